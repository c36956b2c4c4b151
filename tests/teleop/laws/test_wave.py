"""Wave variables: the algebra of both ends to rounding, what the channel feels like, and the energy of the link."""

from __future__ import annotations

from math import pi, sqrt

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from teleop import At, Wave
from teleop.laws.wave import Back, Forth, WaveSlave


def spread(low: float, high: float) -> st.SearchStrategy[float]:
    """Values between low and high, evenly in the logarithm."""
    return st.floats(0.0, 1.0).map(lambda part: low * (high / low) ** part)


def at(x: float = 0.0, v: float = 0.0, dt: float = 1e-3, *, fresh: bool = True) -> At:
    """What a wave end is told; the rest is not computed."""
    nan = float("nan")
    return At(x, v, nan, nan, nan, fresh, nan, dt, dt)


motion = st.floats(-10.0, 10.0).map(lambda value: round(value, 12))  # no squares that vanish


# The transforms


@given(b=spread(1e-3, 1e3), v=motion, w=motion)
def test_the_masters_power_is_that_of_its_waves(b: float, v: float, w: float) -> None:
    f, (u,), _ = Wave(b=b).master((), at(v=v), Back(w))
    size = u * u + w * w
    assert (u * u - w * w) / 2.0 == pytest.approx(f * v, abs=1e-14 * size)
    assert (u + w) / sqrt(2.0 * b) == pytest.approx(v, abs=1e-14 * sqrt(size / b))
    assert sqrt(b / 2.0) * (u - w) == pytest.approx(f, abs=1e-14 * sqrt(size * b))


def test_a_worked_example() -> None:
    """Known numbers: b = 0.8, v = 0.05, f = 1 has u = 0.8222, w = -0.7589, 0.0500 W."""
    w = (0.8 * 0.05 - 1.0) / sqrt(1.6)
    f, (u,), _ = Wave(b=0.8).master((), at(v=0.05), Back(w))
    assert (round(u, 4), round(w, 4)) == (0.8222, -0.7589)
    assert f == pytest.approx(1.0, rel=1e-15)
    assert (u * u - w * w) / 2.0 == pytest.approx(0.0500, rel=1e-15)


gains = st.one_of(st.just(0.0), spread(1e-2, 1e9))


@given(b=spread(1e-3, 1e3), K=gains, B=st.one_of(st.just(0.0), spread(1e-3, 1e4)), dt=spread(1e-5, 1e-1),
       u=motion, v=motion, x=st.floats(-0.01, 0.01))
@settings(max_examples=50)
def test_the_slaves_power_is_that_of_its_waves(
        b: float, K: float, B: float, dt: float, u: float, v: float, x: float) -> None:
    """With the x_d that the tick ends with, at any stiffness: (u^2 - w^2)/2 = f_s v_d.

    The commanded point starts at 0, so that v_d = x_d/dt keeps all its digits. What it cannot keep below
    one part in 2^53 of the position is a force of K times that.
    """
    f_s, (w,), (x_d, _) = Wave(b=b, K=K, B=B).slave(WaveSlave(0.0), at(x=x, v=v, dt=dt), Forth(u))
    v_d = x_d / dt
    grain = 1e-15 * (K * (abs(x) + abs(x_d)) + B * (abs(v) + abs(v_d)))
    near = 5e-14 * (abs(f_s * v_d) + u * u + w * w) + grain * (abs(v_d) + abs(w) / sqrt(b / 2.0))
    assert (u * u - w * w) / 2.0 == pytest.approx(f_s * v_d, abs=near)


@given(b=spread(0.1, 100.0), K=spread(1.0, 1e5), B=spread(0.1, 100.0), v=st.floats(-1.0, 1.0), gap=st.integers(1, 50))
def test_a_steady_motion_goes_on_after_ticks_that_were_left_out_as_if_there_had_been_none(
        b: float, K: float, B: float, v: float, gap: int) -> None:
    """Steady: v_d = v under u = sqrt(b/2) v + f_s/sqrt(2b), at any gap. It drifted by v dt for each tick left out."""
    law, dt, ahead = Wave(b=b, K=K, B=B), 1e-3, 0.01
    u = (b * v + K * ahead) / sqrt(2.0 * b)
    s = WaveSlave(ahead, v)
    for ticks in (1, gap):
        here = at(0.0, v)._replace(x=ticks * dt * v, span=ticks * dt)
        f_s, (w,), after = law.slave(s, here, Forth(u))
        grain = 1e-12 * (1.0 + K + B)
        assert after.v_d == pytest.approx(v, abs=grain / b)
        assert after.x_d == pytest.approx(ahead + ticks * dt * v, abs=dt * grain / b)
        assert f_s == pytest.approx(K * ahead, abs=grain * (1.0 + K * dt / b))
        assert (u * u - w * w) / 2.0 == pytest.approx(f_s * v, abs=grain * (1.0 + abs(u)) ** 2 * (1.0 + 1.0 / b))


@given(K=st.sampled_from([0.0, 500.0, 1e6, 1e9]), b=spread(1e-3, 1e3), B=spread(1e-3, 1e4), dt=spread(1e-5, 1e-1),
       u=motion, v=motion, x=motion, x_d=motion)
