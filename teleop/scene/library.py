"""Library of scenes: those shipped beside this package, those of plug-ins, those at a path.

A file of the user's own, with a scene or a law, imports `master`, `slave` and `channel`, and modules that lie beside
it. Two finders on `sys.meta_path` make that possible without a change of `sys.path`. The first one finds the packages
of this distribution beside `teleop`, so that a folder `scenarios` or a file `master.py` where the command is typed
shadows nothing. The last one finds the modules beside the user's own files that were loaded, after all that is
installed.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Sequence
from functools import lru_cache
from importlib import import_module
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import module_from_spec, spec_from_file_location
from os import stat
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.errors import Refused, enumerated, nearest
from teleop.law import innermost
from teleop.naming import find, known_places
from teleop.scene.parts import SHAPES
from teleop.storage.files import read_bytes

if TYPE_CHECKING:
    from teleop.scene.scene import Scene


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
    from hashlib import sha256  # which loads OpenSSL

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
    try:
        tree = ast.parse(read_bytes(path))
    except (OSError, SyntaxError, ValueError, RecursionError):
        return set()
    whole = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    parts = {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and not node.level}
    return {name.partition(".")[0] for name in whole | parts}


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
