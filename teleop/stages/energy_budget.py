"""The energy budget: an end's forces do no more work on its device than a power and one second of it allow.

A force *drives* its device where it pushes the way that goes: f_s v_s > 0 at the slave and, as f_m is against the
hand, -f_m v_m > 0 at the master. Otherwise it brakes. An empty budget takes driving force away and nothing else.
What is left of it is recorded as `E_left`.
"""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

from teleop.stages.end import Column, End, Places, Run, Stage


class BudgetLimits(NamedTuple):
    full: float  # J
    gain: float  # J a tick


BURST = 1.0  # s, whose energy the budget holds at most


def spend(left: float, work: float) -> float:
    """Energy left (J) of an end's budget when the held force did `work` (J) on the device along one axis.

    Work that is taken from the device (below zero) does not fill the budget.
    """
    return left - max(work, 0.0)


def refill(c: BudgetLimits, left: float) -> float:
    """Energy left of an end's budget with its gain in a tick: at most the energy of one second."""
    full, gain = c
    return min(left + gain, full)


def limit_power(c: BudgetLimits, left: float, f: float, along: float) -> float:
    """`f`, or what of it brakes the device while the end's budget is empty, left <= 0. Per axis.

    After ticks that were left out an end gains what these had gained: T is the time that passes, and the work of the
    force that was held over them is spent at their end. So "one tick" below is as long as a force is held.

    At rest there is nothing to brake, and no force. Over any ticks i .. j, with T = (j - i) dt, the sum of `spend` and
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


class EnergyBudgetStage(Stage):
    """The energy budget of `Cap(power=...)`; one for all axes of an end."""

    name: ClassVar[str] = "energy_budget"
    wants_dx: ClassVar[bool] = True
    c_power: BudgetLimits
    E_left: float
    gained: Any  # ticks that it gains for at this one

    @staticmethod
    def numbers(scene: Any, e: str, dt: float, places: Places) -> Any:
        return scene.per_axis("cap")[0].budget(dt)  # the same on all

    def columns(self, e: End) -> tuple[Column, ...]:
        return (Column(f"E_left_{e.name}", ((self, "E_left"),)),)

    def begin(self, run: Run, e: End, numbers: Any) -> None:
        self.c_power = numbers
        self.E_left = self.c_power.full

    def late(self, run: Run, e: End, ticks: int, since: int) -> None:
        self.gained = ticks

    def act(self, run: Run, e: End, k: int) -> None:
        for a in e.axes:
            self.E_left = spend(self.E_left, a.f * (-a.dx if e.name == "m" else a.dx))
        if e.has.leaves_out:
            self.E_left = refill(BudgetLimits(self.c_power.full, self.c_power.gain * self.gained), self.E_left)
        else:
            self.E_left = refill(self.c_power, self.E_left)
        for a in e.axes:
            a.f_cmd = limit_power(self.c_power, self.E_left, a.f_cmd, -a.v_read if e.name == "m" else a.v_read)
