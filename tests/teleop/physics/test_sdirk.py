"""SDIRK2 with contact and friction inside its stages: exact where that is known, and an honest estimate."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from teleop.physics.contact import events
from teleop.physics.plant import response
from teleop.physics.sdirk import (
    BOND,
    HUNT_CROSSLEY,
    MOST_SUBSTEPS,
    NOTHING,
    WALL,
    Core,
    integrate,
    resistance_force,
    stage,
)
from tests.teleop.physics.motions import TOL, core, either_sign, reference, struck, ten_to


def test_without_friction_a_wall_is_the_exact_wall_within_the_estimate() -> None:
    dice, changed, met = random.Random(7), 0, 0
    for _ in range(300):
        c, p, u, f, dt = struck(dice)
        kept = integrate(c, p, u, f, 0.0, dt, TOL, dice.choice([1.0, 0.25]))
        x, v, _ = events(*c[1:5], dt, p, u, f)
        assert abs(kept.p - x) <= 3.0 * kept.error + 0.1 * TOL
        assert dt * abs(kept.u - v) <= 3.0 * kept.error + 0.1 * TOL
        changed += (p < 0.0) != (x < 0.0)
        met += kept.error <= TOL
    assert changed > 35
    assert met > 240


def test_without_friction_a_bond_is_the_exact_bond_within_the_estimate() -> None:
    dice = random.Random(8)
    for _ in range(100):
        (_, *numbers), p, u, f, dt = struck(dice)
        m, b, k, d = numbers[:4]
        kept = integrate((BOND, *numbers), p, u, f, dice.choice([0.0, 0.2]), dt, TOL, 1.0)
        s, ds, w = response(m, b + d, k, dt)
        assert abs(kept.p - (p - k / m * w * p + s * u + w / m * f)) <= 3.0 * kept.error + 1e-15
        assert dt * abs(kept.u - (ds * u - k / m * s * p + s / m * f)) <= 3.0 * kept.error + 1e-15
        assert kept.error <= TOL or kept.substeps == MOST_SUBSTEPS


@pytest.mark.parametrize("kind", [WALL, BOND, *(pytest.param(kind, marks=pytest.mark.full)
                                                for kind in (NOTHING, HUNT_CROSSLEY))])
def test_with_friction_it_is_an_independent_integration_within_the_estimate(kind: int) -> None:
    dice, turned = random.Random(kind), 0
    for _ in range(25):
        (_, m, b, k, d, _, _, _), p, u, f, dt = struck(dice)
        if kind == HUNT_CROSSLEY:
            k *= 100.0
        lam = dice.choice([0.0, 0.1, 1.0])
        fc = m * abs(u) / dt * 10 ** dice.uniform(-1.0, 0.5)
        s = dice.choice([0.0, 0.0, -0.3 * u, 0.2 * u]) if kind in (NOTHING, BOND) else 0.0
        c = core(kind, m=m, b=b, k=k, d=d, lam=lam, fc=fc)
        kept = integrate(c, p, u, f, s, dt, TOL, 1.0)
        x, v = reference(c, p, u, f, s, dt)
        assert abs(kept.p - x) <= 3.0 * kept.error + 0.1 * TOL
        assert dt * abs(kept.u - v) <= 3.0 * kept.error + TOL
        turned += (v + s) * (u + s) <= 0.0
    assert turned > 5


def test_hunt_crossley_is_an_independent_integration_within_the_estimate() -> None:
    dice = random.Random(11)
    for _ in range(20):
        (_, m, b, k, _, _, _, _), p, u, f, dt = struck(dice)
        c = core(HUNT_CROSSLEY, m=m, b=b, k=100.0 * k, n=dice.choice([1.0, 1.5, 2.0, 3.0]),
                 lam=dice.choice([0.0, 0.3, 3.0, 30.0]))
        kept = integrate(c, p, u, f, 0.0, dt, TOL, 1.0)
        x, v = reference(c, p, u, f, 0.0, dt)
        assert abs(kept.p - x) <= 3.0 * kept.error + 0.1 * TOL
        assert dt * abs(kept.u - v) <= 3.0 * kept.error + 0.1 * TOL


def test_a_touch_between_the_stages_is_not_missed() -> None:
    # Thrown at the wall and pulled back: outside at both ends of the tick, 1 um deep in between.
    m, u, f, dt = 0.1, 0.1, -1.0, 0.02
    p = 1e-6 - 0.5 * m * u * u / -f
    kept = integrate(core(WALL, m=m, k=1e5), p, u, f, 0.0, dt, 1e-7, 1.0)
    x, v, _ = events(m, 0.0, 1e5, 0.0, dt, p, u, f)
    assert kept.substeps > 10
    assert kept.error <= 1e-7
    assert (kept.p, kept.u) == (pytest.approx(x, abs=3.0 * kept.error), pytest.approx(v, abs=3.0 * kept.error / dt))
    assert abs(x - p) > 4e-6


def test_a_body_that_is_misplaced_as_it_enters_stiff_contact_is_estimated_too_fast_later() -> None:
    # 5460 rad/s over 3 ms: what is 10 pm off at the touch is 150 pm/dt off in speed.
    c = core(HUNT_CROSSLEY, m=0.0368, b=0.557, k=1.096e6, n=1.0, lam=1.0, fc=1.6046)
    kept = integrate(c, -2.0807e-4, 0.0, 3.5608, 0.0, 3.0258e-3, TOL, 1.0)
    x, v = reference(c, -2.0807e-4, 0.0, 3.5608, 0.0, 3.0258e-3)
    assert max(abs(kept.p - x), 3.0258e-3 * abs(kept.u - v)) <= 1.5 * kept.error


def test_a_stop_between_the_stages_is_not_missed() -> None:
    # Slowed down by a spring that is being drawn tight: it stops for a moment, slower than a stage could see.
    c, u, s, f = core(BOND, k=2415.9684880398686, fc=0.613696767107184), 3.332361419335734e-05, 0.03504092631671192, \
        0.5382366931912296
    kept = integrate(c, 0.0, u - s, f, s, 1e-3, TOL, 0.0625)
    x, v = reference(c, 0.0, u - s, f, s, 1e-3)
    assert max(abs(kept.p - x), 1e-3 * abs(kept.u - v)) <= 1.2 * kept.error


def test_the_tolerance_asked_for_is_met_by_the_error_made() -> None:
    for tol in (1e-6, 1e-8, 1e-11):
        dice = random.Random(3)
        for _ in range(60):
            c, p, u, f, dt = struck(dice)
            kept = integrate(c, p, u, f, 0.0, dt, tol, 1.0)
            x, v, _ = events(*c[1:5], dt, p, u, f)
            if kept.error <= tol:
                assert max(abs(kept.p - x), dt * abs(kept.u - v)) <= 2.0 * tol
            else:
                assert kept.substeps > MOST_SUBSTEPS // 2


def test_far_from_the_origin_rounding_is_not_taken_for_an_error_of_integration() -> None:
    near, far = (integrate(core(m=0.5, fc=2.0), x, 3e-3, -2.5, 0.0, 1e-3, TOL, 1.0) for x in (0.0, 1e4))
    assert far.substeps < near.substeps + 20
    assert far.p - 1e4 == pytest.approx(near.p, abs=1e-11)


# -- one stage


def test_a_stage_that_only_just_reaches_a_damped_wall_ends_at_its_surface() -> None:
    # Outside it would be 10 um deep, inside the damper would hold it back before it gets there.
    u, mode = stage(core(WALL, m=0.2, k=1e3, d=1e3), -1e-4, 1.0, 1.1e-4, 0.0, 0.0)
    assert -1e-4 + 1.1e-4 * u == pytest.approx(0.0, abs=1e-18)
    assert mode == 1


def test_a_stage_that_is_drawn_out_faster_than_it_may_be_held_is_free() -> None:
    assert stage(core(HUNT_CROSSLEY, k=1e6, lam=0.5), 1e-2, -5.0, 1e-4, 0.0, 0.0) == (-5.0, 2)
    assert stage(core(WALL, k=1e3, d=10.0), 1e-2, -5.0, 1e-4, 0.0, 0.0) == (-5.0, 2)


any_core = st.builds(
    core, st.sampled_from([NOTHING, WALL, BOND, HUNT_CROSSLEY]), m=ten_to(-4, 3), b=st.just(0.0) | ten_to(-3, 2),
    k=st.just(0.0) | ten_to(0, 9), d=st.just(0.0) | ten_to(-3, 3), n=st.sampled_from([1.0, 1.5, 2.0, 10.0]),
    lam=st.just(0.0) | ten_to(-3, 2), fc=st.just(0.0) | ten_to(-3, 3))


@settings(max_examples=75)
@given(any_core, either_sign(ten_to(-9, 0)), either_sign(ten_to(-6, 1)), ten_to(-12, -1), either_sign(ten_to(-3, 3)),
       either_sign(ten_to(-3, 0)))
def test_a_stage_is_the_one_solution_of_its_inclusion(c: Core, y: float, w: float, tau: float, f: float, s: float
                                                      ) -> None:
    _, m, b, *_, fc = c
    u, _ = stage(c, y, w, tau, f, s)

    def balance(u: float, way: float) -> float:
        return (m + tau * b) * u + tau * resistance_force(c, y + tau * u, u) + tau * fc * way - m * w - tau * f

    g = resistance_force(c, y + tau * u, u)
    near = 1e-11 * (abs(u) + abs(w) + abs(y) / tau) + 1e-13 * (m * abs(w) + tau * (abs(f) + fc + g)) / m
    way = [math.copysign(1.0, u + s + side * near) for side in (-1.0, 1.0)]
    assert balance(u - near, way[0]) <= 0.0 <= balance(u + near, way[1])
