"""What the stack's own steps are worth: one tick from the same state, beside tight integrators of scipy's.

And what their rounding comes to over a whole run: the same run with every step put off by as much, in a fixed
pattern of signs. Where contacts bounce or a loop is unstable that grows, and no method is told from another
below it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING, Any

from teleop.analysis.precision.contenders.outsiders import there
from teleop.analysis.precision.reference.deviation import felt
from teleop.analysis.precision.reference.located import MOST_RADIANS, gripped_touch, located, radians
from teleop.errors import number_of
from teleop.physics.plant import Gripped, Plant, move_free, move_gripped
from teleop.simulation.bodies import Bodies, exact_bodies, reference_samples
from teleop.simulation.integrators.parts import inner, slave_of
from teleop.simulation.integrators.stepped import touch_of
from teleop.simulation.metrics import magnitude

if TYPE_CHECKING:
    from teleop.scene.scene import Scene
    from teleop.simulation.integrators.methods import Touch

CHANGES, OTHERS = 24, 12  # ticks to look at: those in which contact is made or lost, and more, evenly
RADAU = 8  # of these also by Radau, which takes far longer


@dataclass(frozen=True, kw_only=True, slots=True)
class Agreement:
    """Largest difference (m; m/s) between a step of the stack's and each integrator, one tick from the same state.

    `sentence` says what was compared, or why nothing was; `x` and `v` are what the step is taken to be off by:
    the difference from DOP853, at least the rounding of the largest value.
    """

    sentence: str
    x: float
    v: float
    differences: Mapping[str, tuple[float, float]]
    ticks: int = 0  # compared
    changes: int = 0  # of these, the slave's in which DOP853 located a change of mode


def agreement(scene: Scene, trace: Mapping[str, Any], seed: int = 0) -> Agreement:
    """Compare the stack's steps from states of the run `trace` with integrators that locate every change of mode."""
    import numpy as np

    with np.errstate(all="ignore"):
        least = [2.0**-53 * float(np.nanmax(magnitude(trace[name]), initial=0.0)) for name in ("x_s", "v_s")]
    if not there():
        return Agreement(sentence="not compared: scipy is not installed", x=least[0], v=least[1], differences={})
    if inner(scene):
        from teleop.analysis.precision.reference.tight import one_tick

        return _said(*one_tick(scene, ticks_of(scene, trace), RADAU, seed), least)
    plants = exact_bodies(scene).slaves
    touches = [touch_of(plant, slave_of(scene)) for plant in plants]
    dt = scene.dt_ns / 1e9
    fastest = max(radians(touch, dt) for touch in touches)
    if fastest > MOST_RADIANS:
        return Agreement(sentence=f"not compared: the fastest mode goes through {fastest:.3g} rad in a tick, too many "
                         "for a step-by-step integrator", x=least[0], v=least[1], differences={})
    ticks = ticks_of(scene, trace)
    every: dict[str, list[tuple[float, float]]] = {}
    changes = 0
    for solver, some in (("DOP853", ticks), ("Radau", ticks[:: -(-len(ticks) // RADAU)])):
        found = [difference for axis, (plant, touch) in enumerate(zip(plants, touches, strict=True))
                 for difference in _slave(plant, touch, dt, trace, axis, some, solver)]
        changes = changes or sum(own[2] > 0 for own in found)  # DOP853's, which sees all the ticks
        found += _master(scene, trace, some[:RADAU], solver)
        every[solver] = [pair[:2] for pair in found]
    return _said(len(ticks), changes, every, least)


def _said(ticks: int, changes: int, every: Mapping[str, list[tuple[float, float]]], least: list[float]) -> Agreement:
    """What the differences of each integrator come to; NaN is one that gave up."""
    differences: dict[str, tuple[float, float]] = {}
    given_up = 0
    for solver, found in every.items():
        done = [pair for pair in found if all(map(isfinite, pair))]
        given_up += len(found) - len(done)
        if done:
            differences[solver] = max(x for x, _ in done), max(v for _, v in done)
    x, v = (max(a, b) for a, b in zip(differences.get("DOP853", (0.0, 0.0)), least, strict=True))
    sentence = f"{ticks} ticks ({changes} with a change of mode), one step each from the same state"
    if given_up:
        sentence += f" ({number_of(given_up, 'time')} an integrator gave up)"
    return Agreement(sentence=sentence, x=x, v=v, differences=differences, ticks=ticks, changes=changes)


def column(trace: Mapping[str, Any], name: str, axis: int) -> Any:
    """One axis of a column of the trace."""
    values = trace[name]
    return values if values.ndim == 1 else values[:, axis]


def ticks_of(scene: Scene, trace: Mapping[str, Any]) -> list[int]:
    """Ticks of the run to start from: where contact is made or lost, where the force is greatest, and between."""
    import numpy as np

    force = magnitude(trace["f_env"])
    ran = len(force)
    at = force > 0.0
    within = felt(scene, trace)[:-1] & ~at[:-1] & ~at[1:]  # made and lost again between two ticks
    changes = np.flatnonzero((at[1:] != at[:-1]) | within)
    some = changes[np.linspace(0, len(changes) - 1, min(CHANGES, len(changes))).astype(int)] if len(changes) else []
    evenly = np.linspace(0, ran - 1, min(OTHERS, ran)).astype(int)
    return sorted({int(k) for k in (*some, *evenly, int(force.argmax())) if np.isfinite(force[k])})


def _slave(plant: Plant, touch: Touch, dt: float, trace: Mapping[str, Any], axis: int, ticks: list[int],
           solver: str) -> Iterator[tuple[float, float, int]]:
    xs, vs, fs = (column(trace, name, axis) for name in ("x_s", "v_s", "f_s"))
    for k in ticks:
        x, v, f = float(xs[k]), float(vs[k]), float(fs[k])
        got, want = plant.move(plant.c, x, v, f), located(touch, dt, x, v, f, solver)
        yield abs(got[0] - want[0]), abs(got[1] - want[1]), want[2]


def _master(scene: Scene, trace: Mapping[str, Any], ticks: list[int], solver: str) -> list[tuple[float, float, int]]:
    """The same of the first axis' gripped master, in coordinates that move with the reference."""
    reference, dt = reference_samples(scene), scene.dt_ns / 1e9
    if reference is None:
        return []
    c, found = exact_bodies(scene).master, []
    touch = gripped_touch(Gripped(*c))
    for k in ticks:
        x, v, f = (float(column(trace, name, 0)[k]) for name in ("x_m", "v_m", "f_m"))
        r0, r1 = reference[0][k : k + 2]
        s = (r1 - r0) / dt
        y, w, _ = located(touch, dt, x - r0, v - s, -(f + touch.b * s), solver)
        got = move_gripped(c, x, v, f, r0, r1)
        found.append((abs(got[0] - (r1 + y)), abs(got[1] - (s + w)), 0))
    return found


def wobbled(scene: Scene, worth: Agreement, bodies: Bodies | None = None) -> Bodies:
    """The scene's own bodies, or others, every step put off by `worth.x` and `worth.v` in a fixed pattern of signs."""
    own = bodies or exact_bodies(scene)
    sign = _signs().__next__

    def off(move: Callable[..., tuple[Any, ...]]) -> Callable[..., tuple[Any, ...]]:
        def moved(*rest: Any) -> tuple[Any, ...]:
            x, v, *more = move(*rest)
            return x + sign() * worth.x, v + sign() * worth.v, *more

        return moved

    slaves: list[Any] = [plant._replace(move=off(plant.move)) for plant in own.slaves]
    if own.inner_m is not None:
        return own._replace(slaves=slaves, instead={**own.instead, "move_held": off(own.instead["move_held"])})
    return Bodies(own.master, slaves, {"move_gripped": off(move_gripped), "move_free": off(move_free)})


def _signs() -> Iterator[float]:
    """+1.0 and -1.0 as by a coin: a linear congruential generator's high bit, the same every time."""
    state = 1
    while True:
        state = (1103515245 * state + 12345) % (1 << 31)
        yield 1.0 if state >> 30 else -1.0
