"""The wall: closed forms, integrators of scipy, and what no wall may do."""

from __future__ import annotations

import math
import random
from itertools import product

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from teleop.analysis.precision.reference.reference import settle
from teleop.physics.contact import MOST_EVENTS, advance, events, falls, wall
from teleop.physics.plant import MassDamper, Plant, free_space
from teleop.physics.sdirk import WALL
from tests.teleop.physics.motions import Case, either_sign, struck, ten_to

quiet = settings(max_examples=60)


any_case = st.builds(
    Case,
    m=ten_to(-4, 1),
    b=st.just(0.0) | ten_to(-3, 2),
    k=st.just(0.0) | ten_to(0, 9) | ten_to(2, 5),
    d=st.just(0.0) | ten_to(-3, 3),
    dt=ten_to(-5, -1),
    p=either_sign(ten_to(-7, -1)),
    u=either_sign(ten_to(-5, 0.5)),
    f=either_sign(ten_to(-3, 2)),
)


def beside(case: Case, at: float = 0.0, side: float = 1.0) -> Plant:
    return wall(MassDamper(mass=case.m, damping=case.b), case.dt, k=case.k, d=case.d, at=at, side=side)


def step(*numbers: float) -> tuple[float, float, int]:
    case = Case(*numbers)
    plant = beside(case)
    return plant.move(plant.c, case.p, case.u, case.f)


def stored(m: float, k: float, p: float, u: float) -> float:
    return 0.5 * m * u * u + 0.5 * k * max(p, 0.0) ** 2


# -- closed forms


def test_strike_within_one_tick_is_seen() -> None:
    # Undamped: in contact for half a period, then away as fast as it came. Both ends of the tick are free.
    m, k, u, gap, dt = 0.5, 2e6, 0.8, 2e-4, 5e-3
    contact = math.pi * math.sqrt(m / k)
    p1, u1, _ = step(m, 0.0, k, 0.0, dt, -gap, u, 0.0)
    assert p1 == pytest.approx(-u * (dt - gap / u - contact), rel=1e-13)
    assert u1 == pytest.approx(-u, rel=1e-13)


def test_wall_touched_only_at_the_apex_is_felt() -> None:
    # Thrown at the wall and pulled back: it would reach 1 um deep in the middle of the tick.
    m, u, f, dt = 0.1, 0.1, -1.0, 0.02
    apex = 0.5 * m * u * u / -f
    p, v, _ = step(m, 0.0, 1e5, 0.0, dt, 1e-6 - apex, u, f)
    missed, same, _ = step(m, 0.0, 1e5, 0.0, dt, -1e-9 - apex, u, f)
    assert missed == pytest.approx(-1e-9 - apex, abs=1e-15)
    assert same == pytest.approx(-u, rel=1e-13)
    # The wall turns it round earlier than the pull would: it is further out, and as fast as its energy says.
    assert p < 1e-6 - apex - 4e-6
    assert 0.5 * m * v * v - f * p == pytest.approx(0.5 * m * u * u - f * (1e-6 - apex), rel=1e-12)


def test_wall_left_within_one_tick_is_not_held_on_to() -> None:
    # Bonded, it would be back in the wall when the tick ends; a wall lets go at p = 0.
    p, u, f, dt = 0.1, -1.0, 0.5, 2.5

    def bonded(t: float) -> float:
        return f + (p - f) * math.cos(t) + u * math.sin(t)

    assert bonded(dt) > 0.0
    out = brentq(bonded, 0.0, 0.5, xtol=1e-15)
    speed = -(p - f) * math.sin(out) + u * math.cos(out)
    p1, u1, _ = step(1.0, 0.0, 1.0, 0.0, dt, p, u, f)
    assert p1 == pytest.approx(speed * (dt - out) + 0.5 * f * (dt - out) ** 2, rel=1e-13)
    assert u1 == pytest.approx(speed + f * (dt - out), rel=1e-13)


def test_the_first_descent_through_zero_is_found_or_there_is_none() -> None:
    # Against a dense search, over- and underdamped: g starts above 0, falling or rising.
    dice, found = random.Random(3), 0
    for _ in range(200):
        m, c, k, span = (dice.uniform(0.1, 3.0) for _ in range(4))
        c, k = c * dice.choice([0.0, 1.0, 3.0]), k * dice.choice([0.0, 0.2, 5.0])
        f, p, u, alpha, beta = (dice.uniform(-1.0, 1.0) for _ in range(5))
        if alpha * p + beta * u < 0.0:
            alpha, beta = -alpha, -beta
        span *= 3.0
        times = [span * i / 250 for i in range(251)]
        g = [alpha * q + beta * v for q, v in (advance(m, c, k, f, p, u, t) for t in times)]
        after = next((i for i, value in enumerate(g) if value < 0.0), None)
        t = falls(m, c, k, f, p, u, alpha, beta, span)
        if after is None:
            assert t == -1.0 or min(g) < 1e-3
        else:
            found += 1
            assert times[after - 1] <= t <= times[after]
    assert 50 < found < 150


