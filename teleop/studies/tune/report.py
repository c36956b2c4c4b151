"""The command `teleop tune`, and the report of a search: text, document, points as CSV, and a plot."""

from __future__ import annotations

import shlex
from argparse import Namespace
from collections.abc import Iterable, Mapping, Sequence
from csv import writer
from functools import partial
from math import inf, isfinite
from pathlib import Path
from typing import Any

from teleop.errors import number_of
from teleop.knob import knobs_of_fields
from teleop.scene.axes import labels_of
from teleop.scene.loading import load_scene
from teleop.simulation.metrics import UNITS
from teleop.simulation.notes import unmet
from teleop.simulation.result import head
from teleop.storage.files import replacing_text
from teleop.studies.margin import Margin
from teleop.studies.tune.objective import FREE, OBJECTIVES, SCENE, Score
from teleop.studies.tune.search import LawSearch, SearchJob, Tuned
from teleop.terminal.answer import Answer, Task, WithUnit, command_of, finite, with_units
from teleop.terminal.options import knobs_from
from teleop.terminal.plotting import BLACK, BLUE, ORANGE, PALE, grid_lines, literal, new_figure, save
from teleop.terminal.progress import shown_for
from teleop.terminal.table import columns, facts, si

SHOWN = {  # the name of a term, and the figure behind it: task and metric
    "tracking": ("tracking error, rms", SCENE, "x_err_rms"),
    "drag": ("greatest force in free space", FREE, "f_m_max"),
    "touch": ("steady force on the environment", SCENE, "f_env_end"),
    "feel": ("steady force on the hand", SCENE, "f_m_end"),
    "rough": ("change of the force on the hand, rms", SCENE, "jerk_rms"),
    "force": ("force error, rms", SCENE, "f_err_rms"),
}


def find(args: Namespace) -> Task:
    """Search the law's parameters. Raises `Refused`."""
    playouts = [] if args.playouts is None else [each.strip() for each in args.playouts.split(",") if each.strip()]
    stem = "".join(c if c.isalnum() or c in "_-" else "-" for c in args.law.rsplit("/", 1)[-1]).strip("-") or "law"

    def work() -> Answer:
        with shown_for(args, args.budget) as show:
            job = SearchJob(args.scene, args.law, args.budget, args.seed, knobs_from(args), args.objective, args.margin,
                            playouts, args.engine)
            tuned = LawSearch(job, tell=show, workers=args.workers).run()
        return Answer(text(tuned), document(tuned, args.typed), plots={"tune": partial(draw, tuned)}, files={
            "points.csv": partial(write_points, tuned.names, tuned.tried),
            "front.csv": partial(write_points, tuned.names, tuned.front())})

    return Task(stem, work)


command = command_of(find, "tune")


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
        untuned = "" if tuned.default is None else f" ({_value(tuned.default)} untuned)"
        rows.append(("result", f"{_settings(tuned)}: {tuned.score.value:.3f}{untuned}"))
        rows += [("but", sentence) for sentence in unmet_conditions(tuned)]
    else:
        rows.append(("result", "no point keeps the constraints"))
        rows.append(("nearest", f"{_settings(tuned)}: {tuned.score.broken}"))
    if tuned.linear is not None:
        rows.append(("linear", linear_text(tuned.linear)))
    held = [f"{name} {why}" for name, why in tuned.ranges.held.items()]
    rows += [("not turned", "; ".join(held))] * bool(held)
    edge = at_edge(tuned)
    rows += [("at an edge", f"{', '.join(edge)}: the best value is at the end of the range that was searched")] * bool(
        edge and tuned.feasible)
    lines = [facts(rows), "", _figures(tuned), ""]
    front = tuned.front()
    if front:
        lines.append(f"front of tracking error against drag: {number_of(len(front), 'point')}, in front.csv")
    lines.append(f"run it: {shlex.join(tuned.command())}")
    return "\n".join(lines)


def unmet_conditions(tuned: Tuned) -> list[str]:
    """A sentence for each condition of the law that link and bodies break with the best point, as a run of it notes."""
    best = load_scene(tuned.scene, **tuned.knobs)
    return unmet(best, tuned.seed)


