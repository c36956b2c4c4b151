"""numpy over a batch: all rows advance together, tick by tick, every quantity one array.

The rows differ in the wall's stiffness and share everything else, the delay too. That favours numpy: its coefficients
are scalars, and a delayed wave is a line of a ring of arrays, not looked up row by row. Buffers are made once and every
operation writes into one. What is left is about fifty passes over arrays a tick. The batch is the size that was fastest
when this was written: smaller ones pay for calls and for contacts of a few rows at a time, larger ones fall out of the
cache. While only the wall differs, both ends' tick is also one 6 by 7 matrix for all rows, and BLAS was then a fifth
faster; it is not taken because one knob of the law that differs between rows is the end of it.

The slave beside its wall: contact located, or sub-steps. Its position p and velocity v are measured from the wall's
surface, inwards. The wall pushes back with `g = k p + d v` where p and g are both above 0, as in
`teleop.physics.contact`; a row is *touching* or not, and either is linear.
"""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from teleop.bench.rivals.rival import Rival, delay_ticks, exact_positions, parts, stiffnesses
from teleop.physics.plant import grip, linear
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene
from teleop.simulation.bodies import reference_samples

Move = Callable[[Any, Any, Any], tuple[Any, Any]]


def located(scene: Scene, k_e: Any) -> Move:
    """Moves rows by the matrix of the mode that each is in, and anew those that another mode ends the tick in.

    A row that changes to and fro within one tick is missed; the canonical scene has none.
    """
    _, _, surface, body = parts(scene)
    dt, d, n = scene.dt, surface.d, len(k_e)
    free = np.array(linear(body.mass, body.damping, 0.0, dt))[:, None]
    touch = np.array([linear(body.mass, body.damping + d, k, dt) for k in k_e]).T
    matrices = np.repeat(free, n, axis=1)  # the matrix of every row as it is now
    a11, a12, b1, a21, a22, b2 = matrices
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
            matrices[:, i] = np.where(touching[i], touch[:, i], free)
        moved = p1, v1
        p1, v1 = p, v  # free to be written into at the next tick
        return moved

    return move


def _product(a: Any, b: Any, c: Any, p: Any, v: Any, f: Any, out: Any, t: Any) -> None:
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


LOCATED_ROWS, LOCATED_SECONDS = 16_000, 2.0
STEPPED_ROWS, STEPPED_SECONDS = 2_000, 0.1
SUB_STEPS = 256  # of a tick, midpoint rule: 8e-7 m over 10 s; semi-implicit Euler needs 800 at half the price each
STEPPED_CHECKED = 1.3  # s, which has two contacts; a single row is slow

Watch = Callable[[int, Any, Any, Any, Any], None]


def located_batch() -> Rival:
    """With exact steps and the instants of contact located."""
    return _rival("numpy, contact located", located, LOCATED_ROWS, LOCATED_SECONDS, 10.0)


def stepped_batch() -> Rival:
    """With the slave moved in sub-steps."""
    return _rival(f"numpy, {SUB_STEPS} sub-steps a tick", lambda scene, k_e: stepped(scene, k_e, SUB_STEPS),
                  STEPPED_ROWS, STEPPED_SECONDS, STEPPED_CHECKED)


def _rival(what: str, wall: Callable[..., Any], rows: int, seconds: float, checked: float) -> Rival:
    scene, k_e = load_scene("canonical", duration=seconds), stiffnesses(rows)
    return Rival(f"{what}, {rows} rows", 20, scene.ticks * rows, lambda: batch(scene, k_e, wall),
                 position_error(load_scene("canonical", duration=checked), wall))


def position_error(scene: Scene, wall: Callable[..., Any] = located) -> float:
    """The greatest error of either handle (m) in a run of one row, against the exact bodies."""
    positions = np.zeros((2, scene.ticks))

    def watch(k: int, x_m: Any, x_s: Any, *_: Any) -> None:
        positions[:, k] = x_m[0], x_s[0]

    batch(scene, np.array([scene.environments[0].k]), wall, watch)()  # type: ignore[union-attr]
    return float(np.abs(positions - exact_positions(scene)).max())


