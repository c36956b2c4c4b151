"""Fixed-step methods on bodies that are not piecewise linear, or that remember: their orders, and what they solve."""

from __future__ import annotations

from dataclasses import replace
from math import inf
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from master.hand import Grip, Sine
from slave import HuntCrossley, Moving, StandardLinearSolid, Tissue, Wall
from teleop import ElectricalDamping, MassDamper, Refused, Scene, load_scene, run
from teleop.analysis.precision.contenders import outsider_bodies
from teleop.analysis.precision.reference.reference import settle
from teleop.physics.relaxing import relaxing
from teleop.physics.sdirk import BOND, HUNT_CROSSLEY, NOTHING, WALL, resistance_force
from teleop.simulation.integrators import relaxed
from teleop.simulation.integrators.methods import METHODS, IntegrationMethod, Touch
from teleop.simulation.integrators.nonlinear import ADVANCE, acceleration, goes, kicked
from teleop.simulation.integrators.parts import has_closed_form
from teleop.simulation.integrators.relaxed import Branch
from teleop.simulation.integrators.stepped import method_bodies, stepped, sub_step
from tests.teleop.analysis.precision.test_measure import strike

KNOWN = [method for method in METHODS if goes(method)]
every_known = pytest.mark.parametrize("method", KNOWN, ids=lambda method: method.name)
every_method = pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)
RIDE = (HUNT_CROSSLEY, 0.5, 1.0, 1e6, 0.0, 1.5, 2.0, 0.0)  # pressed in by 1 mm it stays in contact
BODY = MassDamper(mass=0.5, damping=1.0)
PATH = Sine(amplitude=5e-4, frequency=5.0)
HC = HuntCrossley(k=1e6, lam=1.0, at=1e-3)
RUBBING = MassDamper(mass=0.3, damping=1.0, friction=0.5)


def branch(k1: float = 3000.0) -> Branch:
    return Branch(0.5, 1.0, 2000.0, 1.0, k1 * 0.01, 0.01)


# Where nothing is touched or let go


@every_known
def test_halving_the_step_of_a_ride_in_hunt_crossley_contact_shows_the_order(method: IntegrationMethod) -> None:
    dt, state = 4e-3, (1e-3, 0.05, 20.0, 0.0)
    want = np.array(settle(RIDE, *state, dt, "DOP853")[:2])

    def error(n: int) -> float:
        got = ADVANCE[method.name](RIDE, *state, dt / n, n)
        return float(np.abs(np.array(got) - want).max())

    assert np.log2(error(32) / error(64)) == pytest.approx(method.order, abs=0.25)


