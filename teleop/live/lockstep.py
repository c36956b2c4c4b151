"""The live loop of an end that goes by packets: both ends step together, and the run equals the one in virtual time."""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress

from teleop.live.leaving import let_go
from teleop.live.shell import Shell
from teleop.protocol.endpoint import Stepped
from teleop.protocol.session import FINISHED

AGAIN = 0.02  # s: the last packets are sent again after this wait
SILENT = 250  # such waits in which nothing of the session came, and the other is given up
HEED = 15  # such waits, and a farewell is heeded: last packets may come behind it
LINGER = 50  # such pauses at most for the farewell of the other


async def by_packets(shell: Shell, inbox: Stepped) -> None:
    """Tick when the peer's packet of the tick before has come; what is lost on the way is sent again."""
    driver = PacketDriver(shell, inbox)
    asyncio.get_running_loop().add_reader(shell.wire.sock, shell.guarded, driver.drain)
    for k in range(shell.scene.ticks):
        if not await driver.has_come(k - 1):
            break
        shell.counts.last = k
        shell.tick(k, now := time.monotonic_ns(), 0)
        shell.live_line.announce(now)
    else:
        shell.finish()
    await let_go(shell)  # before it waits for anything
    for _ in range(LINGER):  # the peer may still wait for the last packets
        if shell.endpoint.session.farewell is not None or shell.outcome.fault is not None:
            return
        driver.send_again()
        shell.bye()
        await asyncio.sleep(AGAIN)


class PacketDriver:
    """Reads the socket when something has come, and knows for how long nothing of the session has."""

    def __init__(self, shell: Shell, inbox: Stepped) -> None:
        self.shell, self.inbox = shell, inbox
        self._arrived = asyncio.Event()

    def drain(self) -> None:
        """Read the socket."""
        self.shell.drain()
        self._arrived.set()

    def send_again(self) -> None:
        """Send the last packets again."""
        for data in self.shell.recent:
            self.shell.wire.send(data)

    async def has_come(self, packet: int) -> bool:
        """Wait for the peer's packet; False if the run is over, or nothing has come for a time."""
        shell, session, quiet = self.shell, self.shell.endpoint.session, 0
        heard, again = shell.endpoint.received, time.monotonic() + AGAIN
        while not shell.outcome.over.is_set():
            if self.inbox.has(packet):
                return True
            left = session.farewell not in (None, FINISHED)
            if quiet > (HEED if left else SILENT):
                shell.stop(f"the other end left: {session.farewell or 'it fell silent'}")
            if shell.interrupt.name is not None:
                shell.stop(f"it was asked to stop ({shell.interrupt.name})")
            self._arrived.clear()
            with suppress(TimeoutError):
                await asyncio.wait_for(self._arrived.wait(), max(0.0, again - time.monotonic()))
            if time.monotonic() < again:
                continue  # something came, perhaps from an unknown host: that is no reason to wait longer
            quiet = quiet + 1 if left or shell.endpoint.received == heard else 0
            heard, again = shell.endpoint.received, time.monotonic() + AGAIN
            self.send_again()
            shell.say_again(time.monotonic_ns())
        return False
