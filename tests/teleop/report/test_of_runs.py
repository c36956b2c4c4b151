"""The page of a run, and of several side by side: all that the run was, in figures that are its data, and texts."""

from __future__ import annotations

import json
import re
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import teleop.terminal.plotting
from teleop import Result, load_scene, run
from teleop.report.markup import LONGEST, Markup, element, empty, path_data
from teleop.report.markup import text as text_of
from teleop.report.of_runs import RunView, most_to_see, of_one, of_parts, of_several
from teleop.report.page import page
from teleop.report.strips import Strip, strips
from teleop.scene.axes import AxisLabels
from teleop.terminal.table import printable
from tests.browser import Browser
from tests.programs import BROWSERS, program
from tests.teleop.report.read_page import SVG, Page, curves, frames, texts

pytest.importorskip("matplotlib")
HOSTILE = '"><script>alert(1)</script><img src=x onerror=alert(2)>\x1b[2J\u202e&lt;'


@pytest.fixture(scope="module")
def canonical() -> Result:
    return run(load_scene("canonical", duration=4.0))


@pytest.fixture(scope="module")
def joints() -> Result:
    return run(load_scene("leader_follower", duration=0.3))


def told(result: Result, **also: Any) -> RunView:
    return RunView("here", result, {**result.summary(["teleop", "run", "canonical"]), **also})


def of(*runs: RunView) -> Page:
    return Page(page([of_one(runs[0]) if len(runs) == 1 else of_several(runs)]))


def drawn(*runs: Strip) -> list[Any]:
    """The figures of runs, as they are read."""
    return Page("".join(strips(runs)).encode()).figures


