"""Bodies with a closed form, their equations solved in 40 decimal digits.

From one change of contact to the next each body obeys

    m x'' + c x' + k x + g z = f,        tau z' = h x' - z        (g = 0 without an inner state)

as in `teleop/physics/relaxing.py`. The matrix exponential is a Taylor series, scaled and squared (Moler & Van Loan,
SIAM Rev. 45, 2003, method 3); the instant of a change of contact is bracketed and found by Newton's method. Position
and velocity keep their digits from tick to tick; what a law reads of them is rounded to floats. Nothing of the stack's
own steps is used.
"""

from __future__ import annotations

from decimal import MAX_EMAX, MIN_EMIN, ROUND_HALF_EVEN, Context, Decimal, getcontext, localcontext
from math import hypot, isfinite, nan, pi, sqrt
from typing import NamedTuple

DIGITS = 40
MOST_CHANGES = 256  # of contact that are followed within a tick; what is left of the tick is in contact
MOST_TERMS = 8.0  # rad: a time over which the series of one state is shorter than that of a map
NONE, ONE = Decimal(0), Decimal(1)
OUTSIDE, CONTACT, INSIDE = range(3)

State = tuple[Decimal, Decimal, Decimal]
Rows = tuple[tuple[Decimal, ...], ...]
Table = list[list[Decimal]]


class Linear(NamedTuple):
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

    bonded: Linear
    b: Decimal
    at: Decimal = NONE
    side: Decimal = ONE
    wall: Decimal | None = None
    turned: bool = False


class Reading(NamedTuple):
    """A quantity that is affine in depth and speed: `alpha p + beta u + gamma`."""

    alpha: Decimal
    beta: Decimal
    gamma: Decimal = NONE

    def of(self, p: Decimal, u: Decimal) -> Decimal:
        """Its value."""
        return self.alpha * p + self.beta * u + self.gamma

    def rate(self, own: Linear, f: Decimal) -> Reading:
        """Its rate of change while `m p'' + c p' + k p = f`."""
        m, c, k = own[:3]
        return Reading(-self.beta * k / m, self.alpha - self.beta * c / m, self.beta * f / m)


class Flow:
    """The solution of one linear equation, from its state at any time to its state `t` (s) later."""

    def __init__(self, own: Linear, dt: Decimal) -> None:
        m, c, k, g, h, tau = own
        self.own = own
        self.rates: Rows = ((NONE, ONE, NONE, NONE), (-k / m, -c / m, -g / m, ONE / m),
                            (NONE, h / tau, -ONE / tau, NONE), (NONE,) * 4)
        self.fastest = max(sqrt(k / m), float(c / m), float(ONE / tau) if h else 0.0)  # 1/s
        turns = float(k / m) - 0.25 * float(c / m) ** 2
        # Less than half a period of its oscillation: any quantity turns at most once in such a time.
        self.piece = min(dt, Decimal(0.9 * pi / sqrt(turns))) if turns > 0.0 else dt
        self.kept = {t: self.over(t) for t in {dt, self.piece}}

    def after(self, t: Decimal, state: State, f: Decimal) -> State:
        """The state after `t` under the force `f` (N)."""
        x, v, z = state
        rows = self.kept.get(t)
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
            self.bond, self.free = (Flow(own, self.dt) for own in (motion.bonded, Linear(motion.bonded.m, motion.b)))

    def move(self, x: float, v: float, f: float, z: float = 0.0, r0: float = 0.0, r1: float = 0.0
             ) -> tuple[float, float, float]:
        """(x, v, z) after a tick under the force `f` (N) on it, while what it touches goes from r0 to r1 (m) evenly."""
        self.changes = 0
        if not all(map(isfinite, (x, v, f, z))):
            return nan, nan, nan
        with localcontext(self.context):
            if (x, v, z) != self.returned:
                self.state = Decimal(x), Decimal(v), Decimal(z)
            here, there = Decimal(r0) + self.motion.at, Decimal(r1) + self.motion.at
            s = (there - here) / self.dt
            turn = s if self.motion.turned else NONE
            q, w, y = self.state
            q, w, y = self._moved((q - here, w - s, y - turn), Decimal(f) - self.motion.b * s)
            self.state = there + q, s + w, turn + y
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
            OUTSIDE: [(Reading(-ONE, NONE), CONTACT)],
            CONTACT: [(Reading(k, d), INSIDE if d else OUTSIDE)],
            INSIDE: [(Reading(ONE, NONE), OUTSIDE), (Reading(-k, -d), CONTACT)],
        }
        left = self.dt
        while self.changes < MOST_CHANGES:
            flow = self.bond if mode == CONTACT else self.free
            found = [] if mode == CONTACT and self._stays(p, u, f) else [
                (t, then) for one, then in ends[mode] if (t := _falls(flow, one, p, u, f, left)) is not None]
            if not found:
                break
            t, then = min(found)
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


def _falls(flow: Flow, one: Reading, p: Decimal, u: Decimal, f: Decimal, span: Decimal) -> Decimal | None:
    """The first instant within `span` (s) at which a reading that is not below 0 at first falls through 0, or None."""
    rate, left = one.rate(flow.own, f), span
    while left > 0:
        h = min(flow.piece, left)
        p1, u1, _ = flow.after(h, (p, u, NONE), f)
        if one.of(p1, u1) >= 0 and rate.of(p, u) < 0 < rate.of(p1, u1):  # in between it is least
            least = _root(flow, Reading(*(-each for each in rate)), p, u, f, h, Decimal("1e-20"))
            q, w, _ = flow.after(least, (p, u, NONE), f)
            if one.of(q, w) < 0:
                return span - left + _root(flow, one, p, u, f, least)
        if one.of(p1, u1) < 0:
            return span - left + _root(flow, one, p, u, f, h)
        left, p, u = left - h, p1, u1
    return None


def _root(flow: Flow, one: Reading, p: Decimal, u: Decimal, f: Decimal, high: Decimal, near: Decimal | None = None
          ) -> Decimal:
    """Where a reading falls through 0 before `high`, by Newton's method, halving where that leaves the bracket."""
    rate, low, least = one.rate(flow.own, f), NONE, high * (near or Decimal(10) ** (5 - getcontext().prec))
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

