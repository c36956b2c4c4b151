"""Single steps of the stack's own beside those of a reference, from the same states, at every tick of a run."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite


@dataclass(slots=True)
class Steps:
    """What a comparison of single steps comes to: how many there were, and the largest differences.

    A step is one body in one axis over one tick.
    """

    count: int = 0
    integrated: int = 0  # by the stack itself, without a closed form
    changes: int = 0  # steps in which the reference located a change of contact or of sticking
    gave_up: int = 0  # steps that the reference's integrator did not finish
    x: float = 0.0  # largest difference, m
    v: float = 0.0  # largest difference, m/s

    def add(self, own: tuple[float, float], other: tuple[float, float], *, changed: bool, integrated: bool = False
            ) -> None:
        """Count one step: (x, v) after the stack's own and after the reference's. What diverged is not compared."""
        self.count += 1
        self.changes += changed
        self.integrated += integrated
        if not all(map(isfinite, own)):
            return
        dx, dv = abs(own[0] - other[0]), abs(own[1] - other[1])
        if isfinite(dx + dv):
            self.x, self.v = max(self.x, dx), max(self.v, dv)
        else:
            self.gave_up += 1
