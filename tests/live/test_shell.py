"""The live loop by the clock: two ends in this process, and what may go wrong between and around them."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from threading import Timer
from typing import Any

import numpy as np
import pytest

from master.device import SimulatedMaster
from slave.robot import SimulatedSlave
from teleop import Refused, load_scene
from teleop.live.net.wire import Wire, bind_udp
from teleop.live.process.interrupt import Interrupt
from teleop.live.records.merge import merge
from teleop.live.records.record import EVENTS
from teleop.protocol.packet import Kind, peek
from tests.fakes import Body, at_tick, wire_of
from tests.live.conftest import make_shell, summary

pytestmark = pytest.mark.live
Make = Callable[..., Any]

SCENE = replace(load_scene("canonical", duration=0.4, wall=0.005), link=None)


def faulty(inner: Any, at: int, act: Callable[[], object]) -> Body:
    """A device that does something at one tick."""
    return Body(inner=inner, reads=at_tick(at, act))


def test_both_ends_run_to_their_end_every_tick_is_accounted_for_and_the_motors_are_left_free(pair: Make) -> None:
    """And two ends that never met are not put together."""
    devices = {"m": Body(inner=SimulatedMaster(SCENE)), "s": Body(inner=SimulatedSlave(SCENE))}
    both = pair(SCENE, parts={e: {"device": device} for e, device in devices.items()}).run()
    assert both.errors == {"m": None, "s": None}
    assert both.status() == {"m": "ok", "s": "ok"}
    for shell in both.shells.values():
        assert shell.counts.ticks + shell.counts.skipped == SCENE.ticks
        assert shell.outcome.sentence.startswith("ran to its end, 400 ticks of 0.001 s")
        assert both.share_received(shell.endpoint.e) > 0.5
        assert not shell.endpoint.rejected
    for device in devices.values():
        assert device.held[-1] == (0.0,)
        assert max(abs(f) for f, in device.held) > 0.1
    master, slave = both.write()
    result = merge(SCENE, master, slave)
    assert result.status == "ok"
    assert result.mode == "live"
    assert np.abs(result.trace["f_m"]).max() > 0.1
    assert result.metrics["E_link_min"] >= -1e-12
    events = (slave / EVENTS).read_text()
    (slave / EVENTS).write_text(events.replace("session 0000000000000063", "session 00000000000000aa"))
    with pytest.raises(Refused, match="not the two ends of one run"):
        merge(SCENE, master, slave)


def test_a_start_that_is_lost_is_repeated_before_tick_0_and_whoever_reads_along_may_leave(
    pair: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And a full disk stops the record, not the loop, and is a note of the summary."""
    left, said, lost = list[Any](), list[dict[str, Any]](), iter(range(2))
    wire = wire_of(lambda data: peek(data)[0] is Kind.START and next(lost, None) is not None)

    def leave(numbers: dict[str, Any]) -> None:
        left.append(numbers)
        raise BrokenPipeError

    scene = replace(SCENE, duration=0.6)
    both = pair(scene, wire=wire, parts={"m": {"say": leave}, "s": {"say": said.append}})
    recorder = both.shells["s"].recorder
    begin = recorder.begin

    def full(force: Any) -> None:
        begin(force)
        recorder._file.close()
        recorder._file = Path("/dev/full").open("wb")  # noqa: SIM115 (the recorder closes it)

    monkeypatch.setattr(recorder, "begin", full)
    both.run()
    assert next(lost, None) is None
    assert both.status() == {"m": "ok", "s": "ok"}
    counts = both.shells["s"].counts
    assert (counts.first or 0) + counts.ticks + counts.skipped == scene.ticks
    assert len(left) == 1
    assert 1 <= len(said) <= 4
    assert [numbers["end"] for numbers in said] == ["s"] * len(said)
    assert all(0 <= numbers["k"] < 600 and 0.0 <= numbers["delay"] < 0.5 for numbers in said[1:])
    assert {numbers["gain"] for numbers in said} == {1.0}
    [note] = [note for note in summary(both.write()[1])["notes"] if "record stopped at row" in note]
    assert note.endswith("No space left on device")


@pytest.mark.parametrize(("e", "seed"), [("m", None), ("s", 1), *[
    pytest.param(e, seed, marks=pytest.mark.full) for e, seed in (("s", None), ("m", 1))]])
