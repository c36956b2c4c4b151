"""Position servo as a body: a law's force through a command of position, over a bus that is late.

Low-cost arms and many cobots take a position at 100 to 250 Hz and have no torque mode. Such a servo holds its shaft at
the commanded position with `torque = clip(K (goal - x), stall)`. Two drives make a force of it. Both are the pure
functions `goal_of` and `follow`, which this body and a live device (`teleop.live.devices.position_servo`) share.

**offset**: `goal = x_read + clip(f, stall)/K`. A torque source. What is read is old, so the servo also pulls back to
where it was: with the lateness d the torque is `f - K (x(t) - x(t - d))`, a drag of real part `K sin(w d)/w`, which is
never below `-0.217 K d` (sin y/y is least at y = 4.493). So the servo takes up what the lateness makes if

    damping >= 0.217 K d.

That is for a constant lateness. One that varies is covered by `damping >= K d`, by Cauchy and Schwarz. The least force
that it can make is one count of the encoder, 2 pi K/counts.

**mass**: a virtual mass M with damping D takes the law's force, its position x is the goal, and the servo pulls it
back:

    M v' + D v = f - F,      goal = x,      F = clip(dz(K (x - x_read)), stall)

where dz leaves out `dead`. The law reads x and v of the mass and never x_read. With dead <= friction the port (f, v) is
passive in any passive environment for every M > 0 if

    D >= (K d)^2/(4 damping),      d = there + back + 2 every dt,

whatever the two delays and holds do below these bounds, saturated or not.

Proof. Let s be the shaft's position, x that of the mass, phi the clipped spring and Phi its integral. While one reading
is in use, the work of phi on the mass is what Phi gains. Add these up, and what Phi changes by at each new reading:

    int phi(x - s_read) v dt = Phi(end) - Phi(0) + int phi(x(T) - s) s' dt,

where T is the time at which the first reading from t on is used. At t the servo itself has the goal x(T'), and T - T'
<= d. With w the way of the mass from T' to T, `phi(x(T) - s) s' >= phi(x(T') - s) s' - K |w s'|`, and `K |w s'|` is at
most `damping s'^2 + K^2 w^2/(4 damping)`. The first of these two is what the servo's damping takes up. The second is
paid for by D, since `int w^2 dt <= d^2 int v^2 dt`: each instant lies between T' and T for a time of at most d. What is
left, phi(x(T') - s) s', is kinetic energy, friction and the work on the environment. A dead zone changes the force by
at most `dead`, which the friction pays for. Encoder counts and backlash are outside the proof. The mass is stepped by
backward Euler, under which its energy never rises by more than the work of f.

Refused by construction: a mass whose law reads x_read, and an error taken against a command as old as the reading.

The shaft is stepped in parts of at most 0.1 ms, in which friction, gear and contact make no energy, and springs take
none while they stay closed; the servo's own loop goes by the encoder at the start of each part. Signs:
teleop/DESIGN.md. Units are those of an axis that turns: rad, N m.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil, floor, inf, pi
from typing import Any, ClassVar

from teleop.errors import Refused, enough, number, whole_number
from teleop.physics.implicit import Resistance
from teleop.physics.plant import MassDamper, Plant
from teleop.physics.sdirk import BOND, HUNT_CROSSLEY, NOTHING, power, resistance_force

DRIVES = ("offset", "mass")
LEAST = 0.217234  # of -sin(y)/y, at y = 4.4934
SHORT = 1e-4  # s, the longest part in which a shaft is stepped
SHORT_MASS = 2.5e-4  # s, that of a virtual mass
MOST_LATE = 200  # ticks of either delay: they are kept as a tuple
SPEED = 0.01  # s over which the speed of an offset drive is taken
COUNTED = 2.0**53

Tuple = tuple[Any, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class Servo:
    """A position servo with its drive, as the master or the slave of a scene.

    `K` (N m/rad) is the torque of its error, `damping` (N m s/rad) its own, `inertia` (kg m^2) that of motor and gear
    at the shaft and `link` that of what the shaft carries. `friction` and `stall` in N m, `backlash` in rad from stop
    to stop (`gear` and `bearing` count where there is any), `counts` of the encoder per turn; 0, 0 and inf leave each
    out. `bus`: seconds that a goal and a reading take; rounded up to ticks. `every`: ticks from one exchange with the
    bus to the next. `drive`: "offset" or "mass"; `M` (kg m^2) and `D` (N m s/rad) are those of a mass; `dead` (N m) is
    left out of the torque that the error shows. Raises `Refused` for numbers out of range; a scene refuses one whose
    condition fails (`check`).

    It has no force sensor: f_h and f_env are what its own error shows. A run in virtual time records the
    true position of its shaft as `shaft`, and the true torque on it as `touch`.
    """

    K: float
    damping: float
    inertia: float = 0.028
    friction: float = 0.0
    stall: float = inf
    backlash: float = 0.0
    counts: int = 0
    bus: tuple[float, float] = (0.0, 0.0)
    every: int = 1
    drive: str = "offset"
    link: float = 0.01
    gear: tuple[float, float] = (800.0, 0.5)  # stiffness and damping of its teeth, N m/rad and N m s/rad
    bearing: tuple[float, float] = (0.01, 0.01)  # friction and damping of the link by itself, N m and N m s/rad
    M: float = 0.02
    D: float = 0.06
    dead: float = 0.0

    inner: ClassVar[bool] = True  # its plants have an inner state

    def __post_init__(self) -> None:
        for name in ("K", "damping", "inertia", "link", "M"):
            object.__setattr__(self, name, number(name, getattr(self, name), above=0.0))
        for name in ("friction", "backlash", "D", "dead"):
            object.__setattr__(self, name, number(name, getattr(self, name), low=0.0))
        if self.stall != inf:
            object.__setattr__(self, "stall", number("stall", self.stall, above=0.0))
        object.__setattr__(self, "counts", whole_number("counts", self.counts, low=0))
        object.__setattr__(self, "every", whole_number("every", self.every, low=1))
        for name, what in (("bus", "the delays of a goal and of a reading, s: bus=(0.005, 0.005)"),
                           ("gear", "stiffness and damping of the gear: gear=(800.0, 0.5)"),
                           ("bearing", "friction and damping of the link: bearing=(0.01, 0.01)")):
            pair = getattr(self, name)
            if not isinstance(pair, tuple) or len(pair) != 2:
                raise Refused(f"{name} must be two numbers, {what}, not {pair!r}")
            object.__setattr__(self, name, tuple([number(name, each, low=0.0) for each in pair]))
        if self.drive not in DRIVES:
            raise Refused(f"drive must be offset or mass, not {self.drive!r}; write drive=\"offset\"")
        if self.drive == "mass" and self.dead > self.friction:
            raise Refused(f"a dead zone of {self.dead:g} N m makes energy beyond a friction of {self.friction:g} N m; "
                          f"write dead={self.friction:g} at most")

    @property
    def mass(self) -> float:
        """The mass (kg m^2) that the law moves."""
        return self.M if self.drive == "mass" else self.inertia + self.link

    @property
    def body(self) -> MassDamper:
        """Mass and damping that the law moves, for an observer and for a law's conditions."""
        return MassDamper(mass=self.mass, damping=self.D if self.drive == "mass" else self.damping)

    @property
    def step(self) -> float:
        """Step of the encoder, rad; 0: it has none."""
        return 2.0 * pi / self.counts if self.counts else 0.0

    def linear(self) -> Servo:
        """The same servo without friction, backlash, counts, stall and dead zone."""
        return replace(self, friction=0.0, backlash=0.0, counts=0, stall=inf, dead=0.0)

    def ticks(self, dt: float) -> tuple[int, int]:
        """Whole ticks that a goal and a reading take."""
        to_servo, from_servo = (ceil(delay / dt - 1e-9) for delay in self.bus)
        return to_servo, from_servo

    def lateness(self, dt: float, period: float = 0.0) -> float:
        """The most that the loop over the bus is late, s: both delays, rounded up to ticks, and both holds.

        `period`: from one exchange with the bus to the next, s, where that is longer than `every` ticks.
        """
        return sum(self.ticks(dt)) * dt + 2.0 * max(self.every * dt, period)

    def check(self, dt: float, period: float = 0.0) -> None:
        """Refuse a servo whose drive could make energy, with the numbers that would do, for ticks of dt seconds.

        `period`: as in `lateness`.
        """
        d, most = self.lateness(dt, period), max(self.ticks(dt))
        if most > MOST_LATE:
            raise Refused(f"a bus of a position servo is at most {MOST_LATE} ticks late each way, not {most}; "
                          "take a longer dt, or a faster bus")
        late = f"a position servo of K={self.K:g} N m/rad and damping={self.damping:g} N m s/rad that is {d:g} s late"
        if self.drive == "offset":
            if self.damping < (least := LEAST * self.K * d):
                raise Refused(f"{late} makes energy at its shaft: 0.217 K d is {least:.3g} N m s/rad; take "
                              f"K={enough(self.damping / (LEAST * d), least=False)} at most, or damping="
                              f"{enough(least, least=True)}, or a lateness of "
                              f"{enough(self.damping / (LEAST * self.K), least=False)} s")
        elif (least := (self.K * d) ** 2 / (4.0 * self.damping)) > self.D:
            K_d = 2.0 * (self.D * self.damping) ** 0.5  # N m s/rad, the most that D pays for
            raise Refused(f"{late} makes energy at its virtual mass: (K d)^2/(4 damping) is {least:.3g} N m s/rad; "
                          f"take D={enough(least, least=True)}, or K={enough(K_d / d, least=False)} at most, or a "
                          f"lateness of {enough(K_d / self.K, least=False)} s")

    def slave_plant(self, dt: float, resistance: Resistance | None) -> Plant:
        """The servo in what its shaft touches, at rest at 0 (`start`)."""
        c = self._coefficients(dt, tuple(resistance or Resistance()), 0.0)
        return Plant(move_servo, servo_force, c, self.start(dt))

    def master_plant(self, hand_mass: float, k: float, d: float, dt: float) -> Plant:
        """The servo held by a hand, or by none: all zeros. Its functions are those of a master, `move_held`."""
        held = Resistance(BOND, k, d) if k > 0.0 or d > 0.0 else Resistance()
        c = self._coefficients(dt, tuple(held), hand_mass)
        return Plant(move_held, held_force, c, self.start(dt))

    def _coefficients(self, dt: float, touch: Tuple, hand_mass: float) -> Tuple:
        parts = ceil(number("dt", dt, above=0.0) / SHORT - 1e-9)
        shaft = (self.K, self.damping, self.inertia, self.link + hand_mass, self.friction, self.stall, self.step,
                 0.5 * self.backlash, *self.gear, *self.bearing, dt / parts, parts)
        return shaft, touch, self.drive_numbers(dt), hand_mass

    def drive_numbers(self, dt: float) -> Tuple:
        """The numbers of `goal_of`, `follow` and `felt_torque`, for ticks of dt seconds."""
        parts = ceil(dt / SHORT_MASS - 1e-9)
        return (1.0 if self.drive == "mass" else 0.0, self.K, self.stall, self.M, self.D, self.dead, self.every,
                self._readings(dt) * self.every * dt, dt / parts, parts,
                self.damping + self.K * (self.lateness(dt) - self.every * dt))

    def drive_start(self, dt: float, reading: float) -> Tuple:
        """The state of `follow` at rest: the reading, ticks since the bus, the earlier readings of an offset drive."""
        count = self._readings(dt) if self.drive == "offset" else 1  # none would be another type for the compilers
        return reading, 0, (reading,) * count

    def _readings(self, dt: float) -> int:
        """Count the readings over which an offset drive takes its speed."""
        return max(1, round(SPEED / (self.every * dt)))

    def start(self, dt: float, at: float = 0.0) -> Tuple:
        """The inner state at rest at `at` (rad)."""
        to_servo, from_servo = self.ticks(dt)
        reading = encoded(at, self.step)
        return ((at, 0.0, at, 0.0, 0.0), self.drive_start(dt, reading), at, (at,) * to_servo, (reading,) * from_servo)


