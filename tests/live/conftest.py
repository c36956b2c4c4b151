"""Two ways to a live run: both ends in this process, over real sockets; and processes of their own."""

from __future__ import annotations

import gc
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from threading import Thread
from typing import Any

import pytest

from master.device import SimulatedMaster
from slave.robot import SimulatedSlave
from teleop import DeviceError, Scene
from teleop.live.devices import call_watch
from teleop.live.driving import run
from teleop.live.net.wire import Wire, bind_udp
from teleop.live.process.interrupt import Interrupt
from teleop.live.process.realtime import RealTime
from teleop.live.records.end_result import WAYS
from teleop.live.records.record import RecordWriter
from teleop.live.shell import Shell
from teleop.live.summary import write_end
from teleop.protocol.endpoint import Endpoint, Stepped
from teleop.protocol.manifest import manifest_of
from teleop.protocol.session import Session
from teleop.scene.library import ROOT
from teleop.simulation.plan import link_plans
from tests.waiting import PATIENCE

OWN = {**{key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}, "PYTHONPATH": str(ROOT)}
DEVICES: dict[str, Callable[[Scene], Any]] = {"m": SimulatedMaster, "s": SimulatedSlave}


@pytest.fixture(autouse=True)
def _ordinary_scheduling(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave this process as it is: an end that ran first here would keep a core from the ends of other tests."""
    monkeypatch.setattr(
        "teleop.live.end.realtime.scheduling_of", lambda _args, interrupt, *_: RealTime(interrupt, wanted=False))


@pytest.fixture(autouse=True)
def _no_call_ends_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give devices under test a minute for a call: on a busy machine the check of one ended the worker of the tests."""
    for name in ("BLOCKED_S", "STUCK_S"):
        monkeypatch.setattr(call_watch, name, 60.0)


def make_shell(scene: Scene, e: str, wire: Wire, folder: Path, *, seed: int | None = None, **other: Any) -> Shell:
    """A shell as the command line makes it; with a `seed` it is stepped."""
    inbox = None if seed is None else Stepped(link_plans(scene, seed)[0 if e == "s" else 1])
    number = 99 if e == "m" else None
    session = Session(master=e == "m", manifest=manifest_of(scene), number=number, heals=seed is None)
    folder.mkdir(parents=True)
    device = other.pop("device", DEVICES[e](scene))
    parts = {"say": lambda _numbers: None, "peer_timeout": PATIENCE / 5.0, "interrupt": Interrupt(), **other}
    about = {"scene": scene.name, "knobs": {}, "seed": seed or 0, "mode": "live" if seed is None else "lockstep"}
    return Shell(Endpoint(scene, e, session, inbox), device, wire, RecordWriter(scene, e, folder, about), **parts)


@dataclass
class Pair:
    """A master and a slave in threads of this process, over sockets of their own on loopback."""

    scene: Scene
    out: Path
    seed: int | None = None  # given: stepped
    wire: Callable[..., Wire] = Wire
    parts: dict[str, dict[str, Any]] = field(default_factory=lambda: {"m": {}, "s": {}})
    shells: dict[str, Shell] = field(init=False)
    errors: dict[str, BaseException | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        slave = self.wire(bind_udp(("127.0.0.1", 0), "--listen"), None)
        master = self.wire(bind_udp(("127.0.0.1", 0), "--peer"), slave.sock.getsockname())
        self.shells = {
            e: make_shell(self.scene, e, wire, self.out / name, seed=self.seed, **self.parts[e])
            for e, name, wire in (("s", "slave", slave), ("m", "master", master))
        }

    def run(self) -> Pair:
        """Run both to their ends; what they raised is in `errors`."""
        def drive(e: str) -> None:
            self.errors[e] = None
            try:
                run(self.shells[e])
            except BaseException as error:
                self.errors[e] = error

        ends = [Thread(target=drive, args=e, daemon=True) for e in "sm"]
        gc.collect()
        gc.freeze()  # all that the tests hold is no matter of an end's own collection, just before its first tick
        try:
            for end in ends:
                end.start()
            for end in ends:
                end.join(PATIENCE)
                assert not end.is_alive(), "it never came to its end"
        finally:
            for shell in self.shells.values():
                shell.wire.sock.close()
        return self

    def write(self) -> tuple[Path, Path]:
        """Have both write what they leave; the master's folder and the slave's."""
        for name, shell in zip(("slave", "master"), self.shells.values(), strict=True):
            write_end(shell, self.out / name, self.seed or 0, [])
        return self.out / "master", self.out / "slave"

    def share_received(self, e: str) -> float:
        """The share of the messages sent to end `e` that it received: what the machine left out was never sent."""
        inbox = self.shells[e].endpoint.inbox
        received = self.shells[e].endpoint.counted["received"] + inbox.received
        return float(received / self.shells["ms"[e == "m"]].counts.data_sent)

    def status(self) -> dict[str, str]:
        return {e: shell.outcome.status for e, shell in self.shells.items()}


@pytest.fixture
def pair(tmp_path: Path) -> Callable[..., Pair]:
    """`pair(scene, ...)`: two ends, not run yet, that record below a fresh folder."""
    return lambda scene, **other: Pair(scene, tmp_path / f"pair{time.monotonic_ns()}", **other)


@pytest.fixture
def opened() -> Iterator[Callable[..., Any]]:
    """`opened(thing)`: it is closed in the end, whatever it raises then."""
    things: list[Any] = []

    def keep(thing: Any) -> Any:
        things.append(thing)
        return thing

    yield keep
    for each in reversed(things):
        with suppress(DeviceError, OSError):
            each.close()


LOSSY = "delay(0.05) | bernoulli(0.05) | duplicate(0.05, after=0.002)"


@dataclass(frozen=True)
class Demo:
    """A demo that is over: its folder, which is shared, and not to be written to; and what it printed."""

    folder: Path
    out: str
    err: str


@pytest.fixture(scope="session")
def demo_run(tmp_path_factory: pytest.TempPathFactory) -> Demo:
    """A demo of hard_wall, two seconds over a link that loses."""
    folder = tmp_path_factory.mktemp("lossy") / "run"
    words = ["demo", "hard_wall", "--set", "duration=2.0", "--link", LOSSY, "--seed", "3", "--out", str(folder)]
    done = subprocess.run([sys.executable, "-m", "teleop", *words], env=OWN, cwd=folder.parent, capture_output=True,
                          text=True, check=False, timeout=PATIENCE)
    assert done.returncode == 0, done.stderr
    return Demo(folder, done.stdout, done.stderr)


@pytest.fixture(scope="session")
def lossy(demo_run: Demo) -> Path:
    """The folder of that demo."""
    return demo_run.folder


@dataclass
class Command:
    """`python -m NAME ...` as a process; its stdout is read line by line."""

    process: subprocess.Popen[str]
    lines: list[str] = field(default_factory=list)

    def event(self, name: str) -> dict[str, Any]:
        """Read on to the next event of this name. Only with --json."""
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.lines.append(line)
            found: dict[str, Any] = json.loads(line)
            if found["event"] == name:
                return found
        pytest.fail(f"it ended without the event {name}: {self.process.communicate()[1]}")

    def live(self, shows: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """Read on to the next live line whose numbers show this."""
        while not shows(numbers := self.event("live")):
            pass
        return numbers

    def port(self) -> int:
        """The port that it listens on."""
        return int(self.event("listening")["port"])

    def signal(self, number: signal.Signals) -> None:
        self.process.send_signal(number)

    def end(self) -> tuple[int, str, str]:
        """Wait for it: its exit code, and all of its stdout and stderr."""
        out, err = self.process.communicate(timeout=PATIENCE)
        return self.process.returncode, "".join(self.lines) + out, err

    def refused(self, *words: str) -> str:
        """It ends with exit code 2 and one sentence that has the words in it, which is returned."""
        code, out, err = self.end()
        assert code == 2, (out, err)
        assert err.startswith("teleop: "), err
        assert err.count("\n") == 1, err
        for word in words:
            assert word in err
        return err


@pytest.fixture
def command(tmp_path: Path) -> Iterator[Callable[..., Command]]:
    """`command("slave", ...)`: `python -m slave ...` in a folder of its own, and gone when the test is over."""
    started: list[Command] = []

    def start(name: str, *arguments: str, **other: Any) -> Command:
        streams = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **other}
        started.append(Command(subprocess.Popen(
            [sys.executable, "-m", name, *arguments], cwd=tmp_path, env=OWN, text=True, **streams)))
        return started[-1]

    yield start
    for one in started:
        with suppress(ProcessLookupError):
            one.process.kill()
        one.process.communicate()


def summary(folder: Path) -> dict[str, Any]:
    """The summary.json in a folder."""
    found: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    return found


def running(parent: int | None = None) -> dict[int, str]:
    """The command lines of the processes of this machine, or of those that `parent` has started, by their ids."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError, IndexError):  # it has just ended
            started = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            words = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
            if words and parent in (None, started):
                found[int(folder.name)] = words
    return found


def share_received(sender: Path, receiver: Path) -> float:
    """The share of its messages that came to the other end, by the summaries in both ends' folders."""
    way = WAYS[summary(receiver)["end"][0]][1]
    received, sent = (summary(folder)["packets"][way][what] for folder, what in (
        (receiver, "received"), (sender, "sent")))
    return float(received / sent)


def pair_of_keys(folder: Path) -> dict[str, list[str]]:
    """What a master and a slave are started with to let in each other."""
    pytest.importorskip("OpenSSL")
    from teleop.protocol.secure.keys import keygen

    made = {name: keygen(folder / name) for name in ("master", "slave")}
    return {own: ["--key", str(made[own][0]), "--peer-fingerprint", made[peer][1]]
            for own, peer in (("master", "slave"), ("slave", "master"))}
