"""A robot in MuJoCo at the slave's end of a live run, by its name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from teleop.live.records.merge import load_result, merge, scene_of
from tests.live.conftest import Command, summary

pytestmark = pytest.mark.live


def test_the_slave_of_a_live_run_is_the_arm_in_mujoco(command: Callable[..., Command], tmp_path: Path) -> None:
    """It presses the wall of its model, the master feels it, and its folder tells how stiff that is."""
    pytest.importorskip("mujoco", reason="mujoco-core is not installed (extra mujoco)")
    own = ["arm", "--set", "duration=2.5", "--set", "delay=0.0", "--json"]
    slave = command("slave", *own, "--robot", "mujoco", "--listen", "127.0.0.1:0", "--out", "s")
    master = command("master", *own, "--peer", f"127.0.0.1:{slave.port()}", "--out", "m")
    assert [each.end()[0] for each in (master, slave)] == [0, 0]
    assert [note for note in summary(tmp_path / "s")["notes"] if note.startswith("pressed slowly before the run")]
    ran = load_result(tmp_path / "s").trace
    assert ran["f_env"][-1, 0] > 2.0
    assert ran["x_s"][-1, 0] == pytest.approx(0.03, abs=1e-3)
    both = merge(scene_of(tmp_path / "m"), tmp_path / "m", tmp_path / "s")
    assert both.status == "ok"
    assert both.trace["f_m"][-1, 0] == pytest.approx(both.trace["f_env"][-1, 0], rel=0.2)
