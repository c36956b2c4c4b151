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

from teleop.sweeps.kernels.engines import lane_part
from teleop.sweeps.kernels.lanes import WIDTH, any_lane, broadcast, invert, lane, load, select, with_lane
from teleop.sweeps.kernels.rings import as_lanes, get, put, put_selected, ring, store

ODD = [0.0, -0.0, 1.0, -1.5, 1e-310, -3e-320, 1e308, -1e308, math.inf, -math.inf, math.nan, math.pi]
PAIRS = np.array([*product(ODD, ODD), *[(0.1 * i, 7.0 - 0.3 * i) for i in range(WIDTH)]])[: 144 + WIDTH]


def bits(value: float) -> bytes:
    """The bits of a float; every NaN is the same."""
    return b"nan" if value != value else np.float64(value).tobytes()  # noqa: PLR0124


def on_lanes(*functions: Callable[..., Any]) -> list[list[float]]:
    """What each of several functions of two floats makes of all pairs, eight at a time."""
    names = {f"f{i}": njit(error_model="numpy")(function) for i, function in enumerate(functions)}
    exec(f"def all_of(x, y): return ({''.join(f'broadcast({name}(x, y)), ' for name in names)})",
         names | {"broadcast": broadcast}, names)
    all_of = njit(error_model="numpy")(names["all_of"])

    @njit
    def call(x: Any, y: Any, out: Any) -> None:
        store(out, broadcast(0.0) <= 0.0, 0, all_of(load(x, 0), load(y, 0)))

    found = []
    for first in range(0, len(PAIRS), WIDTH):
        x, y = np.ascontiguousarray(PAIRS[first:first + WIDTH].T)
        out = np.zeros((1 + len(functions), WIDTH))
        call(x, y, out.ravel())
        found.append(out[1:])
    return np.concatenate(found, axis=1).tolist()  # type: ignore[no-any-return]


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


def test_an_operation_on_lanes_is_pythons_in_each_of_them() -> None:
    """Of all pairs of zeros of both signs, subnormal and huge numbers, infinities and NaN."""
    found = on_lanes(*[ours for ours, _ in OPERATIONS.values()])
    for (name, (_, python)), values in zip(OPERATIONS.items(), found, strict=True):
        with np.errstate(all="ignore"):
            wanted = [bits(float(python(x, y))) for x, y in PAIRS.tolist()]
        assert list(map(bits, values)) == wanted, name


@pytest.mark.parametrize("branch", [lambda x, y: x if x < y else y, lambda x, y: x and y])
def test_a_branch_on_lanes_is_refused_when_it_is_compiled(branch: Callable[..., Any]) -> None:
    with pytest.raises(TypingError):
        on_lanes(branch)


def test_a_mask_chooses_lane_by_lane() -> None:
    def either(x: Any, y: Any) -> Any:
        return select((x < y) | (x == 1.0), x, -1.0) + select(invert(x < y) & (y > 0.0), y, 0.0)

    wanted = [(x if x < y or x == 1.0 else -1.0) + (y if not x < y and y > 0.0 else 0.0) for x, y in PAIRS.tolist()]
    assert list(map(bits, on_lanes(either)[0])) == list(map(bits, wanted))


def leaves_early(x: float, y: float) -> float:
    if x < 0.0:
        if not y > x:
            return y - 1.0
        x = x + 2.0
    elif x < 1.0 < y or x == y:
        return x * y
    total = 0.0
    if -1.0 < x <= y and not x > 5.0:
        total = total + x
    else:
        y = y - 1.0
        if y > x or total > 0.0:
            total = total - y
    return total if total < 2.0 else y


def sorted_pair(x: float, y: float) -> tuple[float, float]:
    if x > y:
        x, y = y, x
    return x, y


def calls_another(x: float, y: float) -> float:
    low, high = sorted_pair(x, y)
    return leaves_early(low, high) if low > -2.0 else high


def many_lines(x: float, y: float) -> float:
    a = b = c = d = 0.0
    if x > 0.5:
        a = x + y
        b = a * x
        c = b - y
        d = c / x
        a = d - a
        b = b + a * d
        c = min(a, b)
        d = max(c, d)
    return a + b + c + d


