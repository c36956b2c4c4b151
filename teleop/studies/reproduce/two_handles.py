"""Two handles coupled position-position and position-force, with and without delay: a study wiki's numbers."""

from __future__ import annotations

from dataclasses import replace

from teleop.analysis.passivity.judge import Judged, two_ports
from teleop.law import find_law
from teleop.physics.plant import MassDamper
from teleop.scene.loading import load_scene
from teleop.studies.reproduce.publication import NumberSource, Publication, Replication

HANDLE = MassDamper(mass=0.04, damping=0.8)


def two_port_of(law: str, delay: str) -> Judged:
    """The two-port of two handles, 400 N/m and 4 N s/m between them, on a wall of 400 N/m, without a clock."""
    scene = load_scene("soft_tissue", law=find_law(law)(K=400.0, B=4.0), k_e=400.0, d_e=0.0, link=delay)
    continuous = two_ports(replace(scene, master=HANDLE, slave=HANDLE)).continuous
    assert continuous is not None
    return continuous


def rerun() -> list[Replication]:
    """Stiffness of the wall, impedance in free motion, and Llewellyn's parameter, as the hand perceives them."""
    prompt, late = two_port_of("pp", "none"), two_port_of("pp", "delay(0.05)")
    force = [two_port_of("direct", link) for link in ("none", "delay(0.05)")]
    return [
        Replication("position-position: felt stiffness at 0.01 Hz", "200", prompt.felt, "N/m"),
        Replication("position-position: free impedance at 1 Hz", "1.680", prompt.free, "N s/m"),
        Replication("position-position: Llewellyn's criterion", "holds",
                    "holds" if prompt.absolutely_stable else "fails"),
        Replication("50 ms each way: felt stiffness at 0.01 Hz", "200", late.felt, "N/m"),
        Replication("50 ms each way: free impedance at 1 Hz", "40.975", late.free, "N s/m"),
        Replication("50 ms each way: Llewellyn's parameter fails from", "0.1", late.bands[0].low, "Hz"),
        Replication("50 ms each way: and fails last at", "19.0", late.bands[-1].high, "Hz",
                    remark="19.058 Hz where it is followed to the edge; on which frequencies the wiki looked is not "
                    "printed. In between, from 9.6 to 15.7 Hz, the criterion holds"),
        Replication("50 ms each way: its least value", "-0.643", late.least, ""),
        Replication("50 ms each way: there", "5.8", late.at, "Hz"),
        *[Replication(f"position-force, {delay}: free impedance at 1 Hz", "0.839", each.free, "N s/m")
          for delay, each in zip(("no delay", "50 ms each way"), force, strict=True)],
    ]


PUBLICATION = Publication(
    name="two_handles",
    kind=NumberSource.TEXTBOOK,
    source="laboratory of a study wiki on teleoperation, with the criterion of F. B. Llewellyn, Some fundamental "
           "properties of transmission systems, Proc. IRE 40(3), 1952",
    about="what delay does to two coupled handles: what is felt of a wall stays, free motion gets heavy, and the "
          "two-port is no longer absolutely stable",
    setting="scene soft_tissue with two handles of 0.04 kg and 0.8 N s/m, laws pp and direct with 400 N/m and 4 N s/m, "
            "wall 400 N/m; teleop passivity in continuous time",
    rerun=rerun,
)
