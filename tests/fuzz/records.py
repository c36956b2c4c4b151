"""Hostile datagrams for ends that seal: what can be made of honest records without keys, and strangers who knock."""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable
from struct import pack, pack_into
from typing import Any

from teleop.protocol.secure.association import Association
from teleop.protocol.secure.keys import Key
from teleop.protocol.secure.secure_link import SecureLink
from tests.fuzz.datagrams import Hostile, View
from tests.fuzz.running import AT, Running, fuzzed

SECRET = bytes(range(32))
STRANGERS = [(f"198.51.100.{i}", 5000 + i) for i in range(12)]
KNOCKS = 400  # shots to one stranger that begins a handshake of its own


def links(keys: list[Key]) -> dict[str, Any]:
    """Of a master and a slave; `keys`: master's, slave's, a stranger's."""
    return {"m": SecureLink.calling(keys[0], keys[1].fingerprint, AT["s"]),
            "s": SecureLink.listening(keys[1], keys[0].fingerprint, SECRET)}


def of_another_association(keys: list[Key]) -> list[bytes]:
    """All that two ends with these keys sent, from the first hello on, in a run before this one."""
    run = Running(fuzzed(150), 31_337, links=links(keys)).run()
    return [*run.sealed["m"], *run.sealed["s"]]


class HostileRecords:
    """Shots at one end, each with the address that it comes from.

    `plain`: of sessions in the open. `records`: of other associations. A stranger's own handshakes go on when
    `answered` is told what its shots drew.
    """

    def __init__(
        self, dice: random.Random, view: View, plain: list[bytes], records: list[bytes], stranger: Key, knocks_at: str,
    ) -> None:
        self.dice, self.view, self.records = dice, view, records
        self.open = Hostile(dice, view, plain, records)
        self._stranger, self._knocks_at = stranger, knocks_at
        self._association: Association | None = None
        self._from = STRANGERS[0]
        self._waiting: deque[bytes] = deque()
        self._shots = 0
        self._handshakes = [data for data in records if data[0] == 22]
        shapes = self.open
        self.makes: tuple[Callable[[], bytes], ...] = (
            shapes.noise, shapes.flipped, shapes.cut, shapes.longer, shapes.spliced, shapes.replayed, self.crossed,
            self.reflected, self.bare_handshake, self.in_the_clear, self.other_head, self.two_in_one, self.hello,
            self.hello, shapes.record,
        )

    def shot(self, now: int, *, spoofs: bool) -> tuple[str, bytes, tuple[str, int]]:
        """The next: what it is, the datagram, and from where. `spoofs`: it may bear the peer's own address."""
        self._shots += 1
        if self._waiting:
            return "knock", self._waiting.popleft(), self._from
        if self._shots % KNOCKS == 0:
            self._from = self._any(STRANGERS)
            self._association = Association.towards(self._stranger, self._knocks_at, now)
            self._waiting.extend(self._association.begin(now))
        make = self._any(self.makes)
        peers = AT["s" if self.view.hears == 1 else "m"]
        return make.__name__, make(), peers if spoofs and self.dice.random() < 0.5 else self._any(STRANGERS)

    def answered(self, data: list[bytes], address: tuple[str, int], now: int) -> None:
        """What a shot from there drew."""
        if self._association is not None and address == self._from:
            for each in data:
                self._waiting.extend(self._association.receive(each, now)[1])

    def _any(self, several: Any) -> Any:
        return several[int(self.dice.random() * len(several))]

    def _one(self) -> bytes:
        return self.open.replayed() if self.view.came and self.dice.random() < 0.7 else self.crossed()

    def crossed(self) -> bytes:
        data: bytes = self._any(self.records)
        return data

    def bare_handshake(self) -> bytes:
        """A part of a handshake without the padding that pays for its answer; the cookie of a hello may be good."""
        data: bytes = self._any(self._handshakes or self.records)
        return data.rstrip(b"\0")

    def reflected(self) -> bytes:
        data: bytes = self._any(self.view.own or self.records)
        return data

    def in_the_clear(self) -> bytes:
        """Any packet without a seal, the running session's own among them."""
        return self.open.inside() if self.dice.random() < 0.5 else self.open.shot()[1]

    def other_head(self) -> bytes:
        """An honest record whose head says something else: a new number, another epoch, type, version or length."""
        data = bytearray(self._one())
        if len(data) < 13:
            return bytes(data)
        place, form, several = self._any((
            (0, "!B", (20, 21, 22, 23, 24, 0, 255)), (1, "!H", (0xFEFF, 0xFEFD, 0xFEFC, 0x0303, 0)),
            (3, "!H", (0, 1, 2, 65535)), (5, "!H", (0, 1, 65535)),
            (7, "!I", (0, 1, 2**31, 2**32 - 1, self.dice.getrandbits(32))),
            (11, "!H", (0, 1, 23, 24, 25, len(data) - 13, len(data) - 14, 2**14, 65535)),
        ))
        pack_into(form, data, place, self._any(several))
        return bytes(data)

    def two_in_one(self) -> bytes:
        return self._one() + self._one()

    def hello(self) -> bytes:
        """A hello of nobody: its lengths, cookie and numbers as they come."""
        dice = self.dice
        session, cookie = (dice.randbytes(self._any((0, 0, 1, 32, 255))) for _ in range(2))
        body = pack("!H", self._any((0xFEFD, 0xFEFF, 0))) + dice.randbytes(32)
        body += bytes((len(session),)) + session + bytes((len(cookie),)) + cookie
        body += pack("!HHBB", 2, self._any((0xC02B, 0xC02F, 0)), 1, 0) + dice.randbytes(self._any((0, 2, 50)))
        size = len(body).to_bytes(3, "big")
        message = bytes((self._any((1, 1, 1, 2, 3, 14, 20)),)) + size + bytes(2 + 3) + size + body
        message = message[: self._any((len(message), len(message), 12, 40, 60))]
        data = pack("!BHHHIH", 22, 0xFEFF, self._any((0, 0, 0, 1)), 0, dice.getrandbits(32), len(message)) + message
        return data.ljust(self._any((0, 0, 1200)), b"\0")
