"""The curves along which a loop's roots are counted: about the unit circle, or about the right half-plane."""

from __future__ import annotations

from collections.abc import Callable
from math import acos, pi
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Points = NDArray[np.complex128]

EDGE = 1e-11  # how far outside the unit circle the curve runs, so that a pole on it is inside


class Curve(NamedTuple):
    """The upper half of a curve that is symmetric to the real axis; roots are counted on its far side."""

    point: Callable[[Any], Points]  # for a parameter from 0 to `length`
    length: float
    exponent: Callable[[Points], Points]  # by which a delay multiplies: log z, or s
    outside: Callable[[Points], Any]
    closed: bool  # does it end on the real axis, or at infinity


def reach(radius: float) -> float:
    """The radius at which `circle` runs: from the unit circle on, `EDGE` farther outside."""
    return radius + EDGE if radius >= 1.0 else radius


def circle(radius: float, indent: float) -> Curve:
    """|z| = `radius`; the unit circle and what is as near to it passes z = 1 at the distance `indent`."""
    import numpy as np

    far = reach(radius)
    if not 1.0 <= far < 1.0 + indent:
        return Curve(lambda t: far * np.exp(1j * pi * t), 1.0, np.log, lambda z: np.abs(z) > far, True)
    turn = acos(((far - 1.0) * (far + 1.0) - indent * indent) / (2.0 * indent))
    leave = float(np.angle(1.0 + indent * np.exp(1j * turn)))

    def point(t: Any) -> Points:
        around = 1.0 + indent * np.exp(1j * turn * np.minimum(t, 1.0))
        along: Points = np.where(t <= 1.0, around, far * np.exp(1j * (leave + (pi - leave) * (t - 1.0))))
        return along

    return Curve(point, 2.0, np.log, lambda z: (np.abs(z) > far) & (np.abs(z - 1.0) > indent), True)


def about_one(indent: float) -> Curve:
    """The small circle that `circle` leaves out, seen from outside."""
    import numpy as np

    return Curve(lambda t: 1.0 + indent * np.exp(1j * pi * t), 1.0, np.log, lambda z: np.abs(z - 1.0) > indent, True)


def imaginary_axis(indent: float, top: float) -> Curve:
    """s = i w up to `top` (rad/s), passing s = 0 at `indent` on the right; the right half-plane is its far side."""
    import numpy as np

    def point(t: Any) -> Points:
        around = indent * np.exp(0.5j * pi * np.minimum(t, 1.0))
        along: Points = np.where(t <= 1.0, around, 1j * indent * (top / indent) ** np.maximum(t - 1.0, 0.0))
        return along

    return Curve(point, 2.0, lambda s: s, lambda s: (s.real > 0.0) & (np.abs(s) > indent), False)
