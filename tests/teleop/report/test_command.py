"""`teleop report` as somebody types it: the table as ever, and one page of HTML for each kind of folder."""

from __future__ import annotations

import errno
import json
import shutil
import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import teleop.report.command
import teleop.terminal.plotting
from teleop import load_scene, run, sweep
from teleop.sweeps.pictures.picture import EDGE
from teleop.sweeps.pictures.report import knob_units, told_of, words_of
from teleop.sweeps.store import Store
from teleop.terminal.plotting import RED, SKY
from tests.teleop.report.read_page import SVG, Page, curves, frames, texts
from tests.teleop.studies.compare.test_command import SMALL

pytest.importorskip("matplotlib")

Typed = Callable[..., Any]
SHORT = ("--set", "duration=0.1")


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folders of two runs and of a sweep."""
    at = tmp_path_factory.mktemp("stored")
    run(load_scene("canonical", duration=0.1)).save(at / "a", ["teleop", "run", "canonical"])
    run(load_scene("canonical", duration=0.1, law="pfra")).save(at / "b")
    sweep("soft_tissue", {"delay": [0.0, 0.05, 0.1], "k_e": [1e2, 1e3]}, fixed={"duration": 0.1}, engine="plain",
          out=at / "sweep")
    return at


@pytest.fixture
def here(stored: Path, typed: Typed) -> Path:
    """The same, in an empty folder where commands are typed."""
    shutil.copytree(stored, Path(), dirs_exist_ok=True)
    assert typed is not None
    return Path()


def no_room(*_: object, **__: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.fixture
def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages without figures, which take a second each."""
    monkeypatch.setattr(teleop.terminal.plotting, "find_spec", lambda _: None)


@pytest.mark.usefixtures("here", "plain")
class TestTheFile:
    def test_lies_in_the_folder_the_table_is_as_ever_and_no_other_is_overwritten(self, typed: Typed) -> None:
        first = typed("run", "jittery_wan", *SHORT, "--out", "c").out
        assert typed("report", "c") == (0, f"{first}page: c/report.html\n", "")
        before = Path("c/report.html").read_bytes()
        assert "jittery_wan, law wave" in Page(before).text
        assert typed("report", "c").out.endswith("page: c/report.html\n")
        Path("c/report.html").unlink()
        Path("precious").write_text("my own notes")
        Path("c/report.html").symlink_to(Path("precious").resolve())  # it is not written through
        assert typed("report", "c").out.endswith("page: c/report-2.html\n")
        assert Path("precious").read_text() == "my own notes"
        assert Path("c/report-2.html").read_bytes() == before

    def test_of_several_lies_here_or_where_it_is_named(self, typed: Typed) -> None:
        assert typed("report", "a", "b").out.endswith("page: report.html\n")
        assert typed("report", "a", "b", "--html", "both.html").out.endswith("page: both.html\n")
        assert Path("report.html").read_bytes() == Path("both.html").read_bytes()
        assert not Path("a/report.html").exists()

    def test_that_cannot_be_written_is_said_after_the_table_and_nothing_half_written_is_left(self, typed: Typed,
            monkeypatch: pytest.MonkeyPatch) -> None:
        before = {*Path("a").iterdir()}
        monkeypatch.setattr(teleop.report.command, "replacing", no_room)
        answer = typed("report", "a")
        assert answer.code == 0
        assert answer.out.startswith("run ")
        assert answer.out.endswith("no page: could not write a/report.html (No space left on device); name another "
                                   "file, --html FILE\n")
        assert {*Path("a").iterdir()} == before
        typed("report", "a", "--html", "nowhere/page.html").assert_refused("could not write nowhere/page.html")

    def test_is_not_written_with_json_alone(self, typed: Typed) -> None:
        document = json.loads(Path("a/summary.json").read_text())
        assert json.loads(typed("report", "a", "--json").out) == document | {"path": "a"}
        assert not Path("a/report.html").exists()
        got = json.loads(typed("report", "a", "--json", "--html", "page.html").out)
        assert got == document | {"path": "a", "page": "page.html"}
        assert [one["path"] for one in json.loads(typed("report", "a", "b", "--json").out)["folders"]] == ["a", "b"]

    def test_is_opened_if_that_is_asked_for(self, typed: Typed, monkeypatch: pytest.MonkeyPatch) -> None:
        opened: list[str] = []
        monkeypatch.setattr(webbrowser, "open", lambda address: opened.append(address) or True)
        typed("report", "a", "--open")
        assert opened == [Path("a/report.html").resolve().as_uri()]
        monkeypatch.setattr(webbrowser, "open", lambda _: False)
        typed("report", "a", "--open").assert_refused("open a/report.html yourself")


