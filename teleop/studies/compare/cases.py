"""The cases of a comparison: the file that says which laws meet which links and environments, and the rows of each.

    seeds = 3                       # the seeds 0, 1, 2 of each link with dice; or a list of seeds
    laws = ["wave", "pfra"]         # left out: every law with two ends that is installed
    fitted = true                   # each law with the parameters that follow from link and bodies, where it knows any
    tune = "hard wall"              # the environment that `compare --tuned` searches in; left out: the first
    set = {x_limit = 0.3}           # knobs of every row

    [[law]]                         # one more law, with knobs of its own
    name = "soft wave"
    law = "wave"
    set = {b = 2.0}

    [[link]]
    name = "50 ms"
    link = "delay(0.05)"            # as --link takes it; {folder} is the folder of this file
    set = {playout = "integral"}    # knobs of the rows over this link

    [[environment]]
    name = "hard wall"
    scene = "hard_wall"             # the name of a scene, or its FILE.py
    set = {duration = 3.5}          # knobs of the rows in this environment

Each law meets each link in each environment: that is a case. Where two tables set the same knob, the file is refused.
A case has a row for each seed, and a single one where the link has no dice: there every seed gives the same run. All
rows are checked before any is run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from re import fullmatch, sub
from shlex import quote
from typing import Any

from teleop.errors import Refused, nearest, whole_number
from teleop.law import is_built_in, two_port_laws
from teleop.scene.knobs import law_with_its_numbers
from teleop.scene.library import ROOT, import_bundled, known_scenes, own_file, scene_function
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene
from teleop.simulation.notes import facts, law_notes, of_plans
from teleop.simulation.plan import LinkPlans, link_plans
from teleop.storage.toml_tables import check_keys, is_tables, knobs_in, read_toml, repeated, text_of

BUILT_IN = ROOT / "scenarios" / "compare.toml"
TOP = ("seeds", "laws", "fitted", "tune", "set", "law", "link", "environment")
MOST_SEEDS = 1000
LONGEST = 24  # characters of a name
_SUBJECT = {"law": "law", "link": "link", "environment": "scene"}  # the key of each table that names its content
_EXAMPLE = {"law": "wave", "link": "delay(0.05)", "environment": "hard_wall"}
Tuned = Mapping[tuple[str, str], Mapping[str, object]]  # by the names of law and link, the law's parameters as knobs


@dataclass(frozen=True, kw_only=True, slots=True)
class ComparedItem:
    """Law, link or environment: its name in tables and figures, the text that defines it, and its knobs."""

    name: str
    text: str
    knobs: Mapping[str, object]


@dataclass(frozen=True, kw_only=True, slots=True)
class Comparison:
    """Laws, links, environments and seeds of a comparison. `read_comparison` makes and checks it."""

    name: str  # of the file, without its ending
    laws: tuple[ComparedItem, ...]
    links: tuple[ComparedItem, ...]
    environments: tuple[ComparedItem, ...]
    seeds: tuple[int, ...]
    fitted: bool
    tune: str  # the environment in which laws are tuned
    knobs: Mapping[str, object]  # of every row


def read_comparison(path: Path | str = BUILT_IN, laws: Sequence[str] | None = None) -> Comparison:
    """The comparison of a file, its keys and values checked; its scenes are not made yet.

    The name of an installed scene stands for a file with that scene as its environment, over the scene's own link.
    `laws`: those to be compared in place of the file's, by name or FILE.py. Raises `Refused`.
    """
    path = Path(path)
    file = _scene_alone(str(path)) if str(path) in known_scenes() else read_toml(
        path, f"the comparison {path}", "a file of TOML with [[link]] and [[environment]] tables, the name of a scene, "
        "or none for the built-in comparison")
    where = path.name
    check_keys(file, TOP, where)
    if laws is not None:
        file = {key: value for key, value in file.items() if key not in ("laws", "law")} | {"laws": list(laws)}
    parts = {key: _items(file, key, where, str(path.resolve().parent)) for key in ("law", "link", "environment")}
    listed = _laws(file.get("laws"), where) if "laws" in file or not parts["law"] else ()
    for key in ("link", "environment"):
        if not parts[key]:
            raise Refused(f"{where} has no {key}; write [[{key}]] and below it name = \"...\" and "
                          f"{_SUBJECT[key]} = \"{_EXAMPLE[key]}\"")
    fitted = file.get("fitted", True)
    if not isinstance(fitted, bool):
        raise Refused(f"{where}: fitted is true or false, not {fitted!r}; write fitted = true")
    comparison = Comparison(
        name=path.stem, laws=_distinct((*listed, *parts["law"]), "law", where), links=parts["link"],
        environments=parts["environment"], seeds=_seeds(file.get("seeds", 1), where), fitted=fitted,
        tune=_tuned_in(file.get("tune"), [each.name for each in parts["environment"]], where),
        knobs=knobs_in(file.get("set", {}), where))
    _check_knobs(comparison, where)
    return comparison


def _scene_alone(name: str) -> dict[str, Any]:
    """Tables of a file with a scene as its only environment, over its own link."""
    link = load_scene(name).link
    text = "delay(0.0)" if link is None else import_bundled("channel.link").describe(link)
    return {"link": [{"name": "own", "link": text}], "environment": [{"name": name[:LONGEST], "scene": name}]}


def _tuned_in(value: object, environments: Sequence[str], where: str) -> str:
    """The environment to tune in."""
    if value is None:
        return environments[0]
    if value not in environments:
        raise Refused(f"{where}: tune names an environment of this file, not {value!r}; "
                      f"{nearest(str(value), environments)}")
    return str(value)


def _items(file: Mapping[str, Any], key: str, where: str, folder: str) -> tuple[ComparedItem, ...]:
    """The tables [[key]], each checked."""
    tables = file.get(key, [])
    if not is_tables(tables):
        raise Refused(f"{where}: {key} is a list of tables; begin each with [[{key}]]")
    items = []
    for i, table in enumerate(tables, 1):
        at = f"[[{key}]] {i} of {where}" + (f" ({table['name']})" if isinstance(table.get("name"), str) else "")
        check_keys(table, ("name", _SUBJECT[key], "set"), at)
        if _SUBJECT[key] not in table:
            raise Refused(f"{at} has no {_SUBJECT[key]}; write {_SUBJECT[key]} = \"{_EXAMPLE[key]}\"")
        text = text_of(table[_SUBJECT[key]], _SUBJECT[key], at)
        name = text_of(table.get("name", text), "name", at)
        if key == "link":
            text = text.replace("{folder}", folder)
        knobs = knobs_in(table.get("set", {}), at)
        if key == "law":
            knobs = {name if name.startswith("law.") else f"law.{name}": value for name, value in knobs.items()}
        items.append(ComparedItem(name=_label(name, at), text=text, knobs=knobs))
    return _distinct(tuple(items), key, where)


def _laws(names: object, where: str) -> tuple[ComparedItem, ...]:
    """The laws of a list of names; without a list every one with two ends."""
    if names is None:
        return tuple(ComparedItem(name=name, text=name, knobs={}) for name in two_port_laws())
    if not isinstance(names, list) or not names:
        raise Refused(f"{where}: laws is a list of at least one law, not {names!r}; write laws = [\"wave\"], or leave "
                      "it out for every law with two ends")
    texts = [text_of(each, "laws", where) for each in names]
    return tuple(ComparedItem(name=_label(_short(text), where), text=text, knobs={}) for text in texts)


def _short(law: str) -> str:
    """Name of a law that the file does not name: its file's name, or its text, a long one without numbers."""
    if law.endswith(".py") and "|" not in law:
        return Path(law).stem
    return law if len(law) <= LONGEST else sub(r"\([^()]*\)", "", law)


