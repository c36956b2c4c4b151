"""Colours: where they are, where they are not, and that they change nothing else."""

from __future__ import annotations

import io
import os
import pty
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from teleop.scene.library import ROOT
from teleop.terminal import screen
from teleop.terminal.progress import Progress
from teleop.terminal.screen import BAD, BOLD, GOOD, NOTICE

ORDERS = re.compile(r"\x1b\[\d*m")
TABLE = """\
run            hard_wall, law wave, virtual time, seed 0
status         ok: ran to its end, 10 ticks
safe state     master: safe at t = 0.1 s, silence
note           with 2 ok, it says
"""


class Terminal(io.StringIO):
    """A stream that is a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.fixture(autouse=True)
def usual(monkeypatch: pytest.MonkeyPatch) -> None:
    """A terminal as most are."""
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm-256color")


def inside(order: str, text: str) -> str:
    return f"\x1b[{order}m{text}\x1b[0m"


class TestWhereThereAreColours:
    def test_a_terminal_has_them(self) -> None:
        assert screen.has_colours(Terminal())

    def test_a_file_or_a_pipe_has_none(self) -> None:
        assert not screen.has_colours(io.StringIO())

    @pytest.mark.parametrize(("name", "value"), [("NO_COLOR", "1"), ("NO_COLOR", "0"), ("TERM", "dumb")])
    def test_nobody_gets_them_who_asked_for_none(self, monkeypatch: pytest.MonkeyPatch, name: str, value: str) -> None:
        monkeypatch.setenv(name, value)
        assert not screen.has_colours(Terminal())
        assert screen.answer(TABLE, Terminal()) == TABLE

    def test_an_empty_no_color_asks_for_nothing(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("NO_COLOR", "")
        assert screen.has_colours(Terminal())

    def test_a_terminal_of_which_nothing_is_known_has_none(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.delenv("TERM")
        assert not screen.has_colours(Terminal())


class TestAnAnswer:
    def test_of_a_run_has_heading_status_and_the_labels_of_what_to_heed(self) -> None:
        lines = screen.answer(TABLE, Terminal()).splitlines()
        assert lines == [
            "run            " + inside(BOLD, "hard_wall, law wave, virtual time, seed 0"),
            "status         " + inside(GOOD, "ok") + ": ran to its end, 10 ticks",
            inside(NOTICE, "safe state") + "     master: safe at t = 0.1 s, silence",
            inside(NOTICE, "note") + "           with 2 ok, it says",
        ]

    @pytest.mark.parametrize(("status", "order"), [
        ("ok", GOOD), ("limit cycle", NOTICE), ("unstable", BAD), ("diverged", BAD), ("stopped", NOTICE)])
    def test_says_each_status_in_its_colour(self, status: str, order: str) -> None:
        for line in (f"status   {status}: and why", f"  1     0  direct  {status}  8957", f"6 done: 5 {status}, 1 odd"):
            assert screen.answer(f"-\n{line}", Terminal()) == "-\n" + line.replace(status, inside(order, status))

    def test_leaves_the_same_words_in_a_sentence_alone(self) -> None:
        said = "-\ndelay margin   unstable from a round trip of 29 ticks on, stopped by it\nthe okapi is  okay"
        assert screen.answer(said, Terminal()) == said

    def test_has_headings_over_lists(self) -> None:
        assert screen.answer("scenes\n  canonical  A hand.\n\nlaws", Terminal()) == \
            inside(BOLD, "scenes") + "\n  canonical  A hand.\n\nlaws"

    def test_is_as_wide_with_them_as_without(self) -> None:
        assert ORDERS.sub("", screen.answer(TABLE, Terminal())) == TABLE

    def test_in_a_file_is_as_it_was(self) -> None:
        assert screen.answer(TABLE, io.StringIO()) == TABLE


class TestTheLiveLine:
    def test_has_the_safe_state_in_a_colour_and_is_rewritten_whole(self) -> None:
        stream = Terminal()
        progress = Progress(stream, 100)
        progress.show(10, 0.0, "slave SAFE 20%, no answer  f 0.0 N")
        assert inside(BAD, "slave SAFE 20%, no answer") + "  f 0.0 N" in stream.getvalue()
        progress.show(100, 9.0, "f 0.0 N")
        first, last = (ORDERS.sub("", text) for text in stream.getvalue().split("\r")[1:])
        assert len(last) == len(first)

    def test_has_none_where_nothing_is_wrong(self) -> None:
        stream = Terminal()
        Progress(stream, 100).show(10, 0.0, "f 0.0 N  queue 0.7 ms")
        assert "\x1b" not in stream.getvalue()


def on_a_terminal(folder: Path, *words: str, **also: str) -> str:
    """What `teleop WORDS` writes to a terminal."""
    ours, theirs = pty.openpty()
    kept = {key: value for key, value in os.environ.items() if key not in ("NO_COLOR", *also)}
    done = subprocess.Popen([sys.executable, "-m", "teleop", *words], cwd=folder, stdin=theirs, stdout=theirs,
                            stderr=theirs, env={**kept, "PYTHONPATH": str(ROOT), "TERM": "xterm", **also})
    os.close(theirs)
    said = b""
    try:
        while part := os.read(ours, 1 << 16):
            said += part
    except OSError:  # the terminal is closed at the other end
        pass
    done.wait()
    os.close(ours)
    return said.decode().replace("\r\n", "\n")


def test_a_command_has_colours_on_a_terminal_and_the_same_bytes_as_ever_elsewhere(
    tmp_path: Path, process: Callable[..., Any]
) -> None:
    typed = ("stability", "soft_tissue", "--set", "law=direct", "--set", "delay=0.005")
    piped = process("-m", "teleop", *typed).communicate()[0]
    assert "\x1b" not in piped
    seen = on_a_terminal(tmp_path, *typed)
    assert f"verdict        {inside(GOOD, 'stable')}: " in seen
    assert ORDERS.sub("", seen) == piped
    assert on_a_terminal(tmp_path, *typed, NO_COLOR="1") == piped
    assert "\x1b" not in on_a_terminal(tmp_path, *typed, "--json")


def test_a_refusal_has_its_first_word_in_red_on_a_terminal(tmp_path: Path) -> None:
    assert on_a_terminal(tmp_path, "run", "no_such_scene").startswith(inside(BAD, "teleop:") + " ")
