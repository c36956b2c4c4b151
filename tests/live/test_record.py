"""The record on disk: rows as they come, and what is left of them after a kill, a full disk, or worse."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from teleop import Refused, load_result, load_scene
from teleop.live.records.end_result import NAMES, WAYS
from teleop.live.records.merge import merge, recover, scene_of
from teleop.live.records.reader import FILE, IDLE, GrowingRecord, TruncatedRecord, read_record
from teleop.live.records.record import EVENTS, EVERY, NEWEST, RecordWriter, fresh_folder, read_events
from teleop.protocol.guard import Event
from teleop.scene.library import ROOT
from teleop.simulation.structure import columns
from teleop.simulation.trace import EndRecord
from teleop.terminal.run_table import table
from tests.live.recording import add_rows, record_of

SCENE = load_scene("hard_wall", duration=1.0)
WIDTH = len(columns(SCENE, "m"))


def numbered(k: int) -> tuple[int, int, tuple[float, ...]]:
    return 1000 + k, k - 5, tuple(k + 0.1 * i for i in range(WIDTH))


def recorded(folder: Path, count: int, **knobs: Any) -> RecordWriter:
    return record_of(folder, "m", range(count), row=numbered, **knobs)


def table_of(record: EndRecord) -> Any:
    """All rows of a record that was read."""
    rows: Any = record.rows
    return rows.table(0, len(record.ticks))


def test_what_was_added_is_read_back_to_the_bit(tmp_path: Path) -> None:
    count = 3 * EVERY + 17
    ticks = range(0, 2 * count, 2)
    record_of(tmp_path, "m", ticks, row=numbered).close()
    header, record, late = read_record(tmp_path)
    assert list(record.ticks) == [*ticks]
    assert np.asarray(record.played).tolist() == [k - 5 for k in ticks]
    assert np.asarray(late).tolist() == [1000 + k for k in ticks]
    assert table_of(record).tolist() == [[*numbered(k)[2]] for k in ticks]
    assert (header["end"], header["scene"], header["dt_ns"]) == ("m", "hard_wall", 10**6)
    assert len(header["columns"]) == WIDTH + 3


def test_the_columns_are_named_once_for_each_axis(tmp_path: Path) -> None:
    scene = load_scene("recorded_reach")
    about = {"scene": "recorded_reach", "knobs": {}, "seed": 0, "mode": "live", "command": []}
    RecordWriter(scene, "m", tmp_path, about).begin("bodies")
    assert read_record(tmp_path)[0]["columns"][:9] == ["k", "late_ns", "seq", "x_m", "x_m", "x_m", "v_m", "v_m", "v_m"]


@pytest.mark.parametrize(("law", "column"), [("wave", False), ("pfra", True)])
def test_a_record_of_an_earlier_release_was_said_to_be_none_since_its_header_does_not_tell_where_the_force_is_from(
    law: str, column: bool, tmp_path: Path
) -> None:
    """Such a record has a force if its law read one, and then of the device's sensor: what else stood there it
    does not say, so none is worked out."""
    record_of(tmp_path, "m", range(20), force="sensor" if column else "unknown", law=law, observer="none").close()
    first, rows = (tmp_path / FILE).read_bytes().split(b"\n", 1)
    header = {key: value for key, value in json.loads(first).items() if key != "force"}
    (tmp_path / FILE).write_bytes(json.dumps(header).encode() + b"\n" + rows)
    result = load_result(tmp_path)
    assert result.ticks == 20
    assert ("f_h" in result.trace) is column
    assert any("no force sensor" in note for note in result.notes) is not column


def test_the_report_of_a_run_whose_law_was_edited_since_told_of_a_law_that_never_ran(tmp_path: Path) -> None:
    mine, folder = tmp_path / "law_mine.py", tmp_path / "m"
    example = (ROOT / "scenarios" / "examples" / "law.py").read_text()
    mine.write_text(example)
    record_of(folder, "m", range(20), law=str(mine)).close()
    mine.write_text(f"{example}\n# another\n")
    with pytest.raises(Refused, match=r"^the file of the law was edited since .*; put back the file as it was$"):
        load_result(folder, trust=True)
    assert not (folder / "summary.json").exists()
    mine.write_text(example)
    assert load_result(folder, trust=True).ticks == 20


def test_a_process_that_is_killed_leaves_all_but_the_last_rows(tmp_path: Path) -> None:
    recorder = recorded(tmp_path, 2 * EVERY + 100)  # neither flushed nor closed
    assert len(read_record(tmp_path)[1].ticks) == 2 * EVERY
    recorder.close()


def test_a_process_that_is_killed_early_or_ticks_slowly_leaves_a_record_too(tmp_path: Path) -> None:
    early, slow = tmp_path / "early", tmp_path / "slow"
    open_still = recorded(early, 3), recorded(slow, 3, dt="0.5")
    assert [len(read_record(folder)[1].ticks) for folder in (early, slow)] == [0, 3]
    for recorder in open_still:
        recorder.close()


def test_a_row_that_was_cut_off_is_left_out_and_the_folder_says_so(tmp_path: Path) -> None:
    recorded(tmp_path, 40).close()
    data = (tmp_path / FILE).read_bytes()
    for cut in (1, 7, 8, 8 * (WIDTH + 3) - 1):
        (tmp_path / FILE).write_bytes(data[:-cut])
        with pytest.warns(TruncatedRecord, match="row 39 and what came after it are lost"):
            record = read_record(tmp_path)[1]
        assert list(record.ticks) == [*range(39)], cut
        assert table_of(record).shape == (39, WIDTH), cut
    recover(tmp_path)
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["ticks"] == 39
    assert any("cut off in the middle of a row" in note for note in summary["notes"])


def test_what_happened_is_on_the_disk_at_once_and_a_line_that_was_cut_off_is_left_out(tmp_path: Path) -> None:
    recorder = recorded(tmp_path, 3)
    recorder.note(Event(7, "safe", "silence"))
    recorder.note(Event(9, "released", "fresh packets"))
    first, second = read_events(tmp_path)
    assert first == {"k": 7, "what": "safe", "why": "silence"}
    assert second["k"] == 9
    text = (tmp_path / EVENTS).read_text()
    (tmp_path / EVENTS).write_text(text[:-10])
    assert read_events(tmp_path) == [first]
    recorder.close()


def test_of_a_killed_end_that_had_joined_late_the_ticks_before_are_not_called_skipped(tmp_path: Path) -> None:
    joined = [Event(500, "joined", "the other end was running already")]
    record_of(tmp_path, "m", (500, 501, 504), events=joined, row=lambda _k: (0, -1, 1e-3)).close()
    recover(tmp_path)
    own = json.loads((tmp_path / "summary.json").read_text())["master"]
    assert own["skipped"] == 2
    assert own["late_us"]["p100"] == 2000.0
    assert own["events"][0]["what"] == "joined"


def test_a_record_without_rows_is_a_record(tmp_path: Path) -> None:
    recorded(tmp_path, 0).close()
    assert list(read_record(tmp_path)[1].ticks) == []


@pytest.mark.parametrize("data", [
    None, b"", b"\n", b"[]\n", b"3\n", b"{}\n", b'{"columns": 5}\n', b"\xff\xfe\n", b'{"columns": ["k"', bytes(100),
])
def test_what_is_no_record_is_refused_in_one_sentence(data: bytes | None, tmp_path: Path) -> None:
    if data is not None:
        (tmp_path / FILE).write_bytes(data)
    with pytest.raises(Refused, match="holds no record of a live end") as refused:
        read_record(tmp_path)
    assert str(tmp_path) in str(refused.value)


def test_a_disk_that_is_full_before_the_run_is_no_place_for_it(tmp_path: Path) -> None:
    (tmp_path / FILE).symlink_to("/dev/full")
    with pytest.raises(OSError, match="No space left"):
        recorded(tmp_path, 0)


@pytest.mark.parametrize(("rows", "later", "trouble"), [(EVERY - 1, 3 * EVERY, EVERY), (10, 0, 10)])
def test_a_full_disk_is_remembered_and_never_raised(rows: int, later: int, trouble: int, tmp_path: Path) -> None:
    """It has been full ever since the header went there; or nothing is written before the end."""
    recorder = recorded(tmp_path, 0)
    recorder._file.close()
    recorder._file = Path("/dev/full").open("wb")  # noqa: SIM115 (the recorder closes it)
    add_rows(recorder, range(rows), numbered)
    assert recorder.trouble is None  # nothing has been written yet
    add_rows(recorder, range(later), numbered)
    recorder.close()
    assert recorder.trouble == f"the record stopped at row {trouble}: No space left on device"


# The folder


def test_a_folder_that_nobody_kept_is_gone_with_its_parents(tmp_path: Path) -> None:
    with fresh_folder(tmp_path / "a" / "b" / "c"):
        (tmp_path / "a" / "b" / "c" / "file").write_text("")
    assert list(tmp_path.iterdir()) == []


def test_a_parent_that_was_there_or_is_in_use_stays(tmp_path: Path) -> None:
    (tmp_path / "old").mkdir()
    with fresh_folder(tmp_path / "old" / "new" / "mine"):
        (tmp_path / "old" / "new" / "another's").mkdir()
    assert [path.name for path in (tmp_path / "old" / "new").iterdir()] == ["another's"]
    with fresh_folder(tmp_path / "old" / "x"):
        pass
    assert (tmp_path / "old").is_dir()


def test_a_folder_that_was_kept_stays_whatever_happens_then(tmp_path: Path) -> None:
    def work() -> Any:
        with fresh_folder(tmp_path / "mine") as folder:
            folder.keep()
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        work()
    assert (tmp_path / "mine").is_dir()


@pytest.mark.parametrize("make", ["folder", "file", "dangling link"])
def test_what_is_there_already_is_left_alone(make: str, tmp_path: Path) -> None:
    at = tmp_path / "there"
    if make == "folder":
        at.mkdir()
        (at / "file").write_text("mine")
    elif make == "file":
        at.write_text("mine")
    else:
        at.symlink_to("nowhere")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(Refused, match="is there already; give another folder with --out"), fresh_folder(at):
        pass
    assert sorted(tmp_path.rglob("*")) == before


def test_a_place_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    why = r"cannot write to .*file/x \(Not a directory\)"
    with pytest.raises(Refused, match=why), fresh_folder(tmp_path / "file" / "x"):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


# Two records put together


def end_of(folder: Path, e: str, ticks: range, events: list[Event], counted: int | None = None) -> Path:
    """An end's folder; `counted`: how many packets of all its run a summary of its own says it sent and received."""
    record_of(folder, e, ticks, events=events).close()
    if counted is not None:
        recover(folder)
        told = json.loads((folder / "summary.json").read_text())
        sends, hears = WAYS[e]
        told |= {"status": "ok", "sentence": "ran to its end"}
        told["packets"][sends]["sent"] = told["packets"][hears]["received"] = counted
        told[NAMES[e]] |= {"rtt": {"mean": 0.1}, "jitter": 0.0, "lost": 700, "reordered": 0, "run_time": 10.0}
        (folder / "summary.json").write_text(json.dumps(told))
    return folder


