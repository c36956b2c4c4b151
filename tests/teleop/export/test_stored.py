"""Which folders can be exported, and what is said of those that cannot."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from teleop import Refused, load_result
from teleop.export.stored import BLOCK, Part, all_fields, read_parts
from teleop.export.stored import _on_one_axis as put_on_one_axis
from teleop.simulation.result import write_arrays
from teleop.storage.folder import claim
from tests.teleop.export.conftest import LiveEnd

Stored = Callable[[str], Path]


def read(folder: Path) -> int:
    return sum(len(block["t"]) for part in read_parts(folder, trust=False) for block in part.blocks())


def refused(folder: Path) -> str:
    with pytest.raises(Refused) as why:
        read(folder)
    return str(why.value)


@pytest.fixture
def copy(tmp_path: Path, stored: Stored) -> Path:
    return Path(shutil.copytree(stored("canonical"), tmp_path / "run"))


def test_one_end_alone_can_be_exported(demo: Path) -> None:
    part, = read_parts(demo / "slave", trust=False)
    assert part.ticks == 390
    assert {"x_s", "late_s"} <= part.fields.keys()
    assert "x_m" not in part.fields


def test_rows_come_in_blocks_that_do_not_grow_with_the_run(tmp_path: Path) -> None:
    LiveEnd(tmp_path / "end", "m", range(2 * BLOCK + 5)).close()
    part, = read_parts(tmp_path / "end", trust=False)
    blocks = list(part.blocks())
    assert [len(block["t"]) for block in blocks] == [BLOCK, BLOCK, 5]
    trace = load_result(tmp_path / "end").trace
    for name in trace:
        assert np.array_equal(np.concatenate([block[name] for block in blocks]), trace[name])


def test_what_a_killed_process_left_is_made_whole_first(demo: Path) -> None:
    assert not (demo / "summary.json").exists()
    part, = read_parts(demo, trust=False)
    assert part.summary["status"] == "stopped"
    assert (demo / "summary.json").is_file()


def test_a_run_that_goes_on_is_to_be_followed_instead(demo: Path) -> None:
    shutil.move(demo / "master", demo.parent / "kept")
    claimed = claim(demo / "master")
    shutil.copytree(demo.parent / "kept", demo / "master", dirs_exist_ok=True)
    assert f"teleop stream {demo} --plotjuggler" in refused(demo)
    assert not (demo / "summary.json").exists()
    claimed.close()
    assert read_parts(demo, trust=False)[0].ticks == 390


def test_parts_of_which_one_goes_on_are_not_exported_yet(turned_run: Path) -> None:
    shutil.move(turned_run / "03" / "master", turned_run / "kept")
    claimed = claim(turned_run / "03" / "master")
    shutil.copytree(turned_run / "kept", turned_run / "03" / "master", dirs_exist_ok=True)
    assert "is of a run that goes on" in refused(turned_run)
    claimed.close()
    assert [part.number for part in read_parts(turned_run, trust=False)] == [1, 2, 3]


def test_a_part_of_which_an_end_left_nothing_is_left_out_with_a_sentence(turned_run: Path) -> None:
    shutil.rmtree(turned_run / "02" / "slave")
    said: list[str] = []
    assert [part.number for part in read_parts(turned_run, trust=False, left_out=said)] == [1, 3]
    (sentence,) = said
    assert sentence.startswith("part 02 is left out: ")
    with pytest.raises(Refused, match="holds no record"):
        read_parts(turned_run, trust=False)


def test_parts_of_which_none_can_be_read(turned_run: Path) -> None:
    for number in (1, 2, 3):
        shutil.rmtree(turned_run / f"{number:02d}" / "slave")
    with pytest.raises(Refused, match="holds no record"):
        read_parts(turned_run, trust=False, left_out=[])


def test_columns_of_all_parts_are_there_once(turned_run: Path) -> None:
    names = [one.name for one in all_fields(read_parts(turned_run, trust=False))]
    assert len(names) == len({*names})
    assert {"E_in_fwd", "G_m", "x_m"} <= {*names}


@pytest.mark.parametrize("first", [0.0, 0.5, 1.0, 1.001, 2.0])
def test_times_grow_from_part_to_part_wherever_a_part_begins(first: float, copy: Path) -> None:
    before, after = Part(copy, 1), Part(copy, 2)
    before.first, before.last, after.first, after.last = 0.0, 1.0, first, first + 1.0
    put_on_one_axis(copy, [before, after])
    assert (before.shift_ns, after.ns(first)) == (0, max(1_001_000_000, round(first * 1e9)))


def test_a_folder_of_something_else_or_a_damaged_run_is_refused(copy: Path, tmp_path: Path) -> None:
    data, text = (copy / "trace.npz").read_bytes(), (copy / "summary.json").read_text()
    flipped = bytearray(data)
    flipped[len(data) // 2] ^= 1
    backwards = BytesIO()
    trace = dict(load_result(copy).trace)
    write_arrays(backwards, {**trace, "t": trace["t"][::-1].copy()})
    for damaged, sentence in (
            (data[: int(len(data) * 0.1)], "holds no complete run"), (data[: int(len(data) * 0.9)], "no complete run"),
            (bytes(flipped), "holds no complete run (BadZipFile"), (backwards.getvalue(), "no times t that grow")):
        (copy / "trace.npz").write_bytes(damaged)
        assert sentence in refused(copy)
    (tmp_path / "other.npz").write_bytes(data)
    (copy / "trace.npz").unlink()
    assert "trace.npz: No such file" in refused(copy)
    (copy / "trace.npz").symlink_to(tmp_path / "other.npz")
    assert "holds no complete run" in refused(copy)
    (copy / "trace.npz").unlink()
    (copy / "trace.npz").write_bytes(data)
    (copy / "summary.json").write_text(json.dumps({**json.loads(text), "ticks": 5}))
    assert "the run has 5 rows" in refused(copy)
    (copy / "summary.json").write_text('{"status": "done", "mode": "zwidth"}')
    assert "holds no complete run" in refused(copy)
    (copy / "sweep.json").write_text("{}")
    assert "holds a sweep" in refused(copy)
