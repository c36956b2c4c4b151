"""The extreme matrix: stiff, light, heavy, slow and lossy scenes at once, and what holds for every one of them."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import combinations, product
from math import hypot, inf, isfinite
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from channel.delay import Delay
from master.hand import Grip, Rest
from slave.tissue import Tissue
from slave.wall import Wall
from teleop import load_result
from teleop.laws.direct import Direct
from teleop.laws.wave import Wave
from teleop.physics.plant import MassDamper
from teleop.scene.playout import repeats
from teleop.scene.scene import Scene
from teleop.simulation.result import Result
from teleop.simulation.virtual import run
from teleop.stages.force_cap import LONGEST
from teleop.terminal.run_table import table
from tests.teleop.simulation.extremes import CHOICES, RANGES, TICKS, Case, failing, lines_kept, rows, scene_of, tried

EPS = float(np.finfo(float).eps)


@pytest.fixture(scope="module")
def tries() -> Iterator[list[Case]]:
    """Every row of the matrix."""
    with lines_kept():
        yield [tried(seed, row) for seed, row in enumerate(rows())]


@pytest.fixture
def cases(tries: list[Case]) -> list[Case]:
    """Those that came to a result."""
    return [case for case in tries if case.result]


# -- the matrix itself


def test_the_matrix_has_all_corners_of_all_pairs_of_knobs_and_all_pairs_of_choices() -> None:
    matrix = rows()
    assert len(matrix) >= 500
    corners = {(a, b): {(row[a], row[b]) for row in matrix} for a, b in combinations(RANGES, 2)}
    for (a, b), seen in corners.items():
        ends = [(0.0 if RANGES[name].zero else RANGES[name].low, RANGES[name].high) for name in (a, b)]
        assert seen.issuperset(product(*ends)), (a, b)
    for a, b in combinations(CHOICES, 2):
        pairs = {(str(row[a]), str(row[b])) for row in matrix}
        assert pairs == {(str(x), str(y)) for x, y in product(CHOICES[a], CHOICES[b])}, (a, b)


def test_the_matrix_is_not_idle(cases: list[Case]) -> None:
    """Runs end both ways, walls are struck, messages are played, waves are stored and guards step in."""
    seen: Counter[str] = Counter()
    for case in cases:
        got, trace = case.result, case.result.trace
        finite = all(np.isfinite(column).all() for column in trace.values())
        played = case.scene.link is None or min(got.metrics["fresh_fwd"], got.metrics["fresh_bwd"]) > 0.2
        struck = case.row["environment"] == "wall" and got.metrics.get("f_env_max", 0.0) > 0.0
        for name, is_so in {
            got.status: True, f"{case.row['law']} played": played, f"{case.row['law']} overflowed": not finite,
            "struck": struck, "struck while messages came": struck and played, "chattered": bool(got.notes)
            and "contact events" in got.notes[0], "claimed": claimed(case) and played and trace["E_link"].max() > 0.0,
            "let go": got.metrics.get("g_s_min", 1.0) < 1.0, "nothing came": got.packets["fwd"].received == 0,
        }.items():
            seen[name] += is_so
    least = {
        "ok": 400, "diverged": 40, "wave played": 120, "pfra played": 40, "direct played": 40, "wave overflowed": 1,
        "pfra overflowed": 1, "direct overflowed": 1, "struck": 120, "struck while messages came": 60, "chattered": 1,
        "claimed": 60, "let go": 60, "nothing came": 40,
    }
    assert {name: seen[name] for name, count in least.items() if seen[name] < count} == {}
    assert seen["ok"] + seen["diverged"] == len(cases)


# -- what holds for every row


def test_every_row_ends_in_a_declared_status_without_exception_or_warning(tries: list[Case]) -> None:
    assert failing(tries, lambda case: case.result is not None) == []


def test_a_run_that_is_ok_ran_to_its_end_and_one_that_diverged_says_when_and_what(cases: list[Case]) -> None:
    def holds(case: Case) -> bool:
        got = case.result
        if got.status != "diverged":
            return got.ticks == TICKS
        sound = {name: np.isfinite(column) for name, column in got.trace.items()}
        where, _, what = got.sentence.partition("): ")
        tick = int(where.rpartition("tick ")[2])
        if "is not finite" in what:
            before = all(column[:tick].all() for column in sound.values())
            return before and tick < got.ticks and not sound[what.split()[0]][tick].all()
        return tick == got.ticks - 1 and what.startswith(("x_m passed", "x_s passed"))

    assert failing(cases, holds) == []


def test_what_is_not_finite_is_found_only_in_runs_that_diverged(cases: list[Case]) -> None:
    def holds(case: Case) -> bool:
        got = case.result
        everywhere = all(np.isfinite(column).all() for column in got.trace.values())
        return all(map(np.isfinite, got.metrics.values())) and (everywhere or got.status == "diverged")

    assert failing(cases, holds) == []


def test_the_trace_has_one_row_a_tick_and_every_packet_is_accounted_for(cases: list[Case]) -> None:
    def holds(case: Case) -> bool:
        got = case.result
        clock = np.arange(got.ticks) * case.scene.dt_ns / 1e9
        whole = all(len(column) == got.ticks for column in got.trace.values())
        balance = all(p.sent == p.received + p.lost + p.in_flight for p in got.packets.values())
        return whole and balance and np.array_equal(got.trace["t"], clock)

    assert failing(cases, holds) == []


def claimed(case: Case) -> bool:
    """Does the law claim E_link here?"""
    return "E_link" in case.scene.law.claims and not (case.scene.link and repeats(case.scene.playout))


def test_the_link_stores_no_less_than_nothing_wherever_a_law_claims_it(cases: list[Case]) -> None:
    """E_link is a difference of four sums of at most TICKS squares: each sum is off by TICKS EPS of itself."""

    def holds(case: Case) -> bool:
        if not claimed(case):
            return True
        trace = case.result.trace
        sums = trace["E_in_fwd"] + trace["E_in_bwd"]
        known = np.isfinite(sums)  # up to where a run that diverges overflows
        least = min(case.result.metrics.get("E_fwd_min", 0.0), case.result.metrics.get("E_bwd_min", 0.0))
        rounding = 2.0 * TICKS * case.row["axes"] * EPS * sums[known]
        return bool((trace["E_link"][known] >= -rounding).all() and least >= -rounding.max(initial=0.0))

    assert failing(cases, holds) == []


def test_no_environment_gives_energy_and_no_wall_pulls(cases: list[Case]) -> None:
    """Work in is at least what is stored more and what the slave's damper took, at every tick.

    Stored is m v^2/2 + k p^2/2; a damper takes at least b dx^2/dt, which is what an even speed takes. A position is
    off by some EPS of itself and of the wall's place; a force works on that too.
    """

    def holds(case: Case) -> bool:
        columns = [column.T for column in case.axes("x_s", "v_s", "f_s", "f_env")]
        return all(passive(case.scene, *axis) for axis in zip(case.scene.environments, *columns, strict=True))

    assert failing(cases, holds) == []


def passive(scene: Scene, environment: Any, x: np.ndarray, v: np.ndarray, f: np.ndarray, f_env: np.ndarray) -> bool:
    """Does one axis of the slave keep its balance at every tick whose numbers are finite?"""
    k, at = (0.0, 0.0) if environment is None else (environment.k, environment.at)
    p = 0.0 * x if environment is None else x - at
    if isinstance(environment, Wall):
        p = np.maximum(environment.side * p, 0.0)
        if (environment.side * f_env < 0.0).any():
            return False
    m, b, f, dx = scene.slave.mass, scene.slave.damping, f[:-1], np.diff(x)
    stored = 0.5 * m * v * v + 0.5 * k * p * p
    off = 4.0 * EPS * (np.abs(x[:-1]) + np.abs(x[1:]) + abs(at))
    taken = b * np.maximum(np.abs(dx) - off, 0.0) ** 2 / scene.dt
    made = np.diff(stored) + taken - f * dx
    passed = stored[:-1] + stored[1:] + np.abs(f * dx) + (f * f / k if k else 0.0)  # f^2/k: swung through within a tick
    rounding = 1e-12 * passed + (np.abs(f) + k * (np.abs(p[:-1]) + np.abs(p[1:]) + off)) * off
    known = np.isfinite(made) & np.isfinite(rounding)
    return bool((made <= rounding)[known].all())


def test_guards_guard(cases: list[Case]) -> None:
    """|f| and its change stay within the cap, the watchdog's gain in 0 to 1; after 1 s at 0 there is no force."""

    def holds(case: Case) -> bool:
        trace, cap = case.result.trace, case.scene.cap
        good = all(((trace[g] >= 0.0) & (trace[g] <= 1.0)).all() for g in ("g_m", "g_s") if g in trace)
        for e, f in zip("ms", case.axes("f_m", "f_s") if cap else [], strict=False):
            finite = np.isfinite(f).all(axis=1)
            known = f[finite]
            steps = np.abs(np.diff(known, axis=0, prepend=0.0))
            late = let_go_for(trace, e, f)[finite] > LONGEST / case.scene.dt + 1.0
            good = good and not known[late].any()
            slewed = cap.slew is None or (steps[~late] <= cap.slew * case.scene.dt + 4.0 * EPS * cap.f_max).all()
            good = good and bool((np.abs(known) <= cap.f_max).all()) and bool(slewed)
        return good

    assert failing(cases, holds) == []


