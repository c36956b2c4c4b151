"""The search for parameters: where, by which terms, within its budget, by processes, and again by what it prints."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import sqrt
from pathlib import Path
from typing import Annotated, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import teleop.studies.tune.search
from teleop import Knob, Scene, load_scene, run
from teleop.__main__ import main
from teleop.errors import Refused
from teleop.knob import knobs_of_fields
from teleop.law import find_law, two_port_laws
from teleop.simulation.notes import unmet
from teleop.studies.baseline import Baseline
from teleop.studies.margin import margin
from teleop.studies.parallel import stream
from teleop.studies.tune.objective import FREE, OBJECTIVES, SCENE, Score, score
from teleop.studies.tune.search import LawSearch, Scored, SearchJob, Tuned
from teleop.studies.tune.strategy import Strategy, fold, part, ranges_of, value_at
from teleop.sweeps.grid import Range

SHORT: dict[str, Any] = {"k_e": 2000.0, "duration": 2.5}
LOSSY: dict[str, Any] = {**SHORT, "link": "delay(0.02) | bernoulli(0.05)"}


def tuned(law: str = "wave", budget: int = 16, **others: Any) -> Tuned:
    how = {name: others.pop(name) for name in ("tell", "workers", "keep", "known") if name in others}
    job = SearchJob("hard_wall", law, budget, **{"fixed": dict(SHORT), **others})
    return LawSearch(job, **{"workers": 1, **how}).run()


KEPT: list[Scored] = []


@pytest.fixture(scope="module")
def found() -> Tuned:
    return tuned(keep=KEPT.extend)


def test_the_best_is_the_least_that_was_tried_within_the_budget_and_nothing_beats_the_front(found: Tuned) -> None:
    assert found.feasible
    assert found.score.value == min(each.value for _, each in found.tried if not each.broken) < found.default.value
    assert found.rows == 2 * len(found.tried) == found.budget == 16
    for one in [each.terms for _, each in found.front()]:  # is beaten in both by none
        assert not any(each.terms["tracking"] < one["tracking"] and each.terms["drag"] < one["drag"]
                       for _, each in found.tried if not each.broken)


def test_the_same_search_gives_the_same_bits_with_any_threads_and_another_seed_tries_other_points(found: Tuned) -> None:
    assert tuned(workers=2) == found
    second = tuned(seed=1, budget=6)
    assert second.tried[0][0] == found.tried[0][0] == {"law.b": 20.0, "law.K": 1000.0, "law.B": 20.0}  # the scene's
    assert second.tried[1][0] == found.tried[1][0] == {"law.b": 2.0, "law.K": 500.0, "law.B": 20.0}  # the law's
    assert second.tried[2][0] != found.tried[2][0]


def test_the_settings_that_are_printed_run_the_row_that_was_judged(found: Tuned) -> None:
    result, row = run(load_scene("hard_wall", **found.settings)), found.score.figures["scene"]
    assert {name: result.metrics[name] for name in ("x_err_rms", "f_m_end", "f_env_end", "E_link_min")} == {
        name: row[name] for name in ("x_err_rms", "f_m_end", "f_env_end", "E_link_min")}


def test_a_search_that_is_given_its_points_runs_none_of_them(found: Tuned, monkeypatch: pytest.MonkeyPatch) -> None:
    assert sum(each.stop - each.first for each in KEPT) * 2 == found.rows
    monkeypatch.setattr(teleop.studies.tune.search, "carry_out", None)
    assert tuned(known=KEPT) == found
    with pytest.raises(TypeError):  # the last point is missing
        tuned(known=KEPT[:-1])


@pytest.mark.full
def test_a_link_that_draws_is_checked_with_other_seeds() -> None:
    got = tuned(budget=36, fixed=dict(LOSSY), playouts=["integral", "zero"])
    assert got.rows <= 36
    assert got.best["playout"] in ("integral", "zero")
    assert got.rows > 2 * len(got.tried)  # the seeds of the check come on top


@pytest.mark.full
def test_a_point_that_breaks_a_condition_is_moved_to_where_the_law_fits_itself() -> None:
    """Half of the points of p_d were run with too little damping for its claim."""
    got = tuned("p_d", budget=40, fixed={**SHORT, "delay": 0.02})
    assert {each.unmet for _, each in got.tried[2:]} == {0}
    assert len({values["law.B"] for values, _ in got.tried}) > len(got.tried) // 2
    assert not unmet(load_scene("hard_wall", **got.knobs))


@pytest.mark.full
def test_a_parameter_that_changes_nothing_keeps_the_laws_own_value() -> None:
    """How fast an end is drawn back that was let go was tuned where none ever was."""
    got = tuned("p_d", budget=200, fixed={**SHORT, "delay": 0.02})
    assert got.best["law.rejoin"] == 2.0
    assert len({values["law.rejoin"] for values, _ in got.tried}) > 10
    assert got.best["law.K"] != 100.0


@pytest.mark.full
def test_a_law_without_claims_has_the_margin_that_is_asked_for_in_its_linear_loop_too() -> None:
    """Direct reflection over 30 ms each way, in contact and free."""
    fixed = {**SHORT, "delay": 0.03}
    careful, careless = (tuned("direct", budget=45, fixed=dict(fixed), margin=wanted) for wanted in (4.0, 1.0))
    assert careful.feasible
    assert careful.linear.gain >= 4.0 == careful.margin
    assert careful.linear == margin(load_scene("hard_wall", **careful.knobs))
    assert 1.0 <= careless.linear.gain < 4.0  # so the margin is what made the difference
    assert careless.score.value < careful.score.value


def test_nothing_feasible_says_what_comes_nearest() -> None:
    got = tuned(budget=8, fixed={**SHORT, "x_limit": 0.01})  # the hand reaches farther
    assert not got.feasible
    assert "diverged" in got.score.broken
    assert got.score.order == min(each.order for _, each in got.tried)
    assert got.front() == []


@pytest.mark.full
def test_a_single_playout_is_no_choice_and_is_played_all_the_same() -> None:
    got = tuned(budget=9, fixed=dict(LOSSY), playouts=["integral"])
    assert got.knobs["playout"] == "integral"
    assert "playout=integral" in got.command()
    assert got.score == tuned(budget=9, fixed={**LOSSY, "playout": "integral"}).score


def test_a_search_of_one_playout_took_the_points_of_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """`advise` took two_layer with the newest packet at 0.174, and it has 0.138 at a fixed delay of 0.1 s."""
    tried: list[str] = []

    def score(_: Any, points: Any, __: Any) -> list[Score]:
        tried.extend(point[-1] for point in points)
        return [Score(1.0 / len(tried), "", 0.0, {}, {}) for _ in points]  # always better, so none ends by itself

    monkeypatch.setattr(LawSearch, "_run", score)
    monkeypatch.setattr(LawSearch, "_is_stable", lambda *_: True)
    monkeypatch.setattr(teleop.studies.tune.search, "margin", lambda *_, **__: None)
    playouts = ("zero", "fixed:0.04")
    tuned("pp", 1200, fixed={**SHORT, "link": "delay(0.03) | uniform(0.01)"}, playouts=playouts)
    assert all(tried.count(playout) >= 0.2 * len(tried) for playout in playouts)


ROD = Baseline(moved=0.02, pressed=4.0, steady=5.0, scale=5.0, fastest=0.1)
RODS = {SCENE: ROD, FREE: ROD._replace(moved=0.04, pressed=0.0, steady=None)}
GOOD: dict[str, Any] = {"status": "ok", "ticks": 100, "x_err_rms": 0.002, "f_m_max": 6.0, "f_env_end": 4.0,
                        "f_m_end": 3.0, "f_env_max": 7.0, "swing_end": 0.0, "E_link_min": 0.0}
LIGHT = {**GOOD, "x_err_rms": 0.004, "f_m_max": 1.0, "f_env_end": 0.0, "f_m_end": 0.0, "f_env_max": 0.0}


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("hard_wall", duration=0.1)


def judged(scene: Scene, *rows: tuple[str, dict[str, Any]], objective: str = "balanced") -> Score:
    return score(OBJECTIVES[objective], RODS, scene, rows)


def test_each_term_is_relative_to_the_rod_and_objectives_look_at_their_own(scene: Scene) -> None:
    rows = (SCENE, GOOD), (FREE, LIGHT)
    found = judged(scene, *rows)
    assert found.terms == pytest.approx({"tracking": 0.1, "drag": 0.2, "touch": 0.2, "feel": 0.4})
    assert found.value == pytest.approx(sqrt((0.01 + 0.04 + 0.04 + 0.16) / 4.0))
    assert found.order == (0.0, 0.0, found.value)
    for objective, value in (("tracking", 0.1), ("drag", 0.2), ("force", sqrt((0.04 + 0.16) / 2.0))):
        assert judged(scene, *rows, objective=objective).value == pytest.approx(value), objective


def test_the_rod_itself_is_worth_nothing_and_a_law_that_does_nothing_one_whatever_its_error(scene: Scene) -> None:
    rod = {**GOOD, "x_err_rms": 0.0, "f_env_end": 5.0, "f_m_end": 5.0}
    assert judged(scene, (SCENE, rod), (FREE, {**LIGHT, "x_err_rms": 0.0, "f_m_max": 0.0})).value == 0.0
    idle = {**GOOD, "x_err_rms": 0.02, "f_env_end": 0.0, "f_m_end": 0.0}
    found = judged(scene, (SCENE, idle), (FREE, {**LIGHT, "x_err_rms": 0.04, "f_m_max": 0.0}))
    assert found.value == pytest.approx(sqrt(3.0 / 4.0))
    drags = judged(scene, (SCENE, {**GOOD, "x_err_rms": 0.0005, "f_env_end": 0.0}), (FREE, {**LIGHT, "f_m_max": 5.0}))
    follows = judged(scene, (SCENE, {**GOOD, "x_err_rms": 0.006}), (FREE, LIGHT))
    assert drags.value > follows.value


def test_a_row_that_breaks_a_constraint_says_which_and_is_no_feasible_point(scene: Scene) -> None:
    for row, sentence in (
            ({"status": "refused", "ticks": 0, "sentence": "b must be above 0"}, "refused: b must be above 0"),
            ({**GOOD, "status": "diverged", "ticks": 50}, "diverged at 0.05 s"),
            ({**GOOD, "status": "limit cycle"}, "limit cycle"),
            ({**GOOD, "swing_end": 0.01}, "a swing of 10.0 mm is left at the end"),
            ({**GOOD, "E_link_min": -0.02}, "E_link falls to -20.0 mJ"),
            ({**GOOD, "E_link_min": float("nan")}, "E_link"), ({**GOOD, "x_err_rms": float("nan")}, "")):
        found = judged(scene, (SCENE, row), (FREE, LIGHT))
        assert found.broken
        assert sentence in found.broken
        assert found.order > judged(scene, (SCENE, {**GOOD, "x_err_rms": 10.0}), (FREE, LIGHT)).order, sentence
        assert sentence in judged(scene, (SCENE, GOOD), (FREE, row)).broken
    early, late = (judged(scene, (SCENE, {**GOOD, "status": "diverged", "ticks": ticks})) for ticks in (10, 90))
    assert late.order < early.order  # of two that diverge the later comes nearer


def test_a_force_that_chatters_is_no_steady_force(scene: Scene) -> None:
    """200 N/s rms is 2 N in 10 ms, of the rod's 5 N."""
    found = judged(scene, (SCENE, {**GOOD, "jerk_rms": 200.0}), (FREE, LIGHT))
    assert found.terms["rough"] == pytest.approx(0.4)
    assert found.value > judged(scene, (SCENE, {**GOOD, "jerk_rms": 5.0}), (FREE, LIGHT)).value


