"""`check_device`: what is a device passes with its figures, and each mistake is refused by its sentence."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from collections.abc import Callable
from itertools import pairwise
from math import nan
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import pytest

from master.device import SimulatedMaster
from slave.robot import SimulatedSlave
from teleop import DeviceError, Reading, Refused, check_device, load_scene
from teleop.__main__ import main
from teleop.live.devices.call_watch import BLOCKED_S
from teleop.live.devices.judging import DeviceFault, Mistake, PushedMotion, check_velocity
from teleop.scene.library import ROOT
from tests.fakes import Clock

ONE = load_scene("hard_wall", duration=0.1)


@pytest.fixture(autouse=True)
def _clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock that goes on in sleeps, and by 1 us at each look: a machine is checked by it, however busy ours is."""
    monkeypatch.setattr("teleop.live.devices.checking.time", Clock(step=1000))


class State(NamedTuple):
    """What a device has read and held so far."""

    x: float
    v: float
    f: float  # N, held last
    k: int


class Mass:
    """A mass of 1 kg on a spring `k` with a damper `d`, held by no hand; each device below makes one mistake.

    `reads`: what it reads in place of its state. `holds`: the force that it takes of the one it is given and its own.
    `jumps`: m/N of a hold. `closes`: called to close it.
    """

    def __init__(self, every: list[Mass], *, is_machine: bool = False, way: float = 1.0, jumps: float = 0.0,
                 k: float = 0.0, d: float = 0.0, deadline: float | None = 0.1, senses: bool | None = None,
                 reads: Callable[[State], Reading | BaseException] = lambda now: Reading((now.x,), (now.v,)),
                 holds: Callable[[float, float], float] = lambda force, _own: force,
                 closes: Callable[[], object] = lambda: None) -> None:
        self.simulated, self.way, self.jumps, self.stiffness, self.damping = not is_machine, way, jumps, k, d
        self.reads, self.holds, self.closes = reads, holds, closes
        if deadline is not None:
            self.deadline = deadline
        if senses is not None:
            self.senses = senses
        self.x = self.v = self.f = 0.0
        self.k = self.closed = 0
        self.held: list[float] = []
        every.append(self)

    def read(self, k: int) -> Reading:
        while self.k < k:
            self.v += 1e-3 * (self.way * self.f - self.stiffness * self.x - self.damping * self.v)
            self.x += 1e-3 * self.v
            self.k += 1
        found = self.reads(State(self.x, self.v, self.f, self.k))
        if isinstance(found, BaseException):
            raise found
        return found

    def hold(self, force: tuple[float, ...]) -> None:
        self.f = self.holds(force[0], self.f)
        self.x += self.jumps * self.f
        self.held.append(force[0])

    def close(self) -> None:
        self.closed += 1
        self.closes()


class Checked(NamedTuple):
    """What came of a check, and the devices that were made for it."""

    found: Any
    every: list[Mass]


def checked(ticks: int = 100, push: bool | None = None, **knobs: Any) -> Checked:
    """Check masses of one kind; a knob that is a function without an argument is called for each of them."""
    every: list[Mass] = []
    made = {name: knobs.pop(name) for name in ("reads", "holds") if getattr(knobs.get(name), "is_maker", False)}

    def make(_scene: Any) -> Mass:
        return Mass(every, **knobs, **{name: maker() for name, maker in made.items()})

    try:
        return Checked(check_device(make, ONE, ticks=ticks, push=push), every)
    except Refused as refused:
        return Checked(refused, every)


def maker(function: Any) -> Any:
    """Mark a function that makes what one device reads, which remembers something."""
    function.is_maker = True
    return function


@pytest.mark.parametrize(("e", "make"), [
    ("m", SimulatedMaster), ("s", SimulatedSlave), ("s", lambda _scene: Mass([]))], ids=["m", "s", "mass"])
