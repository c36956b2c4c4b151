"""ROS 2 joints as a device or a robot, and a simulated end that ROS 2 sees: `read` and `hold` are topics.

    python -m slave bench_top --listen 0.0.0.0:9001 --robot scenarios/examples/ros2/bilateral_ros2.py:robot:/arm,joint1
    python -m master bench_top --peer HOST:9001 --device scenarios/examples/ros2/bilateral_ros2.py:device:/hand,joint1

Read is `NAMESPACE/joint_states` (sensor_msgs/JointState: rad or m, and per s), told is `NAMESPACE/commands`
(std_msgs/Float64MultiArray: N m or N, in the order of the joints), as effort controllers of ros2_control take it.
"""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from slave import SimulatedSlave
from teleop import DeviceError, DeviceWatchdog, Reading, Scene

STALE = 0.05  # s: a state is no longer where the joint is
NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)  # hears reliable publishers too
CERTAIN = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)  # a controller that asks for it hears no other


class Joints:
    """Joints of a ROS 2 arm. What has come is taken in `read`, by an executor that waits for nothing: no thread."""

    def __init__(self, scene: Scene, argument: str, sign: float, clock: Callable[[], float] = monotonic) -> None:
        namespace, *joints = argument.split(",")
        self._joints = joints or list(scene.axis_names)
        if len(self._joints) != scene.axes:
            raise DeviceError(f"the scene has {scene.axes} axes, and {len(self._joints)} joints are named; name each, "
                              f"as {namespace},joint1,joint2")
        self.watchdog = DeviceWatchdog(  # a controller of ros2_control holds the last effort for ever
            open="scenarios.examples.ros2.bilateral_ros2:zeroing", arguments=(namespace, str(scene.axes)))
        self._sign, self._clock, self._received = sign, clock, -STALE
        self._newest: Any = None
        self._node = node("bilateral_end")
        self._node.create_subscription(JointState, f"{namespace}/joint_states", self._take, NEWEST)
        self._commands = self._node.create_publisher(Float64MultiArray, f"{namespace}/commands", CERTAIN)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._topic = f"{namespace}/joint_states"

    def read(self, k: int) -> Reading:
        """Read positions and velocities of the joints from the newest message."""
        self._executor.spin_once(timeout_sec=0.0)
        if self._newest is None or self._clock() - self._received > STALE:
            raise DeviceError(f"no joint state came on {self._topic} for {STALE:g} s; is the arm's driver running, in "
                              "this ROS_DOMAIN_ID?")
        names, message = list(self._newest.name), self._newest
        missing = [joint for joint in self._joints if joint not in names]
        if missing or not len(names) == len(message.position) == len(message.velocity):
            raise DeviceError(f"{self._topic} tells no position and velocity of {', '.join(missing or self._joints)}, "
                              f"but names {', '.join(names)}; name its joints behind the namespace")
        at = [names.index(joint) for joint in self._joints]
        return Reading(tuple([message.position[i] for i in at]), tuple([message.velocity[i] for i in at]))

    def hold(self, force: tuple[float, ...]) -> None:
        """Tell the efforts, N m or N."""
        self._commands.publish(Float64MultiArray(data=[self._sign * f for f in force]))

    def close(self) -> None:
        self.hold((0.0,) * len(self._joints))
        self._node.destroy_node()

    def _take(self, message: Any) -> None:
        self._newest, self._received = message, self._clock()


class Published:
    """A simulated slave that ROS 2 sees: its joint states, with the stack's force as effort, on every tick."""

    scene_body = True

    def __init__(self, scene: Scene, namespace: str) -> None:
        self._slave, self._names, self._force = SimulatedSlave(scene), list(scene.axis_names), (0.0,) * scene.axes
        self.deadline = self._slave.deadline
        self._node = node("bilateral_simulated")
        self._states = self._node.create_publisher(JointState, f"{namespace}/joint_states", CERTAIN)

    def read(self, k: int) -> Reading:
        reading = self._slave.read(k)
        message = JointState(name=self._names, position=list(reading.x), velocity=list(reading.v),
                             effort=list(self._force))
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._states.publish(message)
        return reading

    def hold(self, force: tuple[float, ...]) -> None:
        self._force = force
        self._slave.hold(force)

    def close(self) -> None:
        self._node.destroy_node()


def robot(scene: Scene, argument: str) -> Joints:
    """The slave's: its motors push along +x."""
    return Joints(scene, argument, 1.0)


def device(scene: Scene, argument: str) -> Joints:
    """The master's: its motors push against the hand, along -x."""
    return Joints(scene, argument, -1.0)


def simulated(scene: Scene, namespace: str) -> Published:
    """A simulated slave, published."""
    return Published(scene, namespace)


def zeroing(namespace: str, axes: str) -> Callable[[], None]:
    """Set the force to zero: the watchdog process calls this when the end is silent or gone."""
    publisher = node("bilateral_watchdog").create_publisher(Float64MultiArray, f"{namespace}/commands", CERTAIN)
    return lambda: publisher.publish(Float64MultiArray(data=[0.0] * int(axes)))


def node(name: str) -> Any:
    """A node; Ctrl-C stays the end's own, which lets go of the force by a ramp."""
    if not rclpy.ok():
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    return rclpy.create_node(name)