def let_go_for(trace: Mapping[str, np.ndarray], e: str, f: np.ndarray) -> np.ndarray:
    """Ticks for which the watchdog's gain of the end `e` has been 0."""
    ticks = np.arange(len(f))
    return ticks - np.maximum.accumulate(np.where(trace[f"g_{e}"] > 0.0, ticks, -1)) if f"g_{e}" in trace else 0 * ticks


def test_projected_force_is_never_above_the_hands_and_moves_nobody(cases: list[Case]) -> None:
    """PFRA with alpha = 0: |f_m| <= |f_h|; a master at rest that no hand has held stays where it is, to the bit."""

    def holds(case: Case) -> bool:
        if case.row["law"] != "pfra" or case.row["alpha"] or case.scene.cap:
            return True
        f_m, x_m, hand = case.axes("f_m", "x_m", "f_h_hat" if case.scene.observer else "f_h")
        f_m, hand = (np.hypot.reduce(f, axis=1) for f in (f_m, hand))
        still = bool(case.scene.hand) or np.array_equal(x_m, np.broadcast_to(x_m[0], x_m.shape))
        return still and bool((f_m <= hand * (1.0 + 8.0 * EPS))[np.isfinite(hand)].all())

    assert failing(cases, holds) == []


def same(one: Result, other: Result) -> bool:
    """The same status, sentence, figures, packets and bits."""
    bits = all(one.trace[name].tobytes() == column.tobytes() for name, column in other.trace.items())
    return bits and one.trace.keys() == other.trace.keys() and one.summary() == other.summary()


def test_the_same_seed_gives_the_same_bits(cases: list[Case]) -> None:
    """Of a third and of those that diverged; all that is drawn is drawn again for the mirror image of every row."""
    some = [case for case in cases if case.seed % 3 == 0 or case.result.status == "diverged"]
    assert failing(some, lambda case: same(case.result, run(case.scene, seed=case.seed))) == []


def test_the_mirror_image_of_a_scene_runs_as_the_mirror_image(cases: list[Case]) -> None:
    """Every position, velocity and force is the other way round and nothing else changes, to the bit."""

    def holds(case: Case) -> bool:
        got = run(scene_of(case.row, mirror=-1.0), seed=case.seed)
        turned = {name: -1.0 if name.startswith(("x_", "v_", "f_")) else 1.0 for name in got.trace}
        told = got.sentence == case.result.sentence and got.packets == case.result.packets
        return told and got.ticks == case.result.ticks and all(
            np.array_equal(turned[name] * column, case.result.trace[name], equal_nan=True)
            for name, column in got.trace.items()
        )

    assert failing(cases, holds) == []


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
