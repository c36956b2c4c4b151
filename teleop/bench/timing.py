"""Live timing beside C in the same run: lateness of ticks, round trips over loopback, the relay's error of the delay.

Each of our parts and the same in C (`c/timing.c`) are measured at once or in turns; a figure is the median over
the rounds, of ratios within a round. The relay is the process `python -m channel`; both relays are loaded by the same
C program, which takes the kernel's stamps.

`python -m teleop.bench.timing tick N SPIN_NS | echo | ping PORT N` runs one live part alone, as the live loops use it.
The same words make `c/timing.c` do the same in C; both print median and 99 %, us.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from teleop.live.net.wire import DRAIN, Wire, bind_udp
from teleop.live.process.realtime import SPIN_NS
from teleop.live.process.ticker import Alarm
from teleop.protocol.manifest import manifest_of
from teleop.protocol.packet import Kind, Packet, encode
from teleop.scene.library import ROOT
from teleop.scene.loading import load_scene
from teleop.scene.scene import both_ends

SOURCES = Path(__file__).with_name("c")


def compiled(name: str, folder: Path) -> str | None:
    """The program of `c/<name>.c`, made in `folder`; None where it cannot be made: `reason` says why."""
    compiler = _compiler()
    if compiler is None or not SOURCES.is_dir():
        return None
    program = str(folder / name)
    subprocess.run([compiler, "-O2", "-o", program, str(SOURCES / f"{name}.c")], check=True)
    return program


def reason() -> str:
    """The reason for which `compiled` makes no program here."""
    return "no C compiler here" if _compiler() is None else "its C program is in the repository alone"


def _compiler() -> str | None:
    return os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc")


Row = tuple[str, str, str]
TICKS, TRIPS = 4000, 5000
DELAY = 0.02  # s
RATE, COUNT = 1000, 3000  # datagrams a second each way, and in all, for the error of the delay
FULL_RATE, FULL_COUNT = 20_000, 40_000  # the same for loss
SCENE = "hard_wall"
OURS = (sys.executable, "-m", "teleop.bench.timing")


class Late(NamedTuple):
    """The median and the 99th percentile of many times, us."""

    median: float
    most: float


class CarriedLoad(NamedTuple):
    """The delay and losses that a relay added to its load."""

    lost: int
    error: Late


def timing(rounds: int) -> list[Row]:
    """Rows of (what, measured, asked), each a median over `rounds`."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        c = compiled("timing", folder)
        if c is None:
            return [("live timing beside C", reason(), "")]
        datagrams(folder, max(COUNT, FULL_COUNT))
        return ticks(c, rounds) + round_trips(c, rounds) + relays(c, folder, rounds)


def ticks(c: str, rounds: int, count: int = TICKS) -> list[Row]:
    """An `Alarm` and a loop on a timerfd in C, at once; then an alarm that spins."""
    theirs, ours, spun = [], [], []
    for _ in range(rounds):
        running = [_started(*OURS, "tick", count, 0), _started(c, "tick", count)]
        alarm, loop = [_late(process.communicate()[0]) for process in running]
        ours.append(alarm)
        theirs.append(loop)
        spun.append(_late(_started(*OURS, "tick", count, SPIN_NS).communicate()[0]))
    return [
        _summary("C loop on a timerfd: tick late by", theirs),
        *_beside("Alarm: tick late by", ours, theirs),
        (f"Alarm, awake {SPIN_NS // 1000} us before (--spin): late by, median",
         f"{median(one.median for one in spun):.1f} us", "asked: at most 5"),
        ("  99 %", f"{median(one.most for one in spun):.0f} us", ""),
    ]


