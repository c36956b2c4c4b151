"""Files that a user names or a folder of unknown origin holds: what is no file, an archive of arrays, JSON."""

from __future__ import annotations

import copy
import io
import json
import os
import socket
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import teleop.storage.archive
from channel import Mahimahi, PingLog
from master.recording import Recording
from teleop import Refused, load_scene, run
from teleop.protocol.manifest import fingerprint
from teleop.scene.library import beside
from teleop.simulation.summary_shape import RUN
from teleop.storage.archive import MOST_ARRAYS, read_arrays
from teleop.storage.files import MOST, is_part, open_regular, read_bytes, replacing
from teleop.storage.strict_json import (
    Misshapen,
    between,
    dict_of,
    either,
    list_of,
    one_of,
    optional,
    parse,
    parse_line,
    record,
    text,
    truth,
    whole,
    write_document,
)
from teleop.sweeps.cluster import digest_of
from teleop.sweeps.matrix import read_matrix

READERS: dict[str, Callable[[str], object]] = {
    "a delivery trace": Mahimahi, "a ping log": PingLog, "a hand's motion": lambda path: Recording(path=path),
    "a matrix": read_matrix, "a scene's file": load_scene, "a file that both ends compare":
    lambda path: fingerprint(Path(path)),
}


def endless(at: Path) -> None:
    with at.open("wb") as file:
        file.truncate(1 << 40)  # of zeros; it takes no room on the disk


KINDS: dict[str, tuple[Callable[[Path], object], str]] = {
    "a pipe that nothing writes into": (os.mkfifo, "it is a pipe, not a file"),
    "a device without an end": (lambda at: at.symlink_to("/dev/zero"), "it is a device, not a file"),
    "a folder": (Path.mkdir, "it is a folder, not a file"),
    "a socket": (lambda at: socket.socket(socket.AF_UNIX).bind(str(at)), "it is a socket, not a file"),
    "a file of a terabyte": (endless, "larger than 64 MB"),
}


@pytest.mark.timeout(60)
@pytest.mark.parametrize("kind", KINDS)
def test_a_recording_that_never_ends_holds_up_no_command(kind: str, tmp_path: Path) -> None:
    make, sentence = KINDS[kind]
    make(tmp_path / "s.py")
    for name, reader in READERS.items():
        with pytest.raises(Refused, match=sentence) as refused:
            reader(str(tmp_path / "s.py"))
        assert "s.py" in str(refused.value), name


@pytest.mark.timeout(20)
def test_a_pipe_beside_a_scene_is_no_module_that_it_imports(tmp_path: Path) -> None:
    (tmp_path / "scene.py").write_text("import near\n")
    os.mkfifo(tmp_path / "near.py")
    assert beside(tmp_path / "scene.py") == {}
    assert digest_of(str(tmp_path / "near.py")) is None


def test_a_file_that_grows_while_it_is_read_is_bounded_too(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(bytes(100))
    found = os.stat(tmp_path / "file")
    empty = os.stat_result((*found[:6], 0, *found[7:]))
    monkeypatch.setattr(os, "fstat", lambda _: empty)  # as it was before
    assert read_bytes(tmp_path / "file", most=100) == bytes(100)
    with pytest.raises(OSError, match="larger than 0 kB"):
        read_bytes(tmp_path / "file", most=99)


def test_a_link_is_followed_where_a_user_named_it_and_not_where_a_folder_holds_it(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"content")
    (tmp_path / "link").symlink_to("file")
    assert read_bytes(tmp_path / "link") == b"content"
    with pytest.raises(OSError, match="it is a link, not a file"):
        read_bytes(tmp_path / "link", links=False)
    with pytest.raises(OSError, match="No such file"):
        open_regular(tmp_path / "none")
    assert MOST == 64 << 20


class TestReplacing:
    def test_puts_a_file_in_the_place_of_a_link_also_at_its_own_unfinished_name_and_leaves_its_target_alone(
            self, tmp_path: Path) -> None:
        (tmp_path / "target").write_bytes(b"precious")
        for name in ("name", *[f".name.{os.getpid()}-{attempt}.part" for attempt in range(3)]):
            (tmp_path / name).symlink_to("target")
        with replacing(tmp_path / "name", settle=True) as file:
            file.write(b"new")
        assert (tmp_path / "target").read_bytes() == b"precious"
        assert not (tmp_path / "name").is_symlink()
        assert (tmp_path / "name").read_bytes() == b"new"

    def test_leaves_the_old_file_and_nothing_else_where_it_fails(self, tmp_path: Path) -> None:
        (tmp_path / "name").write_bytes(b"old")
        half: list[Path] = []

        def fail() -> None:
            with replacing(tmp_path / "name") as file:
                file.write(b"half")
                half.extend(each for each in tmp_path.iterdir() if is_part(each, "name"))
                raise RuntimeError

        with pytest.raises(RuntimeError):
            fail()
        assert len(half) == 1
        assert [path.name for path in tmp_path.iterdir()] == ["name"]
        assert (tmp_path / "name").read_bytes() == b"old"


# Arrays of a run


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


def test_ever_more_arrays_one_of_a_name_twice_and_a_link_in_place_of_a_trace_are_refused(tmp_path: Path) -> None:
    with pytest.raises(Misshapen, match="more than 256"):
        read_arrays(saved(tmp_path / "many.npz", **{f"c{i}": np.zeros(ROWS) for i in range(MOST_ARRAYS + 1)}), ROWS)
    data = head_of(ROWS) + bytes(8 * ROWS)
    with zipfile.ZipFile(tmp_path / "twice.npz", "w") as archive:
        archive.writestr("t.npy", data)
        with pytest.warns(UserWarning, match="Duplicate"):
            archive.writestr("t.npy", data)
    with pytest.raises(Misshapen, match="no array of its own"):
        read_arrays(tmp_path / "twice.npz", ROWS)
    (tmp_path / "trace.npz").symlink_to(saved(tmp_path / "elsewhere.npz", t=np.zeros(ROWS)))
    with pytest.raises(OSError, match="it is a link, not a file"):
        read_arrays(tmp_path / "trace.npz", ROWS)


# JSON


JSON: Any = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4), max_leaves=20)