# The drives


def clip(f: float, most: float) -> float:
    """f, and no more than `most` of either sign."""
    return most if f > most else -most if f < -most else f


def beyond(f: float, dead: float) -> float:
    """f less a dead zone of either sign."""
    return f - dead if f > dead else f + dead if f < -dead else 0.0


def goal_of(c: Tuple, x: float, f: float, reading: float) -> float:
    """The goal that is sent at an exchange with the bus; c is `Servo.drive_numbers`, x that of the mass."""
    return x if c[0] > 0.5 else reading + clip(f, c[2]) / c[1]


def is_due(c: Tuple, f: float, state: Tuple) -> bool:
    """True if a goal is sent at this tick: at an exchange, and at once where an offset drive is to hold no torque."""
    return bool(c[6] == 1 or state[1] == 0 or (f == 0.0 and c[0] <= 0.5))


def felt_torque(c: Tuple, x: float, v: float, goal: float, reading: float) -> float:
    """The torque (N m) on what the shaft touches, as its error tells it.

    Of a mass that is F; of an offset drive the torque of its goal, less the drag of its motion and `dead`.
    """
    if c[0] > 0.5:
        return clip(beyond(c[1] * (x - reading), c[5]), c[2])
    return beyond(clip(c[1] * (goal - reading), c[2]) - c[10] * v, c[5])


