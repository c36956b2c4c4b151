"""What stiffness the contact of a MuJoCo model has: pressed slowly, in a copy of its state, before the run.

MuJoCo's contacts are soft by how they are computed, and their stiffness goes with the force. So it is measured and
told, never promised: along the first axis that comes upon something, at two forces.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from teleop.errors import DeviceError
from teleop.scene.axes import FORCE_UNIT

if TYPE_CHECKING:
    from slave.mujoco_body import MuJoCoBody
    from slave.mujoco_model import Loaded

FORCES = (2.0, 10.0)  # N or N m, at which it is told
PART = 0.2  # of each: the stiffness is that between a force less and one more by so much
APPROACH = 4.0  # N or N m, against ...
DAMPING = {"m": 20.0, "rad": 2.0}  # ... so much, N s/m or N m s/rad
SPRING = {"m": 1000.0, "rad": 50.0}  # N/m or N m/rad, which hold the other axes
REACH = {"m": 0.2, "rad": 0.6}  # how far from the start it is looked for
SEEKS, SETTLES = 1.5, 0.4  # s, for the way there, and for each force


def pressed(model: Loaded, body: MuJoCoBody) -> str:
    """A sentence on the stiffness of what `body`, a copy of the start, comes upon. It is left in some other state."""
    from copy import copy

    for i in range(len(model.axes)):
        for sign in (1.0, -1.0):
            found = _along(model, copy(body), i, sign)
            if found is not None:
                unit = model.units[i]
                force = FORCE_UNIT[unit]
                at = " and ".join(f"{each:,.0f} {force}/{unit} at {load:g} {force}"
                                  for each, load in zip(found, FORCES, strict=True))
                way = f"{'+' if sign > 0.0 else '-'}{model.names[i]}"
                return (f"pressed slowly before the run along {way}, the contact of the MuJoCo model had {at}: it is "
                        "softer than a rigid body, and not linear")
    reach = " or ".join(f"{REACH[unit]:g} {unit}" for unit in sorted(set(model.units)))
    return (f"pressed before the run along each axis, the MuJoCo model came upon nothing within {reach} of its start: "
            "the stiffness of its contacts is not known")


def _along(model: Loaded, body: MuJoCoBody, i: int, sign: float) -> tuple[float, ...] | None:
    """The stiffness at each of `FORCES` of what is along axis i; None of nothing, and of what does not hold still."""
    dt = model.model.opt.timestep * model.substeps
    try:
        home = body.read().x
        if not _push(model, body, home, i, sign * APPROACH, round(SEEKS / dt), seeks=True):
            return None
        found = []
        for force in FORCES:
            at = []
            for load in (force * (1.0 - PART), force * (1.0 + PART)):
                if not _push(model, body, home, i, sign * load, round(SETTLES / dt)):
                    return None
                at.append(sign * body.read().x[i])
            if not at[1] > at[0]:
                return None
            found.append(2.0 * PART * force / (at[1] - at[0]))
    except DeviceError:
        return None
    return tuple(found)


def _push(model: Loaded, body: MuJoCoBody, home: tuple[float, ...], i: int, force: float, ticks: int, *,
          seeks: bool = False) -> bool:
    """Push along axis i for so many ticks; True if what is there then takes that force, to 5 %.

    `seeks`: it ends as soon as there is something, or beyond `REACH`.
    """
    unit = model.units
    for _ in range(ticks):
        x, v, f = body.read()[:3]
        if not abs(x[i] - home[i]) < REACH[unit[i]]:
            return False
        if f is not None and seeks and abs(f[i] - force) < 0.2 * abs(force) and abs(v[i]) < 0.01:
            return True
        held = [force if j == i else SPRING[unit[j]] * (home[j] - x[j]) for j in range(len(x))]
        body.hold(tuple([each - DAMPING[unit[j]] * v[j] for j, each in enumerate(held)]))
        body.step()
    x, _, f = body.read()[:3]
    return f is not None and abs(f[i] - force) < 0.05 * abs(force)
