"""Live folders as they are opened: of others, which run and follow nothing, and of ends that still run."""

from __future__ import annotations

import json
import shutil
import sys
import tracemalloc
from array import array
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from teleop import Refused, load_result, load_scene
from teleop.__main__ import main
from teleop.live.records.end_result import NAMES
from teleop.live.records.inputs import ARRIVALS, INPUTS
from teleop.live.records.merge import merge, needs_recovery, scene_of
from teleop.live.records.reader import FILE, TruncatedRecord, header_columns, read_record
from teleop.live.records.record import EVENTS, read_events
from teleop.protocol.guard import Event
from teleop.simulation.result import RUNNING
from teleop.storage.folder import claim, is_being_written
from tests.live.recording import add_rows, record_of

KNOBS = {"duration": "1.0"}
SCENE = load_scene("hard_wall", duration=1.0)


def header(e: str = "m", **other: Any) -> dict[str, Any]:
    return {"end": e, "dt_ns": 10**6, "axes": 1, "scene": "hard_wall", "knobs": KNOBS, "seed": 0, "mode": "live",
            "command": ["python"], "every": 1, "force": "bodies", "columns": header_columns(SCENE, e, "bodies"),
            **other}


def record(folder: Path, ticks: list[float], head: object = None, e: str = "m", last: bytes = b"") -> Path:
    """A record with a row of zeros at each of these ticks."""
    folder.mkdir(parents=True, exist_ok=True)
    head = header(e) if head is None else head
    width = len(header_columns(SCENE, e, "bodies"))
    rows = array("d", [value for k in ticks for value in (k, 0.0, -1.0, *[0.0] * (width - 3))])
    (folder / FILE).write_bytes(json.dumps(head).encode() + b"\n" + rows.tobytes() + last)
    return folder


@pytest.fixture
def peak() -> Any:
    """What was allocated since, at most, in bytes."""
    tracemalloc.start()
    yield lambda: tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()


@pytest.mark.parametrize(("tick", "duration", "says"), [
    (1e9, "1.0", "holds the record of a run that never came to its first tick"),
    (9.9e7, "1.0", "a tick 99000000, and its run has the ticks 0 to 999"),
    (9.9e7, "1e5", None), (1e308, "1e5", "never came"), (float("nan"), "1.0", "never came"), (0.5, "1.0", "never came"),
    (-1.0, "1.0", "never came"),
])
def test_a_record_of_300_bytes_with_a_tick_of_1e9_takes_no_gigabytes(
    tick: float, duration: str, says: str | None, tmp_path: Path, peak: Callable[[], int]
) -> None:
    load_scene("hard_wall")  # imports are no matter of the record
    folder = record(tmp_path / "m", [tick], header(knobs={"duration": duration}))
    if says is None:
        got = load_result(folder)
        assert (got.ticks, got.metrics.get("f_h_max")) == (1, None)
        assert any("rows lie so far apart" in note for note in got.notes)
    else:
        with pytest.raises(Refused, match=says):
            load_result(folder)
    assert peak() < 30_000_000


def test_two_ends_of_which_one_has_a_tick_far_beyond_are_put_together_in_little_memory(
    tmp_path: Path, peak: Callable[[], int]
) -> None:
    long = {"duration": "1e5"}
    for e, name in (("m", "master"), ("s", "slave")):
        record(tmp_path / name, [0.0, 1.0, 9e7], header(e, knobs=long), e)
    got = merge(scene_of(tmp_path / "master"), tmp_path / "master", tmp_path / "slave")
    assert got.ticks == 3
    assert peak() < 30_000_000


def test_a_record_of_a_terabyte_of_zeros_ends_at_its_first_unsound_row(tmp_path: Path, peak: Callable[[], int]) -> None:
    folder = record(tmp_path / "m", [0.0, 1.0, 2.0])
    with (folder / FILE).open("ab") as file:
        file.truncate(1 << 40)
    with pytest.warns(TruncatedRecord, match="damaged, with a row that is no tick of a run: row 3 and what came after"):
        assert list(read_record(folder)[1].ticks) == [0, 1, 2]
    assert peak() < 10_000_000
    assert any("damaged" in note for note in load_result(folder).notes)


