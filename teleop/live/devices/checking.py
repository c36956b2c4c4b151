"""The check of a device against what a live end asks of it: `check_device(MyArm, e="s")`, `teleop check robot NAME`.

How long `read` and `hold` take is measured and told, never judged: another machine has other times. All else is right
or refused with one sentence. A device is pushed only if it says that it is simulated, by an attribute `simulated` or
`scene_body` that is true, or if that is asked for.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

from teleop.errors import DeviceError, Refused, enumerated, number, number_of, whole_number
from teleop.live.devices.guarded_device import GuardedDevice, LiveDevice, is_simulated
from teleop.live.devices.heartbeat import watched
from teleop.live.devices.named import NamedDevice, named
from teleop.live.devices.opening import close
from teleop.protocol.endpoint import Axes, Reading
from teleop.scene.axes import FORCE_UNIT
from teleop.scene.device_names import KINDS
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene, both_ends

SIMULATED_N, MACHINE_N = 1.0, 0.1  # the push, N or N m
RAMP_S, STAY_S = 0.1, 0.2  # of a push: up, and down again; and between
FAR = 5e-3  # m or rad: a machine that has come so far is pushed no more, the force goes along its ramp
LEFT_OUT = 50  # ticks that are left out once
WAIT_S = 2.0  # for a first reading, and for a device to take zero


@dataclass(frozen=True, kw_only=True)
class DeviceCheck:
    """What `check_device` has found. Times in s, over `reads` calls; `moved`: by the push, m or rad, in each axis."""

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
    read_most: float
    hold_median: float
    hold_most: float
    rate: float  # 1/s, by the medians
    failed: int  # readings that could not be had
    trouble: str = ""  # of the first of them
    pushed: float | None = None  # N or N m
    moved: tuple[float, ...] = ()
    notes: tuple[str, ...] = ()

    def document(self) -> dict[str, Any]:
        """All of it for a machine."""
        return asdict(self)


def check_device(make: str | Callable[..., LiveDevice], scene: Scene | None = None, *, e: str = "s",
                 push: bool | None = None, force: float | None = None, ticks: int = 1000) -> DeviceCheck:
    """Raise `Refused` with one sentence for the first thing in which a device is none; else what was measured.

    `make`: what makes it from the scene, or the text of `--device` or `--robot`; `scene`: left out, `hard_wall`; `e`:
    the end at which it stands, "m" or "s". It is read and held at `ticks` ticks: a machine by the clock.

    Tried are: what `opened` asks for; numbers, one for each axis and finite, with a force always or never; that a
    reading is a left limit, so the same before and after a force is set at its tick (simulated: at tick 0); ticks that
    are left out; the sign of the force, along +x at the slave and along -x at the master, by a push of `force` (N or
    N m; left out, 1 in simulation and 0.1 on a machine) along each axis in turn, ramped; that what fails raises
    DeviceError or OSError; `close`; and, simulated, that it opens again. `push=None` pushes what is simulated alone. A
    machine is pushed only if its force lapses by itself or a watchdog process stands beside it, and not on once it has
    come 5 mm or 5 mrad. Whatever happens, its force is zero at the end and it is closed.
    """
    whole_number("ticks", ticks, low=1)
    scene = both_ends(load_scene("hard_wall") if scene is None else scene)
    known = named(e, make) if isinstance(make, str) else NamedDevice("", make)
    called = known.text or getattr(make, "__name__", type(make).__name__)
    device = known.open(scene)
    raised: BaseException | None = None
    try:
        with TemporaryDirectory() as folder, watched(device, Path(folder)) as beside:
            trial = _Trial(known, beside, device, scene, e)
            try:
                found = trial.run(called, ticks)
                found = trial.push(found, push, force)
            finally:
                trial.let_go()
    except BaseException as error:
        raised = error
        raise
    finally:
        why = close(device)
        if why is not None and raised is None:
            raise Refused(f"{called} did not close: {why}; what close raises is told after every run, which ends with "
                          "exit code 1 then")
    if found.simulated:
        again = known.open(scene)
        with suppress(Refused):
            if GuardedDevice(again, scene.axes).read(0, 0) is not None:
                close(again)
                return found
        raise Refused(f"{called} was closed, opened again, and cannot be read: let close give back all that it took")
    return found


class _Trial:
    """A device under test. `device`: with its watchdog; `bare`: without."""

    def __init__(self, known: NamedDevice, device: LiveDevice, bare: LiveDevice, scene: Scene, e: str) -> None:
        self.known, self.bare, self.scene, self.e = known, bare, scene, e
        self.guarded = GuardedDevice(device, scene.axes)
        self.simulated = is_simulated(bare)
        self.zero: Axes = (0.0,) * scene.axes
        self.k = 0
        self.began = time.monotonic_ns()
        self.read_s: list[float] = []
        self.hold_s: list[float] = []
        self.failed, self.trouble = 0, ""

    def run(self, called: str, ticks: int) -> DeviceCheck:
        """Read and hold no force."""
        first = self._first()
        if self.simulated:
            self._left_limit(first)
        for at in range(ticks):
            self.k += LEFT_OUT if at == ticks // 2 else 1
            self._tick(self.zero)
        if self.failed == ticks:
            raise Refused(f"none of {number_of(ticks, 'reading')} could be had: {self.trouble}")
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
        return DeviceCheck(
            device=called, axes=self.scene.axes, axis_names=self.scene.axis_names,
            axis_units=self.scene.axis_units, senses=bool(self.guarded.sensor), deadline=deadline,
            watchdog=watchdog, simulated=self.simulated, reads=ticks, read_median=median(self.read_s),
            read_most=max(self.read_s), hold_median=median(self.hold_s), hold_most=max(self.hold_s),
            rate=1.0 / max(together, 1e-9), failed=self.failed,
            trouble=self.trouble, notes=tuple(notes))

    def _first(self) -> Reading:
        until = time.monotonic() + WAIT_S
        while (reading := self._read(0)) is None:
            if time.monotonic() > until:
                raise Refused(f"it cannot be read: {self.guarded.trouble}")
            time.sleep(0.005)
        return reading

    def _left_limit(self, first: Reading) -> None:
        """What is read at tick 0 is the same before and after a force is set there."""
        self._hold((SIMULATED_N,) * self.scene.axes)
        after = self._read(0)
        self._hold(self.zero)
        if after is None or (after.x, after.v) != (first.x, first.v):
            raise Refused(f"at tick 0 it read x = {first.x}, v = {first.v}, and after a force was held there "
                          f"{'nothing' if after is None else f'x = {after.x}, v = {after.v}'}; a reading is the left "
                          "limit: let read(k) move it by the force held since the tick before, and hold move nothing")

    def _tick(self, force: Axes) -> Reading | None:
        """One tick: a reading, and `force` from then on. By the clock, where there is a machine."""
        if not self.simulated:
            time.sleep(max(0.0, (self.began + self.k * self.scene.dt_ns - time.monotonic_ns()) / 1e9))
        began = time.perf_counter_ns()
        reading = self._read(self.k)
        read = time.perf_counter_ns()
        self._hold(force)
        self.hold_s.append((time.perf_counter_ns() - read) / 1e9)
        self.read_s.append((read - began) / 1e9)
        if reading is None:
            self.failed += 1
            self.trouble = self.trouble or str(self.guarded.trouble)
        return reading

    def _read(self, k: int) -> Reading | None:
        try:
            return self.guarded.read(k, time.monotonic_ns())
        except Refused:
            raise
        except Exception as error:
            raise _wrong("read", error) from error

    def _hold(self, force: Axes) -> None:
        try:
            self.guarded.hold(force)
        except Exception as error:
            raise _wrong("hold", error) from error

    def push(self, found: DeviceCheck, asked: bool | None, force: float | None) -> DeviceCheck:
        """`found`, with what a push along each axis did."""
        if asked is False or (asked is None and not self.simulated):
            why = "" if asked is False else ": ask for it by --push (from Python push=True)"
            return _noted(found, f"the sign of its force was not tried, since that moves it{why}")
        if found.deadline is None and not found.watchdog:
            raise Refused("it is not pushed, for it has neither a deadline nor a watchdog, and should this process die "
                          "meanwhile the force would stay on; give it one, see teleop/live/devices/README.md")
        most = number("force", (SIMULATED_N if self.simulated else MACHINE_N) if force is None else force, above=0.0)
        twin = _Twin(self.known, self.scene, self.k) if self.simulated else None
        try:
            moved = tuple([self._push_along(axis, most, twin) for axis in range(self.scene.axes)])
        finally:
            if twin is not None:
                close(twin.device)
        still = [name for name, by in zip(self.scene.axis_names, moved, strict=True) if not by]
        found = replace(found, pushed=most, moved=moved)
        return _noted(found, f"no force moved it along {', '.join(still)}, so its sign there is not known") if (
            still) else found

    def _push_along(self, axis: int, most: float, twin: _Twin | None) -> float:
        """By how much (m or rad) a push moved it along an axis, 0 where it cannot be told. Refuses the wrong way."""
        ramp, stay = (max(1, round(each / self.scene.dt)) for each in (RAMP_S, STAY_S))
        rested = [self._step(axis, 0.0) for _ in range(2 * ramp + stay)] if twin is None else []
        at_rest = [x for x in rested if x is not None]
        start = at_rest[-1] if at_rest else 0.0
        least = 2.0 * (max(at_rest) - min(at_rest)) if at_rest else 0.0  # it moves so much when nobody pushes it
        top, gain, by, step = 0.0, 0.0, 0.0, 1.0 / ramp
        for i in range(2 * ramp + stay):
            down = i >= ramp + stay or (twin is None and abs(by) > FAR)
            gain = max(0.0, gain - step) if down else min(1.0, gain + step)
            x = self._step(axis, gain * most)
            if x is not None:
                by = x - (start if twin is None else twin.at(self.k)[axis])
                top = by if abs(by) > abs(top) else top
        self._step(axis, 0.0)
        if abs(top) <= least:
            return 0.0
        sign, along = (1.0, "+x at the slave") if self.e == "s" else (-1.0, "-x at the master, against the hand")
        if top * sign < 0.0:
            unit = self.scene.axis_units[axis]
            raise Refused(f"a force of {most:g} {FORCE_UNIT[unit]} along {self.scene.axis_names[axis]} moved it by "
                          f"{top:.3g} {unit}, the wrong way: a force acts along {along}; turn its sign in hold")
        return top

    def _step(self, axis: int, force: float) -> float | None:
        """The position along an axis at the next tick, where `force` is held along it from then on."""
        self.k += 1
        reading = self._tick((*self.zero[:axis], force, *self.zero[axis + 1:]))
        return None if reading is None else reading.x[axis]

    def let_go(self) -> None:
        """No force, whatever it raises. Raises `Refused` if it does not take that."""
        until = time.monotonic() + WAIT_S
        while not self.guarded.let_go():
            if time.monotonic() > until:
                raise Refused(f"it does not take zero force ({self.guarded.trouble}): the force may still be on")
            time.sleep(0.005)


class _Twin:
    """The same simulated device, which nobody pushes."""

    def __init__(self, known: NamedDevice, scene: Scene, k: int) -> None:
        self.device = known.open(scene)
        self._zero = self._x = (0.0,) * scene.axes
        self._k = 0
        self.at(k)

    def at(self, k: int) -> Axes:
        """Its position at tick k."""
        for each in range(self._k, k + 1):
            with suppress(DeviceError, OSError):
                self._x = self.device.read(each).x
                self.device.hold(self._zero)
        self._k = k
        return self._x


def _noted(found: DeviceCheck, note: str) -> DeviceCheck:
    return replace(found, notes=(*found.notes, note))


def _wrong(method: str, error: Exception) -> Refused:
    return Refused(f"its {method} raised {type(error).__name__}: {error}; what may come right again raises DeviceError "
                   "of teleop or an OSError, on which an end is safe and asks again, and all else ends the run")


def told(found: DeviceCheck, e: str) -> str:
    """What was found, for a person."""
    force = enumerated(dict.fromkeys(f"{found.pushed or 0.0:g} {FORCE_UNIT[unit]}" for unit in found.axis_units), "or")
    lets_go = " and ".join([*[f"by itself after {found.deadline:g} s"] * (found.deadline is not None),
                            *["by its watchdog process"] * found.watchdog]) or "not at all if this process dies"
    lines = [
        f"{KINDS[e].word} {found.device}: {number_of(found.axes, 'axis', 'axes')}, "
        f"{'with a' if found.senses else 'without a'} force sensor{', simulated' * found.simulated}",
        f"  read    {_time(found.read_median)} median, {_time(found.read_most)} at most, of "
        f"{number_of(found.reads, 'call')}",
        f"  hold    {_time(found.hold_median)} median, {_time(found.hold_most)} at most",
        f"  rate    {found.rate:,.0f} a second, 1 / (read + hold) by the medians, measured now on this machine",
        f"  force   lets go {lets_go}",
    ]
    if found.failed:
        lines.append(f"  failed  {number_of(found.failed, 'reading')}, the first: {found.trouble}")
    if found.pushed is not None and any(found.moved):
        moved = ", ".join(f"{by:.3g} {unit} along {name}" for name, unit, by in
                          zip(found.axis_names, found.axis_units, found.moved, strict=True))
        lines.append(f"  push    {force} moved it by {moved}: the right way")
    return "\n".join([*lines, *[f"  note    {note}" for note in found.notes]])


def _time(seconds: float) -> str:
    return f"{seconds * 1e6:.1f} us" if seconds < 1e-3 else f"{seconds * 1e3:.2f} ms"
