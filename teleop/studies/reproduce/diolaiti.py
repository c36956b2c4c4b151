"""Diolaiti, Niemeyer, Barbagli and Salisbury 2006: a virtual wall whose force is late by whole samples."""

from __future__ import annotations

from teleop.analysis.passivity.one_port import one_port
from teleop.studies.reproduce.publication import NumberSource, Publication, Replication, wall

WALLS = ((1000.0, 1), (1000.0, 5), (200.0, 20))  # N/m, ticks


def rerun() -> list[Replication]:
    """The least damping of the device for walls whose force is late."""
    return [Replication(f"least device damping for K = {K:g} N/m, {d} ms late", f"{K * (0.5e-3 + d * 1e-3):g}",
                        one_port(wall(K, delay=d)).needed.damping, "N s/m", 1e-6, "K (T/2 + t_d) with T = 1 ms")
            for K, d in WALLS]


PUBLICATION = Publication(
    name="diolaiti",
    kind=NumberSource.FORMULA,
    source="N. Diolaiti, G. Niemeyer, F. Barbagli and J. K. Salisbury, Stability of haptic rendering: discretization, "
           "quantization, time delay, and Coulomb effects, IEEE Trans. Robotics 22(2), 2006",
    about="a spring whose force is late by t_d needs the device damping K (T/2 + t_d)",
    setting="scene virtual_wall, law virtual_wall without damper, 1 kHz, the delay of the computation in whole ticks",
    rerun=rerun,
)
