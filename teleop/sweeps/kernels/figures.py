"""Running figures of a kernel, in place of a record: worked out tick by tick in order.

Where several scenes run side by side, each leaves the run at its own tick: `LaneFigures`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from math import inf, nan, sqrt
from operator import add
from typing import Any, NamedTuple

from teleop.simulation.felt import SUMS, TINY, names, ranks
from teleop.simulation.masks import any_lane, store
from teleop.simulation.rest import LATE
from teleop.stages.end import Record, Recorder, Run, RunHas
from teleop.stages.ledger import WaveLedger
from teleop.stages.memory import get, put, ring
from teleop.sweeps.kernels.sums import FigureSums, force_of_law, place_of_law

ALONG = {  # metric that is itself kept along the run -> what else is with it
    "x_err_rms": "x_err", "x_err_max": "x_err", "f_err_rms": "f_err", "f_err_max": "f_err", "f_m_max": "f_m_max",
    "f_s_max": "f_s_max", "f_h_max": "f_h_max", "f_env_max": "f_env_max", "E_link_min": "waves", "E_link_end": "waves",
    "E_port_min": "energy", "E_port_end": "energy", "E_law_min": "stored", "E_law_end": "stored",
    "sent_fwd": "told", "sent_bwd": "told", "g_m_min": "watchdog", "g_s_min": "watchdog",
}
KEPT = {**{name: (what,) for name, what in ALONG.items()}, **SUMS, "energy_out": ("energy",)}  # what is kept for each
SWINGS = tuple([f"swing_{i}" for i in range(LATE)])  # of the late windows, see `teleop.simulation.rest`


def accumulators(name: str) -> tuple[str, ...]:
    """Name the values accumulated along the run for a figure."""
    return ("rest",) if name in SWINGS else KEPT[name]


class FigureLayout(NamedTuple):
    """Running values of a kernel: figures by themselves, groups of sums, and the largest steps of the force."""

    along: tuple[str, ...]
    groups: tuple[str, ...]
    ranks: int

    def names(self, axes: int) -> tuple[str, ...]:
        """Names of all its values, in order."""
        return (*self.along, *[name for group in self.groups for name in names(group, axes, self.ranks)])


def layout(measures: Sequence[str], ticks: int) -> FigureLayout:
    """Choose the running values for these figures of a run of so many ticks."""
    along = [name for name in measures if name in ALONG or name in SWINGS]
    if "energy_out" in measures and "E_port_min" not in along:
        along.append("E_port_min")
    groups = dict.fromkeys([group for name in measures if name in SUMS for group in SUMS[name]])
    return FigureLayout(tuple(along), tuple(groups), ranks(ticks) if "ranks" in groups else 0)


def most(top: float, size: float) -> float:
    """The greater of both; NaN stays."""
    return size if size > top or size != size else top  # noqa: PLR0124 - only NaN differs from itself


def least(low: float, size: float) -> float:
    """The smaller of both; NaN stays."""
    return size if size < low or size != size else low  # noqa: PLR0124


def root_mean(total: float, count: int) -> float:
    """Root of a mean square; NaN of nothing."""
    return sqrt(total / count) if count > 0 else float("nan")


def value_or_nan(value: float, count: int) -> float:
    """A figure of so many values; NaN of none."""
    return value if count > 0 else float("nan")


def magnitude1(a: float) -> float:
    """Magnitude in one axis."""
    return abs(a)


def magnitude2(a: float, b: float) -> float:
    """Magnitude in two axes, without squares that overflow where it does not."""
    top = max(abs(a), abs(b), TINY)
    a, b = a / top, b / top
    return top * sqrt(a * a + b * b)


def magnitude3(a: float, b: float, c: float) -> float:
    """Magnitude in three axes, as of two."""
    top = max(abs(a), abs(b), abs(c), TINY)
    a, b, c = a / top, b / top, c / top
    return top * sqrt(a * a + b * b + c * c)


def magnitude_of(*axes: float) -> float:
    """Magnitude in any number of axes, as of two."""
    top = TINY
    for a in axes:
        top = max(top, abs(a))
    total = 0.0
    for a in axes:
        total = total + a / top * (a / top)
    return top * sqrt(total)


MAGNITUDES = {1: magnitude1, 2: magnitude2, 3: magnitude3}  # written out: of few axes that is quicker


class Past(Record):
    """State of one axis some ticks ago, and the distance of the other end from it."""

    old_x: Any  # places of the master, m
    old_f: Any  # forces on what the slave touches, N
    d_x: float
    d_f: float


class WindowRange(Record):
    """The place of one axis of one end in a window, see `teleop.simulation.rest`."""

    low: float  # the lowest so far, m
    high: float
    rise: float  # the largest so far, m
    fall: float


class RunningFigures(Recorder):
    """The figures and sums of a layout, and whether all is finite at the end."""

    axes: tuple[Past, ...]
    magnitude: Callable[..., Any]
    lag_x: Any  # ticks by which the master's place is compared
    lag_f: Any
    n_x: Any  # how many ticks were compared
    n_f: Any
    x_err_sq: float
    x_err_max: float
    f_err_sq: float
    f_err_max: float
    f_m_max: float
    f_s_max: float
    f_h_max: float
    f_env_max: float
    E_link: float
    E_link_min: float
    E_port: float
    E_port_min: float
    E_law: float
    E_law_min: float
    g_m_min: float
    g_s_min: float
    told_m: float  # messages that the master sent
    told_s: float
    told_of: float  # ticks
    start: int  # the first tick of the late windows
    window: int  # ticks of each
    next: int  # the tick at which the next begins
    swing_0: float  # of the late windows that are over, the newest last, m
    swing_1: float
    swing_2: float
    swing_3: float
    swing_4: float
    size: int  # of a ring
    finite: float  # 1.0 if all is finite at the end, else 0.0

    def __init__(self, axes: int, has: RunHas, wanted: FigureLayout) -> None:
        super().__init__()
        self.measures = wanted.along
        self.ledgers = ("E_link",) * has.waves + ("E_port",) * has.energy + ("E_law",) * has.stored
        self.least_of_ledgers = tuple([f"{name}_min" for name in self.ledgers])
        self.keeps = frozenset([each for name in wanted.along for each in accumulators(name)])
        if "turns" in wanted.groups:
            self.keeps |= {"rest"}
        self.axes = tuple([Past(f"{i}") for i in range(axes)])
        self.places = tuple([WindowRange(f"{e}{i}_place") for e in ("m", "s")[: 1 + has.slave] for i in range(axes)])
        self.groups = frozenset(wanted.groups)
        self.sums = FigureSums(axes, wanted.groups, wanted.ranks)
        self.cells = tuple([cell for group in wanted.groups for cell in self.sums.cells(group, self.places)])

    def begin(self, run: Run, request: Any, size: int) -> None:
        """Before the first tick."""
        self.lag_x = request[0]
        self.lag_f = request[1]
        self.size = size
        if "x_err" in self.keeps:
            self.x_err_sq = self.x_err_max = 0.0
            for m, acc in zip(run.m.axes, self.axes, strict=True):
                acc.old_x = ring(m.x, size)
        if "f_err" in self.keeps:
            self.f_err_sq = self.f_err_max = 0.0
            for m, acc in zip(run.m.axes, self.axes, strict=True):
                acc.old_f = ring(m.x, size)
        for name in ("f_m_max", "f_s_max", "f_h_max", "f_env_max"):
            if name in self.keeps:
                setattr(self, name, 0.0)
        for name in self.ledgers:
            setattr(self, name, 0.0)
        for name in self.least_of_ledgers:
            setattr(self, name, inf)
        if run.m.stage.watchdog:
            self.g_m_min = 1.0
            self.g_s_min = 1.0
        self.told_m = self.told_s = self.told_of = 0.0
        if "rest" in self.keeps:
            self.start = self.next = request[-3]
            self.window = request[-2]
            self.swing_0 = self.swing_1 = self.swing_2 = self.swing_3 = 0.0
            for place in self.places:
                place.low = place.high = place.rise = place.fall = 0.0
        self.sums.begin(run, request)

    def step(self, run: Run, k: int) -> None:
        """After both ends' tick k."""
        if "x_err" in self.keeps:
            self.track_x(run, k)
        if "f_err" in self.keeps:
            self.track_f(run, k)
        if "f_m_max" in self.keeps:
            self.f_m_max = most(self.f_m_max, self.magnitude(*[a.f for a in run.m.axes]))
        if "f_s_max" in self.keeps:
            self.f_s_max = most(self.f_s_max, self.magnitude(*[a.f for a in run.s.axes]))
        if "f_h_max" in self.keeps:
            self.f_h_max = most(self.f_h_max, self.magnitude(*[a.f_ext for a in run.m.axes]))
        if "f_env_max" in self.keeps:
            self.f_env_max = most(self.f_env_max, self.magnitude(*[a.f_ext for a in run.s.axes]))
        if run.has.waves:
            self.E_link = energy_in_link(run.m.stage.wave_ledger, run.s.stage.wave_ledger)
            self.E_link_min = least(self.E_link_min, self.E_link)
        if run.has.energy:
            self.E_port = energy_of_ports(run)
            self.E_port_min = least(self.E_port_min, self.E_port)
        if run.has.stored:
            self.E_law = run.m.stage.law_ledger.E_law + run.s.stage.law_ledger.E_law
            self.E_law_min = least(self.E_law_min, self.E_law)
        if run.m.stage.watchdog:
            self.g_m_min = least(self.g_m_min, run.m.stage.watchdog.g)
            self.g_s_min = least(self.g_s_min, run.s.stage.watchdog.g)
        self.count_messages(run)
        if "rest" in self.keeps:
            self.look(run, k)
        if len(self.groups) > 0:
            self.add(run, k)

    def add(self, run: Run, k: int) -> None:
        """The sums of this tick."""
        if "free" in self.groups:
            self.sums.feel(run, k)
        if "jerk" in self.groups:
            self.sums.smooth(run, self.magnitude(*[a.f - acc.f_was for a, acc in zip(
                run.m.axes, self.sums.axes, strict=True)]), k)
        if "free" in self.groups or "jerk" in self.groups:
            self.sums.keep(run)
        if len(self.sums.at_end) > 0:
            self.sums.end(run, k)
        if "turns" in self.groups:
            self.sums.turn(run, k, self.start, self.window)

    def count_messages(self, run: Run) -> None:
        """The messages that the ends sent, and the ticks."""
        if "told" in self.keeps:
            self.told_m = self.told_m + run.m.stage.deadband.send
            self.told_s = self.told_s + run.s.stage.deadband.send
            self.told_of = self.told_of + 1.0

    def track_x(self, run: Run, k: int) -> None:
        """The slave's place against the master's of `lag_x` ticks ago, 0 before there is one."""
        for m, acc in zip(run.m.axes, self.axes, strict=True):
            put(acc.old_x, k, self.size, place_of_law(run.m, m))
        self.n_x = k + 1 - self.lag_x
        for s, acc in zip(run.s.axes, self.axes, strict=True):
            past = get(acc.old_x, k - self.lag_x, self.size)
            acc.d_x = place_of_law(run.s, s) - past if k >= self.lag_x else 0.0
        err = self.magnitude(*[acc.d_x for acc in self.axes])
        self.x_err_sq = self.x_err_sq + err * err
        self.x_err_max = most(self.x_err_max, err)

    def track_f(self, run: Run, k: int) -> None:
        """The master's force against that on what the slave touches of `lag_f` ticks ago, 0 before there is one."""
        for s, acc in zip(run.s.axes, self.axes, strict=True):
            put(acc.old_f, k, self.size, force_of_law(run.s, s))
        self.n_f = k + 1 - self.lag_f
        for m, acc in zip(run.m.axes, self.axes, strict=True):
            acc.d_f = m.f - get(acc.old_f, k - self.lag_f, self.size) if k >= self.lag_f else 0.0
        err = self.magnitude(*[acc.d_f for acc in self.axes])
        self.f_err_sq = self.f_err_sq + err * err
        self.f_err_max = most(self.f_err_max, err)

    def look(self, run: Run, k: int) -> None:
        """The places of both ends in the late windows."""
        if k == self.next:
            self.next = k + self.window
            self.close(run)
            self.swing_0 = self.swing_1
            self.swing_1 = self.swing_2
            self.swing_2 = self.swing_3
            self.swing_3 = self.swing_4
            for a, acc in zip([a for e in run.ends for a in e.axes], self.places, strict=True):
                acc.low = a.x
                acc.high = a.x
                acc.rise = 0.0
                acc.fall = 0.0
        elif k > self.start:
            for a, acc in zip([a for e in run.ends for a in e.axes], self.places, strict=True):
                if a.x < acc.low:
                    acc.low = a.x
                    acc.fall = max(acc.fall, acc.high - a.x)
                elif a.x > acc.high:
                    acc.high = a.x
                    acc.rise = max(acc.rise, a.x - acc.low)
                else:
                    acc.rise = max(acc.rise, a.x - acc.low)
                    acc.fall = max(acc.fall, acc.high - a.x)

    def close(self, run: Run) -> None:
        """The swing of a window that is over."""
        self.swing_4 = 0.0
        for acc in self.places:
            self.swing_4 = most(self.swing_4, least(acc.rise, acc.fall))

    def outcome(self, run: Run, ticks: int, complete: bool) -> Any:
        """The ticks that ran, below zero if the run left its bounds in the last of them, and the figures."""
        self.finish(run)
        return ticks if complete else -ticks, self.all(run)

    def all(self, run: Run) -> tuple[Any, ...]:
        """The figures in order, the sums, and 1.0 if all is finite."""
        return (*[self.figure(run, name) for name in self.measures],
                *[getattr(record, field) for record, field in self.cells], self.finite)

    def finish(self, run: Run) -> None:
        """The end of the last window, and whether positions, velocities, forces and ledgers are finite."""
        if "rest" in self.keeps:
            self.close(run)
        self.finite = 1.0 if reduce(add, [  # what is not finite, less itself, is NaN
            *[getattr(a, field) - getattr(a, field) for e in run.ends for field in ("x", "v", "f") for a in e.axes],
            *[getattr(self, name) - getattr(self, name) for name in self.ledgers]]) < 1.0 else 0.0

    def figure(self, run: Run, name: str) -> Any:
        """Work out a figure at the end."""
        if name == "x_err_rms":
            return root_mean(self.x_err_sq, self.n_x)
        if name == "x_err_max":
            return value_or_nan(self.x_err_max, self.n_x)
        if name == "f_err_rms":
            return root_mean(self.f_err_sq, self.n_f)
        if name == "f_err_max":
            return value_or_nan(self.f_err_max, self.n_f)
        if name in ("E_link_end", "E_port_end", "E_law_end"):
            return self.E_link if name == "E_link_end" else self.E_port if name == "E_port_end" else self.E_law
        if name in ("sent_fwd", "sent_bwd"):
            return (self.told_m if name == "sent_fwd" else self.told_s) / self.told_of
        return getattr(self, name)


