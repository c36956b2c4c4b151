"""What a live process prints: no reader that is slow, stopped or gone holds it up, and what is read is whole lines."""

from __future__ import annotations

import os
import pty
import signal
import socket
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from teleop.live.process.output import END_S, Output
from teleop.protocol.manifest import manifest_of
from teleop.protocol.packet import Kind, Packet, encode
from teleop.scene.library import ROOT
from teleop.scene.loading import load_scene
from tests.live.conftest import OWN, Command, summary
from tests.waiting import PATIENCE, free_port

pytestmark = pytest.mark.live
LINE = b"%05d " + b"x" * 90 + b"\n"


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    """The reading and the writing end."""
    ends = os.pipe()
    yield ends
    for fd in ends:
        with suppress(OSError):
            os.close(fd)


def fill(fd: int) -> None:
    """Write to a pipe until it takes no more."""
    os.set_blocking(fd, False)
    with suppress(BlockingIOError):
        while True:
            os.write(fd, b"x")
    os.set_blocking(fd, True)


def there(fd: int) -> bytes:
    """All that can be read now."""
    os.set_blocking(fd, False)
    got = b""
    with suppress(BlockingIOError):
        while part := os.read(fd, 1 << 16):
            got += part
    return got


def test_a_pipe_that_nothing_reads_holds_up_no_write_and_has_whole_lines_in_it(pipe: tuple[int, int]) -> None:
    output = Output(pipe[1])
    for k in range(10_000):
        assert output.write(LINE % k) == len(LINE % k)
    lines = there(pipe[0]).splitlines(keepends=True)
    assert lines == [LINE % k for k in range(len(lines))]
    assert output.dropped == 10_000 - len(lines) > 0
    assert os.get_blocking(pipe[1]), "the flag is shared with other processes"
    output.write(b"again\n")
    assert there(pipe[0]) == b"again\n"


def test_a_message_that_is_out_in_part_goes_on_before_the_next_one(pipe: tuple[int, int]) -> None:
    output = Output(pipe[1])
    long = b"a" * 300_000 + b"\n"
    output.write(long)
    output.write(b"dropped\n")
    got = there(pipe[0])
    while len(got) < len(long):
        output.flush()
        got += there(pipe[0])
    output.write(b"next\n")
    assert got + there(pipe[0]) == long + b"next\n"
    assert output.dropped == 1


def test_a_reader_that_is_gone_or_a_full_disk_raises_nothing_and_a_file_has_all_of_it(
    pipe: tuple[int, int], tmp_path: Path
) -> None:
    before = Output(pipe[1])
    os.close(pipe[0])
    for output in (before, Output(pipe[1])):  # it may have gone before this process began
        for k in range(100):
            output.write(LINE % k)
        output.flush()
    with (tmp_path / "file").open("wb") as file:
        output = Output(file.fileno())
        for k in range(1000):
            output.write(LINE % k)
    assert (tmp_path / "file").read_bytes() == b"".join(LINE % k for k in range(1000))
    if Path("/dev/full").exists():
        with Path("/dev/full").open("wb") as full:
            Output(full.fileno()).write(b"x")


def test_a_terminal_that_is_paused_or_a_socket_that_nothing_reads_holds_up_no_write() -> None:
    """Service managers give their services sockets to write to."""
    ours, its = pty.openpty()
    output = Output(its)
    assert output.isatty()
    termios.tcflow(its, termios.TCOOFF)
    for k in range(5000):
        output.write(LINE % k)
    assert output.dropped > 0
    for fd in (ours, its):
        os.close(fd)
    reads, writes = socket.socketpair()
    output = Output(writes.fileno())
    for k in range(20_000):
        output.write(LINE % k)
    assert output.dropped > 0
    reads.close()
    output.write(LINE % 1)
    writes.close()


