"""The figure of a run: its panels and curves, the extremes in each column of pixels, and a file that is whole."""

from __future__ import annotations

import errno
import sys
from argparse import Namespace
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import teleop.terminal.plotting
import teleop.terminal.run_plot
from scenarios.leader_follower import JOINTS
from teleop import Refused, Result, load_scene, run
from teleop.simulation.trace import BLOCK
from teleop.terminal.options import formats
from teleop.terminal.plotting import asked_formats, new_figure, save
from teleop.terminal.run_plot import GREATEST, binned, draw, extremes
from tests.fakes import raising
from tests.teleop.scene.unlike import unlike

figures = pytest.importorskip("matplotlib.figure")


@pytest.fixture
def drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """`drawn(result)` draws it and returns matplotlib's figure, to be looked into."""
    made: list[Any] = []
    monkeypatch.setattr(teleop.terminal.run_plot, "save", lambda figure, *_: made.append(figure) or [])

    def look(result: Result) -> Any:
        assert draw(result, tmp_path / "plot") == []
        return made.pop()

    return look


def test_six_joints_have_a_column_of_panels_each_and_of_sixteen_axes_those_are_drawn_of_most_work(drawn: Any) -> None:
    joints = run(load_scene("leader_follower", duration=0.8))
    figure = drawn(joints)
    assert [axes.get_title() for axes in figure.axes if axes.get_title()] == [*JOINTS]
    assert len(figure.axes) == 3 * 6 + 1, "what is of all axes has one panel"
    assert figure.axes[0].get_ylabel().startswith("position (")
    assert figure.axes[0].get_ylabel().endswith("rad)")
    trace = {name: np.concatenate([column, column, column[:, :4]], axis=1) if column.ndim > 1 else column
             for name, column in joints.trace.items()}
    trace["f_m"] = trace["f_m"] * np.arange(16)  # the later copy of a joint did more work
    figure = drawn(replace(joints, trace=trace, extra={}))
    titles = [axes.get_title() for axes in figure.axes if axes.get_title()]
    assert len(titles) == 6
    assert {"axis15", "axis13"} < {*titles}
    assert "6 of 16 axes are drawn" in figure.get_suptitle()


def labels(axes: Any) -> list[str]:
    return [text.get_text() for text in axes.get_legend().get_texts()]


def test_axes_in_m_and_in_rad_have_scales_of_their_own(drawn: Any) -> None:
    figure = drawn(run(unlike(duration=0.2)))
    units = [axes.get_ylabel().rpartition("(")[2] for axes in figure.axes]
    assert [unit.endswith("rad)") for unit in units[:2]] == [True, False]
    assert [unit.endswith("N m)") for unit in units[2:6]] == [True, False, True, False]
    assert labels(figure.axes[1]) == ["$x_m$ master, rail", "$x_s$ slave, rail"]


@pytest.fixture(scope="module")
def wave() -> Result:
    return run(load_scene("canonical", duration=0.3))


@pytest.fixture(scope="module")
def lossy() -> Result:
    return run(load_scene("hard_wall", link="delay(0.05) | bernoulli(0.1)", playout="zero", duration=3.0), seed=1)


