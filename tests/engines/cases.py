"""Scenes by structure, law and stage, in which every part acts: those of a case differ in their numbers alone."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar, NamedTuple

from channel import LeftOut, parse_link
from master.hand import Grip, Sine
from slave import HuntCrossley, Moving, StandardLinearSolid, Tissue, Wall
from teleop import At, Fixed, Frame, Handover, Integral, Operator, Scaling, Scene, Servo, Wave, kind, load_scene
from teleop.laws.direct import Direct
from teleop.laws.pfra import PFRA
from teleop.laws.pp import PositionPosition
from teleop.laws.virtual_wall import VirtualWall
from teleop.laws.wave_position import WavePosition
from teleop.physics.plant import MassDamper
from teleop.physics.relaxing import ElectricalDamping
from teleop.scene.library import built_in_scenes
from teleop.scene.playout import Energy, Scaled
from teleop.stages.device import Device
from teleop.stages.encoder import Encoder
from teleop.stages.force_cap import Cap
from teleop.stages.passivity_controller import PassivityController
from teleop.stages.velocity.adaptive_window import BestFit, EndFit
from teleop.stages.velocity.backward_difference import BackwardDifference
from teleop.stages.velocity.levant import Levant
from teleop.stages.velocity.low_pass import LowPass
from teleop.stages.watchdog import Watchdog
from tests.teleop.scene.unlike import LAWS, unlike
from tests.teleop.stages.tumbling import tumbling

ROUGH = "delay(0.01) | uniform(0.01) | bernoulli(0.1) ; delay(0.02)"
MANY = 9  # one more than there are lanes
HARD = Wall(k=2e4, d=10.0, at=0.004)
QUEUES = (Integral(), Integral(0.005), Integral(0.05, settle=0.01, memory=0.5),
          Integral(settle=1.0, memory=0.0, ahead=0.0))
FIXED = tuple([Fixed(0.03 + 0.01 * n, Integral()) for n in range(5)])
SWING = Grip(mass=0.2, k=400.0, d=3.0, reference=Sine(amplitude=(0.02, 0.01, -0.02), frequency=3.0))


def own_link(n: int) -> str:
    """A link of random delays and losses for the scene of this number."""
    return f"delay({0.001 * n}) | uniform(0.02) | bernoulli({0.05 * n}) ; delay(0.02) | bernoulli(0.3)"


def waves(scene: str = "canonical", playouts: Sequence[Any] = QUEUES, **knobs: Any) -> list[Scene]:
    """Waves whose playouts have other numbers, over links of their own."""
    return [replace(load_scene(scene, **{"law": "wave", "law.b": 0.5 + 2.0 * n, "link": own_link(n), **knobs}),
                    playout=playouts[n % len(playouts)], energy=True, duration=0.5) for n in range(MANY)]


def wild(law: Any, dice: random.Random, **knobs: Any) -> Scene:
    """The canonical scene with random numbers; some diverge, early and late."""
    return load_scene("canonical", **{
        "law": law, "k_e": 10.0 ** dice.uniform(2.0, 6.0), "d_e": dice.choice([0.0, 1.0, 30.0]),
        "wall": dice.uniform(0.0, 0.04), "amplitude": dice.uniform(0.01, 0.1), "x_limit": 0.5, "duration": 0.5,
        "energy": True, **knobs})


def diverging(link: str | None = ROUGH) -> list[Scene]:
    """Reflected forces, some far too large, one of them overflowing at its first touch."""
    dice = random.Random(1)
    laws = [Direct(K=dice.uniform(100.0, 5000.0), B=dice.uniform(1.0, 40.0), kf=kf)
            for kf in (0.2, 1.0, 40.0, 50.0, 0.5, 1.0, 30.0, 0.3)]
    way = {"delay": 0.01} if link is None else {"link": link}
    return [*[wild(law, dice, **way) for law in laws], replace(wild(Direct(kf=1e308), dice, **way), start_s=0.05)]


def limited() -> list[Scene]:
    """Every limit of a force, narrow in some, at ends with encoders, estimators and forces that are late and slow."""
    dice = random.Random(2)

    def cap() -> Cap:
        return Cap(f_max=dice.uniform(0.5, 20.0), slew=dice.choice([None, 300.0, 1e4]),
                   v_max=10.0 ** dice.uniform(-4.0, 0.5), power=10.0 ** dice.uniform(-6.0, 0.0))

    laws = [PFRA(alpha=dice.random(), kf=kf) for kf in (0.5, 1.0, 60.0, 1.0, 60.0, 1.0, 1.0, 0.5)]
    scenes = [wild(law, dice, link=ROUGH) for law in laws]
    scenes.append(replace(wild(PFRA(kf=1e308), dice, link=ROUGH), start_s=0.05))
    return [replace(of, cap=cap(), watchdog=Watchdog(timeout=0.012 + 0.002 * n, settle=0.02), device_m=Device(
        encoder=Encoder(step=1e-4), velocity=LowPass(cutoff=20.0 + 10.0 * n), every=3, delay=2),
        device_s=Device(encoder=Encoder(step=1e-5), velocity=BackwardDifference())) for n, of in enumerate(scenes)]


def skipping(**left_out: Any) -> list[Scene]:
    """Ticks that both ends leave out, over a link with a gap."""
    base = replace(load_scene("canonical", law="pfra", link="delay(0.01) | blackout(0.2, 0.1)"), energy=True,
                   duration=0.5, device_s=Device(every=3))
    return [replace(base, left_out_m=LeftOut(0.05 + 0.05 * n), left_out_s=LeftOut(0.2, 4.0),
                    cap=Cap(f_max=9.0, slew=2000.0, power=0.01 + 0.01 * n), **left_out) for n in range(MANY)]


def one_port() -> list[Scene]:
    """A rendered wall with a passivity controller, an encoder and limits."""
    base = load_scene("virtual_wall", duration=0.4)
    return [replace(base, law=VirtualWall(K=1e3 + 1e3 * n, at=0.01), passivity=PassivityController(cap=0.5 + n),
                    cap=Cap(f_max=30.0, v_max=0.05 * (n + 1), power=0.02 * (n + 1)),
                    device_m=Device(encoder=Encoder(step=1e-5), velocity=BackwardDifference(), delay=2))
            for n in range(MANY)]


class Place(NamedTuple):
    x: kind.Position


class Work(NamedTuple):
    E: float


class Meter(NamedTuple):
    x: kind.Position
    E: float
    time: float


@dataclass(frozen=True, kw_only=True)
class Metering:
    """Coupling with branches, one of which returns, that keeps its energy and reads span, gain, age and sums."""

    K: float = 200.0
    shows: ClassVar[tuple[str, ...]] = ("E",)
    claims: ClassVar[dict[str, str]] = {}

    def master_start(self, at: At) -> Any:
        return Meter(at.x, 0.01, 0.0), Place(at.x)

    def slave_start(self, at: At) -> Any:
        return Meter(at.x, 0.02, 0.0), Place(at.x)

    def master_sums(self, s: Meter, at: At, rx: Place) -> Work:
        return Work(at.f_held * at.dx)

    def master(self, s: Meter, at: At, rx: Place, over: Work) -> Any:
        now = Meter(at.x, s.E + over.E, s.time + at.span)
        return self.K * (at.x - rx.x) + now.time + 0.01 * at.gain, Place(at.x), now

    def slave(self, s: Meter, at: At, rx: Place) -> Any:
        now = Meter(at.x, s.E - at.f_held * at.dx, s.time + at.span)
        f_s = self.K * (rx.x - at.x) - 4.0 * at.v + now.time - 0.01 * at.gain
        if not at.fresh:
            return 0.5 * f_s, Place(at.x), now
        if f_s > 2.0:
            f_s = 2.0
        elif f_s < -1.0 and at.v > 0.0:
            f_s = f_s + 4.0 * at.v + 0.1 * (at.age > 0.02)
        return f_s, Place(at.x if at.x > 0.0 else 0.0), now

    def master_stored(self, s: Meter) -> float:
        return s.E

    def slave_stored(self, s: Meter) -> float:
        return s.E


def bouncing(seed: int, spans: int) -> tuple[tuple[float, float], ...]:
    """A switch that is opened so many times at random."""
    dice = random.Random(seed)
    times = sorted(0.4 * dice.random() for _ in range(2 * spans))
    return tuple(zip(times[::2], times[1::2], strict=True))


def metered(axes: int = 1) -> list[Scene]:
    """A law of a user's, with an operator's clutch and a watchdog that lets go."""
    base = load_scene("canonical", link="delay(0.01) | uniform(0.005) | blackout(0.1, 0.1)", energy=True)
    return [replace(base, law=Metering(K=150.0 + 10.0 * n), axes=axes, duration=0.4,
                    watchdog=Watchdog(timeout=0.02, ramp=0.01, settle=0.02), cap=Cap(f_max=3.0, slew=300.0),
                    operator=Operator(clutch=bouncing(n, 2 + 2 * (n % 2)), absent=bouncing(20 + n, 2),
                                      ramp=0.004 * (n + 1), closes_within=0.002 * (n + 1)))
            for n in range(MANY)]


def handed_over(policy: bool = True, axes: int = 1, motor: bool = True, **parts: Any) -> list[Scene]:
    """A policy whose switch bounces, with a small tank, actions that leap and others that are missing."""
    dice = random.Random(7)
    base = load_scene("canonical", law="pp", link="delay(0.01) | uniform(0.005) | blackout(0.15, 0.05)", energy=True)
    moves = Sine(amplitude=0.04 if axes == 1 else (0.04, 0.6, 0.1), frequency=2.0) if policy else None
    return [replace(base, axes=axes, duration=0.5, watchdog=Watchdog(timeout=0.02, ramp=0.01, settle=0.02),
                    cap=Cap(f_max=2.0 + n, slew=500.0, v_max=0.2, power=0.05), handover=Handover(
                        policy=moves, takes=bouncing(n, 4), silent=((0.1, 0.2),), rate=60.0, late=0.01, Kp=400.0,
                        Bp=10.0, f_max=3.0, slew=600.0, ramp=0.02, energy=0.004 * (n + 1), power=0.01 * n, soft=0.003,
                        leap=0.03, grip=dice.uniform(0.2, 0.9), motor=motor), **parts) for n in range(MANY)]


def indexed() -> list[Scene]:
    """A pose whose clutch opens by parts, whose scale is changed and whose arm begins elsewhere and is aligned."""
    base = load_scene("pose", law="pp", duration=0.4, link="delay(0.01) | uniform(0.005) | blackout(0.1, 0.1)")
    return [replace(base, start_s=(0.002 * n, 0.0, 0.001, 0.02, -0.01 * n, 0.0), cap=Cap(f_max=3.0, slew=300.0),
                    operator=Operator(clutch=bouncing(n, 2), clutch_rotation=bouncing(30 + n, 3),
                                      clutch_translation=bouncing(40 + n, 1), ramp=0.004 * (n + 1),
                                      scales=((0.05 * (n + 1), 0.4), (0.3, 2.0 + n)), scale_ramp=0.02,
                                      align=(0.1, 0.0, 0.2, 0.9, 0.9, 0.9), align_most=0.5 + n))
            for n in range(3)]


def slow_slew() -> list[Scene]:
    """A clutch that opens while a small slew limit holds a force, for a second and no longer."""
    base = load_scene("canonical", law=PositionPosition(K=1000.0), frequency=0.1, duration=4.0, energy=True)
    return [replace(base, operator=Operator(clutch=((2.5, 4.0),), ramp=0.05), observer=None, link=None, playout=None,
                    cap=Cap(f_max=20.0, slew=slew)) for slew in (0.2, 0.3)]


def knobs(scene: str, name: str, values: Sequence[Any], **fixed: Any) -> list[Scene]:
    """A scene of the library with one knob's values."""
    return [load_scene(scene, **{"duration": 0.3, **fixed, name: value}) for value in values]