def follow(c: Tuple, x: float, v: float, f: float, state: Tuple, arrived: float) -> Tuple:
    """Position and speed that the law is told a tick later, and the state; `arrived`: the newest reading by then."""
    drive, _, _, _, _, _, every, span, _, _, _ = c
    reading, ticks, past = state
    if drive > 0.5:
        x, v = move_mass(c, x, v, f, reading)
    ticks = ticks + 1
    if every == 1 or ticks >= every:
        ticks = 0
        reading = arrived
        if drive <= 0.5:
            x, v = arrived, (arrived - past[0]) / span
            past = past[1:] + (arrived,)  # noqa: RUF005 - compiled code knows no star
    return x, v, (reading, ticks, past)


def move_mass(c: Tuple, x: float, v: float, f: float, reading: float) -> tuple[float, float]:
    """Move the virtual mass over one tick, each part by backward Euler: the one root of a rising function."""
    _, K, stall, M, D, dead, _, _, h, parts, _ = c
    inertia = M / h
    free, pulled = inertia + D, inertia + D + K * h
    for _ in range(parts):
        drive = inertia * v + f
        error = K * (x - reading)
        v = drive / free
        reached = error + K * h * v
        if reached > dead:
            v = (drive - error + dead) / pulled
            if error + K * h * v - dead > stall:
                v = (drive - stall) / free
        elif reached < -dead:
            v = (drive - error - dead) / pulled
            if error + K * h * v + dead < -stall:
                v = (drive + stall) / free
        x = x + h * v
    return x, v


