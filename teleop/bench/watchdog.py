"""The time for which a motor holds its force after the end that drives it was killed or stopped, has crashed, or hangs.

The end drives `teleop.bench.motor`, a motor that outlives it and has no deadline of its own: what sets its force to
zero is the device's watchdog process (`teleop.live.devices.device_watchdog`). Each trial is a live run of its own.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from teleop.bench.motor import HANG, Motor
from teleop.live.records.record import read_events
from teleop.protocol.guard import DEADLINE
from teleop.scene.library import ROOT

Row = tuple[str, str, str]
SCENE = ("hard_wall", "--set", "law=direct", "--link", "none", "--set", "duration=60")
FORCE = 1.0  # N at least, at the blow
CALM = 0.2  # s of it before
PATIENCE = 30.0  # s
TRIALS = 4  # of each blow in a round


def watchdog(rounds: int) -> list[Row]:
    """Rows of (what, measured, asked), over 4 `rounds` trials of each blow."""
    rows: list[Row] = []
    early = 0
    for what, (blow, asked) in BLOWS.items():
        took = []
        for _ in range(TRIALS * rounds):
            with TemporaryDirectory() as name:
                one, before = trial(blow, Path(name))
            took.append(one)
            early += before
        rows.append((f"force is zero after {what}: median, most of {len(took)}",
                     f"{median(took) * 1e3:.1f}, {max(took) * 1e3:.1f} ms", f"asked: at most {asked * 1e3:.0f}"))
    rows.append(("the watchdog acted before the blow, in all of these", str(early), "asked: at most 0"))
    return rows


def trial(blow: Callable[[int, Motor], None], folder: Path) -> tuple[float, int]:
    """Seconds from the blow to zero force, and how often the watchdog had acted before it."""
    motor = Motor(folder / "motor")
    with Ends(folder) as ends:
        until = time.monotonic() + PATIENCE
        since = None
        while since is None or time.monotonic() - since < CALM:
            if abs(motor.force) < FORCE:
                since = None
            elif since is None:
                since = time.monotonic()
            if time.monotonic() > until:
                raise TimeoutError("no force came about in this run")
            time.sleep(0.002)
        early = acted(folder / "slave")
        began = time.monotonic_ns()
        blow(ends.slave.pid, motor)
        while motor.zeroed_ns < began:
            if time.monotonic() > until:
                raise TimeoutError("the force was not set to zero")
            time.sleep(0.0005)
        took = (motor.zeroed_ns - began) / 1e9
    return took, early


def acted(folder: Path) -> int:
    """The number of times that the watchdog of the end in `folder` has acted."""
    return sum(event.get("what") == "watchdog" for event in read_events(folder))


class Ends:
    """A slave that drives the motor in `folder`, and a master, until the block ends; then both are killed."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._processes: list[subprocess.Popen[str]] = []

    def __enter__(self) -> Ends:
        self.slave = self._start("slave", "--listen", "127.0.0.1:0")
        assert self.slave.stdout is not None
        port = json.loads(self.slave.stdout.readline())["port"]
        self.master = self._start("master", "--peer", f"127.0.0.1:{port}")
        return self

    def __exit__(self, *_: object) -> None:
        for process in self._processes:
            process.kill()
            process.communicate()

    def _start(self, name: str, *options: str) -> subprocess.Popen[str]:
        program = ["teleop.bench.motor", str(self._folder / "motor")] if name == "slave" else [name]
        process = subprocess.Popen(
            [sys.executable, "-m", *program, *SCENE, *options, "--out", str(self._folder / name), "--json"], cwd=ROOT,
            text=True, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        )
        self._processes.append(process)
        return process


def _signals(number: signal.Signals) -> Callable[[int, Motor], None]:
    return lambda pid, _motor: os.kill(pid, number)


def _hangs(_pid: int, motor: Motor) -> None:
    motor.order = HANG


BLOWS: dict[str, tuple[Callable[[int, Motor], None], float]] = {
    "SIGKILL": (_signals(signal.SIGKILL), 0.1), "SIGSEGV": (_signals(signal.SIGSEGV), 0.1),
    "SIGSTOP": (_signals(signal.SIGSTOP), 2 * DEADLINE), "a hang in its driver": (_hangs, 2 * DEADLINE),
}