def test_what_is_right_is_taken_and_a_long_wrong_value_is_not_told_at_length() -> None:
    """What is wrong: tests/refusals.toml."""
    checks: tuple[tuple[Any, Any], ...] = (
        (text, "a"), (truth, True), (whole(low=0, high=5), 5), (whole(low=0), 0), (whole(), -7), (between(0.0, 1.0), 1),
        (one_of("m", "s"), "m"), (optional(text), None), (either(text, whole()), 3), (list_of(text), ["a"]),
        (list_of(text, most=1), []), (dict_of(whole()), {"a": 1}), (record({"a": text}), {"a": "x", "b": 1}),
        (record({}, {"a": text}), {}))
    for check, value in checks:
        check(value, "it")
    for wrong in (lambda: whole()("x" * 10_000, "n" * 10_000), lambda: parse(b"[" * 100_000)):
        with pytest.raises(Misshapen) as raised:
            wrong()
        assert len(str(raised.value)) < 400


@pytest.fixture(scope="module")
def summary() -> Any:
    return json.loads(json.dumps(run(load_scene("rubber", duration=0.02)).summary(["teleop"]), default=str))


@given(st.data())
@settings(deadline=None)
def test_a_summary_with_anything_in_place_of_a_value_is_taken_or_is_one_sentence(summary: Any, data: Any) -> None:
    RUN(summary, "summary.json")
    for wrong in ([], {**summary, "metrics": []}):
        with pytest.raises(Misshapen, match=r"summary\.json.* must be an object"):
            RUN(wrong, "summary.json")
    changed = copy.deepcopy(summary)
    place, key = changed, data.draw(st.sampled_from(sorted(changed)))
    while isinstance(place[key], dict) and place[key] and data.draw(st.booleans()):
        place = place[key]
        key = data.draw(st.sampled_from(sorted(place)))
    place[key] = data.draw(JSON)
    sentence = "summary.json"
    try:
        RUN(changed, "summary.json")
    except Misshapen as wrong:
        sentence = str(wrong)
    assert sentence.startswith("summary.json")


def test_a_document_is_written_whole_and_reads_back(tmp_path: Path) -> None:
    value = [None, True, -(2**70), 1e-300, "\u5b57\n\ud83e", {"": {"a": [1.5, {}]}}, []]
    data = json.dumps(value).encode()
    assert parse(data) == parse_line(data) == value
    assert parse_line(b"1e999") == float("inf"), "its caller has to look at the numbers of a line"
    write_document(tmp_path / "summary.json", {"K": float("inf"), "corners": [(0.0, 1.5)]})
    assert parse((tmp_path / "summary.json").read_bytes()) == {"K": "inf", "corners": [[0.0, 1.5]]}
    deep: list[Any] = []
    for _ in range(100_000):
        deep = [deep]
    with pytest.raises(RecursionError):
        write_document(tmp_path / "summary.json", deep)
    assert [path.name for path in tmp_path.iterdir()] == ["summary.json"]
