"""Hannaford and Ryu 2002: hard walls on the Excalibur display, with and without the passivity controller."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from teleop.simulation.virtual import run
from teleop.studies.reproduce.publication import NumberSource, Publication, Replication, wall, with_hand

MASS, DAMPING, HAND = 2.0, 1.0, 40.0  # kg, N s/m, N s/m; not known, see `setting`
CAP = 1000.0  # N s/m of the controller's damper, a quarter of 4 M/T, with which a sampled damper reverses the motion
SPEED = 0.2  # m/s, at the first contact
AT_REST = 2e-5  # m, peak-to-peak in the last half second
REST = f"swing below {1e3 * AT_REST:g} mm"
SOFT = 1e-3  # N/m of a hand's spring so long that its force is constant


class Contact(NamedTuple):
    """A contact with the wall: bounces, swing at the end, and force of the controller."""

    contacts: int
    swing: float  # m, peak-to-peak in the last 0.5 s
    control: float  # N, the most that the controller added where the wall's force was renewed


def contact(K: float, every: int, cap: float | None) -> Contact:
    """A hand that pushes with a constant force through its own damping reaches the wall at `SPEED`, its final speed."""
    push = SPEED * (HAND + DAMPING)
    scene = wall(K, m=MASS, b=DAMPING, every=every, cap=cap, energy=False, **{"law.at": 0.0})
    start = -5.0 * MASS / (HAND + DAMPING) * SPEED  # five time constants of the approach
    trace = run(with_hand(scene, mass=0.0, k=SOFT, d=HAND, at=push / SOFT, start=start)).trace
    x = trace["x_m"]
    inside = x > 0.0
    added = np.abs(trace["f_m"] - K * np.maximum(x, 0.0))[::every]
    return Contact(int((inside[1:] & ~inside[:-1]).sum()), float(np.ptp(x[-500:])), float(added.max()))


def rerun() -> list[Replication]:
    """A wall of 90 kN/m at 1 kHz, and one of 30 kN/m that is renewed at 66.7 Hz."""
    bare, calm = contact(9e4, 1, None), contact(9e4, 1, CAP)
    slow, slow_calm = contact(3e4, 15, None), contact(3e4, 15, CAP)
    fast, late = "90 kN/m at 1 kHz", "30 kN/m at 66.7 Hz"
    return [
        Replication(f"{fast}, no controller", "does not come to rest", _rest(bare), "", REST),
        Replication(f"{fast}, with the controller", "comes to rest", _rest(calm), "", REST),
        Replication(f"{fast}, with the controller: bounces", "6", float(calm.contacts), is_fitted=True,
                    remark="printed as about 6; the mass that is not known was chosen by this number"),
        Replication(f"{fast}: the most that the controller added", "below 40 N",
                    "below 40 N" if calm.control < 40.0 else f"{calm.control:.1f} N",
                    remark=f"{calm.control:.1f} N with a device of {MASS:g} kg, which is assumed; with 1 kg it is "
                           "29.8 N"),
        Replication(f"{late}, no controller", "does not come to rest", _rest(slow), "", REST),
        Replication(f"{late}, with the controller", "comes to rest", _rest(slow_calm), "", REST),
        Replication(f"{late}, with the controller: bounces", "1", slow_calm.contacts - 1.0, "", 0.0,
                    "contacts after the first"),
    ]


def _rest(contact: Contact) -> str:
    return "comes to rest" if contact.swing < AT_REST else "does not come to rest"


PUBLICATION = Publication(
    name="hannaford_ryu",
    kind=NumberSource.PRINTED,
    source="B. Hannaford and J.-H. Ryu, Time-domain passivity control of haptic interfaces, IEEE Trans. Robotics and "
           "Automation 18(1), 2002",
    about="a hard wall met at 200 mm/s bounces on, and comes to rest with the passivity controller",
    setting="scene virtual_wall with its passivity controller; the damper acts every tick, also where the wall's force "
            "is renewed every 15 ms. Mass and damping of the device and the hand are not printed in what was read of "
            "the paper: 2 kg, 1 N s/m and 40 N s/m are assumed, the mass by the printed number of bounces at 90 kN/m. "
            "At rest is a swing of less than 20 um in the last half second of two",
    rerun=rerun,
)
