"""What stiffness the contact of a MuJoCo model has: pressed slowly, in a copy of its state, before the run.

MuJoCo's contacts are soft by how they are computed, and their stiffness goes with the force. So it is measured and
told, never promised: along the first axis that comes upon something, at two forces.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from slave.mujoco_pose import ON_AXIS, jacobian
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
LEAST_FRICTION = 0.5  # N or N m, that is worth a note
SEEKS, SETTLES = 1.5, 0.4  # s, for the way there, and for each force


def pressed(model: Loaded, body: MuJoCoBody) -> list[str]:
    """Sentences on the stiffness of what `body`, a copy of the start, comes upon, and on the friction of its joints."""
    from copy import copy

    reached: dict[str, float] = {}
    friction = friction_notes(model, body)
    for i, unit in enumerate(model.units):
        for sign in (1.0, -1.0):
            found, way = _along(model, copy(body), i, sign)
            if found is not None:
                force = FORCE_UNIT[unit]
                at = " and ".join(f"{each:,.0f} {force}/{unit} at {load:g} {force}"
                                  for each, load in zip(found, FORCES, strict=True))
                along = f"{'+' if sign > 0.0 else '-'}{model.names[i]}"
                return [f"pressed slowly before the run along {along}, the contact of the MuJoCo model had {at}: it is "
                        "softer than a rigid body, and not linear", *friction]
            reached[unit] = min(reached.get(unit, REACH[unit]), way)
    within = " or ".join(f"{way:.2g} {unit}" for unit, way in sorted(reached.items()))
    return [f"pressed before the run along each axis, the MuJoCo model came upon nothing within {within} of its start: "
            "the stiffness of its contacts is not known", *friction]


def friction_notes(model: Loaded, body: MuJoCoBody) -> list[str]:
    """The note on the pushes (N or N m) along each axis that the friction of the joints holds at the start."""
    import numpy as np

    loss = model.model.dof_frictionloss
    J = jacobian(model.robot, body.data)
    with np.errstate(divide="ignore", invalid="ignore"):
        holds = np.nanmin(np.where(abs(J) > ON_AXIS, loss / abs(J), np.inf), axis=1)
    large = [f"{force:.2g} {FORCE_UNIT[unit]} along {name}"
             for force, unit, name in zip(holds.tolist(), model.units, model.names, strict=True)
             if force >= LEAST_FRICTION]
    return [f"the friction of its joints (frictionloss in its file) holds the MuJoCo model at the start against a push "
            f"of up to {', '.join(large)}"] if large else []


def _along(model: Loaded, body: MuJoCoBody, i: int, sign: float) -> tuple[tuple[float, ...] | None, float]:
    """The stiffness at each of `FORCES` of what is along axis i, and how far it came, m or rad.

    The stiffness is None of nothing, and of what does not hold still.
    """
    dt = model.model.opt.timestep * model.substeps
    home = body.read().x
    try:
        if not _push(model, body, home, i, sign * APPROACH, round(SEEKS / dt), seeks=True):
            return None, abs(body.read().x[i] - home[i])
        found = []
        for force in FORCES:
            at = []
            for load in (force * (1.0 - PART), force * (1.0 + PART)):
                if not _push(model, body, home, i, sign * load, round(SETTLES / dt)):
                    return None, abs(body.read().x[i] - home[i])
                at.append(sign * body.read().x[i])
            if not at[1] > at[0]:
                return None, abs(at[1] - sign * home[i])
            found.append(2.0 * PART * force / (at[1] - at[0]))
    except DeviceError:
        return None, 0.0
    return tuple(found), abs(at[1] - sign * home[i])


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
