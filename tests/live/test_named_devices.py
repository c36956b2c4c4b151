"""Devices and robots by name: `NAME`, `NAME:ARGUMENT`, `FILE.py:CLASS`, and what is said of a wrong one."""

from __future__ import annotations

from pathlib import Path

import pytest

from slave.__main__ import main as slave_main
from slave.robot import SimulatedSlave
from teleop import Reading, Refused, load_scene
from teleop.__main__ import main
from teleop.live.devices.opening import find_device
from teleop.naming import DEVICE_KINDS
from teleop.scene.catalogue import device_line

SCENE = load_scene("hard_wall", duration=0.1)
OWN = """
from teleop import Reading


class {name}:
    deadline = 0.1

    def __init__(self, scene, port="none"):
        self.port = port

    def read(self, k):
        return Reading((0.5,), (0.0,))

    def hold(self, force):
        pass
"""


def test_a_built_in_robot_is_made_from_the_scene() -> None:
    assert isinstance(find_device("s", "simulated").open(SCENE), SimulatedSlave)


@pytest.mark.parametrize("e", ["m", "s"])
def test_every_built_in_one_has_a_sentence_that_is_read_without_importing_it(e: str) -> None:
    for name, place in DEVICE_KINDS[e].built_in.items():
        line = device_line(e, name, place)
        assert line.endswith("."), name
        assert "plug-in" not in line, name


def test_a_name_alone_is_listed_with_the_options_that_take_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "csv"]) == 0
    told = capsys.readouterr().out
    assert "--device csv  A recorded motion of a master" in told
    assert "--robot csv   A recorded motion of a slave" in told


@pytest.mark.parametrize(("options", "words"), [
    (["--robot", "mine.py", "--lockstep"], "so it is for what is simulated, and mine.py does not say that it is"),
    (["--robot", "mine.py", "--lockstep", "--watchdog"], "--watchdog is for ends that go by the clock"),
    (["--watchdog"], "give it one by --robot NAME"),
    (["--robot", "mine.py:Arm:/dev/x", "--set", "law=direct"], "the slave's device senses none"),
])
def test_an_end_that_cannot_be_driven_by_its_device_is_refused_before_it_listens(
    options: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(OWN.format(name="Arm"))
    assert slave_main(["hard_wall", "--listen", "127.0.0.1:0", "--quiet", *options]) == 2
    assert words in capsys.readouterr().err


def test_a_file_of_ones_own_needs_no_class_where_it_has_one_and_takes_an_argument(tmp_path: Path) -> None:
    file = tmp_path / "arm.py"
    file.write_text(OWN.format(name="Arm"))
    assert find_device("m", str(file)).open(SCENE).read(0) == Reading((0.5,), (0.0,))
    assert find_device("m", f"{file}:Arm:/dev/ttyACM0").open(SCENE).port == "/dev/ttyACM0"  # type: ignore[attr-defined]
    assert find_device("s", f"{file}:Arm").open(SCENE).port == "none"  # type: ignore[attr-defined]


@pytest.mark.parametrize(("e", "text", "words"), [
    ("s", "simulatedd", "there is no robot 'simulatedd'; did you mean simulated?"),
    ("m", "mujoco", "mujoco is a robot, and this end takes a device; give it to the other end by --robot mujoco"),
    ("s", "csv", "there is nothing; write csv:PATH"),
    ("s", "csv:", "--robot csv: has nothing behind its colon"),
    ("s", "simulated:3", "simulated takes nothing behind its name, and '3' stood there"),
    ("m", "gamepad", "type `teleop demo hard_wall --page`"),
    ("m", "no_such.py:Arm", "there is no file no_such.py; --device FILE.py names a file"),
])
def test_a_wrong_name_is_answered_with_what_to_type(e: str, text: str, words: str) -> None:
    with pytest.raises(Refused) as refused:
        find_device(e, text).open(SCENE)
    assert words in str(refused.value)


def test_a_file_with_two_devices_asks_which_one_and_one_with_none_says_what_a_device_is(tmp_path: Path) -> None:
    file = tmp_path / "two.py"
    file.write_text(OWN.format(name="Left") + OWN.format(name="Right"))
    with pytest.raises(Refused, match=r"has 2 devices; name one of them, .*two.py:Left or .*two.py:Right"):
        find_device("s", str(file))
    with pytest.raises(Refused, match="has no 'Lefft'; did you mean Left"):
        find_device("s", f"{file}:Lefft")
    file.write_text("x = 1")
    with pytest.raises(Refused, match=r"has no robot: a class with read\(k\) and hold\(force\)"):
        find_device("s", str(file))
