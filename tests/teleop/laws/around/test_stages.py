"""Stages around a law: the deadband, the guard and the virtual coupling, and their text wherever a law is named."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from math import pi, sin, sqrt
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pytest

from teleop import PFRA, TDPA, At, Direct, PDamped, Refused, Wave, around, check_law, facts_of, load_scene, run, sweep
from teleop.analysis.models.linear import linear_scene
from teleop.checks.conformance import try_conformance
from teleop.checks.trials import try_claims
from teleop.law import law_name, reads
from teleop.laws.around import compose, guard
from teleop.laws.around.compose import StageEnd
from teleop.laws.around.deadband import FIELDS, DeadbandWrapper, HeldSample, HeldWave, asks, hold, hold_wave, wave_asks
from teleop.laws.around.guard import Account, FromSlave, GuardWrapper, Work, let_through
from teleop.laws.around.names import STAGES
from teleop.laws.wave import Back
from teleop.protocol.manifest import manifest_difference, manifest_of
from teleop.scene.library import ROOT
from teleop.scene.loading import asks_for_trust
from teleop.simulation.ending import scene_arguments as as_typed
from teleop.simulation.prepared import prepare
from teleop.simulation.result import parameters
from teleop.sweeps.kernels.c_kernel import Form, library_name
from tests.engines.engines import one_lane_after_the_other
from tests.fakes import law_of
from tests.programs import compiler_of
from tests.teleop.conftest import Answer

LAWS = pytest.mark.parametrize("law", [Wave(), *[pytest.param(law, marks=pytest.mark.full) for law in (
    Direct(), PFRA(alpha=0.3))]], ids=lambda law: type(law).__name__)


def moving(x: float, v: float, *, dt: float = 1e-3, span: float = 1e-3) -> At:
    return At(x, v, 0.0, 0.0, 0.0, True, 1e-3, dt, span)


def test_a_sine_sends_as_many_of_a_thousand_samples_as_weber_says() -> None:
    law = around("deadband(0.1, floor=1e-3)", Direct(K=0.0))
    for hertz, sent in ((1, 129), (2, 207), (5, 369)):  # counted by the rule
        q = [sin(2.0 * pi * hertz * k / 1000.0) for k in range(1000)]
        s, rx = law.master_start(moving(0.0, 0.0))
        heard = []
        for each in q:
            _, tx, s = law.master(s, moving(each, 0.0), rx)
            heard.append(tx.x)
        assert s.deadband_sent == sent + 1  # the first message, of which the other end knows nothing
        assert all(abs(a - b) <= max(0.1 * abs(b), 1e-3) for a, b in zip(q, heard, strict=True))


def test_a_message_that_is_not_sent_has_the_values_of_the_last_one() -> None:
    law = around("deadband(0.1)", Direct())
    s, rx = law.master_start(moving(0.0, 0.0))
    _, first, s = law.master(s, moving(1.0, 2.0), rx)
    _, second, s = law.master(s, moving(1.05, 2.1), rx)
    _, third, s = law.master(s, moving(1.05, 2.3), rx)  # the velocity has moved: sent with its position
    assert (first, second, third) == ((1.0, 2.0), (1.0, 2.0), (1.05, 2.3))
    assert s.deadband_sent == 2.0


@pytest.mark.parametrize("law", [Wave(), TDPA(), Direct(), PFRA(alpha=0.3)], ids=lambda law: type(law).__name__)
def test_with_k_zero_it_is_the_law_to_the_bit(law: Any) -> None:
    scene = replace(load_scene("canonical", delay=0.02, duration=0.6), energy=True)
    alone, within_it = [run(replace(scene, law=each)).trace for each in (law, around("deadband(0.0, floor=0.5)", law))]
    assert "E_law" in within_it or type(law) is not TDPA
    assert all(np.array_equal(alone[name], within_it[name], equal_nan=True) for name in alone)


@LAWS
def test_a_law_in_a_deadband_keeps_what_it_claims(law: Any) -> None:
    composed = around("deadband(0.3, floor=0.05)", law)
    check_law(composed, compiled=False)
    assert ("E_link" in composed.claims) == ("E_link" in law.claims)


def test_a_deadband_that_holds_waves_as_it_holds_samples_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    def hold_as_sample(s: HeldWave, at: At, is_sent: float, q: float) -> tuple[float, HeldWave]:
        last = hold(HeldSample(s.last), at, is_sent, q)[0]
        return last, HeldWave(last, 0.0, 0.0)

    monkeypatch.setattr(compose, "_MADE", {})
    monkeypatch.setitem(FIELDS, "wave", {**FIELDS["wave"], "ask": asks, "hold_field": hold_as_sample})
    with pytest.raises(ValueError, match="more than the waves brought"):
        check_law(around("deadband(0.3, floor=0.05)", Wave()))


def test_waves_that_are_sent_never_have_more_energy_than_those_there_were() -> None:
    law = around("deadband(0.4, floor=0.2)", Wave())
    s, _ = law.master_start(moving(0.0, 0.0))
    there = sent = 0.0
    rng = np.random.default_rng(3)
    v, held, u_before, tx_before = 0.0, 0, 0.0, 0.0
    for k in range(4000):
        v += 0.02 * rng.standard_normal() - 0.01 * v
        left_out = 5 * (k % 50 == 17)
        _, tx, after = law.master(s, moving(0.0, v, span=1e-3 * (1 + left_out)), Back(0.0))
        u = (2.0 * law.b) ** 0.5 * v
        there += 1e-3 * (0.5 * u * u + left_out * 0.5 * u_before * u_before)
        sent += 1e-3 * (0.5 * tx.u * tx.u + left_out * 0.5 * tx_before * tx_before)
        assert sent <= there + 1e-12 or left_out  # while ticks are left out the last wave goes on: paid at once
        held += after.deadband_sent == s.deadband_sent
        s, u_before, tx_before = after, u, tx.u
    assert sent <= there + 1e-12
    assert held > 1000


def test_numbers_that_are_none_are_sent_and_not_kept() -> None:
    nan, deadband, rest = float("nan"), DeadbandWrapper(0.1, 1e-3), moving(0.0, 0.0)
    assert asks(deadband, HeldSample(0.0), rest, nan) == 1.0
    assert asks(deadband, HeldSample(nan), rest, 1.0) == 1.0
    assert str(hold(HeldSample(5.0), rest, 1.0, -0.0)[0]) == "-0.0"
    assert hold(HeldSample(5.0), rest, 0.0, 3.0)[0] == 5.0
    deadband = DeadbandWrapper(1.0, 1e-3)  # none of these waves has moved
    assert wave_asks(deadband, HeldWave(2.0, 0.0, 0.0), rest, 1.0) == 1.0
    assert wave_asks(deadband, HeldWave(2.0, 1.5e-3, 0.0), rest, 1.0) == 0.0
    assert hold_wave(HeldWave(0.0, -1e-3, 0.0), rest, 1.0, 2.0)[0] == pytest.approx(2.0**0.5)


GUARD = GuardWrapper(k=5000.0, alpha=50.0, v_min=1e-3, drag=4.0)


def at_speed(v: float, f_held: float = 0.0, dx: float = 0.0) -> At:
    return At(0.0, v, 0.0, f_held, dx, True, 1e-3, 1e-3, 1e-3)


def through(g: float, v: float, level: float, axes: float = 1.0, drag: float = 0.0) -> float:
    return let_through(GUARD, Account(level, 0.0, 0.0), at_speed(v), Work(0.0, axes), g, drag)


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
    forces = [guard.master(GUARD, Account(GUARD.E0, 0.0, 0.0), at_speed(1.0), FromSlave(0.0, level), Work(0.0, 1.0),
                           0.0, ())[0] for level in (-1.0, 0.0, 0.025, 0.05, 1.0)]
    assert forces == [4.0, 4.0, 2.0, 0.0, 0.0]  # at 1 m/s, with the sign of the master


def test_an_end_pays_its_own_account_back_before_it_gives_the_other_end_any() -> None:
    law = around("guard(E0=0.1)", Direct())
    s, rx = law.master_start(At(0.0, 0.0, 0.0, 0.0, 0.0, False, float("inf"), 1e-3, 1e-3))
    told = []
    for f_held, dx in ((1.0, -0.03), (1.0, 0.02), (1.0, 0.05)):  # J: 0.03 out, 0.02 back in, 0.05 more in
        _, tx, s = law.master(s, at_speed(0.0, f_held, dx), rx, law.master_sums(s, at_speed(0.0, f_held, dx), rx))
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


def test_a_guarded_law_claims_its_books_and_keeps_them_in_the_trials() -> None:
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


def test_a_guard_says_which_end_is_too_light_for_its_damper() -> None:
    facts = facts_of(load_scene("canonical", law="guard | direct"))
    law = around(f"guard(alpha={1.01 * facts.mass_m / facts.dt})", Direct())
    said = [each for each in law.conditions(facts) if "damper of the guard" in each]
    assert len(said) == 1
    assert "at the master" in said[0]
    assert f"--set law.guard_alpha={facts.mass_m / facts.dt:.4g} is the most" in said[0]
    assert not around("guard", Direct()).conditions(facts)


WAVES = {0.0: 3.9736, 0.05: 0.936037}  # N, pressed for ever by hard_wall: without a coupling, see test_touch


@pytest.mark.full
@pytest.mark.parametrize(("stages", "law"), [
    (stages, law) for stages in ("virtual_coupling", "guard | virtual_coupling")
    for law in (Wave(), Direct(), PFRA(), TDPA())])
def test_a_virtual_coupling_stands_around_every_kind_of_law(stages: str, law: Any) -> None:
    check_law(around(stages, law), compiled=False)


@pytest.mark.full
@pytest.mark.parametrize(("delay", "K"), [(0.0, 400.0), (0.05, 100.0)])
def test_pressed_for_ever_a_coupling_is_a_spring_in_series(delay: float, K: float) -> None:
    """f = way/(sum of all that gives way), so the coupling adds 1/K to what the waves alone leave of 30 mm."""
    law = around(f"virtual_coupling(K={K}, B=2.0)", Wave())
    result = run(load_scene("hard_wall", law=law, delay=delay, duration=20.0))
    assert result.metrics["f_m_end"] == pytest.approx(0.03 / (0.03 / WAVES[delay] + 1.0 / K), rel=1e-3)


def test_a_stiff_coupling_to_a_heavy_tool_is_a_heavier_device() -> None:
    """With the tool's mass of 1 kg and K = 10 kN/m, the felt mass in free motion is that of the waves and 1 kg more."""
    free = load_scene("free_motion", delay=0.0)
    alone = run(replace(free, law=Wave())).metrics["felt_mass"]
    law = around("virtual_coupling(K=1e4, B=5.0, mass=1.0, damping=0.0)", Wave())
    assert run(replace(free, law=law)).metrics["felt_mass"] == pytest.approx(alone + 1.0, rel=0.02)


