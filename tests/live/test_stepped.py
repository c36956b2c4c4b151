"""Two ends that step together, through datagrams or in one process, make the run of virtual time, to the last bit."""

from __future__ import annotations

import socket
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from threading import Event, Thread
from typing import Any

import numpy as np
import pytest

from channel import LeftOut, parse_link
from master import Grip, Rest, SimulatedMaster, Sine
from slave import HuntCrossley, Moving, SimulatedSlave, StandardLinearSolid, Tissue, Wall
from teleop import PFRA, Deadband, DeviceError, Direct, Integral, Operator, Reading, Refused, Scene, load_scene, run
from teleop.law import find_law, known_laws
from teleop.laws.wave import Wave
from teleop.live.driving import AGAIN
from teleop.live.in_process import run_stepped
from teleop.live.net.wire import Wire
from teleop.live.records.merge import merge
from teleop.physics.plant import MassDamper
from teleop.physics.relaxing import ElectricalDamping
from teleop.protocol.packet import Kind, peek
from teleop.scene.playout import Fixed
from teleop.scene.playout import Hold as HoldLast
from teleop.stages.device import Device
from teleop.stages.encoder import Encoder
from teleop.stages.force_cap import Cap
from teleop.stages.passivity_controller import PassivityController
from teleop.stages.velocity.adaptive_window import EndFit
from teleop.stages.velocity.backward_difference import BackwardDifference
from teleop.stages.velocity.low_pass import LowPass
from teleop.stages.watchdog import Watchdog

pytestmark = pytest.mark.live

ROUGH = "uniform(0.012) | bernoulli(0.1) | duplicate(0.2, after=0.003)"
SEED = 11


def scene(**other: Any) -> Scene:
    base: dict[str, Any] = {
        "law": Wave(), "master": MassDamper(mass=0.1, damping=0.5), "slave": MassDamper(mass=0.5, damping=1.0),
        "hand": Grip(mass=0.4, k=200.0, d=5.0, reference=Sine(amplitude=0.05, frequency=2.0)),
        "environment": Wall(k=5e3, d=5.0, at=0.004), "link": parse_link("delay(0.02)"), "duration": 0.3, "energy": True,
    }
    return Scene(**{**base, **other})


def in_three_axes(law: Any, **other: Any) -> Scene:
    wall = Wall(k=5e3, d=5.0, at=0.004)
    return scene(**{"law": law, "axes": 3, "environment": (wall, None, wall), "start_s": (0.0, 0.005, -0.005), **other})


