"""Files of a live end: record and inputs as they come, and after a kill, a full disk, or worse."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from teleop import Refused, load_result, load_scene
from teleop.laws.wave import Back, Forth
from teleop.live.records.end_result import NAMES, WAYS
from teleop.live.records.inputs import ARRIVALS, INPUTS, MOST, InputWriter, input_columns, read_arrivals, read_inputs
from teleop.live.records.merge import merge, recover, scene_of
from teleop.live.records.reader import FILE, IDLE, GrowingRecord, TruncatedRecord, read_record
from teleop.live.records.record import EVENTS, EVERY, NEWEST, RecordWriter, fresh_folder, read_events
from teleop.protocol.guard import Event
from teleop.scene.library import ROOT
from teleop.simulation.structure import columns
from teleop.simulation.trace import EndRecord
from teleop.stages.wave_integral import Integrals
from teleop.terminal.run_table import table
from tests.fakes import raising
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
    RecordWriter(load_scene("recorded_reach"), "m", tmp_path, {**header, "scene": "recorded_reach"}).begin("bodies")
    assert read_record(tmp_path)[0]["columns"][3:9] == ["x_m", "x_m", "x_m", "v_m", "v_m", "v_m"], "once for each axis"


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


@pytest.mark.parametrize(("count", "knobs", "left"), [
    (2 * EVERY + 100, {}, 2 * EVERY), (3, {}, 0), (3, {"dt": "0.5"}, 3)], ids=["late", "early", "of slow ticks"])
def test_a_process_that_is_killed_leaves_a_record_with_all_but_the_last_rows(
    count: int, knobs: dict[str, str], left: int, tmp_path: Path
) -> None:
    recorder = recorded(tmp_path, count, **knobs)  # neither flushed nor closed
    assert list(read_record(tmp_path)[1].ticks) == [*range(left)]
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


def test_what_is_no_record_is_refused_in_one_sentence(tmp_path: Path) -> None:
    for data in (None, b"", b"\n", b"[]\n", b"3\n", b"{}\n", b'{"columns": 5}\n', b"\xff\xfe\n", b'{"columns": ["k"',
                 bytes(100)):
        if data is not None:
            (tmp_path / FILE).write_bytes(data)
        with pytest.raises(Refused, match="holds no record of a live end") as refused:
            read_record(tmp_path)
        assert str(tmp_path) in str(refused.value), data


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


def test_a_folder_that_nobody_kept_is_gone_with_its_parents_but_for_what_was_there_or_is_in_use(tmp_path: Path) -> None:
    with fresh_folder(tmp_path / "a" / "b" / "c"):
        (tmp_path / "a" / "b" / "c" / "file").write_text("")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "old").mkdir()
    with fresh_folder(tmp_path / "old" / "new" / "mine"):
        (tmp_path / "old" / "new" / "another's").mkdir()
    assert [path.name for path in (tmp_path / "old" / "new").iterdir()] == ["another's"]
    with pytest.raises(ZeroDivisionError), fresh_folder(tmp_path / "old" / "kept") as folder:
        raising(ZeroDivisionError())(folder.keep())
    assert (tmp_path / "old" / "kept").is_dir()
    with fresh_folder(tmp_path / "old" / "x"):
        pass
    assert sorted(path.name for path in (tmp_path / "old").iterdir()) == ["kept", "new"]


def test_what_is_there_already_is_left_alone_and_a_place_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "inside").write_text("mine")
    (tmp_path / "file").write_text("mine")
    (tmp_path / "link").symlink_to("nowhere")
    before = sorted(tmp_path.rglob("*"))
    for at, why in (("folder", "is there already; give another folder with --out"), ("file", "is there already"),
                    ("link", "is there already"), ("file/x", r"cannot write to .*file/x \(Not a directory\)")):
        with pytest.raises(Refused, match=why), fresh_folder(tmp_path / at):
            pass
        assert sorted(tmp_path.rglob("*")) == before


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
    master, slave = (dict(result.extra[name]) for name in ("master", "slave"))  # mappings
    assert [event["what"] for event in master["events"]] == ["joined", "session", "met"]
    assert slave["events"] == []
    assert (master["skipped"], slave["skipped"]) == (0, 0)
    assert "E_link" in result.trace, "it is all of one session"


def test_what_two_ends_counted_that_ran_together_is_told(tmp_path: Path) -> None:
    ends = [end_of(tmp_path / e, e, range(1000 - late), [MET], counted=990) for e, late in (("m", 0), ("s", 40))]
    result = merge(SCENE, *ends)
    assert (result.packets["fwd"].sent, result.packets["bwd"].received) == (990, 990)
    assert dict(result.extra["slave"])["lost"] == 700  # a mapping
    assert not any("without the other" in note for note in result.notes)


def test_two_ends_that_met_twice_have_the_ledgers_of_their_last_session_alone(tmp_path: Path) -> None:
    """What the ports took up was below zero where one end's sum had begun anew and the other's had not: energy that
    nobody gave out."""
    ends = [end_of(tmp_path / e, e, range(1000), LONG, counted=990) for e in ("m", "s")]
    result = merge(SCENE, *ends)
    for ledger in ("E_link", "E_port"):
        assert np.isnan(result.trace[ledger][:700]).all()
        assert np.isfinite(result.trace[ledger][700:]).all()
        assert f"{ledger}_min" in result.metrics
    assert any("those of the last session, from t = 0.700 s on" in note for note in result.notes)
    assert result.packets["fwd"].sent == 990
    record_of(tmp_path / "other", "s", [0], law="tdpa").close()
    with pytest.raises(Refused, match="are not the two ends of one run; give two that ran together"):
        merge(SCENE, ends[0], tmp_path / "other")  # which was said to be of another release


def test_two_ends_that_met_for_the_first_time_after_a_turn_did_not_meet_anew(tmp_path: Path) -> None:
    turned = [Event(300, "joined", "a turn"), Event(303, "session", "from rest"), Event(320, "met", "session 2"),
              Event(321, "session", "from rest")]
    result = merge(SCENE, *[end_of(tmp_path / e, e, range(300, 1000), turned, counted=690) for e in ("m", "s")])
    assert np.isnan(result.trace["E_link"][:21]).all()
    assert np.isfinite(result.trace["E_link"][21:]).all()
    assert not any("anew" in note for note in result.notes)


def test_a_folder_without_a_record_names_one_that_has_one(tmp_path: Path) -> None:
    """It said FileNotFoundError."""
    for i, inside in enumerate(([], ["x-1"], ["x-1/master", "x-1/slave"])):
        top = tmp_path / str(i)
        top.mkdir()
        for each in inside:
            recorded(top / each, 3).close()
        said = f"one of its folders, for example {top / 'x-1'}" if inside else "the folder that a live end wrote"
        for ask in (recover, scene_of):
            with pytest.raises(Refused) as refused:
                ask(top)
            assert str(refused.value) == f"{top} holds no record; give {said}"


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


SUMMED = load_scene("hard_wall", duration=1.0, playout="integral")
ABOUT = {"end": "m", "dt_ns": 10**6, "axes": 1, "scene": "hard_wall", "knobs": {"duration": "1.0"}, "seed": 0,
         "mode": "live"}


def inputs_of(folder: Path, count: int) -> InputWriter:
    writer = InputWriter(SUMMED, "m", folder, ABOUT)
    writer.begin(sensor=False)
    for k in range(count):
        writer.arrived(1, k, k * 10**6 + 7, k + 1)
        heard = ((Back(0.5 * k),), (Integrals(0.001 * k, 2.0, 3.0),)) if k % 2 else (None, None)
        inputs = k, (0.1 * k,), (-0.0,), None, k % 2 == 1, k - 3, *heard, 1.0, (0.25,), 1
        writer.ticked(k, 1, inputs, None, (0.3 * k,), (Forth(0.7 * k),), (Integrals(0.002 * k, 4.0, 5.0),))
    return writer


def test_what_an_end_was_told_is_read_back_to_the_bit(tmp_path: Path) -> None:
    inputs_of(tmp_path, 20).close()
    found, came = read_inputs(tmp_path, SUMMED, ABOUT), read_arrivals(tmp_path)
    assert found.header["columns"] == input_columns(SUMMED, "m", sensor=False)
    rows = found.rows.part(0, 20)
    assert rows[7].tolist()[:6] == [7.0, 1.0, 1.0, 1.0, 4.0, 1.0]
    assert rows[7, found.places["rx"]].tolist() == [3.5]
    assert rows[7, found.places["waves"]].tolist() == [0.007, 2.0, 3.0]
    assert rows[8, found.places["waves"]].tolist() == [0.0, 0.0, 0.0]
    assert rows[7, found.places["tx"]].tolist() == [0.7 * 7]
    assert rows[7, found.places["sent"]].tolist() == [0.014, 4.0, 5.0]
    assert np.signbit(rows[:, found.places["v_m"]]).all()
    assert came.packet.tolist() == [*range(20)]
    assert came.time_ns[3] == 3_000_007


def test_a_full_disk_stops_what_is_written_of_the_inputs_never_the_loop_and_a_flood_of_messages_does_not_fill_it(
    tmp_path: Path
) -> None:
    writer = inputs_of(tmp_path, 3)
    writer._files[0].close()
    writer._files[0] = Path("/dev/full").open("wb")  # noqa: SIM115 (the writer closes it)
    writer.flush()
    assert str(writer.trouble).endswith("No space left on device")
    for _ in range(3):
        writer.arrived(1, 0, 0, 0)
        writer.flush()
    writer.close()
    (tmp_path / "flood").mkdir()
    writer = inputs_of(tmp_path / "flood", 1)
    for _ in range(3 * MOST):
        writer.arrived(1, 0, 0, 0)
    writer.close()
    assert len(read_arrivals(tmp_path / "flood").tick) == MOST + 1
    assert str(writer.trouble).startswith(f"{2 * MOST} messages of the law that came are not in {ARRIVALS}")


def edit(path: Path, **keys: Any) -> None:
    first, rows = path.read_bytes().split(b"\n", 1)
    path.write_bytes(json.dumps({**json.loads(first), **keys}).encode() + b"\n" + rows)


SPOILS: list[tuple[Callable[[Path], object], str]] = [
    (lambda at: at.unlink(), "to run again (No such file"),
    (lambda at: at.write_bytes(b"3\n"), "must be an object"),
    (lambda at: at.write_bytes(bytes(99)), "its first line is no header"),
    (lambda at: edit(at, version=2), "is of version 2, and this release reads version 1"),
    (lambda at: edit(at, dt_ns="x"), "dt_ns must be a whole number"),
    (lambda at: (at.unlink(), at.symlink_to("/etc/passwd")), "it is a link"),
]


def test_what_is_no_record_of_inputs_or_not_of_the_record_beside_it_is_refused_in_one_sentence(tmp_path: Path) -> None:
    for spoil, words in SPOILS:
        inputs_of(tmp_path, 3).close()
        for name, read in ((INPUTS, lambda: read_inputs(tmp_path, SUMMED, ABOUT)),
                           (ARRIVALS, lambda: read_arrivals(tmp_path))):
            spoil(tmp_path / name)
            with pytest.raises(Refused) as refused:
                read()
            assert words in str(refused.value)
            assert str(tmp_path) in str(refused.value)
            (tmp_path / name).unlink(missing_ok=True)
    inputs_of(tmp_path, 3).close()
    with pytest.raises(Refused, match="is not of the run whose record lies beside it"):
        read_inputs(tmp_path, SUMMED, {**ABOUT, "scene": "canonical"})
    with pytest.raises(Refused, match="its scene, tick or columns are others"):
        read_inputs(tmp_path, load_scene("hard_wall", law="pfra"), ABOUT)


def test_rows_that_are_cut_off_or_damaged_are_left_out_with_a_sentence(tmp_path: Path) -> None:
    inputs_of(tmp_path, 20).close()
    shutil.copytree(tmp_path, tmp_path / "cut")
    for name in (INPUTS, ARRIVALS):
        whole = (tmp_path / name).read_bytes()
        (tmp_path / "cut" / name).write_bytes(whole[:-5])
    with pytest.warns(TruncatedRecord, match="cut off in the middle of a row"):
        assert len(read_inputs(tmp_path / "cut", SUMMED, ABOUT).rows) == 19
    with pytest.warns(TruncatedRecord, match="row 19 and what came after it are lost"):
        assert len(read_arrivals(tmp_path / "cut").tick) == 19
    data = bytearray((tmp_path / ARRIVALS).read_bytes())
    start = data.index(b"\n") + 1
    data[start + 32 * 4 + 8 : start + 32 * 4 + 16] = (-1).to_bytes(8, "little", signed=True)
    (tmp_path / ARRIVALS).write_bytes(data)
    with pytest.warns(TruncatedRecord, match="damaged, with a row that is no packet of a run: row 4"):
        assert len(read_arrivals(tmp_path).tick) == 4


TICKS = 225_000

CHILD = """
import sys
from pathlib import Path
from teleop.live.records.merge import recover
recover(Path(sys.argv[1]))
peak = [line for line in open("/proc/self/status") if line.startswith("VmHWM:")]  # of this program alone, unlike rusage
print(int(peak[0].split()[1]) // 1024)
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run whose two ends were killed after nearly four minutes."""
    top = tmp_path_factory.mktemp("long")
    ticks = [k for k in range(TICKS) if k % 1000]  # now and then one is left out
    for e, name in (("m", "master"), ("s", "slave")):
        record_of(top / name, e, ticks, events=[Event(0, "met", "session 1")], duration=f"{TICKS * 1e-3}",
                  row=lambda k: (1000 + k % 77, k - 50 if k >= 50 else -1, 0.01 * math.sin(1e-3 * k))).close()
    return top


@pytest.mark.full
@pytest.mark.skipif(sys.platform != "linux", reason="other systems tell the peak otherwise")
def test_the_end_of_half_an_hour_took_more_than_a_gigabyte(run: Path) -> None:
    """1,285 MB for a master, 1,119 MB for a slave, 1,964 MB for both; later 389 MB for both, all columns at once.

    An eighth of that run needs an eighth of it above an interpreter's 40 MB: 195, 175, 280, and later 84 MB.
    """
    for inside, most in ("master", 68), ("slave", 66), ("", 74):
        done = subprocess.run([sys.executable, "-c", CHILD, str(run / inside)], capture_output=True, text=True,
                              check=False)
        assert done.returncode == 0, done.stderr
        told = json.loads((run / inside / "summary.json").read_text())
        assert told["ticks"] == TICKS - TICKS // 1000
        assert told["metrics"]["f_m_max" if inside != "slave" else "f_s_max"]["value"] == pytest.approx(0.01)
        assert int(done.stdout) < most, inside
