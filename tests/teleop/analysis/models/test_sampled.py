"""The damping that a held force needs: published numbers, the energy itself as a quadratic form, and closed loops."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from teleop.analysis.models.linear import StateSpace
from teleop.analysis.models.peak import highest
from teleop.analysis.models.sampled import (
    damping_curve,
    needed_damping,
    of_state_space,
    quantised_stiffness,
    spring_damper,
)
from tests.teleop.analysis.models.closed_forms import filtered_wall, wall_damping

T = 1e-3
stiffness = st.floats(0.0, 1e4)
damping = st.floats(-5.0, 5.0)


def test_walls_with_known_limits() -> None:
    for K, B, d, b_min in ((1600.0, 0.0, 0, 0.8), (800.0, 0.4, 0, 0.8), (1000.0, 0.0, 1, 1.5), (1000.0, 0.5, 1, 1.25),
                           (1000.0, 0.5, 5, 5.0)):
        assert wall_damping(K, B, T, d).damping == pytest.approx(b_min, rel=1e-11)
        assert needed_damping(spring_damper(K, B, T), T, d=d).damping == pytest.approx(b_min, rel=1e-9)


class TestSpringDamper:
    @settings(max_examples=30)
    @given(K=stiffness, B=damping)
    def test_without_delay_it_is_colgates_rule(self, K: float, B: float) -> None:
        assert wall_damping(K, B, T).damping == pytest.approx(K * T / 2 + abs(B), rel=1e-10, abs=1e-12)

    @settings(max_examples=30)
    @given(K=stiffness, d=st.integers(0, 300))
    def test_a_spring_alone_needs_half_a_sample_and_the_delay(self, K: float, d: int) -> None:
        assert wall_damping(K, 0.0, T, d).damping == pytest.approx(K * T * (0.5 + d), rel=1e-10)

    @settings(max_examples=20)
    @given(K=stiffness, B=damping, d=st.integers(0, 40))
    def test_the_search_for_any_controller_agrees(self, K: float, B: float, d: int) -> None:
        found = needed_damping(spring_damper(K, B, T), T, d=d)
        assert found.damping == pytest.approx(wall_damping(K, B, T, d).damping, rel=1e-8, abs=1e-9)

    def test_where_the_most_is_needed(self) -> None:
        assert wall_damping(1000.0, 0.5, T).frequency == pytest.approx(500.0)
        assert wall_damping(1000.0, 0.0, T, 3).frequency == 0.0
        assert wall_damping(1000.0, 0.5, T, 1).frequency == pytest.approx(1 / 6 / T, rel=1e-6)  # cos(th) = 1/2

    def test_ten_seconds_of_delay(self) -> None:
        assert needed_damping(spring_damper(1000.0, 0.5, T), T, d=10_000).damping == pytest.approx(1e4, rel=1e-8)

    def test_a_negative_spring_is_never_passive(self) -> None:
        assert needed_damping(spring_damper(-1.0, 5.0, T), T).damping == float("inf")


def colgate_schenkel(H: complex, w: float) -> float:
    """The printed condition's right side for a force over position H at one frequency."""
    turn = np.exp(-1j * w * T)
    return float(T / 2 / (1 - np.cos(w * T)) * ((1 - turn) * H).real)


@settings(max_examples=50)
@given(K=stiffness, B=damping, cut=st.floats(1.0, 400.0), w=st.floats(10.0, pi / T), d=st.integers(0, 5))
def test_the_curve_is_colgate_and_schenkels(K: float, B: float, cut: float, w: float, d: int) -> None:
    z = np.exp(1j * w * T)
    a = np.exp(-2 * pi * cut * T)
    H = (K + B * (1 - a) / (1 - a / z) * (1 - 1 / z) / T) * z**-d
    got = damping_curve(filtered_wall(K, B, T, cut), T, np.array([w * T]), d=d)[0]
    assert got == pytest.approx(colgate_schenkel(H, w), rel=1e-7, abs=1e-7)


