"""The figure of a run: which panels and curves it has, and that it is written whole or not at all."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import teleop.terminal.plotting
from teleop import Refused, Result, load_scene, run
from teleop.terminal.run_plot import draw

figures = pytest.importorskip("matplotlib.figure")


@pytest.fixture
def drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """`drawn(result)` draws it and returns matplotlib's figure, to be looked into."""
    made: list[Any] = []
    save = figures.Figure.savefig

    def remember(figure: Any, *rest: Any, **named: Any) -> None:
        made.append(figure)
        save(figure, *rest, **named)

    monkeypatch.setattr(figures.Figure, "savefig", remember)

    def look(result: Result) -> Any:
        draw(result, tmp_path / "plot")
        assert (tmp_path / "plot.png").read_bytes().startswith(b"\x89PNG")
        return made[-1]

    return look


@pytest.fixture(scope="module")
def wave() -> Result:
    return run(load_scene("canonical", duration=0.3))


def labels(axes: Any) -> list[str]:
    return [text.get_text().split()[0] for text in axes.get_legend().get_texts()]


class TestWhatIsDrawn:
    def test_positions_forces_and_energies_share_the_time_axis(self, drawn: Any, wave: Result) -> None:
        position, force, energy = drawn(wave).axes
        assert labels(position) == ["$x_m$", "$x_s$"]
        assert set(labels(force)) == {"$f_h$", "$f_m$", "$f_s$", "$f_{env}$"}
        assert labels(energy) == ["$E_{link}$", "$E_{port}$"]
        assert energy.get_xlabel() == "time (s)"
        for axes in (position, force, energy):
            assert axes.get_xlim() == pytest.approx((0.0, 0.3))

    def test_the_title_names_scene_law_and_status(self, drawn: Any, wave: Result) -> None:
        title = drawn(wave).get_suptitle()
        for word in ("canonical", "law wave", "ok: ran to its end"):
            assert word in title

    def test_the_lines_are_the_trace_in_the_unit_of_the_label(self, drawn: Any, wave: Result) -> None:
        figure = drawn(wave)
        factor = {"position (mm)": 1e3, "force (N)": 1.0, "energy (mJ)": 1e3}
        names = {"x_m": 0, "x_s": 0, "f_h": 1, "f_m": 1, "f_s": 1, "f_env": 1, "E_link": 2, "E_port": 2}
        for name, panel in names.items():
            axes = figure.axes[panel]
            label = "${}_{{{}}}$".format(*name.split("_")) if len(name) > 3 else f"${name}$"
            line = next(line for line in axes.get_lines() if str(line.get_label()).startswith(label))
            np.testing.assert_array_equal(line.get_xdata(), wave.trace["t"])
            np.testing.assert_allclose(line.get_ydata(), wave.trace[name] * factor[axes.get_ylabel()])

    def test_a_scene_without_energy_has_no_such_panel(self, drawn: Any) -> None:
        assert len(drawn(run(load_scene("canonical", duration=0.1, energy=False))).axes) == 2

    def test_of_several_axes_the_first_is_the_strong_line(self, drawn: Any, wave: Result) -> None:
        three = np.stack([wave.trace["x_m"]] * 3, axis=1)
        lines = drawn(replace(wave, trace={**wave.trace, "x_m": three})).axes[0].get_lines()
        mine = [line for line in lines if line.get_color() == lines[-1].get_color()]
        assert len(mine) == 3
        assert [line.get_linewidth() > 1.0 for line in mine] == [True, False, False]
        assert len(labels(lines[0].axes)) == 2

    def test_a_run_that_diverged_or_never_began_is_drawn_too(self, drawn: Any, wave: Result) -> None:
        wild = wave.trace["x_m"].copy()
        wild[-3:] = 1e300, np.inf, np.nan
        drawn(replace(wave, trace={**wave.trace, "x_m": wild}))
        drawn(replace(wave, trace={name: column[:0] for name, column in wave.trace.items()}))


class TestTheFile:
    def test_pyplot_and_its_global_state_stay_out(self, wave: Result, tmp_path: Path) -> None:
        sys.modules.pop("matplotlib.pyplot", None)
        draw(wave, tmp_path / "plot")
        assert "matplotlib.pyplot" not in sys.modules

    def test_without_matplotlib_the_answer_is_the_line_that_gets_it(
        self, wave: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(teleop.terminal.plotting, "find_spec", lambda _: None)
        with pytest.raises(Refused, match=r"pip install 'bilateral-teleop\[plot\]'"):
            draw(wave, tmp_path / "plot")
        assert not list(tmp_path.iterdir())

    def test_a_sentence_with_dollar_signs_is_drawn_and_is_no_formula(self, wave: Result, tmp_path: Path) -> None:
        draw(replace(wave, sentence=r"$\frac$ \x1b[2J $", scene="$" * 1001), tmp_path / "plot")
        assert (tmp_path / "plot.png").stat().st_size > 1000
