"""The page of a run, and of several side by side: all that the run was, in figures that are its data."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from teleop import load_scene, run
from teleop.report.of_runs import RunView, of_one, of_parts, of_several
from teleop.report.page import page
from teleop.report.strips import Strip, strips
from teleop.simulation.result import Result
from tests.teleop.report.read_page import SVG, Page, curves

HOSTILE = '"><script>alert(1)</script><img src=x onerror=alert(2)>\x1b[2J\u202e&lt;'


@pytest.fixture(scope="module")
def canonical() -> Result:
    return run(load_scene("canonical", duration=4.0))


def told(result: Result, **also: Any) -> RunView:
    return RunView("here", result, {**result.summary(["teleop", "run", "canonical"]), **also})


def of(*runs: RunView) -> Page:
    return Page(page([of_one(runs[0]) if len(runs) == 1 else of_several(runs)]))


def box_of(figure: Any) -> tuple[float, float, float, float]:
    frame = next(one for one in figure.iter(f"{SVG}rect") if one.get("class") == "f")
    x, y, width, height = (float(frame.get(name)) for name in ("x", "y", "width", "height"))
    return x, y, width, height


class TestOne:
    def test_has_outcome_table_figures_knobs_versions_and_command(self, canonical: Result) -> None:
        shown = of(told(canonical))
        for said in ("canonical, law wave", "ran to its end, 4000 ticks of 0.001 s", "tracking error", "delay",
                     "0.05 s", "law.b", "teleop run canonical", "numpy " + np.__version__):
            assert any(said in text for text in shown.texts), said
        assert [figure.findtext(f"{SVG}title") for figure in shown.figures] == [
            "position", "master's force", "slave's force", "energy"]

    def test_needs_nothing_else_and_every_figure_is_described(self, canonical: Result) -> None:
        shown = of(told(canonical))
        shown.assert_needs_nothing_else()
        peak = 1e3 * float(canonical.trace["x_m"].max())
        assert f"x_m master from {1e3 * float(canonical.trace['x_m'].min()):.1f} mm to {peak:.1f} mm" in str(
            shown.figure("position").findtext(f"{SVG}desc"))

    @pytest.mark.parametrize(("title", "name", "column"), [
        ("position", "x_m master", "x_m"), ("position", "x_s slave", "x_s"),
        ("master's force", "f_m against the hand", "f_m"), ("slave's force", "f_env on the environment", "f_env"),
    ])
    def test_a_curve_goes_through_the_extremes_of_each_column_of_pixels(
        self, canonical: Result, title: str, name: str, column: str
    ) -> None:
        figure = of(told(canonical)).figure(title)
        x, _, width, _ = box_of(figure)
        drawn = [point for piece in curves(figure)[name] for point in piece]
        values = canonical.trace[column]
        # The lowest and the highest point drawn are the extremes of all: from these the scale of the figure.
        heights = [at for _, at in drawn]
        low, high = float(values.min()), float(values.max())
        scale = (max(heights) - min(heights)) / (high - low)
        columns = round(width)
        place = np.minimum((canonical.trace["t"] * (columns / 4.0)).astype(int), columns - 1)
        for i in range(columns):
            own = values[place == i]
            at = round(10.0 * (x + width * (i + 0.5) / columns))
            there = [h for left, h in drawn if left == at]
            assert there
            assert abs(max(heights) - max(there) - scale * (float(own.min()) - low)) <= 6.0  # tenths of a pixel
            assert abs(max(heights) - min(there) - scale * (float(own.max()) - low)) <= 6.0

    def test_is_the_same_to_the_byte(self, canonical: Result) -> None:
        assert page([of_one(told(canonical))]) == page([of_one(told(canonical))])

    def test_is_small_however_long_the_run_was(self) -> None:
        dice = np.random.default_rng(1)
        rows = 300_000
        names = ("x_m", "x_s", "f_h", "f_m", "f_env", "f_s", "queue_m", "queue_s", "E_port", "E_link")
        noise = {name: dice.normal(size=rows) for name in names}
        figures = strips([Strip("", {"t": np.arange(rows) * 1e-3, **noise}, 1e-3, [])])
        assert len(figures) == 5
        assert sum(map(len, figures)) < 130_000

    def test_what_is_not_a_number_is_a_gap_and_an_infinite_value_does_not_flatten_the_rest(self) -> None:
        t = np.arange(100) * 0.01
        x = np.sin(t)
        x[40:60] = np.nan
        x[90] = np.inf
        (figure,) = strips([Strip("", {"t": t, "x_m": x}, 0.01, [])])
        pieces = curves(Page(figure.encode()).figures[0])["x_m master"]
        assert [len(dict.fromkeys(piece)) for piece in pieces] == [40, 30, 9]

    def test_of_a_run_that_never_came_to_a_tick_has_no_figure(self, canonical: Result) -> None:
        nothing = replace(canonical, trace={name: column[:0] for name, column in canonical.trace.items()}, ticks=0)
        assert of(told(nothing)).figures == []

    def test_six_joints_have_a_panel_each_on_a_scale_of_its_own(self) -> None:
        shown = of(told(run(load_scene("leader_follower", duration=0.8))))
        titles = [figure.findtext(f"{SVG}title") for figure in shown.figures]
        assert titles == ["position", "master's force", "slave's force", "energy"]
        texts = [text.text for text in shown.figure("position").iter(f"{SVG}text")]
        assert {"base", "shoulder", "elbow", "forearm", "wrist", "flange"} < {*texts}
        assert any((text or "").startswith("position (") and (text or "").endswith("rad)") for text in texts)
        assert len([one for one in shown.figure("energy").iter(f"{SVG}rect") if one.get("class") == "f"]) == 1

    def test_energy_is_drawn_also_where_the_first_of_many_axes_is_not(self) -> None:
        """`teleop report MASTER SLAVE` ended with KeyError: 0 where other axes had done more work than the first."""
        t = np.arange(50) * 0.01
        x = np.sin(np.outer(t, np.arange(6.0)))  # the first rests
        trace = {"t": t, "x_m": x, "x_s": x, "f_m": x, "f_s": x, "E_port": t}
        assert len(strips([Strip("", trace, 0.01, [])])) == 4
        assert len(strips([Strip("", trace, 0.01, [])] * 2)) == 5, "and the sentence on what is left out"

    def test_of_several_runs_of_many_axes_three_are_drawn_and_named(self) -> None:
        joints = told(run(load_scene("leader_follower", duration=0.8)))
        shown = of(joints, joints)
        assert any("3 of 6 axes are drawn, those over which" in text for text in shown.texts)

    def test_three_axes_are_told_apart_by_their_lines(self) -> None:
        shown = of(told(run(load_scene("recorded_reach", duration=1.0))))
        assert {"x_m master x", "x_m master y", "x_m master z"} <= curves(shown.figure("position")).keys()
        assert {"x", "y", "z"} <= {one.text for one in shown.figure("position").iter(f"{SVG}text")}

    def test_events_are_listed_and_marked(self, canonical: Result) -> None:
        event = {"k": 1234, "what": "safe", "why": "nothing heard for 0.2 s"}
        shown = of(told(replace(canonical, extra={"master": {"events": [event]}})))
        assert {"1.234 s", "safe", "nothing heard for 0.2 s"} <= {*shown.texts}
        marks = [one for one in shown.figure("position").iter(f"{SVG}path") if one.get("class") == "e"]
        assert [one.findtext(f"{SVG}title") for one in marks] == ["master: safe, nothing heard for 0.2 s"]

    def test_hostile_texts_stay_texts(self, canonical: Result) -> None:
        hostile = replace(canonical, scene=HOSTILE, sentence=HOSTILE, notes=(HOSTILE,), mode=HOSTILE, extra={
            "slave": {"events": [{"k": 5, "what": HOSTILE, "why": HOSTILE}]}},
            parameters={HOSTILE: HOSTILE, "law": {"name": HOSTILE, HOSTILE: HOSTILE}})
        document = {"command": [HOSTILE], "versions": {HOSTILE: HOSTILE}}
        view = RunView(HOSTILE, hostile, document)
        shown = Page(page([of_one(view), of_several([view] * 2)]))
        shown.assert_needs_nothing_else()
        assert "\x1b" not in shown.source
        assert "\u202e" not in shown.source
        assert sum("<script>alert(1)</script>" in text for text in shown.texts) > 10


class TestSeveral:
    def test_have_a_column_each_and_a_panel_each_on_one_scale(self, canonical: Result) -> None:
        other = run(load_scene("canonical", duration=4.0, law="pfra", delay=0.1))
        shown = of(told(canonical), told(other))
        heads = [text for text in shown.texts if text.startswith(("1: ", "2: "))]
        assert heads[:2] == ["1: wave, delay 0.05 s", "2: pfra, delay 0.1 s"]
        frames = [one for one in shown.figure("position").iter(f"{SVG}rect") if one.get("class") == "f"]
        assert len(frames) == 2
        assert len({frame.get("height") for frame in frames}) == 1
        shown.assert_needs_nothing_else()

    def test_of_which_one_has_no_verdict_were_only_called_ok(self, canonical: Result) -> None:
        left_open = "0.1 m of swing are left, but that was too short a time for a verdict"
        short = replace(canonical, seed=1, sentence=f"{canonical.sentence}; {left_open}")
        assert any("too short a time for a verdict" in text for text in of(told(canonical), told(short)).texts)
        assert "outcome" not in of(told(canonical), told(replace(canonical, seed=1))).texts

    def test_that_differ_in_nothing_are_called_by_their_folders(self, canonical: Result) -> None:
        first, second = told(canonical)._replace(name="a"), told(canonical)._replace(name="b")
        assert {"1: a", "2: b"} <= {*of(first, second).texts}

    def test_of_a_run_without_a_queue_the_figure_in_words_said_nothing(self, canonical: Result) -> None:
        jitter = run(load_scene("canonical", duration=1.0, link="delay(0.05) | uniform(0.01)"))
        words = str(of(told(canonical), told(jitter)).figure("queue of waves").findtext(f"{SVG}desc"))
        assert ": it has none. 2: " in words

    def test_of_many_each_is_a_row(self, canonical: Result) -> None:
        shown = of(*[told(replace(canonical, seed=seed)) for seed in range(8)])
        assert {f"{i + 1}: seed {i}" for i in range(8)} <= {*shown.texts}


class TestThePartsOfAPage:
    def test_are_told_in_order_with_what_began_them(self, canonical: Result) -> None:
        other = run(load_scene("canonical", duration=2.0, law="direct"))
        begun = [(0, "start"), (4000, "turned")]
        section = of_parts("pg", [told(canonical), told(other)], begun, {"scene": "canonical"}, 6)
        shown = Page(page([section]))
        for said in ("canonical, 2 parts on the page", "start", "turned", "4.0 s", "wave(b=2, K=500, B=20)",
                     "direct(K=500, B=20, kf=1)"):
            assert said in shown.texts, said


def test_the_knobs_of_a_folder_are_those_of_its_summary(canonical: Result, tmp_path: Path) -> None:
    canonical.save(tmp_path / "one")
    stored = json.loads((tmp_path / "one" / "summary.json").read_text())
    shown = of(told(canonical))
    for name in stored["parameters"]:
        assert name in shown.texts
