"""The line that shows how far a command has come."""

from __future__ import annotations

import io
import os

import pytest

from teleop.terminal.progress import Progress, RowsProgress, shown_on


class Terminal(io.StringIO):
    """What is written to it, and what would stand on its lines."""

    def isatty(self) -> bool:
        return True

    def lines(self) -> list[str]:
        shown = []
        for line in self.getvalue().split("\n"):
            screen = ""
            for text in line.split("\r"):
                screen = text + screen[len(text) :]
            shown.append(screen)
        return shown


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

    def test_never_reaches_the_edge_of_the_terminal(self, monkeypatch: pytest.MonkeyPatch) -> None:
        stream = Terminal()
        monkeypatch.setattr(stream, "fileno", lambda: 1)
        monkeypatch.setattr(os, "get_terminal_size", lambda _: os.terminal_size((40, 24)))
        Progress(stream, 10).show(5, 0.0, "x" * 100)
        assert len(stream.lines()[0]) == 39

    def test_takes_more_than_everything_and_a_total_of_nothing(self) -> None:
        for total, done in ((10, 20), (0, 0)):
            stream = Terminal()
            Progress(stream, total).show(done, 0.0)
            assert "100%" in stream.lines()[0]

    def test_that_never_showed_anything_ends_without_a_line(self) -> None:
        stream = Terminal()
        Progress(stream, 10).end()
        assert stream.getvalue() == ""


    def test_drops_the_bar_where_it_leaves_no_room_for_the_rest(self, monkeypatch: pytest.MonkeyPatch) -> None:
        stream = narrow(monkeypatch, 40)
        progress = Progress(stream, 10)
        progress.show(0, 0.0)
        progress.show(5, 1.0, "critical k_e, 3 of 7")
        assert stream.lines() == [" 50%  1 s left  critical k_e, 3 of 7"]


    def test_leaves_out_the_time_left_where_it_leaves_no_room_for_the_text(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        stream = narrow(monkeypatch, 40)
        progress = Progress(stream, 10)
        progress.show(0, 0.0)
        progress.show(5, 1.0, "critical k_e of law wave, 3 of 7")
        assert stream.lines() == [" 50%  critical k_e of law wave, 3 of 7"]


    @pytest.mark.parametrize(("columns", "line"), [
        (100, "[##########..........]   50%  1 s left  f 1.0 N  x 2.0 mm  rtt 100 ms  jitter 2.0 ms"),
        (80, " 50%  1 s left  f 1.0 N  x 2.0 mm  rtt 100 ms  jitter 2.0 ms"),
        (54, " 50%  1 s left  f 1.0 N  x 2.0 mm  rtt 100 ms"), (36, " 50%  1 s left  f 1.0 N  x 2.0 mm"),
        (26, " 50%  f 1.0 N  x 2.0 mm"), (20, " 50%  f 1.0 N"), (10, " 50%  f 1"),
    ])
    def test_leaves_out_whole_parts_what_matters_least_first(
        self, monkeypatch: pytest.MonkeyPatch, columns: int, line: str
    ) -> None:
        stream = narrow(monkeypatch, columns)
        progress = Progress(stream, 10)
        progress.show(0, 0.0)
        progress.show(5, 1.0, "f 1.0 N  x 2.0 mm", "rtt 100 ms  jitter 2.0 ms")
        assert stream.lines()[0].rstrip() == line


def narrow(monkeypatch: pytest.MonkeyPatch, columns: int) -> Terminal:
    """A terminal so many columns wide."""
    stream = Terminal()
    monkeypatch.setattr(stream, "fileno", lambda: 1)
    monkeypatch.setattr(os, "get_terminal_size", lambda _: os.terminal_size((columns, 24)))
    return stream


class TestRowsOnATerminal:
    def test_are_shown_before_the_first_of_them(self) -> None:
        stream = Terminal()
        RowsProgress(stream).show(0, 4800, 10.0)
        assert stream.lines() == ["[....................]  0 of 4800 rows  starting"]

    def test_have_a_rate_without_what_it_took_until_the_first_came(self) -> None:
        stream = Terminal()
        progress = RowsProgress(stream)
        for done, now in ((0, 0.0), (1, 20.0), (4, 20.4)):  # 20 s of compiling
            progress.show(done, 4800, now)
        assert stream.lines() == ["[....................]  4 of 4800 rows          "]  # a bunch: no rate yet
        progress.show(1201, 4800, 22.0)
        assert stream.lines()[0].rstrip() == "[#####...............]  1201 of 4800 rows  600 rows/s  6 s left"
        progress.show(4800, 4800, 28.0)
        assert stream.lines()[0].rstrip() == "[####################]  4800 of 4800 rows  600 rows/s"

    def test_that_were_there_before_count_for_no_rate(self) -> None:
        stream = Terminal()
        progress = RowsProgress(stream)
        progress.show(4000, 4800, 0.0)
        assert stream.lines() == ["[#################...]  4000 of 4800 rows  starting"]
        for done, now in ((4010, 3.0), (4110, 4.0)):
            progress.show(done, 4800, now)
        assert stream.lines()[0].rstrip() == "[#################...]  4110 of 4800 rows  100 rows/s  7 s left"

    def test_have_the_rate_of_the_last_seconds(self) -> None:
        stream = Terminal()
        progress = RowsProgress(stream)
        for second in range(60):  # 1 row a second, and 100 from the 30th on
            progress.show(second + 99 * max(0, second - 30), 10_000, float(second))
        assert "  100 rows/s  " in stream.lines()[0]

    def test_that_take_longer_than_that_have_a_rate_too(self) -> None:
        stream = Terminal()
        progress = RowsProgress(stream)
        for done in range(4):
            progress.show(done, 10, 60.0 * done)
        assert "  0.017 rows/s  7 min left" in stream.lines()[0]

    def test_that_are_all_there_are_not_starting(self) -> None:
        stream = Terminal()
        RowsProgress(stream).show(4800, 4800, 0.0)
        assert stream.lines() == ["[####################]  4800 of 4800 rows"]

    @pytest.mark.parametrize(("columns", "line"), [
        (80, "[####################]  999 000 of 1 000 000 rows  100 rows/s  10 s left"),
        (60, "999 000 of 1 000 000 rows  100 rows/s  10 s left"),
        (40, "999 000 of 1 000 000 rows  10 s left"), (36, "999 000 of 1 000 000  10 s left"),
        (59, "999 000 of 1 000 000 rows  100 rows/s  10 s left"), (24, "999 000 of 1 000 000"), (12, "999 000 of "),
    ])
    def test_leave_out_what_matters_least_where_it_is_narrow(
        self, monkeypatch: pytest.MonkeyPatch, columns: int, line: str
    ) -> None:
        stream = narrow(monkeypatch, columns)
        progress = RowsProgress(stream)
        for done, now in ((0, 0.0), (998_000, 5.0), (999_000, 15.0)):
            progress.show(done, 1_000_000, now)
        assert stream.lines()[0].rstrip() == line.rstrip()
        assert max(map(len, stream.lines())) < columns

    def test_have_no_bar_that_would_come_and_go_where_it_is_narrow(self, monkeypatch: pytest.MonkeyPatch) -> None:
        stream = narrow(monkeypatch, 40)
        progress = RowsProgress(stream)
        progress.show(0, 10, 0.0)
        assert stream.lines() == ["0 of 10 rows  starting"]
        progress.show(1, 10, 1.0)
        assert stream.lines()[0].rstrip() == "1 of 10 rows"

    def test_elsewhere_are_a_plain_line_now_and_then(self) -> None:
        stream = io.StringIO()
        progress = RowsProgress(stream)
        for second in range(13):
            progress.show(10 * second, 1000, float(second))
        progress.end()
        assert stream.getvalue().splitlines() == [
            "50 of 1000 rows  10 rows/s  95 s left", "100 of 1000 rows  10 rows/s  90 s left",
        ]


class TestProgressElsewhere:
    def test_writes_plain_lines_seconds_apart(self) -> None:
        stream = io.StringIO()
        progress = Progress(stream, 12_000)
        for k in range(12_001):
            progress.show(k, 100.0 + k * 1e-3, "x 1.0 mm")
        progress.end()
        assert stream.getvalue().splitlines() == [
            "42%  7 s left  x 1.0 mm", "83%  2 s left  x 1.0 mm",
        ]
        assert not {"\r", "\x1b"} & set(stream.getvalue())

    def test_writes_nothing_for_what_is_short(self) -> None:
        stream = io.StringIO()
        progress = Progress(stream, 100)
        for k in range(101):
            progress.show(k, k * 0.01)
        progress.end()
        assert stream.getvalue() == ""


class TestShownOn:
    def test_a_stream_tells_how_much_is_done_and_goes_on_below_whatever_happens(self) -> None:
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

    def test_no_stream_tells_nothing(self) -> None:
        with shown_on(None, lambda: 0.0) as show:
            show(0.5, "half")
