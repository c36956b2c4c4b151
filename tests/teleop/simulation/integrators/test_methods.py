"""Fixed-step methods: their published stability functions and orders; contact, friction and bodies that remember."""

from __future__ import annotations

import cmath
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from math import inf, sqrt
from typing import Any

import numpy as np
import pytest
from scipy.optimize import fsolve

from master.hand import Grip, Sine
from slave import HuntCrossley, Moving, StandardLinearSolid, Tissue, Wall
from teleop import ElectricalDamping, MassDamper, Plant, Refused, Scene, load_scene, run
from teleop.analysis.precision.contenders import outsider_bodies
from teleop.analysis.precision.reference.reference import settle
from teleop.physics.contact import wall
from teleop.physics.plant import free_space, grip, move_free, move_gripped, spring_damper
from teleop.physics.relaxing import relaxing
from teleop.physics.sdirk import BOND, HUNT_CROSSLEY, NOTHING, WALL, resistance_force
from teleop.simulation.bodies import exact_bodies
from teleop.simulation.integrators import relaxed
from teleop.simulation.integrators.methods import METHODS, IntegrationMethod, Touch
from teleop.simulation.integrators.nonlinear import ADVANCE, goes, kicked
from teleop.simulation.integrators.parts import has_closed_form
from teleop.simulation.integrators.relaxed import Branch
from teleop.simulation.integrators.stepped import bodies_of, method_bodies, stepped, sub_step, touch_of
from tests.teleop.analysis.precision.test_measure import strike

BY_NAME = {method.name: method for method in METHODS}
G = 1.0 - sqrt(0.5)
STABILITY: dict[str, Callable[[complex], complex]] = {  # R(z) of y' = lambda y, z = h lambda; Hairer & Wanner II, IV.3
    "euler": lambda z: 1 + z,
    "rk4": lambda z: 1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24,
    "backward_euler": lambda z: 1 / (1 - z),
    "midpoint": lambda z: (1 + z / 2) / (1 - z / 2),
    "trapezoid": lambda z: (1 + z / 2) / (1 - z / 2),
    "sdirk2": lambda z: (1 + (1 - 2 * G) * z) / (1 - G * z) ** 2,
    "radau": lambda z: (1 + z / 3) / (1 - 2 * z / 3 + z**2 / 6),
}
every_method = pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)


def bonded(m: float = 0.5, b: float = 1.0, k: float = 2000.0, d: float = 3.0) -> Touch:
    return Touch(m, b, k, d, edge=-inf, floor=-inf)


def matrix(method: IntegrationMethod, touch: Touch, h: float) -> np.ndarray:
    a11, a12, _, a21, a22, _ = sub_step(method, touch, h)
    return np.array([[a11, a12], [a21, a22]])


# Where nothing is touched or let go


def test_a_mode_is_multiplied_by_the_published_stability_function() -> None:
    touch = bonded()
    root = cmath.sqrt((touch.b + touch.d) ** 2 - 4 * touch.m * touch.k)
    modes = [(-(touch.b + touch.d) + sign * root) / (2 * touch.m) for sign in (1, -1)]
    for (name, function), h in product(STABILITY.items(), (1e-3, 0.02, 0.3)):
        got = np.sort_complex(np.linalg.eigvals(matrix(BY_NAME[name], touch, h)))
        want = np.sort_complex(np.array([function(h * mode) for mode in modes]))
        np.testing.assert_allclose(got, want, rtol=1e-10, err_msg=f"{name}, {h} s")


def test_the_split_methods_keep_area_where_nothing_damps() -> None:
    for name in ("semi_implicit_euler", "verlet"):
        assert np.linalg.det(matrix(BY_NAME[name], bonded(b=0.0, d=0.0), 0.01)) == pytest.approx(1.0, abs=1e-13), name


@every_method
def test_halving_the_step_of_a_bonded_body_shows_the_order(method: IntegrationMethod) -> None:
    dt, touch = 0.02, bonded()
    exact = spring_damper(MassDamper(mass=0.5, damping=1.0), dt, k=2000.0, d=3.0, at=0.01)
    want = np.array(exact.move(exact.c, 0.02, 0.3, 4.0)[:2])

    def error(n: int) -> float:
        plant = stepped(method, touch._replace(at=0.01), dt, n)
        return float(np.abs(np.array(plant.move(plant.c, 0.02, 0.3, 4.0)[:2]) - want).max())

    assert np.log2(error(32) / error(64)) == pytest.approx(method.order, abs=0.25)


