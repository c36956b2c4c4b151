"""Walls, and environments that move: closed forms, integrators of scipy, and what none of them may do."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from itertools import pairwise, product
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from teleop.analysis.precision.reference.reference import settle
from teleop.physics.carried import Carried, carried
from teleop.physics.contact import MOST_EVENTS, advance, events, falls, wall
from teleop.physics.implicit import Resistance, implicit_master, implicit_plant
from teleop.physics.path import BLOCK, Blocks, Path, Speeds
from teleop.physics.plant import MassDamper, Plant, free_space, spring_damper
from teleop.physics.relaxing import relaxing
from teleop.physics.sdirk import BOND, WALL
from tests.teleop.physics.motions import Case, core, either_sign, reference, struck, ten_to

DT = 1e-3
FREE = MassDamper(mass=0.5)
BODY = MassDamper(mass=0.5, damping=1.0)
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


def test_force_is_the_left_limit() -> None:
    plant = wall(MassDamper(mass=1.0), 1e-3, k=1000.0, d=5.0, at=0.03, side=1.0)
    assert plant.force(plant.c, 0.03, 2.0) == 0.0  # it has just arrived, and has not been in contact yet
    assert plant.force(plant.c, 0.02, 2.0) == 0.0
    assert plant.force(plant.c, 0.031, 2.0) == pytest.approx(11.0)


# -- what holds for every wall


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


def test_quick_decisions_are_those_of_the_events() -> None:
    # Touched only at the apex, or left within a tick, it is felt and let go all the same.
    dice, quick = random.Random(13), 0
    for _ in range(500):
        (_, m, b, k, d, *_), p, u, f, dt = struck(dice)
        case = Case(m, b, k, d, dt * dice.choice([1.0, 4.0]), p, u, f)
        p1, u1, capped = step(*case)
        p2, u2, again = events(m, b, k, d, case.dt, p, u, f)
        assert capped == again
        assert abs(p1 - p2) <= 1e-13 * (1 + case.w * case.dt) * (abs(p) + abs(p1) + case.dt * abs(u)), case
        fast = abs(u) + abs(u1) + abs(f) / m * case.dt + case.w * max(p, 0.0)
        assert abs(u1 - u2) <= 1e-13 * (1 + case.w * case.dt) * fast, case
        quick += (p1, u1) != (p2, u2)
    assert quick > 50


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


# -- environments that move: from their own frame, against an integrator in the frame of the ground


def sine(amplitude: float, frequency: float, count: int) -> list[float]:
    return [amplitude * math.sin(2 * math.pi * frequency * k * DT) for k in range(count + 1)]


def still_or(inner: bool, body: MassDamper = FREE) -> Plant:
    """A wall, or tissue that relaxes, at 3 cm."""
    if inner:
        return relaxing(body, DT, k=300.0, k1=2000.0, tau=0.02, at=0.03)
    return wall(body, DT, k=5000.0, d=5.0, at=0.03, side=1.0)


@settings(max_examples=25)
@given(speed=st.floats(-0.5, 0.5), x=st.floats(-0.1, 0.1), v=st.floats(-1.0, 1.0), f=st.floats(-5.0, 5.0),
       inner=st.booleans())
def test_what_moves_evenly_is_still_in_its_own_frame(speed: float, x: float, v: float, f: float, inner: bool) -> None:
    # Galilei: without damping against the ground, only the motion between body and environment counts.
    still = still_or(inner)
    path = [0.2 + speed * k * DT for k in range(201)]
    moving = carried(still, path, FREE, DT)
    y, w, zy = x, v, still.start
    x, v, zx = 0.2 + x, speed + v, moving.start
    for k in range(200):
        x, v, _, zx = moving.move(moving.c, x, v, f, zx)
        if inner:
            y, w, _, zy = still.move(still.c, y, w, f, zy)
            f_env = still.force(still.c, y, w, zy)
        else:
            y, w, _ = still.move(still.c, y, w, f)
            f_env = still.force(still.c, y, w)
        assert x == pytest.approx(path[k + 1] + y, abs=1e-10)
        assert v == pytest.approx(speed + w, abs=1e-8)
        assert moving.force(moving.c, x, v, zx) == pytest.approx(f_env, abs=1e-5)


def test_wall_that_swings_matches_an_integrator() -> None:
    # A wall that beats twenty times a second under a body pressed lightly against it: it is hit and left.
    path, c, hits = sine(0.004, 20.0, 250), core(WALL, m=BODY.mass, b=BODY.damping, k=5000.0, d=20.0), 0
    let_go, moving = 0, carried(wall(BODY, DT, k=5000.0, d=20.0, at=0.002, side=1.0), path, BODY, DT)
    x, v, z = 0.0, 0.0, moving.start
    for k, (r0, r1) in enumerate(pairwise(path)):
        f, s = 1.5 + math.sin(0.03 * k), (r1 - r0) / DT
        p, u = reference(c, x - 0.002 - r0, v - s, f - BODY.damping * s, 0.0, DT)
        was = x - 0.002 - r0
        x, v, capped, z = moving.move(moving.c, x, v, f, z)
        assert capped == 0
        assert (x, v) == pytest.approx((0.002 + r1 + p, s + u), abs=1e-9)
        hits, let_go = hits + (was * p < 0.0), let_go + (p > 0.0 and moving.force(moving.c, x, v, z) == 0.0)
    assert (hits, let_go) == (4, 6)


def test_tissue_that_swings_and_relaxes_matches_an_integrator() -> None:
    k, k1, tau, at, path = 300.0, 2000.0, 0.02, 0.01, sine(0.01, 3.0, 200)
    moving = carried(relaxing(BODY, DT, k=k, k1=k1, tau=tau, at=at), path, BODY, DT)
    x, v, z, y = 0.0, 0.1, moving.start, np.array([0.0, 0.1, 0.0])
    for tick, (r0, r1) in enumerate(pairwise(path)):
        f, s = math.cos(0.1 * tick), (r1 - r0) / DT

        def rate(t: float, y: Any, r0: float = r0, s: float = s, f: float = f) -> list[float]:
            f_env = k * (y[0] - at - r0 - s * t) + y[2]
            return [y[1], (f - BODY.damping * y[1] - f_env) / BODY.mass, k1 * (y[1] - s) - y[2] / tau]

        x, v, _, z = moving.move(moving.c, x, v, f, z)
        y = solve_ivp(rate, (0.0, DT), y, "DOP853", rtol=1e-13, atol=1e-15).y[:, -1]
        assert (x, v, z[1]) == pytest.approx(tuple(y), abs=1e-10)
        assert moving.force(moving.c, x, v, z) == pytest.approx(k * (x - at - r1) + z[1], rel=1e-12)


def test_force_at_a_tick_is_that_of_the_piece_just_ended() -> None:
    k, d, at = 200.0, 5.0, 0.01
    path = [0.001, 0.003, 0.003, -0.002]
    moving = carried(spring_damper(BODY, DT, k=k, d=d, at=at), path, BODY, DT)
    x, v, z = 0.02, 0.3, moving.start
    speeds = [0.0, 2.0, 0.0, -5.0]  # before the first tick all is at rest
    for tick in range(4):
        f_env = moving.force(moving.c, x, v, z)
        assert f_env == pytest.approx(k * (x - at - path[tick]) + d * (v - speeds[tick]), rel=1e-12)
        x, v, _, z = moving.move(moving.c, x, v, 0.0, z)


def test_beyond_its_path_an_environment_rests() -> None:
    moving, still = (carried(spring_damper(BODY, DT, k=200.0, d=5.0), path, BODY, DT)
                     for path in ([0.0, 0.01, 0.02], [0.0, 0.01, *[0.02] * 50]))
    x, v, z = y, w, zy = 0.0, 0.0, moving.start
    for _ in range(40):
        x, v, _, z = moving.move(moving.c, x, v, 0.1, z)
        y, w, _, zy = still.move(still.c, y, w, 0.1, zy)
        assert (x, v) == (y, w)
        assert moving.force(moving.c, x, v, z) == still.force(still.c, y, w, zy)


def test_friction_is_with_the_ground() -> None:
    # Tissue drawn along under a body that sticks; and where it slips, it does as a master in a hand does.
    body, path = MassDamper(mass=0.5, damping=1.0, friction=1.5), sine(0.02, 2.0, 400)
    moving = carried(implicit_plant(body, DT, resistance=Resistance(BOND, 100.0, 3.0), friction=1.5), path, body, DT)
    held = implicit_master(body, 0.0, 100.0, 3.0, DT, friction=1.5)
    x, v, z, y, w, zy, stuck, slid = 0.0, 0.0, moving.start, 0.0, 0.0, held.start, 0, 0
    for k in range(400):
        x, v, _, z = moving.move(moving.c, x, v, 0.0, z)
        y, w, zy = held.move(held.c, y, w, 0.0, path[k], path[k + 1], zy)
        assert (x, v) == pytest.approx((y, w), abs=1e-7)
        stuck, slid = stuck + (v == 0.0), slid + (v != 0.0)
    assert min(stuck, slid) > 20
    assert moving.report is not None
    assert moving.report(z)["tolerance"] == 1e-9


# -- along a path that is sampled as it is read


def noting() -> tuple[list[tuple[int, int]], Callable[[int, int], tuple[list[float], ...]]]:
    """A sine along two axes, and the list of what is read of it."""
    calls: list[tuple[int, int]] = []

    def samples(first: int, count: int) -> tuple[list[float], ...]:
        calls.append((first, count))
        wave = [0.03 * math.sin(0.01 * k) for k in range(first, first + count)]
        return wave, [2.0 * y for y in wave]

    return calls, samples


def test_a_path_gives_what_sampling_all_of_it_would_give_and_beyond_its_end_it_stays() -> None:
    whole, blocks = noting()[1](0, 700), Blocks(noting()[1])
    for axis, path in enumerate([Path(blocks, axis, 700) for axis in (0, 1)]):
        assert list(path) == whole[axis]
        assert path[3:9] == whole[axis][3:9]
        assert len(path) == 700
        assert path[5000] == path[700] == path[699] != path[698]
        assert Speeds(path, DT)[700] == 0.0 != Speeds(path, DT)[699]


def test_a_day_of_a_path_costs_what_is_read_of_it() -> None:
    calls, samples = noting()
    path = Path(Blocks(samples), 0, 86_400_001)
    assert calls == []
    for k in range(3 * BLOCK):
        path[k], path[k + 1], path[max(0, k - 1)]
    assert calls == [(i * BLOCK, BLOCK) for i in range(4)], "each block once, and none ahead of time"
    assert path[86_400_000] == 0.03 * math.sin(0.01 * 86_400_000)
    assert len(calls) == 5


def test_an_environment_that_is_carried_along_a_path_moves_to_the_bit_as_along_its_list() -> None:
    for still in (relaxing(BODY, DT, k=300.0, k1=2000.0, tau=0.02, at=0.0),
                  wall(BODY, DT, k=5000.0, d=5.0, at=0.0, side=1.0)):
        listed = carried(still, noting()[1](0, 701)[0], BODY, DT)
        read = carried(still, Path(Blocks(noting()[1]), 0, 701), BODY, DT)
        assert read.start == listed.start
        assert Carried(*read.c).last == Carried(*listed.c).last == 700
        a, b = (0.0, 0.0, listed.start), (0.0, 0.0, read.start)
        touched = 0
        for k in range(900):
            f = 5.0 * math.sin(0.02 * k)
            a, b = (one.move(one.c, x, v, f, z) for one, (x, v, z) in ((listed, a), (read, b)))
            a, b = (a[0], a[1], a[3]), (b[0], b[1], b[3])
            assert a == b
            force = listed.force(listed.c, *a)
            assert force == read.force(read.c, *b)
            touched += force != 0.0
        assert touched > 30