def test_last_words_wait_for_a_reader_that_comes_and_not_for_ever_for_one_that_does_not(pipe: tuple[int, int]) -> None:
    output, got = Output(pipe[1]), []
    fill(pipe[1])
    output.wait(PATIENCE)
    reader = threading.Thread(target=lambda: got.append(os.read(pipe[0], 1 << 20)))
    reader.start()
    output.write(b"the end\n")
    reader.join()
    assert output.dropped == 0
    assert there(pipe[0]).endswith(b"the end\n")
    fill(pipe[1])
    output.wait(0.2)
    began = time.monotonic()
    output.write(b"dropped\n")
    assert time.monotonic() - began >= 0.15
    assert output.dropped == 1


@pytest.mark.skipif(not hasattr(os, "setsid"), reason="needs terminals as POSIX has them")
def test_a_process_in_the_background_of_a_terminal_is_not_stopped_by_its_own_line() -> None:
    """With `stty tostop` a terminal stops whoever writes to it from the background: a force would be held for good."""
    code = """
import fcntl, os, signal, subprocess, sys, termios
signal.signal(signal.SIGTTOU, signal.SIG_DFL)  # whatever this process was started with
os.setsid()
its = os.open(sys.argv[1], os.O_RDWR)
fcntl.ioctl(its, termios.TIOCSCTTY, 0)
now = termios.tcgetattr(its)
now[3] |= termios.TOSTOP
termios.tcsetattr(its, termios.TCSANOW, now)
where = {"live": "teleop.live.process.output import live",
         "plain": "contextlib import nullcontext as live"}[sys.argv[2]]
said = f"from {where}\\nwith live():\\n print('here', flush=True)"
child = subprocess.Popen([sys.executable, "-c", said], stdout=its, process_group=0)
_, status = os.waitpid(child.pid, os.WUNTRACED)
child.kill()
sys.exit(3 if os.WIFSTOPPED(status) else os.waitstatus_to_exitcode(status))
"""
    for how, expected in (("plain", 3), ("live", 0)):
        ours, its = pty.openpty()
        done = subprocess.run([sys.executable, "-c", code, os.ttyname(its), how], cwd=ROOT, check=False,
                              timeout=PATIENCE)
        assert done.returncode == expected
        os.close(ours)
        os.close(its)


class Unread:
    """What a process writes to where nothing reads: a pipe that is full, or one without a reader."""

    def __init__(self, how: str) -> None:
        self.reading, self.writing = os.pipe()
        if how == "full":
            fill(self.writing)
        else:
            os.close(self.reading)

    def close(self) -> None:
        for fd in (self.reading, self.writing):
            with suppress(OSError):
                os.close(fd)


@pytest.fixture(params=["full", pytest.param("gone", marks=pytest.mark.full)])
def unread(request: pytest.FixtureRequest) -> Iterator[Unread]:
    made = Unread(request.param)
    yield made
    made.close()


@pytest.fixture
def start(command: Callable[..., Command], unread: Unread) -> Callable[..., subprocess.Popen[str]]:
    """`start("slave", ...)`: a process all of whose output goes unread."""
    return lambda *words: command(*words, stdout=unread.writing, stderr=unread.writing).process


def hello(number: int, **knobs: Any) -> bytes:
    manifest = {**manifest_of(load_scene("canonical", **{"playout": "integral", **knobs})), "mode": "live"}
    return encode(Packet(Kind.HELLO, number, 0, 0, None, manifest), 2000)


def asked(sock: socket.socket, port: int, data: bytes) -> bytes:
    """Send until there is an answer; the answer."""
    sock.settimeout(0.1)
    until = time.monotonic() + PATIENCE
    while time.monotonic() < until:
        sock.sendto(data, ("127.0.0.1", port))
        with suppress(TimeoutError, ConnectionRefusedError):
            return sock.recvfrom(65536)[0]
    pytest.fail("no answer came")


def ends(process: subprocess.Popen[str]) -> int:
    """Ask it to end; its exit code. It waits for a reader, but not for long."""
    process.send_signal(signal.SIGTERM)
    return process.wait(END_S + PATIENCE)