RUBBING = MassDamper(mass=0.1, damping=0.5, friction=0.3)
BEATING = Moving(environment=Wall(k=5e3, d=5.0, at=0.004), path=Sine(amplitude=0.002, frequency=5.0))
SCENES = {
    "wave, constant": scene(),
    "wave, no link": scene(link=None),
    "wave, rough, zero": scene(link=parse_link(ROUGH)),
    "wave, rough, hold": scene(link=parse_link(ROUGH), playout=HoldLast()),
    "wave, rough, fixed": scene(link=parse_link(ROUGH), playout=Fixed(0.008)),
    "wave, blackout": scene(link=parse_link("delay(0.01) | blackout(0.1, 0.08)"),
                            watchdog=Watchdog(timeout=0.03, ramp=0.02), cap=Cap(f_max=2.0, slew=500.0)),
    "wave, three axes": in_three_axes(Wave(), link=parse_link(ROUGH), playout=Fixed(0.008, HoldLast())),
    "direct, other ways": scene(law=Direct(), link=parse_link(f"{ROUGH} ; delay(0.03) | gilbert_elliott(0.1, 0.3)")),
    "direct, no hand": scene(law=Direct(), hand=None, start_m=0.03),
    "pfra, observer": scene(law=PFRA(alpha=0.2), link=parse_link(ROUGH)),
    "pfra, sensor": scene(law=PFRA(alpha=0.2), observer=None, watchdog=Watchdog(timeout=0.01, ramp=0.01)),
    "pfra, three axes": in_three_axes(PFRA(alpha=0.2), link=parse_link(ROUGH), cap=Cap(f_max=2.0, slew=500.0)),
    "devices": scene(
        law=PFRA(alpha=0.2), link=parse_link(ROUGH), passivity=PassivityController(cap=2.0),
        device_m=Device(encoder=Encoder(step=2e-5), velocity=EndFit(noise=2e-5), every=3, delay=2),
        device_s=Device(encoder=Encoder(step=1e-5, phase=0.5), velocity=LowPass(cutoff=60.0)),
    ),
    "devices, three axes": in_three_axes(Direct(), device_m=Device(velocity=BackwardDifference(), delay=1)),
    "friction": scene(master=RUBBING, slave=MassDamper(mass=0.5, damping=1.0, friction=0.2), law=PFRA(alpha=0.2)),
    "friction, sensor": scene(master=RUBBING, law=PFRA(alpha=0.2), observer=None),
    "rubber": scene(environment=HuntCrossley(k=1e4, lam=0.5, at=0.004)),
    "relaxing": scene(environment=StandardLinearSolid(k=100.0, k1=300.0, tau=0.05), law=Direct(),
                      electrical=ElectricalDamping(b=1.0, cutoff=10.0)),
    "moving": in_three_axes(Wave(), environment=(BEATING, None, Wall(k=5e3, at=0.004))),
    "swings to its end": scene(link=parse_link("delay(0.005)"), law=Direct(), start_m=0.03, duration=0.45,
                               hand=Grip(mass=0.4, k=2e3, d=0.0, reference=Rest(at=0.0))),
    "another tick": scene(dt=0.7e-3),
    "one tick": scene(duration=1e-3),
}


def equal(live: Any, virtual: Any) -> None:
    """Status, sentence, figures and every array's bytes."""
    assert (live.status, live.sentence, live.ticks) == (virtual.status, virtual.sentence, virtual.ticks)
    assert list(live.trace) == list(virtual.trace)
    for name, column in virtual.trace.items():
        assert live.trace[name].dtype == column.dtype
        assert live.trace[name].tobytes() == column.tobytes(), name
    assert live.metrics == virtual.metrics


class Leaky(Wire):
    """Every tenth datagram that this wire sends goes nowhere."""

    def __init__(self, sock: socket.socket, peer: Any) -> None:
        super().__init__(sock, peer)
        self.tried = 0

    def send(self, data: bytes) -> None:
        self.tried += 1
        if self.tried % 10:
            super().send(data)


class Stammering(Wire):
    """The master's: every message is lost the first time it is sent, one of them more often; farewells pass."""

    def __init__(self, sock: socket.socket, peer: Any, worst: int = -1) -> None:
        super().__init__(sock, peer)
        self.masters, self.worst, self.tries = peer is not None, worst, Counter[bytes]()

    def send(self, data: bytes) -> None:
        self.tries[data] += 1
        kind, number = peek(data)
        if not self.masters or kind is not Kind.FORTH or self.tries[data] > (5 if number == self.worst else 1):
            super().send(data)


def stepped(pair: Callable[..., Any], of: Scene, **other: Any) -> Any:
    both = pair(of, seed=SEED, **other).run()
    assert both.errors == {"m": None, "s": None}
    return merge(of, *both.write())


OVER_SOCKETS = ("wave, rough, zero", "wave, blackout", "devices, three axes", "pfra, sensor", "one tick")


@pytest.mark.parametrize("name", [  # without sockets all of them are stepped below
    name if name in OVER_SOCKETS else pytest.param(name, marks=pytest.mark.full) for name in SCENES])
def test_the_stepped_run_is_the_virtual_run(name: str, pair: Callable[..., Any]) -> None:
    virtual = run(SCENES[name], seed=SEED)
    live = stepped(pair, SCENES[name])
    equal(live, virtual)
    assert live.packets == virtual.packets
    assert name == "one tick" or max(np.abs(virtual.trace["f_m"]).ravel()) > 0.01