class TestWhatIsDrawn:
    def test_lines_are_the_trace_in_the_unit_of_the_label_on_one_time_axis_and_none_hides_another(
            self, drawn: Any, wave: Result) -> None:
        figure = drawn(wave)
        for word in ("canonical", "law wave", "ok: ran to its end"):
            assert word in figure.get_suptitle()
        panels = figure.axes
        assert [[label.split()[0] for label in labels(panel)] for panel in panels] == [
            ["$x_m$", "$x_s$"], ["$f_m$", "$f_h$"], ["$f_s$", "$f_{env}$"], ["$E_{link}$", "$E_{port}$"]]
        assert panels[-1].get_xlabel() == "time (s)"
        units = ("position (mm)", "master's force (N)", "slave's force (N)", "energy (mJ)")
        names = (("x_s", "x_m"), ("f_h", "f_m"), ("f_env", "f_s"), ("E_port", "E_link"))
        for axes, unit, columns in zip(panels, units, names, strict=True):
            assert axes.get_xlim() == pytest.approx((0.0, 0.3))
            assert axes.get_ylabel() == unit
            for line, name in zip(axes.get_lines(), columns, strict=True):
                np.testing.assert_array_equal(line.get_xdata(), wave.trace["t"])
                np.testing.assert_allclose(line.get_ydata(), wave.trace[name] * (1e3 if "(m" in unit else 1.0))
            under, over = axes.get_lines()  # where they coincide both are seen, the lower one wider and paler
            assert under.get_zorder() <= over.get_zorder()  # drawn in this order
            assert under.get_linewidth() > 2.0 * over.get_linewidth()
            assert under.get_alpha() < 1.0
            assert over.get_alpha() is None
            assert under.get_color() != over.get_color()

    def test_a_scene_has_a_panel_of_energy_or_of_queues_only_where_it_has_them_and_a_long_sentence_is_not_cut_off(
            self, drawn: Any, wave: Result) -> None:
        assert len(drawn(run(load_scene("canonical", duration=0.1, energy=False))).axes) == 3
        panel = drawn(run(load_scene("hard_wall", link="delay(0.01) | bernoulli(0.1)", duration=0.5))).axes[3]
        assert panel.get_ylabel() == "queue of waves (ms)"
        assert {label.split(":")[0] for label in labels(panel)} == {"backward", "forward"}
        figure = drawn(replace(wave, sentence="diverged, " + "and more of it, " * 12))
        figure.canvas.draw()
        box = figure._suptitle.get_window_extent()
        assert 0.0 < box.x0 < box.x1 < figure.bbox.width

    def test_of_three_axes_the_legend_names_x_y_and_z_of_each_quantity(self, drawn: Any, wave: Result) -> None:
        three = np.stack([wave.trace["x_m"]] * 3, axis=1)
        position = drawn(replace(wave, trace={**wave.trace, "x_m": three})).axes[0]
        assert labels(position) == ["$x_m$ master, x", "$x_m$ master, y", "$x_m$ master, z", "$x_s$ slave"]
        assert [line.get_linestyle() for line in position.get_lines()[1:]] == ["-", "--", ":"]
        assert [handle.get_linestyle() for handle in position.get_legend().get_lines()] == ["-", "--", ":", "-"]


class TestUnderLoss:
    def test_a_force_that_jumps_each_tick_covers_no_other_curve(self, drawn: Any, lossy: Result) -> None:
        position, force, contact = drawn(lossy).axes[:3]
        for axes, place in ((position, 1), (contact, 0)):  # which do not jump
            assert len(axes.get_lines()[place].get_xdata()) == 3000
        assert [label.partition(":\n")[2] for label in labels(force)] == ["mean and range over 8 ms"] * 2
        for line in force.get_lines():  # no curve goes up and down within two pixels
            assert len(line.get_xdata()) == 375
        assert [band.get_alpha() < 0.3 for band in force.collections] == [True, True]

    def test_its_mean_and_its_range_are_those_of_the_ticks_in_each_bin_the_last_of_which_may_be_shorter(
            self, lossy: Result) -> None:
        """A curve that does not jump is drawn tick by tick."""
        bins = binned(lossy.trace["t"], lossy.trace["f_m"])
        assert bins is not None
        ticks = lossy.trace["f_m"].reshape(-1, bins.ticks)
        np.testing.assert_allclose(bins.mean, ticks.mean(axis=1), rtol=1e-12)
        np.testing.assert_array_equal(bins.least, ticks.min(axis=1))
        np.testing.assert_array_equal(bins.greatest, ticks.max(axis=1))
        np.testing.assert_allclose(bins.t, lossy.trace["t"].reshape(-1, bins.ticks).mean(axis=1))
        bins = binned(np.arange(1001.0), np.arange(1001) % 2.0)
        assert bins is not None
        assert (bins.ticks, len(bins.mean)) == (3, 334)
        assert (bins.mean[-1], bins.least[-1], bins.greatest[-1]) == (0.5, 0.0, 1.0)
        t = np.arange(10_000) * 1e-3
        for smooth in (np.sin(t), np.sin(30.0 * t), np.maximum(np.sin(30.0 * t) - 0.5, 0.0)):  # contacts too
            assert binned(t, smooth) is None


