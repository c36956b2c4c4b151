"""Numbers of scenes side by side, printed as C: a vector of the compiler's, with a lane for each scene.

Everything a law may write of floats means on lanes what plain Python means in each of them, to the last bit: `min` and
`max` keep their first argument where a comparison fails, as Python's do, NaN and the sign of a zero included; nothing
is contracted or reordered. A comparison gives a mask; a mask that is reckoned with is 1.0 and 0.0.

Whether a number has lanes is its type. A function that is called with lanes is printed in the first of three ways that
has lines in C: as it stands, where no branch depends on lanes; with masks in place of its branches
(`teleop.simulation.specialise`); or for one scene, and called for one lane after the other.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Sequence
from math import inf, nan
from types import FunctionType
from typing import Any

from teleop.emit.expressions import NUMBERS, bare
from teleop.emit.statements import CFunction, Program, Statements
from teleop.emit.types import (
    BOOL,
    DOUBLE,
    NOTHING,
    REALS,
    SCALARS,
    Array,
    NotPrinted,
    Printed,
    Struct,
    TupleParts,
    Types,
    Value,
    c_field,
    parts_of,
)
from teleop.physics.contact import move_wall
from teleop.simulation import masks
from teleop.simulation.expressions import Known, NotSpecialised
from teleop.simulation.masks import any_lane, invert, one_by_one, select
from teleop.simulation.specialise import specialise

LANES, MASK = "vec_real", "vec_mask"  # types: a float in each lane, a truth in each lane
SIGNS: dict[type, str] = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}
COMPARED: dict[type, str] = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}
OF_MASKS: dict[type, str] = {ast.BitAnd: "&", ast.BitOr: "|"}
PRIMITIVES = {math.sqrt: "vec_sqrt", math.fabs: "vec_abs"}


def header(lanes: int) -> str:
    """The lines of C that all kernels over so many lanes have."""
    def join(text: str, sign: str = ", ") -> str:
        return sign.join([text.replace("#", str(i)) for i in range(lanes)])

    return f"""\
typedef double vec_real __attribute__((vector_size({8 * lanes})));
typedef int64_t vec_mask __attribute__((vector_size({8 * lanes})));
#define V static inline __attribute__((always_inline))

