"""Bodies with a closed form, their equations solved in 40 decimal digits.

From one change of contact to the next each body obeys

    m x'' + c x' + k x + g z = f,        tau z' = h x' - z        (g = 0 without an inner state)

as in `teleop/physics/relaxing.py`. The matrix exponential is a Taylor series, scaled and squared (Moler & Van Loan,
SIAM Rev. 45, 2003, method 3); the instant of a change of contact is bracketed and found by Newton's method. Position
and velocity keep their digits from tick to tick; what a law reads of them is rounded to floats. Nothing of the
stack's own steps is used.

In the reference law, link and stages are the same lines in the same floats as in every run, so what is measured
against it is what the integration of the bodies does, and nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from decimal import MAX_EMAX, MIN_EMIN, ROUND_HALF_EVEN, Context, Decimal, getcontext, localcontext
from itertools import cycle
from math import hypot, isfinite, nan, pi, sqrt
from typing import Any, NamedTuple

import numpy as np

from teleop.analysis.precision.reference.deviation import Steps
from teleop.physics.plant import Plant, move_free, move_gripped
from teleop.scene.scene import Scene
from teleop.simulation.bodies import Bodies, exact_bodies
from teleop.simulation.integrators.parts import is_carried, relaxing_branch, slave_of, stills
from teleop.simulation.integrators.stepped import touch_of
from teleop.simulation.metrics import magnitude
from teleop.simulation.result import Result
from teleop.simulation.virtual import run

DIGITS = 40
MOST_CHANGES = 256  # of contact that are followed within a tick; what is left of the tick is in contact
MOST_TERMS = 8.0  # rad: a time over which the series of one state is shorter than that of a map
NONE, ONE = Decimal(0), Decimal(1)
OUTSIDE, CONTACT, INSIDE = range(3)

State = tuple[Decimal, Decimal, Decimal]
Rows = tuple[tuple[Decimal, ...], ...]
Table = list[list[Decimal]]


class Equation(NamedTuple):
    """The coefficients of the equation above."""

    m: Decimal
    c: Decimal
    k: Decimal = NONE
    g: Decimal = NONE
    h: Decimal = NONE
    tau: Decimal = ONE


class Motion(NamedTuple):
    """A body in one axis: the equation of what is bonded to it, and its own damping `b` (N s/m) against the ground.

    What it touches rests at `at` (m). `wall`: None, or the damping of a wall (N s/m) that fills x > at with
    `side` 1, x < at with -1, and cannot pull. `turned`: z is a velocity, which a moving frame changes.
    """

    bonded: Equation
    b: Decimal
    at: Decimal = NONE
    side: Decimal = ONE
    wall: Decimal | None = None
    turned: bool = False


class AffineReading(NamedTuple):
    """A quantity that is affine in depth and speed: `alpha p + beta u + gamma`."""

    alpha: Decimal
    beta: Decimal
    gamma: Decimal = NONE

    def of(self, p: Decimal, u: Decimal) -> Decimal:
        """Its value."""
        return self.alpha * p + self.beta * u + self.gamma

    def rate(self, equation: Equation, f: Decimal) -> AffineReading:
        """Its rate of change while `m p'' + c p' + k p = f`."""
        m, c, k = equation[:3]
        return AffineReading(-self.beta * k / m, self.alpha - self.beta * c / m, self.beta * f / m)


class Propagator:
    """The solution of one linear equation, from its state at any time to its state `t` (s) later."""

    def __init__(self, equation: Equation, dt: Decimal) -> None:
        m, c, k, g, h, tau = equation
        self.equation = equation
        self.rates: Rows = ((NONE, ONE, NONE, NONE), (-k / m, -c / m, -g / m, ONE / m),
                            (NONE, h / tau, -ONE / tau, NONE), (NONE,) * 4)
        self.fastest = max(sqrt(k / m), float(c / m), float(ONE / tau) if h else 0.0)  # 1/s
        turns = float(k / m) - 0.25 * float(c / m) ** 2
        # Less than half a period of its oscillation: any quantity turns at most once in such a time.
        self.piece = min(dt, Decimal(0.9 * pi / sqrt(turns))) if turns > 0.0 else dt
        self.cached = {t: self.over(t) for t in {dt, self.piece}}

    def after(self, t: Decimal, state: State, f: Decimal) -> State:
        """The state after `t` under the force `f` (N)."""
        x, v, z = state
        rows = self.cached.get(t)
        if rows is None and self.fastest * float(t) < MOST_TERMS:
            return self._series(t, state, f)
        one, two, three = (a * x + b * v + c * z + d * f for a, b, c, d in rows or self.over(t))
        return one, two, three

    def over(self, t: Decimal) -> Rows:
        """The map from (x, v, z, f) to (x, v, z) after `t`: the matrix exponential."""
        size = max(sum(map(abs, row)) for row in self.rates) * t
        halvings = max(0, 4 * size.adjusted() + 8)
        with localcontext() as context:
            context.prec += halvings  # no squaring loses as much as one digit
            small = [[entry * t / (1 << halvings) for entry in row] for row in self.rates]
            term = total = [[ONE if i == j else NONE for j in range(4)] for i in range(4)]
            n, least = 0, Decimal(10) ** -context.prec
            while any(abs(entry) > least for row in term for entry in row):
                n += 1
                term = [[entry / n for entry in row] for row in _product(term, small)]
                total = [[a + b for a, b in zip(*rows, strict=True)] for rows in zip(total, term, strict=True)]
            for _ in range(halvings):
                total = _product(total, total)
        return tuple(map(tuple, total[:3]))

    def _series(self, t: Decimal, state: State, f: Decimal) -> State:
        """The same for one state alone, by its own Taylor series."""
        (_, (k, c, g, b), (_, h, tau, _), _), (x, v, z) = self.rates, state
        dx, dv, dz = t * v, t * (k * x + c * v + g * z + b * f), t * (h * v + tau * z)
        least, n = Decimal(10) ** -(getcontext().prec + 2), 1
        while True:
            x, v, z = x + dx, v + dv, z + dz
            n += 1
            step = t / n
            if abs(dx) + abs(dv) * t + abs(dz) < least * (abs(x) + abs(v) * t + abs(z)):
                return x, v, z
            dx, dv, dz = step * dv, step * (k * dx + c * dv + g * dz), step * (h * dv + tau * dz)


def _product(a: Table, b: Table) -> Table:
    columns = list(zip(*b, strict=True))
    return [[sum((p * q for p, q in zip(row, column, strict=True)), NONE) for column in columns] for row in a]


class Body:
    """A body in one axis, moved tick by tick; given back what it returned, it goes on with all its digits."""

    def __init__(self, motion: Motion, dt_ns: int, digits: int = DIGITS) -> None:
        self.context = Context(prec=digits, rounding=ROUND_HALF_EVEN, Emin=MIN_EMIN, Emax=MAX_EMAX, traps=[])
        self.motion = motion
        self.returned: tuple[float, ...] = ()
        self.state: State = (NONE, NONE, NONE)
        self.changes = 0  # of contact in the last tick
        self.rounding = 0.0  # m, the largest between a position that was returned and where it was
        self.forces: list[float] = []  # N, on what it touches after each tick
        with localcontext(self.context):
            self.dt = Decimal(dt_ns) / 10**9
            free = Equation(motion.bonded.m, motion.b)
            self.bond, self.free = (Propagator(equation, self.dt) for equation in (motion.bonded, free))

    def move(self, x: float, v: float, f: float, z: float = 0.0, r0: float = 0.0, r1: float = 0.0
             ) -> tuple[float, float, float]:
        """(x, v, z) after a tick under the force `f` (N) on it, while what it touches goes from r0 to r1 (m) evenly."""
        self.changes = 0
        if not all(map(isfinite, (x, v, f, z))):
            return nan, nan, nan
        with localcontext(self.context):
            if (x, v, z) != self.returned:
                self.state = Decimal(x), Decimal(v), Decimal(z)
            here, end = Decimal(r0) + self.motion.at, Decimal(r1) + self.motion.at
            s = (end - here) / self.dt
            turn = s if self.motion.turned else NONE
            q, w, y = self.state
            q, w, y = self._moved((q - here, w - s, y - turn), Decimal(f) - self.motion.b * s)
            self.state = end + q, s + w, turn + y
            self.returned = one, two, three = tuple(map(float, self.state))
            self.rounding = max(self.rounding, abs(float(Decimal(one) - self.state[0])))
            self.forces.append(float(self._force(q, w, y)))
        return one, two, three

    def _force(self, q: Decimal, w: Decimal, y: Decimal) -> Decimal:
        """The force on what it touches (N), from its state there."""
        (_, c, k, g, _, _), b, _, side, wall, _ = self.motion
        force = k * q + (c - b) * w + g * y
        return force if wall is None or (side * q > 0 and side * force > 0) else NONE

    def _moved(self, state: State, f: Decimal) -> State:
        if self.motion.wall is None:
            return self.bond.after(self.dt, state, f)
        side = self.motion.side
        p, u = self._along_wall(side * state[0], side * state[1], side * f, self.motion.bonded.k, self.motion.wall)
        return side * p, side * u, NONE

    def _along_wall(self, p: Decimal, u: Decimal, f: Decimal, k: Decimal, d: Decimal) -> tuple[Decimal, Decimal]:
        """Depth and speed after a tick, from one change of contact to the next. At p = 0 the way on decides."""
        inward = p > 0 or (p == 0 and (u > 0 or (u == 0 and f > 0)))
        mode = OUTSIDE if not inward else CONTACT if p == 0 or k * p + d * u > 0 else INSIDE
        ends = {
            OUTSIDE: [(AffineReading(-ONE, NONE), CONTACT)],
            CONTACT: [(AffineReading(k, d), INSIDE if d else OUTSIDE)],
            INSIDE: [(AffineReading(ONE, NONE), OUTSIDE), (AffineReading(-k, -d), CONTACT)],
        }
        left = self.dt
        while self.changes < MOST_CHANGES:
            flow = self.bond if mode == CONTACT else self.free
            exits = [] if mode == CONTACT and self._stays(p, u, f) else [
                (t, then) for one, then in ends[mode] if (t := _falls(flow, one, p, u, f, left)) is not None]
            if not exits:
                break
            t, then = min(exits)
            p, u, _ = flow.after(t, (p, u, NONE), f)
            if OUTSIDE in (mode, then):
                p = NONE
            mode, left = then, left - t
            self.changes += 1
        p, u, _ = (self.bond if mode == CONTACT else self.free).after(left, (p, u, NONE), f)
        return p, u

    def _stays(self, p: Decimal, u: Decimal, f: Decimal) -> bool:
        """True if the energy at hand cannot lift a body that is pressed by `f` off the wall, so it stays in contact."""
        m, c, k = map(float, self.motion.bonded[:3])
        if not k or not f > 0:
            return False
        most = 1.001 * hypot(sqrt(k) * float(p - f / self.motion.bonded.k), sqrt(m) * float(u))  # (2 E)^(1/2)
        return float(f) > most * (sqrt(k) + (c - float(self.motion.b)) / sqrt(m))


def _falls(flow: Propagator, one: AffineReading, p: Decimal, u: Decimal, f: Decimal, span: Decimal) -> Decimal | None:
    """The first instant within `span` (s) at which a reading that is not below 0 at first falls through 0, or None."""
    rate, left = one.rate(flow.equation, f), span
    while left > 0:
        h = min(flow.piece, left)
        p1, u1, _ = flow.after(h, (p, u, NONE), f)
        if one.of(p1, u1) >= 0 and rate.of(p, u) < 0 < rate.of(p1, u1):  # in between it is least
            least = _root(flow, AffineReading(*(-each for each in rate)), p, u, f, h, Decimal("1e-20"))
            q, w, _ = flow.after(least, (p, u, NONE), f)
            if one.of(q, w) < 0:
                return span - left + _root(flow, one, p, u, f, least)
        if one.of(p1, u1) < 0:
            return span - left + _root(flow, one, p, u, f, h)
        left, p, u = left - h, p1, u1
    return None


def _root(flow: Propagator, one: AffineReading, p: Decimal, u: Decimal, f: Decimal, high: Decimal,
          near: Decimal | None = None
          ) -> Decimal:
    """Time at which a reading falls through 0 before `high`: by Newton's method, halving where it leaves that."""
    rate, low, least = one.rate(flow.equation, f), NONE, high * (near or Decimal(10) ** (5 - getcontext().prec))
    t = high / 2
    while high - low > least:
        q, w, _ = flow.after(t, (p, u, NONE), f)
        value, slope = one.of(q, w), rate.of(q, w)
        low, high = (t, high) if value >= 0 else (low, t)
        new = t - value / slope if slope < 0 else high
        if abs(new - t) <= least:
            return new
        t = new if low < new < high else (low + high) / 2
    return t


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
    forces = np.array([body.forces for body in slaves]).T[: len(column) - 1]
    off = magnitude(column[1 : len(forces) + 1].reshape(forces.shape) - forces)
    return float(np.nanmax(off, initial=0.0))


