"""The extreme matrices: stiff, light, heavy, slow and lossy scenes at once, and what holds for every one of them.

The ordinary suite runs every eleventh row, `-m full` all of them. The four corners of each pair of knobs stand
one after the other, so an odd stride meets all four kinds. Then scenes that run away, whatever they run into.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import combinations, product
from math import floor, hypot, inf, isfinite
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from channel.delay import Delay
from master.hand import Grip, Rest
from slave import HuntCrossley, Moving, StandardLinearSolid, Tissue, Wall
from teleop import PFRA, Device, Direct, Encoder, MassDamper, Result, Scene, Wave, load_result, run
from teleop.laws.virtual_coupling import VirtualCoupling
from teleop.physics.relaxing import ElectricalDamping
from teleop.physics.sdirk import MOST_SUBSTEPS
from teleop.scene.playout import repeats
from teleop.stages.force_cap import LONGEST
from teleop.stages.passivity_controller import PassivityController
from teleop.stages.velocity.adaptive_window import BestFit
from teleop.stages.velocity.backward_difference import BackwardDifference
from teleop.stages.velocity.levant import Levant
from teleop.stages.velocity.low_pass import LowPass
from teleop.terminal.run_table import table
from tests.fakes import OneSpring
from tests.teleop.simulation.extremes import (
    EPS,
    FAMILIES,
    Case,
    balance,
    failing,
    made,
    rows,
    scene_of,
    ticks_of,
    tried,
)

MATRICES = {"two ends": ("ends",), "bodies and devices": ("plants", "displays")}
ELEVENTH = 11


@pytest.fixture(scope="module", params=[
    pytest.param((name, stride), id=f"{name}, {'all' if stride == 1 else 'an eleventh'}",
                 marks=[pytest.mark.full] * (stride == 1)) for stride in (ELEVENTH, 1) for name in MATRICES])
def tries(request: pytest.FixtureRequest) -> list[Case]:
    """The rows of a matrix, whatever came of them."""
    name, stride = request.param
    return made(MATRICES[name], stride)


@pytest.fixture
def cases(tries: list[Case]) -> list[Case]:
    """Those that came to a result."""
    return [case for case in tries if case.result]


def is_beyond(case: Case) -> bool:
    """True if it is of the second matrix."""
    return case.row["family"] != "ends"


# -- the matrices themselves


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.full] * (name == "ends")) for name in FAMILIES])
def test_a_matrix_has_the_corners_of_the_pairs_of_knobs_and_all_pairs_of_choices(name: str) -> None:
    family, matrix = FAMILIES[name], rows(name)
    for a, b in family.pairs:
        ends = [(0.0 if r.zero else r.low, r.high) for r in (family.ranges[a], family.ranges[b])]
        assert {(row[a], row[b]) for row in matrix if row["pinned"].keys() == {a, b}} == set(product(*ends)), (a, b)
    assert len(matrix) >= 200
    asked_for = {"environment", "law", "passivity", "velocity", "electrical"} if name != "ends" else set()  # by knobs
    for a, b in combinations(family.choices, 2):
        if not asked_for & {a, b}:
            pairs = {(str(row[a]), str(row[b])) for row in matrix}
            assert pairs == {(str(x), str(y)) for x, y in product(family.choices[a], family.choices[b])}, (a, b)
    for choice, values in family.choices.items():
        assert {str(row[choice]) for row in matrix} == set(map(str, values)), choice


def acts_at_two_ends(case: Case) -> dict[str, Any]:
    """What happened in a row of the first matrix: contact, messages, waves stored, guards."""
    got, trace = case.result, case.result.trace
    finite = all(np.isfinite(column).all() for column in trace.values())
    played = case.scene.link is None or min(got.metrics["fresh_fwd"], got.metrics["fresh_bwd"]) > 0.2
    struck = case.row["environment"] == "wall" and got.metrics.get("f_env_max", 0.0) > 0.0
    return {
        got.status: True, f"{case.row['law']} played": played, f"{case.row['law']} overflowed": not finite,
        "struck": struck, "struck while messages came": struck and played, "chattered": bool(got.notes)
        and "contact events" in got.notes[0], "claimed": claimed(case) and played and trace["E_link"].max() > 0.0,
        "let go": got.metrics.get("g_s_min", 1.0) < 1.0, "nothing came": got.packets["fwd"].received == 0,
    }


def acts_beyond(case: Case) -> dict[str, Any]:
    """What happened in a row of the second: bodies stick, slide and are carried; controllers, encoders and caps act."""
    got, trace, row, report = case.result, case.result.trace, case.row, integrated(case)
    still_m, still_s = (
        trace[v].reshape(got.ticks, -1)[2:, 0] == 0.0 for v in ("v_m", "v_s" if "v_s" in trace else "v_m"))
    observed = trace.get("E_po", np.zeros(1))
    touched = got.metrics.get("f_env_max", 0.0) > 0.0
    return {
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
    }


LEAST = ({
    "ok": 400, "diverged": 40, "wave played": 120, "pfra played": 40, "direct played": 40, "wave overflowed": 1,
    "pfra overflowed": 1, "direct overflowed": 1, "struck": 120, "struck while messages came": 60, "chattered": 1,
    "claimed": 60, "let go": 60, "nothing came": 40,
}, {
    "ok": 400, "diverged": 15, "overflowed": 3, "sub-steps": 80, "all sub-steps": 40, "within the tolerance": 40,
    "slave slips": 25, "master slips": 15, "controller acts": 40, "encoder turns": 150, "capped": 80,
    "electrical": 60, "wave acts": 60, "pfra acts": 25, "direct acts": 25, "wall acts": 30, "coupling acts": 40,
    "claimed": 50, "hunt crossley touched": 40, "relaxing touched": 30, "wall touched": 25, "tissue touched": 25,
    "struck by what moves": 100, "turned": 180, "let go": 5,
})


@pytest.mark.full
def test_the_matrix_is_not_idle(tries: list[Case], cases: list[Case]) -> None:
    seen: Counter[str] = Counter()
    for case in cases:
        for name, is_so in (acts_beyond if is_beyond(case) else acts_at_two_ends)(case).items():
            seen[name] += bool(is_so)
    share = 1 if tries[1].seed == 1 else 2 * ELEVENTH
    least = LEAST[is_beyond(cases[0])]
    assert {name: seen[name] for name, count in least.items() if seen[name] < count // share} == {}
    if not is_beyond(cases[0]):
        assert seen["ok"] + seen["diverged"] == len(cases)


# -- what holds for every row


def test_every_row_ends_in_a_declared_status_without_exception_or_warning(tries: list[Case]) -> None:
    assert failing(tries, lambda case: case.result is not None and case.result.status in (
        "ok", "limit cycle", "unstable", "diverged")) == []


def ends_as_it_says(case: Case) -> bool:
    """A run that is ok ran to its end, one that diverged says when and what; nothing else is not finite."""
    got = case.result
    sound = {name: np.isfinite(column) for name, column in got.trace.items()}
    everywhere = all(column.all() for column in sound.values())
    if not all(map(np.isfinite, got.metrics.values())):
        return False
    if got.status != "diverged":
        return got.ticks == ticks_of(case.row) and everywhere
    where, _, what = got.sentence.partition("): ")
    tick = int(where.rpartition("tick ")[2])
    if "is not finite" in what:
        before = all(column[:tick].all() for column in sound.values())
        return before and tick < got.ticks and not sound[what.split()[0]][tick].all()
    return tick == got.ticks - 1 and what.startswith(("x_m passed", "x_s passed")) and (
        everywhere or not is_beyond(case))


def is_accounted_for(case: Case) -> bool:
    """The trace has one row a tick, and every packet is somewhere."""
    got = case.result
    clock = np.arange(got.ticks) * case.scene.dt_ns / 1e9
    whole = all(len(column) == got.ticks for column in got.trace.values())
    balanced = all(p.sent == p.received + p.lost + p.in_flight for p in got.packets.values())
    return whole and balanced and np.array_equal(got.trace["t"], clock)


def claimed(case: Case) -> bool:
    """True if the law claims E_link here."""
    return "E_link" in case.scene.law.claims and not (case.scene.link and repeats(case.scene.playout))


def stores_no_less_than_nothing(case: Case) -> bool:
    """E_link is a difference of four sums of as many squares as ticks: each is off by that many EPS of itself."""
    if not claimed(case):
        return True
    trace = case.result.trace
    sums = trace["E_in_fwd"] + trace["E_in_bwd"]
    known = np.isfinite(sums)  # up to where a run that diverges overflows
    least = min(case.result.metrics.get("E_fwd_min", 0.0), case.result.metrics.get("E_bwd_min", 0.0))
    rounding = 2.0 * case.result.ticks * case.row["axes"] * EPS * sums[known]
    return bool((trace["E_link"][known] >= -rounding).all()
                and (is_beyond(case) or least >= -rounding.max(initial=0.0)))


def is_guarded(case: Case) -> bool:
    """|f| and its change stay within the cap, the watchdog's gain in 0 to 1; after 1 s at 0 there is no force."""
    trace, cap = case.result.trace, case.scene.cap
    good = all(((trace[g] >= 0.0) & (trace[g] <= 1.0)).all() for g in ("g_m", "g_s") if g in trace)
    for e in ("ms" if case.scene.slave else "m") if cap else "":
        f, = case.axes(f"f_{e}")
        finite = np.isfinite(f).all(axis=1)
        known = f[finite]
        steps = np.abs(np.diff(known, axis=0, prepend=0.0))
        late = let_go_for(trace, e, f)[finite] > LONGEST / case.scene.dt + 1.0
        good = good and not known[late].any()
        slewed = cap.slew is None or (steps[~late] <= cap.slew * case.scene.dt + 4.0 * EPS * cap.f_max).all()
        good = good and bool((np.abs(known) <= cap.f_max).all()) and bool(slewed)
    return good