MET, AGAIN = Event(0, "met", "session 1"), Event(700, "met", "session 2")
LONG = [MET, Event(200, "safe", "a stall"), Event(500, "safe", "silence"), Event(700, "session", "again"), AGAIN]


def test_what_an_end_counted_after_the_other_was_killed_is_not_told_of_the_two(tmp_path: Path) -> None:
    """A table said "13500 sent, 3116 received, 10384 under way at the end", and told events from after the death."""
    killed = end_of(tmp_path / "m", "m", range(300), [MET])
    whole = end_of(tmp_path / "s", "s", range(1000), LONG, counted=990)
    result = merge(SCENE, killed, whole)
    assert result.ticks == 300
    assert result.packets == {}
    own: Any = result.extra["slave"]
    assert [event["k"] for event in own["events"]] == [0, 200]
    assert (own["ticks"], own["skipped"], own["late_us"]["p100"]) == (300, 0, 1.0)
    assert not {"rtt", "lost", "run_time"} & own.keys()
    assert result.run_time is None
    assert any("one end ran without the other" in note for note in result.notes)
    assert "E_link" in result.trace, "no session began anew in those ticks"
    assert "sent" not in table(result)


def test_what_an_end_counted_before_the_other_was_started_again_is_not_told_of_the_two(tmp_path: Path) -> None:
    begun = [Event(720, "joined", "it ran already"), Event(720, "session", "from rest"), Event(720, "met", AGAIN.why)]
    anew = end_of(tmp_path / "m", "m", range(720, 1000), begun, counted=279)
    whole = end_of(tmp_path / "s", "s", range(1000), LONG, counted=990)
    result = merge(SCENE, anew, whole)
    assert (result.status, result.ticks, result.packets) == ("ok", 280, {})
    master, slave = (dict(result.extra[name]) for name in ("master", "slave"))  # type: ignore[call-overload]  # mappings
    assert [event["what"] for event in master["events"]] == ["joined", "session", "met"]
    assert slave["events"] == []
    assert (master["skipped"], slave["skipped"]) == (0, 0)
    assert "E_link" in result.trace, "it is all of one session"


