"""`teleop doctor`: what is here, what is kept, and how to be rid of it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from teleop.doctor import command

LATE = {"ticks": 900, "left_out": 0, "precise": True, "late_us": {"p50": 50.0, "p99": 120.0, "p100": 900.0}}
MEASURED: dict[str, Any] = {
    "scheduler": "SCHED_FIFO, priority 40", "memory": "locked",
    "ordinary": LATE, "realtime": LATE,
    "loopback": {"sent": 3000, "lost": 0, "round_trip_us": {"p50": 13.0, "p99": 20.0, "p100": 80.0}, "stamps": True,
                 "buffer": {"asked": 1 << 20, "given": 2 << 20, "holds": 2520, "of": 4000}},
}


@pytest.fixture(autouse=True)
def measured(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the probe told, without waiting for it."""
    monkeypatch.setattr(command, "measure", lambda: MEASURED)


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folder = tmp_path / "cache" / "bilateral-teleop" / "kernels"
    (folder / "__pycache__").mkdir(parents=True)
    (folder / "teleop_kernel_1.py").write_text("x")
    (folder / "__pycache__" / "teleop_kernel_1.loop-1.nbi").write_text("yy")
    (folder / "notes.txt").write_text("mine")
    return folder


def test_it_says_what_is_installed_and_what_is_not(
    typed: Callable[..., Any], cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "version_of", lambda name: None if name == "numba" else "1.2.3")
    said = typed("doctor").out
    assert "not installed: pip install 'bilateral-teleop[batch]'" in said
    assert str(cache) in said


def test_as_json_it_has_versions_and_sizes(typed: Callable[..., Any], cache: Path) -> None:
    told = json.loads(typed("doctor", "--json").out)
    assert told["packages"]["numpy"] == np.__version__
    assert told["kernels"] == {"folder": str(cache), "modules": 1, "bytes": 3, "not_kept": None}


def test_it_clears_the_kernels_and_nothing_else(typed: Callable[..., Any], cache: Path) -> None:
    assert typed("doctor", "--clear").out.startswith("1 kernel removed")
    assert [path.name for path in cache.rglob("*") if path.is_file()] == ["notes.txt"]
    assert json.loads(typed("doctor", "--json").out)["kernels"]["modules"] == 0


def test_where_nothing_is_kept_there_is_nothing_to_clear(
    typed: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "none"))
    assert typed("doctor", "--clear").code == 0


@pytest.mark.usefixtures("cache")
def test_it_says_of_each_thing_whether_it_is_good_and_what_to_type_where_it_is_not(
    typed: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    told = {**MEASURED, "scheduler": "no (Operation not permitted)", "realtime": None}
    monkeypatch.setattr(command, "measure", lambda: told)
    monkeypatch.setattr("teleop.live.process.realtime.cure", lambda *, for_good: f"type this, {for_good}")
    lines = [" ".join(line.split()) for line in typed("doctor").out.splitlines()]
    at = lines.index("real time poor: a live end gets scheduler no (Operation not permitted), memory locked")
    assert lines[at + 1] == "type this, True"
    assert any(line.startswith("loopback ok: none of 3000 round trips lost") for line in lines)


@pytest.mark.usefixtures("cache")
def test_as_json_it_has_every_number_that_was_measured(typed: Callable[..., Any]) -> None:
    told = json.loads(typed("doctor", "--json").out)
    assert told["measured"] == MEASURED
    assert {"others", "governors", "rmem_max"} <= told.keys()
    assert told["realtime"] == {"scheduler": MEASURED["scheduler"], "memory": MEASURED["memory"], "cure": None}
    assert [one["name"] for one in told["findings"]] == \
        ["name", "timer", "real time", "loopback", "buffer", "frequency"]
    assert all((one["cure"] is None) == (one["good"] is not False) for one in told["findings"])


@pytest.mark.usefixtures("cache")
def test_where_nothing_could_be_measured_the_rest_is_told(
    typed: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "measure", lambda: {"error": "its process did not come up"})
    said = typed("doctor").out
    assert "poor: nothing could be measured, for its process did not come up" in said
    assert "numpy" in said
