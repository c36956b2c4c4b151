"""Timer, socket, addresses, signals: the parts that the live loops are made of."""

from __future__ import annotations

import ctypes
import os
import signal
import socket
import threading
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from teleop.errors import Refused
from teleop.live.net.wire import Wire, address, bind_udp, host_port, peer_address
from teleop.live.process.interrupt import Interrupt
from tests.waiting import PATIENCE

pytestmark = pytest.mark.live


# The wire


def test_what_cannot_be_sent_is_counted_and_what_is_not_there_is_none() -> None:
    wire = Wire(bind_udp(("127.0.0.1", 0), "--listen"), None)
    with wire.sock:
        wire.send(b"to nobody")
        assert wire.receive() is None
        wire.peer = ("127.0.0.1", 9)
        wire.send(bytes(70_000))  # longer than a datagram can be
        assert wire.unsent == 1
        wire.peer = wire.sock.getsockname()
        wire.send(b"to myself")
        time.sleep(0.01)
        got = wire.receive()
        assert got is not None
        assert got[:2] == (b"to myself", wire.peer)
        assert wire.sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) > 200_000


def test_what_comes_between_two_looks_is_there_at_the_next_also_if_it_is_empty() -> None:
    """After a datagram the socket is asked if there is more; after none it is read."""
    wire = Wire(bind_udp(("127.0.0.1", 0), "--listen"), None)
    with wire.sock:
        wire.peer = wire.sock.getsockname()
        for count in (0, 1, 0, 3, 2, 0, 0, 1):
            for i in range(count):
                wire.send(bytes(i))
            if count:
                wire.wait(PATIENCE)
            assert [got[0] for got in iter(wire.receive, None)] == [bytes(i) for i in range(count)]
        wire.send(b"one")
        wire.wait(PATIENCE)
        assert wire.receive() is not None
        wire.send(b"another")
        wire.wait(PATIENCE)
        assert wire.receive() is not None


def test_a_socket_that_others_have_closed_is_no_empty_one() -> None:
    for took in (False, True):
        wire = Wire(bind_udp(("127.0.0.1", 0), "--listen"), None)
        wire.peer = wire.sock.getsockname()
        if took:
            wire.send(b"one")
            wire.wait(PATIENCE)
            assert wire.receive() is not None
        os.close(wire.sock.fileno())
        with pytest.raises(OSError, match="Bad file descriptor"):
            wire.receive()
        wire.sock.detach()


def test_an_end_on_all_addresses_is_on_all_of_them_again_after_a_silence() -> None:
    """A socket that is disconnected has lost the port that the system chose; it was bound to one address then."""
    wire = Wire(bind_udp(("0.0.0.0", 0), "--listen"), None)
    with wire.sock:
        before = wire.sock.getsockname()
        for _ in range(2):
            wire.peer = ("127.0.0.1", 9)
            wire.keep_to_peer()
            wire.keep_to_peer()  # as after a change of the peer's address
            assert wire.sock.getsockname() != before
            wire.listen_to_all()
            assert wire.sock.getsockname() == before


def test_a_peer_whose_port_is_closed_raises_nothing() -> None:
    gone = bind_udp(("127.0.0.1", 0), "--listen")
    wire = Wire(bind_udp(("127.0.0.1", 0), "--listen"), gone.getsockname())
    gone.close()
    with wire.sock:
        for _ in range(3):
            wire.send(b"anybody there?")
            time.sleep(0.005)
            assert wire.receive() is None


# Addresses


@pytest.mark.parametrize(("text", "meant"), [
    ("127.0.0.1:9001", ("127.0.0.1", 9001)), (":9001", ("127.0.0.1", 9001)), ("localhost:1", ("127.0.0.1", 1)),
    ("0.0.0.0:0", ("0.0.0.0", 0)),
])
def test_addresses_as_people_type_them(text: str, meant: tuple[str, int]) -> None:
    assert address(text, "--listen") == meant


def test_an_address_that_is_taken_is_refused() -> None:
    with bind_udp(("127.0.0.1", 0), "--listen") as one:
        with pytest.raises(Refused, match="in use"):
            bind_udp(one.getsockname(), "--listen")
        assert host_port(one.getsockname()).startswith("127.0.0.1:")
    assert peer_address("127.0.0.1:9001") == ("127.0.0.1", 9001)


# Signals


def test_a_signal_is_noted_and_the_first_one_counts() -> None:
    before = {each: signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)}
    for number in before:
        with Interrupt() as interrupt:
            assert interrupt.name is None
            os.kill(os.getpid(), number)
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(0.001)
            assert interrupt.name == number.name
        assert {each: signal.getsignal(each) for each in before} == before


def test_a_signal_that_foreign_code_took_is_taken_back_however_it_was_taken() -> None:
    with Interrupt() as interrupt:
        for taken in (lambda: signal.signal(signal.SIGTERM, lambda *_: None),
                      lambda: signal.signal(signal.SIGTERM, signal.SIG_DFL),
                      lambda: signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM]),
                      lambda: ctypes.CDLL(None).signal(15, 0)):
            taken()
            interrupt.retake()
            assert interrupt.pop_retaken() == ["SIGTERM"]
            interrupt.name = None
            os.kill(os.getpid(), signal.SIGTERM)
            assert interrupt.name == "SIGTERM"
        assert interrupt.times == 4


@pytest.mark.parametrize(("name", "options"), [
    ("master", ["--peer", "flips.example:{port}"]), ("slave", ["--listen", "flips.example:0"]),
    ("channel", ["--listen", "flips.example:0", "--peer", "127.0.0.1:{port}"]),
    ("channel", ["--listen", "127.0.0.1:0", "--peer", "flips.example:{port}"]),
])
def test_a_name_whose_address_changes_between_two_look_ups_leads_nowhere_outside_unasked(
    name: str, options: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The first answer is on this machine and is judged; whatever the next would be, nothing is sent there."""
    asked: list[str] = []
    known = socket.getaddrinfo

    def flips(host: str, *arguments: Any) -> Any:
        asked.append(host)
        number = host if host != "flips.example" else "127.0.0.1" if asked.count(host) == 1 else "203.0.113.9"
        return known(number, *arguments)

    monkeypatch.setattr(socket, "getaddrinfo", flips)
    monkeypatch.chdir(tmp_path)
    main: Callable[[list[str]], int] = import_module(f"{name}.__main__").main
    over = threading.Event()

    def stop() -> None:
        while not over.wait(0.5):
            os.kill(os.getpid(), signal.SIGTERM)

    before = signal.signal(signal.SIGTERM, signal.SIG_IGN)  # for what comes before its own handler, and after it
    ending = threading.Thread(target=stop)
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as there:
            there.bind(("127.0.0.1", 0))
            ending.start()
            main(["canonical", *(word.format(port=there.getsockname()[1]) for word in options)])
    finally:
        over.set()
        ending.join()
        signal.signal(signal.SIGTERM, before)
    assert asked.count("flips.example") == 1
    assert "203.0.113.9" not in "".join(capsys.readouterr())
