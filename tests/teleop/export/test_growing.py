"""A live run that is followed: each row of each end once, in order, while its record grows."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop import GrowingRun, Refused
from teleop.live.records.reader import FILE
from teleop.storage.folder import claim
from tests.teleop.export.conftest import LiveEnd


def ticks(run: GrowingRun, most: int = 16) -> dict[tuple[int, str], list[int]]:
    """All ticks that there are now, by part and end."""
    found: dict[tuple[int, str], list[int]] = {}
    while True:
        some = run.take(most)
        for one in some:
            assert 0 < len(one.rows) <= most
            found.setdefault((one.end.number, one.end.header["end"]), []).extend(int(row[0]) for row in one.rows)
        if not some:
            return found


def times(run: GrowingRun) -> list[int]:
    """The times (ms) of all rows of the master, in the order in which they are told."""
    found: list[int] = []
    while some := run.take(16):
        for one in some:
            if one.end.header["end"] == "m":
                found += [int(row[0]) + one.shift_ns // 10**6 for row in one.rows]
    return found


def test_both_ends_of_a_run_that_is_over_are_told_of_in_turn_or_one_alone(demo: Path) -> None:
    first = GrowingRun(demo).take(16)
    assert [(one.end.header["end"], len(one.rows)) for one in first] == [("m", 16), ("s", 16)]
    for folder, rows in ((demo, {(0, "m"): [*range(400)], (0, "s"): [*range(390)]}),
                         (demo / "slave", {(0, "s"): [*range(390)]})):
        run = GrowingRun(folder)
        assert not run.live
        assert ticks(run) == rows
        assert run.over


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of an end with 100 rows."""
    folder = tmp_path_factory.mktemp("whole") / "end"
    LiveEnd(folder, "m", range(100)).close()
    return folder


@given(st.lists(st.integers(0, 60), min_size=1, max_size=6))
def test_each_row_is_told_of_once_however_the_record_grows(whole: Path, steps: Sequence[int]) -> None:
    with tempfile.TemporaryDirectory() as at:
        folder = Path(at, "end")
        claimed = claim(folder)
        shutil.copytree(whole, folder, dirs_exist_ok=True)
        data, seen = (folder / FILE).read_bytes(), list[int]()
        start = data.index(b"\n") + 1
        run = GrowingRun(folder)
        assert run.live
        cut = 0
        for step in steps:  # of any number of bytes, also in the middle of a row, or of the header
            cut += 37 * step
            (folder / FILE).write_bytes(data[:cut])
            seen += ticks(run).get((0, "m"), [])
            width = len(data[start:]) // 100
            assert seen == [*range(max(0, cut - start) // width)][:100]
            assert not run.over
        (folder / FILE).write_bytes(data)
        claimed.close()
        assert seen + ticks(run).get((0, "m"), []) == [*range(100)]
        assert run.over


def test_an_end_that_begins_later_is_found(tmp_path: Path) -> None:
    claimed = claim(tmp_path / "demo")
    run = GrowingRun(tmp_path / "demo")
    assert ticks(run) == {}
    assert not run.over
    end = LiveEnd(tmp_path / "demo" / "master", "m", range(20))
    assert ticks(run) == {(0, "m"): [*range(20)]}
    end.add(range(20, 25))
    end.close()
    LiveEnd(tmp_path / "demo" / "slave", "s", range(3)).close()
    assert ticks(run) == {(0, "m"): [*range(20, 25)], (0, "s"): [0, 1, 2]}
    assert not run.over
    claimed.close()
    assert ticks(run) == {}
    assert run.over


def test_a_part_that_comes_later_is_found_on_the_same_axis_of_time(turned_run: Path) -> None:
    assert times(GrowingRun(turned_run)) == [*range(200), *range(220, 500), *range(500, 600)]
    shutil.move(turned_run / "03", turned_run.parent / "kept")
    shutil.move(turned_run, turned_run.parent / "before")
    claimed = claim(turned_run)
    shutil.copytree(turned_run.parent / "before", turned_run, dirs_exist_ok=True)
    run = GrowingRun(turned_run)
    assert times(run) == [*range(200), *range(220, 500)]
    assert not run.over
    shutil.move(turned_run.parent / "kept", turned_run / "03")
    assert times(run) == [*range(500, 600)]
    claimed.close()
    assert times(run) == []
    assert run.over


def test_a_row_that_is_no_tick_ends_it_with_a_sentence(demo: Path) -> None:
    data = bytearray((demo / "slave" / FILE).read_bytes())
    start = data.index(b"\n") + 1
    width = (len(data) - start) // 390
    data[start + 100 * width : start + 100 * width + 8] = bytes(8)  # tick 0 again
    (demo / "slave" / FILE).write_bytes(data)
    with pytest.raises(Refused, match="after tick 99 comes a row that is no tick"):
        ticks(GrowingRun(demo))


def test_what_is_no_live_run_is_refused(tmp_path: Path, demo: Path) -> None:
    (demo / "master" / FILE).write_bytes(b"something else\n")
    with pytest.raises(Refused, match="no sound record of a live end"):
        ticks(GrowingRun(demo / "master"))
    (tmp_path / "trace.npz").write_bytes(b"")
    with pytest.raises(Refused, match=f"teleop export {tmp_path} --mcap FILE or --csv FILE"):
        GrowingRun(tmp_path)
