"""The bodies of a scene moved by a fixed-step method, in place of the stack's own steps.

The method moves the slave and the gripped master. A body that is linear (in free space, bonded, or gripped) is a
matrix per sub-step for any of them; it is taken n times, since that is what sub-steps are. Bodies that are not
piecewise linear are those of `nonlinear`, bodies that remember those of `relaxed`.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from typing import Any

from teleop.errors import Refused, nearest, number_of
from teleop.physics.contact import WallStep, move_wall, wall_force
from teleop.physics.plant import Gripped, MassDamper, Plant, Sprung, linear_force, move_free, move_linear
from teleop.scene.scene import Scene
from teleop.simulation.bodies import Bodies, exact_bodies
from teleop.simulation.integrators import parts, relaxed
from teleop.simulation.integrators.methods import METHODS, IntegrationMethod, Touch, wall_coefficients
from teleop.simulation.integrators.nonlinear import ADVANCE, goes, held_stepped, move_stepped, stepped_force


def touch_of(plant: Plant, body: MassDamper) -> Touch:
    """The equation of `body` that an exact plant solves. Refused for plants that are none of teleop's own."""
    if plant.move is move_free:
        return Touch(body.mass, body.damping)
    if plant.move is move_linear:
        bond = Sprung(*plant.c)
        return Touch(body.mass, body.damping, bond.k, bond.d, 1.0, bond.at, -inf, -inf)
    if plant.move is move_wall:
        wall = WallStep(*plant.c)
        return Touch(wall.mass, wall.damping, wall.k, wall.d, wall.side, wall.at, 0.0, 0.0)
    raise Refused(
        f"no equation is known for an environment that moves by {plant.move.__name__}, so no fixed-step method can; "
        "take walls, bonded tissue, free space, Hunt-Crossley bodies, the standard linear solid, or these carried along"
    )


def stepped(method: IntegrationMethod, touch: Touch, dt: float, n: int) -> Plant:
    """A plant that moves by n sub-steps of `method` per tick of dt."""
    if touch.edge == 0.0:
        return Plant(method.move, wall_force, wall_coefficients(method, touch, dt / n, n))
    return Plant(move_repeated, linear_force, (touch.at, touch.k, touch.d, *sub_step(method, touch, dt / n), n))


def sub_step(method: IntegrationMethod, touch: Touch, h: float) -> tuple[float, ...]:
    """The matrix of one sub-step of a linear body, in the order of `LinearStep`: the method applied to unit vectors."""
    bond = touch._replace(side=1.0, at=0.0, edge=-inf, floor=-inf)
    c = wall_coefficients(method, bond, h, 1)
    first, second = zip(*(method.move(c, *unit)[:2] for unit in ((1, 0, 0), (0, 1, 0), (0, 0, 1))), strict=True)
    return (*map(float, first), *map(float, second))


def move_repeated(c: Any, x: float, v: float, f: float) -> tuple[float, float, int]:
    """Take the matrix of a linear body's sub-step n times; c is (at, k, d), `LinearStep`, n."""
    at, _, _, a11, a12, b1, a21, a22, b2, n = c
    q = x - at
    push, kick = b1 * f, b2 * f
    for _ in range(n):
        q, v = a11 * q + a12 * v + push, a21 * q + a22 * v + kick
    return at + q, v, 0


def gripped(n: int) -> Callable[..., tuple[float, float]]:
    """`move_gripped` by n sub-steps; its c is `Gripped` with the matrix of one sub-step in it."""

    def move(c: Any, x: float, v: float, f_m: float, r0: float, r1: float) -> tuple[float, float]:
        a11, a12, b1, a21, a22, b2, dt, b, _, _, _, _ = c
        s = (r1 - r0) / dt
        f = -(f_m + b * s)
        y, w, push, kick = x - r0, v - s, b1 * f, b2 * f
        for _ in range(n):
            y, w = a11 * y + a12 * w + push, a21 * y + a22 * w + kick
        return r1 + y, s + w

    return move


def method_bodies(scene: Scene, method: IntegrationMethod, n: int) -> Bodies:
    """The scene's bodies, moved by n sub-steps of `method` per tick. Refused as in `touch_of`."""
    return _moved_by(scene, method, n)._replace(method=f"{method.name}:{n}")


