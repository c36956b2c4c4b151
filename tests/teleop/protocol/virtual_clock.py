"""Two processes on a virtual clock: ends that are killed, started anew, paused, and a link that is cut.

What a process does is what `teleop.live` does around an endpoint, without its sockets: it meets, it joins, it takes
in at most `DRAIN` datagrams a tick by the time at which they came. The devices outlive the processes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from heapq import heappop, heappush
from itertools import count
from random import Random
from typing import Any, NamedTuple

from master.device import SimulatedMaster
from slave.robot import SimulatedSlave
from teleop import Cap, Scene, Watchdog, Wave, load_scene
from teleop.protocol.endpoint import Endpoint
from teleop.protocol.manifest import manifest_of
from teleop.protocol.packet import Kind, peek
from teleop.protocol.session import Session
from tests.fakes import Body

S, MS = 1_000_000_000, 1_000_000
DRAIN = 16
MEETS_EVERY = 5 * MS
EARLY = 10 * MS
PATIENT = 6.0  # s: a second of silence, twice if both notice one after the other, the exchange, settle, ramp
DOG = Watchdog(timeout=0.1, ramp=0.1, settle=0.1)
CAP = Cap(f_max=20.0, slew=40.0)


def healing(law: Any = None, *, dt: float = 0.01, duration: float = 60.0, **other: Any) -> Scene:
    """A scene for these processes: the link is theirs."""
    base = load_scene("canonical", law=law or Wave(b=2.0, K=200.0, B=5.0), dt=dt, duration=duration, wall=0.02)
    return replace(base, **{"link": None, "watchdog": DOG, "cap": CAP, **other})


@dataclass
class Clock:
    """An end's own clock: ns against the true time."""

    offset: int = 0
    ppm: float = 0.0
    _since: int = 0

    def at(self, true: int) -> int:
        return true + self.offset + round((true - self._since) * self.ppm * 1e-6)

    def when(self, shown: int) -> int:
        """The first true time at which it shows as much."""
        true = self._since + round((shown - self.offset - self._since) / (1.0 + self.ppm * 1e-6)) - 2
        while self.at(true) < shown:
            true += 1
        return true


class Done(NamedTuple):
    true: int
    k: int
    force: float
    gain: float
    safe: bool
    played: int
    met: int  # sessions of this process
    row: tuple[float, ...]
    first: bool  # is it the first one of its process


