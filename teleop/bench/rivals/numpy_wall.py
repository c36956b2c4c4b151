"""The slave beside its wall, for a batch of rows in numpy: contact located, or sub-steps.

Position p and velocity v are told from the wall's surface, inwards. The wall pushes back with `g = k p + d v` where p
and g are both above 0, as in `teleop.physics.contact`; a row is *touching* or not, and either is linear.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from teleop.bench.rivals.rival import parts
from teleop.scene.scene import Scene

Move = Callable[[Any, Any, Any], tuple[Any, Any]]


def located(scene: Scene, k_e: Any) -> Move:
    """Moves rows by the matrix of the mode that each is in, and anew those that another mode ends the tick in.

    A row that changes to and fro within one tick is missed; the canonical scene has none.
    """
    import numpy as np

    from teleop.physics.plant import linear

    _, _, surface, body = parts(scene)
    dt, d, n = scene.dt, surface.d, len(k_e)
    free = np.array(linear(body.mass, body.damping, 0.0, dt))[:, None]
    touch = np.array([linear(body.mass, body.damping + d, k, dt) for k in k_e]).T
    own = np.repeat(free, n, axis=1)  # the matrix of every row as it is now
    a11, a12, b1, a21, a22, b2 = own
    lean, touching = d / k_e, np.zeros(n, bool)
    p1, v1, t = np.zeros((3, n))
    now, changed = np.zeros((2, n), bool)

    def move(p: Any, v: Any, f: Any) -> tuple[Any, Any]:
        nonlocal p1, v1
        _product(a11, a12, b1, p, v, f, p1, t)
        _product(a21, a22, b2, p, v, f, v1, t)
        np.multiply(lean, v1, out=t)
        np.add(t, p1, out=t)
        np.minimum(t, p1, out=t)
        np.greater(t, 0.0, out=now)
        np.not_equal(now, touching, out=changed)
        if changed.any():
            i = changed.nonzero()[0]
            p1[i], v1[i], touching[i] = change(
                (body.mass, body.damping, d), k_e[i], dt, p[i], v[i], f[i], p1[i], v1[i], touching[i])
            own[:, i] = np.where(touching[i], touch[:, i], free)
        moved = p1, v1
        p1, v1 = p, v  # free to be written into at the next tick
        return moved

    return move


def _product(a: Any, b: Any, c: Any, p: Any, v: Any, f: Any, out: Any, t: Any) -> None:
    import numpy as np

    np.multiply(a, p, out=out)
    np.multiply(b, v, out=t)
    np.add(out, t, out=out)
    np.multiply(c, f, out=t)
    np.add(out, t, out=out)


def change(body: tuple[float, float, float], k: Any, left: Any, p: Any, v: Any, f: Any, p1: Any, v1: Any, touching: Any
           ) -> tuple[Any, Any, Any]:
    """Depth, speed and mode after `left` (s) of rows that leave their mode, which alone would take them to p1, v1.

    The instant is where p, coming in, or else g passes zero: by Newton's method from the chord.
    """
    import numpy as np

    mass, b, d = body
    entering = ~touching & (p < 0.0)
    alpha, beta = np.where(entering, 1.0, k), np.where(entering, 0.0, d)
    spring, damping = np.where(touching, k, 0.0), np.where(touching, b + d, b)
    before = alpha * p + beta * v
    t = left * before / (before - alpha * p1 - beta * v1)
    for _ in range(2):
        q, u = flow(mass, damping, spring, p, v, f, t)
        t = t - (alpha * q + beta * u) / (alpha * u + beta * (f - damping * u - spring * q) / mass)
    p, v = flow(mass, damping, spring, p, v, f, t)
    left, touching = left - t, ~touching
    p1, v1 = flow(mass, np.where(touching, b + d, b), np.where(touching, k, 0.0), p, v, f, left)
    i = ((np.minimum(p1, k * p1 + d * v1) > 0.0) != touching).nonzero()[0]
    if len(i) and (left[i] > 0.0).all():
        p1[i], v1[i], touching[i] = change(body, k[i], left[i], p[i], v[i], f[i], p1[i], v1[i], touching[i])
    return p1, v1, touching


def flow(m: float, c: Any, k: Any, p: Any, v: Any, f: Any, t: Any) -> tuple[Any, Any]:
    """State of `m p'' + c p' + k p = f` after t, by its Taylor series; a tick is a tenth of a radian here."""
    a = (f - c * v - k * p) / m
    a1 = -(c * a + k * v) / m
    a2 = -(c * a1 + k * a) / m
    a3 = -(c * a2 + k * a1) / m
    return (p + t * (v + t * (a / 2 + t * (a1 / 6 + t * (a2 / 24 + t * a3 / 120)))),
            v + t * (a + t * (a1 / 2 + t * (a2 / 6 + t * a3 / 24))))


def stepped(scene: Scene, k_e: Any, count: int) -> Move:
    """Moves rows by `count` steps of the midpoint rule a tick; contact falls where a step does."""
    import numpy as np

    _, _, surface, body = parts(scene)
    h, m, b, d = scene.dt / count, body.mass, body.damping, surface.d
    s, t, half_p, half_v = np.zeros((4, len(k_e)))
    inside = np.zeros(len(k_e), bool)

    def pull(p: Any, v: Any, f: Any, size: float) -> Any:
        """`size` times the acceleration."""
        np.multiply(k_e, p, out=s)
        np.multiply(v, d, out=t)
        np.add(s, t, out=s)
        np.maximum(s, 0.0, out=s)
        np.greater(p, 0.0, out=inside)
        np.multiply(s, inside, out=s)
        np.multiply(v, b, out=t)
        np.add(s, t, out=s)
        np.subtract(f, s, out=s)
        return np.multiply(s, size / m, out=s)

    def move(p: Any, v: Any, f: Any) -> tuple[Any, Any]:
        for _ in range(count):
            np.add(v, pull(p, v, f, 0.5 * h), out=half_v)
            np.multiply(v, 0.5 * h, out=half_p)
            np.add(half_p, p, out=half_p)
            np.add(v, pull(half_p, half_v, f, h), out=v)
            np.multiply(half_v, h, out=t)
            np.add(p, t, out=p)
        return p, v

    return move
