"""Numbers of position servos from a routine: what is found, how sure it is, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from teleop import Refused, Servo, load_scene, servos_of_file
from teleop.__main__ import main
from teleop.live.devices.identify import NOTHING, Identified, JointRecord, fit_servo, goals, record, toml_of
from teleop.physics.servo import encoded, turn
from teleop.protocol.endpoint import Axes
from tests.live.arms.servo_stand_in import Feetech, Physics
from tests.live.arms.test_position_servo import SCENE
from tests.waiting import until


class TimedBus:
    """One servo on a bus that is late, moved by the time that its caller waits."""

    def __init__(self, servo: Servo) -> None:
        self.servo, self.c = servo, servo.slave_plant(1e-3, None).c[0]
        self.ticks, self.state, self.wanted = 0, (0.0,) * 5, [0.0]
        self.sent, self.places = [0.0], [0.0]
        self.most = 0.0

    def clock(self) -> float:
        return 1e-3 * self.ticks

    def sleep(self, seconds: float) -> None:
        to_servo, _ = self.servo.ticks(1e-3)
        for _ in range(round(seconds / 1e-3)):
            self.sent.append(self.wanted[-1])
            self.state = turn(self.c, NOTHING, self.state, self.sent[max(0, len(self.sent) - 1 - to_servo)], 0.0, 0.0)
            self.places.append(encoded(self.state[0], self.servo.step))
            self.ticks += 1

    def read(self) -> Axes:
        return (self.places[max(0, len(self.places) - 1 - self.servo.ticks(1e-3)[1])],)

    def goal(self, x: Axes) -> None:
        self.wanted.append(x[0])
        self.most = max(self.most, abs(x[0]))

    def close(self) -> None:
        pass


@pytest.mark.parametrize("numbers", [
    {"K": 17.8, "damping": 0.6, "friction": 0.15, "bus": (0.005, 0.005)},
    pytest.param({"K": 50.0, "damping": 1.2, "friction": 0.05, "bus": (0.008, 0.004)}, marks=pytest.mark.full)])
def test_the_numbers_of_a_servo_are_found_within_their_uncertainty_and_its_reach(numbers: dict[str, Any]) -> None:
    bus = TimedBus(Servo(**numbers, inertia=0.028, link=0.01, counts=4096))
    found = fit_servo(record(bus, 0, 0.1, clock=bus.clock, sleep=bus.sleep), 0.038)
    assert bus.most <= 0.1
    for name, true in {**numbers, "lateness": sum(numbers["bus"])}.items():
        if name != "bus":
            assert found.values[name] == pytest.approx(true, abs=found.errors[name]), name
        if name in ("K", "damping"):
            assert found.errors[name] < 0.05 * true, name


def test_a_joint_that_is_stuck_is_no_servo() -> None:
    wanted = goals(0.1, 0.0)
    dice = np.random.Generator(np.random.Philox(1))
    with pytest.raises(Refused, match=r"it does not move as a position servo: .* type a smaller or larger --reach"):
        fit_servo(JointRecord(0.005 * np.arange(len(wanted)), wanted, dice.normal(0.0, 1e-3, len(wanted))), 0.04)


def test_the_command_writes_a_file_that_the_scene_reads_and_another_arm_refuses(
    opened: Callable[..., Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("scservo_sdk", reason="the extra `feetech` is not installed")
    (tmp_path / "one.py").write_text(SCENE)
    scene, file = load_scene(str(tmp_path / "one.py")), tmp_path / "arm.toml"
    servos = opened(Feetech((1,)))
    opened(Physics(servos, (scene.slave,), (None,)))
    asked = ["identify", "robot", f"feetech:{servos.port}?timeout=80", str(tmp_path / "one.py"), "--reach", "0.1",
             "--inertia", "0.038", "--out", str(file)]

    def measured() -> bool:
        """True of a record that no busy machine made late: each is fitted anew."""
        file.unlink(missing_ok=True)
        return main(asked) == 0 and pytest.approx(17.8, rel=0.25) == servos_of_file(file, 1, drive="mass")[0].K

    until(measured, "the stiffness of the stand-in was never found")
    assert "N m/rad" in capsys.readouterr().out
    servo, = servos_of_file(file, 1, drive="mass")
    assert servo.lateness(1e-3) > 0.0
    assert main(asked) != 0
    assert "is there already" in capsys.readouterr().err
    with pytest.raises(Refused, match=r"of another arm: it has 1 joint, and 6 are needed"):
        load_scene("servo_arm", servo=str(file))


def test_a_file_that_identify_did_not_write_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "arm.toml"
    for text, words in (("[[joint]]\nK = 1.0\n", "joint 1 of .* has no damping; write it anew with teleop identify"),
                        ("[[joint]]\nK = 1.0\nDs = 2\n", "has no key 'Ds'"),
                        ("joint = 1", "it has 0 joints, and 1 are"),
                        ("[[joint]\n", "cannot be read .*; give a file that teleop identify wrote")):
        file.write_text(text)
        with pytest.raises(Refused, match=words):
            servos_of_file(file, 1)
    joint = Identified({"K": 2.0, "damping": 1.0, "friction": 0.0, "lateness": 0.01, "inertia": 0.04}, {"K": 0.1})
    file.write_text(toml_of("arm", 0.1, [joint, joint]))
    assert [each.K for each in servos_of_file(file, 2)] == [2.0, 2.0]
