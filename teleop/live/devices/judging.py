"""Mistakes of a device that its readings show: functions of a recorded motion, without the device.

`teleop.live.devices.checking` moves the device and calls these. They compare the device with itself: v with x, its
answer to a push with the push.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
from itertools import pairwise
from math import ceil, sqrt
from statistics import median

from teleop.errors import Refused
from teleop.scene.axes import FORCE_UNIT

LONGEST_DEADLINE = 2.0  # s: a force that stays on longer after its end has died has moved a free kilogram by metres
FARTHEST = 0.05  # m or rad, of a gentle push
LIGHTEST = 10.0  # times as far a push would have to reach that a machine has cut short: 0.1 N then moves some 10 g
ALIKE = 2.0  # the integral of v and the way of x may differ by this factor: v may be filtered
IN_STEP = 0.9  # correlation of the two above which they tell of one motion
LATEST = 2  # ticks by which a motor's force that is told as a sensed one may be late
GAP = 4.0  # times the usual time between two readings, above which they are far apart
STILL = 1e-5  # of the way of x: an integral of v that is smaller is none
REPEATED = 1.5  # times as far with each hold repeated: a force that adds up comes twice as far, another as far
COASTS = 4.5  # times as far as it was pushed: in as long again a free mass comes 3 times as far, a growing force 7


class Mistake(Enum):
    """Mistakes of a device that `check_device` names."""

    UNREAD = "a reading is missing"
    NOT_LEFT_LIMIT = "a reading is no left limit"
    RAISES = "a method raises what ends a run"
    UNRELEASED = "it does not take zero force"
    CLOSE = "it cannot be closed and opened again"
    LONG_DEADLINE = "its deadline is long"
    WRONG_WAY = "its force acts the wrong way"
    VELOCITY_SIGN = "v has the wrong sign"
    NO_VELOCITY = "v stays 0"
    VELOCITY_SIZE = "v and x differ in size"
    FAR = "a gentle push moves it far"
    ADDS_UP = "its force adds up"
    LATE = "readings are late"
    SENSES_ITSELF = "the sensed force is the motor's own"
    NO_LIMIT = "nothing ends its force"


class DeviceFault(Refused):
    """Refusal of a device: its `mistake`, and the sentence that says what to do."""

    def __init__(self, mistake: Mistake, sentence: str) -> None:
        super().__init__(sentence)
        self.mistake = mistake


@dataclass(frozen=True, kw_only=True)
class BusTimes:
    """Times in s of an exchange with all joints on a bus, and how many a second it carries, by the median."""

    median: float
    most_99: float  # 99 of 100 exchanges take no longer
    most: float
    carries: float


def times_of(bus: object) -> BusTimes | None:
    """Return the times of the exchanges of a device's bus; None of a device without one."""
    times = list(getattr(bus, "exchange_s", ()))
    return BusTimes(median=median(times), most_99=percentile_99(times), most=max(times),
                    carries=1.0 / max(median(times), 1e-9)) if times else None


def percentile_99(times: list[float]) -> float:
    """Return the time that 99 of 100 of these do not exceed."""
    return sorted(times)[min(len(times) - 1, ceil(0.99 * len(times)) - 1)]


@dataclass
class PushedMotion:
    """Motion along one axis, in order of time: a number in each list for each reading.

    `by` and `f` count from where the device would be without the push, and from what it would sense there; `f` is empty
    without a force sensor. `held`: the force from the reading before until this one, N or N m.
    """

    name: str
    unit: str
    t: list[float] = field(default_factory=list)
    x: list[float] = field(default_factory=list)
    v: list[float] = field(default_factory=list)
    by: list[float] = field(default_factory=list)
    v_by: list[float] = field(default_factory=list)
    f: list[float] = field(default_factory=list)
    held: list[float] = field(default_factory=list)
    _next: float = 0.0  # the force from the newest reading on
    _base: tuple[float, float, float] | None = None  # x, v and f of the first reading, less the twin's

    def add(self, t: float, x: float, v: float, f: float | None, force: float,
            twin: tuple[float, float, float] | None) -> None:
        """Append a reading, after which `force` is held. `twin`: x, v and f of what is not pushed; None: there is none.
        """
        first = (x, v, f or 0.0)
        rest = (0.0, 0.0, 0.0) if twin is None else twin
        if self._base is None:
            self._base = first[0] - rest[0], first[1] - rest[1], first[2] - rest[2]
        self.t.append(t)
        self.x.append(x)
        self.v.append(v)
        self.by.append(x - rest[0] - self._base[0])
        self.v_by.append(v - rest[1] - self._base[1])
        if f is not None:
            self.f.append(f - rest[2] - self._base[2])
        self.held.append(self._next)
        self._next = force

    def pushed(self) -> int:
        """The number of readings until the force was zero again."""
        return max((i + 1 for i, force in enumerate(self.held) if force), default=0)


