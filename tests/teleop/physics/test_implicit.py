"""Bodies with friction and soft contact: closed forms, exact ticks, and SDIRK2 with an honest estimate of its error."""

from __future__ import annotations

import math
import random
from itertools import product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from teleop.physics.contact import events, wall
from teleop.physics.implicit import Resistance, implicit_master, implicit_plant, report
from teleop.physics.plant import MassDamper, free_space, grip, grip_force, move_gripped, response, spring_damper
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
from tests.teleop.physics.motions import DT, TOL, core, either_sign, reference, run, struck, ten_to

# -- Coulomb friction: closed forms


@pytest.mark.parametrize("b", [0.0, 3.0])
def test_a_sliding_body_stops_where_and_when_the_closed_form_says(b: float) -> None:
    m, fc, v = 0.5, 2.0, 0.3
    stop = m * v / fc if b == 0.0 else m / b * math.log1p(b * v / fc)
    far = 0.5 * m * v * v / fc if b == 0.0 else m / b * (v - fc / b * math.log1p(b * v / fc))
    plant = implicit_plant(MassDamper(mass=m, damping=b), DT, resistance=Resistance(), friction=fc)
    states, z = run(plant, 0.02, v, [0.0] * 100)
    moving = [w > 0.0 for _, w in states]
    assert moving.index(False) == math.ceil(stop / DT)
    assert states[-1][0] == pytest.approx(0.02 + far, abs=3.0 * z.total + 1e-14)
    assert 0.0 < z.total <= TOL
    resting = states[moving.index(False):]
    assert set(resting) == {resting[0]}  # to the bit
    for k in range(moving.index(False)):  # a sliding tick has the exact step: no error adds up
        t = k * DT
        x = v * t - 0.5 * fc / m * t * t if b == 0.0 else (v + fc / b) * m / b * -math.expm1(-b * t / m) - fc / b * t
        assert states[k][0] == pytest.approx(0.02 + x, abs=1e-14)


def test_a_body_pushed_with_less_than_friction_stays_to_the_bit() -> None:
    dice = random.Random(1)
    bond, hertz = Resistance(BOND, 100.0, 5.0, 0.12), Resistance(HUNT_CROSSLEY, 1e4, at=0.099)
    for resistance in (Resistance(), bond, bond._replace(side=-1.0), hertz):
        plant = implicit_plant(MassDamper(mass=0.3, damping=1.0), DT, resistance=resistance, friction=2.0)
        held = plant.force(plant.c, 0.1, 0.0, plant.start)
        states, z = run(plant, 0.1, 0.0, [held + dice.uniform(-1.999, 1.999) for _ in range(300)])
        assert set(states) == {(0.1, 0.0)}
        assert z == plant.start
        for side in (1.0, -1.0):
            _, v, _, after = plant.move(plant.c, 0.1, 0.0, held + side * 2.001, z)
            assert v * side > 0.0
            assert (after == z) == (resistance != hertz)  # it slides away with a closed form


def test_a_turned_body_is_held_back_on_its_way_there_and_back() -> None:
    m, fc, f, v = 0.2, 1.0, -3.0, 0.001  # 20 m/s^2 to the stop, 10 m/s^2 from it
    plant = implicit_plant(MassDamper(mass=m), DT, resistance=Resistance(), friction=fc)
    x, w, _, z = plant.move(plant.c, 0.0, v, f, plant.start)
    stop, left = v / 20.0, DT - v / 20.0
    assert x == pytest.approx(0.5 * v * stop - 5.0 * left * left, abs=3.0 * z[1])
    assert w == pytest.approx(-10.0 * left, abs=3.0 * z[1] / DT)
    assert 0.0 < z[1] <= TOL
    assert z[4] == 0


def test_a_swing_loses_two_fc_over_k_of_amplitude_at_each_turn() -> None:
    m, k, fc, start = 0.5, 200.0, 0.3, 0.0202
    loss, half = 2.0 * fc / k, math.pi * math.sqrt(m / k)
    plant = implicit_plant(MassDamper(mass=m), half / 50.0, resistance=Resistance(BOND, k), friction=fc)
    states, z = run(plant, start, 0.0, [0.0] * 500)
    turns = 0
    while start - turns * loss > fc / k:  # it sticks at the first turn that the spring cannot draw it out of
        turns += 1
    assert turns == 7
    for turn in range(turns + 1):
        x, v = states[50 * turn]
        assert x == pytest.approx((-1)**turn * (start - turn * loss), abs=3.0 * z.total)
        assert v == pytest.approx(0.0, abs=10.0 * z.total * math.sqrt(k / m))
    assert len(set(states[50 * turns + 1:])) == 1
    assert z.total < 10 * TOL
    assert z.over == 0


