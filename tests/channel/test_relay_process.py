"""`python -m channel` as a process between two sockets that stand for the ends."""

from __future__ import annotations

import json
import os
import shlex
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from channel.link import parse_link
from teleop.protocol.manifest import manifest_of
from teleop.protocol.packet import Kind, Packet, encode
from teleop.scene.library import ROOT
from teleop.scene.loading import load_scene
from tests.waiting import PATIENCE

pytestmark = pytest.mark.live
MANIFEST = manifest_of(load_scene("canonical"))
Words = tuple[str, ...]


class Channel:
    """The process, and a socket for each end."""

    def __init__(self, *arguments: str) -> None:
        self.master, self.slave, self.stranger = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(3))
        for sock in (self.master, self.slave, self.stranger):
            sock.bind(("127.0.0.1", 0))
            sock.settimeout(PATIENCE)
        own = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
        self.process = subprocess.Popen(
            [sys.executable, "-m", "channel", "canonical", "--listen", "127.0.0.1:0", "--json",
             "--peer", f"127.0.0.1:{self.slave.getsockname()[1]}", *arguments],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**own, "PYTHONPATH": str(ROOT)},
        )
        assert self.process.stdout is not None
        self.near = ("127.0.0.1", int(json.loads(self.process.stdout.readline())["port"]))

    def meet(self, session: int, master: socket.socket | None = None) -> tuple[str, int]:
        """The first exchange goes through; where the slave sees the channel."""
        master = master or self.master
        hello, welcome = (encode(Packet(kind, session, 0, 0, None, MANIFEST)) for kind in (Kind.HELLO, Kind.WELCOME))
        start = encode(Packet(Kind.START, session, 0, 0, None, 0))
        far = ("", 0)
        for asked, answer in ((hello, welcome), (start, start)):
            master.sendto(asked, self.near)
            data, far = self.slave.recvfrom(65536)
            assert data == asked
            self.slave.sendto(answer, far)
            assert master.recvfrom(65536)[0] == answer
        return far[0], far[1]

    def stop(self) -> dict[str, Any]:
        """Ask it to end; what it counted."""
        self.process.send_signal(signal.SIGTERM)
        out, err = self.process.communicate(timeout=PATIENCE)
        assert self.process.returncode == 0
        # A test's HELLO may be of another duration than its channel.
        assert all(line.startswith("channel: the master runs another scene") for line in err.splitlines()), err
        told: dict[str, Any] = json.loads(out.splitlines()[-1])["summary"]
        return told

    def close(self) -> None:
        self.process.kill()
        self.process.communicate()
        for sock in (self.master, self.slave, self.stranger):
            sock.close()


@pytest.fixture
def channel() -> Iterator[Callable[..., Channel]]:
    started: list[Channel] = []

    def start(*arguments: str) -> Channel:
        started.append(Channel(*arguments))
        return started[-1]

    yield start
    for one in started:
        one.close()


def message(session: int, number: int) -> bytes:
    return encode(Packet(Kind.FORTH, session, number, 0, None, (float(number),), 0.0), 100)


def all_of(sock: socket.socket, expected: int = 0) -> list[bytes]:
    """What comes in until nothing more does. So many are waited for with patience, what is too much for 0.3 s."""
    got = [sock.recvfrom(65536)[0] for _ in range(expected)]
    sock.settimeout(0.3)
    try:
        while True:
            got.append(sock.recvfrom(65536)[0])
    except TimeoutError:
        sock.settimeout(PATIENCE)
        return got


def test_what_the_link_loses_is_lost_and_the_rest_comes_after_its_delay(channel: Callable[..., Channel]) -> None:
    """Losses are drawn by packet number: they are those of the schedule, whenever the packets are sent."""
    text, count = "delay(0.15) | bernoulli(0.3)", 60
    one = channel("--link", text, "--seed", "9")
    far = one.meet(1)
    began = time.monotonic()
    for k in range(count):
        one.master.sendto(message(1, k), one.near)
        one.slave.sendto(message(1, k), far)
    for direction, sock in ((0, one.slave), (1, one.master)):
        drawn = parse_link(text).arrivals(direction, count, 1_000_000, 9, 100).packet.tolist()
        got = [sock.recvfrom(65536)[0]]
        assert time.monotonic() - began >= 0.14
        got += all_of(sock, len(drawn) - 1)
        assert got == [message(1, k) for k in drawn]
        assert 10 < len(got) < count
    counts = one.stop()["counts"]
    for way in ("fwd", "bwd"):
        assert counts[way]["received"] == count + 2  # the first exchange is counted too
        assert counts[way]["lost"] + counts[way]["delivered"] == count + 2


