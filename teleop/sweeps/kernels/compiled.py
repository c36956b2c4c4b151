"""Modules of compiled kernels: one for each structure of scene and engine, in the user's cache folder.

A module imports the functions that its text names and compiles them; nothing of theirs is copied into it. Numba notices
neither an edit in a function that a cached one calls nor a new version of itself, so the module's name is a hash of the
text, of the source of every function in it, and of the versions: an edited law makes another module. It is written
whole, by a rename, so several processes may do so at once. Where the folder cannot be written to, or other users may
write there (`teleop.sweeps.kernels.cache_folder`), it lives in memory.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from importlib import import_module
from importlib.util import cache_from_source, find_spec, module_from_spec, spec_from_file_location
from inspect import signature
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, NamedTuple

import numpy

from teleop.errors import Refused
from teleop.scene.scene import Scene
from teleop.simulation import masks
from teleop.simulation.bodies import Bodies
from teleop.simulation.source import located
from teleop.simulation.structure import record
from teleop.simulation.tick import loop
from teleop.stages import memory
from teleop.storage.files import replacing
from teleop.sweeps.kernels.cache_folder import folder, made_private, open_to_others, tell_once
from teleop.sweeps.kernels.functions import constants, digest, named_in, sources, unlike_python
from teleop.sweeps.kernels.kernel import (
    NotCompiled,
    expression,
    functions_of_kernel,
    gives,
    kernel_lines,
    leaves,
    tree_of,
)

TEXT = '''"""Generated: the {engine} kernel of one structure of scene. Delete it whenever you like."""
from math import inf, nan
from numba import njit
from teleop.simulation.structure import record
from teleop.sweeps.kernels.compiled import compiled_part, jit_at
from teleop.sweeps.kernels.engines import *

{parts}

LOOP = """
{loop}
"""
LINES = {lines}
loop = jit_at(LOOP, LINES, globals())  # the number of each line in the file of the tick

{kernels}'''
KERNEL = '''
@njit(cache=True, error_model="numpy", nogil=True, no_cfunc_wrapper=True)
def {name}(tiles, reals, wholes, arrays, ticks, plays, paths, sizes, lags, start, window, last, out):
    for t in range(tiles):
        base = t * {reals}
        given, law, dt, x_limit, start_m, start_s, held = {tree}
{call}
'''


MOST_NUMBERS = 500  # of a row
INSTRUCTIONS = (masks.__name__, memory.__name__)  # modules for whose functions an engine has instructions


SOURCES = (*[f"teleop.sweeps.kernels.{name}" for name in ("engines", "functions", "lanes", "rings")],
           "teleop.simulation.expressions", "teleop.simulation.specialise")  # modules that a kernel is made with


class CompiledEngine(NamedTuple):
    """The parts of a kernel's module that differ between engines."""

    name: str
    real: str  # how a float is taken from `reals` at `base`; {} is its number
    width: int  # scenes side by side
    calls: Mapping[str, str]  # the kernels of a module by name: how each calls `loop` for tile t
    part_maker: Callable[[str], str]  # the name of the function that makes the part of a name from its place


def check_amount(numbers: int, most: int = MOST_NUMBERS) -> None:
    """Refuse a row of very many numbers, a long line of late forces, say: compiling takes minutes."""
    if numbers > most:
        raise NotCompiled(f"it has {numbers} numbers, above {most}, which are too many to be laid out")


def module(scene: Scene, bodies: Bodies, measures: Sequence[str], engine: CompiledEngine, *, keep: bool = True
           ) -> ModuleType:
    """The loaded module of a kernel. Raises `NotCompiled` or an error of numba's where a part is not made for that.

    `keep`: in the cache folder, else in memory alone.
    """
    text, name = module_text(scene, bodies, measures, engine)
    return _loaded(text, name) if keep else _in_memory(text, f"teleop_kernel_{name}")


