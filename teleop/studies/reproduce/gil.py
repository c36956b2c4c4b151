"""Gil, Sanchez, Hulin, Preusche and Hirzinger 2009: the linear rule for the stability of a late virtual wall."""

from __future__ import annotations

from teleop.analysis.stability.assess import critical
from teleop.scene.scene import Scene
from teleop.studies.reproduce.publication import NumberSource, Publication, Replication, wall

WALLS = ((0.0, 0), (0.0, 1), (0.0, 5), (0.0, 10), (0.0, 100), (0.8, 5))  # N s/m, ticks
CLOSE = 0.02  # of the rule, that a rule of thumb for small damping and delay may be off
M, DAMPING = 0.04, 0.8


def rerun() -> list[Replication]:
    """The stiffness at which the exact sampled loop loses its stability, beside the rule."""
    numbers = []
    for B, d in WALLS:
        rule = (DAMPING + B) / (0.5e-3 + d * 1e-3)

        def late(K: float, B: float = B, d: int = d) -> Scene:
            return wall(K, B, delay=d, m=M, b=DAMPING, k=0.0, d=0.0, energy=False)

        edge = critical(late, "K", low=0.3 * rule, high=3.0 * rule, places=7)
        side = "the rule is on the safe side" if edge.value > rule else "the rule errs on the unsafe side"
        far = f"; {side} by {100.0 * abs(edge.value / rule - 1.0):.1f} %"
        numbers.append(Replication(f"critical stiffness, wall damping {B:g} N s/m, {d} ms late", f"{rule:.2f}",
                                   edge.value, "N/m", CLOSE * rule,
                                   f"within 2 %, as a rule for small damping and delay{far}"))
    return numbers


PUBLICATION = Publication(
    name="gil",
    kind=NumberSource.FORMULA,
    source="J. J. Gil, E. Sanchez, T. Hulin, C. Preusche and G. Hirzinger, Stability boundary for haptic rendering: "
           "influence of damping and delay, J. Computing and Information Science in Engineering 9(1), 2009",
    about="a late virtual wall is stable for K < (b + B)/(T/2 + t_d)",
    setting="scene virtual_wall, 0.04 kg and 0.8 N s/m, no hand, 1 kHz; the critical stiffness is that of the "
            "eigenvalues of the exact sampled loop (teleop stability)",
    rerun=rerun,
)
