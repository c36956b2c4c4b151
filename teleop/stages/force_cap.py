"""The force cap and its slew limit, which come last, so that nothing makes the force jump.

What stands before them acts on the force that the law asks for in this order: the watchdog's gain, the velocity cap,
the energy budget. What is left is the force that is held, and what the law is told of as `f_held`.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Any, ClassVar, NamedTuple

from teleop.errors import number
from teleop.stages.end import End, Places, Run, Stage
from teleop.stages.energy_budget import BURST, BudgetLimits
from teleop.stages.velocity_cap import FADES_FROM, SpeedLimits

LONGEST = 1.0  # s for which a slew limit holds a force of which the law has no share any more


class CapLimits(NamedTuple):
    f_max: float  # N
    step: float  # N a tick
    most: float = inf  # ticks without any share of the law's force, after which none is held


@dataclass(frozen=True, kw_only=True)
class Cap:
    """|f| <= f_max (N) and |df/dt| <= slew (N/s), per axis; drive at less than v_max (m/s) and with `power` (W) alone.

    A force that is let go (by the watchdog, the operator's clutch, or the end of a live run) goes to zero within `slew`
    and `v_max`, and takes at most `LONGEST` seconds beyond its ramp: what is left then goes in one step. The work that
    it does on that way, at most |f| ramp/2 + f^2/(2 slew) times the speed, is not counted against `power`.

    Each is left out with None. For the last two see `limit_speed` and `limit_power`, which say what they promise and
    when.
    """

    f_max: float | None = None
    slew: float | None = None
    v_max: float | None = None
    power: float | None = None

    def __post_init__(self) -> None:
        for name, value, low, above in (
                ("f_max", self.f_max, 0.0, None), ("slew", self.slew, None, 0.0),
                ("v_max", self.v_max, 1e-9, None), ("power", self.power, None, 0.0)):
            if value is not None:
                object.__setattr__(self, name, number(name, value, low=low, above=above))

    @classmethod
    def of(cls, *, f_max: float | None = None, slew: float | None = None, v_max: float | None = None,
           power: float | None = None) -> Cap | None:
        """The cap with these limits; None without any, so that a scene has no cap."""
        none = f_max is slew is v_max is power is None
        return None if none else cls(f_max=f_max, slew=slew, v_max=v_max, power=power)

    @property
    def most(self) -> float:
        """The greatest force, N; inf where `f_max` is left out."""
        return inf if self.f_max is None else self.f_max

    def limits(self, dt: float) -> CapLimits:
        """Coefficients of `cap`."""
        return CapLimits(self.most, inf if self.slew is None else self.slew * dt, LONGEST / dt + 0.5)

    def speed(self) -> SpeedLimits | None:
        """Coefficients of `limit_speed`; None without a velocity cap."""
        return None if self.v_max is None else SpeedLimits(
            self.v_max, 1.0 / ((1.0 - FADES_FROM) * self.v_max), self.most)

    def budget(self, dt: float) -> BudgetLimits | None:
        """Coefficients of `spend`, `refill` and `limit_power`; None without a power budget."""
        return None if self.power is None else BudgetLimits(self.power * BURST, self.power * dt)


def caps(scene: Any) -> tuple[Cap, ...]:
    """The cap of each axis of a scene that has one; on an axis without, one that limits nothing."""
    return tuple([Cap() if each is None else each for each in scene.per_axis("cap")])


def cap(c: CapLimits, f: float, f_held: float) -> float:
    """`f` within the cap, and within one tick's slew of `f_held`. NaN stays NaN: it must be seen."""
    f_max, step, _ = c
    # min and max keep their first argument when the comparison with NaN fails.
    return max(min(max(min(f, f_max), -f_max), f_held + step), f_held - step)


def let_go(c: CapLimits, gain: float, since: float) -> CapLimits:
    """The limits of a tick before which the force was held for `since` ticks, at the watchdog's gain.

    The slew is that of one tick, however long it was held, for a jump is what the limit is against. But let go after a
    stall, at gain 0, it slews what it could have slewed in the meantime.
    """
    f_max, step, most = c
    return CapLimits(f_max, step * since if gain <= 0.0 else step, most)


def share(e: End) -> Any:
    """The share of the law's force that is held: that of the watchdog, and of the operator's clutch."""
    if e.stage.watchdog and e.stage.operator and not e.has.live:
        return e.stage.watchdog.g * clutch_modulus(e.stage.operator)
    return clutch_modulus(e.stage.operator) if e.stage.operator else e.stage.watchdog.g


def clutch_modulus(operator: Any) -> Any:
    """The modulus of the operator's clutch; of one that may open for some axes the greatest."""
    return max(operator.groups[0].g, operator.groups[1].g) if operator.several else operator.groups[0].g


def without_share(share: float, ticks: float, passed: float) -> float:
    """The number of ticks since the law last had a `share` of the force, `passed` ticks after it was `ticks`."""
    return 0.0 if share > 0.0 else ticks + passed


def still_held(c: CapLimits, ticks: float, f_held: float) -> float:
    """The force from which the slew limit counts, `ticks` after the law last had a share of it: none after `most`."""
    return 0.0 if ticks > c.most else f_held


class OverflowStage(Stage):
    """A force that is infinite becomes NaN before the cap, which would make a plausible one of it: it must be seen."""

    name: ClassVar[str] = "overflow"

    def act(self, run: Run, e: End, k: int) -> None:
        for a in e.axes:
            a.f_cmd = a.f_cmd + 0.0 * a.f_cmd


class ForceCapStage(Stage):
    """The force cap and slew limit of `Cap(f_max=..., slew=...)`, axis by axis."""

    name: ClassVar[str] = "force_cap"
    c_cap: tuple[CapLimits, ...]  # for each axis
    held_for: Any  # ticks since the force was set
    passed_by: Any  # ticks since the last
    shareless: Any  # ticks since the law last had a share of the force

    @staticmethod
    def structure(end: Any) -> Any:
        """True if its force has a slew limit, and a gain by which it is let go."""
        let_go = end.scene.watchdog is not None or (end.e == "m" and end.scene.operator is not None)
        return let_go and any(each.slew is not None for each in caps(end.scene))

    def __init__(self, e: End, structure: Any) -> None:
        super().__init__(e, structure)
        self.slewed = structure

    @staticmethod
    def numbers(scene: Any, e: str, dt: float, places: Places) -> Any:
        return tuple([cap.limits(dt) for cap in caps(scene)])

    def begin(self, run: Run, e: End, numbers: Any) -> None:
        self.c_cap = numbers
        if self.slewed:
            self.shareless = 0.0

    def late(self, run: Run, e: End, ticks: int, since: int) -> None:
        self.held_for = since
        self.passed_by = ticks

    def act(self, run: Run, e: End, k: int) -> None:
        if self.slewed:
            self.shareless = without_share(share(e), self.shareless, self.passed_by if e.has.leaves_out else 1.0)
        for a in e.axes:
            f_held = still_held(self.c_cap[a.i], self.shareless, a.f) if self.slewed else a.f
            if e.has.leaves_out and e.stage.watchdog:
                a.f_cmd = cap(let_go(self.c_cap[a.i], e.stage.watchdog.g, self.held_for), a.f_cmd, f_held)
            else:
                a.f_cmd = cap(self.c_cap[a.i], a.f_cmd, f_held)
