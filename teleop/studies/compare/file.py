"""The file of a comparison: which laws meet which links and environments. TOML; every key is checked.

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

Each law meets each link in each environment. Where two tables set the same knob, the file is refused.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from re import fullmatch, sub
from typing import Any

from teleop.errors import Refused, nearest, whole_number
from teleop.law import find_law, known_laws
from teleop.scene.library import ROOT, import_bundled, known_scenes
from teleop.scene.loading import load_scene
from teleop.storage.files import read_bytes
from teleop.sweeps.matrix_file import flat_knobs

BUILT_IN = ROOT / "scenarios" / "compare.toml"
TOP = ("seeds", "laws", "fitted", "tune", "set", "law", "link", "environment")
MOST_SEEDS = 1000
LONGEST = 24  # characters of a name
_HELD = {"law": "law", "link": "link", "environment": "scene"}  # of each table, the key that says what it is
_EXAMPLE = {"law": "wave", "link": "delay(0.05)", "environment": "hard_wall"}


@dataclass(frozen=True, kw_only=True, slots=True)
class Part:
    """One law, link or environment: its name in tables and figures, the text that says what it is, and its knobs."""

    name: str
    text: str
    knobs: Mapping[str, object]


@dataclass(frozen=True, kw_only=True, slots=True)
class Comparison:
    """What a file asks for. `read_comparison` makes and checks it."""

    name: str  # of the file, without its ending
    laws: tuple[Part, ...]
    links: tuple[Part, ...]
    environments: tuple[Part, ...]
    seeds: tuple[int, ...]
    fitted: bool
    tune: str  # the environment in which laws are tuned
    knobs: Mapping[str, object]  # of every row


def two_port_laws() -> list[str]:
    """Names of every installed law with two ends, in order of the alphabet. Plug-ins are imported."""
    return sorted(name for name in known_laws() if hasattr(find_law(name), "slave"))


def read_comparison(path: Path | str = BUILT_IN, laws: Sequence[str] | None = None) -> Comparison:
    """The comparison of a file, its keys and values checked; its scenes are not made yet.

    The name of an installed scene stands for a file with that scene as its environment, over the scene's own link.
    `laws`: those to be compared in place of the file's, by name or FILE.py. Raises `Refused`.
    """
    import tomllib

    path = Path(path)
    try:
        held = _of_scene(str(path)) if str(path) in known_scenes() else tomllib.loads(read_bytes(path).decode())
    except (OSError, ValueError, RecursionError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise Refused(f"the comparison {path} cannot be read ({why}); give a file of TOML with [[link]] and "
                      "[[environment]] tables, the name of a scene, or none for the built-in comparison") from None
    where = path.name
    _known(held, TOP, where)
    if laws is not None:
        held = {key: value for key, value in held.items() if key not in ("laws", "law")} | {"laws": list(laws)}
    parts = {key: _parts(held, key, where, str(path.resolve().parent)) for key in ("law", "link", "environment")}
    own = _laws(held.get("laws"), where) if "laws" in held or not parts["law"] else ()
    for key in ("link", "environment"):
        if not parts[key]:
            raise Refused(f"{where} has no {key}; write [[{key}]] and below it name = \"...\" and "
                          f"{_HELD[key]} = \"{_EXAMPLE[key]}\"")
    fitted = held.get("fitted", True)
    if not isinstance(fitted, bool):
        raise Refused(f"{where}: fitted is true or false, not {fitted!r}; write fitted = true")
    found = Comparison(name=path.stem, laws=_once((*own, *parts["law"]), "law", where), links=parts["link"],
                       environments=parts["environment"], seeds=_seeds(held.get("seeds", 1), where), fitted=fitted,
                       tune=_place(held.get("tune"), [each.name for each in parts["environment"]], where),
                       knobs=_knobs(held.get("set", {}), where))
    _check_knobs(found, where)
    return found


def _of_scene(name: str) -> dict[str, Any]:
    """What the file would hold in which a scene is the only environment, over its own link."""
    link = load_scene(name).link
    text = "delay(0.0)" if link is None else import_bundled("channel.link").describe(link)
    return {"link": [{"name": "own", "link": text}], "environment": [{"name": name[:LONGEST], "scene": name}]}


def _place(given: object, places: Sequence[str], where: str) -> str:
    """The environment to tune in."""
    if given is None:
        return places[0]
    if given not in places:
        raise Refused(f"{where}: tune names an environment of this file, not {given!r}; "
                      f"{nearest(str(given), places)}")
    return str(given)


def _known(held: Mapping[str, Any], keys: Iterable[str], where: str) -> None:
    for key in held:
        if key not in keys:
            raise Refused(f"{where} has no key {key!r}; {nearest(key, keys)}; knobs go into set = {{...}}")


def _parts(held: Mapping[str, Any], key: str, where: str, folder: str) -> tuple[Part, ...]:
    """The tables [[key]], each checked."""
    tables = held.get(key, [])
    if not isinstance(tables, list) or not all(isinstance(each, dict) for each in tables):
        raise Refused(f"{where}: {key} is a list of tables; begin each with [[{key}]]")
    found = []
    for i, table in enumerate(tables, 1):
        at = f"[[{key}]] {i} of {where}" + (f" ({table['name']})" if isinstance(table.get("name"), str) else "")
        _known(table, ("name", _HELD[key], "set"), at)
        if _HELD[key] not in table:
            raise Refused(f"{at} has no {_HELD[key]}; write {_HELD[key]} = \"{_EXAMPLE[key]}\"")
        text = _text(table[_HELD[key]], _HELD[key], at)
        name = _text(table.get("name", text), "name", at)
        if key == "link":
            text = text.replace("{folder}", folder)
        knobs = _knobs(table.get("set", {}), at)
        if key == "law":
            knobs = {name if name.startswith("law.") else f"law.{name}": value for name, value in knobs.items()}
        found.append(Part(name=_label(name, at), text=text, knobs=knobs))
    return _once(tuple(found), key, where)


def _laws(given: object, where: str) -> tuple[Part, ...]:
    """The laws of a list of names; without a list every one with two ends."""
    if given is None:
        return tuple(Part(name=name, text=name, knobs={}) for name in two_port_laws())
    if not isinstance(given, list) or not given:
        raise Refused(f"{where}: laws is a list of at least one law, not {given!r}; write laws = [\"wave\"], or leave "
                      "it out for every law with two ends")
    texts = [_text(each, "laws", where) for each in given]
    return tuple(Part(name=_label(_short(text), where), text=text, knobs={}) for text in texts)


def _short(law: str) -> str:
    """The name of a law that has none of its own: that of its file; a long one with stages goes without its numbers."""
    if law.endswith(".py") and "|" not in law:
        return Path(law).stem
    return law if len(law) <= LONGEST else sub(r"\([^()]*\)", "", law)


def _once(parts: tuple[Part, ...], key: str, where: str) -> tuple[Part, ...]:
    names = [part.name for part in parts]
    twice = next((name for i, name in enumerate(names) if name in names[:i]), None)
    if twice is not None:
        raise Refused(f"{where} has two {key}s called {twice!r}; write another name into one of them, for example "
                      f"name = \"{twice} 2\"")
    return parts


def _knobs(table: object, where: str) -> dict[str, object]:
    if not isinstance(table, dict):
        raise Refused(f"{where}: set is a table of knobs, not {table!r}; write set = {{duration = 2.0}}")
    return flat_knobs(table)


def _check_knobs(asked: Comparison, where: str) -> None:
    """Refuse knobs that have a table of their own, and those that two tables set for the same row."""
    groups = {"law": asked.laws, "link": asked.links, "environment": asked.environments}
    owners: dict[str, tuple[str, str]] = {}
    for key, name, knobs in [("file", "set at the top", asked.knobs), *[
            (key, f"{key} {part.name!r}", part.knobs) for key, parts in groups.items() for part in parts]]:
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


def _text(value: object, key: str, where: str) -> str:
    if not isinstance(value, str) or not value.strip():
        raise Refused(f"{where}: {key} is a text that is not empty, not {value!r}; write it in quotes")
    return value


def _seeds(given: object, where: str) -> tuple[int, ...]:
    """The seeds: a number of them from 0 on, or a list."""
    if isinstance(given, list):
        if not given:
            raise Refused(f"{where}: seeds is empty; write seeds = 3, or a list of at least one")
        found = tuple(whole_number(f"{where}: seeds", each, low=0, high=2**53) for each in given)
        twice = next((seed for i, seed in enumerate(found) if seed in found[:i]), None)
        if twice is not None:
            raise Refused(f"{where}: seeds names {twice} twice; write each seed once")
        return found
    return tuple(range(whole_number(f"{where}: seeds", given, low=1, high=MOST_SEEDS)))
