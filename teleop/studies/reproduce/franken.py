"""Franken et al. 2011: the two-layer law over a second of delay, on a stiff wall."""

from __future__ import annotations

import numpy as np

from teleop.scene.loading import load_scene
from teleop.simulation.notes import fitted
from teleop.simulation.virtual import run
from teleop.studies.reproduce.publication import NumberSource, Publication, Replication

STIFFNESS, DELAY = 1500.0, 1.0  # N/m, s each way
AT_REST = 1e-4  # m, peak-to-peak in the last five seconds


def press(law: str) -> tuple[float, float]:
    """Swing of the master (m, peak-to-peak) in the last 5 s of 40 s after a reach into the wall; the force there."""
    scene = load_scene("hard_wall", law=law, k_e=STIFFNESS, link=f"delay({DELAY})", duration=40.0, f_max="none",
                       slew="none")
    trace = run(fitted(scene)).trace
    return float(np.ptp(trace["x_m"][-5000:])), float(trace["f_env"][-1])


def rerun() -> list[Replication]:
    """The two-layer law, and beside it the same coupling without a layer that has to pay for it."""
    swing, force = press("two_layer")
    bare, _ = press("direct")
    return [Replication("two-layer law", "stable", "stable" if swing < AT_REST else "not at rest",
                        tolerance=f"swing below {1e3 * AT_REST:g} mm",
                        remark=f"at rest to {swing:.1g} m with {force:.2f} N on the wall, beta fitted to the delay; "
                        f"position-force reflection alone, law direct, swings by {bare:.2g} m there")]


PUBLICATION = Publication(
    name="franken",
    kind=NumberSource.PRINTED,
    source="M. Franken, S. Stramigioli, S. Misra, C. Secchi and A. Macchelli, Bilateral telemanipulation with time "
           "delays: a two-layer approach combining passivity and transparency, IEEE Trans. Robotics 27(4), 2011",
    about="a position-force law with an energy tank below it is stable over 1 s of delay",
    setting="scene hard_wall without its force cap, 1500 N/m as printed, 1 s each way (whether 1 s is one way or the "
            "round trip is not in what was read; one way is the harder case); devices, hand and gains are the "
            "scene's and the law's own",
    rerun=rerun,
)
