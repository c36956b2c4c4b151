"""Ends as processes: a signal ends the run without force, what breaks says so, what hangs is ended by the second."""

from __future__ import annotations

import os
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from teleop.live.leaving import HUNG_S
from teleop.live.process.interrupt import OTHERS, REAL_TIME, Interrupt
from teleop.live.records.reader import read_record
from teleop.live.records.record import read_events
from teleop.live.shell import MAY_BE_ON, MOST_TIMES, TRACEBACK
from teleop.scene.library import ROOT
from tests.live.conftest import PATIENCE, summary
from tests.waiting import until

pytestmark = pytest.mark.live
FULL = pytest.mark.full  # the same way to zero by another road
Make = Callable[..., Any]
SCENE = ("canonical", "--set", "duration=120", "--set", "delay=0.002")
UNTAKEN = {  # and why
    "SIGKILL": "no process can take it", "SIGSTOP": "no process can take it", "SIGCONT": "ends nothing",
    "SIGSEGV": "a fault", "SIGBUS": "a fault", "SIGFPE": "a fault", "SIGILL": "a fault",
    "SIGCHLD": "ends nothing", "SIGURG": "ends nothing", "SIGWINCH": "ends nothing",
    "SIGPIPE": "ignored by Python", "SIGXFSZ": "ignored by Python", "SIGTTOU": "ignored by teleop.live.process.output",
}
DEVICE = """
import asyncio, ctypes, os, select, signal, struct, sys, threading, time
from {module} import {kind}
from teleop.errors import DeviceError
from teleop.live.end import end_main

FILE = os.open("force", os.O_RDWR | os.O_CREAT)


class Law:
    @staticmethod
    def send(told):
        hang()


def hang():
    os.pwrite(FILE, b"hangs", 8)
    {act}


class Robot({kind}):
    '''Its force stands in a file, whatever becomes of this process, as in an amplifier.'''

    def __init__(self, scene):
        super().__init__(scene)
        {opens}

    def read(self, k):
        if {hangs} and k >= 500:
            {where}
        return super().read(k)

    def hold(self, force):
        {when}
        os.pwrite(FILE, struct.pack("d", force[0]), 0)
        super().hold(force)


if __name__ == "__main__":
    raise SystemExit(end_main("{e}", Robot))
"""


class Force:
    """What the device in a folder holds."""

    def __init__(self, folder: Path) -> None:
        self.file = folder / "force"

    def __call__(self) -> float:
        data = self.file.read_bytes() if self.file.exists() else b""
        return float(struct.unpack("d", data[:8])[0]) if len(data) >= 8 else 0.0

    def hangs(self) -> None:
        """Wait until its driver, or the law, hangs; it holds a force then."""
        until(lambda: self.file.exists() and self.file.stat().st_size > 8, "nothing hangs")
        assert self() != 0.0

    def until(self, well: Callable[[float], bool]) -> float:
        """Wait for such a force; how many seconds that took."""
        began = time.monotonic()
        while not well(self()):
            assert time.monotonic() - began < PATIENCE, self()
            time.sleep(0.001)
        return time.monotonic() - began


def robot(folder: Path, e: str = "s", act: str = "pass", where: str | None = None, when: str = "pass",
          opens: str = "pass") -> Force:
    """Write the program of an end with such a device; `act` is what hangs, `where` it is called from.

    `opens`: what it does while it is opened.
    """
    module, kind = ("slave.robot", "SimulatedSlave") if e == "s" else ("master.device", "SimulatedMaster")
    (folder / "robot.py").write_text(DEVICE.format(module=module, kind=kind, e=e, act=act, hangs=where is not None,
                                                   where=where or "pass", when=when, opens=opens))
    return Force(folder)


def as_in_a_terminal() -> None:
    """What a shell starts in the background has some of these ignored, and stays so."""
    for number in (signal.SIGINT, signal.SIGQUIT, signal.SIGHUP, signal.SIGTSTP):
        signal.signal(number, signal.SIG_DFL)


def pair(command: Make, e: str = "s", force: Force | None = None, *, hangs: bool = False) -> tuple[Any, Any]:
    """The end with that device, and the other; `force`: wait until there is one, and if it `hangs` for that."""
    names = {"m": "master", "s": "slave", e: "robot"}
    slave = command(names["s"], *SCENE, "--listen", "127.0.0.1:0", "--json", "--out", "s", preexec_fn=as_in_a_terminal)
    peer = ("--peer", f"127.0.0.1:{slave.port()}")
    master = command(names["m"], *SCENE, *peer, "--json", "--out", "m", preexec_fn=as_in_a_terminal)
    if force is not None:
        force.until(lambda f: abs(f) > 0.1)
    if force is not None and hangs:
        force.hangs()
    return (slave, master) if e == "s" else (master, slave)


