"""Where scenes are found: those shipped beside this package, those of plug-ins, those at a path.

Built-in scenes are loaded from the folder beside the installed `teleop` package, so that a folder
`scenarios` or a file `master.py` where the command is typed shadows nothing.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from hashlib import sha256
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import TYPE_CHECKING, Any

from teleop.errors import Refused
from teleop.naming import find, known
from teleop.storage.files import read_bytes

if TYPE_CHECKING:
    from teleop.scene.scene import Scene

GROUP = "teleop.scenes"  # of entry points
ROOT = Path(__file__).resolve().parents[2]  # holds teleop, master, slave, channel and scenarios
_FOLDERS: list[str] = []  # of the scenes' files that were loaded, the newest first: the end of sys.path


def house(module: str) -> Any:
    """Import a module of this distribution, whatever lies in the current folder."""
    top = module.partition(".")[0]
    if top not in sys.modules:
        sys.path.insert(0, str(ROOT))
        try:
            import_module(top)
        finally:
            sys.path.remove(str(ROOT))
    origin = getattr(sys.modules[top], "__file__", None) or ""
    if ROOT not in Path(origin).resolve().parents:
        raise Refused(
            f"the package {top!r} was taken from {origin or 'elsewhere'}, not from beside teleop; rename that one, "
            f"or run from another folder"
        )
    return import_module(module)


def built_in_scenes() -> list[str]:
    """The names of the scenes that come with this package."""
    return sorted(p.stem for p in (ROOT / "scenarios").glob("*.py") if not p.stem.startswith("_"))


def known_scenes() -> list[str]:
    """Every scene that can be named: built in and of plug-ins, none imported."""
    return sorted({*built_in_scenes(), *known(GROUP, {})})


def scene_function(name: str) -> Callable[..., Scene]:
    """The function behind a scene's name or path; its keyword parameters are the scene's knobs."""
    for package in ("master", "slave", "channel", "scenarios"):
        _claim(package)  # the hands, robots and effects that a scene file imports must be ours too
    if name.endswith(".py"):
        module = _from_path(Path(name))
    else:
        module = find("scene", GROUP, {stem: f"scenarios.{stem}" for stem in built_in_scenes()}, name)
    function = getattr(module, "scene", None)
    if not callable(function):
        raise Refused(f"{name} has no function called `scene`; write `def scene(*, k_e: float = 1e3) -> Scene:` in it")
    return function  # type: ignore[no-any-return]  # what it returns is checked when it has run


def _claim(package: str) -> None:
    """Make later imports of `package` find ours, without importing it now."""
    if package in sys.modules:
        house(package)
    elif str(ROOT) != (sys.path[0] if sys.path else None):
        if str(ROOT) in sys.path:
            sys.path.remove(str(ROOT))
        sys.path.insert(0, str(ROOT))


def _from_path(path: Path) -> Any:
    try:
        source = read_bytes(path)
    except FileNotFoundError:
        named = ", ".join(built_in_scenes())
        raise Refused(f"there is no file {path}; a scene is named ({named}) or a path to a .py file") from None
    except OSError as error:
        raise Refused(f"the scene {path} cannot be read ({error.strerror or error}); give the path of a .py "
                      "file") from None
    # One module for each content of each file: all that ask have the same law, and an edited file is another.
    content = f"{path.resolve()}\0".encode() + source
    name = f"teleop_scene_{path.stem}_{sha256(content).hexdigest()[:12]}"
    if name in sys.modules:
        return sys.modules[name]
    spec = spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise Refused(f"{path} cannot be loaded as Python")
    _let_import_from(path)
    module = sys.modules[name] = module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except BaseException as error:
        del sys.modules[name]
        if isinstance(error, Refused) or not isinstance(error, Exception | SystemExit):
            raise
        raise Refused(f"{path} stopped with {type(error).__name__}: {error}; mend it and run again") from error
    return module


def beside(path: Path) -> dict[str, Path]:
    """The modules that a scene's file imports from its own folder, and those that they do: name and file of each."""
    found: dict[str, Path] = {}
    waiting = [path]
    while waiting:
        for name in sorted(_imported(waiting.pop())):
            places = (path.parent / f"{name}.py", path.parent / name / "__init__.py")
            here = next((place for place in places if place.is_file()), None)
            if here is not None and name not in found:
                found[name] = here
                waiting.append(here)
    return found


def _let_import_from(path: Path) -> None:
    """Let a scene's file import what lies beside it, as Python lets a script: now, and whenever it asks.

    Behind all that is installed, which stays what it is whatever lies there; before the folders of earlier scenes.
    Raises `Refused` if the scene asks for a module of whose name this process has another scene's by now.
    """
    folder = path.resolve().parent
    for name in beside(path):
        file = getattr(sys.modules.get(name), "__file__", None) or ""
        where = Path(file).parent.parent if file.endswith("__init__.py") else Path(file).parent
        if file and where != folder and str(where) in _FOLDERS:
            raise Refused(f"{path} imports {name}, and {file} has been imported by that name; rename one of the two, "
                          f"or run the scenes one by one")
    own = str(folder)
    if own in _FOLDERS or own not in sys.path:
        _FOLDERS[:] = [own, *(each for each in _FOLDERS if each != own)]
        sys.path[:] = [*(each for each in sys.path if each not in _FOLDERS), *_FOLDERS]


def _imported(path: Path) -> set[str]:
    """The packages and modules that a file names in its imports; none if it is no Python."""
    import ast

    try:
        tree = ast.parse(read_bytes(path))
    except (OSError, SyntaxError, ValueError, RecursionError):
        return set()
    whole = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    parts = {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and not node.level}
    return {name.partition(".")[0] for name in whole | parts}