def test_a_master_drawn_by_a_spring_breaks_away_and_slides_as_the_closed_form_says() -> None:
    # Stuck until k s t = fc; then y'' = -w^2 y in the frame of the reference, from y = -fc/k: x = s t - (s/w) sin(w t).
    k, fc, s, body, hand = 300.0, 0.756, 0.05, MassDamper(mass=0.1), 0.2
    master = implicit_master(body, hand, k, 0.0, DT, friction=fc)
    w, away = math.sqrt(k / 0.3), fc / (k * s)
    x, v, z = 0.0, 0.0, master.start
    for tick in range(200):
        t = tick * DT - away
        if t <= 0.0:
            assert (x, v) == (0.0, 0.0)
        elif w * t < 6.0:
            assert x == pytest.approx(s * t - s / w * math.sin(w * t), abs=3.0 * z[2] + 1e-15)
            assert v == pytest.approx(s * (1.0 - math.cos(w * t)), abs=3.0 * w * z[2] + 1e-15)
        x, v, z = master.move(master.c, x, v, 0.0, s * tick * DT, s * (tick + 1) * DT, z)
    assert w * (199 * DT - away) > 4.5
    assert 0.0 < z[2] < 2 * TOL


# -- ticks with a closed form take it, others do not


def test_wall_and_tissue_without_friction_are_those_of_a_closed_form() -> None:
    body, dice = MassDamper(mass=0.5, damping=1.0), random.Random(12)
    for kind, exact in ((WALL, wall(body, DT, k=2e5, d=5.0, at=0.001, side=1.0)),
                        (BOND, spring_damper(body, DT, k=2e5, d=5.0, at=0.001))):
        plant = implicit_plant(body, DT, resistance=Resistance(kind, 2e5, 5.0, 0.001))
        x, v, z = 0.0, 0.2, plant.start
        for _ in range(100):
            f = dice.uniform(-2.0, 4.0)
            meant = exact.move(exact.c, x, v, f)
            y, w, _, after = plant.move(plant.c, x, v, f, z)
            error = after[2] - z[2]
            assert abs(y - meant[0]) <= 3.0 * error + 1e-14
            assert DT * abs(w - meant[1]) <= 3.0 * error + 1e-14
            assert plant.force(plant.c, x, v, z) == exact.force(exact.c, x, v)
            x, v, z = y, w, after


def test_whatever_a_wall_does_within_a_tick_the_plant_follows() -> None:
    dice, quick = random.Random(13), 0
    for _ in range(500):
        (_, m, b, k, d, *_), p, u, f, dt = struck(dice)
        dt *= dice.choice([1.0, 4.0])
        body = MassDamper(mass=m, damping=b)
        plant = implicit_plant(body, dt, resistance=Resistance(WALL, k, d))
        exact = wall(body, dt, k=k, d=d, at=0.0, side=1.0)
        x, v, _, z = plant.move(plant.c, p, u, f, plant.start)
        y, w, _ = exact.move(exact.c, p, u, f)
        assert abs(x - y) <= 3.0 * z[1] + 0.1 * TOL
        assert dt * abs(v - w) <= 3.0 * z[1] + 0.1 * TOL
        quick += z == plant.start
    assert 160 < quick < 440


def test_free_flight_without_friction_is_the_exact_step_to_the_bit() -> None:
    body = MassDamper(mass=0.3, damping=0.7)
    free, dice = free_space(body, DT), random.Random(2)
    other = Resistance(HUNT_CROSSLEY, 1e4, at=-0.5, side=-1.0)
    for resistance in (Resistance(), Resistance(WALL, 1e4, 3.0, 0.5), other):
        plant = implicit_plant(body, DT, resistance=resistance)
        for _ in range(50):
            x, v, f = dice.uniform(-0.4, 0.4), dice.uniform(-1.0, 1.0), dice.uniform(-5.0, 5.0)
            assert plant.move(plant.c, x, v, f, plant.start) == (*free.move(free.c, x, v, f), plant.start)


def test_a_master_without_friction_is_the_gripped_master_to_the_bit() -> None:
    body, dice = MassDamper(mass=0.1, damping=0.5), random.Random(4)
    for hand in ((0.4, 200.0, 5.0), (0.0, 0.0, 0.0)):
        master, exact = implicit_master(body, *hand, DT), tuple(grip(body, *hand, DT))
        for _ in range(50):
            x, v, f = (dice.uniform(-1.0, 1.0) for _ in range(3))
            r, r1 = (dice.uniform(-0.1, 0.1), dice.uniform(-0.1, 0.1)) if hand[0] else (0.0, 0.0)
            assert master.move(master.c, x, v, f, r, r1, master.start) == (
                *move_gripped(exact, x, v, f, r, r1), master.start)
            assert master.force(master.c, x, v, f, r, r1, master.start) == grip_force(exact, x, v, f, r, r1)


