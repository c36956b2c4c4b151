"""Rotations: quaternions and rotation vectors to the last digits, and what the increments of phi leave out."""

from __future__ import annotations

from itertools import product as pairs_of
from math import inf, isnan, nan, pi

import mpmath
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from teleop import DeviceError, RotationAxes
from teleop.physics.rotation import exp, heard_at, left_at, log, log_near, log_twofold, product, sent_at, turned, unit

ANGLES = (0.0, 5e-324, 1e-200, 1e-20, 1e-9, 1e-4, 0.3, 1.0, 2.0, 3.0, pi - 1e-6, pi - 1e-12, pi)
AXES = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.6, 0.0, 0.8), (-2.0 / 3.0, 1.0 / 3.0, 2.0 / 3.0))


def vectors(seed: int, count: int, most: float) -> list[tuple[float, ...]]:
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(count, 3))
    lengths = rng.uniform(0.0, most, size=(count, 1))
    return [tuple(each) for each in (axes / np.linalg.norm(axes, axis=1, keepdims=True) * lengths).tolist()]


def of_scipy(q: tuple[float, ...]) -> Rotation:
    return Rotation.from_quat([*q[1:], q[0]])


def test_the_quaternion_of_a_rotation_vector_is_that_of_fifty_digits() -> None:
    for angle, axis in pairs_of(ANGLES, AXES):
        d = [angle * each for each in axis]
        with mpmath.workdps(50):
            a = mpmath.sqrt(sum(mpmath.mpf(each) ** 2 for each in d))
            s = mpmath.sin(a / 2) / a if a else mpmath.mpf("0.5")
            exact = [mpmath.cos(a / 2), *[s * each for each in d]]
            for got, true in zip(exp(*d), exact, strict=True):
                assert abs(got - true) <= min(2.3e-16, 1e-15 * abs(true) + 1.2e-16), d


def test_the_rotation_vector_of_a_quaternion_is_that_of_fifty_digits() -> None:
    """Of q and of -q, near 0 as near pi, of the quaternion as it is in floats."""
    for angle, axis in pairs_of(ANGLES, AXES):
        q = exp(*[angle * each for each in axis])
        with mpmath.workdps(50):
            w, *v = [mpmath.mpf(each) for each in q]
            n = mpmath.sqrt(sum(each**2 for each in v))
            exact = [2 * mpmath.atan2(n, w) / n * each if n else mpmath.mpf(0) for each in v]
            for got, true in zip(log(*q), exact, strict=True):
                assert abs(got - true) <= 9e-16 * max(abs(true), abs(angle)), q
        assert log(*[-each for each in q]) == log(*q) or q[0] == 0.0


def test_they_agree_with_scipy() -> None:
    for d, e in zip(vectors(1, 300, 3.1), vectors(2, 300, 3.1), strict=True):
        p, q = exp(*d), exp(*e)
        assert np.allclose((of_scipy(p) * of_scipy(q)).as_matrix(), of_scipy(product(*p, *q)).as_matrix(), atol=1e-15)
        assert np.allclose(of_scipy(p).as_rotvec(), log(*p), rtol=0.0, atol=3e-15)
        assert np.allclose(Rotation.from_rotvec(d).as_matrix(), of_scipy(p).as_matrix(), atol=1e-15)


def test_a_rotation_vector_goes_on_beyond_pi_and_beyond_turns() -> None:
    """Three turns about a tilted axis and back, in steps of 0.03 rad: always the vector that was turned.

    Near whole turns its direction has few digits left, and its length and the orientation all of theirs.
    """
    last = (0.0, 0.0, 0.0)
    q = (1.0, 0.0, 0.0, 0.0)
    there = np.linspace(0.0, 6.0 * pi, 629)
    before = 0.0
    for angle in [*there, *there[::-1]]:
        step = angle - before
        before = angle
        q = turned(*q, 0.6 * step, 0.0, 0.8 * step)
        last = log_near(*q, *last)
        assert np.allclose(last, (0.6 * angle, 0.0, 0.8 * angle), rtol=0.0, atol=2e-11)
        assert abs(np.linalg.norm(last) - angle) < 2e-13


def test_the_nearest_vector_is_the_nearest_of_all() -> None:
    for d, near in zip(vectors(3, 200, 3.1), vectors(4, 200, 12.0), strict=True):
        got, size = np.array(log_near(*exp(*d), *near)), np.linalg.norm(d)
        every = [np.array(d) * (1.0 + 2.0 * pi * m / size) for m in range(-4, 5)]
        assert np.linalg.norm(got - near) <= min(np.linalg.norm(each - near) for each in every) + 1e-12
        assert np.allclose(exp(*got), exp(*d), atol=1e-14) or np.allclose(exp(*got), [-x for x in exp(*d)], atol=1e-14)


