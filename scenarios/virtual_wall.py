"""A finger on a handle reaches into a wall that the controller renders: no robot, no link."""

from __future__ import annotations

from master import Grip, Reach
from teleop import BackwardDifference, Device, Encoder, MassDamper, OnePortLaw, Scene, VelocityEstimator, VirtualWall


def scene(
    *,
    law: OnePortLaw = VirtualWall(K=800.0, at=0.03),  # what is rendered: virtual_wall, virtual_coupling, of a plug-in
    m: float = 0.04,  # kg, mass of the handle
    b: float = 0.8,  # N s/m, damping of the handle; the wall is passive with at least K dt/2 + B
    friction: float = 0.0,  # N, Coulomb friction of the handle
    k: float = 400.0,  # N/m, stiffness of the finger
    d: float = 1.0,  # N s/m, damping of the finger
    to: float = 0.04,  # m, where the finger reaches
    step: float | None = None,  # m, step of an encoder that rounds down; none: the position as it is
    velocity: VelocityEstimator = BackwardDifference(),  # low_pass(cutoff=30), end_fit(noise=6e-5), levant(L=1), ...
    every: int = 1,  # ticks after which the force is renewed
    delay: int = 0,  # ticks from reading to force
    cap: float | None = None,  # N s/m, most damping of the passivity controller; none: no controller
    v_min: float = 0.0,  # m/s, velocity that the passivity controller leaves alone
    f_max: float | None = None,  # N, most force of the actuator; none: no saturation
    b_e: float | None = None,  # N s/m, electrical damping of the motor, well above its cutoff; none: none
    cutoff: float = 10.0,  # Hz, below which the electrical damping fades
    observer: float | None = 200.0,  # 1/s, bandwidth of the observer of the hand's force; none: a force sensor
    energy: bool = True,  # record the energy ledger
    dt: float = 1e-3,  # s, the tick
    duration: float = 2.0,  # s
) -> Scene:
    """A reach of least jerk takes a finger into a virtual wall, which it then presses."""
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