@pytest.mark.parametrize("kind", [NOTHING, WALL, BOND])
def test_a_tick_that_slides_one_way_is_what_the_integration_gives(kind: int) -> None:
    dice, quick = random.Random(5), 0
    for _ in range(400):
        m, b, k, d, fc = 0.2, 1.0, 10 ** dice.uniform(2, 6), 10 ** dice.uniform(-1, 1.5), 10 ** dice.uniform(-2, 1)
        plant = implicit_plant(MassDamper(mass=m, damping=b), DT, resistance=Resistance(kind, k, d), friction=fc)
        x, v, f = dice.uniform(-1e-4, 3e-4), dice.uniform(-0.05, 0.05), dice.uniform(-10.0, 10.0)
        x1, v1, _, z = plant.move(plant.c, x, v, f, plant.start)
        kept = integrate(core(kind, m=m, b=b, k=k, d=d, fc=fc), x, v, f, 0.0, DT, 1e-10, 1.0)
        assert abs(x1 - kept.p) <= 3.0 * (kept.error + z[1]) + 1e-11
        assert DT * abs(v1 - kept.u) <= 3.0 * (kept.error + z[1]) + 1e-11
        quick += z == plant.start
    assert 100 < quick < 400


# -- what carries a plant


def test_a_moving_environment_is_met_in_its_frame() -> None:
    # A wall closes in at 0.02 m/s on a body at rest, which it must first push out of its stiction.
    m, b, k, d, fc, s = 0.2, 0.5, 2e3, 4.0, 0.3, -0.02
    plant = implicit_plant(MassDamper(mass=m, damping=b), DT, resistance=Resistance(WALL, k, d), friction=fc)
    c = core(WALL, m=m, b=b, k=k, d=d, fc=fc)
    x, v, z = -1e-5, -s, plant.start
    stuck = True
    for _ in range(60):
        p, u = reference(c, x, v, -b * s, s, DT)
        x, v, _, after = plant.move(plant.c, x, v, -b * s, z, s)
        error = after[2] - z[2]
        assert x == pytest.approx(p, abs=3.0 * error + 1e-12)
        assert v == pytest.approx(u, abs=3.0 * error / DT + 1e-9)
        stuck, z = stuck and v == -s, after
    assert not stuck
    assert z[4] == 0


def test_the_grip_feels_the_friction_as_the_left_limit() -> None:
    body, hand, k, d, fc = MassDamper(mass=0.1, damping=0.5), 0.4, 200.0, 5.0, 0.6
    master = implicit_master(body, hand, k, d, DT, friction=fc)
    x, v, f_m, r, slope = 0.01, 0.2, 1.0, 0.03, 0.1
    f_h = master.force(master.c, x, v, f_m, r, slope, master.start)
    a = (f_h - f_m - 0.5 * v - fc) / 0.1  # M a + b v = f_h - f_m - friction
    assert f_h == pytest.approx(k * (r - x) + d * (slope - v) - hand * a, rel=1e-13)
    assert master.force(master.c, -x, -v, -f_m, -r, -slope, master.start) == -f_h
    # At rest and stuck nothing accelerates, and the muscle is what passes through the grip.
    assert master.force(master.c, 0.0, 0.0, 0.1, 0.002, 0.0, master.start) == pytest.approx(0.4)
    f_h = master.force(master.c, 0.0, 0.0, 0.1, 0.01, 0.0, master.start)  # torn away: 1.9 N against 0.6 N
    assert f_h == pytest.approx(2.0 - 0.4 * (1.9 - 0.6) / 0.5)


def test_the_report_adds_up_the_ticks() -> None:
    plant = implicit_plant(MassDamper(mass=0.2), DT, resistance=Resistance(HUNT_CROSSLEY, 1e6), tol=1e-8)
    assert plant.report is not None
    assert plant.report(plant.start) == {"error_estimate_max": 0.0, "error_estimate_sum": 0.0, "substeps_max": 0,
                                         "ticks_over_tolerance": 0, "tolerance": 1e-8}
    x, v, z, errors = -1e-4, 0.3, plant.start, [0.0]
    for _ in range(30):
        x, v, _, z = plant.move(plant.c, x, v, 1.0, z)
        errors.append(z[2] - sum(errors))
    got = report(z)
    assert got["error_estimate_max"] == pytest.approx(max(errors))
    assert got["error_estimate_sum"] == pytest.approx(sum(errors))
    assert 2 < got["substeps_max"] <= MOST_SUBSTEPS
    assert got["ticks_over_tolerance"] == 0


