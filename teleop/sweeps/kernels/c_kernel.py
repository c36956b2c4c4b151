"""The compiled engines: the loop of a row printed as C, compiled by the machine's own compiler and loaded by ctypes.

`c` runs a row at a time, `vector` as many side by side as a register of this machine has numbers, over the whole
horizon (`teleop.sweeps.kernels.lanes`). Rows side by side share their structure, their number of ticks and every whole
number. Where they share their link's schedule and their hand's path too they are `alike`, and these are read once for
all; where not, they are `apart`.

Both print the lines of the tick by `teleop.emit`, so they give the bits of plain Python. A row of `c` in which Python
would have raised ends as diverged. What has no line in C runs by the next plainer engine.

A library's name is a hash of the lines, of the source of every function in them, of the printer and of the machine, so
an edited law makes another, and one that is in the cache folder is loaded without being printed.
"""

from __future__ import annotations

import ast
import ctypes
import os
import subprocess
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import lru_cache, partial
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from teleop.emit.compiler import find_compiler
from teleop.emit.expressions import bare, c_word
from teleop.emit.primitives import FAULTS
from teleop.emit.types import DOUBLE, INT, NOTHING, Array, NotPrinted, Printed, TupleParts, Value, parts_of
from teleop.scene.scene import Scene
from teleop.simulation import masks
from teleop.simulation.bodies import Bodies
from teleop.simulation.expressions import Known
from teleop.simulation.felt import frame_of
from teleop.simulation.source import Lines
from teleop.simulation.structure import structure_of
from teleop.simulation.tick import loop
from teleop.stages import memory
from teleop.storage.files import replacing
from teleop.sweeps.kernels.cache_folder import folder, made_private, open_to_others, tell_once
from teleop.sweeps.kernels.functions import digest, sources
from teleop.sweeps.kernels.kernel import (
    Kernel,
    KernelOutput,
    NotCompiled,
    NotVectorised,
    RowInputs,
    functions_of_kernel,
    gives,
    kernel_lines,
    leaves,
    tree_of,
)
from teleop.sweeps.kernels.lanes import (
    ALL_WIDE,
    LANES,
    MASK,
    REALS_WIDE,
    LaneProgram,
    LaneStatements,
    gathered,
    has_lanes,
    header,
)
from teleop.sweeps.kernels.tiles import Tile, address_of, call_kernel

FLAGS = ("-std=c99", "-ffp-contract=off", "-fno-builtin-pow", "-fPIC", "-shared", "-w")
SOURCES = (*[f"teleop.emit.{name}" for name in ("calls", "expressions", "primitives", "statements", "types")],
           "teleop.simulation.expressions", "teleop.simulation.specialise", "teleop.sweeps.kernels.lanes",
           __name__)  # what a kernel is made with
TREE = ("numbers", "law", "dt", "x_limit", "start_m", "start_s", "held")  # what `tree_of` gives
MOST_NUMBERS = 2000  # of a row
OPTIMISED = 3  # axes beyond which -O3 compiles up to 16 times as long as -O2, and gains nothing

TEXT = """\
/* Generated: the kernel of one structure of scene. Delete it whenever you like. */
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>

{header}
enum {{ {faults} }};
struct rings {{ void *of[{rings}]; int count; }};
{types}
static void *ring(struct rings *rings, int64_t size, size_t each)
{{
    char *place = rings->of[rings->count++] = calloc((size_t)size * each + 63, 1);
    return place + (-(uintptr_t)place & 63); /* where a vector may stand */
}}

{functions}
static void loop(struct rings *rings, const double *reals, const int64_t *wholes, const double *const *lists,
    int64_t count, const int64_t *play_m, const int64_t *play_s, {paths}int64_t size, {lag} lag_0, {lag} lag_1,
    int64_t first_0, int64_t window_0, int64_t last_0, double *row)
{{
    unsigned faults = 0, *const fault = &faults;
    bool raised = false;
{numbers}
{lines}
}}

void kernel(int64_t tiles, const double *reals, const int64_t *wholes, const double *const *lists, int64_t count,
    const int64_t *plays, const int64_t *paths, const int64_t *sizes, const int64_t *lags, int64_t first,
    int64_t window, int64_t last, double *out)
{{
    for (int64_t t = 0; t < tiles; t++) {{
        struct rings rings = {{.count = 0}};
        loop(&rings, reals + {reals} * t, wholes, lists, count, {plays}, {given}sizes[t], {lags}, first, window, last,
            out + {row} * t);
        while (rings.count) free(rings.of[--rings.count]);
    }}
}}
"""


