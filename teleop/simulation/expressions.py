"""Expressions of the tick, of which a part is known when the loop of one structure is made; see `specialise`."""

from __future__ import annotations

import ast
import builtins
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache, reduce
from operator import eq, gt, is_, is_not, lt, ne
from pathlib import Path
from types import FunctionType, MethodType, ModuleType
from typing import Any, Generic, NamedTuple, TypeVar

from teleop.simulation import masks
from teleop.stages.end import Record, declared

Location = tuple[int, int, int, int]
STRUCTURAL = (bool, int, str, tuple, frozenset, type(None))  # what a decision may compare
DECIDED: dict[type[ast.cmpop], Callable[[Any, Any], bool]] = {
    ast.Eq: eq, ast.NotEq: ne, ast.Lt: lt, ast.Gt: gt, ast.Is: is_, ast.IsNot: is_not,
    ast.In: lambda one, all_of: one in all_of, ast.NotIn: lambda one, all_of: one not in all_of,
}


class NotSpecialised(Exception):
    """Why a function cannot be written out, with its file and line."""


class Known(NamedTuple):
    """A value that is known when the loop is made."""

    value: Any


Value = Known | ast.expr
Node = TypeVar("Node", bound=ast.AST)
Written = TypeVar("Written")  # what is known, or what is written for the rest


class CallFrame:
    """A function that is being written out: what its names stand for."""

    def __init__(self, function: FunctionType, suffix: str = "", place: Location | None = None) -> None:
        code = function.__code__
        self.function, self.suffix, self.place = function, suffix, place
        self.arguments = code.co_varnames[:code.co_argcount]
        self.known: dict[str, Known] = {}
        self.names: dict[str, ast.expr] = {}  # an argument's expression, a variable's name
        self.unrolled: list[bool] = []  # of the loops around a line: is it unrolled
        self.branches = 0  # conditions of numbers and loops around a line


@lru_cache(maxsize=64)
def functions_in(module: str, file: str) -> dict[tuple[str, int], ast.FunctionDef]:
    """The functions and methods of a module by name and first line."""
    loader: Any = sys.modules[module].__loader__
    try:
        source = loader.get_source(module) if hasattr(loader, "get_source") else Path(file).read_text()
    except OSError:
        source = None
    if source is None:
        raise NotSpecialised(f"{file} is not there to be read, so what {module} does cannot be written out")
    tree = ast.parse(source)
    bodies = [tree.body, *(each.body for each in tree.body if isinstance(each, ast.ClassDef))]
    return {(each.name, min([each.lineno, *(mark.lineno for mark in each.decorator_list)])): each
            for body in bodies for each in body if isinstance(each, ast.FunctionDef)}


class Evaluator(ABC, Generic[Written]):
    """A walk over the lines of one function, each by a method of its name: to write it out, or to print it as C."""

    scope: dict[str, Any]  # what names stand for
    line: int

    @abstractmethod
    def refused(self, why: str) -> Exception:
        """The refusal of the line at which the walk is."""

    @abstractmethod
    def unwritten(self, node: ast.AST) -> Exception:
        """The refusal of a node that has no method."""

    @abstractmethod
    def parts(self, value: Any) -> Sequence[Any]:
        """The parts of a tuple."""

    def body(self, lines: Sequence[ast.stmt]) -> Written | None:
        """Walk over these lines; what they return, or None if they go on."""
        for line in lines:
            self.line = line.lineno
            make: Callable[[Any], Written | None] | None = getattr(self, f"_{type(line).__name__}", None)
            if make is None or not isinstance(line, ast.stmt):
                raise self.unwritten(line)
            if (answer := make(line)) is not None:
                return answer
        return None

    def evaluate(self, node: ast.expr) -> Written:
        """Evaluate an expression: its known value, or what is written for it."""
        make: Callable[[Any], Written] | None = getattr(self, f"_{type(node).__name__}", None)
        if make is None:
            raise self.unwritten(node)
        return make(node)

    def _Constant(self, node: ast.Constant) -> Known:
        return Known(node.value)

    def around(self, function: FunctionType, word: str) -> Known:
        """Value of a name of a function's module, or of Python's own."""
        if word in function.__globals__:
            return Known(function.__globals__[word])
        if hasattr(builtins, word):
            return Known(getattr(builtins, word))
        raise self.refused(f"{word} is not known")

    def turns(self, entry: ast.expr, loops: list[ast.comprehension]) -> Iterator[Written]:
        """The entries of a comprehension over what is known."""
        if not loops:
            yield self.evaluate(entry)
            return
        over, around = self.parts(self.evaluate(loops[0].iter)), self.scope
        for each in over:
            self.scope = {**around}
            self.bind(loops[0].target, each)
            tests = [self.evaluate(test) for test in loops[0].ifs]
            if not all(isinstance(test, Known) for test in tests):
                raise self.refused("the condition of a comprehension is known beforehand")
            if all(getattr(test, "value", False) for test in tests):
                yield from self.turns(entry, loops[1:])
        self.scope = around

    def bind(self, target: ast.expr, value: Any) -> None:
        """Let names stand for a value."""
        if isinstance(target, ast.Name):
            self.scope[target.id] = value
            return
        if not isinstance(target, ast.Tuple):
            raise self.refused(f"{ast.unparse(target)} cannot stand for what is known beforehand")
        for each, one in zip(target.elts, self.parts(value), strict=True):
            self.bind(each, one)