# The shaft


def encoded(x: float, step: float) -> float:
    """The encoder's reading of x, to the nearest of its steps; what is not finite stays as it is."""
    if step == 0.0:
        return x
    count = x / step + 0.5
    return step * floor(count) if abs(count) < COUNTED else x


def move_servo(c: Tuple, x: float, v: float, f: float, z: Tuple) -> tuple[float, float, int, Tuple]:
    """Move the servo over one tick with the law's force f held; x and v are what the law is told."""
    x, v, z = exchange(c, x, v, f, z, 0.0, 0.0)
    return x, v, 0, z


def move_held(c: Tuple, x: float, v: float, f_m: float, r0: float, r1: float, z: Tuple) -> Tuple:
    """Move the held servo over one tick in which the hand's reference runs straight from r0 to r1."""
    _, _, _, _, _, _, _, _, _, _, _, _, h, parts = c[0]
    return exchange(c, x, v, -f_m, z, r0, (r1 - r0) / (h * parts))


def exchange(c: Tuple, x: float, v: float, f: float, z: Tuple, at: float, rate: float) -> Tuple:
    """Move bus, shaft and drive over one tick, in which what is touched moves from `at` with the speed `rate`."""
    shaft, touch, drive, _ = c
    state, follower, goal, goals, readings = z
    if is_due(drive, f, follower):
        goal = goal_of(drive, x, f, follower[0])
    sent = goals + (goal,)  # noqa: RUF005 - compiled code knows no star
    state = turn(shaft, touch, state, sent[0], at, rate)
    taken = readings + (encoded(state[0], shaft[6]),)  # noqa: RUF005 - as above
    x, v, follower = follow(drive, x, v, f, follower, taken[0])
    return x, v, (state, follower, goal, sent[1:], taken[1:])


def turn(c: Tuple, touch: Tuple, state: Tuple, goal: float, at: float, rate: float) -> Tuple:
    """The shaft after one tick: position and speed of its output and of its motor, and the last acceleration."""
    K, _, _, _, _, stall, step, play, _, _, _, _, h, parts = c
    x, v, y, w, a = state
    for i in range(parts):
        torque = clip(K * (goal - encoded(x, step)), stall)
        v_mean, w_mean = speeds(c, touch, x, v, y, w, torque, at + rate * (h * (i + 1)), rate)
        v1 = 2.0 * v_mean - v if v_mean != 0.0 else 0.0
        w = v1 if play == 0.0 else 2.0 * w_mean - w if w_mean != 0.0 else 0.0
        a = (v1 - v) / h
        v = v1
        x = x + h * v_mean
        y = y + h * w_mean if play > 0.0 else x
    return x, v, y, w, a


