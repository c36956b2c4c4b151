"""Exact bodies: against multiple precision, the matrix exponential, and two of scipy's integrators."""

import math
import random
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from teleop.physics.plant import MassDamper, free_space, grip, grip_force, linear, move_gripped, response, spring_damper
from tests.teleop.physics.motions import ten_to

quiet = settings(max_examples=60)
signed = st.floats(-10.0, 10.0, allow_subnormal=False)


def precise_response(m: float, c: float, k: float, tau: float) -> tuple[Any, Any, Any]:
    """S, S', W by the textbook formula in so many digits that cancellation does not matter."""
    with mp.workdps(400):
        m, c, k, tau = mp.mpf(m), mp.mpf(c), mp.mpf(k), mp.mpf(tau)
        sigma, w2 = c / (2 * m), k / m
        root = mp.sqrt(mp.mpc(sigma**2 - w2))
        decay = mp.exp(-sigma * tau)
        s = decay * (mp.re(mp.sinh(root * tau) / root) if root else tau)
        ds = decay * mp.re(mp.cosh(root * tau)) - sigma * s
        if k:
            return s, ds, (1 - ds - 2 * sigma * s) / w2
        return s, ds, (tau - s) / (2 * sigma) if c else tau**2 / 2


def cases(count: int, seed: int) -> list[tuple[float, float, float, float]]:
    """(m, c, k, tau) of every magnitude: a quarter almost critical, some undamped, some without spring."""
    dice = random.Random(seed)
    found = []
    for _ in range(count):
        m, tau = 10 ** dice.uniform(-4, 3), 10 ** dice.uniform(-6, -1)
        k = 0.0 if dice.random() < 0.1 else 10 ** dice.uniform(-3, 9)
        c = 0.0 if dice.random() < 0.1 else 10 ** dice.uniform(-5, 5)
        if dice.random() < 0.25:
            c = 2.0 * math.sqrt(k * m) * (1.0 + dice.choice([-1.0, 1.0]) * 10 ** dice.uniform(-16, -1))
        found.append((m, c, k, tau))
    return found


def test_response_keeps_thirteen_digits_over_thirteen_decades() -> None:
    # A phase or an exponent of n has a rounding error of n units: the error allowed grows with them. Where
    # S and S' cross zero they are as exact as their envelope.
    for m, c, k, tau in cases(500, seed=1):
        sigma, omega = 0.5 * c / m, math.sqrt(k / m)
        gap = sigma * sigma - omega * omega
        d = math.sqrt(abs(gap))
        slow = sigma if gap < 0 else k / m / (sigma + d) if k else 0.0
        envelope = mp.exp(-slow * tau)
        if envelope < 1e-290:
            continue
        allowed = 1e-13 * (1.0 + (slow + d * (gap < 0)) * tau)
        s, ds, w = response(m, c, k, tau)
        s_, ds_, w_ = precise_response(m, c, k, tau)
        assert abs(s - s_) <= allowed * max(abs(s_), envelope * min(tau, 1 / d if d else tau)), (m, c, k, tau)
        size = envelope + sigma * abs(s_) if gap < 0 else (1 + (sigma + d) * tau) * abs(ds_) + slow * s_
        assert abs(ds - ds_) <= allowed * size + 1e-290, (m, c, k, tau)
        assert abs(w - w_) <= allowed * w_, (m, c, k, tau)


def test_response_at_once_and_without_finite_rates() -> None:
    assert response(0.5, 3.0, 40.0, 0.0) == (0.0, 1.0, 0.0)
    assert all(map(math.isnan, response(1e-320, 1.0, 1.0, 1e-3)))


@quiet
@given(m=ten_to(-2, 2), c=ten_to(-2, 2), k=ten_to(-1, 5), dt=ten_to(-4, -2))
def test_step_is_the_matrix_exponential(m: float, c: float, k: float, dt: float) -> None:
    step = linear(m, c, k, dt)
    whole = expm(np.array([[0.0, 1.0, 0.0], [-k / m, -c / m, 1 / m], [0.0, 0.0, 0.0]]) * dt)
    np.testing.assert_allclose([step[:3], step[3:]], whole[:2], rtol=1e-10, atol=1e-12 * np.abs(whole).max())


def test_body_in_free_space_keeps_its_speed() -> None:
    plant = free_space(MassDamper(mass=0.7), 0.25)
    assert plant.move(plant.c, 1.0, 2.0, 0.0) == (1.5, 2.0, 0)
    assert plant.force(plant.c, 1.0, 2.0) == 0.0
    x, v, _ = plant.move(plant.c, 0.0, 0.0, 1.4)
    assert (x, v) == pytest.approx((0.5 * 2.0 * 0.25**2, 2.0 * 0.25), rel=1e-15)


