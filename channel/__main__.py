"""`python -m channel SCENE --listen HOST:PORT --peer HOST:PORT`: the water between, as a process.

The master sends to where the channel listens; the channel passes on to the slave, its peer, what the
scene's link (or the one of --link) lets through, when it lets it through; and back.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

from channel.link import describe
from channel.relay import Relay
from teleop.live import realtime
from teleop.live.address import Address, address, bound, peer_address, shown, towards
from teleop.live.interrupt import Interrupt
from teleop.live.ticker import Alarm
from teleop.live.wire import DRAIN, Wire
from teleop.options import Parser, guarded, knobs_from, scene_options
from teleop.packet import Kind, Packet, decode, manifest_difference, peek
from teleop.scene import Scene, both_ends, load_scene

QUIET_NS = 1_000_000_000  # a session that has sent no message for so long gives way to another one's HELLO
SEALED = range(20, 26)  # first bytes of DTLS records (RFC 9147)


class RelayShell:
    """Two sockets and a timer around a `Relay`, one session after the other.

    A session is whose HELLO came last when none was running; from its first message on, it has the link for
    itself until nothing more of it comes. Only its two ends are listened to.
    """

    def __init__(self, scene: Scene, seed: int, near: Wire, far: Wire) -> None:
        self.wires = (near, far)  # where direction 0 and direction 1 come in
        self.foreign = 0  # datagrams that are no packets of this session
        self._dt_ns, self._ticks = scene.dt_ns, scene.ticks
        link: Any = scene.link  # a scene asks less of its link than a relay does
        self._water = link, seed, scene.wire_size
        self.relay = Relay(*self._water)
        self._manifest = {key: text for key, text in scene.manifest().items() if key not in ("link", "delay")}
        self._session: int | None = None
        self._origin: int | None = None  # our clock at tick 0
        self._busy_ns = 0  # when the session's last message came
        self._alarm: Alarm | None = None
        self._set_to: int | None = None
        self._carried = [0, 0]  # sealed datagrams in each direction
        self._broken: Exception | None = None

    async def run(self, interrupt: Interrupt) -> None:
        """Relay until Ctrl-C or SIGTERM."""
        loop = asyncio.get_running_loop()
        self._alarm = Alarm(loop, lambda: self._guarded(self._rang))
        for direction, wire in enumerate(self.wires):
            loop.add_reader(wire.sock, self._guarded, self._drain, direction)
        while interrupt.name is None and self._broken is None:
            await asyncio.sleep(0.05)
        self._deliver()
        for wire in self.wires:
            loop.remove_reader(wire.sock)
        self._alarm.close()
        if self._broken is not None:
            raise self._broken

    def _guarded(self, callback: Callable[..., None], *arguments: int) -> None:
        """Call `callback`; what it raises ends the relay. The event loop itself would only log it and go on."""
        try:
            callback(*arguments)
        except Exception as error:
            self._broken = self._broken or error

    def _drain(self, direction: int) -> None:
        for _ in range(DRAIN):
            got = self.wires[direction].receive()
            if got is None:
                break
            self._take(direction, *got)
        self._deliver()

    def _take(self, direction: int, data: bytes | None, sender: Address, now: int) -> None:
        if not data:
            self.foreign += 1
            return
        if data[0] in SEALED:
            self._carry(direction, data, sender, now)
            return
        kind, seq = peek(data)
        if kind in (Kind.HELLO, Kind.WELCOME):
            self._introduce(direction, data, sender, now)
        wire = self.wires[direction]
        if kind is Kind.DATA and direction == 0 and wire.peer is None:
            wire.peer = sender  # of a session that began before this channel was started anew
        if kind is None or sender != wire.peer or (kind is Kind.DATA and seq >= self._ticks):
            self.foreign += 1
            return
        if kind is Kind.DATA:
            self._busy_ns = now
            if self._origin is None:
                self._origin = now - seq * self._dt_ns
        at = 0 if self._origin is None else now - self._origin
        self.relay.receive(direction, seq if kind is Kind.DATA else None, data, at)

    def _carry(self, direction: int, data: bytes, sender: Address, now: int) -> None:
        """Pass on what only the ends can read. Its number is that of its coming, and the link is for all of it."""
        from teleop.secure.record import records

        wire, quiet = self.wires[direction], now - self._busy_ns > QUIET_NS
        if direction == 0 and (wire.peer is None or quiet) and any(one.is_hello for one in records(data) or []):
            wire.peer = sender
            self.relay, self._origin, self._carried = Relay(*self._water), now, [0, 0]
        if sender != wire.peer or self._origin is None:
            self.foreign += 1
            return
        self._busy_ns = now
        self.relay.receive(direction, self._carried[direction], data, now - self._origin)
        self._carried[direction] += 1

    def _introduce(self, direction: int, data: bytes, sender: Address, now: int) -> None:
        """Learn from a HELLO or WELCOME which session this is and where its ends are."""
        packet = decode(data, 0)
        if not isinstance(packet, Packet):
            return
        running = self._origin is not None and now - self._busy_ns < QUIET_NS
        if packet.kind is Kind.HELLO and packet.session != self._session and not running:
            self._compare(packet)
            self._session, self._origin, self._set_to = packet.session, None, None
            self.relay = Relay(*self._water)
        if packet.session == self._session and self._origin is None and direction == (packet.kind is Kind.WELCOME):
            self.wires[direction].peer = sender

    def _compare(self, hello: Packet) -> None:
        """Say so if the master runs another scene: the link would be another one. The link itself may differ."""
        assert isinstance(hello.payload, dict)
        theirs = {key: text for key, text in hello.payload.items() if key in self._manifest}
        difference = manifest_difference(self._manifest, theirs)
        if difference is not None:
            told = f"channel: the master runs another scene than this channel: {difference}"
            print(told, file=sys.stderr, flush=True)

    def _rang(self) -> None:
        self._set_to = None
        self._deliver()

    def _deliver(self) -> None:
        origin = self._origin
        now = 0 if origin is None else time.monotonic_ns() - origin
        for direction, data in self.relay.due(now):
            self.wires[1 - direction].send(data)
        due = self.relay.next_ns()
        if due is not None and origin is not None and due != self._set_to and self._alarm is not None:
            self._alarm.set(origin + due)
            self._set_to = due


def main(argv: Sequence[str] | None = None) -> int:
    """Relay a scene's session until Ctrl-C or SIGTERM; returns the exit code."""
    return guarded(lambda: _run(sys.argv[1:] if argv is None else list(argv)))