class LaneFigures(RunningFigures):
    """The same of scenes side by side, each stored when it leaves its bounds, or at the end."""

    out: Any
    alive: Any  # mask of the scenes that are within their bounds
    within: Any
    left: Any

    def begin(self, run: Run, request: Any, size: int) -> None:
        RunningFigures.begin(self, run, request, size)
        self.out = request[2]
        self.alive = True

    def lost(self, run: Run, x_limit: Any, k: int) -> Any:
        self.within = all(-x_limit < a.x < x_limit for e in run.ends for a in e.axes)
        self.left = self.alive and not self.within
        if any_lane(self.left):
            self.finish(run)
            store(self.out, self.left, -(k + 1), self.all(run))
            self.alive = self.alive and self.within
            for e in run.ends:
                for a in e.axes:
                    a.x = a.x if self.alive else nan  # a scene that is lost moves no more, and costs no more
        return not any_lane(self.alive)

    def outcome(self, run: Run, ticks: int, complete: bool) -> Any:
        self.finish(run)
        if complete:
            store(self.out, self.alive, ticks, self.all(run))


def energy_in_link(m: WaveLedger, s: WaveLedger) -> Any:
    """The energy that the link keeps, J."""
    return (m.E_in - s.E_out) + (s.E_in - m.E_out)


def energy_of_ports(run: Run) -> Any:
    """The energy that the ports took in, J."""
    if not run.has.slave:
        return run.m.stage.port_ledger.E_port
    return run.m.stage.port_ledger.E_port - run.s.stage.port_ledger.E_port
