"""Every row of the built-in delay-scenario matrix ends as expected; where theory has a verdict, it is that one."""

from __future__ import annotations

from dataclasses import replace
from math import inf

import pytest

from slave.tissue import Tissue
from teleop import Scene, load_scene
from teleop.analysis.stability.assess import is_stable, stability
from teleop.law import BUILT_IN
from teleop.sweeps.matrix import MatrixBlock, Row, read_matrix, run_block

BLOCKS = {block.name: block for block in read_matrix()}
ROWS = [(block, row) for block in BLOCKS.values() for row in block.rows()]
FEW = ("soft_tissue_clean", "jittery_wan", "rubber", "blackout")  # which differ in kind; the others with -m full
LINEAR = ("soft_tissue", "relaxing_tissue", "free_motion")


def linear(block: MatrixBlock, row: Row) -> bool:
    """Has the row a loop with roots: a linear law at both ends of a constant delay, and contact without a gap."""
    law = row.law in ("direct", "wave") or block.fixed.get("law.alpha") == 1.0
    return block.scene in LINEAR and law and not row.loss


def made(block: MatrixBlock, row: Row) -> Scene:
    own = {} if row.delay is None else {"delay": row.delay}
    return load_scene(block.scene, **{**block.fixed, **own, "law": row.law})


@pytest.mark.parametrize("name", [name if name in FEW else pytest.param(name, marks=pytest.mark.full)
                                  for name in BLOCKS])
def test_the_rows_of_a_block_end_as_expected_and_waves_take_no_more_from_the_link_than_was_put_in(name: str) -> None:
    outcomes = run_block(BLOCKS[name])
    assert [outcome.row.id for outcome in outcomes] == [row.id for row in BLOCKS[name].rows()]
    assert [outcome.line() for outcome in outcomes if not outcome.as_expected] == []
    stored = {one.row.id: one.figures.get("E_link_min", -inf) for one in outcomes if one.row.law == "wave"}
    assert bool(stored) == ("wave" in BLOCKS[name].laws)
    assert {key: energy for key, energy in stored.items() if energy < -1e-12} == {}


@pytest.mark.parametrize("name", [
    name if name in FEW else pytest.param(name, marks=pytest.mark.full)
    for name, block in BLOCKS.items() if any(linear(block, row) for row in block.rows())])
def test_where_the_loop_is_linear_its_roots_say_the_same(name: str) -> None:
    for row in BLOCKS[name].rows():
        if linear(BLOCKS[name], row):
            assert is_stable(made(BLOCKS[name], row)) == (row.expect == "ok"), row.id


def test_the_delay_margins_that_the_reasons_name() -> None:
    for name, first_unstable in (("soft_tissue_clean", 29), ("stiff_tissue", 5), ("relaxing_tissue", 6), ("gel", None),
                                 ("free_motion", None)):
        block = BLOCKS[name]
        scene = load_scene(block.scene, **{**block.fixed, "law": "direct", "delay": 0.0})
        assert stability(scene).critical_round_trip == first_unstable, name


def test_a_grip_holds_a_pressed_wall_at_every_delay_or_not() -> None:
    for name, first_unstable in (("firm_grip", None), ("light_grip", 17)):
        scene = load_scene("canonical", **{**BLOCKS[name].fixed, "law": "direct", "delay": 0.0})
        pressed = replace(scene, environment=Tissue(k=5000.0, d=5.0))  # the wall as it is in contact
        assert stability(pressed).critical_round_trip == first_unstable, name


def test_the_matrix_has_every_law_that_has_two_ends_and_names_each_row_once() -> None:
    names = [row.id for _, row in ROWS]
    assert len(set(names)) == len(names) >= 150
    assert "soft_tissue-direct-50ms-10%-seed1" in names
    two_ends = {law for law in BUILT_IN if not law.startswith("virtual_")}
    for expect, laws in {"ok": two_ends, "diverged": {"direct", "pfra", "pp", "iss"}}.items():
        assert {row.law for _, row in ROWS if row.expect == expect} == laws
