"""The master's side: hands, the references that they follow, and the simulated master.

    from master import Grip, Reach
    hand = Grip(mass=0.4, k=200.0, d=5.0, reference=Reach(to=0.05, duration=1.0))
"""

from __future__ import annotations

from typing import TYPE_CHECKING

try:
    from teleop.version import DISTRIBUTION as DISTRIBUTION
except ImportError as error:  # another project's package has the same name
    raise ImportError(
        "`master` found another package called teleop in place of its own; install bilateral-teleop in an "
        "environment of its own: python -m venv own && own/bin/python -m pip install bilateral-teleop"
    ) from error

if TYPE_CHECKING:
    from master.device import SimulatedMaster
    from master.hand import Grip, Reach, Rest, Sine
    from master.hand_record import HandRecording
    from master.recording import Recording
    from master.steered import SteeredMaster

__all__ = [
    "Grip", "HandRecording", "Reach", "Recording", "Rest", "SimulatedMaster", "Sine", "SteeredMaster",
]
_HOMES = {  # the module of each name, under this package
    "device": ("SimulatedMaster",),
    "hand": ("Grip", "Reach", "Rest", "Sine"),
    "hand_record": ("HandRecording",),
    "recording": ("Recording",),
    "steered": ("SteeredMaster",),
}


if not TYPE_CHECKING:  # a type checker goes by the imports above, and finds a name that is misspelt

    def __getattr__(name: str) -> object:
        from teleop.naming import public_name

        return public_name(__name__, _HOMES, name)


def __dir__() -> list[str]:
    return sorted(__all__)  # and not what this file needs for itself