V vec_real vec_all(double x) {{ return (vec_real){{{join("x")}}}; }}
V vec_mask vec_truth(bool x) {{ return (vec_mask){{{join("-(int64_t)x")}}}; }}
V vec_real vec_number(vec_mask m) {{ return (vec_real)(m & (vec_mask)vec_all(1.0)); }}
V vec_real vec_abs(vec_real a) {{ return (vec_real)((vec_mask)a & INT64_MAX); }}
V vec_mask vec_either(vec_mask m, vec_mask a, vec_mask b) {{ return (m & a) | (~m & b); }}
#if {lanes} == 4 && defined __AVX__ && defined __GNUC__ && !defined __clang__
V vec_real vec_select(vec_mask m, vec_real a, vec_real b) {{ return __builtin_ia32_blendvpd256(b, a, (vec_real)m); }}
V vec_real vec_max(vec_real a, vec_real b) {{ return __builtin_ia32_maxpd256(b, a); }} /* b > a ? b : a */
V vec_real vec_min(vec_real a, vec_real b) {{ return __builtin_ia32_minpd256(b, a); }}
V vec_real vec_sqrt(vec_real a) {{ return __builtin_ia32_sqrtpd256(a); }}
V bool vec_any(vec_mask m) {{ return __builtin_ia32_movmskpd256((vec_real)m) != 0; }}
#else
V vec_real vec_select(vec_mask m, vec_real a, vec_real b)
{{
    return (vec_real)vec_either(m, (vec_mask)a, (vec_mask)b);
}}
V vec_real vec_max(vec_real a, vec_real b) {{ return vec_select((vec_mask)(b > a), b, a); }}
V vec_real vec_min(vec_real a, vec_real b) {{ return vec_select((vec_mask)(b < a), b, a); }}
V vec_real vec_sqrt(vec_real a) {{ return (vec_real){{{join("sqrt(a[#])")}}}; }}
V bool vec_any(vec_mask m) {{ return ({join("m[#]", " | ")}) != 0; }}
#endif
V vec_real vec_load(const double *p) {{ return (vec_real){{{join("p[#]")}}}; }}
V void vec_store(double *p, vec_mask m, vec_real a) {{ for (int i = 0; i < {lanes}; i++) if (m[i]) p[i] = a[i]; }}
V vec_real vec_wholes(const int64_t *p) {{ return (vec_real){{{join("(double)p[#]")}}}; }}
V vec_real vec_reals_at(const int64_t *p, int64_t k)
{{
    return (vec_real){{{join("((const double *)(intptr_t)p[#])[k]")}}};
}}
V vec_real vec_wholes_at(const int64_t *p, int64_t k)
{{
    return (vec_real){{{join("(double)((const int64_t *)(intptr_t)p[#])[k]")}}};
}}
"""


def has_lanes(thing: Any) -> bool:
    """True of lanes, of a value that has lanes in it, and of the type of one."""
    if isinstance(thing, TupleParts):
        return any(map(has_lanes, thing.values))
    if isinstance(thing, Struct | Array):
        return any(map(has_lanes, parts_of(thing)))
    return has_lanes(thing.type) if isinstance(thing, Printed) else thing in (LANES, MASK)


def class_of(value: Value) -> Any:
    """The NamedTuple that a value is of, if it is of one."""
    return value.of_class if isinstance(value, TupleParts) else getattr(getattr(value, "type", None), "of_class", None)


class LaneTypes(Types):
    """The types of a kernel."""

    def join(self, a: Any, b: Any) -> Any:
        pair = {a, b} if isinstance(a, str) and isinstance(b, str) else set()
        if not pair & {LANES, MASK}:
            return super().join(a, b)
        return None if pair - {LANES, MASK, *SCALARS} else MASK if pair <= {MASK, BOOL} else LANES

    def literal(self, value: Any, kind: Any) -> str:
        if kind in (LANES, MASK):
            inner = super().literal(value, DOUBLE if kind == LANES else BOOL)
            return f"{'vec_all' if kind == LANES else 'vec_truth'}({inner})"
        return super().literal(value, kind)

    def with_numbers(self, kind: Any, instead: dict[str, str]) -> Any:
        """A type with others in place of its numbers."""
        if isinstance(kind, Array):
            return self.array(self.with_numbers(kind.of, instead), kind.count)
        if isinstance(kind, Struct):
            members = {name: self.with_numbers(each, instead) for name, each in kind.members.items()}
            same = [*members.values()] == [*kind.members.values()]
            return kind if same else self.struct(getattr(kind.of_class, "__name__", "Parts"), members, kind.of_class,
                                                 kind.texts)
        return instead.get(kind, kind)


REALS_WIDE = dict.fromkeys(REALS, LANES)  # what a row's numbers are
ALL_WIDE = {**dict.fromkeys(SCALARS, LANES), MASK: LANES}  # what a ring holds, and an answer lane by lane
ONE_LANE = {LANES: DOUBLE, MASK: BOOL}


class LaneProgram(Program):
    """Contents of one kernel's file, for so many rows side by side; one, and there are no lanes."""

    def __init__(self, lanes: int) -> None:
        super().__init__("k_", powers=True)
        self.types: LaneTypes = LaneTypes("k_")
        self.lanes = lanes

    def printer(self, function: FunctionType) -> Statements:
        return LaneStatements(self, function)

    def translated(self, function: FunctionType, arguments: list[Value], name: str) -> CFunction:
        if not any(map(has_lanes, arguments)):
            return super().translated(function, arguments, name)
        function = INSTEAD.get(function, function)
        try:
            return super().translated(function, arguments, name)
        except NotPrinted:
            try:
                return Masked(self, function).translate(arguments, name)
            except (NotPrinted, NotSpecialised):
                return self.in_turn(function, arguments, name)

    def where(self, function: FunctionType, arguments: list[Value], otherwise: Any) -> CFunction:
        """The function called for those lanes alone that a mask names."""
        made = self.in_turn(function, arguments, self._name(f"{function.__name__}_where"), otherwise)
        self._texts.append((made.name, made.text))
        return made

    def in_turn(self, function: FunctionType, arguments: list[Value], name: str, otherwise: Any = None) -> CFunction:
        """The function called for each lane in turn, or, with the type of the answer `otherwise`, for those of a mask.

        Of a mask, it takes that and the answer of the other lanes as well, before the arguments.
        """
        caller, types = LaneStatements(self, function), self.types
        passed = [Printed(each.type, f"a{i}") for i, each in enumerate(arguments)
                  if isinstance(each, Printed) and each.type != NOTHING]
        words = iter(passed)
        scalars = [Printed(types.with_numbers(each.type, ONE_LANE), next(words).text)
                   if isinstance(each, Printed) and each.type != NOTHING else each for each in arguments]
        one = self.function(function, scalars, caller)
        gives = types.with_numbers(one.gives, ALL_WIDE)
        first = [Printed(MASK, "which"), Printed(otherwise, "otherwise")] if otherwise else []
        lines = ["    unsigned faults = 0;  /* of a lane that may not count */"] * one.faults
        for i in range(self.lanes):
            texts = [bare(caller.to(caller.lane(each, i), kind)) for each, kind in zip(passed, one.takes, strict=True)]
            call = f"{one.name}({', '.join([*texts, *['&faults'] * one.faults])})"
            if otherwise:
                call = f"which[{i}] ? {call} : {caller.to(caller.lane(first[1], i), one.gives)}"
            lines += [f"    const {types.c(one.gives)} one{i} = {call};", *["    faults = 0;"] * one.faults]
        together = gathered(gives, [f"one{i}" for i in range(self.lanes)], "")
        heads = [f"{types.c(each.type)} {each.text}" for each in (*first, *passed)]
        text = (f"/* {function.__qualname__}, one lane after the other */\nstatic {types.c(gives)} {name}"
                f"({', '.join(heads)})\n{{\n" + "\n".join(lines) + f"\n    return ({types.c(gives)}){together};\n}}\n")
        return CFunction(name, tuple([each.type for each in (*first, *passed)]), gives, False, text)


