"""Live timing beside C in the same run: lateness of ticks, round trips over loopback, the relay's error of the delay.

Each of our parts and the same in C (`c/timing.c`) are measured at once or in turns; a figure is the median over
the rounds, of ratios within a round. The relay is the process `python -m channel`; both relays are loaded by the same
C program, which takes the kernel's stamps.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from teleop.bench.compiled import compiled, reason
from teleop.live.process.realtime import SPIN_NS
from teleop.protocol.manifest import manifest_of
from teleop.scene.library import ROOT

Row = tuple[str, str, str]
TICKS, TRIPS = 4000, 5000
DELAY = 0.02  # s
RATE, COUNT = 1000, 3000  # datagrams a second each way, and in all, for the error of the delay
FULL_RATE, FULL_COUNT = 20_000, 40_000  # the same for loss
SCENE = "hard_wall"
OURS = (sys.executable, "-m", "teleop.bench.parts")


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
    """An `Alarm` in asyncio and a loop on a timerfd, at once; then an alarm that spins."""
    theirs, ours, spun = [], [], []
    for _ in range(rounds):
        running = [_started(*OURS, "tick", count, 0), _started(c, "tick", count)]
        own, other = [_late(process.communicate()[0]) for process in running]
        ours.append(own)
        theirs.append(other)
        spun.append(_late(_told(*OURS, "tick", count, SPIN_NS)))
    return [
        _plain("C loop on a timerfd: tick late by", theirs),
        *_beside("Alarm in asyncio: tick late by", ours, theirs),
        (f"Alarm, awake {SPIN_NS // 1000} us before (--spin): late by, median",
         f"{median(one.median for one in spun):.1f} us", "asked: at most 5"),
        ("  99 %", f"{median(one.most for one in spun):.0f} us", ""),
    ]


def round_trips(c: str, rounds: int, count: int = TRIPS) -> list[Row]:
    """Of 100 bytes over loopback, each end on a core of its own, as two machines would be; then both on one core."""
    apart: list[list[Late]] = []
    together: list[list[Late]] = []
    for cores, trips in ((cores_apart(), apart), (cores_apart()[:1] * 2, together)):
        with _port(c, "echo", core=cores[1]) as there, _port(*OURS, "echo", core=cores[1]) as ours:
            for _ in range(rounds):
                trips.append([_late(_started(*each, count, core=cores[0]).communicate()[0]) for each in (
                    (c, "ping", there), (*OURS, "ping", ours), (c, "ping", ours))])
    in_c, both, alone = zip(*apart, strict=True)
    one_core = zip(*together, strict=True)
    most = "asked: at most 2.2"
    return [
        _plain("round trip over loopback, C", in_c),
        _beside("round trip, a Wire in asyncio at both ends", both, in_c, most)[0],
        _beside("round trip, C and an echo through a Wire", alone, in_c, most)[0],
        _plain("round trip, C, both ends on one core", next(one_core)),
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
    own, other = zip(*pairs, strict=True)
    lost = [f"{median(one.lost for one in side):.0f}" for side in zip(*full, strict=True)]
    return [
        _plain(f"C relay, {RATE} packets a second each way: error of the delay", [one.error for one in other]),
        *_beside("python -m channel: error of the delay", [one.error for one in own], [one.error for one in other]),
        (f"  lost at {FULL_RATE} a second each way, of {2 * FULL_COUNT}", lost[0], f"{lost[1]} by C; asked: at most 0"),
    ]


def datagrams(folder: Path, count: int) -> None:
    """The packets that the two ends of a session send, in the form that the load reads: `fwd` and `bwd`."""
    from teleop.protocol.packet import Kind, Packet, encode
    from teleop.scene.loading import load_scene
    from teleop.scene.scene import both_ends

    scene = both_ends(load_scene(SCENE, link=f"delay({DELAY})"))
    ways = {"fwd": (Kind.HELLO, Kind.FORTH), "bwd": (Kind.START, Kind.BACK)}
    for name, (control, message) in ways.items():
        first = encode(Packet(control, 1, 0, 0, None, manifest_of(scene) if control is Kind.HELLO else 0))
        rest = (encode(Packet(message, 1, k, k * scene.dt_ns, None, (0.1,), 0.1), scene.wire_size)
                for k in range(count))
        with (folder / name).open("wb") as file:
            file.writelines(len(data).to_bytes(2, "little") + data for data in (first, *rest))


def carried(c: str, folder: Path, rate: int, count: int, *, ours: bool) -> CarriedLoad:
    """One relay under one load."""
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


def _told(*command: Any) -> str:
    return subprocess.run(list(map(str, command)), check=True, capture_output=True, text=True, cwd=ROOT).stdout


def _late(told: str) -> Late:
    return Late(*map(float, told.split()[:2]))


def _plain(what: str, times: Sequence[Late]) -> Row:
    return (f"{what}, median / 99 %",
            f"{median(one.median for one in times):.0f} / {median(one.most for one in times):.0f} us", "")


def _beside(what: str, ours: Sequence[Late], theirs: Sequence[Late], most: str = "asked: at most 1.5") -> list[Row]:
    """The median and the 99 % of ours, with their ratios to C."""
    rows = []
    for place, name in enumerate((f"{what}, median", "  99 %")):
        ratio = median(own[place] / other[place] for own, other in zip(ours, theirs, strict=True))
        rows.append((name, f"{median(own[place] for own in ours):.0f} us", f"{ratio:.2f} times C; {most}".rstrip("; ")))
    return rows
