"""The reference: the run that all others are measured against, and how large its own error is.

Where every body has a closed form, the reference is the run with the bodies moved in 40 digits, and its own error is
what rounding to floats makes of its columns. Elsewhere it is the run by scipy's DOP853, held tight, with every change
of mode located. Its own error is then an estimate: how far the same run by Radau differs from it over the whole run,
or, where Radau would take too long, the same run by DOP853 at a looser tolerance.

What that costs, on a slow core: 40 digits 0.1 ms a tick; without a closed form a tick in contact 2 to 10 ms by Radau
and 0.3 to 1 ms by DOP853, so that 10 s of contact at 1 kHz take about a minute; free flight and sticking cost next to
nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from teleop.analysis.precision.contenders import there
from teleop.analysis.precision.reference.deviation import Steps, errors
from teleop.analysis.precision.reference.digits import DIGITS, run_in_digits
from teleop.analysis.precision.reference.reference import LONG, bodies_moved, reference_bodies
from teleop.errors import Refused
from teleop.scene.scene import Scene
from teleop.simulation.integrators.parts import core_of, has_closed_form, stills
from teleop.simulation.result import Result
from teleop.simulation.virtual import run
from teleop.terminal.table import si

PATIENCE = 90.0  # s that the reference may take unasked
SAMPLES = 24  # ticks from which its time is foretold
FINER, TIGHTER = 1e-2, 1e-4  # of the tolerance: of the runs that the stack's own is compared with
LOOSER = 1e-12  # rtol of DOP853 where it is compared with itself
OFTEN = 50  # steps between two reports of progress

Show = Callable[[float, str], None]


@dataclass(frozen=True, kw_only=True)
class Truth:
    """The reference, the run of the stack's own bodies beside it, and how both compare."""

    method: str  # of the reference: "40 digits" or DOP853
    sentence: str
    result: Result  # the reference
    stack: Result  # the run of the stack's own bodies
    off: Mapping[str, float]  # the reference's own error by column: its rounding, or an estimate
    steps: Mapping[str, Steps]  # the stack's single steps beside those of each reference
    estimates: Mapping[str, Mapping[str, float]]  # of the stack's integration by itself, by end
    bound: Mapping[str, float] | None  # of the error of the stack's own run, by column, see `bound_of`
    took: float  # s, a run of the stack's own bodies


def truth_of(scene: Scene, seed: int, clock: Callable[[], int], *, patient: bool, show: Show) -> Truth:
    """The reference of `scene` for one seed; `show` takes how much is done, 0 to 1, and a text.

    Raises `Refused` where the reference would take too long, unless `patient`, where a body has no closed form and
    scipy is not installed, and where no equation is known of an environment.
    """
    exact = has_closed_form(scene)
    if not exact and not there():
        raise Refused(f"scene {scene.name} has no closed form, and its reference is made by scipy, which is not "
                      "installed; type: pip install scipy")
    show(0.0, "the stack's own run")
    began = clock()
    stack = run(scene, seed=seed)
    took = (clock() - began) / 1e9
    result, method, sentence, off, steps = (_in_digits(scene, seed, stack.ticks, show) if exact else
                                            _integrated(scene, seed, clock, stack.ticks, patient=patient, show=show))
    estimates: Any = stack.extra.get("integration", {})
    return Truth(method=method, sentence=sentence, result=result, stack=stack, off=off, steps=steps,
                 estimates=estimates, bound=None if exact else bound_of(scene, stack), took=took)


def bound_of(scene: Scene, result: Result) -> dict[str, float] | None:
    """A bound of the error of `result`, the stack's own run of `scene`, by column; None where it cannot be told.

    The estimates of single ticks bound it not: an error of speed goes on in free flight, and a loop may enlarge it. So
    the same run is made with a smaller tolerance, whose error E' is taken to be at most half of the error E of
    `result`, as the sums of both runs' estimates are. Then the difference D of the two is at least E - E', and E at
    most 2 D. Where the estimates are not halved at either of two tolerances, all that is left is rounding: None.
    """
    whole = _summed(result)
    if not whole > 0.0:
        return None
    for factor in (FINER, TIGHTER):
        finer = run(replace(scene, tolerance=factor * scene.tolerance), seed=result.seed)
        if _summed(finer) <= 0.5 * whole:
            return {name: 2.0 * error.max for name, error in errors(result.trace, finer.trace).items()}
    return None


