"""`teleop run SCENE --hand FOLDER`: a person's own drag again, in virtual time."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from master.steered import SteeredMaster
from teleop import load_result, load_scene, run

Typed = Callable[..., Any]


@pytest.fixture
def drag(typed: Typed, tmp_path: Path) -> Path:  # noqa: ARG001 - it is run in a folder of its own
    """The folder of a master whose hand was dragged into the wall within 0.8 s."""
    folder = tmp_path / "drag"
    folder.mkdir()
    device = SteeredMaster(load_scene("hard_wall"))
    device.record(folder)
    device.steer([0.05])
    device.read(800)
    device.record(None)
    return folder


def test_it_is_the_run_that_python_makes_and_says_whose_hand_it_was(typed: Typed, drag: Path) -> None:
    answer = typed("run", "hard_wall", "--hand", "drag", "--set", "law=pfra", "--out", "here")
    assert (answer.code, answer.err) == (0, "")
    stored, ours = load_result("here"), run(load_scene("hard_wall", hand=drag, law="pfra"))
    assert stored.ticks == 800
    for name, column in ours.trace.items():
        np.testing.assert_array_equal(stored.trace[name], column)
    summary = json.loads(Path("here/summary.json").read_text())
    assert summary["parameters"]["hand"] == "drag"
    assert summary["parameters"]["duration"] == 0.8
    assert summary["command"][-2:] == ["--out", "here"]


def test_its_report_needs_no_folder_of_the_drag_and_a_duration_that_is_set_stands(typed: Typed, drag: Path) -> None:
    first = typed("run", "hard_wall", "--hand", str(drag), "--set", "duration=0.3", "--out", "here")
    assert "ran to its end" in first.out
    shutil.rmtree(drag)
    again = typed("report", "here", "--json")
    assert (again.code, again.err) == (0, "")
    assert json.loads(again.out)["ticks"] == 300


def test_what_is_no_drag_for_the_scene_is_refused_before_anything_is_written(typed: Typed, drag: Path) -> None:
    Path("alone.py").write_text(
        "from teleop import MassDamper, Scene, Wave\n\n\ndef scene(*, duration: float = 1.0) -> Scene:\n"
        "    return Scene(law=Wave(), master=MassDamper(mass=0.1), slave=MassDamper(mass=0.5), duration=duration)\n")
    for scene, sentence in (
            ("recorded_reach", "was recorded in 1 axis with dt=0.001 s, and the scene has 3 axes"),
            ("alone.py", "moves nothing in a scene without a hand")):
        typed("run", scene, "--hand", str(drag)).assert_refused(sentence)
        assert not Path("runs").exists()
