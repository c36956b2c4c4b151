"""The references, in 40 digits and integrated: against multiple precision, closed forms, and each other."""

from __future__ import annotations

import random
from decimal import Decimal
from itertools import pairwise
from math import exp, gamma, isnan, log, log1p, pi, sqrt
from typing import Any

import mpmath
import numpy as np
import pytest

from slave.wall import Wall
from teleop import Scene, load_scene, run
from teleop.analysis.precision.reference.deviation import Steps, errors
from teleop.analysis.precision.reference.digits import Body, Equation, Motion, digit_bodies, run_in_digits
from teleop.analysis.precision.reference.reference import settle
from teleop.physics.contact import wall
from teleop.physics.implicit import implicit_plant
from teleop.physics.plant import MassDamper, spring_damper
from teleop.physics.sdirk import BOND, HUNT_CROSSLEY, NOTHING, WALL
from teleop.simulation.bodies import Bodies, exact_bodies
from tests.teleop.analysis.precision.test_measure import strike

CLOSED = ["hard_wall", "relaxing_tissue", "beating_heart", *(pytest.param(name, marks=pytest.mark.full) for name in (
    "canonical", "soft_tissue", "free_motion", "recorded_reach"))]


def exact(number: float) -> mpmath.mpf:
    return mpmath.mpf(number)


def linear_step(m: Any, c: Any, k: Any, p: Any, u: Any, f: Any, t: Any) -> tuple[Any, Any]:
    """`m p'' + c p' + k p = f` by the roots of its characteristic polynomial, in multiple precision."""
    if k == 0 and c == 0:
        return p + t * u + t * t * f / (2 * m), u + t * f / m
    if k == 0:
        decay = mpmath.exp(-c * t / m)
        return p + f * t / c + (u - f / c) * m / c * (1 - decay), f / c + (u - f / c) * decay
    root = mpmath.sqrt(mpmath.mpc(c * c - 4 * m * k))
    a, b = (-c + root) / (2 * m), (-c - root) / (2 * m)
    q = p - f / k
    one = (u - b * q) / (a - b)
    x, y = one * mpmath.exp(a * t), (q - one) * mpmath.exp(b * t)
    return f / k + (x + y).real, (a * x + b * y).real


def wall_step(m: Any, b: Any, k: Any, d: Any, p: Any, u: Any, f: Any, span: Any) -> tuple[Any, Any]:
    """One tick beside a wall: contact changes are searched for on a fine grid and bisected, in multiple precision."""
    touching = p > 0 and k * p + d * u > 0
    while True:
        c, spring = (b + d, k) if touching else (b, mpmath.mpf(0))

        def gap(t: Any, touching: bool = touching, c: Any = c, spring: Any = spring, p: Any = p, u: Any = u) -> Any:
            q, w = linear_step(m, c, spring, p, u, f, t)
            return k * q + d * w if touching else -q if p <= 0 else -(k * q + d * w) if -(k * q + d * w) < q else q

        grid = [span * i / 64 for i in range(65)]
        found = next(((s, t) for s, t in pairwise(grid) if gap(t) < 0), None)
        if found is None:
            return linear_step(m, c, spring, p, u, f, span)
        low, high = found
        for _ in range(150):
            middle = (low + high) / 2
            low, high = (middle, high) if gap(middle) >= 0 else (low, middle)
        outside = p <= 0
        p, u = linear_step(m, c, spring, p, u, f, high)
        if not touching and outside:
            p, touching = mpmath.mpf(0), True
        elif touching:
            touching = False
            p = p if d else mpmath.mpf(0)
        else:  # inside, drawn out: onto the wall again, or out of it
            touching = p > mpmath.mpf(10) ** -35
            p = p if touching else -mpmath.mpf(0)
        span -= high


def by_mpmath(scene: Scene) -> Bodies:
    """The scene's slave beside its wall and its gripped master, their states kept in 40 digits by mpmath."""
    own, body, wall, hand = exact_bodies(scene), scene.slave, scene.environment, scene.hand
    assert isinstance(wall, Wall)
    dt = mpmath.mpf(scene.dt_ns) / 10**9
    kept: dict[str, Any] = {}

    def slave(_: Any, x: float, v: float, f: float) -> tuple[float, float, int]:
        state = kept.get("s", (exact(x), exact(v)))
        p, u = wall_step(*map(exact, (body.mass, body.damping, wall.k, wall.d)), state[0] - exact(wall.at), state[1],
                         exact(f), dt)
        kept["s"] = p + exact(wall.at), u
        return float(kept["s"][0]), float(u), 0

    def master(_: Any, x: float, v: float, f: float, r0: float, r1: float) -> tuple[float, float]:
        y, w = kept.get("m", (exact(x), exact(v)))
        b, s = exact(scene.master.damping), (exact(r1) - exact(r0)) / dt
        m = exact(scene.master.mass) + exact(hand.mass)
        y, w = linear_step(m, b + exact(hand.d), exact(hand.k), y - exact(r0), w - s, -exact(f) - b * s, dt)
        kept["m"] = exact(r1) + y, s + w
        return tuple(map(float, kept["m"]))

    return own._replace(slaves=[own.slaves[0]._replace(move=slave)], instead={"move_gripped": master})


