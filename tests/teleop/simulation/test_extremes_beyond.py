"""The second extreme matrix: friction, soft and moving bodies, devices and one-port laws at their ends, all at once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from itertools import combinations, product
from math import floor, isfinite

import numpy as np
import pytest

from teleop.physics.sdirk import MOST_SUBSTEPS
from teleop.scene.playout import repeats
from teleop.simulation.result import Result
from teleop.simulation.virtual import run
from tests.teleop.simulation.extremes import Case, failing, lines_kept, tried
from tests.teleop.simulation.extremes_beyond import FAMILIES, balance, rows, scene_of, ticks_of

EPS = float(np.finfo(float).eps)


@pytest.fixture(scope="module")
def tries() -> Iterator[list[Case]]:
    """Every row of the matrix."""
    with lines_kept():
        yield [tried(seed, row, scene_of(row)) for seed, row in enumerate(rows())]


@pytest.fixture
def cases(tries: list[Case]) -> list[Case]:
    """Those that came to a result."""
    return [case for case in tries if case.result]


# -- the matrix itself


@pytest.mark.parametrize("name", FAMILIES)
def test_the_matrix_has_the_corners_of_the_pairs_of_knobs_and_all_pairs_of_choices(name: str) -> None:
    family, matrix = FAMILIES[name], [row for row in rows() if row["family"] == name]
    for a, b in family.pairs:
        ends = [(0.0 if r.zero else r.low, r.high) for r in (family.ranges[a], family.ranges[b])]
        seen = {(row[a], row[b]) for row in matrix if row["pinned"].keys() == {a, b}}
        assert seen == set(product(*ends)), (a, b)
    assert len(matrix) >= 200
    for a, b in combinations(family.choices, 2):
        if not {"environment", "law", "passivity", "velocity", "electrical"} & {a, b}:  # pinned knobs ask for these
            pairs = {(str(row[a]), str(row[b])) for row in matrix}
            assert pairs == {(str(x), str(y)) for x, y in product(family.choices[a], family.choices[b])}, (a, b)
    for choice, values in family.choices.items():
        assert {str(row[choice]) for row in matrix} == set(map(str, values)), choice


def test_the_matrix_is_not_idle(cases: list[Case]) -> None:
    """Bodies stick and slide, are struck, carried and integrated in earnest; controllers, encoders and caps act."""
    seen: Counter[str] = Counter()
    for case in cases:
        got, trace, row, report = case.result, case.result.trace, case.row, integrated(case)
        still_m, still_s = (
            trace[v].reshape(got.ticks, -1)[2:, 0] == 0.0 for v in ("v_m", "v_s" if "v_s" in trace else "v_m"))
        observed = trace.get("E_po", np.zeros(1))
        touched = got.metrics.get("f_env_max", 0.0) > 0.0
        for name, is_so in {
            got.status: True, "overflowed": not all(np.isfinite(column).all() for column in trace.values()),
            "sub-steps": any(said["substeps_max"] > 2 for said in report.values()),
            "all sub-steps": any(said["substeps_max"] == MOST_SUBSTEPS for said in report.values()),
            "within the tolerance": any(said["substeps_max"] > 2 and not said["ticks_over_tolerance"]
                                        for said in report.values()),
            "slave slips": row.get("f_s", 0.0) > 0.0 and still_s.any() and not still_s.all(),
            "master slips": row["f_m"] > 0.0 and still_m.any() and not still_m.all(),
            "controller acts": row["pc"] > 0.0 and (observed < 0.0).any(),
            "encoder turns": np.ptp(trace.get("q_m", 0.0)) > 0.0,
            "capped": case.scene.cap is not None and (np.abs(trace["f_m"]) == case.scene.cap.f_max).any(),
            "electrical": bool(row["electrical"]) and trace["v_m"].any(), f"{row['law']} acts": trace["f_m"].any(),
            f"{row.get('environment')} touched": touched,
            "struck by what moves": touched and row.get("beat", 0.0) > 0.0,
            "claimed": "E_link" in trace and claimed(case) and trace["E_link"].max() > 0.0,
            "turned": not on_an_edge(case), "let go": not case.scene.hand and touched and row["law"] == "nothing",
        }.items():
            seen[name] += bool(is_so)
    least = {
        "ok": 400, "diverged": 15, "overflowed": 3, "sub-steps": 80, "all sub-steps": 40, "within the tolerance": 40,
        "slave slips": 25, "master slips": 15, "controller acts": 40, "encoder turns": 150, "capped": 80,
        "electrical": 60, "wave acts": 60, "pfra acts": 25, "direct acts": 25, "wall acts": 30, "coupling acts": 40,
        "claimed": 50, "hunt crossley touched": 40, "relaxing touched": 30, "wall touched": 25, "tissue touched": 25,
        "struck by what moves": 100, "turned": 180, "let go": 5,
    }
    assert {name: seen[name] for name, count in least.items() if seen[name] < count} == {}


# -- what holds for every row


def test_every_row_ends_in_a_declared_status_without_exception_or_warning(tries: list[Case]) -> None:
    assert failing(tries, lambda case: case.result is not None and case.result.status in (
        "ok", "limit cycle", "unstable", "diverged")) == []


def test_a_run_that_is_ok_ran_to_its_end_and_one_that_diverged_says_when_and_what(cases: list[Case]) -> None:
    def holds(case: Case) -> bool:
        got = case.result
        sound = {name: np.isfinite(column).all() for name, column in got.trace.items()}
        whole = all(len(column) == got.ticks for column in got.trace.values())
        if got.status != "diverged":
            return whole and got.ticks == ticks_of(case.row) and all(sound.values())
        where, _, what = got.sentence.partition("): ")
        tick = int(where.rpartition("tick ")[2])
        if what.startswith(("x_m passed", "x_s passed")):
            return whole and tick == got.ticks - 1 and all(sound.values())
        before = all(np.isfinite(column[:tick]).all() for column in got.trace.values())
        return whole and before and "is not finite" in what and not sound[what.split()[0]]

    assert failing(cases, holds) == []


def claimed(case: Case) -> bool:
    """Does the law claim E_link here?"""
    return "E_link" in case.scene.law.claims and not (case.scene.link and repeats(case.scene.playout))


def test_the_link_stores_no_less_than_nothing_whatever_stands_at_its_ends(cases: list[Case]) -> None:
    """A difference of four sums of as many squares as there are ticks: each is off by that many EPS of itself."""

    def holds(case: Case) -> bool:
        if not claimed(case):
            return True
        trace = case.result.trace
        sums = trace["E_in_fwd"] + trace["E_in_bwd"]
        known = np.isfinite(sums)
        return bool((trace["E_link"][known] >= -2.0 * case.result.ticks * case.row["axes"] * EPS * sums[known]).all())

    assert failing(cases, holds) == []


def test_the_passivity_observer_sums_the_readings(cases: list[Case]) -> None:
    """E_po(k) = E_po(k-1) + f_m(k-1)(q(k) - q(k-1)), to the bit."""

    def holds(case: Case) -> bool:
        if case.scene.passivity is None:
            return True
        f, q, observed = case.axes("f_m", "q_m" if case.scene.device_m.encoder else "x_m", "E_po")
        work = np.zeros_like(f)
        work[1:] = f[:-1] * np.diff(q, axis=0)
        return np.array_equal(np.cumsum(work, axis=0), observed, equal_nan=True)

    assert failing(cases, holds) == []


def test_readings_are_whole_steps_beside_where_the_device_is(cases: list[Case]) -> None:
    def holds(case: Case) -> bool:
        encoder = case.scene.device_m.encoder
        if encoder is None:
            return True
        x, q = case.axes("x_m", "q_m")
        off = (q - x) / encoder.step - encoder.phase
        rounding = 4.0 * EPS * (1.0 + np.abs(x) / encoder.step)
        known = np.isfinite(x)
        return bool(((off >= -1.0 - rounding) & (off <= rounding))[known].all())

    assert failing(cases, holds) == []


def test_the_cap_bounds_every_force(cases: list[Case]) -> None:
    def holds(case: Case) -> bool:
        forces = case.axes("f_m", "f_s") if case.scene.slave else case.axes("f_m")
        return case.scene.cap is None or all(
            (np.abs(f) <= case.scene.cap.f_max)[np.isfinite(f)].all() for f in forces)

    assert failing(cases, holds) == []


def test_a_force_that_is_renewed_every_nth_tick_rests_in_between(cases: list[Case]) -> None:
    def holds(case: Case) -> bool:
        device, f = case.scene.device_m, case.axes("f_m")[0]
        late = (f[: device.delay] == 0.0).all() or case.scene.passivity is not None
        if case.scene.passivity is not None or device.every == 1:
            return bool(late)
        held = f[np.arange(len(f)) // device.every * device.every]
        return bool(late) and np.array_equal(f, held, equal_nan=True)

    assert failing(cases, holds) == []


def integrated(case: Case) -> dict[str, dict[str, float]]:
    """The integration's report by end; {} if there is none."""
    return case.result.extra.get("integration", {})