class TestOne:
    def test_has_all_that_it_was_to_the_byte_and_needs_nothing_else(self, canonical: Result) -> None:
        data = page([of_one(told(canonical))])
        assert data == page([of_one(told(canonical))])
        assert len(data) < 62_000
        shown = Page(data)
        for said in ("canonical, law wave", "ran to its end, 4000 ticks of 0.001 s", "tracking error", "delay",
                     "0.05 s", "law.b", "teleop run canonical", "numpy " + np.__version__):
            assert any(said in text for text in shown.texts), said
        assert [figure.findtext(f"{SVG}title") for figure in shown.figures] == [
            "position", "master's force", "slave's force", "energy"]
        shown.assert_needs_nothing_else()
        peak = 1e3 * float(canonical.trace["x_m"].max())
        assert f"x_m master from {1e3 * float(canonical.trace['x_m'].min()):.1f} mm to {peak:.1f} mm" in str(
            shown.figure("position").findtext(f"{SVG}desc"))
        assert {*json.loads(json.dumps(canonical.summary(), default=str))["parameters"]} <= {*shown.texts}
        nothing = {name: column[:0] for name, column in canonical.trace.items()}  # it never came to a tick
        assert of(told(replace(canonical, trace=nothing, ticks=0))).figures == []

    def test_every_spike_of_one_tick_of_a_long_run_is_drawn_where_it_was_and_as_high(self) -> None:
        rows = 300_000
        spikes = {5: 1.0, 123_456: -0.7, 200_000: 0.4, 200_001: -0.4, 299_999: 0.9}
        x = 0.01 * np.sin(np.arange(rows) * 1e-3)
        x[[*spikes]] = [*spikes.values()]
        figure, = drawn(Strip("", {"t": np.arange(rows) * 1e-3, "x_m": x}, 1e-3, []))
        (left, _, width, _), = frames(figure)
        path, = curves(figure)["x_m master"]
        low, high = max(y for _, y in path), min(y for _, y in path)  # of -0.7 and 1
        for tick, value in spikes.items():
            at = left + width * tick / rows
            height = low + (value + 0.7) / 1.7 * (high - low)
            assert any(abs(px - at) <= 1.5 and abs(py - height) <= 0.6 for px, py in path), tick

    def test_is_small_however_long_the_run_was(self) -> None:
        dice, rows = np.random.default_rng(1), 100_000
        names = ("x_m", "x_s", "f_h", "f_m", "f_env", "f_s", "queue_m", "queue_s", "E_port", "E_link")
        noise = {name: dice.normal(size=rows) for name in names}
        figures = [*strips([Strip("", {"t": np.arange(rows) * 1e-3, **noise}, 1e-3, [])])]
        assert len(figures) == 5
        assert sum(map(len, figures)) < 150_000

    def test_what_is_not_a_number_is_a_gap_and_an_infinite_value_does_not_flatten_the_rest(self) -> None:
        t = np.arange(100) * 0.01
        x = np.sin(t)
        x[40:60] = x[98] = np.nan
        x[90] = np.inf
        figure, = drawn(Strip("", {"t": t, "x_m": x}, 0.01, []))
        pieces = curves(figure)["x_m master"]
        (left, top, width, height), = frames(figure)
        ends = [round((x - left) / width * 100) for piece in pieces for x in (piece[0][0], piece[-1][0])]
        assert ends == [0, 39, 60, 89, 91, 97, 99, 99], "the last is a point by itself"
        heights = sorted(y for piece in pieces for _, y in piece)
        assert top <= heights[0] < heights[-1] - 0.8 * height <= top + 0.2 * height

    @pytest.mark.full
    def test_six_joints_have_a_panel_each_on_a_scale_of_its_own_and_three_of_several_runs(self, joints: Result) -> None:
        shown = of(told(joints))
        titles = [figure.findtext(f"{SVG}title") for figure in shown.figures]
        assert titles == ["position", "master's force", "slave's force", "energy"]
        words = texts(shown.figure("position"))
        assert {"base", "shoulder", "elbow", "forearm", "wrist", "flange"} < {*words}
        assert any(text.startswith("position (") and text.endswith("rad)") for text in words)
        assert [len(frames(figure)) for figure in shown.figures] == [6, 6, 6, 1]
        assert any("3 of 6 axes are drawn, those over which" in text for text in of(told(joints), told(joints)).texts)

    def test_energy_is_drawn_also_where_the_first_of_many_axes_is_not(self) -> None:
        """`teleop report MASTER SLAVE` ended with KeyError: 0 where other axes had done more work than the first."""
        t = np.arange(50) * 0.01
        x = np.sin(np.outer(t, np.arange(6.0)))  # the first rests
        trace = {"t": t, "x_m": x, "x_s": x, "f_m": x, "f_s": x, "E_port": t}
        assert len([*strips([Strip("", trace, 0.01, [])])]) == 4
        assert len([*strips([Strip("", trace, 0.01, [])] * 2)]) == 5, "and the sentence on what is left out"

    def test_an_axis_whose_name_begins_with_an_underscore_is_in_the_legend(self) -> None:
        """Matplotlib leaves such a name out."""
        t = np.arange(50) * 0.01
        trace = {"t": t, "x_m": np.sin(np.outer(t, np.arange(3.0)))}
        figure, = drawn(Strip("", trace, 0.01, [], AxisLabels(("_x", "_", "z"), ())))
        assert {"_x", "_", "z"} <= {text.strip() for text in texts(figure)}

    def test_three_axes_are_told_apart_by_their_lines(self) -> None:
        shown = of(told(run(load_scene("recorded_reach", duration=0.3))))
        assert {"x_m master x", "x_m master y", "x_m master z"} <= curves(shown.figure("position")).keys()
        assert {"x", "y", "z"} <= {*texts(shown.figure("position"))}
        looks = {str(group.findtext(f"{SVG}title")): group.find(f"{SVG}path").attrib.get("stroke-dasharray")
                 for group in shown.figure("position").iter(f"{SVG}g")}
        assert len({looks[f"x_m master {axis}"] for axis in "xyz"}) == 3

    def test_events_are_listed_and_marked(self, canonical: Result) -> None:
        event = {"k": 1234, "what": "safe", "why": "nothing heard for 0.2 s"}
        shown = of(told(replace(canonical, extra={"master": {"events": [event]}})))
        assert {"1.234 s", "safe", "nothing heard for 0.2 s"} <= {*shown.texts}
        for figure in shown.figures:
            (left, top, width, height), = frames(figure)
            mark, = curves(figure)["master: safe, nothing heard for 0.2 s"]
            assert [x for x, _ in mark] == pytest.approx([left + width * 1.234 / 4.0] * 2, abs=0.1)
            assert sorted(y for _, y in mark) == pytest.approx([top, top + height], abs=0.1)

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
        for figure in shown.figures:
            (_, *first), (_, *second) = frames(figure)
            assert first == pytest.approx(second, abs=0.2)
            assert {text for text in texts(figure) if texts(figure).count(text) > 1} - {"0"} == {
                "1", "2", "3", "4"}, "one time axis for both, and values at the left alone"
        drawn_of = curves(shown.figure("position"))["x_m master"]
        heights = [max(y for _, y in piece) - min(y for _, y in piece) for piece in drawn_of]
        spans = [float(np.ptp(each.trace["x_m"])) for each in (canonical, other)]
        assert heights[0] / spans[0] == pytest.approx(heights[1] / spans[1], rel=0.02)
        shown.assert_needs_nothing_else()

    def test_of_a_run_without_a_queue_the_figure_in_words_said_nothing(self, canonical: Result) -> None:
        jitter = run(load_scene("canonical", duration=1.0, link="delay(0.05) | uniform(0.01)"))
        words = str(of(told(canonical), told(jitter)).figure("queue of waves").findtext(f"{SVG}desc"))
        assert ": it has none. 2: " in words


