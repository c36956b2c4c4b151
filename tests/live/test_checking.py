"""`check_device`: what is a device passes with its figures, and each mistake is refused by its sentence."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from itertools import pairwise
from math import nan
from pathlib import Path
from random import Random
from typing import Any

import pytest

from master.device import SimulatedMaster
from slave.robot import SimulatedSlave
from teleop import DeviceError, Reading, Refused, check_device, load_scene
from teleop.__main__ import main
from teleop.live.devices.call_watch import BLOCKED_S
from teleop.live.devices.judging import DeviceFault, Mistake, PushedMotion, check_velocity
from teleop.scene.library import ROOT
from tests.live.test_own_device import Standing

ONE = load_scene("hard_wall", duration=0.1)


class Mass:
    """A mass of 1 kg that no hand holds. `turned`: its force acts the other way."""

    deadline = 0.1
    simulated = True
    way = 1.0
    jumps = 0.0

    def __init__(self, scene: Any) -> None:
        self.x = self.v = self.f = 0.0
        self.k = 0
        self.closed = 0

    def read(self, k: int) -> Reading:
        while self.k < k:
            self.v += 1e-3 * self.way * self.f
            self.x += 1e-3 * self.v
            self.k += 1
        return Reading((self.x,), (self.v,))

    def hold(self, force: tuple[float, ...]) -> None:
        self.f = force[0]
        self.x += self.jumps * self.f

    def close(self) -> None:
        self.closed += 1


@pytest.mark.parametrize(("e", "make"), [("m", SimulatedMaster), ("s", SimulatedSlave), ("s", Mass)])
def test_a_device_passes_and_moves_the_way_that_its_end_asks_for(e: str, make: Any) -> None:
    found = check_device(make, ONE, e=e, ticks=100)
    assert (found.axes, found.senses, found.simulated) == (1, False, True)
    assert found.moved[0] < 0.0 if e == "m" else found.moved[0] > 0.0
    assert found.rate == pytest.approx(1.0 / (found.read_median + found.hold_median))
    assert found.notes == ()


class Turned(Mass):
    way = -1.0


class MovesInHold(Mass):
    jumps = 1e-3


class Raises(Mass):
    def read(self, k: int) -> Reading:
        if k > 20:
            raise ValueError("frame of 3 bytes")
        return super().read(k)


class Forgets(Mass):
    def close(self) -> None:
        raise KeyError("port")


class OpensOnce(Mass):
    opened = 0

    def __init__(self, scene: Any) -> None:
        super().__init__(scene)
        OpensOnce.opened += 1
        self.gone = OpensOnce.opened > 2  # the first, and its twin beside it

    def read(self, k: int) -> Reading:
        if self.gone:
            raise DeviceError("the port is taken")
        return super().read(k)


class TwoAxes(Mass):
    def read(self, k: int) -> Reading:
        return Reading((0.0, 0.0), (0.0, 0.0))


class SaysThatItSenses(Mass):
    senses = True


@pytest.mark.parametrize(("make", "words"), [
    (Turned, "moved it by -0.0"), (Turned, "m, the wrong way: a force acts along +x at the slave"),
    (MovesInHold, "a reading is the left limit"),
    (Raises, "its read raised ValueError: frame of 3 bytes; what may come right again raises DeviceError"),
    (Forgets, "did not close: KeyError: 'port'"), (OpensOnce, "was closed, opened again, and cannot be read"),
    (TwoAxes, "the device has 2 axes, for so many numbers has the x that it read, and the scene has 1; take a"),
    (SaysThatItSenses, "the device says senses = True and reads f=None"),
])
def test_a_mistake_is_refused_by_its_sentence(make: Any, words: str) -> None:
    with pytest.raises(Refused) as refused:
        check_device(make, ONE, ticks=100)
    assert words in str(refused.value)


class Machine(Mass):
    """What does not say that it is simulated is taken for a machine, which nobody pushes unasked."""

    simulated = False
    made: Machine

    def __init__(self, scene: Any) -> None:
        super().__init__(scene)
        self.held: list[float] = []
        type(self).made = self

    def hold(self, force: tuple[float, ...]) -> None:
        super().hold(force)
        self.held.append(force[0])


def test_a_machine_is_pushed_only_when_it_is_asked_for_gently_and_ends_at_zero() -> None:
    found = check_device(Machine, ONE, ticks=10)
    assert set(Machine.made.held) == {0.0}
    assert "the sign of its force was not tried" in found.notes[0]
    found = check_device(Machine, ONE, ticks=10, push=True)
    held = Machine.made.held
    assert found.pushed == (max(held),) == (0.1,)
    assert max(abs(b - a) for a, b in pairwise(held)) < 0.0011, "a ramp of 0.1 s"
    assert held[-1] == 0.0
    assert Machine.made.closed == 1
    assert 0.0 < found.moved[0] < 0.006


def test_a_machine_that_fails_while_it_is_pushed_is_given_zero_and_closed() -> None:
    class Fails(Machine):
        def read(self, k: int) -> Reading:
            if self.f > 0.05:
                raise ZeroDivisionError
            return super().read(k)

    with pytest.raises(Refused, match="raised ZeroDivisionError"):
        check_device(Fails, ONE, ticks=10, push=True)
    assert max(Fails.made.held) > 0.05
    assert (Fails.made.held[-1], Fails.made.closed) == (0.0, 1)


def test_a_machine_whose_force_outlives_this_process_is_not_pushed() -> None:
    class Bare(Machine):
        deadline = None  # type: ignore[assignment]

    with pytest.raises(Refused, match="neither a deadline nor a watchdog"):
        check_device(Bare, ONE, ticks=10, push=True)


# Mistakes that passed


class Moving(Machine):
    """The mass as a machine or simulated, its `net` force what it really is; each class below makes one mistake."""

    simulated = True
    every: list[Moving]
    way_of_v = 1.0
    length = 1.0

    def __init__(self, scene: Any) -> None:
        super().__init__(scene)
        type(self).every = [*getattr(type(self), "every", []), self]

    def read(self, k: int) -> Reading:
        (x,), (v,), *_ = super().read(k)
        return Reading((self.length * x,), (self.length * self.way_of_v * v,))


class BackwardsV(Moving):
    way_of_v = -1.0


class NoV(Moving):
    way_of_v = 0.0


class Millimetres(Moving):
    length = 1e3


class MillimetresOfPlaceAlone(Moving):
    length, way_of_v = 1e3, 1e-3


class NaNFromReading50On(Moving):
    def read(self, k: int) -> Reading:
        return super().read(k) if k < 50 else Reading((nan,), (0.0,))


class DeadlineOf150(Moving):
    deadline = 150


class AddsUp(Moving):
    def hold(self, force: tuple[float, ...]) -> None:
        super().hold((self.f + force[0],))


class AddsUpOnASpring(AddsUp):
    """Stands still with what was added up, so nothing accelerates: 0.1 N at each tick came to 20 N, unnamed."""

    def read(self, k: int) -> Reading:
        while self.k < k:
            self.v += 1e-3 * (self.f - 500.0 * self.x - 40.0 * self.v)
            self.x += 1e-3 * self.v
            self.k += 1
        return Reading((self.x,), (self.v,))


class ATickOld(Moving):
    newest = Reading((0.0,), (0.0,))

    def read(self, k: int) -> Reading:
        if k > self.k:
            before, self.newest = self.newest, super().read(k)
            self.shown = before
        return getattr(self, "shown", self.newest)


class SensesItsMotor(Moving):
    def read(self, k: int) -> Reading:
        x, v, *_ = super().read(k)
        return Reading(x, v, (self.f,))


class SensesItsMotorLate(Moving):
    """Tells the motor's force a tick after it was held, with the noise of a measured current."""

    before = 0.0

    def __init__(self, scene: Any) -> None:
        super().__init__(scene)
        self.dice = Random(4)

    def read(self, k: int) -> Reading:
        x, v, *_ = super().read(k)
        f, self.before = self.before + self.dice.gauss(0.0, 1e-3), self.f
        return Reading(x, v, (f,))


