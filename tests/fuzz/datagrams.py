"""Hostile datagrams, drawn from a seed: noise, and whatever can be made of honest ones with and without their checksum.

What comes out is of one of two classes. `outside` is of nobody who knows the running session, or cannot be a message
of it that is new: nothing of it may be seen in what an end does. `inside` is a well-made, finite message with the
session's own number, as who reads the link can make it where there are no keys: it is believed, within the cap.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from math import inf, nan
from struct import pack
from typing import Any
from zlib import crc32

import msgpack

from teleop.protocol.manifest import EVERY, TICK_0
from teleop.protocol.packet import VERSION, Echo, Kind, Packet, decode, encode
from teleop.protocol.session import NEXT

KEPT = 256  # honest datagrams that are remembered, to be thrown again
NUMBERS = (0, 1, -1, 2, 255, 2**15, 2**31 - 1, 2**31, 2**32 - 1, 2**32, 2**53, 2**61, 2**62, 2**63 - 1, 2**63,
           2**64 - 1, -(2**31), -(2**61), -(2**63))
# Up to where a law's own products are finite: beyond, a run that believes them ends as one that has diverged.
FLOATS = (0.0, -0.0, 5e-324, -1e-308, 1e-9, 1.0, -1.0, 1e3, -1e6, 1e100, -1e154, 1e200, 1e307, -1e307)
NOT_FINITE = (nan, inf, -inf)
TIMES = tuple(n for n in NUMBERS if -(2**63) <= n < 2**63)
NESTED: Any = ()
for _ in range(300):
    NESTED = (NESTED,)
ODD: tuple[Any, ...] = (
    True, False, "", "x" * 300, "\x1b[2J", "\u202e", b"", b"\xff" * 40, {}, {"a": "b"}, {"a": 1}, {b"a": b"b"},
    {"a": {"b": ()}},
    msgpack.ExtType(5, b"xy"), msgpack.ExtType(127, b""), msgpack.Timestamp(1, 2), (((),),), NESTED, (True,), ("1.0",),
)
"""What is right for no field of a message."""
BODIES = (
    b"", b"\xc1", b"\x90", b"\x96", b"\xdd" + b"\xff" * 4, b"\xdf" + b"\xff" * 4, b"\xdb" + b"\xff" * 4,
    b"\xc9" + b"\xff" * 4 + b"\x01", b"\xc7\x0c\xff" + bytes(12), b"\xd7\xff" + b"\xff" * 8, b"\x91" * 900,
    b"\x81\xa1a" * 300, b"\xa2\xff\xfe", b"\x80", b"\xc0", b"\x01",
)
SENTENCES = ("", "x" * 1001, "a\nb", "\x1b]0;x\x07", "\u200b", "emergency stop", "é" * 1000, "\ue000")
MANIFESTS: tuple[Any, ...] = (
    {}, {"": ""}, {"scene": "mine"}, {EVERY: "0"}, {EVERY: "1001"}, {EVERY: "-1"}, {EVERY: "\u00b2"},
    {EVERY: "9" * 400}, {EVERY: "2", TICK_0: "-"}, {TICK_0: str(2**63)}, {TICK_0: "-" + "9" * 18}, {TICK_0: "1_0"},
    {"k" * 3000: "v" * 3000}, {str(i): "" for i in range(400)}, {"a": 1}, {"a": None}, {"a": "\x00"}, {1: "a"},
    {"a": ["b"]}, {"a": "\ud7ff"}, ["a"], None,
)


def is_lost(k: int) -> bool:
    """Are the honest messages of tick k lost? There are gaps, in which a copy would be played that passed for new."""
    return k % 10 == 3


def sealed(data: bytes) -> bytes:
    """`data` with a good checksum."""
    return data + crc32(data).to_bytes(4, "big")


def framed(kind: int, body: bytes, *, version: int = VERSION, length: int | None = None, padding: bytes = b"") -> bytes:
    """A datagram of any kind around any body, its checksum good."""
    size = len(body) if length is None else length
    return sealed(pack("!2sBBH", b"BT", version, kind, size & 0xFFFF) + body + padding)


def packed(*fields: Any) -> bytes:
    """The fields as the body of a packet, whatever they are."""
    data: bytes = msgpack.packb(fields)
    return data


@dataclass
class View:
    """What an attacker knows of the end that he fires at."""

    number: int  # of its session
    hears: Kind  # its peer's kind of message
    width: int  # of one, in numbers
    k: int = 0  # its tick
    newest: int = -1  # number of the newest honest message that has come
    came: list[bytes] = field(default_factory=list)  # honest datagrams that it has had
    recent: deque[bytes] = field(default_factory=lambda: deque(maxlen=16))  # the last of them
    own: list[bytes] = field(default_factory=list)  # that it has sent


class Hostile:
    """Shots at one end. `foreign`: the datagrams of other sessions, whole; `records`: those of an association."""

    def __init__(self, dice: random.Random, view: View, foreign: list[bytes], records: list[bytes]) -> None:
        self.dice, self.view, self.foreign = dice, view, foreign
        self.honest = [*foreign, *records]
        self.outside: tuple[Callable[[], bytes], ...] = (
            self.noise, self.flipped, self.cut, self.longer, self.spliced, self.replayed, self.crossed, self.reflected,
            self.ill_framed, self.ill_typed, self.not_finite, self.of_another, self.out_of_time, self.stale, self.word,
            self.record, self.unsealed,
        )
        self._records = records

    def shot(self) -> tuple[str, bytes]:
        """The next from outside, and what it is."""
        make = self.outside[int(self.dice.random() * len(self.outside))]
        return make.__name__, make()

    def _any(self, several: Any) -> Any:
        return several[int(self.dice.random() * len(several))]

    def _one(self) -> bytes:
        """An honest datagram, of this session or another."""
        data: bytes = self._any(self.honest) if self.dice.random() < 0.5 else self.replayed()
        return data

    def noise(self) -> bytes:
        data = self.dice.randbytes(int(self.dice.random() ** 3 * 1500))
        return self._any((b"", b"BT", pack("!2sBB", b"BT", VERSION, 0))) + data if self.dice.random() < 0.5 else data

    def flipped(self) -> bytes:
        data = bytearray(self._one())
        for _ in range(self._any((1, 1, 2, 3, 8))):
            data[int(self.dice.random() * len(data))] ^= 1 << int(self.dice.random() * 8)
        return bytes(data)

    def cut(self) -> bytes:
        data = self._one()
        return data[: int(self.dice.random() * len(data))]

    def longer(self) -> bytes:
        more = bytes if self.dice.random() < 0.5 else self.dice.randbytes
        return self._one() + more(self._any((1, 2, 4, 40, 1200, 9000)))

    def spliced(self) -> bytes:
        one, other = self._one(), self._one()
        at = int(self.dice.random() * min(len(one), len(other)))
        data = one[:at] + other[at:]
        return data if data not in (one, other) else data + b"\x01"

    def replayed(self) -> bytes:
        view = self.view
        if not view.came:
            return self.crossed()
        data: bytes = self._any(view.recent if self.dice.random() < 0.5 else view.came)
        return data

    def crossed(self) -> bytes:
        data: bytes = self._any(self.foreign)
        return data

    def reflected(self) -> bytes:
        data: bytes = self._any(self.view.own) if self.view.own else self.crossed()
        packet = decode(data, self.view.width)
        # Only messages: an end's own START thrown back at it is one of its session, and a word (see there).
        return data if not isinstance(packet, Packet) or packet.kind in (Kind.FORTH, Kind.BACK) else self.crossed()

    def ill_framed(self) -> bytes:
        dice, body = self.dice, packed(*self.fields())
        data: bytes = self._any((
            lambda: framed(self._any(range(7, 256)), body),
            lambda: framed(self.view.hears, body, version=self._any((0, 1, VERSION + 1, 255))),
            lambda: framed(self.view.hears, body, length=len(body) - 1 - int(dice.random() * len(body))),
            lambda: framed(self.view.hears, body, length=len(body) + 1 + int(dice.random() * 60000)),
            lambda: framed(self.view.hears, body, padding=bytes(int(dice.random() * 30)) + b"\x01"),
            lambda: framed(self.view.hears, body, padding=bytes(1200)),
            lambda: framed(self._any((2, 3, 4, 5, 6)), body),
            lambda: framed(int(dice.random() * len(Kind)), self._any(BODIES)),
            lambda: framed(int(dice.random() * len(Kind)), body + self._any(BODIES[1:])),
            lambda: framed(int(dice.random() * len(Kind)), packed(*self.fields()[:-1])),
            lambda: framed(int(dice.random() * len(Kind)), packed(*self.fields(), None)),
        ))()
        return data

    def fields(self) -> list[Any]:
        """Of a message that would be played, were nothing wrong with it."""
        view, dice = self.view, self.dice
        payload = tuple([dice.uniform(-50.0, 50.0) for _ in range(view.width)])
        return [view.number, (view.newest + 1) % 2**32, view.k * 1_000_000, (view.k * 1_000_000, 5), payload, 1.0]

    def ill_typed(self) -> bytes:
        fields, width = self.fields(), self.view.width
        wrong: tuple[tuple[int, tuple[Any, ...]], ...] = (
            (0, (None, -1, -(2**63), 1.0)),
            (1, (None, -1, 2**32, 2**64 - 1, 1.0)),
            (2, (None, 2**63, 2**64 - 1, 1.0)),
            (3, (0, 1.0, (), (1,), (1, 2, 3), (1, -1), (1, True), (2**63, 0), (0, 2**64 - 1), (1.0, 1), (None, 0))),
            (4, (None, 0, 1.0, (), (0.0,) * (width + 1), (0.0,) * (width - 1), (0,) * width, (None,) * width,
                 (0.0,) * 131, [[0.0] * width], (*(0.0,) * (width - 1), True), (*(0.0,) * (width - 1), 1))),
            (5, (0, 1, (1.0,))),
        )
        place, several = self._any(wrong)
        fields[place] = self._any(several if self.dice.random() < 0.5 else ODD)
        return framed(self.view.hears, packed(*fields))

    def not_finite(self) -> bytes:
        fields = self.fields()
        payload = list(fields[4])
        if self.dice.random() < 0.7:
            payload[int(self.dice.random() * len(payload))] = self._any(NOT_FINITE)
            fields[4] = payload
        else:
            fields[5] = self._any(NOT_FINITE)
        return framed(self.view.hears, packed(*fields))

    def of_another(self) -> bytes:
        """Right in all but the session, as it is guessed: the next numbers are its master's, which knows its own."""
        view = self.view
        number = self._any((0, 1, view.number + 1, view.number - 1, view.number ^ 2**32, view.number ^ 2**63, 2**64 - 1,
                            self.dice.getrandbits(64)))
        kind = int(self.dice.random() * len(Kind))
        if (number - view.number) % 2**64 <= NEXT:
            number ^= 2**40
        payload = self.fields()[4] if kind < 2 else self._control(Kind(kind))
        echo = self._any((None, (self._any(TIMES), 0)))
        return framed(kind, packed(number, self._any((0, view.k, 2**32 - 1)), self._any(TIMES), echo, payload, None))

    def out_of_time(self) -> bytes:
        """A message of this session, numbered so far ahead or behind that no such one is under way."""
        fields = self.fields()
        away = self._any((1100, 5000, 10**6, 2**30, 2**31 - 9000, 2**31 + 2**20, 2**32 - 2**20))
        fields[1] = (self.view.k + away) % 2**32
        return framed(self.view.hears, packed(*fields))

    def stale(self) -> bytes:
        """Another message under a number that has come."""
        fields = self.fields()
        if self.view.newest < 0:
            return self.crossed()
        seq = self.view.newest if self.dice.random() < 0.3 else int(self.dice.random() * (self.view.newest + 1))
        fields[1] = seq - is_lost(seq)
        return framed(self.view.hears, packed(*fields))

    def unsealed(self) -> bytes:
        """A message that would be played, and its checksum wrong."""
        data = bytearray(framed(self.view.hears, packed(*self.fields())))
        data[-1 - int(self.dice.random() * 4)] ^= 1 << int(self.dice.random() * 8)
        return bytes(data)

    def _control(self, kind: Kind) -> Any:
        if kind is Kind.START:
            return self._any((*TIMES, None, 1.5, True))
        return self._any(SENTENCES if kind in (Kind.REFUSE, Kind.BYE, Kind.RENEW) else MANIFESTS)

    def word(self) -> bytes:
        """Of this session, and none that moves a run. A farewell does, where there are no keys."""
        kind = self._any((Kind.HELLO, Kind.WELCOME, Kind.REFUSE, Kind.START))
        echo = self._any((None, (self._any(TIMES), self._any((0, 1, 2**63 - 1)))))
        seq, sent, payload = self._any((0, 2**32 - 1)), self._any(TIMES), self._control(kind)
        return framed(kind, packed(self.view.number, seq, sent, echo, payload, None))

    def record(self) -> bytes:
        """Something of DTLS."""
        if self._records and self.dice.random() < 0.5:
            data: bytes = self._any(self._records)
            return data
        body = self.dice.randbytes(int(self.dice.random() * 120))
        number = self.dice.getrandbits(48)
        kind, version = self._any((20, 21, 22, 23, 24, 25)), self._any((0xFEFF, 0xFEFD, 0xFEFC))
        head = pack("!BHHHIH", kind, version, self._any((0, 1, 2, 65535)), number >> 32, number & 0xFFFFFFFF, len(body))
        return head + body

    def inside(self) -> bytes:
        """A message that this end believes: anything finite, a little before or after its time."""
        view = self.view
        seq = max(0, view.k + self._any((-40, -12, -3, -1, 0, 1, 1, 2, 12, 300, 1000)))
        payload = tuple([self._any(FLOATS) if self.dice.random() < 0.5 else self.dice.uniform(-1e3, 1e3)
                         for _ in range(view.width)])
        echo = self._any((None, Echo(self._any(TIMES), self._any((0, 1, 2**62, 2**63 - 1)))))
        stamp = self._any((None, *FLOATS))
        return encode(Packet(view.hears, view.number, seq % 2**32, self._any(TIMES), echo, payload, stamp))


def keep(dice: random.Random, several: list[bytes], data: bytes, seen: int) -> None:
    """Remember `data` among at most `KEPT`, a fair sample of all `seen` so far (reservoir sampling)."""
    if len(several) < KEPT:
        several.append(data)
    elif (at := int(dice.random() * seen)) < KEPT:
        several[at] = data
