"""A record is followed as it grows: whole rows, once each, whatever part of one is there."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import pytest

from teleop.live.page.rows import KEPT, HandReference, RecordTail
from teleop.storage.strict_json import Misshapen

HEADER = json.dumps({"end": "m", "dt_ns": 1_000_000, "axes": 2, "scene": "hard_wall", "knobs": {}, "seed": 0,
                     "mode": "live", "columns": ["k", "late_ns", "seq", "x_m", "x_m", "f_m"]}).encode() + b"\n"


def row(k: int) -> bytes:
    return struct.pack("<6d", k, 0.0, -1.0, 0.1 * k, 0.2 * k, 3.0)


def add(folder: Path, data: bytes) -> None:
    with (folder / "record.bin").open("ab") as file:
        file.write(data)


def test_there_are_no_rows_before_there_is_a_record(tmp_path: Path) -> None:
    assert RecordTail(tmp_path / "not-there").read() == []


def test_rows_come_once_each(tmp_path: Path) -> None:
    add(tmp_path, HEADER + row(0) + row(1))
    follower = RecordTail(tmp_path)
    assert [each[0] for each in follower.read()] == [0, 1]
    assert follower.read() == []
    add(tmp_path, row(2))
    assert follower.read() == [(2.0, 0.0, -1.0, pytest.approx(0.2), pytest.approx(0.4), 3.0)]
    follower.close()


@pytest.mark.parametrize("cut", [1, 8, 47])
def test_a_row_that_is_cut_off_waits_for_its_rest(tmp_path: Path, cut: int) -> None:
    add(tmp_path, HEADER + row(0) + row(1)[:cut])
    follower = RecordTail(tmp_path)
    assert [each[0] for each in follower.read()] == [0]
    add(tmp_path, row(1)[cut:])
    assert [each[0] for each in follower.read()] == [1]
    follower.close()


def test_a_header_that_is_cut_off_waits_for_its_rest(tmp_path: Path) -> None:
    add(tmp_path, HEADER[:30])
    follower = RecordTail(tmp_path)
    assert follower.read() == []
    add(tmp_path, HEADER[30:] + row(0))
    assert len(follower.read()) == 1
    follower.close()


def test_what_is_no_record_is_misshapen(tmp_path: Path) -> None:
    add(tmp_path, b"hello\n")
    with pytest.raises(Misshapen):
        RecordTail(tmp_path).read()


def test_a_column_has_a_place_for_each_axis(tmp_path: Path) -> None:
    add(tmp_path, HEADER + row(3))
    follower = RecordTail(tmp_path)
    [newest] = follower.read()
    assert newest[follower.slices["x_m"]] == pytest.approx((0.3, 0.6))
    assert newest[follower.slices["f_m"]] == (3.0,)
    follower.close()


def test_a_row_of_before_is_found_by_its_tick_as_long_as_it_is_kept(tmp_path: Path) -> None:
    add(tmp_path, HEADER + b"".join(row(k) for k in (0, 1, 5)))
    follower = RecordTail(tmp_path)
    follower.read()
    found = follower.at(4)
    assert found is not None
    assert found[0] == 1.0
    add(tmp_path, b"".join(row(k) for k in range(6, 6 + KEPT)))
    follower.read()
    assert follower.at(4) is None
    follower.close()


def test_of_the_hand_the_last_whole_row_counts(tmp_path: Path) -> None:
    hand, path = HandReference(tmp_path), tmp_path / "hand.bin"
    assert hand.newest() is None
    path.write_bytes(b'{"version":1,"dt_ns"')
    assert hand.newest() is None
    path.write_bytes(b'{"version":1,"dt_ns":1000000,"axes":2}\n')
    assert hand.newest() is None
    with path.open("ab") as file:
        file.write(struct.pack("<6d", 0.0, 0.1, 0.2, 1.0, 0.3, 0.4) + b"\0" * 5)
    assert hand.newest() == (0.3, 0.4)
    hand.close()


@pytest.mark.parametrize("header", [b"hello\n", b"[]\n", b'{"axes": "two"}\n', b'{"axes": null}\n'])
def test_a_hand_that_is_none_is_not_shown(tmp_path: Path, header: bytes) -> None:
    (tmp_path / "hand.bin").write_bytes(header + b"\0" * 100)
    assert HandReference(tmp_path).newest() is None
