"""What a terminal shows: numbers with SI prefixes, the table of a run, the line of progress."""

from __future__ import annotations

import io
import os
import re
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop import Refused, Result, load_scene, run
from teleop.simulation.result import Packets
from teleop.terminal.options import guarded
from teleop.terminal.printable import printable
from teleop.terminal.run_table import PREFIX, Progress, RowsProgress, duration, si, table, whole


class TestSI:
    @pytest.mark.parametrize(
        ("value", "unit", "text"),
        [
            (0.0318, "m", "31.8 mm"), (-0.011, "J", "-11.0 mJ"), (3.4e-6, "s", "3.40 us"), (0.0, "J", "0 J"),
            (-0.0, "J", "0 J"), (1.0, "N", "1.00 N"), (999.4, "N", "999 N"), (999.6, "N", "1.00 kN"),
            (0.0009996, "m", "1.00 mm"), (1e6, "m", "1.00 Mm"), (5.08e17, "J", "5.08e+17 J"),
            (1.7e-18, "J", "1.70e-18 J"), (float("inf"), "m", "inf m"), (float("nan"), "N", "nan N"),
        ],
    )
    def test_known_texts(self, value: float, unit: str, text: str) -> None:
        assert si(value, unit) == text

    @given(st.floats(min_value=1e-9, max_value=9.99e11) | st.floats(min_value=-9.99e11, max_value=-1e-9))
    def test_reads_back_to_three_digits(self, value: float) -> None:
        number, unit = si(value, "m").split(" ")
        factor = {letter: 1e3**power for power, letter in PREFIX.items()}[unit.removesuffix("m")]
        assert float(number) * factor == pytest.approx(value, rel=5.001e-3)
        assert 1.0 <= abs(float(number)) < 1000.0
        assert len(re.sub(r"[-.]", "", number)) == 3


def rows(result: Result) -> dict[str, list[str]]:
    """The table as label -> texts."""
    found: dict[str, list[str]] = {}
    for line in table(result).splitlines():
        label, text = re.split(r" {3,}", line, maxsplit=1)
        found.setdefault(label, []).append(text)
    return found


@pytest.fixture(scope="module")
def wave() -> Result:
    return run(load_scene("canonical", duration=1.0))


class TestTable:
    def test_says_what_ran_and_how_it_ended(self, wave: Result) -> None:
        told = rows(wave)
        assert told["run"] == ["canonical, law wave, virtual time, seed 0"]
        assert told["status"] == ["ok: ran to its end, 1000 ticks of 0.001 s"]

    def test_does_not_say_the_status_twice(self, wave: Result) -> None:
        told = rows(replace(wave, status="diverged", sentence="diverged at t = 1 s"))
        assert told["status"] == ["diverged at t = 1 s"]

    def test_gives_the_figures_with_units(self, wave: Result) -> None:
        told, got = rows(wave), wave.metrics
        assert told["tracking error"] == [f"{got['x_err_rms'] * 1e3:.1f} mm rms, {got['x_err_max'] * 1e3:.1f} mm max"]
        assert re.fullmatch(r"[\d.]+ m?N rms, [\d.]+ m?N max", told["force error"][0])
        assert told["delay seen"] == ["50.0 ms fwd, 50.0 ms bwd"]
        assert told["packets"][0] == "fwd: 1000 sent, 950 received, 0 lost, 0 late, 50 under way at the end"
        assert told["link energy"][0].startswith("0 J smallest, ")

    def test_leaves_out_what_the_scene_does_not_have(self) -> None:
        told = rows(run(load_scene("canonical", duration=0.1, link=None, energy=False)))
        assert set(told) == {"run", "status", "tracking error", "force error"}

    def test_tells_the_time_per_tick_if_it_was_taken(self, wave: Result) -> None:
        assert "time per tick" not in rows(wave)
        told = rows(replace(wave, run_time=0.004))
        assert told["time per tick"] == ["4.00 us, 250 times real time"]

    def test_tells_of_loss_each_way_and_of_what_was_rejected(self, wave: Result) -> None:
        counts = {
            "fwd": Packets(sent=9, received=7, lost=2, late=1, overtaken=3, duplicates=4),
            "bwd": Packets(sent=9, received=9, rejected={"checksum": 2, "version": 0}),
        }
        told = rows(replace(wave, packets=counts))["packets"]
        assert told == [
            "fwd: 9 sent, 7 received, 2 lost, 1 late, 3 overtaken, 4 doubled",
            "bwd: 9 sent, 9 received, 0 lost, 0 late, 2 rejected (checksum)",
        ]

    def test_says_if_a_delay_varied_and_if_nothing_came(self, wave: Result) -> None:
        metrics = {**wave.metrics, "T_fwd_mean": 0.02, "T_fwd_max": 0.03}
        del metrics["T_bwd_mean"], metrics["T_bwd_max"]
        told = rows(replace(wave, metrics=metrics))
        assert told["delay seen"] == ["20.0 ms (up to 30.0 ms) fwd, nothing came bwd"]

    def test_says_if_a_watchdog_let_go(self, wave: Result) -> None:
        assert "watchdog" not in rows(replace(wave, metrics={**wave.metrics, "g_m_min": 1.0, "g_s_min": 1.0}))
        told = rows(replace(wave, metrics={**wave.metrics, "g_m_min": 0.0, "g_s_min": 1.0}))
        assert told["watchdog"] == ["let go: smallest gain 0% at the master, 100% at the slave"]

    def test_tells_of_late_ticks_if_it_was_live(self, wave: Result) -> None:
        own: dict[str, Any] = {"skipped": 2, "late_us": {"p50": 61.0, "p99": 172.0, "p100": 2300.0}, "cpu": 0.05}
        extra = {"master": own, "slave": {**own, "late_us": {}, "cpu": None}}
        told = rows(replace(wave, mode="live", extra=extra, run_time=1.0))
        assert told["late ticks"] == [
            "master: 2 skipped, half under 61.0 us late, 99 % under 172 us late, at most 2.30 ms late",
            "slave: 2 skipped",
        ]
        assert told["time per tick"] == ["50.0 us master of processor time"]
        assert "late ticks" not in rows(replace(wave, mode="lockstep", extra=extra))

    def test_calls_the_error_of_an_integration_estimated(self, wave: Result) -> None:
        own = {"error_estimate_max": 4.94e-10, "error_estimate_sum": 1.2e-8, "substeps_max": 3,
               "ticks_over_tolerance": 0, "tolerance": 1e-9}
        over = {**own, "ticks_over_tolerance": 2}
        assert rows(replace(wave, extra={"integration": {"master": own, "slave": over}}))["integration"] == [
            "master: error estimated at 4.94e-10 m a tick (12.0 nm in all), up to 3 sub-steps",
            "slave: error estimated at 4.94e-10 m a tick (12.0 nm in all), up to 3 sub-steps; 2 ticks above 1.00 nm",
        ]

    def test_passes_on_the_notes(self, wave: Result) -> None:
        assert rows(replace(wave, notes=("mind this", "and that")))["note"] == ["mind this", "and that"]

    def test_of_a_run_that_was_stopped_before_its_first_tick_is_short(self, wave: Result) -> None:
        told = rows(replace(wave, status="stopped", sentence="the peer left", ticks=0, metrics={}, run_time=0.1))
        assert told == {"run": told["run"], "status": ["stopped: the peer left"]}

    def test_is_plain_ascii(self, wave: Result) -> None:
        assert table(replace(wave, run_time=0.004)).isascii()


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
        assert stream.lines() == ["[#####...............]   25%  6.0 s left  x 2.0 mm"]
        progress.show(200, 18.0, "x")
        assert stream.lines() == ["[####################]  100%  0.0 s left  x       "]
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
        assert stream.lines()[0].rstrip() == "[##########..........]   50%  15.0 s left"

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
        assert stream.lines() == [" 50%  1.0 s left  critical k_e, 3 of 7"]


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