@every_known
def test_while_it_slides_one_way_friction_takes_nothing_of_the_order(method: IntegrationMethod) -> None:
    dt, core, state = 0.02, (BOND, 0.5, 1.0, 2000.0, 3.0, 1.5, 0.0, 2.0), (-0.03, 0.3, 4.0, 0.1)
    want = np.array(settle(core, *state, dt, "DOP853")[:2])
    assert settle(core, *state, dt, "DOP853").changes == 0
    errors = [np.abs(np.array(ADVANCE[method.name](core, *state, dt / n, n)) - want).max() for n in (32, 64)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(method.order, abs=0.25)


@every_method
def test_halving_the_step_of_a_body_in_tissue_that_relaxes_shows_the_order(method: IntegrationMethod) -> None:
    dt = 0.02
    exact = relaxing(BODY, dt, k=2000.0, k1=3000.0, tau=0.01)
    x, v, _, z = exact.move(exact.c, 0.02, 0.3, 4.0, (1.5,))

    def error(n: int) -> float:
        got = relaxed.stepped(method, branch(), dt, n)(0.02, 0.3, 1.5, 4.0)
        return float(np.abs(np.array(got) - (x, v, z[0])).max())

    assert np.log2(error(32) / error(64)) == pytest.approx(method.order, abs=0.3)


@every_method
def test_without_a_branch_it_is_the_same_method_as_on_a_bond(method: IntegrationMethod) -> None:
    whole = relaxed.sub_step(method, branch(k1=0.0), 2e-3)
    want = sub_step(method, Touch(0.5, 1.0, 2000.0, 0.0, edge=-inf, floor=-inf), 2e-3)
    assert (*whole[0, [0, 1, 3]], *whole[1, [0, 1, 3]]) == pytest.approx(want, rel=1e-12)


# Contact and friction


@every_known
@pytest.mark.parametrize("d", [0.0, 10.0])
def test_at_a_wall_it_is_the_same_method_as_on_one_that_is_piecewise_linear(
    method: IntegrationMethod, d: float
) -> None:
    dt, n = 2e-3, 4
    plant = stepped(method, Touch(0.5, 1.0, 2e4, d, edge=0.0), dt, n)
    core = (WALL, 0.5, 1.0, 2e4, d, 1.5, 0.0, 0.0)
    for p, u in ((-3e-4, 0.4), (1e-3, -0.5), (1e-5, -0.2), (2e-3, 0.1), (1e-4, -2.0)):
        want = plant.move(plant.c, p, u, 1.5)[:2]
        assert ADVANCE[method.name](core, p, u, 1.5, 0.0, dt / n, n) == pytest.approx(want, rel=1e-12, abs=1e-15)


@every_known
def test_a_body_at_rest_that_friction_can_hold_stays_to_the_bit(method: IntegrationMethod) -> None:
    core = (NOTHING, 0.5, 1.0, 0.0, 0.0, 1.5, 0.0, 2.0)
    assert ADVANCE[method.name](core, 0.3, 0.0, 1.99, 0.0, 1e-3, 7) == (0.3, 0.0)
    moved = ADVANCE[method.name](core, 0.3, 0.0, -2.5, 0.0, 1e-3, 7)
    assert moved == pytest.approx((0.3, -0.5 * 7e-3 / 0.5), rel=0.02)


@every_known
def test_through_a_stop_every_method_comes_to_where_the_body_stops(method: IntegrationMethod) -> None:
    core, state = (NOTHING, 0.5, 1.0, 0.0, 0.0, 1.5, 0.0, 3.0), (0.0, 0.02, 1.0, 0.0)
    want = settle(core, *state, 0.01, "DOP853").p
    assert ADVANCE[method.name](core, *state, 0.01 / 4096, 4096)[0] == pytest.approx(want, abs=1e-7)


@given(
    kind=st.sampled_from([NOTHING, WALL, BOND, HUNT_CROSSLEY]), p=st.floats(-1e-3, 1e-3), w=st.floats(-1.0, 1.0),
    f=st.floats(-20.0, 20.0), s=st.sampled_from([0.0, 0.1]), fc=st.sampled_from([0.0, 2.0]),
    d=st.sampled_from([0.0, 10.0]), lam=st.sampled_from([0.0, 3.0]),
)
def test_the_second_half_of_verlets_kick_satisfies_its_own_equation(
    kind: int, p: float, w: float, f: float, s: float, fc: float, d: float, lam: float
) -> None:
    core, tau = (kind, 0.5, 1.0, 1e4, d, 1.5, lam, fc), 1e-3
    u = kicked(core, p, w, tau, f, s)
    left = f - 0.5 * (u - w) / tau - u - resistance_force(core, p, u)  # what friction must be
    rounding = 1e-9 * (1.0 + abs(f) + 500.0 * (abs(u) + abs(w)))
    if u == -s:
        assert abs(left) <= fc + rounding
    else:
        assert left == pytest.approx(fc if u + s > 0.0 else -fc, abs=rounding)


def test_what_explicit_methods_evaluate_is_the_equation() -> None:
    core = (HUNT_CROSSLEY, 0.5, 1.0, 1e6, 0.0, 1.5, 2.0, 3.0)
    g = 1e6 * 1e-3**1.5 * (1.0 + 2.0 * 0.1)
    assert acceleration(core, 1e-3, 0.1, 5.0, 0.0) == pytest.approx((5.0 - 0.1 - g - 3.0) / 0.5, rel=1e-14)
    assert acceleration(core, 1e-3, 0.1, 5.0, -0.2) == pytest.approx((5.0 - 0.1 - g + 3.0) / 0.5, rel=1e-14)
    assert acceleration(core, -1e-3, 0.0, 2.0, 0.0) == 0.0


# In a run

GRIP = Grip(mass=0.4, k=300.0, d=5.0, reference=Sine(amplitude=0.01, frequency=5.0))
SCENES: dict[str, dict[str, Any]] = {
    "Hunt-Crossley": {"environment": HC},
    "the same with friction": {"environment": HC, "slave": RUBBING},
    "a master with friction": {"environment": Tissue(k=2000.0, d=1.0), "hand": GRIP,
                               "master": MassDamper(mass=0.1, damping=0.5, friction=0.3)},
    "the same, held by nobody": {"environment": HC, "master": MassDamper(mass=0.1, damping=0.5, friction=0.3),
                                 "hand": None},
    "a wall that moves": {"environment": Moving(environment=Wall(k=1e4, d=20.0, at=1e-3), path=PATH)},
    "Hunt-Crossley that moves, and friction": {"environment": Moving(environment=HC, path=PATH), "slave": RUBBING},
    "a standard linear solid": {"environment": StandardLinearSolid(k=500.0, k1=2000.0, tau=0.01)},
    "the same, moving": {"environment": Moving(environment=StandardLinearSolid(k=500.0, k1=2e3, tau=0.01), path=PATH)},
    "electrical damping": {"environment": Tissue(k=2000.0, d=1.0), "hand": GRIP,
                           "electrical": ElectricalDamping(b=2.0, cutoff=20.0)},
    "the same without a hand": {"environment": HC, "electrical": ElectricalDamping(b=2.0, cutoff=20.0), "hand": None},
    "three axes": {"axes": 3, "start_m": (0.0, 0.02, 0.02), "environment": (
        None, HC, Moving(environment=StandardLinearSolid(k=500.0, k1=2000.0, tau=0.01), path=PATH))},
}


ORDINARY = ("Hunt-Crossley that moves, and friction", "electrical damping", "three axes")
FEW_FIRST = [pytest.param(name, marks=[pytest.mark.full] * (name not in ORDINARY)) for name in SCENES]


def scene(name: str, **other: Any) -> Scene:
    return strike(**{"duration": 0.04, **SCENES[name], **other})


def off(one: Any, other: Any) -> float:
    return max(float(np.abs(one.trace[name] - other.trace[name]).max()) for name in ("x_m", "x_s"))


@pytest.mark.parametrize("name", FEW_FIRST)
def test_the_methods_move_the_bodies_that_the_stack_moves(name: str) -> None:
    own = run(scene(name))
    methods = METHODS if has_closed_form(scene(name)) else KNOWN
    for method in methods if name in ("the same, moving", "electrical damping") else (methods[0], methods[-1]):
        got = [run(scene(name), bodies=method_bodies(scene(name), method, n)) for n in (1, 64)]
        errors = [off(each, own) for each in got]
        assert errors[1] < 0.1 * errors[0]
        assert errors[1] < 3e-5
        assert "integration" not in got[0].extra  # that would be the stack's own


@pytest.mark.parametrize("name", [each for each in FEW_FIRST if "friction" not in each.values[0]])
def test_so_do_scipys_solvers(name: str) -> None:
    some = scene(name, duration=0.03)
    assert off(run(some, bodies=outsider_bodies(some, "LSODA", 1e-6)), run(some)) < 1e-6


def test_where_there_is_no_slave_the_master_is_moved() -> None:
    alone = load_scene("virtual_wall", duration=0.3)
    own = run(alone)
    errors = [np.abs(run(alone, bodies=method_bodies(alone, METHODS[0], n)).trace["x_m"] - own.trace["x_m"]).max()
              for n in (1, 16)]
    assert 1e-9 < errors[1] < 0.1 * errors[0]


def test_radau_iia_is_refused_where_its_coupled_stages_are_not_solved() -> None:
    with pytest.raises(Refused, match=r"Radau IIA, two stages is not known .* take for example sdirk2"):
        method_bodies(scene("Hunt-Crossley"), METHODS[-1], 1)


def test_a_plant_with_an_inner_state_that_nobody_knows_is_refused() -> None:
    solid = replace(scene("a standard linear solid"), environment=Opaque())
    with pytest.raises(Refused, match=r"move_relaxing, so no fixed-step method can; take walls"):
        method_bodies(solid, METHODS[0], 1)


class Opaque:
    """A relaxing plant that does not say of what it is made."""

    inner = True

    def plant(self, body: MassDamper, dt: float) -> Any:
        return relaxing(body, dt, k=1.0, k1=2.0, tau=0.1)
