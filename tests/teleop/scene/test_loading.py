"""Loading of scenes: what a run by the clock has beside a run in virtual time."""

from __future__ import annotations

import pytest

from teleop import Integral, Refused, load_scene
from teleop.scene.loading import live_knobs


def test_what_runs_by_the_clock_plays_waves_by_their_integral_with_a_link_or_without() -> None:
    """Over `--link none`, which is a real network live, each packet that was lost took its wave with it."""
    assert live_knobs("hard_wall", {}) == {"playout": "integral"}
    assert live_knobs("hard_wall", {"link": "none"}) == {"link": "none", "playout": "integral"}
    assert live_knobs("local", {}) == {"playout": "integral"}
    assert load_scene("local", playout="integral").played_as == Integral()
    assert live_knobs("hard_wall", {"law": "direct"}) == {"law": "direct"}
    assert live_knobs("hard_wall", {"playout": "zero"}) == {"playout": "zero"}
    assert live_knobs("jittery_wan", {}) == {}, "it names its own"
    with pytest.raises(Refused, match="sets nothing in a scene without a link"):
        load_scene("local", playout="zero")
