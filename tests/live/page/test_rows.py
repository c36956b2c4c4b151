"""What a page is shown of two records as they grow, and the offset between master and slave that a clutch leaves."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import pytest

from teleop.live.page.controls import Clutch
from teleop.live.page.rows import KEPT, PAST, HandReference, RecordTail, RowMessages, RowsMessage
from teleop.scene.loading import load_scene
from teleop.storage.strict_json import Misshapen

OWN = ["k", "late_ns", "seq"]
WAVES = {"m": [*OWN, "x_m", "f_h", "f_m", "queue_m", "g_m", "E_in_fwd", "E_out_bwd", "E_port_m"],
         "s": [*OWN, "x_s", "f_env", "f_s", "queue_s", "g_s", "E_in_bwd", "E_out_fwd", "E_port_s"]}
PORTS = {"m": [*OWN, "x_m", "f_h", "f_m", "E_port_m"], "s": [*OWN, "x_s", "f_env", "f_s", "E_port_s"]}


def header(e: str, columns: list[str], axes: int = 1) -> bytes:
    about = {"end": e, "dt_ns": 1_000_000, "axes": axes, "scene": "hard_wall", "knobs": {}, "seed": 0, "mode": "live"}
    return json.dumps({**about, "columns": columns}).encode() + b"\n"


def end(folder: Path, e: str, columns: list[str], *rows: list[float]) -> RecordTail:
    """The record of an end with these rows, not read yet."""
    folder.mkdir()
    data = b"".join(struct.pack(f"<{len(columns)}d", *row) for row in rows)
    (folder / "record.bin").write_bytes(header(e, columns) + data)
    return RecordTail(folder)


def message(rows: RowMessages, ends: dict[str, RecordTail]) -> tuple[RowsMessage, dict[str, Any]]:
    shown = rows.message(1.0, ends, {e: follower.read() for e, follower in ends.items()}, (0.06,))
    assert shown is not None
    return shown, json.loads(shown.text)


def waves(k: int, f: float) -> list[float]:
    return [k, 0.0, k - 50.0, 0.03, 1.0, f, 0.002, 1.0, 5.0 + k, 2.0, 0.0]


def test_the_last_row_and_the_extremes_since_the_last_message_are_shown(tmp_path: Path) -> None:
    rows = RowMessages(1e-3)
    ends = {e: end(tmp_path / e, e, WAVES[e], waves(100, 1.0), waves(101, -7.0), waves(102, 3.0))
            for e in "ms"}
    shown, text = message(rows, ends)
    assert (text["fm"], text["fm_lo"], text["fm_hi"]) == ([3.0], [-7.0], [3.0])
    assert shown.forces["s"] == ((-7.0,), (3.0,))
    assert text["hand"] == [0.06]
    assert text["age"] == pytest.approx([0.05, 0.05])
    _, again = message(rows, ends)  # nothing new
    assert (again["fm_lo"], again["fm_hi"]) == ([3.0], [3.0])


def test_the_energy_is_that_of_a_tick_that_both_ends_have(tmp_path: Path) -> None:
    ends = {"m": end(tmp_path / "m", "m", WAVES["m"], waves(0, 0.0), waves(1, 0.0), waves(2, 0.0)),
            "s": end(tmp_path / "s", "s", WAVES["s"], waves(0, 0.0), waves(1, 0.0))}
    _, text = message(RowMessages(1e-3), ends)
    assert text["E"] == pytest.approx((6.0 - 2.0) + (6.0 - 2.0))


def test_a_law_without_waves_has_the_energy_at_its_ports_and_no_queue(tmp_path: Path) -> None:
    ends = {"m": end(tmp_path / "m", "m", PORTS["m"], [0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.7]),
            "s": end(tmp_path / "s", "s", PORTS["s"], [0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.2])}
    _, text = message(RowMessages(1e-3), ends)
    assert text["E"] == pytest.approx(0.5)
    assert text["queue"] is None
    assert text["age"] == [None, None]
    assert text["gain"] == [1.0, 1.0]


def test_while_one_end_is_turned_and_the_other_is_not_there_is_no_energy(tmp_path: Path) -> None:
    for turned in "ms":
        (tmp_path / turned).mkdir()
        ends = {e: end(tmp_path / turned / e, e, PORTS[e], [0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0]) if e == turned
                else end(tmp_path / turned / e, e, WAVES[e], waves(0, 0.0)) for e in "ms"}
        _, text = message(RowMessages(1e-3), ends)
        assert text["E"] is None
        assert text["queue"] is None


def test_the_queue_of_several_axes_is_the_longest_as_on_the_live_line(tmp_path: Path) -> None:
    """It was that of the first axis."""
    ends = {}
    for e, queues in (("m", [0.0, 0.03, 0.01]), ("s", [0.002, 0.0, 0.04])):
        columns = [*OWN, *[f"x_{e}"] * 3, *[f"f_{e}"] * 3, *[f"queue_{e}"] * 3]
        ends[e] = end(tmp_path / e, e, columns, [0.0, 0.0, -1.0, *[0.0] * 6, *queues])
    assert message(RowMessages(1e-3), ends)[1]["queue"] == pytest.approx([0.04, 0.03])


def test_a_number_that_is_not_finite_is_null(tmp_path: Path) -> None:
    ends = {e: end(tmp_path / e, e, WAVES[e], waves(0, float("nan"))) for e in "ms"}
    assert message(RowMessages(1e-3), ends)[1]["fm"] == [None]


def test_nothing_is_shown_before_both_ends_have_a_row(tmp_path: Path) -> None:
    ends = {"m": end(tmp_path / "m", "m", WAVES["m"], waves(0, 0.0)), "s": end(tmp_path / "s", "s", WAVES["s"])}
    new = {e: follower.read() for e, follower in ends.items()}
    assert RowMessages(1e-3).message(0.0, ends, new, None) is None


def test_of_what_has_passed_ten_seconds_are_kept(tmp_path: Path) -> None:
    rows = RowMessages(1e-3)
    ends = {e: end(tmp_path / e, e, WAVES[e], waves(0, 0.0)) for e in "ms"}
    for _ in range(PAST + 5):
        message(rows, ends)
    assert len(json.loads(rows.past_message())["rows"]) == PAST


# A record is followed as it grows: whole rows, once each, whatever part of one is there


HEADER = header("m", [*OWN, "x_m", "x_m", "f_m"], axes=2)


def row(k: int) -> bytes:
    return struct.pack("<6d", k, 0.0, -1.0, 0.1 * k, 0.2 * k, 3.0)


def add(folder: Path, data: bytes) -> None:
    with (folder / "record.bin").open("ab") as file:
        file.write(data)


def test_rows_come_once_each(tmp_path: Path) -> None:
    assert RecordTail(tmp_path / "not-there").read() == []
    add(tmp_path, HEADER + row(0) + row(1))
    follower = RecordTail(tmp_path)
    assert [each[0] for each in follower.read()] == [0, 1]
    assert follower.read() == []
    add(tmp_path, row(2))
    assert follower.read() == [(2.0, 0.0, -1.0, pytest.approx(0.2), pytest.approx(0.4), 3.0)]
    follower.close()


def test_a_row_or_a_header_that_is_cut_off_waits_for_its_rest(tmp_path: Path) -> None:
    for cut in (1, 8, 47):
        folder = tmp_path / str(cut)
        folder.mkdir()
        add(folder, HEADER[:30])
        follower = RecordTail(folder)
        assert follower.read() == []
        add(folder, HEADER[30:] + row(0) + row(1)[:cut])
        assert [each[0] for each in follower.read()] == [0], cut
        add(folder, row(1)[cut:])
        assert [each[0] for each in follower.read()] == [1], cut
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
    for first in (b"hello\n", b"[]\n", b'{"axes": "two"}\n', b'{"axes": null}\n'):
        path.write_bytes(first + b"\0" * 100)
        assert HandReference(tmp_path).newest() is None, first


# The clutch: a turn keeps its offset, a start from the beginning does not


Ends = dict[str, RecordTail]


def at(ends: Ends, k: int, master: float, slave: float) -> None:
    """Both ends at tick k, m."""
    for e, x in (("m", master), ("s", slave)):
        add(ends[e].folder, struct.pack("<4d", k, 0.0, -1.0, x))
        ends[e].read()


@pytest.fixture
def ends(tmp_path: Path) -> Ends:
    return {e: end(tmp_path / e, e, [*OWN, f"x_{e}"]) for e in "ms"}


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


def test_a_turn_keeps_the_offset_wherever_the_two_were_when_it_began(ends: Ends) -> None:
    for k, slave in ((7, 0.03), (9, -0.02)):
        clutch = Clutch(load_scene("hard_wall"))
        clutch.expect_switch(again=False)
        clutch.begin_session(k)
        at(ends, k, 0.03, slave)
        clutch.measure(ends)
        assert clutch.aligned_position(ends) == pytest.approx([slave])


def test_places_of_a_scaled_slave_are_in_the_masters_metres(ends: Ends) -> None:
    clutch = Clutch(load_scene("hard_wall", scale_x=2.0))
    assert clutch.aligned_position(ends) is None, "what is not known is not aligned"
    at(ends, 0, 0.01, 0.06)
    assert clutch.aligned_position(ends) == pytest.approx([0.03])
