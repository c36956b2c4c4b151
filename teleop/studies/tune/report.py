"""What a search says: its text, its document, and its points as CSV."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping, Sequence
from csv import writer
from math import inf
from pathlib import Path
from typing import Any

from teleop.errors import number_of
from teleop.scene.loading import load_scene
from teleop.simulation.facts import unmet
from teleop.simulation.metrics import UNITS
from teleop.simulation.result import head
from teleop.storage.files import replacing_text
from teleop.studies.margin import Margin
from teleop.studies.tune.objective import FREE, OBJECTIVES, SCENE, Score
from teleop.studies.tune.search import Tuned
from teleop.terminal.answer import finite
from teleop.terminal.table import columns, facts
from teleop.terminal.units import si

SHOWN = {  # what a term is called, and the figure behind it: task and metric
    "tracking": ("tracking error, rms", SCENE, "x_err_rms"),
    "drag": ("greatest force in free space", FREE, "f_m_max"),
    "touch": ("steady force on the environment", SCENE, "f_env_end"),
    "feel": ("steady force on the hand", SCENE, "f_m_end"),
    "rough": ("change of the force on the hand, rms", SCENE, "jerk_rms"),
    "force": ("force error, rms", SCENE, "f_err_rms"),
}


def text(tuned: Tuned) -> str:
    """The search on a terminal."""
    goal = OBJECTIVES[tuned.objective]
    rows = [
        ("tuned", f"law {tuned.law} in {tuned.scene}: {number_of(len(tuned.names), 'parameter')}, "
                  f"{number_of(tuned.rows, 'row')} of {tuned.budget}, {number_of(len(tuned.tried), 'point')}, "
                  f"seed {tuned.seed}, engine {tuned.engine}"),
        ("objective", f"{tuned.objective}: {goal.sentence}"),
        *[("margin", f"the constraints are kept too where the environment is {tuned.margin:g} times as stiff")
          ] * (tuned.margin > 1.0),
    ]
    if tuned.feasible:
        own = "" if tuned.default is None else f" ({_value(tuned.default)} untuned)"
        rows.append(("result", f"{_settings(tuned)}: {tuned.score.value:.3f}{own}"))
        rows += [("but", sentence) for sentence in conditions(tuned)]
    else:
        rows.append(("result", "no point keeps the constraints"))
        rows.append(("nearest", f"{_settings(tuned)}: {tuned.score.broken}"))
    if tuned.linear is not None:
        rows.append(("linear", linear_text(tuned.linear)))
    stay = [f"{name} {why}" for name, why in tuned.ranges.stay.items()]
    rows += [("not turned", "; ".join(stay))] * bool(stay)
    edge = at_edge(tuned)
    rows += [("at an edge", f"{', '.join(edge)}: the best value is at the end of the range that was searched")] * bool(
        edge and tuned.feasible)
    told = [facts(rows), "", _figures(tuned), ""]
    front = tuned.front()
    if front:
        told.append(f"front of tracking error against drag: {number_of(len(front), 'point')}, in front.csv")
    told.append(f"run it: {shlex.join(tuned.command())}")
    return "\n".join(told)


def conditions(tuned: Tuned) -> list[str]:
    """A sentence for each condition of the law that link and bodies break with the best point, as a run of it notes."""
    best = load_scene(tuned.scene, **tuned.knobs)
    return unmet(best, tuned.seed)


def linear_text(told: Margin) -> str:
    """The margins of the linear loop in words."""
    if told.why:
        return f"no margins: {told.why}"
    where = f" {told.where}" if told.where else ""
    delay = "any further delay" if told.delay == inf else f"{si(told.delay, 's')} of further round trip"
    given = f"; {', '.join(told.assumed)}" if told.assumed else ""
    return f"gain margin {told.gain:.3g}{where}, and {delay}{given}"


def _value(found: Score) -> str:
    return found.broken or f"{found.value:.3f}"


def _settings(tuned: Tuned) -> str:
    return " ".join(f"{name}={value:g}" if isinstance(value, float) else f"{name}={value}"
                    for name, value in tuned.best.items())


def at_edge(tuned: Tuned) -> list[str]:
    """The parameters whose best value is the least or the greatest that was looked at."""
    return [name for name, span in tuned.ranges.turned.items()
            if tuned.best[name] in (span.low, span.high, float(f"{span.low:.4g}"), float(f"{span.high:.4g}"))]


def figure(found: Score, task: str, metric: str) -> float | None:
    """A figure of a task, mean over the seeds; of a scene without contact, its own is that of free space."""
    return (found.figures.get(task) or found.figures.get(SCENE, {})).get(metric)


def _figures(tuned: Tuned) -> str:
    """Each term with the figure behind it: of the best point, of the untuned law, of the rod."""
    steady = tuned.rod.steady
    of_rod = {"tracking": 0.0, "drag": 0.0, "touch": steady, "feel": steady, "rough": None, "force": 0.0}
    lines: list[Sequence[str]] = [("", "tuned", "untuned", "rigid rod", "term", "untuned")]
    for name, (words, task, metric) in SHOWN.items():
        if name not in tuned.score.terms:
            continue
        cells = [_si(figure(found, task, metric), metric) for found in (tuned.score, tuned.default) if found]
        terms = [f"{found.terms[name]:.3f}" if found and name in found.terms else "" for found in
                 (tuned.score, tuned.default)]
        lines.append((words, *cells, _si(of_rod[name], metric), *terms))
    return columns(lines)


def _si(value: float | None, metric: str) -> str:
    return "" if value is None else si(value, UNITS[metric])


def document(tuned: Tuned, typed: Sequence[str]) -> dict[str, Any]:
    """The search as JSON can hold it."""
    sentence = "feasible" if tuned.feasible else f"nothing keeps the constraints; nearest: {tuned.score.broken}"
    return {
        **head(status="done" if tuned.feasible else "infeasible", sentence=sentence, scene=tuned.scene, mode="tune",
               parameters=tuned.settings, seed=tuned.seed, command=typed, dt=None),
        "law": tuned.law, "objective": tuned.objective, "says": OBJECTIVES[tuned.objective].sentence,
        "margin": tuned.margin, "budget": tuned.budget, "rows": tuned.rows, "points": len(tuned.tried),
        "engine": tuned.engine,
        "best": dict(tuned.best), **_document_of(tuned.score),
        "own": None if tuned.default is None else _document_of(tuned.default),
        "ranges": {name: [span.low, span.high] for name, span in tuned.ranges.turned.items()},
        "linear": None if tuned.linear is None else {
            **tuned.linear._asdict(), "gain": finite(tuned.linear.gain), "delay": finite(tuned.linear.delay)},
        "conditions": conditions(tuned), "not_turned": dict(tuned.ranges.stay), "at_edge": at_edge(tuned),
        "rod": tuned.rod._asdict(),
        "front": [{**values, **_document_of(found)} for values, found in tuned.front()],
        "run": tuned.command(),
    }


def _document_of(found: Score) -> dict[str, Any]:
    return {"value": finite(found.value), "broken": found.broken,
            "terms": {name: finite(value) for name, value in found.terms.items()},
            "values": [finite(value) for value in found.values],
            "figures": {task: {name: finite(value) for name, value in row.items()}
                        for task, row in found.figures.items()}}


def write_points(path: Path, names: Sequence[str], points: Iterable[tuple[Mapping[str, Any], Score]]) -> None:
    """Write points as CSV: their parameters, value, terms, figures and the constraint that they break."""
    told = [*points]
    terms = [name for name in SHOWN if any(name in found.terms for _, found in told)]
    with replacing_text(path) as file:
        lines = writer(file)
        lines.writerow([*names, "value", "broken", *terms, *(f"{SHOWN[name][2]}:{SHOWN[name][1]}" for name in terms)])
        for values, found in told:
            figures = [figure(found, *SHOWN[name][1:]) for name in terms]
            lines.writerow([*(values[name] for name in names), _cell(found.value), found.broken,
                            *(_cell(found.terms.get(name)) for name in terms), *map(_cell, figures)])


def _cell(value: float | None) -> Any:
    return "" if finite(value) is None else value
