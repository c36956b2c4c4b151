"""Bodies with one state more: against multiple precision, an integrator and their limits."""

import math
import random
from decimal import Decimal, Inexact, localcontext
from functools import partial
from itertools import product
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from teleop.physics.plant import MassDamper, grip, grip_force, move_gripped, spring_damper
from teleop.physics.relaxing import relaxing, relaxing_master, step3
from tests.teleop.physics.motions import ten_to

quiet = settings(max_examples=60)
signed = st.floats(-10.0, 10.0, allow_subnormal=False)
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


def cases(count: int, seed: int) -> list[tuple[Any, ...]]:
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


def test_every_entry_of_the_step_is_exact_to_rounding() -> None:
    for case in cases(50, seed=1):
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
    for m, c, _, g, h, tau, dt in cases(40, seed=2):
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


def test_tissue_under_a_lasting_force_creeps_to_its_lasting_stiffness() -> None:
    # Without mass: x = f/k (1 - k1/(k + k1) exp(-t k/((k + k1) tau))), slower than the force relaxes.
    k, k1, tau, f, dt = 300.0, 700.0, 0.1, 2.0, 1e-2
    plant = relaxing(MassDamper(mass=1e-9, damping=1e-4), dt, k=k, k1=k1, tau=tau)
    x, v, z = 0.0, 0.0, plant.start
    for i in range(1, 300):
        x, v, _, z = plant.move(plant.c, x, v, f, z)
        assert x == pytest.approx(f / k * (1 - k1 / (k + k1) * math.exp(-i * dt * k / ((k + k1) * tau))), rel=1e-5)
    assert x == pytest.approx(f / k, rel=1e-3)


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


def follow(move: Any, force: Any, dt: float, z: tuple[Any, ...] = (), f_m: float = 0.3) -> tuple[Any, ...]:
    """Position and velocity of a master after 400 ticks of the hand's sine, and the grip's last force."""
    x, v, count, inner = 0.0, 0.0, 400, [*z]
    ref = [0.05 * math.sin(6.0 * k * dt) for k in range(count + 1)]
    for k in range(count):
        x, v, *inner = move(x, v, f_m, ref[k], ref[k + 1], *inner)
    return x, v, force(x, v, f_m, ref[count], (ref[count] - ref[count - 1]) / dt, *inner)


def test_limits_of_the_shunt_are_a_damper_and_a_mass() -> None:
    for b_e, cutoff, like, far in (
        (0.0, 10.0, MASTER, 1e-12), (2.0, 1e-13, MassDamper(mass=0.1, damping=2.5), 1e-11), (2.0, 1e13, MASTER, 1e-11),
        (1e9, 1e9 / 0.03 / (2 * math.pi), MassDamper(mass=0.13, damping=0.5), 1e-6),  # the capacitor's mass
    ):
        plant, c = relaxing_master(MASTER, *HAND, 1e-3, b_e=b_e, cutoff=cutoff), tuple(grip(like, *HAND, 1e-3))
        x, v, f_h = follow(partial(plant.move, plant.c), partial(plant.force, plant.c), 1e-3, (plant.start,))
        y, w, g_h = follow(partial(move_gripped, c), partial(grip_force, c), 1e-3)
        assert (x, v) == pytest.approx((y, w), abs=0.1 * far)
        assert b_e == 1e9 or f_h == pytest.approx(g_h, abs=10 * far)


def test_damping_dies_down_from_b_at_the_rate_of_its_cutoff_in_hz() -> None:
    # Against a velocity that begins at once and stays, b s/(s + w_c) answers b v exp(-w_c t).
    b_e, cutoff, dt = 3.0, 10.0, 1e-3
    plant = relaxing_master(MassDamper(mass=1.0), 1e12, 0.0, 0.0, dt, b_e=b_e, cutoff=cutoff)
    x, v, z = 0.0, 0.2, plant.start
    for k in range(200):
        assert b_e * (v - z[0]) == pytest.approx(b_e * 0.2 * math.exp(-2 * math.pi * cutoff * k * dt), rel=1e-9)
        x, v, z = plant.move(plant.c, x, v, 0.0, 0.0, 0.0, z)


@quiet
@given(x=signed, v=signed, u=signed, f_held=signed, r=signed, slope=signed, hand=st.just(0.0) | ten_to(-2, 0))
def test_held_force_is_what_moves_the_master(*, x: float, v: float, u: float, f_held: float, r: float, slope: float,
                                             hand: float) -> None:
    # M_m a + b_m v + b_e (v - u) = f_h - f_m with the acceleration of the joined body, which is what it does next.
    k, d, b_e, dt = 200.0, 5.0, 3.0, 1e-7
    plant = relaxing_master(MASTER, hand, k, d, dt, b_e=b_e, cutoff=10.0)
    f_h = plant.force(plant.c, x, v, f_held, r, slope, (u,))
    _, v1, _ = plant.move(plant.c, x, v, f_held, r, r + slope * dt, (u,))
    want = MASTER.mass * (v1 - v) / dt + MASTER.damping * v + b_e * (v - u)
    assert f_h - f_held == pytest.approx(want, rel=1e-3, abs=0.5)


def test_extremes_stay_finite_and_bounded() -> None:
    for mass, k, k1, tau, dt in product((1e-4, 1e3), (0.0, 1e9), (0.0, 1e9), (1e-9, 1e6), (1e-5, 0.1)):
        plant = relaxing(MassDamper(mass=mass), dt, k=k, k1=k1, tau=tau)
        x, v, z = 0.01, 0.0, plant.start
        for _ in range(100):
            x, v, _, z = plant.move(plant.c, x, v, 0.0, z)
        assert abs(x) <= 0.01 * (1 + 1e-9)
        assert 0.5 * mass * v * v <= 0.5 * k * 1e-4 * (1 + 1e-9)
        assert math.isfinite(plant.force(plant.c, x, v, z))


def test_what_is_not_a_number_stays_so() -> None:
    plant = relaxing(MassDamper(mass=0.5), 1e-3, k=1.0, k1=1.0, tau=1.0)
    assert all(map(math.isnan, plant.move(plant.c, math.nan, 0.0, 0.0, (0.0,))[:2]))
    held = relaxing_master(MASTER, *HAND, 1e-3, b_e=1.0, cutoff=10.0)
    assert math.isnan(held.move(held.c, 0.0, 0.0, math.inf, 0.0, math.nan, held.start)[0])
    assert math.isnan(held.force(held.c, 0.0, math.nan, 0.0, 0.0, 0.0, held.start))
