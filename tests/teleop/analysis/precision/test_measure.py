"""Error against run time: the reference proves itself, every contender is measured, and nothing is dropped."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import teleop.analysis.precision.measure
from channel.delay import Delay
from master.hand import Grip, Rest
from slave import Tissue, Wall
from teleop import Direct, MassDamper, Refused, Scene, load_scene, run
from teleop.analysis.precision.contenders import Contender, outsider_bodies
from teleop.analysis.precision.measure import Entry, Precision, contenders, measure, verdicts
from teleop.analysis.precision.reference.deviation import NEAR, Error, contacts, missed, touching
from teleop.analysis.precision.reference.digits import run_in_digits
from teleop.analysis.precision.report import summary, table
from teleop.simulation.bodies import Bodies
from teleop.simulation.integrators.methods import METHODS
from teleop.simulation.integrators.stepped import method_bodies
from teleop.terminal.table import si

Typed = Callable[..., Any]
BY_NAME = {method.name: method for method in METHODS}


def strike(**other: Any) -> Scene:
    """A slave that is drawn into a wall within some ticks, and bounces there."""
    return Scene(**{
        "law": Direct(K=500.0, B=5.0, kf=0.05), "master": MassDamper(mass=0.1, damping=0.5),
        "slave": MassDamper(mass=0.3, damping=1.0), "start_m": 0.02,
        "hand": Grip(mass=0.4, k=300.0, d=5.0, reference=Rest(at=0.02)), "link": Delay(2e-3),
        "environment": Wall(k=1e5, d=5.0, at=1e-3), "duration": 0.08, **other,
    })


def same(one: Any, other: Any) -> bool:
    return all(np.array_equal(one.trace[name], other.trace[name]) for name in one.trace)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """One tolerance of scipy's solvers, which take longest."""
    monkeypatch.setattr(teleop.analysis.precision.measure, "TOLERANCES", (1e-6,))


@pytest.fixture(scope="module")
def struck() -> Precision:
    """A comparison on a stiff wall, timed by a clock that ticks a microsecond whenever it is read."""
    return measure(strike(), clock=count(0, 1000).__next__, rounds=2)


def by_key(got: Precision) -> dict[str, Entry]:
    return {entry.key: entry for entry in got.entries}


