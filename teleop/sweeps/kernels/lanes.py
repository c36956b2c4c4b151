"""Lanes: eight floats of eight scenes, side by side, as one number of compiled code.

`LanesType` and `MaskType` are types of numba's, lowered to vectors of LLVM. Everything a law may write of floats means
on lanes what plain Python means in each of them, to the last bit: `min` and `max` keep their first argument where a
comparison fails, as Python's do, NaN and the sign of a zero included; nothing is contracted or reordered. A comparison
gives a mask. A mask is no truth, so the compiler refuses an `if` on one: `teleop.simulation.specialise` writes branches
as masks.

A law's function is compiled over lanes as it stands. Floats, whole numbers and truths that meet lanes are put into
every lane, a mask that is reckoned with is 1.0 and 0.0.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

import numba
from llvmlite import ir
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, lower_cast, models, register_model

WIDTH = 8  # lanes

types: Any = numba.types

_REAL, _BIT = ir.DoubleType(), ir.IntType(1)
VECTOR, BITS = ir.VectorType(_REAL, WIDTH), ir.VectorType(_BIT, WIDTH)


class LanesType(types.Type):  # type: ignore[misc]  # numba has no types
    """A float in each lane."""

    def __init__(self) -> None:
        super().__init__(name=f"lanes{WIDTH}")

    def can_convert_from(self, typingctx: Any, kind: Any) -> Any:
        from numba.core.typeconv import Conversion

        return Conversion.safe if _spreads(kind) else None

    def unify(self, typingctx: Any, kind: Any) -> Any:
        return self if _spreads(kind) else None


class MaskType(types.Type):  # type: ignore[misc]
    """A truth in each lane."""

    def __init__(self) -> None:
        super().__init__(name=f"mask{WIDTH}")

    def can_convert_from(self, typingctx: Any, kind: Any) -> Any:
        from numba.core.typeconv import Conversion

        return Conversion.safe if isinstance(kind, types.Boolean) else None

    def unify(self, typingctx: Any, kind: Any) -> Any:
        return self if isinstance(kind, types.Boolean) else None


lanes, mask = LanesType(), MaskType()


def _spreads(kind: Any) -> bool:
    return isinstance(kind, types.Float | types.Integer | types.Boolean | MaskType)


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, VECTOR)


@register_model(MaskType)
class _MaskModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, BITS)


def _everywhere(builder: Any, one: Any, kind: Any) -> Any:
    """A scalar in every lane."""
    start = builder.insert_element(ir.Constant(kind, ir.Undefined), one, ir.Constant(ir.IntType(32), 0))
    order = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH)
    return builder.shuffle_vector(start, ir.Constant(kind, ir.Undefined), order)


def _spread(context: Any, builder: Any, source: Any, target: Any, value: Any) -> Any:  # noqa: ARG001
    return _everywhere(builder, context.cast(builder, value, source, types.float64), VECTOR)


def _spread_truth(context: Any, builder: Any, source: Any, target: Any, value: Any) -> Any:  # noqa: ARG001
    bit = context.cast(builder, value, source, types.boolean)
    return _everywhere(builder, builder.trunc(bit, _BIT) if bit.type != _BIT else bit, BITS)


def _reckon(context: Any, builder: Any, source: Any, target: Any, value: Any) -> Any:  # noqa: ARG001
    return builder.uitofp(value, VECTOR)


for _kind in (types.Float, types.Integer, types.Boolean):
    lower_cast(_kind, LanesType)(_spread)
lower_cast(types.Boolean, MaskType)(_spread_truth)
lower_cast(MaskType, LanesType)(_reckon)


def _operation(word: Any, arity: int, emit: Callable[..., Any], *, result: Any = lanes, of: Any = lanes) -> None:
    """Give an operator or a function of Python its meaning on lanes: `emit(builder, *vectors)`."""

    def generic(self: Any, args: Any, kws: Any) -> Any:  # noqa: ARG001
        has_lanes = any(arg is of or (of is lanes and arg is mask) for arg in args)
        fits = all(arg is of or (_spreads(arg) if of is lanes else isinstance(arg, types.Boolean)) for arg in args)
        return signature(result, *[of] * len(args)) if has_lanes and fits and len(args) == arity else None

    infer_global(word)(type(f"Lanes_{getattr(word, '__name__', word)}", (AbstractTemplate,), {"generic": generic}))

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:  # noqa: ARG001
        return emit(builder, *args)

    lower_builtin(word, *[of] * arity)(lowered)


def _choose(sign: str) -> Callable[..., Any]:
    """`max` or `min`: the next where it is greater or less than what was kept until then."""
    def emit(builder: Any, best: Any, *values: Any) -> Any:
        for value in values:
            best = builder.select(builder.fcmp_ordered(sign, value, best), value, best)
        return best

    return emit


def _call(name: str) -> Callable[..., Any]:
    """An intrinsic of LLVM's on vectors."""
    kind = ir.FunctionType(VECTOR, [VECTOR])
    full = f"llvm.{name}.v{WIDTH}f64"

    def emit(builder: Any, x: Any) -> Any:
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, full), [x])

    return emit


