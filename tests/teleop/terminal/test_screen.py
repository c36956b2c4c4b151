"""What a person sees of a table on a terminal: its facts folded between words, and nothing changed elsewhere."""

from __future__ import annotations

import io
import os

import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop.terminal.screen import columns, render
from teleop.terminal.table import facts, folded

WORDS = "so a wave takes 51.8 ms fwd, 51.8 ms bwd, delay and queue, of which the first"


class Terminal(io.StringIO):
    """A terminal."""

    def isatty(self) -> bool:
        return True

    def fileno(self) -> int:
        return 1


class TestAFact:
    def test_that_is_too_long_goes_on_below_its_own_beginning(self) -> None:
        table = facts([("run", "hard_wall"), ("queue", WORDS)])
        assert folded(table, 60).split("\n") == [
            "run     hard_wall",
            "queue   so a wave takes 51.8 ms fwd, 51.8 ms bwd, delay and",
            "        queue, of which the first",
        ]

    @pytest.mark.parametrize("typed", ["`teleop list laws`", "--set duration=11.6", "type  sudo sysctl --system"])
    def test_that_has_something_to_type_is_left_to_the_terminal_so_that_it_can_be_copied(self, typed: str) -> None:
        table = facts([("run", "hard_wall"), ("note", f"{WORDS} {typed}")])
        assert folded(table, 60) == table

    def test_behind_a_table_with_columns_is_left_as_it_is(self) -> None:
        text = f"{facts([('sweep', WORDS)])}\nrow  seed  law\n  0     0  {WORDS}\nqueue   {WORDS}"
        assert folded(text, 60).split("\n")[-3:] == text.split("\n")[-3:]

    def test_is_left_as_it_is_where_there_is_no_room_to_speak_of(self) -> None:
        table = facts([("a label that is long", WORDS)])
        assert folded(table, 50) == table

    @given(st.lists(st.text("abc ", min_size=1, max_size=200).map(lambda text: " ".join(text.split())), min_size=1),
           st.integers(45, 120))
    def test_loses_no_word(self, said: list[str], width: int) -> None:
        table = facts([("run", "hard_wall"), *(("queue", each) for each in said)])
        assert folded(table, width).split() == table.split()


class TestOnATerminal:
    def test_an_answer_is_folded_at_its_width(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("NO_COLOR", "1")
        monkeypatch.setattr(os, "get_terminal_size", lambda _: os.terminal_size((60, 24)))
        lines = render(facts([("run", "hard_wall"), ("queue", WORDS)]), Terminal()).split("\n")
        assert len(lines) == 3
        assert max(map(len, lines)) <= 60

    def test_of_no_known_width_it_is_as_it_is(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("NO_COLOR", "1")
        monkeypatch.setattr(os, "get_terminal_size", lambda _: os.terminal_size((0, 0)))
        table = facts([("run", "hard_wall"), ("queue", WORDS)])
        assert render(table, Terminal()) == table
        assert columns(io.StringIO()) == 0

    def test_in_a_file_it_is_as_it_is(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(os, "get_terminal_size", lambda _: os.terminal_size((60, 24)))
        table = facts([("run", "hard_wall"), ("queue", WORDS)])
        assert render(table, io.StringIO()) == table
