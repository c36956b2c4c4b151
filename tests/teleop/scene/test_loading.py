"""Scenes as they are loaded: beside the clock, and from a stored folder, whose files are opened for who trusts it."""

from __future__ import annotations

from pathlib import Path

import pytest

from teleop import Integral, Refused, load_scene
from teleop.scene.library import built_in_scenes
from teleop.scene.loading import asks_for_trust, check_installed, live_knobs, stored_scene


def test_what_runs_by_the_clock_plays_waves_by_their_integral_with_a_link_or_without() -> None:
    """Over `--link none`, which is a real network live, each packet that was lost took its wave with it."""
    assert live_knobs("hard_wall", {}) == {"playout": "integral"}
    assert live_knobs("hard_wall", {"link": "none"}) == {"link": "none", "playout": "integral"}
    assert live_knobs("local", {}) == {"playout": "integral"}
    assert load_scene("local", playout="integral").played_as == Integral()
    assert live_knobs("hard_wall", {"law": "direct"}) == {"law": "direct"}
    assert live_knobs("hard_wall", {"playout": "zero"}) == {"playout": "zero"}
    assert live_knobs("jittery_wan", {}) == {}, "it names its own"


def test_every_built_in_scene_is_made_again_from_its_name() -> None:
    for name in built_in_scenes():
        check_installed(name)
        if name != "lte":  # which has no scene without its recordings
            scene = stored_scene(name, {"duration": "0.5"}, trust=False)
            assert scene.ticks == round(0.5 / scene.dt), name
            assert not asks_for_trust(name, {"duration": "0.5"}), name
    assert not asks_for_trust("canonical", {"link": "delay(0.05) | bernoulli(0.1)"})


def test_whoever_recorded_with_a_file_is_told_that_report_asks_for_trust(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name, knobs in (
            ("mine.py", {}), ("folder/mine.py", {}), ("lte", {"up": "a", "down": "b"}),
            ("recorded_reach", {"motion": "my.csv"}), ("canonical", {"link": "ping_log('log')"}),
            ("canonical", {"link": 'delay(0.1) ; mahimahi("trace")'}), ("hard_wall", {"law": "law_mine.py"}),
            ("hard_wall", {"law": "law_mine.py:PositionPosition"}), ("hard_wall", {"law": "/somewhere/else.py"})):
        assert asks_for_trust(name, knobs), (name, knobs)
        with pytest.raises(Refused, match="--trust"):
            stored_scene(name, knobs, trust=False)
