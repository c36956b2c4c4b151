"""Two ends with keys: sealed, each letting in the other and nobody else; and without keys not beyond this machine."""

from __future__ import annotations

import signal
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from select import select
from threading import Event, Thread
from typing import Any

import numpy as np
import pytest

from tests.live.conftest import share_received, summary

pytest.importorskip("OpenSSL")
from teleop.protocol.secure.association import Association
from teleop.protocol.secure.keys import keygen, load_key  # (with the extra alone)

pytestmark = pytest.mark.live
SCENE = ["hard_wall", "--set", "duration=0.5", "--json"]


@pytest.fixture
def keys(tmp_path: Path) -> dict[str, tuple[str, str]]:
    """Of three ends: the file and the fingerprint."""
    made = {name: keygen(tmp_path / name) for name in ("master", "slave", "stranger")}
    return {name: (str(path), fingerprint) for name, (path, fingerprint) in made.items()}


def has(keys: dict[str, tuple[str, str]], own: str, peer: str) -> list[str]:
    return ["--key", keys[own][0], "--peer-fingerprint", keys[peer][1]]


def test_two_ends_with_keys_run_sealed(
    command: Callable[..., Any], keys: dict[str, tuple[str, str]], tmp_path: Path
) -> None:
    slave = command("slave", *SCENE, "--link", "none", "--listen", "127.0.0.1:0", *has(keys, "slave", "master"),
                    "--out", str(tmp_path / "s"))
    master = command("master", *SCENE, "--link", "none", "--peer", f"127.0.0.1:{slave.port()}",
                     *has(keys, "master", "slave"), "--out", str(tmp_path / "m"))
    for end in (master, slave):
        code, out, err = end.end()
        assert code == 0, (out, err)
    for name, folder in (("master", "m"), ("slave", "s")):
        told = summary(tmp_path / folder)
        assert told["status"] == "ok"
        assert told[name]["sealed"] is True
        assert told[name]["associations"] == 1
        assert not told["packets"]["bwd" if name == "master" else "fwd"]["rejected"]
        assert keys[name][0] in " ".join(told["command"])  # the file's name, and nothing of what is in it
        assert "PRIVATE" not in (tmp_path / folder / "summary.json").read_text()
    assert share_received(tmp_path / "m", tmp_path / "s") > 0.8
    assert share_received(tmp_path / "s", tmp_path / "m") > 0.8


def test_they_meet_through_a_channel_that_loses_doubles_and_reorders(
    command: Callable[..., Any], keys: dict[str, tuple[str, str]], tmp_path: Path
) -> None:
    scene = [*SCENE, "--link", "delay(0.005) | uniform(0.01) | bernoulli(0.3) | duplicate(0.1, after=0.002)"]
    slave = command("slave", *scene, "--listen", "127.0.0.1:0", *has(keys, "slave", "master"),
                    "--out", str(tmp_path / "s"))
    channel = command("channel", *scene, "--listen", "127.0.0.1:0", "--peer", f"127.0.0.1:{slave.port()}")
    master = command("master", *scene, "--peer", f"127.0.0.1:{channel.port()}", *has(keys, "master", "slave"),
                     "--out", str(tmp_path / "m"), "--wait", "25")
    for end in (master, slave):
        code, out, err = end.end()
        assert code == 0, (out, err)
    assert 0.5 < share_received(tmp_path / "m", tmp_path / "s") < 0.9
    assert summary(tmp_path / "m")["master"]["sealed"] is True


@pytest.mark.parametrize(("called", "channels"), [
    ("127.0.0.2", 1), *[pytest.param(*each, marks=pytest.mark.full) for each in (("127.0.0.2", 0), ("0.0.0.0", 0))]])
def test_a_slave_that_answers_from_another_address_of_its_host_is_met(
    called: str, channels: int, command: Callable[..., Any], keys: dict[str, tuple[str, str]], tmp_path: Path
) -> None:
    """A slave on 0.0.0.0 does, if it is called by another address than the system would choose for an answer."""
    scene = [*SCENE, "--link", "none"]
    slave = command("slave", *scene, "--listen", "0.0.0.0:0", *has(keys, "slave", "master"),
                    "--out", str(tmp_path / "s"))
    to = f"{called}:{slave.port()}"
    for _ in range(channels):
        to = f"127.0.0.1:{command('channel', *scene, '--listen', '127.0.0.1:0', '--peer', to).port()}"
    master = command("master", *scene, "--peer", to, *has(keys, "master", "slave"), "--out", str(tmp_path / "m"))
    for end in (master, slave):
        code, out, err = end.end()
        assert code == 0, (out, err)
    assert share_received(tmp_path / "m", tmp_path / "s") > 0.8


@pytest.mark.parametrize("wrong", ["master", pytest.param("slave", marks=pytest.mark.full)])
def test_an_end_with_another_key_is_not_let_in(
    wrong: str, command: Callable[..., Any], keys: dict[str, tuple[str, str]], tmp_path: Path
) -> None:
    """The stranger knows the fingerprint that it should have, and has not the key to it."""
    own = {name: "stranger" if name == wrong else name for name in ("master", "slave")}
    slave = command("slave", *SCENE, "--listen", "127.0.0.1:0", *has(keys, own["slave"], "master"), "--wait", "3",
                    "--out", str(tmp_path / "s"))
    master = command("master", *SCENE, "--peer", f"127.0.0.1:{slave.port()}", *has(keys, own["master"], "slave"),
                     "--wait", "3", "--out", str(tmp_path / "m"))
    for end in (master, slave):
        end.refused("in 3 s")
    assert not (tmp_path / "s").exists()
    assert not (tmp_path / "m").exists()


