"""Readings on the three axes of a rotation from a device that measures its orientation."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite, sqrt

from teleop.errors import DeviceError
from teleop.physics.rotation import Quaternion, Vector3, log, product, unit

FAR = 1e-3  # from 1: the length of a quaternion that is none


class RotationAxes:
    """The coordinates phi of three rotation axes, counted along a stream of unit quaternions.

    At the first quaternion phi is its rotation vector; each later one adds log(q q_before^-1), the shortest turn from
    the one before, so phi goes on beyond pi and never comes back by itself. A device that turns by more than half a
    turn from one `phi` to the next is seen to turn the other way. q and -q are the same orientation. The orientation
    that the stage counts from this phi is that of the device again, to rounding.

    All directions are the world's, which both ends share. For the `Reading` of a tick:

        phi = self.rotation.phi(q)
        Reading(x=(*place, *phi), v=(*velocity, *angular_velocity), f=(*force, *torque))
    """

    def __init__(self) -> None:
        self._q: Quaternion | None = None
        self._phi: Vector3 = (0.0, 0.0, 0.0)

    def phi(self, q: Sequence[float]) -> Vector3:
        """The coordinates (rad) at the orientation q = (w, x, y, z), which turns the device's vectors into the world's.

        Its length may be off 1 by 1e-3, as single precision and rounded text leave it. Raises `DeviceError` where it
        is not a unit quaternion.
        """
        w, x, y, z = unit_quaternion(q)
        if self._q is None:
            self._phi = log(w, x, y, z)
        else:
            dx, dy, dz = log(*product(w, x, y, z, self._q[0], -self._q[1], -self._q[2], -self._q[3]))
            self._phi = self._phi[0] + dx, self._phi[1] + dy, self._phi[2] + dz
        self._q = w, x, y, z
        return self._phi

    def in_world(self, vector: Sequence[float]) -> Vector3:
        """A vector of the device, an angular velocity or a torque, in the world's directions at the last quaternion.

        Raises `DeviceError` before there is one.
        """
        if self._q is None:
            raise DeviceError("no quaternion has come yet, so nothing says where the device's axes point; call phi "
                              "first")
        w, x, y, z = self._q
        a, b, c = vector
        _, u, v, s = product(*product(w, x, y, z, 0.0, a, b, c), w, -x, -y, -z)
        return u, v, s


def unit_quaternion(q: Sequence[float]) -> Quaternion:
    """q = (w, x, y, z) as floats, as long as 1 to rounding. Raises `DeviceError` if it is off by more than 1e-3."""
    parts = [float(each) for each in q]
    length = sqrt(sum([each * each for each in parts])) if len(parts) == 4 and all(map(isfinite, parts)) else 0.0
    if abs(length - 1.0) > FAR:
        shown = ", ".join(f"{each:g}" for each in parts)
        raise DeviceError(f"the device's quaternion ({shown}) is no unit quaternion, of four numbers w, x, y, z whose "
                          f"squares sum to 1; it has to send one, within {FAR:g} of that length")
    return unit(*parts)
