"""The test vectors of the wire: `python -m tests.teleop.protocol.vectors` writes `teleop/protocol/vectors.json`.

They are made from fields and bytes that are written down here, without clock or dice: the same file every time. What is
accepted is encoded by hand, byte by byte, where it is not what this package would send.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any
from zlib import crc32

from msgpack import packb

from teleop.protocol.packet import MOST_CONTROL, MOST_DATA, VERSION, Echo, Kind, Packet, encode

FILE = Path(__file__).parents[3] / "teleop" / "protocol" / "vectors.json"
SESSION, BIG, MOST_NS = 0x0123456789ABCDEF, 2**64 - 1, 2**63 - 1
MANIFEST = {"scene": "hard_wall", "law": "pp PositionPosition(K=400.0, B=4.0, rejoin=2.0)", "dt": "0.001"}
ECHO = Echo(4_900_000_000, 1_000_000)
FORTH = Packet(Kind.FORTH, SESSION, 1000, 5_000_000_000, ECHO, (0.012, -0.5), None)
BEFORE, AFTER = b"\x96\x07\x01\x05\xc0", b"\xc0"  # around a payload: session 7, seq 1, sent_ns 5, no echo; and no E_in

ACCEPTED: list[tuple[str, Packet, int | None]] = [
    ("a message of position-position, one axis, padded to 100 bytes", FORTH, 100),
    ("the same of the slave, without padding", FORTH._replace(kind=Kind.BACK), None),
    ("the first message: no echo yet", FORTH._replace(seq=0, echo=None), 100),
    ("a message with E_in", FORTH._replace(E_in=-1.5e-3), 100),
    ("waves by their integral: u, U, E, T", FORTH._replace(payload=(0.25, 0.125, 0.5, 1.001)), 100),
    ("three axes of waves: u, u, u, then U, E of each, then T",
     FORTH._replace(payload=(0.25, -0.5, 0.0, 0.1, 0.2, 0.3, 0.4, -0.0, 0.6, 1.001)), 200),
    ("the largest numbers of every field",
     Packet(Kind.BACK, BIG, 2**32 - 1, MOST_NS, Echo(MOST_NS, MOST_NS), (1.7e308, 1.7e308), -5e-324), 100),
    ("a clock that began below zero",
     Packet(Kind.FORTH, 0, 0, -(2**63), Echo(-129, 0), (0.0, -0.0), 0.0), 100),
    ("HELLO: the manifest, padded to 1200 bytes",
     Packet(Kind.HELLO, SESSION, 0, 5_000_000_000, None, MANIFEST), 1200),
    ("WELCOME of a slave that has a grid, at every second tick",
     Packet(Kind.WELCOME, SESSION, 0, 9_000_000, Echo(5_000_000_000, 0),
            {**MANIFEST, "@every": "2", "@tick 0": "-77"}), None),
    ("REFUSE", Packet(Kind.REFUSE, SESSION, 0, 9_000_000, None, "the slave is set up for another run"), None),
    ("START of the master: tick 0 on the slave's clock, and the WELCOME that told it",
     Packet(Kind.START, SESSION, 0, 5_100_000_000, Echo(9_000_000, 0), 259_000_000), None),
    ("START of the slave: it has come", Packet(Kind.START, SESSION, 0, 10_000_000, None, 259_000_000), None),
    ("RENEW", Packet(Kind.RENEW, SESSION, 0, 11_000_000_000, None, "the session is over: nothing came for 1 s"), None),
    ("BYE of an end that ran to its end", Packet(Kind.BYE, SESSION, 0, 12_000_000_000, None, "finished"), None),
    ("a sentence in letters beyond ASCII", Packet(Kind.BYE, 7, 0, 5, None, "Gerät ausgeschaltet"), None),
]


def datagram(body: bytes, kind: int = 0, *, magic: bytes = b"BT", version: int = VERSION, length: int | None = None,
             padding: bytes = b"") -> bytes:
    """A datagram around any body, with a checksum that is right."""
    head = struct.pack("!2sBBH", magic, version, kind, len(body) if length is None else length)
    return head + body + padding + struct.pack("!I", crc32(head + body + padding))


def _message(*numbers: bytes) -> bytes:
    return BEFORE + bytes([0x90 + len(numbers)]) + b"".join(numbers) + AFTER


ONE, HALF = packb(1.0), b"\xca\x3f\x00\x00\x00"
OTHER_FORMS: list[tuple[str, bytes, Packet]] = [
    ("integers in longer forms than they need, which an end takes and a filter in front of it may not",
     datagram(b"\x96\xcf" + bytes(7) + b"\x07\xce\x00\x00\x00\x01\xd3" + bytes(7) + b"\x05\xc0\x92" + ONE + ONE
              + AFTER),
     Packet(Kind.FORTH, 7, 1, 5, None, (1.0, 1.0))),
    ("numbers as float32", datagram(_message(HALF, ONE)), Packet(Kind.FORTH, 7, 1, 5, None, (0.5, 1.0))),
    ("arrays in their longer form", datagram(b"\xdc\x00\x06\x07\x01\x05\xc0\xdc\x00\x02" + ONE + ONE + AFTER),
     Packet(Kind.FORTH, 7, 1, 5, None, (1.0, 1.0))),
    ("a sentence as str 32", datagram(BEFORE + b"\xdb\x00\x00\x00\x02no" + AFTER, Kind.BYE),
     Packet(Kind.BYE, 7, 1, 5, None, "no")),
]


def _rejected() -> list[tuple[str, bytes, str]]:
    good = encode(FORTH, 100)
    nan, inf = packb(float("nan")), packb(float("inf"))
    many = [("longer than any packet", good + bytes(MOST_CONTROL), "oversize"),
            ("a message longer than a message may be", datagram(_message(ONE, ONE), padding=bytes(MOST_DATA)),
             "oversize"),
            ("nothing", b"", "truncated"),
            ("shorter than head and checksum", good[:9], "truncated"),
            ("a body that is longer than the datagram", datagram(_message(ONE, ONE), length=1000), "truncated"),
            ("cut off, so that the body does not fit", good[:60], "truncated"),
            ("another magic", datagram(_message(ONE, ONE), magic=b"bt"), "magic"),
            ("a record of DTLS", b"\x17\xfe\xfd\x00\x01" + bytes(20), "magic"),
            ("another version", datagram(_message(ONE, ONE), version=3), "version"),
            ("a bit of the body is another", good[:30] + bytes([good[30] ^ 1]) + good[31:], "checksum"),
            ("the checksum with the little end first", good[:-4] + good[:-5:-1], "checksum")]
    bodies = {
        "an array of five": b"\x95\x07\x01\x05\xc0\x92" + ONE + ONE,
        "a map in place of the array": b"\x81\x07\x01",
        "a session below zero": b"\x96\xff\x01\x05\xc0\x92" + ONE + ONE + AFTER,
        "a number of 33 bits": b"\x96\x07\xcf\x00\x00\x00\x01\x00\x00\x00\x00\x05\xc0\x92" + ONE + ONE + AFTER,
        "a time of 64 bits without a sign": b"\x96\x07\x01\xcf" + b"\xff" * 8 + b"\xc0\x92" + ONE + ONE + AFTER,
        "an echo of one time": b"\x96\x07\x01\x05\x91\x05\x92" + ONE + ONE + AFTER,
        "an echo that was held for less than nothing": b"\x96\x07\x01\x05\x92\x05\xff\x92" + ONE + ONE + AFTER,
        "an echo with a float": b"\x96\x07\x01\x05\x92\x05" + ONE + b"\x92" + ONE + ONE + AFTER,
        "integers for numbers": BEFORE + b"\x92\x01\x02" + AFTER,
        "a truth for a number": BEFORE + b"\x92\xc3" + ONE + AFTER,
        "one number too few": _message(ONE),
        "one number too many": _message(ONE, ONE, ONE),
        "an integer for E_in": BEFORE + b"\x92" + ONE + ONE + b"\x00",
        "bytes behind the array": _message(ONE, ONE) + b"\xc0",
        "a body that ends within a number": _message(ONE, ONE)[:-4],
    }
    many += [(name, datagram(body), "malformed") for name, body in bodies.items()]
    many += [("a kind that there is not", datagram(BEFORE + b"\x01" + AFTER, 8), "malformed"),
             ("padding that is not zero", datagram(_message(ONE, ONE), padding=b"\0\1"), "malformed"),
             ("a manifest with a number in it", datagram(BEFORE + b"\x81\xa1a\x01" + AFTER, Kind.HELLO), "malformed"),
             ("a manifest as an array", datagram(BEFORE + b"\x91\xa1a" + AFTER, Kind.HELLO), "malformed"),
             ("a START with a float", datagram(BEFORE + ONE + AFTER, Kind.START), "malformed"),
             ("a sentence as bytes", datagram(BEFORE + b"\xc4\x02no" + AFTER, Kind.BYE), "malformed"),
             ("a sentence with an escape in it", datagram(BEFORE + b"\xa3no\x1b" + AFTER, Kind.BYE), "malformed"),
             ("a sentence that is no UTF-8", datagram(BEFORE + b"\xa2\xc3\x28" + AFTER, Kind.BYE), "malformed"),
             ("a sentence of 1001 letters", datagram(BEFORE + packb("a" * 1001) + AFTER, Kind.BYE), "malformed"),
             ("not a number", datagram(_message(nan, ONE)), "non-finite"),
             ("infinity", datagram(_message(ONE, inf)), "non-finite"),
             ("infinity as float32", datagram(_message(ONE, b"\xca\x7f\x80\x00\x00")), "non-finite"),
             ("an E_in that is not a number", datagram(BEFORE + b"\x92" + ONE + ONE + nan), "non-finite")]
    return many


def fields(packet: Packet) -> dict[str, Any]:
    """A packet as JSON holds it: whole numbers as text, since some readers have 53 bits for them."""
    payload: Any = packet.payload
    told = str(payload) if isinstance(payload, int) else list(payload) if isinstance(payload, tuple) else payload
    return {"kind": packet.kind.name, "session": str(packet.session), "seq": packet.seq, "sent_ns": str(packet.sent_ns),
            "echo": None if packet.echo is None else list(map(str, packet.echo)), "payload": told, "E_in": packet.E_in}


def packet_of(found: dict[str, Any]) -> Packet:
    """The packet of these fields again."""
    kind, payload, echo = Kind[found["kind"]], found["payload"], found["echo"]
    own = int(payload) if kind is Kind.START else tuple(payload) if isinstance(payload, list) else payload
    return Packet(kind, int(found["session"]), found["seq"], int(found["sent_ns"]),
                  None if echo is None else Echo(*map(int, echo)), own, found["E_in"])


def width(packet: Packet) -> int:
    """How many numbers a message of this run carries."""
    return len(packet.payload) if isinstance(packet.payload, tuple) else 2


def made() -> dict[str, Any]:
    """All of them. `size`: to which a datagram is padded, null without padding; `width`: the numbers of a message."""
    accepted = [{"name": name, "width": width(packet), "size": size, "packet": fields(packet),
                 "hex": encode(packet, size).hex()} for name, packet, size in ACCEPTED]
    others = [{"name": name, "width": width(packet), "packet": fields(packet), "hex": data.hex()}
              for name, data, packet in OTHER_FORMS]
    rejected = [{"name": name, "width": 2, "rejection": why, "hex": data.hex()} for name, data, why in _rejected()]
    return {"wire_version": VERSION, "accepted": accepted, "accepted_in_other_forms": others, "rejected": rejected}


def text() -> str:
    """The file."""
    return json.dumps(made(), indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    FILE.write_text(text(), encoding="utf-8")