def test_a_device_that_is_let_go_takes_the_tool_with_it() -> None:
    """Otherwise the coupling would be stretched by all that the hand moves meanwhile."""
    law = around("virtual_coupling(K=400.0)", Direct())
    s, rx = law.master_start(At(0.0, 0.0, 0.0, 0.0, 0.0, False, 1.0, 1e-3, 1e-3))
    for k in range(1, 301):
        at = At(1e-3 * k, 1.0, 0.0, 0.0, 1e-3, False, 1.0, 1e-3, 1e-3, 0.0)
        f_m, _, s = law.master(s, at, rx)
    assert abs(f_m) < 1.0
    assert s.virtual_coupling_y == pytest.approx(0.3, abs=2e-3)


def test_what_a_law_sums_over_the_axes_is_of_the_tool() -> None:
    law, at = around("virtual_coupling", TDPA()), At(2e-3, 0.5, 0.0, 3.0, 2e-3, True, 0.0, 1e-3, 1e-3)
    s, rx = law.master_start(at._replace(x=0.0, v=0.0))
    over = law.master_sums(s, at, rx)
    assert over.w == 0.0  # on which nothing was held yet, as 3 N were on the device
    assert over.vv == law.master(s, at, rx, over)[2].virtual_coupling_u ** 2


def test_what_the_device_has_to_have_is_told() -> None:
    scene = load_scene("hard_wall")
    own = scene.master.damping
    for law, said in ((around("virtual_coupling(K=2000.0, B=0.0)", Direct()), "law.virtual_coupling_K=1000"),
                      (around("virtual_coupling(K=400.0, B=1.0)", Direct()), "law.virtual_coupling_B=0.3 is the most")):
        told = law.conditions(facts_of(replace(scene, law=law)))
        assert own == 0.5
        assert [said in one for one in told] == [True]
    assert around("virtual_coupling", Direct()).conditions(facts_of(scene)) == ()


