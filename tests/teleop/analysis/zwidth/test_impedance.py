"""Upper and lower impedance over frequency, against closed forms."""

from __future__ import annotations

from dataclasses import replace
from math import log10, pi, sqrt
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

from teleop.analysis.zwidth.assess import Curves, curves, device, most
from teleop.analysis.zwidth.passive import passive_region
from teleop.laws.virtual_coupling import VirtualCoupling
from teleop.laws.virtual_wall import VirtualWall
from teleop.physics.plant import MassDamper
from teleop.physics.relaxing import ElectricalDamping
from teleop.scene.scene import Scene
from teleop.stages.device import Device
from teleop.stages.encoder import Encoder
from teleop.stages.velocity.backward_difference import BackwardDifference
from teleop.stages.velocity.low_pass import LowPass

WALL = VirtualWall(K=800.0)


def handle(*, b: float = 0.8, dt: float = 1e-3, law: Any = WALL, **device_m: Any) -> Scene:
    return Scene(law=law, master=MassDamper(mass=0.04, damping=b), dt=dt, duration=1.0,
                 device_m=Device(**{"velocity": BackwardDifference(), **device_m}))


def found(scene: Scene) -> Curves:
    return curves(scene, passive_region(scene))


def test_the_canonical_handle_has_a_z_width_of_254_newton_seconds_per_metre() -> None:
    got = found(handle())
    assert got.at_one == pytest.approx((1600.0 / (2.0 * pi), sqrt(0.8**2 + (0.08 * pi) ** 2)), rel=1e-6)
    assert got.width == pytest.approx(254.648 - 0.83855, abs=1e-3)


def test_the_curves_are_a_spring_then_a_damper_over_a_damper_then_a_mass() -> None:
    got = found(handle(b=8.0))
    assert got.upper is not None
    w = 2.0 * pi * got.frequency
    assert got.frequency[[0, 200, 600]] == pytest.approx([0.1, 1.0, 100.0])
    assert got.upper == pytest.approx(np.maximum(16000.0 / w, 8.0), rel=1e-6)
    assert got.lower == pytest.approx(np.hypot(8.0, 0.04 * w))


def test_the_area_is_that_between_the_curves_where_the_upper_is_above() -> None:
    def gap(decade: float) -> float:
        w = 2.0 * pi * 10.0**decade
        return max(log10(1600.0 / w / sqrt(0.8**2 + (0.04 * w) ** 2)), 0.0)

    area = quad(gap, -1.0, 2.0, limit=200, points=[1.5])[0]
    got = found(handle())
    assert got.area == pytest.approx(area, rel=1e-4)
    assert got.gap == pytest.approx(area / 3.0, rel=1e-4)


def test_a_slow_controller_is_asked_up_to_half_its_rate_only() -> None:
    got = found(handle(dt=1e-2))
    assert got.frequency[-1] == pytest.approx(50.0)
    assert got.area == pytest.approx((got.gap or 0.0) * log10(500.0))


@pytest.mark.full
def test_no_point_of_the_passive_region_is_above_the_upper_curve() -> None:
    scene = handle(delay=3)
    corners = np.array(passive_region(scene).corners)
    frequency = np.array([0.1, 1.0, 10.0, 100.0])
    upper = most(scene, passive_region(scene).corners or (), frequency)
    dice = np.random.default_rng(3)
    weights = dice.dirichlet(np.ones(len(corners)), 50)
    for K, B in weights @ corners:
        assert (np.abs(K / (2j * pi * frequency) + B) <= upper * (1.0 + 1e-12)).all()
    assert upper[0] == pytest.approx(corners[:, 0].max() / (0.2 * pi), rel=1e-3)


def test_a_filtered_damper_counts_as_the_filter_leaves_it() -> None:
    scene = handle(velocity=LowPass(cutoff=30.0))
    frequency = np.array([1.0, 100.0])
    z = np.exp(2j * pi * frequency * 1e-3)
    a = np.exp(-2.0 * pi * 30.0 * 1e-3)
    assert most(scene, ((0.0, 2.0),), frequency) == pytest.approx(2.0 * np.abs((1.0 - a) / (1.0 - a / z)), rel=1e-6)


def test_a_shunt_is_a_damper_above_its_cutoff_alone() -> None:
    scene = replace(handle(), electrical=ElectricalDamping(b=2.0, cutoff=10.0))
    slow, fast = device(scene, np.array([1e-3, 1e3]))
    assert slow == pytest.approx(0.8, rel=1e-3)
    assert fast == pytest.approx(abs(2.8 + 0.04 * 2e3j * pi), rel=1e-3)


def test_behind_a_coupling_the_device_carries_the_tool_along() -> None:
    scene = handle(law=VirtualCoupling(K=1600.0, B=0.0, mass=0.02))
    assert device(scene, np.array([1.0]))[0] == pytest.approx(abs(0.8 + 0.06 * 2j * pi), rel=2e-3)
    got = found(scene)
    assert got.at_one[0] == pytest.approx(1600.0 / (2.0 * pi), rel=1e-6)


def test_where_nothing_is_passive_there_is_no_width_and_where_nothing_is_claimed_no_number() -> None:
    nothing = found(handle(encoder=Encoder(step=1e-5)))
    assert (nothing.width, nothing.area, nothing.gap) == (0.0, 0.0, 0.0)
    unknown = found(handle(velocity=None))
    assert (unknown.upper, unknown.width, unknown.area) == (None, None, None)
    assert unknown.at_one[1] == pytest.approx(0.83855, abs=1e-5)
