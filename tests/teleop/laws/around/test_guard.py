"""The guard around a law: what it lets through, its books, and a run that would otherwise give energy out."""

from __future__ import annotations

from dataclasses import replace
from math import sqrt
from typing import Any

import numpy as np
import pytest

from teleop import check_law, load_scene, run
from teleop.errors import Refused
from teleop.law import At
from teleop.laws.around import compose
from teleop.laws.around.guard import GuardWrapper, let_through, master_damper
from teleop.laws.around.names import around
from teleop.laws.direct import Direct
from teleop.laws.pfra import PFRA
from teleop.laws.wave import Wave
from teleop.simulation.notes import facts_of
from teleop.sweeps.kernels.functions import unlike_python, without_lanes

NUMBERS: dict[str, float] = {"dt": 1e-3, "k": 5000.0, "alpha": 50.0, "v_min": 1e-3, "drag": 0.0}


def through(g: float, v: float, level: float, axes: float = 1.0, **others: float) -> float:
    return let_through(g, v, level, axes, **{**NUMBERS, **others})


def test_a_force_that_the_account_pays_for_is_let_through_to_the_bit() -> None:
    for g, v in ((3.3, 0.1), (-3.3, 0.1), (0.1, -0.7), (-0.0, 0.0), (7.0, 0.0)):
        assert str(through(g, v, 0.05)) == str(g)


def test_what_is_let_through_of_a_force_that_is_not_paid_for() -> None:
    assert through(100.0, 0.0, 0.05) == sqrt(2.0 * 5000.0 * 0.05)  # a spring of 5000 N/m with 0.05 J
    assert through(100.0, 0.0, 0.06, axes=3.0) == pytest.approx(sqrt(2.0 * 5000.0 * 0.02))
    assert through(5.0, 2.0, 0.004) == 0.004 / (1e-3 * 2.0)  # what it takes in a tick of 2 mm
    assert through(-5.0, -2.0, 0.004) == -0.004 / (1e-3 * 2.0)
    assert through(5.0, 0.1, 0.0) == 0.0
    assert through(-5.0, 0.1, 0.0) == -5.0  # 50 N s/m at 0.1 m/s is the most that brakes
    assert through(-50.0, 0.1, 0.0) == -5.0
    assert through(50.0, 0.0, -0.01) == 0.0
    assert through(0.0, 0.1, -1e-6) == pytest.approx(-1e-6 / (1e-3 * 0.01) * 0.1)  # takes back in a tick what it owes
    assert through(0.0, 0.1, -1.0) == -5.0
    assert through(0.0, 1e-6, -1.0) == pytest.approx(-5e-5)
    assert through(0.0, 0.1, 0.05, drag=3.0) == pytest.approx(-0.3)


def test_the_hand_is_asked_for_as_much_as_the_slave_has_not() -> None:
    assert [master_damper(4.0, level, 0.05) for level in (-1.0, 0.0, 0.025, 0.05, 1.0)] == [4.0, 4.0, 2.0, 0.0, 0.0]


def test_an_end_pays_its_own_account_back_before_it_gives_the_other_end_any() -> None:
    law = around("guard(E0=0.1)", Direct())
    s, rx = law.master_start(At(0.0, 0.0, 0.0, 0.0, 0.0, False, float("inf"), 1e-3, 1e-3))
    told = []
    for f_held, dx in ((1.0, -0.03), (1.0, 0.02), (1.0, 0.05)):  # J: 0.03 out, 0.02 back in, 0.05 more in
        at = At(0.0, 0.0, 0.0, f_held, dx, True, 1e-3, 1e-3, 1e-3)
        _, tx, s = law.master(s, at, rx, law.master_sums(s, at, rx))
        told.append((round(s.guard_H, 12), round(tx.guard_E, 12)))
    assert told == [(0.07, 0.0), (0.09, 0.0), (0.1, 0.04)]
    assert law.master_stored(s) == pytest.approx(0.14)


