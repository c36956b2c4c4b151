"""The ROS 2 node, against a stand-in of rclpy's interface: what is read from and told to topics."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from teleop import DeviceError, load_scene
from teleop.live.devices.opening import find_device
from teleop.scene.library import ROOT

FILE = ROOT / "scenarios" / "examples" / "ros2" / "bilateral_ros2.py"


class Message(SimpleNamespace):
    def __init__(self, **fields: Any) -> None:
        super().__init__(**{"name": [], "position": [], "velocity": [], "effort": [], **fields},
                         header=SimpleNamespace(stamp=None))


class Graph:
    """All nodes, and the messages that wait for a subscriber: as many as its QoS keeps."""

    def __init__(self) -> None:
        self.up = 0
        self.published: dict[str, list[Any]] = {}
        self.heard: dict[str, tuple[Callable[[Any], None], Any, list[Any]]] = {}
        self.qos: dict[str, Any] = {}
        self.destroyed = 0

    def say(self, topic: str, message: Any) -> None:
        waiting = self.heard[topic][2]
        waiting.append(message)
        del waiting[: -self.heard[topic][1].depth]

    def spin_once(self, timeout_sec: float) -> None:
        assert timeout_sec == 0.0  # a tick waits for nothing
        for callback, _, waiting in self.heard.values():
            if waiting:
                callback(waiting.pop(0))
                return


GRAPH = Graph()  # one, for a file of one's own is loaded once


class Node:
    def __init__(self, name: str) -> None:
        self.name, self.graph = name, GRAPH

    def create_subscription(self, kind: Any, topic: str, callback: Callable[[Any], None], qos: Any) -> None:
        self.graph.heard[topic] = callback, qos, []

    def create_publisher(self, kind: Any, topic: str, qos: Any) -> Any:
        self.graph.qos[topic] = qos
        return SimpleNamespace(publish=lambda message: self.graph.published.setdefault(topic, []).append(message))

    def get_clock(self) -> Any:
        return SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: "now"))

    def destroy_node(self) -> None:
        self.graph.destroyed += 1


class Executor:
    nodes: tuple[Node, ...] = ()

    def add_node(self, node: Node) -> None:
        self.nodes += (node,)

    def spin_once(self, timeout_sec: float) -> None:
        assert self.nodes
        GRAPH.spin_once(timeout_sec)


def init(signal_handler_options: str) -> None:
    assert signal_handler_options == "no"  # Ctrl-C is the end's
    GRAPH.up += 1


@pytest.fixture
def graph(monkeypatch: pytest.MonkeyPatch) -> Iterator[Graph]:
    vars(GRAPH).update(vars(Graph()))
    offered: dict[str, dict[str, Any]] = {
        "rclpy": {"init": init, "ok": lambda: GRAPH.up > 0, "create_node": Node},
        "rclpy.executors": {"SingleThreadedExecutor": Executor},
        "rclpy.qos": {"QoSProfile": SimpleNamespace,
                      "ReliabilityPolicy": SimpleNamespace(BEST_EFFORT="best effort", RELIABLE="reliable")},
        "rclpy.signals": {"SignalHandlerOptions": SimpleNamespace(NO="no")},
        "sensor_msgs": {}, "sensor_msgs.msg": {"JointState": Message},
        "std_msgs": {}, "std_msgs.msg": {"Float64MultiArray": SimpleNamespace},
    }
    for name, names in offered.items():
        module = ModuleType(name)
        vars(module).update(names)
        monkeypatch.setitem(sys.modules, name, module)
    yield GRAPH
    sys.modules.pop("scenarios.examples.ros2.bilateral_ros2", None)


def opened(e: str, maker: str, axes: int = 1) -> Any:
    """What the command line opens by the file's name."""
    made: Any = find_device(e, f"{FILE}:{maker}").open(load_scene("hard_wall" if axes == 1 else "leader_follower"))
    return made


def state(names: str, *numbers: float) -> Message:
    joints = names.split()
    return Message(name=joints, position=list(numbers), velocity=[10.0 * number for number in numbers])


def test_joints_are_read_by_their_names_whatever_the_order_and_what_else_the_arm_has(graph: Graph) -> None:
    arm = opened("s", "robot:/arm,j1,j2,j3,j4,j5,j6", axes=6)
    graph.say("/arm/joint_states", state("gripper j6 j5 j4 j3 j2 j1", 9.0, 6.0, 5.0, 4.0, 3.0, 2.0, 1.0))
    reading = arm.read(0)
    assert reading.x == (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    assert reading.v == (10.0, 20.0, 30.0, 40.0, 50.0, 60.0)
    assert reading.f is None


def test_of_several_states_the_newest_is_read(graph: Graph) -> None:
    arm = opened("s", "robot:/arm,j1")
    for x in (1.0, 2.0, 3.0):
        graph.say("/arm/joint_states", state("j1", x))
    assert arm.read(0).x == (3.0,)


@pytest.mark.parametrize(("e", "maker", "sign"), [("s", "robot", 1.0), ("m", "device", -1.0)])
def test_a_force_pushes_along_x_at_the_slave_and_against_the_hand_at_the_master(
    graph: Graph, e: str, maker: str, sign: float
) -> None:
    end = opened(e, f"{maker}:/arm,j1")
    end.hold((2.5,))
    assert graph.published["/arm/commands"][-1].data == [sign * 2.5]
    assert graph.qos["/arm/commands"].reliability == "reliable"
    end.close()
    assert graph.published["/arm/commands"][-1].data == [0.0]
    assert graph.destroyed == 1


def test_a_driver_that_is_silent_is_a_device_that_fails_and_comes_back(graph: Graph) -> None:
    arm = opened("s", "robot:/arm,j1")
    with pytest.raises(DeviceError, match="no joint state came on /arm/joint_states"):
        arm.read(0)
    graph.say("/arm/joint_states", state("j1", 1.0))
    arm.read(1)
    arm._received -= 1.0
    with pytest.raises(DeviceError, match=r"for 0\.05 s"):
        arm.read(2)
    graph.say("/arm/joint_states", state("j1", 2.0))
    assert arm.read(3).x == (2.0,)


def test_a_driver_that_does_not_tell_what_is_needed_is_said(graph: Graph) -> None:
    arm = opened("s", "robot:/arm,j1")
    for message in (state("other", 1.0), Message(name=["j1"], position=[1.0])):  # another arm; no velocity
        graph.say("/arm/joint_states", message)
        with pytest.raises(DeviceError, match="tells no position and velocity of j1"):
            arm.read(0)


@pytest.mark.usefixtures("graph")
def test_a_scene_of_other_axes_is_refused() -> None:
    with pytest.raises(ValueError, match="the scene has 1 axes, and 2 joints are named"):
        opened("s", "robot:/arm,j1,j2")


def test_the_watchdog_tells_zeros_by_a_node_of_its_own(graph: Graph) -> None:
    watchdog = opened("s", "robot:/arm,j1").watchdog
    module, _, function = watchdog.open.partition(":")
    getattr(import_module(module), function)(*watchdog.arguments)()
    assert graph.published["/arm/commands"][-1].data == [0.0]


def test_a_simulated_slave_is_published_at_every_tick(graph: Graph) -> None:
    arm = opened("s", "simulated:/arm")
    arm.hold((1.5,))
    for k in range(3):
        reading = arm.read(k)
    told = graph.published["/arm/joint_states"]
    assert len(told) == 3
    assert (told[-1].position, told[-1].velocity) == ([*reading.x], [*reading.v])
    assert told[-1].effort == [1.5]
    assert told[-1].header.stamp == "now"
    assert reading.v[0] > 0.0  # it is driven