class Form(NamedTuple):
    """The rows that one call of a kernel's loop runs."""

    lanes: int = 1  # rows side by side
    apart: bool = False  # each with a schedule and a path of its own

    def addresses(self, word: str, i: str, of: str) -> str:
        """The numbers of this type at the i-th address of a tile, or the place of such addresses, one for each lane."""
        place = f"{word}[{self.lanes} * ({i})]"
        return f"&{place}" if self.apart else f"(const {of} *)(intptr_t){place}"


class InMemory(NamedTuple):
    """Numbers in memory by a word of C: a schedule, a path, or a ring of messages."""

    type: Any  # of each
    text: str
    each: str = ""  # the function that reads one for each lane


class KernelPrinter(LaneStatements):
    """Printer of the loop of a row, or of rows side by side."""

    def __init__(self, program: LaneProgram, names: dict[str, Any]) -> None:
        super().__init__(program, loop)
        self.names = names
        self.rings = 0

    def printed(self, known: dict[str, Value], body: list[ast.stmt]) -> str:
        """The lines, printed until the types of all variables are found."""
        def once() -> None:
            self.rings = 0
            self.start(known, body)
            self.body(body)

        self.until_typed(once)
        return self.rendered(0)

    def apply(self, function: Any, arguments: list[Value], keywords: dict[str, Value]) -> Value:
        if function is memory.at:
            numbers, k = arguments
            place = bare(self.to(k, INT))
            return Printed(numbers.type, f"{numbers.each}({numbers.text}, {place})" if numbers.each else
                           f"{numbers.text}[{place}]")
        if function is memory.get:
            ring, k, size = arguments
            if has_lanes(k):
                return Printed(ring.type, f"{self.getter(ring)}({ring.text}, {bare(k.text)}, {self.to(size, INT)})")
            return Printed(ring.type, self.place(ring, k, size))
        return super().apply(function, arguments, keywords)

    def place(self, ring: InMemory, k: Value, size: Value) -> str:
        """The place of number k in a ring, whose size is a power of two."""
        return f"{ring.text}[{self.to(k, INT)} & ({self.to(size, INT)} - 1)]"

    def getter(self, ring: InMemory) -> str:
        """The function that takes a message from a place of its own for each lane."""
        of, lanes = self.types.c(ring.type), range(self.program.lanes)
        rows = [f"    const {of} *const row{i} = ring + ((int64_t)k[{i}] & (size - 1));" for i in lanes]
        made = gathered(ring.type, [f"(*row{i})" for i in lanes], "[{}]")
        return self.program.helper_function("get", of, [f"const {of} *ring", f"{LANES} k", "int64_t size"],
                                            [*rows, f"    return ({of}){made};"])

    def putter(self, ring: InMemory) -> str:
        """The function that puts a message in a place of its own for each lane of a mask."""
        of, lanes = self.types.c(ring.type), self.program.lanes
        return self.program.helper_function(
            "put", "void", [f"{of} *ring", f"{LANES} k", "int64_t size", f"{MASK} which", f"{of} message"],
            ["    const double *from = (const double *)&message;", f"    for (int i = 0; i < {lanes}; i++) {{",
             "        double *to = (double *)(ring + ((int64_t)k[i] & (size - 1)));",
             "        if (!which[i]) continue;",
             f"        for (size_t n = i; n < sizeof message / 8; n += {lanes}) to[n] = from[n];", "    }"])

    def set_name(self, name: str, value: Value) -> None:
        if isinstance(value, InMemory):
            self.scope[name] = value
        else:
            super().set_name(name, value)

    def ring_type(self, kind: Any) -> Any:
        """The type of a ring's messages: all of its numbers have lanes, where there are lanes."""
        return kind if self.program.lanes == 1 else self.types.with_numbers(kind, ALL_WIDE)

    def _Assign(self, line: ast.Assign) -> None:
        call, name = line.value, getattr(line.targets[0], "id", "")
        if not (isinstance(call, ast.Call) and self.evaluate(call.func) == Known(memory.ring)):
            super()._Assign(line)
            return
        message, size = [self.evaluate(each) for each in call.args]
        kind = self.kinds[name] = self.ring_type(self.types.join(self.kinds.get(name), self.whole(message).type))
        of = self.types.c(kind)
        self.append(f"{of} *const {c_word(name)} = ring(rings, {bare(self.to(size, INT))}, sizeof({of}));")
        self.scope[name] = InMemory(kind, c_word(name))
        self.rings += 1

    def _Expr(self, line: ast.Expr) -> None:
        call = line.value
        function = self.evaluate(call.func) if isinstance(call, ast.Call) else None
        if function not in (Known(memory.put), Known(masks.put_selected), Known(masks.store)):
            super()._Expr(line)
            return
        assert isinstance(call, ast.Call)
        *which, ring, k, size, message = [self.evaluate(each) for each in call.args]
        if function == Known(masks.store):
            (out, mask), (ran, figures) = (ring, k), (size, message)
            mask = self.temporary(Printed(MASK, self.to(mask, MASK)))
            for i, each in enumerate((ran, *self.parts(figures))):
                place = f"{out.text} + {i * self.program.lanes}"
                self.append(f"vec_store({place}, {mask.text}, {bare(self.to(each, LANES))});")
            return
        name = ast.unparse(call.args[-4])
        self.kinds[name] = self.ring_type(self.types.join(ring.type, self.whole(message).type))
        if has_lanes(k):
            mask = self.to(which[0], MASK) if which else self.types.literal(True, MASK)
            texts = [ring.text, *map(bare, (k.text, self.to(size, INT), mask, self.to(message, ring.type)))]
            self.append(f"{self.putter(ring)}({', '.join(texts)});")
            return
        place = self.place(ring, k, size)
        if which:
            message = self.selected(self.whole(which[0]), self.by_name(message), Printed(ring.type, place))
        self.append(f"{place} = {bare(self.to(message, ring.type))};")

    def _For(self, line: ast.For) -> None:
        if not line.orelse:
            super()._For(line)
            return
        self.append("bool is_left = false;")  # Python's `else` of a loop follows one that was not left
        self.level, words = 2, self.words
        super()._For(ast.copy_location(ast.For(line.target, line.iter, [ast.Pass(lineno=0), *line.body], []), line))
        self.level = 1
        if self.words != words:
            raise self.refused("a name stands for another tuple at the end of a tick than at its beginning")
        self.append("if (!is_left) {")
        self.inner(line.orelse)
        self.append("}")

    def _Pass(self, line: ast.Pass) -> None:
        """Begin a tick: what a fault of the last one cut short is not cut short now."""
        self.append("raised = raised || faults;")
        self.append("faults = 0;")

    def _Break(self, line: ast.Break) -> None:
        self.append("is_left = true;")
        super()._Break(line)

    def _Return(self, line: ast.Return) -> None:
        assert line.value is not None
        value = self.evaluate(line.value)
        if value != Known(None):  # else lanes have stored their figures
            ran, figures = self.parts(value)
            *others, finite = self.parts(figures)
            for i, each in enumerate((ran, *others)):
                self.append(f"row[{i}] = {bare(self.to(each, DOUBLE))};")
            self.append(f"row[{1 + len(others)}] = raised || faults ? 0.0 : {self.to(finite, DOUBLE)};")
        self.append("return;")


