"""The commands `teleop study`: check a plan, simulate its people, analyse and unblind a study, run a trial again."""

from __future__ import annotations

import os
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, fields
from importlib.util import find_spec
from math import isfinite, log
from pathlib import Path
from typing import Any

from teleop.errors import Refused, nearest, number_of
from teleop.people.adaptive import share_correct
from teleop.people.analysis import Analysed, Findings, analyse, every_pair
from teleop.people.contrasts import paired_power, people_needed, unpaired_power
from teleop.people.felt import check_levels, compliance, felt_stiffness, limen, with_stiffness
from teleop.people.journal import NAME, Journal, of_kind, read_journal
from teleop.people.plan import OF_TASK, ON_A_LOG_SCALE, UNITS, Design, Measure, StudyPlan
from teleop.people.plan_file import read_plan
from teleop.people.schedule import Trial, disk_of, seconds_of, trials_of
from teleop.people.session import VISUAL, check_modality
from teleop.people.simulated import Person, simulate_session
from teleop.people.study import LOOKS, Study, check_lock, create_study, intervals, open_study, write_lock
from teleop.scene.loading import load_scene
from teleop.simulation.result import versions
from teleop.simulation.virtual import run
from teleop.storage.folder import new_folder
from teleop.terminal.answer import Answer, WithUnit, finite, with_units
from teleop.terminal.plotting import asked_formats, save
from teleop.terminal.progress import shown_for
from teleop.terminal.run_table import table
from teleop.terminal.table import columns, duration, facts


def command(args: Namespace) -> Answer:
    """Carry out `teleop study ACTION`. Raises `Refused`."""
    return ACTIONS[args.action](args)


def _head(args: Namespace, plan: StudyPlan, sentence: str) -> dict[str, Any]:
    return {"status": "done", "sentence": sentence, "scene": plan.scene, "mode": f"study {args.action}",
            "versions": versions(), "command": list(args.typed), "name": plan.name, "plan": plan.digest}


def check(args: Namespace) -> Answer:
    """Check a plan: what each law lets through, balance, power, time and disk; with --lock, register it."""
    path = Path(args.plan)
    plan = read_plan(path)
    is_locked = check_lock(path, plan)
    felt = felt_stiffness(plan)
    check_levels(plan, felt)
    minutes, most = seconds_of(plan) / 60.0, plan.participants.most
    disk = disk_of(plan)
    rows = plan.rows
    balance = (f"{plan.design.value}, {plan.order.value}: {number_of(rows, 'row')}, repeated "
               f"{number_of(plan.participants.least // rows, 'time')} by {plan.participants.least} people")
    power, power_text = _power(plan)
    why = _pointer_refusal(plan)
    if args.lock:
        write_lock(path, plan, {"date": args.date, "versions": versions()})
    lines = [("study", f"{plan.name}: {plan.task.kind.value}, {number_of(len(plan.conditions), 'condition')} in "
                       f"{plan.scene}"),
             ("balance", balance),
             ("a person", f"{trials_of(plan)} trials, {duration(60.0 * minutes)}, {disk / 1e6:.0f} MB on disk "
                          f"({disk * most / 1e9:.1f} GB for {most})"),
             ("device", "a mouse or a haptic device" if why is None else f"no mouse: {why}"),
             ("power", power_text),
             ("lock", f"locked on {args.date}" if args.lock else "locked, and unchanged since" if is_locked else
              f"none: teleop study check {path} --lock registers the plan")]
    document = {**_head(args, plan, "the plan can be run"), "locked": bool(args.lock or is_locked), **with_units({
        "minutes": WithUnit(minutes, "min"), "disk": WithUnit(disk, "bytes"), "rows": rows, "trials": trials_of(plan),
        "power": power, "pointer": why is None, "felt": _felt_document(plan, felt)}, head={})}
    text = facts(lines)
    if with_stiffness(plan):
        text += "\n\n" + _felt_table(plan, felt)
    return Answer(text, document)


