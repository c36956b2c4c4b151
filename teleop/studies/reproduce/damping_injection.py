"""P+d: the damping that a delayed spring asks for, and a weaker form of its condition that is in circulation."""

from __future__ import annotations

from dataclasses import replace

from teleop.analysis.stability.assess import critical, stability
from teleop.law import find_law
from teleop.physics.plant import MassDamper
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene
from teleop.studies.reproduce.publication import NumberSource, Publication, Replication

K, DELAY, MASS = 400.0, 0.05, 5.0  # N/m, s each way, kg


def free_masses(B: float) -> Scene:
    """Two free masses that the law p_d joins."""
    body = MassDamper(mass=MASS)
    scene = load_scene("free_motion", law=find_law("p_d")(K=K, B=B), link=f"delay({DELAY})")
    return replace(scene, master=body, slave=body, hand=None)


def rerun() -> list[Replication]:
    """The verdict at both conditions, and where the scene really loses its stability."""
    edge = critical(free_masses, "B", low=14.0, high=22.0, places=5)
    weak = stability(free_masses(15.0)).verdict
    return [
        Replication("4 B_m B_s >= K^2 (T1 + T2)^2: B = 20 N s/m", "stable", stability(free_masses(20.0)).verdict),
        Replication("4 B_m B_s >= K^2 (T1^2 + T2^2): B = 15 N s/m", "stable", weak,
                    remark="the condition on the sum of squares is too weak by sqrt(2): the two masses swing up; the "
                    f"least damping of these two is {edge.value:.2f} N s/m at 1 kHz"),
    ]


PUBLICATION = Publication(
    name="damping_injection",
    kind=NumberSource.FORMULA,
    source="E. Nuno, R. Ortega, N. Barabanov and L. Basanez, A globally stable PD controller for bilateral "
           "teleoperators, IEEE Trans. Robotics 24(3), 2008, and the form with a sum of squares in circulation since",
    about="two ends drawn to where the other was stay bounded if they are damped by B >= K T",
    setting="law p_d between two free masses of 5 kg, 400 N/m, 50 ms each way; roots of the sampled loop at 1 kHz",
    rerun=rerun,
)
