"""The equations of a two-port's ends put together: device, law and link over frequency. See `two_port`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from teleop.analysis.models.linear import Matrix
    from teleop.analysis.models.peak import Points

READINGS = 5  # of an end: x, v, f, f_held, dx


class Readings(NamedTuple):
    """How an end's readings follow from what happens at the port, over frequency."""

    held: Points  # the force held before, over the force now
    moved: Points  # dx over x
    sense: Points  # what the law is told of the hand's force, over what a sensor would feel
    sensed: Points  # that, over v_m
    through: Points  # that, over f_m


class Driven(NamedTuple):
    """The slave's samples over the force held on it."""

    x: Points
    v: Points


def assembled(s: Points, ends: Any, delay: Any, r: Readings, driven: Driven, *, bare: Points, hold: Points,
              velocity: Any, inertia: Points, acts: Any = (1.0, 1.0)) -> Points:
    """h (n, 2, 2) from the equations of both ends: (force, tx) = law (readings, rx), rx the other's tx, delayed.

    s (n,): i w. ends: the laws by `law_transfer`. delay: of a message forth and back, as factors. bare: the slave's
    velocity over force. hold: what holding makes of a force. velocity: of each end, what the law is told of it over it,
    None for the truth. inertia: f_h over v_m of the master alone. acts: of each end, the delay of its force, a factor.
    """
    import numpy as np

    n, (master, slave) = len(s), ends
    out, home = master.shape[1] - 1, slave.shape[1] - 1  # fields forth, fields back
    size = 2 + out + home  # unknown: f_m, f_s as they act, the messages sent forth, those sent back
    f_m, f_s, forth, back = 0, 1, slice(2, 2 + out), slice(2 + out, size)
    at_m, at_s = np.zeros((2, n, READINGS, size + 2), dtype=np.complex128)  # of the unknowns, then of v_m and f_env
    v_m, f_env = size, size + 1
    at_m[:, 0, v_m], at_m[:, 1, v_m] = 1.0 / s, 1.0 if velocity[0] is None else velocity[0]
    at_m[:, 2, v_m], at_m[:, 2, f_m] = r.sense * r.sensed, r.sense * r.through
    at_m[:, 3, f_m], at_m[:, 4] = r.held, r.moved[:, None] * at_m[:, 0]
    at_s[:, 0, f_s], at_s[:, 0, f_env] = driven.x, -bare / s
    at_s[:, 1, f_s], at_s[:, 1, f_env] = driven.v, -bare
    if velocity[1] is not None:  # made of positions
        at_s[:, 1] = (velocity[1] * s)[:, None] * at_s[:, 0]
    at_s[:, 2, f_env], at_s[:, 3, f_s], at_s[:, 4] = 1.0, r.held, r.moved[:, None] * at_s[:, 0]
    both = np.zeros((n, size, size + 2), dtype=np.complex128)
    for law, at, rx, lag, force, sent, act in ((master, at_m, back, delay[1], f_m, forth, acts[0]),
                                               (slave, at_s, forth, delay[0], f_s, back, acts[1])):
        answer = law[:, :, :READINGS] @ at
        answer[:, :, rx] += law[:, :, READINGS:] * lag[:, None, None]
        answer[:, 0] *= np.broadcast_to(act, n)[:, None]
        both[:, force], both[:, sent] = answer[:, 0], answer[:, 1:]
    unknown = np.linalg.solve(np.eye(size) - both[:, :, :size], both[:, :, size:])
    h = np.empty((n, 2, 2), dtype=np.complex128)
    h[:, 0] = hold[:, None] * unknown[:, f_m]
    h[:, 0, 0] += inertia
    h[:, 1] = -(bare * hold)[:, None] * unknown[:, f_s]
    h[:, 1, 1] += bare
    return h


def law_transfer(law: Matrix, states: int, p: Points) -> Points:
    """(force and message) over (readings, rx) at p = z or s, (n, 1 + fields, READINGS + fields in)."""
    import numpy as np

    shown = law[states:, states:] + np.zeros((len(p), 1, 1))
    if not states:
        return shown.astype(np.complex128)
    inner: Any = np.linalg.solve(p[:, None, None] * np.eye(states) - law[:states, :states], law[:states, states:] + 0j)
    found: Points = shown + law[states:, :states] @ inner
    return found