@given(st.floats(min_value=0.0, max_value=1e9))
def test_a_duration_reads_back_in_a_unit_that_suits_it(seconds: float) -> None:
    text, unit = duration(seconds).split(" ")
    read = float(text) * {"s": 1.0, "min": 60.0, "h": 3600.0}[unit]
    assert read == pytest.approx(seconds, rel=0.0502, abs=1.0 if unit == "s" else 0.0)
    assert "e" not in text
    assert text != "0"
    assert (unit == "s") == (seconds < 99.5)


@given(st.integers(0, 10**20))
def test_a_count_reads_back_from_groups_of_three(count: int) -> None:
    assert int(whole(count).replace(" ", "")) == count
    assert all(len(group) == 3 for group in whole(count).split(" ")[1:])


class TestProgressElsewhere:
    def test_writes_plain_lines_seconds_apart(self) -> None:
        stream = io.StringIO()
        progress = Progress(stream, 12_000)
        for k in range(12_001):
            progress.show(k, 100.0 + k * 1e-3, "x 1.0 mm")
        progress.end()
        assert stream.getvalue().splitlines() == [
            "42%  7.0 s left  x 1.0 mm", "83%  2.0 s left  x 1.0 mm",
        ]
        assert not {"\r", "\x1b"} & set(stream.getvalue())

    def test_writes_nothing_for_what_is_short(self) -> None:
        stream = io.StringIO()
        progress = Progress(stream, 100)
        for k in range(101):
            progress.show(k, k * 0.01)
        progress.end()
        assert stream.getvalue() == ""


NASTY = "\x1b]0;owned\x07\x1b[2J\r\nstatus   ok\x9b31m\u202egnp.exe\ud800\x00"


class TestText:
    def test_that_a_file_holds_gives_the_terminal_no_orders(self) -> None:
        result = run(load_scene("canonical", duration=0.01))
        shown = table(replace(result, scene=NASTY, sentence=NASTY, notes=(NASTY, "a\nnote   forged")))
        assert all(line.isprintable() for line in shown.split("\n"))
        assert not any(line.startswith(("status   ok", "note   forged")) for line in shown.split("\n"))
        assert r"\x1b[2J" in shown

    def test_of_a_refusal_gives_the_terminal_no_orders_either(self, capsys: pytest.CaptureFixture[str]) -> None:
        def refuse() -> int:
            raise Refused(NASTY + "x" * 10_000)

        assert guarded(refuse) == 2
        said = capsys.readouterr().err
        assert said.removesuffix("\n").isprintable()
        assert len(said) < 5000

    def test_that_is_told_at_length_is_cut_and_lines_stay_where_they_are_wanted(self) -> None:
        assert printable("x" * 10, most=5) == "xx..."
        assert printable("a\nb\x1b", lines=True, most=2) == "a\nb\\x1b"

    def test_of_a_summary_that_lacks_half_of_a_pair_of_metrics_leaves_the_pair_out(self) -> None:
        result = run(load_scene("canonical", duration=0.2))
        for name in ("x_err_max", "f_err_max", "T_fwd_max"):
            assert name in result.metrics
            less = {key: value for key, value in result.metrics.items() if key != name}
            assert table(replace(result, metrics=less)).startswith("run")
