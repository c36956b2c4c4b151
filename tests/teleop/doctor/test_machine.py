"""`teleop doctor`: how what was measured is judged, what is said to type, and what is kept and cleared."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from teleop.doctor import command
from teleop.doctor.command import Finding
from teleop.scene.library import ROOT

CURE = "type this for real-time scheduling"


def ticks(p99: float = 120.0, left_out: int = 0) -> dict[str, Any]:
    return {"ticks": 900, "left_out": left_out,
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

    def test_is_good_up_to_half_a_tick_late_and_one_in_a_hundred_left_out(self) -> None:
        for measured, good in ((ticks(499.0), True), (ticks(501.0), False), (ticks(left_out=9), True),
                               (ticks(left_out=10), False)):
            found = command.timer({"ordinary": measured, "realtime": None}, CURE)
            assert found.good == good, measured
            assert ("good are 99 % under 500 us and 1% left out at most" in found.says) == (not good)

    def test_that_is_late_is_cured_by_real_time_scheduling_or_says_what_else_to_type(self) -> None:
        assert command.timer({"ordinary": ticks(2000.0), "realtime": None}, CURE).cure == CURE
        assert "--spin" in str(command.timer({"ordinary": ticks(), "realtime": ticks(2000.0)}, None).cure)

    def test_that_hardly_ever_ran_is_poor_whatever_it_measured(self) -> None:
        found = command.timer({"ordinary": {**ticks(left_out=899), "late_us": {}}, "realtime": None}, CURE)
        assert not found.good
        assert "nearly all of 900 left out" in found.says


class TestLoopbackAndBuffer:
    def test_that_are_good_say_so_in_numbers(self) -> None:
        loopback, buffer = command.link(over())
        assert loopback == Finding("loopback", True, "none of 3000 round trips lost, half of the round trips under "
                                   "13.0 us, 99 % under 20.0 us; the kernel says when each came")
        assert buffer == Finding("buffer", True, "holds 2520 datagrams, 2.52 s of messages at 1 kHz")

    def test_that_loses_or_is_slow_is_poor(self) -> None:
        for also in ({"lost": 1}, {"lost": 3000, "round_trip_us": {}},
                     {"round_trip_us": {"p50": 9.0, "p99": 1001.0, "p100": 2e3}}):
            found = command.link(over(**also))[0]
            assert not found.good, also
            assert found.cure is not None
            assert "good are none lost, and 99 % under 1.00 ms" in found.says

    def test_without_stamps_of_the_kernel_or_a_loopback_says_what_that_costs(self) -> None:
        assert "what is read late counts as late" in command.link(over(stamps=False))[0].says
        found, = command.link({"error": "Network is unreachable"})
        assert not found.good
        assert "Network is unreachable" in found.says

    def test_a_buffer_holds_as_long_as_an_end_is_silent_before_it_is_safe(self) -> None:
        for holds, good in ((800, True), (799, False), (278, False)):
            found = command.link(over(buffer={"asked": 1 << 20, "given": 212992, "holds": holds, "of": 4000}))[1]
            assert found.good == good, holds
            assert ("net.core.rmem_max=1048576" in str(found.cure)) == (not good)


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


class TestAnotherPackageOfTheName:
    @pytest.fixture(autouse=True)
    def alone(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """No distribution but ours has the name."""
        monkeypatch.setattr(command, "packages_distributions", lambda: {"teleop": ["bilateral-teleop"]})

    def test_is_a_package_or_a_file_on_the_path_but_no_command_and_no_folder(self, tmp_path: Path) -> None:
        assert command.other_packages([str(ROOT), str(tmp_path), "no such folder"]) == []  # ours is no other
        assert command.judge_name([]).good
        for folder in ("one/teleop", "two", "bin", "notes/teleop"):
            (tmp_path / folder).mkdir(parents=True)
        for file in ("one/teleop/__init__.py", "two/teleop.py", "bin/teleop"):
            (tmp_path / file).touch()
        folders = [str(ROOT), *(str(tmp_path / name) for name in ("one", "two", "one", "bin", "notes"))]
        found = command.other_packages(folders)
        assert found == [str(tmp_path / "one" / "teleop"), str(tmp_path / "two" / "teleop.py")]
        assert not command.judge_name(found).good

    def test_is_a_distribution_that_has_written_over_ours(self, monkeypatch: pytest.MonkeyPatch) -> None:
        both = {"teleop": ["bilateral-teleop", "teleop", "teleop"]}
        monkeypatch.setattr(command, "packages_distributions", lambda: both)
        assert command.other_packages([]) == ["teleop"]
        found = command.judge_name(["teleop"])
        assert "another package called teleop is here too, teleop" in found.says
        assert "pip install bilateral-teleop" in str(found.cure)


class TestTheProbe:
    def test_that_fails_is_told_as_such(self, monkeypatch: pytest.MonkeyPatch) -> None:
        for code, patience, why in (("raise SystemExit(3)", 60.0, "did not come up"),
                                    ("print('{')", 60.0, "did not come up"), ("print(7)", 60.0, "did not come up"),
                                    ("import time; time.sleep(60)", 0.2, "took longer than 0.2 s")):
            monkeypatch.setattr(command, "PROBE", ("-S", "-c", code))
            monkeypatch.setattr(command, "PATIENCE", patience)
            answer = command.measure()
            assert why in answer["error"], code
            rights = command.realtime(answer)
            assert str(rights["scheduler"]).startswith("no (")
            assert [one.good for one in command.judge(answer, rights)] == [False]

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


MEASURED: dict[str, Any] = {"scheduler": "SCHED_FIFO, priority 40", "memory": "locked", "ordinary": ticks(),
                            "realtime": ticks(), "loopback": over()}


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of kernels; and what is measured is there without waiting for it."""
    monkeypatch.setattr(command, "measure", lambda: MEASURED)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folder = tmp_path / "cache" / "bilateral-teleop" / "kernels"
    (folder / "__pycache__").mkdir(parents=True)
    (folder / "teleop_kernel_1.py").write_text("x")
    (folder / "__pycache__" / "teleop_kernel_1.loop-1.nbi").write_text("yy")
    (folder / "teleop_kernel_c_2.so").write_text("zzz")
    (folder / "notes.txt").write_text("mine")
    return folder


