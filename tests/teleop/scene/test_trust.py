"""Scenes that a stored folder names: those installed are made again, files are opened for who trusts the folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from teleop import Refused
from teleop.scene.library import built_in_scenes
from teleop.scene.loading import asks_for_trust, check_installed, stored_scene


@pytest.mark.parametrize("name", built_in_scenes())
def test_every_built_in_scene_is_made_again_from_its_name(name: str) -> None:
    check_installed(name)
    if name != "lte":  # which has no scene without its recordings
        assert stored_scene(name, {"duration": "0.5"}, trust=False).ticks == 500
        assert not asks_for_trust(name, {"duration": "0.5"})
    assert not asks_for_trust("canonical", {"link": "delay(0.05) | bernoulli(0.1)"})


@pytest.mark.parametrize(("name", "knobs"), [
    ("mine.py", {}), ("folder/mine.py", {}), ("lte", {"up": "a", "down": "b"}),
    ("recorded_reach", {"motion": "my.csv"}),
    ("canonical", {"link": "ping_log('log')"}), ("canonical", {"link": 'delay(0.1) ; mahimahi("trace")'}),
])
def test_whoever_recorded_with_a_file_is_told_that_report_asks_for_trust(
    name: str, knobs: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert asks_for_trust(name, knobs)
    with pytest.raises(Refused, match="--trust"):
        stored_scene(name, knobs, trust=False)
