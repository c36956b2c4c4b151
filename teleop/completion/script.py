"""The script of one shell: what is known of the command line, and the lines of shell that look it up.

All that may be typed is taken from the parser, the catalogue and the tables of the commands when the script is made,
and stands in it: a key press starts no Python. So a plug-in that is installed later, and the knobs of a scene or a law
in a file of one's own, are not in it; to ask for these would run that file at a key press.
"""

from __future__ import annotations

from argparse import REMAINDER, SUPPRESS, Action, ArgumentParser, _SubParsersAction
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from teleop.knob import Declared
from teleop.scene.catalogue import find, names
from teleop.scene.device_names import device_line, known_devices
from teleop.scene.wide import WIDE
from teleop.terminal.listing import PLAYOUTS, TABLES, meaning_of
from teleop.terminal.options import FORMATS

Words = Mapping[str, str]  # each with what it means

SHELLS = {"bash": "bash.sh", "zsh": "zsh.sh", "fish": "fish.fish"}
INSTALL = {  # the folders in which each shell looks by itself, at the first key press
    "bash": "d=~/.local/share/bash-completion/completions; mkdir -p $d; teleop completion bash > $d/teleop",
    "zsh": "teleop completion zsh > ~/.teleop.zsh; echo 'source ~/.teleop.zsh' >> ~/.zshrc, behind compinit",
    "fish": "teleop completion fish > ~/.config/fish/completions/teleop.fish",
}

# What the value of an argument is, by its option or its metavar, and of one command alone by "COMMAND ARGUMENT": a kind
# that complete.sh knows, or a list of words. What is not here, such as a number, has no words.
KINDS = {
    "SCENE": "scene", "LAW": "law", "NAME=VALUE": "set", "KNOB=VALUES": "grid", "KNOB": "knob", "DIR": "folder",
    "FOLDER": "run", "RUN": "run", "SLAVE": "run", "FILE": "file", "FORMATS": "formats", "METHOD:N": "bodies",
    "--laws": "laws", "--metrics": "metrics", "--metric": "metrics", "--playouts": "playouts", "--engine": "engines",
    "--objective": "objectives", "--picture": "pictures", "list NAME": "names",
    "--device": "devices", "--robot": "robots", "check NAME": "either", "reproduce NAME": "publications",
}
ENGINES = {"plain": "in Python", "scalar": "compiled, a row at a time", "vector": "compiled, rows side by side"}


def script(shell: str, parser: ArgumentParser) -> str:
    """The script for `shell`, one of `SHELLS`, of the command line of `parser`."""
    at = Path(__file__).parent
    head = "".join(f"# {line}\n" for line in (f"Completion of teleop in {shell}, by `teleop completion {shell}`.",
                                             f"To have it: {INSTALL[shell]}", "Again after an upgrade."))
    core = (at / "complete.sh").read_text() + "".join(_tables(parser))
    own_knobs = (at / SHELLS[shell]).read_text()
    if shell == "fish":
        escaped = core.replace("\\", "\\\\").replace("'", "\\'")
        return f"{head}set -g __teleop_core '{escaped}'\n{own_knobs}"
    return f"{'#compdef teleop' + chr(10) if shell == 'zsh' else ''}{head}{core}{own_knobs}"


def commands_of(parser: ArgumentParser) -> dict[str, ArgumentParser]:
    """The commands of a parser by their names, each with its own parser."""
    return next((dict(each.choices) for each in parser._actions if isinstance(each, _SubParsersAction)), {})


def kind_of(command: str, action: Action) -> str:
    """Kind of the value of an argument; empty where it takes none, or none that is known."""
    if action.nargs == 0 or (action.option_strings and action.nargs == "?"):  # the second may stand alone
        return ""
    if action.choices is not None:
        return "one-of " + " ".join(map(str, action.choices))
    metavar = str(action.metavar)
    known = (f"{command} {metavar}", *action.option_strings, metavar)
    return next((KINDS[each] for each in known if each in KINDS), "")


