"""The clutch leaves an offset between master and slave, which a turn keeps and a start from the beginning does not."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import pytest

from teleop.live.page.controls import Clutch
from teleop.live.page.rows import RecordTail
from teleop.scene.loading import load_scene

Ends = dict[str, RecordTail]


def add(folder: Path, k: int, x: float) -> None:
    """One more tick of the end in `folder`."""
    with (folder / "record.bin").open("ab") as file:
        file.write(struct.pack("<4d", k, 0.0, -1.0, x))


def at(ends: Ends, k: int, master: float, slave: float) -> None:
    """Both ends at tick k, m."""
    for e, x in (("m", master), ("s", slave)):
        add(ends[e].folder, k, x)
        ends[e].read()


@pytest.fixture
def ends(tmp_path: Path) -> Ends:
    found = {}
    for e in "ms":
        (tmp_path / e).mkdir()
        header = {"end": e, "dt_ns": 1_000_000, "axes": 1, "scene": "hard_wall", "knobs": {}, "seed": 0,
                  "mode": "live", "columns": ["k", "late_ns", "seq", f"x_{e}"]}
        (tmp_path / e / "record.bin").write_bytes(json.dumps(header).encode() + b"\n")
        found[e] = RecordTail(tmp_path / e)
    return found


def test_it_is_open_while_any_page_holds_it() -> None:
    clutch = Clutch(load_scene("hard_wall"))
    assert not clutch.update()
    clutch.hold("a", held=True)
    clutch.hold("b", held=True)
    assert clutch.update()
    assert clutch.is_open
    clutch.hold("a", held=False)
    assert not clutch.update()
    clutch.hold("b", held=False)
    assert clutch.update()
    assert not clutch.is_open


def test_a_turn_brings_the_master_beside_the_slave_by_what_the_clutch_left(ends: Ends) -> None:
    clutch = Clutch(load_scene("hard_wall"))
    clutch.begin_session(5)
    at(ends, 4, 0.0, 0.0)
    clutch.measure(ends)  # the records have not come so far
    at(ends, 5, 0.07, 0.03)
    clutch.measure(ends)
    at(ends, 9, 0.09, 0.02)
    assert clutch.aligned_position(ends) == pytest.approx([0.02 + 0.04])


@pytest.mark.parametrize("slave", [0.03, -0.02])
def test_a_turn_keeps_the_offset_wherever_the_two_were_when_it_began(ends: Ends, slave: float) -> None:
    clutch = Clutch(load_scene("hard_wall"))
    clutch.expect_switch(again=False)
    clutch.begin_session(7)
    at(ends, 7, 0.03, slave)
    clutch.measure(ends)
    assert clutch.aligned_position(ends) == pytest.approx([slave])


def test_places_of_a_scaled_slave_are_in_the_masters_metres(ends: Ends) -> None:
    clutch = Clutch(load_scene("hard_wall", scale_x=2.0))
    at(ends, 0, 0.01, 0.06)
    assert clutch.aligned_position(ends) == pytest.approx([0.03])


def test_what_is_not_known_is_not_aligned(ends: Ends) -> None:
    assert Clutch(load_scene("hard_wall")).aligned_position(ends) is None
