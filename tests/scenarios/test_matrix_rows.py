"""Every row of the built-in delay-scenario matrix ends as expected; where theory has a verdict, it is that one."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from math import inf
from typing import Any

import pytest

from slave.tissue import Tissue
from teleop import Scene, load_scene
from teleop.analysis.stability.assess import is_stable, stability
from teleop.law import BUILT_IN
from teleop.sweeps.matrix import MatrixBlock, Row, RowOutcome, read_matrix, run_block

BLOCKS = {block.name: block for block in read_matrix()}
ROWS = [(block, row) for block in BLOCKS.values() for row in block.rows()]
LINEAR = ("soft_tissue", "relaxing_tissue", "free_motion")


def named(rows: list[tuple[MatrixBlock, Row]]) -> list[Any]:
    return [pytest.param(block, row, id=row.id) for block, row in rows]


@cache
def came(name: str) -> dict[str, RowOutcome]:
    """A whole block, run once for all of its rows."""
    return {outcome.row.id: outcome for outcome in run_block(BLOCKS[name])}


def linear(block: MatrixBlock, row: Row) -> bool:
    """Has the row a loop with roots: a linear law at both ends of a constant delay, and contact without a gap."""
    law = row.law in ("direct", "wave") or block.fixed.get("law.alpha") == 1.0
    return block.scene in LINEAR and law and not row.loss


def made(block: MatrixBlock, row: Row) -> Scene:
    own = {} if row.delay is None else {"delay": row.delay}
    return load_scene(block.scene, **{**block.fixed, **own, "law": row.law})


@pytest.mark.parametrize(("block", "row"), named(ROWS))
def test_a_row_ends_as_expected(block: MatrixBlock, row: Row) -> None:
    outcome = came(block.name)[row.id]
    assert outcome.as_expected, outcome.line()


@pytest.mark.parametrize("name", [name for name, block in BLOCKS.items() if "wave" in block.laws])
def test_waves_take_no_more_from_the_link_than_was_put_in(name: str) -> None:
    stored = {key: one.figures.get("E_link_min", -inf) for key, one in came(name).items() if one.row.law == "wave"}
    assert stored
    assert {key: energy for key, energy in stored.items() if energy < -1e-12} == {}


@pytest.mark.parametrize(("block", "row"), named([pair for pair in ROWS if linear(*pair)]))
def test_where_the_loop_is_linear_its_roots_say_the_same(block: MatrixBlock, row: Row) -> None:
    assert is_stable(made(block, row)) == (row.expect == "ok")


@pytest.mark.parametrize(("name", "first_unstable"), [
    ("soft_tissue_clean", 29), ("stiff_tissue", 5), ("relaxing_tissue", 6), ("gel", None), ("free_motion", None),
])
def test_the_delay_margins_that_the_reasons_name(name: str, first_unstable: int | None) -> None:
    block = BLOCKS[name]
    scene = load_scene(block.scene, **{**block.fixed, "law": "direct", "delay": 0.0})
    assert stability(scene).critical_round_trip == first_unstable


@pytest.mark.parametrize(("name", "first_unstable"), [("firm_grip", None), ("light_grip", 17)])
def test_a_grip_holds_a_pressed_wall_at_every_delay_or_not(name: str, first_unstable: int | None) -> None:
    scene = load_scene("canonical", **{**BLOCKS[name].fixed, "law": "direct", "delay": 0.0})
    pressed = replace(scene, environment=Tissue(k=5000.0, d=5.0))  # the wall as it is in contact
    assert stability(pressed).critical_round_trip == first_unstable


def test_the_matrix_has_every_law_that_has_two_ends_and_names_each_row_once() -> None:
    names = [row.id for _, row in ROWS]
    assert len(set(names)) == len(names) >= 150
    assert "soft_tissue-direct-50ms-10%-seed1" in names
    two_ends = {law for law in BUILT_IN if not law.startswith("virtual_")}
    for expect, laws in {"ok": two_ends, "diverged": {"direct", "pfra", "pp", "iss"}}.items():
        assert {row.law for _, row in ROWS if row.expect == expect} == laws
