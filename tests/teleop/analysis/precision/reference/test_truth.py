"""A comparison where bodies have no closed form: the reference, the default's error beside its estimate, marks."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import teleop.analysis.precision.measure
import teleop.analysis.precision.reference.truth as truth_module
import teleop.analysis.precision.report
from slave import Wall
from teleop import MassDamper, Refused, Scene, load_scene, run
from teleop.analysis.models.by_axis import along, own_parts
from teleop.analysis.precision.contenders import Contender
from teleop.analysis.precision.measure import Entry, Precision, measure, step_costs, verdicts
from teleop.analysis.precision.reference.deviation import Steps, touching
from teleop.analysis.precision.reference.reference import reference_bodies
from teleop.analysis.precision.reference.truth import Truth, bound_of, truth_of
from teleop.analysis.precision.report import draw, summary, table
from teleop.scene.library import built_in_scenes
from teleop.simulation.bodies import exact_bodies
from teleop.simulation.integrators.methods import METHODS
from teleop.simulation.integrators.parts import has_closed_form
from tests.teleop.analysis.precision.test_measure import entry, quick, same, strike  # noqa: F401 - a fixture
from tests.teleop.simulation.integrators.test_methods import HC, RUBBING, SCENES

Typed = Callable[..., Any]


def clock() -> Callable[[], int]:
    """One that ticks a microsecond whenever it is read."""
    return count(0, 1000).__next__


def truth(scene: Scene) -> Truth:
    return truth_of(scene, 0, clock(), patient=False, show=lambda *_: None)


@pytest.fixture(scope="module")
def pressed() -> Precision:
    """A blow against a Hunt-Crossley body, and some ticks of pressing it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(teleop.analysis.precision.measure, "TOLERANCES", (1e-6,))
        return measure(strike(environment=HC, duration=0.03), clock=clock(), rounds=1)


def by_key(got: Precision) -> dict[str, Entry]:
    return {each.key: each for each in got.entries}


