"""The first mistakes of a device's author: each ends in a sentence before the end listens, or asks for anything."""

from __future__ import annotations

import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from slave.robot import SimulatedSlave
from teleop import DeviceError, DeviceWatchdog, Reading, Refused, end_main, load_scene
from teleop.live.devices.opening import open_device
from teleop.scene.library import ROOT
from tests.fakes import Body, raising

SCENE = load_scene("hard_wall", duration=0.1)


class Robot(Body):
    """A device with nothing wrong, and each below with one mistake."""


class NoHold:
    read = Body.read


class OtherName(NoHold):
    set_force = Body.hold


class TakesNothing(Robot):
    def read(self) -> Reading:  # type: ignore[override]
        return Reading((0.0,), (0.0,))


class Waits(Robot):
    async def read(self, k: int) -> Reading:
        return Reading((0.0,), (0.0,))


class Watched(Robot):
    watchdog = "my_arm:zeroing"


class OfNoScene(Robot):
    def __init__(self) -> None:
        pass


@pytest.mark.parametrize(("make", "words"), [
    (Robot(None), ["and was given", 'end_main("s", Robot)']),
    (OfNoScene, ["OfNoScene is called as OfNoScene(scene), and cannot be", "written as OfNoScene()"]),
    (lambda _scene: None, ["gave None, which has no read(k)", "an object with read(k) and hold(force)"]),
    (lambda _scene: NoHold(), ["which has no hold(force)"]),
    (lambda _scene: OtherName(), ["which has no hold(force)"]),
    (lambda _scene: Robot, ["gave the class Robot"]),
    (TakesNothing, ["TakesNothing.read is called as read(k), and cannot be: too many positional arguments",
                    "written as read() -> "]),
    (Waits, ["Waits.read is a coroutine", "write def read(self, k), without async"]),
    (Watched, ["is a DeviceWatchdog, not 'my_arm:zeroing'", 'DeviceWatchdog(open="my_arm:zeroing")']),
    (raising(DeviceError("no such port")), ["the device cannot be opened: no such port"]),
    (raising(FileNotFoundError(2, "No such file or directory", "/dev/arm")), ["cannot be opened", "/dev/arm"]),
    (raising(DeviceError()), ["cannot be opened: DeviceError"]),
    (raising(ZeroDivisionError("by what")), ["call(scene), which makes the device, raised ZeroDivisionError: by what",
                                            "fakes.py:"]),
    (raising(SystemExit(0)), ["call(scene), which makes the device, raised SystemExit: 0"]),
    (partial(Robot, deadline=-1.0), ["a device's deadline must be above 0 s, not -1; write for example deadline=1"]),
    (raising(Refused("take a scene of one axis")), ["take a scene of one axis"]),
], ids=lambda each: each[0] if isinstance(each, list) else "")
def test_what_is_no_device_was_a_traceback_or_ended_a_session_that_had_begun(make: Any, words: list[str]) -> None:
    with pytest.raises(Refused) as refused:
        open_device(make, SCENE)
    for each in words:
        assert each in str(refused.value)


class Wrapped(Robot):
    read = None  # type: ignore[assignment]

    def __init__(self, scene: object) -> None:
        self.read = partial(Robot.read, self)
        self.watchdog = DeviceWatchdog(open="my_arm:zeroing")
        del scene


@pytest.mark.parametrize("make", [Robot, Wrapped, SimulatedSlave, lambda scene, port="/dev/arm": Robot((scene, port))],
                         ids=["a class", "a class around another", "a class of the package", "a function"])
def test_what_can_be_called_is_taken_as_it_is(make: Any) -> None:
    assert open_device(make, SCENE) is not None


def test_an_end_that_is_neither_the_masters_nor_the_slaves_is_one_sentence(
    capsys: pytest.CaptureFixture[str]
) -> None:
    assert end_main("slave", Robot, ["hard_wall"]) == 2
    assert "\"s\" for the slave's, not 'slave'" in capsys.readouterr().err


def test_the_carriage_of_the_examples_in_a_scene_of_three_axes_was_a_traceback(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, str(ROOT / "scenarios" / "examples" / "device.py"), "recorded_reach", "--listen",
         "127.0.0.1:0"], cwd=tmp_path, env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr == ("teleop: the device cannot be opened: the carriage has one axis, the scene 3; take a scene "
                           "of one axis\n")
    assert list(tmp_path.iterdir()) == []