class FlatNumbers:
    """The numbers of a tree as `teleop.sweeps.kernels.kernel.leaves` lays them out, in the same order."""

    def __init__(self, lanes: int) -> None:
        self.lanes = lanes
        self.reals = self.wholes = self.lists = 0

    def initial(self, value: Any, kind: Any) -> str:
        """The initialiser of a value of this type of C; empty where it has none."""
        if isinstance(value, tuple):
            kinds = parts_of(kind) if kind != NOTHING else [NOTHING] * len(value)
            parts = ", ".join(filter(None, [self.initial(*each) for each in zip(value, kinds, strict=True)])) or "0"
            return "" if kind == NOTHING else f"{{{{{parts}}}}}" if isinstance(kind, Array) else f"{{{parts}}}"
        name = "reals" if isinstance(value, float) else "lists" if isinstance(value, list) else "wholes"
        i = getattr(self, name)
        setattr(self, name, i + 1)
        return "" if kind == NOTHING else f"vec_load(reals + {i * self.lanes})" if kind == LANES else f"{name}[{i}]"


def kernel_text(scene: Scene, bodies: Bodies, measures: Sequence[str], form: Form) -> str:
    """The text of a kernel. Raises `NotPrinted` or `NotCompiled` where something in it has no line in C."""
    lanes, apart = form
    program, made = LaneProgram(lanes), lines_of(scene, measures, form)
    printer = KernelPrinter(program, made.names(functions_of_kernel(scene, bodies)))
    flat, numbers, known = FlatNumbers(lanes), [], dict[str, Value]()
    for name, value in zip(TREE, tree_of(scene, bodies), strict=True):
        kind = program.types.of_value(value)
        kind = kind if lanes == 1 else program.types.with_numbers(kind, REALS_WIDE)
        text = flat.initial(value, kind)
        known[name] = Known(value) if kind == NOTHING else Printed(kind, name, fixed=True)
        numbers += [f"    const {program.types.c(kind)} {name} = {text};"] * (kind != NOTHING)
    if flat.reals > MOST_NUMBERS:
        raise NotCompiled(f"it has {flat.reals} numbers, above {MOST_NUMBERS}, which are too many to be laid out")
    axes = range(scene.axes if scene.reference is not None else 0)
    of_lanes = [(LANES, "vec_wholes_at"), (LANES, "vec_reals_at")] if apart else [(INT, ""), (DOUBLE, "")]
    (whole, wholes_at), (real, reals_at) = of_lanes
    known |= {"play_m": InMemory(whole, "play_m", wholes_at), "play_s": InMemory(whole, "play_s", wholes_at),
              "ref": TupleParts(tuple([InMemory(real, f"path_{i}", reals_at) for i in axes])),
              "count": Printed(INT, "count"), "size": Printed(INT, "size"),
              "request": TupleParts((Printed(whole, "lag_0"), Printed(whole, "lag_1"), InMemory(DOUBLE, "row"), *[
                  Printed(INT, name) for name in ("first_0", "window_0", "last_0")]))}
    lines = printer.printed(known, made.made.tree.body)
    lag = [f"vec_wholes(&lags[{lanes} * (2 * t + {i})])" if apart else f"lags[{lanes} * (2 * t + {i})]" for i in (0, 1)]
    return TEXT.format(
        header=header(lanes) if lanes > 1 else "", faults=", ".join([f"K_{name} = 1 << {i}"
                                                                    for i, name in enumerate(FAULTS)]),
        rings=max(1, printer.rings), types=program.types.declarations(), functions=program.text(lines),
        numbers="\n".join(numbers), lines=lines, reals=flat.reals * lanes,
        row=(len(gives(scene, measures)) + 2) * lanes, lag=program.types.c(whole), lags=", ".join(lag),
        paths="".join([f"const {'int64_t' if apart else 'double'} *path_{i}, " for i in axes]),
        plays=", ".join([form.addresses("plays", f"2 * t + {i}", "int64_t") for i in (0, 1)]),
        given="".join([f"{form.addresses('paths', f'{len(axes)} * t + {i}', 'double')}, " for i in axes]))


