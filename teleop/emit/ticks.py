"""The tick of a live end in C: the generator `teleop.simulation.tick.live`, written out for a structure.

What stands before the first `yield` is `init`, the body of the loop is `tick`, and a variable that the loop reads
before it sets it is a field of the state. A fault leaves the state as it was.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Sequence
from math import isnan
from typing import Any, NamedTuple

from teleop.emit.expressions import bare, c_word
from teleop.emit.statements import Line, Program, Statements, stores
from teleop.emit.types import (
    BOOL,
    DOUBLE,
    INT,
    NOTHING,
    Array,
    NotPrinted,
    Printed,
    TupleParts,
    Types,
    Value,
    comment,
    part,
)
from teleop.law import messages
from teleop.scene.scene import Scene
from teleop.simulation.expressions import Known
from teleop.simulation.source import functions, lines
from teleop.simulation.structure import columns, end_scene, live_structure, numbers_of, record, structure_of
from teleop.simulation.tick import LiveTick, live
from teleop.stages.wave_integral import Integrals

WHAT = {  # the inputs and outputs that all ends have
    "k": "number of this tick, of this end", "x": "position, m", "v": "velocity, m/s", "touch": "external force, N",
    "got": "there is a message to play", "newest": "number of the newest message, -1 before the first",
    "rx": "the message", "heard": "the integrals of the waves that came with it", "gain": "of the guard, 0 to 1",
    "held": "force that the motor held since the last tick, N", "since": "ticks since that force was set",
    "clutch": "1 while the operator holds the clutch open, 2 of the translation, 3 of the rotation",
    "present": "1 while the operator is there",
    "scale": "metres of the law for one of the device; with the guard 0 is 1",
    "wants": "1 while the policy's switch is on", "renewed": "1 if an action of the policy came",
    "action": "the policy's newest action, m", "force": "for the motor, N", "tx": "the message to send",
    "sent": "the integrals of its waves, to send along", "row": "what a record of this end has, in its order",
}


class StartReading(NamedTuple):
    """A number that is the reading of an axis where the end starts."""

    axis: int


class PrintedTick(NamedTuple):
    """The printed tick of one end: texts of C, and what the other files need to call it."""

    program: Program
    prefix: str
    text: str  # of `init` and `tick`
    numbers: str  # of the scene, as an initialiser of the parameters
    records: dict[str, dict[str, Any]]  # params, state, in and out: their fields and types
    columns: tuple[str, ...]
    axes: int
    public: tuple[Any, ...] = ()  # further types that the header has


class TickPrinter(Statements):
    """Printer of the lines of the generator; `names` is what they find by name."""

    def __init__(self, program: Program, names: dict[str, Any]) -> None:
        super().__init__(program, live)
        self.names = names

    def whole(self, value: Value) -> Printed:
        if isinstance(value, Known) and isinstance(value.value, StartReading):
            return self.whole(self.scope[f"x_read_{self.names['@end']}{value.value.axis}"])
        return super().whole(value)

    def answer(self, answer: ast.Tuple, kinds: Sequence[Any], columns: Sequence[str]
               ) -> tuple[dict[str, Any], list[str]]:
        """The fields of the outputs, and the lines that set them."""
        outputs: dict[str, Any] = {}
        lines = []
        for name, node, kind in zip(("force", "tx", "sent", "row"), answer.elts, kinds, strict=True):
            if isinstance(node, ast.Tuple):
                outputs[name] = Array(kind, len(node.elts), bare=True)
                lines += [f"    out->{name}[{i}] = {bare(self.to(self.evaluate(each), kind))};"
                          f"{comment(columns[i]) if name == 'row' else ''}" for i, each in enumerate(node.elts)]
        return outputs, lines

    def is_number(self, value: Value) -> bool:
        return isinstance(getattr(value, "value", None), StartReading) or super().is_number(value)


def printed_tick(scene: Scene, e: str, prefix: str, *, sensor: bool | None = None, real: str = DOUBLE) -> PrintedTick:
    """The tick of an end, m or s. Raises `NotPrinted`, with file and line, where a function has no lines in C."""
    scene = end_scene(scene, e)
    made = lines(live_structure(structure_of(scene), e, sensor), live, ends=(e,), engine="c").made
    split = Generator.of(made.tree)
    program = Program(prefix, real)
    types, words = program.types, dict(zip(split.words, LiveTick._fields, strict=True))
    printer = TickPrinter(program, {**made.names, **functions(scene), "@end": e})
    inputs = _inputs(scene, e, program)
    values = {"numbers": _start_numbers(scene, e), "law": scene.law, "dt": scene.dt_ns / 1e9}
    parameters = {name: types.of_value(_without_starts(value)) for name, value in values.items()}
    fixed: dict[str, Value] = {name: _parameter(values[name], Printed(kind, f"p->{name}", fixed=True))
                               for name, kind in parameters.items()}
    starts = {name: Printed(Array(DOUBLE, scene.axes, bare=True), name) for name in ("x0", "v0", "touch0")}
    for name, node in split.aliases({*fixed}).items():
        printer.scope = fixed
        fixed[name] = printer.evaluate(node)
    lasting = [name for name in split.lasting if name not in fixed]

    def run(known: dict[str, Value], body: Sequence[ast.stmt], depth: int = 1) -> PrintedSection:
        copies = printer.copies
        printer.start({**fixed, **known}, [*body])
        printer.copies = copies  # the two functions are rendered in the end, so no name of a copy is used twice
        printer.stores.update(lasting + lasting)
        printer.depth = depth
        printer.body([line for line in body if not (stores([line]) and stores([line]) <= {*fixed})])
        return PrintedSection(printer.lines, printer.declared, printer.scope)

    def state() -> dict[str, Any]:
        return {name: printer.kinds[name] for name in lasting if printer.kinds.get(name, NOTHING) != NOTHING}

    def once() -> tuple[PrintedSection, PrintedSection, PrintedSection]:
        printer.copies = 0
        begun = run(dict(starts), split.prologue)
        for word in words:
            printer.kinds.pop(word, None)
        entry = {name: begun.known[name] for name in lasting if name in begun.known}
        entry |= {name: Printed(kind, c_word(name)) for name, kind in state().items()}
        entry |= {word: Printed(inputs[field], f"in->{field}") for word, field in words.items() if field in inputs}
        first = run(entry, split.between, depth=2)
        entry |= {name: Printed(printer.kinds[name], c_word(name)) for name in stores(split.between)}
        return begun, first, run(entry, split.turn)

    begun, first, turn = printer.until_typed(once)
    members, names = state(), _flat_columns(scene, e, sensor)
    outputs, done = printer.answer(
        split.answer, (DOUBLE, _message(scene, program, mine=e), _integrals(program), DOUBLE), names)
    saved = [f"    s->{name} = {bare(printer.to(turn.known[name], kind))};" for name, kind in members.items()
             if name in stores([*split.between, *split.turn])]
    tick = printer.rendered(0, {c_word(name) for name in members}, "\n".join(done + saved))
    loads = [f"    {types.c(kind)} {c_word(name)} = s->{name};" for name, kind in members.items()]
    if first.lines:
        loads += ["    if (!s->started) {", *[f"        {each.target} = {each.text};" for each in first.lines], "    }"]
        saved.append("    s->started = true;")
    printer.lines, printer.declared, printer.scope = begun
    at_rest = [f"    s->{name} = {bare(printer.to(begun.known[name], kind))};" for name, kind in members.items()
               if name in begun.known and name not in stores(split.between)] + [
                   "    s->started = false;"] * bool(first.lines)
    init = printer.rendered(0, keep="\n".join(at_rest))
    if first.lines:
        members["started"] = BOOL
    text = FUNCTIONS.format(
        prefix=prefix, real=types.c(DOUBLE), init="\n".join(filter(None, [init, *at_rest])),
        tick="\n".join(filter(None, [*loads, tick])), done="\n".join(done + saved),
        unread_init=_unread("\n".join([init, *at_rest]), "s", "p", "x0", "v0", "touch0"),
        unread_tick=_unread("\n".join([*loads, tick]), "s", "p", "in"))
    inputs = {name: kind for name, kind in inputs.items() if re.search(rf"in->{name}\b", text)}
    literal = ", ".join([types.literal(_without_starts(values[name]), kind) for name, kind in parameters.items()
                         if kind != NOTHING])
    records = {"params": parameters, "state": members or {"nothing": BOOL}, "in": inputs, "out": outputs}
    return PrintedTick(program, prefix, text, f"{{{literal}}}", records, names, scene.axes)


FUNCTIONS = """\
unsigned {prefix}init({prefix}state *s, const {prefix}params *p, const {real} *x0, const {real} *v0,
    const {real} *touch0)
{{
    unsigned faults = 0, *const fault = &faults;
    (void)fault;
{unread_init}{init}
    return faults;
}}

