"""What stands in a lane means there what it means in plain Python, to the last bit."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import pytest
from numba import njit
from numba.core.errors import TypingError

from teleop.sweeps.kernels.lanes import WIDTH
from teleop.sweeps.kernels.lanewise import came, lane, load, put, some, spread, where, whole, within
from teleop.sweeps.kernels.rings import ago, received, ring, sent, tell

ODD = [0.0, -0.0, 1.0, -1.5, 1e-310, -3e-320, 1e308, -1e308, math.inf, -math.inf, math.nan, math.pi]
PAIRS = np.array([*product(ODD, ODD), *[(0.1 * i, 7.0 - 0.3 * i) for i in range(WIDTH)]])[: 144 + WIDTH]


def bits(value: float) -> bytes:
    """The bits of a float; every NaN is the same."""
    return b"nan" if value != value else np.float64(value).tobytes()  # noqa: PLR0124


def on_lanes(function: Callable[..., Any]) -> Callable[..., list[float]]:
    """A function of two floats, on eight pairs at a time."""
    compiled = njit(error_model="numpy")(function)

    @njit
    def call(x: Any, y: Any, out: Any) -> None:
        one = spread(compiled(load(x, 0), load(y, 0)))
        tell(out, came(spread(0.0)), 0, (one,))

    def run(pairs: Any) -> list[float]:
        found: list[float] = []
        for first in range(0, len(pairs), WIDTH):
            x, y = np.ascontiguousarray(pairs[first:first + WIDTH].T)
            out = np.zeros(2 * WIDTH)
            call(x, y, out)
            found += out[WIDTH:].tolist()
        return found

    return run


def quotient(x: float, y: float) -> float:
    with np.errstate(all="ignore"):
        return float(np.float64(x) / np.float64(y))


def max_of(x: float, y: float) -> float:
    return max(x, y)


def min_of(x: float, y: float) -> float:
    return min(x, y)


OPERATIONS: dict[str, tuple[Callable[..., Any], Callable[..., Any]]] = {
    "x + y": (lambda x, y: x + y, operator.add),
    "x - y": (lambda x, y: x - y, operator.sub),
    "x * y": (lambda x, y: x * y, operator.mul),
    "x / y": (lambda x, y: x / y, quotient),
    "-x": (lambda x, y: -x, lambda x, y: -x),  # noqa: ARG005
    "abs(x)": (lambda x, y: abs(x), lambda x, y: abs(x)),  # noqa: ARG005
    "sqrt(abs(x))": (lambda x, y: math.sqrt(abs(x)), lambda x, y: math.sqrt(abs(x))),  # noqa: ARG005
    "max(x, y)": (max_of, max),
    "min(x, y)": (min_of, min),
    "max(x, 0.0, y)": (lambda x, y: max(x, 0.0, y), lambda x, y: max(x, 0.0, y)),
    "x * (x < y)": (lambda x, y: x * (x < y), lambda x, y: x * (x < y)),
    "x * (x <= y)": (lambda x, y: x * (x <= y), lambda x, y: x * (x <= y)),
    "y * (x > y)": (lambda x, y: y * (x > y), lambda x, y: y * (x > y)),
    "y * (x >= 1)": (lambda x, y: y * (x >= 1), lambda x, y: y * (x >= 1)),
    "y * (x == y)": (lambda x, y: y * (x == y), lambda x, y: y * (x == y)),
    "y * (x != y)": (lambda x, y: y * (x != y), lambda x, y: y * (x != y)),
    "2 * x + True": (lambda x, y: 2 * x + True, lambda x, y: 2 * x + True),  # noqa: ARG005
    "x * x * x - y / 3.0": (lambda x, y: x * x * x - y / 3.0, lambda x, y: x * x * x - y / 3.0),
}


@pytest.mark.parametrize("name", OPERATIONS)
def test_an_operation_on_lanes_is_pythons_in_each_of_them(name: str) -> None:
    """Of all pairs of zeros of both signs, subnormal and huge numbers, infinities and NaN."""
    ours, python = OPERATIONS[name]
    with np.errstate(all="ignore"):
        wanted = [bits(float(python(x, y))) for x, y in PAIRS.tolist()]
    assert [bits(each) for each in on_lanes(ours)(PAIRS)] == wanted


@pytest.mark.parametrize("branch", [
    lambda x, y: x if x < y else y, lambda x, y: x and y, lambda x, y: 1.0 if not x > y else 2.0,
])
def test_a_branch_on_lanes_is_refused_when_it_is_compiled(branch: Callable[..., Any]) -> None:
    with pytest.raises(TypingError):
        on_lanes(branch)(PAIRS[:WIDTH])


def test_a_mask_chooses_lane_by_lane() -> None:
    def either(x: Any, y: Any) -> Any:
        return where((x < y) | (x == 1.0), x, -1.0) + where(~(x < y) & (y > 0.0), y, 0.0)

    wanted = [(x if x < y or x == 1.0 else -1.0) + (y if not x < y and y > 0.0 else 0.0) for x, y in PAIRS.tolist()]
    assert list(map(bits, on_lanes(either)(PAIRS))) == list(map(bits, wanted))


def test_within_is_pythons_chained_comparison() -> None:
    got = on_lanes(lambda x, y: within(x, y) * 1.0)(PAIRS)
    assert got == [1.0 * (-y < x < y) for x, y in PAIRS.tolist()]


class Pair(NamedTuple):
    a: float
    b: tuple[float, float]


def test_a_tree_is_spread_taken_apart_and_put_together_lane_by_lane() -> None:
    @njit
    def reversed_lanes(x: Any, out: Any) -> None:
        tree = Pair(load(x, 0), (2.0, load(x, 8)))
        told = spread(lane(tree, 0))
        for i in range(WIDTH):
            told = put(told, i, lane(tree, WIDTH - 1 - i))
        tell(out, within(0.0, told.b[0]), 7, (told.a, told.b[0], told.b[1]))

    x, out = np.arange(16.0), np.zeros(4 * WIDTH)
    reversed_lanes(x, out)
    assert out.reshape(4, WIDTH).tolist() == [[7.0] * 8, x[7::-1].tolist(), [2.0] * 8, x[:7:-1].tolist()]


def test_some_asks_whether_any_lane_is_true() -> None:
    @njit
    def any_above(x: Any, y: float) -> bool:
        return bool(some(load(x, 0) > y))

    x = np.arange(8.0)
    assert any_above(x, 6.5)
    assert not any_above(x, 7.0)


def replay(size: int, play: list[int], lanes: bool) -> tuple[list[Any], list[Any]]:
    """What a ring gives at ticks that play these packets, and what it was given."""

    @njit
    def scalar(play: Any, size: int, told: Any) -> None:
        kept, message = ring(Pair(0.0, (0.0, 0.0)), size), Pair(-1.0, (-1.0, -1.0))
        for k in range(len(play)):
            message = received(kept, play[k], message)
            told[k] = message.a + 1000.0 * message.b[1]
            sent(kept, k, Pair(1.0 * k, (0.0, 2.0 * k)))

    @njit
    def vector(plays: Any, size: int, told: Any) -> None:
        nothing = spread(-1.0)
        message = Pair(nothing, (nothing, nothing))
        kept = ring(message, size)
        for k in range(len(plays[0])):
            a, b = plays[0][k], plays[1][k]
            seq = (a, b, a, b, a, b, a, b)
            message = received(kept, seq, message)
            one = message.a + 1000.0 * message.b[1]
            tell(told[k], came(spread(1.0)), 0, (one,))
            sent(kept, k, Pair(spread(k), (spread(0.0), spread(2.0 * k))))

    expected, last = [], -1.0
    for seq in play:
        last = float(seq) if seq >= 0 else last
        expected.append(last + 1000.0 * (2.0 * last if last >= 0 else -1.0))
    if lanes:
        told = np.zeros((len(play), 2 * WIDTH))
        vector((np.array(play), np.array(play[:1] + play[:-1])), size, told)
        return told[:, WIDTH].tolist(), expected
    told = np.zeros(len(play))
    scalar(np.array(play), size, told)
    return told.tolist(), expected


@pytest.mark.parametrize("lanes", [False, True])
def test_a_ring_gives_back_the_message_that_is_played(lanes: bool) -> None:
    play = [-1, 0, -1, 2, 1, -1, 5, 6, -1, 4, 9, 10]
    got, wanted = replay(8, play, lanes)
    assert got == wanted


def test_lags_and_packets_of_each_lane_are_reckoned_apart() -> None:
    @njit
    def behind(k: int, lag: Any, out: Any) -> None:
        then = ago(k, lag)
        tell(out, came(then), k, (whole(then),))

    out = np.full(2 * WIDTH, -9.0)
    behind(3, (0, 1, 2, 3, 4, 5, 6, 7), out)
    assert out.tolist() == [3.0] * 4 + [-9.0] * 4 + [3.0, 2.0, 1.0, 0.0] + [-9.0] * 4