def _pointer_refusal(plan: StudyPlan) -> str | None:
    """Why the plan cannot be run with a pointer; None if it can."""
    try:
        check_modality(plan, plan.analysis.primary, [VISUAL])
    except Refused as refused:
        return str(refused)
    return None


def _probability(plan: StudyPlan, felt: Mapping[float, float], level: float) -> float:
    return share_correct(abs(log(felt[level] / felt[plan.task.standard])), plan.simulated.w, plan.simulated.lapse)


def _felt_document(plan: StudyPlan, felt: Mapping[str, Mapping[float, float]]) -> list[dict[str, Any]]:
    return [{"condition": name, "level": level, "felt_stiffness": value,
             "correct": None if level == plan.task.standard else _probability(plan, of, level)}
            for name, of in felt.items() for level, value in of.items()]


def _felt_table(plan: StudyPlan, felt: Mapping[str, Mapping[float, float]]) -> str:
    """Felt stiffness, and the share of correct answers that is expected, of each level under each condition."""
    task, w = plan.task, plan.simulated.w
    head = ["condition", "level", "felt", "correct", "JND up", "down"]
    lines: list[Sequence[str]] = [head]
    for name, of in felt.items():
        c = compliance(of, task.standard)
        for level, value in of.items():
            standard = level == task.standard
            lines.append([name if level == min(of) else "", f"{level:g} N/m", f"{value:.1f} N/m",
                          "standard" if standard else f"{_probability(plan, of, level):.3f}",
                          *(_limen_texts(c, task.standard, w) if standard else ["", ""])])
    return (columns(lines) + f"\nexpected with w = {w:g} and lapses of {plan.simulated.lapse:g} ([simulated]); "
            f"JND: of {task.knob}, at {task.standard:g} N/m, 84.1 % of answers correct")


def _limen_texts(c: float, standard: float, w: float) -> list[str]:
    """The difference limens of a wall's own stiffness, upwards and downwards."""
    walls = [limen(c, standard, w, z) for z in (1.0, -1.0)]
    return ["none" if wall is None else f"{wall / standard - 1.0:+.1%}" for wall in walls]


def _power(plan: StudyPlan) -> tuple[dict[str, Any] | None, str]:
    if plan.power is None:
        return None, "not asked for: write [power] and below it d_z = 0.8"
    if find_spec("scipy") is None:
        return None, "needs scipy; install it with: pip install 'bilateral-teleop[people]'"
    alpha = plan.analysis.alpha
    is_within = plan.design is Design.WITHIN
    test = paired_power if is_within else unpaired_power
    n = plan.participants.least if is_within else plan.participants.least // len(plan.conditions)
    needed, power = people_needed(test, plan.power.d_z, plan.power.power, alpha), test(plan.power.d_z, n, alpha)
    each = "" if is_within else " in each condition"
    enough = f"{n} people{each} find d = {plan.power.d_z:g} with a power of {power:.3f}; {needed} have " \
             f"{plan.power.power:g}"
    return {"d": plan.power.d_z, "people": n, "power": power, "needed": needed}, enough


