"""Slave, channel and master as the page starts them, gives them orders and has them leave."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from teleop.live.child import Child, arguments_of

FLUSH = 16  # rows of a record that are handed over at once
LEAVE = 5.0  # s for a process to leave in order, before it is killed


class Start(NamedTuple):
    """How the three are started. `ticking`: options of the ends alone; `program`: see `Child.start`."""

    scene: str
    seed: int
    realtime: bool = True
    ticking: Sequence[str] = ()
    program: Sequence[str] = ()


class Children:
    """`tell(name, event)` is called with each event, `ended(name, sentence)` when one has ended by itself."""

    def __init__(self, start: Start, tell: Callable[[str, dict[str, Any]], None],
                 ended: Callable[[str, str], None]) -> None:
        self._start, self._tell, self._ended = start, tell, ended
        self._alive: dict[str, Child] = {}
        self._watches: set[asyncio.Task[None]] = set()
        self._ports: dict[str, int] = {}

    @property
    def complete(self) -> bool:
        """Do all three run?"""
        return len(self._alive) == 3

    async def start(self, knobs: Mapping[str, str], folders: Mapping[str, Path]) -> None:
        """Start all three, the ends m and s to write into `folders`. Raises `Refused`, and stops what has started."""
        try:
            own = ["--flush", str(FLUSH), *self._start.ticking]
            slave = await self._one("slave", knobs, "--listen", "127.0.0.1:0", "--out", str(folders["s"]), *own)
            self._ports["slave"] = await slave.port()
            await self.start_channel(knobs, port=0)
            to = f"127.0.0.1:{self._ports['channel']}"
            await self._one("master", knobs, "--peer", to, "--out", str(folders["m"]), *own)
        except BaseException:
            await self.stop()
            raise

    async def start_channel(self, knobs: Mapping[str, str], port: int | None = None) -> None:
        """Start the channel between the two, left out at the same port as before. Raises `Refused`."""
        at = self._ports["channel"] if port is None else port
        channel = await self._one("channel", knobs, "--listen", f"127.0.0.1:{at}",
                                  "--peer", f"127.0.0.1:{self._ports['slave']}")
        self._ports["channel"] = await channel.port()

    def order(self, order: Mapping[str, Any], *names: str) -> None:
        """Give those of the three that run an order."""
        for name in names:
            if name in self._alive:
                self._alive[name].order(order)

    def interrupt(self, name: str) -> None:
        """Pass a signal on to the two ends."""
        for end in ("master", "slave"):
            if end in self._alive:
                self._alive[end].interrupt(name)

    async def stop(self) -> None:
        """Have all leave in order: the two ends, then the channel between them. What does not is killed."""
        alive, self._alive = self._alive, {}
        for several in (("master", "slave"), ("channel",)):
            leaving = [alive[name] for name in several if name in alive]
            for child in leaving:
                child.interrupt()
            waits = [asyncio.create_task(child.process.wait()) for child in leaving]
            if waits:
                await asyncio.wait(waits, timeout=LEAVE)
            for child in leaving:
                if child.process.returncode is None:
                    with suppress(ProcessLookupError):
                        child.process.kill()
        if self._watches:
            await asyncio.wait(self._watches, timeout=LEAVE)

    async def _one(self, name: str, knobs: Mapping[str, str], *more: str) -> Child:
        options = arguments_of(self._start.scene, self._start.seed, knobs, realtime=self._start.realtime)
        child = await Child.start(name, [*options, *more, "--orders"], orders=True, program=self._start.program)
        self._alive[name] = child
        watch = asyncio.create_task(self._watch(child))
        self._watches.add(watch)
        watch.add_done_callback(self._watches.discard)
        return child

    async def _watch(self, child: Child) -> None:
        def tell(event: dict[str, Any]) -> None:
            if self._alive.get(child.name) is child:
                self._tell(child.name, event)

        code, errors = await child.watch(tell)
        if self._alive.get(child.name) is not child:
            return  # it was asked to
        del self._alive[child.name]
        if child.listening.exception() is None:  # or else who waits for its port says so
            said = (child.done or {}).get("sentence")
            self._ended(child.name, str(said or child.failed(code, errors)))