def test_no_signal_that_a_process_can_take_ends_it() -> None:
    program = """
import os, signal, sys
from teleop.live.process.interrupt import Interrupt
for number in (signal.SIGQUIT, signal.SIGHUP):  # whatever the shell that started the tests makes of them
    signal.signal(number, signal.SIG_DFL)
before = {number: signal.getsignal(number) for number in signal.valid_signals()}
with Interrupt() as interrupt:
    for number in sorted(interrupt.signals):
        interrupt.name = None
        os.kill(os.getpid(), number)
        print(number, interrupt.name, flush=True)
print({number: was for number, was in before.items() if signal.getsignal(number) is not was})
"""
    done = subprocess.run([sys.executable, "-c", program], env={"PYTHONPATH": str(ROOT)}, check=True, text=True,
                          capture_output=True)
    *lines, left = done.stdout.splitlines()
    noted = {int(line.split()[0]): line.split()[1] for line in lines}
    assert left == "{}", "as it was before"
    all_of_them = {int(number) for number in signal.valid_signals()} - {int(getattr(signal, name)) for name in UNTAKEN}
    assert set(noted) == all_of_them
    assert {noted[int(getattr(signal, name))] for name in OTHERS} == set(OTHERS)
    assert noted[REAL_TIME[3]] == "SIGRTMIN+3"


def test_what_is_ignored_stays_so_as_under_nohup() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with Interrupt() as interrupt:
            os.kill(os.getpid(), signal.SIGHUP)
            assert (interrupt.name, signal.SIGHUP in interrupt.signals) == (None, False)
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize(("e", "name", "impatient"), [
    ("m", "SIGTSTP", 1), ("s", "SIGINT", 2), *[pytest.param(e, name, 1, marks=FULL) for e, name in (
        ("m", "SIGHUP"), ("s", "SIGTSTP"), ("s", "SIGHUP"), ("m", "SIGQUIT"), ("s", "SIGABRT"))],
])
def test_a_terminal_that_drops_and_an_impatient_finger_leave_no_force(
    e: str, name: str, impatient: int, command: Make, tmp_path: Path
) -> None:
    """SIGHUP, SIGQUIT and SIGUSR killed an end with 4.26 N held; Ctrl-Z stopped it so."""
    force = robot(tmp_path, e)
    own, other = pair(command, e, force)
    for _ in range(impatient):
        own.signal(getattr(signal, name))
    code, _, err = own.end()
    assert (code, err) == (0, "")
    assert other.end()[0] == 0
    assert force() == 0.0
    left = {each: summary(tmp_path / each) for each in "ms"}
    assert left[e]["sentence"].endswith(f"it was asked to stop ({name})")
    assert left[e]["sentence"] in left["sm"["ms".index(e)]]["sentence"]


@pytest.mark.parametrize("signals", [1, 2])
def test_two_signals_of_one_kind_that_come_while_compiled_code_runs_are_two(signals: int) -> None:
    """To the handler in Python they were one: the end went along its ramp, and was ended on it as one that hangs."""
    program = f"""
import ctypes, os, time
from teleop.live.process.interrupt import Interrupt
from teleop.live.leaving import LastResort
with Interrupt() as interrupt, LastResort(interrupt):
    kill = f"kill -TERM {{os.getpid()}}; sleep 0.2; "
    ctypes.CDLL(None).system((kill * {signals}).encode())
    until = time.monotonic() + 30.0
    while (interrupt.count, interrupt.seen) != (1, {signals}) and time.monotonic() < until:
        time.sleep(0.001)
    print(interrupt.name, interrupt.count, interrupt.seen, interrupt.again)
"""
    done = subprocess.run([sys.executable, "-c", program], env={"PYTHONPATH": str(ROOT)}, check=True, text=True,
                          capture_output=True)
    assert done.stdout == f"SIGTERM 1 {signals} {signals == 2}\n"


@pytest.mark.parametrize(("act", "stuck", "code", "words"), [
    ("sys.exit(0)", "pass", 1, ["raised SystemExit: 0", "its traceback is in"]),
    pytest.param("raise asyncio.CancelledError", "pass", 1,
                 ["the device, asked for a reading, raised CancelledError"], marks=FULL),
    pytest.param("raise KeyboardInterrupt", "pass", 1, ["raised KeyboardInterrupt"], marks=FULL),
    ("raise DeviceError('gone')", "if any(self._f) and not any(force): raise DeviceError('the amplifier')", 3,
     ["the device fails: gone", MAY_BE_ON]),
], ids=["exit", "cancelled", "interrupt", "stuck"])
def test_an_end_whose_driver_breaks_says_so_in_one_sentence_and_its_exit_code(
    act: str, stuck: str, code: int, words: list[str], command: Make, tmp_path: Path
) -> None:
    force = robot(tmp_path, "s", where=act, when=stuck)
    own, other = pair(command)
    ended, _, err = own.end()
    assert (ended, err.count("\n")) == (code, 1), err
    assert (force() == 0.0) is (code == 1)
    for word in words:
        assert word in err
    assert other.end()[0] == 0
    told, heard = summary(tmp_path / "s"), summary(tmp_path / "m")
    assert told["sentence"] in err
    assert told["sentence"] in heard["sentence"], "the peer is told the truth"
    assert len(read_record(tmp_path / "s")[1].ticks) == told["ticks"] > 0
    if "traceback" in err:
        assert act.rpartition(".")[2].removeprefix("raise ") in (tmp_path / "s" / TRACEBACK).read_text()


