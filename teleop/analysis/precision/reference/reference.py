"""The reference for bodies without a closed form: a tick by scipy, tight, with every change of mode located.

A body in one axis, at depth p in what it touches and with speed u against it, as in `teleop/physics/sdirk.py`:

    p' = u,    m u' = f - b u - g(p, u) - fc Sgn(u + s).

Where g or friction changes its law, which a step-by-step integrator must not step across, the motion is cut into
pieces. A piece is *outside*, in *contact*, or *inside* but drawn out too fast to be followed; and it slides one way
or the other, or sticks. What ends it falls through zero there: p, `k p + d u` of a wall, `1 + lam u` of a
Hunt-Crossley body, the speed over the ground, or what friction has left to hold with. Such an instant is bracketed
on the cubic through a step's ends and polished by Newton's method on integrations that end there, since an
interpolation is only so exact. Nothing of the stack's own integration is used: neither its stages nor its steps.

Bodies with a closed form keep it; a tick that touches nothing and slides one way does too. Beside each step the
stack's own is taken from the same state, so that the two are compared at every tick of a run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import cycle
from math import hypot, isfinite, nan, sqrt
from typing import Any, NamedTuple

from teleop.analysis.precision.reference.deviation import Steps
from teleop.physics.contact import advance
from teleop.physics.plant import Plant
from teleop.physics.sdirk import BOND, HUNT_CROSSLEY, NOTHING, WALL, Core
from teleop.scene.scene import Scene
from teleop.simulation.bodies import Bodies, exact_bodies
from teleop.simulation.integrators.parts import core_of, rebuilt

TIGHT = {"DOP853": 3e-14, "Radau": 1e-13}  # rtol; less is rounding
ROUNDING = 1e-14  # relative
MOST_EVENTS = 64  # changes of mode followed in one tick
OUTSIDE, CONTACT, INSIDE = range(3)
ACROSS, FOLLOW, STOP, BREAK = range(4)  # what ends a piece: p = 0, g = 0, the speed, the hold of friction


class Settled(NamedTuple):
    """Depth and speed after a tick, and the number of changes of mode located; NaN where the integrator gave up."""

    p: float
    u: float
    changes: int


class Exit(NamedTuple):
    """A quantity that ends a piece where it falls through zero: `value(p, u, a)` gives it and its rate of change."""

    value: Callable[[float, float, float], tuple[float, float]]
    kind: int
    then: int  # the touch that follows; of BREAK, the way that it slides


class Piece(NamedTuple):
    """Smooth piece of the motion: its equation, its touch, and the way it slides (0: it sticks, if fc > 0)."""

    core: Core
    touch: int
    way: int
    f: float
    s: float

    def rate(self, _: float, y: Any) -> tuple[float, float]:
        """Rates (p', u')."""
        p, u = y
        return u, self.pull(p, u)

    def pull(self, p: float, u: float) -> float:
        """The acceleration."""
        _, m, b, _, _, _, _, fc = self.core
        if fc > 0.0 and self.way == 0:
            return 0.0
        return (self.f - b * u - self.push(p, u) - self.way * fc) / m

    def push(self, p: float, u: float) -> float:
        """g, continued smoothly beyond the ends of the piece."""
        kind, _, _, k, d, n, lam, _ = self.core
        if self.touch != CONTACT:
            return 0.0
        if kind != HUNT_CROSSLEY:
            return k * p + d * u
        return k * p**n * (1.0 + lam * u) if p > 0.0 else 0.0

    def slopes(self, p: float, u: float) -> tuple[float, float]:
        """Dg/dp and dg/du."""
        kind, _, _, k, d, n, lam, _ = self.core
        if self.touch != CONTACT:
            return 0.0, 0.0
        if kind != HUNT_CROSSLEY:
            return k, d
        return (n * k * p ** (n - 1.0) * (1.0 + lam * u), lam * k * p**n) if p > 0.0 else (0.0, 0.0)

    def jacobian(self, _: float, y: Any) -> list[list[float]]:
        """Jacobian of `rate`."""
        _, m, b, _, _, _, _, fc = self.core
        if fc > 0.0 and self.way == 0:
            return [[0.0, 1.0], [0.0, 0.0]]
        stiff, damp = self.slopes(*y)
        return [[0.0, 1.0], [-stiff / m, -(b + damp) / m]]

    def left_over(self, p: float) -> float:
        """The force that friction has to hold against, at rest on the ground."""
        return self.f + self.core[2] * self.s - self.push(p, -self.s)

    def exits(self) -> list[Exit]:
        """List the exits that may end it."""
        kind, _, _, k, d, _, lam, fc = self.core
        exits = []
        if kind in (WALL, HUNT_CROSSLEY):
            if self.touch == OUTSIDE:
                exits.append(Exit(lambda p, u, _: (-p, -u), ACROSS, CONTACT))
            elif self.touch == INSIDE or kind == HUNT_CROSSLEY or d == 0.0:
                exits.append(Exit(lambda p, u, _: (p, u), ACROSS, OUTSIDE))
            if self.touch != OUTSIDE and (d if kind == WALL else lam) > 0.0:
                sign, then = (1.0, INSIDE) if self.touch == CONTACT else (-1.0, CONTACT)
                exits.append(Exit(
                    (lambda p, u, a: (sign * (k * p + d * u), sign * (k * u + d * a))) if kind == WALL
                    else (lambda _, u, a: (sign * (1.0 + lam * u), sign * lam * a)), FOLLOW, then))
        if fc > 0.0 and self.way != 0:
            exits.append(Exit(lambda _, u, a: (self.way * (u + self.s), self.way * a), STOP, self.touch))
        elif fc > 0.0:
            exits += [Exit(self.hold(1), BREAK, 1), Exit(self.hold(-1), BREAK, -1)]
        return exits

    def hold(self, way: int) -> Callable[[float, float, float], tuple[float, float]]:
        """The force that friction has left against a start one way; slightly more, so that the body does start then."""
        fc = self.core[7] + ROUNDING * (self.core[7] + abs(self.f))
        return lambda p, u, _: (fc - way * self.left_over(p), way * self.slopes(p, u)[0] * u)


def settle(core: Core, p: float, u: float, f: float, s: float, dt: float, solver: str, rtol: float | None = None
           ) -> Settled:
    """Depth and speed after dt, by `solver` (DOP853 or Radau), `rtol` left out at its tightest. It takes 0.2 ms to 1 s.

    What touches nothing and provably slides one way, and what sticks to the ground, takes the closed form.
    """
    if not isfinite(abs(p) + abs(u) + abs(f) + abs(s)):
        return Settled(nan, nan, 0)
    piece, left = _begun(core, p, u, f, s), dt
    for changes in range(MOST_EVENTS):
        if s == 0.0 and core[7] > 0.0 and piece.way == 0:
            return Settled(p, u, changes)
        if piece.touch == OUTSIDE and (free := _free(piece, p, u, left)) is not None:
            return Settled(*free, changes)
        t, p, u, which = _first_exit(piece, p, u, left, solver, rtol or TIGHT[solver])
        if which is None or not isfinite(p):
            return Settled(p, u, changes)
        left -= t
        if which.kind == ACROSS:
            p = 0.0
        if which.kind == STOP:
            u = 0.0 - s
        piece = _next(piece, which, p, u)
    return Settled(nan, nan, MOST_EVENTS)


def _begun(core: Core, p: float, u: float, f: float, s: float) -> Piece:
    """The piece that a tick begins in. At p = 0 the speed decides, and at rest there the force."""
    kind, _, b, k, d, _, lam, fc = core
    touch = OUTSIDE
    if kind == BOND:
        touch = CONTACT
    elif kind != NOTHING and p > 0.0:
        touch = CONTACT if (k * p + d * u if kind == WALL else 1.0 + lam * u) > 0.0 else INSIDE
    elif kind != NOTHING and p == 0.0:
        held = fc if u + s == 0.0 else 0.0
        touch = CONTACT if u > 0.0 or (u == 0.0 and f - b * u > held) else OUTSIDE
    return _stick_or_slide(Piece(core, touch, (u + s > 0.0) - (u + s < 0.0), f, s), p, u)


def _stick_or_slide(piece: Piece, p: float, u: float) -> Piece:
    """The piece of a body at rest on the ground: the force decides if it sticks, or which way it slides."""
    fc = piece.core[7]
    if fc == 0.0:
        return piece._replace(way=0)
    if u + piece.s != 0.0:
        return piece
    over = piece.left_over(p)
    return piece._replace(way=(over > fc) - (over < -fc))


def _next(piece: Piece, which: Exit, p: float, u: float) -> Piece:
    """The piece that follows on an exit."""
    if which.kind == BREAK:
        return piece._replace(way=which.then)
    after = piece._replace(touch=which.then)
    return _stick_or_slide(after, p, u) if which.kind == STOP or piece.way == 0 else after


def _free(piece: Piece, p: float, u: float, span: float) -> tuple[float, float] | None:
    """Depth and speed after `span` outside, if the body provably touches nothing and slides one way; else None.

    Its speed is monotone: it keeps its sign if both ends do, and p is largest at an end unless u turns from in to out.
    """
    kind, m, b, _, _, _, _, fc = piece.core
    p1, u1 = advance(m, b, 0.0, piece.f - piece.way * fc, p, u, span)
    turned = piece.way * (u1 + piece.s) < 0.0 or (fc > 0.0 and piece.way == 0)
    if turned or (kind != NOTHING and not (p1 < 0.0 and (u <= 0.0 or u1 >= 0.0))):
        return None
    return p1, u1


def _first_exit(piece: Piece, p: float, u: float, span: float, solver: str, rtol: float
           ) -> tuple[float, float, float, Exit | None]:
    """Time within `span` at which the piece ends, the state there, and the exit; `span` and None if it lasts."""
    exits = piece.exits()
    a = piece.pull(p, u)
    before = 0.0
    tolerance = _tolerance(piece, p, u, span, rtol)
    for t, q, w in _steps(piece, p, u, span, solver, tolerance):
        a1, first = piece.pull(q, w), None
        for one in exits:
            guess = _falls(*one.value(p, u, a), *one.value(q, w, a1), t - before)
            if guess is None:
                continue
            root = _polished(piece, one, p, u, guess, t - before, solver, tolerance, sure=one.value(q, w, a1)[0] < 0.0)
            if root is not None and (first is None or root[0] < first[0]):
                first = (*root, one)
        if first is not None:
            return before + first[0], *first[1:]
        before, p, u, a = t, q, w, a1
    return (span, p, u, None) if before == span else (span, nan, nan, None)


def _tolerance(piece: Piece, p: float, u: float, span: float, rtol: float) -> dict[str, Any]:
    """The solver's tolerances: relative to the largest speed that the energy at hand could make, and its distance."""
    m = piece.core[1]
    stiff, damp = piece.slopes(p, u)
    brief = 1.0 / max(sqrt(max(stiff, 0.0) / m), damp / m, 1.0 / span)
    speed = hypot(u, p / brief if stiff > 0.0 else 0.0) + abs(piece.f) / m * brief
    return {"rtol": rtol, "atol": (0.1 * rtol * speed * brief + 1e-30, 0.1 * rtol * speed + 1e-30)}


