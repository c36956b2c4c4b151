"""What every velocity estimator keeps: flat states, pure steps, invariances of a derivative; and what it resolves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import floor, inf, isfinite, nan
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from teleop import BackwardDifference, BestFit, EndFit, Levant, LowPass
from tests.teleop.stages.velocity.signals import T, driven, floored, ramp, rms, sine, velocities

ESTIMATORS = [BackwardDifference(), LowPass(cutoff=30.0), EndFit(noise=1e-5), EndFit(noise=1e-5, most=1),
              BestFit(noise=1e-5), BestFit(noise=1e-5, most=1), Levant(L=1.0)]
every = pytest.mark.parametrize("estimator", ESTIMATORS, ids=repr)

AWKWARD = (0.0, -0.0, 5e-324, -1e-300, 1e-9, -1e50, 1.7e308, -1.7e308)
SPANS = (T, 2.0 * T, 0.0, 5e-324, 1e-300, 1e300, -T, inf, nan)
walks = st.lists(st.integers(-3, 3), min_size=2, max_size=60)


def conforms(estimator: Any, dt: float = T) -> None:
    """Assert the contract of one estimator: states, purity, determinism, and that nothing is raised."""
    c = estimator.coefficients(dt)
    assert isinstance(c, tuple)
    assert repr(estimator.coefficients(dt)) == repr(c)
    assert repr(estimator.start(0.25)) == repr(estimator.start(0.25))
    length = len(estimator.start(0.25))
    states = [estimator.start(0.25)]
    for k, x in enumerate([*floored(sine(40)[0], 1e-5), *AWKWARD, *AWKWARD[::-1], inf, 0.0, -inf, nan, 0.0, *AWKWARD]):
        for span in SPANS:
            v, s = estimator.step(c, states[-1], x, span)
            again = estimator.step(c, states[-1], x, span)
            assert repr((v, s)) == repr(again), f"not the same answer twice at reading {k}"
            assert type(v) is float
            assert type(s) is tuple
            assert len(s) == length, f"the state has {len(s)} numbers, not {length}, at reading {k}"
            assert all(type(number) is float for number in s)
        states.append(estimator.step(c, states[-1], x, SPANS[k % 2])[1])
    for span in SPANS[:6]:
        assert estimator.step(c, estimator.start(0.25), 0.25, span)[0] == 0.0, f"moves at rest after {span} s"
    for start in (0.0, 1e-3):
        for bad in (nan, inf, -inf):
            v, _ = estimator.step(c, estimator.start(start), bad, dt)
            assert not isfinite(v), f"{bad} was taken for a position"


@every
def test_it_conforms(estimator: Any) -> None:
    for dt in (1e-4, T, 1e-2):
        conforms(estimator, dt)


@every
def test_a_constant_has_no_velocity(estimator: Any) -> None:
    for x in (0.0, 0.1, -3.7e-5, 1e6):
        assert velocities(estimator, [x] * 50) == [0.0] * 50


@every
def test_after_a_motion_it_comes_to_rest_exactly(estimator: Any) -> None:
    readings = floored(sine(300)[0], 1e-5)
    found = velocities(estimator, readings + readings[-1:] * 3000)
    if isinstance(estimator, LowPass):  # exponentially: 3 s of 30 Hz are exp(-565)
        assert abs(found[-1]) < 1e-200
    else:
        assert found[-500:] == [0.0] * 500


@every
def test_a_ramp_gives_its_slope(estimator: Any) -> None:
    for v in (0.02, -0.3):
        assert velocities(estimator, ramp(v, 2000))[1000:] == pytest.approx([v] * 1000, rel=1e-9)


@every
def test_a_stall_on_a_ramp_leaves_the_slope(estimator: Any) -> None:
    """Seven ticks without a reading: the next one comes 8 T after the one before."""
    v = 0.02
    readings = ramp(v, 2000)
    c, s = estimator.coefficients(T), estimator.start(0.0)
    for x in readings[1:1000]:
        _, s = estimator.step(c, s, x, T)
    found, s = estimator.step(c, s, readings[1007], 8.0 * T)
    assert found == pytest.approx(v, rel=1e-9)
    for x in readings[1008:1100]:
        found, s = estimator.step(c, s, x, T)
        assert found == pytest.approx(v, rel=1e-9)


def scaled(estimator: Any, length: float, time: float) -> Any:
    """The same estimator in other units of length and time."""
    match estimator:
        case LowPass():
            return replace(estimator, cutoff=estimator.cutoff / time)
        case EndFit() | BestFit():
            return replace(estimator, noise=estimator.noise * length)
        case Levant():
            return replace(estimator, L=estimator.L * length / time**2)
    return estimator


@every
@given(walk=walks)
@settings(max_examples=25)
def test_it_does_not_depend_on_the_units(estimator: Any, walk: list[int]) -> None:
    """Lengths by 16 and times by 4, powers of four, so that nothing is rounded: bit for bit."""
    readings = [sum(walk[:k]) * 1e-5 for k in range(len(walk))]
    other = velocities(scaled(estimator, 16.0, 4.0), [16.0 * x for x in readings], 4.0 * T)
    assert other == [v * 16.0 / 4.0 for v in velocities(estimator, readings)]


@every
@given(walk=walks, offset=st.integers(-(2**20), 2**20))
@settings(max_examples=25)
def test_it_does_not_depend_on_the_place_or_the_direction(estimator: Any, walk: list[int], offset: int) -> None:
    """Readings in whole steps of 2^-17 m, so that moving them rounds nothing."""
    step = 2.0**-17
    readings = [sum(walk[:k]) * step for k in range(len(walk))]
    found = velocities(estimator, readings)
    assert velocities(estimator, [-x for x in readings]) == [-v for v in found]
    moved = velocities(estimator, [x + offset * step for x in readings])
    assert moved == pytest.approx(found, abs=1e-9)


def test_numbers_of_any_kind_become_those_of_python() -> None:
    """A numpy scalar in the state would be slower and be another type live than in a sweep."""
    noise, most = np.float64(1e-5), 15.0
    for made in (EndFit(noise=noise, most=most), BestFit(noise=noise, most=most)):
        assert (type(made.noise), type(made.most)) == (float, int)
        conforms(made)
    conforms(LowPass(cutoff=np.float64(30.0)))
    conforms(Levant(L=np.float64(1.0)))


# The backward difference: the mean velocity of the last span, to half a tick and a step of the encoder


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


# What they resolve of a slow sine, 1 cm at 1 Hz, read at 1 kHz by encoders of 10 to 60 um


STEPS = (1e-5, 2e-5, 3e-5, 4e-5, 5e-5, 6e-5)  # m
Make = Callable[[float], Any]

# RMS error in mm/s of a velocity of 44 mm/s RMS, by encoder step, over four periods after the first.
MEASURED: dict[str, tuple[Make, tuple[float, ...]]] = {
    "backward difference": (lambda _: BackwardDifference(), (4.03, 7.67, 11.56, 17.19, 19.40, 21.60)),
    "low-pass 10 Hz": (lambda _: LowPass(cutoff=10.0), (4.43, 4.44, 4.46, 4.48, 4.51, 4.54)),
    "low-pass 30 Hz": (lambda _: LowPass(cutoff=30.0), (1.58, 1.80, 2.20, 2.52, 2.97, 3.30)),
    "end-fit": (lambda step: EndFit(noise=step), (1.69, 2.05, 2.23, 2.36, 2.52, 2.64)),
    "best-fit": (lambda step: BestFit(noise=step), (1.70, 1.99, 2.11, 2.15, 2.20, 2.40)),
    "Levant": (lambda _: Levant(L=1.0), (1.32, 1.72, 2.18, 2.43, 2.48, 2.79)),
}


def error(make: Make, step: float) -> float:
    """mm/s."""
    xs, vs = sine(5000)
    return 1e3 * rms(velocities(make(step), floored(xs, step))[1000:], vs[1000:])


def test_the_errors_are_those_measured() -> None:
    """The orders of the literature, F. Janabi-Sharifi et al. 2000 and V. Chawda et al. 2011, are those of the table."""
    for name, (make, measured) in MEASURED.items():
        assert [error(make, step) for step in STEPS] == pytest.approx(measured, abs=0.02), name


def test_half_a_step_is_too_little_noise_for_a_window() -> None:
    """The line through two readings misses a third by up to a whole step, so the window keeps collapsing."""
    for make in (EndFit, BestFit):
        for step in STEPS[1::2]:
            half = error(lambda step, make=make: make(noise=0.5 * step), step)
            assert half > 1.6 * error(lambda step, make=make: make(noise=step), step)
