"""What fuzzing has found, reduced: each defect by its symptom."""

from __future__ import annotations

from typing import Any

from teleop.protocol.packet import Echo, Kind, Packet, encode
from teleop.protocol.session import Session
from tests.fuzz.datagrams import framed, packed
from tests.fuzz.running import AT, MS

MANIFEST = {"scene": "canonical"}
STRANGER = ("198.51.100.7", 5000)


def test_the_answer_to_a_start_is_not_longer_than_the_start() -> None:
    """One whose numbers were short drew one with a long send time."""
    slave, now = Session(master=False, manifest=MANIFEST), 10**15
    slave.receive(Packet(Kind.HELLO, 7, 0, 0, None, MANIFEST), now)
    start = Packet(Kind.START, 7, 0, now, Echo(now, 0), 5)
    assert len(slave.receive(start, now, len(encode(start)))) == 1
    short = framed(Kind.START, packed(7, 0, 1, None, 5, None))
    again = Packet(Kind.START, 7, 0, 1, None, 5)
    assert slave.receive(again, now, len(short)) == []


def test_a_strangers_record_behind_another_breaks_no_handshake_of_the_end_that_calls(keys: list[Any]) -> None:
    """It came from an address that this end has not called, and had no need to see anything of it."""
    from teleop.protocol.secure.dtls_record import HEAD
    from teleop.protocol.secure.secure_link import SecureLink

    master = SecureLink.calling(keys[0], keys[1].fingerprint, AT["s"])
    slave = SecureLink.listening(keys[1], keys[0].fingerprint, bytes(32))
    alert = HEAD.pack(21, 0xFEFD, 0, 0, 9, 2) + b"\x01\x00"
    done = HEAD.pack(22, 0xFEFD, 0, 0, 9, 12) + bytes((14,)) + bytes(11)  # a ServerHelloDone before its time
    for ms in range(200):
        now = ms * MS
        assert master.receive(alert + done, STRANGER, now) == ([], [])
        waiting = [("s", data) for data, _ in master.due(now)] + [("m", data) for data, _ in slave.due(now)]
        while waiting:
            e, data = waiting.pop(0)
            link, back = (master, "s") if e == "m" else (slave, "m")
            waiting += [(back, each) for each, _ in link.receive(data, AT[back], now)[1]]
            assert master.receive(alert + done, STRANGER, now) == ([], [])
    assert master.trouble is None
    assert master.ready
    assert slave.ready
    assert master.associations == 1
    assert sum(master.dropped.values()) > 200
