"""`python -m channel SCENE --listen HOST:PORT --peer HOST:PORT`: the link between the two ends, as a process.

The master sends to where the channel listens. The channel passes on to the slave, its peer, what the scene's link lets
through, when it lets it through; and back.
"""

from __future__ import annotations

import gc
import sys
import time
from argparse import Namespace
from collections.abc import Sequence
from functools import partial
from os import urandom
from selectors import EVENT_READ, DefaultSelector, SelectorKey
from shlex import quote
from typing import Any

from channel.link import describe
from channel.router import Router
from teleop.errors import Refused
from teleop.live.net.wire import Address, Wire, address, bind_towards, bind_udp, host_port, peer_address
from teleop.live.options import insecure_option, is_local, tell_insecure
from teleop.live.orders import OF_THE_RELAY, Orders, orders_option, refuse, tell
from teleop.live.process import output, realtime
from teleop.live.process.interrupt import Interrupt
from teleop.live.process.ticker import Timer
from teleop.scene.loading import live_knobs, load_scene
from teleop.scene.scene import Scene, both_ends
from teleop.terminal.options import Parser, guarded, knobs_from, realtime_option, scene_options

LEAD_NS = 100_000  # the relay is called so long before a datagram is due, for it takes time to wake up and come to it
SOON_NS = 30_000  # what is due so soon after another is waited for too, before anything is taken in
LOOK_S = 0.05  # between two looks at whether it is to end
OPEN, SEALED = " --insecure", " --key master.key --peer-fingerprint THE-SLAVES"  # of a master beyond this machine


class RelayShell:
    """Sockets and a timer around a `Router`: `near`, where masters come in, and `far`, towards the slave."""

    def __init__(self, scene: Scene, seed: int, near: Wire, far: Wire, *, beyond: Address | None = None,
                 insecure: bool = False) -> None:
        self.router = Router(scene, seed, near, far, port=self._port, close=self._close, secret=urandom(32),
                             beyond=beyond, insecure=insecure)
        self.orders: Orders | None = None  # where they come in, if it takes any
        self._selector = DefaultSelector()
        self._set_to: int | None = None  # what the timer is set for

    def run(self, interrupt: Interrupt) -> None:
        """Relay until Ctrl-C or SIGTERM."""
        timer = Timer()
        gc.collect()
        gc.freeze()
        with self._selector:
            for wire in (self.router.near, self.router.far):
                self._selector.register(wire.sock, EVENT_READ)
            if timer.fd >= 0:
                self._selector.register(timer.fd, EVENT_READ)
            if self.orders is not None:
                self._selector.register(self.orders.fd, EVENT_READ)
            try:
                while interrupt.name is None and not (self.orders is not None and self.orders.over):
                    self._sleep(self._selector, timer)
                    self._deliver()
                    self._take()
                    self._pass_on()  # the session's own do not wait
            finally:
                if timer.fd >= 0:
                    timer.close()
                for flow in self.router.flows:
                    self.router.flows.end(flow)

    def _sleep(self, selector: DefaultSelector, timer: Timer) -> None:
        """Until something comes, or is about to be due."""
        due, look = self._due(), LOOK_S
        if self.orders is not None and self.orders.waiting:
            look = 0.0
        if due is None:
            self._obey(selector.select(look))
            return
        left = due - LEAD_NS - time.monotonic_ns()
        if left <= 0:
            return
        if timer.fd < 0:
            self._obey(selector.select(min(look, left / 1e9)))
            return
        if due != self._set_to:
            timer.set(due - LEAD_NS)
            self._set_to = due
        ready = selector.select(look)
        if any(key.fd == timer.fd for key, _ in ready):
            timer.expirations()
        self._obey(ready)

    def _obey(self, ready: list[tuple[SelectorKey, int]]) -> None:
        """Carry out the orders that have come."""
        if self.orders is not None and (self.orders.waiting or any(key.fd == self.orders.fd for key, _ in ready)):
            self.orders.read()

    def _deliver(self) -> None:
        """Wait awake for what is about to be due, and send it. Datagrams can wait meanwhile: they are stamped."""
        until = time.monotonic_ns() + LEAD_NS
        due = self._due()
        while due is not None and due <= until:
            while (now := time.monotonic_ns()) < due:
                pass
            self._pass_on()
            until, due = min(until, now + SOON_NS), self._due()

    def _take(self) -> None:
        """Take in what has come, some of it."""
        router = self.router
        for data, sender, now in router.bulks[0].receive():
            router.from_near(data, sender, now)
        for data, sender, now in router.bulks[1].receive():
            router.from_far(None, data, sender, now)
        for flow in router.flows:
            if flow.sealed:
                for data, sender, now in flow.bulk.receive():
                    router.from_far(flow, data, sender, now)

    def _port(self, home: Address) -> Wire:
        """Another wire towards the slave."""
        wire = Wire(bind_towards(home), home)
        self._selector.register(wire.sock, EVENT_READ)
        return wire

    def _close(self, wire: Wire) -> None:
        self._selector.unregister(wire.sock)
        wire.sock.close()

    def _due(self) -> int | None:
        """The time at which the next datagram has to go out, on our clock."""
        return min((due for flow in self.router.flows if (due := flow.due()) is not None), default=None)

    def _pass_on(self) -> None:
        for flow in self.router.flows:
            now = 0 if flow.origin is None else time.monotonic_ns() - flow.origin
            out: tuple[list[bytes], list[bytes]] = ([], [])
            for direction, data in flow.relay.due(now):
                out[direction].append(data)
            if out[0]:
                flow.wire.peer = flow.slave
                flow.bulk.send(out[0])
            if out[1]:
                self.router.near.peer = flow.master
                self.router.bulks[0].send(out[1])


