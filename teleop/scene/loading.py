"""Loading of scenes: by name or path, with their knobs set, or as a stored folder names them.

Opening a folder of others runs no code of theirs and reads no other file. A scene that is installed may be made again
from the name and the knobs in the folder. A scene or a law in a file of its own is code, and a knob or an effect that
names a file has this machine read it: all of these only for a reader who trusts the folder.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Any, get_args

from teleop.errors import Refused, WrongCount, WrongNumber
from teleop.law.contract import LawMistake
from teleop.scene.library import file_named, import_bundled, known_scenes, scene_function
from teleop.scene.scene import Scene

if TYPE_CHECKING:
    from teleop.knob import Declared


def load_scene(name: str, /, **knobs: object) -> Scene:
    """Make the scene `name` (built in, of a plug-in, or a path ending in .py) with its knobs set.

    `law` may be a law, a law's name, or "FILE.py:CLASS" for one in a file; `law.FIELD` sets one of the law's own
    numbers. The name of the scene's own law keeps the scene's gains; another law, and one with brackets, "wave()", has
    its defaults. Knobs of every scene are `x_limit` (m), beyond which a run has diverged, `scale_x` and `scale_f`, the
    slave's metres and newtons for one of the master's, `link`, which takes a link or its text and replaces the
    scene's, and `hand`, the folder of a live page (or a `master.HandRecording`) whose hand the scene's moves as. Values
    may be texts, as on the command line. Raises `Refused`.

    >>> load_scene("canonical", delay=0.1).name
    'canonical'
    """
    if not isinstance(name, str):
        raise Refused(f"pass the scene's name, for example 'hard_wall', not a value of type {type(name).__name__}; "
                      "its knobs are set by their names beside it")
    return made_by(scene_function(name), name, knobs)


def live_knobs(name: str, knobs: Mapping[str, str]) -> dict[str, str]:
    """The knobs of a scene that is to run live by the clock: waves over a network are played by their integral.

    For in virtual time a scene with a constant delay, or without a link, leaves its playout out, and no network has
    one. Raises `Refused`.
    """
    scene = load_scene(name, **knobs)
    chosen = scene.playout is not None or not scene.has_waves
    return dict(knobs) if chosen else {**knobs, "playout": "integral"}


def made_by(function: Callable[..., Any], name: str, knobs: Mapping[str, object]) -> Scene:
    """Make a scene by its function, with its knobs set as `load_scene` sets them. Raises `Refused`."""
    return SceneMaker(function, name, knobs).scene({})


class SceneMaker:
    """Makes scenes by one function. The knobs that are `fixed` in all of them are read and checked once."""

    def __init__(self, function: Callable[..., Any], name: str, fixed: Mapping[str, object]) -> None:
        self._function, self._name, self._fixed = function, name, fixed
        self._stem = name.rsplit("/", 1)[-1].removesuffix(".py")
        self._settled: dict[str, object] = {}  # the function's knobs, with the values of some scene
        self._shown: dict[str, object] = {}  # the knobs of every scene that are set, as they are shown
        self._common: dict[str, Any] = {}  # and their values
        self._read: dict[str, Declared] = {}  # the knobs that may differ from those of that scene
        self._own_law: Any = None  # the law that the function has by itself
        self._laws: dict[str, Any] = {}  # by the text that names each: looked up once, in a file or a plug-in too

    def scene(self, knobs: Mapping[str, object]) -> Scene:
        """The scene with these knobs besides. Raises `Refused`."""
        from teleop.scene.knobs import read_knob, with_common

        if not self._read or self._read.keys() != knobs.keys():
            self._settle(knobs)
            settled = self._settled
        else:
            settled = self._settled.copy()
            for key, value in knobs.items():
                law = self._laws.get(value) if key == "law" and isinstance(value, str) else None
                settled[key] = read_knob(key, value, self._read[key]) if law is None else law
                if key == "law" and isinstance(value, str):
                    self._laws[value] = settled[key]
        try:
            scene = self._function(**settled)
        except Refused as refused:
            typed = {key: settled[key] for key in (*self._fixed, *knobs) if key in settled}
            raise _as_typed(refused, self._name, typed) from None
        except (Exception, SystemExit) as error:
            why = f"{type(error).__name__}: {error}"
            raise Refused(f"scene {self._name} stopped with {why}; mend it and run again") from error
        if not isinstance(scene, Scene):
            raise Refused(f"scene {self._name!r} returned {type(scene).__name__}; its function must return a "
                          "teleop.Scene")
        scene = with_common(scene, self._common) if self._common else scene
        return _with_name(scene, self._stem, {**settled, **self._shown}, self._own_law)

    def _settle(self, knobs: Mapping[str, object]) -> None:
        """Read and check all knobs; those of later scenes too may differ, where no other knob depends on them."""
        from teleop.scene.knobs import knobs_of, settle

        self._read = {}
        self._settled, of_scene = settle(self._name, self._function, {**self._fixed, **knobs})
        self._shown = {key: shown for key, (shown, _) in of_scene.items()}
        self._common = {key: value for key, (_, value) in of_scene.items()}
        known = knobs_of(self._function)
        self._own_law = known["law"].default if "law" in known and known["law"].default is not ... else None
        tuned = any(key not in known and key.startswith("law.") for key in self._fixed)
        if all(key in known and not (key == "law" and tuned) for key in knobs):
            self._read = {key: known[key] for key in knobs}


def _with_name(scene: Scene, name: str, knobs: Mapping[str, object], own_law: Any) -> Scene:
    """The same scene with a name, its knobs and its own law, without a second check of its parts."""
    called = object.__new__(Scene)
    called.__dict__.update(scene.__dict__, name=name, knobs=knobs, own_law=own_law)
    return called


def _as_typed(refused: Refused, name: str, typed: Mapping[str, object]) -> Refused:
    """A part's refusal with the name of the knob that set the part: the part may have another name for it."""
    if isinstance(refused, (WrongNumber, WrongCount)) and typed.get(refused.name) != refused.value:
        same = [key for key, value in typed.items() if type(value) in (int, float, tuple) and value == refused.value]
        if len(same) == 1:
            return refused.with_name(same[0])
    if isinstance(refused, LawMistake):
        return refused
    words = str(refused).replace("=", " ").split()
    if not typed or any(key in words for key in typed):
        return refused
    return Refused(f"{refused} (scene {name} with {', '.join(f'{key}={value}' for key, value in typed.items())})")


