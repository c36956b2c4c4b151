"""Handover between the operator and a policy: whoever has authority, the force on the handle does not jump.

A policy sends actions, 30 to 60 a second: positions of the master's handle. While it has authority it pulls the handle
there, beside the law's force, and the law drives the slave as ever. So the handle moves with the policy, a hand on it
feels both, and either side may take over at any tick. With x and v of the device,

    f_p = sigma a' clip(Kp (r - x) + Bp (w - v), f_max)     f = g f_law - f_p

where r and w follow the actions (`teleop.physics.following`), and are set to x and v while a = 0: a policy begins
where the handle is. a, the policy's share, goes to 1 and to 0 over `ramp` s, and a' is that without the part of it that
an open clutch takes. Its change within a tick is bounded by `slew`, and sigma = min(1, E/soft) by what is left of an
energy tank,

    E(k) = min(E0, E(k-1) - sum of max(f_p dx, 0) over the axes + P dt).

**The promise.** The work that the policy does, W = sum over ticks and axes of max(f_p dx, 0), f_p being what was held
and dx the motion under it, is paid for at the next tick, when both are known. By the sum of the line above, after n
ticks W <= E0 - E(n) + P n dt. No force is given while E <= 0, for then sigma = 0, so E falls below 0 within one tick
alone, by its work:

    W <= E0 + P t + w,     w = |f_p||dx| of one tick, at most f_max |dx| on each axis,

whatever policy, hand, law and link do. A stall counts as one tick, as long as the force was held.

**The law is untouched.** Of the force that was held, f, the caps cut f_p first: with L = g f_law and f_p as they were
asked, both times the watchdog's gain,

    f_p' = clip(L - f, between 0 and f_p),     f_law' = f + f_p'

so f_law' = L as long as what the caps took away is no more than f_p. A slew limit of the scene's that is slower than
`slew` makes the whole force lag, and that lag is the law's, as it is without a policy. The law is told f_law' as
f_held: its ledgers and `E_port_m` are those of its own port, and f_p is a port of its own beside it. Each of the two
sums is exact, for f dx = f_law' dx - f_p' dx.

**Without a motor at the leader** (`motor=False`) there is nothing to pull, so the policy moves the law's end instead: a
transformer such as the operator's clutch, with a second motion,

    dx_law(k) = g dx(k) + dx_p(k)     v_law(k) = g v(k) + p(k)     F(k) = g f_law(k)     g = 1 - a,

with a and f_law of the tick before, in which the motion was made. p = sigma a w is the policy's velocity, w that of the
filter above from x_law on, and dx_p(k) = dt (p(k-1) + p(k))/2: a law that answers b p(k-1) until the next tick then
takes in b dt/2 sum of p(k-1)^2 + p(k-1) p(k) >= 0 of it, however the policy leaps. (With the filter's own way it
does not: a wave gave out 10 J in trials.) Here a takes 20 ticks at least, for a switch that goes over within a tick,
back and forth, cost a wave 0.25 J; with 20 the least of E_port over 400 random scenes was -1.9 mJ, with ticks left out.

The work at the law's port is that at the device's and that of the policy, f_law dx_law = F dx + f_law dx_p, and the sum
of max(f_law dx_p, 0) is paid from the same tank. The promise is the same but for the work of one tick more, in which
the motion ends. As the handle does not move along, an offset between the two is left, recorded as `offset_policy_m` and
told when the operator has authority again; and there is no force by which a hand could take over.

**Who has authority** is `policy_m`, a `Standing` of `teleop.stages.authority`: the policy, once its switch is on, with
an action that came within `patience` and none of it farther from r than `leap`; what leaps, or is no number, is none. A
late policy gives way over `yields` s, with defaults within 0.1 s of its last action, and comes back over `ramp` with
the next. A link that the watchdog has let go of pauses it, and so does an open clutch. The operator takes over by the
switch, or by force: where the policy's force meets motion against it, sum of f_p v < 0 with |f_p| above `grip` f_max on
an axis, for 50 ms (f_p before sigma, so that an empty tank hides no hand). After that the switch has to be off before
the policy can have authority again.

Recorded are `policy_m`, the share `authority_m`, `f_policy_m` by axis (N, along the motion; what was held of it), the
tank `E_tank_m`, W as `E_policy_m`, and `refused_m`, how many actions leapt.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil, inf
from typing import Any, ClassVar, NamedTuple

from teleop.errors import Refused, by_axis, number, numbers
from teleop.law import At
from teleop.physics.following import Follower, approach, following
from teleop.stages.authority import GRIPS, Rules, share_step, standing, tank_step
from teleop.stages.end import Column, End, Places, Record, Run, Stage, elapsed, per_axis
from teleop.stages.operator import Spans, in_ticks, scheduled, spans_of

SLOWLY = 20.0  # ticks that a takes at least without a motor at the leader: see above
PerAxis = float | tuple[float, ...]


class Pull(NamedTuple):
    """Coefficients of f_p in one axis."""

    Kp: float
    Bp: float
    f_max: float
    step: float  # N a tick
    leap: float
    follower: Follower


@dataclass(frozen=True, kw_only=True, slots=True)
class Handover:
    """A policy that takes over from the operator and gives back, at the master; see `teleop.stages.handover`.

    `policy`: what it does, a reference like a hand's (a `Recording` of a file, for example), of which it sends `rate`
    actions a second, each `late` s late; none: its actions come by orders alone, in a live run. `takes`: spans
    (from, to) in s in which its switch is on; `silent`: spans in which it sends nothing. A number may be a tuple with
    one for each axis, in the axis's own unit: N m and rad where it turns.
    """

    policy: Any = None
    takes: Spans = ()
    silent: Spans = ()
    rate: float = 30.0  # Hz
    late: float = 0.05  # s
    Kp: PerAxis = 12.0  # N/m
    Bp: PerAxis = 0.5  # N s/m
    f_max: PerAxis = 1.0  # N
    slew: PerAxis = 20.0  # N/s
    ramp: float = 0.2  # s
    energy: float = 0.3  # J, E0
    power: float = 0.6  # W, P
    soft: float | None = None  # J; None: `energy`
    bandwidth: float = 20.0  # rad/s, of r
    most_speed: PerAxis = 1.0  # m/s, of r
    leap: PerAxis = 0.5  # m
    grip: float = 0.9  # share of f_max
    patience: float = 0.05  # s
    yields: float = 0.05  # s
    motor: bool = True  # False: the leader has none, and the policy moves the law's end

    def __post_init__(self) -> None:
        object.__setattr__(self, "takes", spans_of("takes", self.takes))
        object.__setattr__(self, "silent", spans_of("silent", self.silent))
        if self.policy is not None and (isinstance(self.policy, type) or not hasattr(self.policy, "samples")):
            raise Refused(f"policy must be something with samples, as a hand's reference has, not {self.policy!r}; "
                          "write for example policy=Recording(path='actions.csv'), or leave it out")
        for name, low, above, high in (
                ("rate", None, 0.0, 1000.0), ("late", 0.0, None, 10.0), ("Kp", 0.0, None, None),
                ("Bp", 0.0, None, None), ("f_max", None, 0.0, None), ("slew", None, 0.0, None),
                ("ramp", None, 0.0, 10.0), ("energy", None, 0.0, None), ("power", 0.0, None, None),
                ("soft", None, 0.0, None), ("bandwidth", None, 0.0, 1000.0), ("most_speed", None, 0.0, None),
                ("leap", None, 0.0, None), ("grip", None, 0.0, 1.0), ("patience", None, 0.0, 10.0),
                ("yields", None, 0.0, 10.0)):
            value = getattr(self, name)
            if value is None and name == "soft":
                continue
            convert = numbers if name in PER_AXIS else number
            object.__setattr__(self, name, convert(name, value, low=low, above=above, high=high))
        if not isinstance(self.motor, bool):
            raise Refused(f"motor must be True or False, not {self.motor!r}; write motor=False where there is none")

    def pulls(self, dt: float, axes: int) -> tuple[Pull, ...]:
        """Coefficients of each axis, at a tick of `dt` s."""
        of = {name: by_axis(name, getattr(self, name), axes) for name in PER_AXIS}
        return tuple([Pull(of["Kp"][i], of["Bp"][i], of["f_max"][i], of["slew"][i] * dt, of["leap"][i],
                           following(dt, self.bandwidth, of["most_speed"][i])) for i in range(axes)])

    def rules(self, dt: float) -> Rules:
        """Coefficients of authority and tank, at a tick of `dt` s."""
        least = 1.0 if self.motor else SLOWLY
        up, yields = [min(1.0 / least, dt / each) for each in (self.ramp, self.yields)]
        return Rules(up, yields, self.patience / dt + 0.5, self.grip,
                     GRIPS / dt - 0.5, self.energy, self.energy if self.soft is None else self.soft, self.power)

    @property
    def without_policy(self) -> Handover:
        """The same, with actions by orders alone."""
        return replace(self, policy=None, takes=(), silent=())

    def switched(self, dt: float) -> Spans:
        """The spans in ticks in which the policy's switch is on."""
        return in_ticks(self.takes, dt)

    @property
    def action_ns(self) -> int:
        """Time from one action to the next, ns."""
        return round(1e9 / self.rate)

    def due(self, n: int, dt: float) -> float:
        """The tick of `dt` s at which action number n comes."""
        return float(ceil((n * self.action_ns / 1e9 + self.late) / dt - 1e-9))

    def actions(self, axes: int, count: int, dt: float, first: int = 0) -> Actions:
        """So many of the policy's actions from the `first` one on, each at its tick. Raises `Refused`."""
        first_of = {"first": first} if first else {}
        samples = self.policy.samples(axes, count, self.action_ns, **first_of)
        if len(samples) != axes or any(len(each) < count for each in samples):
            raise Refused(f"the policy has not the {count} actions for each of {axes} axes that it was asked for; see "
                          "its samples(axes, count, dt_ns)")
        due: list[float] = []
        chosen: list[int] = []
        for n in range(count):
            sent, tick = (first + n) * self.action_ns / 1e9, self.due(first + n, dt)
            if any(start <= sent < end for start, end in self.silent):
                continue
            if due and due[-1] == tick:  # the newest of those that come at one tick
                due.pop()
                chosen.pop()
            due.append(tick)
            chosen.append(n)
        return Actions([*due, inf], tuple([[*[float(each[n]) for n in chosen], 0.0] for each in samples]))


