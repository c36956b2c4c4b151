"""What a person sees on a terminal: colours and folded facts, and nothing changed elsewhere."""

from __future__ import annotations

import io
import os
import pty
import re
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop.scene.library import ROOT
from teleop.terminal.progress import Progress
from teleop.terminal.screen import BAD, BOLD, GOOD, NOTICE, answer, columns, has_colours, render
from teleop.terminal.table import facts, folded
from tests.fakes import Terminal
from tests.teleop.conftest import Answer

ORDERS = re.compile(r"\x1b\[\d*m")
TABLE = """\
run            hard_wall, law wave, virtual time, seed 0
status         ok: ran to its end, 10 ticks
safe state     master: safe at t = 0.1 s, silence
note           with 2 ok, it says
"""
WORDS = "so a wave takes 51.8 ms fwd, 51.8 ms bwd, delay and queue, of which the first"


@pytest.fixture(autouse=True)
def usual(monkeypatch: pytest.MonkeyPatch) -> None:
    """A terminal as most are."""
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm-256color")


def inside(order: str, text: str) -> str:
    return f"\x1b[{order}m{text}\x1b[0m"


def test_a_terminal_has_colours_but_where_none_are_asked_for_and_a_file_has_none(
        monkeypatch: pytest.MonkeyPatch) -> None:
    assert has_colours(Terminal())
    assert not has_colours(Terminal(is_terminal=False))
    assert answer(TABLE, Terminal(is_terminal=False)) == TABLE
    for name, value, asked in (("NO_COLOR", "1", False), ("NO_COLOR", "0", False), ("NO_COLOR", "", True),
                               ("TERM", "dumb", False), ("TERM", None, False)):
        with monkeypatch.context() as patch:
            if value is None:
                patch.delenv(name)
            else:
                patch.setenv(name, value)
            assert has_colours(Terminal()) == asked, (name, value)
            assert (answer(TABLE, Terminal()) == TABLE) == (not asked)


class TestAnAnswer:
    def test_of_a_run_has_heading_status_and_the_labels_of_what_to_heed(self) -> None:
        text = answer(TABLE, Terminal())
        assert text.splitlines() == [
            "run            " + inside(BOLD, "hard_wall, law wave, virtual time, seed 0"),
            "status         " + inside(GOOD, "ok") + ": ran to its end, 10 ticks",
            inside(NOTICE, "safe state") + "     master: safe at t = 0.1 s, silence",
            inside(NOTICE, "note") + "           with 2 ok, it says",
        ]
        assert ORDERS.sub("", text) == TABLE
        assert answer("scenes\n  canonical  A hand.\n\nlaws", Terminal()) == \
            inside(BOLD, "scenes") + "\n  canonical  A hand.\n\nlaws"

    def test_says_each_status_in_its_colour_and_leaves_the_same_words_in_a_sentence_alone(self) -> None:
        for status, order in (("ok", GOOD), ("limit cycle", NOTICE), ("unstable", BAD), ("diverged", BAD),
                              ("stopped", NOTICE)):
            for line in (f"status   {status}: and why", f"  1     0  direct  {status}  8957",
                         f"6 done: 5 {status}, 1 odd"):
                assert answer(f"-\n{line}", Terminal()) == "-\n" + line.replace(status, inside(order, status))
        sentence = "-\ndelay margin   unstable from a round trip of 29 ticks on, stopped by it\nthe okapi is  okay"
        assert answer(sentence, Terminal()) == sentence

    def test_is_folded_at_the_width_of_a_terminal_and_as_it_is_where_that_is_not_known(
            self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("NO_COLOR", "1")
        table = facts([("run", "hard_wall"), ("queue", WORDS)])
        monkeypatch.setattr(os, "get_terminal_size", lambda _: os.terminal_size((60, 24)))
        lines = render(table, Terminal()).split("\n")
        assert len(lines) == 3
        assert max(map(len, lines)) <= 60
        assert render(table, Terminal(is_terminal=False)) == table
        assert columns(io.StringIO()) == 0
        monkeypatch.setattr(os, "get_terminal_size", lambda _: os.terminal_size((0, 0)))
        assert render(table, Terminal()) == table


class TestAFact:
    def test_that_is_too_long_goes_on_below_its_own_beginning(self) -> None:
        table = facts([("run", "hard_wall"), ("queue", WORDS)])
        assert folded(table, 60).split("\n") == [
            "run     hard_wall",
            "queue   so a wave takes 51.8 ms fwd, 51.8 ms bwd, delay and",
            "        queue, of which the first",
        ]

    def test_is_left_as_it_is_where_it_has_something_to_copy_or_columns_or_there_is_no_room(self) -> None:
        for typed in ("`teleop list laws`", "--set duration=11.6", "type  sudo sysctl --system"):
            table = facts([("run", "hard_wall"), ("note", f"{WORDS} {typed}")])
            assert folded(table, 60) == table
        text = f"{facts([('sweep', WORDS)])}\nrow  seed  law\n  0     0  {WORDS}\nqueue   {WORDS}"
        assert folded(text, 60).split("\n")[-3:] == text.split("\n")[-3:]
        table = facts([("a label that is long", WORDS)])
        assert folded(table, 50) == table

    @given(st.lists(st.text("abc ", min_size=1, max_size=200).map(lambda text: " ".join(text.split())), min_size=1,
                    max_size=5), st.integers(45, 120))
    def test_loses_no_word(self, words: list[str], width: int) -> None:
        table = facts([("run", "hard_wall"), *(("queue", each) for each in words)])
        assert folded(table, width).split() == table.split()


def test_the_live_line_has_the_safe_state_in_a_colour_and_is_rewritten_whole() -> None:
    stream = Terminal()
    Progress(stream, 100).show(10, 0.0, "f 0.0 N  queue 0.7 ms")
    assert "\x1b" not in stream.getvalue()
    stream = Terminal()
    progress = Progress(stream, 100)
    progress.show(10, 0.0, "slave SAFE 20%, no answer  f 0.0 N")
    assert inside(BAD, "slave SAFE 20%, no answer") + "  f 0.0 N" in stream.getvalue()
    progress.show(100, 9.0, "f 0.0 N")
    first, last = (ORDERS.sub("", text) for text in stream.getvalue().split("\r")[1:])
    assert len(last) == len(first)


SHOWN = """
import os, sys
from teleop.__main__ import main
for words, no_color in (("list wave", ""), ("list wave", "1"), ("list wave --json", ""), ("run no_such_scene", "")):
    os.environ["NO_COLOR"] = no_color
    main(words.split())
    print("----", flush=True)
"""


def test_a_command_has_colours_on_a_terminal_and_the_same_bytes_as_ever_elsewhere(
        tmp_path: Path, typed: Callable[..., Answer]) -> None:
    piped = typed("list", "wave").out
    assert "\x1b" not in piped
    ours, theirs = pty.openpty()
    done = subprocess.Popen([sys.executable, "-c", SHOWN], cwd=tmp_path, stdin=theirs, stdout=theirs, stderr=theirs,
                            env={**os.environ, "PYTHONPATH": str(ROOT), "TERM": "xterm"})
    os.close(theirs)
    shown = b""
    with suppress(OSError):  # the terminal is closed at the other end
        while part := os.read(ours, 1 << 16):
            shown += part
    done.wait()
    os.close(ours)
    coloured, plain, document, refusal, _ = shown.decode().replace("\r\n", "\n").split("----\n")
    assert "\x1b[" in coloured
    assert ORDERS.sub("", coloured) == plain == piped
    assert "\x1b" not in document
    assert refusal.startswith(inside(BAD, "teleop:") + " ")