HANGS = {
    "sleeps": "time.sleep(600)",
    "computes": "while True: pass",
    "reads": "os.read(os.pipe()[0], 1)",
    "waits": "select.select([os.pipe()[0]], [], [])",
    "locks": "threading.Lock().acquire() and [lock := threading.Lock(), lock.acquire(), lock.acquire()]",
    "in C": "m, lock = ctypes.create_string_buffer(64), ctypes.CDLL(None).pthread_mutex_lock; lock(m); lock(m)",
}
LAW = "sys._getframe(3).f_locals['self'].endpoint._law._started = Law"


@pytest.mark.parametrize(("where", "act", "part"), [
    *[pytest.param("hang()", act, "the device, asked for a reading,", id=f"driver {name}",
                   marks=[] if name == "in C" else FULL) for name, act in HANGS.items()],
    pytest.param(LAW, HANGS["sleeps"], "the law", id="law sleeps"),
])
def test_a_hung_driver_or_law_is_ended_by_the_second_signal(
    where: str, act: str, part: str, command: Make, tmp_path: Path
) -> None:
    """Neither two SIGTERMs nor Ctrl-C ended it, and it held its force."""
    force = robot(tmp_path, "s", act, where)
    own, other = pair(command, "s", force, hangs=True)
    own.signal(signal.SIGTERM)
    time.sleep(0.05)
    own.signal(signal.SIGTERM)
    took = force.until(lambda f: f == 0.0)
    code, _, err = own.end()
    assert code == 1
    assert err.startswith(f"teleop: SIGTERM and SIGTERM came, and {part} does not return; its device was set to zero")
    assert err.count("\n") == 1
    assert took < HUNG_S + 2.0
    assert read_record(tmp_path / "s")[1].ticks[-1] >= 250, "the rows up to the hang are on the disk"
    assert any("does not return" in event["why"] for event in read_events(tmp_path / "s"))
    assert other.end()[0] == 0
    assert f"{part} does not return" in summary(tmp_path / "m")["sentence"], "the peer is told the truth"


def test_a_hung_driver_is_ended_by_one_signal_that_is_not_heeded(command: Make, tmp_path: Path) -> None:
    force = robot(tmp_path, "m", "time.sleep(600)", "hang()")
    own, _ = pair(command, "m", force, hangs=True)
    own.signal(signal.SIGINT)
    code, _, err = own.end()
    assert (code, force()) == (1, 0.0)
    assert err.startswith("teleop: SIGINT came, and the device, asked for a reading, does not return; ")


def test_a_driver_that_hangs_even_for_zero_is_ended_and_the_force_is_said_to_be_on(
    command: Make, tmp_path: Path
) -> None:
    force = robot(tmp_path, "s", "time.sleep(600)", when="self._k >= 500 and hang()")
    own, _ = pair(command, "s", force, hangs=True)
    own.signal(signal.SIGTERM)
    own.signal(signal.SIGINT)
    code, _, err = own.end()
    assert code == 3
    assert "the device, given a force, does not return" in err
    assert MAY_BE_ON in err
    assert force() != 0.0


TAKES = {  # how a driver takes SIGTERM
    "with its default": "signal.signal(signal.SIGTERM, signal.SIG_DFL)",
    "with a handler": "signal.signal(signal.SIGTERM, lambda number, frame: os._exit(0))",
    "below Python": "ctypes.CDLL(None).signal(15, 0)",
    "by blocking it": "signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM])",
}