CURE = "if the folder and that file are your own, or you have read them, add --trust (from Python trust=True)"


def stored_scene(name: str, knobs: Mapping[str, object], *, trust: bool) -> Scene:
    """The scene that a folder names, made again. Raises `Refused`, without `trust` also as the module has it."""
    if not trust:
        check_installed(name)
        _check_no_file(name, knobs)
    return load_scene(name, **knobs)


def asks_for_trust(name: str, knobs: Mapping[str, object]) -> bool:
    """True if a folder of this scene is opened with `trust` alone."""
    try:
        check_installed(name)
        _check_no_file(name, knobs)
    except Refused:
        return True
    return False


def check_installed(name: str) -> None:
    """Refuse a scene that is not installed, neither built in nor of a plug-in."""
    if name not in known_scenes():
        raise Refused(f"the folder names the scene {name!r}, which is a file with code and none of those installed "
                      f"here, so it is not run; {CURE}")


def _check_no_file(name: str, knobs: Mapping[str, object]) -> None:
    from teleop.scene.knobs import knobs_of
    kinds = {key: get_args(declaration.kind) if isinstance(declaration.kind, UnionType) else (declaration.kind,)
             for key, declaration in knobs_of(scene_function(name)).items()}
    for key, value in knobs.items():
        if isinstance(value, str) and file_named(value):  # of a law, whatever its knob is called
            raise Refused(f"the folder's scene {name} has {key}={value[:200]}, which is a file with code, so it is not "
                          f"run; {CURE}")
        if Path in kinds.get(key, ()) or (key == "hand" and key not in kinds) or (
                key == "link" and import_bundled("channel.link").names_a_file(str(value))):
            raise Refused(f"the folder's scene {name} has {key}={str(value)[:200]}, which names a file of this "
                          f"machine, so it is not read; {CURE}")

