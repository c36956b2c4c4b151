"""Check of a device against the needs of a live end: `check_device(MyArm, e="s")`, `teleop check robot NAME`.

The times of `read` and `hold` are measured and reported, never judged: another machine has other times. Any mistake is
a `DeviceFault` with one sentence. A device is pushed only if it says that it is simulated, by an attribute
`simulated` or `scene_body` that is true, or if that is asked for.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from math import ceil
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

from teleop.errors import DeviceError, Refused, number, number_of, whole_number
from teleop.live.devices.call_watch import CallWatch
from teleop.live.devices.device_watchdog import with_watchdog
from teleop.live.devices.guarded_device import GuardedDevice, LiveDevice, is_simulated
from teleop.live.devices.judging import (
    BusTimes,
    DeviceFault,
    Mistake,
    PushedMotion,
    check_deadline,
    check_growth,
    check_lag,
    check_reach,
    check_repetition,
    check_sensor,
    check_velocity,
    percentile_99,
    times_of,
)
from teleop.live.devices.opening import NamedDevice, close, find_device
from teleop.protocol.endpoint import Axes, Reading
from teleop.scene.axes import FORCE_UNIT
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene, both_ends

GENTLE = 0.2  # m/s^2 or rad/s^2, to which what is simulated is pushed, were it the scene's own body
SIMULATED_N, MACHINE_N = 1.0, 0.1  # N or N m: of what is simulated, if less does not move it, and of a machine
RAMP_S, STAY_S = 0.1, 0.2  # of a push of a machine: up, and down again; and between
PROBE = 0.1  # of that push, held for half as long before it: a force that adds up is still small then
FAR = 5e-3  # m or rad: a machine that has come so far is pushed no more, the force goes along its ramp
HAND = 1e-3  # m or rad: a machine that nobody pushes and that came so far was moved by a hand
SAME = 1e-3  # of the push: a simulated sensor is no nearer to the motor's force, unless it reads that
NEARLY = 0.05  # of a machine, whose current is measured
SKIPPED = 50  # ticks that are skipped once
WAIT_S = 2.0  # for a first reading, and for a device to take zero


@dataclass(frozen=True, kw_only=True)
class DeviceCheck:
    """Result of `check_device`. Times in s, over `reads` calls; `moved`: by the push, m or rad, in each axis."""

    device: str
    axes: int
    axis_names: tuple[str, ...]
    axis_units: tuple[str, ...]
    senses: bool
    deadline: float | None
    watchdog: bool
    simulated: bool
    reads: int
    read_median: float
    read_99: float  # 99 of 100 reads take no longer
    read_most: float
    hold_median: float
    hold_most: float
    rate: float  # 1/s, by the medians; of a device with a bus no more than that carries
    bus: BusTimes | None = None  # where a thread of the device does the exchanges
    pushed: tuple[float, ...] = ()  # N or N m, in each axis; empty: it was not pushed
    moved: tuple[float, ...] = ()
    notes: tuple[str, ...] = ()

    def document(self) -> dict[str, Any]:
        """Return all fields for a machine."""
        return asdict(self)


def check_device(make: str | Callable[..., LiveDevice], scene: Scene | None = None, *, e: str = "s",
                 push: bool | None = None, force: float | None = None, ticks: int = 1000) -> DeviceCheck:
    """Raise `DeviceFault` with one sentence for the first mistake of a device; else return what was measured.

    `make`: what makes it from the scene, or the text of `--device` or `--robot`; `scene`: left out, `hard_wall`; `e`:
    the end at which it stands, "m" or "s". It is read and held at `ticks` ticks: a machine by the clock. Raises
    `Refused` for a request that cannot be carried out: an unknown name, a device that does not open, other axes.

    Tried are: the needs of `open_device`; numbers, one for each axis and finite, with a force always or never, at every
    tick; its deadline; that a reading is a left limit, so the same before and after a force is set at its tick
    (simulated: at tick 0); ticks that are left out; that v is the slope of x; the sign of the force, along +x at the
    slave and along -x at the master, by a push of `force` (N or N m; left out, 0.1 on a machine, and in simulation what
    gives the scene's own body 0.2 m/s^2 or rad/s^2, twice as much while it does not move, at most 1) along each
    axis in turn; that the push moves it by less than 5 cm (or 0.05 rad), and no farther with `hold` called twice at
    each tick, that the next tick knows of it (simulated), and that a force sensor senses something else; that what
    fails raises DeviceError or OSError; `close`; and, simulated, that it opens again. `push=None` pushes what is
    simulated alone. A machine is pushed only if its force lapses by itself or a watchdog process stands beside it,
    along a ramp, and not on once it has come 5 mm or 5 mrad. Whatever happens, its force is zero at the end, and it is
    closed.

    A `read` or `hold` that does not return for 1.2 s ends the process with a sentence and exit code 1, for nothing else
    can: zero force is tried first, from another thread.
    """
    whole_number("ticks", ticks, low=1)
    scene = both_ends(load_scene("hard_wall") if scene is None else scene)
    known = find_device(e, make) if isinstance(make, str) else NamedDevice("", make)
    called = known.text or getattr(make, "__name__", type(make).__name__)
    device = known.open(scene)
    raised: BaseException | None = None
    try:
        check_deadline(getattr(device, "deadline", None))
        with TemporaryDirectory() as folder, with_watchdog(device, Path(folder)) as beside, CallWatch(called) as watch:
            trial = _Trial(known, beside, device, scene, e, watch)
            try:
                result = trial.run(called, ticks)
                result = trial.push(result, push, force)
            finally:
                trial.let_go()
    except BaseException as error:
        raised = error
        raise
    finally:
        why = close(device)
        if why is not None and raised is None:
            raise DeviceFault(Mistake.CLOSE, f"{called} did not close: {why}; what close raises is told after every "
                              "run, which ends with exit code 1 then")
    if result.simulated:
        again = known.open(scene)
        with suppress(Refused):
            if GuardedDevice(again, scene.axes).read(0, 0) is not None:
                close(again)
                return result
        raise DeviceFault(Mistake.CLOSE, f"{called} was closed, opened again, and cannot be read: let close give back "
                          "all that it took")
    return result


class _Trial:
    """A device under test. `device`: with its watchdog; `bare`: without."""

    def __init__(self, known: NamedDevice, device: LiveDevice, bare: LiveDevice, scene: Scene, e: str,
                 watch: CallWatch) -> None:
        self.known, self.bare, self.scene, self.e, self.watch = known, bare, scene, e, watch
        self.guarded = watch.guarded = GuardedDevice(device, scene.axes)
        self.simulated = is_simulated(bare)
        self.zero: Axes = (0.0,) * scene.axes
        self.k = 0
        self.began = time.monotonic_ns()
        self.read_s: list[float] = []
        self.hold_s: list[float] = []
        self.failed: list[int] = []  # ticks without a reading
        self.trouble = ""  # of the first of them
        self.sums = list(self.zero)  # of all forces that were held, per axis
        self.holds = 1  # calls of hold at each tick
        self.adds_up = 0.0  # N or N m: steps in which a device that adds them up is given the contrary; 0: it does not

    def run(self, called: str, ticks: int) -> DeviceCheck:
        """Read and hold no force."""
        self._first()
        if self.simulated:
            self._left_limit()
        motions = self._motions()
        for at in range(ticks):
            if at == ticks // 2:
                self._check_slopes(motions)
                motions = self._motions()
                self.k += SKIPPED
            self._tick(self.zero, motions)
        self._check_readings()
        self._check_slopes(motions)
        together = median(self.read_s) + median(self.hold_s)
        notes = []
        if together > self.scene.dt:
            notes.append(f"read and hold take {together * 1e3:.3g} ms together, and a tick of the scene is "
                         f"{self.scene.dt * 1e3:g} ms: an end would leave ticks out; take --rate, or hand over in read "
                         "what a thread of the device has read")
        watchdog = getattr(self.bare, "watchdog", None) is not None
        deadline: float | None = getattr(self.bare, "deadline", None)
        if deadline is None and not watchdog:
            notes.append("it has neither a deadline nor a watchdog: the force of an end that dies stays on; see "
                         "teleop/live/devices/README.md")
        notes += list(getattr(self.bare, "notes", ()))
        rate, exchanges = 1.0 / max(together, 1e-9), times_of(getattr(self.bare, "bus", None))
        if exchanges is not None:
            carries = exchanges.carries
            rate = min(rate, carries)
            if carries < 1.0 / self.scene.dt:
                notes.append(f"its bus carries {carries:,.0f} exchanges a second, and the scene ticks "
                             f"{1 / self.scene.dt:,.0f} times: some ticks read what the one before has read; take "
                             f"--rate {max(1, int(carries))} or less")
        return DeviceCheck(
            device=called, axes=self.scene.axes, axis_names=self.scene.axis_names,
            axis_units=self.scene.axis_units, senses=bool(self.guarded.sensor), deadline=deadline,
            watchdog=watchdog, simulated=self.simulated, reads=ticks, read_median=median(self.read_s),
            read_99=percentile_99(self.read_s), read_most=max(self.read_s), hold_median=median(self.hold_s),
            hold_most=max(self.hold_s), rate=rate, bus=exchanges, notes=tuple(notes))

    def _first(self) -> Reading:
        until = time.monotonic() + WAIT_S
        while (reading := self._read(0)) is None:
            if time.monotonic() > until:
                raise DeviceFault(Mistake.UNREAD, f"it cannot be read: {self.guarded.trouble}")
            time.sleep(0.005)
        return reading

    def _left_limit(self) -> None:
        """Raise `DeviceFault` if a force that is set at tick 0 changes what is read there, by more than noise does."""
        before = [each for each in (self._read(0) for _ in range(10)) if each is not None]
        self._hold((SIMULATED_N,) * self.scene.axes)
        after = self._read(0)
        self._hold((-SIMULATED_N,) * self.scene.axes)
        self._hold(self.zero)
        columns = [*zip(*((*each.x, *each.v) for each in before), strict=True)]
        if after is None or any(
                not 2.0 * min(column) - max(column) <= now <= 2.0 * max(column) - min(column)
                for column, now in zip(columns, (*after.x, *after.v), strict=True)):
            raise DeviceFault(Mistake.NOT_LEFT_LIMIT, (
                f"at tick 0 it read x = {before[-1].x}, v = {before[-1].v}, and after a force was held there "
                f"{'nothing' if after is None else f'x = {after.x}, v = {after.v}'}; a reading is the left limit: let "
                "read(k) move it by the force held since the tick before, and hold move nothing"))

    def _motions(self) -> list[PushedMotion]:
        return [*map(PushedMotion, self.scene.axis_names, self.scene.axis_units)]

    def _tick(self, force: Axes, motions: list[PushedMotion] | None = None) -> Reading | None:
        """Run a tick: a reading, which the motion of each axis gets, and `force` from then on.

        By the clock, where there is a machine.
        """
        self.k += 1
        if not self.simulated:
            time.sleep(max(0.0, (self.began + self.k * self.scene.dt_ns - time.monotonic_ns()) / 1e9))
        at = self.k * self.scene.dt_ns if self.simulated else time.monotonic_ns()
        began = time.perf_counter_ns()
        reading = self._read(self.k)
        read = time.perf_counter_ns()
        self._hold(force)
        self.hold_s.append((time.perf_counter_ns() - read) / 1e9)
        for _ in range(1, self.holds):
            self._hold(force)
        self.read_s.append((read - began) / 1e9)
        if reading is None:
            self.failed.append(self.k)
            self.trouble = self.trouble or str(self.guarded.trouble)
        else:
            for motion, x, v in zip(motions or (), reading.x, reading.v, strict=False):
                motion.t.append(at / 1e9)
                motion.x.append(x)
                motion.v.append(v)
        return reading

    def _read(self, k: int) -> Reading | None:
        try:
            with self.watch.calling("read"):
                return self.guarded.read(k, time.monotonic_ns())
        except Refused:
            raise
        except Exception as error:
            raise _raises("read", error) from error

    def _hold(self, force: Axes) -> None:
        self.sums = [total + each for total, each in zip(self.sums, force, strict=True)]
        try:
            with self.watch.calling("hold"):
                self.guarded.hold(force)
        except Exception as error:
            raise _raises("hold", error) from error

    def _check_readings(self) -> None:
        """Raise `DeviceFault` if a reading could not be had."""
        reads, failed = number_of(len(self.read_s), "reading"), len(self.failed)
        if failed:
            some = f"none of {reads} could be had" if failed == len(self.read_s) else (
                f"{failed} of {reads} could not be had, the first at tick {self.failed[0]}, the last "
                f"{number_of(self.k - self.failed[-1], 'tick')} before the end")
            raise DeviceFault(Mistake.UNREAD, f"{some}: {self.trouble}; an end lets go at each of them: see to its "
                              "cable, its driver, and what read hands over")

    def _check_slopes(self, motions: list[PushedMotion], least: float = 0.0) -> None:
        for motion in motions:
            check_velocity(motion, max(least, 0.0 if self.simulated else HAND))

    def push(self, result: DeviceCheck, wanted: bool | None, force: float | None) -> DeviceCheck:
        """Push the device along each axis; return `result` with its answers."""
        if wanted is False or (wanted is None and not self.simulated):
            why = "" if wanted is False else ": ask for it by --push (from Python push=True)"
            return _noted(result, f"the sign of its force was not tried, since that moves it{why}")
        if result.deadline is None and not result.watchdog:
            raise DeviceFault(Mistake.NO_LIMIT, (
                "it is not pushed, for it has neither a deadline nor a watchdog, and should this process die meanwhile "
                "the force would stay on; give it one, see teleop/live/devices/README.md"))
        most = None if force is None else number("force", force, above=0.0)
        axes = range(self.scene.axes)
        if self.simulated:
            with (_Twin(self.known, self.scene, self.k, self.watch) as twin,
                  _Twin(self.known, self.scene, self.k, self.watch) as repeated):
                pushes = [self._push_simulated(axis, most, twin, repeated) for axis in axes]
        else:
            pushes = [self._push_machine(axis, most or MACHINE_N) for axis in axes]
        still = [name for name, (_, by) in zip(self.scene.axis_names, pushes, strict=True) if not by]
        result = replace(result, pushed=tuple([size for size, _ in pushes]), moved=tuple([by for _, by in pushes]))
        return _noted(result, f"no force moved it along {', '.join(still)}, so its sign there is not known") if (
            still) else result

    def _push_simulated(self, axis: int, force: float | None, twin: _Twin, repeated: _Twin) -> tuple[float, float]:
        """Push it suddenly; return the force, and by how much (m or rad) it moved the device, 0 where it did not.

        `repeated` is pushed as the device is, with two calls of hold at each tick.
        """
        body = self.scene.per_axis("slave" if self.e == "s" else "master")[axis]
        size = min(SIMULATED_N, GENTLE * getattr(body, "mass", 0.5)) if force is None else force
        stay = max(10, round(STAY_S / self.scene.dt))
        while True:
            motion = self._motions()[axis]
            wobble = [self._step(axis, 0.0, motion, twin) for _ in range(10)]  # of a device with dice of its own
            least = 2.0 * (max(wobble) - min(wobble))
            noise = 2.0 * (max(motion.f) - min(motion.f)) if motion.f else 0.0  # of ten readings alone
            repeated.at(self.k)
            motion, doubled = self._motions()[axis], self._motions()[axis]
            for step in (size,) * stay + (0.0,) * (stay + 1):
                self._step(axis, step, motion, twin)
                repeated.follow(self.k, axis, step, doubled, twin)
            self._check_adding(check_repetition, motion, doubled, 3.0 * least, size=size)
            self._judge(axis, motion, least, noise, SAME * size)
            moved = _farthest(motion)
            if abs(moved) > least or force is not None or size >= SIMULATED_N:
                return size, moved if abs(moved) > least else 0.0
            size = min(SIMULATED_N, 2.0 * size)

    def _push_machine(self, axis: int, most: float) -> tuple[float, float]:
        """Push a machine along a ramp, after a smaller push that would show that its force adds up; return the same."""
        ramp, stay = (max(1, round(each / self.scene.dt)) for each in (RAMP_S, STAY_S))
        at_rest = self._motions()[axis]
        for _ in range(2 * ramp + stay):
            self._step(axis, 0.0, at_rest)
        least = 2.0 * (max(at_rest.x) - min(at_rest.x))  # it moves so much when nobody pushes it
        noise = max(at_rest.f) - min(at_rest.f) if at_rest.f else 0.0
        step = 1.0 / ramp
        self._probe(axis, most, ramp, least)
        motion, gain = self._motions()[axis], 0.0
        for i in range(2 * ramp + stay):
            by = motion.by[-1] if motion.by else 0.0
            gain = max(0.0, gain - step) if i >= ramp + stay or abs(by) > FAR else min(1.0, gain + step)
            self._step(axis, gain * most, motion)
        self._step(axis, 0.0, motion)
        up = [most * min(1.0, (i + 1) * step) for i in range(ramp)]
        self._judge(axis, motion, least, noise, NEARLY * most, whole=[*up, *[most] * stay, *up[::-1]])
        moved = _farthest(motion)
        return most, moved if abs(moved) > least else 0.0

    def _probe(self, axis: int, most: float, ramp: int, least: float) -> None:
        """Raise `DeviceFault` if a small push of a machine shows that its force adds up."""
        pushes: list[PushedMotion] = []
        for holds in (1, 2, 1, 2):
            motion, gain, self.holds = self._motions()[axis], 0.0, holds
            for i in range(ramp + 2):
                gain = min(PROBE, gain + 1.0 / ramp) if i < ramp // 2 else max(0.0, gain - 1.0 / ramp)
                self._step(axis, gain * most, motion)
            for _ in range(motion.pushed()):
                self._step(axis, 0.0, motion)
            self._check_adding(check_growth, motion, least, size=PROBE * most)
            back = PushedMotion(motion.name, motion.unit)
            contrary = [-force for force in motion.held[1:motion.pushed() + 1]]  # so that what is free stands again
            for force in contrary + [0.0] * 4 * ramp:
                self._step(axis, force, back)
            pushes.append(motion)
            if holds == 2:  # friction and lost motion let one push go farther than another, but not each time
                try:
                    self._check_adding(check_repetition, pushes[-2], motion, 5.0 * least, size=PROBE * most)
                    break
                except DeviceFault:
                    if len(pushes) == 4:
                        raise
        self.holds, self.adds_up = 1, 0.0

    def _judge(self, axis: int, motion: PushedMotion, least: float, noise: float, tolerance: float,
               whole: list[float] | None = None) -> None:
        """Raise `DeviceFault` for what a push has shown. `least`: m or rad that it moves without one."""
        self._check_readings()
        moved, pushed = _farthest(motion), max(motion.held, key=abs)
        if self.simulated:
            check_lag(motion, self.scene.dt)
        sign, along = (1.0, "+x at the slave") if self.e == "s" else (-1.0, "-x at the master, against the hand")
        if abs(moved) > least and moved * sign < 0.0:
            raise DeviceFault(Mistake.WRONG_WAY, (
                f"a force of {pushed:g} {FORCE_UNIT[motion.unit]} along {motion.name} moved it by {moved:.3g} "
                f"{motion.unit}, the wrong way: a force acts along {along}; turn its sign in hold"))
        check_velocity(motion, least if self.simulated else max(5.0 * least, HAND))
        check_reach(motion, whole or ())
        check_sensor(motion, least, tolerance + noise)

    def _check_adding(self, check: Callable[..., None], *shown: Any, size: float) -> None:
        try:
            check(*shown)
        except DeviceFault:
            self.adds_up = abs(size)
            raise

    def _step(self, axis: int, force: float, motion: PushedMotion, twin: _Twin | None = None) -> float:
        """The position along an axis at the next tick, where `force` is held along it from then on.

        It counts from that of the twin, or of the first reading of the motion.
        """
        reading = self._tick((*self.zero[:axis], force, *self.zero[axis + 1:]))
        base = None if twin is None else twin.at(self.k)
        if reading is None:
            return motion.by[-1] if motion.by else 0.0
        f = None if reading.f is None else reading.f[axis]
        motion.add(self.k * self.scene.dt if self.simulated else time.monotonic_ns() / 1e9, reading.x[axis],
                   reading.v[axis], f, force,
                   None if base is None else (base.x[axis], base.v[axis], 0.0 if base.f is None else base.f[axis]))
        return motion.by[-1]

    def let_go(self) -> None:
        """Hold no force, whatever it raises. Raises `DeviceFault` if it does not take that."""
        until = time.monotonic() + WAIT_S
        for axis, total in enumerate(self.sums if self.adds_up else ()):
            steps = ceil(abs(total) / self.adds_up)
            for _ in range(steps):
                with suppress(Exception):
                    self.guarded.hold((*self.zero[:axis], -total / steps, *self.zero[axis + 1:]))
        while not self.guarded.let_go():
            if time.monotonic() > until:
                raise DeviceFault(Mistake.UNRELEASED, f"it does not take zero force ({self.guarded.trouble}): the "
                                  "force may still be on; switch it off")
            time.sleep(0.005)


class _Twin:
    """The same simulated device, beside it: nobody pushes it, or `follow` does."""

    def __init__(self, known: NamedDevice, scene: Scene, k: int, watch: CallWatch) -> None:
        self._device, self._watch = known.open(scene), watch
        self._zero = (0.0,) * scene.axes
        self._sums = list(self._zero)  # of the forces that it was given, per axis
        self._reading = Reading(self._zero, self._zero)
        self._k = -1
        self.at(k)

    def __enter__(self) -> _Twin:
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(Exception):
            self._device.hold(tuple([-total for total in self._sums]))  # where forces add up, none is on after this
            self._device.hold(self._zero)
        close(self._device)

    def at(self, k: int, force: Axes | None = None, holds: int = 1) -> Reading:
        """Read it at tick k, and hold `force` from then on."""
        for each in range(self._k + 1, k + 1):
            with suppress(DeviceError, OSError), self._watch.calling("read"):
                self._reading = self._device.read(each)
                for _ in range(holds):
                    self._device.hold(force or self._zero)
        self._k = k
        return self._reading

    def follow(self, k: int, axis: int, force: float, motion: PushedMotion, twin: _Twin) -> None:
        """Append the reading at tick k to `motion`, counted from `twin`; `force` is held after it, by two calls."""
        reading = self.at(k, (*self._zero[:axis], force, *self._zero[axis + 1:]), 2)
        self._sums[axis] += 2.0 * force
        base = twin.at(k)
        motion.add(0.0, reading.x[axis], reading.v[axis], None, force, (base.x[axis], base.v[axis], 0.0))


def _farthest(motion: PushedMotion) -> float:
    """Greatest way (m or rad) from where it would be without the push, until the force was zero again."""
    return max(motion.by[:motion.pushed()], key=abs, default=0.0)


def _noted(result: DeviceCheck, note: str) -> DeviceCheck:
    return replace(result, notes=(*result.notes, note))


def _raises(method: str, error: Exception) -> DeviceFault:
    return DeviceFault(Mistake.RAISES, (
        f"its {method} raised {type(error).__name__}: {error}; what may come right again raises DeviceError of teleop "
        "or an OSError, on which an end is safe and asks again, and all else ends the run"))
