"""The bodies of a scene by scipy at its tightest, every change of mode located (`reference`), and their states.

Bodies with a closed form keep it where others do not; a tick that touches nothing and slides one way does too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from teleop.analysis.precision.reference.located import gripped_touch, located
from teleop.analysis.precision.reference.reference import TIGHT, settle
from teleop.physics.plant import Gripped, Plant
from teleop.simulation.bodies import Bodies, exact_bodies
from teleop.simulation.integrators import relaxed
from teleop.simulation.integrators.parts import (
    core_of,
    master_branch,
    rebuilt,
    relaxing_branch,
    slave_of,
    stills,
)
from teleop.simulation.integrators.stepped import touch_of
from teleop.simulation.virtual import run

if TYPE_CHECKING:
    from teleop.scene.scene import Scene

Move = Callable[..., tuple[Any, ...]]
Found = tuple[float, float, int]  # position, speed, changes of mode located
LONG = {"DOP853": 3e-14, "Radau": 1e-12}  # rtol over a whole run: Radau's steps are too many at its tightest


def reference_bodies(
    scene: Scene, solver: str, tell: Callable[[], None] | None = None, *, every: bool = False
) -> Bodies:
    """The scene's bodies, those without a closed form moved by `solver` at `LONG`; `every`: the walls too.

    `tell` is called before each tick of such a body.
    """
    exact = exact_bodies(scene)

    def moved(still: Plant, environment: Any) -> Plant:
        if core_of(still) is None and not (every and still.start is None):
            return still
        other = slave_by(scene, still, environment, solver, LONG[solver])

        def move(_: Any, x: float, v: float, f: float, z: Any = None, s: float = 0.0) -> tuple[Any, ...]:
            if tell is not None:
                tell()
            x, v, _ = other(x, v, f, z, s)
            return (x, v, 0) if still.start is None else (x, v, 0, z)

        return still._replace(move=move, report=None)

    slaves = rebuilt(scene, moved)
    if scene.master.friction == 0.0:
        return exact._replace(slaves=slaves)
    held = master_by(scene, solver, LONG[solver])

    def move_held(_: Any, x: float, v: float, f_m: float, r0: float, r1: float, z: Any) -> tuple[float, float, Any]:
        if tell is not None:
            tell()
        return *held(x, v, f_m, r0, r1, z)[:2], z

    return exact._replace(slaves=slaves, instead={**exact.instead, "move_held": move_held}, report_m=None)


def slave_by(scene: Scene, still: Plant, environment: Any, solver: str, rtol: float | None = None
             ) -> Callable[..., Found]:
    """How `solver` moves the slave beside an environment at rest: (x, v, f, z, s) -> `Found`."""
    dt, body = scene.dt_ns / 1e9, slave_of(scene)
    if (own := core_of(still)) is not None:
        side, at, core = own

        def move(x: float, v: float, f: float, _: Any = None, s: float = 0.0) -> Found:
            p, u, changes = settle(core, side * (x - at), side * v, side * f, side * s, dt, solver, rtol)
            return at + side * p, side * u, changes

        return move
    if (branch := relaxing_branch(still, environment, body)) is not None:
        steps, at = relaxed.solved(branch, dt, solver, TIGHT[solver], 1e-17), environment.at
        return lambda x, v, f, z=None, _=0.0: (at + (found := steps(x - at, v, z[0], f))[0], found[1], 0)
    touch = touch_of(still, body)
    return lambda x, v, f, *_: located(touch, dt, x, v, f, solver)


def master_by(scene: Scene, solver: str, rtol: float | None = None) -> Callable[..., Found]:
    """How `solver` moves the master: (x, v, f_m, r0, r1, z) -> `Found`, in coordinates that move with the reference."""
    c, dt, b = exact_bodies(scene).master, scene.dt_ns / 1e9, scene.master.damping
    if scene.electrical is not None:
        held = relaxed.held(relaxed.solved(master_branch(scene), dt, solver, TIGHT[solver], 1e-17), dt, b)
        return lambda *state: (*held(None, *state)[:2], 0)
    touch = gripped_touch(Gripped(*c)) if scene.master.friction == 0.0 else None

    def move(x: float, v: float, f_m: float, r0: float, r1: float, _: Any = None) -> Found:
        s = (r1 - r0) / dt
        f = -(f_m + b * s)
        if touch is not None:
            y, w, changes = located(touch, dt, x - r0, v - s, f, solver)
        else:
            y, w, changes = settle(c[0], x - r0, v - s, f, s, dt, solver, rtol)
        return r1 + y, s + w, changes

    return move


def one_tick(scene: Scene, ticks: Sequence[int], radau: int, seed: int
             ) -> tuple[int, int, dict[str, list[tuple[float, float]]]]:
    """From the states of the run at `ticks` one step of the stack's own beside each integrator's; Radau's of `radau`.

    How many ticks, in how many of them a change of mode was located, and the differences (m; m/s).
    """
    watched, pairs = states(scene, frozenset(ticks), seed)
    every: dict[str, list[tuple[float, float]]] = {"DOP853": [], "Radau": []}
    changed = set()
    for own, other in pairs:
        at = sorted(watched[own])
        for solver, some in (("DOP853", at), ("Radau", at[:: -(-len(at) // radau)])):
            move = other(solver)
            for k in some:
                state, got = watched[own][k]
                x, v, changes = move(*state)
                every[solver].append((abs(got[0] - x), abs(got[1] - v)))
                if changes:
                    changed.add(k)
    return len(ticks), len(changed), every


State = tuple[tuple[Any, ...], tuple[Any, ...]]  # what a body's move was given after c, and what it gave
Integrator = Callable[..., Callable[..., Found]]  # (solver, rtol)


def states(scene: Scene, ticks: frozenset[int], seed: int
           ) -> tuple[dict[str, dict[int, State]], Iterator[tuple[str, Integrator]]]:
    """The states of every body at some ticks of the scene's own run, by body; and how a solver moves each of them."""
    watched: dict[str, dict[int, State]] = {}

    def watch(name: str, move: Move) -> Move:
        kept = watched.setdefault(name, {})
        k = -1

        def moved(c: Any, *state: Any) -> tuple[Any, ...]:
            nonlocal k
            k += 1
            got = move(c, *state)
            if k in ticks:
                kept[k] = state, got
            return got

        return moved

    axes = iter(range(scene.axes))
    slaves = rebuilt(scene, lambda still, _: still._replace(move=watch(f"slave {next(axes)}", still.move)))
    own = exact_bodies(scene)
    instead = dict(own.instead)
    if scene.axes == 1 and (scene.hand is not None or own.inner_m is not None):
        from teleop.physics.plant import move_gripped

        name = "move_gripped" if own.inner_m is None else "move_held"
        instead[name] = watch("master", instead.get(name, move_gripped))
    run(scene, seed=seed, bodies=own._replace(slaves=slaves, instead=instead))

    def pairs() -> Iterator[tuple[str, Integrator]]:
        for axis, (still, environment) in enumerate(stills(scene)):
            yield f"slave {axis}", partial(slave_by, scene, still, environment)
        if "master" in watched:
            yield "master", partial(master_by, scene)

    return watched, pairs()
