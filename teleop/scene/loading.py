"""Loading of scenes: by name or path, with their knobs set."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from teleop.errors import Refused, WrongNumber
from teleop.law.contract import LawMistake
from teleop.scene.scene import Scene


def load_scene(name: str, /, **knobs: object) -> Scene:
    """Make the scene `name` (built in, of a plug-in, or a path ending in .py) with its knobs set.

    `law` may be a law or a law's name; `law.FIELD` sets one of the law's own numbers; `x_limit` (m), beyond which a run
    has diverged, is a knob of every scene, and so is `link`, which takes a link
    or its text and replaces the scene's. Values may be texts, as on the command line. Raises `Refused`.

    >>> load_scene("canonical", delay=0.1).name
    'canonical'
    """
    from teleop.scene.library import scene_function

    if not isinstance(name, str):
        raise Refused(f"a scene is named by a text, not {name!r}; write for example load_scene('canonical')")
    return made_by(scene_function(name), name, knobs)


def made_by(function: Callable[..., Any], name: str, knobs: Mapping[str, object]) -> Scene:
    """Make a scene by its function, with its knobs set as `load_scene` sets them. Raises `Refused`."""
    from teleop.scene.knobs import settle

    settled, of_scene = settle(name, function, knobs)
    try:
        scene = function(**settled)
    except Refused as refused:
        raise _as_typed(refused, name, {key: settled[key] for key in knobs if key in settled}) from None
    except (Exception, SystemExit) as error:
        why = f"{type(error).__name__}: {error}"
        raise Refused(f"scene {name} stopped with {why}; mend it and run again") from error
    if not isinstance(scene, Scene):
        raise Refused(f"scene {name!r} returned {type(scene).__name__}; its function must return a teleop.Scene")
    stem = name.rsplit("/", 1)[-1].removesuffix(".py")
    shown = {key: shown for key, (shown, _) in of_scene.items()}
    parts: dict[str, Any] = {key: part for key, (_, part) in of_scene.items()}
    return _called(replace(scene, **parts) if parts else scene, stem, {**settled, **shown})


def _called(scene: Scene, name: str, knobs: Mapping[str, object]) -> Scene:
    """The same scene with a name and its knobs, without a second check of its parts."""
    called = object.__new__(Scene)
    called.__dict__.update(scene.__dict__, name=name, knobs=knobs)
    return called


def _as_typed(refused: Refused, name: str, given: Mapping[str, object]) -> Refused:
    """A part's refusal with the name of the knob that set the part: the part may have another name for it."""
    if isinstance(refused, WrongNumber) and given.get(refused.name) != refused.value:
        same = [key for key, value in given.items() if type(value) in (int, float) and value == refused.value]
        if len(same) == 1:
            return refused.called(same[0])
    if isinstance(refused, LawMistake):
        return refused
    said = str(refused).replace("=", " ").split()
    if not given or any(key in said for key in given):
        return refused
    return Refused(f"{refused} (scene {name} with {', '.join(f'{key}={value}' for key, value in given.items())})")
