"""How a live end leaves: its device without force, its record closed, its peer told the truth.

Each of these steps is taken whatever the ones before it raise. Zero force is tried again for `RETRY_NS` by a device
that does not take it; then the status is `UNRELEASED`, and the sentence says that the force may still be on.
"""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from teleop.live.shell import Shell

RETRY_NS = 1_000_000_000  # zero force is tried for so long
PAUSE = 0.005  # s between two tries
UNRELEASED = "unreleased"  # the status of a run whose device did not take zero force
MAY_BE_ON = "THE FORCE MAY STILL BE ON, switch the device off"


async def leave(shell: Shell) -> None:
    """Take these steps. What one of them raises is a fault of the run, and keeps no other from being taken."""
    await _zero(shell)
    shell.guarded(shell.note)
    shell.guarded(shell.recorder.close)
    for _ in range(3):  # a farewell may be lost too
        shell.guarded(lambda: shell.send(shell.bye()))
        await asyncio.sleep(0.002)
    shell.dropped = shell.wire.dropped
    shell.guarded(shell.wire.end)


async def _zero(shell: Shell) -> None:
    stand, until = shell.stand, time.monotonic_ns() + RETRY_NS
    stand.closed = True
    while not stand.let_go() and stand.forced:
        if time.monotonic_ns() > until:
            shell.status = UNRELEASED
            shell.sentence += (f"; its device did not take zero force in {RETRY_NS / 1e9:g} s ({stand.trouble}): "
                               f"{MAY_BE_ON}")
            break
        await asyncio.sleep(PAUSE)
    shell.free = True
