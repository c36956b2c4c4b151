"""Environments that move: seen from their own frame, against an integrator in the frame of the ground."""

import math
import random
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from teleop.errors import Refused
from teleop.physics.carried import carried
from teleop.physics.contact import wall
from teleop.physics.implicit import Resistance, implicit_master, implicit_plant
from teleop.physics.plant import MassDamper, Plant, free_space, grip, move_gripped, spring_damper
from teleop.physics.relaxing import relaxing
from teleop.physics.sdirk import BOND, WALL

DT = 1e-3
FREE = MassDamper(mass=0.5)
BODY = MassDamper(mass=0.5, damping=1.0)

quiet = settings(max_examples=60)


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


@pytest.mark.parametrize("inner", [False, True])
def test_environment_carried_nowhere_is_the_environment_to_the_last_bit(inner: bool) -> None:
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


def crossing(function: Any, direction: int) -> Any:
    """The event that `function(t, y)` passes through zero, upward (1) or downward (-1), as scipy asks for it."""

    def event(t: float, y: Any, _: bool) -> float:
        return float(function(t, y))

    event.terminal, event.direction = True, direction  # type: ignore[attr-defined]
    return event


def beside_a_moving_wall(path: list[float], force: Any, k: float, d: float) -> tuple[np.ndarray, set[tuple[str, str]]]:
    """(x, v) of `BODY` at the ticks, and the changes of mode, integrated with events in the frame of the ground."""
    m, b, rows, changes = BODY.mass, BODY.damping, [(0.0, 0.0)], set()
    for tick, (r0, r1) in enumerate(pairwise(path)):
        s, left, y, f = (r1 - r0) / DT, DT, np.array(rows[-1]), force(tick)
        mode = ""
        while True:
            place = r1 - s * left  # where the wall's surface is now

            def depth(t: float, y: Any, place: float = place, s: float = s) -> float:
                return float(y[0] - place - s * t)

            def push(t: float, y: Any, depth: Any = depth, s: float = s) -> float:
                return float(k * depth(t, y) + d * (y[1] - s))

            def rate(t: float, y: Any, touching: bool, push: Any = push, f: float = f) -> list[float]:
                return [y[1], (f - b * y[1] - (push(t, y) if touching else 0.0)) / m]

            p, g, way = depth(0.0, y), push(0.0, y), y[1] - s
            if not mode:
                mode = "free" if p < 0.0 or (p == 0.0 and way < 0.0) else "contact" if g > 0.0 else "detached"
            events = {"free": [crossing(depth, 1)], "contact": [crossing(push, -1)],
                      "detached": [crossing(depth, -1), crossing(push, 1)]}[mode]
            done = solve_ivp(rate, (0.0, left), y, "DOP853", args=(mode == "contact",), events=events, rtol=1e-12,
                             atol=1e-14, max_step=DT / 4)
            y, left = done.y[:, -1], left - done.t[-1]
            if done.status == 0:
                break
            fallen = {"free": "contact", "contact": "detached",
                      "detached": "free" if len(done.t_events[0]) else "contact"}[mode]
            changes.add((mode, fallen))
            mode = fallen
        rows.append((float(y[0]), float(y[1])))
    return np.array(rows), changes


def test_wall_that_swings_matches_an_integrator() -> None:
    # A wall that beats twenty times a second under a body pressed lightly against it: it is hit and left.
    path = sine(0.004, 20.0, 250)

    def force(tick: int) -> float:
        return 1.5 + math.sin(0.03 * tick)

    want, changes = beside_a_moving_wall([0.002 + r for r in path], force, 5000.0, 20.0)
    moving = carried(wall(BODY, DT, k=5000.0, d=20.0, at=0.002, side=1.0), path, BODY, DT)
    x, v, z = 0.0, 0.0, moving.start
    for k in range(250):
        x, v, capped, z = moving.move(moving.c, x, v, force(k), z)
        assert capped == 0
        assert (x, v) == pytest.approx(tuple(want[k + 1]), abs=1e-9)
    assert changes == {("free", "contact"), ("contact", "detached"), ("detached", "free")}


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


def test_what_is_integrated_moves_as_what_is_exact() -> None:
    exact = carried(wall(BODY, DT, k=2000.0, d=0.0, at=0.002, side=1.0), path := sine(0.004, 10.0, 200), BODY, DT)
    close = carried(implicit_plant(BODY, DT, resistance=Resistance(WALL, 2000.0, 0.0, 0.002)), path, BODY, DT)
    x, v, z = y, w, zy = 0.0, 0.0, exact.start
    zy = close.start
    for _ in range(200):
        x, v, _, z = exact.move(exact.c, x, v, 1.0, z)
        y, w, _, zy = close.move(close.c, y, w, 1.0, zy)
        assert (x, v) == pytest.approx((y, w), abs=1e-5)


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


def test_paths_that_cannot_be_followed_are_refused() -> None:
    plant = free_space(BODY, DT)
    with pytest.raises(Refused, match="the path at tick 1 must be finite"):
        carried(plant, [0.0, math.nan], BODY, DT)
    with pytest.raises(Refused, match="a path needs a place for each tick"):
        carried(plant, [], BODY, DT)
    with pytest.raises(Refused, match="faster than numbers go"):
        carried(plant, [0.0, 1e308], BODY, DT)
    with pytest.raises(Refused, match=r"friction=0\.5 N .* write friction=0"):
        carried(plant, [0.0, 0.0], MassDamper(mass=0.5, friction=0.5), DT)
