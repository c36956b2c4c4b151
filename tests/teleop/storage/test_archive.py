"""The arrays of a run read back: as they were written, and never more memory than the file has any right to ask for."""

from __future__ import annotations

import io
import tracemalloc
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import teleop.storage.archive
from teleop.storage.archive import MOST_ARRAYS, read_arrays
from teleop.storage.strict_json import Misshapen

ROWS = 5


def saved(at: Path, *, compressed: bool = False, **arrays: Any) -> Path:
    (np.savez_compressed if compressed else np.savez)(at, **arrays)
    return at


def test_every_kind_of_column_is_read_back_to_the_bit(tmp_path: Path) -> None:
    wide = np.arange(15.0).reshape(ROWS, 3)
    arrays: dict[str, Any] = {
        "t": np.arange(5.0) / 10.0, "x_m": wide, "x_s": np.asfortranarray(wide), "seq_m": np.arange(5) - 1,
        "alone": np.ones((ROWS, 1)), "truth": np.arange(5) > 2, "inf": np.array([np.inf, -np.inf, np.nan, -0.0, 1e308]),
    }
    for compressed in (False, True):
        got = read_arrays(saved(tmp_path / "trace.npz", compressed=compressed, **arrays), ROWS)
        assert [*got] == [*arrays]
        for name, column in arrays.items():
            assert got[name].dtype == column.dtype
            assert got[name].tobytes() == column.tobytes()
            assert got[name].flags.writeable
    none = read_arrays(saved(tmp_path / "none.npz", t=np.zeros(0), x_m=np.zeros((0, 3))), 0)
    assert none["x_m"].shape == (0, 3)


def test_the_curves_of_an_analysis_have_lengths_of_their_own_and_may_be_complex(tmp_path: Path) -> None:
    arrays: dict[str, Any] = {"frequency": np.arange(7.0), "roots": np.array([1j, -1j, 0.5]),
                              "h": np.arange(12.0).reshape(3, 2, 2) * 1j}
    got = read_arrays(saved(tmp_path / "curves.npz", **arrays), None)
    assert {name: (each.dtype, each.tobytes()) for name, each in got.items()} == {
        name: (each.dtype, each.tobytes()) for name, each in arrays.items()}
    for wrong, why in ((np.zeros((2, 2, 2, 2)), "curves have 1 to 3"), (np.array(1.0), "curves have 1 to 3"),
                       (np.array([object()]), "holds object")):
        with pytest.raises(Misshapen, match=why):
            read_arrays(saved(tmp_path / "curves.npz", wrong=wrong), None)


def test_a_pickle_or_another_shape_in_a_trace_is_refused(tmp_path: Path) -> None:
    for name, array, sentence in (
            ("t", np.array([object()] * ROWS), "holds object"), ("t", np.zeros(ROWS, complex), "holds complex"),
            ("t", np.zeros(ROWS, "f2"), "holds float16"), ("t", np.zeros(ROWS, "f8,i4"), "holds"),
            ("t", np.zeros(ROWS, "M8[s]"), "holds datetime"), ("t", np.array(["a"] * ROWS), "holds <U1"),
            ("t", np.zeros(3), "the run has 5 rows"), ("t", np.array(3.0), "the run has 5 rows"),
            ("t", np.zeros((ROWS, 17)), "the run has 5 rows"), ("t", np.zeros((ROWS, 1, 1)), "the run has 5 rows"),
            ("../../t", np.zeros(ROWS), "is no array"), ("a b", np.zeros(ROWS), "is no array"),
            ("t\x1b[2J", np.zeros(ROWS), "is no array")):
        with zipfile.ZipFile(tmp_path / "trace.npz", "w") as archive:
            data = io.BytesIO()
            np.save(data, array)
            archive.writestr(f"{name}.npy", data.getvalue())
        with pytest.raises(Misshapen, match=sentence):
            read_arrays(tmp_path / "trace.npz", ROWS)


def head_of(rows: int) -> bytes:
    """The head of an array of so many numbers."""
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (rows,)})
    return head.getvalue()


def test_a_small_archive_that_inflates_to_gigabytes_takes_no_memory(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Zeros: a thousandth of what they inflate to. Here of a tenth of the size, with a bound of a tenth."""
    assert teleop.storage.archive.INFLATED < 400_000_512
    monkeypatch.setattr(teleop.storage.archive, "INFLATED", teleop.storage.archive.INFLATED // 10)
    path, rows = tmp_path / "trace.npz", 1_250_000
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for i in range(4):
            archive.writestr(f"c{i}.npy", head_of(rows) + bytes(8 * rows))
    assert path.stat().st_size < 100_000
    tracemalloc.start()
    try:
        with pytest.raises(Misshapen, match=r"would inflate to 40000512"):
            read_arrays(path, rows)
        assert tracemalloc.get_traced_memory()[1] < 2_000_000
    finally:
        tracemalloc.stop()


def test_an_array_of_another_size_than_its_head_says_is_refused_shorter_or_longer(tmp_path: Path) -> None:
    """And takes no memory for what is not there."""
    for rows, size in ((10**8, 80), (ROWS, 8 * ROWS - 1), (ROWS, 8 * ROWS + 1), (ROWS, 16 * ROWS)):
        with zipfile.ZipFile(tmp_path / "trace.npz", "w") as archive:
            archive.writestr("t.npy", head_of(rows) + bytes(size))
        with pytest.raises(Misshapen, match="of another size than its head says"):
            read_arrays(tmp_path / "trace.npz", rows)


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