def test_a_run_that_diverged_with_friction_had_no_summary_since_its_report_was_not_a_number() -> None:
    plant = implicit_plant(MassDamper(mass=0.2), DT, resistance=Resistance(HUNT_CROSSLEY, 1e6), friction=0.1)
    for lost in (math.nan, math.inf, 1e308):
        x, v, _, z = plant.move(plant.c, 1e-4, 0.3, 1.0, plant.start)
        for _ in range(3):
            x, v, _, z = plant.move(plant.c, 1e-4, 0.3, lost, z)
            assert not (math.isfinite(x) and abs(v) < 1e300)
        assert all(map(math.isfinite, z))
        assert report(z)["ticks_over_tolerance"] == 3


# -- extremes: it ends, never raises, and makes no energy


any_resistance = st.builds(
    Resistance, kind=st.sampled_from([NOTHING, WALL, BOND, HUNT_CROSSLEY]), k=st.just(0.0) | ten_to(0, 9),
    d=st.just(0.0) | ten_to(-3, 3), at=st.just(0.0), side=st.just(1.0), n=st.sampled_from([1.0, 1.5, 2.0, 10.0]),
    lam=st.just(0.0) | ten_to(-3, 2))


@settings(max_examples=80)
@given(any_resistance, ten_to(-4, 3), st.just(0.0) | ten_to(-3, 2), st.just(0.0) | ten_to(-3, 3), ten_to(-5, -1),
       either_sign(ten_to(-7, -1)), either_sign(ten_to(-5, 0.5)), either_sign(ten_to(-3, 2)))
def test_extremes_end_and_stay_finite(resistance: Resistance, m: float, b: float, fc: float, dt: float, x: float,
                                      v: float, f: float) -> None:
    plant = implicit_plant(MassDamper(mass=m, damping=b), dt, resistance=resistance, friction=fc)
    states, z = run(plant, x, v, [f, f, -f])
    assert all(math.isfinite(number) for state in (*states, z) for number in state)
    assert z.most <= MOST_SUBSTEPS
    assert math.isfinite(plant.force(plant.c, *states[-1], z))


def test_what_is_not_finite_comes_back_as_not_finite() -> None:
    kinds = (NOTHING, WALL, BOND, HUNT_CROSSLEY)
    for kind, bad, (fc, n) in product(kinds, (math.nan, math.inf, -math.inf), ((0.0, 1.5), (1.0, 1.5), (0.0, 3.0))):
        plant = implicit_plant(MassDamper(mass=1.0), DT, resistance=Resistance(kind, 1e4, 1.0, n=n), friction=fc)
        master = implicit_master(MassDamper(mass=1.0), 0.1, 100.0, 1.0, DT, friction=fc)
        for numbers in ((bad, 0.1, 1.0), (1e-3, bad, 1.0), (1e-3, 0.1, bad), (0.0, 0.0, bad)):
            assert not all(map(math.isfinite, plant.move(plant.c, *numbers, plant.start)[:2]))
            plant.force(plant.c, *numbers[:2], plant.start)
            assert not all(map(math.isfinite, master.move(master.c, *numbers, 0.0, 0.0, master.start)[:2]))
            master.force(master.c, *numbers, 0.0, 0.0, master.start)
        for numbers in ((1e200, 1e200, 1e200), (1e308, -1e308, 1e308)):
            plant.move(plant.c, *numbers, plant.start)
            plant.force(plant.c, *numbers[:2], plant.start)
            master.move(master.c, *numbers, 0.0, 0.0, master.start)


def test_a_tick_that_would_need_more_substeps_says_so() -> None:
    plant = implicit_plant(MassDamper(mass=1e-4), 0.1, resistance=Resistance(HUNT_CROSSLEY, 1e9))
    _, z = run(plant, 1e-5, 0.5, [5.0] * 3)
    assert (z.over > 0, z.most) == (True, MOST_SUBSTEPS)
    assert z.worst > TOL
    assert math.frexp(z.first)[0] == 0.5  # so that the next tick is not passed over its end


# -- SDIRK2: exact where that is known, else beside an independent integration


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


def test_far_from_the_origin_rounding_is_not_taken_for_an_error_of_integration() -> None:
    near, far = (integrate(core(m=0.5, fc=2.0), x, 3e-3, -2.5, 0.0, 1e-3, TOL, 1.0) for x in (0.0, 1e4))
    assert far.substeps < near.substeps + 20
    assert far.p - 1e4 == pytest.approx(near.p, abs=1e-11)


# -- one stage


def test_a_stage_ends_at_the_surface_of_a_damped_wall_or_is_free_if_it_is_drawn_out_too_fast() -> None:
    # Outside it would be 10 um deep, inside the damper would hold it back before it gets there.
    u, mode = stage(core(WALL, m=0.2, k=1e3, d=1e3), -1e-4, 1.0, 1.1e-4, 0.0, 0.0)
    assert -1e-4 + 1.1e-4 * u == pytest.approx(0.0, abs=1e-18)
    assert mode == 1
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
