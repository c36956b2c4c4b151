"""The command `teleop advise`, and the report of an advice: a page of text, document, CSV and a plot."""

from __future__ import annotations

import shlex
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from csv import writer
from functools import partial
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from teleop.errors import Refused, enumerated, number, number_of
from teleop.law import two_port_laws
from teleop.scene.axes import labels_of
from teleop.scene.knobs import check_text, knobs_of
from teleop.scene.library import scene_function
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene
from teleop.simulation.metrics import UNITS
from teleop.simulation.result import head, parameters
from teleop.simulation.virtual import run
from teleop.storage.files import replacing_text
from teleop.studies.advise.advice import Advice, advise
from teleop.studies.advise.laws import MARGIN, LawAdvice, gains, link_text, promise
from teleop.studies.tune.objective import FREE, OBJECTIVES, SCENE, YIELDS, Score
from teleop.studies.tune.report import body as tuned_body
from teleop.studies.tune.report import csv_cell, figure, linear_text
from teleop.studies.tune.search import Tuned
from teleop.sweeps.engine import compiles
from teleop.sweeps.grid import split_list
from teleop.sweeps.runner import cores
from teleop.sweeps.store import DEFINITION
from teleop.terminal import plotting as plot
from teleop.terminal.answer import Answer, Task, WithUnit, command_of, with_units
from teleop.terminal.options import INTERRUPTED, knobs_from
from teleop.terminal.progress import shown_for
from teleop.terminal.table import columns, facts, si

if TYPE_CHECKING:
    from matplotlib.axes import Axes

POINT = 3  # rows of one point at most
ROWS, PLAIN_ROWS = 12_000, 60  # of each law where none are asked for: compiled, and where nothing compiles
WORSE = 1.5  # times the best law's term, and `MORE` above it: a term that counts against a law
MORE = 0.1
HALF = 0.5
LIVE = "127.0.0.1:9001"  # of the slave, in the lines that start the answer live
WIDTH = 108  # columns of text beside the labels
TERMS = {  # name -> colour, label
    "tracking": (plot.BLUE, "tracking error"), "drag": (plot.ORANGE, "drag in free space"),
    "touch": (plot.GREEN, "steady force missing at the wall"), "feel": (plot.PINK, "steady force missing at the hand"),
    "rough": (plot.PURPLE, "roughness at the hand"),
    "force": (plot.SKY, "force error"),
}
MOST = 1.5  # of a term that is drawn to scale


def find(args: Namespace) -> Task:
    """Advise a law, in a folder that the same command goes on with. Raises `Refused`."""
    began = args.seconds()
    laws = two_port_laws() if args.laws is None else split_list(args.laws)
    if not laws:
        raise Refused("--laws names none; write for example --laws wave,pfra, or leave it out for all")
    for law in laws:
        check_text("law", law, {})
    knobs = _knobs(args)
    each = args.budget // len(laws) if args.budget is not None else ROWS if compiles() else PLAIN_ROWS
    if each < POINT:
        raise Refused(f"--budget {args.budget} leaves each of {number_of(len(laws), 'law')} {number_of(each, 'row')}, "
                      f"and one point of the search takes up to {POINT}: the scene, free space and a stiffer wall; "
                      f"write --budget {POINT * len(laws)} or more, or fewer --laws")
    folder = Path(args.out) if args.out is not None else Path("runs") / f"{Path(args.scene).stem}-advise"

    def work() -> Answer:
        try:
            with shown_for(args) as show:
                advice = advise(args.scene, each, fixed=knobs, laws=laws, objective=args.objective, seed=args.seed,
                                show=show, clock=args.seconds, workers=args.workers or cores(), out=folder)
        except KeyboardInterrupt:
            if not (folder / DEFINITION).is_file():
                raise  # nothing was begun
            sentence = "interrupted: the same command goes on from here"
            return Answer(sentence, {"status": "interrupted", "mode": "advise", "sentence": sentence,
                                     "path": str(folder)}, INTERRUPTED)
        seconds = args.seconds() - began
        page = text(advice, seconds)
        return Answer(page, document(advice, args.typed, seconds), plots={"advise": partial(draw, advice)}, files={
            "laws.csv": partial(write_laws, advice), "advice.txt": partial(write_page, page)})

    return Task(Path(args.scene).stem, work, folder)