def test_without_a_link_everything_passes(channel: Callable[..., Channel]) -> None:
    one = channel("--link", "none")
    one.meet(1)
    sent = [message(1, k) for k in range(50)]
    for data in sent:
        one.master.sendto(data, one.near)
    assert all_of(one.slave, len(sent)) == sent


def test_only_the_two_ends_of_the_session_are_listened_to(channel: Callable[..., Channel]) -> None:
    one = channel("--link", "delay(0.001)")
    far = one.meet(1)
    one.master.sendto(message(1, 0), one.near)
    assert one.slave.recvfrom(65536)[0] == message(1, 0)
    thrown = [
        message(1, 7), message(2, 0), b"", b"garbage", bytes(9000), message(1, 1)[:-1] + b"x",
        encode(Packet(Kind.HELLO, 2, 0, 0, None, MANIFEST)), encode(Packet(Kind.HELLO, 1, 0, 0, None, MANIFEST)),
        encode(Packet(Kind.BYE, 1, 0, 0, None, "go")),
    ]
    for data in thrown:
        one.stranger.sendto(data, one.near)
        one.stranger.sendto(data, far)
    assert all_of(one.slave) == all_of(one.master) == all_of(one.stranger) == []
    one.master.sendto(message(1, 1), one.near)
    one.slave.sendto(message(1, 1), far)
    assert one.slave.recvfrom(65536)[0] == message(1, 1)
    assert one.master.recvfrom(65536)[0] == message(1, 1)
    assert one.stop()["foreign"] == 2 * len(thrown)


def test_a_packet_number_that_no_tick_of_the_scene_has_is_foreign(channel: Callable[..., Channel]) -> None:
    one = channel("--link", "delay(0.001)", "--set", "duration=0.05")
    one.meet(1)
    for k in (0, 49, 50, 2**32 - 1):
        one.master.sendto(message(1, k), one.near)
    assert all_of(one.slave, 2) == [message(1, 0), message(1, 49)]
    assert one.stop()["foreign"] == 2


@pytest.mark.parametrize("link", [
    "gilbert_elliott(0.1, 0.3)", "in_order()", "duplicate(0.5) | uniform(0.01)", "blackout(0.1, 0.1)",
])
def test_copies_and_numbers_that_go_back_do_not_end_it(link: str, channel: Callable[..., Channel]) -> None:
    one = channel("--link", f"delay(0.001) | {link}")
    one.meet(1)
    for k in (5, 3, 3, 4000, 0, 5, 2, 9999, 1):
        one.master.sendto(message(1, k), one.near)
    all_of(one.slave)
    one.stop()


def test_the_link_is_shown_as_it_is_typed() -> None:
    command = [sys.executable, "-m", "channel", "canonical", "--listen", "127.0.0.1:0", "--peer", "127.0.0.1:9",
               "--link", "delay(0.05) | bernoulli(p=0.1)"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("channel: delay(0.05) | bernoulli(0.1); 127.0.0.1:")
        process.terminate()


@pytest.mark.parametrize("given", [
    [], ["--insecure"], ["--set", "law=pfra", "--set", "law.kf = 0.2"],
    ["--set", "duration=3", "--link", "delay(0.05) ; delay(0.2)"],
])
def test_the_master_is_started_with_the_scene_that_the_channel_was(given: list[str]) -> None:
    """Typed as it says, the two ends have one manifest; the slave refuses any other."""
    command = [sys.executable, "-m", "channel", "canonical", "--listen", "0.0.0.0:0", "--peer", "127.0.0.1:9", *given]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) as process:
        assert process.stdout is not None
        said = process.stdout.readline()
        process.terminate()
    typed = shlex.split(said.partition("start the master with: ")[2])
    assert typed[:4] == ["python", "-m", "master", "canonical"]
    at = typed.index("--peer")
    assert typed[4:at] == [word for word in given if word != "--insecure"]
    assert typed[at + 1].startswith("THIS-HOST:")
    keys = ["--key", "master.key", "--peer-fingerprint", "THE-SLAVES"]
    assert typed[at + 2 :] == (["--insecure"] if "--insecure" in given else keys)  # or this channel drops what it sends