@pytest.mark.usefixtures("here", "plain")
class TestFolders:
    def test_of_another_kind_or_half_written_are_refused_before_anything_is_written(self, typed: Typed) -> None:
        Path("empty").mkdir()
        typed("report", "a", "empty").assert_refused("empty holds no run and no sweep")
        Path("a/summary.json").unlink()
        typed("report", "a").assert_refused("a holds no complete run")
        Path("b/trace.npz").write_bytes(Path("b/trace.npz").read_bytes()[:2000])
        typed("report", "b").assert_refused("b holds no complete run")
        assert not [*Path().rglob("*.html")]

    def test_of_an_older_version_say_what_they_lack_or_are_shown_with_their_version(self, typed: Typed) -> None:
        summary = json.loads(Path("a/summary.json").read_text())
        Path("a/summary.json").write_text(json.dumps({**summary, "versions": {"bilateral-teleop": "0.0.3"}}))
        typed("report", "a")
        assert "bilateral-teleop 0.0.3" in Page(Path("a/report.html").read_bytes()).text
        del summary["notes"]
        Path("a/summary.json").write_text(json.dumps(summary))
        typed("report", "a").assert_refused("summary.json has no notes")

    def test_of_several_kinds_have_a_section_each_without_matplotlib_but_what_is_asked_for(self, typed: Typed) -> None:
        assert typed("report", "a", "sweep", "b").code == 0
        shown = Page(Path("report.html").read_bytes())
        assert [tag for tag, _ in shown.elements].count("section") == 2
        assert shown.texts[:2] == ["2 reports", "2 reports"]
        assert {"canonical: 2 runs", "soft_tissue: sweep of delay, k_e", "tracking error, rms", "Rows", "Knobs",
                "2 values: 100, 1000"} <= {*shown.texts}
        assert shown.figures == []
        assert [text for text in shown.texts if "matplotlib" in text] == [
            "Figures need matplotlib, which is not installed; type pip install 'bilateral-teleop[plot]', and ask for "
            "the report again."]
        shown.assert_needs_nothing_else()
        typed("report", "sweep", "--metric", "x_err_rms").assert_refused("bilateral-teleop[plot]")


