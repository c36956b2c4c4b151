"""A wall, a finger, an encoder and a passivity controller: five runs that a study wiki prints digit by digit."""

from __future__ import annotations

import numpy as np

from teleop.scene.loading import load_scene
from teleop.simulation.virtual import run
from teleop.studies.reproduce.publication import NumberSource, Publication, Replication

# knobs of the scene; peak and peak-to-peak in the last 0.5 s (mm), observed energy (mJ), as printed
RUNS = {
    "A": ({"K": 400.0}, ("33.53", "0.001", "-0.32")),
    "B": ({"K": 2500.0}, ("31.79", "1.658", "-17.6")),
    "C": ({"K": 2500.0, "cap": 0.8}, ("31.79", "0.080", "-1.81")),
    "D": ({"K": 400.0, "every": 5}, ("34.07", "5.277", "-69.7")),
    "E": ({"K": 400.0, "every": 5, "cap": 0.8}, ("33.90", "0.001", "-1.44")),
}
WHAT = (("peak", "mm"), ("peak-to-peak in the last 0.5 s", "mm"), ("observed energy", "mJ"))


def rerun() -> list[Replication]:
    """The five runs with the integrator of the source: 40 sub-steps of semi-implicit Euler a tick."""
    numbers = []
    for name, (knobs, printed) in RUNS.items():
        scene = load_scene("encoder_wall", **knobs)
        trace = run(scene, bodies="semi_implicit_euler:40").trace
        x, observed = trace["x_m"], float((trace["f_m"][:-1] * np.diff(trace["q_m"])).sum())
        values = (1e3 * float(x.max()), 1e3 * float(np.ptp(x[1000:])), 1e3 * observed)
        setting = ", ".join(f"{key} {value:g}" for key, value in knobs.items())
        numbers += [Replication(f"run {name} ({setting}): {what}", text, value, unit)
                    for (what, unit), text, value in zip(WHAT, printed, values, strict=True)]
    return numbers


PUBLICATION = Publication(
    name="encoder_wall",
    kind=NumberSource.TEXTBOOK,
    source="laboratory of a study wiki on haptic interfaces, after B. Hannaford and J.-H. Ryu, Time-domain passivity "
           "control of haptic interfaces, IEEE Trans. Robotics and Automation 18(1), 2002",
    about="limit cycles of a wall behind an encoder and a slow force, and the passivity controller that ends them",
    setting="scene encoder_wall with the integrator of the source, semi_implicit_euler:40; exact bodies change the "
            "limit cycle of run B by 5 %",
    rerun=rerun,
)