def linear_text(linear: Margin) -> str:
    """The margins of the linear loop in words."""
    if linear.why:
        return f"no margins: {linear.why}"
    where = f" {linear.where}" if linear.where else ""
    delay = "any further delay" if linear.delay == inf else f"{si(linear.delay, 's')} of further round trip"
    assumed = f"; {', '.join(linear.assumed)}" if linear.assumed else ""
    return f"gain margin {linear.gain:.3g}{where}, and {delay}{assumed}"


def _value(score: Score) -> str:
    return score.broken or f"{score.value:.3f}"


def _settings(tuned: Tuned) -> str:
    return " ".join(f"{name}={value:g}" if isinstance(value, float) else f"{name}={value}"
                    for name, value in tuned.best.items())


def at_edge(tuned: Tuned) -> list[str]:
    """The parameters with their best value at the end of their range."""
    return [name for name, span in tuned.ranges.searched.items()
            if tuned.best[name] in (span.low, span.high, float(f"{span.low:.4g}"), float(f"{span.high:.4g}"))]


def figure(score: Score, task: str, metric: str) -> float | None:
    """A figure of a task, mean over the seeds; a scene without contact is free space itself."""
    return (score.figures.get(task) or score.figures.get(SCENE, {})).get(metric)


def _figures(tuned: Tuned) -> str:
    """Each term with the figure behind it: of the best point, of the untuned law, of the rigid baseline."""
    steady = tuned.baseline.steady
    of_baseline = {"tracking": 0.0, "drag": 0.0, "touch": steady, "feel": steady, "rough": None, "force": 0.0}
    lines: list[Sequence[str]] = [("", "tuned", "untuned", "rigid rod", "term", "untuned")]
    for name, (words, task, metric) in SHOWN.items():
        if name not in tuned.score.terms:
            continue
        scores = (tuned.score, tuned.default)
        cells = [_si(figure(score, task, metric), metric) for score in scores if score]
        terms = [f"{score.terms[name]:.3f}" if score and name in score.terms else "" for score in scores]
        lines.append((words, *cells, _si(of_baseline[name], metric), *terms))
    return columns(lines)


def _si(value: float | None, metric: str) -> str:
    return "" if value is None else si(value, UNITS[metric])


def document(tuned: Tuned, typed: Sequence[str]) -> dict[str, Any]:
    """The search as JSON."""
    sentence = "feasible" if tuned.feasible else f"nothing keeps the constraints; nearest: {tuned.score.broken}"
    return {
        **head(status="done" if tuned.feasible else "infeasible", sentence=sentence, scene=tuned.scene, mode="tune",
               parameters=tuned.settings, seed=tuned.seed, command=typed, dt=None),
        **with_units(body(tuned)),
    }


def body(tuned: Tuned) -> dict[str, Any]:
    """The search in a document, with the units of its values."""
    scene = load_scene(tuned.scene, **tuned.knobs)
    unit = labels_of(scene).unit
    units = {f"law.{name}": unit(each.knob.unit) for name, each in knobs_of_fields(type(scene.laws[0])).items()}

    def point(values: Mapping[str, Any]) -> dict[str, Any]:
        return {name: WithUnit(value, units[name]) if name in units else value for name, value in values.items()}

    def scored(score: Score) -> dict[str, Any]:
        return {"value": WithUnit(finite(score.value), "1"), "broken": score.broken,
                "terms": WithUnit({name: finite(value) for name, value in score.terms.items()}, "1"),
                "values": WithUnit([finite(value) for value in score.values], "1"),
                "figures": {task: {name: WithUnit(finite(value), unit(UNITS[name])) for name, value in row.items()}
                            for task, row in score.figures.items()}}

    return {
        "law": tuned.law, "objective": tuned.objective, "says": OBJECTIVES[tuned.objective].sentence,
        "margin": WithUnit(tuned.margin, "1"), "budget": tuned.budget, "rows": tuned.rows, "points": len(tuned.tried),
        "engine": tuned.engine,
        "best": point(tuned.best), **scored(tuned.score),
        "own": None if tuned.default is None else scored(tuned.default),
        "ranges": point({name: [span.low, span.high] for name, span in tuned.ranges.searched.items()}),
        "linear": None if tuned.linear is None else {
            **tuned.linear._asdict(), "gain": WithUnit(finite(tuned.linear.gain), "1"),
            "delay": WithUnit(finite(tuned.linear.delay), "s")},
        "conditions": unmet_conditions(tuned), "not_turned": dict(tuned.ranges.held), "at_edge": at_edge(tuned),
        "rod": {name: WithUnit(value, unit({"moved": "m", "fastest": "m/s"}.get(name, "N")))
                for name, value in tuned.baseline._asdict().items()},
        "front": [{**point(values), **scored(score)} for values, score in tuned.front()],
        "run": tuned.command(),
    }


