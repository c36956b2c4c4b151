"""The independent reference: against the exact steps, against closed forms, and against itself by another method."""

from __future__ import annotations

import random
from math import exp, gamma, isnan, log, log1p, pi, sqrt

import pytest

from teleop.analysis.precision.reference.reference import settle
from teleop.physics.contact import wall
from teleop.physics.implicit import implicit_plant
from teleop.physics.plant import MassDamper, spring_damper
from teleop.physics.sdirk import BOND, HUNT_CROSSLEY, NOTHING, WALL

both = pytest.mark.parametrize("solver", ["DOP853", "Radau"])
M, B = 0.5, 1.0
BODY = MassDamper(mass=M, damping=B)


# Where the exact steps apply


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


# Closed forms


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


# Itself, by the other method


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


def test_what_is_not_finite_stays_so() -> None:
    assert isnan(settle((NOTHING, M, B, 0.0, 0.0, 1.5, 0.0, 0.0), float("inf"), 0.0, 0.0, 0.0, 1e-3, "DOP853").p)
