"""A watchdog process for any device with a name: what `--watchdog` starts beside the end.

It opens the device by the same name a second time, and holds zero when the end is silent or gone; see
`teleop.live.devices.heartbeat`. So it is for hardware that two processes may open. For what only one may, the device
names another way to its motor, by an attribute `watchdog`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path

from teleop.live.devices.heartbeat import DeviceWatchdog
from teleop.live.devices.named import named
from teleop.scene.device_names import KINDS
from teleop.scene.loading import load_scene
from teleop.scene.scene import both_ends


def watchdog_of(e: str, text: str, scene: str, knobs: Mapping[str, str]) -> DeviceWatchdog:
    """The watchdog of what `text` names at the end `e`, in the scene of this name with these knobs.

    >>> watchdog_of("s", "my_arm:/dev/ttyACM0", "hard_wall", {}).open
    'teleop.live.devices.zeroing:zeroing'
    """
    file, colon, rest = text.partition(":")
    name = f"{Path(file).absolute()}{colon}{rest}" if file.endswith(".py") else text
    return DeviceWatchdog(open=f"{__name__}:{zeroing.__name__}", arguments=(e, text, scene, json.dumps(dict(knobs))),
                          device=f"{KINDS[e].word} {name}")


def zeroing(e: str, text: str, scene: str, knobs: str) -> Callable[[], None]:
    """For the watchdog process: opens the device; what is returned has it hold zero. Raises `Refused`."""
    made = both_ends(load_scene(scene, **json.loads(knobs)))
    device, zero = named(e, text).open(made), (0.0,) * made.axes
    return lambda: device.hold(zero)
