"""The table of the bench's README: it is what the command prints, and a cell says what its rows say."""

from __future__ import annotations

import re

import pytest

from teleop.bench.__main__ import BENCHES, LINES, MISSED, Elsewhere, Item, labelled, measured, table
from teleop.scene.library import ROOT

ROWS = [("constant delay: C", "19.3 ns a tick", ""), ("constant delay: c", "23.5 ns a tick", ""),
        ("  over C", "2.21 times", "asked: at most 1.8"), ("pp: live tick", "2.4 / 2.3 us", "asked: at most 10"),
        ("wave: live tick", "12.2 / 2.7 us", "asked: at most 10"),
        ("late", "30 us", "0.93 times C; asked: at most 1.5"), ("both", "81 / 80 us", "asked: at most 90 / 70"),
        ("used", "99.9 / 97.4 %; 1", "asked: at least 0 / 99 / 1"), ("gain", "1.9 times", "asked: at least 1.8")]


def test_the_readme_had_other_lines_than_its_command_prints() -> None:
    lines = (ROOT / "teleop" / "bench" / "README.md").read_text().splitlines()
    shown = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines if line.startswith("| ")]
    assert [(what, aimed, by.strip("`")) for what, _, aimed, by in shown[1:]] == [
        (line.what, line.aimed, line.bench if isinstance(line, Item) else line.command) for line in LINES]
    assert all(cell for _, cell, *_ in shown[1:])


@pytest.mark.parametrize(("patterns", "cell"), [
    (("constant delay: c: over C",), f"2.21 times {MISSED}"),
    ((".*: live tick",), f"2.3 to 12.2 us {MISSED}"), (("pp: live tick", "gain"), "2.4 / 2.3 us; 1.9 times"),
    (("used",), f"99.9 / 97.4 %; 1 {MISSED}"),
    (("late",), "30 us, 0.93 times C"), (("both",), f"81 / 80 us {MISSED}"), (("nothing", "gain"), "no row; 1.9 times"),
])
def test_a_cell_has_a_value_for_each_part_and_says_what_is_missed(patterns: tuple[str, ...], cell: str) -> None:
    assert measured(Item("", "", "", patterns), labelled(ROWS)) == cell


def test_a_bound_in_other_words_was_never_marked_as_missed() -> None:
    sources = [path for path in (ROOT / "teleop" / "bench").glob("*.py") if path.name != "__main__.py"]
    bounds = [bound for path in sources for bound in re.findall(r'(?:f?"|; )asked: ([^"]*)"', path.read_text())]
    assert len(bounds) > 20
    assert all(re.match(r"at (most|least) [{\d]", bound) for bound in bounds), bounds


def test_each_bench_is_run_once_and_a_line_of_another_command_keeps_its_figure() -> None:
    asked: list[str] = []

    def run(name: str) -> list[tuple[str, str, str]]:
        asked.append(name)
        return ROWS

    lines = [Item("one", "1.8", "sweep", ("gain",)), Item("two", "", "sweep", ("late",)),
             Elsewhere("x", "1", "y", "2 s")]
    assert table(run, lines).splitlines()[2:] == [
        "| one | 1.9 times | 1.8 | `sweep` |", "| two | 30 us, 0.93 times C |  | `sweep` |", "| x | 2 s | 1 | `y` |"]
    assert asked == ["sweep"]
    assert {line.bench for line in LINES if isinstance(line, Item)} <= {*BENCHES}
