"""`python -m channel SCENE --listen HOST:PORT --peer HOST:PORT`: the water between, as a process.

The master sends to where the channel listens; the channel passes on to the slave, its peer, what the
scene's link (or the one of --link) lets through, when it lets it through; and back.
"""

from __future__ import annotations

import gc
import json
import sys
import time
from collections.abc import Sequence
from selectors import EVENT_READ, DefaultSelector
from typing import Any

from channel.link import describe
from channel.relay import Counts, Relay
from teleop.live import realtime
from teleop.live.address import Address, address, bound, peer_address, shown, towards
from teleop.live.bulk import Bulk
from teleop.live.interrupt import Interrupt
from teleop.live.ticker import Timer
from teleop.live.wire import Wire
from teleop.options import Parser, guarded, knobs_from, scene_options
from teleop.packet import Kind, Packet, decode, manifest_difference, peek
from teleop.scene import Scene, both_ends, load_scene
from teleop.session import RENEW_NS

MOST_SAID = 5  # strangers can say HELLO too, and nobody may be reading
QUIET_NS = RENEW_NS  # a session that has sent no message for so long gives way to another one's HELLO
SEALED = range(20, 26)  # first bytes of DTLS records (RFC 9147)
LEAD_NS = 45_000  # the relay is called so long before a datagram is due, for it takes time to wake up and come to it
SOON_NS = 30_000  # what is due so soon after another is waited for too, before anything is taken in
LOOK_S = 0.05  # between two looks at whether it is to end
_FORTH, _BACK = Kind.FORTH, Kind.BACK


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
        self._past: list[Counts | None] = [None, None]  # of the sessions before
        self._manifest = {key: text for key, text in scene.manifest().items() if key not in ("link", "delay")}
        self._session: int | None = None
        self._differed = 0  # masters that were said to run another scene
        self._origin: int | None = None  # our clock at tick 0
        self._busy_ns = 0  # when the session's last message came
        self._bulks = (Bulk(near), Bulk(far))
        self._set_to: int | None = None  # what the timer is set for
        self._carried = [0, 0]  # sealed datagrams in each direction

    def run(self, interrupt: Interrupt) -> None:
        """Relay until Ctrl-C or SIGTERM."""
        timer = Timer()
        gc.collect()
        gc.freeze()
        with DefaultSelector() as selector:
            for wire in self.wires:
                selector.register(wire.sock, EVENT_READ)
            if timer.fd >= 0:
                selector.register(timer.fd, EVENT_READ)
            try:
                while interrupt.name is None:
                    self._sleep(selector, timer)
                    self._deliver()
                    for direction, bulk in enumerate(self._bulks):
                        for data, sender, came in bulk.receive():
                            self._take(direction, data, sender, came)
                    self._pass_on()  # the session's own do not wait
            finally:
                if timer.fd >= 0:
                    timer.close()

    def _sleep(self, selector: DefaultSelector, timer: Timer) -> None:
        """Until something comes, or is about to be due."""
        due = self._due()
        if due is None:
            selector.select(LOOK_S)
            return
        left = due - LEAD_NS - time.monotonic_ns()
        if left <= 0:
            return
        if timer.fd < 0:
            selector.select(min(LOOK_S, left / 1e9))
            return
        if due != self._set_to:
            timer.set(due - LEAD_NS)
            self._set_to = due
        if any(key.fd == timer.fd for key, _ in selector.select(LOOK_S)):
            timer.rang()

    def _deliver(self) -> None:
        """Wait awake for what is about to be due, and send it. Datagrams can wait meanwhile: they are stamped."""
        until = time.monotonic_ns() + LEAD_NS
        due = self._due()
        while due is not None and due <= until:
            while (now := time.monotonic_ns()) < due:
                pass
            self._pass_on()
            until, due = min(until, now + SOON_NS), self._due()

    def _take(self, direction: int, data: bytes, sender: Address, now: int) -> None:
        if not data:
            self.foreign += 1
            return
        if data[0] in SEALED:
            self._carry(direction, data, sender, now)
            return
        kind, seq = peek(data)
        message = kind is _FORTH or kind is _BACK  # whose it is, the ends look at
        if not message and kind in (Kind.HELLO, Kind.WELCOME):
            self._introduce(direction, data, sender, now)
        wire = self.wires[direction]
        if message and direction == 0 and wire.peer is None:
            wire.peer = sender  # of a session that began before this channel was started anew
        if kind is None or sender != wire.peer or (message and seq >= self._ticks):
            self.foreign += 1
            return
        if message:
            if direction == 0:  # a slave goes on sending for a while to a master that is no more
                self._busy_ns = now
            if self._origin is None:
                self._origin = now - seq * self._dt_ns
        at = 0 if self._origin is None else now - self._origin
        self.relay.receive(direction, seq if message else None, data, at)

    def _carry(self, direction: int, data: bytes, sender: Address, now: int) -> None:
        """Pass on what only the ends can read. Its number is that of its coming, and the link is for all of it."""
        from teleop.secure.record import records

        wire, quiet = self.wires[direction], now - self._busy_ns > QUIET_NS
        if direction == 0 and (wire.peer is None or quiet) and any(one.is_hello for one in records(data) or []):
            wire.peer = sender
            self._anew()
            self._origin, self._carried = now, [0, 0]
        if sender != wire.peer or self._origin is None:
            self.foreign += 1
            return
        if direction == 0:
            self._busy_ns = now
        self.relay.receive(direction, self._carried[direction], data, now - self._origin)
        self._carried[direction] += 1

    def _introduce(self, direction: int, data: bytes, sender: Address, now: int) -> None:
        """Learn from a HELLO or WELCOME which session this is and where its ends are."""
        packet = decode(data, 0)
        if not isinstance(packet, Packet):
            return
        running = self._origin is not None and now - self._busy_ns < QUIET_NS
        free = not running or sender == self.wires[0].peer  # its own master may ask anew at any time
        if packet.kind is Kind.HELLO and packet.session != self._session and free:
            self._compare(packet)
            self._session, self._origin, self._set_to = packet.session, None, None
            self._anew()
        if packet.session == self._session and self._origin is None and direction == (packet.kind is Kind.WELCOME):
            self.wires[direction].peer = sender

    def _anew(self) -> None:
        """Another session has the link; what was under way of the one before is lost."""
        self._past = [self.counts(direction) for direction in (0, 1)]
        self.relay = Relay(*self._water)

    def counts(self, direction: int) -> Counts:
        """What became of one direction's datagrams, of all sessions."""
        own, past = self.relay.counts(direction), self._past[direction]
        if past is None:
            return own
        both = Counts(*[a + b for a, b in zip(own, past, strict=True)])
        return both._replace(lost=both.lost + past.under_way, under_way=own.under_way,
                             most_under_way=max(own.most_under_way, past.most_under_way))

    def _compare(self, hello: Packet) -> None:
        """Say so if the master runs another scene: the link would be another one. The link itself may differ."""
        assert isinstance(hello.payload, dict)
        theirs = {key: text for key, text in hello.payload.items() if key in self._manifest}
        difference = manifest_difference(self._manifest, theirs)
        if difference is not None and self._differed < MOST_SAID:
            self._differed += 1
            told = f"channel: the master runs another scene than this channel: {difference}"
            print(told, file=sys.stderr, flush=True)

    def _due(self) -> int | None:
        """When something has to go out, on our clock."""
        soon = self.relay.next_ns()
        return None if soon is None or self._origin is None else self._origin + soon

    def _pass_on(self) -> None:
        origin = self._origin
        now = 0 if origin is None else time.monotonic_ns() - origin
        out: tuple[list[bytes], list[bytes]] = ([], [])
        for direction, data in self.relay.due(now):
            out[direction].append(data)
        for direction, datagrams in enumerate(out):
            if datagrams:
                self._bulks[1 - direction].send(datagrams)


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
        shell.run(interrupt)
    counts = {way: shell.counts(direction)._asdict() for direction, way in enumerate(("forth", "back"))}
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
