"""Which axes of a run a figure draws, and how they lie in it: few in one panel, more in a panel each.

Of more axes than a figure has room for, those are drawn over which the forces of the stack did most work: work is in J
on every axis, so that axes in m and in rad compare.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from teleop.errors import enumerated
from teleop.scene.axis_labels import AxisLabels, unit_on

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

TOGETHER = 3  # axes that share a panel, each with a line of its own
APART = 6  # axes in panels of their own
_PORTS = (("f_m", "x_m"), ("f_s", "x_s"))


def axes_of(trace: Mapping[str, Any]) -> int:
    """How many axes a trace has."""
    return max((column.shape[1] for name in ("x_m", "x_s") if name in trace
                for column in [trace[name]] if column.ndim > 1), default=1)


def most_worked(trace: Mapping[str, Any], most: int) -> list[int]:
    """The axes that are drawn, at most so many, in order of the axes."""
    count = axes_of(trace)
    if count <= most:
        return list(range(count))
    work = work_of(trace)
    return sorted(sorted(range(count), key=lambda i: (-work[i], i))[:most])


def work_of(trace: Mapping[str, Any]) -> NDArray[np.float64]:
    """What the stack's forces did along each of several axes at both ends, whatever its sign, summed up, J."""
    import numpy as np

    work = np.zeros(axes_of(trace))
    with np.errstate(all="ignore"):  # of a run that diverged
        for force, place in _PORTS:
            if force in trace and place in trace:
                work += np.nansum(np.abs(trace[force][:-1] * np.diff(trace[place], axis=0)), axis=0)
    return work


def left_out(trace: Mapping[str, Any], shown: Sequence[int], labels: AxisLabels) -> str:
    """A sentence on the axes that are not drawn; empty if all are."""
    count = axes_of(trace)
    if len(shown) == count:
        return ""
    names = labels.named(count)
    return (f"{len(shown)} of {count} axes are drawn, those over which the forces of the stack did most work: "
            f"{enumerated([names[i] for i in shown])}")


def by_unit(unit: str, shown: Sequence[int], labels: AxisLabels, count: int) -> dict[str, list[int]]:
    """The axes that go on one scale, by their unit, of a quantity whose unit along a line is `unit`."""
    units = labels.in_units(count)
    found: dict[str, list[int]] = {}
    for i in shown:
        found.setdefault(unit_on(unit, units[i]), []).append(i)
    return found