def test_a_quaternion_and_its_negative_are_told_apart_up_to_a_whole_turn() -> None:
    """exp undoes the logarithm, sign and all; and each of two bodies finds the other where that finds it."""
    for d, e in zip(vectors(8, 100, 6.28), vectors(9, 100, 6.28), strict=True):
        assert np.allclose(log_twofold(*exp(*d), 0.0, 0.0, 0.0), d, rtol=0.0, atol=5e-14)
        q, p = exp(*d), exp(*e)
        there, back = heard_at(*q, *e, 0.0, 0.0, 0.0), heard_at(*p, *d, 0.0, 0.0, 0.0)
        assert np.allclose(there, np.negative(back), rtol=0.0, atol=1e-13)
        assert np.allclose(product(*exp(*there), *q), p, atol=1e-14)
    assert log_twofold(-1.0, 0.0, 1e-17, 0.0, 0.0, 0.0, 3.0) == (0.0, 0.0, 2.0 * pi)


def test_after_whole_turns_the_axis_that_is_lost_is_the_last_one() -> None:
    near = np.array((0.6, 0.0, 0.8)) * (4.0 * pi - 1e-3)
    assert np.allclose(log_near(1.0, 0.0, 1e-16, 0.0, *near), np.array((0.6, 0.0, 0.8)) * 4.0 * pi, atol=1e-14)


def test_a_hundred_thousand_turns_leave_the_length_at_one() -> None:
    """And where it stands is off by their rounding alone, less than 2e-13 rad."""
    q = (1.0, 0.0, 0.0, 0.0)
    for _ in range(100_000):
        q = turned(*q, 6e-3, 0.0, 8e-3)
    assert abs(sum(each * each for each in q) - 1.0) < 5e-16
    assert np.allclose(log(*product(*q, *exp(-600.0, 0.0, -800.0))), 0.0, atol=2e-13)


def test_what_is_not_finite_is_nan_and_raises_nothing() -> None:
    for bad in (inf, nan, 1e200):
        assert all(map(isnan, exp(bad, 0.0, 0.0)))
        assert all(map(isnan, heard_at(1.0, 0.0, 0.0, 0.0, bad, 0.0, 0.0, 0.0, 0.0, 0.0)))
    assert log_near(*exp(1.0, 0.0, 0.0), inf, nan, 0.0) == log(*exp(1.0, 0.0, 0.0))


def test_what_one_end_sends_the_other_finds_where_it_is() -> None:
    """Three ways to the same place: from another body, and from the body itself after it has turned."""
    for d, e, p in zip(vectors(5, 100, 3.0), vectors(6, 100, 3.0), vectors(7, 100, 1.0), strict=True):
        here, there = exp(*d), exp(*e)
        sent = sent_at(*there, *p, 0.0, 0.0, 0.0)
        at = product(*exp(*p), *there)
        apart = log_twofold(*product(*at, *unit(here[0], *[-x for x in here[1:]])), 0.0, 0.0, 0.0)
        assert np.allclose(heard_at(*here, *sent, 0.0, 0.0, 0.0), apart, atol=3e-15)
        step = (0.01, -0.02, 0.015)
        moved = turned(*there, *step)
        assert np.allclose(left_at(*p, *step), heard_at(*moved, *sent, *p), atol=3e-15)


# -- the rotation axes of a device: phi counted along its quaternions


def test_an_orientation_counted_from_phi_is_that_of_the_device() -> None:
    """A tool that tumbles, its quaternions told with either sign and in single precision."""
    rng = np.random.default_rng(5)
    device, q, counted, before = RotationAxes(), exp(0.5, -2.5, 1.0), (1.0, 0.0, 0.0, 0.0), np.zeros(3)
    for k in range(2000):
        told = np.float32(q) * (-1.0) ** (k // 3)
        phi = np.array(device.phi(told))
        counted = turned(*counted, *(phi - before))
        before = phi
        assert np.linalg.norm(log(*product(*counted, q[0], *[-each for each in q[1:]]))) < 3e-7  # of single precision
        q = turned(*q, *rng.normal(scale=0.1, size=3))


def test_a_tool_that_is_turned_on_and_on_does_not_unwind() -> None:
    device, axis = RotationAxes(), np.array((0.6, 0.0, 0.8))
    for angle in np.linspace(0.0, 9.0 * pi, 400):
        assert device.phi(exp(*(angle * axis))) == pytest.approx(tuple(angle * axis), abs=1e-12)


def test_what_is_no_unit_quaternion_is_an_error_of_the_device() -> None:
    device = RotationAxes()
    for q in ((1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0), (1.0, 0.1, 0.0, 0.0), (nan, 0.0, 0.0, 0.0)):
        with pytest.raises(DeviceError, match="no unit quaternion"):
            device.phi(q)
    assert device.phi((1.0009, 0.0, 0.0, 0.0)) == (0.0, 0.0, 0.0)


def test_a_vector_of_the_device_in_the_directions_of_the_world() -> None:
    device, q = RotationAxes(), exp(0.3, -1.0, 2.0)
    with pytest.raises(DeviceError, match="call phi first"):
        device.in_world((1.0, 0.0, 0.0))
    device.phi(q)
    world = Rotation.from_quat([*q[1:], q[0]]).apply((1.0, 2.0, 3.0))
    assert device.in_world((1.0, 2.0, 3.0)) == pytest.approx(tuple(world), abs=1e-14)
