"""A relay's cookie beside the handshake: the master brings it, the slave never sees it, no other host can set it."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("OpenSSL")
from channel.router import SLOT_NS, Cookies
from teleop.protocol.secure.dtls_record import (
    EXTRA,
    MTU,
    RelayCookie,
    cookie_of,
    cookie_record,
    is_cookie_record,
    records,
    without_cookie,
)
from teleop.protocol.secure.keys import keygen, load_key
from teleop.protocol.secure.secure_link import SecureLink

RELAY, MASTER, MS = ("192.0.2.9", 9000), ("192.0.2.1", 4000), 1_000_000


def test_a_handshake_goes_through_a_relay_that_asks_for_its_cookie(tmp_path: Path) -> None:
    """One round trip more on the master's side; what reaches the slave is what the master's own link has sent."""
    made = {name: keygen(tmp_path / name) for name in ("master", "slave")}
    keys = {name: load_key(str(path)) for name, (path, _) in made.items()}
    master = SecureLink.calling(keys["master"], made["slave"][1], RELAY)
    slave = SecureLink.listening(keys["slave"], made["master"][1], bytes(32))
    caller, cookies, now = RelayCookie(), Cookies(b"k" * 32), 10**12
    asked = 0
    to_slave: list[bytes] = []
    while not (master.ready and slave.ready):
        now += 10 * MS
        assert now < 10**12 + 10**9
        to_relay = [caller.stamp(data) for data, _ in master.due(now)]
        back: list[bytes] = []
        for data in to_slave:
            assert not any(is_cookie_record(one) for one in records(data) or [])
            back += [reply for reply, _ in slave.receive(data, RELAY, now)[1]]
        to_slave = []
        for data in back:
            assert caller.take(data) is None
            to_relay += [caller.stamp(reply) for reply, _ in master.receive(data, RELAY, now)[1]]
        while to_relay:
            data = to_relay.pop(0)
            found = records(data)
            assert found is not None
            assert len(data) <= MTU + EXTRA
            if not found[0].is_hello:
                to_slave.append(data)
            elif cookies.is_good(cookie_of(found), found[0], MASTER, now):
                to_slave.append(without_cookie(found, len(data)))
            else:
                asked += 1
                again = caller.take(cookie_record(found[0], cookies.of(found[0], MASTER, now)))
                assert again
                to_relay.append(again)
    assert asked == 1


def hello(number: int) -> bytes:
    body = bytes((1,)) + bytes(100)
    return (b"\x16\xfe\xff\0\0" + number.to_bytes(6, "big") + len(body).to_bytes(2, "big") + body).ljust(MTU, b"\0")


def test_a_cookie_for_a_hello_that_was_not_sent_is_none() -> None:
    caller = RelayCookie()
    sent = caller.stamp(hello(77))
    assert sent == hello(77)
    for number in (76, 78, 0):
        record = (records(hello(number)) or [])[0]
        assert caller.take(cookie_record(record, b"f" * 32)) == b""
    assert caller.stamp(hello(78)) == hello(78)
    record = (records(hello(77)) or [])[0]
    assert caller.take(cookie_record(record, b"c" * 32)) == caller.stamp(hello(77))
    assert cookie_of(records(caller.stamp(hello(79))) or []) == b"c" * 32
    assert caller.take(cookie_record(record, b"c" * 32)) == b"", "a copy draws nothing"
    for other in (b"", b"\x16", bytes(EXTRA), hello(77), hello(77)[:EXTRA]):
        assert caller.take(other) is None


def test_a_cookie_runs_out() -> None:
    cookies, record = Cookies(b"k" * 32), (records(hello(1)) or [])[0]
    cookie = cookies.of(record, MASTER, 0)
    assert cookies.is_good(cookie, record, MASTER, SLOT_NS)
    assert not cookies.is_good(cookie, record, MASTER, 2 * SLOT_NS)
    assert not cookies.is_good(cookie, record, (MASTER[0], 1), 0)
    assert not Cookies(b"l" * 32).is_good(cookie, record, MASTER, 0)
