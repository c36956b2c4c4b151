"""Library of scenes: those shipped beside this package, those of plug-ins, those at a path.

A file of the user's own, with a scene or a law, imports `master`, `slave` and `channel`, and modules that lie beside
it. Two finders on `sys.meta_path` make that possible without a change of `sys.path`. The first one finds the packages
of this distribution beside `teleop`, so that a folder `scenarios` or a file `master.py` where the command is typed
shadows nothing. The last one finds the modules beside the user's own files that were loaded, after all that is
installed.

Opening a folder of others runs no code of theirs and reads no other file. A scene that is installed may be made again
from the name and the knobs in the folder. A scene or a law in a file of its own is code, and a knob or an effect that
names a file has this machine read it: all of these only for a reader who trusts the folder.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from hashlib import sha256
from importlib import import_module
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import module_from_spec, spec_from_file_location
from os import stat
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Any, NamedTuple, get_args

from teleop.errors import Refused, WrongCount, WrongNumber, enumerated, nearest
from teleop.law import innermost
from teleop.law.contract import LawMistake
from teleop.naming import find, known_places
from teleop.scene.parts import SHAPES
from teleop.scene.scene import Scene
from teleop.storage.files import read_bytes

if TYPE_CHECKING:
    from teleop.knob import Declared


GROUP = "teleop.scenes"  # of entry points
PACKAGES = ("master", "slave", "channel", "scenarios")  # of this distribution, beside teleop
ROOT = Path(__file__).resolve().parents[2]  # holds teleop and PACKAGES
OWN = "teleop_file_"  # begins the names of the modules of the user's own files
_FOLDERS: list[str] = []  # of the user's own files that were loaded, the newest first
_LOADED: dict[str, OwnFile] = {}  # by the name of the module


class BundledFinder:
    """Finder of the packages of this distribution, whatever lies in the current folder."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None = None, target: Any = None) -> ModuleSpec | None:
        """The package `name` beside `teleop`; none for any other module."""
        return PathFinder.find_spec(name, [str(ROOT)], target) if path is None and name in PACKAGES else None


class OwnFolderFinder:
    """Finder of the modules that lie beside the user's own files that were loaded."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None = None, target: Any = None) -> ModuleSpec | None:
        """The module `name` in the folder of the newest file that has one."""
        return PathFinder.find_spec(name, _FOLDERS, target) if path is None and _FOLDERS else None


def import_bundled(module: str) -> Any:
    """Import a module of this distribution, whatever lies in the current folder.

    Raises `Refused` if its package has been imported from elsewhere.
    """
    prefer_bundled()
    return import_module(module)


def prefer_bundled() -> None:
    """Make later imports find the packages of this distribution, without importing them now.

    Raises `Refused` if one of them has been imported from elsewhere.
    """
    if BundledFinder not in sys.meta_path:
        sys.meta_path.insert(0, BundledFinder)
        sys.meta_path.append(OwnFolderFinder)
    for package in PACKAGES:
        if package in sys.modules:
            origin = getattr(sys.modules[package], "__file__", None) or ""
            if ROOT not in Path(origin).resolve().parents:
                raise Refused(f"the package {package!r} was taken from {origin or 'elsewhere'}, not from beside "
                              "teleop; rename that one, or run from another folder")


def scene_folders() -> list[str]:
    """Folders of the user's own files that were loaded, the newest first: another process finds modules there too."""
    return list(_FOLDERS)


def built_in_scenes() -> list[str]:
    """Names of the scenes that come with this package."""
    return sorted(p.stem for p in (ROOT / "scenarios").glob("*.py") if not p.stem.startswith("_"))


def known_scenes() -> list[str]:
    """Names of all scenes, built in and of plug-ins; none is imported."""
    return sorted({*built_in_scenes(), *known_places(GROUP, {})})