def test_a_filter_as_matrices_needs_the_same() -> None:
    """v_f' = a v_f + (1 - a)(x - x_before)/T, f = K x + B v_f'."""
    K, B, a = 900.0, 0.7, np.exp(-2 * pi * 30.0 * T)
    gain = (1 - a) / T
    matrices = StateSpace(np.array([[a, -gain], [0.0, 0.0]]), np.array([[gain], [1.0]]),
                          np.array([[B * a, -B * gain]]), np.array([[K + B * gain]]))
    got = needed_damping(of_state_space(matrices, T), T, d=2)
    assert got.damping == pytest.approx(needed_damping(filtered_wall(K, B, T, 30.0), T, d=2).damping, rel=1e-8)


def energy_bound(K: float, B: float, d: int, every: int, renewals: int = 30, parts: int = 4) -> float:
    """The most that a force takes from a motion over its int v^2, as an eigenvalue: from the time domain alone.

    The motion is straight over `parts` of every tick, begins at rest and lasts a while, so this is a lower bound.
    """
    ticks = renewals * every
    n, h = ticks * parts, T / parts
    x = np.tri(n, n) * h  # after each part, of the velocities
    at = np.vstack([np.zeros(n), x[parts - 1::parts]])  # at the ticks
    law = K * at[:ticks] + B * np.vstack([np.zeros(n), np.diff(at[:ticks], axis=0)]) / T
    work = np.zeros((n, n))
    for k in range(ticks):
        start = k // every * every - d
        if start >= 0:
            work += np.outer(at[k + 1] - at[k], law[start])
    return float(-np.linalg.eigvalsh(0.5 * (work + work.T)).min() / h)


def test_a_force_renewed_slowly_makes_as_much_energy_as_the_form_says() -> None:
    for K, B, d, every in ((1000.0, 0.0, 0, 1), (1000.0, 0.4, 1, 1), (1000.0, 0.0, 0, 3), (1000.0, 0.0, 1, 2),
                           (1000.0, 0.5, 0, 3), (1000.0, -0.4, 2, 4)):
        bound = needed_damping(spring_damper(K, B, T), T, d=d, every=every).damping
        assert 0.93 * bound < energy_bound(K, B, d, every) < bound * (1 + 1e-9), (B, d, every)


@given(K=stiffness, every=st.integers(1, 12), periods=st.integers(0, 3))
@settings(max_examples=12)
def test_a_spring_renewed_slowly_is_one_with_a_longer_sample(K: float, every: int, periods: int) -> None:
    got = needed_damping(spring_damper(K, 0.0, T), T, d=periods * every, every=every).damping
    assert got == pytest.approx(K * every * T * (0.5 + periods), rel=1e-8, abs=1e-9)


def test_a_delay_of_part_of_a_period_needs_more_than_the_sum_of_both() -> None:
    got = needed_damping(spring_damper(1000.0, 0.0, T), T, d=1, every=2).damping
    assert got == pytest.approx(1.0 * (1 + 5**0.5 / 2), rel=1e-8)  # not K (nT/2 + dT) = 2


@settings(max_examples=30)
@given(place=st.floats(0.01, 3.1), width=st.floats(0.05, 2.0))
def test_a_maximum_between_two_places_is_zoomed_in_on(place: float, width: float) -> None:
    found = highest(lambda th: 2.0 - ((th - place) / width) ** 2)
    assert found.value == pytest.approx(2.0, abs=1e-14)
    assert found.th == pytest.approx(place, abs=1e-6)


def test_the_stiffness_behind_an_encoder_is_the_smaller_of_both_bounds() -> None:
    for step, friction, K in ((1e-5, 0.02, 1600.0), (1e-5, 0.004, 800.0), (0.0, 0.0, 1600.0), (1e-5, 0.0, 0.0)):
        assert quantised_stiffness(b=0.8, T=T, step=step, friction=friction) == pytest.approx(K)
