"""The slave of a live run as a LeRobot robot: its motion and force are the observation, beside LeRobot's cameras.

It reads the record that the slave's end writes. What drives the slave is the run's law: an action that LeRobot sends is
written into its data set, and goes nowhere else, so no policy can move the slave by it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from lerobot.cameras import CameraConfig, make_cameras_from_configs
from lerobot.robots import Robot, RobotConfig
from lerobot_teleoperator_bilateral import features, following, now


@RobotConfig.register_subclass("bilateral")
@dataclass(kw_only=True)
class BilateralRobotConfig(RobotConfig):  # type: ignore[misc]  # LeRobot need not be installed
    """`--robot.type=bilateral --robot.run=FOLDER`."""

    run: str  # the folder that the slave's end, or a demo, writes
    axes: list[str] = field(default_factory=lambda: ["x"])  # a name for each, as at the teleoperator
    force: str = "f_s"  # N: of the stack on the slave; f_env: of the slave on what it touches, where it is sensed
    patience: float = 5.0  # s without a row, after which it counts as gone
    cameras: dict[str, CameraConfig] = field(default_factory=dict)


class BilateralRobot(Robot):  # type: ignore[misc]  # as above
    """The slave's end. It observes where the slave is, how fast, the force, the time of that tick, and images."""

    config_class = BilateralRobotConfig
    name = "bilateral"

    def __init__(self, config: BilateralRobotConfig) -> None:
        super().__init__(config)
        self.config, self._newest = config, None
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

    def calibrate(self) -> None:
        """There is nothing to calibrate."""

    def configure(self) -> None:
        """There is nothing to configure."""

    def get_observation(self) -> dict[str, Any]:
        state = now(self._newest, self.config.patience)
        return {**state, **{name: camera.async_read() for name, camera in self.cameras.items()}}

    def send_action(self, action: dict[str, float]) -> dict[str, float]:
        """Nothing is sent: the slave does this already, by the law."""
        return action

    def disconnect(self) -> None:
        newest, self._newest = self._newest, None
        if newest is not None:
            newest.close()
        for camera in self.cameras.values():
            if camera.is_connected:
                camera.disconnect()
