"""The check of an effect against what `channel.effect` promises: `check_effect(Mine())`."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from channel.effect import Effect
from channel.rng import BLOCK, Ints, Rng
from channel.schedule import by_number, by_time
from teleop.errors import Refused

Rows = tuple[Ints, Ints]


def check_effect(effect: Effect, *, size: int = 100) -> None:
    """Refuse an effect with one sentence for the first promise that it breaks.

    Tried on packets sent at 1 kHz, and on a run with ties, gaps, doubled packets and packets out of order:
    rows in and out, cuts into pieces, states carried on twice, random numbers, and the class's `order` and `reorders`.
    """
    sent = np.arange(BLOCK + 300, dtype=np.int64)
    in_step = sent, sent * 1_000_000
    some, again = sent[::3], sent[50:60]
    jumbled = (some * 700_001 + some * 7919 % 40_000_000) // 10_000 * 10_000
    rough = by_time(np.concatenate((some, again)) + 7, np.concatenate((jumbled, again * 900_000)))
    for packet, time_ns in (in_step, rough):
        rows = by_number(packet, time_ns) if effect.order == "number" else (packet, time_ns)
        _rows(effect, rows, size)
        _pieces(effect, rows, size)
    out, _ = _carried(effect, [in_step], size)
    _require(effect.reorders or bool(np.all(np.diff(out) >= 0)), effect, "reorders; its class says it does not")
    if effect.constant_ns is not None:
        packet, time_ns, _ = effect.carry(effect.begin(Rng(1, 0, 0)), *in_step, size)
        same = np.array_equal(packet, in_step[0]) and np.array_equal(time_ns, in_step[1] + effect.constant_ns)
        _require(same, effect, "does more than the constant delay that its `constant_ns` states")
    _dice(effect, size)


def _rows(effect: Effect, rows: Rows, size: int) -> None:
    """Rows in are left as they are; rows out are sorted, are among those in, and are the same a second time."""
    packet, time_ns = rows[0].copy(), rows[1].copy()
    state = effect.begin(Rng(1, 0, 0))
    out, time_out, _ = effect.carry(state, *rows, size)
    _require(np.array_equal(packet, rows[0]) and np.array_equal(time_ns, rows[1]), effect, "wrote to its input")
    _require(out.dtype == np.int64 and time_out.dtype == np.int64 and out.shape == time_out.shape == (len(out),),
         effect, "must return two int64 arrays of one length")
    _require(_same((out, time_out), by_time(out, time_out)), effect, "returns rows not sorted by (time, number)")
    first: dict[int, int] = {}
    for number, time in zip(packet.tolist(), time_ns.tolist(), strict=True):
        first[number] = min(time, first.get(number, time))
    for number, time in zip(out.tolist(), time_out.tolist(), strict=True):
        _require(number in first, effect, f"invented packet {number}")
        _require(time >= first[number], effect, f"lets packet {number} leave before it entered")
    again = effect.carry(state, *rows, size)[:2]
    _require(_same((out, time_out), again), effect, "changes a state that was handed to it")
    _require(_same((out, time_out), _carried(effect, [rows], size)), effect, "has random numbers of its own")


def _pieces(effect: Effect, rows: Rows, size: int) -> None:
    """Check that a run in pieces, down to single packets, comes out the same."""
    whole = _carried(effect, [rows], size)
    count = len(rows[0])
    uneven = [0, 1, 1, 3, 10, 300, 301, count]
    for cuts in (range(count + 1), uneven):
        pieces = [(rows[0][a:b], rows[1][a:b]) for a, b in zip(cuts, [*cuts][1:], strict=False)]
        _require(_same(whole, _carried(effect, pieces, size)), effect, "treats pieces of a run unlike the whole")
        if effect.order == "any":
            _require(_same(whole, _carried(effect, pieces[::-1], size)), effect,
                 'depends on the order of packets, so its class must say order = "time" or "number"')


def _dice(effect: Effect, size: int) -> None:
    """Check that an effect whose outcome depends on the seed depends on direction and place in the chain too."""
    packet = np.arange(4 * BLOCK, dtype=np.int64)

    def outcome(rng: Rng) -> Rows:
        out, time_out, _ = effect.carry(effect.begin(rng), packet, packet * 1_000_000, size)
        return out, time_out

    base = outcome(Rng(1, 0, 0))
    if any(_same(base, outcome(Rng(seed, 0, 0))) for seed in range(2, 10)):
        return  # no random numbers, or so rarely drawn that equal runs prove nothing
    _require(not _same(base, outcome(Rng(1, 1, 0))), effect, "draws the same random numbers in both directions")
    _require(not _same(base, outcome(Rng(1, 0, 1))), effect, "draws the same random numbers at every place in a chain")


def _carried(effect: Effect, pieces: Iterable[Rows], size: int) -> Rows:
    """The rows that come out of all pieces, sorted by (time, number)."""
    state = effect.begin(Rng(1, 0, 0))
    packets, times = [], []
    for piece in pieces:
        packet, time_ns, state = effect.carry(state, *piece, size)
        packets.append(packet)
        times.append(time_ns)
    return by_time(np.concatenate(packets), np.concatenate(times))


def _same(one: Rows, another: Rows) -> bool:
    return np.array_equal(one[0], another[0]) and np.array_equal(one[1], another[1])


def _require(holds: bool, effect: Effect, what: str) -> None:
    if not holds:
        raise Refused(f"{effect!r} {what}")