def speeds(c: Tuple, touch: Tuple, x: float, v: float, y: float, w: float, torque: float, at: float, rate: float
           ) -> tuple[float, float]:
    """Mean speeds of output and motor over one part: without contact if that ends outside, or would pull, else with it.

    A force that acts at the part's start acts by its mean, so that a spring neither makes nor takes energy; one that
    begins within the part acts as it ends, which takes some.
    """
    _, _, _, _, _, _, _, _, _, _, _, _, h, _ = c
    kind, k, d, place, side, n, lam = touch
    free, motor = coupled(c, v, w, y - x, torque, 0.0, 0.0)
    if kind == NOTHING:
        return free, motor
    p = side * (x - (place + at)) + side * h * rate  # at the part's start
    moved = h * side * (free - rate)
    if kind != BOND and p + moved <= 0.0:
        return free, motor
    if kind == HUNT_CROSSLEY:
        q = max(p, 0.0)
        k = k * power(q, n) / q if q > 0.0 else 0.0
        d = k * q * lam
    ahead = 0.5 * h if kind == BOND or p > 0.0 else h
    grip = k * ahead + d
    v1, w1 = coupled(c, v, w, y - x, torque, grip * rate - side * k * p, grip)
    if kind == BOND or k * p + grip * side * (v1 - rate) > 0.0:
        return v1, w1
    return free, motor


def coupled(c: Tuple, v: float, w: float, gap: float, torque: float, pull: float, grip: float) -> tuple[float, float]:
    """Mean speeds of output and motor over one part: apart, or with the gear's teeth closed.

    Output and motor begin at v and w, `gap` is how far the motor is ahead, and `pull - grip v` acts on the output.
    """
    _, damping, inertia, link, friction, _, _, play, gear_k, gear_d, rub, drag, h, _ = c
    if play == 0.0:
        both = 2.0 * (inertia + link) / h
        mean = beyond(both * v + torque + pull, friction) / (both + damping + grip)
        return mean, mean
    motor, output = 2.0 * inertia / h, 2.0 * link / h
    w_free = beyond(motor * w + torque, friction) / (motor + damping)
    v_free = beyond(output * v + pull, rub) / (output + drag + grip)
    reached = gap + h * (w_free - v_free)
    if -play <= reached <= play:
        return v_free, w_free
    depth = gap - play if reached > play else gap + play
    closed = depth > 0.0 if reached > play else depth < 0.0
    teeth = gear_k * (0.5 * h if closed else h) + gear_d
    below = output + drag + teeth + grip
    push = output * v + gear_k * depth + pull
    w1 = beyond(motor * w + torque - gear_k * depth + teeth * push / below, friction + rub) / (
        motor + damping + teeth - teeth * teeth / below)
    v1 = (push + teeth * w1) / below
    through = gear_k * depth + teeth * (w1 - v1)
    if through > 0.0 if reached > play else through < 0.0:
        return v1, w1
    return v_free, w_free


def servo_force(c: Tuple, x: float, v: float, z: Tuple) -> float:
    """The torque on what it touches as the servo's own error tells it: all that such a device knows of it."""
    return felt_torque(c[2], x, v, z[2], z[1][0])


def held_force(c: Tuple, x: float, v: float, f_held: float, r: float, slope: float,  # noqa: ARG001 - every force's
               z: Tuple) -> float:
    """The hand's torque on the servo, told in the same way."""
    return -felt_torque(c[2], x, v, z[2], z[1][0])


def true_touch(c: Tuple, z: Tuple) -> float:
    """The true torque of a slave's shaft on what it touches, as the left limit."""
    kind, k, d, at, side, n, lam = c[1]
    state = z[0]
    g = resistance_force((kind, 1.0, 0.0, k, d, n, lam, 0.0), side * (state[0] - at), side * state[1])
    return side * g if g != 0.0 else 0.0


def true_hold(c: Tuple, z: Tuple, r: float, slope: float) -> float:
    """The true torque of the hand on a master's shaft: its spring and damper, less what its mass takes."""
    _, k, d, _, _, _, _ = c[1]
    state = z[0]
    return float(k * (r - state[0]) + d * (slope - state[1]) - c[3] * state[4])