PER_AXIS = ("Kp", "Bp", "f_max", "slew", "most_speed", "leap")


class Actions(NamedTuple):
    """Actions in the order of their coming; both lists have an entry more than there are actions."""

    due: list[float]  # the tick at which each comes, and inf
    targets: tuple[list[float], ...]  # m, for each axis


def newest(due: Any, n: Any, k: Any) -> Any:
    """The number of actions that have come by tick k, of which n had come before."""
    while due[n] <= k:
        n = n + 1
    return n


def farther(one: float, far: float) -> float:
    """The greater of two distances; infinity where one is no number."""
    if one != one:  # noqa: PLR0124 - of NaN alone, in every engine
        return inf
    return max(one, far)


def part_of_policy(law: float, policy: float, f: float) -> float:
    """The policy's part f_p' of a held force f, of which the law asked for `law`: see the head of the file."""
    return max(min(law - f, max(policy, 0.0)), min(policy, 0.0))


def pulling(c: Pull, a: float, r: float, w: float, x: float, v: float, before: float) -> float:
    """The policy's force before its tank, within one tick's slew of that `before`."""
    f = a * max(min(c.Kp * (r - x) + c.Bp * (w - v), c.f_max), -c.f_max)
    return max(min(f, before + c.step), before - c.step)


def led(share: float, x: float, dx: float, away: float, x_lead: float) -> tuple[float, float]:
    """Position for the law and the device's offset from it (m), after a motion dx of the law's end."""
    if share > 0.0:
        x_lead = x_lead + dx
        return x_lead, x - x_lead
    return x - away, away


