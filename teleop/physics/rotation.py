"""Orientation: unit quaternions (w, x, y, z), and rotation vectors, whose direction is the axis and length the angle.

A quaternion q turns a vector of the body into one of the world, and q and -q are the same orientation. All rotation
vectors, angular velocities and torques are in the world's directions, rad, rad/s and N m, and quaternions multiply from
the left: a body at q that turns by d comes to exp(d) q, and from q to p it is log(p q^-1).

    exp(d) = (cos(a/2), d sin(a/2)/a), a = |d|        log(q) = (2 atan2(n, |w|)/n) (x, y, z) sign(w), n = |(x, y, z)|

Neither loses digits, near 0 as near pi: the arc tangent of both parts is as good at every angle, and its quotient by n
is 1 to rounding where n is small. log is at most pi long; `log_near` takes of all rotation vectors of one orientation,
(a + 2 pi m) u, the one that is nearest to the last: |a u - last|^2 = (a - last.u)^2 + what no m changes, so m is the
nearest whole number to (last.u - a)/(2 pi). So an angle that grows beyond pi, or beyond some turns, goes on. Where an
orientation comes back to 0 after whole turns, its axis is lost: the last one is taken for it. `log_twofold` tells q
from -q, (2 atan2(n, w)/n) (x, y, z), so it needs no last one to go on beyond pi, up to 2 pi.

The coordinate of a rotation axis is phi, the integral of the angular velocity along it. `turned` counts q by the
increments of phi, q' = exp(phi' - phi) q. That is exact where the increments were taken from quaternions, which is what
`RotationAxes` does, and for a turn about an axis that stays. Where the angular velocity turns within a
tick of h s, with w and a the angular velocity and acceleration, the next term of Magnus' series is left out,

    Omega_2 = (1/2) int int_(s < t) w(t) x w(s) ds dt = -(h^3/12) w x a,

an error of third order in each tick and of second order over a time: 8e-8 rad a tick for 10 rad/s, 100 rad/s^2 across
it and 1 ms. phi itself is no orientation: a body that goes round and comes back to where it was has another phi.

Source of the exponential, the logarithm and their derivatives: J. Sola, J. Deray and D. Atchuthan, "A micro Lie theory
for state estimation in robotics", arXiv:1812.01537, 2018; of the series: A. Iserles, H. Munthe-Kaas, S. Norsett and A.
Zanna, "Lie-group methods", Acta Numerica 9, 2000.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, cos, floor, isfinite, nan, pi, sin, sqrt

from teleop.errors import DeviceError

Quaternion = tuple[float, float, float, float]
Vector3 = tuple[float, float, float]
FAR = 1e-3  # from 1: the length of a quaternion that is none
MOST = 1e15  # rad: beyond that an angle says nothing of an orientation
LOST = 1e-14  # a vector part so short has lost its direction in rounding


def exp(x: float, y: float, z: float) -> Quaternion:
    """The unit quaternion of the rotation vector (x, y, z), rad; NaN where that is not finite.

    >>> exp(0.0, 0.0, 0.0)
    (1.0, 0.0, 0.0, 0.0)
    """
    a = sqrt(x * x + y * y + z * z)
    if not a < MOST:
        return nan, nan, nan, nan
    s = sin(0.5 * a) / a if a > 0.0 else 0.5
    return cos(0.5 * a), s * x, s * y, s * z


def product(w: float, x: float, y: float, z: float, pw: float, px: float, py: float, pz: float) -> Quaternion:
    """The product q p of two quaternions: first p, then q."""
    return (w * pw - x * px - y * py - z * pz, w * px + x * pw + y * pz - z * py,
            w * py - x * pz + y * pw + z * px, w * pz + x * py - y * px + z * pw)


def unit(w: float, x: float, y: float, z: float) -> Quaternion:
    """A quaternion as long as 1 to rounding."""
    n = sqrt(w * w + x * x + y * y + z * z)
    return w / n, x / n, y / n, z / n


def turned(w: float, x: float, y: float, z: float, dx: float, dy: float, dz: float) -> Quaternion:
    """exp(d) q: the orientation q after a turn d (rad), as long as 1 again at each, so its length does not drift."""
    ew, ex, ey, ez = exp(dx, dy, dz)
    pw, px, py, pz = product(ew, ex, ey, ez, w, x, y, z)
    return unit(pw, px, py, pz)


def first_or_turned(w: float, x: float, y: float, z: float, dx: float, dy: float, dz: float) -> Quaternion:
    """The same; of none yet, (0, 0, 0, 0), the quaternion exp(d) or its negative, whichever has w >= 0.

    >>> first_or_turned(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    (1.0, 0.0, 0.0, 0.0)
    """
    if w != 0.0 or x != 0.0 or y != 0.0 or z != 0.0:
        return turned(w, x, y, z, dx, dy, dz)
    ew, ex, ey, ez = exp(dx, dy, dz)
    if ew < 0.0:
        return -ew, -ex, -ey, -ez
    return ew, ex, ey, ez


def log_near(w: float, x: float, y: float, z: float, lx: float, ly: float, lz: float) -> Vector3:
    """The rotation vector of a unit quaternion (rad) that is nearest to the vector l; with l = 0 the shortest."""
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    n = sqrt(x * x + y * y + z * z)
    far = sqrt(lx * lx + ly * ly + lz * lz)
    if n < LOST and pi < far < MOST:
        a = (2.0 * pi * floor(far / (2.0 * pi) + 0.5) + 2.0 * (x * lx + y * ly + z * lz) / far) / far
        return a * lx, a * ly, a * lz
    if not n > 0.0:
        return 2.0 * x, 2.0 * y, 2.0 * z
    a = 2.0 * atan2(n, w)
    turns = ((x * lx + y * ly + z * lz) / n - a) / (2.0 * pi)
    if abs(turns) < MOST:  # an l that is not finite is near to nothing
        a = a + 2.0 * pi * floor(turns + 0.5)
    a = a / n
    return a * x, a * y, a * z


def log(w: float, x: float, y: float, z: float) -> Vector3:
    """The shortest rotation vector of a unit quaternion, at most pi long (rad).

    >>> log(0.0, 0.0, 0.0, -1.0)
    (0.0, 0.0, -3.141592653589793)
    """
    return log_near(w, x, y, z, 0.0, 0.0, 0.0)


def log_twofold(w: float, x: float, y: float, z: float, lx: float, ly: float, lz: float) -> Vector3:
    """The shortest rotation vector (rad) whose `exp` is this unit quaternion and not its negative: at most 2 pi long.

    At a whole turn, w = -1, the axis is lost: that of the vector l is taken.
    """
    n = sqrt(x * x + y * y + z * z)
    far = sqrt(lx * lx + ly * ly + lz * lz)
    if w < 0.0 and n < LOST and 0.0 < far < MOST:
        a = 2.0 * pi / far
        return a * lx, a * ly, a * lz
    if not n > 0.0:
        return 2.0 * x, 2.0 * y, 2.0 * z
    a = 2.0 * atan2(n, w) / n
    return a * x, a * y, a * z


def sent_at(w: float, x: float, y: float, z: float, px: float, py: float, pz: float,
            lx: float, ly: float, lz: float) -> Vector3:
    """The rotation vector (rad) of the quaternion exp(p) q, with its sign, see `log_twofold`."""
    aw, ax, ay, az = exp(px, py, pz)
    bw, bx, by, bz = product(aw, ax, ay, az, w, x, y, z)
    return log_twofold(bw, bx, by, bz, lx, ly, lz)


def heard_at(w: float, x: float, y: float, z: float, rx: float, ry: float, rz: float,
             lx: float, ly: float, lz: float) -> Vector3:
    """Rotation vector (rad) from q to the quaternion exp(r), see `log_twofold`."""
    aw, ax, ay, az = exp(rx, ry, rz)
    bw, bx, by, bz = product(aw, ax, ay, az, w, -x, -y, -z)
    return log_twofold(bw, bx, by, bz, lx, ly, lz)


def apart_after(w: float, x: float, y: float, z: float, dx: float, dy: float, dz: float,
                lx: float, ly: float, lz: float) -> Quaternion:
    """The rotation from one orientation to another, after that has turned by d and the first by l: exp(d) q exp(-l)."""
    aw, ax, ay, az = exp(dx, dy, dz)
    bw, bx, by, bz = product(aw, ax, ay, az, w, x, y, z)
    ew, ex, ey, ez = exp(-lx, -ly, -lz)
    cw, cx, cy, cz = product(bw, bx, by, bz, ew, ex, ey, ez)
    return unit(cw, cx, cy, cz)


def left_at(px: float, py: float, pz: float, dx: float, dy: float, dz: float) -> Vector3:
    """Rotation vector (rad) to an orientation that lay p from a body, once that has turned by d: log(exp(p) exp(-d)).

    >>> left_at(1.0, 2.0, 3.0, 0.0, 0.0, 0.0)
    (1.0, 2.0, 3.0)
    """
    if dx == 0.0 and dy == 0.0 and dz == 0.0:
        return px, py, pz
    aw, ax, ay, az = exp(px, py, pz)
    ew, ex, ey, ez = exp(-dx, -dy, -dz)
    bw, bx, by, bz = product(aw, ax, ay, az, ew, ex, ey, ez)
    return log_near(bw, bx, by, bz, px - dx, py - dy, pz - dz)


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