def let_go_for(trace: Mapping[str, np.ndarray], e: str, f: np.ndarray) -> np.ndarray:
    """Ticks for which the watchdog's gain of the end `e` has been 0."""
    ticks = np.arange(len(f))
    return ticks - np.maximum.accumulate(np.where(trace[f"g_{e}"] > 0.0, ticks, -1)) if f"g_{e}" in trace else 0 * ticks


def projects_within_the_hand(case: Case) -> bool:
    """PFRA with alpha = 0: |f_m| <= |f_h|; a master at rest that no hand has held stays where it is, to the bit."""
    law = case.scene.law
    if not isinstance(law, PFRA) or law.alpha or case.scene.cap:
        return True
    f_m, x_m, hand = case.axes("f_m", "x_m", "f_h_hat" if case.scene.observer else "f_h")
    f_m, hand = (np.hypot.reduce(f, axis=1) for f in (f_m, hand))
    still = bool(case.scene.hand) or np.array_equal(x_m, np.broadcast_to(x_m[0], x_m.shape))
    return still and bool((f_m <= hand * (1.0 + 8.0 * EPS))[np.isfinite(hand)].all())


def sums_the_readings(case: Case) -> bool:
    """E_po(k) = E_po(k-1) + f_m(k-1)(q(k) - q(k-1)), to the bit."""
    if case.scene.passivity is None:
        return True
    f, q, observed = case.axes("f_m", "q_m" if case.device.encoder else "x_m", "E_po")
    work = np.zeros_like(f)
    work[1:] = f[:-1] * np.diff(q, axis=0)
    return np.array_equal(np.cumsum(work, axis=0), observed, equal_nan=True)


