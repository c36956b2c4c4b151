"""Completion of what is typed, by argcomplete (extra `completion`), in bash, zsh and fish.

`teleop completion SHELL` prints a few lines for the shell. At a key press the shell runs `teleop` itself, which offers
what its own parser takes: commands, options, scenes, laws, their knobs and what may follow, plug-ins included. A scene
or a law in a file of the user's own is completed by its path; for its knobs the file would have to run.
"""

from __future__ import annotations

import os
from argparse import Action, ArgumentParser, Namespace
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from teleop.errors import Refused
from teleop.scene.catalogue import find, names
from teleop.scene.knobs import COMMON
from teleop.terminal.listing import PLAYOUTS, TABLES, meaning_of
from teleop.terminal.options import FORMATS, commands_of

if TYPE_CHECKING:
    from teleop.knob import Declared
    from teleop.terminal.answer import Answer

Words = Mapping[str, str]  # each with its meaning

FOLDERS = {
    "bash": "~/.local/share/bash-completion/completions/teleop",
    "zsh": "~/.teleop.zsh, sourced by ~/.zshrc behind compinit",
    "fish": "~/.config/fish/completions/teleop.fish",
}
ENGINES = {"plain": "in Python", "c": "by the C compiler, a row at a time", "vector": "by it, several rows at once"}


def command(args: Namespace) -> Answer:
    """The command `teleop completion`. Raises `Refused` without the extra."""
    from teleop.terminal.answer import Answer

    try:
        from argcomplete.shell_integration import shellcode
    except ImportError:
        raise Refused("the completion needs argcomplete; install it with: pip install 'bilateral-teleop[completion]'"
                      ) from None
    text = f"# To have it, write this into {FOLDERS[args.shell]}\n{shellcode(['teleop'], shell=args.shell)}"
    text = f"#compdef teleop\n{text}" if args.shell == "zsh" else text
    return Answer(text.rstrip("\n"), {"shell": args.shell, "script": text})


def complete(parser: ArgumentParser) -> None:
    """Answer a shell that asks for completions of the command line in its environment; then the process ends."""
    from argcomplete.completers import SuppressCompleter
    from argcomplete.finders import CompletionFinder

    commands = commands_of(parser)
    actions = {f"{name} {action}": each for name, of in commands.items() for action, each in commands_of(of).items()}
    for name, each in {**commands, **actions}.items():
        for action in each._actions:
            if (words := completer_of(name, action)) is not None:
                action.completer = words  # type: ignore[attr-defined]  # where argcomplete looks
    CompletionFinder()(parser, always_complete_options="long", default_completer=SuppressCompleter())


def completer_of(command: str, action: Action) -> Callable[..., Words] | None:
    """Completer of an argument, by its option or its metavar; None where any text, or a file, may stand."""
    metavar = str(action.metavar)
    for key in (f"{command} {metavar}", *action.option_strings, metavar):
        if key in COMPLETERS:
            return COMPLETERS[key]
    return None


def one_of(words: Callable[[], Words]) -> Callable[..., Words]:
    """Completer of one word of these."""
    return lambda **_: words()


def several_of(words: Callable[[], Words]) -> Callable[..., Words]:
    """Completer of words that commas join."""

    def offer(prefix: str, **_: Any) -> Words:
        before = prefix[:prefix.rfind(",") + 1]
        return {before + word: meaning for word, meaning in words().items()}

    return offer


def knobs(parsed_args: Namespace, **_: Any) -> dict[str, Declared]:
    """The knobs of the scene that was typed, of its law, and those of every scene."""
    scene = getattr(parsed_args, "scene", None) or ""
    of_scene = dict(_knobs_of("scene", scene))
    typed = [text.partition("=")[2] for text in getattr(parsed_args, "set", None) or () if text.startswith("law=")]
    law = typed[-1] if typed else _law_name(of_scene["law"].default) if "law" in of_scene else ""
    of_law = {f"law.{name}": one for name, one in _knobs_of("law", law).items()}
    return {**of_scene, **COMMON, **of_law}


def settings(prefix: str, parsed_args: Namespace, **_: Any) -> Words:
    """Completer of NAME=VALUE, and of KNOB=VALUES."""
    name, equals, _value = prefix.partition("=")
    if not equals:
        return {f"{knob}=": _meaning(one) for knob, one in knobs(parsed_args).items()}
    values: Words
    if name == "law":
        values = names()["laws"]
    elif name == "playout":
        values = _playouts()
    else:
        declared = knobs(parsed_args).get(name)
        values = dict.fromkeys(declared.knob.choices or (), "") if declared is not None else {}
    before = prefix[:max(prefix.rfind(","), len(name)) + 1]
    return {before + value: meaning for value, meaning in values.items()}


