"""`python -m channel` as a process between two sockets that stand for the ends, and what it says of itself."""

from __future__ import annotations

import json
import os
import shlex
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest

from channel import __main__ as command
from teleop.protocol.packet import Kind, Packet, encode
from teleop.scene.library import ROOT
from tests.channel.site import MANIFEST
from tests.waiting import PATIENCE

pytestmark = pytest.mark.live


@pytest.fixture
def ends() -> Iterator[list[socket.socket]]:
    """A socket for the master, for the slave and for a stranger."""
    made = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(3)]
    for sock in made:
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(PATIENCE)
    yield made
    for sock in made:
        sock.close()


@pytest.fixture
def channel(ends: list[socket.socket]) -> Iterator[subprocess.Popen[str]]:
    """The process, of a scene of 50 ticks, between these ends."""
    own = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    started = subprocess.Popen(
        [sys.executable, "-m", "channel", "canonical", "--listen", "127.0.0.1:0", "--json", "--link", "none",
         "--peer", f"0.0.0.0:{ends[1].getsockname()[1]}", "--set", "duration=0.05"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**own, "PYTHONPATH": str(ROOT)})
    yield started
    started.kill()
    started.communicate()


def word(kind: Kind, session: int, payload: Any = MANIFEST) -> bytes:
    return encode(Packet(kind, session, 0, 0, None, payload))


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


def test_only_the_two_ends_of_the_session_are_listened_to_and_numbers_that_the_scene_has(
    ends: list[socket.socket], channel: subprocess.Popen[str]
) -> None:
    """An unknown host that comes first does not hold it. Its peer is any address of this machine, which is the first:

    from there comes what answers; it is no slave elsewhere than was said, which the channel would tell of.
    """
    master, slave, stranger = ends
    assert channel.stdout is not None
    near, far = ("127.0.0.1", int(json.loads(channel.stdout.readline())["port"])), ("", 0)
    for k in range(100):
        stranger.sendto(message(5, k), near)
    assert all_of(slave) == []
    start = word(Kind.START, 1, 0)
    for asked, answer in ((word(Kind.HELLO, 1), word(Kind.WELCOME, 1)), (start, start)):
        master.sendto(asked, near)
        data, far = slave.recvfrom(65536)
        assert (data, far[0]) == (asked, "127.0.0.1")
        slave.sendto(answer, far)
        assert master.recvfrom(65536)[0] == answer
    thrown = [message(5, 101), message(1, 7), message(2, 0), b"", b"garbage", bytes(9000), message(1, 1)[:-1] + b"x",
              word(Kind.HELLO, 2), word(Kind.HELLO, 1), word(Kind.BYE, 1, "go")]
    for data in thrown:
        stranger.sendto(data, near)
        stranger.sendto(data, far)
    assert all_of(slave) == all_of(master) == all_of(stranger) == []
    for k in (*range(50), 50, 2**32 - 1):  # the scene has 50 ticks
        master.sendto(message(1, k), near)
    slave.sendto(message(1, 1), far)
    assert all_of(slave, 50) == [message(1, k) for k in range(50)]
    assert master.recvfrom(65536)[0] == message(1, 1)
    channel.send_signal(signal.SIGINT)
    out, err = channel.communicate(timeout=PATIENCE)
    assert channel.returncode == 0
    # The HELLO may be of another duration than the channel.
    assert all(line.startswith("channel: the master runs another scene") for line in err.splitlines()), err
    assert json.loads(out.splitlines()[-1])["summary"]["foreign"] == 100 + 2 * len(thrown) + 2


def said_by(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, listen: str, *more: str) -> str:
    """What a channel says of itself before it relays: beyond this machine what is sealed alone, unless told not to."""
    def looked_at(shell: command.RelayShell, _interrupt: Any) -> None:
        assert shell.router._sealed_only is (listen.startswith("0.0.0.0") and "--insecure" not in more)
        assert shell.router._seed == 9 * ("--seed" in more)

    monkeypatch.setattr(command.RelayShell, "run", looked_at)
    assert command.main(["canonical", "--no-realtime", "--listen", listen, "--peer", "127.0.0.1:9", *more]) == 0
    return capsys.readouterr().out.partition("\n")[0]


def test_the_link_is_shown_as_it_is_typed_and_the_master_started_with_the_scene_that_the_channel_was(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Typed as it says, the two ends have one manifest; the slave refuses any other."""
    said = said_by(capsys, monkeypatch, "127.0.0.1:0", "--link", "delay(0.05) | bernoulli(p=0.1)", "--seed", "9")
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
