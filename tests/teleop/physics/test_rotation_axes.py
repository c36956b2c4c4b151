"""The rotation axes of a device: phi counted along its quaternions."""

from __future__ import annotations

from math import nan, pi

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from teleop import DeviceError, RotationAxes
from teleop.physics.rotation import exp, log, product, turned


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


@pytest.mark.parametrize("q", [(1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0), (1.0, 0.1, 0.0, 0.0), (nan, 0.0, 0.0, 0.0)])
def test_what_is_no_unit_quaternion_is_an_error_of_the_device(q: tuple[float, ...]) -> None:
    device = RotationAxes()
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
