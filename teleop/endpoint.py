"""One live end without its sockets: bytes and `now` come in, forces and bytes go out. Sans-IO.

The tick itself is the text of `teleop.tick`, the same as in virtual time.
"""

from __future__ import annotations

from collections import Counter
from math import isfinite
from typing import Any, NamedTuple, Protocol

from teleop.packet import Echo, Kind, Packet, Rejection, Window, check_size, decode, encode
from teleop.playout import Inbox, Plan
from teleop.scene import Scene
from teleop.session import Session
from teleop.source import beginnings, compiled, live_text
from teleop.tick import columns

Axes = tuple[float, ...]


class Reading(NamedTuple):
    """What a device or robot reads at a tick, per axis: the left limit at t_k. SI units."""

    x: Axes
    v: Axes
    f: Axes | None  # force sensor: f_h at the master, f_env at the slave; None: it has none


class Heard(NamedTuple):
    """One message as it came: the law's, per axis, and the sender's energy stamp."""

    rx: tuple[Any, ...]
    E_in: float | None


class Times:
    """Mean, least and most of times in ns, taken one by one."""

    def __init__(self) -> None:
        self.count, self.total, self.least, self.most = 0, 0, 0, 0
        self.recent = 0.0  # mean over about the last 200

    def add(self, ns: int) -> None:
        """One more."""
        self.least = ns if not self.count else min(self.least, ns)
        self.most = ns if not self.count else max(self.most, ns)
        self.count += 1
        self.total += ns
        self.recent += (ns - self.recent) / min(self.count, 200)


class Messages(Protocol):
    """Where messages wait until a tick plays them."""

    def put(self, packet: int, tick: int, entry: Heard) -> None: ...
    def take(self, tick: int) -> tuple[int, Heard] | None: ...


class Stepped:
    """Messages played by a schedule drawn up front: the deterministic form of an inbox."""

    def __init__(self, plan: Plan | None) -> None:
        self._play = None if plan is None else plan.play
        self._keep = 2 if plan is None else plan.lag + 2
        self._held: dict[int, Heard] = {}
        self._newest = -1

    def put(self, packet: int, tick: int, entry: Heard) -> None:
        if packet > self._newest - self._keep:  # a copy of one that was dropped would stay for ever
            self._held[packet] = entry
        if packet > self._newest:
            self._newest = packet
            self._held.pop(packet - self._keep, None)

    def has(self, packet: int) -> bool:
        """Has this packet come? Asked for the newest only: old ones are dropped."""
        return packet < 0 or packet in self._held

    def take(self, tick: int) -> tuple[int, Heard] | None:
        packet = tick - 1 if self._play is None else self._play[tick]
        return None if packet < 0 else (packet, self._held[packet])


class Tick(NamedTuple):
    """What one tick of an end comes to."""

    force: Axes  # to hold until the next tick, N
    datagram: bytes | None  # to send; None if the message is not finite
    row: tuple[float, ...]  # for the record; its columns are `columns(scene, e)`
    played: int  # the packet played at this tick, or -1


