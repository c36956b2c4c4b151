"""Modules of compiled kernels: one for each structure of scene and engine, in the user's cache folder.

A module imports the functions that its text names and compiles them; nothing of theirs is copied into it. Numba notices
neither an edit in a function that a cached one calls nor a new version of itself, so the module's name is a hash of the
text, of the source of every function in it, and of the versions: an edited law makes another module. It is written
whole, by a rename, so several processes may do so at once. Where the folder cannot be written to, it lives in memory.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from inspect import getsource, signature
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, Protocol

from teleop.batch.kernel import kernel_text, names_of, tree_of
from teleop.batch.leaves import expression, leaves
from teleop.bodies import Bodies
from teleop.errors import Refused
from teleop.scene import Scene
from teleop.source import record

TEXT = '''"""Generated: the {engine} kernel of one structure of scene. Delete it whenever you like."""
from math import inf, nan
from numba import njit
from teleop.batch.compiled import compiled_part
from teleop.batch.{engine} import *
from teleop.source import record

{parts}


@njit(error_model="numpy", nogil=True)
{loop}

{kernels}'''
KERNEL = '''
@njit(cache=True, error_model="numpy", nogil=True)
def {name}(tiles, reals, wholes, arrays, ticks, plays, paths, sizes, lags, out):
    for t in range(tiles):
        base = t * {reals}
        given, law, dt, x_limit, start_m, start_s, held = {tree}
{call}
'''


class NotCompiled(Exception):
    """Why a structure of scene has no compiled kernel."""


def folder() -> Path:
    """Where the modules are kept."""
    home = os.environ.get("XDG_CACHE_HOME")
    return (Path(home) if home else Path.home() / ".cache") / "bilateral-teleop" / "kernels"


class Engine(Protocol):
    """What a compiled engine puts into a module of its own: the module `teleop.batch.NAME`."""

    SOURCES: tuple[str, ...]  # the modules of its own that a kernel is made with
    FEATURES: frozenset[str]  # of the tick's text
    REAL: str  # how a float is taken from `reals` at `base`; {} is its number
    WIDTH: int  # scenes side by side
    CALLS: Mapping[str, str]  # the kernels of a module by name: how each calls `loop` for tile t

    @staticmethod
    def maker(word: str) -> str:
        """The function that makes the part called `word` of what stands at a place."""
        ...


def module(scene: Scene, bodies: Bodies, measures: Sequence[str], engine: str) -> ModuleType:
    """The loaded module of a kernel. Raises `NotCompiled` or an error of numba's where a part is not made for that."""
    return _loaded(*module_text(scene, bodies, measures, engine))


def module_text(scene: Scene, bodies: Bodies, measures: Sequence[str], engine: str) -> tuple[str, str]:
    """The module of a kernel, and the name that it goes by."""
    import numba
    import numpy

    own = import_module(f"teleop.batch.{engine}")
    lines, sources = [], []
    for word, part in sorted(names_of(scene, bodies).items()):
        if isinstance(part, float):
            continue  # inf and nan
        places = [_place(word, each) for each in _pieces(part)]
        lines.append(f"{word} = {own.maker(word)}({', '.join(map(repr, places))})")
        sources += [source for each in _pieces(part) for source in _sources(each, set())]

    def class_name(kind: Any) -> str:
        names: tuple[str, ...] = kind._fields
        word = f"{kind.__name__}_of_{'_'.join(names)}"
        made = f"record({kind.__name__!r}, {names})" if record(kind.__name__, names) is kind else (
            f"compiled_part({_place(word, kind)!r})")
        if (line := f"{word} = {made}") not in lines:
            lines.append(line)
        return word

    flat, width = leaves(tree_of(scene, bodies)), own.WIDTH
    tree = expression(flat.shape, own.REAL, class_name)
    axes = range(scene.axes if scene.hand is not None else 0)
    words = {
        "row": (len(measures) + 2) * width, "width": width,
        "one_path": f"({''.join(f'paths[(t * {len(axes)} + {i}) * {width}], ' for i in axes)})",
        "own_paths": f"({''.join(f'each(paths, t * {len(axes)} + {i}), ' for i in axes)})",
    }
    kernels = "".join(KERNEL.format(name=name, reals=len(flat.reals) * width, tree=tree, call=call.format(**words))
                      for name, call in own.CALLS.items())
    text = TEXT.format(engine=engine, kernels=kernels, parts=os.linesep.join(lines),
                       loop=kernel_text(scene, measures, own.FEATURES))
    stack = [_text_of(name) for name in own.SOURCES]
    versions = (sys.version, numba.__version__, numpy.__version__)
    return text, hashlib.sha256(repr((text, sources, stack, versions)).encode()).hexdigest()[:20]


@lru_cache
def _text_of(name: str) -> str:
    return Path(import_module(name).__file__ or "").read_text()


def jit(function: Callable[..., Any]) -> Any:
    """A function compiled as every part of a kernel is: numpy's errors, no lock, no fast-math."""
    from numba import njit

    compiled: Any = njit(error_model="numpy", nogil=True)
    return compiled(function)


def part_at(place: str) -> Any:
    """What stands at "module:name"."""
    module, _, names = place.partition(":")
    part: Any = import_module(module)
    for name in names.split("."):
        part = getattr(part, name)
    return part


def compiled_part(place: str, *inner: str) -> Any:
    """What stands at "module:name", compiled if it is a function; with `inner`, bound to the function there."""
    return _bound(part_at(place), compiled_part(*inner)) if inner else jitted(part_at(place))


def _pieces(part: Any) -> tuple[Any, ...]:
    """A part, or the two that `teleop.plant.bound` made it of."""
    own = isinstance(part, partial) and len(part.args) == 1 and not part.keywords
    return (part.func, *_pieces(part.args[0])) if own else (part,)


def _bound(function: FunctionType, inner: Any) -> Any:
    """`teleop.plant.bound`, compiled. Its arguments are written out: of `*rest` numba makes an indirect call."""
    rest = ", ".join(list(signature(function).parameters)[1:])
    names = {"function": jitted(function), "inner": inner}
    return jit(eval(f"lambda {rest}: function(inner, {rest})", names))


_JITTED: dict[Any, Any] = {}


def jitted(part: Any) -> Any:
    """A plain function compiled, with the plain functions that it names; anything else as it is."""
    if not isinstance(part, FunctionType):
        return part
    if part not in _JITTED:
        own = FunctionType(part.__code__, {"__builtins__": __builtins__}, part.__name__, part.__defaults__)
        _JITTED[part] = jit(own)
        own.__globals__.update({name: jitted(thing) for name, thing in named_in(part).items()})
    return _JITTED[part]


def named_in(function: FunctionType) -> dict[str, Any]:
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
        for thing in named_in(part).values():
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
