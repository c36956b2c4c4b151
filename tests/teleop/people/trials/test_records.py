"""Records of a trial, made again to the bit, what is measured of them, and markers beside other recordings."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from teleop.errors import Refused
from teleop.people.plan import TaskKind
from teleop.people.schedule import Trial
from teleop.people.trials.markers import lsl_markers
from teleop.people.trials.records import begin_trial, keep, measure, rest_begins, unpack

DT = 1e-3


def write(folder: Path, e: str, columns: dict[str, np.ndarray], rest: bytes = b"", name: str = "record.bin") -> None:
    folder.mkdir(parents=True, exist_ok=True)
    header = {"end": e, "dt_ns": 1_000_000, "axes": 1, "scene": "hard_wall", "knobs": {"law": "wave"}, "seed": 0,
              "mode": "live", "force": "sensor", "columns": list(columns)}
    table = np.stack([np.asarray(each, "<f8") for each in columns.values()], axis=1)
    (folder / name).write_bytes(json.dumps(header).encode() + b"\n" + table.tobytes() + rest)


def ends(folder: Path, x: np.ndarray, f: np.ndarray, skips: tuple[int, ...] = ()) -> dict[str, Path]:
    """Records of a master at x whose slave is 20 ms behind, with forces f; ticks from 100 on, some left out."""
    k = np.array([i for i in range(len(x)) if i not in skips])
    behind = np.concatenate([np.full(20, x[0]), x[:-20]])
    for e, name, at in (("m", "master", x), ("s", "slave", behind)):
        write(folder / name, e, {"k": 100 + k, "late_ns": 0 * k, "seq": 80 + k, f"x_{e}": at[k], f"f_{e}": f[k]})
    return {"m": folder / "master", "s": folder / "slave"}


def trial(level: float, width: float = 0.0) -> Trial:
    return Trial(number=1, letter="A", place=1, training=False, level=level, width=width, second=False)


def test_a_record_comes_back_to_the_bit_in_files_that_no_other_user_reads(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    numbers = rng.standard_normal(400)
    numbers[:4] = np.nan, -0.0, np.inf, 5e-324
    for e, name in (("m", "master"), ("s", "slave")):
        write(tmp_path / name, e, {"k": np.arange(400), "same": numbers, "again": numbers}, rest=b"cut")
        write(tmp_path / name, e, {"k": np.arange(400), "other": -numbers}, name="inputs.bin")
    (tmp_path / "master" / "hand.bin").write_bytes(b"a hand\n")
    kept, back = tmp_path / "kept", tmp_path / "back"
    keep({"m": tmp_path / "master", "s": tmp_path / "slave"}, kept)
    assert {path.name: path.stat().st_mode & 0o777 for path in kept.rglob("*") if path.is_file()} == {
        "ends.bin": 0o600, "hand.bin": 0o600}
    assert b"wave" not in (kept / "ends.bin").read_bytes()
    assert (kept / "ends.bin").stat().st_size < 3 * 400 * 8, "columns that are alike are kept once"
    unpack(kept, back)
    for name in ("master/record.bin", "master/inputs.bin", "slave/record.bin", "slave/inputs.bin", "master/hand.bin"):
        assert (back / name).read_bytes() == (tmp_path / name).read_bytes(), name
    data = (kept / "ends.bin").read_bytes()
    for damaged in (b"", data[:-9], b"no" + data):
        (kept / "ends.bin").write_bytes(damaged)
        with pytest.raises(Refused, match="no record of a trial"):
            unpack(kept, tmp_path / "other")


def test_a_reach_is_measured_from_the_first_movement_of_the_hand_to_the_rest_of_the_robot(tmp_path: Path) -> None:
    t = np.arange(1500) * DT
    s = np.clip((t - 0.2) / 0.5, 0.0, 1.0)
    x = 0.053 * s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
    got = measure(TaskKind.REACH, trial(0.05, 0.01), ends(tmp_path, x, 0.0 * x), (100, 1599), DT)
    begins = 0.001 * np.flatnonzero(x > 1e-3)[0]
    rests = 0.001 * np.flatnonzero(x >= 0.053 - 1e-3)[0] + 0.02
    assert got.time == pytest.approx(rests - begins, abs=2e-3)
    assert got.end == pytest.approx(0.053, abs=1e-5), "where it stays, and not where it comes within a millimetre"
    assert got.overshoot == pytest.approx(0.003, abs=1e-6)
    assert got.delay == pytest.approx(0.04)
    assert got.skipped == 0.0
    assert rest_begins(x[:650], 0.05, DT) is None, "it goes on"
    assert rest_begins(0.0 * x, 0.05, DT) is None, "it has not begun"


def test_a_press_is_timed_to_its_force_and_skipped_ticks_are_counted(tmp_path: Path) -> None:
    t = np.arange(1000) * DT
    x, f = 0.01 * np.clip(t - 0.1, 0.0, 1.0), 10.0 * np.clip(t - 0.1, 0.0, 0.6)
    got = measure(TaskKind.PRESS, trial(5.0), ends(tmp_path, x, -f, skips=(300, 301)), (100, 1099), DT)
    assert got.peak_force == pytest.approx(6.0)
    assert got.overshoot == pytest.approx(1.0)
    assert got.time == pytest.approx(0.5 - 0.1, abs=2e-3)
    assert got.skipped == pytest.approx(0.002)
    short = measure(TaskKind.PRESS, trial(9.0), {"m": tmp_path / "master", "s": tmp_path / "slave"}, (100, 1099), DT)
    assert short.time is None, "a force that is never reached has none"
    assert short.overshoot == pytest.approx(-3.0)


def test_a_trial_that_is_begun_again_knows_how_often_it_was_cut(tmp_path: Path) -> None:
    folder = tmp_path / "trial-007"
    assert [begin_trial(folder) for _ in range(3)] == [0, 1, 2]
    (tmp_path / "trial-007.part").mkdir()
    assert begin_trial(folder) == 3
    assert not (tmp_path / "trial-007.part").exists()


def test_markers_go_out_as_a_stream_of_texts_and_without_pylsl_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[Any] = []

    class Outlet:
        def __init__(self, about: tuple[Any, ...]) -> None:
            sent.append(about)

        def push_sample(self, texts: list[str]) -> None:
            sent.append(texts)

    monkeypatch.setitem(sys.modules, "pylsl", SimpleNamespace(StreamInfo=lambda *about: about, StreamOutlet=Outlet))
    mark = lsl_markers("try", 3)
    mark("trial 1 interval 1")
    assert sent == [("teleop-try", "Markers", 1, 0.0, "string", "try-sub-03"), ["trial 1 interval 1"]]
    monkeypatch.setitem(sys.modules, "pylsl", None)
    with pytest.raises(Refused, match=r"bilateral-teleop\[lsl\]"):
        lsl_markers("try", 3)
