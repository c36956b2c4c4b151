"""A live run whose processes are killed, started again, stopped and continued. `tests.live.verdict` judges it."""

from __future__ import annotations

import json
import os
import random
import signal
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from threading import Thread
from typing import Any, NamedTuple

from tests.live.conftest import Command
from tests.waiting import PATIENCE

RAMP, SLEW, F_MAX, DT, DELAY = 0.05, 1000.0, 20.0, 1e-3, 0.01  # of the scene, SI
SCENE = f"""
from channel.delay import Delay
from master.hand import Grip, Sine
from teleop.law import Law
from teleop.laws.wave import Wave
from teleop.physics.plant import MassDamper
from teleop.stages.force_cap import Cap
from teleop.stages.watchdog import Watchdog
from teleop.scene import Scene


def scene(*, duration: float, timeout: float, law: Law = Wave(), friction: float = 0.0) -> Scene:
    return Scene(
        law=law, hand=Grip(mass=0.4, k=200.0, d=5.0, reference=Sine(amplitude=0.05, frequency=0.9)),
        master=MassDamper(mass=0.1, damping=0.5), link=Delay({DELAY}),
        slave=MassDamper(mass=0.5, damping=30.0, friction=friction), watchdog=Watchdog(timeout=timeout, ramp={RAMP}),
        cap=Cap(f_max={F_MAX}, slew={SLEW}), dt={DT}, duration=duration,
    )
"""  # a hand that is never still, on a slave in oil: there is force wherever the law may hold any
NAMES = ("master", "slave", "channel")
SLACK = 0.1  # s, between what these processes do and what this one saw of it


@dataclass
class One:
    """One process, from its start to its end. Times are of the monotonic clock, s."""

    name: str
    folder: Path
    command: Command
    began: float
    ended: float = float("inf")
    stops: list[tuple[float, float]] = field(default_factory=list)
    said: list[tuple[float, dict[str, Any]]] = field(default_factory=list)  # its live lines, and when they came
    port: int | None = None
    files: int | None = None  # descriptors, when it first ran well

    @property
    def pid(self) -> int:
        return self.command.process.pid

    def listen(self) -> None:
        """Keep what it says as it says it."""
        for line in self.command.process.stdout or ():
            event = json.loads(line)
            if event["event"] == "listening":
                self.port = int(event["port"])
            elif event["event"] == "live":
                self.said.append((time.monotonic(), event))


class Upset(NamedTuple):
    """Something that was done to the run, and when: s, from the first blow to the last process that is back."""

    what: str
    began: float
    over: float
    struck: tuple[str, ...]  # those that were gone or stopped