def gathered(kind: Any, words: Sequence[str], index: str) -> str:
    """The initialiser of a tree of lanes: each lane of its own word, at this index of it."""
    if isinstance(kind, Array):
        parts = [gathered(kind.of, [f"{each}.at[{i}]" for each in words], index) for i in range(kind.count)]
        return f"{{{{{', '.join(parts)}}}}}"
    if isinstance(kind, Struct):
        parts = [gathered(of, [f"{each}.{c_field(name)}" for each in words], index)
                 for name, of in kind.members.items() if of != NOTHING]
        return f"{{{', '.join(parts) or '0'}}}"
    return f"{{{', '.join([each + index.format(i) for i, each in enumerate(words)])}}}"


class LaneStatements(Statements):
    """Printer of one function, some of whose numbers have lanes."""

    program: LaneProgram
    types: LaneTypes

    def is_number(self, value: Value) -> bool:
        return getattr(value, "type", None) in (LANES, MASK) or super().is_number(value)

    def to(self, value: Value, kind: Any) -> str:
        if kind in (LANES, MASK):
            if isinstance(value, Known) and isinstance(value.value, NUMBERS):
                return self.types.literal(value.value, kind)
            printed = self.whole(value)
            make = {(LANES, MASK): "vec_number", (MASK, BOOL): "vec_truth"}.get(
                (kind, printed.type), "vec_all" if kind == LANES and printed.type in SCALARS else "")
            if printed.type != kind and not make:
                raise self.refused(f"a {printed.type} stands where a {kind} is needed")
            return f"{make}({bare(printed.text)})" if make else printed.text
        if getattr(value, "type", None) in (LANES, MASK):
            raise self.refused(f"a number of each lane stands where a {kind} is needed")
        return super().to(value, kind)

    def truth(self, value: Value) -> str:
        if has_lanes(value):
            raise self.refused("each lane has an answer of its own to a condition")
        return super().truth(value)

    def lane(self, value: Value, i: int) -> Value:
        """A value as lane i has it."""
        if getattr(value, "type", None) == LANES:
            return Printed(DOUBLE, f"{value.text}[{i}]")
        if getattr(value, "type", None) == MASK:
            return Printed(BOOL, f"({value.text}[{i}] != 0)")
        if not has_lanes(value):
            return value
        return TupleParts(tuple([self.lane(each, i) for each in self.parts(value)]), class_of(value))

    def in_every_lane(self, value: Value) -> Value:
        """A tree of numbers with each of them in every lane."""
        if self.is_number(value):
            return value if getattr(value, "type", None) == MASK else Printed(LANES, self.to(value, LANES))
        return TupleParts(tuple(map(self.in_every_lane, self.parts(value))), class_of(value))

    def selected(self, which: Printed, here: Value, otherwise: Value) -> Value:
        """`here` where the mask is true, else `otherwise`: numbers, or tuples of the same type."""
        if not (self.is_number(here) and self.is_number(otherwise)):
            pairs = [self.parts(here), self.parts(otherwise)]
            if len(pairs[0]) != len(pairs[1]) or class_of(here) is not class_of(otherwise):
                raise self.refused("no mask selects between tuples of unlike types")
            return TupleParts(tuple([self.selected(which, *pair) for pair in zip(*pairs, strict=True)]), class_of(here))
        kind = self.joined(here, otherwise)
        if which.type == MASK:
            kind = MASK if kind in (BOOL, MASK) else LANES
        a, b = [bare(self.to(each, kind)) for each in (here, otherwise)]
        if which.type == MASK:
            return Printed(kind, f"{'vec_either' if kind == MASK else 'vec_select'}({which.text}, {a}, {b})")
        return Printed(kind, f"({self.truth(which)} ? {a} : {b})")

    def by_name(self, value: Value) -> Value:
        """A value whose text may be repeated."""
        return self.temporary(value) if isinstance(value, Printed) else value

    def apply(self, function: Any, arguments: list[Value], keywords: dict[str, Value]) -> Value:
        if function is masks.select:
            which, *both = map(self.by_name, arguments)
            return self.selected(self.whole(which), both[0], both[1])
        if function is masks.invert:
            return self.inverted(arguments[0])
        if function is masks.any_lane:
            mask = self.whole(arguments[0])
            return Printed(BOOL, f"vec_any({bare(mask.text)})" if mask.type == MASK else self.truth(mask))
        if function is masks.broadcast:
            return self.in_every_lane(self.by_name(arguments[0]))
        if function is masks.one_by_one:
            which, called, otherwise, *rest = arguments
            values = [self.argument(each) for each in (otherwise, *rest)]
            made = self.program.where(called.value, values[1:], values[0].type)
            texts = [bare(self.to(each, kind)) for each, kind in zip((which, *values), made.takes, strict=True)]
            return Printed(made.gives, f"{made.name}({', '.join(texts)})")
        return super().apply(function, arguments, keywords)

    def primitive(self, function: Any, arguments: list[Value]) -> Printed:
        if not any(map(has_lanes, arguments)):
            return super().primitive(function, arguments)
        if function not in PRIMITIVES:
            raise self.refused(f"{function.__name__} is worked out for one lane after the other")
        return Printed(LANES, f"{PRIMITIVES[function]}({bare(self.to(arguments[0], LANES))})")

    def _abs(self, value: Value) -> Value:
        return self.primitive(math.fabs, [value]) if has_lanes(value) else super()._abs(value)

    def _float(self, value: Value) -> Value:
        return Printed(LANES, self.to(value, LANES)) if has_lanes(value) else super()._float(value)

    def extreme(self, function: Any, arguments: list[Value]) -> Value:
        values = self.parts(arguments[0]) if len(arguments) == 1 else arguments
        if not any(map(has_lanes, values)):
            return super().extreme(function, arguments)
        made = self.to(values[0], LANES)
        for each in values[1:]:
            made = f"vec_{function.__name__}({bare(made)}, {bare(self.to(each, LANES))})"
        return Printed(LANES, made)

    def inverted(self, value: Value) -> Value:
        """The truth that is a value's opposite, in each lane."""
        if not has_lanes(value):
            return Printed(BOOL, f"(!{self.truth(value)})")
        if getattr(value, "type", None) != MASK:
            raise self.refused("each lane has an answer of its own to a condition")
        return Printed(MASK, f"(~{value.text})")

    def _UnaryOp(self, node: ast.UnaryOp) -> Value:
        inner = self.evaluate(node.operand)
        if not has_lanes(inner):
            return super()._UnaryOp(node)
        if isinstance(node.op, ast.Not):
            return self.inverted(inner)
        if isinstance(node.op, ast.Invert):
            raise self.refused("`~` of a truth is another number in Python; write `not`")
        return Printed(LANES, f"({'-' * isinstance(node.op, ast.USub)}{self.to(inner, LANES)})")

    def binary(self, op: ast.operator, left: Value, right: Value) -> Value:
        numbers = self.is_number(left) and self.is_number(right)
        if not numbers or not (has_lanes(left) or has_lanes(right)):
            return super().binary(op, left, right)
        kind, signs = (MASK, OF_MASKS) if type(op) in OF_MASKS else (LANES, SIGNS)
        if type(op) not in signs:
            raise self.refused(f"{type(op).__name__} is worked out for one lane after the other")
        return Printed(kind, f"({self.to(left, kind)} {signs[type(op)]} {self.to(right, kind)})")

    def _Compare(self, node: ast.Compare) -> Value:
        values = [self.evaluate(each) for each in (node.left, *node.comparators)]
        if not any(map(has_lanes, values)):
            return super()._Compare(node)
        if len(values) > 2 or not all(map(self.is_number, values)) or type(node.ops[0]) not in COMPARED:
            raise self.refused("lanes are compared one pair at a time, by their numbers")
        a, b = [self.to(each, LANES) for each in values]
        return Printed(MASK, f"(vec_mask)({a} {COMPARED[type(node.ops[0])]} {b})")