def bodies(environment: Callable[[float], Any], friction: float = 0.0, electrical: bool = False) -> list[Scene]:
    """Bodies with an inner state in three axes, the last of them beyond what they bear."""
    return [Scene(
        law=Wave(), axes=3, master=MassDamper(mass=0.1, damping=0.5, friction=0.5 * friction),
        slave=MassDamper(mass=0.3, damping=1.0, friction=friction), environment=environment(k),
        hand=replace(SWING, reference=Sine(amplitude=(a, 0.5 * a, -a), frequency=3.0)), energy=True, duration=0.2,
        electrical=ElectricalDamping(b=2.0, cutoff=5.0) if electrical else None,
        link=parse_link("delay(0.01) | uniform(0.01) ; delay(0.02)")) for k, a in (
            (10.0, 0.02), (300.0, 0.05), (1e3, 0.01), (1e4, 0.02), (1e9, 1e6))]


def carried(environment: Any) -> Moving:
    """What moves by itself, with this on it."""
    return Moving(environment=environment, path=Sine(amplitude=0.004, frequency=4.0))


def ball(k: float) -> HuntCrossley:
    """A soft ball before the slave."""
    return HuntCrossley(k=50.0 * k, n=1.5, lam=0.2, at=0.003)


def solid(k: float) -> StandardLinearSolid:
    """Tissue that relaxes."""
    return StandardLinearSolid(k=0.1 * k, k1=0.2 * k, tau=0.06)