def test_the_law_around_which_it_stands_has_the_tool_for_a_master() -> None:
    """P+d is as well damped as the tool is."""
    alone = PDamped(K=400.0, B=15.0)
    facts = facts_of(load_scene("hard_wall", law=alone, delay=0.05))
    assert len(alone.conditions(facts)) == 1
    assert around("virtual_coupling(damping=0.5)", alone).conditions(facts) == alone.conditions(facts)
    assert around("virtual_coupling(damping=30.0)", alone).conditions(facts) == ()


def test_a_coupling_is_linear_as_its_law_is_and_its_lines_run_over_all_lanes_at_once() -> None:
    scene = replace(load_scene("soft_tissue", law=around("virtual_coupling", Direct())), cap=None, watchdog=None)
    assert type(scene.law.linear()) is type(scene.law)
    linear_scene(scene)
    of = load_scene("canonical", law=around("virtual_coupling", Wave()))
    assert one_lane_after_the_other(of) == {"move_wall"}


def test_the_one_port_law_of_this_name_is_still_that() -> None:
    assert load_scene("virtual_coupling", law="virtual_coupling(K=500)").law.K == 500.0
    with pytest.raises(Refused, match="stands around a law with two ends"):
        load_scene("hard_wall", law="guard | virtual_coupling")


