"""A scene worked out once: each part is made a single time, and all that asks has the same."""

from __future__ import annotations

from dataclasses import replace

import pytest

import teleop.simulation.bodies
from teleop.scene.loading import load_scene
from teleop.simulation.prepared import prepare
from teleop.simulation.virtual import run, run_prepared

SCENE = replace(load_scene("canonical"), duration=0.2)


def test_a_run_builds_the_slave_once(monkeypatch: pytest.MonkeyPatch) -> None:
    built = []
    build = teleop.simulation.bodies._slave

    def counted(*given: object) -> object:
        built.append(given)
        return build(*given)  # type: ignore[arg-type]

    monkeypatch.setattr(teleop.simulation.bodies, "_slave", counted)
    assert run(SCENE).status == "ok"
    assert len(built) == SCENE.axes


def test_every_part_is_made_once() -> None:
    prepared = prepare(SCENE)
    for part in ("bodies", "slaves", "reference", "starts", "numbers", "loop"):
        assert getattr(prepared, part) is getattr(prepared, part)
    assert prepared.bodies.slaves is prepared.slaves


def test_a_prepared_scene_runs_again_and_again_with_the_bits_of_a_run() -> None:
    prepared, once = prepare(SCENE), run(SCENE, seed=3)
    for _ in range(2):
        again = run_prepared(prepared, seed=3)
        assert again.metrics == once.metrics
        assert again.sentence == once.sentence
