"""The advice as a page of text, and as a document."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from csv import writer
from pathlib import Path
from textwrap import wrap
from typing import Any

from teleop.errors import enumerated, number_of
from teleop.law.offers import CONDITIONS
from teleop.scene.scene import Scene
from teleop.simulation.metrics import UNITS
from teleop.simulation.result import head, parameters
from teleop.storage.files import replacing_text
from teleop.studies.advise.advice import Advice
from teleop.studies.advise.laws import MARGIN, LawAdvice
from teleop.studies.advise.links import link_text
from teleop.studies.tune.objective import FREE, OBJECTIVES, SCENE, YIELDS, Score
from teleop.studies.tune.report import document as tuned_document
from teleop.studies.tune.report import figure, linear_text
from teleop.studies.tune.search import Tuned
from teleop.terminal.answer import finite
from teleop.terminal.table import columns, facts
from teleop.terminal.units import si

WORSE = 1.5  # times the best law's term, and `MORE` above it: what is said against another law
MORE = 0.1
HALF = 0.5
LIVE = "127.0.0.1:9001"  # of the slave, in the lines that start the answer live
WIDTH = 108  # columns of text beside the labels


def text(found: Advice, seconds: float | None = None) -> str:
    """The page."""
    took = "" if seconds is None else f" in {seconds:.0f} s"
    rod = _rod(found)
    rows = [("link", link_text(found.ways)),
            ("scene", f"{found.scene.name}{_wall(found.scene)}{rod}"),
            ("searched", f"{number_of(len(found.laws), 'law')}, {found.budget} rows each at most, {found.rows} in "
                         f"all{took}; objective {found.objective}: {OBJECTIVES[found.objective].sentence}")]
    best = found.best
    if best is None:
        near = found.laws[0] if found.laws else None
        why = "" if near is None or near.tuned is None else f": {near.law} comes nearest, {near.tuned.score.broken}"
        rows += [("take", f"none: no law keeps the constraints{why}"), ("", _what_to_do(found))]
    else:
        rows += [("", ""), *_take(found, best)]
    told = [facts(wrapped(rows)), "", _table(found)]
    against = avoid(found)
    if against:
        told += ["", facts(wrapped([("avoid" if i == 0 else "", f"- {line}") for i, line in enumerate(against)]))]
    if best is not None and best.tuned is not None:
        told += ["", f"run it: {shlex.join(best.tuned.command())}", *_live(best.tuned)]
    return "\n".join(told)


def _live(tuned: Tuned) -> list[str]:
    """The lines that start the answer live, and what to change in them for two machines."""
    return ["live, on one machine; on two with the slave's address there and a key at each end (teleop keygen):",
            *(f"  {shlex.join(words)}" for words in tuned.live(LIVE))]


def wrapped(rows: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    """Facts whose texts are broken at `WIDTH` columns; the lines that go on have no label."""
    return [(label if i == 0 else "", line) for label, said in rows
            for i, line in enumerate(wrap(said, WIDTH, subsequent_indent="  " * said.startswith("- ")) or [""])]


def _wall(scene: Scene) -> str:
    k_e = scene.knobs.get("k_e")
    return f", an environment of {si(k_e, 'N/m')}" if isinstance(k_e, float) else ""


def _rod(found: Advice) -> str:
    tuned = next((one.tuned for one in found.laws if one.tuned is not None), None)
    if tuned is None or tuned.rod.steady is None:
        return ""
    return f"; a rigid rod in place of law and link would press it with {si(tuned.rod.steady, 'N')} in the end"


def _take(found: Advice, best: LawAdvice) -> list[tuple[str, str]]:
    assert best.tuned is not None
    score = best.tuned.score
    rows = [("take", f"{best.law} with {gains(best)}"), ("expect", "; ".join(_expected(best)) + _means(best))]
    if len(score.values) > 1:
        rows.append(("objective", f"{score.value:.3f} over {len(score.values)} seeds that the search has not seen; "
                                  f"of one seed {min(score.values):.3f} to {max(score.values):.3f}, standard "
                                  f"deviation {best.spread:.3f}"))
    if found.jumps is not None:
        jumps = found.jumps
        over = f", the largest of {number_of(jumps.runs, 'run')}" if jumps.runs > 1 else ""
        rows.append(("jumps", f"the force at the hand jumps by up to {si(jumps.tick, 'N')} from one tick to the next, "
                              f"{si(jumps.message, 'N')} from one message to the next, {si(jumps.within, 'N')} within "
                              f"{si(YIELDS, 's')}{over}"))
    if best.margins is not None:
        rows.append(("margin", _margin(best)))
    if best.tuned.linear is not None and not best.tuned.linear.why:
        rows.append(("loop", f"linear: {linear_text(best.tuned.linear)}"))
    rows.append(("promises", promise(best)))
    rows += [("but", sentence) for sentence in best.broken]
    alike = found.alike()
    if alike:
        rows.append(("as good", f"{enumerated([one.law for one in alike])}: not told apart over the seeds"))
    second = min([one for one in found.laws if one is not best and best.value <= one.value < float("inf")
                  and one not in alike], key=lambda one: one.value, default=None)
    if second is not None:
        rows.append(("because", f"its objective is {score.value:.3f}, that of the next best ({second.law}) "
                                f"{second.value:.3f}; 0 is the rigid rod"))
    bolder = found.bolder
    if bolder is not None:
        rows.append(("bolder", f"{bolder.law} with {gains(bolder)} does better here, {bolder.value:.3f}: "
                               f"{'; '.join(_expected(bolder))}. But {'; '.join(bolder.broken)}. It {_margin(bolder)}"))
    if not best.keeps_energy():
        safe = next((one for one in found.laws if one.value < float("inf") and one.keeps_energy()), None)
        if safe is not None:
            rows.append(("or", f"{safe.law} with {gains(safe)}, the best that keeps its energy whatever it touches: "
                               f"{'; '.join(_expected(safe))}"))
    return rows


def _means(one: LawAdvice) -> str:
    """Of what these figures are means, where the link draws random numbers."""
    assert one.tuned is not None
    count = len(one.tuned.score.values)
    return f" (means over {count} seeds, of which one run has its own)" if count > 1 else ""


def gains(one: LawAdvice) -> str:
    """The parameters, with their units, and the playout."""
    assert one.tuned is not None
    told = []
    for name, value in one.tuned.best.items():
        if name == "playout":
            continue
        knob = one.knobs[name.removeprefix("law.")].knob
        told.append(f"{name.removeprefix('law.')} = {value:g}{' ' + knob.unit if knob.unit not in ('', '1') else ''}")
    playout = one.tuned.best.get("playout")
    return ", ".join(told) + (f", playout {playout}" if playout else "")


def _short(one: LawAdvice) -> str:
    assert one.tuned is not None
    return " ".join(f"{name.removeprefix('law.')}={value:g}" if isinstance(value, float) else str(value)
                    for name, value in one.tuned.best.items())


def _expected(one: LawAdvice) -> list[str]:
    assert one.tuned is not None
    score, rod = one.tuned.score, one.tuned.rod
    told = []
    if (error := figure(score, SCENE, "x_err_rms")) is not None:
        told.append(f"{si(error, 'm')} rms of tracking error")
    wall, hand = figure(score, SCENE, "f_env_end"), figure(score, SCENE, "f_m_end")
    if rod.steady is not None and wall is not None and hand is not None:
        told.append(f"{si(wall, 'N')} of steady force on the wall and {si(hand, 'N')} on the hand, of "
                    f"{si(rod.steady, 'N')}")
    felt = figure(score, SCENE, "felt_stiffness")
    if felt is not None:
        told.append(f"a wall that feels like {si(felt, 'N/m')}")
    if (drag := figure(score, FREE, "f_m_max")) is not None:
        told.append(f"at most {si(drag, 'N')} against the hand in free space")
    if (peak := figure(score, SCENE, "f_env_max")) is not None and peak > 0.0:
        told.append(f"a peak of {si(peak, 'N')} on the wall")
    return told


def _margin(one: LawAdvice) -> str:
    assert one.margins is not None
    wall, delay, wall_end, delay_end = one.margins
    told = []
    if wall > 0.0:
        told.append(f"keeps the constraints up to a wall of {si(wall, 'N/m')}"
                    + (f" (next: {wall_end})" if wall_end else ", the stiffest that was tried"))
    if delay > 0.0:
        told.append(f"with {si(delay, 's')} more delay each way"
                    + (f" (next: {delay_end})" if delay_end else ", the most that was tried"))
    elif delay_end:
        told.append(f"not with more delay: {delay_end}")
    return ", and ".join(told)


def _over(ledger: str, claim: str) -> str:
    """The links of a claim. How waves are played matters to the ledger of waves alone."""
    return CONDITIONS[claim] if ledger == "E_link" else CONDITIONS[claim].partition(",")[0]


def promise(one: LawAdvice) -> str:
    """What the law promises by itself, whatever hand and environment, in words."""
    if not one.claims:
        return "nothing of energy: what holds is what was run here"
    held = "; ".join(f"{ledger} stays above zero {_over(ledger, claim)}" for ledger, claim in one.claims.items())
    return held + (f", but for {1e3 * one.seed_energy:.3g} mJ to begin with" if one.seed_energy > 0.0 else "")


def _table(found: Advice) -> str:
    lines: list[Sequence[str]] = [("law", "objective +- sd", "tracking", "drag", "on the wall", "on the hand",
                                   "feels like", "jerk", "keeps energy", "gains")]
    for one in found.laws:
        if one.tuned is None:
            lines.append((one.law, "refused", *[""] * 8))
            continue
        score = one.tuned.score
        value = f"{score.value:.3f}" + (f" +- {one.spread:.3f}" if one.spread >= 5e-4 else "")
        shown = [(SCENE, "x_err_rms"), (FREE, "f_m_max"), (SCENE, "f_env_end"), (SCENE, "f_m_end"),
                 (SCENE, "felt_stiffness"), (SCENE, "jerk_rms")]
        cells = [_si(score, task, name) for task, name in shown]
        energy = "yes" if one.keeps_energy() else "if" if one.claims else "no"
        lines.append((one.law, value if one.tuned.feasible else "infeasible", *cells, energy, _short(one)))
    return columns(lines, left=(0, 9))


def _si(score: Score, task: str, metric: str) -> str:
    value = figure(score, task, metric)
    return "" if value is None else si(value, UNITS[metric])


def avoid(found: Advice) -> list[str]:
    """What is said against the laws that are not advised, and against other parameters of the one that is."""
    best, alike = found.best, found.alike()
    told = []
    for one in found.laws:
        if one is best or one is found.bolder or one in alike:
            continue
        if one.tuned is None:
            told.append(f"{one.law}: {one.refused}")
        elif not one.tuned.feasible:
            told.append(f"{one.law}: no point keeps the constraints; the nearest: {one.tuned.score.broken}")
        else:
            told.append(f"{one.law}: {'; '.join([*_against(one, best), *one.broken]) or 'a little worse in all'}")
    if best is not None and best.tuned is not None and best.tuned.default is not None and best.tuned.default.broken:
        told.append(f"{best.law} untuned: {best.tuned.default.broken}")
    for playout, score, conditions in found.playouts:
        told.append("; ".join([f"playout {playout} with the advised gains: {_of_playout(score, best)}", *conditions]))
    return told


def _against(one: LawAdvice, best: LawAdvice | None) -> list[str]:
    """The terms in which a law is clearly worse than the best, in the words of an engineer."""
    assert one.tuned is not None
    score, rod = one.tuned.score, one.tuned.rod
    steady = "" if rod.steady is None else f" of {si(rod.steady, 'N')}"
    words = {
        "tracking": f"tracks poorly, {_si(score, SCENE, 'x_err_rms')} rms",
        "drag": f"drags, {_si(score, FREE, 'f_m_max')} in free space",
        "touch": f"{'starves the wall' if score.terms.get('touch', 0.0) > HALF else 'presses less'}, "
                 f"{_si(score, SCENE, 'f_env_end')}{steady}",
        "feel": f"is {'hardly felt' if score.terms.get('feel', 0.0) > HALF else 'felt less'}, "
                f"{_si(score, SCENE, 'f_m_end')}{steady} at the hand",
        "rough": f"is rough, its force on the hand changes by {_si(score, SCENE, 'jerk_rms')} rms",
        "force": f"has a force error of {_si(score, SCENE, 'f_err_rms')} rms",
    }
    own = {} if best is None or best.tuned is None else best.tuned.score.terms
    touch, feel = (figure(score, SCENE, name) for name in ("f_env_end", "f_m_end"))
    if rod.steady is not None and touch is not None and touch > rod.steady:
        words["touch"] = f"presses too hard, {si(touch, 'N')}{steady}"
    if rod.steady is not None and feel is not None and feel > rod.steady:
        words["feel"] = f"is felt too hard, {si(feel, 'N')}{steady} at the hand"
    return [words[name] for name, value in sorted(score.terms.items(), key=lambda each: -each[1])
            if name in words and value > WORSE * own.get(name, 0.0) and value > own.get(name, 0.0) + MORE]


def _of_playout(score: Score, best: LawAdvice | None) -> str:
    if score.broken:
        return score.broken
    own = "" if best is None else f" in place of {best.value:.3f}"
    hand = _si(score, SCENE, "f_m_end")
    return f"objective {score.value:.3f}{own}" + (f", {hand} of steady force at the hand" if hand else "")


def _what_to_do(found: Advice) -> str:
    slow = max(way.median for way in found.ways)
    return (f"ask for less: a softer wall (--wall; a law has to stand one that is {MARGIN:g} times as stiff too), or a "
            f"link of less than {si(slow, 's')}")


def document(found: Advice, typed: Sequence[str], seconds: float) -> dict[str, Any]:
    """The advice as JSON can hold it."""
    best = found.best
    sentence = "no law keeps the constraints" if best is None else f"take {best.law} with {gains(best)}"
    return {
        **head(status="done" if best is not None else "infeasible", sentence=sentence, scene=found.scene.name,
               mode="advise", parameters=parameters(found.scene), seed=None, command=typed, dt=found.scene.dt_ns / 1e9),
        "link": {way: each._asdict() for way, each in zip(("fwd", "bwd"), found.ways, strict=True)},
        "objective": found.objective, "budget": found.budget, "rows": found.rows, "seconds": seconds,
        "laws": [_document_of(one, typed) for one in found.laws], "avoid": avoid(found),
        "run": None if best is None or best.tuned is None else best.tuned.command(),
        "live": None if best is None or best.tuned is None else dict(zip(
            ("master", "slave"), best.tuned.live(LIVE), strict=True)),
        "jumps": None if found.jumps is None else found.jumps._asdict(), "seconds_told": found.told,
    }


def _document_of(one: LawAdvice, typed: Sequence[str]) -> dict[str, Any]:
    told: dict[str, Any] = {
        "law": one.law, "refused": one.refused, "claims": dict(one.claims), "seed_energy": one.seed_energy,
        "conditions_broken": list(one.broken), "deviation": one.deviation, "spread": one.spread,
        "margins": None if one.margins is None else one.margins._asdict(),
    }
    if one.tuned is not None:
        whole = tuned_document(one.tuned, typed)
        told |= {key: whole[key] for key in ("best", "value", "broken", "terms", "figures", "rows", "points", "engine",
                                             "run", "at_edge")}
    return told


def write_laws(path: Path, found: Advice) -> None:
    """Write the table of laws as CSV."""
    metrics = [each for each in (
        ("x_err_rms", SCENE), ("f_m_max", FREE), ("f_env_end", SCENE), ("f_m_end", SCENE), ("f_env_max", SCENE),
        ("felt_stiffness", SCENE), ("jerk_rms", SCENE)) if each[0] in UNITS]
    with replacing_text(path) as file:
        lines = writer(file)
        lines.writerow(["law", "objective", "deviation", "spread", "broken",
                        *(f"{name}:{task}" for name, task in metrics), "keeps_energy", "settings"])
        for one in found.laws:
            if one.tuned is None:
                lines.writerow([one.law, "", "", "", one.refused, *[""] * len(metrics), "", ""])
                continue
            figures = [figure(one.tuned.score, task, name) for name, task in metrics]
            lines.writerow([one.law, _cell(one.tuned.score.value), one.deviation, one.spread,
                            one.tuned.score.broken, *map(_cell, figures), one.keeps_energy(),
                            _settings(one.tuned.settings)])


def _cell(value: float | None) -> Any:
    return "" if finite(value) is None else value


def _settings(settings: Mapping[str, str]) -> str:
    return " ".join(f"{name}={value}" for name, value in settings.items())