def test_an_interrupt_stops_both_ends_and_both_keep_their_records(e: str, seed: int | None, pair: Make) -> None:
    interrupt = Interrupt()

    def press() -> None:
        interrupt.name = "SIGINT"

    device = faulty({"m": SimulatedMaster, "s": SimulatedSlave}[e](SCENE), 200, press)
    both = pair(SCENE, seed=seed, parts={**{"m": {}, "s": {}}, e: {"device": device, "interrupt": interrupt}}).run()
    assert both.errors == {"m": None, "s": None}
    assert both.status() == {"m": "stopped", "s": "stopped"}
    assert both.shells[e].outcome.sentence.endswith("s: it was asked to stop (SIGINT)")
    _, told, when = both.shells["sm"["ms".index(e)]].outcome.sentence.partition("the other end left: stopped at t = ")
    assert told
    assert 0.2 <= float(when.split()[0]) <= 0.4
    result = merge(SCENE, *both.write())
    sentence = both.shells[e].outcome.sentence if e == "m" else result.sentence
    assert (result.status, result.sentence) == ("stopped", sentence)
    assert 0 < result.ticks < SCENE.ticks


@pytest.mark.parametrize("e", ["m", "s"])
def test_an_interrupt_before_the_start_is_a_run_that_never_was(e: str, pair: Make) -> None:
    interrupt = Interrupt()
    interrupt.name = "SIGTERM"
    parts = {"m": {"peer_timeout": 0.5}, "s": {"peer_timeout": 0.5}, e: {"interrupt": interrupt}}
    both = pair(SCENE, parts=parts).run()
    assert both.shells[e].outcome.status == "stopped"
    assert both.shells["sm"["ms".index(e)]].outcome.status == "refused"
    assert [shell.counts.ticks for shell in both.shells.values()] == [0, 0]


def test_a_stall_skips_whole_ticks_also_at_the_very_end_and_says_how_many(pair: Make) -> None:
    at_last = faulty(SimulatedSlave(SCENE), 300, lambda: time.sleep(0.15))  # beyond the end, whenever it begins
    both = pair(SCENE, parts={"m": {}, "s": {"device": faulty(at_last, 100, lambda: time.sleep(0.05))}}).run()
    slave = both.shells["s"]
    assert both.status() == {"m": "ok", "s": "ok"}
    for shell in both.shells.values():
        assert shell.counts.ticks + shell.counts.skipped == SCENE.ticks
    assert slave.counts.ran >= 300, "the tick that stalled"
    assert slave.counts.skipped >= 48 + SCENE.ticks - 1 - slave.counts.ran
    assert f"{slave.counts.skipped} of them skipped" in slave.outcome.sentence
    left_out = f"slave: {slave.counts.skipped} of {SCENE.ticks} ticks"
    assert any(note.startswith(left_out) for note in merge(SCENE, *both.write()).notes)


# Other senders


class Open(wire_of()):  # a class that is made
    """A system that does not keep strangers out."""

    def keep_to_peer(self, shapes: Any = ()) -> None:
        pass


@pytest.mark.parametrize("wire", [wire_of(), Open], ids=["filtered", "open"])
def test_a_stranger_who_copies_what_was_sent_does_not_draw_the_run_to_himself(wire: Any, pair: Make) -> None:
    """All that the slave has taken in so far is sent to it again, from elsewhere: its START most of all."""
    both = pair(SCENE, wire=wire)
    slave, copied = both.shells["s"], list[bytes]()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.bind(("127.0.0.1", 0))
        stranger.settimeout(0.05)

        def copy() -> None:
            copied.extend(slave.wire.taken[:100])
            for data in copied:
                stranger.sendto(data, slave.wire.sock.getsockname())

        both.shells["s"].device.device = faulty(SimulatedSlave(SCENE), 150, copy)
        both.run()
        with pytest.raises(TimeoutError):
            stranger.recvfrom(65536)
    assert both.status() == {"m": "ok", "s": "ok"}
    kinds = {peek(data)[0] for data in copied}
    assert {Kind.HELLO, Kind.START, Kind.FORTH} <= kinds
    assert (slave.endpoint.rejected["address"] > 0) is (wire is Open)
    assert slave.endpoint.inbox.duplicates == 0
    assert both.share_received("m") > 0.5