def test_a_device_passes_and_moves_the_way_that_its_end_asks_for(e: str, make: Any) -> None:
    found = check_device(make, ONE, e=e, ticks=100)
    assert (found.axes, found.senses, found.simulated) == (1, False, True)
    assert found.moved[0] < 0.0 if e == "m" else found.moved[0] > 0.0
    assert found.rate == pytest.approx(1.0 / (found.read_median + found.hold_median))
    assert found.notes == ()
    found, _ = checked(10, reads=lambda _now: Reading((0.5,), (0.0,)))
    assert "no force moved it along x" in found.notes[-1], "its sign is not known"


def forgets() -> None:
    raise KeyError("port")


def at(now: State) -> Reading:
    return Reading((now.x,), (now.v,))


@maker
def opened_once() -> Any:
    """The first can be read, and its twin beside it."""
    count = opened_once.count = getattr(opened_once, "count", 0) + 1
    return (lambda _now: DeviceError("the port is taken")) if count > 2 else at


@pytest.mark.parametrize(("knobs", "words"), [
    ({"way": -1.0}, "moved it by -0.0"), ({"way": -1.0}, "m, the wrong way: a force acts along +x at the slave"),
    ({"jumps": 1e-3}, "a reading is the left limit"),
    ({"reads": lambda now: at(now) if now.k <= 20 else ValueError("frame of 3 bytes")},
     "its read raised ValueError: frame of 3 bytes; what may come right again raises DeviceError"),
    ({"closes": forgets}, "did not close: KeyError: 'port'"),
    ({"reads": opened_once}, "was closed, opened again, and cannot be read"),
    ({"reads": lambda _now: Reading((0.0, 0.0), (0.0, 0.0))},
     "the device has 2 axes, for so many numbers has the x that it read, and the scene has 1; take a"),
    ({"senses": True}, "the device says senses = True and reads f=None"),
    ({"reads": lambda now: DeviceError("the cable is out") if 20 <= now.k < 30 else at(now)},
     "10 of 100 readings could not be had, the first at tick 20, the last 121 ticks before the end: the cable is out"),
])
def test_a_mistake_is_refused_by_its_sentence(knobs: dict[str, Any], words: str) -> None:
    assert words in str(checked(**knobs).found)


def test_a_machine_is_pushed_only_when_it_is_asked_for_gently_and_ends_at_zero() -> None:
    """A device that does not say that it is simulated is taken for a machine, which nobody pushes unasked.

    One that fails meanwhile is given zero, and one whose force outlives this process is not pushed.
    """
    found, every = checked(10, is_machine=True)
    assert set(every[-1].held) == {0.0}
    assert "the sign of its force was not tried" in found.notes[0]
    found, every = checked(10, push=True, is_machine=True)
    held = every[-1].held
    assert found.pushed == (max(held),) == (0.1,)
    assert max(abs(b - a) for a, b in pairwise(held)) < 0.0011, "a ramp of 0.1 s"
    assert held[-1] == 0.0
    assert every[-1].closed == 1
    assert 0.0 < found.moved[0] < 0.006
    found, every = checked(10, push=True, is_machine=True,
                           reads=lambda now: ZeroDivisionError() if now.f > 0.05 else at(now))
    assert "raised ZeroDivisionError" in str(found)
    assert max(every[-1].held) > 0.05
    assert (every[-1].held[-1], every[-1].closed) == (0.0, 1)
    found, _ = checked(10, push=True, is_machine=True, deadline=None)
    assert "neither a deadline nor a watchdog" in str(found)


# Mistakes that passed


@maker
def a_tick_late() -> Any:
    """Shows the state of the tick before."""
    seen = [State(0.0, 0.0, 0.0, 0)] * 2

    def reads(now: State) -> Reading:
        if now.k > seen[-1].k:
            seen.append(now)
        return at(seen[-2])

    return reads


