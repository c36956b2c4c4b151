"""Expressions of Python as expressions of C.

Each is evaluated to a `Known` thing of Python, to a `Printed` expression, or to `TupleParts`, of which a record of C is
made where one is needed. Arithmetic keeps its order and its brackets. What cannot be kept is refused with file
and line, `NotPrinted`.
"""

from __future__ import annotations

import ast
import operator
import re
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import reduce
from inspect import getattr_static
from itertools import groupby
from types import FunctionType
from typing import Any

from teleop.emit.primitives import COMPARISONS, OF_CONSTANTS, SIGNS
from teleop.emit.types import (
    BOOL,
    DOUBLE,
    INT,
    KEYWORDS,
    LIST,
    MIXED,
    NOTHING,
    REALS,
    SCALARS,
    WHOLE,
    Array,
    MethodOf,
    NotPrinted,
    Printed,
    Struct,
    TupleParts,
    Value,
    member,
    part,
    parts_of,
)
from teleop.simulation.expressions import Evaluator, Known

LONG = 8  # parts of a tuple beyond which they are copied by a loop
NUMBERS = (bool, int, float)
RESERVED = frozenset((
    "s", "p", "in", "out", "fault", "y0", "y1", "yn", "j0", "j1", "jn", "gamma", "div", "exp", "log", "sin", "cos",
    "fabs", "trunc", "int64_t", "NAN", "INFINITY"))
OF_ONE: dict[type[ast.unaryop], Callable[[Any], Any]] = {
    ast.Not: operator.not_, ast.USub: operator.neg, ast.UAdd: operator.pos}
WORDS = {"JoinedStr": "an f-string", "Lambda": "a lambda within a function", "Dict": "a dict", "Set": "a set",
         "DictComp": "a dict", "SetComp": "a set", "FunctionDef": "a function within a function", "Try": "`try`",
         "With": "`with`", "Raise": "`raise`", "Global": "`global`", "Assert": "`assert`", "Delete": "`del`",
         "NamedExpr": "`:=`", "Yield": "`yield`", "Import": "an import", "ImportFrom": "an import", "Match": "`match`"}


def c_word(name: str) -> str:
    """The name of a variable in C, which no other variable has."""
    is_taken = name.rstrip("_") in RESERVED | KEYWORDS or name.startswith(("py_", "vec_"))  # helpers are called so
    return f"{name}_" if is_taken else name


def texts_of(value: Value) -> Iterator[str]:
    """The expressions that a value is made of."""
    if isinstance(value, TupleParts):
        for each in value.values:
            yield from texts_of(each)
    elif isinstance(value, Printed):
        yield value.text


def bare(text: str) -> str:
    """An expression without the brackets around all of it."""
    if not (text.startswith("(") and text.endswith(")")):
        return text
    depth = 0
    for i, letter in enumerate(text):
        depth += (letter == "(") - (letter == ")")
        if depth == 0 and i < len(text) - 1:
            return text
    return text[1:-1]


