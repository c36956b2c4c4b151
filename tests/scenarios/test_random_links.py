"""Every law that claims E_link keeps it over links drawn at random, in scenes drawn at random, at every tick.

A claim of E_link is one for playouts that play a message at most once and nothing in the gaps, or waves within the
energy that was sent. The law's numbers, the scene's, its playout, delay, jitter, loss, order, copies and blackouts, all
from nothing to absurd, come from one seed.
"""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from channel.link import EFFECTS
from teleop import Energy, Fixed, Integral, find_law, load_scene, run
from teleop.law import known_laws
from teleop.sweeps.chunk import Job, work
from tests.scenarios import random_links
from tests.scenarios.random_links import bases, drawn, held, integrated, late, makers, record

LOW = -1e-9  # J: below is more than rounding
TICKS = 600
FEW, MANY = 80, 10_000
AT_ONCE = 500  # rows whose schedules are in memory together
FIGURES = ("E_link_min", "E_link_end", "fresh_fwd", "fresh_bwd", "f_env_max")
DRAWN = EFFECTS.keys() - {"recorded"}  # which is a folder of a live run: tests/channel/test_recordings.py
CLAIMING = [name for name in known_laws() if "E_link" in getattr(find_law(name)(), "claims", ())]

Rows = list[tuple[int, dict[str, Any], int]]  # number, knobs, seed


class Drawn(NamedTuple):
    """Rows, and what the engine that sweeps use made of each."""

    rows: Rows
    came: list[dict[str, Any]]


def swept(rows: Rows) -> list[dict[str, Any]]:
    """What each row came to."""
    parts = [rows[first:first + AT_ONCE] for first in range(0, len(rows), AT_ONCE)]
    done = [work(Job(random_links.__file__, {}, part, FIGURES, "plain")).rows for part in parts]
    return [row for part in done for row in part]


def many(name: str, count: int, folder: Path) -> Drawn:
    """`count` random rows of a law and what they came to."""
    rows = rows_of(name, count, folder)
    return Drawn(rows, swept(rows))


def rows_of(name: str, count: int, folder: Path) -> Rows:
    """`count` random rows of a law over the scenes in turn; the first are the same, however many there are."""
    dice = np.random.default_rng(1)
    files = record(folder, dice)
    return [(n, {**drawn(find_law(name)(), dice, TICKS, files), "base": bases()[n % len(bases())]},
             int(dice.integers(2**63))) for n in range(count)]


def by_integral(rows: Rows) -> Drawn:
    """The same rows with waves that are played by their integral."""
    dice = np.random.default_rng(2)
    played = [(n, integrated(knobs, dice), seed) for n, knobs, seed in rows]
    return Drawn(played, swept(played))


