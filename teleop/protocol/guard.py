"""The one place where a live end decides how much of the law's force it may hold. Sans-IO.

`step` is asked once a tick and answers with the gain: 1 as long as all is well, and in the safe state on its way to 0,
or there. Whatever has gone wrong, the way down is the watchdog's ramp, and the way back is the same for every cause:
packets for `settle` seconds that were never apart by more than `timeout`, then the ramp.

An end is safe for one of these causes: silence, no fresh packet for `timeout`; age, none for as long that is younger
than the watchdog allows; no answer, the other end's packets say that it has heard nothing of this one for as long; a
stall, no tick for as long; a device that fails, or reads what is not finite; a session that is over, until another
begins; a session after the first, or a first one whose device is not where the scene begins, for its law begins from
rest. A law that gives what is not finite ends the run, at zero force: an unstable loop does not come back by itself.

In a stall the force was held all the while, so the ramp counts the time that has passed, not the ticks that ran: after
one that was longer than the ramp the first force is zero. Of a device whose force lapses by itself it is zero after a
stall of nearly its deadline, since it was let go in the meantime: what comes next must not jump.

A slew limit may hold a force for longer than the ramp. `LONGEST` seconds after the gain has come to 0 the force is
`overdue`, whatever the slew limit says: what is left of it goes in one step, and an event says so.

`HeldForce` is the force that the end holds, and its way to zero where the law cannot run: without a reading, after a
force that was not finite, and after the run. The held force is then scaled by the guard's gain, which falls along the
watchdog's ramp, within the scene's cap: it falls in amount at every tick and never changes sign. It is open loop, so
without a reading the way is short.

No code of an end runs when it is killed, stopped, or hung in a driver. The device itself lets go then, at its deadline.
For a device whose hardware cannot, a process beside the end does (`teleop.live.devices.device_watchdog`), by `Silence`.
"""

from __future__ import annotations

from math import isfinite
from typing import NamedTuple

from teleop.protocol.states import Cause, Reason
from teleop.scene.axes import FORCE_UNIT
from teleop.scene.scene import Scene
from teleop.stages.force_cap import LONGEST, CapLimits, cap, caps
from teleop.stages.velocity_cap import SpeedLimits, limit_speed
from teleop.stages.watchdog import Watchdog, WatchdogLimits, late_step

DEADLINE = 0.15
"""Seconds, of the simulated devices, and the default of a device watchdog.

As long as the default watchdog of a link takes from the last packet to zero force (0.1 s and a ramp of 0.05 s), so an
end that dies lets go as soon as an end that hears nothing; and twice the 70 ms for which a machine may stall anyway.
"""

LAPSING = 0.9
"""An end that has not ticked for this share of it takes the force as lapsed: its clock is not the device's."""

LOOKS = 15  # of a device watchdog within one deadline
GRACE = 0.2  # of the deadline: what an end gets after its watchdog stood still itself


