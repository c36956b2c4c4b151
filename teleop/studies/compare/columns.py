"""The columns of a comparison: which figure of a row each shows, where it counts, and which way is better."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from teleop.scene.axis_labels import TURNING, AxisLabels

LOW, ONE, MORE, NEITHER = "low", "one", "more", ""  # the value that is best: the least, 1, the greatest, none
FREE, TOUCHED, ANY = "free", "touched", "any"  # the environments whose rows count


class Column(NamedTuple):
    """One figure of the rows, told once for each law."""

    key: str  # the figure, by its name in the rows
    head: str  # over the column
    unit: str  # as it is told, of axes along lines
    factor: float  # of the figure's own unit, to tell it
    better: str  # LOW, ONE, MORE or NEITHER, which is not ranked
    where: str
    question: str  # that it answers, in rankings and over figures
    meaning: str


COLUMNS = (
    Column("gain_margin", "gain", "", 1.0, MORE, ANY, "gain margin",
           "factor on the gain of the linear loop that makes it unstable, over links of constant delay; below 1 it is"),
    Column("x_err_rms", "track", "mm", 1e3, LOW, ANY, "tracking error",
           "slave against the master of one delay ago, rms"),
    Column("f_err_rms", "force", "N", 1.0, LOW, ANY, "force error", "felt force against touched force, rms"),
    Column("felt_drag", "drag", "N s/m", 1.0, LOW, FREE, "felt drag",
           "drag that the stack adds to the master where nothing is touched"),
    Column("felt_mass", "mass", "kg", 1.0, NEITHER, FREE, "felt mass",
           "mass that it adds there; below zero where it feels like a spring"),
    Column("wall_late", "wall", "%", 1e2, ONE, TOUCHED, "force on the wall",
           "force on what is touched over the second half of the run, mean, in percent of a rigid rod's"),
    Column("wall_peak", "peak", "%", 1e2, ONE, TOUCHED, "peak force on the wall",
           "largest force on what is touched, in percent of a rigid rod's"),
    Column("felt_share", "stiff", "%", 1e2, ONE, TOUCHED, "felt stiffness",
           "stiffness felt at the end, where the hand rests in contact, in percent of the environment's"),
    Column("jerk_rms", "jerk", "N/s", 1.0, LOW, ANY, "smoothness, rms", "rate of change of the reflected force, rms"),
    Column("jerk_999", "j99.9", "N/s", 1.0, LOW, ANY, "smoothness, 99.9 %",
           "the rate of change that one tick in a thousand exceeds"),
    Column("drift_end", "drift", "mm", 1e3, LOW, FREE, "drift", "slave against master at the end, nothing touched"),
    Column("energy_out", "out", "mJ", 1e3, LOW, ANY, "energy given out",
           "most energy that law and link had given out at the ports beyond what they took up"),
    Column("seed_energy", "seed", "mJ", 1e3, NEITHER, ANY, "seed energy", "energy that the law is given to begin with"),
    Column("sent", "sent", "%", 1e2, NEITHER, ANY, "packets", "packets sent, in percent of the ticks"),
)
BY_KEY = {column.key: column for column in COLUMNS}


def columns_in(units: Iterable[str]) -> dict[str, Column]:
    """The columns by their keys, in the units of axes in m or rad; in no unit where there are both.

    >>> [columns_in(units)["x_err_rms"].unit for units in (["m"], ["rad"], ["m", "rad"])]
    ['mm', 'mrad', '']
    """
    labels = AxisLabels(units=tuple(units))
    return {column.key: _in(column, labels) for column in COLUMNS}


def titled(column: Column) -> str:
    """The question that a column answers, with its unit if it has one."""
    return f"{column.question} ({column.unit})" if column.unit else column.question


def _in(column: Column, labels: AxisLabels) -> Column:
    prefix, base = ("m", "m") if column.unit == "mm" else ("", column.unit)
    if base not in TURNING:
        return column
    if unit := labels.unit(base):
        return column._replace(unit=prefix + unit)
    return column._replace(unit="", factor=1.0, meaning=f"{column.meaning}, over axes in m and in rad")
