"""A Franka by pylibfranka, against a stand-in of its classes in the process that drives the robot."""

from __future__ import annotations

import inspect
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest

from teleop import DeviceError, Refused, load_scene
from teleop.live.devices.opening import find_device
from teleop.scene.library import ROOT
from tests.waiting import until

pytestmark = pytest.mark.live
VENDOR = Path(__file__).with_name("vendor")
JOINTS = {"axes": "7", "units": "rad"}


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file that has the newest torques of the robot, with the stand-in in the place of pylibfranka."""
    monkeypatch.syspath_prepend(str(VENDOR))
    monkeypatch.setenv("FRANKA_LOG", str(tmp_path / "torques"))
    return tmp_path / "torques"


@pytest.fixture
def franka(log: Path, opened: Callable[..., Any]) -> Callable[..., Any]:
    """`franka("m", "robot?axes=z", scene)`: an arm, closed in the end."""
    assert log.parent.is_dir()
    return lambda e, argument, scene: opened(find_device(e, f"franka:{argument}").open(scene))


def torques(log: Path) -> tuple[float, ...]:
    """The newest torques of the joints, N m."""
    return tuple(map(float, log.read_text().split()[1:])) if log.exists() else ()


def tick(arm: Any, force: tuple[float, ...]) -> str:
    """What a tick says is wrong; "" while it works."""
    time.sleep(0.001)
    try:
        arm.read(0)
        arm.hold(force)
    except DeviceError as error:
        return str(error)
    return ""


def test_the_stand_in_has_the_names_and_the_arguments_of_the_library() -> None:
    real = pytest.importorskip("pylibfranka", reason="the extra `franka` is not installed")
    spec = spec_from_file_location("stand_in", VENDOR / "pylibfranka.py")
    assert spec is not None
    assert spec.loader is not None
    ours = module_from_spec(spec)
    spec.loader.exec_module(ours)
    for name, part in inspect.getmembers(ours, inspect.isclass):
        theirs = getattr(real, name)
        for method, _ in inspect.getmembers(part, inspect.isfunction):
            if method not in ("__init__", "log"):
                assert hasattr(theirs, method), f"{name}.{method}"
        assert issubclass(theirs, RuntimeError) == issubclass(part, RuntimeError)
    assert {"q", "dq", "O_T_EE", "last_motion_errors"} <= set(dir(real.RobotState))
    command = real.Torques([0.5] * 7)
    command.motion_finished = True
    assert list(command.tau_J) == [0.5] * 7


def test_seven_torques_are_slewed_bounded_and_let_go_of_when_they_are_not_renewed_and_a_stopped_process_is_a_sentence(
    franka: Callable[..., Any], log: Path
) -> None:
    arm = franka("s", "robot?limit=5", load_scene("bench_top", **JOINTS))
    until(lambda: tick(arm, (1.0, -9.0, 0.0, 0.0, 0.0, 0.0, 2.0)) == "" and torques(log) == (1, -5, 0, 0, 0, 0, 2))
    reading = arm.read(0)
    assert reading.x[0] > 0.0 > reading.x[1]
    assert reading.v[6] > 0.0
    assert arm.deadline == 0.15
    until(lambda: not any(torques(log)), "a torque that nobody renews stays on")
    zero = (0.0,) * 7
    until(lambda: not tick(arm, zero))
    arm._process.send_signal(signal.SIGSTOP)
    until(lambda: tick(arm, zero) == "the Franka at robot gave no state for 20 ms")
    arm._process.send_signal(signal.SIGCONT)
    until(lambda: not tick(arm, zero))
    arm.close()
    assert log.read_text().split()[0] == "1"  # the motion is finished


def test_a_force_at_the_hand_goes_through_the_jacobian_against_the_hand_of_a_master_and_a_killed_process_is_a_sentence(
    franka: Callable[..., Any], log: Path
) -> None:
    arm = franka("m", "robot?axes=z,-x".replace(",", ""), load_scene("bench_top", axes="2"))
    until(lambda: tick(arm, (2.0, 1.0)) == "" and torques(log) == (1.0, 0, -2.0, 0, 0, 0, 0))
    z, x = arm.read(0).x
    assert z < 0.0
    assert x < 0.0  # its x is turned round
    arm._process.kill()
    until(lambda: tick(arm, (0.0, 0.0)) == "the process that drives the Franka at robot ended")


@pytest.mark.parametrize(("host", "words"), [
    ("lossy", 'the Franka at lossy stopped: libfranka: Move command aborted: motion aborted by reflex! '
     '["communication_constraints_violation"]'),
    ("reflex", 'the process that drives the Franka at reflex ended: libfranka: Move command aborted: motion aborted by '
     'reflex! ["cartesian_reflex"]'),
])
def test_a_stop_of_the_robot_is_one_sentence_and_a_lost_packet_is_recovered_from(
    host: str, words: str, franka: Callable[..., Any]
) -> None:
    arm = franka("s", host, load_scene("bench_top", **JOINTS))
    zero = (0.0,) * 7
    until(lambda: tick(arm, zero) == words)
    if host == "lossy":
        until(lambda: not tick(arm, zero), "it never went on")


PUSHES = """
import sys, time
from teleop import load_scene
from teleop.live.devices.arms.franka import franka_robot
arm = franka_robot(load_scene("bench_top", axes="7", units="rad"), "robot")
while True:
    arm.hold((2.0,) * 7)
    print("pushes", flush=True)
    time.sleep(0.005)
"""


@pytest.mark.parametrize("word", ["KILL", "STOP"])
def test_the_force_of_an_end_that_is_killed_or_stopped_is_let_go_of(word: str, log: Path) -> None:
    path = os.pathsep.join([str(VENDOR), str(ROOT)])
    end = subprocess.Popen([sys.executable, "-c", PUSHES], cwd=ROOT, env={**os.environ, "PYTHONPATH": path},
                           stdout=subprocess.PIPE, text=True)
    try:
        assert end.stdout is not None
        end.stdout.readline()
        until(lambda: torques(log) == (2.0,) * 7)
        end.send_signal(getattr(signal, f"SIG{word}"))
        until(lambda: not any(torques(log)), "its torques stayed on")
    finally:
        end.kill()
        end.communicate()
    until(lambda: log.read_text().split()[0] == "1", "the process outlived its end")


@pytest.mark.parametrize(("argument", "knobs", "words"), [
    ("refused", JOINTS, "the Franka at refused cannot be driven: libfranka: Connection to FCI refused."),
    ("robot", {"axes": "2", "units": "rad"}, "a Franka has 7 joints, and the scene 2 axes in rad"),
    ("robot?axes=xyz", {"axes": "2"}, r"the scene has 2 axes in m, and \?axes= names 3 of a Franka's hand"),
    ("robot?axes=xx", {"axes": "2"}, "axes are the device's in the scene's order, each once, not 'xx'"),
    ("robot?axes=x-", {"axes": "1"}, "each once, not 'x-'"),
    ("robot?limit=1,2", JOINTS, "limit has 2 numbers, and there are 7 joints"),
    ("robot?realtime=no", JOINTS, "realtime is enforce or ignore, not 'no'"),
])
@pytest.mark.usefixtures("log")
def test_an_arm_that_cannot_be_driven_is_refused(argument: str, knobs: dict[str, str], words: str) -> None:
    with pytest.raises(Refused, match=words):
        find_device("s", f"franka:{argument}").open(load_scene("bench_top", **knobs))
