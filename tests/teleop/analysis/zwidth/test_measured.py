"""What comes to rest in virtual time: against eigenvalues where there are some, and a reproduced laboratory."""

from __future__ import annotations

import pytest

import teleop.analysis.zwidth.assess
from teleop import Scene, load_scene
from teleop.analysis.models.rest import FreeMotion, settled
from teleop.analysis.zwidth.assess import let_go, stiffest_at_rest
from teleop.analysis.zwidth.plane import boundary, loop


@pytest.mark.parametrize(("knobs", "B"), [
    ({"delay": 2}, 0.8), *(pytest.param(*each, marks=pytest.mark.full) for each in (
        ({}, 0.0), ({}, 0.8), ({"delay": 2}, 0.0), ({"every": 5}, 0.0), ({"every": 5}, 0.8)))])
def test_without_an_encoder_it_is_the_edge_of_the_linear_loop(knobs: dict[str, int], B: float) -> None:
    scene = load_scene("virtual_wall", **knobs)
    exact = boundary(loop(scene, hand=True), [B]).K[0]
    assert stiffest_at_rest(let_go(scene), B, near=exact) == pytest.approx(exact, rel=0.06)


def test_the_encoder_wall_of_the_laboratory_hums_or_not() -> None:
    for still, K, every, cap in ((True, 400.0, 1, None), (False, 2500.0, 1, None), (False, 400.0, 5, None),
                                 (True, 400.0, 5, 0.8)):
        scene = load_scene("encoder_wall", K=K, every=every, cap=cap)
        assert settled(let_go(scene)).rests == still, (K, every, cap)


@pytest.mark.full
def test_a_passivity_controller_raises_what_comes_to_rest() -> None:
    without, with_it = (
        stiffest_at_rest(let_go(load_scene("encoder_wall", **knobs)), 0.0, near=1600.0) or 0.0
        for knobs in ({}, {"cap": 0.8})
    )
    assert with_it > 1.3 * without


def test_up_to_what_is_found_all_that_were_tried_rest() -> None:
    scene = let_go(load_scene("virtual_wall", step=2e-5))
    tried: list[tuple[float, bool]] = []

    def noted(one: Scene, *, seed: int = 0) -> FreeMotion:
        found = settled(one, seed=seed)
        tried.append((one.law.K, found.rests))
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(teleop.analysis.zwidth.assess, "settled", noted)
        K = stiffest_at_rest(scene, 0.2, near=3000.0)
    assert K is not None
    assert max(tried[:10])[0] > 5.0 * tried[0][0]
    assert all(rested == (stiffness <= K) for stiffness, rested in tried)
    assert min(stiffness for stiffness, rested in tried if not rested) < 1.01 * K


@pytest.mark.full
def test_it_is_looked_for_within_the_range_alone() -> None:
    scene = let_go(load_scene("virtual_wall"))
    asked: list[int] = []
    assert stiffest_at_rest(scene, 0.0, near=3000.0, high=2000.0, tell=lambda: asked.append(1)) == float("inf")
    assert 2 <= len(asked) < 15
    assert stiffest_at_rest(scene, 0.0, near=3000.0, low=5000.0) is None
    assert stiffest_at_rest(scene, 0.0, near=100.0, high=4000.0) == pytest.approx(3600.0, rel=0.05)
    assert stiffest_at_rest(scene, 0.0, near=1e6) == pytest.approx(3600.0, rel=0.05)


def test_the_device_begins_outside_the_wall_and_the_hand_pulls_it_in() -> None:
    scene = let_go(load_scene("virtual_wall", to=0.05))
    assert scene.start_m == pytest.approx(0.029)
    assert scene.hand is not None
    assert scene.hand.reference.samples(1, 3, scene.dt_ns) == ([0.05] * 3,)
