"""Hunt-Crossley contact: a spring that stiffens with depth and whose damping grows with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from teleop.errors import Refused, number
from teleop.physics.implicit import Resistance
from teleop.physics.sdirk import HUNT_CROSSLEY


@dataclass(frozen=True, kw_only=True, slots=True)
class HuntCrossley:
    """A body of stiffness `k` (N/m^n), exponent `n` and damping `lam` (s/m) with its surface at `at` (m).

    It fills x > at if `side` is 1 and x < at if `side` is -1. With p the depth the force on it is
    `k p^n max(0, 1 + lam p')` while p > 0, else 0: no jump at the touch, where a spring beside a damper has one,
    and no pull. n = 1.5 is Hertz's contact of two spheres. A blow at a small speed v_i comes back with the
    restitution `e = 1 - (2/3) lam v_i` to first order, for every n. Hunt & Crossley, J. Appl. Mech. 42 (1975);
    Marhefka & Orin, IEEE Trans. SMC A 29 (1999).
    """

    inner: ClassVar[bool] = True  # no closed form: the plant that follows it keeps an inner state

    k: float
    n: float = 1.5
    lam: float = 0.0
    at: float = 0.0
    side: float = 1.0

    def __post_init__(self) -> None:
        for name in ("k", "lam"):
            object.__setattr__(self, name, number(name, getattr(self, name), low=0.0))
        object.__setattr__(self, "n", number("n", self.n, low=1.0, high=10.0))
        for name in ("at", "side"):
            object.__setattr__(self, name, number(name, getattr(self, name)))
        if self.side not in (-1.0, 1.0):
            raise Refused(f"side must be 1 (it fills x > at) or -1 (x < at), not {self.side:g}")

    def resistance(self) -> Resistance:
        """Coefficients of its force on a body, for `teleop.physics.implicit.implicit_plant`."""
        return Resistance(HUNT_CROSSLEY, self.k, 0.0, self.at, self.side, self.n, self.lam)
