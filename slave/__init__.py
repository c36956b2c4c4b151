"""The slave's side: environments that a slave touches, and the simulated slave.

    from slave import Wall
    environment = Wall(k=5e3, d=5.0, at=0.03)
"""

from __future__ import annotations

from typing import TYPE_CHECKING

try:
    from teleop.version import DISTRIBUTION as DISTRIBUTION
except ImportError as error:  # another project's package has the same name
    raise ImportError(
        "`slave` found another package called teleop in place of its own; install bilateral-teleop in an "
        "environment of its own: python -m venv own && own/bin/python -m pip install bilateral-teleop"
    ) from error

if TYPE_CHECKING:
    from slave.hunt_crossley import HuntCrossley
    from slave.moving import Moving
    from slave.mujoco_robot import MuJoCoRobot
    from slave.robot import SimulatedSlave
    from slave.standard_linear_solid import StandardLinearSolid
    from slave.tissue import Tissue
    from slave.wall import Wall

__all__ = [
    "HuntCrossley", "Moving", "MuJoCoRobot", "SimulatedSlave", "StandardLinearSolid", "Tissue", "Wall",
]
_HOMES = {  # the module of each name, under this package
    "hunt_crossley": ("HuntCrossley",),
    "moving": ("Moving",),
    "mujoco_robot": ("MuJoCoRobot",),
    "robot": ("SimulatedSlave",),
    "standard_linear_solid": ("StandardLinearSolid",),
    "tissue": ("Tissue",),
    "wall": ("Wall",),
}


if not TYPE_CHECKING:  # a type checker goes by the imports above, and finds a name that is misspelt

    def __getattr__(name: str) -> object:
        from teleop.naming import public_name

        return public_name(__name__, _HOMES, name)


def __dir__() -> list[str]:
    return sorted(__all__)  # and not what this file needs for itself
