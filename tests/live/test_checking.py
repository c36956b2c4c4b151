"""`check_device`: what is a device passes with its figures, and each mistake is refused by its sentence."""

from __future__ import annotations

import json
import re
from itertools import pairwise
from typing import Any

import pytest

from master.device import SimulatedMaster
from slave.robot import SimulatedSlave
from teleop import DeviceError, Reading, Refused, check_device, load_scene
from teleop.__main__ import main
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
    assert (found.axes, found.senses, found.simulated, found.failed) == (1, False, True, 0)
    assert found.moved[0] < 0.0 if e == "m" else found.moved[0] > 0.0
    assert found.rate == pytest.approx(1.0 / (found.read_median + found.hold_median))
    assert found.notes == ()


class Turned(Mass):
    way = -1.0


class MovesInHold(Mass):
    jumps = 1e-3


class Infinite(Mass):
    def read(self, k: int) -> Reading:
        return Reading((0.0,), (float("inf") if k > 20 else 0.0,))


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
    (MovesInHold, "a reading is the left limit"), (Infinite, "none of 100 readings"),
    (Raises, "its read raised ValueError: frame of 3 bytes; what may come right again raises DeviceError"),
    (Forgets, "did not close: KeyError: 'port'"), (OpensOnce, "was closed, opened again, and cannot be read"),
    (TwoAxes, "the device has 2 axes, for so many numbers has the x that it read, and the scene has 1; take a"),
    (SaysThatItSenses, "the device says senses = True and reads f=None"),
])
def test_a_mistake_is_refused_by_its_sentence(make: Any, words: str) -> None:
    if make is Infinite:
        class Worse(Infinite):
            def read(self, k: int) -> Reading:
                return super().read(k + 21 * (k > 0))
        make = Worse
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
    assert max(held) == found.pushed == 0.1
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


def test_a_device_that_was_unplugged_for_a_while_is_told_of() -> None:
    class Loose(Mass):
        def read(self, k: int) -> Reading:
            if 20 <= k < 30:
                raise DeviceError("the cable is out")
            return super().read(k)

    found = check_device(Loose, ONE, ticks=100)
    assert (found.failed, found.trouble) == (10, "the cable is out")


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
    assert re.search(r"push    1 N or 1 N m moved it by [\d.]+ m along rail, [\d.]+ rad along turn: the right", told)


def test_a_device_that_does_not_move_says_that_its_sign_is_not_known() -> None:
    class Still(Standing):
        simulated = True

        def __init__(self, _scene: Any) -> None:
            super().__init__(None)

    assert "no force moved it along x" in check_device(Still, ONE, ticks=10).notes[-1]