@pytest.mark.parametrize("scene", ["canonical", "soft_tissue"])
def test_direct_reflection_over_50_ms_becomes_a_bounded_run_that_gives_out_no_more_than_its_seed(scene: str) -> None:
    alone = load_scene(scene, law="direct", delay=0.05, duration=4.0)
    guarded = run(replace(load_scene(scene, law="guard() | direct", delay=0.05, duration=4.0), energy=True))
    trace = guarded.trace
    assert run(replace(alone, energy=True)).metrics["E_port_min"] < -5.0
    assert guarded.status == "ok"
    assert guarded.metrics["E_port_min"] > -2.0 * 0.05 - 1e-5
    assert abs(trace["x_s"]).max() < 0.06
    assert trace["E_law"].min() > -1e-5
    assert abs(trace["E_law"] - 0.1 - trace["E_port"]).max() < 1e-12
    assert {"guard_H_m", "guard_H_s"} <= set(trace)


def test_a_slave_starves_unless_the_hand_is_asked_for_what_it_needs() -> None:
    asks, does_not = [run(load_scene("canonical", law=f"guard(drag={drag}) | direct", delay=0.05, duration=3.0)).metrics
                      for drag in (5.0, 0.0)]
    assert asks["x_err_rms"] < 0.3 * does_not["x_err_rms"]


def test_a_law_that_gives_out_nothing_is_the_law_to_the_bit() -> None:
    knobs = {"delay": 0.05, "duration": 1.0}
    alone, guarded = [run(load_scene("canonical", law=law, **knobs)).trace for law in ("wave", "guard(drag=0) | wave")]
    assert all(np.array_equal(alone[name], guarded[name], equal_nan=True) for name in alone)


@pytest.mark.parametrize("law", [Direct(), PFRA(alpha=0.5), Wave(), around("deadband(0.2)", Direct())],
                         ids=["direct", "pfra", "wave", "deadband | direct"])
def test_what_comes_out_claims_its_books_and_keeps_them(law: Any) -> None:
    guarded = around("guard", law)
    assert dict(guarded.claims) == {"E_law": "any link"}
    check_law(guarded, compiled=False)
    for end in (type(guarded).master, type(guarded).slave, type(guarded).master_sums, type(guarded).slave_sums):
        assert without_lanes(end) is None
        assert unlike_python(end) is None


def test_a_deadband_around_a_guard_keeps_its_books() -> None:
    check_law(around("deadband(0.3, floor=0.01) | guard", Direct()), compiled=False)


MUTANTS = {
    "what is given to the other end is kept as well": ("guard_H = guard_H - guard_gives", "guard_H = guard_H + 0.0"),
    "what was told is taken again at each tick": ("guard_seen - s.guard_seen", "guard_seen"),
    "what is given out is not counted": ("over.guard_w", "max(over.guard_w, 0.0)"),
    "no force is held back": ("f = let_through(", "f = (lambda g, *_: g)("),
    "an end that has none left drives on": ("at.v, guard_H, over", "at.v, abs(guard_H) + 0.01, over"),
    "the slave counts work with the master's sign": ("-at.f_held", "at.f_held"),
}


@pytest.mark.parametrize("wrong", MUTANTS)
def test_a_guard_that_is_wrong_is_caught_by_the_check_of_every_law(wrong: str, monkeypatch: pytest.MonkeyPatch) -> None:
    old, new = MUTANTS[wrong]
    right = GuardWrapper.lines

    def lines(end: Any) -> Any:
        made = right(end)
        return made._replace(after=tuple([line.replace(old, new) for line in made.after]),
                             sums={name: share.replace(old, new) for name, share in made.sums.items()})

    monkeypatch.setattr(compose, "_MADE", {})
    monkeypatch.setattr(GuardWrapper, "lines", staticmethod(lines))
    with pytest.raises(Refused, match="E_law"):
        check_law(around("guard", Direct()))


def test_a_guard_says_which_end_is_too_light_for_its_damper() -> None:
    facts = facts_of(load_scene("canonical", law="guard | direct"))
    law = around(f"guard(alpha={1.01 * facts.mass_m / facts.dt})", Direct())
    said = [each for each in law.conditions(facts) if "damper of the guard" in each]
    assert len(said) == 1
    assert "at the master" in said[0]
    assert f"--set law.guard_alpha={facts.mass_m / facts.dt:.4g} is the most" in said[0]
    assert not around("guard", Direct()).conditions(facts)
