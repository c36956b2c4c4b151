"""How a live end leaves: its device without force, its record closed, its peer told how the run ended.

The force goes as in the safe state: along the watchdog's ramp and within the slew limit, tick by tick, so that nothing
jumps in a person's hand. The law has no part in it: the force that was held falls in amount until it is zero. The
device is read meanwhile, for the velocity cap; after a run that diverged it is not, since its readings are not
believed. Without readings the way takes `BLIND_NS` at most, else as long as the guard says; what is left then goes at
once. So does all of it after a second signal, and where something was raised: what is broken is asked for nothing more
than zero.

Each of the steps is taken whatever the ones before it raise. Zero force is tried again for `RETRY_NS` by a device
that does not take it; then the status is `UNRELEASED`, and the sentence says that the force may still be on.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator

from teleop.errors import enumerated
from teleop.live.process.ticker import Alarm
from teleop.live.shell import Shell
from teleop.protocol.endpoint import Axes, Endpoint
from teleop.protocol.held_force import BLIND_NS
from teleop.scene.axes import FORCE_UNIT

RETRY_NS = 1_000_000_000  # zero force is tried for so long
PAUSE = 0.005  # s between two tries


async def let_go(shell: Shell) -> None:
    """Take the force of `shell` to zero, one step a tick; nothing of it is recorded but an event."""
    device, endpoint = shell.device, shell.endpoint
    if shell.outcome.fault is not None or not device.forced:
        return
    if shell.outcome.status != "ok" and device.trouble is None:
        # Now, so that the other end does not go on with what it heard last. How a device that fails has ended is told
        # when it is known.
        shell.bye()
    most, began, k = _told(endpoint, endpoint.held.force), time.monotonic_ns(), shell.counts.last
    seen = began  # when it was last read
    ring = asyncio.Event()
    alarm = Alarm(asyncio.get_running_loop(), ring.set)
    alarm.set(began + endpoint.own.dt_ns, endpoint.own.dt_ns)
    try:
        now, passed, reading = began, 1, None  # that of this tick has been used
        while True:
            force = endpoint.held.over(None if reading is None else reading.v, passed)
            spent = now - seen > BLIND_NS or endpoint.guard.overdue
            if shell.interrupt.again or spent or not any(force):
                break
            if not device.hold(force):
                break
            await ring.wait()
            ring.clear()
            before, now = now, time.monotonic_ns()
            passed = max(1, round((now - before) / endpoint.own.dt_ns))
            k += passed * endpoint.every
            reading = None if shell.outcome.status == "diverged" else device.read(k, now)
            seen = seen if reading is None else now
    finally:
        alarm.close()
    if not device.let_go():
        endpoint.guard.tell(shell.counts.ran, "zero", f"the device does not take zero force: {device.trouble}")
        return
    jump = f", the last {_told(endpoint, force)} at once" if any(force) else ""
    sentence = f"{most} taken to zero in {(time.monotonic_ns() - began) / 1e9:.3f} s{jump}"
    endpoint.guard.tell(shell.counts.ran, "zero", sentence)


def _told(endpoint: Endpoint, force: Axes) -> str:
    """The largest size of a force of each unit: "1.61 N", "1.61 N and 0.3 N m"."""
    most: dict[str, float] = {}
    for one, unit in zip(force, endpoint.scene.axis_units, strict=True):
        most[FORCE_UNIT[unit]] = max(most.get(FORCE_UNIT[unit], 0.0), abs(one))
    return enumerated(f"{size:.3g} {unit}" for unit, size in most.items())


async def leave(shell: Shell) -> None:
    """Take these steps. What one of them raises is a fault of the run, and keeps no other from being taken."""
    for pause in _steps(shell):
        await asyncio.sleep(pause)


def leave_without_loop(shell: Shell) -> None:
    """Take them where they were not all taken, for the loop has failed: nothing here needs it, or a descriptor."""
    for pause in _steps(shell):
        time.sleep(pause)


def _steps(shell: Shell) -> Iterator[float]:
    """Each step of leaving that is not over at once gives the seconds to wait before it goes on."""
    if shell.left:
        return
    yield from _zero(shell)
    shell.guarded(lambda: _write_events(shell))
    shell.guarded(shell.recorder.close)
    for _ in range(3):  # a farewell may be lost too
        shell.guarded(shell.bye)
        yield 0.002
    shell.counts.dropped = shell.wire.dropped
    shell.guarded(shell.wire.end)
    shell.left = True


def _zero(shell: Shell) -> Iterator[float]:
    device, until = shell.device, time.monotonic_ns() + RETRY_NS
    device.closed = True
    while not device.let_go() and device.forced:
        if time.monotonic_ns() > until:
            shell.outcome.unreleased(f"its device did not take zero force in {RETRY_NS / 1e9:g} s ({device.trouble})")
            break
        yield PAUSE
    shell.free = True


def _write_events(shell: Shell) -> None:
    shell.take_events()
