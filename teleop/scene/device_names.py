"""Devices and robots by name: those built in, and those that installed packages offer.

A package of yours offers a master's device by `[project.entry-points."teleop.devices"]`, `mine = "my_package:MyArm"`,
and a slave's robot by the group `teleop.robots`. They are listed without being imported. What opens one by its name is
`teleop.live.devices.opening`.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping
from typing import NamedTuple

from teleop.naming import known_places
from teleop.scene.library import ROOT

DEVICES = {  # of the master's end
    "csv": "teleop.live.devices.csv_replay:replayed_device",
    "gamepad": "teleop.live.devices.opening:gamepad",
    "haply": "master.haply:Inverse3",
    "pointer": "teleop.live.devices.opening:pointer",
    "simulated": "master.device:SimulatedMaster",
}
ROBOTS = {  # of the slave's end
    "csv": "teleop.live.devices.csv_replay:replayed_robot",
    "mujoco": "slave.mujoco_robot:MuJoCoRobot",
    "simulated": "slave.robot:SimulatedSlave",
}


class DeviceKind(NamedTuple):
    """Kind of device at one end: its word, the option that names it, the group of entry points, the built-in ones."""

    word: str
    option: str
    group: str
    built_in: Mapping[str, str]  # "module:maker" by name


KINDS = {
    "m": DeviceKind("device", "--device", "teleop.devices", DEVICES),
    "s": DeviceKind("robot", "--robot", "teleop.robots", ROBOTS),
}


def known_devices(e: str) -> dict[str, str]:
    """Places of all that may stand at the end `e`, "m" or "s": `name -> "module:maker"`. None is imported."""
    return dict(sorted(known_places(KINDS[e].group, KINDS[e].built_in).items()))


def device_line(e: str, name: str, place: str) -> str:
    """The first line of the docstring of a built-in maker, read from its file without importing it."""
    if KINDS[e].built_in.get(name) != place:
        return f"from a plug-in, {place}"
    module, _, maker = place.partition(":")
    file = ROOT.joinpath(*module.split(".")).with_suffix(".py")
    if not file.is_file():
        return ""
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == maker:
            return (ast.get_docstring(node) or "").partition("\n")[0]
    return ""