def write_points(names: Sequence[str], points: Iterable[tuple[Mapping[str, Any], Score]], path: Path) -> None:
    """Write points as CSV: their parameters, value, terms, figures and the constraint that they break."""
    scored = [*points]
    terms = [name for name in SHOWN if any(name in score.terms for _, score in scored)]
    with replacing_text(path) as file:
        lines = writer(file)
        lines.writerow([*names, "value", "broken", *terms, *(f"{SHOWN[name][2]}:{SHOWN[name][1]}" for name in terms)])
        for values, score in scored:
            figures = [figure(score, *SHOWN[name][1:]) for name in terms]
            lines.writerow([*(values[name] for name in names), csv_cell(score.value), score.broken,
                            *(csv_cell(score.terms.get(name)) for name in terms), *map(csv_cell, figures)])


def csv_cell(value: float | None) -> Any:
    """A number as a cell of CSV: empty where there is none, and where it is not finite."""
    return "" if finite(value) is None else value


def draw(tuned: Tuned, path: Path, formats: Sequence[str]) -> list[Path]:
    """Draw the points of a search as `path` in each of `formats`; returns the files."""
    settings = ", ".join(f"{name.removeprefix('law.')}={value:.4g}" if isinstance(value, float) else f"{name}={value}"
                         for name, value in tuned.best.items())
    status = "best" if tuned.feasible else f"nearest ({tuned.score.broken})"
    title = f"{literal(f'{tuned.law} in {tuned.scene}, {len(tuned.tried)} points')}\n{literal(f'{status}: {settings}')}"
    axes_figure = new_figure((8.0, 6.0), title)
    axes = axes_figure.add_subplot()
    good = [score for _, score in tuned.tried if not score.broken]
    reach = [_position(score) for score in good]
    limit = 1.5 * max([y for _, y in reach], default=1.0)
    near = [(x, y) for x, y in (_position(score) for _, score in tuned.tried if score.broken)
            if isfinite(x) and isfinite(y) and y <= limit]
    axes.scatter(*_columns(near), marker="x", s=18, color=PALE, label="breaks a constraint", linewidths=1.0)
    shade = [1.0 - min(score.terms.get("feel", score.terms.get("force", 0.0)), 1.0) for score in good]
    drawn = axes.scatter(*_columns(reach), c=shade, cmap="viridis", vmin=0.0, vmax=1.0, s=26, label="feasible")
    axes_figure.colorbar(drawn, ax=axes, label="steady force that reaches the hand, 1: all of a rigid rod's"
                         if tuned.baseline.steady is not None else "1 - force error term")
    front = [_position(score) for _, score in tuned.front()]
    axes.step(*_columns(front), where="post", color=BLUE, linewidth=1.2, label="front")
    if tuned.default is not None and not tuned.default.broken:
        axes.scatter(*_columns([_position(tuned.default)]), marker="s", s=70, facecolors="none", edgecolors=BLACK,
                     label="untuned")
    axes.scatter(*_columns([_position(tuned.score)]), marker="*", s=190, color=ORANGE, edgecolors=BLACK, zorder=5,
                 label="best" if tuned.feasible else "nearest")
    axes.set_xlabel("drag: greatest force against the hand in free space (N)")
    axes.set_ylabel("tracking error, rms (mm)")
    axes.set_ylim(bottom=0.0)
    axes.set_xlim(left=0.0)
    grid_lines(axes)
    axes.legend(fontsize=8)
    return save(axes_figure, path, formats)


def _position(score: Score) -> tuple[float, float]:
    """Drag (N) and tracking error (mm) of a point; NaN where it has none."""
    drag, error = figure(score, *SHOWN["drag"][1:]), figure(score, SCENE, "x_err_rms")
    return (float("nan") if drag is None else drag, float("nan") if error is None else 1e3 * error)


def _columns(points: Sequence[tuple[float, float]]) -> tuple[list[float], list[float]]:
    return [x for x, _ in points], [y for _, y in points]