def test_what_two_ends_counted_that_ran_together_is_told(tmp_path: Path) -> None:
    ends = [end_of(tmp_path / e, e, range(1000 - late), [MET], counted=990) for e, late in (("m", 0), ("s", 40))]
    result = merge(SCENE, *ends)
    assert (result.packets["fwd"].sent, result.packets["bwd"].received) == (990, 990)
    assert dict(result.extra["slave"])["lost"] == 700  # type: ignore[call-overload]  # a mapping
    assert not any("without the other" in note for note in result.notes)


@pytest.mark.parametrize("ledger", ["E_link", "E_port"])
def test_two_ends_that_met_twice_have_the_ledgers_of_their_last_session_alone(tmp_path: Path, ledger: str) -> None:
    """What the ports took up was below zero where one end's sum had begun anew and the other's had not: energy that
    nobody gave out."""
    ends = [end_of(tmp_path / e, e, range(1000), LONG, counted=990) for e in ("m", "s")]
    result = merge(SCENE, *ends)
    assert np.isnan(result.trace[ledger][:700]).all()
    assert np.isfinite(result.trace[ledger][700:]).all()
    assert f"{ledger}_min" in result.metrics
    assert any("those of the last session, from t = 0.700 s on" in note for note in result.notes)
    assert result.packets["fwd"].sent == 990