def test_an_unknown_hosts_hello_neither_ends_nor_hangs_a_channel_whose_output_nothing_reads(
    start: Callable[..., subprocess.Popen[str]]
) -> None:
    """It says that the hello is of another scene, and goes on relaying."""
    with (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as unknown,
          socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as slave):
        slave.bind(("127.0.0.1", 0))
        slave.settimeout(0.1)
        port = free_port()
        one = start("channel", "canonical", "--listen", f"127.0.0.1:{port}", "--peer",
                    f"127.0.0.1:{slave.getsockname()[1]}")
        until, came = time.monotonic() + PATIENCE, 0
        while came < 20 and time.monotonic() < until:
            unknown.sendto(hello(5 + came, duration=3.0), ("127.0.0.1", port))
            with suppress(TimeoutError):
                slave.recvfrom(65536)
                came += 1
        assert came == 20
    assert one.poll() is None
    assert ends(one) == 0


def test_an_unknown_hosts_datagram_neither_ends_nor_hangs_a_slave_whose_output_nothing_reads(
    start: Callable[..., subprocess.Popen[str]]
) -> None:
    """After two seconds it says why no master was let in, and goes on listening."""
    port = free_port()
    one = start("slave", "canonical", "--listen", f"127.0.0.1:{port}")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        assert asked(sock, port, hello(7))
        until = time.monotonic() + 2.6
        while time.monotonic() < until:
            sock.sendto(b"no packet of ours", ("127.0.0.1", port))
            time.sleep(0.05)
        assert asked(sock, port, hello(7))
    assert one.poll() is None
    assert ends(one) == 130


CLOSES = "import os, sys; [os.close(int(n)) for n in sys.argv[1].split()]; os.execv(sys.executable, sys.argv[2:])"


@pytest.mark.parametrize(("at_slave", "at_master"), [("1 2", "gone"), *[
    pytest.param(*each, marks=pytest.mark.full) for each in (("gone", "1 2"), ("full", "full"), ("1", "2"))]])
def test_two_ends_whose_output_nothing_reads_or_whose_streams_are_closed_run_to_their_end(
    at_slave: str, at_master: str, tmp_path: Path
) -> None:
    """As under a service manager. What cannot be said ended the run, at both ends; the run and its record are whole."""
    port, scene, both = free_port(), ["hard_wall", "--set", "duration=0.7", "--link", "none"], []
    for name, how, words in (("slave", at_slave, ["--listen", f"127.0.0.1:{port}", "--json"]),
                             ("master", at_master, ["--peer", f"127.0.0.1:{port}", "--wait", f"{PATIENCE}"])):
        closes, out = ([], Unread(how)) if how in ("gone", "full") else (["-c", CLOSES, how, sys.executable], None)
        stream = None if out is None else out.writing
        both.append(subprocess.Popen([sys.executable, *closes, "-m", name, *scene, *words, "--out", name], cwd=tmp_path,
                                     env=OWN, stdout=stream, stderr=stream))
        if out is not None and how == "gone":
            out.close()
    assert [one.wait(PATIENCE) for one in both] == [0, 0]
    for name in ("slave", "master"):
        told = summary(tmp_path / name)
        assert told["status"] == "ok"
        assert told["ticks"] + told[name]["skipped"] == 700


@pytest.mark.parametrize(("unread", "form"), [
    ("gone", []), *[pytest.param(*each, marks=pytest.mark.full) for each in (
        ("full", ["--json"]), ("full", []), ("gone", ["--json"]))]], indirect=["unread"])
def test_a_demo_whose_output_nothing_reads_runs_to_its_end(
    form: list[str], start: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    """It reads what its processes say all the while, though nothing reads what it says itself."""
    one = start("scenarios", "demo", "hard_wall", "--set", "duration=0.5", "--out", "out", *form)
    assert one.wait(PATIENCE) == 0
    assert summary(tmp_path / "out")["status"] == "ok"