@pytest.mark.full
def test_the_file_of_a_run_that_diverged_with_dollar_signs_is_drawn_without_the_state_of_pyplot(
        wave: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They are no formula, and an infinite value is no scale."""
    sys.modules.pop("matplotlib.pyplot", None)
    wild = wave.trace["x_m"].copy()
    wild[-3:] = 1e300, np.inf, np.nan
    result = replace(wave, trace={**wave.trace, "x_m": wild}, sentence=r"$\frac$ \x1b[2J $", scene="$" * 1001)
    draw(result, tmp_path / "plot")
    assert (tmp_path / "plot.png").stat().st_size > 1000
    assert "matplotlib.pyplot" not in sys.modules
    assert draw(replace(wave, trace={name: column[:0] for name, column in wave.trace.items()}), tmp_path / "none")
    monkeypatch.setattr(teleop.terminal.plotting, "find_spec", lambda _: None)
    with pytest.raises(Refused, match=r"pip install 'bilateral-teleop\[plot\]'"):
        draw(wave, tmp_path / "other")
    assert {path.name for path in tmp_path.iterdir()} == {"plot.png", "none.png"}


VALUES = st.floats(allow_nan=True, allow_infinity=True, width=64)


def points(t: Any, values: Any, high: float, columns: int) -> tuple[Any, Any, Any]:
    at, heights = (each.reshape(-1, 2) for each in extremes(t, values, 0.0, high, columns))
    assert np.array_equal(at[:, 0], at[:, 1])
    return at[:, 0], heights.min(axis=1), heights.max(axis=1)


@given(values=arrays(float, st.integers(1, 200), elements=VALUES), columns=st.integers(2, 10))
def test_each_column_of_pixels_has_the_extremes_of_its_rows_and_of_few_rows_each_is_a_point(values: Any,
        columns: int) -> None:
    t = np.arange(len(values)) * 0.001
    high = len(values) * 0.001
    sound = np.where(np.abs(values) <= GREATEST, values, np.nan)
    at, least, greatest = points(t, values, high, columns)
    if len(values) < 2 * columns:
        assert np.array_equal(at, t)
        rows = [sound[i:i + 1] for i in range(len(values))]
    else:
        place = np.minimum((t * (columns / high)).astype(int), columns - 1)
        rows = [sound[place == column] for column in range(columns)]
    some = [each[np.isfinite(each)] for each in rows]
    assert np.array_equal(least, [each.min() if len(each) else np.nan for each in some], equal_nan=True)
    assert np.array_equal(greatest, [each.max() if len(each) else np.nan for each in some], equal_nan=True)


def test_a_spike_of_one_tick_in_a_million_is_seen_across_blocks_and_ticks_left_out_for_a_column_are_a_gap() -> None:
    values = np.zeros(1_000_000)
    values[[BLOCK - 1, BLOCK, 777_777]] = 1.0, -2.0, 3.0
    _, least, greatest = points(np.arange(1_000_000) * 1e-3, values, 1000.0, 600)
    assert np.flatnonzero(greatest == 3.0).tolist() == [777_777 * 600 // 1_000_000]
    edge = BLOCK * 600 // 1_000_000
    assert (least[edge], greatest[edge]) == (-2.0, 1.0)
    t = np.concatenate([np.arange(0, 4000), np.arange(8000, 10_000)]) * 1e-3
    _, least, _ = points(t, np.ones(6000), 10.0, 100)
    assert np.isnan(least).nonzero()[0].tolist() == [*range(40, 80)]


# The files of a plot: their formats, their names, and that each is written whole or not at all


FIRST = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}


def figure(top: float = 1.0) -> Any:
    """A small figure with text, a line and a filled area; another for each `top`."""
    made = new_figure((2.0, 1.5), "title")
    axes = made.subplots()
    axes.plot([0.0, 1.0], [0.0, top], label="$f_m$")
    axes.fill_between([0.0, 1.0], [0.0, top])
    axes.set_xlim(0.0, 1.0)
    axes.set_ylim(0.0, 3.0)
    axes.set_xlabel(f"to {top}")
    return made


def test_of_nothing_asked_for_there_is_none_and_left_out_it_is_png() -> None:
    assert asked_formats(Namespace(plot=False, format=None)) == ()
    assert asked_formats(Namespace(plot=True, format=None)) == ("png",)
    assert asked_formats(Namespace(plot=False, format=None), wanted=True) == ("png",)
    assert asked_formats(Namespace(plot=False, format=("svg",))) == ("svg",)
    assert formats("pdf, SVG") == ("pdf", "svg")


def overlapping(figure: Any) -> list[tuple[str, str]]:
    """Pairs of drawn texts of a figure of which one lies over the other, or beyond the figure's edge."""
    from matplotlib.text import Text

    drawn: dict[Any, None] = {}
    whole = Text.draw

    def draw(text: Any, *given: Any) -> None:
        whole(text, *given)
        drawn[text] = None

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Text, "draw", draw)
        figure.draw_without_rendering()
    edge = figure.bbox
    placed = [(each.get_text(), each.get_window_extent()) for each in drawn if each.get_text().strip()]
    beyond = [(text, "the edge") for text, box in placed if not (
        box.x0 > edge.x0 - 1.0 and box.x1 < edge.x1 + 1.0 and box.y0 > edge.y0 - 1.0 and box.y1 < edge.y1 + 1.0)]
    return beyond + [(a, b) for i, (a, one) in enumerate(placed) for b, other in placed[:i]
                     if min(one.x1, other.x1) - max(one.x0, other.x0) > 1.0
                     and min(one.y1, other.y1) - max(one.y0, other.y0) > 1.0]


