"""Live, with a stand-in whose motor holds its last force: a device that hangs, is unplugged, or does not close."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from teleop.bench.watchdog import FORCE, SCENE, Motor
from teleop.live.records.merge import load_result
from teleop.live.records.record import read_events
from tests.live.conftest import Command, summary
from tests.waiting import until

pytestmark = pytest.mark.live

SLOW, OUT, STUCK = 2, 3, 4  # orders to the stand-in: 50 ms in read, unplugged, and in read for ever
STAND_IN = f"""
import time
from pathlib import Path

from teleop import DeviceError, Reading
from teleop.bench.watchdog import Motor


class Arm:
    def __init__(self, scene, path):
        self.motor = Motor(Path(path))

    def read(self, k):
        order = self.motor.order
        if order == {OUT}:
            raise DeviceError("the cable is out")
        time.sleep({{{SLOW}: 0.05, {STUCK}: 1e6}}.get(order, 0.0))
        return Reading((0.0,), (0.0,), (0.0,))

    def hold(self, force):
        self.motor.hold(force[0])

    def close(self):
        raise KeyError("port")
"""


@pytest.fixture
def site(command: Callable[..., Command], tmp_path: Path) -> Callable[..., tuple[Command, Motor]]:
    """A slave with the stand-in for its robot, that pushes."""
    def make(*options: str) -> tuple[Command, Motor]:
        (tmp_path / "arm.py").write_text(STAND_IN)
        motor = Motor(tmp_path / "motor")
        slave = command("slave", *SCENE, "--robot", f"arm.py:Arm:{tmp_path / 'motor'}", "--listen", "127.0.0.1:0",
                        "--json", "--out", str(tmp_path / "s"), *options)
        command("master", *SCENE, "--peer", f"127.0.0.1:{slave.port()}", "--json", "--out", str(tmp_path / "m"))
        until(lambda: abs(motor.force) > FORCE, "no force came about")
        return slave, motor
    return make


def stands_still(motor: Motor) -> bool:
    """True if its end has not held it for a tenth of a second."""
    before = motor.holds
    time.sleep(0.1)
    return motor.holds == before


def test_one_that_is_slow_and_then_unplugged_is_safe_says_so_and_comes_back(
    site: Callable[..., Any], tmp_path: Path
) -> None:
    slave, motor = site()
    motor.order = SLOW
    before = motor.holds
    until(lambda: motor.holds > before + 8, "it does not go on")
    motor.order = 0
    until(lambda: abs(motor.force) > FORCE, "no force any more")
    motor.order = OUT
    until(lambda: motor.force == 0.0, "the force stays on while nothing is read")
    motor.order = 0
    until(lambda: abs(motor.force) > FORCE, "the force did not come back")
    slave.signal(signal.SIGTERM)
    code, _, err = slave.end()
    assert code == 1
    assert "the run is over and its folder is whole, and the device did not close: KeyError: 'port'" in err
    assert motor.force == 0.0
    told = summary(tmp_path / "s")
    assert told["slave"]["skipped"] > 8 * 30, "of 50 ticks that each reading took"
    assert any("went by while the device was read, for up to" in note for note in told["notes"])
    whats = [(event["what"], event["why"]) for event in read_events(tmp_path / "s")]
    out = next(i for i, (what, why) in enumerate(whats) if what == "safe" and "the cable is out" in why)
    assert "released" in [what for what, _ in whats[out:]]


def test_one_that_hangs_for_ever_is_set_to_zero_by_the_watchdog_that_was_asked_for(site: Callable[..., Any]) -> None:
    slave, motor = site("--watchdog")
    motor.order = STUCK
    until(lambda: motor.force == 0.0, "the watchdog does not let go")
    slave.signal(signal.SIGINT)  # of two that are the same the system may hand over one
    slave.signal(signal.SIGTERM)
    code, _, err = slave.end()
    assert code != 0
    assert "no heartbeat of the end that drives the device" in err
    assert "its force was set to zero" in err


def test_without_a_watchdog_the_last_resort_lets_go_of_one_that_hangs_at_the_second_signal(
    site: Callable[..., Any], tmp_path: Path
) -> None:
    slave, motor = site()
    motor.order = STUCK
    until(lambda: stands_still(motor), "it does not hang")
    slave.signal(signal.SIGINT)  # of two that are the same the system may hand over one
    slave.signal(signal.SIGTERM)
    code, _, err = slave.end()
    assert code == 1
    assert "the device has neither a deadline nor a watchdog" in err, "said at its start"
    assert "its device was set to zero force" in err
    assert motor.force == 0.0
    why = load_result(tmp_path / "s").sentence
    assert "asked for a reading, does not return; this is made from its record" in why, "it was \"without a word\""
