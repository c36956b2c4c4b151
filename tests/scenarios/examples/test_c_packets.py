"""The C client's packets beside this package's own: of the test vectors, and of bytes that nobody meant."""

from __future__ import annotations

import json
import random
import subprocess
from pathlib import Path
from zlib import crc32

import pytest

from teleop.protocol.packet import Packet, Rejection, decode, encode
from tests.programs import program
from tests.scenarios.examples.compiled import compiled
from tests.teleop.protocol.vectors import FILE, packet_of

MUTATIONS = 8_000
Case = tuple[int, bytes]


@pytest.fixture(scope="module")
def check(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compiled("check", tmp_path_factory.mktemp("c"))


def said(check: Path, cases: list[Case]) -> list[str]:
    """What the C client says of each datagram: the packet encoded again as hex, or the rejection."""
    lines = "".join(f"{width} {data.hex()}\n" for width, data in cases)
    done = subprocess.run([program(check)], input=lines, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.splitlines()


def test_it_decodes_and_encodes_every_vector_and_rejects_for_the_same_reasons(check: Path) -> None:
    vectors = json.loads(FILE.read_text(encoding="utf-8"))
    parts = ("accepted", "accepted_in_other_forms", "rejected")
    cases = [one for part in parts for one in vectors[part]]
    found = said(check, [(one["width"], bytes.fromhex(one["hex"])) for one in cases])
    for one, line in zip(cases, found, strict=True):
        assert line == (one.get("rejection") or own(packet_of(one["packet"]), len(one["hex"]) // 2)), one["name"]


def test_of_mutated_datagrams_it_takes_what_this_package_takes(check: Path) -> None:
    rng = random.Random(17)
    vectors = json.loads(FILE.read_text(encoding="utf-8"))
    seeds = [(one["width"], bytes.fromhex(one["hex"])) for part in ("accepted", "rejected") for one in vectors[part]]
    cases = [(width, mutated(rng, data)) for width, data in rng.choices(seeds, k=MUTATIONS)]
    taken = 0
    for (width, data), line in zip(cases, said(check, cases), strict=True):
        ours = decode(data, width)
        if isinstance(ours, Rejection):
            # What is printable beyond ASCII is a table that C has not.
            assert line == ours.value or (ours is Rejection.MALFORMED and texts(data)), data.hex()
        else:
            taken += 1
            again = decode(bytes.fromhex(line), width)
            assert repr(again) == repr(ours), data.hex()
    assert MUTATIONS / 50 < taken < MUTATIONS / 2, "both kinds are tried"


def own(packet: Packet, size: int) -> str:
    """The datagram of this package for the packet, as hex; padded to `size` bytes if it is not longer already."""
    return encode(packet, max(size, len(encode(packet)))).hex()


def texts(data: bytes) -> bool:
    """Is it a packet with text beyond ASCII in it?"""
    return data[3] in (2, 3, 4, 6, 7) and any(byte >= 0x80 for byte in data[6:-4])


def mutated(rng: random.Random, data: bytes) -> bytes:
    """The datagram with a few bytes changed, put in or taken out; mostly with a checksum that is right again."""
    body = bytearray(data[:-4])
    for _ in range(rng.choice((1, 1, 2, 3))):
        at, change = rng.randrange(len(body) + 1), rng.choice((0, 1, 1, 1, 2))
        if change == 0:
            body.insert(at, rng.choice((0, 0x7F, 0x80, 0x92, 0xC0, 0xCB, 0xD3, 0xDF, 0xFF, rng.randrange(256))))
        elif at < len(body) and change == 1:
            body[at] = rng.randrange(256)
        elif at < len(body):
            del body[at]
    if rng.random() < 0.2 and len(body) >= 6:
        body[4:6] = max(0, int.from_bytes(body[4:6], "big") + rng.randint(-9, 9)).to_bytes(2, "big")
    return bytes(body) + (crc32(body).to_bytes(4, "big") if rng.random() < 0.9 else data[-4:])
