"""The parts of live loops: socket, addresses, signals, alarms, and the clocks of a machine that was suspended."""

from __future__ import annotations

import ctypes
import os
import signal
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from teleop import Refused, Watchdog, load_scene
from teleop.live.driving import ClockDriver
from teleop.live.net.wire import Wire, address, bind_udp, host_port, peer_address
from teleop.live.process.interrupt import Interrupt
from teleop.live.process.ticker import LEAST_NS, Alarm, Suspension, Timer, boottime
from tests.waiting import PATIENCE

pytestmark = pytest.mark.live


# The wire


def test_what_cannot_be_sent_is_counted_what_is_not_there_is_none_and_a_closed_port_raises_nothing() -> None:
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
        with bind_udp(("127.0.0.1", 0), "--listen") as gone:
            wire.peer = gone.getsockname()
        for _ in range(3):
            wire.send(b"anybody there?")
            time.sleep(0.005)
            assert wire.receive() is None


def test_what_comes_between_two_looks_is_there_at_the_next_also_if_it_is_empty() -> None:
    """After a datagram the socket is asked if there is more; after none it is read. A closed one is no empty one."""
    wire = Wire(bind_udp(("127.0.0.1", 0), "--listen"), None)
    with wire.sock:
        wire.peer = wire.sock.getsockname()
        for count in (0, 1, 0, 3, 2, 0, 0, 1):
            for i in range(count):
                wire.send(bytes(i))
            if count:
                wire.wait(PATIENCE)
            assert [got[0] for got in iter(wire.receive, None)] == [bytes(i) for i in range(count)]
        for data in (b"one", b"another"):
            wire.send(data)
            wire.wait(PATIENCE)
            assert wire.receive() is not None
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


# Addresses


def test_addresses_are_read_as_people_type_them_and_one_that_is_taken_is_refused() -> None:
    for text, meant in (("127.0.0.1:9001", ("127.0.0.1", 9001)), (":9001", ("127.0.0.1", 9001)),
                        ("localhost:1", ("127.0.0.1", 1)), ("0.0.0.0:0", ("0.0.0.0", 0))):
        assert address(text, "--listen") == meant
    with bind_udp(("127.0.0.1", 0), "--listen") as one:
        with pytest.raises(Refused, match="in use"):
            bind_udp(one.getsockname(), "--listen")
        assert host_port(one.getsockname()).startswith("127.0.0.1:")
    assert peer_address("127.0.0.1:9001") == ("127.0.0.1", 9001)


# Signals


def test_of_two_signals_the_first_counts_and_one_that_foreign_code_took_is_taken_back_however_it_was_taken() -> None:
    with Interrupt() as interrupt:
        for number in (signal.SIGINT, signal.SIGTERM):
            os.kill(os.getpid(), number)
        assert interrupt.name == "SIGINT"
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


MS = 1_000_000


def ring(
    alarm: Alarm, start: int, interval: int, count: int, busy: Callable[[int], None] = lambda _: None
) -> list[int]:
    """The times (ns from the start) at which so many waits of an alarm were over; `busy` is called between two of them.

    A wait may be over after the next instant: the machine may take the processor away at any point.
    """
    alarm.set(start, interval)
    over: list[int] = []
    for i in range(count):
        if i:
            busy(i)
        alarm.wait()
        over.append(time.monotonic_ns() - start)
    return over