def test_what_was_integrated_says_how_well_in_finite_figures(cases: list[Case]) -> None:
    """The report is there for a body that rubs and for a soft one, and counts the ticks that missed the tolerance."""

    def holds(case: Case) -> bool:
        row, report = case.row, integrated(case)
        soft = row.get("f_s", 0.0) > 0.0 or row.get("environment") == "hunt crossley"
        ends = [end for end, has in (("master", case.scene.master.friction > 0.0), ("slave", soft)) if has]
        return list(report) == ends and all(
            all(map(isfinite, said.values())) and said["tolerance"] == case.scene.tolerance
            and (said["ticks_over_tolerance"] > 0) >= (said["error_estimate_max"] > case.scene.tolerance)
            and (said["ticks_over_tolerance"] == 0 or case.result.status == "diverged"
                 or said["error_estimate_max"] > case.scene.tolerance)
            for said in report.values())

    assert failing(cases, holds) == []


def test_a_slave_makes_no_energy_beyond_the_error_of_its_integration(cases: list[Case]) -> None:
    """At every tick what is stored more is at most the force's work, less what damper and friction took for sure.

    With nobody at it and no force that is: friction, dampers and soft bodies only take. In the frame of what it
    touches, which within a tick moves evenly; friction with the ground works on that frame too.
    """

    def holds(case: Case) -> bool:
        if case.scene.slave is None:
            return True
        columns = [column.T for column in case.axes("x_s", "v_s", "f_s", "f_env")]
        error = np.float64(integrated(case).get("slave", {}).get("error_estimate_max", 0.0))
        return all((made <= allowed).all() for made, allowed in (
            balance(case.scene, one, error, *axis)
            for one, axis in zip(case.scene.environments, zip(*columns, strict=True), strict=True)))

    assert failing(cases, holds) == []


