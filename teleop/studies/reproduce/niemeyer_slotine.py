"""Niemeyer and Slotine 1991: what a wave channel feels like from one end."""

from __future__ import annotations

from dataclasses import replace
from math import pi
from typing import Any

import numpy as np

from teleop.analysis.passivity.two_port import continuous_two_port
from teleop.law import At, find_law
from teleop.physics.plant import MassDamper
from teleop.scene.loading import load_scene
from teleop.studies.reproduce.publication import NumberSource, Publication, Replication

b, T = 0.8, 0.05  # N s/m, s each way
HANDLE = MassDamper(mass=0.04, damping=0.8)
STIFF, LIGHT = 1e4, 1e-9  # N/m, kg: the slave's coupling and mass, next to a rigid one and to none
SLOW = 0.05  # Hz, far below the resonance


def reflected_impedance(frequency: list[float], touched: float) -> Any:
    """Impedance (N s/m) at the master of a slave that touches this one (N s/m), without the master itself."""
    scene = load_scene("free_motion", law=find_law("wave")(b=b, K=STIFF, B=0.0), link=f"delay({T})", observer=None)
    scene = replace(scene, master=HANDLE, slave=MassDamper(mass=LIGHT), hand=None)
    s = 2j * pi * np.array(frequency)
    master = HANDLE.mass * s + HANDLE.damping
    port = continuous_two_port(scene, s.imag / (2.0 * pi))
    return port.perceived_impedance(np.full(len(s), touched, dtype=complex)) - master


def rerun() -> list[Replication]:
    """A free and a clamped end at low frequency, the resonance, and one pair of waves."""
    w = 2.0 * pi * SLOW
    slow, one, four = reflected_impedance([SLOW, 1.0, 4.0], 0.0)
    clamped = reflected_impedance([SLOW], 1e15)[0]
    places = np.linspace(4.0, 6.0, 401)
    resonance = float(places[np.abs(reflected_impedance(places.tolist(), 0.0)).argmax()])
    law: Any = find_law("wave")(b=b)
    u = 0.8222
    at = At(0.0, 0.05, 0.0, 0.0, 0.0, True, T, 1e-3, 1e-3)
    f_m, sent, _ = law.master((), at, type(law.master_start(at)[1])(-0.7589))
    power = 0.5 * (sent.u**2 - 0.7589**2)
    return [
        Replication("a free end at low frequency: a mass b T", "0.04", float(slow.imag) / w, "kg", 1e-4),
        Replication("a clamped end at low frequency: a spring b/T", "16", -float(clamped.imag) * w, "N/m", 0.05,
                    "the slave's coupling of 10 kN/m lies in series"),
        Replication("resonance of a free end, 1/(4 T)", "5", resonance, "Hz", 0.005),
        Replication("impedance of a free end at 1 Hz", "0.25994", abs(one), "N s/m"),
        Replication("impedance of a free end at 4 Hz", "2.46215", abs(four), "N s/m"),
        Replication("wave sent at 0.05 m/s with w = -0.7589", f"{u}", float(sent.u), "sqrt(W)", 1e-4),
        Replication("force there", "1", float(f_m), "N", 2e-4),
        Replication("power there", "0.0500", float(power), "W"),
    ]


PUBLICATION = Publication(
    name="niemeyer_slotine",
    kind=NumberSource.FORMULA,
    source="G. Niemeyer and J.-J. E. Slotine, Stable adaptive teleoperation, IEEE J. Oceanic Engineering 16(1), 1991",
    about="a delayed wave channel is a mass where its far end is free, a spring where it is clamped, and in between a "
          "transmission line, Z = b (1 - G e^-2sT)/(1 + G e^-2sT)",
    setting="law wave with b = 0.8 N s/m over 50 ms each way; the impedance is that of teleop passivity in continuous "
            "time, less the master's. The numbers follow from the printed formula",
    rerun=rerun,
)
