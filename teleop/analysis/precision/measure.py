"""Error against run time: the stack's own steps beside every other way to move the same bodies, in the same loop.

The diagram is a work-precision diagram as in SciML (Rackauckas & Nie, J. Open Res. Softw. 5 (2017)). A method is
*beaten* if another one is at least as accurate and more than 1.2 times faster. Its accuracy is the largest error of
the slave's position and the largest error of the force on the environment; both count. Run times are medians over
rounds in which the methods take turns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf, isfinite, log10
from statistics import median
from typing import Any

import numpy as np

from teleop.analysis.models.by_axis import one_loop
from teleop.analysis.precision.contenders import SOLVERS, TOLERANCES, Contender, outsider_bodies, there
from teleop.analysis.precision.reference.deviation import (
    Error,
    contacts,
    distance,
    errors,
    missed,
    peak_ratio,
    touching,
)
from teleop.analysis.precision.reference.truth import Truth, truth_of
from teleop.errors import Refused
from teleop.physics.plant import move_free, move_gripped
from teleop.scene.scene import Scene
from teleop.simulation.bodies import Bodies, exact_bodies, reference_samples
from teleop.simulation.integrators.methods import METHODS
from teleop.simulation.integrators.nonlinear import goes
from teleop.simulation.integrators.parts import check_no_servo, has_closed_form, is_carried, slave_of, whole_plants
from teleop.simulation.integrators.stepped import method_bodies
from teleop.simulation.metrics import tracking
from teleop.simulation.result import Result
from teleop.simulation.virtual import run

Clock = Callable[[], int]
Move = Callable[..., tuple[Any, ...]]
Show = Callable[[float, str], None]

SUBSTEPS = (1, 4, 16, 64)
FASTER = 1.2
BUDGET = 45.0  # s that all contenders may take if the number of rounds is left to us
WITH_REFERENCE = 110.0  # s with a reference by scipy: what a quick one leaves is for more rounds
WHOLE_ROUNDS, MOST_ROUNDS = 3, 9  # then: rounds of all methods, and with more of the cheap ones, whose times vary most
CHEAP = 4  # sub-steps
OUTSIDE = 0.4  # of the budget is for scipy's solvers
MOST_UNASKED = 200_000  # ticks: with more the reference and a round do not fit into a minute
BINS = 800  # of the errors along the run
EULER = "semi_implicit_euler/1"


@dataclass(frozen=True, kw_only=True, slots=True)
class Entry:
    """Error and run time of one contender. If it diverged, the errors are those of the ticks before."""

    contender: Contender
    status: str
    sentence: str
    ns_per_tick: float
    runs: int
    errors: Mapping[str, Error]
    peak_ratio: float | None  # its largest force on the environment over that of the reference, if there is one
    missed: int  # contacts of the reference in which it never touched
    beaten_by: str | None = None

    @property
    def key(self) -> str:
        """Name of the contender."""
        return self.contender.key


@dataclass(frozen=True, kw_only=True)
class Precision:
    """The comparison on one scene.

    `entries` begin with the stack's own. `along` holds the errors along the run, each the largest within a stretch of
    ticks that begins at `t`. An error at or below `truth.off` may be the reference's own.
    """

    scene: Scene
    seed: int
    rounds: int
    truth: Truth
    contacts: int
    step_ns: Mapping[str, float]  # of moving all bodies by one tick, without the loop around it
    entries: Sequence[Entry]
    along: Mapping[str, Any] = field(repr=False)
    left_out: Mapping[str, str]  # and why
    too_slow: frozenset[str]  # of these, the contenders that there was no time for

    @property
    def result(self) -> Result:
        """The reference: the run that all contenders are measured against."""
        return self.truth.result


def contenders(scene: Scene) -> Iterator[Contender]:
    """List the contenders, the cheaper first. Raises `Refused` without a slave or its environment's equation."""
    slave_of(scene)
    check_no_servo(scene)
    exact = has_closed_form(scene)
    name, label = ("exact", "exact") if exact else ("default", f"default: SDIRK2 to {scene.tolerance:.0e} m a tick")
    yield Contender(method=name, label=label, bodies=exact_bodies(scene))
    for n in SUBSTEPS:
        for m in METHODS:
            if exact or goes(m):
                yield Contender(method=m.name, label=m.label, substeps=n, bodies=method_bodies(scene, m, n))
    if not there() or _rubs(scene):
        return
    for rtol in sorted(TOLERANCES, key=lambda rtol: abs(log10(rtol / 1e-6))):  # the middle one first
        for solver in SOLVERS:
            bodies = outsider_bodies(scene, solver, rtol)
            yield Contender(method=solver, label=f"scipy {solver}", rtol=rtol, bodies=bodies)