Typed = Callable[..., Answer]
MINE = (ROOT / "scenarios" / "examples" / "law.py").read_text()


def test_a_text_names_stages_and_law_with_their_numbers_which_are_knobs_beside_each_other_of_one_class() -> None:
    assert load_scene("canonical", law="deadband(0.2, floor=1e-4) | wave(b=3)").law == around(
        "deadband(k=0.2, floor=1e-4)", Wave(b=3.0))
    assert load_scene("canonical", law="deadband|wave").law == around("deadband()", Wave())
    assert load_scene("canonical", law="wave(b=3.0)").law == Wave(b=3.0)
    law = load_scene("canonical", **{"law": "deadband(0.2) | wave(b=3.0)", "law.b": 4.0, "law.deadband_k": 0.3}).law
    assert (law.b, law.deadband_k, law.deadband_floor) == (4.0, 0.3, 1e-3)
    assert [field.name for field in fields(law)] == ["b", "K", "B", "deadband_k", "deadband_floor"]
    assert type(law) is type(around("deadband(0.1)", Wave()))
    assert law_name(law) == "deadband | wave"


def test_a_law_with_a_name_of_the_stage_is_told_so() -> None:
    mine = law_of(name="Mine", knobs=[("deadband_k", float, 1.0)])()
    with pytest.raises(Refused, match="has a field deadband_k, which is one of the stage"):
        around("deadband", mine)


class Commanded(NamedTuple):
    force: float


@dataclass(frozen=True)
class Softer:
    """A share of the law's force reaches the device."""

    share: float = 0.5

    name: ClassVar[str] = "softer"
    shows: ClassVar[tuple[str, ...]] = ("softer_force",)
    begun: ClassVar[Any] = Commanded(0.0)

    @classmethod
    def end(cls, _name: str, _sends: Any) -> Any:
        return StageEnd(lambda _, _at: (Softer.begun, ()), lambda softer, _s, _at, _rx, _over, f, tx: (
            softer.share * f, tx, (), Commanded(f)))

    @classmethod
    def claims_of(cls, _claims: Any) -> Any:
        return {}


def test_a_stage_of_ones_own_runs_in_every_engine_to_the_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    compiler_of("vector")
    monkeypatch.setitem(STAGES, "softer", f"{__name__}:Softer")
    axes = {"law.softer_share": [0.5, 1.0], "law.guard_k": [5000.0, 1.0]}
    fixed = {"law": "guard | softer | direct", "duration": 0.3, "energy": False}
    plain, *compiled = [sweep("free_motion", axes, fixed=fixed, engine=engine, metrics=["x_err_rms"])["x_err_rms"]
                        for engine in ("plain", "vector")]
    assert len(set(plain)) == 4
    assert all(np.array_equal(plain, each) for each in compiled)
    alone, whole = [run(load_scene("free_motion", law=law, duration=0.3)).trace
                    for law in (Direct(), compose.compose(Softer(share=1.0), Direct()))]
    assert all(np.array_equal(alone[name], whole[name], equal_nan=True) for name in alone)
    assert np.array_equal(whole["softer_force_m"], whole["f_m"])


