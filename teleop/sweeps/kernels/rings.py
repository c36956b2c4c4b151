"""Memory of a compiled kernel, read by number: `teleop.stages.memory` in compiled code.

A ring is a flat array of rows, as many as a power of two, with a message such as its own; a row holds the numbers of
one message, each with all of its lanes. A path or a schedule stands at an address, which goes with a number such as
those that stand there; where the scenes side by side have their own, at a tuple of addresses. A place that differs from
lane to lane is a float in each.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count
from typing import Any

import numpy as np
from llvmlite import ir
from numba.extending import overload

from teleop.sweeps.kernels.lanes import (
    VECTOR,
    WIDTH,
    LanesType,
    address,
    intrinsic_of,
    lanes,
    mask,
    numbers_in,
    tree_type,
    tree_value,
    types,
)

WHOLE, INDEX = ir.IntType(64), ir.IntType(32)


def _has_lanes(kind: Any) -> bool:
    return isinstance(kind, LanesType) or (isinstance(kind, types.BaseTuple) and any(map(_has_lanes, kind.types)))


def _width(kind: Any) -> int:
    """Places that each number of a message takes."""
    return WIDTH if _has_lanes(kind) else 1


def _place(k: Any) -> Any:
    """The type of a place: lanes, or a whole number."""
    return k if isinstance(k, LanesType) else types.int64


def ring(message: Any, size: int) -> Any:
    """Make a ring for messages such as this one; `size` is a power of two."""
    raise NotImplementedError(message, size)


def _ring(message: Any, size: Any) -> Any:  # noqa: ARG001
    row = max(1, numbers_in(message)) * _width(message)
    return lambda message, size: (np.zeros(size * row), message)


overload(ring, strict=False)(_ring)


class _Rows:
    """The rows of a ring that hold a message: one, or one for each lane, where each has a place of its own."""

    def __init__(self, context: Any, builder: Any, ring: tuple[Any, Any], place: tuple[Any, Any], size: Any) -> None:
        (kind, value), (of_place, k) = ring, place
        self.context, self.builder = context, builder
        self.kind, self.message = kind.types
        self.array = builder.extract_value(value, 0)
        self.wide, self.apart = _has_lanes(self.message), isinstance(of_place, LanesType)
        row = ir.Constant(WHOLE, max(1, numbers_in(self.message)) * _width(self.message))
        last = builder.sub(size, ir.Constant(WHOLE, 1))
        places = [builder.fptosi(builder.extract_element(k, ir.Constant(INDEX, i)), WHOLE)
                  for i in range(WIDTH)] if self.apart else [k]
        self.rows = [builder.mul(builder.and_(each, last), row) for each in places]

    def offsets(self) -> Iterator[Any]:
        """Offset of each number of a message in its row."""
        return (ir.Constant(WHOLE, i) for i in count(0, _width(self.message)))

    def pointer(self, i: int, offset: Any) -> Any:
        """Pointer to a number: with all of its lanes, or of lane i by itself."""
        at = self.builder.add(self.rows[i], offset)
        if self.wide and not self.apart:
            return address(self.context, self.builder, self.kind, self.array, at)
        at = self.builder.add(at, ir.Constant(WHOLE, i)) if self.wide else at
        return self.builder.gep(self.context.make_array(self.kind)(self.context, self.builder, self.array).data, [at])

    def read(self, result: Any, message: Any) -> Any:
        """The message that they hold."""
        builder, offsets = self.builder, self.offsets()

        def leaf(kind: Any, value: Any) -> Any:  # noqa: ARG001
            offset = next(offsets)
            if not self.apart:
                return builder.load(self.pointer(0, offset), align=8)
            vector = ir.Constant(VECTOR, ir.Undefined)
            for i in range(WIDTH):
                one = builder.load(self.pointer(i, offset), align=8)
                vector = builder.insert_element(vector, one, ir.Constant(INDEX, i))
            return vector

        return tree_value(self.context, builder, self.message, result, message, leaf)

    def write(self, kind: Any, message: Any, which: Any = None) -> None:
        """Keep a message in them, where the mask is true."""
        builder, offsets = self.builder, self.offsets()

        def keep(pointer: Any, value: Any, here: Any) -> None:
            if here is not None:
                value = builder.select(here, value, builder.load(pointer, align=8))
            builder.store(value, pointer, align=8)

        def leaf(leaf_kind: Any, value: Any) -> Any:
            offset = next(offsets)
            number = self.context.cast(builder, value, leaf_kind, lanes if self.wide else types.float64)
            if not self.apart:
                keep(self.pointer(0, offset), number, which)
                return value
            for i in range(WIDTH):
                lane = ir.Constant(INDEX, i)
                here = None if which is None else builder.extract_element(which, lane)
                keep(self.pointer(i, offset), builder.extract_element(number, lane), here)
            return value

        tree_value(self.context, builder, kind, kind, message, leaf)


@intrinsic_of
def put(typingctx: Any, rows: Any, k: Any, size: Any, message: Any) -> Any:  # noqa: ARG001
    """Keep a message under the number k."""

    def make(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        _Rows(context, builder, (rows, args[0]), (sig.args[1], args[1]), args[2]).write(message, args[3])
        return context.get_dummy_value()

    return types.none(rows, _place(k), types.int64, message), make


@intrinsic_of
def put_selected(typingctx: Any, which: Any, rows: Any, k: Any, size: Any, message: Any) -> Any:  # noqa: ARG001
    """Keep a message under the number k where the mask is true."""

    def make(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        _Rows(context, builder, (rows, args[1]), (sig.args[2], args[2]), args[3]).write(message, args[4], args[0])
        return context.get_dummy_value()

    apart = isinstance(k, LanesType)
    return types.none(mask if apart else which, rows, _place(k), types.int64, message), make


@intrinsic_of
def get(typingctx: Any, stored: Any, k: Any, size: Any) -> Any:  # noqa: ARG001
    """The message of number k; of each lane, where each has a place of its own."""
    number = lanes if _has_lanes(stored.types[1]) else types.float64
    message = tree_type(stored.types[1], lambda _: number)

    def make(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        rows = _Rows(context, builder, (stored, args[0]), (sig.args[1], args[1]), args[2])
        return rows.read(message, builder.extract_value(args[0], 1))

    return message(stored, _place(k), types.int64), make


@intrinsic_of
def at(typingctx: Any, numbers: Any, k: Any) -> Any:  # noqa: ARG001
    """The k-th of the numbers at an address; of each lane, where each has an address of its own."""
    apart, real = isinstance(numbers[0], types.BaseTuple), isinstance(numbers[1], types.Float)

    def make(context: Any, builder: Any, sig: Any, args: Any) -> Any:  # noqa: ARG001
        kind, place = ir.DoubleType() if real else WHOLE, builder.extract_value(args[0], 0)
        numbers_read = [builder.load(builder.gep(builder.inttoptr(each, kind.as_pointer()), [args[1]]))
                 for each in ([builder.extract_value(place, i) for i in range(WIDTH)] if apart else [place])]
        if not apart:
            return numbers_read[0]
        vector = _vector(builder, kind, numbers_read)
        return vector if real else builder.sitofp(vector, VECTOR)

    return (lanes if apart else types.float64 if real else types.int64)(numbers, types.int64), make


def _vector(builder: Any, kind: Any, numbers: list[Any]) -> Any:
    """Numbers, one for each lane, as a vector."""
    vector = ir.Constant(ir.VectorType(kind, WIDTH), ir.Undefined)
    for i, number in enumerate(numbers):
        vector = builder.insert_element(vector, number, ir.Constant(INDEX, i))
    return vector


@intrinsic_of
def tile_of(typingctx: Any, numbers: Any, t: Any) -> Any:  # noqa: ARG001
    """Eight whole numbers of a flat array, from place 8 t on, as a tuple."""

    def make(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        first = builder.mul(args[1], ir.Constant(WHOLE, WIDTH))
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        return context.make_tuple(builder, sig.return_type, [
            builder.load(builder.gep(data, [builder.add(first, ir.Constant(WHOLE, i))])) for i in range(WIDTH)])

    return types.UniTuple(types.int64, WIDTH)(numbers, types.int64), make


@intrinsic_of
def as_lanes(typingctx: Any, numbers: Any) -> Any:  # noqa: ARG001
    """A tuple of eight whole numbers as lanes."""

    def make(context: Any, builder: Any, sig: Any, args: Any) -> Any:  # noqa: ARG001
        wholes = [builder.extract_value(args[0], i) for i in range(WIDTH)]
        return builder.sitofp(_vector(builder, WHOLE, wholes), VECTOR)

    return lanes(numbers), make


@intrinsic_of
def store(typingctx: Any, out: Any, which: Any, ran: Any, figures: Any) -> Any:  # noqa: ARG001 - numba names them
    """Write how many ticks ran, and the figures, where the mask is true."""

    def make(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        def keep(i: int, value: Any) -> None:
            place = address(context, builder, sig.args[0], args[0], ir.Constant(WHOLE, i * WIDTH))
            builder.store(builder.select(args[1], value, builder.load(place, align=8)), place, align=8)

        keep(0, args[2])
        for i, kind in enumerate(figures.types):
            keep(i + 1, context.cast(builder, builder.extract_value(args[3], i), kind, lanes))
        return context.get_dummy_value()

    return types.none(out, mask, lanes, figures), make