MISTAKES = [
    (BackwardsV, Mistake.VELOCITY_SIGN, "turn the sign of v in read"),
    (NoV, Mistake.NO_VELOCITY, "hand over the velocity in read"),
    (Millimetres, Mistake.FAR, "if x is in mm, hand it over in m"),
    (MillimetresOfPlaceAlone, Mistake.VELOCITY_SIZE, "hand over x in m and v in m/s"),
    (NaNFromReading50On, Mistake.UNREAD, "the first at tick 50"),
    (DeadlineOf150, Mistake.LONG_DEADLINE, "write deadline = 0.15"),
    (AddsUp, Mistake.ADDS_UP, "do not add to it"),
    (ATickOld, Mistake.LATE, "hand over in read(k) the state at tick k"),
    (SensesItsMotor, Mistake.SENSES_ITSELF, "or f=None without one"),
    (AddsUpOnASpring, Mistake.ADDS_UP, "with hold called twice at each tick"),
    (SensesItsMotorLate, Mistake.SENSES_ITSELF, "or f=None without one"),
]


@pytest.mark.parametrize("is_machine", [False, True], ids=["simulated", "machine"])
@pytest.mark.parametrize(("make", "mistake", "cure"), MISTAKES, ids=[each[0].__name__ for each in MISTAKES])
def test_a_device_that_would_hit_its_user_passed(
    make: Any, mistake: Mistake, cure: str, is_machine: bool,
) -> None:
    """And whatever is found, at the end no force is on: not what was held last, nor what a hold has added up."""
    if is_machine and mistake is Mistake.LATE:
        pytest.skip("a machine is late by what its link takes, and that is no mistake")

    class Device(make):  # type: ignore[misc]
        simulated = not is_machine

    with pytest.raises(DeviceFault, match=re.escape(cure)) as fault:
        check_device(Device, ONE, ticks=100, push=True)
    assert fault.value.mistake is mistake
    for device in Device.every:
        assert device.f == pytest.approx(0.0, abs=1e-9)
        assert device.closed == 1
        assert not is_machine or max(map(abs, device.held), default=0.0) < 1.5, "it went on for long"


