"""Calls: of functions that are printed too, of those that C has a line for, and of classes of tuples."""

from __future__ import annotations

import ast
import math
import re
from contextlib import suppress
from dataclasses import is_dataclass
from functools import partial, reduce
from inspect import CO_VARARGS, CO_VARKEYWORDS
from types import FunctionType, MethodType
from typing import Any

from teleop.emit.expressions import CExpressions, bare
from teleop.emit.primitives import PRIMITIVES, REFUSED
from teleop.emit.types import BOOL, DOUBLE, INT, NOTHING, REALS, MethodOf, Printed, TupleParts, Value
from teleop.simulation.expressions import Known

FOLDED = (range, len, zip, enumerate, reversed, float, int, bool, abs, min, max, tuple, list)
ROWS = (zip, enumerate, reversed, range, list)


class Calls(CExpressions):
    """The calls of one function."""

    def _Call(self, node: ast.Call) -> Value:
        if isinstance(node.func, ast.Attribute) and node.func.attr == "_replace":
            return self.replaced(self.evaluate(node.func.value), node)
        function = self.evaluate(node.func)
        if function in (Known(all), Known(any)):
            is_any = function == Known(any)
            values = [*map(self._bool, self.parts(self.evaluate(node.args[0])))] or [Known(not is_any)]
            if isinstance(node.args[0], ast.GeneratorExp):
                return self.either(values, decides=is_any)
            return reduce(lambda a, b: self.both(a, b, "|" if is_any else "&"), values)
        arguments = [one for each in node.args for one in self.several(each)]
        keywords = {str(each.arg): self.evaluate(each.value) for each in node.keywords}
        if isinstance(function, MethodOf):
            return self.call(function.function, [function.first, *arguments], keywords)
        if not isinstance(function, Known):
            raise self.refused(f"{ast.unparse(node.func)} is no function")
        return self.apply(function.value, arguments, keywords)

    def replaced(self, value: Value, node: ast.Call) -> Value:
        """A NamedTuple with other values of some fields."""
        of_class = getattr(value if isinstance(value, TupleParts) else getattr(value, "type", None), "of_class", None)
        if of_class is None or not hasattr(of_class, "_fields"):
            raise self.refused(f"{ast.unparse(node)} is of no NamedTuple")
        fields = dict(zip(of_class._fields, self.parts(value), strict=True))
        fields.update({str(each.arg): self.evaluate(each.value) for each in node.keywords})
        return self.made_of(TupleParts(tuple(fields.values()), of_class), value)

    def apply(self, function: Any, arguments: list[Value], keywords: dict[str, Value]) -> Value:
        """A call of a thing of Python."""
        if function in REFUSED:
            raise self.refused(REFUSED[function])
        if isinstance(function, type) and issubclass(function, tuple) and hasattr(function, "_fields"):
            kind: Any = function
            rest = [keywords.get(name, Known(kind._field_defaults.get(name))) for name in kind._fields[len(arguments):]]
            return TupleParts((*arguments, *rest), function)
        if isinstance(function, partial) and not function.keywords:
            return self.apply(function.func, [*map(Known, function.args), *arguments], keywords)
        if isinstance(function, FunctionType):
            return self.call(function, arguments, keywords)
        if keywords and function is not zip:
            raise self.refused(f"{no_line(function)} has no line in C with {', '.join(keywords)}=")
        if all(isinstance(each, Known) for each in arguments) and (function in FOLDED or function in PRIMITIVES):
            with suppress(ArithmeticError, ValueError):  # at every tick, and so in C
                made = function(*[each.value for each in arguments])
                return Known(tuple(made) if function in ROWS else made)
        if function in PRIMITIVES:
            return self.primitive(function, arguments)
        make = getattr(self, f"_{getattr(function, '__name__', '')}", None)
        if make is None or getattr(function, "__module__", "") != "builtins":
            raise self.refused(f"{no_line(function)} has no line in C")
        result: Value = make(*arguments)
        return result

    def primitive(self, function: Any, arguments: list[Value]) -> Printed:
        """A call of a function that C has a line for."""
        primitive = PRIMITIVES[function]
        if len(arguments) != len({*re.findall(r"{(\d)}", primitive.text)}):
            raise self.refused(f"{no_line(function)} has no line in C with {len(arguments)} arguments")
        if primitive.helper:
            self.program.helpers.add(primitive.helper)
        self.faults = self.faults or primitive.faults
        self.program.libm.update([primitive.libm] if primitive.libm else [])
        texts = [bare(self.to(each, primitive.takes)) for each in arguments]
        return Printed(primitive.gives, primitive.text.format(*texts).replace("@", self.program.suffix))

    # Python's own functions

    def _min(self, *values: Value) -> Value:
        return self.extreme(min, [*values])

    def _max(self, *values: Value) -> Value:
        return self.extreme(max, [*values])

    def _tuple(self, value: Value) -> Value:
        return TupleParts(self.parts(value))

    _list = _tuple

    def _len(self, value: Value) -> Value:
        return self.made_of(Known(len(self.parts(value))), value)

    def _zip(self, *values: Value) -> Value:
        return TupleParts(tuple([TupleParts(row) for row in zip(*map(self.parts, values), strict=False)]))

    def _enumerate(self, value: Value, *start: Value) -> Value:
        first = start[0].value if start else 0
        return self._zip(Known(range(first, first + len(self.parts(value)))), value)

    def _reversed(self, value: Value) -> Value:
        return TupleParts(self.parts(value)[::-1])

    def _abs(self, value: Value) -> Value:
        printed = self.whole(value)
        if printed.type in REALS:
            return Printed(printed.type, f"fabs{self.program.suffix}({bare(printed.text)})")
        return self.extreme(max, [printed, self.binary(ast.Sub(), Known(0), printed)])

    def _bool(self, value: Value) -> Value:
        return Known(bool(value.value)) if isinstance(value, Known) else Printed(BOOL, self.truth(value))

    def _float(self, value: Value) -> Value:
        return Printed(DOUBLE, self.to(value, DOUBLE))

    def _int(self, value: Value) -> Value:
        printed = self.whole(value)
        if printed.type not in REALS:
            return Printed(INT, self.to(printed, INT))
        return self.primitive(math.trunc, [printed])

    def extreme(self, function: Any, arguments: list[Value]) -> Value:
        """The least or the greatest, asked from left to right as Python does."""
        values = self.parts(arguments[0]) if len(arguments) == 1 else arguments
        made = values[0]
        for each in values[1:]:
            if isinstance(made, Known) and isinstance(each, Known):
                made = Known(function(made.value, each.value))
                continue
            joined = self.joined(made, each)
            kind = INT if joined == BOOL else joined
            name = ("py_imin" if kind == INT else "py_min").replace("min", function.__name__)
            made = Printed(kind, self.helper(name, bare(self.to(made, kind)), bare(self.to(each, kind))))
        return made

    def call(self, function: FunctionType, arguments: list[Value], keywords: dict[str, Value]) -> Value:
        """A call of a function that is printed too."""
        code, defaults = function.__code__, function.__defaults__ or ()
        names, values = code.co_varnames[:code.co_argcount], [*arguments]
        stars = CO_VARARGS | CO_VARKEYWORDS
        only_names = bool(keywords or code.co_kwonlyargcount)
        if code.co_flags & stars == CO_VARARGS and not only_names and len(values) >= len(names):
            values, stars = [*values[:len(names)], TupleParts(tuple(values[len(names):]))], 0
            names = code.co_varnames[:len(values)]
            if (answer := self.program.inlined(function, values, self)) is not None:
                return answer
        if len(values) > len(names) or code.co_flags & stars or code.co_kwonlyargcount:
            raise self.refused(f"{function.__qualname__} has starred arguments or ones by name alone, or too many")
        for i, name in enumerate(names[len(values):], len(values)):
            back = len(names) - i
            if name not in keywords and back > len(defaults):
                raise self.refused(f"{function.__qualname__} lacks {name}")
            values.append(keywords[name] if name in keywords else Known(defaults[-back]))
        settled = [self.argument(each) for each in values]
        made = self.program.function(function, settled, self)
        self.faults = self.faults or made.faults
        if made.gives == NOTHING:
            return TupleParts(())
        passed = [each for each in settled if isinstance(each, Printed) and each.type != NOTHING]
        texts = [bare(self.to(each, kind)) for each, kind in zip(passed, made.takes, strict=True)]
        return Printed(made.gives, f"{made.name}({', '.join([*texts, *['fault'] * made.faults])})")

    def argument(self, value: Value) -> Value:
        """An argument as a function is printed for: numbers are passed, texts and functions are known."""
        if isinstance(value, TupleParts) or (isinstance(value, Known) and (
                isinstance(value.value, float) or (isinstance(value.value, tuple) and value.value))):
            return self.whole(value)
        return value


def no_line(function: Any) -> str:
    """Name a thing of Python in a refusal."""
    if isinstance(function, type) and is_dataclass(function):
        return f"{function.__name__}, which is made at a tick and is no NamedTuple,"
    if isinstance(function, MethodType):
        return f"{function.__qualname__}, which is bound to an object,"
    name = f"{getattr(function, '__module__', '') or ''}.{getattr(function, '__qualname__', function)}"
    return name.lstrip(".").removeprefix("builtins.")