@dataclass
class Process:
    """One run of one end's program."""

    world: World
    e: str
    end: Endpoint
    ticking: bool = False
    asleep: bool = False
    over: bool = False
    last: int = -1
    ran: int = 0
    queue: list[tuple[int, bytes]] = field(default_factory=list)  # when they came, by its clock

    def now(self) -> int:
        return self.world.clocks[self.e].at(self.world.true)

    def next(self) -> int:
        """When it wakes next, true time."""
        if not self.ticking:
            return self.world.true + MEETS_EVERY
        start, span = self.end.session.start_ns, self.end.scene.dt_ns * self.end.every
        assert start is not None
        due = start + max(0, (self.now() - start) // span + 1) * span
        return max(self.world.true + 1, self.world.clocks[self.e].when(due))

    def take_in(self, most: int) -> None:
        taken, self.queue = self.queue[:most], self.queue[most:]
        for came, data in taken:
            for reply in self.end.receive(data, came):
                self.world.send(self.e, reply)

    def wake(self) -> None:
        session, now = self.end.session, self.now()
        self.take_in(DRAIN if self.ticking else 10**9)
        if session.failure is not None or session.left:
            self.over = True
            self.world.devices[self.e].hold((0.0,))
            return
        if self.ticking:
            self.tick(now)
            return
        if session.start_ns is not None and not session.meeting and now > session.start_ns - EARLY:
            self.ticking = True
            if session.joined:
                every = self.end.every
                self.last = (now - session.start_ns) // (self.end.scene.dt_ns * every) * every
                self.end.join(self.last + every)
        for data in session.due(now):
            self.world.send(self.e, data)

    def tick(self, now: int) -> None:
        session, world = self.end.session, self.world
        assert session.start_ns is not None
        every = self.end.every
        k = (now - session.start_ns) // (self.end.scene.dt_ns * every) * every
        if k <= self.last:
            return
        self.last = k
        out = self.end.tick(k, now, world.devices[self.e].read(k))
        world.devices[self.e].hold(out.force)
        if out.datagram is not None:
            world.send(self.e, out.datagram)
        guard = self.end.guard
        world.done[self.e].append(Done(world.true, k, out.force[0], guard.gain, guard.safe, out.played, session.met,
                                       out.row, self.ran == 0))
        self.ran += 1
        for data in session.due(now):
            world.send(self.e, data)


@dataclass
class World:
    """The two ends, their clocks, and the way between."""

    scene: Scene
    clocks: dict[str, Clock] = field(default_factory=lambda: {"m": Clock(), "s": Clock(7_777_777_777)})
    delay: dict[str, int] = field(default_factory=lambda: {"m": 20 * MS, "s": 20 * MS})  # of what this end sends
    jitter: int = 0  # ns at most, uniform
    loss: float = 0.0
    copies: float = 0.0
    noise: int = 0  # ns at most, of the stamps with which datagrams come
    seed: int = 1
    every: dict[str, int] = field(default_factory=lambda: {"m": 1, "s": 1})
    still: bool = False  # devices that do not move
    cut: set[str] = field(default_factory=set)  # ends whose datagrams are lost
    drops: Callable[[str, bytes], bool] = lambda _e, _data: False  # of everything that is sent, what is lost
    true: int = 0

    def __post_init__(self) -> None:
        self.dice = Random(self.seed)
        self.devices: dict[str, Any] = (
            {e: Body(mass=None, f=0.0) for e in "ms"} if self.still else
            {"m": SimulatedMaster(self.scene), "s": SimulatedSlave(self.scene)})
        self.processes: dict[str, Process | None] = {"m": None, "s": None}
        self.wakes = {"m": 0, "s": 0}
        self.done: dict[str, list[Done]] = {"m": [], "s": []}
        self._way: list[tuple[int, int, str, bytes]] = []
        self._serial = count()
        for e in "sm":
            self.start(e)

    def end(self, e: str) -> Endpoint:
        process = self.processes[e]
        assert process is not None
        return process.end

    def start(self, e: str, *, scene: Scene | None = None) -> None:
        self.kill(e)
        number = self.dice.getrandbits(64) if e == "m" else None
        session = Session(master=e == "m", manifest=manifest_of(scene or self.scene), number=number,
                          every=self.every[e])
        end = Endpoint(scene or self.scene, e, session)
        if not self.still:
            end.guard.lapse_after(self.devices[e].deadline)
        self.processes[e] = Process(self, e, end)
        self.wakes[e] = self.true

    def kill(self, e: str) -> None:
        """It is gone; without it the motor holds nothing."""
        self.processes[e] = None
        self.devices[e].hold((0.0,))

    def restart(self, who: str, away: float) -> None:
        for e in who:
            self.kill(e)
        self.run(away)
        for e in who:
            self.start(e)

    def stand_still(self, who: str, away: float) -> None:
        for is_asleep in (True, False):
            for e in who:
                self.pause(e, is_asleep)
            if is_asleep:
                self.run(away)

    def pause(self, e: str, asleep: bool) -> None:
        process = self.processes[e]
        if process is not None:
            process.asleep = asleep
            self.wakes[e] = self.true

    def cut_off(self, who: str, away: float) -> None:
        self.cut = set(who)
        self.run(away)
        self.cut = set()

    def step(self, e: str, by: int) -> None:
        self.clocks[e].offset += by
        self.wakes[e] = self.true

    def send(self, e: str, data: bytes) -> None:
        other = "s" if e == "m" else "m"
        dice, control = self.dice, peek(data)[0] not in (Kind.FORTH, Kind.BACK)
        if self.drops(e, data) or e in self.cut or (dice.random() < self.loss):
            return
        for _ in range(1 + (dice.random() < self.copies)):
            takes = self.delay[e] + (dice.randrange(self.jitter + 1) if self.jitter else 0)
            heappush(self._way, (self.true + takes, next(self._serial), other, data))
        assert control or len(data) == self.scene.wire_size

    def put_in(self, e: str, data: bytes) -> None:
        """A datagram comes to end `e` now, from wherever."""
        process = self.processes[e]
        if process is None:
            return
        came = process.now() - (self.dice.randrange(self.noise + 1) if self.noise else 0)
        process.queue.append((came, data))
        if not process.ticking and not process.asleep:
            process.take_in(10**9)

    def run(self, seconds: float) -> World:
        until = self.true + round(seconds * S)
        while True:
            wake = min((self.wakes[e] for e, p in self.processes.items() if p and not p.asleep and not p.over),
                       default=until)
            comes = self._way[0][0] if self._way else until
            if min(wake, comes) >= until:
                break
            if comes <= wake:
                self.true, _, e, data = heappop(self._way)
                self.put_in(e, data)
                continue
            self.true = wake
            for e, process in self.processes.items():
                if process and not process.asleep and not process.over and self.wakes[e] <= self.true:
                    process.wake()
                    self.wakes[e] = process.next()
        self.true = until
        return self

    def both_play(self, e: str | None = None) -> bool:
        for one in e or "ms":
            process = self.processes[one]
            if process is None or process.over or not process.ticking or process.asleep:
                return False
            if process.end.guard.safe or process.end.guard.gain < 1.0:
                return False
        return True

    def until_both_play(self, most: float) -> float:
        """Run until both ends play, `most` seconds at most; how many it took."""
        began = self.true
        while not self.both_play() and self.true - began < most * S:
            self.run(0.05)
        return (self.true - began) / S

    def assert_both_play(self, most: float = PATIENT, after: float = 0.5) -> World:
        """Both ends play within `most` seconds; then let `after` seconds pass."""
        took = self.until_both_play(most)
        assert took < most, [(e, p and (p.over, p.ticking, p.end.session.met)) for e, p in self.processes.items()]
        return self.run(after)
