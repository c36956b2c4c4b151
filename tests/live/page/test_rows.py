"""Two records as a page shows them while they grow, the offset that a clutch leaves, and the parts of a page."""

from __future__ import annotations

import json
import shutil
import struct
from pathlib import Path
from typing import Any

import pytest

from teleop import Refused, load_result, load_scene
from teleop.live.page.controls import Clutch
from teleop.live.page.rows import KEPT, PAST, HandReference, RecordTail, RowMessages, RowsMessage
from teleop.live.page.session import PagePart, PageParts, size_of
from teleop.storage.strict_json import Misshapen
from tests.live.conftest import Pair

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


def test_a_law_without_waves_has_the_energy_at_its_ports_and_no_queue_and_while_one_end_is_turned_there_is_none(
    tmp_path: Path
) -> None:
    ends = {"m": end(tmp_path / "m", "m", PORTS["m"], [0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.7]),
            "s": end(tmp_path / "s", "s", PORTS["s"], [0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.2])}
    _, text = message(RowMessages(1e-3), ends)
    assert text["E"] == pytest.approx(0.5)
    assert text["queue"] is None
    assert text["age"] == [None, None]
    assert text["gain"] == [1.0, 1.0]
    for turned in "ms":
        folder = tmp_path / f"turned {turned}"
        folder.mkdir()
        ends = {e: end(folder / e, e, PORTS[e], [0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0]) if e == turned
                else end(folder / e, e, WAVES[e], waves(0, 0.0)) for e in "ms"}
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


def test_a_number_that_is_not_finite_is_null_and_nothing_is_shown_before_both_ends_have_a_row(tmp_path: Path) -> None:
    ends = {e: end(tmp_path / e, e, WAVES[e], *[waves(0, float("nan"))] * (e == "m")) for e in "ms"}
    new = {e: follower.read() for e, follower in ends.items()}
    assert RowMessages(1e-3).message(0.0, ends, new, None) is None
    add(tmp_path / "s", struct.pack("<11d", *waves(0, 0.0)))
    assert message(RowMessages(1e-3), ends)[1]["fm"] == [None]


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


def test_rows_come_once_each_with_a_place_for_each_axis_and_what_is_no_record_is_misshapen(tmp_path: Path) -> None:
    assert RecordTail(tmp_path / "not-there").read() == []
    add(tmp_path, HEADER + row(0) + row(1))
    follower = RecordTail(tmp_path)
    assert [each[0] for each in follower.read()] == [0, 1]
    assert follower.read() == []
    add(tmp_path, row(2))
    [newest] = follower.read()
    assert newest == (2.0, 0.0, -1.0, pytest.approx(0.2), pytest.approx(0.4), 3.0)
    assert (newest[follower.slices["x_m"]], newest[follower.slices["f_m"]]) == (newest[3:5], (3.0,))
    follower.close()
    (tmp_path / "record.bin").write_bytes(b"hello\n")
    with pytest.raises(Misshapen):
        RecordTail(tmp_path).read()


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


def test_a_turn_brings_the_master_beside_the_slave_by_what_the_clutch_left_wherever_the_two_were(ends: Ends) -> None:
    clutch = Clutch(load_scene("hard_wall"))
    clutch.begin_session(5)
    at(ends, 4, 0.0, 0.0)
    clutch.measure(ends)  # the records have not come so far
    at(ends, 5, 0.07, 0.03)
    clutch.measure(ends)
    at(ends, 9, 0.09, 0.02)
    assert clutch.aligned_position(ends) == pytest.approx([0.02 + 0.04])
    for k, slave in ((17, 0.03), (19, -0.02)):
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


KNOBS = {"duration": "0.2"}


