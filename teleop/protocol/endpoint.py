"""Live end without its sockets: bytes and `now` come in, forces and bytes go out. Sans-IO.

The tick itself is made from `teleop.simulation.tick`, as in virtual time. Around it: the guard, which
decides how much of the law's force may be held; and the sessions, with each of which the law begins anew. A session
after the first begins where the end is: its law sees positions from there (a clutch), the record goes on in the
device's own.

An end may tick at every n-th tick of the grid only, its peer at every m-th: see `teleop.protocol.inbox`.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from math import inf, isfinite
from typing import Any, NamedTuple, Protocol

from teleop.errors import Refused
from teleop.law import law_name
from teleop.law import messages as message_types
from teleop.protocol.estimates import LinkEstimates
from teleop.protocol.guard import ForceGuard, HeldForce
from teleop.protocol.inbox import Heard, Inbox, Messages, Resampling
from teleop.protocol.packet import (
    DATA,
    MOST_SEQ,
    Echo,
    Kind,
    Layout,
    Packet,
    Rejection,
    Window,
    check_size,
    decode,
    encode,
    unwrapped,
)
from teleop.protocol.reception import IntegralCheck, Presence
from teleop.protocol.session import RENEW_NS, Session
from teleop.protocol.states import Cause, Reason
from teleop.protocol.switches import SwitchEvents, switches_of, unlike
from teleop.scene.playout import Fixed
from teleop.scene.scene import Scene
from teleop.simulation.plan import Plan
from teleop.simulation.source import live_of
from teleop.simulation.structure import NAMES, SENSED, columns, numbers_of, structure_of
from teleop.simulation.tick import LiveTick
from teleop.stages.wave_integral import Integrals

Axes = tuple[float, ...]
_NEAR = 1 << 30  # a packet's number within so much of the tick is what it says
_new: Any = tuple.__new__  # twice as fast as the class
SLEW = 2000  # a slave's grid follows the master's by at most 1/2000 of a tick a tick, 500 ppm
COUNTED = ("received", "late", "overtaken", "duplicates", "refused", "played")  # of an inbox


class Reading(NamedTuple):
    """Reading of a device or robot at a tick, per axis: the left limit at t_k. SI units.

    The switches are those of a master: None, it has no such switch. See `teleop.stages.operator`.
    """

    x: Axes
    v: Axes
    f: Axes | None = None  # force sensor: f_h at the master, f_env at the slave; None: it has none
    clutch: bool | None = None  # is the operator's clutch held open
    present: bool | None = None  # is the operator there


class Stepped:
    """Messages played by a schedule drawn up front: the deterministic form of an inbox."""

    def __init__(self, plan: Plan | None) -> None:
        self._play = None if plan is None else plan.play
        self._keep = 2 if plan is None else plan.lag + 2
        self._held: dict[int, Heard] = {}
        self._newest = -1

    def add(self, packet: int, tick: int, entry: Heard) -> None:
        if packet > self._newest - self._keep:  # a copy of one that was dropped would stay for ever
            self._held[packet] = entry
        if packet > self._newest:
            self._newest = packet
            self._held.pop(packet - self._keep, None)

    def has(self, packet: int) -> bool:
        """True if this packet has come. Asked for the newest alone: old ones are dropped."""
        return packet < 0 or packet in self._held

    def take(self, tick: int) -> tuple[int, Heard] | None:
        packet = tick - 1 if self._play is None else self._play[tick]
        return None if packet < 0 else (packet, self._held[packet])


class Tick(NamedTuple):
    """Result of one tick of an end."""

    force: Axes  # to hold until the next tick, N
    datagram: bytes | None  # to send; None if the message is not finite, or its deadband does not send it
    row: tuple[float, ...]  # for the record; its columns are `columns(scene, e, sensor)`
    played: int  # the packet played at this tick, or -1


class Witness(Protocol):
    """Writer of all inputs of an end; see `teleop.live.records.inputs`."""

    def arrived(self, session: int, packet: int, time_ns: int, tick: int) -> None: ...
    def ticked(self, k: int, session: int, inputs: tuple[Any, ...], index: Axes | None, force: Axes,
               tx: tuple[Any, ...], sent: tuple[Integrals, ...] | None) -> None: ...


class Endpoint:
    """The master's or the slave's end of a scene, live.

    `now` is the end's own monotonic clock in ns. `force_failed` names a force that was not finite: nothing may
    be held then, the run has diverged.

    `link` tells what the packets say of the way and of the peer's clock. One-way delays are as they are seen, from
    the tick a packet was sent at to its coming: they carry the uncertainty of the clock offset, half the fastest round
    trip of the first exchange. `guard` holds the safe state and the events of the run. `queues` are the places in a row
    of the record that have the queue of waves (s), one an axis; none where nothing has a queue.
    """

    _switches: SwitchEvents | None = None  # where there is an operator's part

    def __init__(self, scene: Scene, e: str, session: Session, messages: Messages | None = None) -> None:
        self.scene, self.e, self.session = scene, e, session
        self.stepped = messages is not None
        self.inbox: Messages = messages if messages is not None else Inbox(scene.played_as, scene.dt_ns)
        self.rejected: Counter[str] = Counter()
        self.received = self.saved = 0  # DATA packets of the sessions, copies included; what a deadband did not send
        self.heard_ns = 0  # when the newest of them that was no copy came
        self.counted: Counter[str] = Counter()  # by the inboxes of earlier sessions
        self.force_failed: str | None = None
        self.message_failed = False  # was the law's message not finite, and so not sent
        self.stamp_margin: float | None = None  # smallest of (sender's stamp) - (energy received here), J
        self.every = session.every
        self.own = replace(scene, dt=scene.dt * self.every) if self.every != 1 else scene
        dt = self.own.dt_ns / 1e9
        self.guard = ForceGuard(scene.watchdog, dt, every=self.every, stepped=self.stepped)
        # What came last is played so long after it was sent: until then there is a force, which no session may cut off.
        played = round(scene.played_as.delay * 1e9) if isinstance(scene.played_as, Fixed) else 0
        session.liveness.renew_ns = max(session.liveness.renew_ns, played + self.guard.lets_go_ns + RENEW_NS // 10)
        self.link = LinkEstimates(band_ns=scene.dt_ns // 2)
        self._window = Window()  # so that a copy or a replay is no second measurement
        self._tick = -1
        self._came = 0  # the tick at which a new packet came last
        self.presence = Presence(session, self.link, scene.dt_ns, self.every, self.guard.timeout_ns)
        self._met = 1  # the session that the law was begun for
        self._placed = False  # is it known where the device was before tick 0
        self._away: Axes | None = None  # how far that is from where the scene begins, if it is not there
        self._index: Axes | None = None  # where the law's positions count from, if not from the device's zero
        self.held = HeldForce(scene, e, self.every, self.guard)
        self._newest: tuple[int, int, int] | None = None  # the peer's newest number, its send time, and when it came
        self._shifted = 0  # ns that the grid was moved by
        self.witness: Witness | None = None
        self._live: Any = None
        self._rejoined = False  # did the law begin later than with tick 0 of the first session
        self._before: tuple[Integrals, ...] | None = None  # what the peer's waves had come to when it was heard first
        self._started: Any = None
        law: Any = scene.laws[0]
        self._axes = range(scene.axes)
        forth, back = message_types(law, dt)
        rx_type, tx_type = (back, forth) if e == "m" else (forth, back)
        own, other = ("master", "slave") if e == "m" else ("slave", "master")
        self._rx = Layout(rx_type, scene.axes, couples=hasattr(law, f"{other}_sums"))
        self._tx = Layout(tx_type, scene.axes, couples=hasattr(law, f"{own}_sums"))
        self.hears, self._sends = (Kind.BACK, Kind.FORTH) if e == "m" else (Kind.FORTH, Kind.BACK)
        self._integral = structure_of(scene).has.integral
        along = (1 + 2 * scene.axes) * self._integral  # T, and U and E of each axis, behind the law's messages
        self._width = self._rx.width + along
        most = max(self._rx.width, self._tx.width) + along
        self._size = check_size(scene.wire_size, most, energy=scene.energy and not self._integral)
        self._newest_wins = not self.stepped and not isinstance(scene.played_as, Fixed)
        self._rates = Resampling(rx_type, mine=self.every, turning=scene.turning)
        self._sums = IntegralCheck(scene.dt_ns / 1e9, scene.axes)
        self._dt, self._dt_ns = dt, scene.dt_ns

    @property
    def way(self) -> Any:
        """Times (ns) of the way towards this end: one-way delays."""
        return self.link.way

    def senses(self, sensor: bool, switches: tuple[str, ...] = ()) -> None:
        """Make this end's tick for a device with or without a force `sensor`, before the first: then there is no time.

        `switches`: those that the device has, "clutch" and "present". Raises `Refused` if the law reads a force that
        nothing tells, if the scene needs a switch that the device lacks, or does not heed one that it has.
        """
        scene, e = self.scene, self.e
        if why := unlike(scene, e, switches):
            raise Refused(why)
        if getattr(structure_of(scene), e).has.sensed and not sensor:
            raise Refused(_no_force(scene, e))
        self._live = live_of(self.own, e, sensor)
        names = columns(scene, e, sensor)
        stamps = [f"E_in_{'fwd' if e == 'm' else 'bwd'}", f"E_out_{'bwd' if e == 'm' else 'fwd'}"]
        flat = [n for name in names for n in ([name] * scene.axes if "@" in name else [name])]
        self._E_in, self._E_out = (flat.index(s) if s in flat else None for s in stamps)
        self._told = flat.index(f"sent_{e}") if f"sent_{e}" in flat else None
        self._switches = SwitchEvents(scene, flat) if "clutch_m" in flat else None
        self.queues = [i for i, name in enumerate(flat) if name == f"queue_{e}@"]
        self._places = [i for i, name in enumerate(flat) if name in (f"x_{e}@", f"q_{e}@")]

    def receive(self, data: bytes, now: int) -> list[bytes]:
        """Take a datagram that came at `now`; the datagrams to send back at once. Never raises on any bytes.

        It is played from the first tick at or after its coming on, even if that tick runs late.
        """
        packet = decode(data, self._width)
        if isinstance(packet, Rejection):
            self.rejected[packet.value] += 1
            return []
        session, dt_ns, start_ns = self.session, self._dt_ns, self.session.start_ns
        kind, number, seq, sent_ns, echo, _, _ = packet
        if kind is not self.hears and kind not in DATA:
            if not session.belongs(packet, now):
                self.rejected["session"] += 1
                return []
            return session.receive(packet, now, len(data))
        if number != session.number or start_ns is None or not session.carries_data:
            self.rejected["session"] += 1
            return []
        if kind is not self.hears:
            self.rejected["direction"] += 1
            return []
        came = -((start_ns - now) // dt_ns)  # the tick, rounded up
        near = self._tick if self.stepped or came < self._tick else came
        seq = seq if -_NEAR < seq - near < _NEAR else unwrapped(seq, near)
        sent = start_ns + seq * dt_ns  # when, by our clock
        if session.met != self._met and not self.stepped:
            session.take_data(now, sent)
            return []  # its law begins with the next tick, and nothing of it counts as of the session before
        if seq > near and seq > (self._tick + 1 if self.stepped else near + self.presence.most_ahead()):
            self.rejected["early"] += 1
            self.presence.ahead(self._tick, seq - near, sent_ns, now)
            return []
        old, heard = seq < 0 or seq < near - (1 << 30), self._message_of(packet)
        if old or (heard.waves is not None and not self._sums.add_up(seq, heard.waves, session.peer_every)):
            self.rejected["old" if old else "integrals"] += 1
            return []
        self.received += 1
        if self._window.judge(seq, near) == "new":
            session.take_data(now, sent)
            self._came = came
            self.presence.in_time()
            if not self.stepped:
                self.heard_ns = now
                self.link.add(seq, sent_ns, echo, now - sent, now)
            if self._newest is None or seq > self._newest[0]:
                self._newest = (seq, sent_ns, now)
                self.presence.newest(echo, sent, now)
        tick = came if came > self._tick else self._tick + 1
        if self.witness is not None:
            self.witness.arrived(self._met, seq, now - start_ns, tick)
        self.inbox.add(seq, tick, heard)
        return []

    def tick(self, k: int, now: int, reading: Reading, trouble: str | None = None) -> Tick:
        """Run tick k of the grid. The force is in N per axis, capped and watched as the scene says.

        `trouble`: why this end may hold no force, if something of which the link knows nothing has gone wrong.
        """
        if self._started is None or self._met != self.session.met:
            self._begin(k, reading)
        got = self._rates.take(self.inbox, self._tick, k)
        gain = self._gain(k, now, None if got is None else k - got[0],
                          None if trouble is None else Reason(Cause.DEVICE, trouble))
        if self.guard.lapsed or self.guard.overdue:
            self.held.zero(k)
        seq, rx, waves = (-1, None, None) if got is None else (got[0], got[1].rx, got[1].waves)
        x = reading.x if self._index is None else tuple([a - b for a, b in zip(reading.x, self._index, strict=True)])
        newest = seq if self.every == 1 else seq / self.every
        if waves is not None and self._rejoined:
            waves = self._since(waves)
        inputs = LiveTick(
            k // self.every, x, reading.v, reading.f, got is not None, newest, rx, waves, gain, self.held.force,
            self.held.since(k), 1.0 if reading.clutch else 0.0,
            1.0 if reading.present or reading.present is None else 0.0)
        force, tx, sent, row = self._started.send(inputs)
        if got is not None and self._E_out is not None and got[1].E_in is not None:
            margin = got[1].E_in - row[self._E_out]
            if self.stamp_margin is None or margin < self.stamp_margin:
                self.stamp_margin = margin
        if self._switches is not None:
            self._switches.update(k, row, self.guard)
        if self._index is not None:
            row = self._physical(row)
        self._tick = k
        if not self.held.take(k, force):
            self.force_failed = f"f_{self.e}"
        if self.e == "s":
            self._follow()
        datagram = self._datagram(k, now, tx, sent, row)
        if self.witness is not None:
            self.witness.ticked(k, self._met, inputs, self._index, force, tx, sent)
        out: Tick = _new(Tick, (force, datagram, row, seq))
        return out

    def left_out(self, k: int, trouble: str, cause: Cause = Cause.DEVICE) -> Axes:
        """Skip tick k, for there is no reading: the force (N, per axis) to hold, on its way to zero."""
        force = self.held.blind(k, self._tick, Reason(cause, trouble))
        self.session.zero_force = not any(force)
        return force

    def stood_still(self, ns: int) -> None:
        """End the session, for this machine was suspended for `ns`: what it has of its peer is too old by as much."""
        self.session.end(f"stood still: this machine was suspended for {ns / 1e9:.3f} s", Cause.STOOD_STILL)

    def place(self, x: Axes) -> None:
        """Take note of where the device is before tick 0; if not where the scene is, the law begins from rest there."""
        self._placed = True
        starts = self.scene.vector(f"start_{self.e}", getattr(self.scene, f"start_{self.e}"))
        if x != starts and not self.stepped:
            self._away = tuple([a - b for a, b in zip(x, starts, strict=True)])

    def join(self, k: int, why: str = "the other end was running already") -> None:
        """The first tick of this end will be k: the run has been going on without it."""
        if not self.stepped:
            self._tick = k - 1
            self.inbox = Inbox(self.scene.played_as, self.scene.dt_ns, tick=k - 1)
            self.guard.tell(k, "joined", why)
            self._met = 0

    def _begin(self, k: int, reading: Reading) -> None:
        """Begin the law: for the first session as the scene says, for a later one from rest, where the end is."""
        if self._live is None:
            self.senses(reading.f is not None, switches_of(reading))
        first, self._met = self._met == 1 and self._started is None, self.session.met
        self._rejoined, self._before = not first and not self.stepped, None
        self.held.begin(k)
        x = reading.x
        if first and not self._placed:
            self.place(x)  # nobody could read it before
        if first and self._away is not None:
            self._index = self._counted_from(self._away)
            self.guard.begin(k, "the device is not where the scene begins: the law's positions count from there")
        if not first:
            self._index = self._counted_from(x)
            if not self.stepped:
                inbox: Any = self.inbox
                self.counted += Counter({name: getattr(inbox, name) for name in COUNTED})
                self.inbox, self._tick = Inbox(self.scene.played_as, self.scene.dt_ns, tick=k - 1), k - 1
                self._window, self._newest, self._shifted = Window(), None, 0
                self._sums = IntegralCheck(self.scene.dt_ns / 1e9, self.scene.axes)
                self.presence.begin()
                self.link.begin(self._rates.theirs)
            self.guard.begin(k, "the law begins from rest, and its positions from here")
        if self._index is not None:
            x = tuple([a - b for a, b in zip(x, self._index, strict=True)])
        self._rates.begin(self.session.peer_every)
        begins = numbers_of(self.own, {self.e: x})
        self._started = self._live(begins, self.scene.law, self._dt, x, reading.v, reading.f)
        self._started.send(None)

    def _gain(self, k: int, now: int, age: int | None, trouble: Reason | None) -> float:
        """The guard's gain at tick k, and whether the session is over. `age`: ticks since its message was sent."""
        session, presence, unheard = self.session, self.presence, 0.0
        if not self.stepped:
            presence.judge(k, now)
            # What is not released yet waits for the first answer; a run that begins well need not.
            waits = self.guard.safe and not presence.answered
            unheard = inf if waits else presence.unheard_ns / 1e9
        came = self._came if self._newest_wins else self._rates.played
        gain = self.guard.step(
            k, age is not None, trouble, arrived=came, over=session.ended, unheard=unheard, age=age or 0)
        session.zero_force = gain == 0.0
        return gain

    def _counted_from(self, x: Axes) -> Axes:
        """Origin of the law's positions: here, to a whole step of the encoder if there is one."""
        device: Any = getattr(self.scene, f"device_{self.e}")
        if device is None or device.encoder is None:
            return x
        from teleop.stages.encoder import encode

        return tuple([encode((device.encoder.step, 0.5), each) for each in x])

    def _follow(self) -> None:
        """Let a slave's grid follow the master's, whose clock may go at another rate."""
        wanted = -self.link.clock.shift_ns
        if self.session.start_ns is not None and wanted != self._shifted and not self.stepped:
            most = self.own.dt_ns // SLEW
            step = max(-most, min(most, wanted - self._shifted))
            self._shifted += step
            self.session.start_ns += step

    def _physical(self, row: tuple[float, ...]) -> tuple[float, ...]:
        """A row of the record with its positions as the device reads them."""
        assert self._index is not None
        out = list(row)
        for n, i in enumerate(self._places):
            out[i] += self._index[n % self.scene.axes]
        return tuple(out)

    def _message_of(self, packet: Packet) -> Heard:
        payload: Any = packet.payload
        rx, at = self._rx.messages(payload), self._rx.width
        if not self._integral:
            return Heard(rx, packet.E_in)
        if len(rx) == 1:  # the same without the loop
            U, E, T = payload[at:]
            return Heard(rx, E, (Integrals(T, U, E),))
        T = payload[-1]
        waves = tuple([Integrals(T, payload[at + 2 * i], payload[at + 2 * i + 1]) for i in self._axes])
        return Heard(rx, sum(each.E for each in waves), waves)

    def _since(self, waves: tuple[Integrals, ...]) -> tuple[Integrals, ...]:
        """Subtract the integrals of the first message of this session that this end played.

        Where both begin with tick 0, that is all they have come to. A later session's ends begin at ticks of their own,
        and what a peer sent before this end was there is no queue to play.
        """
        if self._before is None:
            self._before = waves
        return tuple([Integrals(*[now - then for now, then in zip(each, before, strict=True)])
                      for each, before in zip(waves, self._before, strict=True)])

    def _datagram(
        self, k: int, now: int, tx: tuple[Any, ...], sent: tuple[Integrals, ...] | None, row: tuple[float, ...]
    ) -> bytes | None:
        payload = self._tx.flat(tx)
        if sent is not None:
            payload += (*[number for _, U, E in sent for number in (U, E)], sent[0].T)
        session = self.session
        if not isfinite(sum(payload)) and not all(map(isfinite, payload)):
            self.message_failed = True
            return None
        if session.number is None or not session.carries_data:
            return None
        if self._told is not None and row[self._told] == 0.0:
            self.saved += 1
            return None
        newest = self._newest
        echo = None if newest is None else _new(Echo, (newest[1], max(0, now - newest[2])))
        stamp = None
        if sent is None and self._E_in is not None and isfinite(row[self._E_in]):
            stamp = float(row[self._E_in])
        packet = _new(Packet, (self._sends, session.number, k & MOST_SEQ, now, echo, payload, stamp))
        return encode(packet, self._size)


def _no_force(scene: Scene, e: str) -> str:
    """Why a law that reads the external force at the end `e` does not run with a device that senses none."""
    whose = {"m": "the hand's force", "s": "the force on the environment"}[e]
    other = "--set law=wave" if "law" in scene.knobs else "law=Wave() in the scene"
    cures = [f"take a law that reads none, with {other} at both ends"]
    if e == "m":
        observer = "--set observer=200" if "observer" in scene.knobs else "observer=200.0 in the scene"
        cures.insert(0, f"have an observer estimate it, with {observer} at both ends")
    return (f"the law {law_name(scene.laws[0])} reads {whose}, {SENSED[e]}, and the {NAMES[e]}'s device senses none: "
            f"its reading has f=None; have it read f, in N, or {', or '.join(cures)}")
