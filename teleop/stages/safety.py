"""Watchdog, velocity cap, energy budget, force cap: tick functions that a scene names, in virtual time and live.

They act on the force that the law asks for, in this order: the watchdog's gain, the velocity cap, the energy budget,
the force cap, the slew limit, which comes last so that nothing makes the force jump. What is left is the force that is
held, and what the law is told of as `f_held`.

A force *drives* its device where it pushes the way that goes: f_s v_s > 0 at the slave and, as f_m is against the
hand, -f_m v_m > 0 at the master. Otherwise it brakes. Velocity cap and budget take driving force away and nothing else,
so what they add to a law is dissipation, but for what the hold and the slew limit make of any change of force. `along`
is the velocity reading in the sense of the force: v_s at the slave, -v_m at the master.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from teleop.errors import number


class DogLimits(NamedTuple):
    patience: float  # ticks without a fresh packet that are still fine
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

    def limits(self, dt: float) -> DogLimits:
        # Half a tick of grace, so that a time of n ticks means n whatever n*dt rounds to.
        step = min(1.0, dt / self.ramp) if self.ramp > 0.0 else 1.0
        settle = self.settle / dt + 0.5 if self.settle > 0.0 else 0.0
        age = float("inf") if self.age is None else self.age / dt + 0.5
        return DogLimits(self.timeout / dt + 0.5, step, settle, age)


def watch(c: DogLimits, gain: float, calm: float, silent: int) -> tuple[float, float]:
    """The watchdog's next gain in [0, 1] and count of calm ticks, `silent` ticks after the last fresh packet.

    A run begins with the gain at 1 and `calm` at infinity: nothing has gone wrong yet.
    """
    patience, step, settle, _ = c
    calm = 0.0 if silent > patience else calm + 1.0
    if calm - silent > settle:  # up to the last packet: waiting for another one proves nothing
        return (gain + step if gain < 1.0 - step else 1.0), calm
    return (gain - step if gain > step else 0.0), calm


class CapLimits(NamedTuple):
    f_max: float  # N
    step: float  # N a tick


class SpeedLimits(NamedTuple):
    v_max: float  # m/s
    slope: float  # s/m, of the fading
    f_max: float  # N


class BudgetLimits(NamedTuple):
    full: float  # J
    gain: float  # J a tick


FADES_FROM = 0.9  # of v_max
BURST = 1.0  # s, whose energy the budget holds at most


@dataclass(frozen=True, kw_only=True)
class Cap:
    """|f| <= f_max (N) and |df/dt| <= slew (N/s), per axis; drive at less than v_max (m/s) and with `power` (W) alone.

    At the end of a live run the force goes to zero within `slew` and `v_max`. The work that it does on that way, at
    most |f| ramp/2 + f^2/(2 slew) times the speed, is not counted against `power`.

    `slew`, `v_max` and `power` are left out with None. For the last two see `fade` and `ration`, which say what they
    promise and when.
    """

    f_max: float
    slew: float | None = None
    v_max: float | None = None
    power: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "f_max", number("f_max", self.f_max, low=0.0))
        for name, value, low, above in (
                ("slew", self.slew, None, 0.0), ("v_max", self.v_max, 1e-9, None), ("power", self.power, None, 0.0)):
            if value is not None:
                object.__setattr__(self, name, number(name, value, low=low, above=above))

    def limits(self, dt: float) -> CapLimits:
        """What `cap` computes with."""
        return CapLimits(self.f_max, float("inf") if self.slew is None else self.slew * dt)

    def speed(self) -> SpeedLimits | None:
        """What `fade` computes with."""
        return None if self.v_max is None else SpeedLimits(
            self.v_max, 1.0 / ((1.0 - FADES_FROM) * self.v_max), self.f_max)

    def budget(self, dt: float) -> BudgetLimits | None:
        """What `pay`, `refill` and `ration` compute with."""
        return None if self.power is None else BudgetLimits(self.power * BURST, self.power * dt)


def fade(c: SpeedLimits, f: float, along: float) -> float:
    """`f` within f_max, with what drives the device faded linearly from 0.9 v_max on, to zero at v_max. Per axis.

    A force that brakes is as it was, at any speed. A body of mass M that was below v_max is not driven above it by the
    force of one tick if f_max dt <= 0.1 M v_max, and otherwise at most to 0.9 v_max + f_max dt/M; that is of the
    velocity as it is read, and without a slew limit, with which the force takes up to f_max/slew s to fade. Whatever
    else moves the device (the hand, what it touches) is not in the stack's power. What is faded is the force within
    f_max: of a law that asks for a hundred times that, no more than the last hundredth of the band would take any.

    NaN of force or velocity stays NaN: it must be seen.
    """
    v_max, slope, f_max = c
    forth = max(min((v_max - along) * slope, 1.0), 0.0)
    back = max(min((v_max + along) * slope, 1.0), 0.0)
    return forth * max(min(f, f_max), 0.0) + back * min(max(f, -f_max), 0.0)


def pay(left: float, work: float) -> float:
    """What is left (J) of an end's budget when the held force did `work` (J) on the device along one axis.

    Work that is taken from the device (below zero) does not fill the budget.
    """
    return left - max(work, 0.0)


def refill(c: BudgetLimits, left: float) -> float:
    """What is left of an end's budget with what it gains in a tick: at most the energy of one second.

    Ticks that a live end missed gain nothing: less than the bound is always safe.
    """
    full, gain = c
    return min(left + gain, full)


def ration(c: BudgetLimits, left: float, f: float, along: float) -> float:
    """`f`, or what of it brakes the device while the end's budget is empty, left <= 0. Per axis.

    At rest there is nothing to brake, and no force. Over any ticks i .. j, with T = (j - i) dt, the sum of `pay` and
    `refill` telescopes: the work W that the end's held forces did on its device, as it is read and counted wherever
    it was above zero, axis by axis, is

        W <= left(i) - left(j) + power T <= power (1 s + T) + D,    D = max(0, -left(j))

    What is owed, D, is work done past empty. While the budget is empty nothing drives, so it is the work of the one
    held force that emptied it, at most |f||dx| of one tick; with a slew limit the force is f/slew s in falling, and
    does another f^2/(2 slew) times the speed at most.

    What brakes at the tick may drive before the next: it stops the device and takes it the other way. From rest on, a
    free body M is given up to f^2 dt^2/(2M) so, and a damper above 2M/dt does it at every tick. That is paid for too,
    and where an end owes the energy of one second no force is let through at all, so that without a slew limit

        W <= power (2 s + T) + |f||dx| of one tick

    whatever law, device and environment are. NaN of any of these stays NaN: it must be seen.
    """
    full, _ = c
    some, braking = left > 0.0, left > -full
    forth = some | (braking & (along < 0.0))
    back = some | (braking & (along > 0.0))
    return forth * max(f, 0.0) + back * min(f, 0.0) + 0.0 * (left + along)


def cap(c: CapLimits, f: float, f_held: float) -> float:
    """`f` within the cap, and within one tick's slew of `f_held`. NaN stays NaN: it must be seen."""
    f_max, step = c
    # min and max keep their first argument when the comparison with NaN fails.
    return max(min(max(min(f, f_max), -f_max), f_held + step), f_held - step)
