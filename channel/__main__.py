"""`python -m channel SCENE --listen HOST:PORT --peer HOST:PORT`: the water between, as a process.

The master sends to where the channel listens; the channel passes on to the slave, its peer, what the
scene's link (or the one of --link) lets through, when it lets it through; and back.
"""

from __future__ import annotations

import asyncio
import json
import signal
import sys
import time
from collections.abc import Sequence
from typing import Any

from channel.relay import Relay
from teleop.live.address import address, bound, shown
from teleop.live.ticker import Alarm
from teleop.live.wire import DRAIN, Wire
from teleop.options import Parser, guarded, knobs_from, scene_options
from teleop.packet import Kind, peek
from teleop.scene import Scene, load_scene


class RelayShell:
    """Two sockets and a timer around a `Relay`."""

    def __init__(self, scene: Scene, seed: int, near: Wire, far: Wire) -> None:
        link: Any = scene.link  # a scene asks less of its link than a relay does
        self.relay = Relay(link, seed, scene.wire_size)
        self.wires = (near, far)  # where direction 0 and direction 1 come in
        self.foreign = 0  # datagrams that are no packets of this scene
        self._dt_ns, self._ticks = scene.dt_ns, scene.ticks
        self._origin: int | None = None  # our clock at tick 0
        self._alarm: Alarm | None = None
        self._set_to: int | None = None
        self._over = asyncio.Event()

    async def run(self) -> None:
        """Relay until Ctrl-C or SIGTERM."""
        loop = asyncio.get_running_loop()
        for name in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(name, self._over.set)
        self._alarm = Alarm(loop, self._deliver)
        for direction, wire in enumerate(self.wires):
            loop.add_reader(wire.sock, self._drain, direction)
        await self._over.wait()
        self._deliver()
        for wire in self.wires:
            loop.remove_reader(wire.sock)
        self._alarm.close()

    def _drain(self, direction: int) -> None:
        wire = self.wires[direction]
        for _ in range(DRAIN):
            got = wire.receive()
            if got is None:
                break
            data, sender = got
            now = time.monotonic_ns()
            kind, seq = peek(data)
            if kind is None or (kind is Kind.DATA and seq >= self._ticks):
                self.foreign += 1
                continue
            if kind is Kind.HELLO and direction == 0:
                wire.peer = sender  # where the master is
            data_packet = kind is Kind.DATA
            if data_packet and self._origin is None:
                self._origin = now - seq * self._dt_ns
            at = 0 if self._origin is None else now - self._origin
            self.relay.receive(direction, seq if data_packet else None, data, at)
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
    parser.add_argument("--json", action="store_true", help="write events as lines of JSON for a machine")
    args = parser.parse_args(argv)
    scene = load_scene(args.scene, **knobs_from(args))
    peer = address(args.peer, "--peer")
    near = Wire(bound(address(args.listen, "--listen"), "--listen"), None)
    far = Wire(bound(("127.0.0.1" if peer[0].startswith("127.") else "0.0.0.0", 0), "--peer"), peer)
    shell = RelayShell(scene, args.seed, near, far)
    at = near.sock.getsockname()[:2]
    if args.json:
        _event("listening", address=shown(at), port=at[1])
    else:
        print(f"channel: {scene.link or 'no link'}; {shown(at)} <-> {shown(peer)}; start the master with: "
              f"python -m master {args.scene} --peer {shown(at)}", flush=True)
    asyncio.run(shell.run())
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
