"""The human-force observer recovers the hand's force from exact velocities: an identity, not a fit."""

from __future__ import annotations

from math import cos, exp, expm1, pi, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp

from teleop import load_scene
from teleop.simulation.source import live_of
from teleop.simulation.structure import columns, numbers_of
from teleop.simulation.tick import LiveTick
from teleop.stages.observer import coefficients, observe

INSTANT = 1e9  # 1/s: a filter so fast that f_h_hat is f_bar itself

masses, dampings = st.floats(0.01, 10.0), st.one_of(st.just(0.0), st.floats(1e-9, 100.0))
ticks = st.sampled_from([1e-4, 1e-3, 1e-2])


def speed_after(v: float, f: float, M: float, b: float, dt: float) -> float:
    """M dv/dt + b v = f over dt, f constant; in closed form."""
    decay = b * dt / M
    return v * exp(-decay) + (f / b * -expm1(-decay) if b > 0.0 else f * dt / M)


@given(M=masses, b=dampings, dt=ticks, f_h=st.floats(-50.0, 50.0), f_m=st.floats(-50.0, 50.0), v=st.floats(-2.0, 2.0))
@settings(max_examples=80)
def test_a_constant_force_is_observed_exactly(M: float, b: float, dt: float, f_h: float, f_m: float, v: float) -> None:
    c = coefficients(INSTANT, M, b, dt)
    after = speed_after(v, f_h - f_m, M, b, dt)
    # What is lost is the last digit of the velocities times the gain, or the last of the smallest number.
    lost = 1e-15 * (c.gain * (abs(v) + abs(after)) + abs(f_m) + abs(f_h)) + 1e-300
    assert observe(c, 0.0, v, after, f_m) == pytest.approx(f_h, abs=4.0 * lost)


@pytest.mark.parametrize("b", [0.0, 1e-6, 0.5, 40.0])
def test_a_varying_force_is_observed_as_its_exponentially_weighted_mean(b: float) -> None:
    """Against quadrature of the weight and a tight integration of the motion: sine of the hand, 1 kHz."""
    M, dt, f_m, omega = 0.1, 1e-3, 1.3, 2.0 * pi * 40.0

    def f_h(t: float) -> float:
        return 5.0 * sin(omega * t) + 2.0

    def weight(t: float) -> float:
        return exp(-b * (dt - t) / M)

    def motion(t: float, v: np.ndarray) -> np.ndarray:
        return (f_h(t) - f_m - b * v) / M

    c = coefficients(INSTANT, M, b, dt)
    after = solve_ivp(motion, (0.0, dt), [0.2], method="DOP853", rtol=1e-13, atol=1e-15).y[0, -1]
    mean = quad(lambda t: f_h(t) * weight(t), 0.0, dt, epsabs=1e-14)[0] / quad(weight, 0.0, dt, epsabs=1e-14)[0]
    assert observe(c, 0.0, 0.2, after, f_m) == pytest.approx(mean, abs=1e-10)


@given(M=masses, dt=ticks, v=st.floats(-2.0, 2.0), after=st.floats(-2.0, 2.0), f_m=st.floats(-50.0, 50.0))
def test_without_damping_it_is_mass_times_acceleration_and_the_limit_is_smooth(
        M: float, dt: float, v: float, after: float, f_m: float) -> None:
    none = observe(coefficients(INSTANT, M, 0.0, dt), 0.0, v, after, f_m)
    assert none == pytest.approx(M * (after - v) / dt + f_m, abs=1e-12 * M / dt)
    for little in (1e-300, 1e-18, 1e-9):
        near = observe(coefficients(INSTANT, M, little, dt), 0.0, v, after, f_m)
        assert near == pytest.approx(none, abs=2.0 * little + 1e-12 * M / dt)


@given(L=st.floats(1.0, 1000.0), f_h=st.floats(-50.0, 50.0), b=dampings)
def test_it_comes_to_a_constant_force_as_a_first_order_filter(L: float, f_h: float, b: float) -> None:
    """f_h_hat(t) = f_h (1 - exp(-L t)), exactly at every tick, whatever f_m does meanwhile."""
    M, dt, v, f_h_hat = 0.1, 1e-3, 0.0, 0.0
    c = coefficients(L, M, b, dt)
    for k in range(1, 101):
        f_m = cos(k)
        after = speed_after(v, f_h - f_m, M, b, dt)
        f_h_hat = observe(c, f_h_hat, v, after, f_m)
        v = after
        assert f_h_hat == pytest.approx(f_h * -expm1(-L * k * dt), abs=1e-10)


def test_a_master_that_was_never_touched_is_observed_as_exactly_nothing() -> None:
    c = coefficients(200.0, 0.1, 0.5, 1e-3)
    assert observe(c, 0.0, 0.0, 0.0, 0.0) == 0.0


def test_a_stall_of_many_ticks_does_not_throw_the_live_estimate_off() -> None:
    """A held force and a constant hand, seen again after 70 ticks: the estimate is the hand's force still."""
    scene = load_scene("canonical", law="pfra", observer=INSTANT)
    M, b, dt = scene.master.mass, scene.master.damping, 1e-3
    begins = numbers_of(scene, {"m": (0.0,)})
    live = live_of(scene, "m")(begins, scene.law, dt, (0.0,), (0.0,), None)
    live.send(None)
    at = [name.removesuffix("@") for name in columns(scene, "m")].index("f_h_hat")
    v, before, f_m = 0.0, 0, 0.0
    for k in (0, 1, 2, 72, 73, 200):
        v, before = speed_after(v, 0.3 - f_m, M, b, (k - before) * dt), k
        force, _, _, row = live.send(LiveTick(
            k, (0.0,), (v,), None, False, -1, None, None, 1.0, (f_m,), 1, 0.0, 1.0))
        f_m = force[0]
        if k:
            assert row[at] == pytest.approx(0.3, abs=1e-9)
