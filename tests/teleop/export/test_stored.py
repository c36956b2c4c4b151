"""Which folders can be exported, and columns with their units as JSON objects whose numbers come back to the bit."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from io import BytesIO
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop import Refused, load_result, load_scene
from teleop.export.columns import KNOWN, TOPICS, Objects, field, paths_of, quantity
from teleop.export.stored import BLOCK, Part, all_fields, read_parts
from teleop.export.stored import _on_one_axis as put_on_one_axis
from teleop.scene.catalogue import names
from teleop.simulation.result import write_arrays
from teleop.simulation.structure import columns
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


def test_rows_come_in_blocks_that_do_not_grow_with_the_run(tmp_path: Path) -> None:
    LiveEnd(tmp_path / "end", "m", range(2 * BLOCK + 5)).close()
    part, = read_parts(tmp_path / "end", trust=False)
    blocks = list(part.blocks())
    assert [len(block["t"]) for block in blocks] == [BLOCK, BLOCK, 5]
    trace = load_result(tmp_path / "end").trace
    for name in trace:
        assert np.array_equal(np.concatenate([block[name] for block in blocks]), trace[name])


def test_what_a_killed_process_left_is_made_whole_first_of_one_end_too(demo: Path) -> None:
    assert not (demo / "summary.json").exists()
    part, = read_parts(demo, trust=False)
    assert part.summary["status"] == "stopped"
    assert (demo / "summary.json").is_file()
    part, = read_parts(demo / "slave", trust=False)
    assert part.ticks == 390
    assert {"x_s", "late_s"} <= part.fields.keys()
    assert "x_m" not in part.fields


def test_a_run_or_a_part_that_goes_on_is_to_be_followed_instead(demo: Path, turned_run: Path) -> None:
    for folder, end, sentence in ((demo, demo / "master", f"teleop stream {demo} --plotjuggler"),
                                  (turned_run, turned_run / "03" / "master", "is of a run that goes on")):
        shutil.move(end, folder / "kept")
        claimed = claim(end)
        shutil.copytree(folder / "kept", end, dirs_exist_ok=True)
        shutil.rmtree(folder / "kept")
        assert sentence in refused(folder)
        assert not (folder / "summary.json").exists()
        claimed.close()
    assert read_parts(demo, trust=False)[0].ticks == 390
    parts = read_parts(turned_run, trust=False)
    assert [part.number for part in parts] == [1, 2, 3]
    names = [one.name for one in all_fields(parts)]
    assert len(names) == len({*names}), "a column of several parts is there once"
    assert {"E_in_fwd", "G_m", "x_m"} <= {*names}


def test_a_part_without_an_end_is_left_out_with_a_sentence_and_all_of_them_are_refused(turned_run: Path) -> None:
    empty = shutil.copytree(turned_run, turned_run.parent / "empty")
    shutil.rmtree(turned_run / "02" / "slave")
    said: list[str] = []
    assert [part.number for part in read_parts(turned_run, trust=False, left_out=said)] == [1, 3]
    (sentence,) = said
    assert sentence.startswith("part 02 is left out: ")
    assert "holds no record" in refused(turned_run)
    for number in (1, 2, 3):
        shutil.rmtree(empty / f"{number:02d}" / "slave")
    with pytest.raises(Refused, match="holds no record"):
        read_parts(empty, trust=False, left_out=[])


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


WITHOUT = {"lte"}  # it asks for recordings
SCENES = sorted({*names()["scenes"]} - WITHOUT)


def test_every_column_of_a_scene_is_known_with_its_unit_and_as_many_axes() -> None:
    for scene in SCENES:
        made = load_scene(scene)
        for e in "ms" if made.slave is not None else "m":
            for name in columns(made, e):
                found = KNOWN[name.removesuffix("@")]
                assert found.unit, (scene, name)
                assert found.axes == name.endswith("@"), (scene, name)


def test_every_column_has_a_topic_and_a_meaning_of_its_own_which_tells_the_ends_of_the_link_apart() -> None:
    assert {one.topic for one in KNOWN.values()} == {*TOPICS, ""}
    assert len({one.meaning for one in KNOWN.values()}) == len(KNOWN)
    for name, words in (
            ("seq_m", "backward message that the master played"), ("seq_s", "forward message that the slave played"),
            ("E_in_fwd", "the master's waves have brought into the link, forward"),
            ("E_out_fwd", "played at the slave have taken out of the link, forward"),
            ("E_in_bwd", "the slave's waves have brought into the link, backward"),
            ("E_out_bwd", "played at the master have taken out of the link, backward")):
        assert words in quantity(name).meaning


def test_one_axis_is_an_object_with_x_as_three_are_and_a_field_that_a_law_shows_says_whose_it_is() -> None:
    assert paths_of(field("x_m", 1)) == [("master", "x_m", "x")]
    assert paths_of(field("x_m", 3), topic=False) == [("x_m", "x"), ("x_m", "y"), ("x_m", "z")]
    assert paths_of(field("g_s", 1)) == [("slave", "g_s")]
    assert field("x_m", 1).flat == ("x_m",)
    assert field("f_env", 2).flat == ("f_env_x", "f_env_y")
    assert quantity("stored_s") == ("", "stored of the state of the slave's law, in its own unit", "slave", True)


PATHS = [("t",), ("master", "x", "x"), ("link", "seq"), ("master", "x", "y"), ("master", "50% \"n\"")]
NUMBERS = st.one_of(st.floats(), st.integers(-(10**12), 10**12))


def strict(text: str) -> Any:
    """As a strict reader takes it: it knows no NaN."""
    def refuse(word: str) -> None:
        raise AssertionError(word)

    return json.loads(text, parse_constant=refuse)


@given(st.lists(st.tuples(*[NUMBERS] * len(PATHS)), max_size=5))
def test_every_finite_number_comes_back_to_the_bit_under_its_path(rows: list[tuple[float, ...]]) -> None:
    texts = Objects(PATHS).texts([[row[i] for row in rows] for i in range(len(PATHS))])
    assert len(texts) == len(rows)
    for text, row in zip(texts, rows, strict=True):
        got = strict(text)
        for path, value in zip(PATHS, row, strict=True):
            found: Any = got
            for name in path:
                found = found.get(name, {})
            if isfinite(value):
                assert (repr(found), type(found)) == (repr(value), type(value))
            else:
                assert found == {}


def test_what_is_left_empty_is_left_out_too_and_a_sum_that_overflows_leaves_no_number_out() -> None:
    assert Objects([("t",), ("x", "x")]).texts([[0.5, 1.5], [float("nan"), 2.5]]) == ['{"t":0.5}',
                                                                                    '{"t":1.5,"x":{"x":2.5}}']
    assert Objects([("f",)]).texts([[1e308, 1e308]]) == ['{"f":1e+308}', '{"f":1e+308}']