def _steps(piece: Piece, p: float, u: float, span: float, solver: str, tolerance: dict[str, Any]
           ) -> Iterator[tuple[float, float, float]]:
    """The solver's steps as (t, p, u); they end before `span` where it gives up."""
    from scipy.integrate import DOP853, Radau

    if span <= 0.0:
        return
    options: Any = {"jac": piece.jacobian} if solver == "Radau" else {}
    kind = Radau if solver == "Radau" else DOP853
    running = kind(piece.rate, 0.0, (p, u), span, **tolerance, **options)
    while running.status == "running":
        running.step()
        if running.status == "failed":
            return
        yield float(running.t), float(running.y[0]), float(running.y[1])


def _falls(e0: float, d0: float, e1: float, d1: float, h: float) -> float | None:
    """Time at which the cubic through both ends of a step first falls through zero from above, or None.

    A value that is not above zero at the start is rounding of an event that just was; it counts if it rises first.
    """
    if e0 > 0.0 < e1 and (d0 >= 0.0 or d1 <= 0.0):
        return None
    # e0 + d0 t + c2 t^2 + c3 t^3
    mean = (e1 - e0) / h
    c2, c3 = (3.0 * mean - 2.0 * d0 - d1) / h, (d0 + d1 - 2.0 * mean) / (h * h)

    def cubic(t: float) -> float:
        return e0 + t * (d0 + t * (c2 + t * c3))

    turns = [0.0, *sorted(t for t in _roots(3.0 * c3, 2.0 * c2, d0) if 0.0 < t < h), h]
    values = [max(e0, 0.0), *map(cubic, turns[1:-1]), e1]
    for i in range(len(turns) - 1):
        if values[i] >= 0.0 > values[i + 1]:
            low, high = turns[i], turns[i + 1]
            for _ in range(60):
                t = 0.5 * (low + high)
                low, high = (t, high) if cubic(t) >= 0.0 else (low, t)
            return high
    return None


