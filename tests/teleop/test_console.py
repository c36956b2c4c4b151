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

from teleop import Result, load_scene, run
from teleop.console import PREFIX, Progress, si, table
from teleop.result import Packets


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
        assert told["delay seen"] == ["50.0 ms forth, 50.0 ms back"]
        assert told["packets"][0] == "forth: 1000 sent, 950 received, 0 lost, 0 late, 50 under way at the end"
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
            "forth": Packets(sent=9, received=7, lost=2, late=1, overtaken=3, duplicates=4),
            "back": Packets(sent=9, received=9, rejected={"checksum": 2, "version": 0}),
        }
        told = rows(replace(wave, packets=counts))["packets"]
        assert told == [
            "forth: 9 sent, 7 received, 2 lost, 1 late, 3 overtaken, 4 doubled",
            "back: 9 sent, 9 received, 0 lost, 0 late, 2 rejected (checksum)",
        ]

    def test_says_if_a_delay_varied_and_if_nothing_came(self, wave: Result) -> None:
        metrics = {**wave.metrics, "T_fwd_mean": 0.02, "T_fwd_max": 0.03}
        del metrics["T_bwd_mean"], metrics["T_bwd_max"]
        told = rows(replace(wave, metrics=metrics))
        assert told["delay seen"] == ["20.0 ms (up to 30.0 ms) forth, nothing came back"]

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
