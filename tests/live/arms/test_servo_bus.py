"""Chains of Feetech and Dynamixel servos by their vendors' SDKs, against stand-ins on a pseudo terminal."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from math import pi
from typing import Any

import pytest

pytest.importorskip("scservo_sdk", reason="the extra `feetech` is not installed")
pytest.importorskip("dynamixel_sdk", reason="the extra `dynamixel` is not installed")

from teleop import DeviceError, Refused, Scene, check_device, load_scene
from teleop.__main__ import main
from teleop.live.devices.arms import dynamixel, feetech
from teleop.live.devices.arms.dynamixel import DynamixelChain, dynamixel_bus, dynamixel_device, dynamixel_robot
from teleop.live.devices.arms.feetech import feetech_bus, feetech_robot
from teleop.live.devices.arms.servo_bus import ServoBus, TorqueArm
from teleop.live.devices.judging import DeviceFault
from teleop.live.devices.opening import find_device
from teleop.scene.library import ROOT
from tests.live.arms.servo_stand_in import Dynamixel, Feetech, Servos
from tests.waiting import answered, until

pytestmark = pytest.mark.live
BUSES: dict[type[Servos], Callable[[Scene, str], ServoBus]] = {Feetech: feetech_bus, Dynamixel: dynamixel_bus}
STEP = 2 * pi / 4096  # rad of a count


def joints(axes: int = 2) -> Scene:
    return load_scene("bench_top", axes=str(axes), units="rad")


def trouble(bus: ServoBus) -> str:
    """What the bus says is wrong; "" while it reads."""
    try:
        bus.read()
    except DeviceError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("kind", BUSES)
def test_a_chain_is_limp_until_its_first_goal_follows_goals_and_lets_go_when_they_are_renewed_no_more(
    kind: type[Servos], opened: Callable[..., Any]
) -> None:
    servos = opened(kind((1, 2)))
    bus = opened(answered(lambda: BUSES[kind](joints(), f"{servos.port}?ids=1,-2")))
    until(lambda: not trouble(bus))
    assert [servos.get(each, servos.torque, 1) for each in (1, 2)] == [0, 0]

    def follows() -> bool:
        with suppress(DeviceError):  # a busy machine may be late with an answer
            bus.goal((0.3, 0.2))
            return bus.read() == pytest.approx((0.3, 0.2), abs=STEP)
        return False

    until(follows)
    assert [servos.get(each, servos.torque, 1) for each in (1, 2)] == [1, 1]
    assert servos.get(2, *servos.positions) == round(2048 - 0.2 / STEP)  # the sign of its id
    assert bus.rate > 0.0
    # The hand moves joint 1 away from its goal: what lets go gives it its position for a goal.
    servos.moves = lambda _servo, _table: None
    servos.set(1, *servos.positions, 2048)
    until(lambda: servos.get(1, *servos.goals) == 2048, "its goal was never let go of")
    assert servos.get(1, servos.torque, 1) == 1
    bus.limp()
    until(lambda: not servos.get(1, servos.torque, 1))
    bus.close()


@pytest.mark.parametrize("kind", BUSES)
def test_a_servo_that_does_not_answer_is_one_sentence_and_blocks_no_tick(
    kind: type[Servos], opened: Callable[..., Any]
) -> None:
    servos = opened(kind((1, 2)))
    bus = opened(answered(lambda: BUSES[kind](joints(), servos.port)))
    for knob, sentence in (("silent", "does not answer"), ("damaged", "answered with a packet that is damaged"),
                           ("short", "answered with 1 byte of ")):
        getattr(servos, knob).add(2)
        until(lambda sentence=sentence: f"servo 2 on {servos.port} {sentence}" in trouble(bus), f"never {sentence}")
        took = []
        for _ in range(100):
            began = time.perf_counter()
            with pytest.raises(DeviceError):
                bus.goal((0.0, 0.0))
            took.append(time.perf_counter() - began)
            time.sleep(0.001)
        assert sorted(took)[50] < 0.02, "a goal waits for the 34 ms that the SDK waits"
        getattr(servos, knob).clear()
        until(lambda: not trouble(bus), f"never came back after {knob}")


@pytest.mark.parametrize(("kind", "flags", "words"), [
    (Feetech, 4, "it is too hot (31 degrees Celsius)"),
    (Feetech, 4 | 32, "it is too hot and it is overloaded (31 degrees Celsius)"),
    (Dynamixel, 0x80, "it is too hot")])
def test_a_servo_that_is_too_hot_makes_the_chain_limp_until_it_is_cool(
    kind: type[Servos], flags: int, words: str, opened: Callable[..., Any]
) -> None:
    servos = opened(kind((1, 2)))
    bus = opened(answered(lambda: BUSES[kind](joints(), servos.port)))

    def drives() -> bool:
        with suppress(DeviceError):  # of a stand-in that is late on a busy machine
            bus.goal((0.1, 0.1))
        return all(servos.get(each, servos.torque, 1) for each in (1, 2))

    until(drives)
    servos.set(2, 70, 1, 4)  # of a Dynamixel: which error it is
    servos.flags[2] = flags
    until(lambda: f"servo 2 on {servos.port} reports: {words}; all torques are off" in trouble(bus))
    until(lambda: not any(servos.get(each, servos.torque, 1) for each in (1, 2)), "it was never limp")
    switched: list[int] = []
    servos.moves = lambda servo, table: switched.append(servo) if table[servos.torque] else None
    for _ in range(50):  # an end goes on giving goals while it is safe
        with pytest.raises(DeviceError):
            bus.goal((0.1, 0.1))
        time.sleep(0.002)
    assert not switched
    servos.flags.clear()
    until(lambda: not trouble(bus))
    until(drives)


@pytest.mark.parametrize("kind", BUSES)
def test_a_port_that_is_lost_is_a_sentence_and_close_says_that_the_servos_may_hold_on(
    kind: type[Servos]
) -> None:
    servos = kind((1, 2))
    bus = BUSES[kind](joints(), servos.port)
    servos.unplug()
    until(lambda: f"{servos.port} is lost" in trouble(bus) or "cannot be opened" in trouble(bus))
    with pytest.raises(DeviceError, match="may still hold"):
        bus.close()


@pytest.mark.parametrize("kind", BUSES)
def test_a_chain_that_is_not_there_or_is_another_one_is_refused_with_what_to_type(
    kind: type[Servos], opened: Callable[..., Any]
) -> None:
    servos = opened(kind((1, 3)))
    name = kind.__name__.lower()
    for argument, sentence in (
        (servos.port, f"servo 2 on {servos.port} does not answer; those that answer at 1000000 baud among 1 to 12 are "
                      "1, 3: name them by ?ids="),
        ("/dev/nothing", "/dev/nothing cannot be opened (No such file or directory); name the port of the adapter, for "
                         f"example {name}:/dev/ttyACM0, and see that you may write to it (group dialout)"),
    ):
        with pytest.raises(DeviceError) as refused:
            BUSES[kind](joints(), argument)
        assert str(refused.value) == sentence
    for argument, words in (
        (f"{servos.port}?ids=1-3", f"the scene has 2 axes, and {name} was given 3 ids"),
        (f"{servos.port}?ids=1,1", "name each joint once"), (f"{servos.port}?ids=1,x", "whole numbers from 0 to 252"),
        (f"{servos.port}?id=1,3", f"{name} has no setting 'id'; did you mean ids?"),
        (f"{servos.port}?baud=1", "has no baud rate 1"), (f"{servos.port}?rate=0", "rate must be above 0"),
        (f"{servos.port}?ids", "cannot be read"), ("?ids=1", "has no address"),
    ):
        with pytest.raises(Refused, match=words.replace("?", r"\?")):
            BUSES[kind](joints(), argument)
    with pytest.raises(Refused, match="axes are in m"):
        BUSES[kind](load_scene("hard_wall"), f"{servos.port}?ids=1")


def test_what_a_feetech_servo_has_in_its_memory_is_refused_or_kept(opened: Callable[..., Any]) -> None:
    servos = opened(Feetech((1, 2)))
    servos.set(1, 3, 2, 1284)
    with pytest.raises(Refused, match=r"servo 1 on .* is of model 1284, and this driver knows the STS and SMS"):
        feetech_bus(joints(), servos.port)
    servos.set(1, 3, 2, 777)
    servos.set(2, 33, 1, 1)
    with pytest.raises(Refused, match=r"servo 2 on .* is in mode 1, and mode 0 is needed"):
        feetech_bus(joints(), servos.port)
    servos.set(2, 33, 1, 0)
    servos.set(1, 7, 1, 250)
    servos.set(1, 9, 4, 2000 | 2100 << 16)
    bus = opened(answered(lambda: feetech_bus(joints(), f"{servos.port}?limit=0.3")))
    assert "wait 500 us before they answer" in bus.notes[0]
    assert servos.get(1, 48, 2) == 300

    def at_its_limit() -> bool:
        bus.goal((-1.0, 0.0))
        return servos.get(1, 42, 2) == 2000

    until(at_its_limit)


def test_a_joint_that_passes_the_seam_of_its_encoder_is_a_sentence_and_ticks_after_a_pause_find_a_position_at_once(
    opened: Callable[..., Any]
) -> None:
    """The check of a device leaves out 50 ticks, 0.25 s of a scene of 5 ms, and the first reading after that failed."""
    servos = opened(Feetech((1, 2)))
    servos.set(1, 56, 2, 4090)
    bus = opened(answered(lambda: feetech_bus(joints(), servos.port)))
    servos.set(1, 56, 2, 3)
    until(lambda: "servo 1" in trouble(bus))
    assert "went over the seam of its encoder, from 4090 to 3 of 4096" in trouble(bus)
    servos.set(1, 56, 2, 4095)
    until(lambda: not trouble(bus))

    def pauses() -> bool:
        with suppress(DeviceError):
            bus.goal((0.0, 0.0))
        until(lambda: bus._silent, "its goal was never let go of")
        time.sleep(0.06)  # its newest position is old by then
        return not trouble(bus)

    until(pauses)


def test_a_late_answer_is_not_taken_for_the_next_one(opened: Callable[..., Any]) -> None:
    """The SDK drops nothing that has come; so after an answer that was late every position would be an old one."""
    servos = opened(Feetech((1,)))
    bus = opened(answered(lambda: feetech_bus(joints(1), servos.port)))
    chain: Any = bus._chain
    bus._done.set()
    bus._thread.join()
    chain._handler.ser.write(bytes([0xFF, 0xFF, 1, 4, 2, 56, 8, ~(1 + 4 + 2 + 56 + 8) & 0xFF]))  # a read of its state
    until(lambda: chain._handler.ser.in_waiting == 14)
    servos.set(1, 56, 2, 2148)
    assert chain.read() == pytest.approx((100 * STEP,))


def test_torques_by_the_current_are_an_ordinary_device_with_the_servos_own_watchdog(
    opened: Callable[..., Any]
) -> None:
    servos = opened(Dynamixel((1, 2)))
    motors = "mode=current&kt=1.78,0.89&limit=0.5"
    robot = opened(answered(lambda: dynamixel_robot(joints(), f"{servos.port}?{motors}")))

    def current(servo: int) -> int:
        return int.from_bytes(servos.tables[servo][102:104], "little", signed=True)

    def pushes() -> bool:
        robot.hold((0.178, -9.0))
        return (current(1), current(2)) == (round(100 / 2.69), -round(500 / 2.69))  # mA; the second at its limit

    until(pushes)
    until(lambda: servos.get(1, 98, 1) == 5)  # of 20 ms
    assert servos.get(1, 11, 1) == 0
    assert robot.read(0).f is None
    assert robot.deadline == 0.15
    until(lambda: (current(1), current(2)) == (0, 0), "a torque that nobody renews is never let go of")
    robot.close()
    assert [servos.get(each, 64, 1) for each in (1, 2)] == [0, 0]
    device = opened(answered(lambda: dynamixel_device(joints(), f"{servos.port}?{motors}")))

    def pushes_back() -> bool:
        device.hold((0.178, 0.0))
        return current(1) == -round(100 / 2.69)

    until(pushes_back)


def test_full_pwm_is_the_torque_at_stall(opened: Callable[..., Any]) -> None:
    servos = opened(Feetech((1, 2), moves=lambda _servo, _table: None))
    for each in (1, 2):
        servos.set(each, 33, 1, 2)
    robot = opened(answered(lambda: feetech_robot(joints(), f"{servos.port}?mode=pwm&stall=2")))

    def pushes() -> bool:
        robot.hold((0.5, -9.0))
        return (servos.get(1, 44, 2), servos.get(2, 44, 2)) == (250, 1000 | 1 << 10)

    until(pushes)
    until(lambda: (servos.get(1, 44, 2), servos.get(2, 44, 2)) == (0, 0))
    assert getattr(robot, "deadline", None) is None
    assert robot.watchdog is not None


@pytest.mark.parametrize(("text", "words"), [
    ("dynamixel:/dev/x?kt=1.78", "need mode=current and the N m of an ampere"),
    ("dynamixel:/dev/x?mode=current&kt=1,2,3", "kt has 3 numbers, and there are 2 joints"),
    ("dynamixel:/dev/x?mode=current&kt=-1", "kt must be above 0"),
    ("dynamixel:/dev/x?mode=torque&kt=1", "mode is position or current, not 'torque'"),
    ("feetech:/dev/x?mode=pwm", "stall= in N m"), ("feetech:/dev/x?limit=2", "limit must be at most 1"),
    ("feetech:/dev/x?lets_go=drop", "lets_go is hold or limp, not 'drop'"),
])
def test_settings_that_mean_nothing_are_refused_before_a_port_is_opened(text: str, words: str) -> None:
    with pytest.raises(Refused, match=words):
        find_device("s", text).open(joints())


def test_a_check_tells_what_the_bus_carries(opened: Callable[..., Any], capsys: pytest.CaptureFixture[str]) -> None:
    servos = opened(Dynamixel((1, 2)))

    def make(_: Scene) -> TorqueArm:
        """An arm whose thread waits as long as a busy machine may need."""
        return TorqueArm(ServoBus(DynamixelChain(servos.port, ((1, 1.0), (2, 1.0)), timeout=60_000.0, kt=(1.78,))), 1.0,
                         0.15)

    result = check_device(make, joints(), ticks=300)
    assert result.bus is not None
    assert 0.0 < result.bus.median <= result.bus.most_99 <= result.bus.most
    assert result.rate <= result.bus.carries
    text = f"dynamixel:{servos.port}?mode=current&kt=1.78&rate=100"
    words = ["check", "robot", text, "bench_top", "--set", "axes=2", "--set", "units=rad", "--ticks", "100"]
    until(lambda: main(words) == 0)  # a busy machine may lose an answer
    out = capsys.readouterr().out
    assert "exchanges a second" in out
    assert "for 99 of 100" in out
    servos.silent.add(2)
    with pytest.raises((DeviceFault, Refused), match=r"servo 2 on .* does not answer"):
        check_device(text, joints(), ticks=100)


HOLDS = """
import sys, time
from contextlib import suppress
from teleop import DeviceError, load_scene
from teleop.live.devices.device_watchdog import with_watchdog
from teleop.live.devices.arms.feetech import feetech_robot
from pathlib import Path
arm = feetech_robot(load_scene("bench_top", axes="2", units="rad"), sys.argv[1])
with with_watchdog(arm, Path(sys.argv[2])) as watched:
    print("pushes", flush=True)
    while True:
        with suppress(DeviceError):  # an answer that is late, where a live end goes on too
            watched.read(0)
        with suppress(DeviceError):
            watched.hold((0.5, 0.5))
        time.sleep(0.005)
