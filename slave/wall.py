"""Wall: a spring-damper that fills one side of a plane and cannot pull."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from teleop.errors import Refused, number
from teleop.physics.contact import wall
from teleop.physics.plant import MassDamper, Plant

if TYPE_CHECKING:
    from teleop.physics.implicit import Resistance


@dataclass(frozen=True, kw_only=True, slots=True)
class Wall:
    """A wall of stiffness `k` (N/m) and damping `d` (N s/m) with its surface at `at` (m).

    It fills x > at if `side` is 1 and x < at if `side` is -1. With p the depth and `g = k p + d p'` the
    force on it is g while p > 0 and g > 0, else 0: a slave drawn out faster than the wall can follow
    leaves it before p = 0. `k = d = 0` is no wall at all.
    """

    k: float
    d: float = 0.0
    at: float = 0.0
    side: float = 1.0

    def __post_init__(self) -> None:
        for name in ("k", "d"):
            object.__setattr__(self, name, number(name, getattr(self, name), low=0.0))
        for name in ("at", "side"):
            object.__setattr__(self, name, number(name, getattr(self, name)))
        if self.side not in (-1.0, 1.0):
            raise Refused(f"side must be 1 (the wall fills x > at) or -1 (x < at), not {self.side:g}")

    def plant(self, body: MassDamper, dt: float) -> Plant:
        """Exact step of `body` beside this wall, for ticks of dt seconds."""
        return wall(body, dt, k=self.k, d=self.d, at=self.at, side=self.side)

    def resistance(self) -> Resistance:
        """Coefficients of its force on a body with friction, for `teleop.physics.implicit.implicit_plant`."""
        from teleop.physics.implicit import Resistance
        from teleop.physics.sdirk import WALL

        return Resistance(WALL, self.k, self.d, self.at, self.side)