@every_method
def test_the_gripped_master_comes_to_the_exact_one(method: IntegrationMethod) -> None:
    body, dt = MassDamper(mass=0.1, damping=0.5), 0.01
    held = tuple(grip(body, 0.4, 200.0, 5.0, dt))
    scene = load_scene("canonical", dt=dt)
    assert exact_bodies(scene).master == (held,)
    at = (0.01, 0.2, 0.7, 0.011, 0.015)
    want = np.array(move_gripped(held, *at))
    errors = []
    for n in (8, 16):
        bodies = method_bodies(scene, method, n)
        errors.append(np.abs(np.array(bodies.instead["move_gripped"](bodies.master[0], *at)) - want).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(method.order, abs=0.3)


@pytest.mark.parametrize("name", ["backward_euler", "sdirk2", "radau"])
def test_l_stable_methods_are_calm_where_the_step_is_far_too_long(name: str) -> None:
    assert np.abs(np.linalg.eigvals(matrix(BY_NAME[name], bonded(k=1e12, d=0.0), 1e-3))).max() < 1e-2
    assert np.abs(np.linalg.eigvals(matrix(BY_NAME["euler"], bonded(k=1e12, d=0.0), 1e-3))).max() > 1e2


# At a wall

BODY = MassDamper(mass=0.5, damping=1.0)


def beside_wall(method: IntegrationMethod, n: int, dt: float, **wanted: float) -> tuple[Plant, Plant]:
    """The exact plant at a wall, and the method's."""
    knobs = {"k": 2e4, "d": 10.0, "at": 0.03, "side": 1.0} | wanted
    exact = wall(BODY, dt, **knobs)
    return exact, stepped(method, touch_of(exact, BODY), dt, n)


@every_method
@pytest.mark.parametrize(("x", "v"), [(0.0295, 0.4), (0.031, -0.5), (0.03001, -0.2), (0.032, 0.1)])
def test_through_making_and_losing_contact_every_method_comes_to_the_exact_step(
    method: IntegrationMethod, x: float, v: float
) -> None:
    def error(n: int) -> float:
        exact, plant = beside_wall(method, n, 4e-3)
        return abs(plant.move(plant.c, x, v, 1.5)[0] - exact.move(exact.c, x, v, 1.5)[0])

    assert error(4096) < 3e-7
    assert error(4096) < 0.1 * error(8) + 1e-15


@every_method
def test_the_other_side_is_the_mirror_image(method: IntegrationMethod) -> None:
    _, one = beside_wall(method, 3, 2e-3)
    _, other = beside_wall(method, 3, 2e-3, side=-1.0, at=-0.03)
    for x, v in ((0.0297, 0.3), (0.031, 0.1), (0.031, -2.0)):
        a, b, _ = one.move(one.c, x, v, 1.0)
        c, d, _ = other.move(other.c, -x, -v, -1.0)
        assert (a, b) == (-c, -d)
        assert one.force(one.c, x, v) == -other.force(other.c, -x, -v)


@pytest.mark.parametrize(("p", "u", "f"), [(-1e-4, 0.5, 1.0), (-5e-4, 0.6, 1.0), (1e-4, -0.2, 0.0), (2e-4, -0.4, 1.0)])
def test_radau_solves_its_two_stages_together_with_their_contact(p: float, u: float, f: float) -> None:
    """Butcher's tableau with the wall's force at both stages, from an independent root finder."""
    a = 1e-3 * np.array([[5 / 12, -1 / 12], [3 / 4, 1 / 4]])
    want = fsolve(lambda w: w - u - a @ ((f - w - np.maximum(2e4 * (p + a @ w), 0.0)) / 0.5), np.full(2, u), xtol=1e-13)
    _, plant = beside_wall(BY_NAME["radau"], 1, 1e-3, d=0.0, at=0.0)
    assert plant.move(plant.c, p, u, f)[:2] == pytest.approx((p + (a @ want)[1], want[1]), rel=1e-9)


# In a run


@every_method
def test_bodies_handed_in_are_those_that_move(method: IntegrationMethod) -> None:
    scene = load_scene("canonical", duration=0.4)
    exact = run(scene).trace

    def error(n: int) -> float:
        got = run(scene, bodies=method_bodies(scene, method, n)).trace
        return max(float(np.abs(got[name] - exact[name]).max()) for name in ("x_m", "x_s"))

    assert 1e-8 < error(1) < 0.02
    assert error(8) < 0.7 * error(1)


def test_a_master_that_nobody_holds_or_that_has_no_slave_is_moved_too() -> None:
    scene = replace(load_scene("canonical", duration=0.1), hand=None)
    bodies = method_bodies(scene, BY_NAME["euler"], 1)
    x, v, _ = bodies.instead["move_free"](bodies.master[0], 1.0, 2.0, -3.0)
    assert (x, v) == pytest.approx((1.0 + 2.0e-3, 2.0 + 1e-3 * (-3.0 - 0.5 * 2.0) / 0.1), rel=1e-13)
    assert bodies.instead["move_free"] is not move_free
    alone = load_scene("virtual_wall", duration=0.3)
    own = run(alone)
    errors = [np.abs(run(alone, bodies=method_bodies(alone, METHODS[0], n)).trace["x_m"] - own.trace["x_m"]).max()
              for n in (1, 16)]
    assert 1e-9 < errors[1] < 0.1 * errors[0]


def test_what_no_fixed_step_method_can_move_is_refused_before_the_run() -> None:
    def my_move(*state: float) -> tuple[float, float, int]:
        return state[1], state[2], 0

    odd = free_space(BODY, 1e-3)._replace(move=my_move)
    with pytest.raises(Refused, match=r"my_move, so no fixed-step method can; take walls"):
        touch_of(odd, BODY)
    with pytest.raises(Refused, match="not piecewise linear; take for example sdirk2"):
        run(load_scene("stick_slip"), bodies="radau:2")
    with pytest.raises(Refused, match=r"Radau IIA, two stages is not known .* take for example sdirk2"):
        method_bodies(scene("Hunt-Crossley"), METHODS[-1], 1)
    solid = replace(scene("a standard linear solid"), environment=Opaque())
    with pytest.raises(Refused, match=r"move_relaxing, so no fixed-step method can; take walls"):
        method_bodies(solid, METHODS[0], 1)


# By name, as `teleop run --bodies` takes them


SHORT = load_scene("hard_wall", duration=1.0)


def test_a_method_goes_by_the_name_that_precision_prints_and_by_a_beginning_that_no_other_has() -> None:
    for method in METHODS:
        assert bodies_of(SHORT, f"{method.name}:3").numbers() == method_bodies(SHORT, method, 3).numbers()
    for text in ("semi-implicit:2", "semi_implicit:2", "semi-implicit-euler:2", "semi:2"):
        assert bodies_of(SHORT, text).method == "semi_implicit_euler:2"


def test_exact_bodies_are_the_run_as_it_is_without_the_option() -> None:
    plain, exact, other, handed = (run(SHORT, bodies=each) for each in (None, "exact", "euler:1", exact_bodies(SHORT)))
    assert all(np.array_equal(plain.trace[name], handed.trace[name]) for name in plain.trace)
    assert exact.trace["x_s"].tobytes() == plain.trace["x_s"].tobytes() != other.trace["x_s"].tobytes()
    assert exact.summary() == plain.summary()
    assert "bodies" not in plain.summary()


@pytest.mark.parametrize(("text", "why"), [
    ("rk4", "sub-steps"), ("rk4:", "sub-steps"), ("rk4:0", "sub-steps"), ("rk4:-1", "sub-steps"),
    ("rk4:1e3", "sub-steps"), ("rk4:1000001", "sub-steps"), ("exact:2", "names no integrator"), (":4", "names no"),
    ("r:1", "names no integrator"), ("rk5:1", "did you mean rk4"),
])
def test_what_names_no_bodies_is_refused(text: str, why: str) -> None:
    with pytest.raises(Refused, match=why):
        bodies_of(SHORT, text)


# Bodies that are not piecewise linear, or that remember

KNOWN = [method for method in METHODS if goes(method)]
every_known = pytest.mark.parametrize("method", KNOWN, ids=lambda method: method.name)
RIDE = (HUNT_CROSSLEY, 0.5, 1.0, 1e6, 0.0, 1.5, 2.0, 0.0)  # pressed in by 1 mm it stays in contact
PATH = Sine(amplitude=5e-4, frequency=5.0)
HC = HuntCrossley(k=1e6, lam=1.0, at=1e-3)
RUBBING = MassDamper(mass=0.3, damping=1.0, friction=0.5)


def branch(k1: float = 3000.0) -> Branch:
    return Branch(0.5, 1.0, 2000.0, 1.0, k1 * 0.01, 0.01)


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
@pytest.mark.parametrize("d", [0.0, 10.0, 2000.0])  # with the last a stage ends on the surface itself
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


@pytest.mark.parametrize("kind", [NOTHING, WALL, BOND, HUNT_CROSSLEY])
def test_the_second_half_of_verlets_kick_solves_its_own_equation(kind: int) -> None:
    """`m (U - w)/tau + b U + g + friction = f`, friction of any size up to fc where the body is at rest."""
    dice, tau, stuck = np.random.default_rng(3), 1e-3, 0
    for _ in range(200):
        p, w, f = dice.uniform(-1e-3, 1e-3), -0.1 + dice.uniform(-0.01, 0.01), dice.uniform(-3.0, 3.0)
        core = (kind, 0.5, 1.0, 1e4, 10.0, 1.5, 3.0, dice.choice([0.0, 2.0]))
        u = kicked(core, p, w, tau, f, 0.1)
        left = f - 0.5 * (u - w) / tau - u - resistance_force(core, p, u)  # what friction must be
        if u == -0.1:
            stuck += 1
            assert abs(left) <= core[7] + 1e-9
        else:
            assert left == pytest.approx(core[7] if u > -0.1 else -core[7], abs=1e-7)
    assert 5 < stuck < 100


@every_known
def test_through_a_stop_every_method_comes_to_where_the_body_stops(method: IntegrationMethod) -> None:
    core, state = (NOTHING, 0.5, 1.0, 0.0, 0.0, 1.5, 0.0, 3.0), (0.0, 0.02, 1.0, 0.0)
    want = settle(core, *state, 0.01, "DOP853").p
    assert ADVANCE[method.name](core, *state, 0.01 / 4096, 4096)[0] == pytest.approx(want, abs=1e-7)


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


class Opaque:
    """A relaxing plant that does not say of what it is made."""

    inner = True

    def plant(self, body: MassDamper, dt: float) -> Any:
        return relaxing(body, dt, k=1.0, k1=2.0, tau=0.1)
