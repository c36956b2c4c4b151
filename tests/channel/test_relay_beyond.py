"""A relay that reaches beyond this machine: what is not sealed stays out, unless that was asked for and is said."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from teleop.protocol.manifest import manifest_of
from teleop.protocol.packet import Kind, Packet, decode
from teleop.protocol.session import Session
from tests.channel.site import MASTER, SCENE, SLAVE, Site, sealed
from tests.live.conftest import command, summary  # noqa: F401 (a fixture)

ANY = ("0.0.0.0", 9000)


def test_a_keyless_slave_on_loopback_is_not_opened_to_the_network_by_a_channel(
    capsys: pytest.CaptureFixture[str]
) -> None:
    """Not one datagram of either side is passed on; that is said once, with what to type."""
    site = Site(beyond=ANY)
    packet = site.session(7)
    for _ in range(10):
        for kind in Kind:
            assert not site.takes(packet(kind), MASTER)
            assert not site.takes(packet(kind), SLAVE)
        assert not site.takes(b"GET / HTTP/1.1", MASTER)
    assert site.router.unsealed == 10 * (2 * len(Kind) + 1)
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    for word in ("192.0.2.1:4000", "0.0.0.0:9000", "--key", "--insecure"):
        assert word in said


def test_what_is_sealed_passes_a_channel_that_reaches_beyond_this_machine() -> None:
    site = Site(beyond=ANY)
    site.asks()
    assert site.takes(sealed(0, 22), SLAVE)
    assert site.takes(sealed(1), MASTER)
    assert site.takes(sealed(1), SLAVE)
    assert site.router.unsealed == 0


def test_both_ends_are_told_by_a_channel_that_was_asked_to_carry_their_link_in_the_open() -> None:
    """By an entry in each other's manifest, that tells and is not compared; the exchange goes on with it."""
    site = Site(beyond=ANY, insecure=True)
    ends = {True: Session(master=True, manifest=manifest_of(SCENE), number=7),
            False: Session(master=False, manifest=manifest_of(SCENE))}
    assert not any(end.in_the_open for end in ends.values())
    waiting = [(True, data) for data in ends[True].due(site.now)]
    while waiting:
        master, data = waiting.pop(0)
        site.now += 1_000_000
        assert site.takes(data, MASTER if master else SLAVE)
        _, passed = site.out[1 if master else 0][-1]
        assert len(passed) <= max(1200, len(data) + 24)
        packet = decode(passed, 0)
        assert isinstance(packet, Packet)
        waiting += [(not master, reply) for reply in ends[not master].receive(packet, site.now, len(passed))]
    assert all(end.met == 1 and end.failure is None and end.in_the_open for end in ends.values())


def test_between_ends_of_this_machine_nothing_is_marked() -> None:
    site = Site(insecure=True)
    for kind, sender in ((Kind.HELLO, MASTER), (Kind.WELCOME, SLAVE)):
        assert site.takes(site.session(7)(kind), sender)
        assert site.out[int(sender == MASTER)][-1][1] == site.session(7)(kind)


@pytest.mark.live
@pytest.mark.parametrize("insecure", [False, True])
def test_a_channel_on_all_addresses_is_refused_to_ends_without_keys_or_said_at_all_three(
    insecure: bool, command: Callable[..., Any], tmp_path: Path  # noqa: F811
) -> None:
    scene = ["hard_wall", "--set", "duration=0.5", "--json"]
    slave = command("slave", *scene, "--listen", "127.0.0.1:0", "--out", str(tmp_path / "s"))
    channel = command("channel", *scene, "--listen", "0.0.0.0:0", "--peer", f"127.0.0.1:{slave.port()}",
                      *["--insecure"] * insecure)
    master = command("master", *scene, "--peer", f"127.0.0.1:{channel.port()}", "--out", str(tmp_path / "m"),
                     "--wait", "30" if insecure else "4")
    if insecure:
        ends = [one.end() for one in (master, slave)]
        assert [code for code, _, _ in ends] == [0, 0]
        assert all(err.count("INSECURE: a channel on the way") == 1 for _, _, err in ends)
        for folder in ("m", "s"):
            assert any("--insecure" in note for note in summary(tmp_path / folder)["notes"])
    else:
        master.refused("no answer")
        slave.process.terminate()
        assert slave.end()[0] == 130
    channel.process.terminate()
    code, _, err = channel.end()
    assert code == 0
    assert ("INSECURE: the link to 0.0.0.0:" if insecure else "dropped a packet without keys") in err
    assert err.count("\n") == 1