def check_deadline(deadline: float | None) -> None:
    """Raise `DeviceFault` for a deadline (s) after which a force has done its harm."""
    if deadline is not None and deadline > LONGEST_DEADLINE:
        raise DeviceFault(Mistake.LONG_DEADLINE, (
            f"its deadline is {deadline:g} s, and for so long its force stays on after its end has died; a deadline is "
            f"in s, at most {LONGEST_DEADLINE:g}: if {deadline:g} ms are meant, write deadline = {deadline / 1e3:g}; "
            "if its hardware takes longer, leave deadline out and take --watchdog"))


def check_velocity(motion: PushedMotion, least: float) -> None:
    """Raise `DeviceFault` if the integral of v is not the way of x. Ways of up to `least` (m or rad) are not judged.

    Nothing is judged by what happened between two readings that are far apart, as on a busy machine: v was another.
    """
    times = [t1 - t0 for t0, t1 in pairwise(motion.t)]
    longest, ways, along = GAP * median(times or [0.0]), [0.0], [0.0]
    for time, (x0, x1), (v0, v1) in zip(times, pairwise(motion.x), pairwise(motion.v), strict=True):
        if time <= longest:
            ways.append(ways[-1] + (x1 - x0))
            along.append(along[-1] + 0.5 * (v0 + v1) * time)
    if len(ways) < 3 or (_spread(ways) <= least and _spread(along) <= least):
        return
    xx, ii = sum(x * x for x in ways), sum(i * i for i in along)
    xi = sum(x * i for x, i in zip(ways, along, strict=True))
    compared = (f"along {motion.name}: it integrates to {_greatest(along):.3g} {motion.unit}, while x moved by "
                f"{_greatest(ways):.3g} {motion.unit}")
    if ii <= STILL * STILL * xx:
        raise DeviceFault(Mistake.NO_VELOCITY, (
            f"v stays 0 {compared}; hand over the velocity in read, for example the way of x since the reading before "
            "over the time since then"))
    units = f"hand over x in {motion.unit} and v in {motion.unit}/s"
    if xx <= STILL * STILL * ii:
        raise DeviceFault(Mistake.VELOCITY_SIZE, f"v and x do not fit {compared}; {units}, of the same axis")
    alike = xi / sqrt(xx * ii)
    if abs(alike) < IN_STEP:
        return  # it is sampled too seldom, or disturbed too much, to be judged
    if alike < 0.0:
        raise DeviceFault(Mistake.VELOCITY_SIGN, f"v has the wrong sign {compared}; turn the sign of v in read")
    if not 1.0 / ALIKE <= sqrt(ii / xx) <= ALIKE:
        raise DeviceFault(Mistake.VELOCITY_SIZE, f"v and x differ in size {compared}; {units}")


