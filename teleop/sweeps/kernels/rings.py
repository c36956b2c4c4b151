"""What a compiled kernel remembers between ticks: messages on their way, and positions of some ticks ago.

A ring is a flat array of rows, as many as a power of two; a row holds the numbers of one message, each with all of its
lanes. The schedule of a link stands at an address, or, where the scenes side by side have links of their own, at a
tuple of addresses; a lag likewise is one number or a tuple.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count
from typing import Any

import numpy as np
from llvmlite import ir
from numba.extending import overload

from teleop.sweeps.kernels.lanes import VECTOR, WIDTH, LanesType, lanes, types
from teleop.sweeps.kernels.lanewise import address, intrinsic_of, numbers_in, tree_value, vector_of

WHOLE = ir.IntType(64)


def _has_lanes(kind: Any) -> bool:
    return isinstance(kind, LanesType) or (isinstance(kind, types.BaseTuple) and any(map(_has_lanes, kind.types)))


def _each(kind: Any) -> int:
    """Places that each number of a message takes."""
    return WIDTH if _has_lanes(kind) else 1


def ring(message: Any, rows: int) -> Any:
    """A ring for messages such as this one."""
    raise NotImplementedError(message, rows)


def _ring(message: Any, rows: Any) -> Any:  # noqa: ARG001
    size = max(1, numbers_in(message)) * _each(message)
    return lambda message, rows: np.zeros(rows * size)  # noqa: ARG005


overload(ring, strict=False)(_ring)


def _row(context: Any, builder: Any, kind: Any, array: Any, seq: Any, message: Any) -> Any:
    """Where the row of a message begins."""
    size = ir.Constant(WHOLE, max(1, numbers_in(message)) * _each(message))
    places = builder.extract_value(context.make_array(kind)(context, builder, array).shape, 0)
    turn = builder.sub(builder.udiv(places, size), ir.Constant(WHOLE, 1))  # rows, a power of two, less one
    return builder.mul(builder.and_(seq, turn), size)


def _offsets(kind: Any) -> Iterator[Any]:
    return (ir.Constant(WHOLE, i) for i in count(0, _each(kind)))


def _cell(context: Any, builder: Any, kind: Any, array: Any, at: Any) -> Any:
    return builder.gep(context.make_array(kind)(context, builder, array).data, [at])


@intrinsic_of
def sent(typingctx: Any, kept: Any, k: Any, message: Any) -> Any:  # noqa: ARG001
    """Keep a message under the number k."""

    def make(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind = sig.args[0]
        row, offsets = _row(context, builder, kind, args[0], args[1], message), _offsets(message)

        def leaf(own: Any, value: Any) -> Any:
            at = builder.add(row, next(offsets))
            if _has_lanes(message):
                builder.store(context.cast(builder, value, own, lanes), address(context, builder, kind, args[0], at),
                              align=8)
            else:
                builder.store(context.cast(builder, value, own, types.float64),
                              _cell(context, builder, kind, args[0], at))
            return value

        tree_value(context, builder, message, message, args[2], leaf)
        return context.get_dummy_value()

    return types.none(kept, types.int64, message), make


@intrinsic_of
def placed(typingctx: Any, kept: Any, at: Any, which: Any, message: Any) -> Any:  # noqa: ARG001 - numba gives it
    """Keep a message at place `at` where `which` is true; lane by lane, where each has a place of its own."""
    own_places = isinstance(at, types.BaseTuple)

    def make(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind, offsets = sig.args[0], _offsets(message)
        places = [builder.extract_value(args[1], i) for i in range(WIDTH)] if own_places else [args[1]]
        rows = [_row(context, builder, kind, args[0], place, message) for place in places]

        def keep(pointer: Any, keeps: Any, value: Any, **aligned: int) -> None:
            builder.store(builder.select(keeps, value, builder.load(pointer, **aligned)), pointer, **aligned)

        def leaf(own: Any, value: Any) -> Any:
            offset = next(offsets)
            if not _has_lanes(message):
                keep(_cell(context, builder, kind, args[0], builder.add(rows[0], offset)), args[2],
                     context.cast(builder, value, own, types.float64))
                return value
            value = context.cast(builder, value, own, lanes)
            if not own_places:
                keep(address(context, builder, kind, args[0], builder.add(rows[0], offset)), args[2], value, align=8)
                return value
            for i, row in enumerate(rows):
                lane = ir.Constant(ir.IntType(32), i)
                place = builder.add(row, builder.add(offset, ir.Constant(WHOLE, i)))
                keep(_cell(context, builder, kind, args[0], place), builder.extract_element(args[2], lane),
                     builder.extract_element(value, lane))
            return value

        tree_value(context, builder, message, message, args[3], leaf)
        return context.get_dummy_value()

    return types.none(kept, at if own_places else types.int64, which, message), make


@intrinsic_of
def received(typingctx: Any, kept: Any, seq: Any, message: Any) -> Any:  # noqa: ARG001
    """The message of number `seq`, or the one there is if that is below zero; lane by lane, where each has its own."""
    own_links = isinstance(seq, types.BaseTuple)

    def make(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind, numbers = sig.args[0], args[1]
        if own_links:
            numbers = vector_of(builder, args[1], False)
            rows = [_row(context, builder, kind, args[0], builder.extract_value(args[1], i), message)
                    for i in range(WIDTH)]
        else:
            rows = [_row(context, builder, kind, args[0], args[1], message)]
        came, offsets = builder.icmp_signed(">=", numbers, ir.Constant(numbers.type, None)), _offsets(message)

        def leaf(own: Any, value: Any) -> Any:  # noqa: ARG001
            offset = next(offsets)
            if not _has_lanes(message):
                new = builder.load(_cell(context, builder, kind, args[0], builder.add(rows[0], offset)))
            elif not own_links:
                new = builder.load(address(context, builder, kind, args[0], builder.add(rows[0], offset)), align=8)
            else:
                new = ir.Constant(VECTOR, ir.Undefined)
                for i, row in enumerate(rows):
                    place = builder.add(builder.add(row, offset), ir.Constant(WHOLE, i))
                    one = builder.load(_cell(context, builder, kind, args[0], place))
                    new = builder.insert_element(new, one, ir.Constant(ir.IntType(32), i))
            return builder.select(came, new, value)

        return tree_value(context, builder, message, message, args[2], leaf)

    return message(kept, seq if own_links else types.int64, message), make


def _of_each(builder: Any, sig: Any, of: Any, one: Any) -> Any:
    """A tuple with what `one` makes of each entry of another, or what it makes of a thing that is no tuple."""
    if not isinstance(sig, types.BaseTuple):
        return one(sig, of)
    return [one(kind, builder.extract_value(of, i)) for i, kind in enumerate(sig.types)]


@intrinsic_of
def each(typingctx: Any, numbers: Any, t: Any) -> Any:  # noqa: ARG001
    """Eight whole numbers of a flat array, from place 8 t on, as a tuple."""

    def make(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        first = builder.mul(args[1], ir.Constant(WHOLE, WIDTH))
        return context.make_tuple(builder, sig.return_type, [
            builder.load(_cell(context, builder, sig.args[0], args[0], builder.add(first, ir.Constant(WHOLE, i))))
            for i in range(WIDTH)])

    return types.UniTuple(types.int64, WIDTH)(numbers, types.int64), make


def _at(builder: Any, place: Any, k: Any, kind: Any) -> Any:
    """The k-th of the numbers that stand at an address."""
    return builder.load(builder.gep(builder.inttoptr(place, kind.as_pointer()), [k]))


@intrinsic_of
def packet(typingctx: Any, play: Any, k: Any) -> Any:  # noqa: ARG001
    """The packet that the schedule at an address plays at tick k, or -1; for each lane, where each has its own."""

    def make(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        found = _of_each(builder, play, args[0], lambda _, place: _at(builder, place, args[1], WHOLE))
        return context.make_tuple(builder, sig.return_type, found) if isinstance(play, types.BaseTuple) else found

    return play(play, types.int64), make


@intrinsic_of
def sample(typingctx: Any, path: Any, k: Any) -> Any:  # noqa: ARG001
    """Where the path at an address is at tick k; for each lane, where each has its own."""
    own_paths = isinstance(path, types.BaseTuple)

    def make(context: Any, builder: Any, sig: Any, args: Any) -> Any:  # noqa: ARG001
        found = _of_each(builder, path, args[0], lambda _, place: _at(builder, place, args[1], ir.DoubleType()))
        if not own_paths:
            return found
        vector = ir.Constant(VECTOR, ir.Undefined)
        for i, one in enumerate(found):
            vector = builder.insert_element(vector, one, ir.Constant(ir.IntType(32), i))
        return vector

    return (lanes if own_paths else types.float64)(path, types.int64), make


@intrinsic_of
def ago(typingctx: Any, k: Any, lag: Any) -> Any:  # noqa: ARG001
    """The tick `lag` before k; below zero where there is none."""

    def make(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        found = _of_each(builder, lag, args[1], lambda kind, one: builder.sub(args[0], one))  # noqa: ARG005
        return context.make_tuple(builder, sig.return_type, found) if isinstance(lag, types.BaseTuple) else found

    return lag(types.int64, lag), make


@intrinsic_of
def tell(typingctx: Any, out: Any, which: Any, ran: Any, told: Any) -> Any:  # noqa: ARG001
    """Put the ticks that ran and the figures of these lanes in their places."""

    def make(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        def keep(i: int, value: Any) -> None:
            place = address(context, builder, sig.args[0], args[0], ir.Constant(WHOLE, i * WIDTH))
            builder.store(builder.select(args[1], value, builder.load(place, align=8)), place, align=8)

        keep(0, args[2])
        for i, kind in enumerate(told.types):
            keep(i + 1, context.cast(builder, builder.extract_value(args[3], i), kind, lanes))
        return context.get_dummy_value()

    return types.none(out, which, lanes, told), make