_operation(operator.add, 2, lambda b, x, y: b.fadd(x, y))
_operation(operator.sub, 2, lambda b, x, y: b.fsub(x, y))
_operation(operator.mul, 2, lambda b, x, y: b.fmul(x, y))
_operation(operator.truediv, 2, lambda b, x, y: b.fdiv(x, y))
_operation(operator.neg, 1, lambda b, x: b.fneg(x))
_operation(operator.pos, 1, lambda b, x: x)  # noqa: ARG005
_operation(abs, 1, _call("fabs"))
_operation(math.fabs, 1, _call("fabs"))
_operation(math.sqrt, 1, _call("sqrt"))
for _count in (2, 3, 4):
    _operation(max, _count, _choose(">"))
    _operation(min, _count, _choose("<"))
for _word, _sign in ((operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">="),
                     (operator.eq, "==")):
    _operation(_word, 2, lambda b, x, y, sign=_sign: b.fcmp_ordered(sign, x, y), result=mask)
_operation(operator.ne, 2, lambda b, x, y: b.fcmp_unordered("!=", x, y), result=mask)
_operation(operator.and_, 2, lambda b, x, y: b.and_(x, y), result=mask, of=mask)
_operation(operator.or_, 2, lambda b, x, y: b.or_(x, y), result=mask, of=mask)
_operation(operator.invert, 1, lambda b, x: b.not_(x), result=mask, of=mask)


def intrinsic_of(make: Callable[..., Any]) -> Any:
    """`numba.extending.intrinsic`, which has no types."""
    return intrinsic(make)


def tree_type(kind: Any, leaf: Callable[[Any], Any]) -> Any:
    """The type of a tree with other types for its numbers."""
    if not isinstance(kind, types.BaseTuple):
        return leaf(kind)
    tuple_class = kind.instance_class if isinstance(kind, types.BaseNamedTuple) else None
    return types.BaseTuple.from_types(tuple([tree_type(each, leaf) for each in kind.types]), tuple_class)


def tree_value(context: Any, builder: Any, kind: Any, result: Any, value: Any, leaf: Callable[[Any, Any], Any]) -> Any:
    """The value of a tree of type `result`, made of one of type `kind`: `leaf(kind, value)` for each number."""
    if not isinstance(kind, types.BaseTuple):
        return leaf(kind, value)
    parts = [tree_value(context, builder, each, result_kind, builder.extract_value(value, i), leaf)
             for i, (each, result_kind) in enumerate(zip(kind.types, result.types, strict=True))]
    return context.make_tuple(builder, result, parts)


def numbers_in(kind: Any) -> int:
    """Count the numbers of a tree of this type."""
    return sum(map(numbers_in, kind.types)) if isinstance(kind, types.BaseTuple) else 1