@dataclass(frozen=True, kw_only=True)
class Numbers:
    """Knobs of every kind of bounds, the ends of a law left out: ranges go by knobs alone."""

    K: Annotated[float, Knob("N/m", "stiffness", low=0.0)] = 300.0
    K_d: Annotated[float, Knob("N/m", "more of it", low=0.0)] = 0.0
    alpha: Annotated[float, Knob("", "weight", low=0.0, high=1.0)] = 0.0
    beta: Annotated[float, Knob("", "small share", low=0.0, high=1.0)] = 0.01
    g: Annotated[float, Knob("", "gain", above=0.0, high=2.0)] = 1.0
    off: Annotated[float, Knob("J", "nothing says how large", low=0.0)] = 0.0
    name: str = "text"


def test_a_range_follows_from_bounds_and_default() -> None:
    found = ranges_of(Numbers())
    assert found.searched == {
        "law.K": Range(10.0, 9000.0, log=True), "law.K_d": Range(0.0, 300.0), "law.alpha": Range(0.0, 1.0),
        "law.beta": Range(0.01 / 30.0, 1.0, log=True), "law.g": Range(1.0 / 30.0, 2.0, log=True),
    }
    assert "neither its value nor its bounds" in found.held["off"]


def test_the_spans_of_every_law_lie_within_its_bounds_and_about_its_own_values() -> None:
    for law in [find_law(name)() for name in two_port_laws()]:
        for knob, span in ranges_of(law).searched.items():
            field = knob.removeprefix("law.")
            declared, value = knobs_of_fields(type(law))[field].knob, getattr(law, field)
            assert declared.span is not None, (law, knob)
            declared.check(knob, (span.low, span.high))
            assert span.low <= value <= span.high or value == 0.0, (law, knob)