class Target(NamedTuple):
    """The machine that a compiler makes vectors for."""

    flags: tuple[str, ...]
    macros: str  # all that it defines there, its own version among them

    @property
    def lanes(self) -> int:
        """Floats in a register."""
        return 8 if "__AVX512F__" in self.macros else 4 if "__AVX__" in self.macros else 2


ONE_ROW = Target(("-O2",), "")  # what any machine of a kind runs


@lru_cache
def target_of(compiler: str, axes: int = 1) -> Target:
    """This machine, or what the compiler makes code for where it cannot look."""
    level = "-O3" if axes <= OPTIMISED else "-O2"
    for flags in (("-march=native",), ()):
        done = subprocess.run([compiler, *flags, "-dM", "-E", "-x", "c", os.devnull], capture_output=True, text=True,
                              check=False)
        if done.returncode == 0:
            break
    return Target((level, "-fno-math-errno", *flags), done.stdout)


def lines_of(scene: Scene, measures: Sequence[str], form: Form) -> Lines:
    """The lines of a kernel of this form."""
    return kernel_lines(scene, measures, engine="c" if form.lanes == 1 else "vector")


def library_name(scene: Scene, bodies: Bodies, measures: Sequence[str], form: Form, compiler: str,
                 target: Target = ONE_ROW) -> str:
    """The name of a kernel's library: a hash of all that it is made of."""
    made = lines_of(scene, measures, form)

    def kinds(value: Any) -> Any:
        return (type(value), *map(kinds, value)) if isinstance(value, tuple) else type(value)

    parts = [each for part in made.names(functions_of_kernel(scene, bodies)).values() if not isinstance(part, float)
             for each in pieces_of(part)]
    texts = [made.text(), repr(kinds(tree_of(scene, bodies))), *sources(parts), *map(text_of, SOURCES), repr(form)]
    return f"teleop_kernel_c_{digest([*texts, compiler, target.macros, *FLAGS, *target.flags])}"


