"""The guard around a law: what it lets through, its books, and a run that would otherwise give energy out."""

from __future__ import annotations

from dataclasses import replace
from inspect import getsource
from math import sqrt
from typing import Any

import numpy as np
import pytest

from teleop import PFRA, At, Direct, Refused, Wave, around, check_law, facts_of, load_scene, run
from teleop.checks.conformance import try_conformance
from teleop.checks.trials import try_claims
from teleop.laws.around import compose, guard
from teleop.laws.around.guard import Account, FromSlave, GuardWrapper, Work, let_through, master
from tests.engines.engines import one_lane_after_the_other

GUARD = GuardWrapper(k=5000.0, alpha=50.0, v_min=1e-3, drag=4.0)


def at(v: float, f_held: float = 0.0, dx: float = 0.0) -> At:
    return At(0.0, v, 0.0, f_held, dx, True, 1e-3, 1e-3, 1e-3)


def through(g: float, v: float, level: float, axes: float = 1.0, drag: float = 0.0) -> float:
    return let_through(GUARD, Account(level, 0.0, 0.0), at(v), Work(0.0, axes), g, drag)


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
    forces = [master(GUARD, Account(GUARD.E0, 0.0, 0.0), at(1.0), FromSlave(0.0, level), Work(0.0, 1.0), 0.0, ())[0]
              for level in (-1.0, 0.0, 0.025, 0.05, 1.0)]
    assert forces == [4.0, 4.0, 2.0, 0.0, 0.0]  # at 1 m/s, with the sign of the master


def test_an_end_pays_its_own_account_back_before_it_gives_the_other_end_any() -> None:
    law = around("guard(E0=0.1)", Direct())
    s, rx = law.master_start(At(0.0, 0.0, 0.0, 0.0, 0.0, False, float("inf"), 1e-3, 1e-3))
    told = []
    for f_held, dx in ((1.0, -0.03), (1.0, 0.02), (1.0, 0.05)):  # J: 0.03 out, 0.02 back in, 0.05 more in
        _, tx, s = law.master(s, at(0.0, f_held, dx), rx, law.master_sums(s, at(0.0, f_held, dx), rx))
        told.append((round(s.guard_H, 12), round(tx.guard_E, 12)))
    assert told == [(0.07, 0.0), (0.09, 0.0), (0.1, 0.04)]
    assert law.master_stored(s) == pytest.approx(0.14)


@pytest.mark.parametrize("scene", ["canonical", pytest.param("soft_tissue", marks=pytest.mark.full)])
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
    """Or less than the account has: of a law that sums over the axes too."""
    for law, E0 in (("wave", 0.05), ("pfra", 1e3)):
        alone, guarded = [run(load_scene("canonical", law=each, delay=0.05, duration=1.0)).trace
                          for each in (law, f"guard(E0={E0}, drag=0) | {law}")]
        assert all(np.array_equal(alone[name], guarded[name], equal_nan=True) for name in alone), law


def test_what_comes_out_claims_its_books_and_keeps_them_in_the_trials() -> None:
    guarded: Any = around("guard", Direct())
    assert dict(guarded.claims) == {"E_law": "any link"}
    try_conformance(guarded)
    try_claims(guarded)
    assert one_lane_after_the_other(load_scene("canonical", law=guarded)) == {"move_wall"}


@pytest.mark.full
@pytest.mark.parametrize(("stages", "law"), [
    *[("guard", law) for law in (Direct(), PFRA(alpha=0.5), Wave(), around("deadband(0.2)", Direct()))],
    ("deadband(0.3, floor=0.01) | guard", Direct())], ids=["direct", "pfra", "wave", "deadband in it", "in a deadband"])
def test_no_search_finds_a_case_in_which_it_breaks_them(stages: str, law: Any) -> None:
    check_law(around(stages, law), compiled=False)


MUTANTS = {  # a function of the guard, and what of its lines is wrong
    "what is given to the other end is kept as well": ("settle", "H - gives, s.E", "H, s.E"),
    "what was told is taken again at each tick": ("settle", "(seen - s.seen)", "seen"),
    "what is given out is not counted": ("settle", "over.w", "max(over.w, 0.0)"),
    "no force is held back": ("let_through", "    v, energy =", "    return g\n    v, energy ="),
    "an end that has none left drives on": ("let_through", "max(s.H, 0.0)", "(abs(s.H) + 0.01)"),
    "the slave counts work with the master's sign": ("SLAVE", "", ""),
}


@pytest.mark.parametrize("wrong", [
    pytest.param(wrong, marks=[pytest.mark.full] * (n % 2)) for n, wrong in enumerate(MUTANTS)])
def test_a_guard_that_is_wrong_is_caught_by_the_check_of_every_law(wrong: str, monkeypatch: pytest.MonkeyPatch) -> None:
    name, old, new = MUTANTS[wrong]
    if name == "SLAVE":
        mutant: Any = guard.SLAVE._replace(share=guard.MASTER.share)
    else:
        lines = getsource(getattr(guard, name))
        assert lines.count(old) == 1
        scope = dict(vars(guard))
        exec(lines.replace(old, new), scope)
        mutant = scope[name]
    monkeypatch.setattr(compose, "_MADE", {})
    monkeypatch.setattr(guard, name, mutant)
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