@pytest.mark.usefixtures("here")
class TestASweep:
    @pytest.mark.usefixtures("plain")
    def test_that_grows_has_its_table_and_a_sentence_in_place_of_a_page(self, typed: Typed) -> None:
        definition = json.loads(Path("sweep/sweep.json").read_text())
        with Store.open("sweep", definition):
            answer = typed("report", "sweep")
            assert answer.code == 0
            assert answer.out.endswith("no page: sweep is still being written; ask again when that is over\n")
            assert not Path("sweep/report.html").exists()
            typed("report", "sweep", "--html", "page.html").assert_refused("no page is made", "still being written")
        assert typed("report", "sweep").out.endswith("page: sweep/report.html\n")

    def test_has_its_map_its_knobs_and_its_first_rows(self, typed: Typed) -> None:
        typed("report", "sweep")
        shown = Page(Path("sweep/report.html").read_bytes())
        shown.assert_needs_nothing_else()
        (figure,) = shown.figures
        assert figure.findtext(f"{SVG}title") == "k_e (N/m) over delay (s)"
        words = texts(figure)
        errors = Store.look("sweep").table()["x_err_rms"]
        bar = [float(text) for text in words[words.index("100 % ok") + 1:-1]]  # at its colours
        assert errors.min() <= bar[0] < bar[-1] <= errors.max()
        assert words[-1] == "x_err_rms (m), median of the runs ok"
        assert {"3 values: 0, 0.05, 0.1", "2 values: 100, 1000"} <= {*shown.texts}
        assert "Rows" in shown.texts

    def test_with_rows_that_diverged_shows_where_and_draws_the_boundary(self, typed: Typed) -> None:
        axes = {"delay": [0.0, 0.1], "k_e": [1e2, 5e3]}
        sweep("soft_tissue", axes, fixed={"duration": 2.0, "law": "direct", "x_limit": 0.3}, engine="plain", out="map")
        typed("report", "map")
        (figure,) = Page(Path("map/report.html").read_bytes()).figures
        looks = {one.get(name) for one in figure.iter(f"{SVG}path") for name in ("fill", "stroke")}
        assert {SKY.lower(), RED.lower(), EDGE.lower()} <= looks
        assert {"ok", "diverged", "boundary", "delay (s)", "k_e (N/m)"} <= {*texts(figure)}

    def test_over_one_knob_has_curves_with_a_point_a_value(self, typed: Typed) -> None:
        axes = {"delay": [0.0, 0.05, 0.1], "law": ["wave", "pp"]}
        sweep("soft_tissue", axes, fixed={"duration": 0.1}, engine="plain", out="line")
        typed("report", "line")
        (figure,) = Page(Path("line/report.html").read_bytes()).figures
        names = [*curves(figure)]
        assert len(names) == 6
        assert [name.split()[:2] for name in names] == [["law", "wave"]] * 3 + [["law", "pp"]] * 3

    def test_of_more_values_than_a_page_has_cells_or_of_seeds_alone_says_what_is_not_shown(
            self, typed: Typed, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("teleop.sweeps.pictures.picture.ALONG", 2)
        typed("report", "sweep")
        assert "Shown: 2 of 3 values of delay." in Page(Path("sweep/report.html").read_bytes()).texts
        sweep("jittery_wan", {}, fixed={"duration": 0.1}, seeds=2, engine="plain", out="seeds")
        assert typed("report", "seeds").code == 0
        shown = Page(Path("seeds/report.html").read_bytes())
        assert shown.figures == []
        assert "No figure: " in shown.text


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
    assert {"10 ms", "loss"} <= {*texts(shown.figures[0])}
    assert {"wave", "direct", "tracking error"} <= {*shown.texts}
    for option in (("--plot",), ("--rows", "3"), ("--metric", "x_err_rms")):
        typed("report", "runs/small", *option).assert_refused("holds a comparison", option[0], "teleop compare")
    file = Path("runs/small/rows.jsonl")
    rows = [json.loads(line) for line in file.read_text().splitlines()]
    for wrong in ({"ended": "nowhere"}, {"law": 3}, {"x_err_rms": "much"}):  # rows that are none of it
        changed = [{**rows[0], **wrong}, *rows[1:]]
        file.write_text("".join(json.dumps(row) + "\n" for row in changed))
        typed("report", "runs/small").assert_refused("another version", "teleop compare")


def test_of_a_sweep_of_joints_has_its_metric_in_rad_and_over_m_and_rad_none_and_a_bound_in_both(typed: Typed) -> None:
    short = ("--set", "duration=0.02", "--engine", "plain", "--out")
    typed("sweep", "leader_follower", "--grid", "k_e=5,10", *short, "s")
    typed("report", "s")
    assert "x_err_rms (rad)" in of("s").texts
    assert "x_err_rms (m)" not in of("s").texts
    typed("sweep", "pose", "--grid", "k_e=500,1000", "d_e=1,5", "--set", "x_limit=10", *short, "both")
    typed("report", "both")
    assert "x_err_rms, median of the runs ok" in of("both").texts
    told, _, rows = told_of(Path("both"))
    assert words_of(told, knob_units(told, rows, trust=False))["ok"] == "ok: within 10 m or rad for 0.02 s"


class TestAStudy:
    @pytest.mark.full
    def test_of_precision_has_its_methods_over_run_time(self, typed: Typed, monkeypatch: pytest.MonkeyPatch) -> None:
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

    def test_of_numbers_that_are_none_has_no_figure_and_one_that_is_none_is_refused(self, typed: Typed) -> None:
        Path("t").mkdir()
        Path("t/summary.json").write_text(json.dumps({
            "status": "done", "sentence": "<script>", "mode": "tune", "front": [{"figures": 3}], "best": {}}))
        assert typed("report", "t").code == 0
        shown = of("t")
        assert shown.figures == []
        assert "No figure: the numbers for it are not there." in shown.texts
        assert "<script>" in shown.texts
        Path("t/summary.json").write_text(json.dumps({"status": 3, "sentence": "done", "mode": "tune"}))
        typed("report", "t").assert_refused("holds no complete study (summary.json.status must be a text", "type the")
        Path("t/summary.json").write_text(json.dumps({"mode": "another"}))
        typed("report", "t").assert_refused("holds no run and no sweep")


def test_of_a_page_has_its_parts_in_order_but_those_that_cannot_be_read(typed: Typed) -> None:
    """A folder of `teleop demo --page`: a part for each turn."""
    parts, page = [], Path("pg")
    for i, law in enumerate(("wave", "direct", "tdpa"), 1):
        run(load_scene("hard_wall", duration=0.1, law=law)).save(page / f"{i:02}")
        parts.append({"folder": f"{i:02}", "knobs": {}, "k": 4000 * (i - 1), "why": "turn" if i > 1 else "start"})
    index = {"version": 1, "scene": "hard_wall", "seed": 0, "command": ["teleop", "demo", "--page"], "parts": parts}
    (page / "page.json").write_text(json.dumps(index))
    lines = typed("report", "pg").out.splitlines()
    assert lines[0] == "page   hard_wall, 3 parts"
    assert [line.split()[:2] for line in lines[2:5]] == [["1", "start"], ["2", "switched"], ["3", "switched"]]
    shown = of("pg")
    assert {"hard_wall, 3 parts on the page", "start", "switched", "8.0 s", "direct(K=500, B=20, kf=1)"} <= {
        *shown.texts}
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
