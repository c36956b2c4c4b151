"""The files of a plot: their formats, their names, and that each is written whole or not at all."""

from __future__ import annotations

import errno
from argparse import Namespace
from pathlib import Path
from typing import Any

import pytest

import teleop.terminal.plotting
from teleop import Refused
from teleop.terminal.options import formats
from teleop.terminal.plotting import asked_formats, new_figure, save

pytest.importorskip("matplotlib")
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

    class Full:
        def write(self, _: bytes) -> None:
            raise OSError(errno.ENOSPC, "No space left on device")

    whole = teleop.terminal.plotting.replacing

    def replacing(path: Path) -> Any:
        class Half:
            def __enter__(self) -> Any:
                self.inner = whole(path)
                self.inner.__enter__().write(b"half")
                return Full()

            def __exit__(self, *error: Any) -> Any:
                return self.inner.__exit__(*error)

        return Half()

    monkeypatch.setattr(teleop.terminal.plotting, "replacing", replacing)
    with pytest.raises(Refused, match="No space left"):
        save(figure(), tmp_path / "plot")
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"the old one"]