class Expressions(Evaluator[Value]):
    """The expressions of one function that is being made, and the functions that they call."""

    def __init__(self, entry: FunctionType, engine: str = "plain") -> None:
        self.engine = engine
        self.masks: list[str] = []  # variables with the conditions of the branches around a line, of lanes
        self.uniform: set[str] = set()  # variables that are the same in all lanes
        self.tuple_classes: set[str] = set()  # names of a scene's classes of messages and states
        self.entry = CallFrame(entry)
        self.file = entry.__code__.co_filename
        self.frames = [self.entry]
        self.out: list[ast.stmt] = []
        self.names: dict[str, Any] = {}  # around the function
        self.fields: dict[str, tuple[int, str]] = {}  # variable -> the record's field that it is
        self.taken = set(entry.__code__.co_varnames)
        self.assigned = set(self.entry.arguments)  # variables that have a value by now, but for those of one tick
        self.passed: set[str] = set()  # those of one tick
        self.line = entry.__code__.co_firstlineno
        self.whole: ast.expr | None = None  # the expression that is all of a statement's value

    @property
    def frame(self) -> CallFrame:
        """The function whose lines are being written."""
        return self.frames[-1]

    @property
    def scope(self) -> dict[str, Known]:
        """Known things by name, of the function that is being written."""
        return self.frame.known

    @scope.setter
    def scope(self, scope: dict[str, Known]) -> None:
        self.frame.known = scope

    def definition(self, function: FunctionType) -> ast.FunctionDef:
        """The lines of a function."""
        code = function.__code__
        result = functions_in(function.__module__, code.co_filename).get((code.co_name, code.co_firstlineno))
        if result is None:
            raise self.refused(f"{function.__qualname__} is not written in a module or a class")
        return result

    def refused(self, why: str) -> NotSpecialised:
        """The refusal of the line that is being written."""
        return NotSpecialised(f"{self.frame.function.__code__.co_filename}:{self.line}: {why}")

    def unwritten(self, node: ast.AST) -> NotSpecialised:
        text = f": {ast.unparse(node)}" if isinstance(node, ast.expr) else ""
        return self.refused(f"{type(node).__name__} is not for the tick{text}")

    def locate(self, made: Node, old: ast.AST) -> Node:
        """A new node in the place of an old one."""
        spot: Any = made
        spot.lineno, spot.col_offset, spot.end_lineno, spot.end_col_offset = self.frame.place or location(old)
        return made

    def name_node(self, word: str, old: ast.AST, context: ast.expr_context | None = None) -> ast.Name:
        """A name in the place of an old node."""
        return self.locate(ast.Name(word, context or ast.Load()), old)

    # Names

    def variable(self, record: Record, field: str) -> str:
        """The variable of a record's field."""
        word = record.word(field)
        if self.fields.setdefault(word, (id(record), field)) != (id(record), field):
            raise self.refused(f"two records have a field {field} whose variable would be {word}; rename one")
        if word in self.taken and word not in self.entry.arguments:
            raise self.refused(f"{word} is a field's variable and another's too; rename one")
        if declared(type(record))[field] in ("int", "bool"):
            self.uniform.add(word)
        return word

    def fresh(self, word: str) -> str:
        """A name for a variable of a function that is written out: no other has it."""
        base = f"{word}_{self.frame.suffix}" if self.frame.suffix else word
        result, n = base, 2
        while result in self.taken or result in self.fields or result in self.names:
            result, n = f"{base}_{n}", n + 1
        self.taken.add(result)
        return result

    def outer(self, word: str, thing: Any, old: ast.AST) -> ast.expr:
        """A name for something around the function."""
        base, n = word, 2
        while word in self.taken or self.names.get(word, thing) is not thing:
            word, n = f"{base}_{n}", n + 1
        self.names[word] = thing
        return self.name_node(word, old)

    def residual(self, value: Value, old: ast.AST, word: str = "") -> ast.expr:
        """The expression of a value in the function that is made; `word` is what it is called, if it has a name."""
        if isinstance(value, ast.expr):
            return value
        thing = value.value
        if isinstance(thing, Record):
            raise self.refused(f"{type(thing).__name__} {thing.suffix} escapes: it can be asked for its fields and "
                               "handed to functions that are written out, and nothing else")
        made: ast.expr
        if type(thing) in (tuple, list):
            made = ast.Tuple([self.residual(Known(each), old) for each in thing], ast.Load())
        elif isinstance(thing, bool | int | str | None) or (isinstance(thing, float) and thing - thing == 0.0):
            made = ast.Constant(thing)
        elif isinstance(thing, float):
            return self.outer(word or repr(thing).replace("-", "minus_"), thing, old)
        elif callable(thing):
            return self.outer(word or getattr(thing, "__name__", type(thing).__name__), thing, old)
        else:
            raise self.refused(f"{word or thing!r} is neither a number nor a function")
        return self.locate(made, old)

    # What expressions come to

    def residualize(self, node: ast.expr) -> ast.expr:
        """The expression itself."""
        return self.residual(self.evaluate(node), node, getattr(node, "id", getattr(node, "attr", "")))

    def _Name(self, node: ast.Name) -> Value:
        word, frame = node.id, self.frame
        if word in frame.known:
            return frame.known[word]
        if word in frame.names:
            result = frame.names[word]
            return self.name_node(result.id, node) if isinstance(result, ast.Name) else result
        if word in frame.function.__code__.co_varnames:
            if frame is not self.entry:
                raise self.refused(f"{word} is read before it is set")
            return self.name_node(word, node)
        return self.around(frame.function, word)

    def _Attribute(self, node: ast.Attribute) -> Value:
        inner = self.evaluate(node.value)
        if not isinstance(inner, Known):
            return self.locate(ast.Attribute(inner, node.attr, ast.Load()), node)
        thing, word = inner.value, node.attr
        if isinstance(thing, Record) and word not in vars(thing) and word in declared(type(thing)):
            return self.name_node(self.variable(thing, word), node)
        try:
            result = getattr(thing, word)
        except AttributeError:
            raise self.refused(f"{type(thing).__name__} has no {word}") from None
        if isinstance(thing, Record) and callable(result) and not isinstance(result, MethodType):
            if declared(type(thing)).get(word, "").endswith("tuple[Any, ...]]"):
                self.tuple_classes.add(thing.word(word))
            return self.outer(thing.word(word), result, node)
        return Known(result)

    def _Subscript(self, node: ast.Subscript) -> Value:
        inner, at = self.evaluate(node.value), self.evaluate(node.slice)
        if isinstance(inner, Known) and isinstance(at, Known):
            return Known(inner.value[at.value])
        made = ast.Subscript(self.residual(inner, node), self.residual(at, node), ast.Load())
        return self.locate(made, node)

    def _Slice(self, node: ast.Slice) -> Value:
        parts = [None if each is None else self.residualize(each) for each in (node.lower, node.upper, node.step)]
        return self.locate(ast.Slice(*parts), node)

    def _UnaryOp(self, node: ast.UnaryOp) -> Value:
        inner = self.evaluate(node.operand)
        if isinstance(inner, Known) and isinstance(node.op, ast.Not):
            return Known(not inner.value)
        if isinstance(node.op, ast.Not) and self.has_lanes(self.residual(inner, node)):
            return self.call(masks.invert, [self.residual(inner, node)], node)
        return self.locate(ast.UnaryOp(node.op, self.residual(inner, node)), node)

    def _BinOp(self, node: ast.BinOp) -> Value:
        return self.locate(ast.BinOp(self.residualize(node.left), node.op, self.residualize(node.right)), node)

    def _Compare(self, node: ast.Compare) -> Value:
        left, rights = self.evaluate(node.left), [self.evaluate(each) for each in node.comparators]
        decide = DECIDED.get(type(node.ops[0])) if len(rights) == 1 else None
        if decide is not None and isinstance(left, Known) and isinstance(left.value, STRUCTURAL) and isinstance(
                rights[0], Known) and isinstance(rights[0].value, STRUCTURAL):
            return Known(decide(left.value, rights[0].value))
        sides = [self.residual(each, node) for each in (left, *rights)]
        if len(node.ops) > 1 and any(map(self.has_lanes, sides)):
            return self.joined([self.locate(ast.Compare(a, [sign], [b]), node) for a, sign, b in zip(
                sides, node.ops, sides[1:], strict=False)], ast.And(), node)
        return self.locate(ast.Compare(sides[0], node.ops, sides[1:]), node)

    def _BoolOp(self, node: ast.BoolOp) -> Value:
        decides = isinstance(node.op, ast.Or)
        undecided: list[ast.expr] = []
        for each in node.values:
            value = self.evaluate(each)
            if not isinstance(value, Known):
                undecided.append(value)
            elif bool(value.value) is decides and not undecided:
                return value
            elif bool(value.value) is decides:
                undecided.append(self.residual(value, each))
                break
        if len(undecided) < 2:
            return undecided[0] if undecided else value
        return self.joined(undecided, node.op, node)

    def _IfExp(self, node: ast.IfExp) -> Value:
        test = self.evaluate(node.test)
        if isinstance(test, Known):
            return self.evaluate(node.body if test.value else node.orelse)
        if self.has_lanes(test):
            return self.call(masks.select, [test, self.residualize(node.body), self.residualize(node.orelse)], node)
        return self.locate(ast.IfExp(test, self.residualize(node.body), self.residualize(node.orelse)), node)

    # Conditions that several scenes side by side may answer each in its own way

    def has_lanes(self, value: ast.expr) -> bool:
        """True if the value may differ from lane to lane."""
        return self.engine == "vector" and not self.is_uniform(value)

    def is_uniform(self, value: ast.expr) -> bool:
        """True if the value is the same in all lanes: of constants, of what is declared int or bool, of `any_lane`."""
        if isinstance(value, ast.Call) and isinstance(value.func, ast.Name) and (
                self.names.get(value.func.id) is masks.any_lane):
            return True
        if isinstance(value, ast.Name):
            return value.id in self.uniform or (value.id in self.names and value.id not in self.fields)
        return all(self.is_uniform(each) for each in ast.iter_child_nodes(value) if isinstance(each, ast.expr))

    def joined(self, conditions: list[ast.expr], operator: ast.boolop, node: ast.AST) -> ast.expr:
        """Conditions joined by `and` or `or`; of lanes, masks by `&` or `|`."""
        if len(conditions) == 1:
            return conditions[0]
        if not any(map(self.has_lanes, conditions)):
            return self.locate(ast.BoolOp(operator, conditions), node)
        sign = ast.BitAnd() if isinstance(operator, ast.And) else ast.BitOr()
        return reduce(lambda a, b: self.locate(ast.BinOp(a, sign, b), node), conditions)

    def call(self, function: Callable[..., Any], parts: list[ast.expr], node: ast.AST) -> ast.expr:
        """A call of what an engine has an instruction for."""
        return self.locate(ast.Call(self.outer(function.__name__, function, node), parts, []), node)

    def _Yield(self, node: ast.Yield) -> Value:
        return self.locate(ast.Yield(None if node.value is None else self.residualize(node.value)), node)

    def _display(self, node: ast.Tuple | ast.List) -> Value:
        return self.together([one for each in node.elts for one in self.several(each)], node)

    def together(self, values: list[Value], node: ast.expr) -> Value:
        """Values side by side: known where all are, except for a list of numbers, which may change."""
        known = [each.value for each in values if isinstance(each, Known)]
        if known and len(known) == len(values) and (isinstance(node, ast.Tuple) or of_structure(known)):
            return Known(tuple(known))
        kind = ast.Tuple if isinstance(node, ast.Tuple) else ast.List
        return self.locate(kind([self.residual(each, node) for each in values], ast.Load()), node)

    _Tuple = _List = _display

    def several(self, node: ast.expr) -> list[Value]:
        """The values of an entry of a display or of a call: of one with a star as many as there are."""
        if not isinstance(node, ast.Starred):
            return [self.evaluate(node)]
        inner = self.evaluate(node.value)
        if isinstance(inner, Known):
            return [Known(each) for each in inner.value]
        if isinstance(inner, ast.Tuple | ast.List):
            return [*inner.elts]
        return [self.locate(ast.Starred(inner, ast.Load()), node)]

    def _ListComp(self, node: ast.ListComp | ast.GeneratorExp) -> Value:
        return self.together(list(self.turns(node.elt, node.generators)), node)

    _GeneratorExp = _ListComp

    def parts(self, value: Value) -> list[Known]:
        if not isinstance(value, Known):
            raise self.refused(f"a comprehension goes over what is known, not {ast.unparse(value)}")
        return [Known(each) for each in value.value]

    def bind(self, target: ast.expr, value: Known) -> None:
        if isinstance(target, ast.Name) and (target.id in self.frame.names or target.id in self.frame.known):
            raise self.refused(f"{target.id} stands for what is known when the loop is made, so it is set once")
        super().bind(target, value)


def of_structure(thing: object) -> bool:
    """True of what a name can stand for, False of a number that a variable holds."""
    if isinstance(thing, tuple | list):
        return any(map(of_structure, thing))
    return isinstance(thing, Record | ModuleType | FunctionType | MethodType | type)


def location(node: Any) -> Location:
    """Location of a node in its file."""
    return node.lineno, node.col_offset, node.end_lineno, node.end_col_offset