class MasterStep(NamedTuple):
    """The gripped master with `f_m = b v_m - root w` put in: `x' = xx x + xv v + xw w + drive_x[k]`, and v' alike."""

    xx: float
    xv: float
    xw: float
    vx: float
    vv: float
    vw: float
    drive_x: list[float]  # by the reference, for every tick
    drive_v: list[float]


def master(scene: Scene) -> MasterStep:
    """The master's step over a tick."""
    law, hand, _, _ = parts(scene)
    g = grip(scene.master, hand.mass, hand.k, hand.d, scene.dt)
    r = np.asarray((reference_samples(scene) or ())[0])
    slope, root = np.diff(r) / scene.dt, sqrt(2.0 * law.b)
    return MasterStep(g.a11, g.a12 - g.b1 * law.b, g.b1 * root, g.a21, g.a22 - g.b2 * law.b, g.b2 * root,
                  (r[1:] - g.a11 * r[:-1] - (g.a12 + g.b1 * g.b) * slope).tolist(),
                  (slope - g.a21 * r[:-1] - (g.a22 + g.b2 * g.b) * slope).tolist())


def batch(scene: Scene, k_e: Any, wall: Callable[..., Any] = located, watch: Watch | None = None
          ) -> Callable[[], tuple[Any, Any]]:
    """Prepare a run of `scene` with walls of each `k_e` (N/m): it returns rms and greatest tracking error (m) by row.

    The link is a constant delay of whole ticks. `watch` is told k, x_m, x_s and the waves u, w sent at every tick.
    """
    n, lag = len(k_e), delay_ticks(scene)
    slave = np.zeros((3, n))
    slave[:2] -= parts(scene)[2].at  # its two positions are told from the wall's surface
    waves = [[np.zeros(n) for _ in range(lag)] for _ in range(2)]
    state = *np.zeros((8, n)), *slave, *waves, np.zeros((lag + 1, n))
    fixed = scene, master(scene), wall(scene, k_e), watch
    return lambda: _run(*fixed, *state)


def _run(scene: Scene, c: MasterStep, move: Any, watch: Watch | None, x_m: Any, v_m: Any, new: Any, f_s: Any, s: Any,
         t: Any, sq: Any, top: Any, p: Any, x_d: Any, v_s: Any, forth: Any, back: Any, old: Any) -> tuple[Any, Any]:
    law, _, surface, _ = parts(scene)
    dt, at, lag, root = scene.dt, surface.at, len(forth), sqrt(2.0 * law.b)
    per = 1.0 / (law.b + law.B + law.K * dt)
    of_u, of_x, of_v = root * per, law.K * per, law.B * per
    subtract, multiply = np.subtract, np.multiply
    for k in range(scene.ticks):
        u, w = forth[k % lag], back[k % lag]  # what comes in
        subtract(x_m, at, out=old[k % (lag + 1)])
        if k >= lag:
            subtract(p, old[(k + 1) % (lag + 1)], out=t)
            np.maximum(top, np.abs(t, out=new), out=top)
            multiply(t, t, out=t)
            sq += t
        seen = None if watch is None else (x_m.copy(), p + at)
        # slave: f_s = root u - b v_d, and w = root v_d - u goes back
        subtract(x_d, p, out=t)
        t *= of_x
        multiply(u, of_u, out=s)
        s -= t
        multiply(v_s, of_v, out=t)
        s += t  # v_d
        multiply(s, dt, out=t)
        x_d += t
        s *= root
        multiply(s, 0.5, out=t)
        subtract(u, t, out=f_s)
        f_s *= root
        s -= u
        # master: root v_m - w goes forth
        multiply(v_m, root, out=u)
        u -= w
        multiply(x_m, c.xx, out=new)
        multiply(v_m, c.xv, out=t)
        new += t
        multiply(w, c.xw, out=t)
        new += t
        new += c.drive_x[k]
        x_m *= c.vx
        v_m *= c.vv
        v_m += x_m
        w *= c.vw
        v_m += w
        v_m += c.drive_v[k]
        x_m, new = new, x_m
        back[k % lag], s = s, w  # what went out is kept in its place, and the old array is free
        if watch is not None and seen is not None:
            watch(k, *seen, u, back[k % lag])
        p, v_s = move(p, v_s, f_s)
    return np.sqrt(sq / (scene.ticks - lag)), top
