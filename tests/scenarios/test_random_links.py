"""Every law that claims E_link keeps it over links drawn at random, in scenes drawn at random, at every tick.

A claim of E_link is one for playouts that play a message at most once and nothing in the gaps. The law's numbers, the
scene's, its playout, delay, jitter, loss, order, copies and blackouts, all from nothing to absurd, come from one seed.
"""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from channel.link import EFFECTS
from teleop import load_scene, run
from teleop.law import find_law, known_laws
from teleop.sweeps.chunk import Job, work
from tests.scenarios import random_links
from tests.scenarios.random_links import bases, drawn, held, makers, record

LOW = -1e-9  # J: below is more than rounding
TICKS = 600
FEW, MANY = 300, 10_000
AT_ONCE = 500  # rows whose schedules are in memory together
FIGURES = ("E_link_min", "E_link_end", "fresh_fwd", "fresh_bwd", "f_env_max")
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
    """`count` random rows of a law; the first of them are the same, however many there are."""
    dice = np.random.default_rng(1)
    files = record(folder, dice)
    rows = [(n, drawn(find_law(name)(), dice, TICKS, files), int(dice.integers(2**63))) for n in range(count)]
    return Drawn(rows, swept(rows))


def active(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows that took more from the link than they put in, those of the shortest links first. NaN is one of them."""
    return sorted((row for row in rows if not row.get("E_link_min", np.nan) >= LOW), key=lambda row: len(row["link"]))


def effects(rows: Rows) -> Counter[str]:
    """In how many of the links each effect is."""
    return Counter(name for _, knobs, _ in rows for name in set(re.findall(r"(\w+)\(", knobs["link"])))


@pytest.fixture(scope="module", params=CLAIMING)
def few(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Drawn:
    """The links of the ordinary suite, of every law that claims."""
    return many(request.param, FEW, tmp_path_factory.mktemp("recordings"))


def test_some_law_claims_and_every_effect_is_drawn() -> None:
    assert "wave" in CLAIMING
    assert makers(1.0, 1e-3, {}).keys() == EFFECTS.keys()


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
    assert min(effects(few.rows)[name] for name in EFFECTS) > 0.2 * FEW
    for knob, values in {"base": set(bases()), "axes": {1, 3}, "motion": {*random_links.MOTIONS}}.items():
        assert {knobs[knob] for _, knobs, _ in few.rows} == values


def test_the_smallest_is_that_of_the_whole_record_and_no_way_gave_more_than_its_stamps(few: Drawn) -> None:
    for n, knobs, seed in few.rows[::15]:
        got = run(load_scene(random_links.__file__, **knobs), seed=seed)
        assert got.trace["E_link"].min() == few.came[n]["E_link_min"], knobs
        assert min(got.metrics.get("E_fwd_min", 0.0), got.metrics.get("E_bwd_min", 0.0)) >= LOW, knobs


def test_over_the_same_links_messages_that_are_held_in_the_gaps_make_energy(few: Drawn) -> None:
    """What nobody claims: the links and motions are such that a wave played twice shows."""
    rows = [(n, held(knobs), seed) for n, knobs, seed in few.rows[:100]]
    made = [row["E_link_min"] for row in active(swept(rows))]
    assert len(made) >= 10
    assert min(made) < -0.01


@pytest.mark.soak
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", CLAIMING)
def test_none_of_ten_thousand_random_links_gives_more_than_it_got(name: str, tmp_path: Path) -> None:
    several = many(name, MANY, tmp_path)
    seen, status = effects(several.rows), Counter(row["status"] for row in several.came)
    print(f"{name}: least E_link {min(row['E_link_min'] for row in several.came):.3g} J, {dict(status)}, {dict(seen)}")
    assert active(several.came)[:3] == []
    assert min(seen[effect] for effect in EFFECTS) > 0.2 * MANY
