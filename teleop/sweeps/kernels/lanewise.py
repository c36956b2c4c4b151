"""What compiled text does with lanes as a whole: put them together, choose between them, take one of them.

A *tree* is what a law or a body gives: a number, or a tuple or NamedTuple of trees. These are intrinsics of numba's:
they are called in compiled code, and each makes the instructions for the types that it meets; of what is the same in
all lanes they mean what `teleop.simulation.masks` says.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.extending import intrinsic

from teleop.sweeps.kernels.lanes import VECTOR, WIDTH, LanesType, MaskType, lanes, mask, types


def intrinsic_of(make: Callable[..., Any]) -> Any:
    """`numba.extending.intrinsic`, which has no types."""
    return intrinsic(make)


def tree_type(kind: Any, leaf: Callable[[Any], Any]) -> Any:
    """The type of a tree with other types for its numbers."""
    if not isinstance(kind, types.BaseTuple):
        return leaf(kind)
    own = kind.instance_class if isinstance(kind, types.BaseNamedTuple) else None
    return types.BaseTuple.from_types(tuple([tree_type(each, leaf) for each in kind.types]), own)


def tree_value(context: Any, builder: Any, kind: Any, result: Any, value: Any, leaf: Callable[[Any, Any], Any]) -> Any:
    """The value of a tree of type `result`, made of one of type `kind`: `leaf(kind, value)` for each number."""
    if not isinstance(kind, types.BaseTuple):
        return leaf(kind, value)
    parts = [tree_value(context, builder, each, there, builder.extract_value(value, i), leaf)
             for i, (each, there) in enumerate(zip(kind.types, result.types, strict=True))]
    return context.make_tuple(builder, result, parts)


def numbers_in(kind: Any) -> int:
    """How many numbers a tree of this type has."""
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
    """The tree of lane i; what has no lanes is the same in all."""

    def one(kind: Any) -> Any:
        return {lanes: types.float64, mask: types.boolean}.get(kind, kind)

    def make(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        def leaf(kind: Any, value: Any) -> Any:
            if isinstance(kind, LanesType):
                return builder.extract_element(value, args[1])
            return builder.extract_element(value, args[1]) if isinstance(kind, MaskType) else value

        return tree_value(context, builder, tree, sig.return_type, args[0], leaf)

    return tree_type(tree, one)(tree, types.intp), make


@intrinsic_of
def with_lane(typingctx: Any, tree: Any, i: Any, one: Any) -> Any:  # noqa: ARG001
    """A tree of lanes with the numbers of the tree `one` in lane i."""

    def make(context: Any, builder: Any, sig: Any, args: Any) -> Any:  # noqa: ARG001
        def into(kind: Any, there: Any, value: Any, other: Any) -> Any:
            if not isinstance(kind, types.BaseTuple):
                return builder.insert_element(value, context.cast(builder, other, there, types.float64), args[1])
            return context.make_tuple(builder, kind, [
                into(each, also, builder.extract_value(value, n), builder.extract_value(other, n))
                for n, (each, also) in enumerate(zip(kind.types, there.types, strict=True))])

        return into(tree, one, args[0], args[2])

    return tree(tree, types.intp, one), make


@intrinsic_of
def select(typingctx: Any, which: Any, here: Any, there: Any) -> Any:
    """`here` where the mask is true, `there` in the other lanes: numbers, truths, or tuples of such."""

    def type_of(one: Any, other: Any) -> Any:
        if isinstance(one, types.BaseTuple):
            own = one.instance_class if isinstance(one, types.BaseNamedTuple) else None
            return types.BaseTuple.from_types(tuple(map(type_of, one.types, other.types)), own)
        if all(isinstance(each, types.Boolean | MaskType) for each in (one, other)):
            return mask if MaskType in (type(which), type(one), type(other)) else types.boolean
        with_lanes = isinstance(which, MaskType) or LanesType in (type(one), type(other))
        return lanes if with_lanes else typingctx.unify_types(one, other)

    def make(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        def choose(kind: Any, one: Any, other: Any, a: Any, b: Any) -> Any:
            if isinstance(kind, types.BaseTuple):
                return context.make_tuple(builder, kind, [
                    choose(each, one.types[i], other.types[i], builder.extract_value(a, i), builder.extract_value(b, i))
                    for i, each in enumerate(kind.types)])
            return builder.select(args[0], context.cast(builder, a, one, kind), context.cast(builder, b, other, kind))

        return choose(sig.return_type, here, there, args[1], args[2])

    mask_type = which if isinstance(which, MaskType) else types.boolean
    return type_of(here, there)(mask_type, here, there), make


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