class Silence:
    """The check, every `look_ns`, that a heartbeat is not overdue. Times are ns of the machine's monotonic clock.

    A watchdog that stood still itself cannot tell whether the end did too: both may have been kept from running. So
    after a look that came late the end gets `grace_ns` to renew; but only once for each heartbeat, or a watchdog that
    is always late would never act.
    """

    def __init__(self, deadline_ns: int) -> None:
        self.deadline_ns, self.look_ns = deadline_ns, max(1, deadline_ns // LOOKS)
        self.grace_ns = round(deadline_ns * GRACE)
        self._looked: int | None = None
        self._graced, self._until = 0, 0  # the heartbeat that was given time, and until when

    def overdue(self, now: int, beat: int) -> bool:
        """True if the force is to be set to zero. `beat`: when it was renewed last; 0 means that there is no force.

        `now` has to be read before `beat` is, so that a pause between the two makes the silence shorter, not longer.
        """
        late = self._looked is not None and now - self._looked > self.look_ns + self.grace_ns
        self._looked = now
        if not beat or now - beat <= self.deadline_ns:
            return False
        if late and beat != self._graced:
            self._graced, self._until = beat, now + self.grace_ns
        return beat != self._graced or now >= self._until


UNNAMED = Watchdog(timeout=0.8)
"""What a live end has where the scene names no watchdog."""

_NEVER = 1 << 62  # ticks
CAUSES = tuple(Cause)
STALL, SILENCE, AGE, NO_ANSWER, NEW_SESSION = map(CAUSES.index, (
    Cause.STALL, Cause.SILENCE, Cause.AGE, Cause.NO_ANSWER, Cause.NEW_SESSION))
_QUIET = frozenset((Cause.SILENCE, Cause.NO_ANSWER, Cause.SESSION_OVER, Cause.ORDERED, Cause.ASKED_AGAIN,
                    Cause.NEW_SESSION))  # no event when safe
MOST_EVENTS = 10_000  # kept


class GuardState(NamedTuple):
    """The guard of one end between two ticks."""

    gain: float
    cause: int  # of the safe state it is in, its place in `CAUSES`; -1 outside it
    k: int  # the last tick that ran
    heard: int  # when a packet came last; silence counts from the start
    quiet_ticks: float
    waits: bool  # for the first packet since the cause was over: from that one on the quiet ticks count
    old_k: int  # the last tick at which a message was too old
    shareless: int  # own ticks since the gain was above 0


def guard_begin(k: int, every: int) -> GuardState:
    """The guard of a session that begins at tick `k`: no force until packets have come for a while."""
    return GuardState(0.0, NEW_SESSION, k - every, k - every, 0.0, True, -_NEVER, 0)


def guard_step(
    c: WatchdogLimits, s: GuardState, dt: float, every: int, lapses: float, k: int, got: bool, arrived: int, age: int,
    unheard: float, trouble: int, over: int,
) -> tuple[GuardState, int]:
    """The guard at tick `k`, and the cause that it finds at this one, -1 for none; see `ForceGuard.step`.

    `trouble` and `over` are causes by their places, or -1. `lapses`: own ticks from one that ran to the next by which a
    device has let its force go by itself.
    """
    passed = (k - s.k) // every
    gain = 0.0 if passed > lapses else s.gain
    heard, waits, old_k, timeout_ticks = s.heard, s.waits, s.old_k, c.timeout_ticks
    if got and age / every > c.age:
        old_k = k
    elif got:
        heard = max(heard, min(k, arrived))
        waits = waits and (k - heard) // every > timeout_ticks
    silent, not_heard, cause_now = (k - heard) // every, unheard > timeout_ticks * dt, trouble
    if cause_now < 0 and (passed - 1 > timeout_ticks or passed > lapses):
        cause_now = STALL
    elif cause_now < 0 and over >= 0:
        cause_now = over
    elif cause_now < 0 and silent > timeout_ticks:
        cause_now = AGE if (k - old_k) // every <= timeout_ticks else SILENCE
    elif cause_now < 0 and not_heard and (s.cause < 0 or s.cause == NO_ANSWER):
        cause_now = NO_ANSWER
    cause = cause_now if cause_now >= 0 else s.cause
    waits = waits or cause_now >= 0
    if waits:
        silent = _NEVER
    quiet = s.quiet_ticks
    if not_heard:  # it is not released before the other end hears this one; what came has settled it all the same
        quiet = min(quiet, c.settle + silent - passed)
    gain, quiet = late_step(c, gain, quiet, silent, passed)
    shareless = 0 if gain > 0.0 else s.shareless + passed
    if quiet - silent > c.settle:
        cause = -1
    return GuardState(gain, cause, k, heard, quiet, waits, old_k, shareless), cause_now


def guard_fall(gain: float, step: float, passed: int, lapses: float) -> float:
    """The gain `passed` own ticks later with the run over: on its way to 0 along the ramp."""
    step = passed * step
    return gain - step if gain > step and passed <= lapses else 0.0


class Event(NamedTuple):
    """Something that a run's record has to tell. `k`: the tick at which it was seen."""

    k: int
    what: str  # "joined", "session", "safe", "released"; of others "met", "watchdog", "clutch", "present"
    why: str
    cause: Cause | None = None  # of "safe"

    def document(self) -> dict[str, int | str]:
        """The event as a record has it."""
        return {"k": self.k, "what": self.what, "why": self.why}


class ForceGuard:
    """The gain of one end, tick by tick. `watchdog`: the scene's; None: `UNNAMED`, or none at all when stepped.

    `dt`: the end's own tick, s; that is every `every`-th of the grid, by which time is counted here. `safe`: is it in
    the safe state, or on the way back from it, and `cause` why. `events` say when it came there, why, and when it was
    released. `entries`: how many times it came there.
    """

    def __init__(self, watchdog: Watchdog | None, dt: float, *, every: int = 1, stepped: bool = False) -> None:
        named = watchdog is not None
        self.gain, self.safe, self.entries = 1.0, False, 0
        self.reason: Reason | None = None  # of the safe state it is in
        self.events: list[Event] = []
        self.new_events: list[Event] = []  # those of them since they were taken last
        self._dog = None if stepped and not named else (watchdog or UNNAMED)
        self._c = None if self._dog is None else self._dog.limits(dt)
        self._dt, self._every = dt, every
        self.lapsed = False  # was the force let go by the device before this tick
        self._shareless = 0  # own ticks since the gain was above 0
        self._longest = LONGEST / dt + 0.5
        self._lapses = float("inf")  # own ticks from one that ran to the next, and it was
        self._quiet_ticks = float("inf")
        self._waits = False  # for the first packet since the cause was over: from that one on the quiet ticks count
        self._k = -every  # the last tick that ran
        self._heard = -every  # when a packet came last; silence counts from the start
        self.old, self.oldest = 0, 0.0  # how many messages were too old, and how old the oldest was, s
        self._old_k = -(1 << 62)  # the last tick at which one was

    @property
    def overdue(self) -> bool:
        """True from `LONGEST` seconds after the gain has come to 0 on: no force is held then."""
        return self._shareless > self._longest

    @property
    def lets_go_ns(self) -> int:
        """Time (ns) after the last packet from which on there is no force within a fast slew limit."""
        return 0 if self._dog is None else round((self._dog.timeout + self._dog.ramp) * 1e9)

    def lapse_after(self, deadline: float) -> None:
        """The device sets a force to zero by itself that is not renewed for `deadline` seconds."""
        self._lapses = max(1.0, LAPSING * deadline / self._dt)

    def begin(self, k: int, why: str) -> None:
        """The law begins anew at tick `k`: from zero force, and only after packets have come for a while."""
        self.tell(k, "session", why)
        if self._c is not None:
            self.gain, _, self._k, self._heard, self._quiet_ticks, self._waits, _, _ = guard_begin(k, self._every)
            self._enter(k, Reason(Cause.NEW_SESSION, "a new session"))

    @property
    def cause(self) -> str | None:
        """Sentence on the cause of the safe state, None outside it."""
        return None if self.reason is None else self.reason.why

    @property
    def age(self) -> float | None:
        """Greatest age (s) that a message may have; None: any."""
        return None if self._dog is None else self._dog.age

    @property
    def timeout_ns(self) -> int:
        """Longest silence (ns) that it lets pass."""
        return 0 if self._dog is None else round(self._dog.timeout * 1e9)

    def step(
        self, k: int, got: bool, trouble: Reason | None = None, arrived: int | None = None,
        over: Reason | None = None, unheard: float = 0.0, age: int = 0,
    ) -> float:
        """The gain at tick k of the grid. `got`: is there a fresh message; `trouble`: another cause to be safe.

        `arrived`: the tick at which a packet arrived last, or was played last, if not this one. A packet that waited at
        an end that stood still does not show that its sender is still there, nor does a slow peer's message that stands
        for many ticks. `over`: why the session is over. `unheard`: for how long (s) the other end had heard nothing of
        this one when it sent its newest packet. `age`: how many ticks ago that message was sent.
        """
        if self._c is None or self._dog is None:
            return 1.0
        every = self._every
        k_before, self._k = self._k, k
        passed = (k - k_before) // every
        if got and passed == 1 and self.gain == 1.0 and not self.safe and trouble is None and over is None:
            heard, quiet = self._heard, self._quiet_ticks + 1.0
            newest = k if arrived is None or arrived > k else arrived
            if newest > heard:  # noqa: PLR1730 - at every tick, and `max` takes three times as long
                heard = newest
            silent = (k - heard) // every
            most, _, settle, oldest = self._c
            if (silent <= most and unheard <= most * self._dt and age <= oldest * every
                    and quiet - silent > settle):  # nearly always: full gain stays so
                self._heard, self._quiet_ticks, self._waits, self.lapsed = heard, quiet, False, False
                return 1.0
        before = GuardState(self.gain, -1 if self.reason is None else CAUSES.index(self.reason.cause), k_before,
                            self._heard, self._quiet_ticks, self._waits, self._old_k, self._shareless)
        after, cause = guard_step(
            self._c, before, self._dt, every, self._lapses, k, got, k if arrived is None else arrived, age, unheard,
            -1 if trouble is None else CAUSES.index(trouble.cause), -1 if over is None else CAUSES.index(over.cause))
        self.gain, _, _, self._heard, self._quiet_ticks, self._waits, self._old_k, self._shareless = after
        self.lapsed = passed > self._lapses
        if got and self._old_k == k:
            self.old, self.oldest = self.old + 1, max(self.oldest, age / every * self._dt)
        if cause >= 0:
            self._enter(k, trouble or self._reason(CAUSES[cause], passed - 1, over))
        if self.safe and after.cause < 0:
            self.safe, self.reason = False, None
            self.tell(k, "released", f"fresh packets for {self._dog.settle:g} s")
        return self.gain

    def _reason(self, cause: Cause, missed: int, over: Reason | None) -> Reason:
        """The sentence on a cause of link or clock; `missed`: own ticks that were skipped before this one."""
        assert self._dog is not None
        if over is not None and cause is over.cause:
            return over
        timeout = f"{self._dog.timeout:g} s"
        return Reason(cause, {
            Cause.STALL: f"a stall: no tick for {missed * self._dt:.3f} s",
            Cause.AGE: f"age: messages come more than {self._dog.age or 0.0:g} s after they were sent",
            Cause.SILENCE: f"silence: no fresh packet for {timeout}",
            Cause.NO_ANSWER: f"no answer: the other end has not heard this one for {timeout}"}[cause])

    def fall(self, passed: int = 1) -> float:
        """The gain `passed` own ticks later with the run over: on its way to 0 along the ramp; no event.

        A stepped end whose scene names no watchdog has the ramp of `UNNAMED` for this.
        """
        self.lapsed = passed > self._lapses
        self.gain = guard_fall(self.gain, (self._dog or UNNAMED).limits(self._dt).step, passed, self._lapses)
        self._shareless = 0 if self.gain > 0.0 else self._shareless + passed
        return self.gain

    def tell(self, k: int, what: str, why: str, cause: Cause | None = None) -> None:
        """Note an event."""
        if len(self.events) < MOST_EVENTS:
            self.events.append(Event(k, what, why, cause))
            self.new_events.append(self.events[-1])

    def take_events(self) -> list[Event]:
        """The events since this was asked last."""
        events, self.new_events = self.new_events, []
        return events

    def _enter(self, k: int, reason: Reason) -> None:
        before, self.reason = self.reason, reason
        if before is None or not (reason.cause is before.cause or reason.cause in _QUIET):
            self.entries += not self.safe
            self.safe = True
            self.tell(k, "safe", reason.why, reason.cause)


BLIND_NS = 100_000_000  # the longest that a force is held without a reading


class HeldForce:
    """`force` (N, per axis) of end `e`, which ticks at every `every`-th tick of the scene's grid."""

    def __init__(self, scene: Scene, e: str, every: int, guard: ForceGuard) -> None:
        self.force: tuple[float, ...] = (0.0,) * scene.axes
        self._e, self._every, self._guard = e, every, guard
        self._dt_ns, dt = scene.dt_ns, every * scene.dt_ns / 1e9
        # Of each axis its greatest velocity, None where it has none, and its cap; none of a scene without a cap.
        self._limits = [] if scene.cap is None else [(each.speed(), each.limits(dt)) for each in caps(scene)]
        self._units = [FORCE_UNIT[unit] for unit in scene.axis_units]
        self._k = 0  # the tick at which it was set last

    def begin(self, k: int) -> None:
        """The law begins at tick k."""
        self._k = k - self._every

    def since(self, k: int) -> int:
        """Number of own ticks since it was set last, at tick k, where it is set again."""
        ticks, self._k = (k - self._k) // self._every, k
        return ticks

    def take(self, k: int, force: tuple[float, ...]) -> bool:
        """Set it to `force` (N, per axis) at tick k; False if that is not finite, and then it stays what it was."""
        if not isfinite(sum(force)) and not all(map(isfinite, force)):  # a sum may be too great that is of finite ones
            return False
        if not any(force) and any(self.force):
            self.zero(k)
        self.force = force
        return True

    def zero(self, k: int) -> None:
        """Set it to zero at tick k, with an event where that is a step which the slew limit does not allow.

        There is none where the device has set it to zero by itself.
        """
        steps = [(abs(f), unit) for f, (_, c), unit in zip(self.force, self._limits, self._units, strict=False)
                 if abs(f) > c.step * (1.0 + 1e-9)]
        self.force = (0.0,) * len(self.force)
        if steps and not self._guard.lapsed:
            self._guard.tell(k, "zero", "{:.3g} {} set to zero in one step, which the slew limit still held".format(
                *max(steps)))

    def lost(self) -> None:
        """The device did not take it: whatever it holds now, the next force begins at zero, along the guard's ramp."""
        self._guard.gain = 0.0
        self.force = (0.0,) * len(self.force)

    def blind(self, k: int, ran: int, trouble: Reason) -> tuple[float, ...]:
        """The force to hold at tick k, which has no reading and so no law; `ran`: the last tick that had.

        After `BLIND_NS` there is none, whatever ramp and slew limit ask.
        """
        self._k, before = k, self._guard.gain
        gain = self._guard.step(k, False, trouble)
        if gain >= before:  # of a stepped end without a watchdog
            gain = self._guard.fall()
        if (k - ran) * self._dt_ns > BLIND_NS or self._guard.lapsed:
            self._guard.gain = gain = 0.0
            self.zero(k)
        return self._scaled(before, gain, None)

    def over(self, v: tuple[float, ...] | None, passed: int = 1) -> tuple[float, ...]:
        """The force to hold `passed` own ticks later with the run over; one step of the slew limit, however many.

        Whoever asks ends this where the guard is `overdue`.

        `v`: the velocity (m/s, per axis), by which the velocity cap is kept; None if it is not known.
        """
        before, gain = self._guard.gain, self._guard.fall(passed)
        if self._guard.lapsed:
            self.force = (0.0,) * len(self.force)
        return self._scaled(before, gain, v)

    def _scaled(self, before: float, gain: float, v: tuple[float, ...] | None) -> tuple[float, ...]:
        part = gain / before if before > 0.0 else 0.0
        along = None if v is None or not all(map(isfinite, v)) else v if self._e == "s" else [-each for each in v]
        if not self._limits:
            self.force = tuple([part * each for each in self.force])
        elif along is None:
            self.force = tuple([let_down(c, part, f) for f, (_, c) in zip(self.force, self._limits, strict=True)])
        else:
            self.force = tuple([
                let_down(c, part, f) if speed is None else let_down_moving(speed, c, part, f, along_axis)
                for f, (speed, c), along_axis in zip(self.force, self._limits, along, strict=True)])
        return self.force


def let_down(c: CapLimits, part: float, force: float) -> float:
    """The part of a held force that is held on, within the cap."""
    return cap(c, part * force, force)


def let_down_moving(speed: SpeedLimits, c: CapLimits, part: float, force: float, along: float) -> float:
    """The same of an axis whose velocity is known, along its force, within the velocity cap too."""
    return cap(c, limit_speed(speed, part * force, along), force)
