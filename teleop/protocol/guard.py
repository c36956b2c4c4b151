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
"""

from __future__ import annotations

from typing import NamedTuple

from teleop.protocol.deadline import LAPSING
from teleop.stages.force_cap import LONGEST
from teleop.stages.watchdog import Watchdog, late_step

UNNAMED = Watchdog(timeout=0.8)
"""What a live end has where the scene names no watchdog."""

_NEVER = 1 << 62  # ticks
_QUIET = ("silence", "no answer", "the session is over", "a new session")  # in the safe state they go without saying
MOST_EVENTS = 10_000  # kept


class Event(NamedTuple):
    """Something that a run's record has to tell. `k`: the tick at which it was seen."""

    k: int
    what: str  # "joined", "session", "safe", "released"; of others "met", "watchdog", "clutch", "present"
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
            self._k = self._heard = k - self._every
            self.gain, self._quiet_ticks, self._waits = 0.0, 0.0, True
            self._enter(k, "a new session")

    @property
    def age(self) -> float | None:
        """Greatest age (s) that a message may have; None: any."""
        return None if self._dog is None else self._dog.age

    @property
    def timeout_ns(self) -> int:
        """Longest silence (ns) that it lets pass."""
        return 0 if self._dog is None else round(self._dog.timeout * 1e9)

    def step(
        self, k: int, got: bool, trouble: str | None = None, *, came: int | None = None, over: str | None = None,
        unheard: float = 0.0, age: int = 0,
    ) -> float:
        """The gain at tick k of the grid. `got`: is there a fresh message; `trouble`: what else keeps it safe.

        `came`: the tick at which a packet came last, or was played last, if not this one: neither what waited at an end
        that stood still, nor a slow peer's message that stands for many ticks, shows that its sender is still there.
        `over`: why the session is over. `unheard`: for how long (s) the other end had heard nothing of this one when it
        sent its newest packet. `age`: how many ticks ago that message was sent.
        """
        if self._c is None or self._dog is None:
            return 1.0
        every = self._every
        passed, self._k = (k - self._k) // every, k
        if got and passed == 1 and self.gain == 1.0 and not self.safe and trouble is None and over is None:
            heard, quiet = self._heard, self._quiet_ticks + 1.0
            newest = k if came is None or came > k else came
            if newest > heard:  # noqa: PLR1730 - at every tick, and `max` takes three times as long
                heard = newest
            silent = (k - heard) // every
            most, _, settle, oldest = self._c
            if (silent <= most and unheard <= most * self._dt and age <= oldest * every
                    and quiet - silent > settle):  # nearly always: full gain stays so
                self._heard, self._quiet_ticks, self._waits, self.lapsed = heard, quiet, False, False
                return 1.0
        timeout_ticks = self._c.timeout_ticks
        self.lapsed = passed > self._lapses
        if self.lapsed:
            self.gain = 0.0
        if got:
            self._hear(k, came, age)
        silent, not_heard = (k - self._heard) // self._every, unheard > timeout_ticks * self._dt
        if trouble is None:
            trouble = self._cause_of(k, passed - 1, silent, not_heard, over)
        if trouble is not None:
            self._enter(k, trouble)
            self._waits = True
        if self._waits:
            silent = _NEVER
        c, quiet = self._c, self._quiet_ticks
        if not_heard:  # it is not released before the other end hears this one; what came has settled it all the same
            quiet = min(quiet, c.settle + silent - passed)
        self.gain, self._quiet_ticks = late_step(c, self.gain, quiet, silent, passed)
        self._shareless = 0 if self.gain > 0.0 else self._shareless + passed
        if self.safe and self._quiet_ticks - silent > c.settle:
            self.safe, self.cause = False, None
            self.tell(k, "released", f"fresh packets for {self._dog.settle:g} s")
        return self.gain

    def _hear(self, k: int, came: int | None, age: int) -> None:
        """A message is there at tick k, sent `age` ticks ago; what `came` is, see `step`."""
        assert self._c is not None
        if age / self._every > self._c.age:
            self._old_k, self.old = k, self.old + 1
            self.oldest = max(self.oldest, age / self._every * self._dt)
            return
        self._heard = max(self._heard, k if came is None else min(k, came))
        self._waits = self._waits and (k - self._heard) // self._every > self._c.timeout_ticks

    def _cause_of(self, k: int, missed: int, silent: int, not_heard: bool, over: str | None) -> str | None:
        """Cause for which this end has to be safe though its device does well; None if it need not.

        `missed`: own ticks that were left out before this one; `silent`: own ticks since a packet came; `not_heard`:
        does the other end say that it hears nothing of this one; `over`: why the session is over, if it is.
        """
        assert self._c is not None
        assert self._dog is not None
        timeout_ticks = self._c.timeout_ticks
        if missed > timeout_ticks or self.lapsed:
            return f"a stall: no tick for {missed * self._dt:.3f} s"
        if over is not None:
            return over
        if silent > timeout_ticks:
            if (k - self._old_k) // self._every <= timeout_ticks:
                return f"age: messages come more than {self._dog.age:g} s after they were sent"
            return f"silence: no fresh packet for {self._dog.timeout:g} s"
        if not_heard and (not self.safe or str(self.cause).startswith("no answer")):
            return f"no answer: the other end has not heard this one for {self._dog.timeout:g} s"
        return None

    def fall(self, passed: int = 1) -> float:
        """The gain `passed` own ticks later with the run over: on its way to 0 along the ramp; no event.

        A stepped end whose scene names no watchdog has the ramp of `UNNAMED` for this.
        """
        step = passed * (self._dog or UNNAMED).limits(self._dt).step
        self.lapsed = passed > self._lapses
        self.gain = self.gain - step if self.gain > step and not self.lapsed else 0.0
        self._shareless = 0 if self.gain > 0.0 else self._shareless + passed
        return self.gain

    def tell(self, k: int, what: str, why: str) -> None:
        """Note an event."""
        if len(self.events) < MOST_EVENTS:
            self.events.append(Event(k, what, why))
            self.new_events.append(self.events[-1])

    def take_events(self) -> list[Event]:
        """The events since this was asked last."""
        events, self.new_events = self.new_events, []
        return events

    def _enter(self, k: int, why: str) -> None:
        kind, before = why.partition(":")[0], (self.cause or "").partition(":")[0]
        self.cause = why
        if not self.safe or kind not in (before, *_QUIET):
            self.entries += not self.safe
            self.safe = True
            self.tell(k, "safe", why)