def module_text(scene: Scene, bodies: Bodies, measures: Sequence[str], engine: CompiledEngine) -> tuple[str, str]:
    """The module of a kernel, and the name that it goes by."""
    import numba

    lines: list[str] = []
    pieces: list[Any] = []
    made = kernel_lines(scene, measures, engine=engine.name)
    for word, part in sorted(made.names(functions_of_kernel(scene, bodies)).items()):
        if isinstance(part, float):
            continue  # inf and nan
        if part.__module__ in INSTRUCTIONS:
            lines += [f"{word} = {part.__name__}"] * (word != part.__name__)
            continue
        for each in pieces_of(part):
            if isinstance(each, FunctionType) and (odd := unlike_python(each)):
                raise NotCompiled(f"{each.__qualname__} has {odd}")
        places = [_place(word, each) for each in pieces_of(part)]
        lines.append(f"{word} = {engine.part_maker(word)}({', '.join(map(repr, places))})")
        pieces += pieces_of(part)

    def class_name(kind: Any) -> str:
        names: tuple[str, ...] = kind._fields
        word = f"{kind.__name__}_of_{'_'.join(names)}"
        made = f"record({kind.__name__!r}, {names})" if record(kind.__name__, names) is kind else (
            f"compiled_part({_place(word, kind)!r})")
        if (line := f"{word} = {made}") not in lines:
            lines.append(line)
        return word

    flat, width = leaves(tree_of(scene, bodies)), engine.width
    check_amount(len(flat.reals))
    tree = expression(flat.shape, engine.real, class_name)
    axes = range(scene.axes if scene.reference is not None else 0)
    words = {
        "row": (len(gives(scene, measures)) + 2) * width, "width": width,
        "one_path": f"({''.join(f'(paths[(t * {len(axes)} + {i}) * {width}], 0.0), ' for i in axes)})",
        "own_paths": f"({''.join(f'(tile_of(paths, t * {len(axes)} + {i}), 0.0), ' for i in axes)})",
    }
    kernels = "".join(KERNEL.format(name=name, reals=len(flat.reals) * width, tree=tree, call=call.format(**words))
                      for name, call in engine.calls.items())
    text = TEXT.format(engine=engine.name, kernels=kernels, parts=os.linesep.join(lines), loop=made.text(),
                       lines=made.lines())
    stack = [text_of(name) for name in SOURCES]
    versions = [sys.version, numba.__version__, numpy.__version__]
    return text, digest([text, *sources(pieces), *stack, *versions])


@lru_cache
def text_of(name: str) -> str:
    """The source of a module."""
    return Path(import_module(name).__file__ or "").read_text()


