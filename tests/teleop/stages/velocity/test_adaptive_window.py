"""Adaptive windows against the rule tried line by line in whole numbers, and the error bounds of their text."""

from __future__ import annotations

from fractions import Fraction
from math import isnan

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from teleop import BestFit, EndFit
from tests.teleop.stages.velocity.signals import T, driven, floored, ramp, velocities

STEP = 2.0**-17  # m: encoder counts times this are exact
KINDS = pytest.mark.parametrize("kind", [EndFit, BestFit])

counts = st.lists(st.integers(-3, 3), min_size=1, max_size=50).map(
    lambda steps: [sum(steps[:k]) for k in range(len(steps) + 1)]
)


def slope_of(kind: type, window: list[int]) -> Fraction:
    """Counts a tick; `window` is newest first."""
    n = len(window) - 1
    if kind is EndFit:
        return Fraction(window[0] - window[n], n)
    middle = Fraction(sum(window), n + 1)
    times = [Fraction(n, 2) - i for i in range(n + 1)]
    return sum(t * (y - middle) for t, y in zip(times, window, strict=True)) / sum(t * t for t in times)


def by_trying(kind: type, readings: list[int], noise: Fraction, most: int) -> tuple[int, Fraction]:
    """The window (ticks) and slope (counts a tick) at the last reading, every line tried on every reading of it."""
    past = readings[::-1]
    chosen = (1, Fraction(past[0] - past[1]))
    for n in range(2, min(most, len(past) - 1) + 1):
        slope = slope_of(kind, past[: n + 1])
        if any(abs(past[0] - i * slope - past[i]) > noise for i in range(n + 1)):
            break
        chosen = (n, slope)
    return chosen


@KINDS
@given(readings=counts, noise=st.sampled_from([Fraction(1, 2), Fraction(1), Fraction(5, 2)]), most=st.integers(1, 20))
@settings(max_examples=60)
def test_it_is_the_longest_line_that_passes_by_every_reading(
        kind: type, readings: list[int], noise: Fraction, most: int) -> None:
    found = velocities(kind(noise=float(noise) * STEP, most=most), [STEP * y for y in readings])
    for k in range(1, len(readings)):
        _, slope = by_trying(kind, readings[: k + 1], noise, most)
        assert found[k] * T / STEP == pytest.approx(float(slope), abs=1e-11)


@given(v=st.floats(-2.0, 2.0), phase=st.floats(0.0, 0.999), most=st.integers(2, 30))
@settings(max_examples=40)
def test_on_a_quantised_ramp_the_end_fit_keeps_its_longest_window(v: float, phase: float, most: int) -> None:
    """So it is off by less than one step over the whole window, however the encoder rounds."""
    found = velocities(EndFit(noise=STEP, most=most), floored(ramp(v, 3 * most), STEP, phase))
    for estimate in found[most:]:
        assert abs(estimate - v) < STEP / (most * T) * (1.0 + 1e-6)


@KINDS
@given(pushes=st.lists(st.tuples(st.floats(-20.0, 20.0), st.integers(1, 15)), min_size=1, max_size=5),
       v=st.floats(-0.3, 0.3), phase=st.floats(0.0, 0.999))
@settings(max_examples=30)
def test_the_error_is_within_the_bound_of_the_window_that_was_chosen(
        kind: type, pushes: list[tuple[float, int]], v: float, phase: float) -> None:
    """(w + miss)/(n T) + a n T/2, with n from the rule and a the largest acceleration within the window."""
    accelerations = [a for a, ticks in pushes for _ in range(ticks)]
    xs, vs = driven([*accelerations, 0.0], v)
    readings = floored(xs, STEP, phase)
    found = velocities(kind(noise=STEP), readings)
    whole = [round(y / STEP) for y in readings]
    for k in range(1, len(whole)):
        n, _ = by_trying(kind, whole[: k + 1], Fraction(1), 15)
        a = max(map(abs, accelerations[k - n : k]))
        miss = 0.0 if kind is EndFit else STEP
        assert abs(found[k] - vs[k]) <= (STEP + miss) / (n * T) + 0.5 * a * n * T + 1e-9


@KINDS
def test_a_stall_longer_than_the_window_begins_a_new_one(kind: type) -> None:
    estimator = kind(noise=1e-5, most=4)
    c, s = estimator.coefficients(T), estimator.start(0.0)
    for x in ramp(0.01, 10)[1:]:
        _, s = estimator.step(c, s, x, T)
    v, s = estimator.step(c, s, 1.0, 6.0 * T)
    assert v == (1.0 - 0.01 * 9 * T) / (6.0 * T)
    assert s[0] == 1.0
    assert all(isnan(x) for x in s[1:])
    v, _ = estimator.step(c, s, 1.0 + 2e-6, T)
    assert v == pytest.approx(2e-3)


@KINDS
def test_a_span_of_one_tick_to_rounding_is_no_stall(kind: type) -> None:
    """Spans as they come from a clock: differences of times, not dt itself."""
    estimator = kind(noise=1e-5)
    c, s, t = estimator.coefficients(T), estimator.start(0.0), 1e4
    for k in range(1, 30):
        now = 1e4 + k * T
        v, s = estimator.step(c, s, 1e-6 * (k // 3), now - t)
        t = now
    assert not any(map(isnan, s))
    assert v == pytest.approx(1e-3 / 3.0, rel=0.1)


@KINDS
def test_a_reading_that_is_none_is_forgotten_with_the_window(kind: type) -> None:
    estimator = kind(noise=1e-5, most=4)
    found = velocities(estimator, [*ramp(0.01, 5), float("nan"), *[0.01 * k * T for k in range(6, 20)]])
    assert isnan(found[5])
    assert isnan(found[6])
    assert found[7:] == pytest.approx([0.01] * 13)