def simulate(args: Namespace) -> Answer:
    """Carry out a study with simulated people; with --recover, many, to see what the analysis makes of them."""
    plan = read_plan(args.plan)
    check_lock(Path(args.plan), plan)
    count = args.participants or plan.participants.least
    if count > plan.participants.most:
        raise Refused(f"the plan has at most {plan.participants.most} participants, not {count}; write --participants "
                      f"{plan.participants.most}")
    if args.recover is not None:
        from teleop.people.recovery import recover

        with shown_for(args, float(args.recover)) as show:
            return recover(args, plan, count, lambda done: show(float(done), f"{done} of {args.recover} studies"),
                           _head(args, plan, f"{args.recover} studies"))
    is_there = args.out is not None and (Path(args.out) / "study.json").exists()
    study = (open_study(args.out, plan, simulated=True) if is_there else
             create_study(plan, args.out, entropy=plan.seed, simulated=True))
    with shown_for(args, float(count)) as show:
        for number in range(1, count + 1):
            show(float(number - 1), f"{number - 1} of {number_of(count, 'person', 'people')}")
            with study.journal(number, sync=False) as journal:
                simulate_session(Person(plan, number, study.key.felt, study.key.conditions), journal)
    study.write_tables()
    trials = count * trials_of(plan)
    people = number_of(count, "simulated person", "simulated people")
    text = facts([("study", f"{plan.name}: {people}, {trials} trials"),
                  ("table", str(study.folder / "data" / f"study-{plan.name}_data.csv")),
                  ("next", f"teleop study analyse {study.folder}")])
    document = {**_head(args, plan, f"{count} simulated people"), "participants": count, "trials": trials}
    return Answer(text, document).kept_in(study.folder)


def contrast_pairs(study: Study) -> list[tuple[str, str]]:
    """The contrasts by letter: the plan's once the study is unblinded, and every pair before it.

    Which contrasts a plan names, and in which order, would tell letters apart.
    """
    if not study.looks():
        return every_pair(study.key.conditions)
    letters = {condition.name: letter for letter, condition in study.key.conditions.items()}
    return [(letters[first], letters[second]) for first, second in study.plan.analysis.contrasts]


def analyse_command(args: Namespace) -> Answer:
    """Analyse a study: measures of each condition, contrasts, effect sizes, and what was left out, before and after."""
    formats = asked_formats(args)
    study = open_study(args.folder)
    measure = study.plan.analysis.primary if args.measure is None else _measure(study.plan, args.measure)
    journals = [*study.rows()]
    check_modality(study.plan, measure, (row.get("modality") for _, rows in journals for row in rows))
    study.write_tables()
    analysed = analyse(study.plan, study.key.felt, journals, contrast_pairs(study), measure)
    if not analysed.before.trials:
        raise Refused(f"{study.folder} has no trials yet; run teleop study run, or teleop study simulate")
    document = {**_head(args, study.plan, f"{analysed.after.people} people"), "measure": analysed.measure.value,
                "blind": not study.looks(), "simulated": study.simulated,
                "before": _document(study, analysed.before), "after": _document(study, analysed.after),
                "excluded": {"trials": analysed.excluded.trials,
                             "people": {f"sub-{n:02d}": why for n, why in analysed.excluded.people.items()},
                             "no_measure": [[f"sub-{n:02d}", study.label(each)]
                                            for n, each in analysed.excluded.fits]}}
    answer = Answer(_text(study, analysed), document)
    if formats:
        from teleop.people.plot import figure_of

        answer = answer.with_plots(study.folder, save(figure_of(study, analysed), study.folder / "people", formats))
    return answer


def _measure(plan: StudyPlan, name: str) -> Measure:
    measures = OF_TASK[plan.task.kind]
    if name not in [each.value for each in measures]:
        raise Refused(f"a task {plan.task.kind} has no measure {name!r}; {nearest(name, measures)}")
    return Measure(name)


def _document(study: Study, analysed: Findings) -> dict[str, Any]:
    label = study.label
    return {"people": analysed.people, "trials": analysed.trials,
            "conditions": [{**asdict(each), "letter": label(each.letter), "low": finite(each.low),
                            "high": finite(each.high)} for each in analysed.summaries],
            "contrasts": [{**asdict(each), "corrected_interval": each.effect_interval(study.plan.analysis.alpha),
                           "first": label(each.first), "second": label(each.second)}
                          for each in analysed.contrasts],
            "pooled": {label(letter): {"w": each.w, "low": each.low, "high": finite(each.high), "bias": each.bias,
                                       "lapse": each.lapse, "trials": each.trials}
                       for letter, each in analysed.pooled.items()}}


