"""Published comparisons rerun here: what each publication printed beside what this stack gives.

Each publication is a module of this room with a `PUBLICATION`; `PUBLICATIONS` lists them in the order of the table.
"""

from __future__ import annotations

from importlib import import_module

from teleop.errors import Refused, nearest
from teleop.studies.reproduce.publication import Publication, Replication

PUBLICATIONS = (
    "colgate_schenkel", "diolaiti", "abbott_okamura", "gil", "encoder_wall", "hannaford_ryu", "gillespie_cutkosky",
    "choi_tan", "two_handles", "niemeyer_slotine", "damping_injection", "polushin",
    "franken",
)

__all__ = ["PUBLICATIONS", "Publication", "Replication", "find_publication"]


def find_publication(name: str) -> Publication:
    """The publication of this name. Raises `Refused` with the nearest names if there is none."""
    if name not in PUBLICATIONS:
        raise Refused(f"there is no publication {name!r} to rerun; {nearest(name, PUBLICATIONS)}")
    publication: Publication = import_module(f"{__name__}.{name}").PUBLICATION
    return publication