def test_two_ends_with_other_laws_were_said_to_be_of_another_release(tmp_path: Path) -> None:
    master = end_of(tmp_path / "m", "m", range(100), [MET])
    record_of(tmp_path / "s", "s", [0], law="tdpa").close()
    with pytest.raises(Refused, match="are not the two ends of one run; give two that ran together"):
        merge(SCENE, master, tmp_path / "s")


def test_two_ends_that_met_for_the_first_time_after_a_turn_did_not_meet_anew(tmp_path: Path) -> None:
    turned = [Event(300, "joined", "a turn"), Event(303, "session", "from rest"), Event(320, "met", "session 2"),
              Event(321, "session", "from rest")]
    result = merge(SCENE, *[end_of(tmp_path / e, e, range(300, 1000), turned, counted=690) for e in ("m", "s")])
    assert np.isnan(result.trace["E_link"][:21]).all()
    assert np.isfinite(result.trace["E_link"][21:]).all()
    assert not any("anew" in note for note in result.notes)


@pytest.mark.parametrize("inside", [[], ["x-1"], ["x-1/master", "x-1/slave"]])
def test_a_folder_without_a_record_names_one_that_has_one(inside: list[str], tmp_path: Path) -> None:
    """It said FileNotFoundError."""
    for each in inside:
        recorded(tmp_path / each, 3).close()
    said = f"one of its folders, for example {tmp_path / 'x-1'}" if inside else "the folder that a live end wrote"
    for ask in (recover, scene_of):
        with pytest.raises(Refused) as refused:
            ask(tmp_path)
        assert str(refused.value) == f"{tmp_path} holds no record; give {said}"


def test_an_end_that_is_idle_writes_no_more_of_its_run_and_its_newest_rows_can_be_followed(tmp_path: Path) -> None:
    """A session of fifteen minutes wrote 820 MB."""
    writer, follower = recorded(tmp_path, 700), GrowingRecord(tmp_path, IDLE)
    assert follower.read() == []
    writer.idle()
    size, seen, most = (tmp_path / FILE).stat().st_size, [], 0
    for k in range(700, 700 + 3 * NEWEST):
        writer.add(k, *numbered(k))
        if k % 100 == 0:
            seen += follower.read()
            most = max(most, (tmp_path / IDLE).stat().st_size)
    writer.idle()  # once more is nothing
    seen += follower.read()
    ticks = [row[0] for row in seen]
    assert ticks == sorted(set(ticks)), "a file that is begun anew repeats nothing"
    assert len(ticks) > 2.8 * NEWEST
    assert all(row[1:3] == numbered(int(row[0]))[:2] for row in seen)
    assert most < 1.1 * 8 * (WIDTH + 3) * NEWEST
    assert (tmp_path / FILE).stat().st_size == size
    writer.close()
    follower.close()
    assert not (tmp_path / IDLE).exists()
    assert list(read_record(tmp_path)[1].ticks) == [*range(700)]
    assert writer.trouble is None
