"""Standard linear solid: tissue that yields with time, which the slave stays bonded to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from teleop.errors import number
from teleop.physics.plant import MassDamper, Plant
from teleop.physics.relaxing import relaxing


@dataclass(frozen=True, kw_only=True, slots=True)
class StandardLinearSolid:
    """A spring `k` (N/m) in parallel with a spring `k1` (N/m) that relaxes within `tau` (s), at rest at `at` (m).

    `f_env = k (x - at) + phi` with `phi' = k1 v - phi/tau`: as stiff as k + k1 against a quick push, as k in the
    long run; held still, the force falls to the lasting one as exp(-t/tau). It is the model of Zener with k1 in
    series with a dashpot k1 tau (Y. C. Fung, "Biomechanics", 2nd ed., Springer 1993, section 2.11). k1 = 0 is a
    spring; a short tau makes the branch a damper of k1 tau, a long one a second spring. It pulls as well as
    it pushes. However far from `at` the slave starts, phi starts at 0.
    """

    inner: ClassVar[bool] = True  # its plants have an inner state: (phi,)

    k: float
    k1: float
    tau: float
    at: float = 0.0

    def __post_init__(self) -> None:
        for name in ("k", "k1"):
            object.__setattr__(self, name, number(name, getattr(self, name), low=0.0))
        object.__setattr__(self, "tau", number("tau", self.tau, above=0.0))
        object.__setattr__(self, "at", number("at", self.at))

    def plant(self, body: MassDamper, dt: float) -> Plant:
        """Exact step of `body` bonded to this solid, for ticks of dt seconds."""
        return relaxing(body, dt, k=self.k, k1=self.k1, tau=self.tau, at=self.at)
