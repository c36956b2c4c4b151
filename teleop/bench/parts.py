"""`python -m teleop.bench.parts tick N SPIN_NS | echo | ping PORT N`: the live parts alone, as the live loops use them.

The same words make `c/timing.c` do the same in C; what is printed is the same too: median and 99 %, us.
"""

from __future__ import annotations

import asyncio
import sys
import time
from collections.abc import Sequence

from teleop.live.net.wire import DRAIN, Wire, bind_udp
from teleop.live.process.ticker import Alarm

TICK_NS = 1_000_000
PAYLOAD = bytes(100)


async def tick(count: int, spin_ns: int) -> list[int]:
    """The lateness of an alarm at each of `count` ticks at 1 kHz, ns; for one that was missed, when it came next."""
    late: list[int] = []
    over = asyncio.Event()
    start = time.monotonic_ns() + 20 * TICK_NS

    def wake() -> None:
        woken = time.monotonic_ns() - start
        late.extend(woken - k * TICK_NS for k in range(len(late), woken // TICK_NS + 1))
        if len(late) >= count:
            over.set()

    alarm = Alarm(asyncio.get_running_loop(), wake, spin_ns)
    alarm.set(start, TICK_NS)
    await over.wait()
    alarm.close()
    return late[:count]


async def echo(wire: Wire, over: asyncio.Event) -> None:
    """Send back what comes to where it came from, until it is over."""

    def drain() -> None:
        for _ in range(DRAIN):
            got = wire.receive()
            if got is None or got[0] is None:
                break
            wire.peer = got[1]
            wire.send(got[0])

    loop = asyncio.get_running_loop()
    loop.add_reader(wire.sock, drain)
    await over.wait()
    loop.remove_reader(wire.sock)


async def ping(wire: Wire, count: int) -> list[int]:
    """The time that `count` datagrams take to the wire's peer and back, ns, one after the other."""
    trips: list[int] = []
    over = asyncio.Event()
    began = 0

    def send() -> None:
        nonlocal began
        began = time.monotonic_ns()
        wire.send(PAYLOAD)

    def drain() -> None:
        for _ in range(DRAIN):
            if wire.receive() is None:
                break
            trips.append(time.monotonic_ns() - began)
            if len(trips) < count:
                send()
            else:
                over.set()

    loop = asyncio.get_running_loop()
    loop.add_reader(wire.sock, drain)
    send()
    await over.wait()
    loop.remove_reader(wire.sock)
    return trips[:count]


async def _main(what: str, *numbers: int) -> None:
    if what == "tick":
        times = await tick(*numbers)
    else:
        with bind_udp(("127.0.0.1", 0), "--listen") as sock:
            if what == "echo":
                print(sock.getsockname()[1], flush=True)
                await echo(Wire(sock, None), asyncio.Event())
                return
            port, count = numbers
            wire = Wire(sock, ("127.0.0.1", port))
            wire.keep_to_peer()
            times = await ping(wire, count)
    times.sort()
    print(f"{times[len(times) // 2] / 1e3:.2f} {times[int(len(times) * 0.99)] / 1e3:.2f}")


def main(words: Sequence[str]) -> int:
    """Run one part; returns the exit code."""
    asyncio.run(_main(words[0], *map(int, words[1:])))
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
