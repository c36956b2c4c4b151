"""Aligned text: facts and columns."""

from __future__ import annotations

from teleop.terminal.table import columns, facts


class TestFacts:
    def test_stand_below_each_other_behind_the_longest_label(self) -> None:
        assert facts([("run", "a"), ("", "b"), ("longest", "c")]).splitlines() == [
            "run       a", "          b", "longest   c"]

    def test_of_unknown_origin_stay_on_their_line(self) -> None:
        assert facts([("scene", "x\nstatus   ok\x1b[2J")]) == r"scene   x\nstatus   ok\x1b[2J"

    def test_may_be_none(self) -> None:
        assert facts([]) == ""


class TestColumns:
    def test_are_as_wide_as_their_widest_cell_and_end_without_blanks(self) -> None:
        lines = columns([("name", "size", "note"), ("a", "10", ""), ("bcdef", "7", "odd")], left=(0, 2)).splitlines()
        assert lines == ["name   size  note", "a        10", "bcdef     7  odd"]
