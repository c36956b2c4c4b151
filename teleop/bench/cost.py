"""The processor time of a live end's tick, in all and part by part; of another tree beside it, in the same run.

    python -m teleop.bench cost --rounds 8 --against ../before     # a worktree of the commit before

The two trees take turns, so that what else the machine does disturbs both. Live: the system's count of processor time
over a demo at 1 kHz, mean of its two ends.

Back to back: `python -P cost.py` of each tree runs both live ends in one process, tick after tick without a wait, and
prints the time of a tick. The ends are whole, sockets on loopback included; only their clock is a stand-in that goes on
by one tick at a time. So nothing is in it of waking up, and caches are warm: the figure hardly depends on the rest of
the machine. Live each part takes about twice as long, since it finds its caches cold. The parts are timed in a second
run; one that a tree lacks is left out.
"""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

from teleop.live.driving import ClockDriver
from teleop.live.net.wire import Wire, bind_udp
from teleop.live.process.interrupt import Interrupt
from teleop.live.records.record import RecordWriter
from teleop.live.shell import Shell
from teleop.protocol.endpoint import Endpoint
from teleop.protocol.manifest import manifest_of
from teleop.protocol.session import Session
from teleop.scene.library import ROOT
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene, both_ends

TICKS = 5000
DEVICES = {"m": ("master.device", "SimulatedMaster"), "s": ("slave.robot", "SimulatedSlave")}  # above this room
WARM = 1000  # of them, at first, that do not count
TICK_NS = 1_000_000
PARTS = {
    "read the socket": ("live.shell:Shell.drain", "live.net.wire:Wire.receive"),
    "decode": ("protocol.endpoint:decode",),
    "judge what came": ("protocol.connection:Connection.receive", "protocol.endpoint:Endpoint.receive",
                        "protocol.packet:Window.judge", "protocol.session:Session.take_data"),
    "inbox": ("protocol.inbox:Inbox.add", "protocol.inbox:Inbox.take"),
    "estimates": ("protocol.estimates:LinkEstimates.add", "protocol.reception:Presence.newest"),
    "guard, presence": ("protocol.endpoint:Endpoint._gain", "protocol.guard:ForceGuard.step",
                        "protocol.reception:Presence.judge"),
    "device and its checks": ("live.devices.guarded_device:GuardedDevice.read",
                              "live.devices.guarded_device:GuardedDevice.hold"),
    "law and stages": ("protocol.endpoint:Endpoint.tick",),
    "encode": ("protocol.endpoint:Endpoint._datagram", "protocol.endpoint:framed"),
    "send": ("live.net.wire:Wire.send",),
    "record, live line": ("live.records.record:RecordWriter.add", "live.records.inputs:InputWriter.ticked",
                          "live.records.inputs:InputWriter.arrived", "live.live_line:LiveLine.tick",
                          "live.live_line:LiveLine.announce"),
    "driver and shell": ("live.driving:ClockDriver.wake", "live.shell:Shell.tick", "live.shell:Shell.take_events",
                         "live.shell:Shell.say_again", "live.driving:Listening.update",
                         "live.process.ticker:Suspension.duration"),
}
OVERHEAD_NS = 130  # of a timed call, to the part that calls it


class Clock:
    """The module `time` with a monotonic clock that stands still until it is moved."""

    time_ns = staticmethod(time.time_ns)  # at every tick

    def __init__(self) -> None:
        self.now = time.monotonic_ns()

    def __getattr__(self, name: str) -> Any:
        return getattr(time, name)

    def monotonic_ns(self) -> int:
        """The stand-in's time, ns."""
        return self.now


def live_end(scene: Scene, e: str, wire: Wire, folder: Path) -> Shell:
    """A live end that has read its device once."""
    session = Session(master=e == "m", manifest=manifest_of(scene), number=2**63 + 1 if e == "m" else None)
    folder.mkdir()
    device: Any = getattr(import_module(DEVICES[e][0]), DEVICES[e][1])(scene)
    shell = Shell(Endpoint(scene, e, session), device, wire, RecordWriter(scene, e, folder, {}), lambda _: None,
                  peer_timeout=None, interrupt=Interrupt())
    shell.device.read(0, 0)
    shell.endpoint.senses(bool(shell.device.sensor), shell.device.switches)
    shell.recorder.begin(shell.device.force_source)
    return shell


def ticks(clock: Clock, shells: list[Shell], began: Callable[[], None]) -> float:
    """Median time (us) of a tick, after `began` was called."""
    while any(shell.endpoint.session.start_ns is None or shell.endpoint.session.meeting for shell in shells):
        for shell in shells:
            shell.drain()
            shell.say_again(clock.now)
        clock.now += TICK_NS
    drivers = [ClockDriver(shell, 0) for shell in shells]
    for driver in drivers:
        driver.suspension._boot = None
        driver.listening.update(clock.now, driver.shell.take_events())
        reading = driver.shell.device.read(0, clock.now)
        assert reading is not None
        driver.shell.endpoint.place(reading.x)
    clock.now = (shells[0].endpoint.session.start_ns or 0) + TICK_NS // 2
    began()
    gc.collect()
    took: list[int] = []
    for _ in range(TICKS):
        clock.now += TICK_NS
        for driver in drivers:
            at = time.perf_counter_ns()
            driver.wake()
            took.append(time.perf_counter_ns() - at)
    for driver in drivers:
        heard = driver.shell.endpoint.link.way.count
        assert heard >= TICKS - 10, f"{heard} of {TICKS} messages heard: {driver.shell.outcome.sentence}"
    return median(took[2 * WARM:]) / 1e3