def windows() -> list[Scene]:
    """Estimators that look back over windows of readings, one at each end."""
    return [replace(load_scene("canonical", law="pp", delay=0.005, duration=0.3), device_m=Device(
        encoder=Encoder(step=1e-5), velocity=EndFit(noise=noise)), device_s=Device(
        encoder=Encoder(step=1e-5), velocity=BestFit(noise=noise, most=7))) for noise in (1e-6, 1e-5, 1e-4)]


def read_by(velocity: Callable[[float], Any], **knobs: Any) -> list[Scene]:
    """A rendered wall that is read by an estimator."""
    return [load_scene("virtual_wall", velocity=velocity(noise), step=1e-5, to=0.02, duration=0.5, **knobs)
            for noise in (1e-6, 1e-5, 1e-4)]


def servos() -> list[Scene]:
    """Position servos at both ends, of both drives, at a wall, a tissue and a soft ball."""
    made = []
    for n, (drive_m, drive_s) in enumerate((("offset", "offset"), ("mass", "offset"), ("offset", "mass"))):
        numbers = {"K": 15.0 + 5.0 * n, "damping": 0.6, "friction": 0.1 * n, "stall": 2.0, "backlash": 0.01 * n,
                   "counts": 1000 * n, "bus": (0.003, 0.004), "every": 10, "D": 0.5, "dead": 0.05 * n}
        ends = {end: tuple([Servo(drive=drive, inertia=0.02 + 0.01 * i, **numbers) for i in range(3)])
                for end, drive in (("master", drive_m), ("slave", drive_s))}
        made.append(Scene(
            axes=3, units=("rad",) * 3, **ends, law=PositionPosition(K=8.0, B=0.4), link=parse_link("delay(0.02)"),
            hand=Grip(mass=0.02, k=15.0, d=0.5, reference=Sine(amplitude=(0.4, 0.3, -0.5), frequency=1.0)),
            environment=(Wall(k=500.0, d=2.0, at=0.05), Tissue(k=10.0, d=0.1), ball(2.0)), duration=0.4, energy=True))
    return made


