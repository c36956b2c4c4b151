"""The low-pass: the transfer function that its text states, a first-order lag, in spans of any length."""

from __future__ import annotations

from math import expm1, pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop.stages.velocity.low_pass import LowPass
from tests.teleop.stages.velocity.signals import T, driven, floored, sine, velocities

cutoffs = st.floats(0.1, 2000.0)


def rate(cutoff: float, dt: float = T) -> float:
    return -expm1(-2.0 * pi * cutoff * dt)


@pytest.mark.parametrize("cutoff", [1.0, 30.0, 500.0])
def test_it_is_the_stated_transfer_function(cutoff: float) -> None:
    from scipy.signal import lfilter

    xs = floored(sine(2000)[0], 1e-5)
    r = rate(cutoff)
    filtered = lfilter([r / T, -r / T], [1.0, r - 1.0], xs)  # at rest at 0, where the sine begins
    assert velocities(LowPass(cutoff=cutoff), xs) == pytest.approx(filtered, abs=1e-12)


@pytest.mark.parametrize("cutoff", [1.0, 30.0, 500.0])
def test_the_filter_is_the_exact_one_for_a_held_difference(cutoff: float) -> None:
    """Against the zero-order-hold discretisation of omega/(s + omega)."""
    from scipy.signal import cont2discrete

    omega = 2.0 * pi * cutoff
    (_, gain), pole, _ = (np.ravel(part) for part in cont2discrete(([omega], [1.0, omega]), T, method="zoh"))
    estimator = LowPass(cutoff=cutoff)
    v, _ = estimator.step(estimator.coefficients(T), (0.0, 0.0), T, T)  # a difference of 1 m/s, from rest
    assert v == pytest.approx(gain, rel=1e-10)
    v, _ = estimator.step(estimator.coefficients(T), (0.0, 1.0), 0.0, T)  # none, from 1 m/s
    assert v == pytest.approx(-pole[1], rel=1e-10)


@given(cutoff=cutoffs, d=st.floats(-1.0, 1.0), v=st.floats(-1.0, 1.0), n=st.integers(1, 10))
def test_one_long_span_is_as_many_short_ones(cutoff: float, d: float, v: float, n: int) -> None:
    estimator = LowPass(cutoff=cutoff)
    c = estimator.coefficients(T)
    s = (0.0, v)
    for k in range(1, n + 1):
        short, s = estimator.step(c, s, d * (k * T), T)
    long, _ = estimator.step(c, (0.0, v), d * (n * T), n * T)
    assert long == pytest.approx(short, abs=1e-11)


@given(cutoff=cutoffs, a=st.lists(st.floats(-10.0, 10.0), min_size=2, max_size=200), phase=st.floats(0.0, 0.99))
def test_the_error_is_at_most_the_lag_and_the_share_of_the_step(cutoff: float, a: list[float], phase: float) -> None:
    step, r, most = 1e-5, rate(cutoff), max(map(abs, a))
    xs, vs = driven(a)
    found = velocities(LowPass(cutoff=cutoff), floored(xs, step, phase))
    bound = most * T * (0.5 + (1.0 - r) / r) + step * r / T
    for estimate, v in zip(found, vs, strict=True):
        assert abs(estimate - v) <= bound * (1.0 + 1e-9)
