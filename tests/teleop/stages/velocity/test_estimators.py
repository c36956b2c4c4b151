"""Velocity estimators: what each keeps, what each is held to, and what they resolve."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from fractions import Fraction
from math import copysign, cos, floor, inf, isfinite, isnan, nan, pi, sin, sqrt
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from teleop import BackwardDifference, BestFit, EndFit, LowPass
from teleop.stages.velocity.levant import LAMBDA0, LAMBDA1, Levant

T = 1e-3  # s


def velocities(estimator: Any, readings: Sequence[float], dt: float = T) -> list[float]:
    """The estimate at each reading, zero at the first, which is the start."""
    c, s = estimator.coefficients(dt), estimator.start(readings[0])
    found = [0.0]
    for x in readings[1:]:
        v, s = estimator.step(c, s, x, dt)
        found.append(v)
    return found


def ramp(v: float, count: int, dt: float = T) -> list[float]:
    return [v * (k * dt) for k in range(count)]


def driven(accelerations: Iterable[float], v: float = 0.0, dt: float = T) -> tuple[list[float], list[float]]:
    """Positions and velocities at the ticks under accelerations held for a tick each, exactly, from 0 m."""
    x, xs, vs = 0.0, [], []
    for a in accelerations:
        xs.append(x)
        vs.append(v)
        x, v = x + dt * (v + 0.5 * dt * a), v + dt * a
    return xs, vs


def sine(count: int, amplitude: float = 0.01, frequency: float = 1.0) -> tuple[list[float], list[float]]:
    omega = 2.0 * pi * frequency
    times = [k * T for k in range(count)]
    return [amplitude * sin(omega * t) for t in times], [amplitude * omega * cos(omega * t) for t in times]


def floored(xs: Iterable[float], step: float, phase: float = 0.0) -> list[float]:
    return [step * floor(x / step + phase) for x in xs]


def rms(found: Sequence[float], true: Sequence[float]) -> float:
    return sqrt(sum((a - b) ** 2 for a, b in zip(found, true, strict=True)) / len(found))


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
def test_after_a_motion_it_comes_to_rest_exactly(estimator: Any) -> None:
    readings = floored(sine(300)[0], 1e-5)
    found = velocities(estimator, readings + readings[-1:] * 3000)
    if isinstance(estimator, LowPass):  # exponentially: 3 s of 30 Hz are exp(-565)
        assert abs(found[-1]) < 1e-200
    else:
        assert found[-500:] == [0.0] * 500


@every
def test_a_ramp_gives_its_slope_and_a_constant_none(estimator: Any) -> None:
    for v in (0.02, -0.3):
        assert velocities(estimator, ramp(v, 2000))[1000:] == pytest.approx([v] * 1000, rel=1e-9)
    for x in (0.1, -3.7e-5, 1e6):
        assert velocities(estimator, [x] * 50) == [0.0] * 50


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


@given(x0=st.floats(-1.0, 1.0), x1=st.floats(-1.0, 1.0), span=st.sampled_from([1e-4, 1e-3, 0.5]))
def test_a_backward_difference_is_over_the_span(x0: float, x1: float, span: float) -> None:
    estimator = BackwardDifference()
    v, s = estimator.step(estimator.coefficients(T), estimator.start(x0), x1, span)
    assert v == (x1 - x0) / span
    assert s == (x1,)


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


# Adaptive windows against the rule tried line by line in whole numbers

COUNT = 2.0**-17  # m: encoder counts times this are exact
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
def test_a_window_is_the_longest_line_that_passes_by_every_reading(
        kind: type, readings: list[int], noise: Fraction, most: int) -> None:
    found = velocities(kind(noise=float(noise) * COUNT, most=most), [COUNT * y for y in readings])
    for k in range(1, len(readings)):
        _, slope = by_trying(kind, readings[: k + 1], noise, most)
        assert found[k] * T / COUNT == pytest.approx(float(slope), abs=1e-11)


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


# Levant's differentiator

bounds = st.sampled_from([0.1, 1.0, 30.0])


@given(L=bounds, z0=st.floats(-1.0, 1.0), z1=st.floats(-1.0, 1.0), span=st.sampled_from([1e-4, 1e-3, 5e-3]),
       off=st.floats(-1e-2, 1e-2) | st.floats(-2e-6, 2e-6))
@settings(max_examples=50)
def test_a_step_of_levant_solves_implicit_equations(L: float, z0: float, z1: float, off: float, span: float) -> None:
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
def test_for_a_short_tick_levant_is_the_differential_equation(L: float) -> None:
    """Against a tight integration from a velocity error of 0.1 m/s, up to the second change of sign and past it."""
    v, dt = 0.1, 2e-6 / L

    def off(_: float, e: np.ndarray) -> list[float]:
        sigma, off = e
        return [off - LAMBDA0 * sqrt(L * abs(sigma)) * np.sign(sigma), -LAMBDA1 * L * np.sign(sigma)]

    end = 1.1 * v / L
    exact = solve_ivp(off, (0.0, end), [0.0, -v], max_step=end / 2000, rtol=1e-9, atol=1e-12, dense_output=True).sol
    found = velocities(Levant(L=L), ramp(v, int(end / dt), dt), dt)
    for share in (0.2, 0.5, 0.8, 0.9, 0.95, 0.99):
        k = int(share * end / dt)
        assert found[k] == pytest.approx(v + exact(k * dt)[1], abs=2e-3 * v)


@given(L=bounds, v=st.floats(0.01, 1.0))
@settings(max_examples=10)
def test_levant_comes_to_a_ramp_in_finite_time(L: float, v: float) -> None:
    """1.25 v/L, measured, and from there on the slope to rounding."""
    ticks = int(1.3 * v / L / T) + 5
    if ticks > 4000:
        L, ticks = 1.0, int(1.3 * v / T) + 5
    assert velocities(Levant(L=L), ramp(v, ticks + 50))[ticks:] == pytest.approx([v] * 50, abs=1e-11)


@given(L=bounds, shares=st.lists(st.floats(-1.0, 1.0), min_size=2, max_size=100))
@settings(max_examples=40)
def test_once_there_levant_is_off_by_half_a_tick_of_acceleration_at_most(L: float, shares: list[float]) -> None:
    """From rest, which it knows: it slides from the first tick, and no acceleration within L ends that."""
    xs, vs = driven([share * L for share in shares])
    for estimate, v in zip(velocities(Levant(L=L), xs), vs, strict=True):
        assert abs(estimate - v) <= 0.5 * L * T + 1e-11


def test_what_is_faster_than_L_is_followed_at_the_largest_rate() -> None:
    L = 1.0
    found = velocities(Levant(L=L), [0.0] * 10 + [0.01] * 20)
    changes = np.diff(found)
    assert np.abs(changes).max() == pytest.approx(LAMBDA1 * L * T)
    assert changes[9] == pytest.approx(LAMBDA1 * L * T)


# The low-pass

cutoffs = st.floats(0.1, 2000.0)


@pytest.mark.parametrize("cutoff", [1.0, 30.0, 500.0])
def test_a_low_pass_is_the_exact_one_for_a_held_difference(cutoff: float) -> None:
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
def test_one_long_span_of_a_low_pass_is_as_many_short_ones(cutoff: float, d: float, v: float, n: int) -> None:
    estimator = LowPass(cutoff=cutoff)
    c = estimator.coefficients(T)
    s = (0.0, v)
    for k in range(1, n + 1):
        short, s = estimator.step(c, s, d * (k * T), T)
    long, _ = estimator.step(c, (0.0, v), d * (n * T), n * T)
    assert long == pytest.approx(short, abs=1e-11)