def framed(scene: str, **knobs: Any) -> list[Scene]:
    """Bases turned by angles of their own, of another size, before walls and with scales of the axes."""
    base = load_scene(scene, duration=0.3, **knobs)
    scaling = tuple([Scaling(scale_x=1.0 + 0.5 * (i % 3 == 0), scale_f=2.0) for i in range(base.axes)])
    scaling = scaling if not base.rotations else Scaling(scale_x=0.5)
    return [replace(base, scaling=scaling, frame=Frame(rotation=(0.4 * n, -0.3, 1.0), scale=0.5 + 0.25 * n))
            for n in range(3)]


def many_axes() -> list[Scene]:
    """Eleven axes, of which two begin with the same digit, each from a place of its own and without a hand."""
    base = replace(load_scene("canonical"), hand=None, environment=None, duration=0.1, link=parse_link(ROUGH))
    places = tuple([0.01 * (i + 1) for i in range(11)])
    return [replace(base, law=PFRA(K=300.0 + 100.0 * n), axes=11, start_m=places) for n in range(3)]


def coupled() -> list[Scene]:
    """Sums over three axes with unlike environments, of scenes whose masters differ."""
    base = load_scene("canonical", law=PFRA(alpha=0.3), link=None)
    return [replace(base, axes=3, environment=(HARD, None, Tissue(k=200.0, d=1.0)), duration=0.3, energy=True,
                    hand=SWING, master=replace(base.master, mass=0.05 + 0.02 * n)) for n in range(MANY)]


