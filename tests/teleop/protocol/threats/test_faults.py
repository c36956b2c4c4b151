"""The eight communication faults of IEC 61784-3, each met by its measure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import pairwise
from math import isfinite
from typing import NamedTuple

import numpy as np
import pytest

from teleop.protocol.endpoint import Endpoint
from teleop.scene.playout import Fixed, Playout, Zero
from tests.teleop.protocol.ends import Both
from tests.teleop.protocol.threats.hands import (
    OTHER,
    TAKEOVER,
    WATCHED,
    Change,
    control,
    data,
    handed_on,
    untouched,
)


class Fault(NamedTuple):
    """What happens to packets 150 to 249 of either way, and what the end that gets them makes of it."""

    change: Change
    count: Callable[[Endpoint], int]
    counted: int
    falls: bool = False  # does the watchdog let go
    changes: bool = False  # is there any trace of it in the run
    playout: Playout = Zero()


def of_inbox(name: str) -> Callable[[Endpoint], int]:
    return lambda end: int(getattr(end.inbox, name))


def rejected(cause: str) -> Callable[[Endpoint], int]:
    return lambda end: end.rejected[cause]


def beside(datagram: Callable[[int, str], bytes]) -> Change:
    return lambda e, k, good: [(10, datagram(k, e)), (10, good)]


FAULTS = {  # by name; behind each its measure
    "corruption": Fault(  # CRC-32 over all of the packet; with keys the seal
        lambda _e, k, good: [(10, good[: k % 60] + bytes([good[k % 60] ^ 1]) + good[k % 60 + 1 :])],
        lambda end: sum(end.rejected.values()), 100, falls=True, changes=True),
    "repetition": Fault(  # a window of the numbers that came
        lambda _e, _k, good: [(10, good), (10, good), (40, good)], of_inbox("duplicates"), 200),
    "wrong sequence": Fault(  # sequence numbers; the numbers played only grow
        lambda _e, k, good: [(10 if k % 2 else 13, good)], of_inbox("overtaken"), 50, changes=True),
    "loss": Fault(  # the watchdog
        lambda _e, _k, _good: [], of_inbox("received"), WATCHED.ticks - 10 - 100, falls=True, changes=True),
    "delay": Fault(  # a fixed playout, and the watchdog
        lambda _e, _k, good: [(110, good)], of_inbox("late"), 100, falls=True, changes=True, playout=Fixed(0.015)),
    "insertion": Fault(  # the session number; with keys the seal
        beside(lambda k, e: data(k, 50.0, to=e, session=OTHER)), rejected("session"), 100),
    "masquerade": Fault(  # the session number; with keys the pinned certificate
        beside(lambda k, _e: control(*TAKEOVER[k % len(TAKEOVER)], session=OTHER)), rejected("session"), 100),
    "wrong address": Fault(  # the socket keeps to its peer; the length of the law's message, the session number
        beside(lambda k, e: data(k, payload=(1.0, 2.0), to=e, session=OTHER)), rejected("malformed"), 100),
}


@cache
def honest_run(playout: Playout) -> Both:
    return handed_on(untouched, replace(WATCHED, playout=playout))


@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_of_iec_61784_3_meets_its_measure(name: str) -> None:
    fault = FAULTS[name]
    kept = replace(WATCHED, playout=fault.playout)
    both = handed_on(lambda e, k, good: (fault.change if 150 <= k < 250 else untouched)(e, k, good), kept)
    honest = honest_run(fault.playout)
    assert (both.rows != honest.rows) is fault.changes
    for e in "ms":
        assert fault.count(both.ends[e]) == fault.counted
        assert all(isfinite(force) for force, in both.held[e])
        numbers = [number for number in both.played[e] if number >= 0]
        assert set(numbers) <= set(honest.played[e])
        assert all(one < other for one, other in pairwise(numbers))
        assert both.played[e][-100:] == honest.played[e][-100:]  # and it is over when it is over
        gain = both.gains(e)
        assert bool(gain.min() == 0.0) is fault.falls
        assert gain[-1] == 1.0
        if fault.falls:
            assert not {*range(150, 250)} & set(numbers)
            assert all(both.held[e][k] == (0.0,) for k in np.flatnonzero(gain == 0.0))
        else:
            assert gain.min() == 1.0