class Endpoint:
    """The master's or the slave's end of a scene, live.

    `now` is the end's own monotonic clock in ns. `force_failed` names a force that was not finite: nothing may
    be held then, the run has diverged.

    `way` are the one-way delays as they are seen, from the tick a packet was sent at to the tick that took it
    in: they carry the uncertainty of the clock offset, half the fastest round trip of the first exchange.
    `rtt` are the round trips that the packets' echoes tell, which need no common clock.
    """

    def __init__(self, scene: Scene, e: str, session: Session, messages: Messages | None = None) -> None:
        self.scene, self.e, self.session = scene, e, session
        self.inbox: Messages = messages if messages is not None else Inbox(scene.playout, scene.dt_ns)
        self.stepped = isinstance(self.inbox, Stepped)
        self.rejected: Counter[str] = Counter()
        self.received = 0  # DATA packets of this session, copies included
        self.force_failed: str | None = None
        self.stamp_margin: float | None = None  # smallest of (sender's stamp) - (energy received here), J
        self.way, self.rtt = Times(), Times()
        self._window = Window()  # so that a copy or a replay is no second measurement
        self._tick = -1
        self._newest: tuple[int, int] | None = None  # peer's newest send time, and when it came here
        self._live = compiled(scene, live_text(scene, e), "live")  # now: at tick 0 there is no time for it
        self._started: Any = None
        law: Any = scene.law
        self._axes = range(scene.axes)
        dt = scene.dt_ns / 1e9
        from teleop.law import messages as message_types

        forth, back = message_types(law, dt)
        self._rx_type, tx_type = (back, forth) if e == "m" else (forth, back)
        self._rx_width, tx_width = len(self._rx_type._fields), len(tx_type._fields)
        self._width = self._rx_width * scene.axes
        most = max(self._rx_width, tx_width) * scene.axes
        self._size = check_size(scene.wire_size, most, energy=scene.energy)
        names = columns(scene, e)
        stamps = [f"E_in_{'fwd' if e == 'm' else 'bwd'}", f"E_out_{'bwd' if e == 'm' else 'fwd'}"]
        flat = [n for name in names for n in ([name] * scene.axes if "@" in name else [name])]
        self._E_in, self._E_out = (flat.index(s) if s in flat else None for s in stamps)
        self._g = flat.index(f"g_{e}") if f"g_{e}" in flat else None
        self._dt = dt

    def receive(self, data: bytes, now: int) -> list[bytes]:
        """Take a datagram that came at `now`; the datagrams to send back at once. Never raises on any bytes.

        It is played from the first tick at or after its coming on, even if that tick runs late.
        """
        packet = decode(data, self._width)
        if isinstance(packet, Rejection):
            self.rejected[packet.value] += 1
            return []
        if packet.kind is not Kind.DATA:
            if not self.session.belongs(packet, now):
                self.rejected["session"] += 1
                return []
            return self.session.receive(packet, now)
        if packet.session != self.session.number or self.session.start_ns is None:
            self.rejected["session"] += 1
            return []
        self.session.data_came()
        self.received += 1
        if not self.stepped and self._window.judge(packet.seq, self._tick) == "new":
            self.way.add(now - self.session.start_ns - packet.seq * self.scene.dt_ns)
            if packet.echo is not None:
                self.rtt.add(now - packet.echo.sent_ns - packet.echo.held_ns)
        if self._newest is None or packet.sent_ns > self._newest[0]:
            self._newest = (packet.sent_ns, now)
        tick = -((self.session.start_ns - now) // self.scene.dt_ns)  # rounded up
        self.inbox.put(packet.seq, max(tick, self._tick + 1), Heard(self._message(packet.payload), packet.E_in))
        return []

    def tick(self, k: int, now: int, reading: Reading) -> Tick:
        """Run tick k. The force is in N per axis, capped and watched as the scene says."""
        if self._started is None:
            self._begin(reading)
        got = self.inbox.take(k)
        self._tick = k
        seq, rx = (-1, None) if got is None else (got[0], got[1].rx)
        force, tx, row = self._started.send((k, reading.x, reading.v, reading.f, got is not None, seq, rx))
        if got is not None and self._E_out is not None and got[1].E_in is not None:
            margin = got[1].E_in - row[self._E_out]
            if self.stamp_margin is None or margin < self.stamp_margin:
                self.stamp_margin = margin
        if not all(map(isfinite, force)):
            self.force_failed = f"f_{self.e}"
        return Tick(force, self._datagram(k, now, tx, row), row, seq)

    def gain(self, row: tuple[float, ...]) -> float | None:
        """The watchdog's gain in a row of this end, None if the scene has no watchdog."""
        return None if self._g is None else row[self._g]

    def _begin(self, reading: Reading) -> None:
        scene = self.scene
        begins = beginnings(scene, {self.e: reading.x})
        self._started = self._live(scene, begins, scene.law, self._dt, reading.x, reading.v, reading.f)
        self._started.send(None)

    def _message(self, payload: Any) -> tuple[Any, ...]:
        n, kind = self._rx_width, self._rx_type
        return tuple([kind(*payload[i * n : i * n + n]) for i in self._axes])

    def _datagram(self, k: int, now: int, tx: tuple[Any, ...], row: tuple[float, ...]) -> bytes | None:
        payload = tuple(tx[0]) if len(tx) == 1 else tuple([number for message in tx for number in message])
        session = self.session.number
        if session is None or not all(map(isfinite, payload)):
            return None
        echo = None if self._newest is None else Echo(self._newest[0], max(0, now - self._newest[1]))
        stamp = None if self._E_in is None or not isfinite(row[self._E_in]) else row[self._E_in]
        return encode(Packet(Kind.DATA, session, k, now, echo, payload, stamp), self._size)