def round_trips(c: str, rounds: int, count: int = TRIPS) -> list[Row]:
    """Time 100 bytes to and fro over loopback, each end on its own core, as on two machines; then both on one core."""
    apart: list[list[Late]] = []
    together: list[list[Late]] = []
    for cores, trips in ((cores_apart(), apart), (cores_apart()[:1] * 2, together)):
        with _port(c, "echo", core=cores[1]) as c_port, _port(*OURS, "echo", core=cores[1]) as our_port:
            for _ in range(rounds):
                trips.append([_late(_started(*each, count, core=cores[0]).communicate()[0]) for each in (
                    (c, "ping", c_port), (*OURS, "ping", our_port), (c, "ping", our_port))])
    in_c, both, alone = zip(*apart, strict=True)
    one_core = zip(*together, strict=True)
    most = "asked: at most 2.2"
    return [
        _summary("round trip over loopback, C", in_c),
        _beside("round trip, a Wire at both ends", both, in_c, most)[0],
        _beside("round trip, C and an echo through a Wire", alone, in_c, most)[0],
        _summary("round trip, C, both ends on one core", next(one_core)),
        _beside("round trip, Wires, both ends on one core", next(one_core), [trip[0] for trip in together], most)[0],
    ]


def cores_apart() -> list[int | None]:
    """Two cores, None twice if there is no choice."""
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    return [cores[0], cores[-1]] if len(cores) > 1 else [None, None]


def relays(c: str, folder: Path, rounds: int) -> list[Row]:
    """`python -m channel` and a relay in C, in turns."""
    pairs, full = [], []
    for _ in range(rounds):
        pairs.append((carried(c, folder, RATE, COUNT, ours=True), carried(c, folder, RATE, COUNT, ours=False)))
        full.append((carried(c, folder, FULL_RATE, FULL_COUNT, ours=True),
                     carried(c, folder, FULL_RATE, FULL_COUNT, ours=False)))
    ours, in_c = zip(*pairs, strict=True)
    lost = [f"{median(one.lost for one in side):.0f}" for side in zip(*full, strict=True)]
    return [
        _summary(f"C relay, {RATE} packets a second each way: error of the delay", [one.error for one in in_c]),
        *_beside("python -m channel: error of the delay", [one.error for one in ours], [one.error for one in in_c]),
        (f"  lost at {FULL_RATE} a second each way, of {2 * FULL_COUNT}", lost[0], f"{lost[1]} by C; asked: at most 0"),
    ]


def datagrams(folder: Path, count: int) -> None:
    """The packets that the two ends of a session send, in the form that the load reads: `fwd` and `bwd`."""
    scene = both_ends(load_scene(SCENE, link=f"delay({DELAY})"))
    ways = {"fwd": (Kind.HELLO, Kind.FORTH), "bwd": (Kind.START, Kind.BACK)}
    for name, (control, message) in ways.items():
        first = encode(Packet(control, 1, 0, 0, None, manifest_of(scene) if control is Kind.HELLO else 0))
        rest = (encode(Packet(message, 1, k, k * scene.dt_ns, None, (0.1,), 0.1), scene.wire_size)
                for k in range(count))
        with (folder / name).open("wb") as file:
            file.writelines(len(data).to_bytes(2, "little") + data for data in (first, *rest))


def carried(c: str, folder: Path, rate: int, count: int, *, ours: bool) -> CarriedLoad:
    """Run a relay under a load: its losses and its error of the delay."""
    delay_ns = round(DELAY * 1e9)
    load = _started(c, "load", folder / "fwd", folder / "bwd", rate, count, delay_ns, stdin=subprocess.PIPE)
    assert load.stdout is not None
    peer = load.stdout.readline().strip()
    with _channel(peer, count) if ours else _port(c, "relay", peer, delay_ns) as near:
        forth, back, *error = load.communicate(f"{near}\n")[0].split()
    return CarriedLoad(int(forth) + int(back), Late(*map(float, error)))


@contextmanager
def _channel(peer: str, count: int) -> Iterator[int]:
    """A channel that takes `count` packets each way; its port."""
    process = _started(sys.executable, "-m", "channel", SCENE, "--link", f"delay({DELAY})", "--set",
                       f"duration={max(1.0, count * 1e-3)}", "--listen", "127.0.0.1:0", "--peer", f"127.0.0.1:{peer}",
                       "--json", stderr=subprocess.DEVNULL)  # it would say that the load's scene has another duration
    assert process.stdout is not None
    with _ending(process):
        yield int(json.loads(process.stdout.readline())["port"])