def active(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows that took more from the link than they put in, those of the shortest links first. NaN is one of them."""
    return sorted((row for row in rows if not row.get("E_link_min", np.nan) >= LOW), key=lambda row: len(row["link"]))


def effects(rows: Rows) -> Counter[str]:
    """In how many of the links each effect is."""
    return Counter(name for _, knobs, _ in rows for name in set(re.findall(r"(\w+)\(", knobs["link"])))


@pytest.fixture(scope="module", params=[
    name if name == "wave" else pytest.param(name, marks=pytest.mark.full) for name in CLAIMING])
def few(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Drawn:
    """The links of the ordinary suite, of every law that claims."""
    return many(request.param, FEW, tmp_path_factory.mktemp("recordings"))


def test_some_law_claims_and_every_effect_is_drawn() -> None:
    assert "wave" in CLAIMING
    assert makers(1.0, 1e-3, {}).keys() == DRAWN


def test_no_random_link_gives_more_than_it_got(few: Drawn) -> None:
    assert active(few.came)[:3] == []


def test_the_rows_are_runs_in_which_energy_goes_through_the_link(few: Drawn) -> None:
    """Those that nothing gets through are among them, and everything is there that may be drawn.

    Where a hand waits in contact, gaps that come at random may shake it to the end by as much as is felt.
    """
    ended = Counter(row["status"] for row in few.came)
    assert ended.keys() <= {"ok", "limit cycle", "diverged"}
    assert ended["limit cycle"] < 0.02 * FEW
    lively = [row for row in few.came if min(row["fresh_fwd"], row["fresh_bwd"]) > 0.1 and row["E_link_end"] > 1e-6]
    assert len(lively) > 0.4 * FEW
    assert sum(row["f_env_max"] > 0.0 for row in lively) > 0.2 * FEW
    assert sum(row["fresh_fwd"] == 0.0 for row in few.came) > 0.02 * FEW
    assert min(effects(few.rows)[name] for name in DRAWN) > 0.15 * FEW
    for knob, values in {"base": set(bases()), "axes": {1, 3}, "motion": {*random_links.MOTIONS}}.items():
        assert {knobs[knob] for _, knobs, _ in few.rows} == values


def test_the_smallest_is_that_of_the_whole_record_and_no_way_gave_more_than_its_stamps(few: Drawn) -> None:
    for n, knobs, seed in few.rows[::15]:
        got = run(load_scene(random_links.__file__, **knobs), seed=seed)
        assert got.trace["E_link"].min() == few.came[n]["E_link_min"], knobs
        assert min(got.metrics.get("E_fwd_min", 0.0), got.metrics.get("E_bwd_min", 0.0)) >= LOW, knobs


@pytest.mark.full
def test_over_the_same_links_messages_that_are_held_in_the_gaps_make_energy(few: Drawn) -> None:
    """What nobody claims: the links and motions are such that a wave played twice shows."""
    rows = [(n, held(knobs), seed) for n, knobs, seed in few.rows]
    made = [row["E_link_min"] for row in active(swept(rows))]
    assert len(made) >= 6
    assert min(made) < -0.01


def test_waves_by_their_integral_give_no_more_than_they_got_and_get_more_through(few: Drawn) -> None:
    """Whatever the queue, with and without a fixed delay."""
    played = by_integral(few.rows)
    assert active(played.came)[:3] == []
    assert {type(knobs["playout"]) for _, knobs, _ in played.rows} == {Integral, Energy, Fixed}
    kept, lost = [[row["E_link_end"] for row in came] for came in (played.came, few.came)]
    assert sum(own < other for own, other in zip(kept, lost, strict=True)) > FEW // 2  # J: less ends in gaps


def overdrafts(rows: Rows) -> list[tuple[float, dict[str, Any]]]:
    """By how much each row's E_link passes what was held over one wait each way, with ticks left out, J."""
    dice, found = np.random.default_rng(3), []
    for _, knobs, seed in rows:
        row = late(integrated(knobs, dice), dice)
        trace = run(load_scene(random_links.__file__, **row), seed=seed).trace
        waits = sum(np.diff(trace[f"E_out_{way}"], prepend=0.0).max() for way in ("fwd", "bwd"))
        found.append((float(-trace["E_link"].min() - waits), row))
    return found


@pytest.mark.full
def test_where_ticks_are_left_out_no_more_is_owed_than_was_held_over_one_wait_each_way(few: Drawn) -> None:
    """A force is held over ticks that are left out, and so is the wave; that is paid before another is played."""
    assert [each for each in overdrafts(few.rows[:60]) if not each[0] <= -LOW] == []


@pytest.mark.soak
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", CLAIMING)
def test_none_of_ten_thousand_random_links_gives_more_than_it_got_by_the_integral_of_its_waves(
    name: str, tmp_path: Path
) -> None:
    rows = rows_of(name, MANY, tmp_path)
    several = by_integral(rows)
    status = Counter(row["status"] for row in several.came)
    print(f"{name}: least E_link {min(row['E_link_min'] for row in several.came):.3g} J, {dict(status)}")
    assert active(several.came)[:3] == []
    assert [each for each in overdrafts(rows[:2000]) if not each[0] <= -LOW] == []


@pytest.mark.soak
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", CLAIMING)
def test_none_of_ten_thousand_random_links_gives_more_than_it_got(name: str, tmp_path: Path) -> None:
    several = many(name, MANY, tmp_path)
    seen, status = effects(several.rows), Counter(row["status"] for row in several.came)
    print(f"{name}: least E_link {min(row['E_link_min'] for row in several.came):.3g} J, {dict(status)}, {dict(seen)}")
    assert active(several.came)[:3] == []
    assert min(seen[effect] for effect in DRAWN) > 0.2 * MANY