def test_a_knob_that_is_set_or_follows_from_the_slave_is_not_turned() -> None:
    """The mass of the predicted slave was searched from 1/30 to 30 times its own."""
    assert ranges_of(find_law("wave_prediction")()).held == {
        "mass": "0.5: the slave's own", "damping": "1: the slave's own"}
    found = ranges_of(find_law("wave")(), ["law.K"])
    assert set(found.searched) == {"law.b", "law.B"}
    assert found.held == {"K": "as set"}


@given(st.sampled_from([Range(0.02, 18.0, log=True), Range(0.0, 1.0), Range(-3.0, 400.0)]), st.floats(0.0, 1.0))
def test_places_are_what_is_typed_within_the_range(span: Range, u: float) -> None:
    value = value_at(span, u)
    assert span.low <= value <= span.high
    assert float(f"{value:.4g}") == value or value in (span.low, span.high)
    assert value_at(span, part(span, value)) == pytest.approx(value, rel=2e-4, abs=1e-12)


def evolved(value: object, generations: int, key: int = 0) -> Strategy:
    strategy = Strategy([0.2, 0.3, 0.9, 0.5], 0.15, (key, 0))
    for _ in range(generations):
        drawn = strategy.ask()
        strategy.tell(drawn, [(value(fold(x)),) for x in drawn])
    return strategy