def knob_names(parsed_args: Namespace, **_: Any) -> Words:
    """Completer of KNOB."""
    return {name: _meaning(one) for name, one in knobs(parsed_args).items()}


def files(prefix: str, **_: Any) -> Words:
    """Completer of FILE: files and folders, hidden ones by their dot."""
    name = prefix.rpartition("/")[2]
    typed = prefix.removesuffix(name)  # argcomplete's own completer would start a bash, which not every machine has
    with suppress(OSError, RuntimeError):  # no such folder, or no such user
        entries = sorted(Path(typed or ".").expanduser().iterdir())
        return {f"{typed}{each.name}{'/' * each.is_dir()}": "" for each in entries
                if each.name.startswith(name) and (name or not each.name.startswith("."))}
    return {}


def scenes(prefix: str, **_: Any) -> Words:
    """Completer of SCENE: known ones, and files."""
    return {**files(prefix), **names()["scenes"]}


def runs(prefix: str, **_: Any) -> Words:
    """Completer of a folder: those in `runs`, and others where none of these fits."""
    known = [str(each) for each in sorted(Path("runs").glob("*")) if each.is_dir()]
    fitting = [each for each in known if each.startswith(prefix)]
    return dict.fromkeys(fitting or [each for each in files(prefix) if each.endswith("/")], "")


def _names_of(kind: str) -> Callable[[], Words]:
    return lambda: names()[kind]


def _everything() -> Words:
    return {**{kind: f"all {kind}" for kind in TABLES}, **{
        name: meaning for kind in names().values() for name, meaning in kind.items()}}


def _playouts() -> Words:
    return {name: plays for name, plays, _ in PLAYOUTS if name.islower()}


def _devices(ends: str) -> Callable[[], Words]:
    from teleop.naming import known_devices
    from teleop.scene.catalogue import device_line

    return lambda: {name: device_line(e, name, place) for e in ends for name, place in known_devices(e).items()}


def _metrics() -> Words:
    from teleop.simulation.metrics import METRICS

    return {name: f"{one.unit}, {one.meaning}" for name, one in METRICS.items()}


def _methods() -> Words:
    from teleop.simulation.integrators.methods import METHODS

    return {f"{one.name}:": one.label for one in METHODS}


def _objectives() -> Words:
    from teleop.studies.tune.objective import OBJECTIVES

    return dict.fromkeys(OBJECTIVES, "")


def _pictures() -> Words:
    from teleop.sweeps.pictures.picture import KINDS

    return dict.fromkeys(KINDS, "")


def _publications() -> Words:
    from teleop.studies.reproduce import PUBLICATIONS

    return dict.fromkeys(PUBLICATIONS, "")


COMPLETERS: dict[str, Callable[..., Words]] = {
    "SCENE": scenes, "LAW": one_of(_names_of("laws")), "NAME=VALUE": settings, "KNOB=VALUES": settings,
    "KNOB": knob_names, "FILE": files, "PLAN": files, "STUDY": runs,
    "DIR": runs, "FOLDER": runs, "RUN": runs, "SLAVE": runs,
    "METHOD:N": one_of(_methods), "FORMATS": several_of(lambda: dict.fromkeys(FORMATS, "")),
    "--laws": several_of(_names_of("laws")), "--metrics": several_of(_metrics), "--metric": several_of(_metrics),
    "--playouts": several_of(_playouts),
    "--engine": one_of(lambda: ENGINES), "--objective": one_of(_objectives), "--picture": one_of(_pictures),
    "list NAME": one_of(_everything), "--device": one_of(_devices("m")), "--robot": one_of(_devices("s")),
    "check NAME": one_of(_devices("ms")), "reproduce NAME": one_of(_publications),
}
"""Completers by an argument's option or metavar, and of one command alone by "COMMAND ARGUMENT"."""


def _knobs_of(kind: str, name: str) -> Mapping[str, Declared]:
    """The knobs of a scene or a law; none of one in a file, or of a plug-in that cannot be loaded."""
    if not name or os.sep in name or name.endswith(".py"):
        return {}
    with suppress(Exception):  # a plug-in is somebody else's code, and the rest is as good without it
        return next((one.knobs for one in find(name) if one.kind == kind), {})
    return {}


def _law_name(law: object) -> str:
    from teleop.law import law_name

    return law if isinstance(law, str) else law_name(law)


def _meaning(one: Declared) -> str:
    return ", ".join(part for part in (one.knob.unit, meaning_of(one)) if part)
