"""The run that all others are measured against, and what it is worth.

Where every body has a closed form it is the stack's own run, which is exact; what its rounding comes to is another
one whose steps are put off by as much. Elsewhere it is the run by scipy's Radau, held tight, with every change of
mode located, and beside it the same by DOP853: what tells the two apart over the whole run is what the reference is
taken to be off by. Where Radau would take too long DOP853's run is the reference, put off by what tells the two
apart in single ticks.

What that costs, on a slow core: a tick in contact 2 to 10 ms by Radau and 0.3 to 1 ms by DOP853, so that 10 s of
contact at 1 kHz take about a minute; free flight and sticking cost next to nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from teleop.analysis.precision.contenders.outsiders import there
from teleop.analysis.precision.reference.agreement import Agreement, agreement, wobbled
from teleop.analysis.precision.reference.deviation import errors
from teleop.errors import Refused
from teleop.simulation.integrators.parts import closed
from teleop.simulation.virtual import run
from teleop.terminal.units import si

if TYPE_CHECKING:
    from teleop.scene.scene import Scene
    from teleop.simulation.result import Result

PATIENCE = 90.0  # s that the reference may take unasked
SAMPLES = 24  # ticks from which its time is foretold


@dataclass(frozen=True, kw_only=True)
class Truth:
    """The reference run, that of the stack's own bodies beside it, and what each is worth."""

    method: str  # exact, Radau or DOP853
    sentence: str
    result: Result
    own: Result  # put off by its rounding if the method is exact
    off: Mapping[str, float]  # the largest error of the reference itself, by quantity
    agreement: Agreement
    estimates: Mapping[str, Mapping[str, float]]  # of its integration by the stack itself, by end
    took: float  # s, a run of the stack's own bodies

    @property
    def estimated(self) -> float | None:
        """What the stack's own estimates sum to, m; None where nothing was integrated."""
        sums = [one["error_estimate_sum"] for one in self.estimates.values() if "error_estimate_sum" in one]
        return sum(sums) if sums else None


def truth_of(scene: Scene, seed: int, clock: Callable[[], int], *, patient: bool, show: Callable[[float, str], None]
             ) -> Truth:
    """The truth about `scene`; `show` is told how much is done. Refused where it would take too long unless `patient`.

    Refused as well where there is no closed form and no scipy to do without.
    """
    exact = closed(scene)
    if not exact and not there():
        raise Refused(f"scene {scene.name} has no closed form, and its reference is made by scipy, which is not "
                      "installed; type: pip install scipy")
    show(0.0, "the stack's own run")
    began = clock()
    own = run(scene, seed=seed)
    took = (clock() - began) / 1e9
    worth = agreement(scene, own.trace, seed)
    if not exact:
        return _integrated(scene, seed, clock, own, worth, took, patient=patient, show=show)
    wobble = run(scene, seed=seed, bodies=wobbled(scene, worth))
    return Truth(method="exact", sentence="the exact steps themselves", result=own, own=wobble,
                 off=_apart(wobble, own), agreement=worth, estimates={}, took=took)


def _apart(one: Result, other: Result) -> dict[str, float]:
    return {name: error.max for name, error in errors(one.trace, other.trace).items()}


def _integrated(scene: Scene, seed: int, clock: Callable[[], int], own: Result, worth: Agreement, took: float, *,
                patient: bool, show: Callable[[float, str], None]) -> Truth:
    from teleop.analysis.precision.reference.tight import reference_bodies

    seconds, x, v = _foretold(scene, seed, clock, own.ticks)
    if seconds["DOP853"] > PATIENCE and not patient:
        raise Refused(f"the reference of {own.ticks} ticks without a closed form would take about "
                      f"{seconds['DOP853']:.0f} s; shorten the run, for example --set duration=5, or write --rounds 1 "
                      "and wait")
    both = patient or seconds["Radau"] <= PATIENCE
    total = seconds["DOP853"] + seconds["Radau"] * both

    def by(solver: str, before: float) -> Result:
        done = 0

        def tell() -> None:
            nonlocal done
            done += 1
            if done % 50 == 0:
                part = min(done / (own.ticks * bodies_count), 1.0)
                show(min((before + part * seconds[solver]) / max(total, 1e-9), 1.0), f"the reference by {solver}")

        return run(scene, seed=seed, bodies=reference_bodies(scene, solver, tell))

    bodies_count = max(_unclosed(scene), 1)
    quick = by("DOP853", 0.0)
    if both:
        result, method = by("Radau", seconds["DOP853"]), "Radau"
        off = _apart(quick, result)
        sentence = ("scipy's Radau at rtol 1e-12, every change of mode located; by DOP853 the run differs by at most "
                    f"{si(off['x_s'], 'm')}, {si(off['f_env'], 'N')}")
    else:
        result, method = quick, "DOP853"
        least = replace(worth, x=max(x, 1e-17), v=max(v, 1e-17))
        bodies = wobbled(scene, least, reference_bodies(scene, "DOP853"))
        off = _apart(run(scene, seed=seed, bodies=bodies), quick)
        sentence = (f"scipy's DOP853 at rtol 3e-14, every change of mode located; Radau, which would take about "
                    f"{seconds['Radau']:.0f} s for the run (--rounds 1 has it), differs in one tick by at most "
                    f"{si(x, 'm')}, {si(v, 'm/s')}: put off by as much at every tick the run differs by at most "
                    f"{si(off['x_s'], 'm')}, {si(off['f_env'], 'N')}")
    estimates: Any = own.extra.get("integration", {})
    return Truth(method=method, sentence=sentence, result=result, own=own, off=off, agreement=worth,
                 estimates=estimates, took=took)


def _unclosed(scene: Scene) -> int:
    """How many bodies have no closed form."""
    from teleop.simulation.integrators.parts import core_of, stills

    return (scene.master.friction > 0.0) * scene.axes + sum(core_of(still) is not None for still, _ in stills(scene))


def _foretold(scene: Scene, seed: int, clock: Callable[[], int], ran: int) -> tuple[dict[str, float], float, float]:
    """Seconds that the run would take by each solver, and by how much (m, m/s) they differ in some single ticks."""
    from math import isfinite

    from teleop.analysis.precision.reference.tight import LONG, states

    ticks = frozenset(int(ran * (i + 0.5) / SAMPLES) for i in range(min(SAMPLES, ran)))
    watched, pairs = states(scene, ticks, seed)
    seconds = {"DOP853": 0.0, "Radau": 0.0}
    differences = [(0.0, 0.0)]
    for body, other in pairs:
        if body == "master" and scene.master.friction == 0.0:
            continue
        ends: list[list[tuple[Any, ...]]] = []
        for solver in seconds:
            move = other(solver, LONG[solver])
            began = clock()
            ends.append([move(*state) for state, _ in watched[body].values()])
            seconds[solver] += (clock() - began) / 1e9 / max(len(watched[body]), 1) * ran
        differences += [(abs(a[0] - b[0]), abs(a[1] - b[1])) for a, b in zip(*ends, strict=True)]
    sound = [pair for pair in differences if all(map(isfinite, pair))]
    return seconds, max(x for x, _ in sound), max(v for _, v in sound)
