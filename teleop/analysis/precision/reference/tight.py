"""Bodies without a closed form, moved by scipy at its tightest, every change of mode located (`reference`).

Bodies with a closed form keep it; a tick that touches nothing and slides one way does too. Beside each step the
stack's own is taken from the same state, so that the two are compared at every tick of a run.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import cycle
from typing import TYPE_CHECKING, Any

from teleop.analysis.precision.reference.reference import settle
from teleop.analysis.precision.reference.steps import Steps
from teleop.physics.plant import Plant
from teleop.simulation.bodies import Bodies, exact_bodies
from teleop.simulation.integrators.parts import core_of, rebuilt

if TYPE_CHECKING:
    from teleop.scene.scene import Scene

Move = Callable[..., tuple[Any, ...]]
Found = tuple[float, float, int]  # position, speed, changes of mode located
Watch = Callable[[Callable[..., Found], Move, tuple[Any, ...], Any], tuple[Found, Any]]
LONG = {"DOP853": 3e-14, "Radau": 1e-12}  # rtol over a whole run: Radau's steps are too many at its tightest


def reference_bodies(scene: Scene, solver: str, *, rtol: float | None = None, steps: Steps | None = None,
                     tell: Callable[[], None] | None = None) -> Bodies:
    """The scene's bodies, those without a closed form moved by `solver`; its `rtol`, left out, is that of `LONG`.

    `steps` counts the stack's own steps beside them; `tell` is called before each of them.
    """
    steps = Steps() if steps is None else steps

    def beside(other: Callable[..., Found], own: Move, state: tuple[Any, ...], z: Any) -> tuple[Found, Any]:
        """The solver's step, and the inner state after the stack's own, which is counted."""
        if tell is not None:
            tell()
        found, mine = other(*state), own(z)
        steps.add(mine[:2], found[:2], changed=found[2] > 0, integrated=mine[-1] is not z)
        return found, mine[-1]

    return bodies_moved(scene, solver, rtol or LONG[solver], beside)


def bodies_moved(scene: Scene, solver: str, rtol: float, watch: Watch) -> Bodies:
    """The scene's bodies, those without a closed form moved as `watch` answers.

    It is given how `solver` moves a body, how the stack does from an inner state, what the solver's function takes,
    and the stack's inner state; it returns `Found` and that state after the tick.
    """
    exact, dt = exact_bodies(scene), scene.dt_ns / 1e9

    def moved(still: Plant, _: Any) -> Plant:
        if (equation := core_of(still)) is None:
            return still
        side, at, core = equation
        own = still.start

        def by_solver(x: float, v: float, f: float, s: float) -> Found:
            p, u, changes = settle(core, side * (x - at), side * v, side * f, side * s, dt, solver, rtol)
            return at + side * p, side * u, changes

        def move(_: Any, x: float, v: float, f: float, z: Any, s: float = 0.0) -> tuple[Any, ...]:
            nonlocal own
            (x1, v1, _), own = watch(by_solver, lambda own: still.move(still.c, x, v, f, own, s), (x, v, f, s), own)
            return x1, v1, 0, z

        return still._replace(move=move, report=None)

    slaves = rebuilt(scene, moved)
    if scene.master.friction == 0.0:
        return exact._replace(slaves=slaves)
    core, b, stock = exact.master[0][0], scene.master.damping, exact.instead["move_held"]
    inner = cycle([[each] for each in exact.inner_m])

    def held(x: float, v: float, f_m: float, r0: float, r1: float) -> Found:
        s = (r1 - r0) / dt
        y, w, changes = settle(core, x - r0, v - s, -(f_m + b * s), s, dt, solver, rtol)
        return r1 + y, s + w, changes

    def move_held(c: Any, x: float, v: float, f_m: float, r0: float, r1: float, z: Any) -> tuple[float, float, Any]:
        own, state = next(inner), (x, v, f_m, r0, r1)
        (x1, v1, _), own[0] = watch(held, lambda z: stock(c, *state, z), state, own[0])
        return x1, v1, z

    return exact._replace(slaves=slaves, instead={**exact.instead, "move_held": move_held}, report_m=None)