class TestTheReference:
    @pytest.mark.parametrize(("name", "knobs"), [
        ("canonical", {"k_e": 1e9, "d_e": 100.0}), *(pytest.param(*each, marks=pytest.mark.full) for each in (
            ("canonical", {}), ("canonical", {"k_e": 1e6, "d_e": 0.0}), ("canonical", {"k_e": 1e8}),
            ("canonical", {"k_e": 1e3, "d_e": 100.0}), ("hard_wall", {"k_e": 1e6, "duration": 2.0}),
            ("soft_tissue", {}), ("free_motion", {}))),
    ])
    def test_one_exact_step_is_that_of_40_digits_at_every_tick(self, name: str, knobs: dict[str, float]) -> None:
        scene = load_scene(name, **{"duration": 0.7, **knobs})
        _, _, steps = run_in_digits(scene, 0)
        assert steps.count == 2 * scene.ticks
        assert (steps.gave_up, steps.integrated) == (0, 0)
        assert steps.x < 1e-15
        assert steps.v < 1e-11
        walled = isinstance(scene.environment, Wall)
        assert (steps.changes > 0) == walled  # or it would compare smooth motion only

    @pytest.mark.full
    def test_an_error_that_may_be_the_references_own_is_shown_as_a_bound(self, struck: Precision) -> None:
        truth = replace(struck.truth, off={name: 10.0 * error.max for name, error in struck.entries[0].errors.items()})
        coarse = replace(struck, truth=truth)
        exact, other = (next(line for line in table(coarse).splitlines() if line.startswith(f"{key} "))
                        for key in ("exact", "euler/1"))
        assert exact.count("<= ") == 5
        assert "<=" not in other
        resolved = {m["name"]: m["errors"]["x_s"]["resolved"] for m in summary(coarse)["methods"]}
        assert (resolved["exact"], resolved["euler/1"]) == (False, True)

    def test_how_good_it_is_is_said_in_the_table_and_in_json(self, struck: Precision) -> None:
        off = struck.truth.off
        assert f"by at most {si(off['x_s'], 'm')}, {si(off['f_env'], 'N')}" in table(struck)
        assert summary(struck)["reference"]["off_by"] == off
        assert f"all {2 * 80} steps of the run" in table(struck)

    def test_without_scipy_the_rest_is_measured(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(teleop.analysis.precision.measure, "there", lambda: False)
        got = measure(strike(duration=0.02), clock=count(0, 1000).__next__, rounds=1)
        assert got.truth.method == "40 digits"
        assert all(e.contender.rtol is None for e in got.entries)
        assert len(got.entries) == 37


class TestContacts:
    def test_a_bounce_within_one_tick_is_followed_and_felt_though_no_tick_sees_a_force(self) -> None:
        scene = strike(environment=Wall(k=1e9, d=0.0, at=1.0005e-3))
        trace = run(scene).trace
        felt_at = touching(scene, trace)
        unseen = felt_at & (trace["f_env"] == 0.0)
        _, _, steps = run_in_digits(scene, 0)
        assert steps.changes >= (unseen[:-1] & (trace["f_env"][1:] == 0.0)).sum() > 0
        turned = np.flatnonzero((trace["v_s"][:-1] > 0.0) & (trace["v_s"][1:] < -0.5 * trace["v_s"][:-1]))
        assert len(turned)
        assert felt_at[turned].all()

    def test_in_free_space_nobody_feels_anything(self) -> None:
        for method in METHODS:
            for damping in (0.0, 20.0):
                scene = strike(environment=None, slave=MassDamper(mass=0.3, damping=damping), duration=0.03)
                trace = run(scene, bodies=method_bodies(scene, method, 4)).trace
                assert not touching(scene, trace).any(), (method.name, damping)

    def test_contacts_near_each_other_are_one_and_one_that_was_not_felt_is_missed(self) -> None:
        touching = np.zeros(200, dtype=bool)
        touching[[20, 21, 21 + NEAR, 100, 150]] = True
        touches = contacts(touching)
        assert touches == [(20, 21 + NEAR), (100, 100), (150, 150)]
        other = np.zeros(200, dtype=bool)
        other[[25, 100 + NEAR]] = True
        assert missed(other, touches) == 1
        assert missed(other[:120], touches) == 0  # it did not live to see the last one
        assert contacts(np.zeros(5, dtype=bool)) == []


class TestAComparison:
    def test_all_contenders_are_there_the_exact_one_first(self, struck: Precision) -> None:
        keys = [entry.key for entry in struck.entries]
        assert keys[0] == "exact"
        assert set(keys) == {"exact"} | {f"{m.name}/{n}" for m in METHODS for n in (1, 4, 16, 64)} | {
            f"{solver}/{rtol}" for solver in ("DOP853", "LSODA", "Radau") for rtol in ("1e-03", "1e-06", "1e-09")
        }
        assert struck.left_out == {}
        assert {e.runs for e in struck.entries if e.contender.rtol is None} == {2}
        assert {e.ns_per_tick for e in struck.entries} == {1000.0 / 80}, "by the clock that is given"

    def test_errors_are_the_distance_from_the_exact_run(self, struck: Precision) -> None:
        scene = struck.scene
        want = run(scene).trace
        for key in ("euler/1", "sdirk2/4", "LSODA/1e-06"):
            method, step = key.split("/")
            bodies = outsider_bodies(scene, method, float(step)) if method == "LSODA" else (
                method_bodies(scene, BY_NAME[method], int(step)))
            got, entry = run(scene, bodies=bodies).trace, by_key(struck)[key]
            for name in ("x_s", "x_m", "f_env"):
                off = np.abs(got[name] - want[name])
                assert entry.errors[name] == pytest.approx((off.max(), np.sqrt(np.mean(off**2)), off[-1]), rel=1e-12)
            assert entry.peak_ratio == pytest.approx(got["f_env"].max() / want["f_env"].max())

    def test_finer_is_more_accurate_and_nobody_comes_near_exact(self, struck: Precision) -> None:
        entries = by_key(struck)
        own = entries["exact"].errors["x_s"].max
        assert 0.0 < own < 1e-11
        for method in METHODS:
            size = {n: entries[f"{method.name}/{n}"].errors["x_s"].max for n in (1, 64)}
            assert size[64] < size[1]
            assert size[64] > 1e3 * own

    def test_tracking_and_numerical_error_lie_side_by_side_along_the_run(self, struck: Precision) -> None:
        along = struck.along
        trace = run(struck.scene).trace
        np.testing.assert_array_equal(along["t"], trace["t"])
        np.testing.assert_allclose(along["x_err"][2:], np.abs(trace["x_s"][2:] - trace["x_m"][:-2]))
        np.testing.assert_allclose(along["f_err"][2:], np.abs(trace["f_m"][2:] - trace["f_env"][:-2]))
        assert np.isnan(along["x_err"][:2]).all()
        assert np.nanmax(along["x_s:euler/1"]) == by_key(struck)["euler/1"].errors["x_s"].max

    @pytest.mark.full
    def test_a_long_run_keeps_the_largest_error_of_every_stretch_and_progress_goes_from_nothing_to_all(
        self, quick: None, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(teleop.analysis.precision.measure, "BINS", 7)
        shown: list[float] = []
        got = measure(strike(duration=0.05), clock=count(0, 1000).__next__, rounds=2,
                      show=lambda part, _: shown.append(part))
        assert all(len(column) == 7 for column in got.along.values())
        assert np.nanmax(got.along["f_env:rk4/1"]) == by_key(got)["rk4/1"].errors["f_env"].max
        assert shown == sorted(shown)
        assert (shown[0], shown[-1]) == (0.0, 1.0)

    @pytest.mark.full
    def test_what_diverges_or_misses_is_marked_and_kept(self, quick: None) -> None:
        hard = strike(environment=Wall(k=1e9, d=0.0, at=1e-3), duration=0.2)
        got = measure(hard, clock=count(0, 1000).__next__, rounds=1)
        entries = by_key(got)
        assert got.result.status == "ok"
        lost = entries["semi_implicit_euler/1"]
        assert lost.status == "diverged"
        assert np.isnan(lost.errors["x_s"].end)
        assert sum(e.missed > 0 for e in got.entries) > 0
        assert entries["exact"].missed == 0
        lines = table(got).splitlines()
        assert any(line.startswith("semi_implicit_euler/1 ") and "diverged" in line for line in lines)
        told = next(m for m in summary(got)["methods"] if m["name"] == "semi_implicit_euler/1")
        assert told["status"] == "diverged"
        assert told["errors"]["x_s"]["end"] is None
        json.dumps(summary(got), allow_nan=False, default=str)

    @pytest.mark.full
    def test_a_scene_that_diverges_by_itself_is_compared_up_to_there(self, quick: None) -> None:
        got = measure(strike(law=Direct(K=2000.0, B=8.0, kf=3.0), link=Delay(0.05), duration=3.0, x_limit=10.0,
                             environment=Tissue(k=2000.0, d=0.0)), clock=count(0, 1000).__next__, rounds=1)
        assert got.result.status == "diverged"
        assert got.entries[0].beaten_by is None
        assert 1e-15 < got.entries[0].errors["x_s"].max < 1e-3 * by_key(got)["rk4/1"].errors["x_s"].max + 1e-9

    @pytest.mark.full
    def test_every_axis_counts(self, quick: None) -> None:
        scene = strike(axes=3, environment=(None, Wall(k=1e5, at=1e-3), Tissue(k=500.0, d=1.0)),
                       start_m=(0.0, 0.02, 0.01), hand=None, duration=0.05)
        got = by_key(measure(scene, clock=count(0, 1000).__next__, rounds=1))
        a, b = run(scene, bodies=method_bodies(scene, BY_NAME["euler"], 1)).trace["x_s"], run(scene).trace["x_s"]
        assert got["euler/1"].errors["x_s"].max == pytest.approx(np.linalg.norm(a - b, axis=1).max())


def entry(method: str, time: float, x: float, f: float, status: str = "ok") -> Entry:
    return Entry(contender=Contender(method=method, label=method, bodies=Bodies((), [])), status=status, sentence="",
                 ns_per_tick=time, runs=1, errors={"x_s": Error(x, x, x), "f_env": Error(f, f, f)}, peak_ratio=1.0,
                 missed=0)


def test_beaten_is_what_is_less_accurate_in_position_and_force_and_more_than_1_2_times_slower() -> None:
    exact, lost = entry("exact", 100.0, 1e-12, 1e-9), entry("a", 10.0, 1e-3, 1.0, "diverged")
    for entries, beaten in (
            ([exact, entry("a", 119.0, 1e-3, 1.0), entry("b", 121.0, 1e-3, 1.0), entry("c", 50.0, 1e-2, 1.0)],
             {"b": "exact"}),
            ([replace(exact, ns_per_tick=500.0), entry("a", 100.0, 1e-6, 1e-2), entry("b", 200.0, 1e-3, 1e-3),
              entry("c", 200.0, 1e-3, 1e-1)], {"c": "a"}),  # it takes both
            ([exact, entry("a", 130.0, 0.0, 0.0)], {"a": "exact"}),  # below the rounding of the exact run all are alike
            ([replace(exact, ns_per_tick=130.0), entry("a", 100.0, 1e-14, 0.0)], {"exact": "a"}),
            ([exact, lost, entry("b", 90.0, 1e-2, 1.0)], {}),  # what diverged beats nobody unless the scene does
            ([replace(exact, status="diverged"), lost, entry("b", 90.0, 1e-2, 1.0, "diverged")], {"b": "a"})):
        assert {e.key: e.beaten_by for e in verdicts(entries) if e.beaten_by} == beaten


class TestTheBudget:
    def test_what_does_not_fit_into_a_minute_is_left_out_and_named(self, quick: None) -> None:
        slow = count(0, 2_000_000_000).__next__  # every reading is 2 s after the last
        got = measure(strike(duration=0.02), clock=slow)
        assert got.entries[0].key == "exact"
        assert got.left_out
        assert {e.key for e in got.entries} | set(got.left_out) == {c.key for c in contenders(strike(duration=0.02))}
        assert all("a shorter duration or --rounds 1 has it" in why for why in got.left_out.values())
        assert all(key in table(got) for key in got.left_out)

    @pytest.mark.full
    def test_rounds_that_were_asked_for_are_made_whatever_they_take(self, quick: None) -> None:
        got = measure(strike(duration=0.02), clock=count(0, 100_000_000).__next__, rounds=3)
        assert got.left_out == {}
        assert got.rounds == 3

    def test_what_is_no_number_of_rounds_is_refused_before_anything_is_run(self) -> None:
        for rounds in (True, 1.5, "2"):
            with pytest.raises(Refused, match=r"rounds must be a whole number of at least 1, .*; write --rounds 3"):
                measure(strike(), clock=lambda: 0, rounds=rounds)


class TestTheFigure:
    def test_no_two_contenders_look_alike_scipys_solvers_among_them(self, struck: Precision) -> None:
        pytest.importorskip("matplotlib")
        from teleop.analysis.precision.report import LOOKS

        methods = {e.contender.method for e in struck.entries} - {"exact"}
        assert methods == set(LOOKS)
        for kind in ("colour", "marker"):
            assert len({getattr(look, kind) for look in LOOKS.values()}) == len(LOOKS)


class TestTheCommand:
    def test_table_files_and_figure(self, typed: Typed, quick: None, tmp_path: Path) -> None:
        pytest.importorskip("matplotlib")
        got = typed("precision", "canonical", "--set", "duration=0.1", "--rounds", "1", "--out", "here", "--plot")
        assert got.code == 0
        for word in ("exact ", "radau/64", "LSODA/1e-06", "not beaten: ", "tracking error", "f_env rms"):
            assert word in got.out
        assert got.out.endswith("written to here\nplot: here/precision.png\n")
        assert {path.name for path in (tmp_path / "here").iterdir()} == {"summary.json", "errors.npz", "precision.png"}
        assert (tmp_path / "here" / "precision.png").read_bytes().startswith(b"\x89PNG")
        with np.load(tmp_path / "here" / "errors.npz") as arrays:
            assert {"t", "x_err", "f_err", "x_s:exact", "f_env:radau/64"} <= set(arrays)

    @pytest.mark.full
    def test_one_axis_of_several_is_told_in_its_units(self, typed: Typed, quick: None, tmp_path: Path) -> None:
        code, out, _ = typed("precision", "pose", "--set", "duration=0.05", "--rounds", "1", "--out",
                             str(tmp_path / "p"), "--axis", "rx")
        assert code == 0
        assert " rad" in out
        assert not re.search(r"\d [unmk]?(m|N)\b(?! m)", out)
        document = json.loads((tmp_path / "p" / "summary.json").read_text())
        assert [document["units"][name] for name in ("x_s", "f_env", "ns_per_tick")] == ["rad", "N m", "ns"]

    def test_json_is_one_object_and_what_is_in_the_folder(self, typed: Typed, quick: None, tmp_path: Path) -> None:
        got = typed("precision", "canonical", "--set", "duration=0.05", "--rounds", "1", "--json")
        assert got.err == ""
        told = json.loads(got.out)
        assert told.pop("path") == "runs/canonical-precision-1"
        assert told == json.loads((tmp_path / "runs" / "canonical-precision-1" / "summary.json").read_text())
        assert told["methods"][0]["name"] == "exact"
        assert told["ticks"] == 50
        assert told["reference"]["per_tick"]["40 digits"]["x"] < 1e-15
        assert set(told["reference"]["step_ns"]) == {"exact", "semi_implicit_euler/1"}
