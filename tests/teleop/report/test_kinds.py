"""A page of each kind of folder that a command leaves."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from teleop import load_scene, run
from teleop.sweeps.pictures.report import knob_units, told_of, words_of
from tests.teleop.report.read_page import SVG, Page, frames, texts

pytest.importorskip("matplotlib")

Typed = Callable[..., Any]
SMALL = """
seeds = 1
set = {x_limit = 0.3}
[[link]]
name = "10 ms"
link = "delay(0.01)"
[[link]]
name = "200 ms"
link = "delay(0.2)"
[[environment]]
name = "tissue"
scene = "soft_tissue"
set = {duration = 0.4}
"""


def titles(page: Page) -> list[str | None]:
    return [figure.findtext(f"{SVG}title") for figure in page.figures]


def of(folder: str) -> Page:
    shown = Page(Path(folder, "report.html").read_bytes())
    shown.assert_needs_nothing_else()
    return shown


@pytest.mark.full
def test_of_a_comparison_has_its_table_and_a_map_of_how_cases_ended_and_nothing_of_a_sweep(typed: Typed) -> None:
    Path("small.toml").write_text(SMALL)
    compared = typed("compare", "small.toml", "--laws", "wave,direct", "--workers", "1").out
    assert compared.split("\n\n")[1] == typed("report", "runs/small").out.split("\n\n")[1]  # the table
    shown = of("runs/small")
    assert titles(shown)[0] == "How the cases ended"
    assert "200 ms" in {*texts(shown.figures[0])}
    assert {"wave", "direct", "tracking error"} <= {*shown.texts}
    for option in (("--plot",), ("--rows", "3"), ("--metric", "x_err_rms")):
        typed("report", "runs/small", *option).assert_refused("holds a comparison", option[0], "teleop compare")
    file = Path("runs/small/rows.jsonl")
    rows = [json.loads(line) for line in file.read_text().splitlines()]
    for wrong in ({"ended": "nowhere"}, {"law": 3}, {"x_err_rms": "much"}):  # rows that are none of it
        changed = [{**rows[0], **wrong}, *rows[1:]]
        file.write_text("".join(json.dumps(row) + "\n" for row in changed))
        typed("report", "runs/small").assert_refused("another version", "teleop compare")


class TestASweepOfOtherAxes:
    def test_of_joints_has_its_metric_in_rad(self, typed: Typed) -> None:
        typed("sweep", "leader_follower", "--grid", "k_e=5,10", "--set", "duration=0.02", "--engine", "plain",
              "--out", "s")
        typed("report", "s")
        shown = of("s")
        assert "x_err_rms (rad)" in shown.texts
        assert "x_err_rms (m)" not in shown.texts

    def test_over_axes_in_m_and_in_rad_a_metric_has_no_unit_and_a_bound_has_both(self, typed: Typed) -> None:
        typed("sweep", "pose", "--grid", "k_e=500,1000", "d_e=1,5", "--set", "duration=0.02", "--set", "x_limit=10",
              "--engine", "plain", "--out", "s")
        typed("report", "s")
        assert "x_err_rms, median of the runs ok" in of("s").texts
        told, _, rows = told_of(Path("s"))
        assert words_of(told, knob_units(told, rows, trust=False))["ok"] == "ok: within 10 m or rad for 0.02 s"


class TestAStudy:
    @pytest.mark.full
    def test_of_precision_has_its_methods_and_error_over_run_time(
            self, typed: Typed, monkeypatch: pytest.MonkeyPatch) -> None:
        pytest.importorskip("mpmath")
        for name, few in (("TOLERANCES", (1e-6,)), ("SUBSTEPS", (1, 4))):
            monkeypatch.setattr(f"teleop.analysis.precision.measure.{name}", few)
        typed("precision", "canonical", "--set", "duration=0.1", "--rounds", "1", "--out", "p")
        told = typed("report", "p")
        assert told.out.startswith("precision")
        shown = of("p")
        assert titles(shown) == ["Error over run time"]
        assert {"exact", "rk4/1", "semi_implicit_euler/4"} <= {*shown.texts}

    @pytest.mark.full
    def test_of_tune_has_its_front(self, typed: Typed) -> None:
        typed("tune", "wave", "--scene", "hard_wall", "--set", "duration=2.5", "--budget", "8", "--workers", "1",
              "--out", "t")
        typed("report", "t")
        shown = of("t")
        assert titles(shown) == ["The front of tracking error against drag"]
        assert "best.law.b" in shown.texts

    def test_of_an_analysis_has_its_figures_with_their_units_and_no_rows_of_a_sweep(self, typed: Typed) -> None:
        """The round trip of a loop without a clock stood there in ticks."""
        typed("stability", "soft_tissue", "--set", "law=direct", "--continuous", "--out", "s")
        assert "dominant.frequency" in typed("report", "s").out
        summary = json.loads(Path("s/summary.json").read_text())
        assert {f"{summary['dominant']['frequency']:.6g} Hz", f"{summary['continuous']['round_trip']:.6g} s"} <= {
            *of("s").texts}
        typed("report", "s", "--rows", "3").assert_refused("what teleop stability found", "leave it out")

    @pytest.mark.full
    def test_of_an_analysis_had_no_figure(self, typed: Typed, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("teleop.analysis.stability.report.PLACES", 4)
        typed("passivity", "soft_tissue", "--set", "law=direct", "--out", "two")
        typed("passivity", "virtual_wall", "--out", "one")
        typed("stability", "soft_tissue", "--set", "law=direct", "--set", "delay=0.005", "--critical", "k_e", "--range",
              "300:600", "--tol", "10", "--plot", "--out", "loop")
        figures = {"two": ["Impedances, sampled", "Llewellyn's parameter, sampled: absolutely stable where it is 1 and "
                                                  "more"],
                   "one": ["Damping that the held force needs"],
                   "loop": ["Roots z of the sampled loop, and open loop",
                            "Margins over k_e; critical where the growth rate passes 0"]}
        for folder, named in figures.items():
            assert typed("report", folder).code == 0
            assert titles(of(folder)) == named, folder
        words = str(of("two").figures[1].findtext(f"{SVG}desc"))
        assert f"from {json.loads(Path('two/summary.json').read_text())['sampled']['eta_min']:.3g} to " in words
        Path("loop/curves.npz").write_bytes(b"no archive")
        typed("report", "loop")
        assert "No figure: the numbers for it are not there." in Page(Path("loop/report-2.html").read_bytes()).texts
        Path("loop/curves.npz").unlink()
        typed("report", "loop")
        assert any("type its command again with --plot" in text
                   for text in Page(Path("loop/report-3.html").read_bytes()).texts)

    def test_of_an_advice_has_its_laws_with_what_they_are_judged_by(self, typed: Typed) -> None:
        Path("a").mkdir()
        judged = {"deviation": 0.0, "terms": {"tracking": 0.4, "drag": 0.2}}
        laws = [{"law": "wave", "value": 0.3, "broken": "", **judged}, {"law": "pp", "value": 0.2, **judged,
                 "broken": "limit cycle"}, {"law": "iss", "refused": "it cannot run here"}]
        Path("a/summary.json").write_text(json.dumps({
            "status": "done", "sentence": "take wave", "scene": "hard_wall", "mode": "advise", "laws": laws}))
        typed("report", "a")
        figure = of("a").figure("Laws over this link")
        assert {"advised: wave", "pp", "infeasible: limit cycle", "tracking error"} <= {*texts(figure)}
        assert str(figure.findtext(f"{SVG}desc")).endswith("wave: 0.300; pp: limit cycle.")

    def test_of_numbers_that_are_none_has_no_figure_and_says_so(self, typed: Typed) -> None:
        Path("t").mkdir()
        Path("t/summary.json").write_text(json.dumps({
            "status": "done", "sentence": "<script>", "mode": "tune", "front": [{"figures": 3}], "best": {}}))
        assert typed("report", "t").code == 0
        shown = of("t")
        assert shown.figures == []
        assert "No figure: the numbers for it are not there." in shown.texts
        assert "<script>" in shown.texts

    def test_that_is_none_is_refused(self, typed: Typed) -> None:
        Path("t").mkdir()
        Path("t/summary.json").write_text(json.dumps({"status": 3, "sentence": "done", "mode": "tune"}))
        typed("report", "t").assert_refused("holds no complete study (summary.json.status must be a text", "type the")
        Path("t/summary.json").write_text(json.dumps({"mode": "another"}))
        typed("report", "t").assert_refused("holds no run and no sweep")


def test_of_a_page_has_its_parts_in_order_but_those_that_cannot_be_read(typed: Typed) -> None:
    """A folder of `teleop demo --page`: a part for each turn."""
    parts, page = [], Path("pg")
    for i, law in enumerate(("wave", "direct", "tdpa"), 1):
        run(load_scene("hard_wall", duration=0.1, law=law)).save(page / f"{i:02}")
        parts.append({"folder": f"{i:02}", "knobs": {}, "k": 100 * (i - 1), "why": "turn" if i > 1 else "start"})
    index = {"version": 1, "scene": "hard_wall", "seed": 0, "command": ["teleop", "demo", "--page"], "parts": parts}
    (page / "page.json").write_text(json.dumps(index))
    lines = typed("report", "pg").out.splitlines()
    assert lines[0] == "page   hard_wall, 3 parts"
    assert [line.split()[:2] for line in lines[2:5]] == [["1", "start"], ["2", "switched"], ["3", "switched"]]
    shown = of("pg")
    assert "hard_wall, 3 parts on the page" in shown.texts
    assert len(frames(shown.figure("position"))) == 3
    assert "teleop demo --page" in shown.texts
    (page / "02/trace.npz").unlink()
    (page / "03").rename("elsewhere")
    (page / "03").symlink_to(Path("elsewhere").resolve())
    answer = typed("report", "pg")
    assert answer.code == 0
    assert "left out   pg/02 holds no complete run" in answer.out
    assert "pg/03 is a link" in answer.out
    assert "wave" in answer.out
    for change, words in (
            ({"version": 2}, "version"), ({"parts": []}, "names no part"), ({"scene": 3}, "scene must be a text"),
            ({"parts": [{"folder": "../elsewhere", "k": 0, "why": "start"}]}, "a part is a number")):
        (page / "page.json").write_text(json.dumps({**index, **change}))
        typed("report", "pg").assert_refused("holds no page that can be read", words)
