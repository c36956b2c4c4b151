"""What every velocity estimator keeps: flat states, pure steps, no exception, the invariances of a derivative."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, isfinite, nan
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from teleop import BackwardDifference, BestFit, EndFit, Levant, LowPass
from tests.teleop.stages.velocity.signals import T, floored, ramp, sine, velocities

ESTIMATORS = [
    BackwardDifference(),
    LowPass(cutoff=30.0),
    EndFit(noise=1e-5),
    EndFit(noise=1e-5, most=1),
    BestFit(noise=1e-5),
    BestFit(noise=1e-5, most=1),
    Levant(L=1.0),
]
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


@dataclass(frozen=True)
class Growing:
    """Wrong: keeps all readings."""

    def coefficients(self, dt: float) -> tuple[()]:
        return ()

    def start(self, x: float) -> tuple[float, ...]:
        return (x,)

    @staticmethod
    def step(
        c: tuple[()], s: tuple[float, ...], x: float, span: float  # noqa: ARG004
    ) -> tuple[float, tuple[float, ...]]:
        return (x - s[-1]) / max(span, 1e-300), (*s, x)


class Dividing(Growing):
    """Wrong: divides by a span of zero."""

    @staticmethod
    def step(
        c: tuple[()], s: tuple[float, ...], x: float, span: float  # noqa: ARG004
    ) -> tuple[float, tuple[float, ...]]:
        return (x - s[-1]) / span, (x,)


class Clipping(Growing):
    """Wrong: makes a number of what is none."""

    @staticmethod
    def step(
        c: tuple[()], s: tuple[float, ...], x: float, span: float  # noqa: ARG004
    ) -> tuple[float, tuple[float, ...]]:
        return max(-1.0, min(1.0, (x - s[-1]) / max(span, 1e-300))), (x,)


@pytest.mark.parametrize("wrong", [Growing(), Dividing(), Clipping()], ids=lambda e: type(e).__name__)
def test_what_does_not_conform_is_found(wrong: Any) -> None:
    with pytest.raises((AssertionError, ZeroDivisionError)):
        conforms(wrong)


@every
@pytest.mark.parametrize("x", [0.0, 0.1, -3.7e-5, 1e6])
def test_a_constant_has_no_velocity(estimator: Any, x: float) -> None:
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
@pytest.mark.parametrize("v", [0.02, -0.3])
def test_a_ramp_gives_its_slope(estimator: Any, v: float) -> None:
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
@settings(max_examples=50)
def test_it_does_not_depend_on_the_units(estimator: Any, walk: list[int]) -> None:
    """Lengths by 16 and times by 4, powers of four, so that nothing is rounded: bit for bit."""
    readings = [sum(walk[:k]) * 1e-5 for k in range(len(walk))]
    other = velocities(scaled(estimator, 16.0, 4.0), [16.0 * x for x in readings], 4.0 * T)
    assert other == [v * 16.0 / 4.0 for v in velocities(estimator, readings)]


@every
@given(walk=walks, offset=st.integers(-(2**20), 2**20))
@settings(max_examples=50)
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
