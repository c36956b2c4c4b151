"""Devices that a browser has: they move the hand of a simulated master on the page of a live run."""

from __future__ import annotations

from typing import NoReturn

from teleop.errors import Refused
from teleop.scene.scene import Scene


def pointer(scene: Scene) -> NoReturn:
    """Mouse, finger or pen in a browser, by `teleop demo SCENE --page`."""
    raise _of_the_page(scene, "a pointer drags the master's handle")


def gamepad(scene: Scene) -> NoReturn:
    """A gamepad's stick in a browser, by `teleop demo SCENE --page`."""
    raise _of_the_page(scene, "a gamepad's stick moves the hand, and its first button is the clutch")


def _of_the_page(scene: Scene, what: str) -> Refused:
    return Refused(f"{what} on the page of a live run, which finds it in the browser; type `teleop demo {scene.name} "
                   "--page`, and leave the device out")