def ran(began: Callable[[], None]) -> float:
    """The two ends of a run, from the first exchange on."""
    clock = Clock()
    for name in ("driving", "shell", "net.wire"):
        module: Any = import_module(f"teleop.live.{name}")
        module.time = clock
    scene = both_ends(load_scene("hard_wall", duration=2 * TICKS * TICK_NS / 1e9))
    with TemporaryDirectory() as name, bind_udp(("127.0.0.1", 0), "") as near, bind_udp(("127.0.0.1", 0), "") as far:
        shells = [live_end(scene, "m", Wire(near, far.getsockname()), Path(name) / "m"),
                  live_end(scene, "s", Wire(far, None), Path(name) / "s")]
        us = ticks(clock, shells, began)
        for shell in shells:
            shell.recorder.close()
        return us


def timed(times: list[int], inside: list[int], function: Callable[..., Any]) -> Callable[..., Any]:
    """`function`, with its own time (ns) put into `times`; `inside`: the time of the parts that each open call made."""
    def call(*args: Any, **named: Any) -> Any:
        inside.append(0)
        began = time.perf_counter_ns()
        try:
            return function(*args, **named)
        finally:
            passed = time.perf_counter_ns() - began
            times.append(passed - inside.pop())
            inside[-1] += passed + OVERHEAD_NS
    return call


def place_of(name: str) -> tuple[Any, str]:
    """The module or class that a part's function is in, and what it is called there."""
    module, _, path = name.partition(":")
    *outer, last = path.split(".")
    owner: Any = import_module(f"teleop.{module}")
    for each in outer:
        owner = getattr(owner, each)
    return owner, last


def wrap() -> dict[str, list[int]]:
    """Have all parts timed; their times (ns) by name, as they come."""
    times: dict[str, list[int]] = defaultdict(list)
    inside = [0]
    for name in [each for names in PARTS.values() for each in names]:
        try:
            owner, last = place_of(name)
            function = getattr(owner, last)
        except (ImportError, AttributeError):
            continue  # this tree has it not
        setattr(owner, last, timed(times[name], inside, function))
    return times


def main() -> int:
    """Print what a tick takes, us: whole, and by parts."""
    whole = ran(lambda: None)
    times: dict[str, list[int]] = {}
    ran(lambda: times.update(wrap()))
    parts = {part: sum(median(times[name]) * len(times[name]) / TICKS / 2e3 for name in names if times.get(name))
             for part, names in PARTS.items()}
    print(json.dumps({"whole": whole, **parts}))
    return 0


Row = tuple[str, str, str]
SECONDS = 4
LIVE, WHOLE = "live, processor time of a tick", "back to back"


def cost(rounds: int, against: str | None = None) -> list[Row]:
    """Rows of (what, us a tick, the same of the tree `against` and the ratio): medians over `rounds`."""
    trees = [ROOT] if against is None else [ROOT, Path(against).resolve()]
    figures: dict[Path, list[dict[str, float]]] = {tree: [] for tree in trees}
    with TemporaryDirectory() as folder:
        for i in range(rounds):
            for tree in trees if i % 2 else trees[::-1]:
                parts: dict[str, float] = json.loads(_python(tree, "-P", str(tree / "teleop" / "bench" / "cost.py")))
                out = Path(folder) / f"{i}-{trees.index(tree)}"
                figures[tree].append({LIVE: _live(tree, out), WHOLE: parts.pop("whole"),
                                    **{f"  {part}": us for part, us in parts.items()}})
    medians = [{what: median(one[what] for one in each) for what in each[0]} for each in figures.values()]
    return [(what, f"{us:.1f} us", "" if len(medians) < 2 else _beside(us, medians[1].get(what, 0.0)))
            for what, us in medians[0].items()]


def _beside(us: float, before: float) -> str:
    ratio = f", {us / before:.2f} times" if before > 0.0 else ""
    return f"before: {before:.1f} us{ratio}"


def _live(tree: Path, out: Path) -> float:
    """Processor time (us) of a tick that ran, mean of the two ends of a demo."""
    words = ("hard_wall", "--set", f"duration={SECONDS}", "--out", str(out), "--json")
    summary: dict[str, Any] = json.loads(_python(tree, "-m", "scenarios", "demo", *words))
    return sum(float(summary[end]["cpu"] / (1e3 - summary[end]["skipped"] / SECONDS) * 1e6)
               for end in ("master", "slave")) / 2


def _python(tree: Path, *words: str) -> str:
    done = subprocess.run([sys.executable, *words], cwd=tree, env={**os.environ, "PYTHONPATH": str(tree)}, check=True,
                          capture_output=True, text=True)
    return done.stdout


if __name__ == "__main__":
    raise SystemExit(main())
