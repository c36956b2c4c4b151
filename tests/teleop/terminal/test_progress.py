"""The line that shows how far a command has come."""

from __future__ import annotations

import os
from collections.abc import Iterable

import pytest

from teleop.terminal.progress import Progress, RowsProgress, shown_on
from tests.fakes import Terminal


def narrow(monkeypatch: pytest.MonkeyPatch, columns: int) -> Terminal:
    """A terminal so many columns wide."""
    monkeypatch.setattr(os, "get_terminal_size", lambda _: os.terminal_size((columns, 24)))
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

    def test_writes_at_most_ten_times_a_second_but_always_the_end(self) -> None:
        stream = Terminal()
        progress = Progress(stream, 1000)
        for k in range(1001):
            progress.show(k, k * 1e-3)
        assert stream.getvalue().count("\r") <= 12
        assert "100%" in stream.lines()[0]

    def test_takes_more_than_everything_a_total_of_nothing_and_no_call_at_all(self) -> None:
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
        for columns, parts, line in (
                (100, live, "[##########..........]   50%  1 s left  f 1.0 N  x 2.0 mm  rtt 100 ms  jitter 2.0 ms"),
                (80, live, " 50%  1 s left  f 1.0 N  x 2.0 mm  rtt 100 ms  jitter 2.0 ms"),
                (54, live, " 50%  1 s left  f 1.0 N  x 2.0 mm  rtt 100 ms"),
                (36, live, " 50%  1 s left  f 1.0 N  x 2.0 mm"), (26, live, " 50%  f 1.0 N  x 2.0 mm"),
                (20, live, " 50%  f 1.0 N"), (10, live, " 50%  f 1"),
                (40, critical, " 50%  critical k_e of law wave, 3 of 7"),
                (40, ("x" * 100,), " 50%  " + "x" * 33)):
            stream = narrow(monkeypatch, columns)
            progress = Progress(stream, 10)
            progress.show(0, 0.0)
            progress.show(5, 1.0, *parts)
            assert stream.lines()[0].rstrip() == line
            assert max(map(len, stream.lines())) < columns


class TestRowsOnATerminal:
    def test_have_a_rate_without_what_it_took_until_the_first_came(self) -> None:
        compiling = [(0, 0.0), (1, 20.0), (4, 20.4)]  # 20 s of it
        assert rows_shown(4800, compiling[:1]) == "[....................]  0 of 4800 rows  starting"
        assert rows_shown(4800, compiling) == "[....................]  4 of 4800 rows"  # a bunch: no rate yet
        half = [*compiling, (1201, 22.0)]
        assert rows_shown(4800, half) == "[#####...............]  1201 of 4800 rows  600 rows/s  6 s left"
        assert rows_shown(4800, [*half, (4800, 28.0)]) == "[####################]  4800 of 4800 rows  600 rows/s"

    def test_that_were_there_before_count_for_no_rate(self) -> None:
        assert rows_shown(4800, [(4000, 0.0)]) == "[#################...]  4000 of 4800 rows  starting"
        assert rows_shown(4800, [(4000, 0.0), (4010, 3.0), (4110, 4.0)]) == (
            "[#################...]  4110 of 4800 rows  100 rows/s  7 s left")
        assert rows_shown(4800, [(4800, 0.0)]) == "[####################]  4800 of 4800 rows"

    def test_have_the_rate_of_the_last_seconds_and_one_if_they_take_longer_than_that(self) -> None:
        faster = [(second + 99 * max(0, second - 30), float(second)) for second in range(60)]  # 1 a second, then 100
        assert "  100 rows/s  " in rows_shown(10_000, faster)
        assert "  0.017 rows/s  7 min left" in rows_shown(10, [(done, 60.0 * done) for done in range(4)])

    def test_leave_out_what_matters_least_where_it_is_narrow(self, monkeypatch: pytest.MonkeyPatch) -> None:
        for columns, line in (
                (80, "[####################]  999 000 of 1 000 000 rows  100 rows/s  10 s left"),
                (60, "999 000 of 1 000 000 rows  100 rows/s  10 s left"),
                (59, "999 000 of 1 000 000 rows  100 rows/s  10 s left"),
                (40, "999 000 of 1 000 000 rows  10 s left"), (36, "999 000 of 1 000 000  10 s left"),
                (24, "999 000 of 1 000 000"), (12, "999 000 of")):
            stream = narrow(monkeypatch, columns)
            assert rows_shown(1_000_000, [(0, 0.0), (998_000, 5.0), (999_000, 15.0)], stream) == line
            assert max(map(len, stream.lines())) < columns
        # no bar that would come and go
        assert rows_shown(10, [(0, 0.0)], narrow(monkeypatch, 40)) == "0 of 10 rows  starting"
        assert rows_shown(10, [(0, 0.0), (1, 1.0)], narrow(monkeypatch, 40)) == "1 of 10 rows"


class TestElsewhere:
    def test_plain_lines_are_written_seconds_apart(self) -> None:
        stream = Terminal(is_terminal=False)
        progress = Progress(stream, 12_000)
        for k in range(12_001):
            progress.show(k, 100.0 + k * 1e-3, "x 1.0 mm")
        progress.end()
        assert stream.getvalue().splitlines() == ["42%  7 s left  x 1.0 mm", "83%  2 s left  x 1.0 mm"]
        assert not {"\r", "\x1b"} & set(stream.getvalue())
        stream = Terminal(is_terminal=False)
        rows = RowsProgress(stream)
        for second in range(13):
            rows.show(10 * second, 1000, float(second))
        rows.end()
        assert stream.getvalue().splitlines() == [
            "50 of 1000 rows  10 rows/s  95 s left", "100 of 1000 rows  10 rows/s  90 s left"]

    def test_nothing_is_written_for_what_is_short(self) -> None:
        stream = Terminal(is_terminal=False)
        progress = Progress(stream, 100)
        for k in range(101):
            progress.show(k, k * 0.01)
        progress.end()
        assert stream.getvalue() == ""


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