def _summed(result: Result) -> float:
    """The sum of the estimates of single ticks, of both ends, m."""
    ends: Any = result.extra.get("integration", {})
    return float(sum(one.get("error_estimate_sum", 0.0) for one in ends.values()))


Found = tuple["Result", str, str, Mapping[str, float], Mapping[str, Steps]]


def _in_digits(scene: Scene, seed: int, ticks: int, show: Show) -> Found:
    method = f"{DIGITS} digits"
    result, off, steps = run_in_digits(scene, seed, _progress(show, f"the reference in {method}", ticks * scene.axes))
    return result, method, (f"each body's equation of motion solved in {method} at every tick; its columns are rounded "
                            f"to floats, by at most {_sizes(off)}"), off, {method: steps}


def _integrated(scene: Scene, seed: int, clock: Callable[[], int], ticks: int, *, patient: bool, show: Show) -> Found:
    seconds = _foretold(scene, seed, clock, ticks)
    if seconds["DOP853"] > PATIENCE and not patient:
        raise Refused(f"the reference of {ticks} ticks without a closed form would take about "
                      f"{seconds['DOP853']:.0f} s; shorten the run, for example --set duration=5, or write --rounds 1 "
                      "and wait")
    second = "Radau" if patient or seconds["Radau"] <= PATIENCE else "DOP853"
    half = seconds["DOP853"] / max(seconds["DOP853"] + seconds[second], 1e-9)
    masters = scene.axes if scene.master.friction > 0.0 else 0  # without a closed form, as slaves with a core are
    moved = max(masters + sum(core_of(still) is not None for still, _ in stills(scene)), 1) * ticks

    def by(solver: str, rtol: float, before: float, after: float) -> tuple[Result, Steps]:
        steps = Steps()
        tell = _progress(lambda part, text: show(before + part * (after - before), text), f"the reference by {solver}",
                         moved)
        return run(scene, seed=seed, bodies=reference_bodies(scene, solver, rtol=rtol, steps=steps, tell=tell)), steps

    result, steps = by("DOP853", LONG["DOP853"], 0.0, half)
    rtol = LONG["Radau"] if second == "Radau" else LOOSER
    check, beside = by(second, rtol, half, 1.0)
    off = {name: error.max for name, error in errors(check.trace, result.trace).items()}
    differs = f"by {second} at {rtol:.0e} the run differs by at most {_sizes(off)}"
    if second == "DOP853":
        differs += f" (Radau would take about {seconds['Radau']:.0f} s; --rounds 1 has it)"
    return (result, "DOP853", f"scipy's DOP853 at rtol {LONG['DOP853']:.0e}, every change of mode located; {differs}",
            off, {"DOP853": steps} | ({second: beside} if second != "DOP853" else {}))


def _sizes(off: Mapping[str, float]) -> str:
    return f"{si(off['x_s'], 'm')}, {si(off['f_env'], 'N')}"


def _progress(show: Show, text: str, steps: int) -> Callable[[], None]:
    """A function to call before each of so many steps; it shows how much of them is done."""
    done = 0

    def tell() -> None:
        nonlocal done
        done += 1
        if done % OFTEN == 0:
            show(min(done / steps, 1.0), text)

    return tell


def _foretold(scene: Scene, seed: int, clock: Callable[[], int], ticks: int) -> dict[str, float]:
    """Seconds that the run would take by each solver, from some steps of the stack's own run, evenly spaced."""
    import scipy.integrate  # noqa: F401 - not within the first step that is timed

    every = max(1, ticks // SAMPLES) | 1  # odd, so that two bodies which take turns are both among them
    seconds = {}
    for solver, rtol in LONG.items():
        made, timed, spent = 0, 0, 0

        def watch(solver_step: Any, stack_step: Any, state: tuple[Any, ...], z: Any) -> tuple[Any, Any]:
            nonlocal made, timed, spent
            if made % every == 0:
                began = clock()
                solver_step(*state)
                spent, timed = spent + clock() - began, timed + 1
            made += 1
            x, v, *_, z = stack_step(z)
            return (x, v, 0), z

        run(scene, seed=seed, bodies=bodies_moved(scene, solver, rtol, watch))
        seconds[solver] = spent / 1e9 / timed * made
    return seconds