@maker
def late_motor() -> Any:
    """Tells the motor's force a tick after it was held, with the noise of a measured current."""
    dice, before = Random(4), [0.0]

    def reads(now: State) -> Reading:
        f, before[0] = before[0] + dice.gauss(0.0, 1e-3), now.f
        return Reading((now.x,), (now.v,), (f,))

    return reads


def adds_up(force: float, own: float) -> float:
    return own + force


MISTAKES: dict[str, tuple[dict[str, Any], Mistake, str]] = {
    "v backwards": ({"reads": lambda now: Reading((now.x,), (-now.v,))},
                    Mistake.VELOCITY_SIGN, "turn the sign of v in read"),
    "no v": ({"reads": lambda now: Reading((now.x,), (0.0,))},
             Mistake.NO_VELOCITY, "hand over the velocity in read"),
    "mm": ({"reads": lambda now: Reading((1e3 * now.x,), (1e3 * now.v,))},
           Mistake.FAR, "if x is in mm, hand it over in m"),
    "x alone in mm": ({"reads": lambda now: Reading((1e3 * now.x,), (now.v,))},
                      Mistake.VELOCITY_SIZE, "hand over x in m and v in m/s"),
    "NaN from reading 50 on": ({"reads": lambda now: at(now) if now.k < 50 else Reading((nan,), (0.0,))},
                               Mistake.UNREAD, "the first at tick 50"),
    "a deadline in ms": ({"deadline": 150}, Mistake.LONG_DEADLINE, "write deadline = 0.15"),
    "adds up": ({"holds": adds_up}, Mistake.ADDS_UP, "do not add to it"),
    "a tick late": ({"reads": a_tick_late}, Mistake.LATE, "hand over in read(k) the state at tick k"),
    "senses its motor": ({"reads": lambda now: Reading((now.x,), (now.v,), (now.f,))},
                         Mistake.SENSES_ITSELF, "or f=None without one"),
    # stands still with what was added up, so nothing accelerates: 0.1 N at each tick came to 20 N, unnamed
    "adds up on a spring": ({"holds": adds_up, "k": 500.0, "d": 40.0},
                            Mistake.ADDS_UP, "with hold called twice at each tick"),
    "senses its motor late": ({"reads": late_motor}, Mistake.SENSES_ITSELF, "or f=None without one"),
}


@pytest.mark.parametrize("is_machine", [False, True], ids=["simulated", "machine"])
@pytest.mark.parametrize("name", MISTAKES)
def test_a_device_that_would_hit_its_user_passed(name: str, is_machine: bool) -> None:
    """And whatever is found, at the end no force is on: not what was held last, nor what a hold has added up."""
    knobs, mistake, cure = MISTAKES[name]
    if is_machine and mistake is Mistake.LATE:
        pytest.skip("a machine is late by what its link takes, and that is no mistake")
    fault, every = checked(push=True, is_machine=is_machine, **knobs)
    assert isinstance(fault, DeviceFault), fault
    assert cure in str(fault)
    assert fault.mistake is mistake
    for device in every:
        assert device.f == pytest.approx(0.0, abs=1e-9)
        assert device.closed == 1
        assert not is_machine or max(map(abs, device.held), default=0.0) < 1.5, "it went on for long"


BARE = """
from teleop import Reading
class Bare:
    {deadline}
    def __init__(self, scene): pass
    def read(self, k): return Reading((0.0,), (0.0,))
    def hold(self, force): pass
"""


def test_a_device_without_a_deadline_passes_with_a_note_that_its_force_stays_on_and_a_mistake_has_exit_code_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """`teleop check` ended in a TypeError for the device that it most needs to warn of."""
    (tmp_path / "bare.py").write_text(BARE.format(deadline=""))
    assert main(["check", "robot", f"{tmp_path}/bare.py", "--ticks", "20"]) == 0
    answer = capsys.readouterr().out
    assert "lets go not at all if this process dies" in answer
    assert "it has neither a deadline nor a watchdog: the force of an end that dies stays on" in answer
    (tmp_path / "late.py").write_text(BARE.format(deadline="deadline = 150"))
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
    assert took < 30.0, "within 2 s where the machine has nothing else to do, and 99 s of its own"
    if "PyDLL" not in hang:
        assert (tmp_path / "held").read_text().splitlines()[-1] == "0.0"
        assert "its force was set to zero" in done.stderr


