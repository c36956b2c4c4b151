"""The arrays of a run read back: as they were written, and never more memory than the file has any right to ask for."""

from __future__ import annotations

import io
import tracemalloc
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from teleop.storage.archive import INFLATED, MOST_ARRAYS, read_arrays
from teleop.storage.strict_json import Misshapen

ROWS = 5


def saved(at: Path, *, compressed: bool = False, **arrays: Any) -> Path:
    (np.savez_compressed if compressed else np.savez)(at, **arrays)
    return at


@pytest.mark.parametrize("compressed", [False, True])
def test_every_kind_of_column_is_read_back_to_the_bit(tmp_path: Path, compressed: bool) -> None:
    wide = np.arange(15.0).reshape(ROWS, 3)
    arrays: dict[str, Any] = {
        "t": np.arange(5.0) / 10.0, "x_m": wide, "x_s": np.asfortranarray(wide), "seq_m": np.arange(5) - 1,
        "alone": np.ones((ROWS, 1)), "truth": np.arange(5) > 2, "inf": np.array([np.inf, -np.inf, np.nan, -0.0, 1e308]),
    }
    got = read_arrays(saved(tmp_path / "trace.npz", compressed=compressed, **arrays), ROWS)
    assert [*got] == [*arrays]
    for name, column in arrays.items():
        assert got[name].dtype == column.dtype
        assert got[name].tobytes() == column.tobytes()
        assert got[name].flags.writeable
    none = read_arrays(saved(tmp_path / "none.npz", t=np.zeros(0), x_m=np.zeros((0, 3))), 0)
    assert none["x_m"].shape == (0, 3)


@pytest.mark.parametrize(("name", "array", "says"), [
    ("t", np.array([object()] * ROWS), "holds object"), ("t", np.zeros(ROWS, complex), "holds complex"),
    ("t", np.zeros(ROWS, "f2"), "holds float16"),
    ("t", np.zeros(ROWS, "f8,i4"), "holds"), ("t", np.zeros(ROWS, "M8[s]"), "holds datetime"),
    ("t", np.array(["a"] * ROWS), "holds <U1"), ("t", np.zeros(3), "the run has 5 rows"),
    ("t", np.array(3.0), "the run has 5 rows"), ("t", np.zeros((ROWS, 17)), "the run has 5 rows"),
    ("t", np.zeros((ROWS, 1, 1)), "the run has 5 rows"), ("../../t", np.zeros(ROWS), "is no array"),
    ("a b", np.zeros(ROWS), "is no array"), ("t\x1b[2J", np.zeros(ROWS), "is no array"),
])
def test_a_pickle_or_another_shape_in_a_trace_is_refused(name: str, array: Any, says: str, tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "trace.npz", "w") as archive:
        data = io.BytesIO()
        np.save(data, array)
        archive.writestr(f"{name}.npy", data.getvalue())
    with pytest.raises(Misshapen, match=says):
        read_arrays(tmp_path / "trace.npz", ROWS)


def bomb(at: Path, rows: int, arrays: int) -> Path:
    """Zeros: a thousandth of what they inflate to."""
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (rows,)})
    with zipfile.ZipFile(at, "w", zipfile.ZIP_DEFLATED) as archive:
        for i in range(arrays):
            with archive.open(f"c{i}.npy", "w") as part:
                part.write(head.getvalue())
                for _ in range(rows // 125_000):
                    part.write(bytes(1_000_000))
    return at


def test_a_small_archive_that_inflates_to_gigabytes_takes_no_memory(tmp_path: Path) -> None:
    path = bomb(tmp_path / "trace.npz", 12_500_000, 4)
    assert path.stat().st_size < 1_000_000
    tracemalloc.start()
    try:
        with pytest.raises(Misshapen, match=r"would inflate to 400000512"):
            read_arrays(path, 12_500_000)
        assert tracemalloc.get_traced_memory()[1] < 2_000_000
    finally:
        tracemalloc.stop()
    assert INFLATED < 400_000_512


def test_an_array_that_says_it_is_greater_than_it_is_takes_no_memory(tmp_path: Path) -> None:
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (10**8,)})
    with zipfile.ZipFile(tmp_path / "trace.npz", "w") as archive:
        archive.writestr("t.npy", head.getvalue() + bytes(80))
    with pytest.raises(Misshapen, match="of another size than its head says"):
        read_arrays(tmp_path / "trace.npz", 10**8)


@pytest.mark.parametrize("size", [8 * ROWS - 1, 8 * ROWS + 1, 16 * ROWS])
def test_an_array_of_another_size_than_its_head_says_is_refused_shorter_or_longer(size: int, tmp_path: Path) -> None:
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (ROWS,)})
    with zipfile.ZipFile(tmp_path / "trace.npz", "w") as archive:
        archive.writestr("t.npy", head.getvalue() + bytes(size))
    with pytest.raises(Misshapen, match="of another size than its head says"):
        read_arrays(tmp_path / "trace.npz", ROWS)


def test_ever_more_arrays_or_one_of_a_name_twice_are_refused(tmp_path: Path) -> None:
    with pytest.raises(Misshapen, match="more than 256"):
        read_arrays(saved(tmp_path / "many.npz", **{f"c{i}": np.zeros(ROWS) for i in range(MOST_ARRAYS + 1)}), ROWS)
    data = io.BytesIO()
    np.save(data, np.zeros(ROWS))
    with zipfile.ZipFile(tmp_path / "twice.npz", "w") as archive:
        archive.writestr("t.npy", data.getvalue())
        with pytest.warns(UserWarning, match="Duplicate"):
            archive.writestr("t.npy", data.getvalue())
    with pytest.raises(Misshapen, match="no array of its own"):
        read_arrays(tmp_path / "twice.npz", ROWS)


def test_a_link_in_place_of_a_trace_is_not_followed(tmp_path: Path) -> None:
    saved(tmp_path / "elsewhere.npz", t=np.zeros(ROWS))
    (tmp_path / "trace.npz").symlink_to("elsewhere.npz")
    with pytest.raises(OSError, match="it is a link, not a file"):
        read_arrays(tmp_path / "trace.npz", ROWS)
