"""Live ends whose arm has its weight carried: a silence, a stop, a kill; and motors on a bus."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from mmap import mmap
from pathlib import Path
from typing import Any

import pytest

from teleop import Reading, load_result, load_scene
from teleop.live.devices.device_watchdog import BEAT, DONE, FIRED, SEEN, SIZE, WatchedDevice
from teleop.live.devices.guarded_device import GuardedDevice
from teleop.live.devices.opening import find_device
from teleop.live.records.record import read_events
from teleop.scene.library import ROOT
from tests.live.arms.damiao_stand_in import Damiao
from tests.live.conftest import Command, summary
from tests.waiting import until

pytest.importorskip("mujoco", reason="mujoco-core is not installed (extra mujoco)")
pytestmark = pytest.mark.live
ARM = ROOT / "slave" / "arm.xml"
SCENE = """
from dataclasses import replace
from scenarios.bench_top import scene as bench


def scene(*, duration: float = 60.0):
    home = (0.0, 1.0472, -2.0944)
    of = bench(axes=3, units="rad", names="turn,lift,bend", duration=duration, f_max=1.0, m_s=0.02, b_s=0.1, m_m=0.02)
    return replace(of, start_m=home, start_s=home)
"""


@pytest.fixture
def opened() -> Iterator[Callable[[Any], Any]]:
    """`opened(thing)`: it is closed in the end."""
    things: list[Any] = []

    def keep(thing: Any) -> Any:
        things.append(thing)
        return thing

    yield keep
    for each in things:
        each.close()


def test_in_a_silence_the_arm_stays_where_it_is_and_after_a_stop_its_weight_is_lowered(
    command: Callable[..., Command], tmp_path: Path
) -> None:
    """The master is killed; a second and more later the slave is stopped, its law's force long gone."""
    (tmp_path / "weighty.py").write_text(SCENE)
    slave = command("slave", "weighty.py", "--robot", f"compensated:{ARM}?ramp=0.05 | mujoco:{ARM}?gravcomp=0",
                    "--listen", "127.0.0.1:0", "--json", "--out", str(tmp_path / "s"))
    master = command("master", "weighty.py", "--peer", f"127.0.0.1:{slave.port()}", "--out", str(tmp_path / "m"))
    slave.live(lambda numbers: numbers["gain"] == 1.0)
    master.signal(signal.SIGKILL)
    began = slave.live(lambda numbers: numbers["gain"] == 0.0)["k"]
    slave.live(lambda numbers: numbers["k"] > began + 2000)
    slave.signal(signal.SIGINT)
    code, _, err = slave.end()
    assert code == 0, err
    assert summary(tmp_path / "s")["status"] == "stopped"
    events = read_events(tmp_path / "s")
    assert any(each["what"] == "safe" for each in events)
    (zero,) = (each["why"] for each in events if each["what"] == "zero")
    lowered = zero.partition("and the arm's weight lowered in ")[2]
    assert 0.04 < float(lowered.removesuffix(" s")) < 2.0, zero  # along its ramp, however late ticks were
    trace: Any = load_result(tmp_path / "s").trace
    settled = trace["t"] > 0.5
    way = trace["x_s"][settled]
    assert abs(way - way[0]).max() < 0.05  # it falls by more than that in 0.1 s
    assert way[0][1] > 0.97


def test_of_motors_on_a_bus_the_weight_is_held_and_gone_when_the_end_lets_go(
    opened: Callable[..., Any], tmp_path: Path
) -> None:
    can = pytest.importorskip("can", reason="the extra `openarm` is not installed")
    file = tmp_path / "one.urdf"
    file.write_text("<robot name='one'><link name='base'/><link name='link'><inertial><origin xyz='0.2 0 0'/>"
                    "<mass value='0.5'/><inertia ixx='1e-3' iyy='1e-3' izz='1e-3' ixy='0' ixz='0' iyz='0'/></inertial>"
                    "</link><joint name='lift' type='revolute'><parent link='base'/><child link='link'/>"
                    "<axis xyz='0 -1 0'/><limit lower='-2' upper='2' effort='5' velocity='9'/></joint></robot>")
    stand_in = Damiao(can.Bus(channel="weighty", interface="virtual"), can.Message, (1,))
    try:
        of = load_scene("bench_top", axes="1", units="rad", names="lift")
        arm = opened(find_device("s", f"compensated:{file} | openarm:weighty?interface=virtual").open(of))
        guarded = GuardedDevice(arm, 1)
        k = 0

        def ticked() -> bool:
            nonlocal k
            k += 1
            time.sleep(0.001)
            reads = guarded.read(k, 0) is not None
            return guarded.hold((0.0,)) and reads

        weight = 0.5 * 9.81 * 0.2

        def held_in_place() -> bool:
            """True if it is given its weight: the stand-in has none, so what carries one would lift it."""
            stand_in.x[1] = stand_in.v[1] = 0.0
            return ticked() and abs(stand_in.torque[1] - weight) < 0.01

        until(held_in_place, "it never carried the weight")
        assert arm.read(k).f is not None
        stand_in.silent.add(1)
        until(lambda: not ticked() and "does not answer" in str(guarded.trouble))
        for _ in range(150):
            ticked()
        until(lambda: abs(stand_in.torque[1]) < 0.01, "a bus without answers is pressed on")
        stand_in.silent.clear()
        until(held_in_place, "it never carried the weight again")
        assert guarded.let_go()
        until(lambda: abs(stand_in.torque[1]) < 0.01, "let go it presses on")
    finally:
        stand_in.close()


def test_what_carries_a_weight_is_watched_while_the_laws_force_is_zero() -> None:
    """A watchdog process goes by the heartbeat: without one an end that is killed would leave the weight on."""
    class Carrying:
        """A device that holds 2 N beside the law's."""

        def __init__(self) -> None:
            self.force, self.carries = 0.0, True

        def read(self, k: int) -> Reading:
            return Reading((0.0,), (0.0,))

        def hold(self, force: tuple[float, ...]) -> None:
            self.force, self.carries = force[0] + 2.0, True

        def let_go(self, zero: tuple[float, ...]) -> None:
            self.force, self.carries = zero[0], False

    device = Carrying()
    watched = WatchedDevice(device, 0.15, mmap(-1, SIZE))
    words: Any = [0] * 8
    watched._words, words[SEEN] = words, 1 << 62
    guarded = GuardedDevice(watched, 1)
    guarded.read(0, 0)
    assert guarded.hold((0.0,))
    assert words[BEAT] > 0
    assert device.force == 2.0
    words[FIRED] = 1  # it takes over
    assert not guarded.hold((0.0,))
    assert device.force == 0.0
    words[DONE] = 1
    assert not guarded.hold((0.0,))  # and nothing is carried before the end has seen that
    assert guarded.hold((0.0,))
    assert device.force == 2.0
    assert guarded.let_go()
    assert (device.force, words[BEAT]) == (0.0, 0)
