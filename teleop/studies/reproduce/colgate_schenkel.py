"""Colgate and Schenkel 1997: the damping that a sampled virtual wall needs of its device."""

from __future__ import annotations

from teleop.analysis.passivity.one_port import one_port
from teleop.studies.reproduce.publication import NumberSource, Publication, Replication, wall

WALLS = ((1600.0, 0.0), (800.0, 0.4), (1000.0, 0.25))  # N/m, N s/m
NEAR = 1e-3  # of the damping, on either side of the bound


def rerun() -> list[Replication]:
    """The least damping of the device for three walls, and the verdict just above and just below it."""
    numbers = []
    for K, B in WALLS:
        least = 0.5 * K * 1e-3 + abs(B)
        scene = wall(K, B, b=least)
        numbers.append(Replication(f"least device damping for K = {K:g} N/m, B = {B:g} N s/m", f"{least:g}",
                                   one_port(scene).needed.damping, "N s/m", 1e-6, "K T/2 + |B| with T = 1 ms"))
    K, B = WALLS[0]
    for factor, expected in ((1.0 + NEAR, "passive"), (1.0 - NEAR, "not passive")):
        verdict = one_port(wall(K, B, b=0.8 * factor)).passive
        numbers.append(Replication(
            f"that wall with {0.8 * factor:.4g} N s/m", expected,
            {True: "passive", False: "not passive", None: "not known"}[verdict], "", f"{NEAR:.1%} from the bound"))
    return numbers


PUBLICATION = Publication(
    name="colgate_schenkel",
    kind=NumberSource.FORMULA,
    source="J. E. Colgate and G. G. Schenkel, Passivity of a class of sampled-data systems: application to haptic "
           "interfaces, J. Robotic Systems 14(1), 1997",
    about="a device with a sampled wall is passive iff b >= K T/2 + |B|",
    setting="scene virtual_wall, law virtual_wall, 1 kHz; the least damping is read off the scene's own tick "
            "(teleop passivity), not off the formula",
    rerun=rerun,
)
