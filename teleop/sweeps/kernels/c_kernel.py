"""The engine `c`: the loop of a row printed as C, compiled by the machine's own compiler and loaded by ctypes.

It prints the lines of the engine `scalar` by `teleop.emit`, so it gives the same bits, and it compiles a structure of
scene in about a second, where numba takes several. A row in which Python would have raised ends as diverged. What has
no line in C runs by another engine.

The library's name is a hash of the lines, of the source of every function in them and of the printer, as that of a
module of `teleop.sweeps.kernels.compiled`, so one that is in the cache folder is loaded without being printed.
"""

from __future__ import annotations

import ast
import ctypes
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from teleop.emit.compiler import find_compiler
from teleop.emit.expressions import bare, c_word
from teleop.emit.primitives import FAULTS
from teleop.emit.statements import Program, Statements
from teleop.emit.types import DOUBLE, INT, NOTHING, Array, Printed, TupleParts, Types, Value, parts_of
from teleop.scene.scene import Scene
from teleop.simulation.bodies import Bodies
from teleop.simulation.expressions import Known
from teleop.simulation.felt import frame_of
from teleop.simulation.source import Lines
from teleop.simulation.tick import loop
from teleop.stages import memory
from teleop.storage.files import replacing
from teleop.sweeps.kernels.cache_folder import folder, made_private, open_to_others, tell_once
from teleop.sweeps.kernels.compiled import check_amount, pieces_of, text_of
from teleop.sweeps.kernels.functions import digest, sources
from teleop.sweeps.kernels.kernel import (
    Kernel,
    KernelOutput,
    NotCompiled,
    RowInputs,
    functions_of_kernel,
    gives,
    kernel_lines,
    tree_of,
)
from teleop.sweeps.kernels.tiles import address_of, call_kernel

MOST_NUMBERS = 2000  # of a row
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fno-builtin-pow", "-fPIC", "-shared", "-w")
SOURCES = (*[f"teleop.emit.{name}" for name in ("calls", "expressions", "primitives", "statements", "types")],
           "teleop.simulation.expressions", "teleop.simulation.specialise", __name__)  # what a kernel is made with
TREE = ("numbers", "law", "dt", "x_limit", "start_m", "start_s", "held")  # what `tree_of` gives

TEXT = """\
/* Generated: the kernel of one structure of scene. Delete it whenever you like. */
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>

enum {{ {faults} }};
struct rings {{ void *of[{rings}]; int count; }};
{types}
static void *ring(struct rings *rings, int64_t size, size_t each)
{{
    return rings->of[rings->count++] = calloc((size_t)size, each);
}}

{functions}
static void loop(struct rings *rings, const double *reals, const int64_t *wholes, const double *const *lists,
    int64_t count, const int64_t *play_m, const int64_t *play_s, {paths}int64_t size, const int64_t *request,
    double *out)
{{
    unsigned faults = 0, *const fault = &faults;
    bool raised = false;
{numbers}
{lines}
}}

void kernel(int64_t tiles, const double *reals, const int64_t *wholes, const double *const *lists, int64_t count,
    const int64_t *plays, const int64_t *paths, const int64_t *sizes, const int64_t *lags, int64_t start,
    int64_t window, int64_t last, double *out)
{{
    for (int64_t t = 0; t < tiles; t++) {{
        const int64_t request[5] = {{lags[2 * t], lags[2 * t + 1], start, window, last}};
        struct rings rings = {{.count = 0}};
        loop(&rings, reals + {reals} * t, wholes, lists, count, (const int64_t *)(intptr_t)plays[2 * t],
            (const int64_t *)(intptr_t)plays[2 * t + 1], {given}sizes[t], request, out + {row} * t);
        while (rings.count) free(rings.of[--rings.count]);
    }}
}}
"""


class InMemory(NamedTuple):
    """Numbers in memory by a word of C: a schedule, a path, or a ring of messages."""

    type: Any  # of each
    text: str


