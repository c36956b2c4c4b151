"""A tick beside a wall, as the tests of the contact draw it."""

from __future__ import annotations

import math
from typing import NamedTuple


class Case(NamedTuple):
    """A body (mass m, damping b), a wall (k, d), and a tick dt from depth p and inward speed u under f."""

    m: float
    b: float
    k: float
    d: float
    dt: float
    p: float
    u: float
    f: float

    @property
    def w(self) -> float:
        return math.sqrt(self.k / self.m)
