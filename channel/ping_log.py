"""Replay of a `ping -D` log: any path on the internet, recorded with what every computer has."""

from __future__ import annotations

import re
from dataclasses import KW_ONLY, dataclass, field
from itertools import pairwise
from typing import Annotated

import numpy as np

from channel.effect import LONGEST, Effect, read_recording, refuse_line
from channel.rng import Ints, Rng
from channel.schedule import by_time, nanoseconds
from teleop.errors import Refused, number, number_of, plural
from teleop.knob import Knob

_STAMP = re.compile(r"\[(\d{1,12})\.(\d{1,9})\] (.*)")
_SEQ = re.compile(r"icmp_seq=(\d{1,5})\b")
_RTT = re.compile(r" time=(\d{1,8}(?:\.\d+)?) ms\b")
_AROUND = re.compile(r"PING |---|\d+ packets transmitted|rtt |round-trip |pipe \d|ping: |[0-9.]+%|\^C")  # of ping's own
_CLOCK = re.compile(r"time of day goes back", re.IGNORECASE)
_LOST = -1
_PAUSE = 1e9  # ns between probes where a single reply does not tell: ping's own default
_MOST = 10_000_000  # probes
SLACK, GRACE = 5.0, 1e9  # times the interval, ns: probes come late where a computer is busy


@dataclass(frozen=True, slots=True)
class PingLog(Effect):
    """A packet takes the newest probe sent at or before its time: half the probe's round trip each way.

    A probe without a reply (its number missing, "no answer yet", unreachable) loses the packets of both
    directions, since the log cannot tell which way it was lost. A second reply (DUP!) is ignored, so are
    heading and summary. The log's clock starts at its first probe; `start` s of it are skipped at the
    session's start, and it begins again one probe interval after its last probe. Record with
    `ping -D -i 0.01 HOST > FILE`.
    Refused: a file that is missing, no text, empty, cut off in a line, out of order, or without time stamps; with lines
    that ping does not write; and one whose clock was set, or that stood still, while ping ran: see `_steady`.
    """

    path: Annotated[str, Knob("", "file that `ping -D` wrote")]
    _: KW_ONLY
    start: Annotated[float, Knob("s", "time of the recording to skip", low=0.0, high=1e6)] = 0.0
    crc: int = field(init=False, repr=False)
    """Checksum of the file: other contents under the same path are another effect."""
    _sent: Ints = field(init=False, repr=False, compare=False)  # ns from the first probe
    _delay: Ints = field(init=False, repr=False, compare=False)  # ns one way, or _LOST
    _period: int = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", number("start", self.start, low=0.0, high=1e6))
        path, lines, crc = read_recording("ping_log", self.path)
        sent, delay, period = probes(path, lines)
        for name, value in (("path", path), ("crc", crc), ("_sent", sent), ("_delay", delay), ("_period", period)):
            object.__setattr__(self, name, value)

    def carry(self, state: Rng, packet: Ints, time_ns: Ints, size: int) -> tuple[Ints, Ints, Rng]:
        """The packets whose probe was answered, half its round trip later."""
        now = (time_ns + nanoseconds(self.start)) % self._period
        delay = self._delay[np.searchsorted(self._sent, now, side="right") - 1]
        back = delay != _LOST
        return *by_time(packet[back], time_ns[back] + delay[back]), state


def probes(path: str, lines: list[str]) -> tuple[Ints, Ints, int]:
    """Send times from the first probe on (n,), one-way delays or -1 (n,), and the log's period: all in ns.

    A probe was sent its round trip before the reply's stamp; lost ones lie between their neighbours.
    """
    answered: dict[int, tuple[int, int]] = {}  # number -> sent, round trip
    line_of: dict[int, int] = {}  # number -> line
    newest = first = None
    last_stamp = 0
    for line, text in enumerate(lines, 1):
        if not text.startswith("["):
            _check_around(path, line, text)
            continue
        stamp, seq, rtt = _line(path, line, text)
        if stamp < last_stamp:
            refuse_line(path, line, "its time stamp lies before the one above: the clock was set or "
                        "lines were moved; cut the log here, or record again")
        last_stamp = stamp
        if newest is not None:
            seq += 65536 * round((newest - seq) / 65536)  # the number has 16 bits and starts again
        newest = seq if newest is None else max(newest, seq)
        first = seq if first is None else min(first, seq)
        if rtt is None:
            continue
        if seq not in answered:
            answered[seq] = (stamp - rtt, rtt)
            line_of[seq] = line
        elif "(DUP!)" not in text:
            refuse_line(path, line, f"probe {seq} is answered again, without (DUP!): these are two logs "
                        "in one file; cut them apart")
    if first is None or newest is None or not answered:
        raise Refused(f"{path} holds no reply of a ping -D log; record one: ping -D -i 0.01 HOST > {path}")
    _steady(path, answered, line_of)
    return _evenly(path, first, newest, answered)


