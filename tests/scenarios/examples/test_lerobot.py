"""The LeRobot plug-in, against a stand-in of LeRobot's documented interface: what it offers, and when it stops.

The stand-in has what LeRobot's page on hardware of one's own says: abstract `Teleoperator` and `Robot`, configurations
that are registered by a type, and its errors.
"""

from __future__ import annotations

import abc
import json
import struct
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar

import numpy as np
import pytest

from teleop import Refused
from teleop.live.policy_page import PolicyPage
from teleop.live.records.reader import FILE
from teleop.protocol.policy import PolicyWord
from teleop.scene.library import ROOT
from tests.teleop.export.conftest import LiveEnd

HERE = ROOT / "scenarios" / "examples" / "lerobot"
COMMON = ("is_connected", "connect", "is_calibrated", "calibrate", "configure", "disconnect", "action_features")
OF_TELEOPERATORS = (*COMMON, "feedback_features", "get_action", "send_feedback")
OF_ROBOTS = (*COMMON, "observation_features", "get_observation", "send_action")


@dataclass(kw_only=True)
class _Config:
    id: str | None = None
    calibration_dir: Path | None = None
    known: ClassVar[dict[str, type]]

    @classmethod
    def register_subclass(cls, name: str) -> Any:
        return lambda one: cls.known.setdefault(name, one)


class _Device:
    def __init__(self, config: Any) -> None:
        self.id = config.id


class NotConnected(ConnectionError):
    pass


class Camera:
    is_connected = False

    def connect(self) -> None:
        self.is_connected = True

    def async_read(self) -> str:
        return "image"

    def disconnect(self) -> None:
        self.is_connected = False


@dataclass
class CameraConfig:
    height: int = 480
    width: int = 640


def _nothing() -> None:
    pass


def abstract(name: str, methods: tuple[str, ...]) -> type:
    return abc.ABCMeta(name, (_Device,), {method: abc.abstractmethod(_nothing) for method in methods})


