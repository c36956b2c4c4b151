"""Virtual coupling: a finger pushes a simulated tool, by spring and damper, into a wall too stiff for the handle."""

from __future__ import annotations

from typing import Annotated

from master import Grip, Reach
from teleop import (
    BackwardDifference,
    Device,
    Encoder,
    Knob,
    MassDamper,
    OnePortLaw,
    Scene,
    VelocityEstimator,
    VirtualCoupling,
    knob,
)


def scene(
    *,
    law: OnePortLaw = VirtualCoupling(k_e=1e5, at=0.03),
    m: Annotated[float, Knob("kg", "mass of the handle", above=0.0)] = 0.04,
    b: Annotated[float, Knob("N s/m", "damping of the handle; passive with at least K dt/2 + B", low=0.0)] = 0.8,
    friction: Annotated[float, Knob("N", "Coulomb friction of the handle", low=0.0)] = 0.0,
    k: Annotated[float, Knob("N/m", "stiffness of the finger", low=0.0)] = 400.0,
    d: Annotated[float, Knob("N s/m", "damping of the finger", low=0.0)] = 1.0,
    to: Annotated[float, Knob("m", "position that the finger reaches for")] = 0.04,
    step: knob.EncoderStep = None,
    velocity: VelocityEstimator = BackwardDifference(),
    every: Annotated[int, Knob("ticks", "time after which the force is renewed", low=1)] = 1,
    delay: Annotated[int, Knob("ticks", "delay from reading to force", low=0)] = 0,
    cap: knob.ControllerDamping = None,
    v_min: knob.ControllerRest = 0.0,
    f_max: Annotated[float | None, Knob("N", "most force of the actuator; none: no saturation", low=0.0)] = None,
    b_e: knob.MotorDamping = None,
    cutoff: knob.MotorCutoff = 10.0,
    observer: knob.ObserverBandwidth = 200.0,
    energy: knob.EnergyLedgers = True,
    dt: knob.Tick = 1e-3,
    duration: knob.Duration = 2.0,
) -> Scene:
    """A minimum-jerk reach takes a tool on a virtual coupling into a stiff virtual wall."""
    passivity, saturation, electrical = None, None, None
    if cap is not None:
        from teleop import PassivityController

        passivity = PassivityController(cap=cap, v_min=v_min)
    if f_max is not None:
        from teleop import Cap

        saturation = Cap(f_max=f_max)
    if b_e is not None:
        from teleop import ElectricalDamping

        electrical = ElectricalDamping(b=b_e, cutoff=cutoff)
    return Scene(
        law=law,
        master=MassDamper(mass=m, damping=b, friction=friction),
        hand=Grip(mass=0.0, k=k, d=d, reference=Reach(to=to, start=0.1, duration=0.6)),
        device_m=Device(
            encoder=None if step is None else Encoder(step=step), velocity=velocity,
            every=every, delay=delay,
        ),
        passivity=passivity,
        cap=saturation,
        electrical=electrical,
        observer=observer,
        energy=energy,
        dt=dt,
        duration=duration,
    )