class TestARun:
    def test_the_exact_methods_error_is_what_multiple_precision_says_not_what_a_coarser_reference_shows(self) -> None:
        """Once the run was put off by a rounding error at every tick, and the difference shown as the method's."""
        scene = strike(environment=Wall(k=1e6, d=5.0, at=1e-3), duration=0.04)
        own = run(scene).trace
        result, off, _ = run_in_digits(scene, 0)
        with mpmath.workdps(40):
            want = run(scene, bodies=by_mpmath(scene)).trace
        assert np.diff(own["f_env"] > 0.0).sum() >= 3
        for name in ("x_s", "x_m", "f_env"):
            np.testing.assert_array_equal(result.trace[name], want[name])
        true = np.abs(own["x_s"] - want["x_s"]).max()
        assert errors(own, result.trace)["x_s"].max == true > off["x_s"] > 0.0

    @pytest.mark.parametrize("name", CLOSED)
    def test_with_more_digits_it_is_the_same_and_the_exact_run_lies_by_rounding_off(self, name: str) -> None:
        scene = load_scene(name, duration=0.15)
        (one, off, steps), (other, _, _) = (run_in_digits(scene, 0, digits=digits) for digits in (40, 60))
        for column, rounding in off.items():
            assert errors(one.trace, other.trace)[column].max <= 1e-30
            assert rounding < 1e-11 * max(1.0, np.abs(one.trace[column]).max())
        assert errors(run(scene).trace, one.trace)["x_s"].max < 1e-14
        assert steps.count == 150 * 2 * scene.axes
        assert steps.x < 1e-16

    def test_a_step_that_were_wrong_would_show_at_whatever_tick(self, monkeypatch: pytest.MonkeyPatch) -> None:
        scene = strike(duration=0.03)
        own = exact_bodies(scene)
        plant, made = own.slaves[0], iter(range(100))

        def bent(c: Any, x: float, v: float, f: float) -> tuple[float, float, int]:
            x, v, more = plant.move(c, x, v, f)
            return x + 1e-9 * (next(made) == 17), v, more

        crooked = own._replace(slaves=[plant._replace(move=bent)])
        monkeypatch.setattr("teleop.analysis.precision.reference.digits.exact_bodies", lambda _: crooked)
        monkeypatch.setattr("teleop.simulation.integrators.parts.exact_bodies", lambda _: own)
        steps = Steps()
        run(scene, bodies=digit_bodies(scene, steps)[0])
        assert steps.x == pytest.approx(1e-9, rel=1e-6)

    def test_its_own_error_is_the_rounding_of_its_columns(self) -> None:
        scene = strike(duration=0.05)
        bodies, slaves, _ = digit_bodies(scene, Steps())
        trace = run(scene, bodies=bodies).trace
        _, off, _ = run_in_digits(scene, 0)
        assert 0.0 < off["x_s"] <= 2.0**-53 * np.abs(trace["x_s"]).max()
        assert off["f_env"] == np.abs(trace["f_env"][1:] - np.array(slaves[0].forces)[:-1]).max() > 0.0