def _distinct(items: tuple[ComparedItem, ...], key: str, where: str) -> tuple[ComparedItem, ...]:
    twice = repeated([item.name for item in items])
    if twice is not None:
        raise Refused(f"{where} has two {key}s called {twice!r}; write another name into one of them, for example "
                      f"name = \"{twice} 2\"")
    return items


def _check_knobs(comparison: Comparison, where: str) -> None:
    """Refuse knobs that have a table of their own, and those that two tables set for the same row."""
    groups = {"law": comparison.laws, "link": comparison.links, "environment": comparison.environments}
    owners: dict[str, tuple[str, str]] = {}
    for key, name, knobs in [("file", "set at the top", comparison.knobs), *[
            (key, f"{key} {item.name!r}", item.knobs) for key, items in groups.items() for item in items]]:
        for knob in knobs:
            if knob in ("law", "link"):
                raise Refused(f"{where}: {name} sets {knob}, which has tables of its own; write it as [[{knob}]]")
            if knob in owners and owners[knob][0] != key:
                raise Refused(f"{where}: {owners[knob][1]} and {name} both set {knob}; leave one of them out")
            owners.setdefault(knob, (key, name))


def _label(name: str, where: str) -> str:
    if not fullmatch(r"[\w%+./()|,= -]{1,24}", name):
        raise Refused(f"{where}: a name has 1 to 24 letters, digits, spaces and %+-_./()|,=, not {name!r}; write for "
                      "example name = \"50 ms\"")
    return name


def _seeds(value: object, where: str) -> tuple[int, ...]:
    """The seeds: a number of them from 0 on, or a list."""
    if isinstance(value, list):
        if not value:
            raise Refused(f"{where}: seeds is empty; write seeds = 3, or a list of at least one")
        seeds = tuple(whole_number(f"{where}: seeds", each, low=0, high=2**53) for each in value)
        twice = repeated(seeds)
        if twice is not None:
            raise Refused(f"{where}: seeds names {twice} twice; write each seed once")
        return seeds
    return tuple(range(whole_number(f"{where}: seeds", value, low=1, high=MOST_SEEDS)))


