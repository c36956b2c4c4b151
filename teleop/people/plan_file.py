"""The file of a plan: TOML, checked key by key before anything is written.

    name = "feltstiffness"           # letters and digits: it names the files
    design = "within"                # each person meets every condition; or "between": each person meets one
    order = "williams"               # of the conditions, a Williams square; or "random"
    scene = "hard_wall"              # a scene's name, or its FILE.py
    set = {delay = 0.02}             # knobs of every trial
    seed = 1                         # of orders and of simulated people
    turn = 1.5                       # s, from one trial to the next, the same whatever changes

    [participants]
    least = 12                       # people with whom the analysis is made
    most = 24
    multiple_of = 2

    [[condition]]
    name = "wave"
    set = {law = "wave"}

    [task]                           # see `TrialTask`
    kind = "compare"
    method = "constant"
    standard = 500.0
    levels = [350.0, 420.0, 600.0, 720.0]
    repeats = 10

    [training]
    trials = 4                       # before the first trial of each condition

    [breaks]
    every = 20                       # trials
    seconds = 60.0                   # at least

    [[question]]                     # after the trials of each condition, or after="session"
    kind = "tlx"
    weighted = true

    [exclusion]                      # see `Exclusion`
    least_correct = 0.6

    [analysis]
    primary = "w"
    contrasts = [["wave", "pp"]]
    correction = "holm"

    [power]
    d_z = 0.8                        # the least effect of interest

    [simulated]                      # people of `teleop study simulate`; see `Simulated`
    w = 0.15
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import MISSING, fields
from enum import StrEnum
from pathlib import Path
from re import fullmatch
from typing import Any, TypeVar

from teleop.errors import Refused, enumerated, nearest, number, number_of, whole_number
from teleop.people.plan import (
    OF_TASK,
    SHOWN,
    After,
    Analysis,
    Correction,
    Design,
    Exclusion,
    LevelMethod,
    Measure,
    Order,
    Participants,
    Power,
    QuestionKind,
    Simulated,
    StudyCondition,
    StudyPlan,
    StudyQuestion,
    TaskKind,
    TrialTask,
)
from teleop.storage.files import read_bytes
from teleop.storage.toml_tables import check_keys, is_tables, knobs_in, read_toml, repeated, text_of

LONGEST = 24  # characters of a name
MOST_PEOPLE = 1000
Chosen = TypeVar("Chosen", bound=StrEnum)
TOP = ("name", "design", "order", "scene", "set", "seed", "turn", "consent", "participants", "condition", "task",
       "training", "breaks", "question", "exclusion", "analysis", "power", "simulated")


def read_plan(path: Path | str) -> StudyPlan:
    """Read and check the plan of a file; its scene is not made yet. Raises `Refused`."""
    path = Path(path)
    file = read_toml(path, f"the plan {path}", "a file of TOML, for example one of scenarios/examples/people")
    where = path.name
    check_keys(file, TOP, where)
    for key in ("name", "scene", "participants", "condition", "task", "analysis"):
        if key not in file:
            raise Refused(f"{where} has no {key}; {_EXAMPLES[key]}")
    name = text_of(file["name"], "name", where)
    if len(name) > LONGEST or fullmatch("[A-Za-z0-9]+", name) is None:
        raise Refused(f"{where}: name has at most {LONGEST} letters and digits, for it names the files, not {name!r}; "
                      "write for example name = \"feltstiffness\"")
    design = _choice(Design, file.get("design", "within"), "design", where)
    order = _choice(Order, file.get("order", "williams"), "order", where)
    conditions = _conditions(file["condition"], where)
    task = _task(file["task"], where)
    training = _table(file, "training", ("trials",), where)
    breaks = _table(file, "breaks", ("every", "seconds"), where)
    questions = _questions(file.get("question", []), where)
    plan = StudyPlan(
        name=name, design=design, order=order, scene=text_of(file["scene"], "scene", where),
        knobs=knobs_in(file.get("set", {}), where), seed=_whole(file, "seed", where, 0, low=0),
        turn=_number(file, "turn", where, 1.5, low=0.5, high=10.0), participants=_participants(file, where),
        conditions=conditions, task=task,
        training=_whole(training, "trials", f"{where} [training]", 0, low=0, high=1000),
        break_every=_whole(breaks, "every", f"{where} [breaks]", 0, low=0),
        break_seconds=_number(breaks, "seconds", f"{where} [breaks]", 0.0, low=0.0, high=3600.0), questions=questions,
        exclusion=_record(Exclusion, _table(file, "exclusion", _keys(Exclusion), where), f"{where} [exclusion]"),
        analysis=_analysis(file["analysis"], conditions, task, questions, where), power=_power(file, where),
        simulated=_simulated(file, conditions, where), consent=_text(file, "consent", where),
        source=read_bytes(path).decode())
    _check_balance(plan, where)
    return plan


_EXAMPLES = {
    "name": 'write name = "feltstiffness"',
    "scene": 'write scene = "hard_wall"',
    "participants": "write [participants] and below it least = 12 and most = 24",
    "condition": 'write [[condition]] and below it name = "wave" and set = {law = "wave"}',
    "task": 'write [task] and below it kind = "compare"',
    "analysis": 'write [analysis] and below it primary = "w" and contrasts = [["wave", "pp"]]',
}


def _table(file: Mapping[str, Any], key: str, keys: Iterable[str], where: str) -> dict[str, Any]:
    table = file.get(key, {})
    if not isinstance(table, dict):
        raise Refused(f"{where}: {key} is a table; begin it with [{key}]")
    check_keys(table, keys, f"{where} [{key}]")
    return table


def _keys(kind: type[Any]) -> tuple[str, ...]:
    return tuple(each.name for each in fields(kind))


def _choice(kind: type[Chosen], value: object, key: str, where: str) -> Chosen:
    words = [each.value for each in kind]
    if not isinstance(value, str) or value not in words:
        raise Refused(f"{where}: {key} is {enumerated(words, 'or')}, not {value!r}; "
                      f"write {key} = \"{words[0]}\"")
    return kind(value)


def _number(table: Mapping[str, Any], key: str, where: str, default: float, *, low: float | None = None,
            above: float | None = None, high: float | None = None) -> float:
    return number(f"{where}: {key}", table.get(key, default), low=low, above=above, high=high)


def _whole(table: Mapping[str, Any], key: str, where: str, default: int, *, low: int, high: int | None = None) -> int:
    return whole_number(f"{where}: {key}", table.get(key, default), low=low, high=high)


def _text(table: Mapping[str, Any], key: str, where: str) -> str:
    return text_of(table[key], key, where) if key in table else ""


def _truth(table: Mapping[str, Any], key: str, where: str, default: bool) -> bool:
    value = table.get(key, default)
    if not isinstance(value, bool):
        raise Refused(f"{where}: {key} is true or false, not {value!r}; write {key} = true")
    return value


def _numbers(table: Mapping[str, Any], key: str, where: str) -> tuple[float, ...]:
    values = table.get(key, [])
    if not isinstance(values, list) or not values:
        raise Refused(f"{where}: {key} is a list of numbers above 0, not {values!r}; write {key} = [...]")
    got = tuple(number(f"{where}: {key}", each, above=0.0) for each in values)
    if (twice := repeated(got)) is not None:
        raise Refused(f"{where}: {key} has {twice:g} twice; leave one of them out")
    return got


def _record(kind: type[Any], table: Mapping[str, Any], where: str) -> Any:
    """A record of numbers and truths, by the types of its defaults."""
    read: dict[str, Any] = {}
    for each in fields(kind):
        if each.name in table:
            default = None if each.default is MISSING else each.default
            read[each.name] = (_truth(table, each.name, where, default) if isinstance(default, bool)
                               else _number(table, each.name, where, 0.0))
    return kind(**read)


def _participants(file: Mapping[str, Any], where: str) -> Participants:
    table = _table(file, "participants", _keys(Participants), where)
    at = f"{where} [participants]"
    for key in ("least", "most"):
        if key not in table:
            raise Refused(f"{at} has no {key}; write for example {key} = {12 if key == 'least' else 24}")
    multiple = _whole(table, "multiple_of", at, 1, low=1)
    least, most = (_whole(table, key, at, 0, low=2, high=MOST_PEOPLE) for key in ("least", "most"))
    if most < least:
        raise Refused(f"{at}: most is {most}, fewer than least, {least}; write most = {least}")
    for key, value in (("least", least), ("most", most)):
        if value % multiple:
            raise Refused(f"{at}: {key} is {value}, which is no multiple of {multiple}; write {key} = "
                          f"{-(-value // multiple) * multiple}")
    return Participants(least=least, most=most, multiple_of=multiple)


def _conditions(tables: object, where: str) -> tuple[StudyCondition, ...]:
    if not is_tables(tables) or not isinstance(tables, list):
        raise Refused(f"{where}: condition is a list of tables; begin each with [[condition]]")
    conditions = []
    for i, table in enumerate(tables, 1):
        at = f"[[condition]] {i} of {where}"
        check_keys(table, ("name", "set"), at)
        name = text_of(table.get("name", ""), "name", at)
        conditions.append(StudyCondition(name=name, knobs=knobs_in(table.get("set", {}), at)))
    if (twice := repeated([each.name for each in conditions])) is not None:
        raise Refused(f"{where} has two conditions called {twice!r}; give one of them another name")
    if len(conditions) > 12:
        raise Refused(f"{where} has {len(conditions)} conditions, more than 12; nobody can be asked all of them")
    return tuple(conditions)


_OF_KIND = {
    TaskKind.REACH: ("distances", "widths", "repeats"),
    TaskKind.PRESS: ("forces", "repeats"),
    TaskKind.COMPARE: ("knob", "standard", "levels", "method", "repeats", "trials", "down"),
    TaskKind.FREE: ("repeats",),
}


def _task(table: object, where: str) -> TrialTask:
    at = f"{where} [task]"
    if not isinstance(table, dict):
        raise Refused(f"{where}: task is a table; begin it with [task]")
    kind = _choice(TaskKind, table.get("kind"), "kind", at)
    check_keys(table, ("kind", "seconds", "text", "show", *_OF_KIND[kind]), at)
    common: dict[str, Any] = {"kind": kind, "seconds": _number(table, "seconds", at, 2.6, low=0.2, high=600.0),
              "text": _text(table, "text", at), "show": _visible(table.get("show", list(SHOWN)), at),
              "repeats": _whole(table, "repeats", at, 1, low=1, high=10_000)}
    if kind is TaskKind.REACH:
        return TrialTask(**common, distances=_numbers(table, "distances", at), widths=_numbers(table, "widths", at))
    if kind is TaskKind.PRESS:
        return TrialTask(**common, forces=_numbers(table, "forces", at))
    if kind is TaskKind.FREE:
        return TrialTask(**common)
    method = _choice(LevelMethod, table.get("method", "constant"), "method", at)
    levels, standard = _numbers(table, "levels", at), _number(table, "standard", at, 0.0, above=0.0)
    if standard in levels:
        raise Refused(f"{at}: levels have the standard itself, {standard:g}, where no answer is correct; leave it out")
    if method is LevelMethod.CONSTANT:
        for key in ("trials", "down"):
            if key in table:
                raise Refused(f"{at}: {key} belongs to staircase and quest; write repeats, or method = \"staircase\"")
        if common["repeats"] % 2:
            raise Refused(f"{at}: repeats is {common['repeats']}, an odd number, with which a level cannot stand first "
                          f"as often as second; write repeats = {common['repeats'] + 1}")
    elif "repeats" in table:
        raise Refused(f"{at}: repeats belongs to method = \"constant\"; write trials")
    if method is LevelMethod.STAIRCASE and not (all(level > standard for level in levels)
                                           or all(level < standard for level in levels)):
        raise Refused(f"{at}: the levels of a staircase lie on one side of its standard, {standard:g}; leave out those "
                      "of the other side")
    if method is LevelMethod.STAIRCASE and len(levels) < 3:
        raise Refused(f"{at}: a staircase of {number_of(len(levels), 'level')} has no steps; write three at least")
    return TrialTask(**common, intervals=2, knob=_text(table, "knob", at) or "k_e", standard=standard, levels=levels,
                method=method, trials=_whole(table, "trials", at, 40, low=2, high=10_000),
                down=_whole(table, "down", at, 2, low=1, high=10))


def _visible(names: object, at: str) -> tuple[str, ...]:
    if not isinstance(names, list) or not all(name in SHOWN for name in names) or not {"hand", "master"} & {*names}:
        raise Refused(f"{at}: show is a list of {enumerated(SHOWN)}, hand or master among them, not {names!r}; write "
                      "show = [\"hand\", \"master\", \"slave\"]")
    return tuple(names)


def _questions(tables: object, where: str) -> tuple[StudyQuestion, ...]:
    if not is_tables(tables) or not isinstance(tables, list):
        raise Refused(f"{where}: question is a list of tables; begin each with [[question]]")
    questions = []
    for i, table in enumerate(tables, 1):
        at = f"[[question]] {i} of {where}"
        check_keys(table, _keys(StudyQuestion), at)
        kind = _choice(QuestionKind, table.get("kind"), "kind", at)
        items = table.get("items", [])
        if kind is not QuestionKind.TLX and not items:
            raise Refused(f"{at} has no items; write for example items = [\"How hard was it to feel the wall?\"]")
        if not isinstance(items, list) or not all(isinstance(each, str) and each.strip() for each in items):
            raise Refused(f"{at}: items is a list of texts, not {items!r}; write items = [\"How hard was it?\"]")
        if kind is QuestionKind.TLX and items:
            raise Refused(f"{at}: NASA-TLX has items of its own; leave items out")
        questions.append(StudyQuestion(
            kind=kind, items=tuple(items), points=_whole(table, "points", at, 7, low=2, high=101),
            weighted=_truth(table, "weighted", at, False),
            after=_choice(After, table.get("after", "condition"), "after", at)))
    return tuple(questions)


def _analysis(table: object, conditions: tuple[StudyCondition, ...], task: TrialTask,
              questions: tuple[StudyQuestion, ...], where: str) -> Analysis:
    at = f"{where} [analysis]"
    if not isinstance(table, dict):
        raise Refused(f"{where}: analysis is a table; begin it with [analysis]")
    check_keys(table, _keys(Analysis), at)
    primary = _choice(Measure, table.get("primary"), "primary", at)
    if primary not in OF_TASK[task.kind]:
        raise Refused(f"{at}: a task {task.kind} has no {primary}; there are: {', '.join(OF_TASK[task.kind])}")
    if primary is Measure.TLX and not any(each.kind is QuestionKind.TLX and each.after is After.CONDITION
                                          for each in questions):
        raise Refused(f"{at}: primary is tlx, and no condition is followed by it; write [[question]] and below it "
                      "kind = \"tlx\"")
    names = [each.name for each in conditions]
    pairs = table.get("contrasts", [])
    if not isinstance(pairs, list) or not all(isinstance(pair, list) and len(pair) == 2 for pair in pairs):
        raise Refused(f"{at}: contrasts is a list of pairs of conditions, not {pairs!r}; write contrasts = "
                      f"[[\"{names[0]}\", \"{names[-1]}\"]]")
    for name in (name for pair in pairs for name in pair):
        if name not in names:
            raise Refused(f"{at}: contrasts name the condition {name!r}; {nearest(str(name), names)}")
    if any(first == second for first, second in pairs):
        raise Refused(f"{at}: a contrast is between two conditions, not of one with itself; leave it out")
    return Analysis(primary=primary, contrasts=tuple((first, second) for first, second in pairs),
                    correction=_choice(Correction, table.get("correction", "holm"), "correction", at),
                    alpha=_number(table, "alpha", at, 0.05, above=0.0, high=0.5),
                    lapse=_number(table, "lapse", at, 0.02, low=0.0, high=0.1))


def _power(file: Mapping[str, Any], where: str) -> Power | None:
    if "power" not in file:
        return None
    table = _table(file, "power", _keys(Power), where)
    return Power(d_z=_number(table, "d_z", f"{where} [power]", 0.0, above=0.0, high=10.0),
                 power=_number(table, "power", f"{where} [power]", 0.8, low=0.05, high=0.999))


def _simulated(file: Mapping[str, Any], conditions: tuple[StudyCondition, ...], where: str) -> Simulated:
    table = _table(file, "simulated", _keys(Simulated), where)
    at = f"{where} [simulated]"
    effects = table.get("effects", {})
    if not isinstance(effects, dict):
        raise Refused(f"{at}: effects is a table, not {effects!r}; write effects = {{{conditions[0].name} = 0.2}}")
    check_keys(effects, [each.name for each in conditions], f"{at} effects")
    numbers = {key: _number(table, key, at, 0.0, low=None if key in ("bias", "learning") else 0.0)
               for key in _keys(Simulated) if key in table and key != "effects"}
    for key in ("w", "slope"):
        if key in numbers:
            number(f"{at}: {key}", numbers[key], above=0.0)
    if "lapse" in numbers:
        number(f"{at}: lapse", numbers["lapse"], high=0.5)
    return Simulated(**numbers, effects={name: number(f"{at}: effects.{name}", value)
                                         for name, value in effects.items()})


def _check_balance(plan: StudyPlan, where: str) -> None:
    """Refuse numbers of people with whom orders are not balanced."""
    rows = plan.rows
    if plan.participants.least % rows or plan.participants.most % rows:
        kind = "conditions" if plan.design is Design.BETWEEN else "orders"
        raise Refused(f"{where} [participants]: least {plan.participants.least} and most {plan.participants.most} are "
                      f"not both multiples of the {rows} {kind}, so some would stand more often; write multiple_of = "
                      f"{rows}, and numbers to suit")