def held_at(share: float, f: float, f_law: float) -> float:
    """The force at the law's port while f was held at the device: `f_law` where nothing of it is."""
    return f / (1.0 - share) if share < 1.0 else f_law


class Pulled(Record):
    """The policy in one axis."""

    c_pull: Pull
    targets: Any  # the actions that are drawn up front, m
    action: float  # that came last, m
    target: float  # the last that did not leap, m
    goal: float  # its reference r, m
    goal_v: float  # w, m/s
    f_slewed: float  # its force before the tank
    f_asked: float  # the policy's force before what stands behind this stage
    f_law: float  # the law's
    f_policy: float  # what is held of the policy's force, along the motion, N
    f_port: float  # what is held of the law's force, N
    f_whole: float  # the force that both were parts of
    pace: float  # of the policy's motion, m/s: p
    led: float  # the way that it made in the last tick, m
    x_lead: float  # of a leader without a motor: the position that the law was told, m
    dx_lead: float  # its last motion, m
    away: float  # how far the device is from it, m


class HandoverStage(Stage):
    """The policy's force beside the law's, its tank, and who has authority; the same for all axes but for the force."""

    name: ClassVar[str] = "handover"
    axis_kind: ClassVar[type[Record]] = Pulled
    wants_dx: ClassVar[bool] = True
    c_rules: Rules
    c_takes: Any  # ticks [from, to) in which the policy's switch is on
    due: Any  # the ticks of the actions that are drawn up front
    n: Any  # how many have come
    wants: Any  # 1.0 while the policy's switch is on
    renewed: Any  # 1.0 if an action came at this tick
    policy: float  # who has authority, a `Standing`
    authority: float  # the policy's share a
    taken: float  # 1.0 if an action came that does not leap
    refused: float  # actions that leapt
    quiet: float  # ticks since the last action
    resisted: float  # ticks for which the hand has resisted
    allowed: float  # 1.0 while link and clutch let the policy move
    ticks_since: Any  # ticks since the last
    E_tank: float  # J
    E_policy: float  # W, J
    work: float  # that of the last tick, J
    along: float  # sum of f_p v, W
    strength: float  # the greatest |f_p|/f_max
    sigma: float
    g_last: float  # the watchdog's gain at the last tick
    shared: float  # the policy's share in the motion, of the tick before

    @staticmethod
    def structure(end: Any) -> Any:
        """True if actions are drawn up front; and if the policy moves the law's end."""
        return end.scene.handover.policy is not None, not end.scene.handover.motor

    def __init__(self, e: End, structure: Any) -> None:
        super().__init__(e, structure)
        self.planned, self.moves = structure

    @staticmethod
    def numbers(scene: Any, e: str, dt: float, places: Places) -> Any:
        of = scene.handover
        pulls = of.pulls(dt, scene.axes)
        if of.policy is None:
            return pulls, of.rules(dt), of.switched(dt)
        due, targets = of.actions(scene.axes, 1 + ceil(scene.duration * of.rate), dt)
        return pulls, of.rules(dt), of.switched(dt), (0.0, due), tuple([(0.0, each) for each in targets])

    def columns(self, e: End) -> tuple[Column, ...]:
        return (Column(f"policy_{e.name}", ((self, "policy"),)), Column(f"authority_{e.name}", ((self, "authority"),)),
                per_axis(f"f_policy_{e.name}", self.axes, "f_policy"),
                Column(f"E_tank_{e.name}", ((self, "E_tank"),)), Column(f"E_policy_{e.name}", ((self, "E_policy"),)),
                Column(f"refused_{e.name}", ((self, "refused"),)),
                *[per_axis(f"offset_policy_{e.name}", self.axes, "away")] * self.moves)

    def begin(self, run: Run, e: End, numbers: Any) -> None:
        self.c_rules = numbers[1]
        self.c_takes = numbers[2]
        if self.planned and not e.has.live:
            self.due = numbers[3]
            self.n = 0
            for a, port in zip(e.axes, self.axes, strict=True):
                port.targets = numbers[4][a.i]
        self.policy = self.authority = self.refused = self.resisted = self.E_policy = 0.0
        self.quiet = self.c_rules.patience + 1.0
        self.E_tank = self.c_rules.full
        self.wants = self.renewed = 0.0
        self.g_last = 1.0
        self.shared = 0.0
        for a, port in zip(e.axes, self.axes, strict=True):
            port.c_pull = numbers[0][a.i]
            port.action = port.target = port.goal = a.x_read
            port.goal_v = port.f_slewed = port.f_asked = port.f_law = port.f_policy = port.f_port = port.f_whole = 0.0
            if self.moves:
                port.x_lead = a.x_read
                port.away = port.pace = 0.0

    def late(self, run: Run, e: End, ticks: int, since: int) -> None:
        self.ticks_since = ticks

    def read(self, run: Run, e: End, k: int) -> None:
        if e.has.live:
            if not self.moves:
                for a, port in zip(e.axes, self.axes, strict=True):
                    divide_held(a.f, port)
        else:
            self.wants = scheduled(self.c_takes, k)
            if self.planned:
                self.draw(k)

    def draw(self, k: int) -> None:
        """Take the newest of the actions that have come by tick k."""
        before = self.n
        self.n = newest(self.due[1], before, k)
        self.renewed = 1.0 if self.n > before else 0.0
        for port in self.axes:
            port.action = port.targets[1][self.n - 1] if self.n > 0 else port.goal

    def situate(self, run: Run, e: End) -> None:
        if self.moves:
            self.lead(run, e)

    def lead(self, run: Run, e: End) -> None:
        """Put the transformer with the policy's motion between the readings and the law."""
        self.work = 0.0
        self.sigma = max(min(self.E_tank / self.c_rules.soft, 1.0), 0.0) * self.shared
        for a, port in zip(e.axes, self.axes, strict=True):
            port.f_port = held_at(self.shared, a.at.f_held, self.g_last * port.f_law)
            port.goal, port.goal_v = approach(port.c_pull.follower, port.x_lead, port.goal_v, port.target)
            port.goal_v = port.goal_v if self.shared > 0.0 else 0.0
            port.led = 0.5 * run.dt * (port.pace + self.sigma * port.goal_v)
            port.pace = self.sigma * port.goal_v
            self.work = self.work + max(port.f_port * port.led, 0.0)
        for a, port in zip(e.axes, self.axes, strict=True):
            port.dx_lead = (1.0 - self.shared) * a.at.dx + port.led
            port.x_lead, port.away = led(abs(port.led) + self.shared, a.at.x, port.dx_lead, port.away, port.x_lead)
            a.at = At(port.x_lead, (1.0 - self.shared) * a.at.v + port.pace, (1.0 - self.shared) * a.at.f,
                      port.f_port, port.dx_lead, a.at.fresh, a.at.age, a.at.dt, a.at.span, a.at.gain)

    def act(self, run: Run, e: End, k: int) -> None:
        passed = self.ticks_since if e.has.leaves_out else 1.0
        if self.moves:
            self.E_policy = self.E_policy + self.work
            self.E_tank = tank_step(self.c_rules, self.E_tank, self.work, elapsed(run, e))
            self.resisted = 0.0
            for port in self.axes:
                port.goal = port.x_lead
            self.judge(run, e, passed)
            self.shared = self.authority
            for a, port in zip(e.axes, self.axes, strict=True):
                port.f_law = a.f_cmd
                port.f_policy = self.shared * a.f_cmd
                a.f_cmd = (1.0 - self.shared) * a.f_cmd
        else:
            self.pull(run, e, passed)

    def pull(self, run: Run, e: End, passed: Any) -> None:
        """Add the policy's force to the law's."""
        self.settle(run, e, passed)
        self.judge(run, e, passed)
        share = self.authority
        if e.stage.operator:
            for group in e.stage.operator.groups:
                share = min(share, group.g)
        self.sigma = max(min(self.E_tank / self.c_rules.soft, 1.0), 0.0)
        for a, port in zip(e.axes, self.axes, strict=True):
            if self.authority > 0.0:
                port.goal, port.goal_v = approach(port.c_pull.follower, port.goal, port.goal_v, port.target)
            else:
                port.goal = a.x_read
                port.goal_v = a.v_read
            port.f_slewed = pulling(port.c_pull, share, port.goal, port.goal_v, a.x_read, a.v_read, port.f_slewed)
            port.f_asked = self.sigma * port.f_slewed
            port.f_law = a.f_cmd
            a.f_cmd = a.f_cmd - port.f_asked

    def settle(self, run: Run, e: End, passed: Any) -> None:
        """Pay for what the held force did over the last tick, and see whether a hand resists it."""
        self.work = 0.0
        self.along = 0.0
        self.strength = 0.0
        for a, port in zip(e.axes, self.axes, strict=True):
            self.work = self.work + max(port.f_policy * a.dx, 0.0)
            self.along = self.along + port.f_slewed * a.v_read
            self.strength = max(abs(port.f_slewed) / port.c_pull.f_max, self.strength)
        self.E_policy = self.E_policy + self.work
        self.E_tank = tank_step(self.c_rules, self.E_tank, self.work, elapsed(run, e))
        resists = self.along < 0.0 and self.strength > self.c_rules.grip
        self.resisted = self.resisted + passed if resists else 0.0

    def judge(self, run: Run, e: End, passed: Any) -> None:
        """Decide who has authority, and its share."""
        far = 0.0
        for port in self.axes:
            far = farther(abs(port.action - port.goal) / port.c_pull.leap, far)
        self.taken = self.renewed if far <= 1.0 else 0.0
        self.refused = self.refused + (self.renewed - self.taken)
        self.quiet = 0.0 if self.taken > 0.0 else self.quiet + passed
        for port in self.axes:
            port.target = port.action if self.taken > 0.0 else port.target
        self.allowed = 1.0 if self.g_last >= 1.0 else 0.0
        if e.stage.operator:
            for group in e.stage.operator.groups:
                self.allowed = min(self.allowed, 1.0 - group.released)
        self.policy = standing(self.c_rules, self.policy, self.wants, self.allowed, self.quiet, self.resisted)
        self.authority = share_step(self.c_rules, self.authority, self.policy, passed)


def divide_held(f: Any, port: Pulled) -> None:
    """Divide the force of one axis anew where another was held than its tick had commanded, as a live end may."""
    if f != port.f_whole:
        port.f_policy = part_of_policy(port.f_port, port.f_policy, f)
        port.f_port = f + port.f_policy
        port.f_whole = f


class ShareStage(Stage):
    """The parts of law and policy in the force that the caps have left."""

    name: ClassVar[str] = "handover_share"

    def act(self, run: Run, e: End, k: int) -> None:
        e.stage.handover.g_last = e.stage.watchdog.g if e.stage.watchdog else 1.0
        if not e.stage.handover.moves:
            for a, port in zip(e.axes, e.stage.handover.axes, strict=True):
                port.f_policy = part_of_policy(
                    e.stage.handover.g_last * port.f_law, e.stage.handover.g_last * port.f_asked, a.f_cmd)
                port.f_port = a.f_cmd + port.f_policy
                port.f_whole = a.f_cmd