command = command_of(find, "advise")


def _knobs(args: Namespace) -> dict[str, object]:
    """The knobs that are set, with the link and the wall among them. Raises `Refused`."""
    knobs: dict[str, object] = dict(knobs_from(args))
    if args.ping is not None and args.link is not None:
        raise Refused("--ping and --link both give the link; leave one of them out")
    if args.ping is not None:
        quote = '"' if "'" in args.ping else "'"
        knobs["link"] = f"ping_log({quote}{args.ping}{quote})"
    if "link" not in knobs:
        raise Refused("no link is given; write --link 'delay(0.04) | uniform(0.02) | bernoulli(0.02)', or --ping FILE "
                      "with what `ping -D -i 0.02 HOST > FILE` has recorded")
    if args.wall is not None:
        number("--wall", args.wall, low=0.0, unit="N/m")
        if "k_e" not in knobs_of(scene_function(args.scene)):
            raise Refused(f"scene {args.scene} has no knob k_e for --wall to set; leave it out, or take another scene, "
                          "for example hard_wall or soft_tissue")
        if "k_e" in knobs:
            raise Refused("--wall and --set k_e both give the stiffness of the wall; leave one of them out")
        knobs["k_e"] = args.wall
    return knobs


def text(advice: Advice, seconds: float | None = None) -> str:
    """The page."""
    took = "" if seconds is None else f" in {seconds:.0f} s"
    baseline = _baseline_text(advice)
    rows = [("link", link_text(advice.ways)),
            ("scene", f"{advice.scene.name}{_wall(advice.scene)}{baseline}"),
            ("searched", f"{number_of(len(advice.laws), 'law')}, {advice.budget} rows each at most, {advice.rows} in "
                         f"all{took}; objective {advice.objective}: {OBJECTIVES[advice.objective].sentence}")]
    best = advice.best
    if best is None:
        near = advice.laws[0] if advice.laws else None
        why = "" if near is None or near.tuned is None else f": {near.law} comes nearest, {near.tuned.score.broken}"
        rows += [("take", f"none: no law keeps the constraints{why}"), ("", _what_to_do(advice))]
    else:
        rows += [("", ""), *_take(advice, best)]
    lines = [facts(wrap_facts(rows)), "", _table(advice)]
    against = avoid(advice)
    if against:
        lines += ["", facts(wrap_facts([("avoid" if i == 0 else "", f"- {line}") for i, line in enumerate(against)]))]
    if best is not None and best.tuned is not None:
        lines += ["", f"run it: {shlex.join(best.tuned.command())}", *_live(best.tuned)]
    return "\n".join(lines)


def _live(tuned: Tuned) -> list[str]:
    """The lines that start the answer live, and what to change in them for two machines."""
    return ["live, on one machine; on two with the slave's address there and a key at each end (teleop keygen):",
            *(f"  {shlex.join(words)}" for words in tuned.live(LIVE))]


