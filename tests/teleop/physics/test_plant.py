"""Exact bodies, with one state more too: against multiple precision, the matrix exponential, integrators and limits."""

from __future__ import annotations

import math
import random
from decimal import Decimal, Inexact, localcontext
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from teleop.physics.plant import MassDamper, free_space, grip, grip_force, linear, move_gripped, response, spring_damper
from teleop.physics.relaxing import relaxing, relaxing_master, step3
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


# Bodies with one state more

HAND = (0.4, 200.0, 5.0)
MASTER = MassDamper(mass=0.1, damping=0.5)


def precise_step(m: float, c: Any, k: float, g: float, h: Any, tau: float, dt: float) -> list[Any]:
    """The step by the power series of the matrix exponential, halved and squared, in 240 digits."""
    with mp.workdps(240):
        m, c, k, g, h, tau, dt = (mp.mpf(str(each)) if isinstance(each, Decimal) else mp.mpf(each)
                                  for each in (m, c, k, g, h, tau, dt))
        # The states are x, v dt, z and f, which stays.
        a = mp.matrix([[0, 1, 0, 0], [-k * dt**2 / m, -c * dt / m, -g * dt**2 / m, dt**2 / m],
                       [0, h / tau, -dt / tau, 0], [0, 0, 0, 0]])
        n = max(0, int(mp.log(1 + mp.mnorm(a, 1), 2)) + 8)
        b, term, total = a / mp.mpf(2)**n, mp.eye(4), mp.eye(4)
        for i in range(1, 70):
            term = term * b / i
            total += term
        for _ in range(n):
            total = total * total
        unit = (1, dt, 1, 1)
        return [total[i, j] / unit[i] * unit[j] for i in range(3) for j in range(4)]


def relaxing_cases(count: int, seed: int) -> list[tuple[Any, ...]]:
    """(m, c, k, g, h, tau, dt) of every magnitude, half with a Maxwell branch, half with a shunted motor."""
    dice = random.Random(seed)
    found: list[tuple[Any, ...]] = []
    for i in range(count):
        m, tau, dt = 10 ** dice.uniform(-4, 3), 10 ** dice.uniform(-9, 6), 10 ** dice.uniform(-5, -1)
        c = dice.choice([0.0, 10 ** dice.uniform(-5, 5)])
        k = dice.choice([0.0, 10 ** dice.uniform(-3, 9)])
        if i % 2:
            found.append((m, c, k, 1.0, Decimal(10 ** dice.uniform(-3, 9)) * Decimal(tau), tau, dt))
        else:
            b_e = 10 ** dice.uniform(-3, 5)
            found.append((m, Decimal(c) + Decimal(b_e), k, -b_e, 1.0, tau, dt))
    return found


def test_every_entry_of_the_step_of_three_is_exact_to_rounding() -> None:
    for case in relaxing_cases(50, seed=1):
        for got, want in zip(step3(*case), precise_step(*case), strict=True):
            assert abs(got - want) <= 4e-16 * abs(want) + 1e-40, case  # below that it has died down


def test_the_caller_s_own_decimals_change_nothing() -> None:
    def made() -> list[Any]:
        return [relaxing(MASTER, 1e-3, k=300.0, k1=700.0, tau=0.1).c,
                relaxing_master(MASTER, *HAND, 1e-3, b_e=2.0, cutoff=10.0).c]

    usual = made()
    with localcontext(prec=3, traps=[Inexact]):
        assert made() == usual


def test_nothing_creeps_without_a_lasting_spring() -> None:
    for m, c, _, g, h, tau, dt in relaxing_cases(40, seed=2):
        step = step3(m, c, 0.0, g, h, tau, dt)
        assert (step.a11, step.a21, step.a31) == (1.0, 0.0, 0.0)


def integrated(rate: Any, start: Any, span: float) -> Any:
    return solve_ivp(rate, (0.0, span), start, method="DOP853", rtol=1e-13, atol=1e-15).y[:, -1]


def test_relaxing_tissue_matches_an_integrator() -> None:
    dice = random.Random(3)
    for _ in range(30):
        body = MassDamper(mass=10 ** dice.uniform(-1, 0.5), damping=10 ** dice.uniform(-2, 1))
        k, k1, tau, dt = (10 ** dice.uniform(*ends) for ends in ((0, 4), (0, 4), (-3, 0), (-4, -2)))
        at, x, v, f, phi = (dice.uniform(-1, 1) for _ in range(5))

        def rate(_: float, y: Any, body: MassDamper = body, k: float = k, k1: float = k1, tau: float = tau,
                 at: float = at, f: float = f) -> list[float]:
            return [y[1], (f - body.damping * y[1] - k * (y[0] - at) - y[2]) / body.mass, k1 * y[1] - y[2] / tau]

        plant = relaxing(body, dt, k=k, k1=k1, tau=tau, at=at)
        x1, v1, capped, (phi1,) = plant.move(plant.c, x, v, f, (phi,))
        assert capped == 0
        assert plant.force(plant.c, x, v, (phi,)) == k * (x - at) + phi
        np.testing.assert_allclose([x1, v1, phi1], integrated(rate, [x, v, phi], dt), rtol=1e-10, atol=1e-10)


