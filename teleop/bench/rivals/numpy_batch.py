"""numpy over a batch: all rows advance together, tick by tick, every quantity one array.

The rows differ in the wall's stiffness and share everything else, the delay too. That favours numpy: its coefficients
are scalars, and a delayed wave is a line of a ring of arrays, not looked up row by row. Buffers are made once and every
operation writes into one. What is left is about fifty passes over arrays a tick. The batch is the size that was fastest
when this was written: smaller ones pay for calls and for contacts of a few rows at a time, larger ones fall out of the
cache. While only the wall differs, both ends' tick is also one 6 by 7 matrix for all rows, and BLAS was then a fifth
faster; it is not taken because one knob of the law that differs between rows is the end of it.
"""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt
from typing import Any, NamedTuple

from teleop.bench.rivals.numpy_wall import located, stepped
from teleop.bench.rivals.rival import Rival, delay_ticks, exact_positions, parts, stiffnesses
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene

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
    import numpy as np

    found = np.zeros((2, scene.ticks))

    def watch(k: int, x_m: Any, x_s: Any, *_: Any) -> None:
        found[:, k] = x_m[0], x_s[0]

    batch(scene, np.array([scene.environments[0].k]), wall, watch)()  # type: ignore[union-attr]
    return float(np.abs(found - exact_positions(scene)).max())


class Master(NamedTuple):
    """The gripped master with `f_m = b v_m - root w` put in: `x' = xx x + xv v + xw w + drive_x[k]`, and v' alike."""

    xx: float
    xv: float
    xw: float
    vx: float
    vv: float
    vw: float
    drive_x: list[float]  # by the reference, for every tick
    drive_v: list[float]


def master(scene: Scene) -> Master:
    """The master's step over a tick."""
    import numpy as np

    from teleop.physics.plant import grip
    from teleop.simulation.bodies import reference_samples

    law, hand, _, _ = parts(scene)
    g = grip(scene.master, hand.mass, hand.k, hand.d, scene.dt)
    r = np.asarray((reference_samples(scene) or ())[0])
    slope, root = np.diff(r) / scene.dt, sqrt(2.0 * law.b)
    return Master(g.a11, g.a12 - g.b1 * law.b, g.b1 * root, g.a21, g.a22 - g.b2 * law.b, g.b2 * root,
                  (r[1:] - g.a11 * r[:-1] - (g.a12 + g.b1 * g.b) * slope).tolist(),
                  (slope - g.a21 * r[:-1] - (g.a22 + g.b2 * g.b) * slope).tolist())


def batch(scene: Scene, k_e: Any, wall: Callable[..., Any] = located, watch: Watch | None = None
          ) -> Callable[[], tuple[Any, Any]]:
    """One run of `scene` with walls of each `k_e` (N/m): it returns the rms and the greatest tracking error (m) by row.

    The link is a constant delay of whole ticks. `watch` is told k, x_m, x_s and the waves u, w sent at every tick.
    """
    import numpy as np

    n, lag = len(k_e), delay_ticks(scene)
    slave = np.zeros((3, n))
    slave[:2] -= parts(scene)[2].at  # its two positions are told from the wall's surface
    waves = [[np.zeros(n) for _ in range(lag)] for _ in range(2)]
    state = *np.zeros((8, n)), *slave, *waves, np.zeros((lag + 1, n))
    given = scene, master(scene), wall(scene, k_e), watch
    return lambda: _run(*given, *state)


def _run(scene: Scene, c: Master, move: Any, watch: Watch | None, x_m: Any, v_m: Any, new: Any, f_s: Any, s: Any,
         t: Any, sq: Any, top: Any, p: Any, x_d: Any, v_s: Any, forth: Any, back: Any, old: Any) -> tuple[Any, Any]:
    import numpy as np

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
