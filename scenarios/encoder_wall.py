"""Virtual wall behind a coarse encoder: limit cycles, and the passivity controller that ends them."""

from __future__ import annotations

from math import pi
from typing import Annotated

from master import Grip, Rest
from teleop import BackwardDifference, Cap, Device, Encoder, Knob, MassDamper, Scene, VirtualWall, knob


def scene(
    *,
    K: Annotated[float, Knob("N/m", "stiffness of the wall; 2500 oscillates at 34 Hz", low=0.0)] = 400.0,
    every: Annotated[int, Knob(
        "ticks", "time after which the wall's force is renewed; 5 oscillates at 21 Hz", low=1)] = 1,
    cap: knob.ControllerDamping = None,
    v_min: knob.ControllerRest = 0.0,
    step: Annotated[float | None, Knob(
        "m", "encoder step: 1024 lines on a 10 mm drum; none: no encoder", above=0.0)] = 2.0 * pi * 0.010 / 1024.0,
    f_max: Annotated[float | None, Knob(
        "N", "most force of wall and controller together; none: any", low=0.0)] = 2.0,
    dt: knob.Tick = 1e-3,
    duration: knob.Duration = 1.5,
) -> Scene:
    """A finger pulls a handle from rest at 29 mm towards 33 mm; the virtual wall begins at 30 mm."""
    if cap is None:
        passivity = None
    else:
        from teleop import PassivityController

        passivity = PassivityController(cap=cap, v_min=v_min)
    return Scene(
        law=VirtualWall(K=K, at=0.030),
        master=MassDamper(mass=0.04, damping=0.8),
        hand=Grip(mass=0.0, k=400.0, d=0.0, reference=Rest(at=0.033)),
        device_m=Device(
            encoder=None if step is None else Encoder(step=step), velocity=BackwardDifference(), every=every,
        ),
        passivity=passivity,
        cap=Cap.of(f_max=f_max),
        start_m=0.029,
        energy=True,
        dt=dt,
        duration=duration,
    )
