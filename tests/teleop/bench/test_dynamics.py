"""The bench of an arm without its weight: what it leaves, and what its observer tells, of the arm of this project."""

from __future__ import annotations

import pytest

from teleop.bench import dynamics
from teleop.scene.library import ROOT

pytest.importorskip("mujoco", reason="mujoco-core is not installed (extra mujoco)")


def test_it_measures_an_arm_that_is_named_and_what_is_left_is_small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dynamics, "SECONDS", 3.5)
    monkeypatch.setattr(dynamics, "TICKS", 200)
    monkeypatch.setattr("slave.mujoco_robot.pressed", lambda *_: [])
    rows = {what.strip(): value for what, value, _ in dynamics.dynamics(1, [str(ROOT / "slave" / "arm.xml")])}
    values = {what: float(value.split()[0]) for what, value in rows.items()}
    assert values["compensated"] < 0.01 * values["without compensation"]
    assert values["by a model that is 5 % too light"] > 10.0 * values["compensated"]
    assert values["and against them behind the same low-pass"] < 0.1
    assert values["its delay, of means over 50 ms"] == pytest.approx(10.5, abs=2.5)
    assert values["a tick with both, where 1000 `x=x*1.0001+0.5` take 30 us"] > 0.0
