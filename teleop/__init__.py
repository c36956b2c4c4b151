"""A delayed bilateral teleoperation stack: laws, plants, the tick, and what both ends share.

    from teleop import load_scene, run
    result = run(load_scene("canonical", delay=0.1), seed=1)

Names are loaded when they are first used: importing `teleop` loads neither numpy nor asyncio.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

__version__ = "0.1.0"
DISTRIBUTION = "bilateral-teleop"  # the index knows another package that imports as `teleop`

if TYPE_CHECKING:
    from teleop.checks.two_port import check_law as check_law
    from teleop.errors import Refused as Refused
    from teleop.law import At as At
    from teleop.law import find_law as find_law
    from teleop.scene.scene import Scene as Scene
    from teleop.scene.scene import load_scene as load_scene
    from teleop.simulation.result import Result as Result
    from teleop.simulation.result import load_result as load_result
    from teleop.simulation.virtual import run as run
    from teleop.sweeps.runner import sweep as sweep

_HOME = {
    "At": "law", "find_law": "law", "check_law": "checks.two_port", "Refused": "errors", "run": "simulation.virtual",
    "Result": "simulation.result", "load_result": "simulation.result", "Scene": "scene.scene",
    "load_scene": "scene.scene", "sweep": "sweeps.runner",
}
__all__ = ["DISTRIBUTION", "At", "Refused", "Result", "Scene", "__version__", "check_law", "find_law",
           "load_result", "load_scene", "run", "sweep"]


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module 'teleop' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"teleop.{_HOME[name]}"), name)
