"""Terminal as a person sees it: colours, folded facts, progress; and nothing changed elsewhere."""

from __future__ import annotations

import io
import os
import pty
import re
import subprocess
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop.scene.library import ROOT
from teleop.terminal.progress import Progress, RowsProgress, shown_on
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
    def test_that_is_too_long_goes_on_below_its_own_beginning_but_where_it_has_what_to_copy_columns_or_no_room(
            self) -> None:
        table = facts([("run", "hard_wall"), ("queue", WORDS)])
        assert folded(table, 60).split("\n") == [
            "run     hard_wall",
            "queue   so a wave takes 51.8 ms fwd, 51.8 ms bwd, delay and",
            "        queue, of which the first",
        ]
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


# The line that shows how far a command has come


def narrow(monkeypatch: pytest.MonkeyPatch, width: int) -> Terminal:
    monkeypatch.setattr(os, "get_terminal_size", lambda _: os.terminal_size((width, 24)))
    return Terminal()


def rows_shown(total: int, steps: Iterable[tuple[int, float]], stream: Terminal | None = None) -> str:
    """The line after so many rows were done at these times, s."""
    stream = stream or Terminal()
    progress = RowsProgress(stream)
    for done, now in steps:
        progress.show(done, total, now)
    (line,) = stream.lines()
    return line.rstrip()


class TestProgressOnATerminal:
    def test_rewrites_one_line_with_bar_share_time_left_and_text(self) -> None:
        stream = Terminal()
        progress = Progress(stream, 200)
        progress.show(0, 10.0, "x 1.0 mm")
        assert stream.lines() == ["[....................]    0%  x 1.0 mm"]
        progress.show(50, 12.0, "x 2.0 mm")
        assert stream.lines() == ["[#####...............]   25%  6 s left  x 2.0 mm"]
        progress.show(200, 18.0, "x")
        assert stream.lines() == ["[####################]  100%  x                 "]
        progress.end()
        assert stream.getvalue().endswith("\n")
        assert "\x1b" not in stream.getvalue()

    def test_takes_what_was_done_at_the_first_call_for_no_rate(self) -> None:
        """As at an end of a run that comes when a third of it is over."""
        stream = Terminal()
        progress = Progress(stream, 30)
        progress.show(10, 0.0)
        assert stream.lines() == ["[#######.............]   33%"]
        progress.show(15, 5.0)
        assert stream.lines()[0].rstrip() == "[##########..........]   50%  15 s left"

    def test_writes_at_most_ten_times_a_second_but_always_the_end_of_more_than_everything_or_of_nothing(self) -> None:
        stream = Terminal()
        progress = Progress(stream, 1000)
        for k in range(1001):
            progress.show(k, k * 1e-3)
        assert stream.getvalue().count("\r") <= 12
        assert "100%" in stream.lines()[0]
        for total, done in ((10, 20), (0, 0)):
            stream = Terminal()
            Progress(stream, total).show(done, 0.0)
            assert "100%" in stream.lines()[0]
        stream = Terminal()
        Progress(stream, 10).end()
        assert stream.getvalue() == ""

    def test_never_reaches_the_edge_and_leaves_out_whole_parts_what_matters_least_first(
            self, monkeypatch: pytest.MonkeyPatch) -> None:
        live, critical = ("f 1.0 N  x 2.0 mm", "rtt 100 ms  jitter 2.0 ms"), ("critical k_e of law wave, 3 of 7",)
        for width, parts, line in (
                (100, live, "[##########..........]   50%  1 s left  f 1.0 N  x 2.0 mm  rtt 100 ms  jitter 2.0 ms"),
                (80, live, " 50%  1 s left  f 1.0 N  x 2.0 mm  rtt 100 ms  jitter 2.0 ms"),
                (54, live, " 50%  1 s left  f 1.0 N  x 2.0 mm  rtt 100 ms"),
                (36, live, " 50%  1 s left  f 1.0 N  x 2.0 mm"), (26, live, " 50%  f 1.0 N  x 2.0 mm"),
                (20, live, " 50%  f 1.0 N"), (10, live, " 50%  f 1"),
                (40, critical, " 50%  critical k_e of law wave, 3 of 7"),
                (40, ("x" * 100,), " 50%  " + "x" * 33)):
            stream = narrow(monkeypatch, width)
            progress = Progress(stream, 10)
            progress.show(0, 0.0)
            progress.show(5, 1.0, *parts)
            assert stream.lines()[0].rstrip() == line
            assert max(map(len, stream.lines())) < width


