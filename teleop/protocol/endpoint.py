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
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from teleop.errors import Refused
from teleop.law import law_name
from teleop.law import messages as message_types
from teleop.protocol.end_law import EndLaw, Origin, RowPlaces
from teleop.protocol.estimates import LinkEstimates
from teleop.protocol.guard import ForceGuard, HeldForce
from teleop.protocol.inbox import Heard, Inbox, Messages, Resampling
from teleop.protocol.packet import (
    DATA,
    MOST_SEQ,
    Echo,
    Kind,
    Layout,
    Rejection,
    check_size,
    decode,
    framed,
    unwrapped,
)
from teleop.protocol.reception import Presence, Reception
from teleop.protocol.session import Session, renew_after
from teleop.protocol.states import Cause, Reason
from teleop.protocol.switches import SwitchEvents, switches_of, unlike
from teleop.scene.playout import Fixed
from teleop.scene.scene import Scene
from teleop.simulation.plan import Plan
from teleop.simulation.structure import NAMES, SENSED, structure_of
from teleop.simulation.tick import LiveTick
from teleop.stages.end import CLUTCHES
from teleop.stages.wave_integral import Integrals

if TYPE_CHECKING:  # an end without a policy does not load it
    from teleop.protocol.policy import PolicyEvents, PolicyInput

Axes = tuple[float, ...]
_NOTHING: Any = (None, None, None)  # message, energy and waves where none is played
_NO_POLICY: Any = (0.0, 0.0, None)  # what a tick is sent of none
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
    clutch: bool | str | None = None  # is the operator's clutch held open; "translation", "rotation": of those alone
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


class MessageFormat:
    """Format of both ways' messages at the end `e`: the law's, per axis, and the integrals of waves behind them.

    `hears` and `sends`: kind of the packets of each way. `width`: of those that come, how many numbers one has. `size`:
    bytes of every datagram.
    """

    def __init__(self, scene: Scene, e: str, dt: float) -> None:
        law: Any = scene.laws[0]
        ways = (("master", Kind.FORTH), ("slave", Kind.BACK))
        (sender, self.sends), (peer, self.hears) = ways if e == "m" else ways[::-1]
        types = dict(zip(("master", "slave"), message_types(law, dt), strict=True))
        self.rx_type = types[peer]
        self._rx, self._tx = (
            Layout(types[name], scene.axes, couples=hasattr(law, f"{name}_sums")) for name in (peer, sender))
        self._has_integral = structure_of(scene).has.integral
        integrals = (1 + 2 * scene.axes) * self._has_integral  # T, and U and E of each axis, behind the law's messages
        self.width = self._rx.width + integrals
        most = max(self._rx.width, self._tx.width) + integrals
        self.size = check_size(scene.wire_size, most, energy=scene.energy and not self._has_integral)
        self._axes = range(scene.axes)

    def message_of(self, payload: Any, E_in: float | None) -> Heard:
        """The message in a packet with this payload and this energy of the sender."""
        rx, at = self._rx.messages(payload), self._rx.width
        if not self._has_integral:
            heard: Heard = _new(Heard, (rx, E_in, None))
            return heard
        if len(rx) == 1:  # the same without the loop
            U, E, T = payload[at:]
            return Heard(rx, E, (Integrals(T, U, E),))
        T = payload[-1]
        waves = tuple([Integrals(T, payload[at + 2 * i], payload[at + 2 * i + 1]) for i in self._axes])
        return Heard(rx, sum(each.E for each in waves), waves)

    def payload_of(self, tx: tuple[Any, ...], waves: tuple[Integrals, ...] | None) -> tuple[float, ...]:
        """The numbers of a packet with these messages."""
        payload = self._tx.flat(tx)
        if waves is not None:
            payload += (*[number for _, U, E in waves for number in (U, E)], waves[0].T)
        return payload


