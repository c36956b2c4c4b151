"""`teleop doctor`: what is here, what is kept, and how to be rid of it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from teleop import doctor


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
    monkeypatch.setattr(doctor, "_version", lambda name: None if name == "numba" else "1.2.3")
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
def test_it_says_what_a_live_end_gets_of_real_time_scheduling_and_what_to_type(
    typed: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    told = json.loads(typed("doctor", "--json").out)["realtime"]
    assert set(told) == {"scheduler", "memory", "cure"}
    assert (told["cure"] is None) == (not any(told[name].startswith("no ") for name in ("scheduler", "memory")))
    refused = "import json; print(json.dumps({'scheduler': 'no (Operation not permitted)', 'memory': 'locked'}))"
    monkeypatch.setattr(doctor, "_ASK", refused)
    monkeypatch.setattr("teleop.live.process.realtime.cure", lambda *, for_good: f"type this, {for_good}")
    said = typed("doctor").out
    assert "a live end gets scheduler no (Operation not permitted), memory locked\n" in said
    assert said.rstrip().endswith("type this, True")
