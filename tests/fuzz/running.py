"""Two ends that meet and run on a virtual clock, in the open or with keys, and what is fired at one of them."""

from __future__ import annotations

import ctypes
import gc
import os
import random
import sys
from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from hashlib import sha256
from math import isfinite
from struct import pack
from typing import Any

from channel.link import parse_link
from master.device import SimulatedMaster
from slave.robot import SimulatedSlave
from teleop import Cap, Scene, Watchdog, load_scene
from teleop.protocol.endpoint import Endpoint
from teleop.protocol.manifest import manifest_of
from teleop.protocol.packet import DATA, Kind, Packet, Rejection, decode
from teleop.protocol.session import Session
from tests.fuzz.datagrams import Hostile, View, is_lost, keep

MS = 1_000_000
AT = {"m": ("192.0.2.1", 4000), "s": ("192.0.2.2", 9001)}
AHEAD = {"m": 10**12, "s": 10**12 + 987_654_321_000}  # the clock of each
WAY = 10  # ticks from one end to the other
CAP = 5.0
Shots = Callable[["Running"], Iterable[tuple[bytes, tuple[str, int]]]]


def fuzzed(ticks: int, **other: Any) -> Scene:
    """The scene that is run: waves against a wall, every guard on."""
    base = load_scene("canonical", duration=ticks / 1000, wall=0.005, delay=0.01)
    return replace(base, cap=Cap(f_max=CAP, slew=1000.0), watchdog=Watchdog(timeout=0.05, ramp=0.02),
                   link=parse_link("delay(0.01)"), **other)


class Running:
    """A master and a slave from their first HELLO on. `step` is one millisecond.

    `links`: what seals at each end, if anything does. `fire`: what comes to end `at` beside all that is honest, once it
    is `met`, or from the very first on where it is `early`.
    """

    def __init__(
        self, scene: Scene, number: int, *, links: dict[str, Any] | None = None, at: str = "s",
        fire: Shots = lambda _: (), early: bool = False,
    ) -> None:
        self.scene, self.links, self.at, self.fire, self.early = scene, links or {}, at, fire, early
        told = manifest_of(scene)
        sessions = {"m": Session(master=True, manifest=told, number=number), "s": Session(master=False, manifest=told)}
        self.ends = {e: Endpoint(scene, e, sessions[e]) for e in "ms"}
        self.devices: dict[str, Any] = {"m": SimulatedMaster(scene), "s": SimulatedSlave(scene)}
        self.now = 0
        self.last = {"m": -1, "s": -1}
        self.way: dict[str, list[tuple[int, bytes]]] = {"m": [], "s": []}  # towards each end: when, what
        self.said: dict[str, list[bytes]] = {"m": [], "s": []}  # the first that each sent, as it came out of it
        self.sealed: dict[str, list[bytes]] = {"m": [], "s": []}  # and as it went out
        self.sha = {"m": sha256(), "s": sha256()}  # of rows, forces, packets played and messages sent
        self.most_force = 0.0
        self.view = View(number, self.ends[at].format.hears, self.ends[at].format.width)
        self.dice = random.Random(number)
        self._came = self._sent = 0
        self.honest = self.fired = self.words = self.replies = 0
        self.opened = 0  # of what was fired at a link: has to stay 0
        self.drawn: list[bytes] = []  # what the last shot drew
        self.owed: Counter[tuple[str, int]] = Counter()  # bytes from each address, less those sent there

    def clock(self, e: str) -> int:
        return self.now + AHEAD[e]

    def step(self) -> None:
        """A millisecond: what is under way comes, what is hostile comes, both ends tick."""
        for e in "ms":
            due = [data for when, data in self.way[e] if when <= self.now]
            self.way[e] = [(when, data) for when, data in self.way[e] if when > self.now]
            for data in due:
                self._honest(e, data)
            if e == self.at and (self.early or self.ends[e].session.met):
                for data, address in self.fire(self):
                    self.shoot(data, address)
        for e in "ms":
            self._turn(e)
        self.now += MS

    def run(self) -> Running:
        """All ticks of the scene; then the farewell of both."""
        while min(self.last.values()) < self.scene.ticks - 1:
            self.step()
            assert self.now < (self.scene.ticks + 60_000) * MS, "they do not meet"
        for e in "ms":
            self._say(e, self.ends[e].session.bye("the run is over", self.clock(e)))
        return self

    def shoot(self, data: bytes, address: tuple[str, int]) -> None:
        """One hostile datagram at the end that is under fire. No address draws more than came from it."""
        e = self.at
        self.fired += 1
        self.view.number = self.ends["m"].session.number or 0
        end, link = self.ends[e], self.links.get(e)
        if link is not None:
            plain, out = link.receive(data, address, self.clock(e))
            self.opened += len(plain)
            self.drawn = [each for each, _ in out]
        else:
            packet = decode(data, self.view.width)
            self.words += self._is_word(end, packet)
            self.drawn = end.receive(data, self.clock(e))
            assert len(self.drawn) <= 1
        self.replies += len(self.drawn)
        # A handshake is answered when enough has come for it; in the open each answer is to one datagram.
        more = len(data) - sum(map(len, self.drawn))
        self.owed[address] += more
        assert self.owed[address] >= 0
        assert more >= 0 or link is not None

    def _is_word(self, end: Endpoint, packet: Packet | Rejection) -> bool:
        """Is it for the session itself? It is not counted then."""
        if isinstance(packet, Rejection) or packet.kind in DATA:
            return False
        return end.session.belongs(packet, self.clock(end.e))

    def _honest(self, e: str, data: bytes) -> None:
        link = self.links.get(e)
        if link is None:
            several = [data]
        else:
            several, out = link.receive(data, AT["sm"[e == "s"]], self.clock(e))
            self._go(e, [each for each, to in out if to == AT["sm"[e == "s"]]])
        for each in several:
            packet = decode(each, self.ends[e].format.width)
            assert isinstance(packet, Packet)
            if e == self.at:
                self.honest += 1
                self.view.newest = max(self.view.newest, packet.seq if packet.kind in DATA else -1)
                self.words += self._is_word(self.ends[e], packet)
            self._say(e, self.ends[e].receive(each, self.clock(e)))
        if e == self.at:
            self._came += 1
            keep(self.dice, self.view.came, data, self._came)
            self.view.recent.append(data)

    def _turn(self, e: str) -> None:
        end, now = self.ends[e], self.clock(e)
        session, link = end.session, self.links.get(e)
        if link is not None:
            self._go(e, [data for data, _ in link.due(now)])
        self._say(e, session.due(now))
        if session.start_ns is None or session.meeting:
            return
        k = (now - session.start_ns) // self.scene.dt_ns
        if k <= self.last[e] or k >= self.scene.ticks:
            return
        self.last[e] = k
        out = end.tick(k, now, self.devices[e].read(k))
        assert end.force_failed is None
        assert all(map(isfinite, out.force))
        self.devices[e].hold(out.force)
        self.most_force = max(self.most_force, *map(abs, out.force))
        self.sha[e].update(pack(f"<{len(out.row) + 1}d", out.played, *out.row))
        if e == self.at:
            self.view.k = k
        if out.datagram is not None:
            self.sha[e].update(out.datagram)
            self._say(e, [out.datagram], lost=is_lost(k))

    def _say(self, e: str, datagrams: list[bytes], *, lost: bool = False) -> None:
        link = self.links.get(e)
        for data in datagrams:
            if len(self.said[e]) < 400 or data[3] > Kind.BACK:
                self.said[e].append(data)
            out = data if link is None else link.send(data)
            if out is not None and not lost:
                self._go(e, [out])

    def _go(self, e: str, datagrams: list[bytes]) -> None:
        other = "sm"[e == "s"]
        for data in datagrams:
            if len(self.sealed[e]) < 400:
                self.sealed[e].append(data)
            if e == self.at:
                self._sent += 1
                keep(self.dice, self.view.own, data, self._sent)
            self.way[other].append((self.now + WAY * MS, data))

    def digest(self) -> dict[str, str]:
        """Of all that both ends did."""
        return {e: sha.hexdigest() for e, sha in self.sha.items()}


