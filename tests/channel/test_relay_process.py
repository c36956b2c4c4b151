"""`python -m channel` as a process between two sockets that stand for the ends, and what it says of itself."""

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

from channel import __main__ as command
from channel import parse_link
from teleop.protocol.packet import Kind, Packet, encode
from teleop.scene.library import ROOT
from tests.channel.site import MANIFEST
from tests.waiting import PATIENCE

pytestmark = pytest.mark.live


class Channel:
    def __init__(self, *arguments: str) -> None:
        self.master, self.slave, self.stranger = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(3))
        for sock in (self.master, self.slave, self.stranger):
            sock.bind(("127.0.0.1", 0))
            sock.settimeout(PATIENCE)
        own = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
        self.process = subprocess.Popen(
            [sys.executable, "-m", "channel", "canonical", "--listen", "127.0.0.1:0", "--json",
             "--peer", f"0.0.0.0:{self.slave.getsockname()[1]}", *arguments],
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

    def stop(self, number: signal.Signals) -> dict[str, Any]:
        """End it by a signal; what it counted."""
        self.process.send_signal(number)
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


def test_what_the_link_loses_is_lost_the_rest_comes_after_its_delay_and_the_next_session_has_a_link_of_its_own(
    channel: Callable[..., Channel]
) -> None:
    """Losses are drawn by packet number: they are those of the schedule, whenever the packets are sent.

    When nothing more of a session comes, another master may use the same channel, from another port.
    """
    text, count = "delay(0.15) | bernoulli(0.3)", 60
    one = channel("--link", text, "--seed", "9")
    for session, master in ((1, one.master), (2, one.stranger)):
        far = one.meet(session, master)
        began = time.monotonic()
        for k in range(count):
            master.sendto(message(session, k), one.near)
            one.slave.sendto(message(session, k), far)
        for direction, sock in ((0, one.slave), (1, master)):
            drawn = parse_link(text).arrivals(direction, count, 1_000_000, 9, 100).packet.tolist()
            got = [sock.recvfrom(65536)[0]]
            assert time.monotonic() - began >= 0.14
            got += all_of(sock, len(drawn) - 1)
            assert got == [message(session, k) for k in drawn]
            assert 10 < len(got) < count
        time.sleep(1.1)
    one.master.sendto(message(1, count), one.near)
    assert all_of(one.slave) == []
    counts = one.stop(signal.SIGTERM)["counts"]
    for way in ("fwd", "bwd"):
        assert counts[way]["received"] == 2 * (count + 2), "of both sessions; the first exchange is counted too"
        assert counts[way]["lost"] + counts[way]["delivered"] == 2 * (count + 2)


def test_only_the_two_ends_of_the_session_are_listened_to_and_numbers_that_the_scene_has(
    channel: Callable[..., Channel]
) -> None:
    """An unknown host that comes first does not hold it. Its peer is any address of this machine, which is the first:

    from there comes what answers; it is no slave elsewhere than was said, which the channel would tell of.
    """
    one = channel("--link", "none", "--set", "duration=0.05")
    for k in range(100):
        one.stranger.sendto(message(5, k), one.near)
    assert all_of(one.slave) == []
    far = one.meet(1)
    assert far[0] == "127.0.0.1"
    thrown = [
        message(5, 101), message(1, 7), message(2, 0), b"", b"garbage", bytes(9000), message(1, 1)[:-1] + b"x",
        encode(Packet(Kind.HELLO, 2, 0, 0, None, MANIFEST)), encode(Packet(Kind.HELLO, 1, 0, 0, None, MANIFEST)),
        encode(Packet(Kind.BYE, 1, 0, 0, None, "go")),
    ]
    for data in thrown:
        one.stranger.sendto(data, one.near)
        one.stranger.sendto(data, far)
    assert all_of(one.slave) == all_of(one.master) == all_of(one.stranger) == []
    for k in (*range(50), 50, 2**32 - 1):  # the scene has 50 ticks
        one.master.sendto(message(1, k), one.near)
    one.slave.sendto(message(1, 1), far)
    assert all_of(one.slave, 50) == [message(1, k) for k in range(50)]
    assert one.master.recvfrom(65536)[0] == message(1, 1)
    assert one.stop(signal.SIGINT)["foreign"] == 100 + 2 * len(thrown) + 2


def said_by(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, listen: str, *more: str) -> str:
    """What a channel says of itself before it relays: beyond this machine what is sealed alone, unless told not to."""
    def looked_at(shell: command.RelayShell, _interrupt: Any) -> None:
        assert shell.router._sealed_only is (listen.startswith("0.0.0.0") and "--insecure" not in more)

    monkeypatch.setattr(command.RelayShell, "run", looked_at)
    assert command.main(["canonical", "--no-realtime", "--listen", listen, "--peer", "127.0.0.1:9", *more]) == 0
    return capsys.readouterr().out.partition("\n")[0]


def test_the_link_is_shown_as_it_is_typed_and_the_master_started_with_the_scene_that_the_channel_was(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Typed as it says, the two ends have one manifest; the slave refuses any other."""
    said = said_by(capsys, monkeypatch, "127.0.0.1:0", "--link", "delay(0.05) | bernoulli(p=0.1)")
    assert said.startswith("channel: delay(0.05) | bernoulli(0.1); 127.0.0.1:")
    for given in ([], ["--insecure"], ["--set", "law=pfra", "--set", "law.kf = 0.2"],
                  ["--set", "duration=3", "--link", "delay(0.05) ; delay(0.2)"]):
        said = said_by(capsys, monkeypatch, "0.0.0.0:0", *given)
        typed = shlex.split(said.partition("start the master with: ")[2])
        assert typed[:4] == ["python", "-m", "master", "canonical"]
        at = typed.index("--peer")
        assert typed[4:at] == [word for word in given if word != "--insecure"]
        assert typed[at + 1].startswith("THIS-HOST:")
        keys = ["--key", "master.key", "--peer-fingerprint", "THE-SLAVES"]  # or this channel drops what it sends
        assert typed[at + 2 :] == (["--insecure"] if "--insecure" in given else keys)