unsigned {prefix}tick({prefix}state *s, const {prefix}params *p, const {prefix}in *in, {prefix}out *out)
{{
    unsigned faults = 0, *const fault = &faults;
    (void)fault;
{unread_tick}{tick}
    if (faults)
        return faults;
{done}
    return 0;
}}
"""


def _unread(text: str, *names: str) -> str:
    """Lines for the arguments that nothing reads."""
    return "".join([f"    (void){name};\n" for name in names if not re.search(rf"\b{name}\b", text)])


class PrintedSection(NamedTuple):
    """Printed lines, the variables that are declared before them, and what names stand for behind them."""

    lines: list[Line]
    declared: dict[str, None]
    known: dict[str, Value]


class Generator(NamedTuple):
    """The generator of a live end in its parts."""

    prologue: list[ast.stmt]
    between: list[ast.stmt]  # once, before the first tick
    turn: list[ast.stmt]  # a tick
    words: tuple[str, ...]  # the variables of a `LiveTick`, in order
    answer: ast.Tuple  # force, message, integrals, row

    @classmethod
    def of(cls, tree: ast.FunctionDef) -> Generator:
        """The parts of these lines."""
        body: list[Any] = tree.body
        first = next(i for i, line in enumerate(body) if isinstance(getattr(line, "value", None), ast.Yield))
        loop: Any = body[-1]
        return cls(body[:first], body[first + 1:-1], loop.body[:-1],
                   tuple([each.id for each in loop.body[-1].targets[0].elts]), loop.body[-1].value.value)

    @property
    def lasting(self) -> list[str]:
        """The variables that live from one tick to the next."""
        answer = ast.copy_location(ast.Expr(self.answer), self.turn[-1])
        begun = stores([*self.prologue, *self.between])
        return sorted(read_first([*self.turn, answer], set(self.words)) & begun)

    def aliases(self, parameters: set[str]) -> dict[str, ast.expr]:
        """Variables that are parts of the parameters by another name, and never set again."""
        parts: dict[str, ast.expr] = {}
        for line in self.prologue:
            if isinstance(line, ast.Assign) and isinstance(line.targets[0], ast.Name) and len(line.targets) == 1:
                name, node = line.targets[0].id, line.value
                while isinstance(node, ast.Attribute | ast.Subscript):
                    node = node.value
                again = stores([*self.between, *self.turn, *[each for each in self.prologue if each is not line]])
                if isinstance(node, ast.Name) and node.id in {*parameters, *parts} and name not in again:
                    parts[name] = line.value
        return parts


def reads(nodes: Sequence[ast.AST]) -> set[str]:
    """The names that these read."""
    return {each.id for node in nodes for each in ast.walk(node)
            if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Load)}


def read_first(body: Sequence[ast.stmt], defined: set[str]) -> set[str]:
    """The names that are read before they are certainly set; `defined` gains those that are set."""
    unset: set[str] = set()
    for line in body:
        if isinstance(line, ast.If):
            ways = [set(defined), set(defined)]
            unset |= reads([line.test]) - defined
            unset |= read_first(line.body, ways[0]) | read_first(line.orelse, ways[1])
            defined |= ways[0] & ways[1]
        elif isinstance(line, ast.For):
            unset |= (reads([line.iter]) - defined) | read_first(line.body, defined | stores([line.target]))
        elif isinstance(line, ast.AugAssign):
            unset |= (reads([line]) | stores([line])) - defined
            defined |= stores([line])
        else:
            unset |= reads([line]) - defined
            defined |= stores([line])
    return unset


def _start_numbers(scene: Scene, e: str) -> Any:
    """The numbers of an end's stages, with a `StartReading` where one is the reading at which the end starts."""
    shape, dt = getattr(structure_of(scene), e), scene.dt_ns / 1e9
    probes = []
    for shift in (0.0123, -0.0457):
        places = [x + shift * (i + 1) for i, x in enumerate(scene.vector(f"start_{e}", getattr(scene, f"start_{e}")))]
        numbers, = numbers_of(scene, {e: places})
        for stage in shape.stages:
            stage.numbers(scene, e, dt, places)  # which an encoder rounds
        probes.append((numbers, places))
    (one, at_one), (another, at_another) = probes

    def marked(a: Any, b: Any) -> Any:
        if isinstance(a, tuple):
            parts = [marked(x, y) for x, y in zip(a, b, strict=True)]
            return type(a)(*parts) if hasattr(a, "_fields") else tuple(parts)
        if a == b or (isnan(a) and isnan(b)):
            return a
        for i in range(scene.axes):
            if (a, b) == (at_one[i], at_another[i]):
                return StartReading(i)
        raise NotPrinted(f"{scene.name}, end {e}: a stage begins with a number that depends on where the end starts, "
                         "and is not its reading there, so no `init` can be printed for it")

    return record("Given", (e,))(marked(one, another))


