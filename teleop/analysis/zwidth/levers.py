"""What widens a device's Z-width, one thing at a time from the scene as it is."""

from __future__ import annotations

from dataclasses import replace
from math import pi
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.analysis.zwidth.passive import passive_region
from teleop.errors import Refused
from teleop.law import find_law
from teleop.law.analysis_offers import coupling_of
from teleop.stages.device import Device
from teleop.stages.encoder import Encoder

if TYPE_CHECKING:
    from collections.abc import Iterator

    from teleop.scene.scene import Scene

STEP = 2.0 * pi * 0.010 / 1024.0  # m: of an encoder of 1024 lines on a drum of 10 mm
CUTOFF = 30.0  # Hz, of the velocity filter
SHUNT = 10.0  # Hz, below which the shunt of the motor damps less


class Lever(NamedTuple):
    """One change to the scene."""

    name: str
    what: str  # in words
    scene: Scene | None  # None: it does not apply, and `what` says why


def levers(scene: Scene) -> Iterator[Lever]:
    """The scene as it is, and then each change alone."""
    yield Lever("as it is", "the scene's own values", scene)
    b = scene.master.damping
    if b > 0.0:
        yield Lever("damping x2", f"device damping {b:g} to {2.0 * b:g} N s/m",
                    replace(scene, master=replace(scene.master, damping=2.0 * b)))
    else:
        yield Lever("damping x2", "left out: the device has no damping to double", None)
    yield from _resolution(scene)
    yield _rate(scene)
    yield _filter(scene)
    yield _coupling(scene)
    yield _controller(scene)
    yield _electrical(scene)


def _rate(scene: Scene) -> Lever:
    try:
        faster = replace(scene, dt=0.5 * scene.dt)
    except Refused as refused:  # a scene's tick is bounded below
        return Lever("rate x2", f"left out: {refused}", None)
    return Lever("rate x2", f"{1e-3 / scene.dt:g} to {2e-3 / scene.dt:g} kHz; delay and renewal stay the same count of "
                 "ticks", faster)


def _resolution(scene: Scene) -> Iterator[Lever]:
    device = scene.device_m or Device()
    encoder = device.encoder
    if encoder is None:
        yield Lever("encoder", f"an encoder of {STEP * 1e6:.3g} um; none before",
                    replace(scene, device_m=replace(device, encoder=Encoder(step=STEP))))
        return
    for word, factor in (("resolution x4", 0.25), ("resolution /4", 4.0)):
        step = factor * encoder.step
        yield Lever(word, f"encoder step {encoder.step * 1e6:.3g} to {step * 1e6:.3g} um",
                    replace(scene, device_m=replace(device, encoder=replace(encoder, step=step))))
    yield Lever("no encoder", "positions as they are", replace(scene, device_m=replace(device, encoder=None)))


def _filter(scene: Scene) -> Lever:
    from teleop.stages.velocity.backward_difference import BackwardDifference
    from teleop.stages.velocity.low_pass import LowPass

    device = scene.device_m or Device()
    if isinstance(device.velocity, BackwardDifference):
        return Lever("velocity filter", f"backward difference through a low-pass of {CUTOFF:g} Hz",
                     replace(scene, device_m=replace(device, velocity=LowPass(cutoff=CUTOFF))))
    return Lever("no velocity filter", "plain backward difference", replace(
        scene, device_m=replace(device, velocity=BackwardDifference())))


def _coupling(scene: Scene) -> Lever:
    law: Any = scene.law
    own = {"K": law.K, "B": law.B, "at": float(getattr(law, "at", 0.0))}
    if coupling_of(law, scene.dt_ns / 1e9) is not None:
        return Lever("no coupling", "the wall felt directly", replace(scene, law=find_law("virtual_wall")(**own)))
    coupled: Any = replace(scene, law=find_law("virtual_coupling")(**own))
    corners = passive_region(coupled).corners
    K, B = max(corners) if corners else (law.K, law.B)
    tool = f"to a tool of {coupled.law.mass * 1e3:g} g"
    words = f"the stiffest passive coupling, {K:.4g} N/m and {B:.3g} N s/m, {tool}: any passive environment behind it"
    return Lever("virtual coupling", words if corners else f"a coupling of the same K and B {tool}",
                 replace(scene, law=replace(coupled.law, K=K, B=B)))


def _controller(scene: Scene) -> Lever:
    if scene.passivity is not None:
        return Lever("no controller", "without the passivity controller", replace(scene, passivity=None))
    from teleop.stages.passivity_controller import PassivityController

    cap = scene.master.damping or 0.02 * scene.master.mass / scene.dt
    return Lever("passivity controller", f"adds at most {cap:.3g} N s/m of damping while the port has made energy",
                 replace(scene, passivity=PassivityController(cap=cap)))


def _electrical(scene: Scene) -> Lever:
    from teleop.physics.relaxing import ElectricalDamping

    name = "electrical damping"
    if scene.electrical is not None:
        return Lever("no shunt", "without electrical damping", replace(scene, electrical=None))
    if scene.master.friction > 0.0:
        return Lever(name, "left out: it does not go together with friction yet", None)
    b = scene.master.damping
    if b == 0.0:
        return Lever(name, "left out: the device has no damping to match", None)
    return Lever(name, f"a shunt of the motor adds {b:g} N s/m above {SHUNT:g} Hz",
                 replace(scene, electrical=ElectricalDamping(b=b, cutoff=SHUNT)))
