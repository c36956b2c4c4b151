"""What an end was told, on the disk: rows as they come, a full disk, a flood, files that are none."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from teleop import Refused, load_scene
from teleop.laws.wave import Back, Forth
from teleop.live.records.inputs import ARRIVALS, INPUTS, MOST, InputWriter, input_columns, read_arrivals, read_inputs
from teleop.live.records.reader import TruncatedRecord
from teleop.stages.wave_integral import Integrals

SCENE = load_scene("hard_wall", duration=1.0, playout="integral")
ABOUT = {"end": "m", "dt_ns": 10**6, "axes": 1, "scene": "hard_wall", "knobs": {"duration": "1.0"}, "seed": 0,
         "mode": "live"}


def written(folder: Path, count: int) -> InputWriter:
    writer = InputWriter(SCENE, "m", folder, ABOUT)
    writer.begin(sensor=False)
    for k in range(count):
        writer.arrived(1, k, k * 10**6 + 7, k + 1)
        heard = ((Back(0.5 * k),), (Integrals(0.001 * k, 2.0, 3.0),)) if k % 2 else (None, None)
        inputs = k, (0.1 * k,), (-0.0,), None, k % 2 == 1, k - 3, *heard, 1.0, (0.25,), 1
        writer.ticked(k, 1, inputs, None, (0.3 * k,), (Forth(0.7 * k),), (Integrals(0.002 * k, 4.0, 5.0),))
    return writer


def test_what_an_end_was_told_is_read_back_to_the_bit(tmp_path: Path) -> None:
    written(tmp_path, 20).close()
    found, came = read_inputs(tmp_path, SCENE, ABOUT), read_arrivals(tmp_path)
    assert found.header["columns"] == input_columns(SCENE, "m", sensor=False)
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


def test_a_full_disk_stops_what_is_written_of_the_inputs_and_never_the_loop(tmp_path: Path) -> None:
    writer = written(tmp_path, 3)
    writer._files[0].close()
    writer._files[0] = Path("/dev/full").open("wb")  # noqa: SIM115 (the writer closes it)
    writer.flush()
    assert str(writer.trouble).endswith("No space left on device")
    for _ in range(3):
        writer.arrived(1, 0, 0, 0)
        writer.flush()
    writer.close()


def test_a_flood_of_messages_does_not_fill_the_disk(tmp_path: Path) -> None:
    writer = written(tmp_path, 1)
    for _ in range(3 * MOST):
        writer.arrived(1, 0, 0, 0)
    writer.close()
    assert len(read_arrivals(tmp_path).tick) == MOST + 1
    assert str(writer.trouble).startswith(f"{2 * MOST} messages of the law that came are not in {ARRIVALS}")


def edit(path: Path, **keys: Any) -> None:
    first, rows = path.read_bytes().split(b"\n", 1)
    path.write_bytes(json.dumps({**json.loads(first), **keys}).encode() + b"\n" + rows)


@pytest.mark.parametrize(("spoil", "words"), [
    (lambda at: at.unlink(), "to run again (No such file"),
    (lambda at: at.write_bytes(b"3\n"), "must be an object"),
    (lambda at: at.write_bytes(bytes(99)), "its first line is no header"),
    (lambda at: edit(at, version=2), "is of version 2, and this release reads version 1"),
    (lambda at: edit(at, dt_ns="x"), "dt_ns must be a whole number"),
    (lambda at: (at.unlink(), at.symlink_to("/etc/passwd")), "it is a link"),
], ids=["missing", "other", "zeros", "version", "shape", "link"])
def test_what_is_no_record_of_inputs_is_refused_in_one_sentence(
    spoil: Callable[[Path], object], words: str, tmp_path: Path
) -> None:
    written(tmp_path, 3).close()
    for name, read in ((INPUTS, lambda: read_inputs(tmp_path, SCENE, ABOUT)),
                       (ARRIVALS, lambda: read_arrivals(tmp_path))):
        spoil(tmp_path / name)
        with pytest.raises(Refused) as refused:
            read()
        assert words in str(refused.value)
        assert str(tmp_path) in str(refused.value)


def test_inputs_of_another_scene_than_the_record_beside_them_are_refused(tmp_path: Path) -> None:
    written(tmp_path, 3).close()
    with pytest.raises(Refused, match="is not of the run whose record lies beside it"):
        read_inputs(tmp_path, SCENE, {**ABOUT, "scene": "canonical"})
    with pytest.raises(Refused, match="its scene, tick or columns are others"):
        read_inputs(tmp_path, load_scene("hard_wall", law="pfra"), ABOUT)


def test_rows_that_are_cut_off_or_damaged_are_left_out_with_a_sentence(tmp_path: Path) -> None:
    written(tmp_path, 20).close()
    shutil.copytree(tmp_path, tmp_path / "cut")
    for name in (INPUTS, ARRIVALS):
        whole = (tmp_path / name).read_bytes()
        (tmp_path / "cut" / name).write_bytes(whole[:-5])
    with pytest.warns(TruncatedRecord, match="cut off in the middle of a row"):
        assert len(read_inputs(tmp_path / "cut", SCENE, ABOUT).rows) == 19
    with pytest.warns(TruncatedRecord, match="row 19 and what came after it are lost"):
        assert len(read_arrivals(tmp_path / "cut").tick) == 19
    data = bytearray((tmp_path / ARRIVALS).read_bytes())
    start = data.index(b"\n") + 1
    data[start + 32 * 4 + 8 : start + 32 * 4 + 16] = (-1).to_bytes(8, "little", signed=True)
    (tmp_path / ARRIVALS).write_bytes(data)
    with pytest.warns(TruncatedRecord, match="damaged, with a row that is no packet of a run: row 4"):
        assert len(read_arrivals(tmp_path).tick) == 4
