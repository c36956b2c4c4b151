"""Robots in MuJoCo, most of which are not pressed against what they touch before their run."""

import pytest


@pytest.fixture
def pressing() -> None:
    """Robots are pressed before their run, for the notes on it: 0.3 s each."""


@pytest.fixture(autouse=True)
def _not_pressed(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if "pressing" not in request.fixturenames:
        monkeypatch.setattr("slave.mujoco_robot.pressed", lambda *_: [])