def _check_around(path: str, line: int, text: str) -> None:
    """Refuse a line without a time stamp that is none of those that ping writes around its replies."""
    if _CLOCK.search(text):
        refuse_line(path, line, "ping says that the clock was set back; cut the log here, or record again")
    if _SEQ.search(text):
        refuse_line(path, line, "this line has no time stamp; record again with ping -D")
    if text.strip() and not _AROUND.match(text.strip()):
        refuse_line(path, line, f"{text.strip()[:60]!r} is no line of a ping -D log; delete it")


def _steady(path: str, answered: dict[int, tuple[int, int]], line_of: dict[int, int]) -> None:
    """Refuse a log whose probes were not sent about evenly.

    Ping sends one probe after another at its interval, whatever becomes of them. So between two replies the time and
    the number of probes go together: much more time than that many intervals, and the clock was set forward, or the
    computer slept; much less, or the time of the later probe before that of the earlier, and it was set back, or lines
    of another log follow. The interval is the median of all that are there, `SLACK` times it are allowed, and `GRACE`.
    """
    numbers = sorted(answered)
    steps = [(answered[b][0] - answered[a][0]) / (b - a) for a, b in pairwise(numbers)]
    if not steps:
        return
    interval = sorted(steps)[len(steps) // 2]
    for a, b in pairwise(numbers):
        took, even = answered[b][0] - answered[a][0], (b - a) * interval
        if took > SLACK * even + GRACE or took < even / SLACK - GRACE:
            refuse_line(
                path, line_of[b], f"probe {b} was sent {took / 1e9:.3g} s after probe {a}, and "
                f"{number_of(b - a, 'interval')} of this log's probes {plural(b - a, 'takes', 'take')} "
                f"{even / 1e9:.3g} s: the clock was set, the recording stood still, or this is another log; cut it "
                "here, or record again")


def _line(path: str, line: int, text: str) -> tuple[int, int, int | None]:
    """The stamp in ns, the probe's number, and its round trip in ns or None."""
    stamped, seq = _STAMP.match(text), _SEQ.search(text)
    if stamped is None or seq is None:
        refuse_line(path, line, f"{text[:60]!r} is no line of a ping -D log; delete it if the file "
                    "was cut off")
    stamp = int(stamped[1]) * 10**9 + int(stamped[2].ljust(9, "0"))
    if " bytes from " not in text:
        return stamp, int(seq[1]), None
    rtt = _RTT.search(text)
    if rtt is None:
        refuse_line(path, line, f"the reply {text[-40:]!r} has no time=... ms; delete it if the file "
                    "was cut off")
    took = round(float(rtt[1]) * 1e6)
    if took > nanoseconds(2 * LONGEST):
        refuse_line(path, line, f"a round trip of {took / 1e9:g} s is longer than the {2 * LONGEST:g} s "
                    "that can be replayed; delete the line")
    return stamp, int(seq[1]), took


def _evenly(path: str, first: int, newest: int, answered: dict[int, tuple[int, int]]) -> tuple[Ints, Ints, int]:
    """Put the probes without a reply between the others: all from `first` to `newest`, by number."""
    if newest - first > _MOST:
        raise Refused(f"{path} counts {newest - first} probes, too many for one log; cut it into parts")
    known = np.array(sorted(answered))
    began = answered[int(known[0])][0]
    sent_known = np.array([answered[seq][0] - began for seq in known.tolist()], np.float64)
    interval = float(sent_known[-1]) / float(known[-1] - known[0]) if len(known) > 1 else _PAUSE
    seq = np.arange(first, newest + 1)
    outside = np.minimum(seq - known[0], 0) + np.maximum(seq - known[-1], 0)
    sent = np.interp(seq, known, sent_known) + interval * outside
    sent_ns = np.maximum.accumulate(np.rint(sent - sent[0]).astype(np.int64))
    delay = np.full(len(seq), _LOST, np.int64)
    delay[known - first] = [answered[number][1] // 2 for number in known.tolist()]
    return sent_ns, delay, int(sent_ns[-1]) + max(round(interval), 1)