def scene_function(name: str) -> Callable[..., Scene]:
    """Function of the scene with this name or path; its keyword parameters are the knobs.

    Raises `Refused` for an unknown name, and for a file that cannot be loaded or has no function `scene`.
    """
    prefer_bundled()  # the hands, robots and effects that a scene imports must be ours too
    if name.endswith(".py"):
        named = ", ".join(built_in_scenes())
        module = own_module(Path(name), "a scene", f"a scene is named ({named}) or a path to a .py file")
    else:
        module = find("scene", GROUP, {stem: f"scenarios.{stem}" for stem in built_in_scenes()}, name)
    function = getattr(module, "scene", None)
    if not callable(function):
        raise Refused(f"{name} has no function called `scene`; write `def scene(*, k_e: float = 1e3) -> Scene:` in it")
    return function  # type: ignore[no-any-return]  # what it returns is checked when it has run


class OwnFile(NamedTuple):
    """A Python file of the user's own, as it was when it was loaded."""

    path: Path
    digest: str  # of its content: the first 12 digits of its SHA-256


def own_file(thing: type | Callable[..., Any]) -> OwnFile | None:
    """The file of the user's own that a class or a function was loaded from; None if it comes from a package.

    Of a law with stages around it that is the file of the law.
    """
    return _LOADED.get((innermost(thing) if isinstance(thing, type) else thing).__module__)


def own_module(path: Path, what: str, hint: str) -> Any:
    """Load a Python file of the user's own that has `what`, "a scene" for example.

    Raises `Refused` if it cannot be read or loaded; `hint` says how `what` is named if there is no such file.
    """
    prefer_bundled()  # the hands, robots and effects that it imports must be ours
    try:
        source = read_bytes(path)
    except FileNotFoundError:
        raise Refused(f"there is no file {path}; {hint}") from None
    except OSError as error:
        raise Refused(f"{path} cannot be read ({error.strerror or error}); give the path of a .py file with "
                      f"{what}") from None
    # One module for each content of each file: all that ask have the same law, and an edited file is another.
    content = f"{path.resolve()}\0".encode() + source
    name = f"{OWN}{path.stem}_{sha256(content).hexdigest()[:12]}"
    if name in sys.modules:
        return sys.modules[name]
    spec = spec_from_file_location(name, path)
    if spec is None or spec.origin is None:
        raise Refused(f"{path} cannot be loaded as Python")
    _let_import_from(path)
    module = sys.modules[name] = module_from_spec(spec)
    _LOADED[name] = OwnFile(Path(spec.origin), sha256(source).hexdigest()[:12])
    try:
        # What was read is what is run: Python's own loader may take the compiled code of an earlier content.
        exec(compile(source, spec.origin, "exec", dont_inherit=True), module.__dict__)
    except BaseException as error:
        del sys.modules[name], _LOADED[name]
        if isinstance(error, Refused) or not isinstance(error, Exception | SystemExit):
            raise
        raise Refused(f"{path} stopped with {type(error).__name__}: {error}; mend it and run again") from error
    return module


def beside(path: Path) -> dict[str, Path]:
    """Modules that a scene's file imports from its own folder, directly or by way of another: file by name."""
    files: dict[str, Path] = {}
    waiting = [path]
    while waiting:
        for name in sorted(_imported(waiting.pop())):
            places = (path.parent / f"{name}.py", path.parent / name / "__init__.py")
            here = next((place for place in places if place.is_file()), None)
            if here is not None and name not in files:
                files[name] = here
                waiting.append(here)
    return files


def _let_import_from(path: Path) -> None:
    """Let a scene's file import the modules beside it, as Python lets a script: now, and whenever it asks.

    All that is installed is found first; then this folder, then those of earlier scenes. Raises `Refused` if the scene
    asks for a module whose name stands for a module of another scene in this process.
    """
    folder = path.resolve().parent
    for name in beside(path):
        file = getattr(sys.modules.get(name), "__file__", None) or ""
        where = Path(file).parent.parent if file.endswith("__init__.py") else Path(file).parent
        if file and where != folder and str(where) in _FOLDERS:
            raise Refused(f"{path} imports {name}, and {file} has been imported by that name; rename one of the two, "
                          f"or run the scenes one by one")
    _FOLDERS[:] = [str(folder), *(each for each in _FOLDERS if each != str(folder))]