def foreign() -> list[bytes]:
    """All that two other sessions said, one of them refused."""
    run = Running(fuzzed(150), 424_242).run()
    refused = Session(master=False, manifest={"scene": "another"})
    master = Session(master=True, manifest=manifest_of(run.scene), number=99)
    hello = master.due(0)[0]
    packet = decode(hello, 0)
    assert isinstance(packet, Packet)
    run.ends["s"].session.end("the session is over")
    asked = run.ends["s"].session.due(run.now)
    said = [*run.said["m"], *run.said["s"], hello, *refused.receive(packet, 5, len(hello)), *asked]
    kinds = {packet.kind for data in said if isinstance(packet := decode(data, 1), Packet)}
    assert kinds == set(Kind)
    return said


def from_outside(hostile: Hostile, each: int, counts: Counter[str]) -> list[tuple[bytes, tuple[str, int]]]:
    """So many shots, half of them from the peer's own address."""
    shots = []
    for _ in range(each):
        name, data = hostile.shot()
        counts[name] += 1
        shots.append((data, AT["m"] if hostile.dice.random() < 0.5 else ("198.51.100.7", 5000)))
    return shots


class Memory:
    """Python's own blocks and the pages of the process, to be compared."""

    def __init__(self) -> None:
        gc.collect()
        with suppress(AttributeError, OSError):  # of the GNU library: give back what is free between what is used
            ctypes.CDLL(None).malloc_trim(0)
        self.blocks = sys.getallocatedblocks()
        with open("/proc/self/statm") as file:
            self.bytes = int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")

    def since(self, before: Memory) -> tuple[int, int]:
        """Growth: blocks, bytes."""
        return self.blocks - before.blocks, self.bytes - before.bytes