# Right devices


@maker
def noisy() -> Any:
    """Throws dice at each reading, also at the same tick; the noise of its sensor is as large as the push."""
    gauss = Random(5).gauss
    return lambda now: Reading((now.x + gauss(0.0, 2e-5),), (now.v + gauss(0.0, 2e-3),), (gauss(0.0, 0.05),))


@maker
def encoder() -> Any:
    """Reads in steps of 10 um, and v by a filtered difference of them."""
    step, last = 1e-5, [0, 0, 0.0]  # the tick, steps, slope

    def reads(now: State) -> Reading:
        steps = round(now.x / step)
        if now.k > last[0]:
            slope = last[2] + 0.1 * (1e3 * step * (steps - last[1]) / (now.k - last[0]) - last[2])
            last[:] = now.k, steps, slope
        return Reading((steps * step,), (last[2],))

    return reads


@maker
def every_fourth_tick() -> Any:
    """Samples at 250 Hz under a tick of 1 ms."""
    newest = [Reading((0.0,), (0.0,))]

    def reads(now: State) -> Reading:
        if now.k % 4 == 0:
            newest[0] = at(now)
        return newest[0]

    return reads


@maker
def lost_motion() -> Any:
    """Has a gear with 0.2 mm of backlash between motor and encoder."""
    shown = [0.0]

    def reads(now: State) -> Reading:
        before, shown[0] = shown[0], min(max(shown[0], now.x - 1e-4), now.x + 1e-4)
        return Reading((shown[0],), (now.v if shown[0] != before else 0.0,))

    return reads


@pytest.mark.parametrize("is_machine", [False, True], ids=["simulated", "machine"])
@pytest.mark.parametrize("knobs", [
    {"reads": noisy}, {"reads": encoder}, {"reads": every_fourth_tick}, {"reads": lost_motion},
    {"reads": lambda now: Reading((round(now.x / 1e-5) * 1e-5,), (now.v,))},
    {"k": 4000.0, "d": 5.0, "reads": lambda now: Reading((now.x,), (now.v,), (4000.0 * now.x + 5.0 * now.v,))},
], ids=["noisy", "encoder", "250 Hz", "backlash", "steps", "a sensor at a wall"])
def test_a_right_device_was_accused_of_its_noise_its_steps_or_its_rate(knobs: Any, is_machine: bool) -> None:
    """Noise was a force in hold, steps and 250 Hz were late readings, and noise of a sensor was the motor's force."""
    found, _ = checked(push=True, is_machine=is_machine, **knobs)
    assert not isinstance(found, Refused), found
    assert found.moved[0] > 0.0


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


def test_the_command_tells_it_and_has_it_as_json_and_of_unlike_axes_each_by_its_name_in_its_unit(
    capsys: pytest.CaptureFixture[str]
) -> None:
    """Two axes moved "by 0.01, 0.02 m or rad" under "1 N or N m"."""
    assert main(["check", "robot", "simulated", "--ticks", "50"]) == 0
    told = capsys.readouterr().out
    assert "robot simulated: 1 axis, without a force sensor, simulated" in told
    assert "lets go by itself after 0.15 s" in told
    assert main(["check", "device", "simulated", "--ticks", "50", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["moved"][0] < 0.0
    assert main(["check", "robot", "simulated", "bench_top", "--ticks", "50", "--set", "axes=2",
                 "--set", "units=m,rad", "--set", "names=rail,turn"]) == 0
    told = capsys.readouterr().out
    assert re.search(r"push    moved it by [\d.]+ m along rail \(0.1 N\), [\d.]+ rad along turn \(0.1 N m\): the right",
                     told)
