"""Surroundings of a two-port: the link's delays within it, and the impedance that its slave touches."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from teleop.analysis.models.by_axis import one_loop
from teleop.analysis.models.linear import link_ticks, with_linear_law
from teleop.analysis.models.peak import Points
from teleop.errors import Refused
from teleop.scene.playout import Fixed, Integral, Scaled, Zero, as_typed
from teleop.scene.scene import Scene

PRESS = 1e-3  # m inside a surface, where an environment with one is asked
AROUND, SLOW = 0.5e-3, 1e-6  # m, m/s: where it must be linear


def linear_parts(scene: Scene) -> tuple[Scene, list[str]]:
    """The scene without what is not linear but beside the law, and the names of what was left out.

    A law that is not linear is replaced by the one that it offers, which is not left out.
    """
    scene = with_linear_law(one_loop(scene))
    left = [name for name in ("cap", "watchdog", "passivity") if getattr(scene, name) is not None]
    changes: dict[str, Any] = dict.fromkeys((*left, "operator"))  # whose clutch is closed
    for name in ("device_m", "device_s"):
        device = getattr(scene, name)
        if device is not None and device.encoder is not None:
            changes[name] = replace(device, encoder=None)
            left.append("encoder" if name == "device_m" else "encoder of the slave")
    for name, whose in (("left_out_m", "master"), ("left_out_s", "slave")):
        if getattr(scene, name) is not None:
            changes[name] = None
            left.append(f"ticks that the {whose} leaves out")
    gaps, played_as = scene.wave_playout, scene.played_as
    if isinstance(gaps, Scaled) or (isinstance(gaps, Integral) and gaps.target > 0.0):
        changes["playout"] = Fixed(played_as.delay) if isinstance(played_as, Fixed) else Zero()
        left.append(f"playout {as_typed(played_as)}")
    for name in ("master", "slave"):
        body = getattr(scene, name)
        if body is not None and body.friction > 0.0:
            changes[name] = replace(body, friction=0.0)
            left.append(f"friction of the {name}")
    return replace(scene, **changes), ["passivity controller" if name == "passivity" else name for name in left]


def ticks(scene: Scene, seed: int = 0) -> tuple[int, int]:
    """Whole ticks forth and back. Refused where they change from packet to packet, or a force is renewed slowly."""
    for name, device in (("device_m", scene.device_m), ("device_s", scene.device_s)):
        if device is not None and device.every > 1:
            raise Refused(f"{name} renews its force every {device.every} ticks, so the two-port is not time-invariant; "
                          "set every=1 and a longer dt")
    try:
        return link_ticks(scene, seed)
    except Refused:
        raise Refused("the link does not bring every packet after the same number of ticks, so the two-port is not "
                      "time-invariant; write for example --link 'delay(0.05)'") from None


def delays(scene: Scene, seed: int = 0) -> tuple[float, float]:
    """Seconds forth and back in continuous time: the link's own, or with a fixed playout the ticks that it makes."""
    if scene.link is None:
        return 0.0, 0.0
    forth, back = ticks(scene, seed)
    if isinstance(scene.played_as, Fixed):
        return forth * scene.dt_ns / 1e9, back * scene.dt_ns / 1e9
    parts = []
    for direction in (0, 1):
        arrivals = scene.link.arrivals(direction, min(scene.ticks, 1000), scene.dt_ns, seed, scene.wire_size)
        parts.append(float(np.mean(arrivals.time_ns - arrivals.packet * scene.dt_ns)) / 1e9)
    return parts[0], parts[1]


def touched(scene: Scene, s: Points) -> Points | None:
    """The impedance (N s/m) of what the slave touches on the first axis at s = i w; a wall while in contact.

    None where there is no such thing: the environment is not linear even in contact. Nothing is 0.
    """
    environment: Any = scene.environments[0]
    environment = getattr(environment, "environment", environment)  # of what is moved along a path
    if environment is None:
        return 0.0 * s
    if hasattr(environment, "k1") and hasattr(environment, "tau"):
        relaxing: Points = environment.k / s + environment.k1 * environment.tau / (1.0 + environment.tau * s)
        return relaxing
    if scene.slave is None or not hasattr(environment, "plant"):
        return None
    plant = environment.plant(scene.slave, scene.dt_ns / 1e9)
    place = getattr(environment, "at", 0.0) + getattr(environment, "side", 1.0) * PRESS
    if plant.start is not None:
        return None

    def force(x: float, v: float) -> float:
        return float(plant.force(plant.c, place + x, v))

    k = (force(AROUND, 0.0) - force(-AROUND, 0.0)) / (2.0 * AROUND)
    d = (force(0.0, SLOW) - force(0.0, -SLOW)) / (2.0 * SLOW)
    size = abs(force(0.0, 0.0)) + abs(k) * AROUND + abs(d) * SLOW
    if not abs(force(0.5 * AROUND, SLOW) - force(0.0, 0.0) - 0.5 * k * AROUND - d * SLOW) <= 1e-9 * size:
        return None
    impedance: Points = d + k / s
    return impedance
