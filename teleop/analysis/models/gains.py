"""A scene as a function of its law's stiffness K and damping B: which scenes are, and what of them is linear."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import TYPE_CHECKING

from teleop.analysis.models.by_axis import one_loop
from teleop.analysis.models.one_port_loop import one_axis
from teleop.errors import Refused
from teleop.law import law_name

if TYPE_CHECKING:
    from teleop.scene.scene import Scene


def check(scene: Scene) -> Scene:
    """The first axis of a scene that has a Z-width; `Refused` for others, with what to type."""
    if scene.slave is not None:
        raise Refused(f"scene {scene.name} has a slave, and a Z-width is that of one device with what its controller "
                      "renders; take a scene without one, for example teleop zwidth virtual_wall")
    one_loop(scene)
    known = {field.name for field in fields(scene.law)} if is_dataclass(scene.law) else set()
    if not all(name in known and isinstance(getattr(scene.law, name), float | int) for name in ("K", "B")):
        raise Refused(f"law {law_name(scene.law)} has no stiffness K and damping B to draw a plane of; take one that "
                      "has, for example --set law=virtual_wall")
    return one_axis(scene)


def with_gains(scene: Scene, K: float, B: float) -> Scene:
    """The scene with another stiffness (N/m) and damping (N s/m) of its law."""
    return replace(scene, law=replace(scene.law, K=K, B=B))


def linear_part(scene: Scene) -> Scene:
    """The scene without what is not linear around the law: encoder, friction, force cap, passivity controller."""
    device = scene.device_m
    return replace(
        scene, cap=None, passivity=None, energy=False, master=replace(scene.master, friction=0.0),
        device_m=None if device is None else replace(device, encoder=None),
    )


def left_out(scene: Scene) -> list[str]:
    """What `linear_part` leaves out of the scene, in words."""
    device = scene.device_m
    there = {
        "its encoder": device is not None and device.encoder is not None,
        "its Coulomb friction": scene.master.friction > 0.0,
        "its force cap": scene.cap is not None,
        "its passivity controller": scene.passivity is not None,
    }
    return [words for words, has in there.items() if has]


def scales(scene: Scene) -> tuple[float, float]:
    """A stiffness (N/m) and a damping (N s/m) of the device's own size, at which its maps are read off."""
    T = scene.dt_ns / 1e9
    B = max(scene.master.damping, 1e-3 * scene.master.mass / T)
    return B / T, 0.25 * B
