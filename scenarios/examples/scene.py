"""A scene of your own: a hand draws a slave over tissue that lies behind a lossy link.

    teleop run scenarios/examples/scene.py --set k_e=2e3 --set loss=0.1
    teleop sweep scenarios/examples/scene.py --grid k_e=100:1e4:5:log loss=0:0.2:3
"""

from __future__ import annotations

from typing import Annotated

from channel import Bernoulli, Delay
from master import Grip, Sine
from slave import Tissue
from teleop import Cap, Knob, Law, MassDamper, Scene, Watchdog, Wave, knob, load_scene, run


def scene(
    *,
    law: Law = Wave(),
    delay: knob.LinkDelay = 0.05,  # unit, meaning and bounds as in other scenes
    loss: Annotated[float, Knob("1", "share of the packets that are lost", low=0.0, high=1.0, link=True)] = 0.02,
    k_e: Annotated[float, Knob("N/m", "stiffness of the tissue", low=0.0)] = 500.0,
    f_max: knob.MostForce = 15.0,
    duration: knob.Duration = 4.0,
) -> Scene:
    """A slow swing of the hand, tissue that holds on to the slave, and a link that loses packets."""
    return Scene(
        law=law,
        hand=Grip(mass=0.4, k=200.0, d=5.0, reference=Sine(amplitude=0.02, frequency=0.5)),
        master=MassDamper(mass=0.1, damping=0.5),
        link=Delay(delay) | Bernoulli(loss),
        slave=MassDamper(mass=0.5, damping=1.0),
        environment=Tissue(k=k_e, d=5.0),
        watchdog=Watchdog(timeout=0.2),
        cap=Cap(f_max=f_max, slew=2000.0),
        observer=200.0,  # 1/s, bandwidth of the observer of the hand's force, for laws that read it
        energy=True,  # record the ledgers
        duration=duration,
    )


if __name__ == "__main__":
    for loss in (0.0, 0.1, 0.3):
        result = run(load_scene(__file__, loss=loss), seed=1)
        error, least = result.metrics["x_err_rms"], result.metrics["E_link_min"]
        print(f"{100 * loss:2.0f} % lost: {result.status}, {1e3 * error:.1f} mm rms, least E_link {least:.3f} J")