TWO_PORT = [name for name in known_laws() if hasattr(find_law(name), "master")]


@pytest.mark.full
@pytest.mark.parametrize("axes", [1, 3])
@pytest.mark.parametrize("name", TWO_PORT)
def test_the_stepped_run_of_every_law_is_its_virtual_run(name: str, axes: int, pair: Callable[..., Any]) -> None:
    law, rough = find_law(name)(), parse_link(ROUGH)
    short: Any = {"link": rough, "duration": 0.1, "watchdog": Watchdog(timeout=0.02, ramp=0.02)}
    of = scene(law=law, **short) if axes == 1 else in_three_axes(law, **short)
    equal(stepped(pair, of), run(of, seed=SEED))


@pytest.mark.parametrize(("name", "wire", "duration"), [
    ("wave, rough, zero", Leaky, 0.1), ("pfra, three axes", Stammering, 0.02), ("one tick", Stammering, 0.02),
    *[pytest.param(name, wire, duration, marks=pytest.mark.full)
      for name in ("wave, rough, zero", "pfra, three axes", "wave, no link", "one tick")
      for wire, duration in ((Leaky, 0.1), (Stammering, 0.02))],
])
def test_datagrams_that_are_lost_on_the_way_are_sent_again(
    name: str, wire: Any, duration: float, pair: Callable[..., Any]
) -> None:
    of = replace(SCENES[name], duration=min(SCENES[name].duration, duration))
    equal(stepped(pair, of, wire=wire), run(of, seed=SEED))


UNSTABLE = scene(
    law=Direct(K=2000.0, B=8.0, kf=3.0), master=MassDamper(mass=0.04, damping=0.8), environment=Tissue(k=2000.0, d=0.0),
    slave=MassDamper(mass=0.04, damping=0.8), hand=Grip(mass=0.0, k=100.0, d=2.0, reference=Rest()),
    start_m=1e-3, x_limit=0.05,
)


DIVERGING = {
    "grows": UNSTABLE, "grows longer": replace(UNSTABLE, x_limit=0.3), "no link": replace(UNSTABLE, link=None),
    "soon": scene(x_limit=1e-4), "the master at once": scene(x_limit=1e-3, start_m=0.5),
    "the slave at once": scene(x_limit=1e-3, start_s=0.5), "not finite": scene(
        hand=Grip(mass=0.4, k=200.0, d=5.0, reference=Sine(amplitude=1e308, frequency=3.0)), law=Direct(K=1e9)),
}


@pytest.mark.parametrize(("of", "wire"), [
    pytest.param(of, wire, id=f"{name} {wire.__name__}", marks=[] if (name, wire) in (
        ("grows", Leaky), ("the slave at once", Leaky), ("not finite", Wire)) else pytest.mark.full)
    for name, of in DIVERGING.items() for wire in (Wire, Leaky)
])
def test_a_run_that_diverges_does_so_at_the_same_tick_and_says_the_same(
    of: Scene, wire: Any, pair: Callable[..., Any]
) -> None:
    virtual = run(of, seed=SEED)
    assert virtual.status == "diverged"
    equal(stepped(pair, of, wire=wire), virtual)


OVERFLOW = scene(law=Direct(kf=1e308), start_s=0.02, link=parse_link("delay(0.002)"))


def test_the_last_message_of_a_run_that_diverges_is_waited_for_though_the_farewell_came_first(
    pair: Callable[..., Any]
) -> None:
    """The master's force fails at a tick that the slave has yet to make, for which it needs a message still."""
    virtual = run(OVERFLOW, seed=SEED)
    assert "f_m is not finite" in virtual.sentence
    assert virtual.ticks < 10
    equal(stepped(pair, OVERFLOW, wire=partial(Stammering, worst=virtual.ticks - 2)), virtual)