def _tables(parser: ArgumentParser) -> Iterator[str]:
    """The functions of shell that say what is known: defaults, options and places of commands, words of each kind."""
    commands = commands_of(parser)
    texts = {"commands": {name: each.description or "" for name, each in commands.items()},
             "options ": _options(parser)}
    takes: dict[str, tuple[str, str]] = {}
    places: dict[str, str] = {}
    defaults: dict[str, str] = {}
    for name, each in commands.items():
        texts[f"options {name}"] = _options(each)
        position = 0
        for action in each._actions:
            kind = kind_of(name, action)
            if kind.startswith("one-of "):
                texts[kind] = dict.fromkeys(kind.split()[1:], "")
            if not action.option_strings:
                position += 1
                places[f"{name} {position}"] = kind
            elif kind or action.nargs is None:
                takes |= {f"{name} {option}": (kind or "none", "more" if action.nargs == "+" else "")
                          for option in action.option_strings}
            if kind == "scene" and action.default:
                defaults[name] = str(action.default)
    texts |= _words()
    scenes, laws = names()["scenes"], names()["laws"]
    law_of = {}
    for scene in scenes:
        knobs = _look_up("scene", scene)
        texts[f"scene {scene}"] = {name: _meant(one) for name, one in {**knobs, **WIDE}.items()}
        texts |= _values(knobs)
        if "law" in knobs:
            law_of[scene] = _name_of(knobs["law"].default)
    texts |= _values(WIDE)
    texts |= {f"law {law}": {f"law.{knob}": _meant(one) for knob, one in _look_up("law", law).items()} for law in laws}
    yield _function("_teleop_option", takes, lambda value: f"_want={_quoted(value[0])} _many={value[1]}", '"$1 $2"',
                    otherwise="_want= _many=")
    yield _function("_teleop_place", places, lambda kind: f"_want={_quoted(kind)}", '"$1 $2"', otherwise="_want=")
    yield _function("_teleop_default", defaults, lambda scene: f"_scene={_quoted(scene)}", '"$1"')
    yield _function("_teleop_law", law_of, lambda law: f"_law={_quoted(law)}", '"$1"')
    yield _function("_teleop_data", texts, lambda words: "_teleop_say" + "".join(
        f" {_quoted(word)} {_quoted(what)}" for word, what in words.items()), '"$1"',
        otherwise=f"case $1 in 'scene '*) _teleop_data {_quoted('scene of a file')} ;; esac")


def _words() -> dict[str, Words]:
    """The words of each kind that are the same for every command."""
    from teleop.simulation.integrators.methods import METHODS
    from teleop.simulation.metrics import METRICS
    from teleop.studies.reproduce import PUBLICATIONS
    from teleop.studies.tune.objective import OBJECTIVES
    from teleop.sweeps.pictures.picture import KINDS as PICTURES

    known = names()
    playouts = {name: plays for name, plays, _ in PLAYOUTS if name.islower()}
    devices, robots = ({name: device_line(e, name, place) for name, place in known_devices(e).items()} for e in "ms")
    everything = {name: meaning for kind in known.values() for name, meaning in kind.items()}
    return {
        "scene": known["scenes"], "law": known["laws"], "laws": known["laws"],
        "names": {**{kind: f"all {kind}" for kind in TABLES}, **everything},
        "metrics": {name: f"{one.unit}, {one.meaning}" for name, one in METRICS.items()},
        "playouts": playouts, "value playout": playouts, "engines": ENGINES, "formats": dict.fromkeys(FORMATS, ""),
        "objectives": dict.fromkeys(OBJECTIVES, ""), "pictures": dict.fromkeys(PICTURES, ""),
        "devices": devices, "robots": robots, "either": devices | robots,
        "publications": dict.fromkeys(PUBLICATIONS, ""),
        "bodies": {f"{one.name}:": one.label for one in METHODS},
        "scene of a file": {name: _meant(one) for name, one in WIDE.items()},
    }


def _options(parser: ArgumentParser) -> Words:
    return {option: _sentence(action.help) for action in parser._actions for option in action.option_strings
            if option.startswith("--") and action.help != SUPPRESS and action.nargs != REMAINDER}


def _look_up(kind: str, name: str) -> Mapping[str, Declared]:
    """The knobs of a scene or a law; none of one of a plug-in that cannot be loaded."""
    try:
        return next((one.knobs for one in find(name) if one.kind == kind), {})
    except Exception:  # it is somebody else's code, and the script is as good without it
        return {}


def _values(knobs: Mapping[str, Declared]) -> dict[str, Words]:
    """The choices of the knobs that have some."""
    return {f"value {name}": dict.fromkeys(one.knob.choices, "") for name, one in knobs.items() if one.knob.choices}


def _name_of(law: object) -> str:
    from teleop.law import law_name

    return law if isinstance(law, str) else law_name(law)


def _meant(one: Declared) -> str:
    return ", ".join(part for part in (one.knob.unit, meaning_of(one)) if part)


def _sentence(text: str | None) -> str:
    """The first part of what is said of something."""
    return (text or "").partition(";")[0]


def _function(name: str, table: Mapping[str, Any], body: Callable[[Any], str], key: str, otherwise: str = ":") -> str:
    """A function of shell that does what `body` makes of the entry of `table` under `key`."""
    lines = "".join(f"        {_quoted(each)}) {body(entry)} ;;\n" for each, entry in table.items())
    return f"{name}() {{\n    case {key} in\n{lines}        *) {otherwise} ;;\n    esac\n}}\n"


def _quoted(text: str) -> str:
    """The text as one word of POSIX sh, on one line."""
    return "'" + text.replace("\n", " ").replace("\t", " ").replace("'", "'\\''") + "'"