@quiet
@given(m=ten_to(-4, 3), c=ten_to(-5, 5), dt=ten_to(-6, -1))
def test_a_body_at_rest_without_a_spring_stays_to_the_last_bit(m: float, c: float, dt: float) -> None:
    step = linear(m, c, 0.0, dt)
    assert step.a11 == 1.0
    assert step.a21 == 0.0


@quiet
@given(x=signed, v=signed, f=signed, at=signed, c=st.just(0.0) | ten_to(-2, 1))
def test_bonded_body_balances_its_energy(x: float, v: float, f: float, at: float, c: float) -> None:
    # Work of f less the change of energy is what the dampers took: positive, and zero without dampers.
    m, k = 0.5, 300.0
    plant = spring_damper(MassDamper(mass=m, damping=c), 0.01, k=k, d=c, at=at)
    x1, v1, capped = plant.move(plant.c, x, v, f)
    stored = 0.5 * m * (v1 * v1 - v * v) + 0.5 * k * ((x1 - at) ** 2 - (x - at) ** 2)
    lost = f * (x1 - x) - stored
    tiny = 1e-11 * (1.0 + v * v + v1 * v1 + k * (x - at) ** 2)
    assert capped == 0
    assert lost >= -tiny
    assert lost <= (tiny if c == 0.0 else math.inf)
    assert plant.force(plant.c, x, v) == k * (x - at) + c * v


def held_hand(method: str, body: MassDamper, hand: tuple[float, float, float], dt: float, *,
              x: float, v: float, f_m: float, r0: float, r1: float) -> tuple[float, float]:
    """Hand and master with the reference running straight from r0 to r1, integrated numerically."""
    m_h, k, d = hand
    mass, slope = body.mass + m_h, (r1 - r0) / dt

    def rate(t: float, y: Any) -> list[float]:
        pull = k * (r0 + slope * t - y[0]) + d * (slope - y[1])
        return [y[1], (pull - body.damping * y[1] - f_m) / mass]

    jacobian = np.array([[0.0, 1.0], [-k / mass, -(d + body.damping) / mass]])
    extra = {"jac": jacobian} if method == "Radau" else {}
    end = solve_ivp(rate, (0.0, dt), [x, v], method=method, rtol=1e-13, atol=1e-15, **extra).y[:, -1]
    return float(end[0]), float(end[1])


@pytest.mark.parametrize(("method", "count"), [("DOP853", 30), ("Radau", 6)])
def test_gripped_master_matches_integrators(method: str, count: int) -> None:
    dice = random.Random(method)
    for _ in range(count):
        body = MassDamper(mass=10 ** dice.uniform(-2, 0), damping=10 ** dice.uniform(-2, 1))
        hand = (10 ** dice.uniform(-2, 0), 10 ** dice.uniform(1, 5), 10 ** dice.uniform(-1, 2))
        dt = 10 ** dice.uniform(-4, -2)
        x, r0, r1 = (dice.uniform(-0.05, 0.05) for _ in range(3))
        v, f_m = dice.uniform(-1, 1), dice.uniform(-20, 20)
        got = move_gripped(grip(body, *hand, dt), x, v, f_m, r0, r1)
        want = held_hand(method, body, hand, dt, x=x, v=v, f_m=f_m, r0=r0, r1=r1)
        speed = abs(v) + abs(r1 - r0) / dt
        assert abs(got[0] - want[0]) <= 1e-10 * (0.1 + speed * dt)
        assert abs(got[1] - want[1]) <= 1e-10 * (1.0 + speed)


@quiet
@given(x=signed, v=signed, f_held=signed, r=signed, slope=signed, hand=st.just(0.0) | ten_to(-2, 0))
def test_grip_force_is_what_moves_the_master(*, x: float, v: float, f_held: float, r: float, slope: float,
                                             hand: float) -> None:
    # M_m a + b_m v = f_h - f_m with the acceleration of the joined body.
    body, k, d = MassDamper(mass=0.1, damping=0.5), 200.0, 5.0
    f_h = grip_force(grip(body, hand, k, d, 1e-3), x, v, f_held, r, slope)
    a = (k * (r - x) + d * (slope - v) - body.damping * v - f_held) / (body.mass + hand)
    assert body.mass * a + body.damping * v == pytest.approx(f_h - f_held, rel=1e-12, abs=1e-11)


def test_what_is_not_finite_stays_so() -> None:
    body = MassDamper(mass=0.1, damping=0.5)
    held = grip(body, 0.4, 200.0, 5.0, 1e-3)
    for bad in (math.nan, math.inf, -math.inf):
        for plant in (free_space(body, 1e-3), spring_damper(body, 1e-3, k=100.0, d=1.0)):
            for state in ((bad, 0.0, 0.0), (0.0, bad, 0.0), (0.0, 0.0, bad)):
                assert not all(map(math.isfinite, plant.move(plant.c, *state)))
        assert not all(map(math.isfinite, move_gripped(held, 0.0, 0.0, bad, 0.0, 0.0)))
