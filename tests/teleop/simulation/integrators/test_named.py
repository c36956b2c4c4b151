"""Bodies by name, as `teleop run --bodies` takes them."""

from __future__ import annotations

import pytest

from teleop import load_scene, run
from teleop.errors import Refused
from teleop.simulation.integrators.methods import METHODS, IntegrationMethod
from teleop.simulation.integrators.stepped import bodies_of, method_bodies

SHORT = load_scene("hard_wall", duration=1.0)


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)
def test_every_method_goes_by_the_name_that_precision_prints(method: IntegrationMethod) -> None:
    assert bodies_of(SHORT, f"{method.name}:3").numbers() == method_bodies(SHORT, method, 3).numbers()


@pytest.mark.parametrize("text", ["semi-implicit:2", "semi_implicit:2", "semi-implicit-euler:2", "semi:2"])
def test_a_beginning_that_no_other_method_has_is_enough(text: str) -> None:
    assert bodies_of(SHORT, text).method == "semi_implicit_euler:2"


def test_exact_bodies_are_the_run_as_it_is_without_the_option() -> None:
    plain, exact, other = (run(SHORT, bodies=bodies) for bodies in (None, "exact", "euler:1"))
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


def test_a_method_without_a_solver_for_friction_is_refused_before_the_run() -> None:
    with pytest.raises(Refused, match="not piecewise linear; take for example sdirk2"):
        run(load_scene("stick_slip"), bodies="radau:2")