class KernelPrinter(Statements):
    """Printer of the loop of a row."""

    def __init__(self, program: Program, names: dict[str, Any]) -> None:
        super().__init__(program, loop)
        self.names = names
        self.rings = 0

    def printed(self, known: dict[str, Value], body: list[ast.stmt]) -> str:
        """The lines, printed until the types of all variables are found."""
        for _ in range(8):
            before, self.rings = dict(self.kinds), 0
            self.start(known, body)
            self.body(body)
            if before == self.kinds:
                break
        return self.rendered(0)

    def apply(self, function: Any, arguments: list[Value], keywords: dict[str, Value]) -> Value:
        if function is memory.at:
            numbers, k = arguments
            return Printed(numbers.type, f"{numbers.text}[{bare(self.to(k, INT))}]")
        if function is memory.get:
            ring, k, size = arguments
            return Printed(ring.type, self.place(ring, k, size))
        return super().apply(function, arguments, keywords)

    def place(self, ring: InMemory, k: Value, size: Value) -> str:
        """The place of number k in a ring, whose size is a power of two."""
        return f"{ring.text}[{self.to(k, INT)} & ({self.to(size, INT)} - 1)]"

    def set_name(self, name: str, value: Value) -> None:
        if isinstance(value, InMemory):
            self.scope[name] = value
        else:
            super().set_name(name, value)

    def _Assign(self, line: ast.Assign) -> None:
        call, name = line.value, getattr(line.targets[0], "id", "")
        if not (isinstance(call, ast.Call) and self.evaluate(call.func) == Known(memory.ring)):
            super()._Assign(line)
            return
        message, size = [self.evaluate(each) for each in call.args]
        kind = self.kinds[name] = self.types.join(self.kinds.get(name), self.whole(message).type)
        of = self.types.c(kind)
        self.append(f"{of} *const {c_word(name)} = ring(rings, {bare(self.to(size, INT))}, sizeof({of}));")
        self.scope[name] = InMemory(kind, c_word(name))
        self.rings += 1

    def _Expr(self, line: ast.Expr) -> None:
        call = line.value
        if not (isinstance(call, ast.Call) and self.evaluate(call.func) == Known(memory.put)):
            super()._Expr(line)
            return
        ring, k, size, message = [self.evaluate(each) for each in call.args]
        name = ast.unparse(call.args[0])
        self.kinds[name] = self.types.join(ring.type, self.whole(message).type)
        self.append(f"{self.place(ring, k, size)} = {bare(self.to(message, ring.type))};")

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
        ran, figures = self.parts(self.evaluate(line.value))
        *others, finite = self.parts(figures)
        for i, each in enumerate((ran, *others)):
            self.append(f"out[{i}] = {bare(self.to(each, DOUBLE))};")
        self.append(f"out[{1 + len(others)}] = raised || faults ? 0.0 : {self.to(finite, DOUBLE)};")
        self.append("return;")


class FlatNumbers:
    """The numbers of a tree as `teleop.sweeps.kernels.kernel.leaves` lays them out, in the same order."""

    def __init__(self, types: Types) -> None:
        self.types = types
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
        return "" if kind == NOTHING else f"{name}[{i}]"


def kernel_text(scene: Scene, bodies: Bodies, measures: Sequence[str], made: Lines) -> str:
    """The text of a kernel. Raises `NotPrinted` or `NotCompiled` where something in it has no line in C."""
    program = Program("k_", powers=True)
    printer = KernelPrinter(program, made.names(functions_of_kernel(scene, bodies)))
    flat, numbers, known = FlatNumbers(program.types), [], dict[str, Value]()
    for name, value in zip(TREE, tree_of(scene, bodies), strict=True):
        kind = program.types.of_value(value)
        text = flat.initial(value, kind)
        known[name] = Known(value) if kind == NOTHING else Printed(kind, name, fixed=True)
        numbers += [f"    const {program.types.c(kind)} {name} = {text};"] * (kind != NOTHING)
    check_amount(flat.reals, MOST_NUMBERS)
    axes = range(scene.axes if scene.reference is not None else 0)
    known |= {"play_m": InMemory(INT, "play_m"), "play_s": InMemory(INT, "play_s"),
              "ref": TupleParts(tuple([InMemory(DOUBLE, f"path_{i}") for i in axes])),
              "count": Printed(INT, "count"), "size": Printed(INT, "size"),
              "request": Printed(Array(INT, 5, bare=True), "request")}
    lines = printer.printed(known, made.made.tree.body)
    return TEXT.format(
        faults=", ".join([f"K_{name} = 1 << {i}" for i, name in enumerate(FAULTS)]), rings=max(1, printer.rings),
        types=program.types.declarations(), functions=program.text(lines), numbers="\n".join(numbers), lines=lines,
        paths="".join([f"const double *path_{i}, " for i in axes]), reals=flat.reals,
        row=len(gives(scene, measures)) + 2,
        given="".join([f"(const double *)(intptr_t)paths[{len(axes)} * t + {i}], " for i in axes]))