@pytest.fixture
def plugin(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """The robot's module, as LeRobot imports it."""
    class TeleoperatorConfig(_Config):
        known: ClassVar[dict[str, type]] = {}

    class RobotConfig(_Config):
        known: ClassVar[dict[str, type]] = {}

    offered: dict[str, dict[str, Any]] = {
        "lerobot": {}, "lerobot.utils": {}, "lerobot.utils.errors": {"DeviceNotConnectedError": NotConnected},
        "lerobot.teleoperators": {"Teleoperator": abstract("Teleoperator", OF_TELEOPERATORS),
                                  "TeleoperatorConfig": TeleoperatorConfig},
        "lerobot.robots": {"Robot": abstract("Robot", OF_ROBOTS), "RobotConfig": RobotConfig},
        "lerobot.cameras": {"CameraConfig": CameraConfig,
                            "make_cameras_from_configs": lambda configs: {name: Camera() for name in configs}},
    }
    for name, names in offered.items():
        module = ModuleType(name)
        vars(module).update(names)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.syspath_prepend(str(HERE))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    import lerobot_robot_bilateral as robot

    yield robot
    for name in ("lerobot_robot_bilateral", "lerobot_teleoperator_bilateral"):
        del sys.modules[name]


@pytest.fixture
def ends(tmp_path: Path) -> Iterator[dict[str, LiveEnd]]:
    """Both ends of a run that goes on."""
    made = {e: LiveEnd(tmp_path / "run" / name, e, range(ticks))
            for e, name, ticks in (("m", "master", 12), ("s", "slave", 10))}
    yield made
    for end in made.values():
        end.close()


def both(plugin: Any, folder: Path, **more: Any) -> tuple[Any, Any]:
    """The teleoperator and the robot of the run in `folder`, made by their type as LeRobot does it."""
    teleoperators, robots = sys.modules["lerobot.teleoperators"], sys.modules["lerobot.robots"]
    hand = teleoperators.TeleoperatorConfig.known["bilateral"](run=str(folder), patience=0.05, **more)
    arm = robots.RobotConfig.known["bilateral"](run=str(folder), patience=0.05, **more)
    return sys.modules["lerobot_teleoperator_bilateral"].BilateralTeleoperator(hand), plugin.BilateralRobot(arm)


def last(folder: Path) -> dict[str, float]:
    """The newest row of a record, by the name of its columns."""
    head, _, body = (folder / FILE).read_bytes().partition(b"\n")
    columns = json.loads(head)["columns"]
    return dict(zip(columns, struct.unpack(f"<{len(columns)}d", body[-8 * len(columns):]), strict=True))


def test_action_and_observation_are_the_newest_rows_of_master_and_slave(
    plugin: Any, ends: dict[str, LiveEnd], tmp_path: Path
) -> None:
    hand, arm = both(plugin, tmp_path / "run")
    hand.connect()
    arm.connect()
    for grown in (0, 5):
        ends["m"].add(range(12, 12 + grown))
        action, seen = hand.get_action(), arm.get_observation()
        m, s = last(tmp_path / "run" / "master"), last(tmp_path / "run" / "slave")
        assert [action[f"x{end}"] for end in (".pos", ".vel", ".force")] == [m["x_m"], m["v_m"], m["f_m"]]
        assert [seen[f"x{end}"] for end in (".pos", ".vel", ".force")] == [s["x_s"], s["v_s"], s["f_s"]]
        assert (action["time.whole"], action["time.rest"]) == (0.0, (11 + grown) * 1e-3)
        assert seen["time.rest"] == 9e-3
    assert {*action} == {*hand.action_features} == {*arm.action_features}
    assert {*seen} == {*arm.observation_features}
    assert set(hand.action_features.values()) == {float}
    hand.disconnect()
    arm.disconnect()
    assert not hand.is_connected
    assert not arm.is_connected


def test_a_time_of_days_keeps_its_microseconds_in_single_precision(
    plugin: Any, ends: dict[str, LiveEnd], tmp_path: Path
) -> None:
    ends["m"].add([80_000_001])  # 22 hours and a millisecond
    hand, _ = both(plugin, tmp_path / "run")
    hand.connect()
    stored = {name: np.float32(number) for name, number in hand.get_action().items()}
    assert float(stored["time.whole"]) == 80_000.0
    assert float(stored["time.rest"]) == pytest.approx(1e-3, abs=1e-9)


@pytest.mark.usefixtures("ends")
def test_cameras_are_beside_it(plugin: Any, tmp_path: Path) -> None:
    config = plugin.BilateralRobotConfig(run=str(tmp_path / "run"), cameras={"front": CameraConfig()})
    arm = plugin.BilateralRobot(config)
    assert not arm.is_connected
    arm.connect()
    assert arm.is_connected
    assert arm.get_observation()["front"] == "image"
    assert arm.observation_features["front"] == (480, 640, 3)
    arm.disconnect()


@pytest.mark.usefixtures("ends")
def test_an_action_is_sent_nowhere(plugin: Any, tmp_path: Path) -> None:
    _, arm = both(plugin, tmp_path / "run")
    before = (tmp_path / "run" / "slave" / FILE).read_bytes()
    assert arm.send_action({"x.pos": 9.0}) == {"x.pos": 9.0}
    assert (tmp_path / "run" / "slave" / FILE).read_bytes() == before


@pytest.mark.usefixtures("ends")
def test_an_action_of_a_policy_goes_to_the_masters_end(plugin: Any, tmp_path: Path) -> None:
    arm = plugin.BilateralRobot(plugin.BilateralRobotConfig(run=str(tmp_path / "run"), policy=str(
        tmp_path / "run" / "master")))
    with pytest.raises(NotConnected, match="no folder of a master that runs and takes a policy's actions"):
        arm.connect()
    arm.disconnect()
    with PolicyPage(tmp_path / "run" / "master", 1) as page:
        arm.connect()
        assert page.read() == PolicyWord(takes=True, to=None)
        assert arm.send_action({"x.pos": 0.2, "x.vel": 9.0}) == {"x.pos": 0.2, "x.vel": 9.0}
        assert page.read() == PolicyWord(takes=None, to=(0.2,))
        with pytest.raises(Refused, match="finite"):
            arm.send_action({"x.pos": float("nan")})
        arm.disconnect()
        assert page.read() == PolicyWord(takes=False, to=None)


def test_a_run_that_stands_still_or_is_over_is_not_connected(
    plugin: Any, ends: dict[str, LiveEnd], tmp_path: Path
) -> None:
    hand, arm = both(plugin, tmp_path / "run")
    with pytest.raises(NotConnected, match="call connect"):
        hand.get_action()
    hand.connect()
    arm.connect()
    hand._newest._received -= 1.0
    with pytest.raises(NotConnected, match=r"no row came for 0\.05 s"):
        hand.get_action()
    for e in "ms":
        ends.pop(e).close()
    with pytest.raises(NotConnected, match="the run is over"):
        arm.get_observation()


@pytest.mark.usefixtures("ends")
@pytest.mark.parametrize(("more", "why"), [
    ({"axes": ["x", "y"]}, "the run has 1 axes, and 2 are named: x, y"),
    ({"force": "f_h"}, "the run records no f_h; give another force"),
])
def test_a_run_that_is_not_as_it_is_described_is_refused(
    plugin: Any, tmp_path: Path, more: dict[str, Any], why: str
) -> None:
    hand, _ = both(plugin, tmp_path / "run", **more)
    with pytest.raises(NotConnected, match=why):
        hand.connect()


def test_a_folder_without_a_run_is_refused(plugin: Any, tmp_path: Path) -> None:
    hand, _ = both(plugin, tmp_path)
    with pytest.raises(NotConnected, match="no record of a live end"):
        hand.connect()


def test_the_package_is_named_as_lerobot_looks_for_it(plugin: Any) -> None:
    about = tomllib.loads((HERE / "pyproject.toml").read_text())
    assert about["project"]["name"] == "lerobot_robot_bilateral"
    files = about["tool"]["hatch"]["build"]["targets"]["wheel"]["include"]
    assert sorted(files) == sorted(path.name for path in HERE.glob("*.py"))
    for one in (plugin.BilateralRobotConfig, sys.modules["lerobot_teleoperator_bilateral"].BilateralTeleoperatorConfig):
        assert {"run", "axes", "force", "patience", "id"} <= {field.name for field in fields(one)}
