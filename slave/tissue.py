"""Tissue: a spring-damper that the slave stays bonded to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from teleop.errors import number
from teleop.physics.plant import MassDamper, Plant, spring_damper

if TYPE_CHECKING:
    from teleop.physics.implicit import Resistance


@dataclass(frozen=True, kw_only=True, slots=True)
class Tissue:
    """A spring `k` (N/m) and a damper `d` (N s/m) at rest at `at` (m): `f_env = k (x - at) + d v`.

    Unlike a wall it pulls as well as it pushes, on both sides of `at`.
    """

    k: float
    d: float
    at: float = 0.0

    def __post_init__(self) -> None:
        for name in ("k", "d"):
            object.__setattr__(self, name, number(name, getattr(self, name), low=0.0))
        object.__setattr__(self, "at", number("at", self.at))

    def plant(self, body: MassDamper, dt: float) -> Plant:
        """Exact step of `body` bonded to this tissue, for ticks of dt seconds."""
        return spring_damper(body, dt, k=self.k, d=self.d, at=self.at)

    def resistance(self) -> Resistance:
        """Coefficients of its force on a body with friction, for `teleop.physics.implicit.implicit_plant`."""
        from teleop.physics.implicit import Resistance
        from teleop.physics.sdirk import BOND

        return Resistance(BOND, self.k, self.d, self.at)
