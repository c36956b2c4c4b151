"""Replay of a packet-delivery trace: a recorded mobile link with a finite queue in front of it."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, field
from typing import Annotated, ClassVar

import numpy as np

from channel.effect import Effect, read_recording, refuse_line
from channel.rng import Ints, Rng
from channel.schedule import Order, by_time, nanoseconds
from teleop.errors import Refused, number
from teleop.knob import Knob

OPPORTUNITY = 1500  # bytes that one line of a trace delivers
_MS = 1_000_000


@dataclass(frozen=True, slots=True)
class Mahimahi(Effect):
    """A queue served by the delivery opportunities of a recording.

    Format: mahimahi (Netravali et al., USENIX ATC 2015); recordings of this kind: Winstein, Sivaraman,
    Balakrishnan, NSDI 2013. Each line of the file is a time in whole ms, none earlier than the one before: an
    opportunity for up to 1500 bytes that entered before it, so 15 packets of 100. At the last line's time the
    recording begins again. `start` s of it are skipped at the session's start. Packets wait first in, first
    out; one that finds `queue` packets waiting is lost. Unlike in mahimahi's own shell, a packet is never
    split over two opportunities.
    Refused: a file that is missing, no text, empty or out of order; packets of more than 1500 bytes.
    """

    order: ClassVar[Order] = "time"
    reorders: ClassVar[bool] = False
    path: Annotated[str, Knob("", "file with a delivery trace")]
    _: KW_ONLY
    queue: Annotated[int, Knob("packets", "room to wait", low=1, high=1e6)] = 2000
    start: Annotated[float, Knob("s", "time of the recording to skip", low=0.0, high=1e6)] = 0.0
    crc: int = field(init=False, repr=False)
    """Checksum of the file: other contents under the same path are another effect."""
    _ms: Ints = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if isinstance(self.queue, bool) or not isinstance(self.queue, int) or not 1 <= self.queue <= 10**6:
            raise Refused(f"queue must be a whole number of packets, 1 to 1000000, not {self.queue!r}; "
                          "write for example queue=2000")
        object.__setattr__(self, "start", number("start", self.start, low=0.0, high=1e6))
        path, lines, crc = read_recording("mahimahi", self.path)
        for name, value in (("path", path), ("crc", crc), ("_ms", opportunities(path, lines))):
            object.__setattr__(self, name, value)

    def begin(self, rng: Rng) -> int:
        """The first free slot: opportunities are counted through all repeats, each split into packets."""
        return 0

    def carry(self, state: int, packet: Ints, time_ns: Ints, size: int) -> tuple[Ints, Ints, int]:
        """The packets that found room, when their opportunity comes.

        With `soonest_i` the first slot after packet i enters and `free` the first one not taken, packet i
        takes slot max(free, soonest_i), unless free = soonest_i + queue, when the queue is full. Both cases
        are one clamp, free -> min(max(free, soonest_i) + 1, soonest_i + queue), and clamps make clamps.
        """
        if not 1 <= size <= OPPORTUNITY:
            raise Refused(f"mahimahi carries packets of 1 to {OPPORTUNITY} bytes, not {size}; "
                          "write for example packet_size=100")
        if not len(packet):
            return packet, time_ns, state
        each = OPPORTUNITY // size
        entered = time_ns + nanoseconds(self.start)
        soonest = self._next(entered) * each
        free = _free_slots(soonest, self.queue, state)
        before = np.concatenate(([state], free[:-1]))
        slot = np.maximum(before, soonest)
        has_room = before < soonest + self.queue
        leaves = self._time(slot[has_room] // each) - nanoseconds(self.start)
        return *by_time(packet[has_room], leaves), int(free[-1])

    def _next(self, time_ns: Ints) -> Ints:
        """The first opportunity later than each time: its number, repeats counted."""
        again, ms = np.divmod(time_ns // _MS, self._ms[-1])  # later than t is later than its whole ms
        return again * len(self._ms) + np.searchsorted(self._ms, ms, side="right")

    def _time(self, opportunity: Ints) -> Ints:
        """The time of its delivery, ns."""
        again, line = np.divmod(opportunity, len(self._ms))
        time: Ints = (again * self._ms[-1] + self._ms[line]) * _MS
        return time


def _free_slots(soonest: Ints, queue: int, free: int) -> Ints:
    """The first free slot after each packet, (n,): the clamps of `carry`, composed by doubling.

    In terms of free - (packets so far) packet i clamps to [soonest_i - i, soonest_i + queue - i - 1]; after
    round j each row holds the composition of the 2^j clamps that end with its own.
    """
    row = np.arange(len(soonest))
    low, high = soonest - row, soonest - row + (queue - 1)
    step = 1
    while step < len(row):
        low[step:], high[step:] = (np.clip(low[:-step], low[step:], high[step:]),
                                   np.clip(high[:-step], low[step:], high[step:]))
        step *= 2
    slots: Ints = np.clip(free, low, high) + row + 1
    return slots


def opportunities(path: str, lines: list[str]) -> Ints:
    """The times of a trace, ms, (n,), checked line by line."""
    last = 0
    times = []
    for line, text in enumerate(lines, 1):
        if not text.strip():
            continue
        if not (text.strip().isascii() and text.strip().isdecimal() and len(text) < 16):
            refuse_line(path, line, f"{text.strip()[:40]!r} is no whole number of ms, as each line of a "
                        "delivery trace is: delete it if the file was cut off, else record again")
        ms = int(text)
        if ms < last:
            refuse_line(path, line, f"{ms} ms comes after {last} ms; a delivery trace never goes back: "
                        "sort it (sort -n) or record again")
        last = ms
        times.append(ms)
    if last == 0:
        refuse_line(path, len(lines), "the recording ends at 0 ms, too short to repeat; record again")
    return np.array(times, np.int64)
