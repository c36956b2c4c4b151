"""How far two ends stand apart in orientation: the angle of their relative rotation, from the quaternions recorded."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import count, takewhile
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


def quaternions(trace: Mapping[str, Any], e: str) -> list[NDArray[np.float64]]:
    """The orientation of each rotation of an end, m or s, as (w, x, y, z) in rows: of shape (4, ticks)."""
    import numpy as np

    numbers = takewhile(lambda n: f"qw{n}_{e}" in trace, ("" if i == 1 else str(i) for i in count(1)))
    return [np.stack([trace[f"q{part}{n}_{e}"] for part in "wxyz"]) for n in numbers]


def angle_error(trace: Mapping[str, Any], ticks: NDArray[np.int64], lag: int) -> NDArray[np.float64]:
    """The angle (rad) from the slave's orientation to that of the master `lag` ticks before, at every tick.

    Of several rotations the greatest; NaN before the first tick at which both exist.
    """
    import numpy as np

    at = np.searchsorted(ticks, ticks - lag, side="right") - 1
    has = at >= 0
    size = np.full(len(ticks), np.nan)
    for master, slave in zip(quaternions(trace, "m"), quaternions(trace, "s"), strict=True):
        a, b = master[:, at[has]], slave[:, has]
        with np.errstate(all="ignore"):
            along = np.abs((a * b).sum(axis=0))
            across = np.linalg.norm(a[0] * b[1:] - b[0] * a[1:] + np.cross(a[1:], b[1:], axis=0), axis=0)
            size[has] = np.fmax(size[has], 2.0 * np.arctan2(across, along))
    return size
