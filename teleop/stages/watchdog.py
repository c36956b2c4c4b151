"""The watchdog: without fresh packets the force goes to zero along a ramp. Its gain is recorded as `g`.

A live end has more causes to let go than silence, so there the gain comes from the one place that knows them all,
`teleop.protocol.guard`, which calls the same `watchdog_step`.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Any, ClassVar, NamedTuple

from teleop.errors import number
from teleop.stages.end import Column, End, Places, Run, Stage


class WatchdogLimits(NamedTuple):
    timeout_ticks: float  # ticks without a fresh packet that are still fine
    step: float  # change of the gain a tick
    settle: float  # ticks from the first packet after a silence to the last, before the gain rises again
    age: float  # ticks: a message that is older when it is played is none


@dataclass(frozen=True, kw_only=True)
class Watchdog:
    """No fresh packet for `timeout` seconds: the force ramps to zero over `ramp` seconds.

    When packets have come again, and for `settle` seconds were never apart by more than `timeout`, the force ramps
    back over the same time; until then the ramp to zero goes on. The time is from the first of these packets to the
    last, so one by itself lifts nothing, save with `settle=0`, where it is enough. Silence counts from the start of
    the run, so over a link slower than `timeout` the first thing that happens is a ramp.

    A message that is older than `age` seconds at the tick that plays it counts as none here: packets that come one
    after another over a delay that has grown say that the link is there, not that the hand still is where they say.
    The law gets it all the same, so what lets go is the ramp alone. None: a message may be of any age.
    """

    timeout: float = 0.1
    ramp: float = 0.05
    settle: float = 0.1
    age: float | None = 2.5

    def __post_init__(self) -> None:
        number("timeout", self.timeout, above=0.0)
        number("ramp", self.ramp, low=0.0)
        number("settle", self.settle, low=0.0)
        if self.age is not None:
            number("age", self.age, above=0.0)

    def limits(self, dt: float) -> WatchdogLimits:
        # Half a tick of grace, so that a time of n ticks means n whatever n*dt rounds to.
        step = min(1.0, dt / self.ramp) if self.ramp > 0.0 else 1.0
        settle = self.settle / dt + 0.5 if self.settle > 0.0 else 0.0
        age = float("inf") if self.age is None else self.age / dt + 0.5
        return WatchdogLimits(self.timeout / dt + 0.5, step, settle, age)


def watchdog_step(c: WatchdogLimits, gain: float, quiet_ticks: float, silent: float) -> tuple[float, float]:
    """The watchdog's next gain, in [0, 1], and next `quiet_ticks`, `silent` ticks after the last fresh packet.

    `quiet_ticks` counts the ticks since silence was last longer than the timeout. A run begins with the gain at 1 and
    `quiet_ticks` at infinity: nothing has gone wrong yet.
    """
    timeout_ticks, step, settle, _ = c
    quiet_ticks = 0.0 if silent > timeout_ticks else quiet_ticks + 1.0
    if quiet_ticks - silent > settle:  # up to the last packet: waiting for another one proves nothing
        return (gain + step if gain < 1.0 - step else 1.0), quiet_ticks
    return (gain - step if gain > step else 0.0), quiet_ticks


def late_step(c: WatchdogLimits, gain: float, quiet_ticks: float, silent: float, passed: float) -> tuple[float, float]:
    """The same after `passed` ticks, of which the last alone is run: time counts, so it goes down by all their steps.

    The way up is a step for each tick that is run: a force that comes back must not jump.
    """
    timeout_ticks, step, settle, age = c
    quiet_ticks = quiet_ticks + (passed - 1.0)
    if silent > timeout_ticks or quiet_ticks + 1.0 - silent <= settle:
        c = WatchdogLimits(timeout_ticks, min(1.0, step * passed), settle, age)
    return watchdog_step(c, gain, quiet_ticks, silent)


def watch_late(
    c: WatchdogLimits, gain: float, quiet_ticks: float, waits: float, silent: float, passed: float
) -> tuple[float, float, float]:
    """The next gain, `quiet_ticks` and `waits` of a run in virtual time after `passed` ticks, as a live end has them.

    More ticks left out than the timeout has are a stall, which counts as silence, until the next message (`waits`, 1.0
    or 0.0): what waited meanwhile does not show that its sender is still there.
    """
    waits = 1.0 if passed - 1.0 > c.timeout_ticks or silent > c.timeout_ticks or (waits > 0.0 and silent > 0.0) else 0.0
    gain, quiet_ticks = late_step(c, gain, quiet_ticks, inf if waits > 0.0 else silent, passed)
    return gain, quiet_ticks, waits


class WatchdogStage(Stage):
    """The gain of an end, by which the force of each of its axes is multiplied."""

    name: ClassVar[str] = "watchdog"
    g: float  # the gain
    g_held: float  # of a live end the same at its last tick
    c_dog: WatchdogLimits
    heard: Any  # the tick at which a fresh message was played last
    quiet_ticks: float
    waits: float  # 1.0 after a stall, until a message comes
    passed: Any  # ticks since the last

    @staticmethod
    def structure(end: Any) -> Any:
        """True if a message beyond an age counts as none. Of a live end without a watchdog there is None."""
        return end.scene.watchdog.age is not None

    def __init__(self, e: End, structure: Any) -> None:
        super().__init__(e, structure)
        self.aged, self.recorded = structure is True, structure is not None

    @staticmethod
    def numbers(scene: Any, e: str, dt: float, places: Places) -> Any:
        return scene.watchdog.limits(dt)

    def columns(self, e: End) -> tuple[Column, ...]:
        return (Column(f"g_{e.name}", ((self, "g"),)),) if self.recorded else ()

    def begin(self, run: Run, e: End, numbers: Any) -> None:
        if not e.has.live:
            self.c_dog = numbers
            self.heard = -1
            self.quiet_ticks = inf
            if e.has.leaves_out:
                self.waits = 0.0
            self.g = 1.0

    def late(self, run: Run, e: End, ticks: int, since: int) -> None:
        if not e.has.live:
            self.passed = ticks

    def act(self, run: Run, e: End, k: int) -> None:
        if not e.has.live:
            self.listen(run, e, k)
        if e.has.leaves_out and not e.has.live:
            self.g, self.quiet_ticks, self.waits = watch_late(
                self.c_dog, self.g, self.quiet_ticks, self.waits, k - self.heard, self.passed)
        elif not e.has.live:
            self.g, self.quiet_ticks = watchdog_step(self.c_dog, self.g, self.quiet_ticks, k - self.heard)
        for a in e.axes:
            a.f_cmd = self.g * a.f_cmd

    def listen(self, run: Run, e: End, k: int) -> None:
        """Note the tick of a fresh message that is not too old."""
        if self.aged:
            self.heard = k if e.got and k - e.newest <= self.c_dog.age else self.heard
        else:
            self.heard = k if e.got else self.heard