class TestATick:
    def test_beside_a_wall_it_is_that_of_dop853_with_located_events(self) -> None:
        dice = random.Random(5)
        changes = 0
        for _ in range(40):
            k, d = 10 ** dice.uniform(2, 6), dice.choice([0.0, 3.0, 50.0])
            p, u, f = dice.uniform(-1e-3, 1e-3), dice.uniform(-1.0, 1.0), dice.uniform(-20.0, 20.0)
            body = Body(Motion(Equation(*map(Decimal, (0.5, 1.0 + d, k))), Decimal(1), wall=Decimal(d)), 2_000_000)
            want = settle((WALL, 0.5, 1.0, k, d, 1.5, 0.0, 0.0), p, u, f, 0.0, 2e-3, "DOP853")
            assert body.move(p, u, f)[:2] == pytest.approx(want[:2], rel=1e-10, abs=1e-13)
            assert body.changes == want.changes
            changes += body.changes
        assert changes > 20

    def test_pressed_against_a_wall_too_stiff_for_an_integrator_it_rests_at_its_depth(self) -> None:
        for k in (1e14, 1e9):
            body = Body(Motion(Equation(*map(Decimal, (0.5, 1.0, k))), Decimal(1), wall=Decimal(0)), 1_000_000)
            state = 1.0 / k, 0.0
            for _ in range(3):
                state = body.move(*state, 1.0)[:2]
            assert state == (pytest.approx(1.0 / k, rel=1e-12), pytest.approx(0.0, abs=1e-12))

    def test_stiff_and_overdamped_it_is_the_matrix_exponential(self) -> None:
        m, c, k, f = 0.3, 2e4, 1e6, 3.0
        body = Body(Motion(Equation(*map(Decimal, (m, c, k))), Decimal(0)), 1_000_000)
        with mpmath.workdps(60):
            want = linear_step(*map(exact, (m, c, k, 1e-3, -0.5, f)), mpmath.mpf("0.001"))
        assert body.move(1e-3, -0.5, f)[:2] == tuple(map(float, want))

    def test_bonded_it_is_that_of_dop853_and_what_is_not_finite_stays_so(self) -> None:
        body = Body(Motion(Equation(*map(Decimal, (0.5, 4.0, 2000.0))), Decimal(1)), 2_000_000)
        want = settle((BOND, 0.5, 1.0, 2000.0, 3.0, 1.5, 0.0, 0.0), 0.01, 0.3, 4.0, 0.0, 2e-3, "DOP853")
        assert body.move(0.01, 0.3, 4.0)[:2] == pytest.approx(want[:2], rel=1e-13)
        body = Body(Motion(Equation(Decimal(1), Decimal(0)), Decimal(0)), 1_000_000)
        assert np.isnan(body.move(float("inf"), 0.0, 0.0)).all()
        assert isnan(settle((NOTHING, M, B, 0.0, 0.0, 1.5, 0.0, 0.0), float("inf"), 0.0, 0.0, 0.0, 1e-3, "DOP853").p)


both = pytest.mark.parametrize("solver", ["DOP853", "Radau"])
M, B = 0.5, 1.0
BODY = MassDamper(mass=M, damping=B)


@both
def test_at_a_wall_it_is_the_exact_step(solver: str) -> None:
    states = [(-2e-4, 0.5, 1.0), (3e-4, -0.6, 2.0), (1e-3, 0.1, -3.0), (0.0, 0.2, 0.0), (0.0, 0.0, 1.0),
              (5e-5, -1.0, 30.0)]
    for k, d in ((2e4, 10.0), (1e6, 0.0), (1e3, 50.0), (1e6, 200.0)):
        exact = wall(BODY, 1e-3, k=k, d=d, at=0.01, side=-1.0)
        for p, u, f in states if solver == "DOP853" else states[:2]:
            q, w, _ = settle((WALL, M, B, k, d, 1.5, 0.0, 0.0), p, u, f, 0.0, 1e-3, solver)
            moved = exact.move(exact.c, 0.01 - p, -u, -f)[:2]
            assert (0.01 - q, -w) == pytest.approx(moved, rel=1e-12, abs=1e-15), (k, d, p, u, f)


@both
def test_bonded_it_is_the_exact_step(solver: str) -> None:
    exact = spring_damper(BODY, 2e-3, k=2000.0, d=3.0)
    got = settle((BOND, M, B, 2000.0, 3.0, 1.5, 0.0, 0.0), 0.01, 0.3, 4.0, 0.0, 2e-3, solver)
    assert got[:2] == pytest.approx(exact.move(exact.c, 0.01, 0.3, 4.0)[:2], rel=1e-13)


@both
@pytest.mark.parametrize("n", [1.5, *(pytest.param(n, marks=pytest.mark.full) for n in (1.0, 2.0))])
def test_a_hertz_impact_takes_its_time_and_comes_back_as_fast(solver: str, n: float) -> None:
    """`T = 2 (depth/u) sqrt(pi) Gamma(1 + 1/(n+1))/Gamma(1/2 + 1/(n+1))`, `depth^(n+1) = (n+1) m u^2/(2 k)`."""
    k, u, gap = 3e5, 0.3, 1e-4
    e = 1.0 / (n + 1.0)
    depth = (0.5 * (n + 1.0) * M * u * u / k) ** e
    inside = 2.0 * depth / u * sqrt(pi) * gamma(1.0 + e) / gamma(0.5 + e)
    got = settle((HUNT_CROSSLEY, M, 0.0, k, 0.0, n, 0.0, 0.0), -gap, u, 0.0, 0.0, 2.0 * gap / u + inside, solver)
    assert got.p == pytest.approx(-gap, abs=1e-12 * depth)
    assert got.u == pytest.approx(-u, rel=1e-12)
    assert got.changes == 2


@both
@pytest.mark.parametrize(("n", "lam"), [(2.2, 0.2), *(pytest.param(*each, marks=pytest.mark.full)
                                                      for each in ((1.5, 1.0), (1.0, 3.0)))])


