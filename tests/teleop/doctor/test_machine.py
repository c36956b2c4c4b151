"""How what was measured is judged, and what is said to type."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from teleop.doctor import command
from teleop.doctor.command import Finding

CURE = "type this for real-time scheduling"


def ticks(p99: float = 120.0, left_out: int = 0, precise: bool = True) -> dict[str, Any]:
    return {"ticks": 900, "left_out": left_out, "precise": precise,
            "late_us": {"p50": 50.0, "p99": p99, "p100": max(900.0, p99)}}


def over(**also: Any) -> dict[str, Any]:
    return {"sent": 3000, "lost": 0, "round_trip_us": {"p50": 13.0, "p99": 20.0, "p100": 80.0}, "stamps": True,
            "buffer": {"asked": 1 << 20, "given": 2 << 20, "holds": 2520, "of": 4000}, **also}


class TestTheTimer:
    def test_is_judged_by_what_a_live_end_gets(self) -> None:
        found = command.timer({"ordinary": ticks(9000.0), "realtime": ticks()}, None)
        assert found.good
        assert found.cure is None
        assert found.says == (
            "with real-time scheduling half under 50.0 us late, 99 % under 120 us, at most 900 us, none of 900 left "
            "out; without it half under 50.0 us late, 99 % under 9.00 ms, at most 9.00 ms, none of 900 left out")

    @pytest.mark.parametrize(("told", "good"), [
        (ticks(499.0), True), (ticks(501.0), False), (ticks(left_out=9), True), (ticks(left_out=10), False)])
    def test_is_good_up_to_half_a_tick_late_and_one_in_a_hundred_left_out(
        self, told: dict[str, Any], good: bool
    ) -> None:
        found = command.timer({"ordinary": told, "realtime": None}, CURE)
        assert found.good == good
        assert ("good are 99 % under 500 us and 1% left out at most" in found.says) == (not good)

    def test_that_is_late_without_real_time_scheduling_is_cured_by_that(self) -> None:
        assert command.timer({"ordinary": ticks(2000.0), "realtime": None}, CURE).cure == CURE

    def test_that_is_late_with_it_says_what_else_to_type(self) -> None:
        cure = command.timer({"ordinary": ticks(), "realtime": ticks(2000.0)}, None).cure
        assert cure is not None
        assert "--spin" in cure

    def test_that_is_not_precise_is_poor_whatever_it_measured(self) -> None:
        found = command.timer({"ordinary": ticks(precise=False), "realtime": None}, None)
        assert not found.good
        assert "no timerfd" in found.says

    def test_that_hardly_ever_ran_says_so(self) -> None:
        found = command.timer({"ordinary": {**ticks(left_out=899), "late_us": {}}, "realtime": None}, CURE)
        assert not found.good
        assert "nearly all of 900 left out" in found.says


class TestLoopbackAndBuffer:
    def test_that_are_good_say_so_in_numbers(self) -> None:
        loopback, buffer = command.link(over())
        assert loopback == Finding("loopback", True, "none of 3000 round trips lost, half of the round trips under "
                                   "13.0 us, 99 % under 20.0 us; the kernel says when each came")
        assert buffer == Finding("buffer", True, "holds 2520 datagrams, 2.52 s of messages at 1 kHz")

    @pytest.mark.parametrize("also", [
        {"lost": 1}, {"lost": 3000, "round_trip_us": {}}, {"round_trip_us": {"p50": 9.0, "p99": 1001.0, "p100": 2e3}}])
    def test_that_loses_or_is_slow_is_poor(self, also: Mapping[str, Any]) -> None:
        found = command.link(over(**also))[0]
        assert not found.good
        assert found.cure is not None
        assert "good are none lost, and 99 % under 1.00 ms" in found.says

    def test_without_stamps_of_the_kernel_says_what_that_costs(self) -> None:
        assert "what is read late counts as late" in command.link(over(stamps=False))[0].says

    @pytest.mark.parametrize(("holds", "good"), [(800, True), (799, False), (278, False)])
    def test_a_buffer_holds_as_long_as_an_end_is_silent_before_it_is_safe(self, holds: int, good: bool) -> None:
        found = command.link(over(buffer={"asked": 1 << 20, "given": 212992, "holds": holds, "of": 4000}))[1]
        assert found.good == good
        if not good:
            assert "net.core.rmem_max=1048576" in str(found.cure)

    def test_without_a_loopback_there_is_one_sentence(self) -> None:
        found, = command.link({"error": "Network is unreachable"})
        assert not found.good
        assert "Network is unreachable" in found.says


class TestFrequency:
    def test_is_not_judged_where_it_cannot_be_read(self) -> None:
        assert command.governor({}, in_time=False) == Finding(
            "frequency", None, "this system does not say how its processors choose their frequency")

    def test_is_poor_only_where_ticks_are_late(self) -> None:
        assert command.governor({"powersave": 8}, in_time=True).good
        assert command.governor({"performance": 8}, in_time=False).good
        found = command.governor({"performance": 2, "powersave": 6}, in_time=False)
        assert not found.good
        assert found.says == "processors choose it 2 by performance and 6 by powersave, and ticks are late"

    def test_is_read_of_each_processor(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        for cpu, name in (("cpu0", "powersave"), ("cpu1", "powersave"), ("cpu2", "performance"), ("cpufreq", "no")):
            folder = tmp_path / cpu / "cpufreq"
            folder.mkdir(parents=True)
            (folder / "scaling_governor").write_text(f"{name}\n")
        monkeypatch.setattr(command, "GOVERNORS", tmp_path)
        assert command.governors() == {"powersave": 2, "performance": 1}


class TestTheProbe:
    @pytest.mark.parametrize(("code", "why"), [
        ("raise SystemExit(3)", "did not come up"), ("print(7)", "did not come up"), ("print('{')", "did not come up"),
        ("import time; time.sleep(60)", "took longer than 0.5 s"),
    ])
    def test_that_fails_is_told_as_such(self, code: str, why: str, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(command, "PROBE", ("-c", code))
        monkeypatch.setattr(command, "PATIENCE", 0.5 if "sleep" in code else 30.0)
        told = command.measure()
        assert why in told["error"]
        rights = command.realtime(told)
        assert str(rights["scheduler"]).startswith("no (")
        assert [one.good for one in command.judge(told, rights)] == [False]

    @pytest.mark.live
    def test_measures_what_is_judged(self) -> None:
        told = command.measure()
        assert told["ordinary"]["ticks"] >= 900
        assert 0 <= told["ordinary"]["left_out"] < told["ordinary"]["ticks"]
        assert (told["realtime"] is None) == told["scheduler"].startswith("no ")
        loopback = told["loopback"]
        assert loopback["sent"] == 3000
        assert 0.0 < loopback["round_trip_us"]["p50"] <= loopback["round_trip_us"]["p99"]
        assert 0 < loopback["buffer"]["holds"] <= loopback["buffer"]["of"]
        assert loopback["stamps"] == (sys.platform == "linux")
        names = [one.name for one in command.judge(told, command.realtime(told))]
        assert names == ["timer", "real time", "loopback", "buffer"]