def _moved_by(scene: Scene, method: IntegrationMethod, n: int) -> Bodies:
    dt = scene.dt_ns / 1e9
    parts.check_no_servo(scene)
    exact = exact_bodies(scene)
    if not (goes(method) or parts.has_closed_form(scene)):
        raise Refused(f"{method.label} is not known on bodies that are not piecewise linear; take for example sdirk2")

    def moved(still: Plant, environment: Any) -> Plant:
        if (held := parts.core_of(still)) is not None:
            return Plant(move_stepped, stepped_force, (*held, ADVANCE[method.name], dt / n, n), ())
        if (branch := parts.relaxing_branch(still, environment, parts.slave_of(scene))) is not None:
            return still._replace(move=relaxed.bonded(relaxed.stepped(method, branch, dt, n)))
        return stepped(method, touch_of(still, parts.slave_of(scene)), dt, n)

    slaves = parts.rebuilt(scene, moved)
    if scene.master.friction > 0.0:
        move = held_stepped(exact.master[0][0], ADVANCE[method.name], dt, n)
        return exact._replace(slaves=slaves, instead={**exact.instead, "move_held": move},
                              inner_m=((),) * scene.axes, report_m=None)
    if scene.electrical is not None:
        move = relaxed.step_held(relaxed.stepped(method, parts.master_branch(scene), dt, n), dt, scene.master.damping)
        return exact._replace(slaves=slaves, instead={**exact.instead, "move_held": move})
    if scene.hand is None:
        body = Touch(scene.master.mass, scene.master.damping)
        master = stepped(method, body, dt, n)
        return Bodies((master.c,) * scene.axes, slaves, {"move_free": master.move})
    grip = Gripped(*exact.master[0])
    matrix = sub_step(method, Touch(grip.mass, grip.b, grip.k, grip.d), dt / n)
    return Bodies(((*matrix, *grip[6:]),) * scene.axes, slaves, {"move_gripped": gripped(n)})


EXACT = "exact"
FORM = "METHOD:N with N sub-steps a tick, for example semi_implicit_euler:40, or exact"
MOST_SUBSTEPS = 1_000_000  # of a tick; more is a slip of the keyboard


def bodies_of(scene: Scene, text: str) -> Bodies:
    """The bodies of `scene` as `text` says: `exact` for its own, or `METHOD:N` for a method of `METHODS`.

    A method goes by its name, or by a beginning of it that no other has, a hyphen for an underscore. Raises `Refused`,
    also where the method does not go with these bodies.
    """
    if text == EXACT:
        return exact_bodies(scene)
    name, colon, count = text.partition(":")
    method = _method(name, text)
    if not colon or not (count.isascii() and count.isdecimal()) or not 1 <= int(count) <= MOST_SUBSTEPS:
        raise Refused(f"bodies={text} does not say how many sub-steps a tick has, 1 to {MOST_SUBSTEPS}; write for "
                      f"example {method.name}:40")
    if any(isinstance(getattr(scene, name), tuple) for name in ("master", "slave", "hand")):
        raise Refused(f"bodies={text} moves bodies that are the same on every axis, and scene {scene.name} has some "
                      "for each; leave bodies out, which moves them exactly, or take a scene with one for all axes")
    return method_bodies(scene, method, int(count))


def _method(name: str, text: str) -> IntegrationMethod:
    wanted = name.replace("-", "_")
    methods = [m for m in METHODS if m.name == wanted] or [m for m in METHODS if wanted and m.name.startswith(wanted)]
    if len(methods) == 1:
        return methods[0]
    raise Refused(f"bodies={text} names no integrator; write {FORM}; {nearest(wanted, [m.name for m in METHODS])}")


def method_note(bodies: Bodies) -> list[str]:
    """The note on a run whose bodies did not move by the scene's own steps."""
    if not bodies.method:
        return []
    name, _, count = bodies.method.partition(":")
    label = next(m.label for m in METHODS if m.name == name)
    return [f"the bodies moved by {label}, {number_of(int(count), 'sub-step')} a tick, in place of the exact steps: "
            f"the figures have the error of that method"]