def test_a_hunt_crossley_impact_has_its_restitution(solver: str, n: float, lam: float) -> None:
    """`m u' = -k p^n (1 + lam u)` by u/(1 + lam u): `lam u - log(1 + lam u)` is the same on the way in and out."""
    got = settle((HUNT_CROSSLEY, M, 0.0, 1e6, 0.0, n, lam, 0.0), -1e-4, 0.4, 0.0, 0.0, 0.2, solver)
    assert got.u < 0.0 > got.p
    assert lam * got.u - log1p(lam * got.u) == pytest.approx(lam * 0.4 - log1p(lam * 0.4), rel=1e-12)


@both
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_friction_stops_a_sliding_body_where_it_should_and_holds_it(solver: str, way: float) -> None:
    """`m v' = f - b v - fc` from v0 stops at `t = (m/b) log(1 + b v0/(fc - f))`."""
    f, fc, v0 = 1.0, 3.0, 0.02
    tau, limit = M / B, (f - fc) / B
    stop = tau * log(1.0 - v0 / limit)
    x = limit * stop + (v0 - limit) * tau * (1.0 - exp(-stop / tau))
    got = settle((NOTHING, M, B, 0.0, 0.0, 1.5, 0.0, fc), 0.0, way * v0, way * f, 0.0, 0.05, solver)
    assert got.p == pytest.approx(way * x, rel=1e-12)
    assert (got.u, got.changes) == (0.0, 1)
    assert settle((NOTHING, M, B, 0.0, 0.0, 1.5, 0.0, fc), x, 0.0, 0.999 * fc, 0.0, 0.05, solver)[:2] == (x, 0.0)


@both
@pytest.mark.parametrize("b", [0.0, 20.0])
def test_a_bonded_body_held_on_moving_ground_lets_go_where_the_spring_has_wound_up(solver: str, b: float) -> None:
    """With nothing else than friction and `k p` it goes along with the ground, -s, until `k p = fc`, then slides.

    Then `m q'' + b q' + k q = -b s` for `q = p - fc/k`, from q = 0 and q' = -s; without b that is `-s/w sin(w t)`.
    """
    k, fc, s = 1000.0, 2.0, -0.1
    core = (BOND, M, b, k, 0.0, 1.5, 0.0, fc)
    begins = fc / k / -s
    held = settle(core, 0.0, -s, -b * s, s, 0.999 * begins, solver)
    assert held == (pytest.approx(0.999 * fc / k, rel=1e-12), -s, 0)
    got = settle(core, 0.0, -s, -b * s, s, 0.05, solver)
    sliding = spring_damper(MassDamper(mass=M, damping=b), 0.05 - begins, k=k, d=0.0)
    assert got.p == pytest.approx(fc / k + sliding.move(sliding.c, 0.0, -s, -b * s)[0], rel=1e-9)
    assert got.changes == 1


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.full) for seed in range(1, 6))])
def test_radau_and_dop853_agree_whatever_changes(seed: int) -> None:
    dice = random.Random(seed)
    seen = 0
    for kind in (NOTHING, WALL, BOND, HUNT_CROSSLEY):
        for _ in range(4):
            k = 10 ** dice.uniform(2, 5) * (30.0 if kind == HUNT_CROSSLEY else 1.0)
            core = (kind, 10 ** dice.uniform(-1, 0.5), dice.choice([0.0, 2.0]), k, dice.choice([0.0, 5.0]), 1.5,
                    dice.choice([0.0, 2.0]), dice.choice([0.0, 1.5]))
            s = dice.choice([0.0, dice.uniform(-0.2, 0.2)])
            u = dice.choice([dice.uniform(-0.5, 0.5), -s, 1e-3 - s])
            p, f = dice.uniform(-1e-3, 1e-3), dice.uniform(-5.0, 5.0)
            one, other = (settle(core, p, u, f, s, 2e-3, solver) for solver in ("DOP853", "Radau"))
            assert one[:2] == pytest.approx(other[:2], rel=1e-11, abs=1e-14)
            seen += one.changes
    assert seen > 0  # or it would compare smooth motion only


def test_the_stacks_own_integration_comes_to_it_as_its_tolerance_falls() -> None:
    from slave.hunt_crossley import HuntCrossley

    off = []
    for tol in (1e-8, 1e-10):
        plant = implicit_plant(BODY, 2e-3, resistance=HuntCrossley(k=1e6, lam=1.0).resistance(), friction=0.5, tol=tol)
        side, at, core = plant.c[:3]
        x, *_, z = plant.move(plant.c, -1e-4, 0.3, 2.0, plant.start)
        want = settle(core, -1e-4, 0.3, 2.0, 0.0, 2e-3, "DOP853")
        assert (side, at) == (1.0, 0.0)
        off.append(abs(x - want.p))
        assert off[-1] < 2.0 * plant.report(z)["error_estimate_max"] + 0.1 * tol
    assert off[1] < 0.1 * off[0]