@pytest.mark.parametrize("spin_ns", [0, 150_000, 3 * MS, 40 * MS])
def test_it_waits_until_its_instant_and_once_for_each(spin_ns: int) -> None:
    """Even if it is to wait awake for longer than from one instant to the next."""
    over = ring(Alarm(spin_ns), time.monotonic_ns() + 20 * MS, 5 * MS, 12)
    assert over[0] >= 0
    assert all(then // (5 * MS) < now // (5 * MS) for then, now in pairwise(over)), "none twice, and none early"
    assert ring(Alarm(spin_ns), time.monotonic_ns() + 20 * MS, 0, 1)[0] >= 0


class Time:
    """The module `time` with a clock of its own, which goes on by a microsecond whenever it is read."""

    def __init__(self) -> None:
        self.now, self.slept = 0, list[int]()

    def monotonic_ns(self) -> int:
        self.now += 1000
        return self.now

    def sleep(self, seconds: float) -> None:
        self.slept.append(round(seconds * 1e9))
        self.now += self.slept[-1]


@pytest.mark.parametrize("spin_ns", [0, 150_000, 3 * MS, 12 * MS])
def test_it_sleeps_up_to_its_instant_and_waits_for_the_rest_awake(
    spin_ns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock, start = Time(), 20 * MS
    monkeypatch.setattr("teleop.live.process.ticker.time", clock)
    alarm = Alarm(spin_ns)
    alarm.set(start, 5 * MS)
    for due in (start, start + 5 * MS, start + 10 * MS):
        left = due - spin_ns - clock.now - 1000
        clock.slept.clear()
        alarm.wait()
        assert due <= clock.now < due + 2000
        assert clock.slept == ([left] if left > 0 else [])
    clock.now = start + 30 * MS + 77_000
    alarm.wait()
    assert clock.now < start + 30 * MS + 80_000, "late, it is over at once, for all that have passed together"
    alarm.wait()
    assert start + 35 * MS <= clock.now < start + 35 * MS + 2000


def test_instants_that_were_missed_are_left_out_and_the_next_is_not_early() -> None:
    """Whoever waits was busy over some of them, or they had passed before: they are over together, the grid stays."""
    interval = 20 * MS
    over = ring(Alarm(2 * MS), time.monotonic_ns() + 20 * MS, interval, 6, lambda i: time.sleep(0.07 * (i == 2)))
    instants = [at // interval for at in over]
    assert instants == sorted(set(instants))
    assert instants[2] - instants[1] >= 3
    over = ring(Alarm(), time.monotonic_ns() - 12_345 * MS, interval, 3)
    assert over[0] >= 12_345 * MS
    assert all(then // interval < now // interval for then, now in pairwise(over))
    alarm, start = Alarm(3 * MS), time.monotonic_ns() + 20 * MS
    for step in (0, 7 * MS, 9 * MS, 30 * MS):  # it may be set again between two waits
        assert ring(alarm, start + step, 0, 1)[0] >= 0


@pytest.mark.skipif(Timer().fd < 0, reason="there is no timerfd here")
def test_a_timer_counts_its_rings_and_is_read_without_waiting() -> None:
    timer = Timer()
    with pytest.raises(OSError, match="cannot be set"):
        timer.set(time.monotonic_ns(), -MS)
    assert timer.expirations() == 0
    began = time.monotonic_ns()
    timer.set(began - 1000 * MS, MS)
    time.sleep(0.001)
    told = timer.expirations()
    assert told >= 1000
    assert timer.expirations() + told <= 1001 + (time.monotonic_ns() - began) // MS, "those are told"
    timer.close()


S = 1_000_000_000


class Clocks:
    """A clock that counts suspension and one that does not; the process is held up for `held` at the next reading."""

    def __init__(self) -> None:
        self.now, self.slept, self.held = 5 * S, 3 * S, 0

    def _read(self, what: int) -> int:
        self.now, self.held = self.now + 100 + self.held, 0
        return self.now + what

    def boot(self) -> int:
        return self._read(self.slept)

    def mono(self) -> int:
        return self._read(0)


def test_what_one_clock_alone_counts_is_a_suspension_told_once_and_what_holds_a_process_up_is_none() -> None:
    clocks = Clocks()
    seen = Suspension(clocks.boot, clocks.mono)
    clocks.now += 100 * S
    assert seen.duration() == 0
    clocks.slept += 5 * S
    assert seen.duration() == pytest.approx(5 * S, abs=1000)
    assert seen.duration() == 0
    for held in ((S, 0, 0), (0, S, 0), (0, 0, S)):
        clocks = Clocks()
        clocks.held = held[0]
        seen = Suspension(clocks.boot, clocks.mono)
        for once in held[1:]:
            clocks.held = once
            assert seen.duration() == 0
    assert Suspension(None).duration() == 0
    seen = Suspension(boottime())
    for _ in range(1000):
        assert seen.duration() == 0


def test_a_live_end_whose_machine_was_suspended_is_safe_at_once_and_goes_on_in_another_session(
    pair: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    dog = Watchdog(timeout=0.8, ramp=0.05, settle=0.05)
    both = pair(replace(load_scene("canonical", duration=3.0, wall=0.005), link=None, watchdog=dog))
    slave = both.shells["s"]
    slept = [0]

    def boot() -> int:
        if slave.endpoint._tick > 400:
            slept[0] = 5 * S
        return time.monotonic_ns() + slept[0]

    drive = ClockDriver.drive

    def suspended_once(driver: ClockDriver) -> None:
        if driver.shell is slave:
            driver.suspension = Suspension(boot)
        drive(driver)

    monkeypatch.setattr(ClockDriver, "drive", suspended_once)
    both.run()
    assert both.errors == {"m": None, "s": None}
    assert both.status() == {"m": "ok", "s": "ok"}
    events = slave.endpoint.guard.events
    told = next(i for i, event in enumerate(events) if event.why.startswith("stood still"))
    assert events[told].what == "safe"
    assert "suspended for 5.000 s" in events[told].why
    after = [event.what for event in events[told:]]
    assert after.index("session") < after.index("released"), "another session alone releases it"
    assert LEAST_NS < S