def _text(study: Study, analysed: Analysed) -> str:
    plan, excluded = study.plan, analysed.excluded
    unit = UNITS.get(analysed.measure, "")
    blind = "letters until teleop study unblind" if not study.looks() else "unblinded"
    left_out = [*(f"{number_of(n, 'trial')} {reason}" for reason, n in excluded.trials.items()),
                *(f"sub-{person:02d}: {why}" for person, why in excluded.people.items()),
                *(f"sub-{person:02d} in {study.label(letter)}: the trials tell no {analysed.measure.value}"
                  for person, letter in excluded.fits)]
    head = facts([("study", f"{plan.name}: {number_of(analysed.before.people, 'person', 'people')}, "
                            f"{analysed.before.trials} trials{', simulated' * study.simulated}; {blind}"),
                  ("measure", f"{analysed.measure.value}{f', {unit}' if unit else ''}"
                              + (", compared by its logarithm" if analysed.measure in ON_A_LOG_SCALE else "")),
                  ("left out", "; ".join(left_out) or "nothing")])
    parts = [head, _findings_text(study, analysed.after, analysed.measure)]
    if analysed.before is not analysed.after:
        parts.append("before anything was left out\n" + _findings_text(study, analysed.before, analysed.measure))
    return "\n\n".join(parts)


def _findings_text(study: Study, analysed: Findings, measure: Measure) -> str:
    level = f"{1.0 - study.plan.analysis.alpha:.0%}"
    lines: list[Sequence[str]] = [["condition", "people", "mean", level, "all as one", level]]
    for each in analysed.summaries:
        one = analysed.pooled.get(each.letter)
        as_one = ["", ""] if one is None or measure is not Measure.W else [f"{one.w:.4f}", _interval(one.low, one.high)]
        lines.append([study.label(each.letter), str(each.people), f"{each.mean:.4g}", _interval(each.low, each.high),
                      *as_one])
    if not any(line[4] for line in lines[1:]):
        lines = [line[:4] for line in lines]
    jnds = _limens(study, analysed) if measure is Measure.W else ""
    effect = "g_z" if study.plan.design is Design.WITHIN else "g_s"
    head = ["contrast", "people", "difference", level, "t", "df", "p", "corrected", effect, level]
    tests: list[Sequence[str]] = [head]
    for of in analysed.contrasts:
        tests.append([f"{study.label(of.first)} - {study.label(of.second)}", str(of.people), f"{of.estimate:+.4f}",
                      _interval(of.low, of.high), f"{of.t:.3f}", f"{of.df:.0f}", _p(of.p), _p(of.p_corrected),
                      f"{of.corrected:.2f}", _interval(*of.effect_interval(study.plan.analysis.alpha))])
    note = "" if len(tests) > 1 else "\nno contrast: three people at least with both conditions are needed"
    return columns(lines) + jnds + ("\n\n" + columns(tests) if len(tests) > 1 else note)


def _limens(study: Study, findings: Findings) -> str:
    """The difference limens of the wall's own stiffness, with their level; they would tell letters apart."""
    if not (study.looks() and with_stiffness(study.plan)):
        return ""
    standard, sentences = study.plan.task.standard, []
    for each in findings.summaries:
        c = compliance(study.key.felt[each.letter], standard)
        sentences.append(f"{study.label(each.letter)} {' and '.join(_limen_texts(c, standard, each.mean))}")
    return f"\nJND of {study.plan.task.knob} at {standard:g} N/m, 84.1 % correct: {'; '.join(sentences)}"


def _interval(low: float, high: float) -> str:
    return f"{low:.4g} .. {high:.4g}" if isfinite(low) and isfinite(high) else f"{low:.4g} .. none"


def _p(p: float) -> str:
    return "<.0001" if p < 1e-4 else f"{p:.4f}"