class TestAScene:
    CODE = "from pathlib import Path\nPath('ran').touch()\nfrom scenarios.hard_wall import scene\n"

    @pytest.fixture(autouse=True)
    def here(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.chdir(tmp_path)
        Path("evil.py").write_text(self.CODE)
        Path("secret").write_text("0\n5\nsecret\n")

    def test_that_the_folder_names_and_is_not_installed_is_run_for_who_trusts_the_folder_alone(
        self, capsys: pytest.CaptureFixture[str]
    ) -> None:
        for name in ("os", "", "m/evil.py", "../scenarios/hard_wall", "evil", "./evil.py", "evil.py"):
            for folder in (record(Path("m"), [0.0], header(scene=name)), record(Path("s"), [0.0], header("s"), "s")):
                (folder / "evil.py").write_text(self.CODE)
            for ask in (lambda: load_result("m"), lambda: scene_of(Path("m"))):
                with pytest.raises(Refused, match=r"is a file with code .*--trust"):
                    ask()
            assert main(["report", "m"]) == main(["report", "m", "s"]) == 2
            assert not Path("ran").exists(), name
        assert main(["report", "--trust", "m"]) == 0
        assert "wave" in capsys.readouterr().out
        assert Path("ran").exists()

    def test_whose_knobs_name_a_file_of_this_machine_has_it_read_only_for_who_trusts(self) -> None:
        for scene, knobs in (
            ("lte", {"up": "secret", "down": "secret"}), ("recorded_reach", {"motion": "secret"}),
            ("hard_wall", {"link": "mahimahi('secret')"}), ("hard_wall", {"link": 'delay(0.1) | ping_log("secret")'}),
            ("hard_wall", {"link": "mahimahi(secret)"}), ("hard_wall", {"link": "delay(0) ; recorded( ../secret )"}),
        ):
            record(Path("m"), [0.0], header(scene=scene, knobs=knobs))
            with pytest.raises(Refused, match=r"names a file of this machine, so it is not read.*trust=True"):
                load_result("m")
            with pytest.raises(Refused, match="secret"):
                load_result("m", trust=True)

    def test_that_is_another_than_the_records_is_not_taken_for_it(self) -> None:
        for change in ({"columns": [*header_columns(SCENE, "m", "bodies")[:-1], "other"]}, {"axes": 3},
                       {"dt_ns": 2 * 10**6}, {"knobs": {"energy": "false"}}):
            record(Path("m"), [0.0], header(**change))
            with pytest.raises(Refused, match="is not of the scene hard_wall as it is here"):
                load_result("m")


WRONG: list[dict[str, Any]] = [
    {"end": "x"}, {"end": None}, {"end": ["m"]}, {"dt_ns": "1"}, {"dt_ns": 0}, {"dt_ns": 10**300}, {"axes": 10**9},
    {"scene": 3}, {"scene": {}}, {"knobs": []}, {"knobs": {"duration": [1]}}, {"seed": -1}, {"seed": 1 << 64},
    {"mode": "virtual"}, {"columns": 5}, {"columns": []}, {"columns": ["k", "late_ns", "seq"]}, {"columns": [1] * 9},
    {"columns": ["x"] * 1601}, {"every": 0}, {"every": 10**9}, {"force": "felt"}, {"command": "rm"}, {"command": [1]},
]


def test_a_header_of_wrong_types_is_one_sentence(tmp_path: Path) -> None:
    for change in WRONG:
        record(tmp_path, [0.0, 1.0], header(**change))
        for ask in (load_result, scene_of):
            with pytest.raises(Refused, match="holds no record of a live end") as refused:
                ask(tmp_path)
            assert len(str(refused.value)) < 400, change


def test_events_of_wrong_types_are_left_out(tmp_path: Path) -> None:
    good = {"k": 3, "what": "safe", "why": "silence"}
    wrong: list[Any] = [[], 3, {}, {**good, "k": "3"}, {**good, "k": 1e9}, {**good, "what": []}, {**good, "why": None}]
    lines = [json.dumps(each) for each in [*wrong, good]]
    (tmp_path / EVENTS).write_text("\n".join([*lines, '{"k": NaN}', "[" * 10_000]))
    assert read_events(tmp_path) == [good]


class TestALink:
    @pytest.fixture(autouse=True)
    def precious(self, tmp_path: Path) -> Any:
        (tmp_path / "precious").write_text("precious")
        yield
        assert (tmp_path / "precious").read_text() == "precious"

    def test_in_place_of_what_report_writes_is_replaced_and_its_target_stays(self, tmp_path: Path) -> None:
        folder = record(tmp_path / "m", [0.0, 1.0])
        for name in ("trace.npz", "summary.json", "plot.png", ".plot.png.part"):
            (folder / name).symlink_to(tmp_path / ("nowhere" if name == "summary.json" else "precious"))
        assert main(["report", str(folder), "--plot"]) == 0
        assert not (tmp_path / "nowhere").exists()
        assert not any((folder / name).is_symlink() for name in ("trace.npz", "summary.json"))
        assert (folder / "plot-2.png").is_file()

    @pytest.mark.parametrize("name", [FILE, "summary.json"])
    def test_in_place_of_what_report_reads_is_not_followed(self, name: str, tmp_path: Path) -> None:
        folder, other = (record(tmp_path / each, [0.0, 1.0]) for each in "mo")
        load_result(other)
        (folder / name).unlink(missing_ok=True)
        (folder / name).symlink_to(other / name)
        with pytest.raises(Refused, match="it is a link, not a file"):
            load_result(folder)

    def test_in_place_of_an_ends_folder_is_not_followed(self, tmp_path: Path) -> None:
        for e, name in (("m", "master"), ("s", "slave")):
            record(tmp_path / "elsewhere" / name, [0.0, 1.0], e=e)
        (tmp_path / "run").mkdir()
        for name in ("master", "slave"):
            (tmp_path / "run" / name).symlink_to(tmp_path / "elsewhere" / name)
        with pytest.raises(Refused, match="is a link, and what a folder links to is not opened"):
            load_result(tmp_path / "run")
        assert sorted(path.name for path in (tmp_path / "elsewhere" / "master").iterdir()) == [FILE]


MINUTE = load_scene("hard_wall", duration=60.0)
MET = [Event(0, "met", "session 1")]

locked = pytest.mark.skipif(sys.platform == "win32", reason="folders are not locked there")

class End:
    """An end that holds its folder and records as many ticks as it is told to; of a demo the folder alone."""

    def __init__(self, e: str, folder: Path) -> None:
        self.claimed, self.done = claim(folder), 0
        self.recorder = None if e == "demo" else record_of(folder, e, events=MET, duration="60.0")

    def tick(self, count: int) -> None:
        assert self.recorder is not None
        add_rows(self.recorder, range(self.done, self.done + count))
        self.recorder.flush()
        self.done += count

    def kill(self) -> None:
        """Let go of the folder without a word, as the system does for a process that is gone."""
        self.claimed.close()


def left_in(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def shown(capsys: pytest.CaptureFixture[str], *typed: object) -> str:
    assert main(["report", *map(str, typed)]) == 0
    return capsys.readouterr().out


@locked
def test_a_run_that_was_reported_while_it_ran_and_then_killed_stayed_at_that_tick_for_good(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """And a running process was said to have "ended without a word"."""
    end = End("m", tmp_path / "m")
    end.tick(1000)
    assert not is_being_written(tmp_path)
    assert not is_being_written(tmp_path / "not there")
    assert is_being_written(tmp_path / "m")
    before = left_in(tmp_path)
    said = shown(capsys, tmp_path / "m")
    assert "still running: this is its record up to tick 999" in said
    assert "nothing is written while it runs" in said
    assert "without a word" not in said
    assert json.loads(shown(capsys, tmp_path / "m", "--json"))["status"] == RUNNING
    assert left_in(tmp_path) == before
    end.tick(2000)
    assert load_result(tmp_path / "m").ticks == 3000
    end.tick(500)
    end.kill()
    assert not is_being_written(tmp_path / "m")
    for _ in range(2):
        result = load_result(tmp_path / "m")
        assert (result.status, result.ticks, len(result.trace["t"])) == ("stopped", 3500, 3500)
        assert result.sentence.startswith("the process ended without a word after tick 3499")


@locked
def test_a_run_that_has_not_ticked_yet_is_said_to_have_just_begun(tmp_path: Path) -> None:
    End("m", tmp_path / "m")
    with pytest.raises(Refused, match="has not come to its first tick yet; ask again in a moment"):
        load_result(tmp_path / "m")
    End("demo", tmp_path / "demo")
    with pytest.raises(Refused, match="is being written, and there is nothing to show of it yet; ask again"):
        load_result(tmp_path / "demo")
    End("m", tmp_path / "demo" / "master").tick(1)
    with pytest.raises(Refused, match="is being written, and there is nothing to show of it yet"):
        load_result(tmp_path / "demo")


@locked
def test_two_ends_of_which_one_was_killed_and_one_runs_are_shown_and_not_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    master, slave = End("m", tmp_path / "m"), End("s", tmp_path / "s")
    master.tick(1000)
    slave.tick(1200)
    said = shown(capsys, tmp_path / "m", tmp_path / "s", "--out", tmp_path / "both")
    assert "still running: master and slave; these are the ticks that both have run" in said
    slave.kill()
    said = shown(capsys, tmp_path / "m", tmp_path / "s", "--out", tmp_path / "both")
    assert "still running: master;" in said
    assert "slave: the process ended without a word after tick 1199" in said
    assert not (tmp_path / "both").exists()
    assert [sorted(left_in(tmp_path / each)) for each in "ms"] == [[ARRIVALS, "events.jsonl", INPUTS, FILE]] * 2
    master.tick(150)
    master.kill()
    assert "written to" in shown(capsys, tmp_path / "m", tmp_path / "s", "--out", tmp_path / "both")
    assert load_result(tmp_path / "both").ticks == 1150


@locked
def test_the_folder_of_a_demo_is_whole_when_neither_end_nor_demo_runs(tmp_path: Path) -> None:
    top = tmp_path / "top"
    demo = End("demo", top)
    ends = [End(e, top / name) for e, name in NAMES.items()]
    for end in ends:
        end.tick(1000)
    assert load_result(top).status == RUNNING
    ends[0].kill()
    assert load_result(top).status == RUNNING
    ends[1].tick(500)
    ends[1].kill()
    result = load_result(top)
    assert result.status == RUNNING
    assert result.sentence.startswith("still running: both ends are over")
    assert not (top / "summary.json").exists()
    demo.kill()
    result = load_result(top)
    assert (result.status, result.ticks) == ("stopped", 1000)
    assert (top / "summary.json").exists()


def test_what_was_made_of_one_end_or_of_two_too_early_is_made_again_when_the_record_has_grown(tmp_path: Path) -> None:
    """Where a folder cannot be locked, or was copied while it was written, a process cannot be seen to run."""
    recorder = record_of(tmp_path, "m", range(500), events=MET, duration="60.0")
    recorder.flush()
    assert load_result(tmp_path).ticks == 500
    assert not needs_recovery(tmp_path)
    add_rows(recorder, range(500, 800))
    recorder.flush()
    assert needs_recovery(tmp_path)
    assert load_result(tmp_path).ticks == 800
    recorder.close()
    summary: Any = json.loads((tmp_path / "summary.json").read_text())
    del summary["recovered"]  # what an end writes that came to its own end
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    with (tmp_path / FILE).open("ab") as file:
        file.write(bytes(8))
    assert not needs_recovery(tmp_path)
    top = tmp_path / "top"
    later = [record_of(top / name, e, range(750), duration="60.0") for e, name in NAMES.items()]
    assert load_result(top).ticks == 750
    for recorder in later:
        add_rows(recorder, range(750, 1000))
        recorder.close()
    assert load_result(top).ticks == 1000
    shutil.rmtree(top / "slave")  # what was put together once is still there to be read
    assert load_result(top).ticks == 1000


def test_an_end_that_comes_to_its_end_while_it_is_read_is_not_cut_off_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It ran when the record was read, and had written its own summary when that was looked for."""
    folders = [tmp_path / name for name in NAMES.values()]
    for e, folder in zip(NAMES, folders, strict=True):
        record_of(folder, e, range(500), duration="60.0").close()
        load_result(folder)
    monkeypatch.setattr("teleop.live.records.merge.is_being_written", lambda folder: folder == folders[0])
    assert merge(MINUTE, *folders).status == RUNNING