def digit_bodies(scene: Scene, steps: Steps, tell: Callable[[], None] | None = None, digits: int = DIGITS) -> Moved:
    """The scene's bodies moved in `digits` digits; the slave and the master of each axis among them.

    Beside each step the stack's own is taken from the same floats, and counted in `steps`. Refused where no equation
    is known of what the slave touches.
    """
    stack = exact_bodies(scene)
    slaves, plants = [], []
    for plant, (still, environment) in zip(stack.slaves, stills(scene), strict=True):
        motion = slave_motion(scene, still, environment)
        slaves.append(Body(motion, scene.dt_ns, digits))
        plants.append(_plant(plant, slaves[-1], Body(motion, scene.dt_ns, digits), steps, tell))
    masters, name, move = _master(scene, stack, digits, steps)
    return stack._replace(slaves=plants, instead={**stack.instead, name: move}), slaves, masters


def slave_motion(scene: Scene, still: Plant, environment: Any) -> Motion:
    """The slave's equation beside an environment at rest."""
    body = slave_of(scene)
    if relaxing_branch(still, environment, body) is not None:
        m, b, k, k1, tau = map(Decimal, (body.mass, body.damping, environment.k, environment.k1, environment.tau))
        return Motion(Equation(m, b, k, ONE, k1 * tau, tau), b, Decimal(environment.at))
    touch = touch_of(still, body)
    m, b, k, d, side, at = map(Decimal, touch[:6])
    wall = d if touch.edge == 0.0 else None
    return Motion(Equation(m, b + d, k), b, at, side, wall)


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
        return Motion(Equation(m + m_h, b + d, k), b)
    b_e, tau = Decimal(shunt.b), Decimal(1.0 / (2.0 * pi * shunt.cutoff))
    return Motion(Equation(m + m_h, b + d + b_e, k, -b_e, ONE, tau), b, turned=True)


def _master(scene: Scene, stack: Bodies, digits: int, steps: Steps) -> tuple[list[Body], str, Callable[..., Any]]:
    """The masters, the name of the function that moves them, and that function; the axes take turns in it."""
    motion = master_motion(scene)
    bodies = [Body(motion, scene.dt_ns, digits) for _ in range(scene.axes)]
    single, turn = Body(motion, scene.dt_ns, digits), cycle(bodies)
    name, stock = ("move_held", None) if stack.inner_m else (
        ("move_free", move_free) if scene.hand is None else ("move_gripped", move_gripped))
    step: Any = stack.instead.get(name, stock)

    def move(c: Any, x: float, v: float, f: float, *rest: Any) -> tuple[Any, ...]:
        r0, r1 = rest[:2] or (0.0, 0.0)
        z = rest[2][0] if name == "move_held" else 0.0
        state = x, v, f if name == "move_free" else -f, z, r0, r1
        single.returned = ()
        steps.add(step(c, x, v, f, *rest)[:2], single.move(*state)[:2], changed=False)
        x, v, z = next(turn).move(*state)
        return (x, v, (z,)) if name == "move_held" else (x, v, 0) if name == "move_free" else (x, v)

    return bodies, name, move
