"""A column of a record as a curve of some hundred points: the least and the greatest value in each column of pixels.

So a spike of one tick in an hour is still seen, and what is drawn of a million rows is no larger than of a thousand.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.report.scales import GREATEST
from teleop.simulation.trace import blocks

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray


class Line(NamedTuple):
    """What is drawn of a curve: arrays of shape (points,); where `least` is NaN, there is a gap."""

    x: NDArray[Any]  # from 0 to 1 along the axis
    least: NDArray[Any]
    greatest: NDArray[Any]

    def range(self) -> tuple[float, float]:
        """The least and the greatest value of all, (inf, -inf) of none."""
        import numpy as np

        known = np.isfinite(self.least)
        return (float(self.least[known].min(initial=np.inf)), float(self.greatest[known].max(initial=-np.inf)))


def line_of(t: NDArray[Any], values: NDArray[Any], low: float, high: float, columns: int) -> Line:
    """The curve of `values` (rows,) at times `t` (rows,), which grow, over `low` .. `high` in `columns` of pixels.

    With fewer than two rows a column each row is a point. A value that is not finite, or beyond `GREATEST`, is a gap.
    """
    import numpy as np

    if len(t) < 2 * columns:
        sound = _sound(np.asarray(values, dtype=float))
        return Line((np.asarray(t, dtype=float) - low) / (high - low), sound, sound)
    least, greatest = np.full(columns, np.inf), np.full(columns, -np.inf)
    for place, begin, part in _parts(t, values, low, high, columns):
        least[place] = np.fmin(least[place], np.fmin.reduceat(part, begin))
        greatest[place] = np.fmax(greatest[place], np.fmax.reduceat(part, begin))
    nothing = ~np.isfinite(least)
    least[nothing] = greatest[nothing] = np.nan
    return Line((np.arange(columns) + 0.5) / columns, least, greatest)


def _parts(t: NDArray[Any], values: NDArray[Any], low: float, high: float, columns: int
           ) -> Iterator[tuple[NDArray[Any], NDArray[Any], NDArray[Any]]]:
    """Of each block of rows the columns that it has rows in, where their rows begin, and the values."""
    import numpy as np

    for block in blocks(len(t)):
        at = (np.asarray(t[block], dtype=float) - low) * (columns / (high - low))
        place = np.clip(at.astype(np.int64), 0, columns - 1)
        begin = np.flatnonzero(np.diff(place, prepend=-1))
        yield place[begin], begin, _sound(np.asarray(values[block], dtype=float))


def _sound(values: NDArray[Any]) -> NDArray[Any]:
    import numpy as np

    return np.where(np.abs(values) <= GREATEST, values, np.nan)