def valley(x: Sequence[float]) -> float:
    """A narrow valley across all coordinates, a thousand times as steep as it is long."""
    along = sum(x) - 2.0
    return along * along + 1e3 * sum((a - b) ** 2 for a, b in pairwise(x))


def test_it_finds_the_end_of_a_valley_that_no_coordinate_goes_along_and_of_a_range() -> None:
    strategy = evolved(valley, 150)
    assert fold([*strategy.mean]) == pytest.approx([0.5] * 4, abs=1e-3)
    assert strategy.spread < 0.01
    assert fold([*evolved(sum, 80).mean]) == pytest.approx([0.0] * 4, abs=0.01)
    assert [*evolved(valley, 5).mean] == [*evolved(valley, 5).mean] != [*evolved(valley, 5, key=1).mean]


TUNE = ["tune", "wave", "--scene", "hard_wall", "--set", "k_e=2000", "--set", "duration=2.5", "--budget", "12",
         "--workers", "1"]


def test_it_leaves_points_front_and_the_command_of_the_best(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*TUNE, "--out", str(tmp_path / "t"), "--plot"]) == 0
    page = capsys.readouterr().out
    document = json.loads((tmp_path / "t/summary.json").read_text())
    assert document["status"] == "done"
    assert document["rows"] == 12
    assert "run it: teleop run hard_wall --set law=wave" in page
    assert document["run"][:3] == ["teleop", "run", "hard_wall"]
    with (tmp_path / "t/points.csv").open() as file:
        points = list(csv.DictReader(file))
    assert len(points) == document["points"] == 6
    assert min(float(point["value"]) for point in points if not point["broken"]) == document["value"]
    assert (tmp_path / "t/tune.png").stat().st_size > 10_000
    assert main([*document["run"][1:], "--out", str(tmp_path / "r"), "--json"]) == 0
    summary = json.loads((tmp_path / "r/summary.json").read_text())
    assert summary["metrics"]["x_err_rms"]["value"] == document["figures"]["scene"]["x_err_rms"]


@pytest.mark.full
def test_a_best_point_that_breaks_a_condition_of_its_law_says_so_before_it_is_run(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [{"wave": "p_d", "12": "40"}.get(word, word) for word in TUNE]
    assert main([*words, "--set", "delay=0.2", "--set", "law.B=0.5", "--out", str(tmp_path / "t")]) == 0
    page = " ".join(capsys.readouterr().out.split())
    document = json.loads((tmp_path / "t/summary.json").read_text())
    (sentence,) = document["conditions"]
    assert "it is not: --set law.B=" in sentence
    assert f"but {sentence}" in page
    assert main([*document["run"][1:], "--out", str(tmp_path / "r"), "--json"]) == 0
    assert sentence in json.loads((tmp_path / "r/summary.json").read_text())["notes"]


def squares(job: int, send: Callable[[Any], None]) -> int:
    """Send each number below the job's, answer its square; a job below 0 refuses, one of 99 is killed."""
    if job < 0:
        raise Refused("below zero")
    if job == 99:
        os._exit(9)
    for number in range(job):
        send(number)
    return job * job


def carried_out(jobs: list[int], workers: int) -> tuple[dict[int, int], dict[int, list[int]], list[int]]:
    parts: dict[int, list[int]] = {}
    begun: list[int] = []
    answers = dict(stream(squares, jobs, workers, begun.append,
                            lambda number, part: parts.setdefault(number, []).append(part), lambda: None))
    return answers, parts, begun


@pytest.mark.parametrize("workers", [1, 2])
def test_every_part_is_taken_before_its_answer_and_a_refusal_of_a_job_is_that_of_the_whole(workers: int) -> None:
    answers, parts, begun = carried_out([3, 1, 2], workers)
    assert answers == {0: 9, 1: 1, 2: 4}
    assert parts == {0: [0, 1, 2], 1: [0], 2: [0, 1]}
    assert sorted(begun) == [0, 1, 2]
    with pytest.raises(Refused, match="below zero"):
        carried_out([2, -1], workers)


def test_a_process_that_was_killed_says_what_to_type() -> None:
    with pytest.raises(Refused, match="type the same command again"):
        carried_out([99, 99], 2)
