"""The knobs of a sweep on the axes and over the panels of a figure."""

from __future__ import annotations

from teleop.report.scales import Axis, along
from teleop.sweeps.pictures.layout import PlottedKnob, spaced


def axis_of(knob: PlottedKnob) -> Axis:
    """The axis of a knob with numbers, spaced as its values are."""
    return along(knob.values, *spaced(knob.values))


def plain(title: str) -> str:
    """A title without what matplotlib would need before a dollar sign."""
    return title.replace(r"\$", "$").replace("\n", ", ")