def test_force_of_held_tissue_relaxes_to_the_lasting_one() -> None:
    # A push of 1 m/s for dt by a body too heavy to yield loads the branch to k1 tau (1 - exp(-dt/tau)), which is k1 dt
    # if it is quick.
    k, k1, dt = 300.0, 700.0, 1e-3
    for tau in (1e-4, 0.01, 2.0):
        plant = relaxing(MassDamper(mass=1e15), dt, k=k, k1=k1, tau=tau)
        x, v, _, z = plant.move(plant.c, 0.0, 1.0, 0.0, plant.start)
        assert (x, v) == pytest.approx((dt, 1.0), rel=1e-9)
        assert tau != 2.0 or plant.force(plant.c, x, 0.0, z) == pytest.approx((k + k1) * dt, rel=3e-4)
        loaded = k1 * tau * -math.expm1(-dt / tau)
        for i in range(2000):
            want = k * dt + loaded * math.exp(-i * dt / tau)
            assert plant.force(plant.c, x, 0.0, z) == pytest.approx(want, rel=1e-9)
            _, _, _, z = plant.move(plant.c, dt, 0.0, 0.0, z)


def test_limits_of_the_branch_are_a_spring_and_a_damper() -> None:
    body, dt = MassDamper(mass=0.5, damping=1.0), 1e-3
    for k1, tau, K, d, far in ((0.0, 0.1, 300.0, 0.0, 1e-14), (700.0, 1e12, 1000.0, 0.0, 1e-11),
                               (5.0 / 1e-9, 1e-9, 300.0, 5.0, 1e-7), (5.0 / 1e-13, 1e-13, 300.0, 5.0, 1e-11)):
        plant, simple = relaxing(body, dt, k=300.0, k1=k1, tau=tau, at=0.02), spring_damper(body, dt, k=K, d=d, at=0.02)
        x, v, z, y, w = 0.02, 0.0, plant.start, 0.02, 0.0
        for i in range(1000):
            f = math.sin(0.02 * i)
            x, v, _, z = plant.move(plant.c, x, v, f, z)
            y, w, _ = simple.move(simple.c, y, w, f)
            assert x == pytest.approx(y, abs=0.02 * far)
            assert plant.force(plant.c, x, v, z) == pytest.approx(simple.force(simple.c, y, w), abs=5 * far)


def test_master_with_a_shunted_motor_matches_an_integrator() -> None:
    dice = random.Random(5)
    for _ in range(30):
        m_h, k, d = 10 ** dice.uniform(-2, 0), 10 ** dice.uniform(1, 5), 10 ** dice.uniform(-1, 2)
        b_e, cutoff, dt = 10 ** dice.uniform(-1, 1.5), 10 ** dice.uniform(-1, 2.5), 10 ** dice.uniform(-4, -2)
        x, r0, r1 = (dice.uniform(-0.05, 0.05) for _ in range(3))
        v, u, f_m, slope = dice.uniform(-1, 1), dice.uniform(-1, 1), dice.uniform(-20, 20), (r1 - r0) / dt

        def rate(t: float, y: Any, k: float = k, d: float = d, mass: float = 0.1 + m_h, b_e: float = b_e,
                 w_c: float = 2 * math.pi * cutoff, r: float = r0, s: float = slope, f: float = f_m) -> list[float]:
            shunt = b_e * (y[1] - y[2])
            return [y[1], (k * (r + s * t - y[0]) + d * (s - y[1]) - 0.5 * y[1] - shunt - f) / mass,
                    w_c * (y[1] - y[2])]

        plant = relaxing_master(MASTER, m_h, k, d, dt, b_e=b_e, cutoff=cutoff)
        x1, v1, (u1,) = plant.move(plant.c, x, v, f_m, r0, r1, (u,))
        want = integrated(rate, [x, v, u], dt)
        speed = 1.0 + abs(slope)
        assert np.all(np.abs(np.array([x1, v1, u1]) - want) <= 1e-10 * np.array([0.1 + speed * dt, speed, speed]))


@quiet
@given(x=signed, v=signed, u=signed, f_held=signed, r=signed, slope=signed, hand=st.just(0.0) | ten_to(-2, 0))
def test_the_held_force_of_a_shunted_motor_is_what_moves_it(*, x: float, v: float, u: float, f_held: float, r: float,
                                                           slope: float, hand: float) -> None:
    # M_m a + b_m v + b_e (v - u) = f_h - f_m with the acceleration of the joined body, which is what it does next.
    k, d, b_e, dt = 200.0, 5.0, 3.0, 1e-7
    plant = relaxing_master(MASTER, hand, k, d, dt, b_e=b_e, cutoff=10.0)
    f_h = plant.force(plant.c, x, v, f_held, r, slope, (u,))
    _, v1, _ = plant.move(plant.c, x, v, f_held, r, r + slope * dt, (u,))
    want = MASTER.mass * (v1 - v) / dt + MASTER.damping * v + b_e * (v - u)
    assert f_h - f_held == pytest.approx(want, rel=1e-3, abs=0.5)


def test_what_is_not_a_number_stays_so_with_one_state_more() -> None:
    plant = relaxing(MassDamper(mass=0.5), 1e-3, k=1.0, k1=1.0, tau=1.0)
    assert all(map(math.isnan, plant.move(plant.c, math.nan, 0.0, 0.0, (0.0,))[:2]))
    held = relaxing_master(MASTER, *HAND, 1e-3, b_e=1.0, cutoff=10.0)
    assert math.isnan(held.move(held.c, 0.0, 0.0, math.inf, 0.0, math.nan, held.start)[0])
    assert math.isnan(held.force(held.c, 0.0, math.nan, 0.0, 0.0, 0.0, held.start))