def reads_whole_steps(case: Case) -> bool:
    """Readings are whole steps beside where the device is."""
    encoder = case.device.encoder
    if encoder is None:
        return True
    x, q = case.axes("x_m", "q_m")
    off = (q - x) / encoder.step - encoder.phase
    rounding = 4.0 * EPS * (1.0 + np.abs(x) / encoder.step)
    known = np.isfinite(x)
    return bool(((off >= -1.0 - rounding) & (off <= rounding))[known].all())


def rests_in_between(case: Case) -> bool:
    """A force that is renewed every nth tick rests in between."""
    device, f = case.device, case.axes("f_m")[0]
    late = (f[: device.delay] == 0.0).all() or case.scene.passivity is not None
    if case.scene.passivity is not None or device.every == 1:
        return bool(late)
    held = f[np.arange(len(f)) // device.every * device.every]
    return bool(late) and np.array_equal(f, held, equal_nan=True)


def integrated(case: Case) -> dict[str, dict[str, float]]:
    """Report of the integration by end; {} if there is none."""
    return case.result.extra.get("integration", {})


def reports_its_integration(case: Case) -> bool:
    """The report is there for a body that rubs and for a soft one, and counts the ticks that missed the tolerance."""
    row, report = case.row, integrated(case)
    soft = row.get("f_s", 0.0) > 0.0 or row.get("environment") == "hunt crossley"
    ends = [end for end, has in (("master", case.scene.master.friction > 0.0), ("slave", soft)) if has]
    return list(report) == ends and all(
        all(map(isfinite, said.values())) and said["tolerance"] == case.scene.tolerance
        and (said["ticks_over_tolerance"] > 0) >= (said["error_estimate_max"] > case.scene.tolerance)
        and (said["ticks_over_tolerance"] == 0 or case.result.status == "diverged"
             or said["error_estimate_max"] > case.scene.tolerance)
        for said in report.values())


def makes_no_energy(case: Case) -> bool:
    """At every tick a slave stores at most the force's work more, less what damper and friction took for sure.

    With nobody at it and no force that is: friction, dampers and soft bodies only take. In the frame of what it
    touches, which within a tick moves evenly; friction with the ground works on that frame too.
    """
    if case.scene.slave is None:
        return True
    columns = [column.T for column in case.axes("x_s", "v_s", "f_s", "f_env")]
    error = np.float64(integrated(case).get("slave", {}).get("error_estimate_max", 0.0))
    return all((made <= allowed).all() for made, allowed in (
        balance(case.scene, one, error, *axis)
        for one, axis in zip(case.scene.environments, zip(*columns, strict=True), strict=True)))


def takes_in_what_it_is_given(case: Case) -> bool:
    """A handle that a hand holds still: from rest, what is stored more is at most what -f_m did."""
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


HOLD: tuple[Callable[[Case], bool], ...] = (
    ends_as_it_says, is_accounted_for, stores_no_less_than_nothing, is_guarded, projects_within_the_hand,
    sums_the_readings, reads_whole_steps, rests_in_between, reports_its_integration, makes_no_energy,
    takes_in_what_it_is_given)


@pytest.mark.parametrize("holds", HOLD, ids=lambda holds: holds.__name__)
def test_holds_for_every_row(cases: list[Case], holds: Callable[[Case], bool]) -> None:
    assert failing(cases, holds) == []


def same(one: Result, other: Result) -> bool:
    """True of the same status, sentence, figures, packets and bits."""
    bits = all(one.trace[name].tobytes() == column.tobytes() for name, column in other.trace.items())
    return bits and one.trace.keys() == other.trace.keys() and one.summary() == other.summary()


def test_the_same_seed_gives_the_same_bits(cases: list[Case]) -> None:
    """Of a third and of those that diverged; all that is drawn is drawn again for the mirror image of every row."""
    some = [case for case in cases if case.seed % 3 == 0 or case.result.status == "diverged"]
    assert failing(some, lambda case: same(case.result, run(case.scene, seed=case.seed))) == []


def on_an_edge(case: Case) -> bool:
    """True if the mirror image of some position would be read as another step."""
    device = case.device
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
        return (sentence, got.extra, got.packets, got.ticks) == (
            case.result.sentence, case.result.extra, case.result.packets, case.result.ticks) and all(
            np.array_equal(turned[name] * column, case.result.trace[name], equal_nan=True)
            for name, column in got.trace.items())

    assert failing([case for case in cases if not on_an_edge(case)], holds) == []


def test_what_a_diverged_run_leaves_can_be_read_again(cases: list[Case], tmp_path: Path) -> None:
    def holds(case: Case) -> bool:
        saved = case.result.save(tmp_path / str(case.seed))
        back = load_result(saved.path)
        bits = all(np.array_equal(back.trace[n], a, equal_nan=True) for n, a in saved.trace.items())
        return bits and back.metrics == saved.metrics and table(back) == table(saved)

    assert failing([case for case in cases if case.result.status == "diverged"], holds) == []


# -- what used to break


def runaway(ticks: int, **other: Any) -> Result:
    """A light master and slave on a coupling far too stiff for their tick, with bounds beyond every square root."""
    body = MassDamper(mass=1e-4)
    hand = Grip(mass=0.0, k=200.0, d=0.0, reference=Rest(at=0.1))
    scene = Scene(**{
        "law": Direct(K=1e6, B=0.0), "master": body, "slave": body, "hand": hand, "environment": Tissue(k=1e3, d=0.0),
        "energy": True, "dt": 0.1, "duration": 0.1 * ticks, "x_limit": 1e300, **other,
    })
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return run(scene)


def test_the_size_of_a_force_in_three_axes_was_lost_where_its_square_overflows() -> None:
    got = runaway(1000, axes=3, hand=None, start_m=(0.1, 0.2, 0.2), environment=None)
    assert got.status == "diverged"
    greatest = max(hypot(*row) for row in got.trace["f_s"].tolist())
    assert 1e160 < greatest < inf
    assert got.metrics["f_s_max"] == pytest.approx(greatest, rel=1e-14)


def test_the_ledger_of_a_run_whose_waves_overflow_warned_of_infinity_less_infinity() -> None:
    got = runaway(1000, law=Wave(b=1e6), link=Delay(0.0))
    assert got.status == "diverged"
    assert np.isnan(got.trace["E_link"][-1])
    assert not got.metrics.keys() & {"E_link_min", "E_link_end"}


def test_a_run_whose_ledger_overflowed_before_its_positions_passed_for_ok() -> None:
    tick = next(k for k, work in enumerate(runaway(1000).trace["E_port"]) if not isfinite(work))
    got = runaway(tick + 1)
    assert got.ticks == tick + 1  # to its end, and within its bounds
    assert got.status == "diverged"
    assert f"(tick {tick}): E_port" in got.sentence
    assert runaway(tick).status == "ok"


def test_the_table_of_a_run_that_has_a_smallest_energy_but_none_at_its_end_could_not_be_printed() -> None:
    got = replace(runaway(5), metrics={"E_link_min": -1e-3})
    assert "-1.00 mJ smallest\n" in table(got) + "\n"
    assert "link energy" not in table(replace(got, metrics={}))


HAND = Grip(mass=0.1, k=100.0, d=0.0, reference=Rest(at=0.2))
MET = {
    "nothing": None, "wall": Wall(k=1e9, d=1e3), "tissue": Tissue(k=1e-6, d=0.0), "Hertz": HuntCrossley(k=1e9),
    "a soft body": HuntCrossley(k=1.0, n=10.0, lam=1e3), "relaxing": StandardLinearSolid(k=1.0, k1=1e3, tau=1e-3),
    "carried": Moving(environment=HuntCrossley(k=1.0, n=3.0), path=Rest(at=0.1)),
}


def diverged(**parts: Any) -> Case:
    """A light handle, in ticks far too long for what it is on, with bounds beyond every square root."""
    case = tried(0, {}, Scene(**{
        "master": MassDamper(mass=1e-4), "energy": True, "dt": 0.1, "duration": 12.0, "x_limit": 1e300,
        "start_m": 0.1, "passivity": PassivityController(cap=1e3), **parts,
    }))
    assert case.trouble == "", parts
    assert case.result.status == "diverged", parts
    return case


@pytest.mark.full
def test_a_runaway_of_a_slave_ends_with_a_report_of_the_ticks_that_missed_the_tolerance() -> None:
    device = Device(encoder=Encoder(step=1e-3), velocity=Levant(L=1.0))
    for name, friction in product(MET, (0.0, 1.0)):
        if name == "relaxing" and friction:
            continue  # which is refused
        body = MassDamper(mass=1e-4, friction=friction)
        case = diverged(law=Direct(K=1e6, B=0.0), master=body, slave=body, environment=MET[name], hand=HAND,
                        device_m=device, device_s=device)
        soft = friction > 0.0 or name in ("Hertz", "a soft body", "carried")
        report = case.result.extra.get("integration", {})
        assert list(report) == ["master"] * (friction > 0.0) + ["slave"] * soft, (name, friction)
        assert all(said["ticks_over_tolerance"] > 0 for said in report.values()), (name, friction)


@pytest.mark.parametrize("law", [OneSpring(K=1e6, B=1e6), VirtualCoupling(K=1e6, B=1.0, theta_f=0.0, theta_x=0.0)])
def test_a_runaway_of_a_handle_ends_whatever_its_device_and_law(law: Any) -> None:
    parts: tuple[dict[str, Any], ...] = (
        {}, {"electrical": ElectricalDamping(b=1.0, cutoff=1.0)}, {"hand": HAND},
        {"master": MassDamper(mass=1e-4, friction=1.0), "hand": HAND})
    for velocity, other in product((None, BackwardDifference(), LowPass(), Levant(L=1.0), BestFit(noise=1e-3)), parts):
        diverged(law=law, device_m=Device(encoder=Encoder(step=1e-12), velocity=velocity), **other)