def test_any_address_of_this_machine_as_its_peer_is_the_first(channel: Callable[..., Channel]) -> None:
    """From there comes what answers; it is no slave elsewhere than was said, which the channel would tell of."""
    one = channel("--link", "none")
    own = one.slave.getsockname()[1]
    other = channel("--link", "none", "--peer", f"0.0.0.0:{own}")  # (that of the first one's slave)
    hello = encode(Packet(Kind.HELLO, 1, 0, 0, None, MANIFEST))
    one.master.sendto(hello, other.near)
    data, far = one.slave.recvfrom(65536)
    assert (data, far[0]) == (hello, "127.0.0.1")
    one.slave.sendto(encode(Packet(Kind.WELCOME, 1, 0, 0, None, MANIFEST)), far)
    one.master.recvfrom(65536)
    other.stop()


def test_an_unknown_host_that_comes_first_does_not_hold_it(channel: Callable[..., Channel]) -> None:
    """With messages of no session, that never end: they are not passed on, and the master's HELLO opens the way."""
    one = channel("--link", "none")
    for k in range(100):
        one.stranger.sendto(message(5, k), one.near)
    assert all_of(one.slave) == []
    one.meet(1)
    one.stranger.sendto(message(5, 101), one.near)
    one.master.sendto(message(1, 0), one.near)
    assert all_of(one.slave, 1) == [message(1, 0)]


def test_the_next_session_finds_fresh_water(channel: Callable[..., Channel]) -> None:
    """When nothing more of a session comes, another master may use the same channel, from another port."""
    one = channel("--link", "delay(0.02) | bernoulli(0.4)", "--seed", "4")
    drawn = parse_link("delay(0.02) | bernoulli(0.4)").arrivals(0, 40, 1_000_000, 4, 100).packet.tolist()
    assert 10 < len(drawn) < 40
    one.meet(1)
    for k in range(40):
        one.master.sendto(message(1, k), one.near)
    assert len(all_of(one.slave, len(drawn))) == len(drawn)
    time.sleep(1.1)
    one.meet(2, one.stranger)
    for k in range(40):
        one.stranger.sendto(message(2, k), one.near)
    assert len(all_of(one.slave, len(drawn))) == len(drawn)
    one.master.sendto(message(1, 41), one.near)
    assert all_of(one.slave) == []
    assert one.stop()["counts"]["fwd"]["received"] == 84, "of both sessions"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_with_what_it_counted(number: signal.Signals, channel: Callable[..., Channel]) -> None:
    one = channel("--link", "delay(0.001)")
    one.process.send_signal(number)
    out, err = one.process.communicate(timeout=PATIENCE)
    assert (one.process.returncode, err) == (0, "")
    assert json.loads(out)["summary"]["foreign"] == 0


@pytest.mark.parametrize(("arguments", "words"), [
    (("--link", "dely(1)"), ["dely", "did you mean delay?"]),
    (("--peer", "nowhere"), ["--peer takes HOST:PORT"]),
    (("--peer", "127.0.0.1:0"), ["--peer needs the port"]),
    (("--set", "delay=soon"), ["delay"]),
])
def test_a_wrong_request_is_one_sentence(arguments: Words, words: list[str]) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "channel", "canonical", "--listen", "127.0.0.1:0", "--peer", "127.0.0.1:9", *arguments],
        capture_output=True, text=True, cwd=ROOT, check=False, timeout=PATIENCE,
    )
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    for word in words:
        assert word in done.stderr
