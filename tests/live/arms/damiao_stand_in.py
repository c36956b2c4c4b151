"""Damiao motors on python-can's virtual bus, their frames packed by hand: inertia and damper, a timeout, an error."""

from __future__ import annotations

import struct
import threading
import time
from typing import Any

PMAX, VMAX, TMAX = 12.5, 30.0, 10.0
INERTIA, DAMPING, FRICTION = 0.1, 0.2, 0.01  # kg m^2, N m s/rad, N m: half a step of the torque moves nothing


class Damiao:
    """Motors 1 to n in a thread. Knobs: ids in `silent`; `errors`: state that a motor reports, by id."""

    def __init__(self, bus: Any, message: Any, ids: tuple[int, ...] = (1, 2)) -> None:
        self.bus, self.message, self.ids = bus, message, ids
        self.registers: dict[tuple[int, int], bytes] = {}
        for each in ids:
            for rid, value in ((21, PMAX), (22, VMAX), (23, TMAX)):
                self.registers[each, rid] = struct.pack("<f", value)
            self.registers[each, 10], self.registers[each, 9] = struct.pack("<I", 2), bytes(4)
        self.x, self.v, self.torque = (dict.fromkeys(ids, 0.0) for _ in range(3))
        self.kd = dict.fromkeys(ids, 0.0)
        self.on = dict.fromkeys(ids, False)
        self.heard = {each: time.monotonic() for each in ids}
        self.silent: set[int] = set()
        self.errors: dict[int, int] = {}
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        self.bus.shutdown()

    def _serve(self) -> None:
        before = time.monotonic()
        while not self._over.is_set():
            message = self.bus.recv(timeout=0.005)
            now = time.monotonic()
            for each in self.ids:
                timeout = struct.unpack("<I", self.registers[each, 9])[0] * 50e-6
                if self.on[each] and timeout and now - self.heard[each] > timeout:
                    self.on[each], self.errors[each] = False, 13
                self._move(each, now - before)
            before = now
            if message is not None:
                self._take(message.arbitration_id, bytes(message.data), now)

    def _move(self, each: int, dt: float) -> None:
        torque = self.torque[each] - self.kd[each] * self.v[each] if self.on[each] else 0.0
        v = self.v[each] + dt * (torque - DAMPING * self.v[each]) / INERTIA
        self.v[each] = max(0.0, abs(v) - dt * FRICTION / INERTIA) * (1.0 if v > 0.0 else -1.0)
        self.x[each] += dt * self.v[each]

    def _take(self, arbitration: int, data: bytes, now: float) -> None:
        if arbitration == 0x7FF:
            each, order, rid = data[0] | data[1] << 8, data[2], data[3]
            if each in self.ids and each not in self.silent and order in (0x33, 0x55):
                if order == 0x55:
                    self.registers[each, rid] = data[4:]
                self._send(each, data[:4] + self.registers[each, rid])
            return
        if arbitration not in self.ids:
            return
        self.heard[arbitration] = now
        if data[:7] == b"\xff" * 7:
            self.on[arbitration] = data[7] == 0xFC if data[7] in (0xFC, 0xFD) else self.on[arbitration]
            if data[7] == 0xFB and self.errors.get(arbitration) == 13:
                del self.errors[arbitration]
            if data[7] == 0xFD:
                self.torque[arbitration] = 0.0
        else:
            steps = (data[6] & 0xF) << 8 | data[7]
            self.torque[arbitration] = (steps / 4095 * 2 - 1) * TMAX
            self.kd[arbitration] = (data[5] << 4 | data[6] >> 4) / 4095 * 5
        if arbitration not in self.silent:
            state = self.errors.get(arbitration, 1 if self.on[arbitration] else 0)
            q = round((self.x[arbitration] / PMAX + 1) / 2 * 65535)
            v = round((self.v[arbitration] / VMAX + 1) / 2 * 4095)
            t = round((self.torque[arbitration] / TMAX + 1) / 2 * 4095)
            self._send(arbitration, bytes([
                state << 4 | arbitration & 0xF, q >> 8, q & 0xFF, v >> 4, (v & 0xF) << 4 | t >> 8, t & 0xFF, 40, 45]))

    def _send(self, each: int, data: bytes) -> None:
        self.bus.send(self.message(arbitration_id=each + 0x10, data=data, is_extended_id=False))
