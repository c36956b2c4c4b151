"""The rendered walls that several publications are about: the scene `virtual_wall` as they have it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from teleop.scene.loading import load_scene

if TYPE_CHECKING:
    from teleop.scene.scene import Scene


def wall(K: float, B: float = 0.0, **knobs: object) -> Scene:
    """A handle at a rendered wall of stiffness K (N/m) and damping B (N s/m), sampled at 1 kHz."""
    return load_scene("virtual_wall", **{"law.K": K, "law.B": B, **knobs})


def held(scene: Scene, *, mass: float, k: float, d: float, at: float, start: float) -> Scene:
    """The scene with a hand that stands still at `at` (m) and a handle that starts at `start` (m), at rest."""
    still: Any = load_scene("encoder_wall").hand
    hand = replace(still, mass=mass, k=k, d=d, reference=replace(still.reference, at=at))
    return replace(scene, hand=hand, start_m=start)