def _has_start(value: Any) -> bool:
    return isinstance(value, StartReading) or (isinstance(value, tuple) and any(map(_has_start, value)))


def _without_starts(value: Any) -> Any:
    """The numbers of the parameters: a plain tuple of numbers that has a start is none of them."""
    if not _has_start(value):
        return value
    if hasattr(value, "_fields"):
        return type(value)(*map(_without_starts, value))
    if any(isinstance(each, StartReading) for each in value):
        return ()
    return tuple(map(_without_starts, value))


def _parameter(value: Any, printed: Value) -> Value:
    """Value of a parameter: its place in C, or parts, where one of them is a start."""
    has_place = isinstance(printed, Printed) and printed.type != NOTHING
    if not _has_start(value):
        return printed if has_place else Known(value)
    if isinstance(value, StartReading):
        return Known(value)
    parts = [_parameter(each, part(printed, i) if has_place else Known(each)) for i, each in enumerate(value)]
    return TupleParts(tuple(parts), type(value) if hasattr(value, "_fields") else None)


def _inputs(scene: Scene, e: str, program: Program) -> dict[str, Any]:
    """The types of a `LiveTick`."""
    n = scene.axes
    axis = Array(DOUBLE, n, bare=True)
    return {"k": INT, "x": axis, "v": axis, "touch": axis, "got": BOOL, "newest": DOUBLE,
            "rx": Array(_message(scene, program, mine="s" if e == "m" else "m"), n, bare=True),
            "heard": Array(_integrals(program), n, bare=True), "gain": DOUBLE, "held": axis, "since": INT,
            "clutch": DOUBLE, "present": DOUBLE, "scale": DOUBLE, "wants": DOUBLE, "renewed": DOUBLE, "action": axis}


def _message(scene: Scene, program: Program, *, mine: str) -> Any:
    """The type of the messages that an end sends."""
    if scene.slave is None:
        return NOTHING
    of_class: Any = messages(scene.laws[0], scene.dt_ns / 1e9)[mine == "s"]
    return program.types.tuple_of([DOUBLE] * len(of_class._fields), of_class)


def _integrals(program: Program) -> Any:
    return program.types.tuple_of([DOUBLE] * 3, Integrals)


def _flat_columns(scene: Scene, e: str, sensor: bool | None) -> tuple[str, ...]:
    axes = scene.axis_names if scene.axes > 1 else ("",)
    return tuple([name.replace("@", f"_{axis}" if axis else "") for name in columns(scene, e, sensor)
                  for axis in (axes if "@" in name else ("",))])


def record_line(types: Types, name: str, kind: Any, what: str) -> str:
    """The declaration of one field."""
    size = f"[{kind.count}]" if isinstance(kind, Array) and kind.bare else ""
    of = kind.of if size else kind
    return f"    {types.c(of)} {name}{size};{comment(what)}"