def unblind(args: Namespace) -> Answer:
    """Write who looks at the key, and when, and show it."""
    study = open_study(args.folder)
    who = args.name or os.environ.get("USER") or os.environ.get("LOGNAME") or "unknown"
    with Journal(study.folder / LOOKS) as looks:
        looks.append({"kind": "look", "who": who, "when": args.date})
        number = len(looks.rows)
    key = {letter: condition.name for letter, condition in study.key.conditions.items()}
    text = facts([("study", f"{study.plan.name}: look {number} at the key, by {who} on {args.date}"),
                  *((letter, name) for letter, name in sorted(key.items()))])
    return Answer(text, {**_head(args, study.plan, f"look {number} at the key"), "key": key, "who": who,
                         "when": args.date})


def rerun(args: Namespace) -> Answer:
    """Run a trial's hand again under another law, in virtual time, with its own knobs; or show its own run."""
    study = open_study(args.folder)
    person, _, number = args.trial.removeprefix("sub-").partition("/")
    if not (person.isdecimal() and number.isdecimal()):
        raise Refused(f"--trial {args.trial} is no trial; write for example --trial sub-03/7")
    rows = of_kind(read_journal(study.home(int(person)) / NAME), "trial")
    row = next((each for each in rows if each["number"] == int(number)), None)
    if row is None:
        raise Refused(f"{study.folder} has no trial {args.trial}; the table in data names all of them")
    if not study.looks() and any(not _is_of_law(name) for each in study.plan.conditions for name in each.knobs):
        raise Refused("a trial's knobs would tell its condition, and the study is blind; type teleop study unblind "
                      f"{study.folder} first")
    trial = Trial(**{each.name: row[each.name] for each in fields(Trial)})
    records = study.records(int(person), trial)
    if not all(record.is_dir() for record in records):
        raise Refused(f"trial {args.trial} has no record of a hand" + (": its person is simulated" if study.simulated
                      else "; it was removed") + ", so there is nothing to run again")
    if args.law is None:
        return _own_run(args, study, records)
    scenes = [load_scene(study.plan.scene, **{name: value for name, value in knobs.items() if not _is_of_law(name)
                                              and name != "duration"}, law=args.law, hand=str(record))
              for knobs, record in zip(intervals(study, trial), records, strict=True)]
    texts, summaries = [], []
    with new_folder(args.out, f"{study.plan.name}-rerun") as new:
        for scene, record in zip(scenes, records, strict=True):
            result = run(scene, seed=study.plan.seed, clock=args.nanoseconds)
            (new.inside / record.name).mkdir()
            result.write(new.inside / record.name, args.typed)
            texts.append(table(result))
            summaries.append(result.summary(args.typed))
    document = {**_head(args, study.plan, f"trial {args.trial} under {args.law}"), "trial": args.trial, "law": args.law,
                "intervals": summaries}
    return Answer("\n\n".join(texts), document).kept_in(new.path)


def _own_run(args: Namespace, study: Study, records: Sequence[Path]) -> Answer:
    """The files that the two ends of a trial left, which name its law."""
    from teleop.people.trials.records import unpack

    if not study.looks():
        raise Refused(f"a trial's run names its law, and the study is blind; type teleop study unblind {study.folder} "
                      "first")
    with new_folder(args.out, f"{study.plan.name}-trial") as new:
        for record in records:
            unpack(record, new.inside / record.name)
    text = facts([("trial", f"{args.trial}, as its two ends recorded it"),
                  ("next", f"teleop report {new.path / records[0].name}")])
    return Answer(text, {**_head(args, study.plan, f"trial {args.trial}"), "trial": args.trial}).kept_in(new.path)


def _is_of_law(knob: str) -> bool:
    return knob.partition(".")[0] == "law"


def run_session(args: Namespace) -> Answer:
    """Carry out the session of a person, on a screen of their own."""
    from teleop.people.trials.command import run

    return run(args, lambda plan, sentence: _head(args, plan, sentence))


ACTIONS: dict[str, Callable[[Namespace], Answer]] = {
    "check": check, "simulate": simulate, "analyse": analyse_command, "unblind": unblind, "rerun": rerun,
    "run": run_session,
}
