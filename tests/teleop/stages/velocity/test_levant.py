"""Levant's differentiator: each step solves the implicit equations, sliding is exact, noise costs sqrt(L eps)."""

from __future__ import annotations

from math import copysign, sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from teleop.stages.velocity.levant import LAMBDA0, LAMBDA1, Levant
from tests.teleop.stages.velocity.signals import T, driven, ramp, velocities

bounds = st.sampled_from([0.1, 1.0, 30.0])


@given(L=bounds, z0=st.floats(-1.0, 1.0), z1=st.floats(-1.0, 1.0), span=st.sampled_from([1e-4, 1e-3, 5e-3]),
       off=st.floats(-1e-2, 1e-2) | st.floats(-2e-6, 2e-6))
@settings(max_examples=50)
def test_a_step_solves_the_implicit_equations(L: float, z0: float, z1: float, off: float, span: float) -> None:
    """Both right sides at the end of the step; the sign is one number, of [-1, 1] where sigma is zero."""
    x = z0 + span * z1 - off
    estimator = Levant(L=L)
    v, (z0_next, z1_next) = estimator.step(estimator.coefficients(T), (z0, z1), x, span)
    assert v == z1_next
    sigma = z0_next - x
    sign = (z1 - z1_next) / (span * LAMBDA1 * L)
    rounding = 1e-15 / (span * span * LAMBDA1 * L) + 1e-15 / (span * LAMBDA1 * L)
    if sigma == 0.0:
        assert abs(sign) <= 1.0 + rounding
    else:
        assert sign == pytest.approx(copysign(1.0, sigma), abs=rounding)
    moved = z0 + span * (z1_next - LAMBDA0 * sqrt(L * abs(sigma)) * sign)
    # A sigma of the last digits of x has a root of half as many digits.
    assert moved == pytest.approx(z0_next, abs=1e-15 + span * LAMBDA0 * sqrt(L * 1e-15) * (abs(sigma) < 1e-12))


@pytest.mark.parametrize("L", [0.5, 2.0])
def test_for_a_short_tick_it_is_the_differential_equation(L: float) -> None:
    """Against a tight integration from a velocity error of 0.1 m/s, up to the second change of sign and past it."""
    v, dt = 0.1, 2e-6 / L

    def error(_: float, e: np.ndarray) -> list[float]:
        sigma, off = e
        return [off - LAMBDA0 * sqrt(L * abs(sigma)) * np.sign(sigma), -LAMBDA1 * L * np.sign(sigma)]

    end = 1.1 * v / L
    exact = solve_ivp(error, (0.0, end), [0.0, -v], max_step=end / 2000, rtol=1e-9, atol=1e-12, dense_output=True).sol
    found = velocities(Levant(L=L), ramp(v, int(end / dt), dt), dt)
    for share in (0.2, 0.5, 0.8, 0.9, 0.95, 0.99):
        k = int(share * end / dt)
        assert found[k] == pytest.approx(v + exact(k * dt)[1], abs=2e-3 * v)


@given(L=bounds, v=st.floats(0.01, 1.0))
@settings(max_examples=10)
def test_it_comes_to_a_ramp_in_finite_time(L: float, v: float) -> None:
    """1.25 v/L, measured, and from there on the slope to rounding."""
    ticks = int(1.3 * v / L / T) + 5
    if ticks > 4000:
        L, ticks = 1.0, int(1.3 * v / T) + 5
    assert velocities(Levant(L=L), ramp(v, ticks + 50))[ticks:] == pytest.approx([v] * 50, abs=1e-11)


@pytest.mark.parametrize("L", [0.4, 2.0])
def test_the_worst_constant_acceleration_takes_ten_times_v_over_L(L: float) -> None:
    """The estimate gains (lambda1 - 1) L on a velocity that runs away at L."""
    v = 0.05
    ticks = int(v / ((LAMBDA1 - 1.0) * L) / T)
    xs, vs = driven([L] * (ticks + 60), v)
    found = velocities(Levant(L=L), xs)
    assert vs[ticks // 2] - found[ticks // 2] == pytest.approx(0.5 * v, rel=0.05)
    for k in range(ticks + 20, ticks + 60):
        assert abs(found[k] - vs[k]) <= 0.5 * L * T + 1e-9


@given(L=bounds, shares=st.lists(st.floats(-1.0, 1.0), min_size=2, max_size=100))
@settings(max_examples=40)
def test_once_there_it_is_off_by_half_a_tick_of_acceleration_at_most(L: float, shares: list[float]) -> None:
    """From rest, which it knows: it slides from the first tick, and no acceleration within L ends that."""
    xs, vs = driven([share * L for share in shares])
    for estimate, v in zip(velocities(Levant(L=L), xs), vs, strict=True):
        assert abs(estimate - v) <= 0.5 * L * T + 1e-11


@given(L=bounds, steps=st.lists(st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)), min_size=3, max_size=100),
       share=st.floats(0.0, 0.024))
@settings(max_examples=40)
def test_a_noise_far_below_the_acceleration_of_a_tick_does_not_end_the_sliding(
        L: float, steps: list[tuple[float, float]], share: float) -> None:
    eps = share * L * T * T
    xs, vs = driven([a * L for a, _ in steps])
    readings = [x + eps * e for x, (_, e) in zip(xs, steps, strict=True)]
    readings[0] = 0.0  # it starts at rest where it is
    for estimate, v in zip(velocities(Levant(L=L), readings), vs, strict=True):
        assert abs(estimate - v) <= 0.5 * L * T + 2.0 * eps / T + 1e-11


def errors(noise: str, eps: float, xs: np.ndarray, beat: np.ndarray) -> np.ndarray:
    """Errors of at most eps, one for each position."""
    dice = np.random.default_rng(len(noise))
    match noise:
        case "random":
            return dice.uniform(-eps, eps, len(xs))
        case "two values":
            return dice.choice([-eps, eps], len(xs))
        case "encoder":
            return 2.0 * eps * np.floor(xs / (2.0 * eps)) + eps - xs
    return eps * beat


def test_noise_costs_at_most_three_times_the_root_of_L_eps() -> None:
    """eps from L T^2 up over four decades: one constant for all, measured 2.6 at the lower end, 2.0 at the upper."""
    L = 1.0
    for ratio, rate in ((1.0, 1.0), (1.0, 2.0), (100.0, 0.3), (1e4, 1.0)):
        eps = ratio * L * T * T
        own = sqrt(L / eps)  # 1/s: how fast the differentiator is at this noise
        times = np.arange(5000) * T
        beat = np.sign(np.sin(rate * own * times))
        for noise in ("random", "two values", "encoder", "in step with the acceleration"):
            accelerations = L * (beat if noise.startswith("in step") else np.sin(0.7 * times * rate))
            xs, vs = driven(accelerations.tolist())
            readings = np.array(xs) + errors(noise, eps, np.array(xs), beat)
            found = velocities(Levant(L=L), readings.tolist())
            worst = max(abs(a - b) for a, b in zip(found[2500:], vs[2500:], strict=True))
            assert worst < 3.0 * sqrt(L * eps), (noise, ratio, rate)


def test_what_is_faster_than_L_is_followed_at_the_largest_rate() -> None:
    L = 1.0
    found = velocities(Levant(L=L), [0.0] * 10 + [0.01] * 20)
    changes = np.diff(found)
    assert np.abs(changes).max() == pytest.approx(LAMBDA1 * L * T)
    assert changes[9] == pytest.approx(LAMBDA1 * L * T)
