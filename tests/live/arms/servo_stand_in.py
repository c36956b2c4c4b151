"""Servos on a pseudo terminal that speak Feetech's protocol or Dynamixel 2.0, byte by byte, without an SDK."""

from __future__ import annotations

import os
import select
import threading
import tty
from collections.abc import Callable, Sequence
from dataclasses import replace
from math import pi
from tempfile import TemporaryDirectory
from time import monotonic
from typing import Any

from teleop import Servo
from teleop.physics.servo import true_touch, turn

STEP = 2.0 * pi / 4096  # rad of a count
READ, WRITE, SYNC_READ, SYNC_WRITE = 2, 3, 0x82, 0x83


def crc(data: bytes) -> int:
    """CRC-16 of the polynomial 0x8005, as protocol 2.0 has it."""
    total = 0
    for byte in data:
        total ^= byte << 8
        for _ in range(8):
            total = ((total << 1) ^ 0x8005 if total & 0x8000 else total << 1) & 0xFFFF
    return total


class Servos:
    """Some servos, a table of bytes each, in a thread. Knobs: ids in `silent`, `short`, `damaged`, `flags` by id.

    `moves`: called with a table after each write to it: what the motor does.
    """

    positions: tuple[int, int]  # address and bytes of the position
    goals: tuple[int, int]
    torque: int  # address of its switch
    registers: tuple[tuple[int, int, int], ...]  # address, bytes and value, as it leaves the factory
    width: int  # bytes of an address and a length

    def __init__(self, ids: tuple[int, ...] = (1, 2), moves: Callable[[int, bytearray], None] | None = None) -> None:
        self.tables = {each: bytearray(256) for each in ids}
        for each in ids:
            for register in self.registers:
                self.set(each, *register)
        self.silent: set[int] = set()
        self.short: set[int] = set()
        self.damaged: set[int] = set()
        self.flags: dict[int, int] = {}
        self.moves = moves or self._follow
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        # A link that goes with the adapter: the number of a pseudo terminal may be another one's a moment later.
        self._folder = TemporaryDirectory()
        self.port = f"{self._folder.name}/servos"
        os.symlink(os.ttyname(self._slave), self.port)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def get(self, servo: int, address: int, length: int) -> int:
        return int.from_bytes(self.tables[servo][address:address + length], "little")

    def set(self, servo: int, address: int, length: int, value: int) -> None:
        self.tables[servo][address:address + length] = value.to_bytes(length, "little")

    def _follow(self, servo: int, _: bytearray) -> None:
        """Be at the goal at once, while the torque is on."""
        if self.get(servo, self.torque, 1):
            self.set(servo, *self.positions, self.get(servo, *self.goals))

    def unplug(self) -> None:
        """Be gone, as an adapter that is pulled out."""
        if self._over.is_set():
            return
        self._over.set()
        self._thread.join()
        self._folder.cleanup()
        os.close(self._master)
        os.close(self._slave)

    close = unplug

    def _serve(self) -> None:
        buffer = b""
        while not self._over.is_set():
            if not select.select([self._master], [], [], 0.02)[0]:
                buffer = b""  # what is incomplete when the line is quiet is dropped
            else:
                buffer += os.read(self._master, 4096)
                while (taken := self._take(buffer)) is not None:
                    packet, buffer = taken
                    os.write(self._master, b"".join(self._answers(*packet)))

    def _answers(self, servo: int, instruction: int, body: bytes) -> list[bytes]:
        if instruction in (SYNC_READ, SYNC_WRITE):
            address, length, rest = self._split(body)
            if instruction == SYNC_READ:
                return [self._answer(each, bytes(self.tables[each][address:address + length]))
                        for each in rest if each in self.tables]
            for at in range(0, len(rest), length + 1):
                if rest[at] in self.tables:
                    self._write(rest[at], address, rest[at + 1:at + 1 + length])
            return []
        if servo not in self.tables:
            return []
        if instruction == READ:
            address, length, _ = self._split(body)
            return [self._answer(servo, bytes(self.tables[servo][address:address + length]))]
        if instruction == WRITE:
            self._write(servo, int.from_bytes(body[:self.width], "little"), body[self.width:])
        return [self._answer(servo, b"")]

    def _write(self, servo: int, address: int, data: bytes) -> None:
        self.tables[servo][address:address + len(data)] = data
        self.moves(servo, self.tables[servo])

    def _answer(self, servo: int, data: bytes) -> bytes:
        if servo in self.silent:
            return b""
        packet = self._pack(servo, self.flags.get(servo, 0), data[:1] if servo in self.short else data)
        return packet[:-1] + bytes([packet[-1] ^ 1]) if servo in self.damaged else packet

    def _take(self, buffer: bytes) -> tuple[tuple[int, int, bytes], bytes] | None:
        raise NotImplementedError

    def _pack(self, servo: int, flags: int, data: bytes) -> bytes:
        raise NotImplementedError

    def _split(self, body: bytes) -> tuple[int, int, bytes]:
        at, length, rest = body[:self.width], body[self.width:2 * self.width], body[2 * self.width:]
        return int.from_bytes(at, "little"), int.from_bytes(length, "little"), rest