def jit(function: Callable[..., Any]) -> Any:
    """A function compiled as every part of a kernel is: numpy's errors, no lock, no fast-math.

    Only compiled code calls it. Wrappers for Python and C would take about half of the compiling.
    """
    from numba import njit

    compiled: Any = njit(error_model="numpy", nogil=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
    return compiled(function)


def jit_at(text: str, lines: Sequence[int], names: dict[str, Any]) -> Any:
    """The loop of this text, compiled, with the line of the tick that each of its lines comes from."""
    exec(located(text, lines), names)
    return jit(names[loop.__name__])


def part_at(place: str) -> Any:
    """Find the part at "module:name"."""
    module, _, names = place.partition(":")
    part: Any = import_module(module)
    for name in names.split("."):
        part = getattr(part, name)
    return part


def compiled_part(place: str, *inner: str) -> Any:
    """Compile the part at "module:name" if it is a function; with `inner`, bind it to the function there."""
    return _bound(part_at(place), compiled_part(*inner)) if inner else jitted(part_at(place))


def pieces_of(part: Any) -> tuple[Any, ...]:
    """A part, or the two that `teleop.physics.plant.bound` made it of."""
    is_bound = isinstance(part, partial) and len(part.args) == 1 and not part.keywords
    return (part.func, *pieces_of(part.args[0])) if is_bound else (part,)


def _bound(function: FunctionType, inner: Any) -> Any:
    """`teleop.physics.plant.bound`, compiled. Each argument by name: of `*rest` numba makes an indirect call."""
    rest = ", ".join(list(signature(function).parameters)[1:])
    names = {"function": jitted(function), "inner": inner}
    return jit(eval(f"lambda {rest}: function(inner, {rest})", names))


_JITTED: dict[Any, Any] = {}


def jitted(part: Any) -> Any:
    """A plain function compiled, with the plain functions that it names; anything else as it is."""
    if not isinstance(part, FunctionType):
        return part
    key = part, digest(constants([part]))  # numba takes what a function names as it is now, and for ever
    if key not in _JITTED:
        copy = FunctionType(part.__code__, {"__builtins__": __builtins__}, part.__name__, part.__defaults__)
        _JITTED[key] = jit(copy)
        copy.__globals__.update({name: jitted(thing) for name, thing in named_in(part).items()})
    return _JITTED[key]


def _place(word: str, part: Any) -> str:
    """Name the place where another process finds a part."""
    place = f"{part.__module__}:{part.__qualname__}"
    if "<" in place:
        raise NotCompiled(f"{word} is made during the run, not found in a module")
    if getattr(part, "__closure__", None):
        raise NotCompiled(f"{word} of {part.__module__} holds what it was made with, which no other process finds")
    return place


def _loaded(text: str, name: str) -> ModuleType:
    """The module of this name, written first if it is not there."""
    full = f"teleop_kernel_{name}"
    if full in sys.modules:
        return sys.modules[full]
    path = folder() / f"{full}.py"
    try:
        made_private(path.parent)
        cached = Path(cache_from_source(str(path))).parent  # Python's own
        why = open_to_others(path.parent, full) or (open_to_others(cached, full) if cached.exists() else None)
        if why:
            tell_once(why)
            return _in_memory(text, full)
        if not path.exists() or path.read_text() != text:
            with replacing(path) as file:
                file.write(text.encode())
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
    if why := _kept_elsewhere(module, full):
        tell_once(why)
        return _in_memory(text, full)
    return module


def _kept_elsewhere(module: ModuleType, full: str) -> str | None:
    """Why the pickles that numba keeps of a module may be of another user; nothing has been read of them yet."""
    trusted = [folder(), *[Path(each) for each in (os.environ.get("NUMBA_CACHE_DIR"),) if each]]
    for part in vars(module).values():
        where = getattr(getattr(part, "stats", None), "cache_path", None)
        if where is None:
            continue
        if not any(Path(where).absolute().is_relative_to(each.absolute()) for each in trusted):
            return f"numba keeps them in {where}; unset what tells it so, such as .numba_config.yaml"
        if why := open_to_others(Path(where), full):
            return why
    return None


def _in_memory(text: str, full: str) -> ModuleType:
    module = ModuleType(full)
    sys.modules[full] = module
    exec(compile(text.replace("cache=True, ", ""), f"<{full}>", "exec"), module.__dict__)
    return module


def need_numba(engine: str) -> None:
    """Refuse an engine that is not installed."""
    if find_spec("numba") is None:
        raise Refused(f"engine {engine} needs numba: pip install 'bilateral-teleop[batch]', or take --engine plain")


def cause(error: Exception) -> str:
    """Why something is not compiled, in one line: of numba's many the one that names the cause."""
    if isinstance(error, NotCompiled):
        return str(error)
    lines = [line.strip() for line in str(error).splitlines()]
    noise = ("Failed in", "During:", "File", "- Resolution", "<")
    telling = [line for line in lines if line and not line.startswith(noise)]
    message = " ".join(telling[:2]) if telling and telling[0].endswith(":") else "".join(telling[:1])
    return f"{type(error).__name__}: {message[:200]}"