@lru_cache
def text_of(name: str) -> str:
    """The source of a module."""
    return Path(import_module(name).__file__ or "").read_text()


def pieces_of(part: Any) -> tuple[Any, ...]:
    """A part, or the two that `teleop.physics.plant.bound` made it of."""
    is_bound = isinstance(part, partial) and len(part.args) == 1 and not part.keywords
    return (part.func, *pieces_of(part.args[0])) if is_bound else (part,)


def loaded_kernel(scene: Scene, bodies: Bodies, measures: Sequence[str], form: Form) -> Callable[..., None]:
    """The compiled kernel of rows of this form."""
    compiler = find_compiler()
    if compiler is None:
        raise NotCompiled("there is no C compiler")
    target = target_of(compiler, scene.axes) if form.lanes > 1 else ONE_ROW
    compiled = _loaded(library_name(scene, bodies, measures, form, compiler, target),
                       [compiler, *FLAGS, *target.flags], lambda: kernel_text(scene, bodies, measures, form))

    def kernel(tiles: int, reals: Any, wholes: Any, arrays: tuple[Any, ...], *others: Any) -> None:
        lists = (ctypes.c_void_p * len(arrays))(*map(address_of, arrays))
        compiled(tiles, *map(_argument, (reals, wholes)), lists, *map(_argument, others))

    return kernel