FIGURES = (
    "stability soft_tissue --set law=direct --set delay=0.005 --critical k_e --range 300:600 --tol 10",
    "sweep soft_tissue --grid law=direct,pp,p_d,wave delay=0:0.2:5 k_e=20:5e3:5:log --set duration=0.2 --engine plain",
    "run hard_wall --set duration=1",
)


@pytest.mark.parametrize("words", [*FIGURES, *(pytest.param(words, marks=pytest.mark.full) for words in (
    "passivity soft_tissue --set law=direct", "passivity virtual_coupling",
    "precision canonical --set duration=0.1 --rounds 1",
    "tune wave --scene hard_wall --set duration=2.5 --budget 4 --workers 1",
    "zwidth virtual_wall", "stability virtual_wall", "run leader_follower --set duration=1",
    "advise --link delay(0.05) --laws wave,direct,pp --budget 30 --workers 1",
    "sweep hard_wall --grid delay=0:0.1:9"))])
def test_no_text_of_a_figure_lies_over_another(words: str, typed: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The title of `passivity` covered its panels."""
    drawn = []
    monkeypatch.setattr(teleop.terminal.plotting, "render", lambda figure, *_: drawn.append(figure) or b"")
    monkeypatch.setattr("teleop.analysis.stability.report.PLACES", 4)
    if words.startswith("precision"):
        pytest.importorskip("mpmath")
    answer = typed(*words.split(), "--plot")
    assert answer.code == 0, answer.err
    assert drawn
    assert [pair for figure in drawn for pair in overlapping(figure)] == []


class TestNames:
    def test_the_same_picture_is_the_file_that_is_there_and_another_the_next_number_in_all_formats(
            self, tmp_path: Path) -> None:
        first = save(figure(1.0), tmp_path / "sweep", ("png", "pdf", "svg"))
        assert [path.name for path in first] == ["sweep.png", "sweep.pdf", "sweep.svg"]
        held = [path.read_bytes() for path in first]
        for path, data in zip(first, held, strict=True):
            assert data.startswith(FIRST[path.suffix[1:]])
            assert b"Date" not in data
        assert [path.name for path in save(figure(2.0), tmp_path / "sweep", ("svg", "png"))] == [
            "sweep-2.svg", "sweep-2.png"]
        assert save(figure(2.0), tmp_path / "sweep") == [tmp_path / "sweep-2.png"]
        assert save(figure(1.0), tmp_path / "sweep", ("png", "pdf", "svg")) == first  # the same bytes
        assert save(figure(3.0), tmp_path / "sweep") == [tmp_path / "sweep-3.png"]
        assert [path.read_bytes() for path in first] == held
        assert len([*tmp_path.iterdir()]) == 6

    def test_a_link_or_a_folder_of_that_name_stays_and_so_does_what_it_leads_to(self, tmp_path: Path) -> None:
        (tmp_path / "precious").write_bytes(b"precious")
        for name in ("plot.png", ".plot.png.part"):
            (tmp_path / name).symlink_to("precious")
        (tmp_path / "plot-2.png").mkdir()
        assert save(figure(), tmp_path / "plot") == [tmp_path / "plot-3.png"]
        assert (tmp_path / "plot.png").is_symlink()
        assert (tmp_path / "precious").read_bytes() == b"precious"


def test_a_full_disk_leaves_the_old_figure_and_no_new_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "plot.png").write_bytes(b"the old one")
    whole = teleop.terminal.plotting.replacing

    @contextmanager
    def replacing(path: Path) -> Any:
        with whole(path) as file:
            file.write(b"half")
            yield SimpleNamespace(write=raising(OSError(errno.ENOSPC, "No space left on device")))

    monkeypatch.setattr(teleop.terminal.plotting, "replacing", replacing)
    with pytest.raises(Refused, match="No space left"):
        save(figure(), tmp_path / "plot")
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"the old one"]