def _imported(path: Path) -> set[str]:
    """Top-level modules that a file imports; none if the file is no Python."""
    import ast

    try:
        tree = ast.parse(read_bytes(path))
    except (OSError, SyntaxError, ValueError, RecursionError):
        return set()
    whole = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    parts = {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and not node.level}
    return {name.partition(".")[0] for name in whole | parts}


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
        raise Refused(f"a scene is named by a text, not {name!r}; write for example load_scene('canonical')")
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


_TWO_ENDS, _ONE_PORT = SHAPES["law"][0], SHAPES["one-port law"][0]
_HINT = "law=FILE.py names a file with a law of your own, law=FILE.py:CLASS one of several in it"


def file_named(text: str) -> str:
    """The file in the text that names a law, with stages around it or numbers in brackets; empty if it names none.

    >>> file_named("law_mine.py:Mine"), file_named("law_mine.py"), file_named("wave")
    ('law_mine.py', 'law_mine.py', '')
    >>> file_named("deadband(0.1) | law_mine.py:Mine(K=3.0)")
    'law_mine.py'
    """
    if ".py" not in text:
        return ""
    from teleop.laws.around.names import law_text

    try:
        return _parted(law_text(text).law)[0]
    except Refused:  # whatever it is, it names a file
        return _parted(text)[0] or text


def file_law(text: str) -> type[Any]:
    """The class of the law that `FILE.py:CLASS` or `FILE.py` names. Raises `Refused`."""
    try:
        at = stat(file_named(text))
    except OSError:
        return _load_law(text, None)  # which says so
    return _load_law(text, (at.st_dev, at.st_ino, at.st_size, at.st_mtime_ns))


def laws_in(file: str) -> dict[str, type[Any]]:
    """The laws that a file defines, its classes with the methods of a law, by name. Raises `Refused`."""
    module = own_module(Path(file), "a law", _HINT)
    return {name: thing for name, thing in vars(module).items()
            if isinstance(thing, type) and thing.__module__ == module.__name__ and not _lacks(thing)}


@lru_cache(maxsize=64)  # a sweep asks for each row
def _load_law(text: str, _: tuple[int, ...] | None) -> type[Any]:
    file, name = _parted(text)
    laws = laws_in(file)
    if not name and len(laws) == 1:
        return next(iter(laws.values()))
    if not name and laws:
        raise Refused(f"{file} has {len(laws)} laws; write {enumerated([f'law={file}:{each}' for each in laws], 'or')}")
    if not name:
        raise Refused(f"{file} has no law: a class with the methods {enumerated(_TWO_ENDS)}, or "
                      f"{enumerated(_ONE_PORT)} where the scene has no slave; README.md has one under \"Write a law\"")
    law = getattr(own_module(Path(file), "a law", _HINT), name, None)
    if law is None:
        hint = nearest(name, laws) if laws else "it has no law"
        raise Refused(f"{file} has no class {name!r}; {hint}")
    if not isinstance(law, type) or (lacks := _lacks(law)):
        why = f"it has no {enumerated(lacks)}" if isinstance(law, type) else "it is no class"
        raise Refused(f"{name} in {file} is no law: {why}; there are: {', '.join(laws) or 'no laws'}")
    return law


def _parted(text: str) -> tuple[str, str]:
    """File and class; without a file of this name two empty texts."""
    file, _, name = text.rpartition(":")
    if file.endswith(".py"):
        return file, name
    return (text, "") if text.endswith(".py") else ("", "")


def _lacks(kind: type) -> list[str]:
    """The methods that a class has not, of those of the kind of law that it is nearer to."""
    two_ends, one_port = ([each for each in shape if not hasattr(kind, each)] for shape in (_TWO_ENDS, _ONE_PORT))
    return one_port if len(one_port) < len(_ONE_PORT) and not len(two_ends) < len(_TWO_ENDS) else two_ends


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