@pytest.mark.parametrize("killed", [False, True])
def test_garbage_that_keeps_coming_stops_no_resend_and_no_giving_up(
    killed: bool, pair: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each datagram of a stranger was taken for a word of the peer: both ends waited for ever, with the force held."""
    monkeypatch.setattr("teleop.live.driving.SILENT", 20)
    of = scene(duration=0.05)
    both = pair(of, seed=SEED, wire=partial(Stammering, worst=20))
    if killed:
        master = both.shells["m"].wire
        master.send = lambda data: None if peek(data)[1] > 20 or peek(data)[0] is Kind.BYE else Wire.send(master, data)

    addresses, is_over = [shell.wire.sock.getsockname() for shell in both.shells.values()], Event()

    def throw() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            while not is_over.wait(AGAIN / 4):
                for address in addresses:
                    stranger.sendto(b"?", address)

    thrower = Thread(target=throw)
    thrower.start()
    try:
        both.run()
    finally:
        is_over.set()
        thrower.join()
    assert both.errors == {"m": None, "s": None}
    slave = both.shells["s"].outcome
    assert (slave.status, "it fell silent" in slave.sentence) == (("stopped", True) if killed else ("ok", False))


SIMULATED: dict[str, Any] = {"m": SimulatedMaster, "s": SimulatedSlave}


def same(of: Scene) -> None:
    """It is the run of virtual time: status, figures, arrays, packets and notes."""
    ours, virtual = run_stepped(of, SIMULATED, seed=SEED), run(of, seed=SEED)
    equal(ours, virtual)
    assert (ours.mode, ours.packets, ours.notes, ours.extra) == (
        "virtual", virtual.packets, virtual.notes, {k: v for k, v in virtual.extra.items() if k != "integration"})


@pytest.mark.parametrize("name", SCENES)
def test_the_run_of_two_ends_in_one_process_is_the_virtual_run(name: str) -> None:
    same(SCENES[name])


@pytest.mark.parametrize("name", [
    name if name in ("wave", "four_channel") else pytest.param(name, marks=pytest.mark.full) for name in TWO_PORT])
def test_of_every_law_in_three_axes_over_a_rough_link_with_a_watchdog(name: str) -> None:
    same(in_three_axes(find_law(name)(), link=parse_link(ROUGH), duration=0.1,
                       watchdog=Watchdog(timeout=0.02, ramp=0.02)))


@pytest.mark.parametrize("of", [*DIVERGING.values(), OVERFLOW], ids=[*DIVERGING, "overflow"])
def test_a_run_that_diverges_in_one_process_does_so_at_the_same_tick_and_says_the_same(of: Scene) -> None:
    assert run(of, seed=SEED).status == "diverged"
    same(of)


def test_of_scenes_with_more_parts() -> None:
    """Over another link, of six joints, with an operator's clutch."""
    same(load_scene("jittery_wan", duration=1.0, law="tdpa"))
    same(load_scene("leader_follower", duration=0.2, law="four_channel"))
    same(scene(operator=Operator(clutch=((0.05, 0.1),), absent=((0.2, 0.25),), ramp=0.02)))


class Robot(SimulatedSlave):
    """A slave of another kind: it senses its force, and fails at a tick if it is told to."""

    scene_body = False
    fails = -1

    def __init__(self, of: Scene) -> None:
        super().__init__(of, senses=True)
        self.closed = 0
        made.append(self)

    def read(self, k: int) -> Reading:
        if k == self.fails:
            raise DeviceError("the motor is off")
        return super().read(k)

    def close(self) -> None:
        self.closed += 1


class Broken(Robot):
    fails = 30


class Dead(Robot):
    fails = 0


class Blind(Robot):
    def __init__(self, of: Scene) -> None:
        super().__init__(of)
        self._sensor = False


class Arm(Robot):
    """One that nothing moves but its motor."""

    passive = True


class Pushed(SimulatedMaster):
    """A master that something else moves, a recording for example, of whose force nothing is known."""

    scene_body = False
    simulated = True


made: list[Robot] = []


def test_what_a_robot_senses_is_what_is_recorded_and_it_is_closed_in_the_end() -> None:
    of = SCENES["wave, constant"]
    ours, virtual = run_stepped(of, {**SIMULATED, "s": Robot}, seed=SEED, named={"robot": "mine"}), run(of, seed=SEED)
    assert ours.trace["f_env"].tobytes() == virtual.trace["f_env"].tobytes()
    assert np.abs(ours.trace["f_env"]).max() > 1.0
    assert ours.extra == {"robot": "mine"}
    assert made[-1].closed == 1


def test_of_a_robot_that_senses_no_force_there_is_none_a_note_says_so_and_no_law_reads_it() -> None:
    ours = run_stepped(SCENES["wave, constant"], {**SIMULATED, "s": Blind}, seed=SEED)
    assert "f_env" not in ours.trace
    assert "f_err_rms" not in ours.metrics
    assert [note for note in ours.notes if note.startswith("slave: the device has no force sensor")]
    with pytest.raises(Refused, match="reads the force on the environment"):
        run_stepped(scene(law=find_law("pfra")()), {**SIMULATED, "s": Blind}, seed=SEED)


def test_a_device_that_fails_stops_the_run_one_that_cannot_be_read_at_all_is_refused_and_both_are_closed() -> None:
    ours = run_stepped(SCENES["wave, constant"], {**SIMULATED, "s": Broken}, seed=SEED)
    assert (ours.status, ours.ticks) == ("stopped", 30)
    assert ours.sentence == "stopped at t = 0.030 s: the slave's device fails: the motor is off"
    assert made[-1].closed == 1
    with pytest.raises(Refused, match=r"the slave's device cannot be read: the motor is off; .* --robot out"):
        run_stepped(SCENES["wave, constant"], {**SIMULATED, "s": Dead}, seed=SEED)
    assert made[-1].closed == 1


def test_a_limit_cycle_is_told_of_a_robot_that_nothing_else_moves_and_without_advice_on_other_bodies() -> None:
    swings = replace(SCENES["swings to its end"], duration=2.0)
    virtual = run(swings, seed=SEED)
    assert virtual.status == "unstable"
    ours = run_stepped(swings, {**SIMULATED, "s": Robot}, seed=SEED)
    assert ours.trace["x_s"].tobytes() == virtual.trace["x_s"].tobytes()
    assert (ours.status, ours.sentence) == ("ok", "ran to its end, 2000 ticks of 0.001 s")
    ours = run_stepped(swings, {**SIMULATED, "s": Arm}, seed=SEED)
    assert ours.status == "unstable"
    assert virtual.sentence == f"{ours.sentence}; to see what becomes of it: {virtual.sentence.rpartition(': ')[2]}"


def test_a_motion_that_grows_under_a_hand_of_which_nothing_is_known_is_no_fault() -> None:
    """What the hand's reference puts in was asked of a force that nobody had sensed."""
    of = load_scene("beating_heart", law="direct", delay=0.1)
    ours = run_stepped(of, {**SIMULATED, "m": Pushed}, seed=SEED)
    assert [note for note in run(of, seed=SEED).notes if "still grows" in note]
    assert "f_h" not in ours.trace
    assert ours.status == "ok"


def test_what_no_schedule_can_step_is_refused_in_one_sentence() -> None:
    for of, says in (
        (load_scene("virtual_wall"), "has no slave, .* leave --device and --robot out"),
        (scene(deadband=Deadband(k=0.1, keep_alive=0.01), playout=Integral()), "a deadband leaves packets out"),
        (scene(law=Direct(), left_out_s=LeftOut(0.2)), "ticks are left out by order .* leave --device and --robot out"),
    ):
        with pytest.raises(Refused, match=says):
            run_stepped(of, SIMULATED)