class TestTheReference:
    def test_radaus_run_differs_by_as_much_as_it_says(self, pressed: Precision) -> None:
        found = pressed.truth
        assert found.method == "DOP853"
        other = run(pressed.scene, bodies=reference_bodies(pressed.scene, "Radau")).trace
        for name in ("x_s", "x_m", "f_env"):
            assert found.off[name] == np.abs(other[name] - found.result.trace[name]).max()
        assert 0.0 < found.off["x_s"] < 1e-13
        assert found.off["f_env"] < 1e-8
        assert "every change of mode located; by Radau at 1e-12 the run differs by at most" in found.sentence

    @pytest.mark.full
    @pytest.mark.parametrize("name", [name if name in (
        "the same with friction", "the same, moving", "three axes") else pytest.param(name, marks=pytest.mark.full)
        for name in SCENES])
    def test_only_what_has_no_closed_form_is_integrated(self, name: str) -> None:
        scene = strike(**{"duration": 0.02, **SCENES[name]})
        found = truth(scene)
        exact = not any(word in name for word in ("Hunt", "friction", "axes", "nobody", "without"))
        assert set(found.steps) == ({"40 digits"} if exact else {"DOP853", "Radau"})
        assert (found.method == "40 digits") == exact
        assert all(steps.x < (1e-14 if exact else 2e-9) for steps in found.steps.values())
        assert all((steps.integrated > 0) != exact or not steps.changes for steps in found.steps.values())
        assert exact <= (found.bound is None)
        assert same(found.stack, run(scene))

    def test_it_is_shown_how_far_it_is(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(truth_module, "OFTEN", 5)
        shown: list[tuple[float, str]] = []
        scene = strike(environment=HC, duration=0.01)
        truth_of(scene, 0, clock(), patient=True, show=lambda *line: shown.append(line))
        parts = [part for part, _ in shown]
        assert parts == sorted(parts)
        assert {text for _, text in shown} >= {"the reference by DOP853", "the reference by Radau"}

    @pytest.mark.full
    def test_where_radau_takes_too_long_dop853_is_compared_with_itself(self, monkeypatch: pytest.MonkeyPatch) -> None:
        scene = strike(environment=HC, duration=0.02)
        long = truth(scene)
        monkeypatch.setattr(truth_module, "_foretold", lambda *_: {"DOP853": 1.0, "Radau": 1e3})
        brief = truth(scene)
        assert same(brief.result, long.result)
        assert "by DOP853 at 1e-12 the run differs" in brief.sentence
        assert "(Radau would take about 1000 s; --rounds 1 has it)" in brief.sentence
        assert 0.0 < brief.off["x_s"] < 1e-12
        assert set(brief.steps) == {"DOP853"}

    def test_the_single_ticks_that_are_compared_miss_no_integrated_one(self) -> None:
        """Once 14 ticks of stick_slip showed an error of 3e-18 m, as none of them was integrated: it is 8e-11 m."""
        scene = load_scene("stick_slip", duration=0.3)
        own = run(scene)
        estimates: Any = own.extra["integration"]
        most = max(one["error_estimate_max"] for one in estimates.values())
        steps = Steps()
        run(scene, bodies=reference_bodies(scene, "DOP853", steps=steps))
        assert steps.count == 2 * own.ticks
        assert 0 < steps.integrated < 40
        assert 0.5 * most < steps.x < 2.0 * most

    def test_a_reference_that_takes_too_long_is_refused_unless_asked_for(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(truth_module, "_foretold", lambda *_: {"DOP853": 900.0, "Radau": 1e4})
        with pytest.raises(Refused, match=r"would take about 900 s; .* --set duration=5, or write --rounds 1"):
            truth(strike(environment=HC))

    def test_the_time_it_will_take_is_foretold_by_the_clock(self) -> None:
        scene = strike(environment=HC, duration=0.03)
        seconds = truth_module._foretold(scene, 0, clock(), 30)
        assert seconds == pytest.approx({"DOP853": 30 * 1e-6, "Radau": 30 * 1e-6})

    def test_without_scipy_it_is_refused(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(truth_module, "there", lambda: False)
        monkeypatch.setattr(teleop.analysis.precision.measure, "there", lambda: False)
        with pytest.raises(Refused, match="type: pip install scipy"):
            measure(strike(environment=HC), clock=clock(), rounds=1)


class TestTheDefault:
    def test_it_is_the_first_and_its_true_error_is_below_its_bound_and_not_far(self, pressed: Precision) -> None:
        first, bound, steps = pressed.entries[0], pressed.truth.bound, pressed.truth.steps["DOP853"]
        assert (first.key, first.contender.label) == ("default", "default: SDIRK2 to 1e-09 m a tick")
        own, want = run(pressed.scene).trace, pressed.result.trace
        assert first.errors["x_s"].max == np.abs(own["x_s"] - want["x_s"]).max()
        assert all(0.3 * bound[name] < error.max <= bound[name] for name, error in first.errors.items())
        assert pressed.truth.estimates["slave"]["ticks_over_tolerance"] == 0
        most = pressed.truth.estimates["slave"]["error_estimate_max"]
        assert 0.1 * most < steps.x < 2.0 * most + 1e-10, "so is that of one tick"
        assert steps.changes > 0
        finer = run(replace(pressed.scene, tolerance=1e-11)).trace
        assert np.abs(finer["x_s"] - want["x_s"]).max() < 0.05 * first.errors["x_s"].max

    @pytest.mark.parametrize(("name", "knobs"), [
        ("rubber", {}), ("rubber", {"law": "direct"}),  # a loop that enlarges errors
        *(pytest.param(*each, marks=pytest.mark.full) for each in (
            # the precision of servos is refused
            *((scene, {}) for scene in built_in_scenes() if scene not in ("lte", "rubber", "servo_arm")),
            ("rubber", {"tolerance": 1e-6}), ("rubber", {"n": 1.0}), ("rubber", {"lam": 3.0})))])
    def test_the_estimate_of_a_scene_was_told_as_a_bound_and_was_none(self, name: str, knobs: dict[str, Any]) -> None:
        """Of 1.5 s of rubber 50.6 nm were told, and the true error is 130 nm: a blow's error of speed flies on."""
        scene = load_scene(name, duration=1.0 if knobs else 1.5, **knobs)
        scene = along(scene, scene.axis_names[0] if own_parts(scene) else None)
        own = run(scene)
        bound = bound_of(scene, own)
        assert (bound is None) == has_closed_form(scene)
        if bound is None:
            return
        want = run(scene, bodies=reference_bodies(scene, "DOP853")).trace
        for column in ("x_s", "x_m", "f_env"):
            true = np.abs(own.trace[column] - want[column]).max()
            assert true <= bound[column]
            assert knobs or 0.3 * bound[column] <= true

    def test_of_rounding_no_bound_is_told(self) -> None:
        scene = load_scene("rubber", duration=1.0, tolerance=1e-14)
        assert bound_of(scene, run(scene)) is None

    @pytest.mark.parametrize("name", ["Hunt-Crossley that moves, and friction", *(
        pytest.param(name, marks=pytest.mark.full) for name in ("the same with friction", "a master with friction"))])
    def test_the_same_with_friction_over_a_whole_run(self, name: str) -> None:
        scene = strike(**{"duration": 0.1, **SCENES[name]})
        own, want = run(scene), run(scene, bodies=reference_bodies(scene, "DOP853"))
        said: Any = own.extra["integration"]
        estimated = sum(one["error_estimate_sum"] for one in said.values())
        assert np.abs(own.trace["x_s"] - want.trace["x_s"]).max() < 3.0 * estimated + 1e-12


class TestTheContenders:
    def test_all_but_radau_iia_take_part_and_finer_is_more_accurate_by_the_order(self, pressed: Precision) -> None:
        keys = [each.key for each in pressed.entries]
        names = [m.name for m in METHODS if m.name != "radau"]
        assert set(keys) == {"default", "DOP853/1e-06", "LSODA/1e-06", "Radau/1e-06"} | {
            f"{name}/{n}" for name in names for n in (1, 4, 16, 64)}
        assert pressed.left_out == {"radau": "no solver for its coupled stages where a body is not piecewise linear"}
        entries = by_key(pressed)
        for method in METHODS:
            if method.name != "radau":
                size = [entries[f"{method.name}/{n}"].errors["x_s"].max for n in (16, 64)]
                assert size[1] < size[0] * 4.0 ** (0.2 - min(method.order, 2.0))

    def test_with_friction_scipys_solvers_are_left_out_and_why(self) -> None:
        scene = strike(environment=None, slave=RUBBING, duration=0.01)
        got = measure(scene, clock=clock(), rounds=1)
        assert {each.contender.rtol for each in got.entries} == {None}
        assert "friction jumps at rest" in got.left_out["scipy's solvers"]
        assert "left out" in table(got)
        assert not touching(scene, run(scene).trace).any(), "friction alone is not felt as a contact"

    def test_below_the_references_own_error_nobody_is_told_apart_and_a_default_that_diverged_beats_nobody(self) -> None:
        first, better, worse = (entry(*each) for each in (
            ("default", 100.0, 1e-8, 1e-5), ("a", 130.0, 1e-9, 1e-6), ("a", 130.0, 1e-7, 1e-4)))
        off = {"x_s": 1e-14, "f_env": 1e-9}
        assert verdicts([first, better])[1].beaten_by == "default"
        assert verdicts([first, better], off)[1].beaten_by is None
        assert verdicts([replace(first, status="diverged"), worse], off, "ok")[1].beaten_by is None

    @pytest.mark.full
    def test_so_it_is_in_a_comparison(self, quick: None) -> None:  # noqa: F811
        """By a clock that runs faster and faster finer ones, which come later, are slower."""
        slower = (n**4 for n in count())
        got = by_key(measure(strike(environment=HC, duration=0.03), clock=slower.__next__, rounds=1))
        assert got["rk4/64"].ns_per_tick > 1.2 * got["default"].ns_per_tick
        assert got["rk4/64"].errors["x_s"].max < got["default"].errors["x_s"].max
        assert got["rk4/64"].beaten_by is None
        assert got["euler/64"].beaten_by == "default"

    def test_an_inner_state_goes_on_from_tick_to_tick_where_steps_are_timed(self) -> None:
        scene = strike(environment=HC, duration=0.02)
        seen: list[int] = []

        def spy(_: Any, x: float, v: float, f: float, z: int) -> tuple[float, float, int, int]:  # noqa: ARG001
            seen.append(z)
            return x, v, 0, z + 1

        own = exact_bodies(scene)
        bodies = own._replace(slaves=[own.slaves[0]._replace(move=spy, start=7)])
        step_costs([Contender(method="spy", label="spy", bodies=bodies)], scene, run(scene).trace, clock(), 20, 1)
        assert seen == [*range(7, 27), *range(7, 27)]


class TestWhatIsTold:
    def test_the_table_has_the_true_error_beside_the_estimate_and_so_has_json(self, pressed: Precision) -> None:
        lines = table(pressed).splitlines()
        assert lines[1].startswith("default ")
        assert "by itself at most " in lines[1]
        for label in ("reference ", "default, one tick", "default, estimated", "default, bound", "default, its effort",
                      "left out"):
            assert any(line.startswith(label) for line in lines)
        assert not any(line.startswith("exact") for line in lines)
        told = json.loads(json.dumps(summary(pressed), allow_nan=False, default=str))
        assert told["reference"]["method"] == "DOP853"
        assert told["reference"]["off_by"]["x_s"] == pressed.truth.off["x_s"]
        assert told["estimates"]["slave"]["tolerance"] == 1e-9
        assert told["bound"] == pressed.truth.bound
        assert told["methods"][0]["name"] == "default"
        assert set(told["reference"]["step_ns"]) == {"default", "semi_implicit_euler/1"}

    def test_the_figure_has_the_bound_beside_the_true_error(
        self, pressed: Precision, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        pytest.importorskip("matplotlib")
        made: list[Any] = []
        monkeypatch.setattr(teleop.analysis.precision.report.plot, "save", lambda figure, *_: made.append(figure) or [])
        draw(pressed, tmp_path / "p")
        labels = made[0].axes[0].get_legend_handles_labels()[1]
        assert {"default: SDIRK2 to 1e-09 m a tick", "its own bound"} <= {*labels}

    def test_a_wall_that_moves_is_compared_with_the_exact_run(self, quick: None) -> None:  # noqa: F811
        scene = strike(**{"duration": 0.04, **SCENES["a wall that moves"]})
        got = measure(scene, clock=clock(), rounds=1)
        assert got.entries[0].key == "exact"
        assert got.left_out == {}
        assert got.entries[0].errors["x_s"].max < 1e-13
        assert by_key(got)["radau/64"].errors["x_s"].max < 1e-6


def test_walls_without_friction_are_left_to_the_exact_steps() -> None:
    scene = strike(environment=Wall(k=1e4, at=1e-3), master=MassDamper(mass=0.1, damping=0.5, friction=0.1))
    exact, other = run(scene), run(scene, bodies=reference_bodies(scene, "DOP853"))
    assert np.abs(exact.trace["x_s"] - other.trace["x_s"]).max() < 1e-9