class Masked(LaneStatements):
    """Printer of one function with masks in place of its branches."""

    def __init__(self, program: LaneProgram, function: FunctionType) -> None:
        super().__init__(program, function)
        self.made = specialise(function, engine="vector")
        self.names = self.made.names

    def definition(self) -> tuple[list[ast.stmt], str, int]:
        return self.made.tree.body, "", self.function.__code__.co_firstlineno


def move_wall_in_lanes(c: Any, x: Any, v: Any, f: Any) -> Any:
    """`move_wall` in lanes: every tick that stays in its mode at once, and the others one lane after the other."""
    (side, at, k, d, s12, t1, s22, t2, a11, a12, b1, a21, a22, b2, gp, gu, gf, one_turn, _, _, _) = c
    p = side * (x - at)
    x1 = x + s12 * v + t1 * f
    v1 = s22 * v + t2 * f
    inside = p > 0.0
    done = (p < 0.0) & (side * (x1 - at) < 0.0) & ((side * v <= 0.0) | (side * v1 >= 0.0))
    if any_lane(inside):
        u = side * v
        w = side * f
        p1 = a11 * p + a12 * u + b1 * w
        u1 = a21 * p + a22 * u + b2 * w
        stays = (inside & (one_turn == 1.0) & (k * p + d * u > 0.0) & (k * p1 + d * u1 > 0.0) & (p1 > 0.0)
                 & ((gp * p + gu * u + gf * w >= 0.0) | (gp * p1 + gu * u1 + gf * w <= 0.0)))
        x1 = select(stays, at + side * p1, x1)
        v1 = select(stays, side * u1, v1)
        done = done | stays
    if any_lane(invert(done)):
        sound = abs(p) + abs(v) + abs(f) < inf
        x1 = select(done | sound, x1, nan)  # what is not finite is lost
        left = invert(done) & sound
        if any_lane(left):
            x1, v1, _ = one_by_one(left, move_wall, (x1, v1, 0), c, x, v, f)
    return x1, v1, 0


INSTEAD: dict[Any, Any] = {move_wall: move_wall_in_lanes}