@dataclass(frozen=True, kw_only=True, slots=True)
class Case:
    """A law over a link in an environment, ready to be run by its texts alone."""

    law: str
    link: str
    environment: str
    scene: str  # its name or FILE.py
    knobs: Mapping[str, object]  # as `load_scene` takes them
    seeds: tuple[int, ...]
    conditions: tuple[str, ...]  # conditions of the law that link and bodies break, one sentence each
    units: tuple[str, ...]  # of its axes, m or rad
    source: str  # a digest of the law's file, of one that is not built in; else empty

    def command(self, seed: int) -> str:
        """Command that runs one of its rows by itself."""
        words = ["teleop", "run", self.scene]
        for name, value in self.knobs.items():
            words += ["--link", str(value)] if name == "link" else ["--set", f"{name}={_option_text(value)}"]
        return " ".join(map(quote, [*words, "--seed", str(seed)]))


def cases_of(comparison: Comparison, where: str, tuned: Tuned | None = None) -> list[Case]:
    """Every case of a comparison, in the order law, environment, link.

    `tuned`: parameters that a search found; None: each law has the parameters of the file, fitted. `where` names the
    file in sentences. Raises `Refused`, naming the tables, for a case that makes no scene.
    """
    plans: dict[tuple[str, str], tuple[LinkPlans, bool]] = {}
    return [_case(comparison, where, law, environment, link, plans, tuned)
            for law in comparison.laws for environment in comparison.environments for link in comparison.links]


def _case(comparison: Comparison, where: str, law: ComparedItem, environment: ComparedItem, link: ComparedItem,
          known_plans: dict[tuple[str, str], tuple[LinkPlans, bool]], tuned: Tuned | None) -> Case:
    knobs = {**comparison.knobs, **environment.knobs, **link.knobs, "law": law.text, **law.knobs, "link": link.text}
    try:  # one law has the same numbers in all environments, also in that whose own law it is
        knobs["law"] = law_with_its_numbers(law.text, scene_function(environment.text))
        scene = load_scene(environment.text, **knobs)
    except Refused as refused:
        raise Refused(f"{where}: {refused} (law {law.name!r}, link {link.name!r}, environment "
                      f"{environment.name!r})") from None
    if scene.slave is None:
        raise Refused(f"{where}: environment {environment.name!r} has no slave, so no law with two ends; take another "
                      "scene, for example scene = \"hard_wall\"")
    key = environment.name, link.name
    plans, dice = known_plans.get(key) or known_plans.setdefault(key, _plans(scene, comparison.seeds))
    played = of_plans(scene, plans, scene.ticks)
    if tuned is not None:
        knobs |= tuned[law.name, link.name]
        scene = load_scene(environment.text, **knobs)
    elif comparison.fitted and hasattr(scene.laws[0], "fitted"):
        laws = tuple([each.fitted(facts(scene, i, *played)) for i, each in enumerate(scene.laws)])
        knobs |= _changed_knobs(scene.laws, laws)
        scene = replace(scene, law=laws if isinstance(scene.law, tuple) else laws[0])
    first: Any = scene.laws[0]
    file = None if is_built_in(first) else own_file(type(first))
    return Case(law=law.name, link=link.name, environment=environment.name, scene=environment.text, knobs=knobs,
                seeds=comparison.seeds if dice else comparison.seeds[:1], conditions=tuple(law_notes(scene, *played)),
                units=scene.axis_units, source="" if file is None else file.digest)


def _plans(scene: Scene, seeds: tuple[int, ...]) -> tuple[LinkPlans, bool]:
    """Plans of the link with the first seed; and True if another seed plays anything else."""
    plans = link_plans(scene, seeds[0])
    return plans, any(_play_times(link_plans(scene, seed)) != _play_times(plans) for seed in seeds[1:])


def _play_times(plans: LinkPlans) -> list[bytes]:
    return [b"" if plan is None else plan.played_at.tobytes() for plan in plans]


def _changed_knobs(laws: tuple[Any, ...], fitted: tuple[Any, ...]) -> dict[str, object]:
    """The parameters in which fitted laws of the axes differ, as knobs: a number, or where axes differ one for each."""
    if not is_dataclass(laws[0]):
        return {}
    changed: dict[str, object] = {}
    for name in [field.name for field in fields(laws[0]) if field.init]:
        was, now = [[float(getattr(law, name)) for law in each] for each in (laws, fitted)]
        if was != now:
            changed[f"law.{name}"] = now[0] if len(set(now)) == 1 else tuple(now)
    return changed


def _option_text(value: object) -> str:
    """A knob's value as --set reads it back to the same bits."""
    if isinstance(value, tuple):
        return ",".join(map(_option_text, value))
    return "none" if value is None else str(value).lower() if isinstance(value, bool) else str(value)


def path_text(path: Path | str) -> str:
    """A path as messages print it; a file of this package by its name."""
    return Path(path).name if ROOT in Path(path).resolve().parents else str(path)