class Site:
    """Master, channel and slave, each started as often as it takes; the ports stay."""

    def __init__(self, command: Callable[..., Command], folder: Path, keys: dict[str, list[str]], seconds: int,
                 timeout: float, knobs: Sequence[str] = ()) -> None:
        self.timeout = timeout
        self._command, self._folder, self._keys = command, folder, keys
        scene = folder / "oil.py"
        scene.write_text(SCENE)
        self._scene = [str(scene), "--set", f"duration={seconds}", "--set", f"timeout={timeout}", "--json"]
        self._scene += [part for knob in knobs for part in ("--set", knob)]
        self.every: list[One] = []
        self.now: dict[str, One] = {}
        self.ports = {name: free_port() for name in ("slave", "channel")}
        self.upsets: list[Upset] = []
        for name in ("slave", "channel", "master"):
            self.start(name)

    def start(self, name: str) -> None:
        """Start it (anew); the answer is not waited for."""
        folder = self._folder / f"{name}{sum(one.name == name for one in self.every)}"
        own = ["--listen", f"127.0.0.1:{self.ports[name]}"] if name in self.ports else []
        to = {"master": "channel", "channel": "slave"}.get(name)
        own += ["--peer", f"127.0.0.1:{self.ports[to]}"] if to else []
        own += ["--out", str(folder), *self._keys.get(name, [])] if name != "channel" else []
        one = One(name, folder, self._command(name, *self._scene, *own), time.monotonic())
        Thread(target=one.listen, daemon=True).start()
        self.every.append(one)
        self.now[name] = one

    def kill(self, name: str) -> None:
        """As the system's out-of-memory killer does it."""
        one = self.now[name]
        one.command.signal(signal.SIGKILL)
        one.command.process.wait()
        one.ended = time.monotonic()

    def stop(self, name: str) -> float:
        self.now[name].command.signal(signal.SIGSTOP)
        return time.monotonic()

    def go_on(self, name: str, since: float) -> None:
        self.now[name].stops.append((since, time.monotonic()))
        self.now[name].command.signal(signal.SIGCONT)

    def resumed(self, since: float) -> None:
        """Wait until both ends say that they hold all of the law's force, and did so well after `since`."""
        until = time.monotonic() + PATIENCE
        while not all(self._well(self.now[name], since + 2 * self.timeout) for name in ("master", "slave")):
            told = {name: one.said[-1:] for name, one in self.now.items()}
            dead = [one for one in self.now.values() if one.command.process.poll() is not None]
            errors = [(one.name, one.command.process.communicate()[1]) for one in dead]
            assert not dead, f"ended by itself: {errors} after {self.upsets[-1:]}"
            assert time.monotonic() < until, f"not resumed {PATIENCE} s after {self.upsets[-1:]}: {told}"
            time.sleep(0.02)
        for one in self.now.values():
            files = len(os.listdir(f"/proc/{one.pid}/fd"))
            one.files = one.files or files
            assert abs(files - one.files) <= 1, f"the {one.name} has {files} files open, and had {one.files}"

    @staticmethod
    def _well(one: One, after: float) -> bool:
        when, event = one.said[-1] if one.said else (0.0, {})
        return when > after and event["gain"] == 1.0 and event["delay"] is not None

    def upset(self, dice: random.Random) -> None:
        """One blow of some kind, until all three run."""
        began = time.monotonic()
        kind = dice.choice(("kill", "kill", "stop", "stop", "two", "again", "crossed"))
        first, second, _ = dice.sample(NAMES, 3)
        pause = dice.uniform(0.0, 0.5)
        struck, what = (first, second), f"{kind} {first}"
        if kind == "kill":
            self.kill(first)
            time.sleep(pause)
            self.start(first)
            struck = (first,)
        elif kind == "stop":
            length = dice.uniform(0.05, 1.5)
            since = self.stop(first)
            time.sleep(length)
            self.go_on(first, since)
            struck, what = (first,), f"{what} for {length:.2f} s"
        elif kind == "two":
            self.kill(first)
            time.sleep(pause / 2)
            self.kill(second)
            for name in dice.sample(struck, 2):
                time.sleep(pause / 2)
                self.start(name)
            what += f" and {second}"
        elif kind == "again":
            self.kill(first)
            self.start(first)
            time.sleep(dice.uniform(0.0, 2.0))
            self.kill(first)
            self.start(first)
            struck = (first,)
        else:
            since = self.stop(first)
            self.kill(second)
            time.sleep(pause)
            self.start(second)
            time.sleep(length := dice.uniform(0.0, 1.5))
            self.go_on(first, since)
            what = f"stop {first} for {pause + length:.2f} s, kill {second} meanwhile"
        self.upsets.append(Upset(what, began, time.monotonic(), struck))
        self.resumed(time.monotonic())

    def end(self) -> None:
        """Ask all three to stop; they do, and nothing of this run is left."""
        for one in self.now.values():  # at once: one that ends because the other left heeds no signal any more
            one.command.signal(signal.SIGTERM)
        for name, one in self.now.items():
            code = one.command.process.wait(PATIENCE)
            said = one.command.process.stderr.read() if one.command.process.stderr else ""
            assert (code, said) == (0, ""), (name, code, said)
        assert not [one.name for one in self.every if Path(f"/proc/{one.pid}").exists()]
        assert list(whose_command_says(str(self._folder))) == []


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        return int(sock.getsockname()[1])


def whose_command_says(text: str) -> Iterator[int]:
    """The processes of this machine with a text in their command line."""
    for folder in Path("/proc").iterdir():
        if folder.name.isdecimal() and int(folder.name) != os.getpid():
            try:
                said = (folder / "cmdline").read_bytes()
            except OSError:
                continue
            if text.encode() in said:
                yield int(folder.name)