class TestRowsOnATerminal:
    def test_have_a_rate_without_what_it_took_until_the_first_came_or_those_that_were_there_before(self) -> None:
        compiling = [(0, 0.0), (1, 20.0), (4, 20.4)]  # 20 s of it
        half = [*compiling, (1201, 22.0)]
        for steps, shown in (
                (compiling[:1], "[....................]  0 of 4800 rows  starting"),
                (compiling, "[....................]  4 of 4800 rows"),  # a bunch: no rate yet
                (half, "[#####...............]  1201 of 4800 rows  600 rows/s  6 s left"),
                ([*half, (4800, 28.0)], "[####################]  4800 of 4800 rows  600 rows/s"),
                ([(4000, 0.0)], "[#################...]  4000 of 4800 rows  starting"),
                ([(4000, 0.0), (4010, 3.0), (4110, 4.0)],
                 "[#################...]  4110 of 4800 rows  100 rows/s  7 s left"),
                ([(4800, 0.0)], "[####################]  4800 of 4800 rows")):
            assert rows_shown(4800, steps) == shown

    def test_have_the_rate_of_the_last_seconds_and_one_if_they_take_longer_than_that(self) -> None:
        faster = [(second + 99 * max(0, second - 30), float(second)) for second in range(60)]  # 1 a second, then 100
        assert "  100 rows/s  " in rows_shown(10_000, faster)
        assert "  0.017 rows/s  7 min left" in rows_shown(10, [(done, 60.0 * done) for done in range(4)])

    def test_leave_out_what_matters_least_where_it_is_narrow(self, monkeypatch: pytest.MonkeyPatch) -> None:
        for width, line in (
                (80, "[####################]  999 000 of 1 000 000 rows  100 rows/s  10 s left"),
                (60, "999 000 of 1 000 000 rows  100 rows/s  10 s left"),
                (59, "999 000 of 1 000 000 rows  100 rows/s  10 s left"),
                (40, "999 000 of 1 000 000 rows  10 s left"), (36, "999 000 of 1 000 000  10 s left"),
                (24, "999 000 of 1 000 000"), (12, "999 000 of")):
            stream = narrow(monkeypatch, width)
            assert rows_shown(1_000_000, [(0, 0.0), (998_000, 5.0), (999_000, 15.0)], stream) == line
            assert max(map(len, stream.lines())) < width
        # no bar that would come and go
        assert rows_shown(10, [(0, 0.0)], narrow(monkeypatch, 40)) == "0 of 10 rows  starting"
        assert rows_shown(10, [(0, 0.0), (1, 1.0)], narrow(monkeypatch, 40)) == "1 of 10 rows"


class TestElsewhere:
    def test_plain_lines_are_written_seconds_apart_and_none_for_what_is_short(self) -> None:
        for total, step, shown in ((12_000, 1e-3, ["42%  7 s left  x 1.0 mm", "83%  2 s left  x 1.0 mm"]),
                                   (100, 0.01, [])):
            stream = Terminal(is_terminal=False)
            progress = Progress(stream, total)
            for k in range(total + 1):
                progress.show(k, 100.0 + k * step, "x 1.0 mm")
            progress.end()
            assert stream.getvalue().splitlines() == shown
            assert not {"\r", "\x1b"} & set(stream.getvalue())
        stream = Terminal(is_terminal=False)
        rows = RowsProgress(stream)
        for second in range(13):
            rows.show(10 * second, 1000, float(second))
        rows.end()
        assert stream.getvalue().splitlines() == [
            "50 of 1000 rows  10 rows/s  95 s left", "100 of 1000 rows  10 rows/s  90 s left"]


def test_a_stream_tells_how_much_is_done_and_goes_on_below_whatever_happens() -> None:
    stream, now = Terminal(), iter([0.0, 1.0])

    def fail_half_way() -> None:
        with shown_on(stream, lambda: next(now), 2.0) as show:
            show(0.0, "begun")
            show(1.0, "half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail_half_way()
    assert stream.lines()[-2].split() == ["[##########..........]", "50%", "1", "s", "left", "half"]
    assert stream.getvalue().endswith("\n")
    with shown_on(None, lambda: 0.0) as show:
        show(0.5, "half")