class CExpressions(Evaluator[Value]):
    """The expressions of one function; `program` has the types, the helpers and the functions that it calls."""

    def __init__(self, program: Any, function: Any) -> None:
        self.program, self.types, self.function = program, program.types, function
        self.file, self.line = function.__code__.co_filename, function.__code__.co_firstlineno
        self.scope: dict[str, Value] = {}  # what each name stands for
        self.names: Mapping[str, Any] = {}  # what generated lines find by name, in place of the function's own globals
        self.faults = False

    def refused(self, why: str) -> NotPrinted:
        """The refusal of the line that is being printed."""
        return NotPrinted(f"{self.file}:{self.line}: {self.function.__qualname__}: {why}")

    def unwritten(self, node: ast.AST) -> NotPrinted:
        kind = type(node).__name__
        return self.refused(f"{WORDS.get(kind, kind)} has no line in C: {ast.unparse(node)[:60]!r}")

    # Values

    def whole(self, value: Value) -> Printed:
        """A value as one expression of C."""
        if isinstance(value, Printed):
            return value
        if isinstance(value, Known):
            if isinstance(value.value, NUMBERS):
                kind = self.types.of_value(value.value)
                return Printed(kind, self.number(value.value, kind), fixed=True)
            if isinstance(value.value, tuple | list):
                of_class = type(value.value) if hasattr(value.value, "_fields") else None
                return self.whole(TupleParts(tuple(map(Known, value.value)), of_class))
            if value.value is None:
                return Printed(NOTHING, "")
            raise self.refused(f"{value.value!r:.60} is no number")
        if not isinstance(value, TupleParts):
            raise self.refused("a function is no number")
        parts = [self.whole(each) for each in value.values]
        kind = self.types.tuple_of([each.type for each in parts], value.of_class)
        return self.record(parts, kind)

    def number(self, value: Any, kind: Any) -> str:
        """A number as C has it in an expression."""
        try:
            text: str = self.types.literal(value, kind)
        except NotPrinted as why:
            raise self.refused(str(why)) from None
        return f"({text})" if text.startswith("-") else text

    def record(self, parts: Sequence[Value], kind: Any) -> Printed:
        """A record of C of these parts."""
        if kind == NOTHING:
            return Printed(NOTHING, "")
        texts = [self.to(each, of) for each, of in zip(parts, parts_of(kind), strict=True) if of != NOTHING]
        if isinstance(kind, Array) and kind.count > LONG:
            return Printed(kind, self.gathered(texts, kind))
        inner = ", ".join(map(bare, texts)) or "0"
        return Printed(kind, f"({self.types.c(kind)}){{{{{inner}}}}}" if isinstance(kind, Array)
                       else f"({self.types.c(kind)}){{{inner}}}")

    def gathered(self, texts: list[str], kind: Array) -> str:
        """A call of a function that copies a long tuple together, by loops where parts follow each other."""
        def key(pair: tuple[int, str]) -> tuple[str, int | None]:
            match = re.fullmatch(r"([\w.>\-]+)\.at\[(\d+)\]", pair[1])
            return (match[1], int(match[2]) - pair[0]) if match else (pair[1], None)

        arguments: dict[str, tuple[str, str]] = {}
        lines, n = [], 0
        for (source, shift), group in groupby(enumerate(texts), key):
            count, array = len(list(group)), shift is not None
            of = self.types.c(kind.of)
            if array:
                of = self.types.c(self.program.arrays[source])
            word = arguments.setdefault(source, (f"a{len(arguments)}", of))[0]
            first = n + (shift or 0)
            index = f"i + {first - n}" if first != n else "i"
            part_of = f"{word}.at[{index}]" if array else word
            lines.append(f"    for (i = {n}; i < {n + count}; i++) r.at[i] = {part_of};")
            n += count
        name = self.program.helper_function(
            f"gather_{kind.name}", self.types.c(kind), [f"{of} {word}" for word, of in arguments.values()],
            [f"    {self.types.c(kind)} r;", "    int i;", *lines, "    return r;"])
        return f"{name}({', '.join(map(bare, arguments))})"

    def to(self, value: Value, kind: Any) -> str:
        """A value as an expression of this type."""
        if isinstance(value, Known) and isinstance(value.value, NUMBERS) and kind in SCALARS:
            return self.number(value.value, kind)
        is_record = isinstance(kind, Struct | Array)
        if isinstance(value, TupleParts) and is_record and len(value.values) == len(parts_of(kind)):
            return self.record(value.values, kind).text
        printed = self.whole(value)
        if printed.type is kind or printed.type == kind:
            return printed.text
        if kind == BOOL:
            return self.truth(printed)
        if printed.type in SCALARS and kind in SCALARS:
            if printed.type in REALS and kind in REALS:
                return printed.text
            if printed.type in REALS:
                return self.helper("py_count", bare(printed.text), faults=True)
            return f"({self.types.c(kind)}){printed.text}"
        if isinstance(printed.type, Struct | Array) and is_record and len(
                parts_of(printed.type)) == len(parts_of(kind)):
            inner = Printed(printed.type, "a")
            self.program.arrays["a"] = printed.type
            made = self.record([part(inner, i) for i in range(len(parts_of(kind)))], kind)
            name = self.program.helper_function(f"as_{kind}", self.types.c(kind), [f"{self.types.c(printed.type)} a"],
                                                [f"    return {made.text};"])
            return f"{name}({printed.text})"
        raise self.refused(f"a {printed.type} stands where a {kind} is needed")

    def truth(self, value: Value) -> str:
        """A value as a condition."""
        printed = self.whole(value)
        if printed.type == BOOL:
            return printed.text
        if printed.type in SCALARS:
            return f"({printed.text} != {self.number(0, printed.type)})"
        raise self.refused("a tuple is no condition in C; compare numbers")

    def parts(self, value: Value) -> tuple[Value, ...]:
        """The parts of a tuple."""
        if isinstance(value, Known):
            return tuple(map(Known, value.value))
        if isinstance(value, TupleParts):
            return value.values
        if isinstance(value, Printed) and isinstance(value.type, Struct | Array):
            if isinstance(value.type, Array) and not value.type.bare:
                self.program.arrays[value.text] = value.type
            return tuple([part(value, i) for i in range(len(parts_of(value.type)))])
        if isinstance(value, Printed) and value.type == NOTHING:
            return ()
        raise self.refused("a number has no parts")

    def helper(self, name: str, *arguments: str, faults: bool = False) -> str:
        """A call of a helper."""
        self.program.helpers.add(name)
        self.faults = self.faults or faults
        return f"{name}({', '.join([*arguments, *['fault'] * faults])})"

    def joined(self, *values: Value) -> Any:
        """The type that holds all of these."""
        kind: Any = None
        for each in values:
            printed = self.whole(each)
            joined = self.types.join(kind, printed.type)
            if joined is None:
                raise self.refused(f"a value is once {kind} and once {printed.type}")
            kind = joined
        return kind

    @abstractmethod
    def apply(self, function: Any, arguments: list[Value], keywords: dict[str, Value]) -> Value:
        """A call of a thing of Python: see `teleop.emit.calls`."""

    # Names, fields, parts

    def _Name(self, node: ast.Name) -> Value:
        word, function = node.id, self.function
        if word in self.scope:
            return self.scope[word]
        if word in self.names:
            return Known(self.names[word])
        if word in function.__code__.co_varnames:
            raise self.refused(f"{word} is not set on every way to here; set it before the `if`")
        if word in function.__code__.co_freevars:
            raise self.refused(f"{word} is a variable of the function around; pass it as an argument")
        return self.around(function, word)

    def _Attribute(self, node: ast.Attribute) -> Value:
        inner, word = self.evaluate(node.value), node.attr
        if isinstance(inner, Known):
            return Known(getattr(inner.value, word))
        of_class = inner.of_class if isinstance(inner, TupleParts) else getattr(inner.type, "of_class", None)
        if isinstance(inner, TupleParts) and of_class is not None and word in of_class._fields:
            return inner.values[of_class._fields.index(word)]
        if isinstance(inner, Printed) and isinstance(inner.type, Struct) and word in inner.type.members:
            return member(inner, word)
        attribute = getattr_static(of_class, word, None)
        if isinstance(attribute, property):
            return self.apply(attribute.fget, [inner], {})
        if isinstance(attribute, FunctionType):
            return MethodOf(attribute, inner)
        if attribute is None:
            raise self.refused(f"{ast.unparse(node)} is no field of a record")
        return Known(getattr(of_class, word))

    def _Subscript(self, node: ast.Subscript) -> Value:
        inner = self.evaluate(node.value)
        if isinstance(node.slice, ast.Slice):
            ends = [None if each is None else self.evaluate(each)
                    for each in (node.slice.lower, node.slice.upper, node.slice.step)]
            if not all(each is None or isinstance(each, Known) for each in ends):
                raise self.refused(f"{ast.unparse(node)} has an end that is not known when it is printed")
            made = TupleParts(self.parts(inner)[slice(*[None if each is None else each.value for each in ends])])
            return self.made_of(made, inner)
        at = self.evaluate(node.slice)
        if isinstance(inner, Known) and isinstance(at, Known):
            return Known(inner.value[at.value])
        if isinstance(at, Known) and getattr(inner, "type", None) != LIST:
            return self.made_of(self.parts(inner)[at.value], inner)
        printed = self.whole(inner)
        if printed.type == LIST:
            return Printed(DOUBLE, f"{printed.text}[{bare(self.to(at, INT))}]")
        if not isinstance(printed.type, Array) or printed.type.bare:
            raise self.refused(f"{ast.unparse(node)} takes a part of unlike ones by a number that is not known")
        index = self.helper("py_index", bare(self.to(at, INT)), str(printed.type.count), faults=True)
        return Printed(printed.type.of, f"{printed.text}.at[{index}]")

    def made_of(self, value: Value, *of: Value) -> Value:
        """A value that is made of these, refused where what it leaves out may fault."""
        text = " ".join(texts_of(value))
        for each in of:
            if any("fault" in one and one not in text for one in texts_of(each)):
                raise self.refused("what may be a division by zero is made and not read; leave it out")
        return value

    def _Tuple(self, node: ast.Tuple) -> Value:
        return TupleParts(tuple([one for each in node.elts for one in self.several(each)]))

    def _List(self, node: ast.List) -> Value:
        raise self.refused(f"a list has no line in C; write a tuple: {ast.unparse(node)[:60]}")

    def several(self, node: ast.expr) -> list[Value]:
        """The values of an entry of a tuple or of a call."""
        return [*self.parts(self.evaluate(node.value))] if isinstance(node, ast.Starred) else [self.evaluate(node)]

    def _GeneratorExp(self, node: ast.GeneratorExp | ast.ListComp) -> Value:
        return TupleParts(tuple(self.turns(node.elt, node.generators)))

    _ListComp = _GeneratorExp

    # Operators

    def _UnaryOp(self, node: ast.UnaryOp) -> Value:
        inner = self.evaluate(node.operand)
        if isinstance(inner, Known) and isinstance(inner.value, NUMBERS) and type(node.op) in OF_ONE:
            return Known(OF_ONE[type(node.op)](inner.value))
        if isinstance(node.op, ast.Not):
            return Printed(BOOL, f"(!{self.truth(inner)})")
        printed = self.whole(inner)
        if isinstance(node.op, ast.Invert) or printed.type not in SCALARS:
            raise self.refused(f"{ast.unparse(node)} has no line in C")
        kind = self.types.join(printed.type, INT) if printed.type != DOUBLE else DOUBLE
        if isinstance(node.op, ast.USub) and kind in (WHOLE, MIXED):
            return self.binary(ast.Mult(), Known(-1), printed)
        sign = "-" if isinstance(node.op, ast.USub) else "+"
        return Printed(kind, f"({sign}{self.to(printed, kind)})", printed.fixed)

    def _BinOp(self, node: ast.BinOp) -> Value:
        return self.binary(node.op, self.evaluate(node.left), self.evaluate(node.right))

    def binary(self, op: ast.operator, left: Value, right: Value) -> Value:
        """Two values with an operator between them."""
        if isinstance(left, Known) and isinstance(right, Known):
            with suppress(ArithmeticError, KeyError):  # at every tick, and so in C
                return Known(OF_CONSTANTS[type(op)](left.value, right.value))
        if not all(self.is_number(each) for each in (left, right)):
            if isinstance(op, ast.Add):
                return TupleParts(self.parts(left) + self.parts(right))
            if isinstance(op, ast.Mult) and isinstance(right, Known):
                return TupleParts(self.parts(left) * right.value)
            raise self.refused(f"tuples with {type(op).__name__} between them have no line in C")
        kind = self.answers(op, left, right)
        if type(op) in SIGNS:
            text = f"{self.to(left, kind)} {SIGNS[type(op)]} {self.to(right, kind)}"
            return Printed(kind, self.helper("py_whole", text, faults=True) if kind == WHOLE else f"({text})")
        if isinstance(op, ast.Div):
            a, b = self.to(left, DOUBLE), self.to(right, DOUBLE)
            if isinstance(right, Known) and right.value != 0:
                return Printed(DOUBLE, f"({a} / {b})")
            return Printed(DOUBLE, self.helper("py_div", bare(a), bare(b), faults=True))
        if isinstance(op, ast.Mod):
            rest = self.helper("py_imod" if kind == INT else "py_mod", bare(self.to(left, kind)),
                               bare(self.to(right, kind)), faults=True)
            return Printed(kind, self.helper("py_whole", rest, faults=True) if kind == WHOLE else rest)
        if isinstance(op, ast.BitAnd | ast.BitOr) and self.joined(left, right) == BOOL:
            return self.both(left, right, "&" if isinstance(op, ast.BitAnd) else "|")
        if isinstance(op, ast.FloorDiv) and kind == INT:
            if right == Known(1):
                return left
            a, b = bare(self.to(left, INT)), bare(self.to(right, INT))
            return Printed(INT, self.helper("py_idiv", a, b, faults=True))
        if isinstance(op, ast.Pow) and self.program.powers and kind != INT:
            base, power = (bare(self.to(each, DOUBLE)) for each in (left, right))
            return Printed(DOUBLE, self.helper("py_libm", f"pow({base}, {power})", base, faults=True))
        instead = {ast.Pow: "`**` is rounded otherwise from one libm to the next; write x * x",
                   ast.FloorDiv: "`//` has no line in C; write floor(a / b)"}
        raise self.refused(instead.get(type(op), f"{type(op).__name__} has no line in C"))

    def answers(self, op: ast.operator, left: Value, right: Value) -> Any:
        """The type of two numbers with an operator between them."""
        kinds = [self.whole(each).type for each in (left, right)]
        kind = DOUBLE if DOUBLE in kinds else reduce(self.types.join, kinds, INT)
        signs = [right] if isinstance(op, ast.Mod) else [left, right] if isinstance(op, ast.Mult) else []
        if kind == MIXED and signs and not any(isinstance(each, Known) and each.value > 0 for each in signs):
            raise self.refused("the sign of a 0 that is once a whole number and once a float; write 0.0")
        return kind

    def both(self, left: Value, right: Value, sign: str) -> Printed:
        """Two truths with & or | between them: unlike `and` and `or`, they are both worked out, with their faults."""
        return Printed(BOOL, f"({self.truth(left)} {sign} {self.truth(right)})")

    def is_number(self, value: Value) -> bool:
        """True of a number, False of a tuple."""
        return isinstance(value.value, NUMBERS) if isinstance(value, Known) else (
            isinstance(value, Printed) and value.type in SCALARS)

    def _Compare(self, node: ast.Compare) -> Value:
        values = [self.evaluate(each) for each in (node.left, *node.comparators)]
        made: list[Value] = []
        for op, a, b in zip(node.ops, values, values[1:], strict=False):
            if isinstance(op, ast.Is | ast.IsNot):
                same = isinstance(a, Known) and isinstance(b, Known) and a.value is b.value
                made.append(Known(same is isinstance(op, ast.Is)))
            elif type(op) not in COMPARISONS:
                if not (isinstance(a, Known) and isinstance(b, Known)):
                    raise self.refused(f"{ast.unparse(node)} has no line in C; compare with == and `or`")
                made.append(Known((a.value in b.value) is isinstance(op, ast.In)))
            elif isinstance(a, Known) and isinstance(b, Known):
                made.append(Known(COMPARISONS[type(op)][1](a.value, b.value)))
            else:
                if not (self.is_number(a) and self.is_number(b)):
                    raise self.refused(f"{ast.unparse(node)} compares tuples, which has no line in C")
                kind = self.types.join(self.joined(a, b), INT)
                made.append(Printed(BOOL, f"({self.to(a, kind)} {COMPARISONS[type(op)][0]} {self.to(b, kind)})"))
        return self.either(made, decides=False)

    def _BoolOp(self, node: ast.BoolOp) -> Value:
        return self.either([self.evaluate(each) for each in node.values], decides=isinstance(node.op, ast.Or))

    def either(self, values: Sequence[Value], *, decides: bool) -> Value:
        """The first of these that is true, or of `and`, where False `decides`, false; else the last."""
        undecided: list[Value] = []
        for each in values:
            if isinstance(each, Known) and bool(each.value) is not decides and each is not values[-1]:
                continue
            undecided.append(each)
            if isinstance(each, Known) and bool(each.value) is decides:
                break
        if len(undecided) > 1 and undecided[-1] is values[-1] and isinstance(undecided[-1], Known) and isinstance(
                undecided[-1].value, bool) and undecided[-1].value is not decides and all(
                    isinstance(each, Printed) and each.type == BOOL for each in undecided[:-1]):
            undecided.pop()
        if len(undecided) == 1:
            return undecided[0]
        kind = self.joined(*undecided)
        if kind == BOOL:
            sign = " || " if decides else " && "
            return Printed(BOOL, f"({sign.join(self.truth(each) for each in undecided)})")
        text = self.to(undecided[-1], kind)
        for each in reversed(undecided[:-1]):
            here, rest = (self.to(each, kind), text) if decides else (text, self.to(each, kind))
            text = f"({self.truth(each)} ? {here} : {rest})"
        return Printed(kind, text)

    def _IfExp(self, node: ast.IfExp) -> Value:
        test = self.evaluate(node.test)
        if isinstance(test, Known):
            return self.evaluate(node.body if test.value else node.orelse)
        here, otherwise = self.evaluate(node.body), self.evaluate(node.orelse)
        kind = self.joined(here, otherwise)
        return Printed(kind, f"({self.truth(test)} ? {self.to(here, kind)} : {self.to(otherwise, kind)})")