def _run(argv: list[str]) -> int:
    parser = Parser(prog="python -m channel", description="The impaired link of a scene, as a relay over UDP.")
    scene_options(parser)
    parser.add_argument("--listen", metavar="HOST:PORT", required=True, help="where the master sends to")
    parser.add_argument("--peer", metavar="HOST:PORT", required=True, help="where the slave listens")
    realtime.option(parser)
    parser.add_argument("--json", action="store_true", help="write events as lines of JSON for a machine")
    args = parser.parse_args(argv)
    scene = both_ends(load_scene(args.scene, **knobs_from(args)))
    peer = peer_address(args.peer)
    with bound(address(args.listen, "--listen"), "--listen") as near, towards(peer) as far, Interrupt() as interrupt:
        shell = RelayShell(scene, args.seed, Wire(near, None), Wire(far, peer))
        at = near.getsockname()[:2]
        realtime.asked(args, "channel")
        if args.json:
            _event("listening", address=shown(at), port=at[1])
        else:
            link: Any = scene.link  # a scene asks less of its link than a text does
            water = "no link" if link is None else describe(link)
            print(f"channel: {water}; {shown(at)} <-> {shown(peer)}; start the master with: "
                  f"python -m master {args.scene} --peer {shown(at)}", flush=True)
        asyncio.run(shell.run(interrupt))
    counts = {way: shell.relay.counts(direction)._asdict() for direction, way in enumerate(("forth", "back"))}
    if args.json:
        _event("done", summary={"counts": counts, "foreign": shell.foreign})
    else:
        for way, count in counts.items():
            print(f"channel: {way}: " + ", ".join(f"{n} {name.replace('_', ' ')}" for name, n in count.items()))
    return 0


def _event(name: str, **fields: Any) -> None:
    print(json.dumps({"event": name, **fields}), flush=True)


if __name__ == "__main__":
    raise SystemExit(main())