def c_kernel(scene: Scene, bodies: Bodies, measures: Sequence[str]) -> Kernel:
    """The kernel of a scene's structure. Raises `NotCompiled` or `NotPrinted` where a part of it has no line in C."""
    names = gives(scene, measures)
    kernel = loaded_kernel(scene, bodies, measures, Form())

    def run(rows: Sequence[RowInputs], lags: Sequence[tuple[int, int]]) -> list[KernelOutput]:
        return [one for one, in call_kernel(kernel, [[each] for each in zip(rows, lags, strict=True)], len(names))]

    return Kernel("c", tuple(measures), names, frame_of(scene), run)


def vector_kernel(scene: Scene, bodies: Bodies, measures: Sequence[str]) -> Kernel:
    """The kernel of a scene's structure over lanes. Raises `NotVectorised` where that has none, else as `c_kernel`."""
    if structure_of(scene).m.has.inner or structure_of(scene).s.has.inner:
        raise NotVectorised("a body with an inner state is moved one scene at a time")
    if any(part.has.leaves_out and "compute_delay" in [stage.name for stage in part.stages]
           for part in (structure_of(scene).m, structure_of(scene).s)):
        raise NotVectorised("a computation delay at an end that leaves out ticks runs one scene at a time")
    if leaves(tree_of(scene, bodies)).arrays:
        raise NotVectorised("a part with a list among its numbers runs one scene at a time")
    compiler = find_compiler()
    names, width = gives(scene, measures), target_of(compiler).lanes if compiler else 1
    made = lru_cache(lambda apart: loaded_kernel(scene, bodies, measures, Form(width, apart)))
    made(False)

    def run(rows: Sequence[RowInputs], lags: Sequence[tuple[int, int]]) -> list[KernelOutput]:
        tiles: dict[bool, list[tuple[int, Tile]]] = {False: [], True: []}
        for first in range(0, len(rows), width):
            tile = list(zip(rows[first:first + width], lags[first:first + width], strict=True))
            one, lag = tile[0]
            alike = all(row.schedule is one.schedule and row.path is one.path and part == lag for row, part in tile)
            tile += [tile[-1]] * (width - len(tile))  # lanes without a row of their own repeat the last
            tiles[not alike].append((first, tile))
        results: dict[int, KernelOutput] = {}
        for apart, several in tiles.items():
            if several:
                try:
                    kernel = made(apart)
                except (NotCompiled, NotPrinted) as error:
                    raise NotVectorised(f"rows of schedules of their own have no lanes: {error}") from error
                outputs = call_kernel(kernel, [tile for _, tile in several], len(names))
                for (first, _), ones in zip(several, outputs, strict=True):
                    results |= enumerate(ones, first)
        return [results[i] for i in range(len(rows))]

    return Kernel("vector", tuple(measures), names, frame_of(scene), run, width)


def _argument(value: Any) -> Any:
    return ctypes.c_void_p(address_of(value)) if isinstance(value, np.ndarray) else ctypes.c_int64(value)


def _loaded(name: str, command: Sequence[str], text: Callable[[], str]) -> Any:
    """The kernel of the library of this name, compiled first if it is not there."""
    path, keep = folder() / f"{name}.so", True
    try:
        made_private(path.parent)
        if why := open_to_others(path.parent, name):
            tell_once(why)
            keep = False
    except OSError:
        keep = False
    if keep and path.exists():
        with suppress(OSError):  # of a damaged one
            return ctypes.CDLL(str(path)).kernel
    with TemporaryDirectory() as temporary:
        code, made = Path(temporary) / "kernel.c", Path(temporary) / f"{name}.so"
        code.write_text(text())
        done = subprocess.run([*command, str(code), "-lm", "-o", str(made)], capture_output=True, text=True,
                              check=False)
        if done.returncode:
            raise NotCompiled(f"the C compiler says: {done.stderr.strip()[:200]}")
        if keep:
            with suppress(OSError):  # of a full disk
                with replacing(path) as file:
                    file.write(made.read_bytes())
                made = path
        return ctypes.CDLL(str(made)).kernel
