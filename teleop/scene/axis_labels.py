"""Names and units of the axes in what a run leaves, for readers that have the files and not the scene.

A document (`summary.json`, the header of a live record) has the keys `axis_names` and `axis_units` where the scene
gives its axes names or units; without them the axes are called as in `teleop.scene.axes.axis_names`, and are in m.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.scene.axes import FORCE_UNIT, MOST_AXES, axis_names
from teleop.storage.strict_json import Check, list_of, one_of, text

if TYPE_CHECKING:
    from teleop.scene.scene import Scene

SHAPES: dict[str, Check] = {"axis_names": list_of(text, most=MOST_AXES),
                            "axis_units": list_of(one_of(*FORCE_UNIT), most=MOST_AXES)}
TURNING = {"m": "rad", "m/s": "rad/s", "N": "N m", "N/s": "N m/s", "N/m": "N m/rad", "N s/m": "N m s/rad",
           "kg": "kg m^2"}  # the unit of a quantity along an axis that turns, by that along a line


_LONGEST_FIRST = "|".join(sorted(map(re.escape, TURNING), key=len, reverse=True))
_BEHIND = re.compile(rf"(?<=\d )([unmkMG]?)({_LONGEST_FIRST})(?![\w/])")  # a number, with the prefix of the unit


class AxisLabels(NamedTuple):
    """Names and units as a scene gives them; empty: it gives none."""

    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()

    def names_for(self, axes: int) -> tuple[str, ...]:
        """The names of the axes of a record that has so many."""
        return axis_names(self.names if len(self.names) == axes else (), axes)

    def units_for(self, axes: int) -> tuple[str, ...]:
        """The unit of the position, m or rad, of each of so many axes."""
        return self.units if len(self.units) == axes else ("m",) * axes

    def unit(self, unit: str) -> str:
        """A unit of a figure over all axes, by that along a line; empty where some axes turn and others do not.

        >>> AxisLabels(units=("rad", "rad")).unit("N"), AxisLabels().unit("N"), AxisLabels(units=("m", "rad")).unit("s")
        ('N m', 'N', 's')
        """
        units = {unit_on(unit, each) for each in self.units or ("m",)}
        return units.pop() if len(units) == 1 else ""

    def document(self) -> dict[str, list[str]]:
        """The keys of a document; none where the scene gives neither names nor units."""
        return {key: list(labels) for key, labels in zip(SHAPES, self, strict=True) if labels}


def labels_of(scene: Scene) -> AxisLabels:
    """The labels that a scene gives its axes."""
    return AxisLabels(scene.names, scene.axis_units if scene.rotations else scene.units)


def labels_in(document: Mapping[str, Any]) -> AxisLabels:
    """The labels in a document whose shape was checked by `SHAPES`."""
    return AxisLabels(*[tuple(document.get(key) or ()) for key in SHAPES])


def told_along(text: str, axis: str) -> str:
    """A sentence on an axis in m or rad, which was written for one along a line: its units behind numbers.

    >>> told_along("with 0.04 kg and 0.2 N s/m after 5 ms, 3 mm of way", "rad")
    'with 0.04 kg m^2 and 0.2 N m s/rad after 5 ms, 3 mrad of way'
    """
    return _BEHIND.sub(lambda match: match[1] + TURNING[match[2]], text) if axis == "rad" else text


def unit_on(unit: str, axis: str) -> str:
    """The unit of a quantity on an axis in m or rad, by that along a line.

    >>> unit_on("N/m", "rad"), unit_on("N/m", "m"), unit_on("J", "rad")
    ('N m/rad', 'N/m', 'J')
    """
    return TURNING.get(unit, unit) if axis == "rad" else unit
