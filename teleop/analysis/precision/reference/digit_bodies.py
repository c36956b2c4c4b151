"""The reference where every body has a closed form: the scene's run with its bodies moved in 40 digits (`digits`).

Law, link and stages are the same lines in the same floats as in every run, so what is measured against it is what the
integration of the bodies does, and nothing else.
"""

from __future__ import annotations

from decimal import Decimal
from itertools import cycle
from math import hypot, pi
from typing import TYPE_CHECKING, Any

from teleop.analysis.precision.reference.digits import DIGITS, ONE, Body, Linear, Motion
from teleop.analysis.precision.reference.steps import Steps
from teleop.physics.plant import Plant, move_free, move_gripped
from teleop.simulation.bodies import Bodies, exact_bodies
from teleop.simulation.integrators.parts import is_carried, relaxing_branch, slave_of, stills
from teleop.simulation.integrators.stepped import touch_of
from teleop.simulation.metrics import magnitude
from teleop.simulation.virtual import run

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from teleop.scene.scene import Scene
    from teleop.simulation.result import Result

Moved = tuple[Bodies, list[Body], list[Body]]


def run_in_digits(scene: Scene, seed: int, tell: Callable[[], None] | None = None, digits: int = DIGITS
                  ) -> tuple[Result, Mapping[str, float], Steps]:
    """The run, its own error (m; N) by column, and the stack's single steps beside its own.

    Its error is what rounding to floats makes of the columns: with more digits it is the same run. `tell` is called
    before each tick of each body.
    """
    steps = Steps()
    bodies, slaves, masters = digit_bodies(scene, steps, tell, digits)
    result = run(scene, seed=seed, bodies=bodies)
    return result, {
        "x_s": hypot(*(body.rounding for body in slaves)), "x_m": hypot(*(body.rounding for body in masters)),
        "f_env": _force_rounding(result.trace["f_env"], slaves),
    }, steps


def _force_rounding(column: Any, slaves: list[Body]) -> float:
    """The largest difference (N) between a run's force on the environment and that of the motion in all its digits."""
    import numpy as np

    forces = np.array([body.forces for body in slaves]).T[: len(column) - 1]
    off = magnitude(column[1 : len(forces) + 1].reshape(forces.shape) - forces)
    return float(np.nanmax(off, initial=0.0))


def digit_bodies(scene: Scene, steps: Steps, tell: Callable[[], None] | None = None, digits: int = DIGITS) -> Moved:
    """The scene's bodies moved in `digits` digits; the slave and the master of each axis among them.

    Beside each step the stack's own is taken from the same floats, and counted in `steps`. Refused where no equation
    is known of what the slave touches.
    """
    own = exact_bodies(scene)
    slaves, plants = [], []
    for plant, (still, environment) in zip(own.slaves, stills(scene), strict=True):
        motion = slave_motion(scene, still, environment)
        slaves.append(Body(motion, scene.dt_ns, digits))
        plants.append(_plant(plant, slaves[-1], Body(motion, scene.dt_ns, digits), steps, tell))
    masters, name, move = _master(scene, own, digits, steps)
    return own._replace(slaves=plants, instead={**own.instead, name: move}), slaves, masters


def slave_motion(scene: Scene, still: Plant, environment: Any) -> Motion:
    """The slave's equation beside an environment at rest."""
    body = slave_of(scene)
    if relaxing_branch(still, environment, body) is not None:
        m, b, k, k1, tau = map(Decimal, (body.mass, body.damping, environment.k, environment.k1, environment.tau))
        return Motion(Linear(m, b, k, ONE, k1 * tau, tau), b, Decimal(environment.at))
    touch = touch_of(still, body)
    m, b, k, d, side, at = map(Decimal, touch[:6])
    wall = d if touch.edge == 0.0 else None
    return Motion(Linear(m, b + d, k), b, at, side, wall)


def _plant(plant: Plant, body: Body, single: Body, steps: Steps, tell: Callable[[], None] | None
           ) -> Plant:
    """`plant` moved as `body`; `single` takes the same steps from floats, to compare the plant's own with."""
    carried = is_carried(plant)
    path = plant.c[1] if carried else None

    def move(c: Any, x: float, v: float, f: float, *inner: Any) -> tuple[Any, ...]:
        if tell is not None:
            tell()
        z, = inner or ((),)
        k, memory = (z[0], z[1:]) if carried else (0, z)
        r0, r1 = path[k : k + 2] if path is not None else (0.0, 0.0)
        state = (x, v, f, *(memory or (0.0,)), r0, r1)
        single.returned = ()
        steps.add(plant.move(c, x, v, f, *inner)[:2], single.move(*state)[:2], changed=single.changes > 0)
        x, v, phi = body.move(*state)
        after = (*((k + 1,) if carried else ()), *((phi,) if memory else ()))
        return (x, v, 0, after) if inner else (x, v, 0)

    return plant._replace(move=move)


def master_motion(scene: Scene) -> Motion:
    """The master's equation in the frame of what the hand follows."""
    hand, shunt = scene.hand, scene.electrical
    m, b = Decimal(scene.master.mass), Decimal(scene.master.damping)
    m_h, k, d = map(Decimal, (hand.mass, hand.k, hand.d) if hand is not None else (0.0, 0.0, 0.0))
    if shunt is None:
        return Motion(Linear(m + m_h, b + d, k), b)
    b_e, tau = Decimal(shunt.b), Decimal(1.0 / (2.0 * pi * shunt.cutoff))
    return Motion(Linear(m + m_h, b + d + b_e, k, -b_e, ONE, tau), b, turned=True)


def _master(scene: Scene, own: Bodies, digits: int, steps: Steps) -> tuple[list[Body], str, Callable[..., Any]]:
    """The masters, the name of the function that moves them, and that function; the axes take turns in it."""
    motion = master_motion(scene)
    bodies = [Body(motion, scene.dt_ns, digits) for _ in range(scene.axes)]
    single, turn = Body(motion, scene.dt_ns, digits), cycle(bodies)
    name, stock = ("move_held", None) if own.inner_m else (
        ("move_free", move_free) if scene.hand is None else ("move_gripped", move_gripped))
    step: Any = own.instead.get(name, stock)

    def move(c: Any, x: float, v: float, f: float, *rest: Any) -> tuple[Any, ...]:
        r0, r1 = rest[:2] or (0.0, 0.0)
        z = rest[2][0] if name == "move_held" else 0.0
        state = x, v, f if name == "move_free" else -f, z, r0, r1
        single.returned = ()
        steps.add(step(c, x, v, f, *rest)[:2], single.move(*state)[:2], changed=False)
        x, v, z = next(turn).move(*state)
        return (x, v, (z,)) if name == "move_held" else (x, v, 0) if name == "move_free" else (x, v)

    return bodies, name, move