class Endpoint:
    """The master's or the slave's end of a scene, live.

    `now` is the end's own monotonic clock in ns. `force_failed` names a force that was not finite: nothing may
    be held then, the run has diverged.

    `link` tells what the packets say of the way and of the peer's clock. One-way delays are as they are seen, from
    the tick a packet was sent at to its coming: they carry the uncertainty of the clock offset, half the fastest round
    trip of the first exchange. `guard` holds the safe state and the events of the run. `places` are those of a row of
    the record, once the end knows what its device senses.
    """

    places: RowPlaces

    _switches: SwitchEvents | None = None  # where there is an operator's part
    _policy_events: PolicyEvents | None = None  # where there is a policy's

    def __init__(self, scene: Scene, e: str, session: Session, messages: Messages | None = None) -> None:
        self.scene, self.e, self.session = scene, e, session
        self.stepped = messages is not None
        self.inbox: Messages = messages if messages is not None else Inbox(scene.played_as, scene.dt_ns)
        self.rejected: Counter[str] = Counter()
        self.received = self.saved = 0  # DATA packets of the sessions, copies included; what a deadband did not send
        self.heard_ns = 0  # when the newest of them that was no copy came
        self.counted: Counter[str] = Counter()  # by the inboxes of earlier sessions
        self.force_failed: str | None = None
        self.scale = 1.0  # of the operator's transformer, as it was ordered last
        self.message_failed = False  # was the law's message not finite, and so not sent
        self.stamp_margin: float | None = None  # smallest of (sender's stamp) - (energy received here), J
        self.every = session.every
        self.end_scene = replace(scene, dt=scene.dt * self.every) if self.every != 1 else scene
        dt = self.end_scene.dt_ns / 1e9
        self.format = MessageFormat(scene, e, dt)
        self.guard = ForceGuard(scene.watchdog, dt, every=self.every, stepped=self.stepped)
        session.liveness.renew_ns = max(session.liveness.renew_ns, renew_after(scene, self.guard.lets_go_ns))
        self.link = LinkEstimates(band_ns=scene.dt_ns // 2)
        self.presence = Presence(session, self.link, scene.dt_ns, self.every, self.guard.timeout_ns)
        self.held = HeldForce(scene, e, self.every, self.guard)
        self.policy: PolicyInput | None = None
        if scene.handover is not None and e == "m":
            from teleop.protocol.policy import PolicyInput

            self.policy = PolicyInput(scene, dt)
        self.witness: Witness | None = None
        self._dt_ns = scene.dt_ns
        self._tick = -1
        self._arrived = 0  # the tick at which a new packet came last
        self._newest_wins = not self.stepped and not isinstance(scene.played_as, Fixed)
        self._reception = Reception(scene.dt_ns / 1e9, scene.axes)
        self._rates = Resampling(self.format.rx_type, mine=self.every, turning=scene.turning)
        self._origin = Origin(scene, e)
        self._met = 1  # the session that the law was begun for
        self._law: EndLaw | None = None  # once it is known what the device senses

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
        law = self._law = EndLaw(self.end_scene, e, sensor, self._origin)
        self.places = law.places
        self._switches = SwitchEvents(scene, law.names) if "clutch_m" in law.names else None
        if self.policy is not None:
            from teleop.protocol.policy import PolicyEvents

            self._policy_events = PolicyEvents(scene, law.names)

    def receive(self, data: bytes, now: int) -> list[bytes]:
        """Take a datagram that came at `now`; the datagrams to send back at once. Never raises on any bytes.

        It is played from the first tick at or after its coming on, even if that tick runs late.
        """
        packet = decode(data, self.format.width)
        if isinstance(packet, Rejection):
            self.rejected[packet.value] += 1
            return []
        session, start_ns, hears = self.session, self.session.start_ns, self.format.hears
        kind, number, seq, sent_ns, echo, payload, E_in = packet
        if kind is not hears and kind not in DATA:
            if not session.belongs(packet, now):
                self.rejected["session"] += 1
                return []
            return session.receive(packet, now, len(data))
        if number != session.number or start_ns is None or not session.carries_data:
            self.rejected["session"] += 1
            return []
        if kind is not hears:
            self.rejected["direction"] += 1
            return []
        arrival = -((start_ns - now) // self._dt_ns)  # the tick, rounded up
        near = self._tick if self.stepped or arrival < self._tick else arrival
        seq = seq if -_NEAR < seq - near < _NEAR else unwrapped(seq, near)
        sent = start_ns + seq * self._dt_ns  # when, by our clock
        if session.met != self._met and not self.stepped:
            session.take_data(now, sent)
            return []  # its law begins with the next tick, and nothing of it counts as of the session before
        if seq > near and seq > (self._tick + 1 if self.stepped else near + self.presence.most_ahead()):
            self.rejected["early"] += 1
            self.presence.ahead(self._tick, seq - near, sent_ns, now)
            return []
        is_old, reception = seq < 0 or seq < near - _NEAR, self._reception
        message = self.format.message_of(payload, E_in)
        if is_old or (message.waves is not None and not reception.integrals.add_up(
                seq, message.waves, session.peer_every)):
            self.rejected["old" if is_old else "integrals"] += 1
            return []
        self.received += 1
        if reception.window.judge(seq, near) == "new":
            session.take_data(now, sent)
            self._arrived = arrival
            self.presence.in_time()
            if not self.stepped:
                self.heard_ns = now
                self.link.add(seq, sent_ns, echo, now - sent, now)
            if reception.newest is None or seq > reception.newest[0]:
                reception.newest = (seq, sent_ns, now)
                self.presence.newest(echo, sent, now)
        tick = arrival if arrival > self._tick else self._tick + 1
        if self.witness is not None:
            self.witness.arrived(self._met, seq, now - start_ns, tick)
        self.inbox.add(seq, tick, message)
        return []

    def tick(self, k: int, now: int, reading: Reading, trouble: str | None = None) -> Tick:
        """Run tick k of the grid. The force is in N per axis, capped and watched as the scene says.

        `trouble`: why this end may hold no force, if something of which the link knows nothing has gone wrong.
        """
        law = self._law
        if law is None or not law.begun or self._met != self.session.met:
            law = self._begin(k, reading)
        played = self._rates.take(self.inbox, self._tick, k)
        gain = self._gain(k, now, None if played is None else k - played[0],
                          None if trouble is None else Reason(Cause.DEVICE, trouble))
        if self.guard.lapsed or self.guard.overdue:
            self.held.zero(k)
        seq, (rx, stamp, waves) = (-1, _NOTHING) if played is None else played
        if waves is not None and self._reception.rejoined:
            waves = self._reception.since_first(waves)
        x, v, f, clutch, present = reading
        origin, held = self._origin, self.held
        inputs = _new(LiveTick, (
            k // self.every, x if origin.at is None else origin.of_law(x), v, f, played is not None,
            seq if self.every == 1 else seq / self.every, rx, waves, gain, held.force, held.since(k),
            CLUTCHES[clutch], 1.0 if present or present is None else 0.0, self.scale,
            *(_NO_POLICY if self.policy is None else self._policy_at(k))))
        force, tx, sent, row = law.answer(inputs)
        if stamp is not None and self.places.E_out is not None:
            margin = stamp - row[self.places.E_out]
            if self.stamp_margin is None or margin < self.stamp_margin:
                self.stamp_margin = margin
        if self._switches is not None:
            self._switches.update(k, row, self.guard)
        if self._policy_events is not None:
            self._policy_events.update(k, row, self.guard)
        self._tick = k
        if not held.take(k, force):
            self.force_failed = f"f_{self.e}"
        if self.e == "s":
            self._follow()
        datagram = self._datagram(k, now, tx, sent, row)
        if self.witness is not None:
            self.witness.ticked(k, self._met, inputs, origin.at, force, tx, sent)
        out: Tick = _new(Tick, (force, datagram, row, seq))
        return out

    def _policy_at(self, k: int) -> tuple[float, float, Axes]:
        """The policy's switch, whether an action came, and the newest, in the law's positions."""
        assert self.policy is not None
        wants, renewed, action = self.policy.at(k // self.every)
        return wants, renewed, self._origin.of_law(action)

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
        self._origin.place(x, moves=not self.stepped)

    def set_scale(self, k: int, scale: float) -> None:
        """Set the scale of motion and force between the device and its law at tick k; it changes gradually from then.

        Raises `Refused` for one that is out of bounds; then it stays what it was.
        """
        from teleop.stages.scaling import check_scale

        self.scale = check_scale(scale)
        self.guard.tell(k, "scale", f"the scale is set to {scale:g}: a metre of the handle is {scale:g} m of the law, "
                        f"and a newton of the law {scale:g} N in the hand")

    def join(self, k: int, why: str = "the other end was running already") -> None:
        """The first tick of this end will be k: the run has been going on without it."""
        if not self.stepped:
            self._tick = k - 1
            self.inbox = Inbox(self.scene.played_as, self.scene.dt_ns, tick=k - 1)
            self.guard.tell(k, "joined", why)
            self._met = 0

    def _begin(self, k: int, reading: Reading) -> EndLaw:
        """Begin the law: for the first session as the scene says, for a later one from rest, where the end is."""
        if self._law is None:
            self.senses(reading.f is not None, switches_of(reading))
        law = self._law
        assert law is not None
        first, self._met = self._met == 1 and not law.begun, self.session.met
        self.held.begin(k)
        origin = self._origin
        if first and not origin.placed:
            self.place(reading.x)  # nobody could read it before
        if first and origin.away is not None:
            origin.move(origin.away)
            self.guard.begin(k, "the device is not where the scene begins: the law's positions count from there")
        if not first:
            origin.move(reading.x)
            if not self.stepped:
                inbox: Any = self.inbox
                self.counted += Counter({name: getattr(inbox, name) for name in COUNTED})
                self.inbox, self._tick = Inbox(self.scene.played_as, self.scene.dt_ns, tick=k - 1), k - 1
                self._reception = Reception(self.scene.dt_ns / 1e9, self.scene.axes, rejoined=True)
                self.presence.begin()
                self.link.begin(self._rates.theirs)
            self.guard.begin(k, "the law begins from rest, and its positions from here")
        self._rates.begin(self.session.peer_every)
        law.begin(origin.of_law(reading.x), reading.v, reading.f)
        return law

    def _gain(self, k: int, now: int, age: int | None, trouble: Reason | None) -> float:
        """The guard's gain at tick k, and whether the session is over. `age`: ticks since its message was sent."""
        session, presence, unheard = self.session, self.presence, 0.0
        if not self.stepped:
            presence.judge(k, now)
            # What is not released yet waits for the first answer; a run that begins well need not.
            waits = self.guard.safe and not presence.answered
            unheard = inf if waits else presence.unheard_ns / 1e9
        arrived = self._arrived if self._newest_wins else self._rates.played
        gain = self.guard.step(k, age is not None, trouble, arrived, session.ended, unheard, age or 0)
        session.zero_force = gain == 0.0
        return gain

    def _follow(self) -> None:
        """Let a slave's grid follow the master's, whose clock may go at another rate."""
        wanted, reception = -self.link.clock.shift_ns, self._reception
        if self.session.start_ns is not None and wanted != reception.shift_ns and not self.stepped:
            most = self.end_scene.dt_ns // SLEW
            step = max(-most, min(most, wanted - reception.shift_ns))
            reception.shift_ns += step
            self.session.start_ns += step

    def _datagram(
        self, k: int, now: int, tx: tuple[Any, ...], sent: tuple[Integrals, ...] | None, row: tuple[float, ...]
    ) -> bytes | None:
        payload = self.format.payload_of(tx, sent)
        session, places, newest = self.session, self.places, self._reception.newest
        if not isfinite(sum(payload)) and not all(map(isfinite, payload)):
            self.message_failed = True
            return None
        if session.number is None or not session.carries_data:
            return None
        if newest is None and self._origin.pinned and self.e == "m" and not self.stepped:
            return None  # it would draw the slave to where the handle is, before the law knows where that one is
        if places.sent is not None and row[places.sent] == 0.0:
            self.saved += 1
            return None
        echo = None if newest is None else _new(Echo, (newest[1], max(0, now - newest[2])))
        stamp = None
        if sent is None and places.E_in is not None and isfinite(row[places.E_in]):
            stamp = float(row[places.E_in])
        return framed(self.format.sends, (session.number, k & MOST_SEQ, now, echo, payload, stamp), self.format.size)


def _no_force(scene: Scene, e: str) -> str:
    """Why a law that reads the external force at the end `e` does not run with a device that senses none."""
    whose = {"m": "the hand's force", "s": "the force on the environment"}[e]
    law = "--set law=wave" if "law" in scene.knobs else "law=Wave() in the scene"
    cures = [f"take a law that reads none, with {law} at both ends"]
    if e == "m":
        observer = "--set observer=200" if "observer" in scene.knobs else "observer=200.0 in the scene"
        cures.insert(0, f"have an observer estimate it, with {observer} at both ends")
    return (f"the law {law_name(scene.laws[0])} reads {whose}, {SENSED[e]}, and the {NAMES[e]}'s device senses none: "
            f"its reading has f=None; have it read f, in N, or {', or '.join(cures)}")
