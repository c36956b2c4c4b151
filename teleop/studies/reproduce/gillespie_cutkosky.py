"""Gillespie and Cutkosky 1996: a handle that bounces on a sampled floor gains height at every strike."""

from __future__ import annotations

from teleop.simulation.virtual import run
from teleop.studies.reproduce.publication import NumberSource, Publication, Replication, wall, with_hand

HANDLE, FINGER, SPRING, FLOOR, TICK = 0.35, 0.006, 500.0, 5000.0, 0.01  # kg, kg, N/m, N/m, s
SURFACE = 0.03  # m


def heights(finger: float, tick: float) -> list[float]:
    """Heights (m) above the floor to which the handle comes back; the finger pulls towards `finger` (m)."""
    scene = wall(FLOOR, m=HANDLE, b=0.0, dt=tick, x_limit=1.0, energy=False, **{"law.at": SURFACE})
    x = run(with_hand(scene, mass=FINGER, k=SPRING, d=0.0, at=finger, start=0.0)).trace["x_m"]
    return [SURFACE - float(x[k]) for k in range(1, len(x) - 1) if x[k - 1] >= x[k] < x[k + 1] and x[k] < SURFACE]


def rerun() -> list[Replication]:
    """The heights of the bounces for three places of the finger."""
    numbers = []
    for finger in (0.03, 0.032, 0.04):
        tops = heights(finger, TICK)
        higher = len(tops) > 2 and all(later > before for before, later in zip([SURFACE, *tops], tops, strict=False))
        reached = ", ".join(f"{1e3 * each:.0f}" for each in tops[:4])
        numbers.append(Replication(f"floor sampled at 10 ms, finger at {1e3 * finger:g} mm", "higher at every strike",
                                   "higher at every strike" if higher else "not higher at every strike",
                                   remark=f"from {1e3 * SURFACE:g} mm to {reached} mm"))
    return numbers


PUBLICATION = Publication(
    name="gillespie_cutkosky",
    kind=NumberSource.PRINTED,
    source="R. B. Gillespie and M. R. Cutkosky, Stable user-specific haptic rendering of the virtual wall, Proc. ASME "
           "IMECE, DSC-Vol. 58, 1996",
    about="a sampled floor gives out energy at every strike, for its force comes and goes late",
    setting="scene virtual_wall, 0.35 kg, finger 0.006 kg and 500 N/m, floor 5000 N/m at 10 ms, no damping, all "
            "printed; the handle starts at rest 30 mm above the floor, which is assumed",
    rerun=rerun,
)