def wrap_facts(rows: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    """Facts with their texts broken at `WIDTH` columns; the lines that go on have no label."""
    return [(label if i == 0 else "", line) for label, sentence in rows
            for i, line in enumerate(wrap(sentence, WIDTH, subsequent_indent="  " * sentence.startswith("- ")) or [""])]


def _wall(scene: Scene) -> str:
    k_e = scene.knobs.get("k_e")
    return f", an environment of {si(k_e, 'N/m')}" if isinstance(k_e, float) else ""


def _baseline_text(advice: Advice) -> str:
    tuned = next((each.tuned for each in advice.laws if each.tuned is not None), None)
    if tuned is None or tuned.baseline.steady is None:
        return ""
    return f"; a rigid rod in place of law and link would press it with {si(tuned.baseline.steady, 'N')} in the end"


def _take(advice: Advice, best: LawAdvice) -> list[tuple[str, str]]:
    score = best.search.score
    rows = [("take", f"{best.law} with {gains(best)}"), ("expect", "; ".join(_effects(best)) + _means(best))]
    if len(score.values) > 1:
        rows.append(("objective", f"{score.value:.3f} over {len(score.values)} seeds that the search has not seen; "
                                  f"of one seed {min(score.values):.3f} to {max(score.values):.3f}, standard "
                                  f"deviation {best.spread:.3f}"))
    if advice.jumps is not None:
        jumps = advice.jumps
        over = f", the largest of {number_of(jumps.runs, 'run')}" if jumps.runs > 1 else ""
        rows.append(("jumps", f"the force at the hand jumps by up to {si(jumps.tick, 'N')} from one tick to the next, "
                              f"{si(jumps.message, 'N')} from one message to the next, {si(jumps.within, 'N')} within "
                              f"{si(YIELDS, 's')}{over}"))
    if best.margins is not None:
        rows.append(("margin", _margin(best)))
    if best.search.linear is not None and not best.search.linear.why:
        rows.append(("loop", f"linear: {linear_text(best.search.linear)}"))
    rows.append(("promises", promise(best)))
    rows += [("but", sentence) for sentence in best.broken]
    alike = advice.alike()
    if alike:
        rows.append(("as good", f"{enumerated([each.law for each in alike])}: not told apart over the seeds"))
    second = min([each for each in advice.laws if each is not best and best.value <= each.value < float("inf")
                  and each not in alike], key=lambda each: each.value, default=None)
    if second is not None:
        rows.append(("because", f"its objective is {score.value:.3f}, that of the next best ({second.law}) "
                                f"{second.value:.3f}; 0 is the rigid rod"))
    bolder = advice.bolder
    if bolder is not None:
        rows.append(("bolder", f"{bolder.law} with {gains(bolder)} does better here, {bolder.value:.3f}: "
                               f"{'; '.join(_effects(bolder))}. But {'; '.join(bolder.broken)}. It {_margin(bolder)}"))
    if not best.keeps_energy():
        safe = next((each for each in advice.laws if each.value < float("inf") and each.keeps_energy()), None)
        if safe is not None:
            rows.append(("or", f"{safe.law} with {gains(safe)}, the best that keeps its energy whatever it touches: "
                               f"{'; '.join(_effects(safe))}"))
    return rows


def _means(law: LawAdvice) -> str:
    """A note on the seeds behind the figures, where the link draws random numbers."""
    count = len(law.search.score.values)
    return f" (means over {count} seeds, of which one run has its own)" if count > 1 else ""


def _short(law: LawAdvice) -> str:
    return " ".join(f"{name.removeprefix('law.')}={value:g}" if isinstance(value, float) else str(value)
                    for name, value in law.search.best.items())


def _effects(law: LawAdvice) -> list[str]:
    score, baseline = law.search.score, law.search.baseline
    effects = []
    if (error := figure(score, SCENE, "x_err_rms")) is not None:
        effects.append(f"{si(error, 'm')} rms of tracking error")
    wall, hand = figure(score, SCENE, "f_env_end"), figure(score, SCENE, "f_m_end")
    if baseline.steady is not None and wall is not None and hand is not None:
        effects.append(f"{si(wall, 'N')} of steady force on the wall and {si(hand, 'N')} on the hand, of "
                       f"{si(baseline.steady, 'N')}")
    felt = figure(score, SCENE, "felt_stiffness")
    if felt is not None:
        effects.append(f"a wall that feels like {si(felt, 'N/m')}")
    if (drag := figure(score, FREE, "f_m_max")) is not None:
        effects.append(f"at most {si(drag, 'N')} against the hand in free space")
    if (peak := figure(score, SCENE, "f_env_max")) is not None and peak > 0.0:
        effects.append(f"a peak of {si(peak, 'N')} on the wall")
    return effects


def _margin(law: LawAdvice) -> str:
    assert law.margins is not None
    wall, delay, wall_end, delay_end = law.margins
    bounds = []
    if wall > 0.0:
        bounds.append(f"keeps the constraints up to a wall of {si(wall, 'N/m')}"
                      + (f" (next: {wall_end})" if wall_end else ", the stiffest that was tried"))
    if delay > 0.0:
        bounds.append(f"with {si(delay, 's')} more delay each way"
                      + (f" (next: {delay_end})" if delay_end else ", the most that was tried"))
    elif delay_end:
        bounds.append(f"not with more delay: {delay_end}")
    return ", and ".join(bounds)


def _table(advice: Advice) -> str:
    lines: list[Sequence[str]] = [("law", "objective +- sd", "tracking", "drag", "on the wall", "on the hand",
                                   "feels like", "jerk", "keeps energy", "gains")]
    for law in advice.laws:
        if law.tuned is None:
            lines.append((law.law, "refused", *[""] * 8))
            continue
        score = law.tuned.score
        value = f"{score.value:.3f}" + (f" +- {law.spread:.3f}" if law.spread >= 5e-4 else "")
        shown = [(SCENE, "x_err_rms"), (FREE, "f_m_max"), (SCENE, "f_env_end"), (SCENE, "f_m_end"),
                 (SCENE, "felt_stiffness"), (SCENE, "jerk_rms")]
        cells = [_si(score, task, name) for task, name in shown]
        energy = "yes" if law.keeps_energy() else "if" if law.claims else "no"
        lines.append((law.law, value if law.tuned.feasible else "infeasible", *cells, energy, _short(law)))
    return columns(lines, left=(0, 9))


def _si(score: Score, task: str, metric: str) -> str:
    value = figure(score, task, metric)
    return "" if value is None else si(value, UNITS[metric])


def avoid(advice: Advice) -> list[str]:
    """Sentences against the laws that are not advised, and against other parameters of the advised law."""
    best, alike = advice.best, advice.alike()
    against = []
    for law in advice.laws:
        if law is best or law is advice.bolder or law in alike:
            continue
        if law.tuned is None:
            against.append(f"{law.law}: {law.refused}")
        elif not law.tuned.feasible:
            against.append(f"{law.law}: no point keeps the constraints; the nearest: {law.tuned.score.broken}")
        else:
            against.append(f"{law.law}: {'; '.join([*_against(law, best), *law.broken]) or 'a little worse in all'}")
    if best is not None and best.tuned is not None and best.tuned.default is not None and best.tuned.default.broken:
        against.append(f"{best.law} untuned: {best.tuned.default.broken}")
    for playout, score, conditions in advice.playouts:
        against.append("; ".join(
            [f"playout {playout} with the advised gains: {_playout_text(score, best)}", *conditions]))
    return against


def _against(law: LawAdvice, best: LawAdvice | None) -> list[str]:
    """The terms in which a law is clearly worse than the best, in the words of an engineer."""
    score, baseline = law.search.score, law.search.baseline
    steady = "" if baseline.steady is None else f" of {si(baseline.steady, 'N')}"
    words = {
        "tracking": f"tracks poorly, {_si(score, SCENE, 'x_err_rms')} rms",
        "drag": f"drags, {_si(score, FREE, 'f_m_max')} in free space",
        "feel": f"is {'hardly felt' if score.terms.get('feel', 0.0) > HALF else 'felt less'}, "
                f"{_si(score, SCENE, 'f_m_end')}{steady} at the hand",
        "rough": f"is rough, its force on the hand changes by {_si(score, SCENE, 'jerk_rms')} rms",
        "force": f"has a force error of {_si(score, SCENE, 'f_err_rms')} rms",
    }
    terms = {} if best is None or best.tuned is None else best.tuned.score.terms
    touch, feel = (figure(score, SCENE, name) for name in ("f_env_end", "f_m_end"))
    if baseline.steady and touch is not None:
        words["touch"] = (f"presses too hard, {si(touch, 'N')}{steady}" if touch > baseline.steady else
                          f"passes only {100.0 * touch / baseline.steady:.0f} % of the force to the wall")
    if baseline.steady is not None and feel is not None and feel > baseline.steady:
        words["feel"] = f"is felt too hard, {si(feel, 'N')}{steady} at the hand"
    return [words[name] for name, value in sorted(score.terms.items(), key=lambda each: -each[1])
            if name in words and value > WORSE * terms.get(name, 0.0) and value > terms.get(name, 0.0) + MORE]


def _playout_text(score: Score, best: LawAdvice | None) -> str:
    if score.broken:
        return score.broken
    advised = "" if best is None else f" in place of {best.value:.3f}"
    hand = _si(score, SCENE, "f_m_end")
    return f"objective {score.value:.3f}{advised}" + (f", {hand} of steady force at the hand" if hand else "")


def _what_to_do(advice: Advice) -> str:
    slow = max(way.median for way in advice.ways)
    return (f"ask for less: a softer wall (--wall; a law has to stand one that is {MARGIN:g} times as stiff too), or a "
            f"link of less than {si(slow, 's')}")


def document(advice: Advice, typed: Sequence[str], seconds: float) -> dict[str, Any]:
    """The advice as JSON."""
    best, unit = advice.best, labels_of(advice.scene).unit
    tuned = None if best is None else best.tuned
    sentence = "no law keeps the constraints" if best is None else f"take {best.law} with {gains(best)}"
    force = {name: unit("N") for name in ("tick", "message", "within")}
    return {
        **head(status="done" if best is not None else "infeasible", sentence=sentence, scene=advice.scene.name,
               mode="advise", parameters=parameters(advice.scene), seed=None, command=typed,
               dt=advice.scene.dt_ns / 1e9),
        **with_units({
            "link": {way: _in_units(each._asdict(), {"lost": "1"}, "s")
                     for way, each in zip(("fwd", "bwd"), advice.ways, strict=True)},
            "objective": advice.objective, "budget": advice.budget, "rows": advice.rows,
            "seconds": WithUnit(seconds, "s"),
            "laws": [_law_document(law, unit) for law in advice.laws], "avoid": avoid(advice),
            "run": None if tuned is None else tuned.command(),
            "live": None if tuned is None else dict(zip(("master", "slave"), tuned.live(LIVE), strict=True)),
            "jumps": None if advice.jumps is None else _in_units(advice.jumps._asdict(), force),
            "seconds_told": WithUnit(advice.predicted, "s"),
        }),
    }


def _law_document(law: LawAdvice, unit: Callable[[str], str]) -> dict[str, Any]:
    result: dict[str, Any] = {
        "law": law.law, "refused": law.refused, "claims": dict(law.claims),
        "seed_energy": WithUnit(law.seed_energy, "J"), "conditions_broken": list(law.broken),
        "deviation": WithUnit(law.deviation, "1"), "spread": WithUnit(law.spread, "1"),
        "margins": law.margins and _in_units(law.margins._asdict(), {"wall": unit("N/m"), "delay": "s"}),
    }
    if law.tuned is not None:
        body = tuned_body(law.tuned)
        result |= {key: body[key] for key in (
            "best", "value", "broken", "terms", "figures", "rows", "points", "engine", "run", "at_edge")}
        result["best"] = dict(law.tuned.best)  # parameters of one name have another unit in another law
    return result


def _in_units(values: Mapping[str, Any], units: Mapping[str, str], unit: str = "") -> dict[str, WithUnit]:
    return {name: WithUnit(value, units.get(name, unit)) for name, value in values.items()}


def write_page(page: str, path: Path) -> None:
    """Write the page as text."""
    with replacing_text(path) as file:
        file.write(page + "\n")


def write_laws(advice: Advice, path: Path) -> None:
    """Write the table of laws as CSV."""
    metrics = [each for each in (
        ("x_err_rms", SCENE), ("f_m_max", FREE), ("f_env_end", SCENE), ("f_m_end", SCENE), ("f_env_max", SCENE),
        ("felt_stiffness", SCENE), ("jerk_rms", SCENE)) if each[0] in UNITS]
    with replacing_text(path) as file:
        lines = writer(file)
        lines.writerow(["law", "objective", "deviation", "spread", "broken",
                        *(f"{name}:{task}" for name, task in metrics), "keeps_energy", "settings"])
        for law in advice.laws:
            if law.tuned is None:
                lines.writerow([law.law, "", "", "", law.refused, *[""] * len(metrics), "", ""])
                continue
            figures = [figure(law.tuned.score, task, name) for name, task in metrics]
            lines.writerow([law.law, csv_cell(law.tuned.score.value), law.deviation, law.spread,
                            law.tuned.score.broken, *map(csv_cell, figures), law.keeps_energy(),
                            _settings(law.tuned.settings)])


def _settings(settings: Mapping[str, str]) -> str:
    return " ".join(f"{name}={value}" for name, value in settings.items())


def draw(advice: Advice, path: Path, formats: Sequence[str]) -> list[Path]:
    """Draw the advice as `path` in each of `formats`; returns the files."""
    best = advice.best
    title = "no law keeps the constraints" if best is None else f"take {best.law}: {gains(best)}"
    figure = plot.new_figure((13.0, 6.5), "\n".join(
        [plot.literal(title), plot.literal(f"{advice.scene.name}, {link_text(advice.ways)}")]))
    grid = figure.add_gridspec(2, 2, width_ratios=(1.15, 1.0))
    draw_laws(figure.add_subplot(grid[:, 0]), document(advice, (), 0.0)["laws"], None if best is None else best.law)
    if best is not None and best.tuned is not None:
        motion = figure.add_subplot(grid[0, 1])
        force = figure.add_subplot(grid[1, 1], sharex=motion)
        _run(motion, force, best.tuned)
    return plot.save(figure, path, formats)


def draw_laws(axes: Axes, laws: Sequence[Mapping[str, Any]], advised: str | None) -> None:
    """Draw a row for each law that was searched, as the document has them: its terms as bars, its value as a mark."""
    laws = [each for each in laws if "terms" in each]
    names = [name for name in TERMS if any(name in each["terms"] for each in laws)]
    high = 0.8 / max(1, len(names))
    first = next((y for y, each in enumerate(laws) if not each["broken"]), None)
    for y, law in enumerate(laws):
        if law["broken"]:
            axes.text(0.02, y, plot.literal(f"infeasible: {law['broken']}", most=70), va="center", fontsize=8,
                      color=plot.RED)
            continue
        for i, name in enumerate(names):
            if (value := law["terms"].get(name)) is not None:
                axes.barh(y - 0.4 + (i + 0.5) * high, min(float(value), MOST), height=high, color=TERMS[name][0],
                          label=TERMS[name][1] if y == first else None)
        axes.errorbar(float(law["value"]), y, xerr=law["deviation"] or None, fmt="D", color=plot.DARK,
                      markersize=5, capsize=3, label="objective: root mean square" if y == first else None, zorder=5)
    axes.set_yticks(range(len(laws)), [
        plot.literal(f"advised: {each['law']}" if each["law"] == advised else each["law"]) for each in laws])
    axes.set_ylim(len(laws) - 0.4, -0.6)
    axes.set_xlim(0.0, MOST)
    axes.set_xlabel(f"0: a rigid rod, 1: a law that does nothing (cut off at {MOST:g})")
    axes.axvline(1.0, color=plot.GREY, linewidth=0.8)
    plot.grid_lines(axes)
    axes.yaxis.grid(visible=False)  # it would run through the words
    if first is not None:
        axes.legend(fontsize=8, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, frameon=False, borderaxespad=0.3)


def _run(motion: Axes, force: Axes, tuned: Tuned) -> None:
    """Positions and forces of a run with the advised gains."""
    result = run(load_scene(tuned.scene, **tuned.knobs), seed=tuned.seed)
    t, trace = result.trace["t"], result.trace

    def first(name: str) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        column = np.asarray(trace[name])
        return column if column.ndim == 1 else column[:, 0]

    motion.plot(t, 1e3 * first("x_m"), color=plot.BLUE, label="master")
    motion.plot(t, 1e3 * first("x_s"), color=plot.ORANGE, label="slave")
    motion.set_ylabel("position (mm)")
    force.plot(t, first("f_env") if "f_env" in trace else 0.0 * t, color=plot.ORANGE, label="slave on the environment")
    force.plot(t, first("f_m"), color=plot.BLUE, label="stack against the hand")
    steady = tuned.baseline.steady
    if steady is not None:
        force.axhline(steady, color=plot.GREY, linewidth=1.0, linestyle="--", label="steady force of a rigid rod")
        top = 1.5 * max(steady, float(np.quantile(first("f_m"), 0.999)))
        force.set_ylim(top=min(top, force.get_ylim()[1]))
    force.set_ylabel("force (N)")
    force.set_xlabel("t (s)")
    for axes in (motion, force):
        plot.grid_lines(axes)
        axes.legend(fontsize=8)