def test_a_handle_that_a_hand_holds_still_takes_in_what_the_stack_gives_it(cases: list[Case]) -> None:
    """From rest in the hand's spring: what is stored more is at most what -f_m did, friction and shunt only take."""

    def holds(case: Case) -> bool:
        scene, row = case.scene, case.row
        if scene.hand and row["reference"] != "rest":
            return True
        x, v, f = case.axes("x_m", "v_m", "f_m")
        k, m = (row["k_h"], row["M_m"] + row["m_h"]) if scene.hand else (0.0, row["M_m"])
        y = x - (np.array(scene.hand.reference.samples(scene.axes, 1, 1)).T if scene.hand else 0.0)
        stored = 0.5 * m * v**2 + 0.5 * k * y**2
        work = np.cumsum(f[:-1] * np.diff(x, axis=0), axis=0)
        error = np.float64(integrated(case).get("master", {}).get("error_estimate_max", 0.0))
        push = k * np.abs(y) + np.abs(f) + m * np.abs(v) / scene.dt + scene.master.friction
        pushed = np.maximum.accumulate(push, axis=0)
        off = 3.0 * error + 8.0 * EPS * (np.abs(x) + np.abs(y))
        allowed = np.cumsum(off * pushed + m * (3.0 * error / scene.dt) ** 2, axis=0)
        passed = np.maximum.accumulate(stored[1:] + np.abs(work), axis=0)
        allowed = allowed[1:] + k * (3.0 * error) ** 2 + 1e-12 * passed
        known = np.isfinite(work + stored[1:] + allowed)
        return bool((stored[1:] - stored[0] + work <= allowed + 1e-12 * stored[0])[known].all())

    assert failing(cases, holds) == []


def same(one: Result, other: Result) -> bool:
    """The same status, sentence, figures, packets and bits."""
    bits = all(one.trace[name].tobytes() == column.tobytes() for name, column in other.trace.items())
    return bits and one.trace.keys() == other.trace.keys() and one.summary() == other.summary()


def test_the_same_seed_gives_the_same_bits(cases: list[Case]) -> None:
    some = [case for case in cases if case.seed % 3 == 0 or case.result.status == "diverged"]
    assert failing(some, lambda case: same(case.result, run(case.scene, seed=case.seed))) == []


def on_an_edge(case: Case) -> bool:
    """Would the mirror image of some position be read as another step?"""
    device = case.scene.device_m
    if device.encoder is None:
        return False
    step, phase = device.encoder.step, device.encoder.phase
    ends = ["x_m", "x_s"] if case.scene.slave else ["x_m"]
    places = np.concatenate([column.ravel() for column in case.axes(*ends)])
    return phase != 0.5 or any(
        floor(x / step + phase) != -floor(-x / step + phase) for x in places.tolist() if isfinite(x / step))


def test_the_mirror_image_of_a_scene_runs_as_the_mirror_image(cases: list[Case]) -> None:
    """Every position, velocity and force is the other way round and nothing else changes, to the bit."""

    def holds(case: Case) -> bool:
        got = run(scene_of(case.row, mirror=-1.0), seed=case.seed)
        turned = {name: -1.0 if name.startswith(("x_", "v_", "f_", "q_")) else 1.0 for name in got.trace}
        sentence = got.sentence.replace("Turned.", f"{type(case.scene.law).__name__}.")  # the law's own name is told
        return sentence == case.result.sentence and got.extra == case.result.extra and all(
            np.array_equal(turned[name] * column, case.result.trace[name], equal_nan=True)
            for name, column in got.trace.items()
        )

    assert failing([case for case in cases if not on_an_edge(case)], holds) == []