def test_a_device_without_a_deadline_passes_with_a_note_that_its_force_stays_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """`teleop check` ended in a TypeError for the device that it most needs to warn of."""
    (tmp_path / "bare.py").write_text(
        "from teleop import Reading\nclass Bare:\n    def __init__(self, scene): pass\n"
        "    def read(self, k): return Reading((0.0,), (0.0,))\n    def hold(self, force): pass\n")
    assert main(["check", "robot", f"{tmp_path}/bare.py", "--ticks", "20"]) == 0
    answer = capsys.readouterr().out
    assert "lets go not at all if this process dies" in answer
    assert "it has neither a deadline nor a watchdog: the force of an end that dies stays on" in answer


def test_the_command_names_a_mistake_and_ends_with_exit_code_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "late.py").write_text(
        "from teleop import Reading\nclass Long:\n    deadline = 150\n    def __init__(self, scene): pass\n"
        "    def read(self, k): return Reading((0.0,), (0.0,))\n    def hold(self, force): pass\n")
    assert main(["check", "robot", f"{tmp_path}/late.py"]) == 1
    assert "its deadline is long\n  its deadline is 150 s" in capsys.readouterr().out
    assert main(["check", "robot", f"{tmp_path}/late.py", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["mistake"] == "long_deadline"


HANGS = """
import ctypes, time
from pathlib import Path
from teleop import Reading
class Hangs:
    deadline = 0.1
    simulated = True
    def __init__(self, scene): self.f = 0.0
    def read(self, k):
        if self.f:
            Path("began").write_text(str(time.monotonic()))
            {hang}
        return Reading((0.0,), (0.0,))
    def hold(self, force):
        self.f = force[0]
        with open("held", "a") as file:
            file.write(f"{{self.f}}\\n")
"""


@pytest.mark.parametrize(("hang", "words"), [
    ("time.sleep(99)", f"its read did not return for {BLOCKED_S:g} s"),
    ("ctypes.PyDLL(None).sleep(99)", "in read"),  # with Python's lock kept: no line of Python can run, and a traceback
], ids=["a driver that waits", "compiled code that keeps the lock"])
def test_a_read_that_blocks_hung_the_check_without_a_word(hang: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "hangs.py").write_text(HANGS.format(hang=hang))
    done = subprocess.run([sys.executable, "-m", "teleop", "check", "robot", "hangs.py", "--ticks", "10"], cwd=tmp_path,
                          env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False, timeout=60)
    took = time.monotonic() - float((tmp_path / "began").read_text())
    assert words in done.stderr
    assert done.returncode == 1
    assert took < 10.0, "within 2 s where the machine has nothing else to do"
    if "PyDLL" not in hang:
        assert (tmp_path / "held").read_text().splitlines()[-1] == "0.0"
        assert "its force was set to zero" in done.stderr


def test_what_moves_by_itself_or_touches_something_is_no_mistake() -> None:
    """A hand that moves a machine nobody pushes, a spring, damping, noise, an encoder's steps; a sensor at a wall."""
    class Spring(Mass):
        deadline = 0.1

        def read(self, k: int) -> Reading:
            while self.k < k:
                self.v += 1e-3 * (self.f - 4000.0 * self.x - 5.0 * self.v)
                self.x += 1e-3 * self.v
                self.k += 1
            return Reading((self.x,), (self.v,), (4000.0 * self.x + 5.0 * self.v,))

    class Steps(Mass):
        def read(self, k: int) -> Reading:
            (x,), (v,), *_ = super().read(k)
            return Reading((round(x / 1e-5) * 1e-5,), (v,))

    assert check_device(Spring, ONE, ticks=50).moved[0] > 0.0
    assert check_device(Steps, ONE, ticks=50).moved[0] > 0.0


class Noisy(Mass):
    """Throws dice at each reading, also at the same tick; the noise of its sensor is as large as the push."""

    noise, sensor = 2e-5, 0.05

    def __init__(self, scene: Any) -> None:
        super().__init__(scene)
        self.dice = Random(5)

    def read(self, k: int) -> Reading:
        (x,), (v,), *_ = super().read(k)
        gauss = self.dice.gauss
        return Reading((x + gauss(0.0, self.noise),), (v + gauss(0.0, 100.0 * self.noise),),
                       (gauss(0.0, self.sensor),))


class Encoder(Mass):
    """Reads in steps of 10 um, and v by a filtered difference of them."""

    step, slope = 1e-5, 0.0

    def read(self, k: int) -> Reading:
        while self.k < k:
            before = round(self.x / self.step)
            super().read(self.k + 1)
            self.slope += 0.1 * (1e3 * self.step * (round(self.x / self.step) - before) - self.slope)
        return Reading((round(self.x / self.step) * self.step,), (self.slope,))


class EveryFourthTick(Mass):
    """Samples at 250 Hz under a tick of 1 ms."""

    newest = Reading((0.0,), (0.0,))

    def read(self, k: int) -> Reading:
        now = super().read(k)
        if k % 4 == 0:
            self.newest = now
        return self.newest


class LostMotion(Mass):
    """Has a gear with 0.2 mm of backlash between motor and encoder."""

    shown = 0.0

    def read(self, k: int) -> Reading:
        (x,), (v,), *_ = super().read(k)
        before, self.shown = self.shown, min(max(self.shown, x - 1e-4), x + 1e-4)
        return Reading((self.shown,), (v if self.shown != before else 0.0,))


@pytest.mark.parametrize("is_machine", [False, True], ids=["simulated", "machine"])
@pytest.mark.parametrize("make", [Noisy, Encoder, EveryFourthTick, LostMotion])
def test_a_right_device_was_accused_of_its_noise_its_steps_or_its_rate(make: Any, is_machine: bool) -> None:
    """Noise was a force in hold, steps and 250 Hz were late readings, and noise of a sensor was the motor's force."""
    class Device(make):  # type: ignore[misc]
        simulated = not is_machine

    assert check_device(Device, ONE, ticks=100, push=True).moved[0] > 0.0


def test_a_right_device_was_accused_where_the_machine_was_busy_for_20_ticks() -> None:
    """Its velocity before and behind them was none of those with which it had moved meanwhile."""
    def motion(v: float, jump: float = 0.0) -> PushedMotion:
        pushed = PushedMotion("x", "m")
        for k in (*range(20), *range(40, 60)):
            pushed.add(1e-3 * k, 1e-3 * k + jump * (k >= 40), v, None, 0.0, None)
        return pushed

    check_velocity(motion(1.0), 0.0)
    check_velocity(motion(1.0, jump=0.2), 0.0)
    with pytest.raises(DeviceFault, match="v and x differ in size"):
        check_velocity(motion(0.3, jump=0.2), 0.0)


def test_readings_that_fail_while_it_is_unplugged_are_counted() -> None:
    class Loose(Mass):
        def read(self, k: int) -> Reading:
            if 20 <= k < 30:
                raise DeviceError("the cable is out")
            return super().read(k)

    with pytest.raises(DeviceFault, match="10 of 100 readings could not be had, the first at tick 20, the last 121 tick"
                       "s before the end: the cable is out"):
        check_device(Loose, ONE, ticks=100)


def test_the_command_tells_it_and_has_it_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "robot", "simulated", "--ticks", "50"]) == 0
    told = capsys.readouterr().out
    assert "robot simulated: 1 axis, without a force sensor, simulated" in told
    assert "lets go by itself after 0.15 s" in told
    assert main(["check", "device", "simulated", "--ticks", "50", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["moved"][0] < 0.0
    assert main(["check", "robot", "simulatedd"]) == 2


def test_of_a_push_along_unlike_axes_each_is_told_by_its_name_in_its_unit(capsys: pytest.CaptureFixture[str]) -> None:
    """It moved "by 0.01, 0.02 m or rad" under "1 N or N m"."""
    assert main(["check", "robot", "simulated", "bench_top", "--ticks", "50", "--set", "axes=2",
                 "--set", "units=m,rad", "--set", "names=rail,turn"]) == 0
    told = capsys.readouterr().out
    assert re.search(r"push    moved it by [\d.]+ m along rail \(0.1 N\), [\d.]+ rad along turn \(0.1 N m\): the right",
                     told)


def test_a_device_that_does_not_move_says_that_its_sign_is_not_known() -> None:
    class Still(Standing):
        simulated = True

        def __init__(self, _scene: Any) -> None:
            super().__init__(None)
            self.reading = Reading((0.5,), (0.0,))

    assert "no force moved it along x" in check_device(Still, ONE, ticks=10).notes[-1]