def test_zero_stiffness_is_a_viscous_wall() -> None:
    # Driven in it creeps; let go it stays where it is; drawn out it is free at once.
    m, d, u = 0.2, 4.0, 0.5
    p, v, _ = step(m, 0.0, 0.0, d, 0.05, 0.0, u, 0.0)
    assert p == pytest.approx(m * u / d * -math.expm1(-d * 0.05 / m), rel=1e-13)
    assert v == pytest.approx(u * math.exp(-d * 0.05 / m), rel=1e-13)
    assert step(m, 0.0, 0.0, d, 0.05, 0.01, -u, 0.0)[:2] == pytest.approx((0.01 - 0.05 * u, -u))
    # Pushed while it is on its way out: free until it turns, then against the damper.
    turn = m * u / 2.0
    p, v, _ = step(m, 0.0, 0.0, d, turn + 0.1, 1.0, -u, 2.0)
    assert v == pytest.approx(2.0 / d * -math.expm1(-d * 0.1 / m), rel=1e-12)


def test_no_stiffness_and_no_damping_is_free_space() -> None:
    body = MassDamper(mass=0.2, damping=0.1)
    assert wall(body, 1e-3, k=0.0, d=0.0, at=0.0, side=1.0) == free_space(body, 1e-3)


def test_undamped_bounces_keep_their_energy() -> None:
    # Pressed on the wall by a constant force, it bounces for ever: m v^2/2 + k p^2/2 - f x stays.
    m, k, f, x, v = 0.3, 8e5, 2.0, -0.003, 0.0
    plant = wall(MassDamper(mass=m), 1e-3, k=k, d=0.0, at=0.0, side=1.0)
    before, bounces = stored(m, k, x, v) - f * x, 0
    for _ in range(5000):
        x, new, capped = plant.move(plant.c, x, v, f)
        bounces += v > 0.0 > new
        v = new
        assert capped == 0
    assert bounces > 50
    assert stored(m, k, x, v) - f * x == pytest.approx(before, rel=1e-11)


def test_force_is_the_left_limit() -> None:
    plant = wall(MassDamper(mass=1.0), 1e-3, k=1000.0, d=5.0, at=0.03, side=1.0)
    assert plant.force(plant.c, 0.03, 2.0) == 0.0  # it has just arrived, and has not been in contact yet
    assert plant.force(plant.c, 0.02, 2.0) == 0.0
    assert plant.force(plant.c, 0.031, 2.0) == pytest.approx(11.0)


# -- what holds for every wall


@quiet
@given(any_case)
def test_quick_decisions_are_those_of_the_events(case: Case) -> None:
    assume(case.k > 0.0 or case.d > 0.0)
    m, b, k, d, dt, p, u, f = case
    p1, u1, capped = step(*case)
    p2, u2, again = events(m, b, k, d, dt, p, u, f)
    far, fast = abs(p) + abs(p1) + dt * abs(u), abs(u) + abs(u1) + abs(f) / m * dt + case.w * max(p, 0.0)
    assert capped == again
    assert abs(p1 - p2) <= 1e-13 * (1 + case.w * dt) * far
    assert abs(u1 - u2) <= 1e-13 * (1 + case.w * dt) * fast


@quiet
@given(any_case)
def test_one_tick_is_two_halves(case: Case) -> None:
    half = case._replace(dt=0.5 * case.dt)
    p1, u1, capped = step(*case)
    ph, uh, first = step(*half)
    p2, u2, second = step(*half._replace(p=ph, u=uh))
    assume(not capped and not first and not second)
    _, _, _, _, dt, p, u, f = case
    fast = abs(u) + abs(uh) + abs(u1) + abs(f) / case.m * dt + case.w * (max(p, 0.0) + max(ph, 0.0))
    far = abs(p) + abs(ph) + abs(p1) + dt * (abs(u) + abs(uh))
    assert abs(p1 - p2) <= 1e-12 * (1 + case.w * dt) * far
    assert abs(u1 - u2) <= 1e-12 * (1 + case.w * dt) * fast


