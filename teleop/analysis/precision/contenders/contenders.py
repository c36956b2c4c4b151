"""A contender: one way to move the bodies of a scene, to be measured against the others."""

from __future__ import annotations

from dataclasses import dataclass

from teleop.simulation.bodies import Bodies


@dataclass(frozen=True, kw_only=True, slots=True)
class Contender:
    """A way to move the bodies: the stack's own, a fixed-step method with `substeps`, or scipy's solver with `rtol`.

    The stack's own is `exact` where every body has a closed form, else `default`.
    """

    method: str
    label: str
    bodies: Bodies
    substeps: int | None = None
    rtol: float | None = None

    @property
    def step(self) -> str:
        """Number of its sub-steps, or its rtol."""
        return str(self.substeps) if self.substeps else f"{self.rtol:.0e}" if self.rtol else ""

    @property
    def key(self) -> str:
        """Name among all contenders, for example `rk4/16`."""
        return f"{self.method}/{self.step}" if self.step else self.method
