"""The live loop of the relay: sockets and a timer around a `Router`.

The master sends to where the channel listens; the channel passes on to the slave, its peer, what the scene's link lets
through, when it lets it through; and back.
"""

from __future__ import annotations

import gc
import time
from os import urandom
from selectors import EVENT_READ, DefaultSelector, SelectorKey

from channel.router import Router
from teleop.live.net.wire import Address, Wire, towards
from teleop.live.orders import Orders
from teleop.live.process.interrupt import Interrupt
from teleop.live.process.ticker import Timer
from teleop.scene.scene import Scene

LEAD_NS = 100_000  # the relay is called so long before a datagram is due, for it takes time to wake up and come to it
SOON_NS = 30_000  # what is due so soon after another is waited for too, before anything is taken in
LOOK_S = 0.05  # between two looks at whether it is to end


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
            timer.rang()
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
        for data, sender, came in router.bulks[0].receive():
            router.from_near(data, sender, came)
        for data, sender, came in router.bulks[1].receive():
            router.from_far(None, data, sender, came)
        for flow in router.flows:
            if flow.own:
                for data, sender, came in flow.bulk.receive():
                    router.from_far(flow, data, sender, came)

    def _port(self, home: Address) -> Wire:
        """Another wire towards the slave."""
        wire = Wire(towards(home), home)
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