class TestTheWords:
    @pytest.fixture(autouse=True)
    def plain(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Pages without figures, which take a second each."""
        monkeypatch.setattr(teleop.terminal.plotting, "find_spec", lambda _: None)

    def test_on_runs_are_also_how_each_ended_where_all_are_ok(self, canonical: Result) -> None:
        """One that had too little time for a verdict was only called ok."""
        left_open = "0.1 m of swing are left, but that was too short a time for a verdict"
        shown = of(told(canonical), told(replace(canonical, seed=1, sentence=f"{canonical.sentence}; {left_open}")))
        assert any("too short a time for a verdict" in text for text in shown.texts)
        assert canonical.sentence in shown.texts

    def test_on_runs_that_differ_in_nothing_are_their_folders_and_on_many_a_row_each(self, canonical: Result) -> None:
        first, second = told(canonical)._replace(name="a"), told(canonical)._replace(name="b")
        assert {"1: a", "2: b"} <= {*of(first, second).texts}
        shown = of(*[told(replace(canonical, seed=seed)) for seed in range(8)])
        assert {f"{i + 1}: seed {i}" for i in range(8)} <= {*shown.texts}

    def test_the_figures_of_a_page_were_of_its_last_parts_whatever_was_to_see_in_them(self, canonical: Result) -> None:
        """They are of the parts that swing, then of those with the greatest force, and the rest is named."""
        force = [3.0, 20.0, 0.1, 9.0, 20.0, 2.0, 5.0, 1.0]
        parts = [replace(canonical, status="limit cycle" if i == 2 else "ok", metrics={
            "f_m_max": size, "f_env_max": size / 2.0, "jerk_rms": float(i)}) for i, size in enumerate(force)]
        assert most_to_see(parts, 3) == [1, 2, 4]
        assert most_to_see(parts[:2], 3) == [0, 1]
        section = of_parts("pg", [told(part) for part in parts], [(0, "start")] * 8, {"scene": "canonical"})
        words = Page(page([section])).text
        assert "The figures show the 6 parts with most to see" in words
        assert "Left out: parts 6 and 8." in words

    def test_a_force_that_is_rounding_was_shown_in_femtonewtons(self, canonical: Result) -> None:
        small = replace(canonical, metrics={**canonical.metrics, "f_m_end": 4.98e-15, "x_err_rms": 1e-9})
        for shown in (of(told(small)).text, of(told(small), told(canonical)).text, small._repr_html_()):
            assert "e-15" not in shown
            assert re.search(r"\b(0 N felt|0 N)\b", shown)
            assert re.search(r"1\.00 nm|1e-09 m", shown), "what is small but no rounding stays"
        assert small.metrics["f_m_end"] == 4.98e-15


@given(said=st.text(max_size=80))
@settings(max_examples=50)
def test_whatever_is_put_in_is_read_again_as_text_and_as_attribute(said: str) -> None:
    page = Page(element("p", {"title": said}, said).encode())
    assert page.elements == [("p", {"title": printable(said)})]
    assert "".join(page.texts) == printable(said)


def test_markup_is_put_in_as_it_is_and_a_text_is_not_longer_than_is_read() -> None:
    assert element("p", None, element("b", None, "<i>")) == "<p><b>&lt;i&gt;</b></p>"
    assert empty("path", {"d": "M0 0", "class": None}) == '<path d="M0 0"/>'
    assert len(text_of("x" * 10 * LONGEST)) == LONGEST


def test_only_the_commands_of_a_path_are_taken_for_one() -> None:
    assert isinstance(path_data("M0 0l3-4"), Markup)
    with pytest.raises(ValueError, match="letters and numbers"):
        path_data('M0 0"/><script>')


def printed(html: bytes, at: Path) -> tuple[int, str]:
    """The sheets of a page that is printed, and what the browser's console says."""
    (at / "page.html").write_bytes(html)
    done = subprocess.run(
        [program(*BROWSERS), "--headless=new", "--no-sandbox", "--disable-gpu", f"--user-data-dir={at / 'profile'}",
         "--enable-logging=stderr", "--v=0", "--no-pdf-header-footer", f"--print-to-pdf={at / 'page.pdf'}",
         (at / "page.html").as_uri()], capture_output=True, text=True, check=True, timeout=120)
    console = "\n".join(line for line in done.stderr.splitlines() if "CONSOLE" in line)
    return len(re.findall(rb"/Type\s*/Page\b(?!s)", (at / "page.pdf").read_bytes())), console


PARTED = """[...document.querySelectorAll('td.k, th[scope=row]:not(.w), span.k')].filter(each => {
  const range = document.createRange();
  range.selectNodeContents(each);
  return new Set([...range.getClientRects()].map(box => Math.round(box.bottom))).size > 1;
}).map(each => each.textContent)"""
OVERLAPPING = """[...document.querySelectorAll('svg')].flatMap(svg => {
  const boxes = [...svg.querySelectorAll('text')].map(each => [each.textContent, each.getBoundingClientRect()]);
  return boxes.flatMap(([a, one], i) => boxes.slice(0, i).filter(([b, other]) =>
    Math.min(one.right, other.right) - Math.max(one.left, other.left) > 1 &&
    Math.min(one.bottom, other.bottom) - Math.max(one.top, other.top) > 3).map(([b, _]) => a + ' over ' + b));
})"""


@pytest.mark.live
@pytest.mark.full
def test_a_page_of_parts_parted_numbers_from_their_units_and_was_as_narrow_as_a_column_of_text(tmp_path: Path) -> None:
    results = [run(load_scene("hard_wall", duration=0.8, **knobs)) for knobs in (
        {"law": "wave"}, {"law": "tdpa"}, {"law": "direct", "delay": 0.15}, {"law": "iss", "k_e": 4000.0})]
    views = [told(each)._replace(name=f"{i:02}") for i, each in enumerate(results)]
    parts = of_parts("pg", views, [(0, "switched")] * 4, {"scene": "hard_wall", "command": []})
    (tmp_path / "page.html").write_bytes(page([parts, of_one(told(results[1]))]))
    browser = Browser()
    try:
        for width in (1280, 800):
            tab = browser.page((tmp_path / "page.html").as_uri(), width=width, height=900)
            assert tab.evaluate(PARTED) == []
            assert tab.evaluate(OVERLAPPING) == []
            assert tab.evaluate("document.documentElement.scrollWidth") <= width, "the page itself does not scroll"
            assert tab.evaluate("document.querySelector('svg').getBoundingClientRect().width") > 0.85 * width
    finally:
        browser.close()


@pytest.mark.live
@pytest.mark.full
def test_a_run_is_printed_on_two_sheets_at_most_and_six_on_three(tmp_path: Path) -> None:
    sheets, console = printed(page([of_one(told(run(load_scene("jittery_wan", duration=3.0))))]), tmp_path)
    assert 1 <= sheets <= 2
    assert console == ""
    results = [run(load_scene("hard_wall", duration=1.0, law=law)) for law in (
        "wave", "direct", "pp", "p_d", "iss", "tdpa")]
    several = of_several([told(each)._replace(name=f"run-{i}") for i, each in enumerate(results)])
    sheets, console = printed(page([several]), tmp_path)
    assert 1 <= sheets <= 3
    assert console == ""
