"""The backward difference: the mean velocity of the last span, to half a tick and a step of the encoder."""

from __future__ import annotations

from math import floor

import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop.stages.velocity.backward_difference import BackwardDifference
from tests.teleop.stages.velocity.signals import T, driven, floored, sine, velocities

accelerations = st.lists(st.floats(-10.0, 10.0), min_size=2, max_size=100)


@given(x0=st.floats(-1.0, 1.0), x1=st.floats(-1.0, 1.0), span=st.sampled_from([1e-4, 1e-3, 0.5]))
def test_it_is_the_difference_over_the_span(x0: float, x1: float, span: float) -> None:
    estimator = BackwardDifference()
    v, s = estimator.step(estimator.coefficients(T), estimator.start(x0), x1, span)
    assert v == (x1 - x0) / span
    assert s == (x1,)


@given(a=accelerations, v=st.floats(-1.0, 1.0))
def test_it_lags_by_half_a_tick_exactly(a: list[float], v: float) -> None:
    xs, vs = driven(a, v)
    found = velocities(BackwardDifference(), xs)
    for k in range(1, len(a)):
        assert found[k] == pytest.approx(vs[k] - 0.5 * T * a[k - 1], abs=1e-12)


@pytest.mark.parametrize("step", [1e-5, 6e-5])
def test_behind_an_encoder_it_is_a_multiple_of_step_over_tick_and_off_by_less_than_one(step: float) -> None:
    xs, vs = sine(1000)
    found = velocities(BackwardDifference(), floored(xs, step, 0.5))
    for estimate, before, v in zip(found[1:], vs, vs[1:], strict=False):
        assert estimate * T / step == pytest.approx(floor(estimate * T / step + 0.5), abs=1e-6)
        assert abs(estimate - 0.5 * (before + v)) < step / T + 1e-6
    assert max(abs(a - b) for a, b in zip(found[1:], vs[1:], strict=True)) > 0.9 * step / T