def test_what_goes_in_the_open_all_the_same_says_so_loudly(command: Callable[..., Any], tmp_path: Path) -> None:
    slave = command("slave", *SCENE, "--link", "none", "--listen", "0.0.0.0:0", "--insecure",
                    "--out", str(tmp_path / "s"))
    master = command("master", *SCENE, "--link", "none", "--peer", f"127.0.0.1:{slave.port()}",
                     "--out", str(tmp_path / "m"))
    assert master.end()[0] == 0
    code, _, err = slave.end()
    assert code == 0
    assert "INSECURE" in err
    assert any("--insecure" in note for note in summary(tmp_path / "s")["notes"])
    assert not any("--insecure" in note for note in summary(tmp_path / "m")["notes"])


def test_a_sender_without_the_key_does_not_keep_the_pinned_master_out(
    command: Callable[..., Any], keys: dict[str, tuple[str, str]], tmp_path: Path
) -> None:
    """2,000 datagrams a second from 64 ports, hellos with good cookies most of them, at 0.1 s of round trip."""
    scene = [*SCENE, "--link", "delay(0.05)"]
    slave = command("slave", *scene, "--listen", "127.0.0.1:0", *has(keys, "slave", "master"),
                    "--out", str(tmp_path / "s"))
    port = slave.port()
    channel = command("channel", *scene, "--listen", "127.0.0.1:0", "--peer", f"127.0.0.1:{port}")
    with flooded(port, keys) as thrown:
        master = command("master", *scene, "--peer", f"127.0.0.1:{channel.port()}", *has(keys, "master", "slave"),
                         "--out", str(tmp_path / "m"))
        for end in (master, slave):
            code, out, err = end.end()
            assert code == 0, (out, err)
    assert thrown[0] > 0
    assert summary(tmp_path / "s")["packets"]["fwd"]["received"] > 100


def test_an_observer_whose_copies_come_first_draws_nothing_to_itself_even_after_an_outage(
    command: Callable[..., Any], keys: dict[str, tuple[str, str]], tmp_path: Path
) -> None:
    """It kept two ends from meeting for as long as it copied, and after 1.4 s of silence for good."""
    scene = ["hard_wall", "--set", "duration=600", "--link", "none", "--json"]
    slave = command("slave", *scene, "--listen", "127.0.0.1:0", *has(keys, "slave", "master"),
                    "--out", str(tmp_path / "s"))
    with observer(slave.port()) as (at, silent):
        master = command("master", *scene, "--peer", f"127.0.0.1:{at}", *has(keys, "master", "slave"),
                         "--out", str(tmp_path / "m"))
        ends = {"m": master, "s": slave}
        for end in ends.values():
            end.live(lambda numbers: numbers["gain"] == 1.0 and numbers["delay"] is not None)
        silent.set()
        let_go = {e: end.live(lambda numbers: numbers["gain"] == 0.0)["k"] for e, end in ends.items()}
        time.sleep(1.4)
        silent.clear()
        for end in ends.values():
            end.live(lambda numbers: numbers["gain"] == 1.0)
        master.signal(signal.SIGTERM)
        for end in ends.values():
            code, out, err = end.end()
            assert code == 0, (out, err)
    for e, k in let_go.items():
        with np.load(tmp_path / e / "trace.npz") as trace:
            assert trace[f"seq_{e}"][trace["t"] > k * 1e-3].max() > k, "what was sent after the outage is played"


@contextmanager
def observer(slave: int) -> Iterator[tuple[int, Event]]:
    """A network between two ends, in which an observer's copy of each datagram comes before it, from another port.

    What is sent to the observer's own ports is kept. The master's port to ask, and an event: set, nothing passes.
    """
    near, far, near_copy, far_copy = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(4))
    silent, over = Event(), Event()
    for sock in (near, far, near_copy, far_copy):
        sock.bind(("127.0.0.1", 0))
    home: list[Any] = [None]

    def pass_on() -> None:
        while not over.is_set():
            for sock in select([near, far], [], [], 0.05)[0]:
                data, sender = sock.recvfrom(4096)
                if sock is near:
                    home[0] = sender
                copy, own, to = (far_copy, far, ("127.0.0.1", slave)) if sock is near else (near_copy, near, home[0])
                if not silent.is_set() and to is not None:
                    copy.sendto(data, to)
                    own.sendto(data, to)

    thread = Thread(target=pass_on)
    thread.start()
    try:
        yield near.getsockname()[1], silent
    finally:
        over.set()
        thread.join()
        for sock in (near, far, near_copy, far_copy):
            sock.close()


@contextmanager
def flooded(port: int, keys: dict[str, tuple[str, str]]) -> Iterator[list[int]]:
    """An end that listens on loopback, while 64 ports ask it for cookies and bring them back; how many they sent."""
    stranger, thrown, over = load_key(keys["stranger"][0]), [0], Event()

    def fire() -> None:
        sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(64)]
        says: list[bytes] = []
        for sock in sockets:
            sock.connect(("127.0.0.1", port))
            sock.settimeout(1.0)
            association = Association.towards(stranger, keys["slave"][1], 0)
            (hello,) = association.begin(0)
            sock.send(hello)
            (says_again,) = association.receive(sock.recv(2048), 0)[1]
            says.append(says_again)
        while not over.wait(0.01):
            for i in range(20):
                at = (thrown[0] + i) % 64
                with suppress(OSError):
                    sockets[at].send(says[at])
            thrown[0] += 20
        for sock in sockets:
            sock.close()

    thread = Thread(target=fire)
    thread.start()
    try:
        yield thrown
    finally:
        over.set()
        thread.join()