def check_growth(motion: PushedMotion, least: float) -> None:
    """Raise `DeviceFault` if the force goes on growing: zero was asked for, and what was pushed goes on accelerating.

    It was pushed with one force for as long as it was held at zero after that. A passive device from rest comes at most
    3 times as far as it was pushed, and its acceleration falls; one that adds up what it is given 7 times.
    """
    n = motion.pushed()
    rest = len(motion.by) - n
    if n < 4 or rest < 4:
        return
    sign = 1.0 if motion.by[n - 1] > 0.0 else -1.0
    by = [sign * each for each in motion.by]
    pushed, ended = by[n - 1], by[-1]
    under = (by[n - 1] - 2.0 * by[n // 2] + by[0]) / (n / 2) ** 2
    after = (by[-1] - 2.0 * by[n - 1 + rest // 2] + by[n - 1]) / (rest / 2) ** 2
    if pushed > least and ended > COASTS * pushed and after > under > 0.0:
        force = max(motion.held, key=abs)
        raise DeviceFault(Mistake.ADDS_UP, (
            f"its force goes on growing along {motion.name}: {force:g} {FORCE_UNIT[motion.unit]} were asked for again "
            f"and again, then zero, and it went on accelerating, from {pushed:.3g} to {ended:.3g} {motion.unit}; hold "
            "replaces the force that was held before: do not add to it"))


def check_repetition(once: PushedMotion, twice: PushedMotion, least: float) -> None:
    """Raise `DeviceFault` if the same push moves a device farther where `hold` is called twice at each tick.

    A force that is replaced is the same force then. Ways of up to `least` (m or rad) are not judged.
    """
    n = once.pushed()
    way, repeated = (_greatest(motion.by[:n]) for motion in (once, twice))
    if abs(way) > least and repeated / way > REPEATED:
        force = _greatest(once.held)
        raise DeviceFault(Mistake.ADDS_UP, (
            f"its force adds up along {once.name}: {force:.3g} {FORCE_UNIT[once.unit]} moved it by {way:.3g} "
            f"{once.unit}, and by {repeated:.3g} {once.unit} with hold called twice at each tick; hold replaces the "
            "force that was held before: do not add to it"))


def check_reach(motion: PushedMotion, whole: Sequence[float] = ()) -> None:
    """Raise `DeviceFault` if the push moved it farther than so gentle a push moves a machine.

    `whole`: the force (N or N m) at each tick of a push that was cut short. It is judged by how far it would have taken
    a free mass, whose way grows with the double integral of the force, and let come `LIGHTEST` times as far.
    """
    force, n, unit = abs(_greatest(motion.held)), motion.pushed(), motion.unit
    moved, done = abs(_greatest(motion.by[:n])), _twice_summed(motion.held[:n])
    reach = moved * max(1.0, _twice_summed(whole) / done) if done else moved
    if moved <= FARTHEST and reach <= FARTHEST * (LIGHTEST if whole else 1.0):
        return
    by = f"by {moved:.3g} {unit}" + ("" if reach == moved else f", and whole would by {reach:.3g} {unit},")
    raise DeviceFault(Mistake.FAR, (
        f"a push of {force:.3g} {FORCE_UNIT[unit]} moved it {by} along {motion.name} in "
        f"{motion.t[n - 1] - motion.t[0]:.2g} s, which is far for so small a force; "
        f"{'if x is in mm, hand it over in m' if unit == 'm' else 'if x is in degrees, hand it over in rad'}; if it is "
        f"so light, push it less: --force {force * FARTHEST / reach / 2.0:.1g}"))


def check_lag(motion: PushedMotion, dt: float) -> None:
    """Raise `DeviceFault` if the first reading after a sudden force does not know of it yet, and a later one does.

    An x that stays the same from tick to tick once it moves is one of an encoder's steps, or is sampled more slowly: it
    is not judged.
    """
    first = next((i for i, moved in enumerate(zip(motion.by, motion.v_by, strict=True)) if any(moved)), 0)
    began = next((i for i, force in enumerate(motion.held) if force), 0)
    seen = motion.by[first:first + 10]
    if began < first <= began + 10 and all(a != b for a, b in pairwise(seen)):
        raise DeviceFault(Mistake.LATE, (
            f"readings are late along {motion.name}: a force that was held from one tick on is first seen in x or v "
            f"{first - began + 1} ticks later ({(first - began + 1) * dt * 1e3:.3g} ms), where the next tick knows of "
            "it; hand over in read(k) the state at tick k, not what the call before has fetched"))


def check_sensor(motion: PushedMotion, least: float, tolerance: float) -> None:
    """Raise `DeviceFault` if the sensed force is the commanded one, of either sign, while the device moves.

    What moves it is then no force of what it touches. It may come up to `LATEST` ticks late. `tolerance`: N or N m;
    more than half the push is noise that hides it, and is not judged.
    """
    n = motion.pushed()
    if not motion.f or not n or abs(_greatest(motion.by[:n])) <= least or 2.0 * tolerance > abs(_greatest(motion.held)):
        return
    if any(all(abs(f - sign * held) <= tolerance for f, held in zip(motion.f[late:], motion.held, strict=False))
           for sign in (1.0, -1.0) for late in range(LATEST + 1)):
        unit = FORCE_UNIT[motion.unit]
        raise DeviceFault(Mistake.SENSES_ITSELF, (
            f"the force f that it senses along {motion.name} is the one that its motor was told, "
            f"{_greatest(motion.held):.3g} {unit}, while it moved; f is the force between it and what touches it: give "
            "that of a force sensor, or f=None without one (if something touches it now, free it and check again)"))


def _twice_summed(force: Sequence[float]) -> float:
    speed = way = 0.0
    for each in force:
        speed += each
        way += speed
    return abs(way)


def _spread(numbers: Sequence[float]) -> float:
    return max(numbers) - min(numbers)


def _greatest(numbers: Sequence[float]) -> float:
    return max(numbers, key=abs, default=0.0)