class Feetech(Servos):
    """STS3215, in the middle of their turn: FF FF ID LEN INST ... SUM."""

    positions, goals, torque, width = (56, 2), (42, 2), 40, 1
    registers = ((3, 2, 777), (11, 2, 4095), (56, 2, 2048), (63, 1, 31))  # the last: degrees Celsius

    def _take(self, buffer: bytes) -> tuple[tuple[int, int, bytes], bytes] | None:
        start = buffer.find(b"\xff\xff")
        packet = buffer[start:] if start >= 0 else b""
        if len(packet) > 2 and packet[2] == 0xFF:
            return (0, 0, b""), packet[1:]
        if len(packet) < 4 or len(packet) < packet[3] + 4:
            return None
        whole, rest = packet[:packet[3] + 4], packet[packet[3] + 4:]
        if whole[-1] != ~sum(whole[2:-1]) & 0xFF:
            return (0, 0, b""), packet[1:]  # lost: the next one may begin within it
        return (whole[2], whole[4], whole[5:-1]), rest

    def _pack(self, servo: int, flags: int, data: bytes) -> bytes:
        inner = bytes([servo, len(data) + 2, flags]) + data
        return b"\xff\xff" + inner + bytes([~sum(inner) & 0xFF])


class Dynamixel(Servos):
    """XM430-W350, in the middle of their turn: FF FF FD 00 ID LEN LEN INST ... CRC CRC."""

    positions, goals, torque, width = (132, 4), (116, 4), 64, 2
    registers = ((0, 2, 1020), (11, 1, 3), (38, 2, 1193), (132, 4, 2048))

    def _follow(self, servo: int, table: bytearray) -> None:
        if self.get(servo, 11, 1) == 5:
            super()._follow(servo, table)

    def _take(self, buffer: bytes) -> tuple[tuple[int, int, bytes], bytes] | None:
        start = buffer.find(b"\xff\xff\xfd\x00")
        packet = buffer[start:] if start >= 0 else b""
        if len(packet) < 7 or len(packet) < int.from_bytes(packet[5:7], "little") + 7:
            return None
        length = int.from_bytes(packet[5:7], "little") + 7
        whole, rest = packet[:length], packet[length:]
        if int.from_bytes(whole[-2:], "little") != crc(whole[:-2]):
            return (0, 0, b""), packet[1:]
        return (whole[4], whole[7], whole[8:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")), rest

    def _pack(self, servo: int, flags: int, data: bytes) -> bytes:
        inner = bytes([0x55, flags]) + data.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
        packet = b"\xff\xff\xfd\x00" + bytes([servo]) + (len(inner) + 2).to_bytes(2, "little") + inner
        return packet + crc(packet).to_bytes(2, "little")


class Physics:
    """Shafts of servos that move in real time by `teleop.physics.servo`, in what they touch, until it is closed."""

    def __init__(self, servos: Feetech, bodies: Sequence[Servo], environments: Sequence[Any]) -> None:
        self._servos = servos
        self._plants = [body.slave_plant(1e-3, None if one is None else one.resistance())
                        for body, one in zip(bodies, environments, strict=True)]
        self._limp = [replace(body, stall=1e-12).slave_plant(1e-3, None).c[0] for body in bodies]
        self.states: list[Any] = [(0.0,) * 5] * len(bodies)
        servos.moves = lambda _servo, _table: None
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def touch(self, joint: int) -> float:
        """True torque (N m) of a joint on what it touches."""
        return true_touch(self._plants[joint].c, (self.states[joint],))

    def close(self) -> None:
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        began, ticks = monotonic(), 0
        while not self._over.wait(0.001):
            due = int((monotonic() - began) / 1e-3)
            ticks = max(ticks, due - 50)  # a stall is not made up for
            for _ in range(due - ticks):
                for i, (servo, plant) in enumerate(zip(self._servos.tables, self._plants, strict=True)):
                    on = self._servos.get(servo, self._servos.torque, 1)
                    goal = (self._servos.get(servo, *self._servos.goals) - 2048) * STEP
                    shaft = plant.c[0] if on else self._limp[i]
                    self.states[i] = turn(shaft, plant.c[1], self.states[i], goal, 0.0, 0.0)
                    self._servos.set(servo, *self._servos.positions, round(self.states[i][0] / STEP) + 2048)
            ticks = due