@contextmanager
def _port(*command: Any, core: int | None = None) -> Iterator[int]:
    """The port that a command prints, while it runs."""
    process = _started(*command, core=core)
    assert process.stdout is not None
    with _ending(process):
        yield int(process.stdout.readline())


@contextmanager
def _ending(process: subprocess.Popen[str]) -> Iterator[None]:
    try:
        yield
    finally:
        process.terminate()
        process.communicate()


def _started(*command: Any, core: int | None = None, **streams: Any) -> subprocess.Popen[str]:
    process = subprocess.Popen(list(map(str, command)), stdout=subprocess.PIPE, text=True, cwd=ROOT, **streams)
    if core is not None:
        os.sched_setaffinity(process.pid, [core])
    return process


def _late(output: str) -> Late:
    return Late(*map(float, output.split()[:2]))


def _summary(what: str, times: Sequence[Late]) -> Row:
    return (f"{what}, median / 99 %",
            f"{median(one.median for one in times):.0f} / {median(one.most for one in times):.0f} us", "")


def _beside(what: str, ours: Sequence[Late], theirs: Sequence[Late], most: str = "asked: at most 1.5") -> list[Row]:
    """The median and the 99 % of ours, with their ratios to C."""
    rows = []
    for place, name in enumerate((f"{what}, median", "  99 %")):
        ratio = median(mine[place] / in_c[place] for mine, in_c in zip(ours, theirs, strict=True))
        rows.append((name, f"{median(mine[place] for mine in ours):.0f} us",
                     f"{ratio:.2f} times C; {most}".rstrip("; ")))
    return rows


TICK_NS = 1_000_000
PAYLOAD = bytes(100)
LOOK_S = 0.05  # for a datagram, which wakes whoever waits


def tick(count: int, spin_ns: int) -> list[int]:
    """The lateness of an alarm at each of `count` ticks at 1 kHz, ns; for one that was missed, when it came next."""
    late: list[int] = []
    start = time.monotonic_ns() + 20 * TICK_NS
    alarm = Alarm(spin_ns)
    alarm.set(start, TICK_NS)
    while len(late) < count:
        alarm.wait()
        woken = time.monotonic_ns() - start
        late.extend(woken - k * TICK_NS for k in range(len(late), woken // TICK_NS + 1))
    return late[:count]


def echo(wire: Wire, is_over: Callable[[], bool] = lambda: False) -> None:
    """Send back what comes to where it came from, until it is over."""
    while not is_over():
        wire.wait(LOOK_S)
        for _ in range(DRAIN):
            got = wire.receive()
            if got is None or got[0] is None:
                break
            wire.peer = got[1]
            wire.send(got[0])


def ping(wire: Wire, count: int) -> list[int]:
    """The time that `count` datagrams take to the wire's peer and back, ns, one after the other."""
    trips: list[int] = []
    while len(trips) < count:
        began = time.monotonic_ns()
        wire.send(PAYLOAD)
        while wire.receive() is None:
            wire.wait(LOOK_S)
        trips.append(time.monotonic_ns() - began)
    return trips


def _main(what: str, *numbers: int) -> None:
    if what == "tick":
        times = tick(*numbers)
    else:
        with bind_udp(("127.0.0.1", 0), "--listen") as sock:
            if what == "echo":
                print(sock.getsockname()[1], flush=True)
                echo(Wire(sock, None))
                return
            port, count = numbers
            wire = Wire(sock, ("127.0.0.1", port))
            wire.keep_to_peer()
            times = ping(wire, count)
    times.sort()
    print(f"{times[len(times) // 2] / 1e3:.2f} {times[int(len(times) * 0.99)] / 1e3:.2f}")


def main(words: Sequence[str]) -> int:
    """Run one part; returns the exit code."""
    _main(words[0], *map(int, words[1:]))
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
