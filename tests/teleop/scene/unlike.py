"""A scene of three axes that have nothing in common: a joint, a joint that nobody holds, a carriage before a wall."""

from __future__ import annotations

from typing import Any

from channel import Bernoulli, Delay, UniformJitter
from master import Grip, Sine
from slave import Tissue, Wall
from teleop import (
    TDPA,
    Cap,
    Device,
    Encoder,
    FourChannel,
    LowPass,
    MassDamper,
    PositionPosition,
    Scene,
    Watchdog,
    Wave,
    each_axis,
)

MASSES, GAINS = (0.3, 0.2, 0.1), (300.0, 200.0, 100.0)
LAWS = {
    "pp": tuple([PositionPosition(K=K, B=5.0) for K in GAINS]),
    "wave": tuple([Wave(b=b, K=400.0, B=10.0) for b in (3.0, 2.0, 1.0)]),
    "four_channel": tuple([FourChannel(K=K, B=5.0) for K in GAINS]),
    "tdpa": tuple([TDPA(K=K, B=5.0) for K in GAINS]),
}


def unlike(law: Any = LAWS["pp"], **parts: Any) -> Scene:
    """Three axes that have nothing in common: a joint, a joint that nobody holds, and a carriage before a wall."""
    given: dict[str, Any] = {
        "law": law, "axes": 3, "names": ("shoulder", "elbow", "rail"), "units": ("rad", "rad", "m"),
        "master": each_axis(MassDamper, 3, mass=MASSES, damping=(0.5, 0.4, 0.3)),
        "slave": each_axis(MassDamper, 3, mass=(0.5, 0.4, 0.3), damping=1.0),
        "hand": (Grip(mass=0.4, k=200.0, d=5.0, reference=Sine(amplitude=0.05, frequency=1.0)), None,
                 Grip(mass=0.2, k=100.0, d=3.0, reference=Sine(amplitude=0.02, frequency=2.0))),
        "environment": (Tissue(k=100.0, d=1.0), None, Wall(k=1e3, d=5.0, at=0.01)),
        "cap": (Cap(f_max=5.0, slew=500.0), None, Cap(f_max=10.0, v_max=0.5)),
        "device_m": each_axis(
            lambda step, cutoff: Device(encoder=Encoder(step=step), velocity=LowPass(cutoff=cutoff)), 3,
            step=(1e-5, 2e-5, 4e-5), cutoff=(30.0, 60.0, 90.0)),
        "link": Delay(0.02) | UniformJitter(0.01) | Bernoulli(0.1), "watchdog": Watchdog(timeout=0.2), "energy": True,
        "start_m": (0.01, 0.02, 0.0), "start_s": (0.01, 0.02, 0.0), "duration": 0.6,
    }
    return Scene(**{**given, **parts})
