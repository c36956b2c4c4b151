"""Live folders that others have sent: opening one runs nothing, follows nothing, and takes what its bytes can mean."""

from __future__ import annotations

import json
import tracemalloc
from array import array
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from teleop import Refused, load_result, load_scene
from teleop.__main__ import main
from teleop.live.records.merge import merge, scene_of
from teleop.live.records.reader import FILE, TruncatedRecord, header_columns, read_record
from teleop.live.records.record import EVENTS, read_events

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

    @pytest.mark.parametrize("name", ["evil.py", "./evil.py", "evil", "../scenarios/hard_wall", "m/evil.py", "os", ""])
    def test_that_the_folder_names_and_is_not_installed_is_not_run(self, name: str) -> None:
        for folder in (record(Path("m"), [0.0], header(scene=name)), record(Path("s"), [0.0], header("s"), "s")):
            (folder / "evil.py").write_text(self.CODE)
        for ask in (lambda: load_result("m"), lambda: scene_of(Path("m"))):
            with pytest.raises(Refused, match=r"is a file with code .*--trust"):
                ask()
        assert main(["report", "m"]) == main(["report", "m", "s"]) == 2
        assert not Path("ran").exists()

    def test_is_run_for_who_trusts_the_folder(self, capsys: pytest.CaptureFixture[str]) -> None:
        record(Path("m"), [0.0], header(scene="evil.py"))
        assert main(["report", "--trust", "m"]) == 0
        assert "wave" in capsys.readouterr().out
        assert Path("ran").exists()

    @pytest.mark.parametrize(("scene", "knobs"), [
        ("lte", {"up": "secret", "down": "secret"}), ("recorded_reach", {"motion": "secret"}),
        ("hard_wall", {"link": "mahimahi('secret')"}), ("hard_wall", {"link": 'delay(0.1) | ping_log("secret")'}),
        ("hard_wall", {"link": "mahimahi(secret)"}), ("hard_wall", {"link": "delay(0) ; recorded( ../secret )"}),
    ])
    def test_whose_knobs_name_a_file_of_this_machine_has_it_read_only_for_who_trusts(
        self, scene: str, knobs: dict[str, str]
    ) -> None:
        record(Path("m"), [0.0], header(scene=scene, knobs=knobs))
        with pytest.raises(Refused, match=r"names a file of this machine, so it is not read.*trust=True"):
            load_result("m")
        with pytest.raises(Refused, match="secret"):
            load_result("m", trust=True)

    @pytest.mark.parametrize("change", [
        {"columns": [*header_columns(SCENE, "m", "bodies")[:-1], "other"]}, {"axes": 3}, {"dt_ns": 2 * 10**6},
        {"knobs": {"energy": "false"}},
    ])
    def test_that_is_another_than_the_records_is_not_taken_for_it(self, change: dict[str, Any]) -> None:
        record(Path("m"), [0.0], header(**change))
        with pytest.raises(Refused, match="is not of the scene hard_wall as it is here"):
            load_result("m")


@pytest.mark.parametrize("change", [
    {"end": "x"}, {"end": None}, {"end": ["m"]}, {"dt_ns": "1"}, {"dt_ns": 0}, {"dt_ns": 10**300}, {"axes": 10**9},
    {"scene": 3}, {"scene": {}}, {"knobs": []}, {"knobs": {"duration": [1]}}, {"seed": -1}, {"seed": 1 << 64},
    {"mode": "virtual"}, {"columns": 5}, {"columns": []}, {"columns": ["k", "late_ns", "seq"]}, {"columns": [1] * 9},
    {"columns": ["x"] * 1601}, {"every": 0}, {"every": 10**9}, {"force": "felt"}, {"command": "rm"}, {"command": [1]},
])
def test_a_header_of_wrong_types_is_one_sentence(change: dict[str, Any], tmp_path: Path) -> None:
    record(tmp_path, [0.0, 1.0], header(**change))
    for ask in (load_result, scene_of):
        with pytest.raises(Refused, match="holds no record of a live end") as refused:
            ask(tmp_path)
        assert len(str(refused.value)) < 400


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