def unfit(scene: Scene) -> dict[str, str]:
    """Methods that are no contenders on this scene, and why."""
    reasons = {m.name: "no solver for its coupled stages where a body is not piecewise linear"
             for m in METHODS if not has_closed_form(scene) and not goes(m)}
    if _rubs(scene):
        reasons["scipy's solvers"] = "friction jumps at rest, where their steps would become endlessly small"
    return reasons


def _rubs(scene: Scene) -> bool:
    return scene.master.friction > 0.0 or slave_of(scene).friction > 0.0


def measure(
    scene: Scene, *, seed: int = 0, clock: Clock, rounds: int | None = None, show: Show = lambda *_: None
) -> Precision:
    """Compare every contender on `scene`.

    `clock` returns nanoseconds. `rounds` is how many runs of each are timed, of scipy's solvers one; left out,
    there are as many rounds and contenders as fit into `BUDGET` seconds. `show` takes how much is done, 0 to 1, and a
    text. Raises `Refused` for an environment whose equation is not known, and for a run too long to compare unasked.
    """
    _check(one_loop(scene), rounds)
    everyone = list(contenders(scene))
    share = 0.1 if has_closed_form(scene) else 0.5  # of the progress, for the reference
    began = clock()
    truth = truth_of(scene, seed, clock, patient=rounds is not None, show=lambda part, text: show(share * part, text))
    before, began = began, clock()
    budget = BUDGET if has_closed_form(scene) else max(BUDGET, WITH_REFERENCE - (began - before) / 1e9)
    reference = truth.result
    trace = reference.trace
    cost = run_costs(everyone, scene, trace, clock, truth.took)
    chosen, slow = (everyone, {}) if rounds else _affordable(everyone, cost)
    turns = _turns(chosen, rounds)
    total = sum(cost[c.key] for turn in turns for c in turn)
    if not rounds:
        total = min(total, max(budget - (clock() - began) / 1e9, sum(cost[c.key] for c in chosen)))
    times: dict[str, list[float]] = {c.key: [] for c in chosen}
    entries: dict[str, Entry] = {}
    touches, bins = contacts(touching(scene, trace)), range(0, reference.ticks, -(-reference.ticks // BINS))
    along = {"t": trace["t"][bins]} | {name: _most(size, bins) for name, size in tracking(scene, dict(trace)).items()}
    done = 0.0
    for i, turn in enumerate(turns):
        spent = (clock() - began) / 1e9
        if i and not rounds and spent + sum(cost[c.key] for c in turn) > budget:
            break
        for c in turn:
            show(share + (1.0 - share) * min(done / total, 0.99), f"round {i + 1}: {c.label} {c.step}")
            got = run(scene, seed=seed, clock=clock, bodies=c.bodies)
            times[c.key].append((got.run_time or 0.0) / got.ticks * 1e9)
            done += cost[c.key]
            if not i:
                got = truth.stack if c is everyone[0] else got
                entries[c.key] = _entry(c, got, trace, missed(touching(scene, got.trace), touches))
                along |= {f"{name}:{c.key}": _most(distance(name, got.trace, trace), bins) for name in ("x_s", "f_env")}
    show(1.0, "done")
    return Precision(
        scene=scene, seed=seed, rounds=len(times[everyone[0].key]), truth=truth, contacts=len(touches),
        step_ns=step_costs([c for c in chosen if c is everyone[0] or c.key == EULER], scene, trace, clock, 1000, 15),
        entries=verdicts([replace(entries[c.key], ns_per_tick=median(times[c.key]), runs=len(times[c.key]))
                          for c in chosen], truth.off, reference.status),
        along=along, left_out={**unfit(scene), **slow}, too_slow=frozenset(slow),
    )


def verdicts(entries: Sequence[Entry], off: Mapping[str, float] | None = None, status: str | None = None
             ) -> list[Entry]:
    """The entries, each with who beats it: the stack's own steps if they do, else the fastest that does.

    Errors below `off`, the reference's own (left out: those of the first entry), count as equal. A contender that
    diverged has an infinite error if the reference, whose `status` is given (left out: that of the first entry),
    did not; if the reference diverged too, the errors are those of the ticks before.
    """
    first = entries[0]
    floor = off or {name: error.max for name, error in first.errors.items()}
    wanted = status or first.status

    def accuracy(entry: Entry) -> list[float]:
        lost = entry.status == "diverged" != wanted
        pairs = [(entry.errors[name].max, floor[name]) for name in ("x_s", "f_env")]
        return [max(error, least) if isfinite(error) and not lost else inf for error, least in pairs]

    def beats(one: Entry, rival: Entry) -> bool:
        as_accurate = all(a <= b for a, b in zip(accuracy(one), accuracy(rival), strict=True))
        return as_accurate and rival.ns_per_tick > FASTER * one.ns_per_tick

    return [
        replace(e, beaten_by=min((o for o in entries if beats(o, e)),
                                 key=lambda o: (o.key != first.key, o.ns_per_tick)).key)
        if any(beats(o, e) for o in entries) else e
        for e in entries
    ]


def _check(scene: Scene, rounds: int | None) -> None:
    if rounds is not None and (isinstance(rounds, bool) or not isinstance(rounds, int) or rounds < 1):
        raise Refused(f"rounds must be a whole number of at least 1, not {rounds!r}; write --rounds 3")
    if rounds is None and scene.ticks > MOST_UNASKED:
        raise Refused(f"{scene.ticks} ticks are too many to compare within a minute; shorten the run with --set "
                      "duration=10, or write --rounds 1 and wait")


def _affordable(everyone: Sequence[Contender], cost: Mapping[str, float]) -> tuple[list[Contender], dict[str, str]]:
    """Contenders whose first round fits into the budget, and why the others are left out."""
    chosen, left_out, ours, theirs = [], {}, 0.0, 0.0
    for c in everyone:
        if c.rtol is None and ours + cost[c.key] <= (0.9 - OUTSIDE) * BUDGET:
            chosen.append(c)
            ours += cost[c.key]
        elif c.rtol and theirs + cost[c.key] <= OUTSIDE * BUDGET:
            chosen.append(c)
            theirs += cost[c.key]
        else:
            left_out[c.key] = f"a run would take about {cost[c.key]:.1f} s; a shorter duration or --rounds 1 has it"
    return chosen, left_out


def _turns(chosen: Sequence[Contender], rounds: int | None) -> list[list[Contender]]:
    """Contenders of each round: all in the first; scipy's solvers, which are far slower, are run once."""
    ours = [c for c in chosen if c.rtol is None]
    if rounds:
        return [list(chosen), *[ours] * (rounds - 1)]
    cheap = [c for c in ours if not c.substeps or c.substeps <= CHEAP]
    return [list(chosen), *[ours] * (WHOLE_ROUNDS - 1), *[cheap] * (MOST_ROUNDS - WHOLE_ROUNDS)]


def _entry(c: Contender, got: Result, want: Mapping[str, Any], unfelt: int) -> Entry:
    return Entry(
        contender=c, status=got.status, sentence=got.sentence, ns_per_tick=0.0, runs=0, errors=errors(got.trace, want),
        peak_ratio=peak_ratio(got.trace, want), missed=unfelt,
    )


def _most(size: Any, bins: range) -> Any:
    """Largest value within each stretch of ticks; NaN where there is none."""
    whole = np.full(len(bins) * bins.step, np.nan)
    whole[: len(size)] = size
    return np.fmax.reduce(whole.reshape(len(bins), bins.step), axis=1)


def step_costs(some: Sequence[Contender], scene: Scene, trace: Mapping[str, Any], clock: Clock, samples: int,
               rounds: int) -> dict[str, float]:
    """Nanoseconds to move all bodies by one tick from states of the run, by contender: the least of some rounds.

    An inner state, if there is one, is the one after the sampled tick before.
    """
    ran = len(trace["t"])
    at = range(0, ran, max(1, ran // samples))
    reference = reference_samples(scene)
    slaves, masters = ([list(zip(*(column(trace, f"{name}_{e}", i)[at].tolist() for name in "xvf"), strict=True))
                        for i in range(scene.axes)] for e in "sm")
    if reference is not None:
        masters = [[(*state, r[k], r[k + 1]) for k, state in zip(at, bodies, strict=True)]
                   for r, bodies in zip(reference, masters, strict=True)]
    elif some[0].bodies.inner_m:
        masters = [[(*state, 0.0, 0.0) for state in bodies] for bodies in masters]
    carried = [is_carried(plant) for plant in whole_plants(scene)]
    jobs: dict[str, list[tuple[Move, Any, list[tuple[Any, ...]]]]] = {}
    for c in some:
        bodies = c.bodies
        move = _master(bodies, held=reference is not None)
        inner = bodies.inner_m or (None,) * scene.axes
        jobs[c.key] = [_job(move, held, states, at, z)
                       for held, states, z in zip(bodies.master, masters, inner, strict=True)]
        jobs[c.key] += [_job(plant.move, plant.c, states, at, plant.start, ticks=ticks)
                        for plant, states, ticks in zip(bodies.slaves, slaves, carried, strict=True)]
    times: dict[str, list[float]] = {key: [] for key in jobs}
    for _ in range(rounds):
        for key, job in jobs.items():
            began = clock()
            for move, held, states in job:
                for state in states:
                    move(held, *state)
            times[key].append((clock() - began) / len(at))
    return {key: min(several) for key, several in times.items()}


def run_costs(everyone: Sequence[Contender], scene: Scene, trace: Mapping[str, Any], clock: Clock, each: float
              ) -> dict[str, float]:
    """Seconds that a run of each contender will take: `each` of the first one, and more where its steps take more."""
    step: dict[str, float] = {}
    for c in everyone:
        step |= step_costs([c], scene, trace, clock, 10 if c.rtol else 50, 2)
    first = step[everyone[0].key]
    return {key: each + max(0.0, ns - first) * 1e-9 * scene.ticks for key, ns in step.items()}


def column(trace: Mapping[str, Any], name: str, axis: int) -> Any:
    """Pick one axis of a column of the trace."""
    values = trace[name]
    return values if values.ndim == 1 else values[:, axis]


def _master(bodies: Bodies, *, held: bool) -> Move:
    """The function that moves the master."""
    if bodies.inner_m:
        move: Move = bodies.instead["move_held"]
        return move
    name, exact = ("move_gripped", move_gripped) if held else ("move_free", move_free)
    return bodies.instead.get(name, exact)  # type: ignore[no-any-return]


def _job(move: Move, c: Any, states: list[tuple[Any, ...]], at: range, z: Any, *, ticks: bool = False
         ) -> tuple[Move, Any, list[tuple[Any, ...]]]:
    """The function to time, its coefficients, and the states, each followed by the inner state if there is one.

    The inner state of an environment that moves begins with the tick.
    """
    if z is None:
        return move, c, states
    whole = []
    for k, state in zip(at, states, strict=True):
        z = (k, *z[1:]) if ticks else z
        whole.append((*state, z))
        z = move(c, *state, z)[-1]
    return move, c, whole