def test_it_says_what_is_installed_and_what_is_not(typed: Callable[..., Any], cache: Path,
        monkeypatch: pytest.MonkeyPatch) -> None:
    document = json.loads(typed("doctor", "--json").out)
    assert document["packages"]["numpy"] == np.__version__
    assert document["kernels"] == {"folder": str(cache), "modules": 2, "bytes": 6, "not_kept": None}
    assert document["measured"] == MEASURED
    assert {"others", "governors", "rmem_max"} <= document.keys()
    assert document["realtime"] == {"scheduler": MEASURED["scheduler"], "memory": MEASURED["memory"], "cure": None}
    assert [one["name"] for one in document["findings"]] == \
        ["name", "timer", "real time", "loopback", "buffer", "frequency"]
    assert all((one["cure"] is None) == (one["good"] is not False) for one in document["findings"])
    monkeypatch.setattr(command, "version_of", lambda name: None if name == "matplotlib" else "1.2.3")
    monkeypatch.setattr(command, "find_compiler", lambda: None)
    out = typed("doctor").out
    assert "C compiler          none: install gcc or clang, and sweeps run some 100 times faster" in out
    assert "not installed: pip install 'bilateral-teleop[plot]'" in out
    assert str(cache) in out


def test_it_needs_no_numpy_so_it_says_what_is_installed_where_that_cannot_be_loaded() -> None:
    code = ("import sys; sys.modules['numpy'] = None; from teleop.doctor import command; "
            "command.measure = lambda: {'error': 'nothing came up'}; print(command.text(command.findings()))")
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "matplotlib" in done.stdout


def test_it_clears_the_kernels_and_nothing_else(typed: Callable[..., Any], cache: Path) -> None:
    assert typed("doctor", "--clear").out.startswith("2 kernels removed")
    assert [path.name for path in cache.rglob("*") if path.is_file()] == ["notes.txt"]
    assert json.loads(typed("doctor", "--json").out)["kernels"]["modules"] == 0
    assert typed("doctor", "--clear").code == 0  # where there is nothing


@pytest.mark.usefixtures("cache")
def test_it_says_of_each_thing_whether_it_is_good_and_what_to_type_where_it_is_not(typed: Callable[..., Any],
        monkeypatch: pytest.MonkeyPatch) -> None:
    told = {**MEASURED, "scheduler": "no (Operation not permitted)", "realtime": None}
    monkeypatch.setattr(command, "measure", lambda: told)
    monkeypatch.setattr("teleop.live.process.realtime.cure", lambda *, for_good: f"type this, {for_good}")
    lines = [" ".join(line.split()) for line in typed("doctor").out.splitlines()]
    at = lines.index("real time poor: a live end gets scheduler no (Operation not permitted), memory locked")
    assert lines[at + 1] == "type this, True"
    assert any(line.startswith("loopback ok: none of 3000 round trips lost") for line in lines)


@pytest.mark.usefixtures("cache")
def test_where_nothing_could_be_measured_the_rest_is_told(typed: Callable[..., Any],
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "measure", lambda: {"error": "its process did not come up"})
    said = typed("doctor").out
    assert "poor: nothing could be measured, for its process did not come up" in said
    assert "numpy" in said