def test_garbage_is_counted_from_the_first_moment_on_and_disturbs_nothing(pair: Make) -> None:
    both = pair(SCENE)
    slave = both.shells["s"]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        def throw(count: int) -> None:
            for i in range(count):
                stranger.sendto((b"", b"GET / HTTP/1.1", b"BT\x09" + bytes(20), bytes(9000))[i % 4], address)

        address = slave.wire.sock.getsockname()
        throw(40)
        both.shells["m"].device.device = faulty(SimulatedMaster(SCENE), 200, lambda: throw(80))
        both.run()
    assert both.status() == {"m": "ok", "s": "ok"}
    # Of the forty before the session; the eighty during it do not come through to us.
    assert dict(slave.endpoint.rejected) == {"truncated": 10, "magic": 10, "version": 10, "oversize": 10}
    assert both.share_received("s") > 0.5


class Roaming(Wire):
    """From some time on it sends from another port. What is sent to its first one may come as before."""

    moved: Wire | None = None
    hears = True

    def send(self, data: bytes) -> None:
        if self.moved is None:
            super().send(data)
        else:
            self.moved.send(data)

    def receive(self) -> Any:
        return (self.moved and self.moved.receive()) or (super().receive() if self.hears else None)


@pytest.mark.parametrize("hears", [pytest.param(False, marks=pytest.mark.full), True])
def test_a_peer_that_comes_back_from_another_port_is_heard_in_a_session_of_its_own(
    hears: bool, pair: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As after a channel was restarted. Without keys, messages of the session before may be anybody's from there.

    Even if the master goes on hearing the slave: that one falls silent, and asks for another session.
    """
    for name in ("teleop.live.driving.OPEN_NS", "teleop.protocol.session.RENEW_NS"):
        monkeypatch.setattr(name, 400_000_000)
    both = pair(replace(SCENE, duration=2.2), wire=Roaming)
    master, slave = both.shells["m"], both.shells["s"]
    for shell in (master, slave):
        shell.endpoint.session.liveness.renew_ns = 400_000_000
    moved = Wire(bind_udp(("127.0.0.1", 0), "--listen"), slave.wire.sock.getsockname())

    def move() -> None:
        assert isinstance(master.wire, Roaming)
        master.wire.moved, master.wire.hears = moved, hears

    master.device.device = faulty(SimulatedMaster(both.scene), 300, move)
    both.run()
    assert both.errors == {"m": None, "s": None}
    assert slave.connection.peer == moved.sock.getsockname()
    moved.sock.close()
    for shell in (master, slave):
        assert shell.endpoint.session.met >= 2
        assert shell.wire.connected, "to the peer alone again"
        assert 0 < shell.endpoint.counted["played"] < shell.endpoint.counted["played"] + shell.endpoint.inbox.played


def test_a_new_session_is_asked_for_where_the_master_was_told_to_ask(pair: Make) -> None:
    """A slave with two addresses may have answered from the other one, and be started again on the first alone."""
    both = pair(SCENE)
    master, slave = both.shells["m"], both.shells["s"]
    asked = slave.wire.sock.getsockname()
    master.connection.peer = ("127.0.0.1", 9)
    assert master.endpoint.session.meeting
    master.say_again(time.monotonic_ns())
    assert master.connection.peer == asked
    time.sleep(0.01)
    got = slave.wire.receive()
    assert got is not None
    assert peek(got[0] or b"")[0] is Kind.HELLO
    for shell in both.shells.values():
        shell.wire.sock.close()


def test_an_end_whose_tick_0_was_moved_far_ahead_heeds_an_interrupt(pair: Make) -> None:
    """The alarm was set to tick 0, and until then nobody looked at anything."""
    both = pair(SCENE)
    slave = both.shells["s"]

    def move() -> None:
        assert slave.endpoint.session.start_ns is not None
        slave.endpoint.session.start_ns += 600 * 10**9
        Timer(0.1, setattr, (slave.interrupt, "name", "SIGTERM")).start()

    slave.device.device = faulty(SimulatedSlave(SCENE), 100, move)
    both.run()
    assert both.errors == {"m": None, "s": None}
    assert (slave.outcome.status, "SIGTERM" in slave.outcome.sentence) == ("stopped", True)


def test_datagrams_without_an_end_are_taken_in_up_to_a_number_and_a_time(tmp_path: Path) -> None:
    class Endless(Wire):
        taken = 0

        def receive(self) -> Any:
            self.taken += 1
            return b"none of ours", ("127.0.0.1", 9), time.monotonic_ns()

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        wire = Endless(sock, None)
        shell = make_shell(SCENE, "s", wire, tmp_path / "s")
        for share_ns, most in ((0, 16), (10**15, 1024)):
            shell._share_ns, wire.taken = share_ns, 0
            shell.drain()
            assert wire.taken == most