@intrinsic_of
def broadcast(typingctx: Any, tree: Any) -> Any:  # noqa: ARG001
    """The tree with its numbers in every lane."""

    def make(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return tree_value(context, builder, tree, sig.return_type, args[0],
                          lambda kind, value: value if isinstance(kind, MaskType) else context.cast(
                              builder, value, kind, lanes))

    return tree_type(tree, lambda kind: kind if isinstance(kind, MaskType) else lanes)(tree), make


@intrinsic_of
def lane(typingctx: Any, tree: Any, i: Any) -> Any:  # noqa: ARG001
    """The tree of lane i; a number without lanes is the same in all."""

    def lane_type(kind: Any) -> Any:
        return {lanes: types.float64, mask: types.boolean}.get(kind, kind)

    def make(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        def leaf(kind: Any, value: Any) -> Any:
            if isinstance(kind, LanesType):
                return builder.extract_element(value, args[1])
            return builder.extract_element(value, args[1]) if isinstance(kind, MaskType) else value

        return tree_value(context, builder, tree, sig.return_type, args[0], leaf)

    return tree_type(tree, lane_type)(tree, types.intp), make


@intrinsic_of
def with_lane(typingctx: Any, tree: Any, i: Any, one: Any) -> Any:  # noqa: ARG001
    """A tree of lanes with the numbers of the tree `one` in lane i."""

    def make(context: Any, builder: Any, sig: Any, args: Any) -> Any:  # noqa: ARG001
        def into(kind: Any, lane_kind: Any, value: Any, number: Any) -> Any:
            if not isinstance(kind, types.BaseTuple):
                return builder.insert_element(value, context.cast(builder, number, lane_kind, types.float64), args[1])
            return context.make_tuple(builder, kind, [
                into(each, also, builder.extract_value(value, n), builder.extract_value(number, n))
                for n, (each, also) in enumerate(zip(kind.types, lane_kind.types, strict=True))])

        return into(tree, one, args[0], args[2])

    return tree(tree, types.intp, one), make


@intrinsic_of
def select(typingctx: Any, which: Any, here: Any, otherwise: Any) -> Any:
    """`here` where the mask is true, `there` in the other lanes: numbers, truths, or tuples of such."""

    def type_of(one: Any, second: Any) -> Any:
        if isinstance(one, types.BaseTuple) or isinstance(second, types.BaseTuple):
            tuple_class = getattr(one, "instance_class", None)
            alike = [isinstance(each, types.BaseTuple) and len(each.types) for each in (one, second)]
            if tuple_class is not getattr(second, "instance_class", None) or alike[0] != alike[1]:
                raise TypingError(f"{one} and {second} are not alike, so no mask selects between them")
            return types.BaseTuple.from_types(tuple(map(type_of, one.types, second.types)), tuple_class)
        if all(isinstance(each, types.Boolean | MaskType) for each in (one, second)):
            return mask if MaskType in (type(which), type(one), type(second)) else types.boolean
        with_lanes = isinstance(which, MaskType) or LanesType in (type(one), type(second))
        return lanes if with_lanes else typingctx.unify_types(one, second)

    def make(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        def choose(kind: Any, one: Any, two: Any, a: Any, b: Any) -> Any:
            if isinstance(kind, types.BaseTuple):
                return context.make_tuple(builder, kind, [
                    choose(each, one.types[i], two.types[i], builder.extract_value(a, i), builder.extract_value(b, i))
                    for i, each in enumerate(kind.types)])
            return builder.select(args[0], context.cast(builder, a, one, kind), context.cast(builder, b, two, kind))

        return choose(sig.return_type, here, otherwise, args[1], args[2])

    mask_type = which if isinstance(which, MaskType) else types.boolean
    return type_of(here, otherwise)(mask_type, here, otherwise), make


@intrinsic_of
def any_lane(typingctx: Any, which: Any) -> Any:  # noqa: ARG001
    """True if the mask is true of any lane."""

    def make(context: Any, builder: Any, sig: Any, args: Any) -> Any:  # noqa: ARG001
        if not isinstance(which, MaskType):
            return args[0]
        bits = builder.bitcast(args[0], ir.IntType(WIDTH))
        return builder.icmp_unsigned("!=", bits, ir.Constant(bits.type, 0))

    return types.boolean(which if isinstance(which, MaskType) else types.boolean), make


@intrinsic_of
def invert(typingctx: Any, which: Any) -> Any:  # noqa: ARG001
    """The mask that is true where this one is not."""
    kind = which if isinstance(which, MaskType) else types.boolean
    return kind(kind), lambda context, builder, sig, args: builder.not_(args[0])  # noqa: ARG005


def address(context: Any, builder: Any, kind: Any, array: Any, at: Any) -> Any:
    """A pointer to eight floats of a flat array, from place `at` on."""
    start = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(start, [at]), VECTOR.as_pointer())


@intrinsic_of
def load(typingctx: Any, array: Any, at: Any) -> Any:  # noqa: ARG001
    """Eight floats of a flat array from place `at` on."""

    def make(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.load(address(context, builder, sig.args[0], *args), align=8)

    return lanes(array, types.intp), make
