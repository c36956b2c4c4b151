"""The slave of a live run as a LeRobot robot: its motion and force are the observation, beside LeRobot's cameras.

It reads the record that the slave's end writes. What drives the slave is the run's law. With `policy` an action that
LeRobot sends goes to the master's end, whose scene has a `Handover`: while the policy has authority it moves the handle
there, the slave with it, and a hand on the handle takes over by force. Without it an action is written into the data
set, and goes nowhere else: a teleoperator's own action must not come back to it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from lerobot.cameras import CameraConfig, make_cameras_from_configs
from lerobot.robots import Robot, RobotConfig
from lerobot.utils.errors import DeviceNotConnectedError
from lerobot_teleoperator_bilateral import features, following, now

from teleop import PolicyWriter, Refused


@RobotConfig.register_subclass("bilateral")
@dataclass(kw_only=True)
class BilateralRobotConfig(RobotConfig):  # type: ignore[misc]  # LeRobot need not be installed
    """`--robot.type=bilateral --robot.run=FOLDER`."""

    run: str  # the folder that the slave's end, or a demo, writes
    axes: list[str] = field(default_factory=lambda: ["x"])  # a name for each, as at the teleoperator
    force: str = "f_s"  # N: of the stack on the slave; f_env: of the slave on what it touches, where it is sensed
    policy: str = ""  # the folder of the master's end on this machine, to which a policy's actions go; "": to none
    patience: float = 5.0  # s without a row, after which it counts as gone
    cameras: dict[str, CameraConfig] = field(default_factory=dict)


class BilateralRobot(Robot):  # type: ignore[misc]  # as above
    """The slave's end. It observes where the slave is, how fast, the force, the time of that tick, and images."""

    config_class = BilateralRobotConfig
    name = "bilateral"

    def __init__(self, config: BilateralRobotConfig) -> None:
        super().__init__(config)
        self.config, self._newest = config, None
        self._policy: PolicyWriter | None = None
        self.cameras = make_cameras_from_configs(config.cameras)

    @property
    def observation_features(self) -> dict[str, Any]:
        images = {name: (camera.height, camera.width, 3) for name, camera in self.config.cameras.items()}
        return {**features(self.config.axes), **images}

    @property
    def action_features(self) -> dict[str, type]:
        names: dict[str, type] = features(self.config.axes)
        return names

    @property
    def is_connected(self) -> bool:
        return self._newest is not None and all(camera.is_connected for camera in self.cameras.values())

    @property
    def is_calibrated(self) -> bool:
        return True

    def connect(self, calibrate: bool = True) -> None:
        for camera in self.cameras.values():
            camera.connect()
        self._newest = following(self.config.run, "s", self.config)
        if self.config.policy:
            try:
                self._policy = PolicyWriter(self.config.policy)
            except Refused as refused:
                raise DeviceNotConnectedError(str(refused)) from refused
            self._policy.switch(on=True)

    def calibrate(self) -> None:
        """There is nothing to calibrate."""

    def configure(self) -> None:
        """There is nothing to configure."""

    def get_observation(self) -> dict[str, Any]:
        state = now(self._newest, self.config.patience)
        return {**state, **{name: camera.async_read() for name, camera in self.cameras.items()}}

    def send_action(self, action: dict[str, float]) -> dict[str, float]:
        """Send a policy's action to the master; of a teleoperator's nothing: the slave does it already, by the law."""
        if self._policy is not None:
            self._policy.send([action[f"{axis}.pos"] for axis in self.config.axes])
        return action

    def disconnect(self) -> None:
        policy, self._policy = self._policy, None
        if policy is not None:
            policy.switch(on=False)
            policy.close()
        newest, self._newest = self._newest, None
        if newest is not None:
            newest.close()
        for camera in self.cameras.values():
            if camera.is_connected:
                camera.disconnect()