"""


def test_the_watchdog_process_lets_servos_go_whose_end_is_stopped(opened: Callable[..., Any], tmp_path: Any) -> None:
    """Which has their port still."""
    servos = opened(Feetech((1, 2), moves=lambda _servo, _table: None))
    for each in (1, 2):
        servos.set(each, 33, 1, 2)
    end = subprocess.Popen([sys.executable, "-c", HOLDS, f"{servos.port}?mode=pwm&stall=2", str(tmp_path)], cwd=ROOT,
                           stdout=subprocess.PIPE, text=True)
    try:
        assert end.stdout is not None
        end.stdout.readline()
        until(lambda: (servos.get(1, 44, 2), servos.get(1, 40, 1)) == (250, 1))
        end.send_signal(signal.SIGSTOP)
        until(lambda: (servos.get(1, 44, 2), servos.get(1, 40, 1)) == (0, 0), "its torque stayed on")
    finally:
        end.kill()
        end.communicate()


@pytest.mark.parametrize("driver", [feetech, dynamixel])
def test_the_watchdogs_way_over_a_port_of_its_own_holds_a_joint_where_it_is_or_makes_it_limp(
    driver: Any, opened: Callable[..., Any]
) -> None:
    kind = Feetech if driver is feetech else Dynamixel
    servos = opened(kind((1, 2), moves=lambda _servo, _table: None))  # what they touch holds them

    def presses() -> None:
        for each in (1, 2):
            servos.set(each, *servos.goals, 3000)
            servos.set(each, servos.torque, 1, 1)

    presses()
    let_go = driver.letting_go(servos.port, "1,-2")
    let_go()
    until(lambda: [servos.get(each, *servos.goals) for each in (1, 2)] == [2048, 2048])
    servos.set(1, *servos.positions, 2000)  # it sinks a little
    let_go()
    assert [servos.get(each, *servos.goals) for each in (1, 2)] == [2048, 2048]
    assert [servos.get(each, servos.torque, 1) for each in (1, 2)] == [1, 1]
    presses()
    driver.letting_go(f"{servos.port}?lets_go=limp", "1,-2")()
    until(lambda: [servos.get(each, servos.torque, 1) for each in (1, 2)] == [0, 0])
    presses()
    servos.silent.add(1)  # where it is nobody knows
    driver.letting_go(servos.port, "1,-2")()
    until(lambda: [servos.get(each, servos.torque, 1) for each in (1, 2)] == [0, 0])


def test_a_live_run_with_servos_by_name(opened: Callable[..., Any], command: Callable[..., Any], tmp_path: Any) -> None:
    """The hand of a simulated master moves; the torques of the law reach the servos, and are off in the end."""
    torques, reach = list[int](), tmp_path / "reach.csv"  # of both joints, to 0.3 rad in a second
    reach.write_text("t,x,y\n" + "".join(f"{i / 100},{min(i, 100) * 3e-3},{-min(i, 100) * 3e-3}\n" for i in range(300)))
    servos = opened(Dynamixel((1, 2), moves=lambda _servo, table: torques.append(
        int.from_bytes(table[102:104], "little", signed=True))))
    knobs = ("--set", "axes=2", "--set", "units=rad", "--set", "duration=2", "--rate", "100", "--json")
    slave = command("slave", "bench_top", *knobs, "--listen", "127.0.0.1:0", "--out", "slave", "--robot",
                    f"dynamixel:{servos.port}?mode=current&kt=1.78&timeout=80")
    master = command("master", "bench_top", *knobs, "--peer", f"127.0.0.1:{slave.port()}", "--out", "master",
                     "--device", f"csv:{reach}")
    for end in (master, slave):
        code, _, err = end.end()
        assert code == 0, err
        assert "holds its last force" not in err
    assert max(map(abs, torques)) > 5, "the law never pushed"
    assert [servos.get(each, 64, 1) for each in (1, 2)] == [0, 0]
    assert [servos.get(each, 102, 2) for each in (1, 2)] == [0, 0]