def main(argv: Sequence[str] | None = None) -> int:
    """Relay a scene's session until Ctrl-C or SIGTERM; returns the exit code."""
    return guarded(lambda: _run(sys.argv[1:] if argv is None else list(argv)))


def _run(argv: list[str]) -> int:
    parser = Parser(prog="python -m channel", description="The impaired link of a scene, as a relay over UDP.")
    scene_options(parser)
    parser.add_argument("--listen", metavar="HOST:PORT", required=True, help="where the master sends to")
    parser.add_argument("--peer", metavar="HOST:PORT", required=True, help="where the slave listens")
    insecure_option(parser)
    realtime_option(parser)
    orders_option(parser)
    parser.add_argument("--json", action="store_true", help="write events as lines of JSON for a machine")
    args = parser.parse_args(argv)
    scene = both_ends(load_scene(args.scene, **live_knobs(args.scene, knobs_from(args))))
    peer = _with_host(peer_address(args.peer), "127.0.0.1")  # answers come from there
    listen = address(args.listen, "--listen")
    with (output.live(), bind_udp(listen, "--listen") as near, bind_towards(peer) as far, Interrupt() as interrupt,
          realtime.scheduling_of(args, interrupt, realtime.RELAY_PRIORITY) as scheduling):
        beyond = next((at for at in (listen, peer) if not is_local(at)), None)
        shell = RelayShell(scene, args.seed, Wire(near, None), Wire(far, peer), beyond=beyond, insecure=args.insecure)
        if args.orders:
            shell.orders = Orders(OF_THE_RELAY, partial(_turn, shell, args))
        if beyond is not None and args.insecure:
            tell_insecure(f"the link to {host_port(beyond)} is")
        at = near.getsockname()[:2]
        if args.json:
            tell("listening", address=host_port(at), port=at[1], realtime=scheduling.report)
        else:
            link: Any = scene.link  # a scene asks less of its link than a text does
            named = "no link" if link is None else describe(link)
            print(f"channel: {named}; {host_port(at)} <-> {host_port(peer)}; start the master with: "
                  f"python -m master {_scene_arguments(args)} --peer {host_port(_with_host(at, 'THIS-HOST'))}"
                  f"{'' if beyond is None else OPEN if args.insecure else SEALED}", flush=True)
            if scheduling.report is not None:
                print(f"channel: {realtime.sentence(scheduling.report)}", flush=True)
        shell.run(interrupt)
    router = shell.router
    counts = {way: router.counts(direction)._asdict() for direction, way in enumerate(("fwd", "bwd"))}
    if args.json:
        tell("done", summary={"counts": counts, "foreign": router.foreign, "unsealed": router.unsealed})
    else:
        for way, count in counts.items():
            print(f"channel: {way}: " + ", ".join(f"{n} {name.replace('_', ' ')}" for name, n in count.items()))
    return 0


def _turn(shell: RelayShell, args: Namespace, order: dict[str, Any]) -> None:
    """Go on with the link of the scene as an order has its knobs."""
    try:
        shell.router.turn(both_ends(load_scene(args.scene, **live_knobs(args.scene, order["knobs"]))))
    except Refused as refused:
        refuse(str(refused))
    else:
        tell("turned")


def _with_host(at: Address, here: str) -> Address:
    """The address, its host named where it is "any of this machine's"."""
    return (here, at[1]) if at[0] == "0.0.0.0" else at


def _scene_arguments(args: Namespace) -> str:
    """The scene as the master has to be given it. The link too: the two ends compare theirs, though none draws."""
    words = [quote(args.scene), *(f"--set {quote(each)}" for each in args.set)]
    return " ".join([*words, f"--link {quote(args.link)}"] if args.link else words)


if __name__ == "__main__":
    raise SystemExit(main())