def test_the_index_has_each_part_with_its_knobs_as_it_begins(tmp_path: Path) -> None:
    parts = PageParts(tmp_path, {"scene": "hard_wall", "seed": 7, "command": ["teleop", "demo"]})
    assert parts.begin({"law": "wave"}, 0, "start") == {"m": tmp_path / "01" / "master", "s": tmp_path / "01" / "slave"}
    parts.begin({"law": "pp"}, 900, "turn")
    parts.correct_start(917)
    assert json.loads((tmp_path / "page.json").read_text()) == {
        "version": 1, "scene": "hard_wall", "seed": 7, "command": ["teleop", "demo"], "parts": [
            {"folder": "01", "knobs": {"law": "wave"}, "k": 0, "why": "start"},
            {"folder": "02", "knobs": {"law": "pp"}, "k": 917, "why": "turn"}]}
    assert not parts.recorded


def test_a_part_that_cannot_be_put_together_has_its_sentence_and_ctrl_c_meanwhile_leaves_the_rest_for_later(
    tmp_path: Path
) -> None:
    """Three parts: a whole one, one that only the master came to, one whose master's record is another file."""
    ends = Pair(load_scene("hard_wall", duration=0.2), tmp_path / "ends", seed=1).run()
    ran = dict(zip("ms", ends.write(), strict=True))
    parts, said = PageParts(tmp_path, {"scene": "hard_wall", "seed": 0, "command": ["teleop"]}), list[str]()
    for why in ("start", "turn", "again"):
        folders = parts.begin(KNOBS, 0, why)
        for e in "ms" if why != "turn" else "m":
            shutil.copytree(ran[e], folders[e])
    (tmp_path / "03" / "master" / "record.bin").write_text("another file\n")
    (tmp_path / "03" / "master" / "summary.json").unlink()
    [result] = parts.merge_all("hard_wall", ["teleop"], said.append, lambda: False)
    assert parts.recorded
    assert result.path == parts.folder / "01"
    assert load_result(parts.folder / "01").ticks == result.ticks > 0
    assert len(said) == 2
    assert said[0].startswith("part 02: only the master")
    assert said[1].startswith("part 03: ")
    said.clear()
    assert parts.merge_all("hard_wall", ["teleop"], said.append, lambda: True) == []
    [sentence] = said
    assert f"teleop report {parts.folder / '01'}" in sentence


def test_the_oldest_part_goes_first_and_no_name_is_given_twice(tmp_path: Path) -> None:
    parts = PageParts(tmp_path, {"scene": "hard_wall"}, keep=size_of("10MB"))
    for i in range(3):
        for folder in parts.begin({}, 100 * i, "turn").values():
            folder.mkdir(parents=True)
            (folder / "record.bin").write_bytes(bytes(1000 * (i + 1)))
    assert parts.sizes() == [2000, 4000, 6000]
    assert parts.drop_oldest() == "01"
    assert not (tmp_path / "01").exists()
    assert parts.begin({}, 300, "turn")["m"] == tmp_path / "04" / "master"
    assert [part["folder"] for part in json.loads((tmp_path / "page.json").read_text())["parts"]] == ["02", "03", "04"]
    shutil.rmtree(tmp_path / "02")
    assert parts.drop_oldest() == "02", "a part that a person removed kept all others from being removed"


def test_a_part_that_is_over_is_measured_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A hundred parts took 70 ms of each second, in which no picture came."""
    parts, measured = PageParts(tmp_path, {"scene": "hard_wall"}), list[str]()
    for i in range(20):
        parts.begin({}, 100 * i, "turn")["m"].mkdir(parents=True)
    size = PageParts._size

    def counted(self: PageParts, part: PagePart) -> int:
        measured.append(part.folder)
        return size(self, part)

    monkeypatch.setattr(PageParts, "_size", counted)
    for i in range(3):
        (parts.newest["m"] / "record.bin").write_bytes(bytes(1000 * (i + 1)))
        assert parts.sizes() == [0] * 19 + [1000 * (i + 1)], "the newest part grows"
    assert len(measured) == 18 + 3 * 2


def test_a_size_is_read_as_it_is_typed() -> None:
    assert [size_of(typed) for typed in ("2GB", "0.5 GB", "10MB", "20000kB")] == [2e9, 5e8, 1e7, 2e7]
    for typed in ("2", "GB", "2gb", "-1GB", "nanGB", "1e999GB", "9MB", ""):
        with pytest.raises(Refused, match="a size of at least 10 MB"):
            size_of(typed)