@quiet
@given(any_case)
def test_wall_makes_no_energy(case: Case) -> None:
    # Not even where its events are capped.
    m, _, k, _, _, p, u, f = case
    p1, u1, _ = step(*case)
    before, after = stored(m, k, p, u), stored(m, k, p1, u1)
    passed = before + after + abs(f) * (abs(p) + abs(p1)) + (2 * f * f / k if k else 0.0)
    assert after - before - f * (p1 - p) <= 1e-12 * passed


@quiet
@given(any_case)
def test_wall_only_pushes(case: Case) -> None:
    # Its impulse over the tick, by the balance of momentum, is never inward.
    m, b, _, _, dt, p, u, f = case
    plant = beside(case)
    p1, u1, capped = plant.move(plant.c, p, u, f)
    assert plant.force(plant.c, p, u) >= 0.0
    assert plant.force(plant.c, p1, u1) >= 0.0
    assume(not capped)
    impulse = f * dt - m * (u1 - u) - b * (p1 - p)
    passed = m * (abs(u) + abs(u1)) + b * (abs(p) + abs(p1)) + abs(f) * dt + m * case.w * max(p, 0.0)
    assert impulse >= -1e-13 * (1 + case.w * dt) * passed


@quiet
@given(any_case, either_sign(ten_to(-3, 0)))
def test_mirrored_wall_gives_mirrored_motion(case: Case, at: float) -> None:
    right, left = beside(case, at), beside(case, -at, side=-1.0)
    x, v, capped = right.move(right.c, at + case.p, case.u, case.f)
    assert left.move(left.c, -at - case.p, -case.u, -case.f) == (-x, -v, capped)
    assert left.force(left.c, -x, -v) == -right.force(right.c, x, v)


def test_endless_chatter_is_capped_and_makes_no_energy() -> None:
    # 0.1 g on 1 GN/m, pressed with 100 N: its bounces are far too many for a tick of 0.1 s.
    m, k, f = 1e-4, 1e9, 100.0
    p, u = -1e-6, 0.0
    before = stored(m, k, p, u) - f * p
    p, u, capped = step(m, 0.0, k, 0.0, 0.1, p, u, f)
    assert capped == 1
    assert stored(m, k, p, u) - f * p <= before * (1 + 1e-9)
    assert MOST_EVENTS == 32


def test_extremes_end_and_do_not_raise() -> None:
    for m, k, d in product((1e-4, 10.0), (0.0, 1.0, 1e9), (0.0, 1e-3, 1e5)):
        for bad in (math.nan, math.inf, -math.inf, 1e308, -1e200):
            for state in ((bad, 0.5, 1.0), (0.0, bad, 1.0), (0.001, 0.5, bad), (-0.001, bad, -bad), (bad, bad, bad)):
                got = step(m, 0.0, k, d, 0.1, *state)
                assert abs(bad) < math.inf or not all(map(math.isfinite, got[:2]))
        for p, u, f in ((0.0, 0.0, 0.0), (5e-324, -5e-324, 0.0), (0.0, 0.0, 1e-300), (1e-18, -1e3, 1e3)):
            assert all(map(math.isfinite, step(m, 0.0, k, d, 0.1, p, u, f)))


@pytest.mark.parametrize(("method", "count"), [("DOP853", 40), ("Radau", 6)])
def test_stiff_walls_match_two_of_scipys_integrators_to_1e_10(method: str, count: int) -> None:
    # Up to some two oscillations within a tick, every change of mode located.
    dice, changes = random.Random(7), 0
    for _ in range(count):
        (_, m, b, k, d, *_), p, u, f, dt = struck(dice)
        dt *= dice.choice([1.0, 5.0])
        if dice.random() < 0.2:  # drawn out of a wall that is too slow to follow, and pushed back in
            p, u, d, f = abs(p), -abs(u), 4 * k * abs(p / u), 2 * m * u * u / abs(p)
        case = Case(m, b, k, d, dt, p, u, f)
        p1, u1, found = settle((WALL, m, b, k, d, 1.5, 0.0, 0.0), p, u, f, 0.0, dt, method)
        got_p, got_u, capped = step(*case)
        fast = abs(u) + abs(u1) + case.w * max(p, 0.0) + abs(f) / m * min(dt, 1 / case.w)
        assert capped == 0
        assert abs(got_p - p1) <= 1e-10 * (abs(p) + abs(p1) + fast / case.w), case
        assert abs(got_u - u1) <= 1e-10 * fast, case
        changes += found
    assert changes > count // 3