@settings(max_examples=80)
def test_velocity_and_force_of_the_slaves_port_solve_their_two_equations_together(
        K: float, b: float, B: float, dt: float, u: float, v: float, x: float, x_d: float) -> None:
    """Against mpmath: f = sqrt(2b) u - b v_d and f = K (x_d + dt v_d - x) + B (v_d - v), solved at 50 digits."""
    with mpmath.workdps(50):
        mb, mK, mB, mdt, mu, mv, mx, mx_d = map(mpmath.mpf, (b, K, B, dt, u, v, x, x_d))
        v_d, f = mpmath.lu_solve(
            mpmath.matrix([[mb, 1], [mK * mdt + mB, -1]]),
            mpmath.matrix([mpmath.sqrt(2 * mb) * mu, -mK * (mx_d - mx) + mB * mv]),
        )
        w = mu - mpmath.sqrt(2 / mb) * f
        got_f, (got_w,), (got_x_d, _) = Wave(b=b, K=K, B=B).slave(WaveSlave(x_d), at(x, v, dt), Forth(u))
        # A position is known to one part in 2^53 and the spring makes that a force.
        spring, damper = K * (abs(x) + abs(x_d) + dt * abs(v_d)), B * (abs(v) + abs(v_d))
        grain = 2e-15 * (spring + damper + abs(f) + sqrt(2 * b) * abs(u))
        assert abs(got_f - f) <= grain
        assert abs(got_w - w) <= mpmath.sqrt(2 / mb) * grain + 4e-15 * abs(u)
        moved = 4e-15 * (abs(x_d) + dt * abs(v_d)) + dt * grain / (b + B + K * dt)
        assert abs(got_x_d - (mx_d + mdt * v_d)) <= moved


@given(b=spread(1e-3, 1e3), v=motion, w=motion, x=motion)
def test_a_missing_wave_counts_as_zero_whatever_came_before(b: float, v: float, w: float, x: float) -> None:
    law = Wave(b=b)
    assert law.master((), at(v=v, fresh=False), Back(w)) == law.master((), at(v=v), Back(0.0))
    stale = law.slave(WaveSlave(x), at(x, v, fresh=False), Forth(w))
    assert stale == law.slave(WaveSlave(x), at(x, v), Forth(0.0))


# What the channel feels like


def impedance(law: Wave, frequency: float, delay: int, *, seconds: int = 2) -> complex:
    """F/V at the master, at a frequency in whole Hz, with a held slave behind `delay` ticks of 1 ms each way.

    Nothing dissipates in an unmatched channel, so what the start left rings for ever, but at odd multiples
    of 1/(4T): over one whole second a sum picks out the frequency alone.
    """
    dt, count = 1e-3, 1000 * seconds
    forth, back = [Forth(0.0)] * delay, [Back(0.0)] * delay
    state = WaveSlave(0.0)
    speeds, forces = [], []
    for k in range(count):
        v = np.cos(2.0 * pi * frequency * k * dt)
        f, u, _ = law.master((), at(v=v), back[k])
        _, w, state = law.slave(state, at(), forth[k])
        forth.append(u)
        back.append(w)
        speeds.append(v)
        forces.append(f)
    turn = np.exp(-2j * pi * frequency * dt * np.arange(count - 1000, count))
    return complex((turn @ forces[-1000:]) / (turn @ speeds[-1000:]))


def z_in(b: float, z_load: float, T: float, frequency: float) -> complex:
    """Known numbers: Z_in = b (1 - G e^-2sT)/(1 + G e^-2sT) with G = (b - Z_L)/(b + Z_L)."""
    gamma = 1.0 if z_load == 0.0 else -1.0 if z_load == float("inf") else (b - z_load) / (b + z_load)
    turn = gamma * np.exp(-2j * 2.0 * pi * frequency * T)
    return complex(b * (1.0 - turn) / (1.0 + turn))


@pytest.mark.parametrize(("law", "z_load"), [
    (Wave(b=0.8, K=0.0, B=0.0), 0.0), (Wave(b=0.8, K=1e12, B=1e12), float("inf")), (Wave(b=0.8, K=0.0, B=2.0), 2.0),
    (Wave(b=0.8, K=0.0, B=0.3), 0.3), (Wave(b=0.8, K=0.0, B=0.8), 0.8),  # matched: it sends nothing back
])
def test_the_channel_transforms_an_impedance_like_a_transmission_line(law: Wave, z_load: float) -> None:
    seconds = 12 if z_load in (0.3, 2.0) else 2  # what damps takes its time to forget the start
    for frequency in (1.0, 7.0, 18.0):
        want = z_in(0.8, z_load, 0.05, frequency)
        assert impedance(law, frequency, 50, seconds=seconds) == pytest.approx(want, rel=1e-9), frequency
    published = [abs(z_in(0.8, 0.0, 0.05, frequency)) for frequency in (1.0, 4.0)]
    assert published == pytest.approx([0.25994, 2.46215], abs=5e-6)
