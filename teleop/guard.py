"""The one place where a live end decides how much of the law's force it may hold. Sans-IO.

`step` is asked once a tick and answers with the gain: 1 as long as all is well, and in the safe state on its way to 0,
or there. Whatever has gone wrong, the way down is the watchdog's ramp, and the way back is the same for every cause:
packets for `settle` seconds that were never apart by more than `timeout`, then the ramp.

An end is safe for one of these causes: silence, no fresh packet for `timeout`; a stall, no tick for as long; a device
that fails, or reads what is not finite; a session after the first, or a first one whose device is not where the scene
begins, for its law begins from rest. A law that gives what is not finite ends the run, at zero force: an unstable loop
does not come back by itself.

In a stall the force was held all the while, so the ramp counts the time that has passed, not the ticks that ran: after
one that was longer than the ramp the first force is zero. Of a device whose force lapses by itself it is zero after a
stall of nearly its deadline, since it was let go in the meantime: what comes next must not jump.
"""

from __future__ import annotations

from typing import NamedTuple

from teleop.deadline import LAPSING
from teleop.safety import Watchdog, watch

UNNAMED = Watchdog(timeout=0.8)
"""What a live end has where the scene names no watchdog."""

_NEVER = 1 << 62  # ticks
MOST_EVENTS = 10_000  # kept


class Event(NamedTuple):
    """Something that a run's record has to tell. `k`: the tick at which it was seen."""

    k: int
    what: str  # "joined", "session", "safe", "released"; of others "met", "watchdog"
    why: str


class Guard:
    """The gain of one end, tick by tick. `watchdog`: the scene's; None: `UNNAMED`, or none at all when stepped.

    `dt`: the end's own tick, s; that is every `every`-th of the grid, by which time is counted here. `safe`: is it in
    the safe state, or on the way back from it, and `cause` why. `events` say when it came there, why, and when it was
    released. `entries`: how many times it came there.
    """

    def __init__(self, watchdog: Watchdog | None, dt: float, *, every: int = 1, stepped: bool = False) -> None:
        named = watchdog is not None
        self.gain, self.safe, self.entries = 1.0, False, 0
        self.cause: str | None = None  # of the safe state it is in
        self.events: list[Event] = []
        self._dog = None if stepped and not named else (watchdog or UNNAMED)
        self._c = None if self._dog is None else self._dog.limits(dt)
        self._dt, self._every = dt, every
        self.lapsed = False  # was the force let go by the device before this tick
        self._lapses = float("inf")  # own ticks from one that ran to the next, and it was
        self._calm = float("inf")
        self._waits = False  # for the first packet since the cause was over: from that one on calm is counted
        self._k = -every  # the last tick that ran
        self._heard = -every  # when a packet came last; silence counts from the start

    @property
    def lets_go_ns(self) -> int:
        """How long after the last packet there is no force any more."""
        return 0 if self._dog is None else round((self._dog.timeout + self._dog.ramp) * 1e9)

    def lapse_after(self, deadline: float) -> None:
        """The device sets a force to zero by itself that is not renewed for `deadline` seconds."""
        self._lapses = max(1.0, LAPSING * deadline / self._dt)

    def begin(self, k: int, why: str) -> None:
        """The law begins anew at tick `k`: from zero force, and only after packets have come for a while."""
        self.tell(k, "session", why)
        if self._c is not None:
            self._k = self._heard = k - self._every
            self.gain, self._calm, self._waits = 0.0, 0.0, True
            self._enter(k, "a new session")

    def step(self, k: int, got: bool, trouble: str | None = None, *, came: int | None = None) -> float:
        """The gain at tick k of the grid. `got`: is there a fresh message; `trouble`: what else keeps it safe.

        `came`: the tick at which a packet came last, if not this one: what waited at an end that stood still is new to
        it, and says nothing of whether its sender is still there.
        """
        if self._c is None or self._dog is None:
            return 1.0
        passed, self._k = (k - self._k) // self._every, k
        patience = self._c.patience
        self.lapsed = passed > self._lapses
        if self.lapsed:
            self.gain = 0.0
        if got:
            self._heard = max(self._heard, k if came is None else min(k, came))
            self._waits = self._waits and (k - self._heard) // self._every > patience
        silent = (k - self._heard) // self._every
        if trouble is None and (passed - 1 > patience or self.lapsed):
            trouble = f"a stall: no tick for {(passed - 1) * self._dt:.3f} s"
        if trouble is None and silent > patience:
            trouble = f"silence: no fresh packet for {self._dog.timeout:g} s"
        if trouble is not None:
            self._enter(k, trouble)
            self._waits = True
        if self._waits:
            silent = _NEVER
        c = self._c
        falling = silent > patience or self._calm + 1.0 - silent <= c.settle
        if falling and passed > 1:
            c = c._replace(step=min(1.0, c.step * passed))
        self.gain, self._calm = watch(c, self.gain, self._calm, silent)
        if self.safe and self._calm - silent > c.settle:
            self.safe, self.cause = False, None
            self.tell(k, "released", f"fresh packets for {self._dog.settle:g} s")
        return self.gain

    def tell(self, k: int, what: str, why: str) -> None:
        """Note an event."""
        if len(self.events) < MOST_EVENTS:
            self.events.append(Event(k, what, why))

    def _enter(self, k: int, why: str) -> None:
        kind, before = why.partition(":")[0], (self.cause or "").partition(":")[0]
        self.cause = why
        if not self.safe or kind not in (before, "silence", "a new session"):  # these go without saying
            self.entries += not self.safe
            self.safe = True
            self.tell(k, "safe", why)