CASES: dict[str, Callable[[], list[Scene]]] = {
    "waves by their integral": waves,
    "waves of three axes": partial(waves, "recorded_reach"),
    **{f"waves, {name}": partial(waves, scene, playouts, left_out=left_out) for name, scene, playouts, left_out in (
        ("ticks left out", "canonical", QUEUES, 0.2), ("energy", "canonical", (Energy(),), 0.0),
        ("energy, ticks left out", "recorded_reach", (Energy(),), 0.2), ("fixed", "canonical", FIXED, 0.0),
        ("fixed, ticks left out", "recorded_reach", FIXED, 0.2),
        ("scaled, ticks left out", "canonical", (Scaled(0.1), Scaled(0.0)), 0.2))},
    "forces that diverge": diverging,
    "forces that diverge, constant delays": partial(diverging, None),
    "limits, devices and a watchdog": limited,
    "ticks left out": skipping,
    "a one-port": one_port,
    "a user's law, a clutch and gaps": metered,
    "a user's law in two axes": partial(metered, 2),
    "a policy": handed_over,
    "a policy in three axes, a clutch, skips": partial(
        handed_over, axes=3, left_out_m=LeftOut(0.2), operator=Operator(clutch=((0.2, 0.25),), ramp=0.02)),
    "a policy without actions": partial(handed_over, policy=False),
    "a clutch of parts, scale and alignment": indexed,
    "a policy, no motor at the leader": partial(handed_over, motor=False, axes=3, operator=Operator(
        clutch=((0.2, 0.25),), ramp=0.02)),
    "no actions and no motor": partial(handed_over, policy=False, motor=False),
    "a clutch and a small slew limit": slow_slew,
    "a deadband": partial(knobs, "free_motion", "deadband", (0.05, 0.2, 0.5), law="wave", delay=0.02),
    "stages around a law": partial(knobs, "free_motion", "law.deadband_k", [0.05 * n for n in range(MANY)],
                                   law="guard | deadband(0.3) | direct"),
    "a coupling with branches": partial(knobs, "virtual_coupling", "law.K", [200.0 + 30.0 * n for n in range(MANY)]),
    "axes of their own": lambda: [unlike(LAWS["pp"], start_m=(0.01 * n, 0.02, 0.0), duration=0.3) for n in range(3)],
    "a turned base": partial(framed, "recorded_reach", energy=True),
    "a turned base of a pose": partial(framed, "pose"),
    "eleven axes": many_axes,
    "coupled axes without a link": coupled,
    "rotations": lambda: [tumbling(law=WavePosition(b=0.02, K=1.0 + n, B=0.02, K_p=0.2, B_p=0.005), duration=0.3,
                                   observer=None) for n in range(3)],
    "six axes": partial(knobs, "pose", "delay", (0.0, 0.01, 0.02), duration=0.2),
    "position servos": servos,
    "friction": partial(bodies, lambda k: (Wall(k=k, d=2.0, at=0.004), carried(Tissue(k=0.1 * k, d=2.0)), ball(k)),
                        friction=0.3),
    "soft and relaxing bodies that move": partial(
        bodies, lambda k: (ball(k), carried(replace(ball(k), side=-1.0)), carried(solid(k))), electrical=True),
    "relaxing, moved and none": partial(
        bodies, lambda k: (solid(k), carried(Wall(k=k, d=2.0, at=0.004)), None), electrical=True),
    "windows of readings": windows,
    "end fit, friction": partial(read_by, lambda noise: EndFit(noise=noise), friction=0.3),
    "best fit, electrical damping": partial(read_by, lambda noise: BestFit(noise=noise, most=40), b_e=2.0),
    "end fit of one reading": partial(read_by, lambda noise: EndFit(noise=noise, most=1)),
    "levant": partial(read_by, lambda noise: Levant(L=noise * 1e6)),
    **{name: partial(knobs, name, "duration", (0.4,)) for name in built_in_scenes() if name != "lte"},
}
