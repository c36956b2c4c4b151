"""Kernels compiled by numba: one module per structure of scene, in the user's cache folder.

A module imports the functions that its text names and compiles them; nothing of theirs is copied into it. Numba notices
neither an edit in a function that a cached one calls nor a new version of itself, so the module's name is a hash of the
text, of the source of every function in it, and of the versions: an edited law makes another module. It is written
whole, by a rename, so several processes may do so at once. Where the folder cannot be written to, it lives in memory.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Sequence
from dataclasses import fields
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from inspect import getsource
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

from teleop.batch.kernel import Kernel, kernel_text, names_of
from teleop.bodies import Bodies
from teleop.errors import Refused
from teleop.scene import Scene
from teleop.source import beginnings

HEAD = '''"""Generated: the kernel of one structure of scene. Delete it whenever you like."""
from collections import namedtuple
from math import inf, nan
from numba import njit
from teleop.batch.compiled import compiled_part

Given = namedtuple("Given", {given})
Law = namedtuple("Law", {law})
'''


class NotCompiled(Exception):
    """Why a structure of scene has no compiled kernel."""


def folder() -> Path:
    """Where the modules are kept."""
    home = os.environ.get("XDG_CACHE_HOME")
    return (Path(home) if home else Path.home() / ".cache") / "bilateral-teleop" / "kernels"


def scalar(scene: Scene, bodies: Bodies, measures: Sequence[str]) -> Kernel:
    """The kernel compiled for one scene at a time. Raises `NotCompiled` where a part of it is not made for that."""
    text, name = module_text(scene, bodies, measures)
    module = _loaded(text, name)
    return Kernel("scalar", tuple(measures), module.loop, module.Given, module.Law)


def module_text(scene: Scene, bodies: Bodies, measures: Sequence[str]) -> tuple[str, str]:
    """The module of a kernel, and the name that it goes by."""
    import numba
    import numpy

    starts = {e: scene.vector(f"start_{e}", getattr(scene, f"start_{e}")) for e in ("m", "s")}
    given = beginnings(scene, starts)._fields
    lines, sources = [], []
    for word, part in sorted(names_of(scene, bodies).items()):
        if isinstance(part, float):
            continue  # inf and nan
        place = _place(word, part)
        lines.append(f"{word} = compiled_part({place!r})")
        sources += _sources(part, set())
    head = HEAD.format(given=given, law=[field.name for field in fields(scene.law)])
    kernel = kernel_text(scene, measures)
    text = f"{head}{os.linesep.join(lines)}\n\n\n@njit(cache=True, error_model='numpy', nogil=True)\n{kernel}"
    versions = (sys.version, numba.__version__, numpy.__version__)
    return text, hashlib.sha256(repr((text, sources, versions)).encode()).hexdigest()[:20]


def compiled_part(place: str) -> Any:
    """What stands at "module:name", compiled if it is a function."""
    module, _, names = place.partition(":")
    part: Any = import_module(module)
    for name in names.split("."):
        part = getattr(part, name)
    return _jit(part)


_JITTED: dict[Any, Any] = {}


def _jit(part: Any) -> Any:
    """A plain function compiled, with the plain functions that it names; anything else as it is."""
    if not isinstance(part, FunctionType):
        return part
    if part not in _JITTED:
        from numba import njit

        own = FunctionType(part.__code__, {"__builtins__": __builtins__}, part.__name__, part.__defaults__)
        _JITTED[part] = njit(error_model="numpy", nogil=True)(own)
        own.__globals__.update({name: _jit(thing) for name, thing in _named(part).items()})
    return _JITTED[part]


def _named(function: FunctionType) -> dict[str, Any]:
    """What a function finds by name around it."""
    return {name: function.__globals__[name] for name in function.__code__.co_names if name in function.__globals__}


def _place(word: str, part: Any) -> str:
    """Where a part is found again by another process."""
    place = f"{part.__module__}:{part.__qualname__}"
    if "<" in place:
        raise NotCompiled(f"{word} is made during the run, not found in a module")
    if part.__module__ == "__main__" or getattr(part, "__closure__", None):
        raise NotCompiled(f"{word} of {part.__module__} cannot be found by another process")
    return place


def _sources(part: Any, seen: set[Any]) -> list[str]:
    """The source of a part and of every plain function or class that it names."""
    if part in seen or not isinstance(part, FunctionType | type) or part.__module__ in ("builtins", "math"):
        return []
    seen.add(part)
    try:
        found = [getsource(part)]
    except (OSError, TypeError):
        found = [repr(part)]
    if isinstance(part, FunctionType):
        for thing in _named(part).values():
            if isinstance(thing, FunctionType | type):
                found += _sources(thing, seen)
            elif isinstance(thing, int | float | str):
                found.append(repr(thing))
    return found


def _loaded(text: str, name: str) -> ModuleType:
    """The module of this name, written first if it is not there."""
    full = f"teleop_kernel_{name}"
    if full in sys.modules:
        return sys.modules[full]
    path = folder() / f"{full}.py"
    try:
        if not path.exists() or path.read_text() != text:
            path.parent.mkdir(parents=True, exist_ok=True)
            part = path.with_suffix(f".{os.getpid()}.part")
            part.write_text(text)
            part.replace(path)
    except OSError:
        return _in_memory(text, full)
    spec = spec_from_file_location(full, path)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[full] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[full]
        raise
    return module


def _in_memory(text: str, full: str) -> ModuleType:
    module = ModuleType(full)
    sys.modules[full] = module
    exec(compile(text.replace("cache=True, ", ""), f"<{full}>", "exec"), module.__dict__)
    return module


def need_numba(engine: str) -> None:
    """Refuse an engine that is not installed."""
    from importlib.util import find_spec

    if find_spec("numba") is None:
        raise Refused(f"engine {engine} needs numba: pip install 'bilateral-teleop[batch]', or take --engine plain")