def test_a_function_that_branches_was_refused_though_its_branches_can_be_masks() -> None:
    branching = (leaves_early, calls_another, many_lines)
    a, b, c = [lane_part(f"{__name__}:{function.__name__}") for function in branching]
    found = on_lanes(lambda x, y: a(x, y), lambda x, y: b(x, y), lambda x, y: c(x, y))  # noqa: PLW0108 - numba takes it
    for function, values in zip(branching, found, strict=True):
        with np.errstate(all="ignore"):
            wanted = [bits(float(function(*map(np.float64, pair)))) for pair in PAIRS]
        assert list(map(bits, values)) == wanted, function.__name__


class Pair(NamedTuple):
    a: float
    b: tuple[float, float]


def test_a_tree_is_broadcast_taken_apart_and_put_together_lane_by_lane() -> None:
    @njit
    def reversed_lanes(x: Any, out: Any) -> None:
        tree = Pair(load(x, 0), (2.0, load(x, 8)))
        told = broadcast(lane(tree, 0))
        for i in range(WIDTH):
            told = with_lane(told, i, lane(tree, WIDTH - 1 - i))
        store(out, told.b[0] > 0.0, 7, (told.a, told.b[0], told.b[1]))

    x, out = np.arange(16.0), np.zeros(4 * WIDTH)
    reversed_lanes(x, out)
    assert out.reshape(4, WIDTH).tolist() == [[7.0] * 8, x[7::-1].tolist(), [2.0] * 8, x[:7:-1].tolist()]


def test_any_lane_asks_whether_a_lane_is_true() -> None:
    @njit
    def any_above(x: Any, y: float) -> bool:
        return bool(any_lane(load(x, 0) > y))

    x = np.arange(8.0)
    assert any_above(x, 6.5)
    assert not any_above(x, 7.0)


def replay(size: int, play: list[int], lanes: bool) -> tuple[list[Any], list[Any]]:
    """What a ring gives at ticks that play these packets, and what it was given."""

    @njit
    def scalar(play: Any, size: int, played: Any) -> None:
        message = Pair(-1.0, (-1.0, -1.0))
        kept = ring(message, size)
        for k in range(len(play)):
            if play[k] >= 0:
                message = get(kept, play[k], size)
            played[k] = message.a + 1000.0 * message.b[1]
            put(kept, k, size, Pair(1.0 * k, (0.0, 2.0 * k)))

    @njit
    def vector(plays: Any, size: int, played: Any) -> None:
        nothing = broadcast(-1.0)
        message = Pair(nothing, (nothing, nothing))
        kept = ring(message, size)
        for k in range(len(plays[0])):
            a, b = plays[0][k], plays[1][k]
            seq = as_lanes((a, b, a, b, a, b, a, b))
            message = select(seq >= 0, get(kept, seq, size), message)
            store(played[k], nothing < 0.0, 0, (message.a + 1000.0 * message.b[1],))
            put(kept, k, size, Pair(broadcast(k), (broadcast(0.0), broadcast(2.0 * k))))

    expected, last = [], -1.0
    for seq in play:
        last = float(seq) if seq >= 0 else last
        expected.append(last + 1000.0 * (2.0 * last if last >= 0 else -1.0))
    if lanes:
        found = np.zeros((len(play), 2 * WIDTH))
        vector((np.array(play), np.array(play[:1] + play[:-1])), size, found)
        return found[:, WIDTH].tolist(), expected
    found = np.zeros(len(play))
    scalar(np.array(play), size, found)
    return found.tolist(), expected


@pytest.mark.parametrize("lanes", [False, True])
def test_a_ring_gives_back_the_message_that_is_played(lanes: bool) -> None:
    play = [-1, 0, -1, 2, 1, -1, 5, 6, -1, 4, 9, 10]
    got, wanted = replay(8, play, lanes)
    assert got == wanted


def test_a_message_is_kept_in_the_places_and_for_the_lanes_that_a_mask_names() -> None:
    @njit
    def kept_apart(out: Any) -> None:
        place = as_lanes((0, 1, 2, 3, 3, 2, 1, 0))
        kept = ring(broadcast(0.0), 4)
        put(kept, 2, 4, broadcast(-5.0))
        put_selected(place < 3, kept, place, 4, place + 10.0)
        for k in range(4):
            store(out[k], place >= 0, k, (get(kept, k, 4),))

    out = np.zeros((4, 2 * WIDTH))
    kept_apart(out)
    assert out[:, WIDTH:].tolist() == [
        [10.0, 0, 0, 0, 0, 0, 0, 10.0], [0, 11.0, 0, 0, 0, 0, 11.0, 0],
        [-5.0, -5.0, 12.0, -5.0, -5.0, 12.0, -5.0, -5.0], [0.0] * 8]