def library_name(scene: Scene, bodies: Bodies, made: Lines, compiler: str) -> str:
    """The name of a kernel's library: a hash of all that it is made of."""
    def kinds(value: Any) -> Any:
        return (type(value), *map(kinds, value)) if isinstance(value, tuple) else type(value)

    parts = [each for part in made.names(functions_of_kernel(scene, bodies)).values() if not isinstance(part, float)
             for each in pieces_of(part)]
    texts = [made.text(), repr(kinds(tree_of(scene, bodies))), *sources(parts), *map(text_of, SOURCES)]
    return f"teleop_kernel_c_{digest([*texts, compiler, *FLAGS])}"


def c_kernel(scene: Scene, bodies: Bodies, measures: Sequence[str], *, keep: bool = True) -> Kernel:
    """The kernel of a scene's structure. Raises `NotCompiled` or `NotPrinted` where something in it has no line in C.

    `keep`: in the cache folder, else for this process alone.
    """
    compiler = find_compiler()
    if compiler is None:
        raise NotCompiled("there is no C compiler")
    made, names = kernel_lines(scene, measures, engine="scalar"), gives(scene, measures)
    compiled = _loaded(library_name(scene, bodies, made, compiler), compiler, keep,
                       lambda: kernel_text(scene, bodies, measures, made))

    def kernel(tiles: int, reals: Any, wholes: Any, arrays: tuple[Any, ...], *others: Any) -> None:
        lists = (ctypes.c_void_p * len(arrays))(*map(address_of, arrays))
        compiled(tiles, *map(_argument, (reals, wholes)), lists, *map(_argument, others))

    def run(rows: Sequence[RowInputs], lags: Sequence[tuple[int, int]]) -> list[KernelOutput]:
        return [one for one, in call_kernel(kernel, [[each] for each in zip(rows, lags, strict=True)], len(names))]

    return Kernel("c", tuple(measures), names, frame_of(scene), run)


def _argument(value: Any) -> Any:
    return ctypes.c_void_p(address_of(value)) if isinstance(value, np.ndarray) else ctypes.c_int64(value)


def _loaded(name: str, compiler: str, keep: bool, text: Callable[[], str]) -> Any:
    """The kernel of the library of this name, compiled first if it is not there."""
    path = folder() / f"{name}.so"
    try:
        made_private(path.parent)
        if keep and (why := open_to_others(path.parent, name)):
            tell_once(why)
            keep = False
    except OSError:
        keep = False
    if keep and path.exists():
        return ctypes.CDLL(str(path)).kernel
    with TemporaryDirectory() as temporary:
        code, made = Path(temporary) / "kernel.c", Path(temporary) / f"{name}.so"
        code.write_text(text())
        done = subprocess.run([compiler, *FLAGS, str(code), "-lm", "-o", str(made)], capture_output=True, text=True,
                              check=False)
        if done.returncode:
            raise NotCompiled(f"the C compiler says: {done.stderr.strip()[:200]}")
        if keep:
            with replacing(path) as file:
                file.write(made.read_bytes())
        return ctypes.CDLL(str(path if keep else made)).kernel
