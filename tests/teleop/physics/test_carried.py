"""Environments that move: seen from their own frame, against an integrator in the frame of the ground."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from teleop.physics.carried import Carried, carried
from teleop.physics.contact import wall
from teleop.physics.implicit import Resistance, implicit_master, implicit_plant
from teleop.physics.path import BLOCK, Blocks, Path, Speeds
from teleop.physics.plant import MassDamper, Plant, grip, move_gripped, spring_damper
from teleop.physics.relaxing import relaxing
from teleop.physics.sdirk import BOND, WALL
from tests.teleop.physics.motions import core, reference

DT = 1e-3
FREE = MassDamper(mass=0.5)
BODY = MassDamper(mass=0.5, damping=1.0)

quiet = settings(max_examples=25)


def sine(amplitude: float, frequency: float, count: int) -> list[float]:
    return [amplitude * math.sin(2 * math.pi * frequency * k * DT) for k in range(count + 1)]


def still_or(inner: bool, body: MassDamper = FREE) -> Plant:
    """A wall, or tissue that relaxes, at 3 cm."""
    if inner:
        return relaxing(body, DT, k=300.0, k1=2000.0, tau=0.02, at=0.03)
    return wall(body, DT, k=5000.0, d=5.0, at=0.03, side=1.0)


@quiet
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


def test_environment_carried_nowhere_is_the_environment_to_the_last_bit() -> None:
    for inner in (False, True):
        still = still_or(inner, BODY)
        moving = carried(still, [0.0] * 501, BODY, DT)
        x, v, zx = 0.0, 0.4, moving.start
        rest: list[Any] = [] if still.start is None else [still.start]
        y, w = x, v
        for k in range(500):
            f = math.sin(0.02 * k)
            x, v, capped, zx = moving.move(moving.c, x, v, f, zx)
            y, w, _, *rest = still.move(still.c, y, w, f, *rest)
            assert (x, v, capped) == (y, w, 0)
            assert moving.force(moving.c, x, v, zx) == still.force(still.c, y, w, *rest)


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


def test_carried_tissue_pulls_as_a_hand_does() -> None:
    # A spring-damper on a path is what a grip without mass is on its reference.
    moving = carried(spring_damper(BODY, DT, k=200.0, d=5.0), path := sine(0.05, 1.0, 300), BODY, DT)
    c = tuple(grip(BODY, 0.0, 200.0, 5.0, DT))
    x, v, z, y, w = 0.0, 0.0, moving.start, 0.0, 0.0
    for k in range(300):
        x, v, _, z = moving.move(moving.c, x, v, -1.0, z)
        y, w = move_gripped(c, y, w, 1.0, path[k], path[k + 1])
        assert (x, v) == pytest.approx((y, w), abs=1e-13)


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


def test_extremes_stay_finite() -> None:
    dice = random.Random(2)
    for mass in (1e-4, 1e3):
        for k in (0.0, 1e9):
            for dt in (1e-5, 0.1):
                body = MassDamper(mass=mass, damping=1.0)
                path = [dice.uniform(-0.1, 0.1) for _ in range(51)]
                for plant in (wall(body, dt, k=k, d=5.0, at=0.0, side=1.0),
                              relaxing(body, dt, k=k, k1=1e9, tau=1e-9)):
                    moving = carried(plant, path, body, dt)
                    x, v, z = 0.05, 0.0, moving.start
                    for _ in range(60):
                        x, v, _, z = moving.move(moving.c, x, v, 1.0, z)
                        assert math.isfinite(moving.force(moving.c, x, v, z))
                    assert math.isfinite(x)
                    x, v, _, z = moving.move(moving.c, math.nan, v, 1.0, z)
                    assert math.isnan(x)


# -- along a path that is sampled as it is read


def noting() -> tuple[list[tuple[int, int]], Callable[[int, int], tuple[list[float], ...]]]:
    """A sine along two axes, and the list of what is read of it."""
    calls: list[tuple[int, int]] = []

    def samples(first: int, count: int) -> tuple[list[float], ...]:
        calls.append((first, count))
        wave = [0.03 * math.sin(0.01 * k) for k in range(first, first + count)]
        return wave, [2.0 * y for y in wave]

    return calls, samples


def test_it_gives_what_sampling_all_of_it_would_give() -> None:
    whole = noting()[1](0, 1000)
    blocks = Blocks(noting()[1])
    paths = [Path(blocks, axis, 1000) for axis in (0, 1)]
    for axis, path in enumerate(paths):
        assert list(path) == whole[axis]
        assert path[3:9] == whole[axis][3:9]
        assert len(path) == 1000


def test_beyond_its_end_it_stays() -> None:
    path = Path(Blocks(noting()[1]), 0, 700)
    assert path[5000] == path[700] == path[699] != path[698]
    assert Speeds(path, DT)[700] == 0.0 != Speeds(path, DT)[699]


def test_a_day_of_it_costs_what_is_read_of_it() -> None:
    calls, samples = noting()
    path = Path(Blocks(samples), 0, 86_400_001)
    assert calls == []
    for k in range(3 * BLOCK):
        path[k], path[k + 1], path[max(0, k - 1)]
    assert calls == [(i * BLOCK, BLOCK) for i in range(4)], "each block once, and none ahead of time"
    assert path[86_400_000] == 0.03 * math.sin(0.01 * 86_400_000)
    assert len(calls) == 5


def test_an_environment_that_is_carried_along_it_moves_to_the_bit_as_along_its_list() -> None:
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
