"""Choi and Tan 2004: the greatest stiffness at which a virtual texture feels clean, over the update rate."""

from __future__ import annotations

from teleop.studies.reproduce.publication import NumberSource, Publication, Replication

SLOW, FAST = "0.325", "0.904"  # N/mm, at 250 Hz and at 40 kHz
LACKS = ("judged by people at a textured wall; what they call clean, the device's resonance and its friction are "
         "needed to run it")


def rerun() -> list[Replication]:
    """The two stiffnesses, which are quoted, and their ratio, which is worked out."""
    return [
        Replication("greatest clean stiffness at 250 Hz", SLOW, None, "N/mm", remark=LACKS),
        Replication("greatest clean stiffness at 40 kHz", FAST, None, "N/mm", remark=LACKS),
        Replication("increase from 250 Hz to 40 kHz", "278", 100.0 * (float(FAST) / float(SLOW) - 1.0), "%",
                    remark="0.904/0.325 is 2.78: the stiffness is 278 % of what it was, an increase of 178 %"),
    ]


PUBLICATION = Publication(
    name="choi_tan",
    kind=NumberSource.PRINTED,
    source="S. Choi and H. Z. Tan, Effect of update rate on perceived instability of virtual haptic texture, Proc. "
           "IEEE/RSJ IROS, 2004",
    about="textures can be rendered stiffer, and feel clean, at higher update rates",
    setting="quoted, not run: the criterion is a person's",
    rerun=rerun,
)
