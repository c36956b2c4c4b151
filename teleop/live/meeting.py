"""What a live end does before its run: the first reading of its device, and the first exchange with the other end."""

from __future__ import annotations

import asyncio
import time

from teleop.errors import Refused
from teleop.live import fault
from teleop.live.net.wire import shown
from teleop.live.shell import Shell
from teleop.protocol.packet import VERSION, Rejection
from teleop.protocol.session import FINISHED

HINT_NS = 2_000_000_000  # of waiting for a peer, and the terminal is told what may be wrong
EARLY_NS = 10_000_000  # so long before tick 0 the exchange is over at the latest


async def first_reading(shell: Shell) -> bool:
    """Read the device, before the other end is asked for anything, and begin the record; False if there is no run.

    A device that cannot be read yet is asked again, for as long as one that fails during a run.
    """
    try:
        while shell.device.read(0, now := time.monotonic_ns()) is None:
            if shell.device.dead(now):
                shell.outcome.end("refused", f"the device cannot be read: {shell.device.trouble}")
            elif shell.interrupt.name is not None:
                shell.stop(f"it was asked to stop ({shell.interrupt.name})")
            if shell.outcome.over.is_set():
                return False
            await asyncio.sleep(0.005)
        shell.endpoint.senses(bool(shell.device.sensor), shell.device.switches)
    except Refused as refused:
        shell.outcome.end("refused", str(refused))
        return False
    shell.recorder.begin(shell.device.force_source)
    shell.retake_signals()
    return True


async def meet(shell: Shell) -> bool:
    """The first exchange; False if the run was over before it began."""
    session, stepped = shell.endpoint.session, shell.endpoint.stepped
    began, hinted = time.monotonic_ns(), ""
    while not shell.outcome.over.is_set():
        now = time.monotonic_ns()
        if session.failure is not None:
            shell.outcome.end("refused", session.failure)
        elif session.farewell not in (None, FINISHED):
            shell.outcome.end("refused", f"the other end left before the run began: {session.farewell}")
        elif shell.interrupt.name is not None:
            shell.stop(f"it was asked to stop ({shell.interrupt.name})")
        elif session.start_ns is not None and not session.meeting:
            # Until then what was lost of the exchange can be said again.
            if stepped or now > session.start_ns - EARLY_NS:
                return True
        elif shell.peer_timeout is not None and now - began > shell.peer_timeout * 1e9:
            shell.outcome.end("refused", _why_no_peer(shell, f"in {shell.peer_timeout:g} s"))
        elif now - began > HINT_NS and _has_hint(shell):
            if (hint := _why_no_peer(shell, "yet")) != hinted:
                shell.hint(hint)
            hinted = hint
        shell.say_again(now)
        await asyncio.sleep(0.005)
    return False


def _has_hint(shell: Shell) -> bool:
    """True if there is more to tell than that no peer has come."""
    secure_link = shell.wire.secure_link
    if secure_link is not None and secure_link.trouble is not None:
        return True
    return shell.connection.asked is not None or _unknown_came(shell)


def _why_no_peer(shell: Shell, since: str) -> str:
    """Why there is no peer, as far as it is known."""
    peer, secure_link = shell.connection.peer, shell.wire.secure_link
    if secure_link is not None and secure_link.trouble is not None:
        why = f"no peer was let in {since}: {secure_link.trouble}"
    elif peer is None:
        why = f"no master came {since}; start one that has this address as its --peer, or --wait longer"
    else:
        why = f"no answer from {shown(peer)} {since}; start the other end first, and check address and port"
    if secure_link is None and shell.endpoint.rejected[Rejection.VERSION.value]:
        return f"{why}; what came is of another wire version than {VERSION}: install the same release at both ends"
    keys = "; what came was from no such end: has one of the two keys, and the other none?"
    return why + keys * _unknown_came(shell)


def _unknown_came(shell: Shell) -> bool:
    """True if anything has come that no such end sends."""
    secure_link = shell.wire.secure_link
    return sum(shell.endpoint.rejected.values() if secure_link is None else secure_link.dropped.values()) > 0


fault.named(meet, "the first exchange")