def _roots(a: float, b: float, c: float) -> Iterator[float]:
    """Roots of a t^2 + b t + c."""
    under = b * b - 4.0 * a * c
    if under < 0.0:
        return
    q = -0.5 * (b + (sqrt(under) if b >= 0.0 else -sqrt(under)))
    yield from (top / low for top, low in ((q, a), (c, q)) if low != 0.0)


def _polished(piece: Piece, one: Exit, p: float, u: float, t: float, h: float, solver: str, tolerance: dict[str, Any],
              *, sure: bool) -> tuple[float, float, float] | None:
    """The instant of an exit and the state there, by Newton's method from t; None if it only comes near one."""
    low, high = 0.0, h
    for _ in range(60):
        _, q, w = list(_steps(piece, p, u, t, solver, tolerance))[-1] if t > 0.0 else (t, p, u)
        a = piece.pull(q, w)
        e, slope = one.value(q, w, a)
        low, high = (t, high) if e >= 0.0 else (low, t)
        new = t - e / slope if slope < 0.0 else 0.5 * (low + high) if sure else -1.0
        if not isfinite(new) or not low <= new <= high:
            if not sure:
                return None
            new = 0.5 * (low + high)
        if abs(new - t) <= 1e-15 * h or abs(e) <= -1e-15 * slope * t:
            return t, q, w
        t = new
    return (t, q, w) if sure else None


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

    def beside(
        solver_step: Callable[..., Found], stack_step: Move, state: tuple[Any, ...], z: Any
    ) -> tuple[Found, Any]:
        """The solver's step, and the inner state after the stack's own, which is counted."""
        if tell is not None:
            tell()
        exact, after = solver_step(*state), stack_step(z)
        steps.add(after[:2], exact[:2], changed=exact[2] > 0, integrated=after[-1] is not z)
        return exact, after[-1]

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
        stack_state = still.start

        def by_solver(x: float, v: float, f: float, s: float) -> Found:
            p, u, changes = settle(core, side * (x - at), side * v, side * f, side * s, dt, solver, rtol)
            return at + side * p, side * u, changes

        def move(_: Any, x: float, v: float, f: float, z: Any, s: float = 0.0) -> tuple[Any, ...]:
            nonlocal stack_state
            (x1, v1, _), stack_state = watch(
                by_solver, lambda state: still.move(still.c, x, v, f, state, s), (x, v, f, s), stack_state)
            return x1, v1, 0, z

        return still._replace(move=move, report=None)

    slaves = rebuilt(scene, moved)
    if scene.master.friction == 0.0:
        return exact._replace(slaves=slaves)
    core, b, stock = exact.master[0][0], scene.master.damping, exact.instead["move_held"]
    inner = cycle([[each] for each in exact.inner_m])

    def hold_by_solver(x: float, v: float, f_m: float, r0: float, r1: float) -> Found:
        s = (r1 - r0) / dt
        y, w, changes = settle(core, x - r0, v - s, -(f_m + b * s), s, dt, solver, rtol)
        return r1 + y, s + w, changes

    def move_held(c: Any, x: float, v: float, f_m: float, r0: float, r1: float, z: Any) -> tuple[float, float, Any]:
        axis, state = next(inner), (x, v, f_m, r0, r1)
        (x1, v1, _), axis[0] = watch(hold_by_solver, lambda z: stock(c, *state, z), state, axis[0])
        return x1, v1, z

    return exact._replace(slaves=slaves, instead={**exact.instead, "move_held": move_held}, report_m=None)