@pytest.mark.parametrize(("how", "at"), [
    ("by blocking it", "opening"), *[pytest.param(how, at, marks=FULL) for how, at in (
        ("below Python", "a tick"), ("with a handler", "opening"), ("with its default", "opening"),
        ("below Python", "the first reading"), ("with a handler", "a tick"))],
])
def test_a_driver_that_takes_signals_for_itself_leaves_no_force(
    how: str, at: str, command: Make, tmp_path: Path
) -> None:
    """The end died of SIGTERM with 4.26 N on."""
    act = {"the first reading": f"self._k == 0 and {TAKES[how]}", "a tick": f"self._k == 500 and {TAKES[how]}"}
    force = robot(tmp_path, "s", when=act.get(at, "pass"), opens=TAKES[how] if at == "opening" else "pass")
    own, other = pair(command, "s", force)
    while own.event("live")["k"] < 750:  # a tick or two after a look of the thread
        pass
    own.signal(signal.SIGTERM)
    code, _, err = own.end()
    assert (code, force()) == (0, 0.0)
    assert "a driver or a library had taken SIGTERM for itself; taken back" in err
    assert any(event["what"] == "signals" for event in read_events(tmp_path / "s"))
    assert summary(tmp_path / "s")["sentence"].endswith("it was asked to stop (SIGTERM)")
    assert other.end()[0] == 0


@pytest.mark.parametrize("how", [
    "below Python", *[pytest.param(how, marks=FULL) for how in ("with its default", "with a handler")]])
def test_a_driver_that_took_signals_again_and_again_could_end_with_force_on(
    how: str, command: Make, tmp_path: Path
) -> None:
    """Each time it was taken back a tenth of a second later; a signal in between ended the process with 4.26 N on."""
    force = robot(tmp_path, "s", when=TAKES[how])
    own, other = pair(command)
    code, _, err = own.end()
    assert (code, force()) == (0, 0.0)
    assert err.count("had taken SIGTERM for itself") == MOST_TIMES + 1
    assert "SIGTERM for itself again and again" in summary(tmp_path / "s")["sentence"]
    assert other.end()[0] == 0


CLOSES = "[os.close(fd) for fd in range(3, 64) if fd != FILE and os.path.exists(f'/proc/self/fd/{fd}')]"


@pytest.mark.parametrize(("deafens", "act"), [
    pytest.param(CLOSES, "in C", id="closes files, in C", marks=FULL),
    pytest.param(f"{TAKES['with its default']}, {CLOSES}", "sleeps", id="takes the signal and closes files",
                 marks=FULL),
    pytest.param(f"resource.setrlimit(resource.RLIMIT_NOFILE, (3, 3)), {CLOSES}", "sleeps", id="leaves no files"),
    pytest.param("signal.set_wakeup_fd(-1)", "sleeps", id="takes the pipe"),
])
def test_a_driver_that_closed_the_pipe_of_signals_and_hung_was_ended_by_none(
    deafens: str, act: str, command: Make, tmp_path: Path
) -> None:
    """The thread of last resort waited for a handler that wrote to a closed file: 4.26 N on, whatever was sent."""
    force = robot(tmp_path, "s", HANGS[act], f"import resource; [{deafens}]; hang()")
    own, _ = pair(command, "s", force, hangs=True)
    own.signal(signal.SIGTERM)
    time.sleep(0.05)
    own.signal(signal.SIGTERM)
    assert force.until(lambda f: f == 0.0) < HUNG_S + 2.0
    code, _, err = own.end()
    assert (code, "its device was set to zero force" in err) == (1, True)


@pytest.mark.parametrize("kind", ["socket", pytest.param("", marks=FULL)])
def test_a_driver_that_closes_files_that_are_not_its_own_leaves_no_force(
    kind: str, command: Make, tmp_path: Path
) -> None:
    """The loop failed, and nothing of the way out was done: 4.26 N on, no status, no error.txt."""
    links = f"[fd for fd in range(3, 64) if fd != FILE and {kind!r} in link(fd)]"
    link = "link = lambda fd: os.path.exists(f'/proc/self/fd/{fd}') and os.readlink(f'/proc/self/fd/{fd}') or 'none'"
    force = robot(tmp_path, "s", where=f"{link}; [os.close(fd) for fd in {links} if link(fd) != 'none']")
    own, _ = pair(command, "s", force)
    code, _, err = own.end()
    assert (code, force()) == (1, 0.0)
    assert "the live loop raised OSError" in err
    assert "Traceback" not in err
    assert summary(tmp_path / "s")["status"] == "stopped"
    assert (tmp_path / "s" / "error.txt").exists()


def test_a_driver_that_closed_files_at_its_first_reading_ended_in_tracebacks(command: Make, tmp_path: Path) -> None:
    force = robot(tmp_path, "s", when="pass", where=CLOSES)
    text = (tmp_path / "robot.py").read_text().replace("k >= 500", "k == 0")
    (tmp_path / "robot.py").write_text(text)
    own = command("robot", *SCENE, "--listen", "127.0.0.1:0", "--json", "--out", "s")
    code, _, err = own.end()
    assert (code, force()) == (1, 0.0)
    assert "the first exchange raised OSError" in err
    assert "Traceback" not in err
    assert "Task" not in err
