"""Partial evaluator: ordinary functions over records, written out as the one function of one structure.

A *record* is an object that the tick is written over: a run, an end, an axis, a stage. What a record is made with
(`has`, `axes`, a law's function) is known when the loop is made; what its class only declares (`x: float`) is a
variable of the loop. Of the entry function, and of each function that it hands a record to,

    if e.has.touch:             is decided, and the branch that is not taken is not there to be paid for,
    for a in e.axes:            is unrolled, and so are comprehensions over what is known,
    stage.read(run, e, k)       is written out where it is called,
    a.x = ...                   sets a local variable, x_m0.

getattr and setattr of known names are fields, all([...]) and reduce(add, [...]) become `and` and `+`. Everything else
stays as it is, in the order that it has: arithmetic is neither worked out nor rearranged. What cannot be kept so is
refused with a sentence, `NotSpecialised`: a record that escapes (into a list, or to a function without source), `break`
in a loop that is unrolled, a `return` that depends on a number, a name that a class does not have.

EVALUATOR.md beside this file shows a stage before and after.

Lines keep their numbers in the file of the entry function. A line from another file has the number of the call there,
since the code of a function names one file.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Sequence
from functools import reduce
from inspect import CO_GENERATOR
from operator import add
from types import FunctionType, MethodType
from typing import Any, NamedTuple

from teleop.errors import number_of
from teleop.simulation import masks
from teleop.simulation.expressions import CallFrame, Expressions, Known, NotSpecialised, Value, location, of_structure
from teleop.stages import memory
from teleop.stages.end import Record, declared

__all__ = ["NotSpecialised", "Specialised", "specialise"]


class Specialised(NamedTuple):
    """A function of one structure."""

    tree: ast.FunctionDef
    file: str
    names: dict[str, Any]  # what it finds by name around it


new: Any = tuple.__new__  # in plain Python twice as fast as the class
LONG = 12  # statements under a mask from which on it is first asked whether the mask is true of any lane


def specialise(function: Callable[..., Any], *records: Record, engine: str = "plain") -> Specialised:
    """`function` with these for its first arguments; the others stay its arguments. Raises `NotSpecialised`.

    `engine`: plain; c, which has instructions for `teleop.stages.memory`; vector, whose branches are masks.
    """
    assert isinstance(function, FunctionType)
    made = _Writer(function, engine)
    return made.write(records)


class _Writer(Expressions):
    """Writer of one function."""

    def write(self, records: Sequence[Record]) -> Specialised:
        """The whole of it."""
        node = self.definition(self.entry.function)
        self.entry.known = {name: Known(one) for name, one in zip(self.entry.arguments, records, strict=False)}
        if records:
            self.uniform |= {name for name, kind in self.entry.function.__annotations__.items() if kind == "int"}
        self.body(self.returned_once(node.body) if self.engine == "vector" else node.body)
        rest = [ast.arg(name) for name in self.entry.arguments[len(records):]]
        made, = ast.parse(f"def {node.name}(): ...").body  # with the fields that this Python's functions have
        assert isinstance(made, ast.FunctionDef)
        made.args, made.body = ast.arguments([], rest, None, [], [], None, []), self.out
        for each in (made, *rest):
            self.locate(each, node)
        return Specialised(made, self.file, self.names)

    def returned_once(self, lines: Sequence[ast.stmt]) -> Sequence[ast.stmt]:
        """The same lines; if they return under an `if`, with a variable for what they return at the end."""
        if not any(isinstance(line, ast.If) and returns(line) for line in lines):
            return lines
        word = self.fresh("returned")
        self.entry.names[word] = self.name_node(word, lines[-1])

        def settled(lines: Sequence[ast.stmt]) -> list[ast.stmt]:
            for i, line in enumerate(lines):
                if isinstance(line, ast.Return):
                    value = line.value or self.locate(ast.Constant(None), line)
                    return [*lines[:i], self.locate(ast.Assign([self.name_node(word, line, ast.Store())], value), line)]
                if isinstance(line, ast.If) and returns(line):
                    rest = lines[i + 1:]
                    ways = [settled([*way, *rest]) for way in (line.body, line.orelse)]
                    return [*lines[:i], self.locate(ast.If(line.test, *ways), line)]
            return [*lines]

        return [*settled(lines), self.locate(ast.Return(self.name_node(word, lines[-1])), lines[-1])]

    # Statements

    def block(self, lines: Sequence[ast.stmt]) -> list[ast.stmt]:
        """Lines that depend on numbers: of a branch, or of a loop."""
        around, self.out = self.out, []
        self.frame.branches += 1
        if self.body(lines) is not None and (self.frame is not self.entry or self.masks):
            raise self.refused("a function that is written out may not return from a loop, or from an `if` of "
                               "numbers; return at its end")
        self.frame.branches -= 1
        made, self.out = self.out, around
        return made

    def emit(self, made: ast.stmt, old: ast.AST) -> None:
        """Append a line."""
        self.out.append(self.locate(made, old))

    def right_side(self, node: ast.expr) -> Value:
        """Evaluate the whole right side of a line, where a call may have lines of its own."""
        self.whole = node
        value = self.evaluate(node)
        self.whole = None
        return value

    def _Pass(self, line: ast.Pass) -> None:
        """Nothing."""

    def _Expr(self, line: ast.Expr) -> None:
        call = line.value
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "setattr":
            field = self.evaluate(call.args[1])
            assert isinstance(field, Known)
            target = ast.copy_location(ast.Attribute(call.args[0], field.value, ast.Store()), call)
            self.assign(target, self.right_side(call.args[2]), line)
        elif not isinstance(value := self.right_side(call), Known):
            self.emit(ast.Expr(value), line)

    def _Assign(self, line: ast.Assign) -> None:
        value = self.right_side(line.value)
        if len(line.targets) == 1:
            self.assign(line.targets[0], value, line)
        else:
            right = self.in_every_lane(self.residual(value, line), line)
            self.emit(ast.Assign([self.target(each) for each in line.targets], right), line)

    def _AnnAssign(self, line: ast.AnnAssign) -> None:
        if line.value is not None:
            self.assign(line.target, self.right_side(line.value), line)

    def _AugAssign(self, line: ast.AugAssign) -> None:
        value = self.residual(self.right_side(line.value), line)
        target: Any = self.target(line.target)
        self.emit(ast.AugAssign(target, line.op, value), line)

    def assign(self, target: ast.expr, value: Value, line: ast.stmt) -> None:
        """Assign a value to one target."""
        if isinstance(value, Known) and of_structure(value.value):
            if self.frame.branches:
                raise self.refused(f"{ast.unparse(target)} stands for what is known when the loop is made, so it "
                                   "cannot be set under a condition of numbers, or in a loop that stays one")
            self.bind(target, value)
            return
        right = self.residual(value, line)
        made = self.target(target)
        if isinstance(made, ast.Name) and made.id in self.fields and made.id in self.entry.arguments:
            if not isinstance(right, ast.Name) or right.id != made.id:
                raise self.refused(f"{made.id} is an argument and a field of the same name, so it cannot be set")
            return  # one variable is both
        if isinstance(made, ast.Name) and made.id in self.fields:
            if made.id not in self.uniform:
                right = self.in_every_lane(right, line)
        elif isinstance(made, ast.Name):
            (self.uniform.discard if self.masks or not self.is_uniform(right) else self.uniform.add)(made.id)
        self.emit(ast.Assign([made], right), line)

    def in_every_lane(self, value: ast.expr, line: ast.AST) -> ast.expr:
        """A constant of scenes side by side, so that its variable has lanes from the beginning."""
        names = [each for each in ast.walk(value) if isinstance(each, ast.Name) and each.id in self.uniform]
        truth = isinstance(value, ast.Compare) or (
            isinstance(value, ast.Constant) and type(value.value) not in (int, float))
        if self.engine != "vector" or names or truth or not self.is_uniform(value):
            return value
        return self.call(masks.broadcast, [value], line)

    def target(self, node: ast.expr) -> ast.expr:
        """Target of an assignment, as an expression of the function that is made."""
        made: ast.expr
        if isinstance(node, ast.Name):
            frame, word = self.frame, node.id
            if word in frame.known or (frame is not self.entry and word in frame.arguments):
                raise self.refused(f"{word} is an argument, or stands for what is known when the loop is made; set a "
                                   "name of its own")
            if frame is not self.entry and word not in frame.names:
                frame.names[word] = self.name_node(self.fresh(word), node)
            made = self.name_node(word if frame is self.entry else ast.unparse(frame.names[word]), node, ast.Store())
            self.assigned.add(made.id)
        elif isinstance(node, ast.Attribute):
            record = self.evaluate(node.value)
            if not isinstance(record, Known) or not isinstance(record.value, Record):
                raise self.refused(f"{ast.unparse(node)} is no field of a record, so it cannot be set")
            if node.attr in vars(record.value) or node.attr not in declared(type(record.value)):
                raise self.refused(f"{type(record.value).__name__} declares no variable {node.attr}")
            made = self.name_node(self.variable(record.value, node.attr), node, ast.Store())
            (self.passed if node.attr in record.value.passing else self.assigned).add(made.id)
        elif isinstance(node, ast.Tuple):
            made = ast.Tuple([self.target(each) for each in node.elts], ast.Store())
        elif isinstance(node, ast.Subscript):
            made = ast.Subscript(self.residualize(node.value), self.residualize(node.slice), ast.Store())
        else:
            raise self.refused(f"{ast.unparse(node)} cannot be set")
        return self.locate(made, node)

    def _If(self, line: ast.If) -> Value | None:
        test = self.right_side(line.test)
        if isinstance(test, Known):
            return self.body(line.body if test.value else line.orelse)
        if self.has_lanes(test):
            inverse = self.mask(self.call(masks.invert, [test], line), line) if line.orelse else ""
            self.under(self.mask(test, line), line.body, line)
            if line.orelse:
                self.under(inverse, line.orelse, line)
            return None
        self.emit(ast.If(test, self.block(line.body) or [self.locate(ast.Pass(), line)], self.block(line.orelse)), line)
        return None

    def _For(self, line: ast.For) -> None:
        over = self.evaluate(line.iter)
        if isinstance(over, Known):
            self.unroll(line, over.value)
        else:
            target = self.target(line.target)
            self.uniform.add(ast.unparse(target))
            self.emit(ast.For(target, over, self.turn(line.body), self.block(line.orelse)), line)

    def _While(self, line: ast.While) -> None:
        test = self.residual(self.evaluate(line.test), line)
        self.emit(ast.While(test, self.turn(line.body), self.block(line.orelse)), line)

    def mask(self, test: ast.expr, line: ast.AST) -> str:
        """A variable with a condition of lanes, and that of the branch around it."""
        made = self.fresh("mask")
        if self.masks:
            test = self.locate(ast.BinOp(self.name_node(self.masks[-1], line), ast.BitAnd(), test), line)
        self.emit(ast.Assign([self.name_node(made, line, ast.Store())], test), line)
        return made

    def under(self, mask: str, lines: Sequence[ast.stmt], line: ast.AST) -> None:
        """The lines of a branch of lanes: done in all, and chosen, so that elsewhere each variable stays as it was."""
        had = self.assigned | self.passed
        self.masks.append(mask)
        made = self.block(lines)
        self.masks.pop()
        stored = dict.fromkeys([each.id for one in made for each in ast.walk(one)
                                if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store)])
        saved = {word: self.fresh(f"{word}_was") for word in stored if word in had}
        around, self.out = self.out, []
        for word, was in saved.items():
            self.emit(ast.Assign([self.name_node(was, line, ast.Store())], self.name_node(word, line)), line)
        self.out += made
        for word, was in saved.items():
            parts: list[ast.expr] = [self.name_node(each, line) for each in (mask, word, was)]
            self.emit(ast.Assign([self.name_node(word, line, ast.Store())], self.call(masks.select, parts, line)), line)
        made, self.out = self.out, around
        if len(made) > LONG:
            test = self.call(masks.any_lane, [self.name_node(mask, line)], line)
            made = [self.locate(ast.If(test, made, []), line)]
        self.out += made

    def turn(self, lines: Sequence[ast.stmt]) -> list[ast.stmt]:
        """The lines of a loop that stays one."""
        self.frame.unrolled.append(False)
        made = self.block(lines)
        self.frame.unrolled.pop()
        return made

    def unroll(self, line: ast.For, over: Any) -> None:
        """The lines of a loop once for each of what it goes over."""
        if line.orelse:
            raise self.refused("a loop that is unrolled has no else")
        self.frame.unrolled.append(True)
        around, branches = self.frame.known, self.frame.branches
        self.frame.branches = 0
        for each in over:
            self.frame.known = {**around}
            self.bind(line.target, Known(each))
            if self.body(line.body) is not None:
                raise self.refused("a loop that is unrolled cannot be returned from")
        self.frame.known, self.frame.branches = around, branches
        self.frame.unrolled.pop()

    def leave(self, line: ast.Break | ast.Continue) -> None:
        """`break` or `continue`."""
        if not self.frame.unrolled or self.frame.unrolled[-1]:
            raise self.refused(f"`{type(line).__name__.lower()}` stands in a loop that is unrolled, where it would "
                               "leave the loop around it; write a condition instead")
        if self.masks:
            raise self.refused(f"`{type(line).__name__.lower()}` stands under a condition that each of several scenes "
                               "answers in its own way")
        self.emit(type(line)(), line)

    _Break = _Continue = leave

    def _Return(self, line: ast.Return) -> Value:
        value = Known(None) if line.value is None else self.right_side(line.value)
        if self.frame is self.entry:
            self.emit(ast.Return(self.residual(value, line)), line)
        return value

    # Calls

    def _Call(self, node: ast.Call) -> Value:
        whole, self.whole = self.whole is node, None
        function = self.evaluate(node.func)
        values = [one for each in node.args for one in self.several(each)]
        if isinstance(function, Known):
            if getattr(function.value, "__module__", "") == memory.__name__:
                return self.remembered(function.value, [self.residual(each, node) for each in values], node)
            if self.engine == "plain" and is_tuple_class(function.value):
                return self.new_tuple(self.residual(function, node, getattr(node.func, "id", "")), values, node)
            if (answer := self.worked_out(function.value, values, node)) is not None:
                return answer
            method = isinstance(function.value, MethodType) and isinstance(function.value.__self__, Record)
            if method or any(isinstance(each, Known) and isinstance(each.value, Record) for each in values):
                return self.written_out(function.value, values, node, whole)
        elif self.engine == "plain" and isinstance(function, ast.Name) and function.id in self.tuple_classes:
            return self.new_tuple(function, values, node)
        keywords = [self.locate(ast.keyword(each.arg, self.residualize(each.value)), each) for each in node.keywords]
        callee = self.residual(function, node, getattr(node.func, "attr", getattr(node.func, "id", "")))
        return self.locate(ast.Call(callee, [self.residual(each, node) for each in values], keywords), node)

    def worked_out(self, function: Any, values: list[Value], node: ast.Call) -> Value | None:
        """Work out some of Python's own functions of known arguments; None of others."""
        first = values[0] if values else None
        if (function in (getattr, len, zip, enumerate, reversed) and not node.keywords) or function is zip:
            if function is getattr and len(values) == 2 and isinstance(values[1], Known):
                attribute = ast.Attribute(node.args[0], values[1].value, ast.Load())
                return self._Attribute(ast.copy_location(attribute, node))
            if all(isinstance(each, Known) for each in values):
                answer = function(*[each.value for each in values])  # type: ignore[union-attr]
                return Known(answer if function is len else tuple(answer))
        if function in (tuple, list) and isinstance(first, Known | ast.List | ast.Tuple):
            kind = ast.Tuple if function is tuple else ast.List
            return first if isinstance(first, Known) else self.locate(kind(first.elts, ast.Load()), node)
        if function in (all, any) and isinstance(first, ast.List | ast.Tuple):
            return self.joined(first.elts, ast.And() if function is all else ast.Or(), node)
        if function is reduce and isinstance(values[0], Known) and values[0].value is add and isinstance(
                values[1], ast.List | ast.Tuple):
            sums: ast.expr = reduce(
                lambda left, right: self.locate(ast.BinOp(left, ast.Add(), right), node), values[1].elts)
            return sums
        return None

    def new_tuple(self, kind: ast.expr, values: list[Value], node: ast.Call) -> ast.expr:
        """A NamedTuple in plain Python."""
        made = self.locate(ast.Tuple([self.residual(each, node) for each in values], ast.Load()), node)
        return self.locate(ast.Call(self.outer("new", new, node), [kind, made], []), node)

    def remembered(self, function: FunctionType, parts: list[ast.expr], node: ast.Call) -> Value:
        """A word of `teleop.stages.memory`: in plain Python its one line, else a call of an engine's instruction."""
        if self.masks and function is memory.put:
            return self.call(masks.put_selected, [self.name_node(self.masks[-1], node), *parts], node)
        if self.engine != "plain":
            return self.call(function, parts, node)
        frame = CallFrame(function, place=self.frame.place or location(node))
        frame.names = dict(zip(frame.arguments, parts, strict=True))
        line = self.definition(function).body[-1]
        self.frames.append(frame)
        answer: Value = Known(None)
        if isinstance(line, ast.Assign):
            self.emit(ast.Assign([self.target(line.targets[0])], self.residualize(line.value)), node)
        elif isinstance(line, ast.Return) and line.value is not None:
            answer = self.residualize(line.value)
        self.frames.pop()
        return answer

    def written_out(self, function: Any, values: list[Value], node: ast.Call, whole: bool) -> Value:
        """A call in the place of which the function's own lines stand."""
        body_of = getattr(function, "__func__", function)
        if isinstance(function, MethodType):
            values = [Known(function.__self__), *values]
        if not isinstance(body_of, FunctionType) or body_of.__code__.co_flags & CO_GENERATOR or node.keywords:
            raise self.refused(f"{ast.unparse(node.func)} is no plain function of arguments in their order, so a "
                               "record that is handed to it escapes")
        if any(each.function.__code__ is body_of.__code__ for each in self.frames):
            raise self.refused(f"{body_of.__qualname__} calls itself, so it cannot be written out")
        records = [each.value for each in values if isinstance(each, Known) and isinstance(each.value, Record)]
        place = self.frame.place or (location(node) if body_of.__code__.co_filename != self.file else None)
        frame = CallFrame(body_of, max([each.suffix for each in records], key=len), place)
        if len(values) != len(frame.arguments):
            takes = number_of(len(frame.arguments), "argument")
            raise self.refused(f"{body_of.__qualname__} takes {takes}, not {len(values)}")
        lines, before, line = self.definition(body_of), len(self.out), self.line
        self.frames.append(frame)
        for name, value in zip(frame.arguments, values, strict=True):
            if isinstance(value, Known):
                frame.known[name] = value
            elif self.lasting(value):
                frame.names[name] = value
            else:
                saved = self.fresh(name)
                frame.names[name] = self.name_node(saved, node)
                self.emit(ast.Assign([self.name_node(saved, node, ast.Store())], value), node)
        answer = self.body(lines.body)
        self.frames.pop()
        self.line = line
        if len(self.out) > before and not whole:
            raise self.refused(f"{body_of.__qualname__} has lines of its own and stands in the midst of an expression, "
                               "before which they would be worked out; let its call be all of the right side")
        return Known(None) if answer is None else answer

    def lasting(self, value: ast.expr) -> bool:
        """True if no function that is handed the value can set it: a name of the caller, or a number."""
        if isinstance(value, ast.BinOp):
            return self.lasting(value.left) and self.lasting(value.right)
        while isinstance(value, ast.Attribute):
            value = value.value
        return isinstance(value, ast.Constant) or (
            isinstance(value, ast.Name) and (value.id not in self.fields or value.id in self.entry.arguments))


def returns(line: ast.stmt) -> bool:
    """True if a line, or one within it, returns."""
    return any(isinstance(each, ast.Return) for each in ast.walk(line))


def is_tuple_class(function: Any) -> bool:
    """True of a NamedTuple's class."""
    return isinstance(function, type) and issubclass(function, tuple) and hasattr(function, "_fields")