def test_a_law_is_read_through_several_stages_its_rows_share_a_kernel_and_an_analysis_takes_the_law_inside() -> None:
    law = type(around("guard | deadband", PFRA()))
    assert reads(law.master) == reads(PFRA.master) | {"v", "dt"}
    assert reads(law.master_sums) == reads(PFRA.master_sums) | {"f_held", "dx"}
    scenes = [load_scene("free_motion", law=f"deadband({k}) | pfra", duration=0.3) for k in (0.1, 0.2)]
    assert len({library_name(scene, prepare(scene).bodies, ("x_err_rms",), Form(4), "cc") for scene in scenes}) == 1
    law = around("deadband(0.1) | guard", Wave(b=3.0))
    assert law.linear() == Wave(b=3.0)


def test_a_stage_whose_record_has_a_name_of_at_is_told_so(monkeypatch: pytest.MonkeyPatch) -> None:
    class Force(NamedTuple):
        f: float

    monkeypatch.setattr(Softer, "begun", Force(0.0))
    with pytest.raises(Refused, match="the stage softer has a record with the field f, a name of At"):
        compose.compose(Softer(), Wave(b=1.0))


def test_a_composed_law_goes_to_another_process() -> None:
    law = around("deadband(0.2)", Wave(b=3.0))
    assert pickle.loads(pickle.dumps(law)) == law
    told = subprocess.run([sys.executable, "-c", "import pickle, sys; print(pickle.load(sys.stdin.buffer))"],
                          input=pickle.dumps(law), capture_output=True, check=True, cwd=ROOT)
    assert told.stdout.decode().strip() == repr(law)


def test_a_grid_and_a_summary_name_it_and_a_command_repeats_it(typed: Typed, tmp_path: Path) -> None:
    answer = typed("sweep", "canonical", "--set", "duration=0.1", "--grid",
                   "law=deadband(k=0.1,floor=1e-3) | wave,wave delay=0:0.05:2", "--out", str(tmp_path / "s"))
    assert answer.code == 0
    scene = load_scene("canonical", law="deadband(0.2) | wave(b=3.0)", duration=0.1)
    told = parameters(scene)["law"]
    assert told == {"name": "deadband | wave", "b": 3.0, "K": 500.0, "B": 20.0, "deadband_k": 0.2,
                    "deadband_floor": 1e-3}
    again = {f"law.{key}": value for key, value in told.items() if key != "name"}
    assert load_scene("canonical", law=told["name"], **again).law == scene.law
    assert as_typed(scene) == ("canonical --set law='deadband | wave' --set law.b=3.0 --set law.deadband_k=0.2 "
                            "--set duration=0.1")


def test_the_list_has_the_knobs_of_a_stage_and_of_a_law_with_it(typed: Typed) -> None:
    found = json.loads(typed("list", "deadband(0.2) | wave", "--json").out)["found"][0]
    assert [knob["name"] for knob in found["knobs"]] == ["b", "K", "B", "deadband_k", "deadband_floor"]
    assert "deadband_floor" in typed("list", "deadband").out
    assert "deadband" in typed("list", "around").out


def test_a_law_of_a_file_has_stages_too_and_is_told_apart_by_its_file(tmp_path: Path) -> None:
    file = tmp_path / "law_mine.py"
    file.write_text(MINE)
    text = f"deadband(0.1) | {file}"
    scene = load_scene("canonical", law=text, duration=0.2)
    assert run(scene).status == "ok"
    before = manifest_of(scene)
    assert Path(str(parameters(scene)["law"]["file"])).name == "law_mine.py"
    file.write_text(MINE + "\nEDITED = True\n")
    os.utime(file, ns=(1, 1))
    after = manifest_of(load_scene("canonical", law=text, duration=0.2))
    assert "law source" in str(manifest_difference(before, after))


def test_a_stored_text_that_names_a_file_is_not_run_without_trust() -> None:
    for text in ("deadband(0.1) | {}", "{}(K=3.0)", "deadband(0.1) | {}:SmoothReflection(K=3.0)", "deadband(0.1 | {}"):
        assert asks_for_trust("canonical", {"law": text.format("law_mine.py")}), text


def test_a_mistake_of_the_law_inside_is_told_with_its_own_line(tmp_path: Path) -> None:
    file = tmp_path / "law_wrong.py"
    line = "return self.K * (rx.x - at.x)"
    assert line in MINE
    file.write_text(MINE.replace(line, "return 1.0 / (rx.x < 0.02) + self.K * (rx.x - at.x)"))
    with pytest.raises(Refused, match=r"SmoothReflection.slave \(.*law_wrong.py:\d+\) raised ZeroDivisionError"):
        run(load_scene("canonical", law=f"deadband(0.1) | {file}", duration=0.2))
