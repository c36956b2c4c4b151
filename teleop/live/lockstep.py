"""The live loop of an end that goes by packets: both ends step together, and the run equals the one in virtual time."""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress
from typing import TYPE_CHECKING

from teleop.live.leaving import let_go
from teleop.protocol.session import FINISHED

if TYPE_CHECKING:
    from teleop.live.shell import Shell
    from teleop.protocol.endpoint import Stepped

AGAIN = 0.02  # s: the last packets are sent again after this wait
SILENT = 250  # such waits in which nothing of the session came, and the other is given up
HEED = 15  # such waits, and a farewell is heeded: last packets may come behind it
LINGER = 50  # such pauses at most for the farewell of the other


async def by_packets(shell: Shell, inbox: Stepped) -> None:
    """Tick when the peer's packet of the tick before has come; what is lost on the way is sent again."""
    shell.arrived = asyncio.Event()
    for k in range(shell.scene.ticks):
        if not await _until_there(shell, inbox, k - 1):
            break
        shell.last = k
        shell.tick(k, now := time.monotonic_ns(), 0)
        shell.announce(now)
    else:
        shell.finish()
    await let_go(shell)  # before it waits for anything
    for _ in range(LINGER):  # the peer may still wait for the last packets
        if shell.endpoint.session.farewell is not None or shell.fault is not None:
            return
        shell.send([*shell.recent, *shell.bye()])
        await asyncio.sleep(AGAIN)


async def _until_there(shell: Shell, inbox: Stepped, packet: int) -> bool:
    """Wait for the peer's packet; False if the run is over, or nothing has come for a time."""
    assert shell.arrived is not None
    endpoint, session, quiet = shell.endpoint, shell.endpoint.session, 0
    heard, again = endpoint.received, time.monotonic() + AGAIN
    while not shell.over.is_set():
        if inbox.has(packet):
            return True
        left = session.farewell not in (None, FINISHED)
        if quiet > (HEED if left else SILENT):
            shell.stop(f"the other end left: {session.farewell or 'it fell silent'}")
        if shell.interrupt.name is not None:
            shell.stop(f"it was asked to stop ({shell.interrupt.name})")
        shell.arrived.clear()
        with suppress(TimeoutError):
            await asyncio.wait_for(shell.arrived.wait(), max(0.0, again - time.monotonic()))
        if time.monotonic() < again:
            continue  # something came, perhaps a stranger's: that is no reason to wait longer
        quiet = quiet + 1 if left or endpoint.received == heard else 0
        heard, again = endpoint.received, time.monotonic() + AGAIN
        shell.wire.due(time.monotonic_ns())
        shell.send([*shell.recent, *session.due(time.monotonic_ns())])
    return False
