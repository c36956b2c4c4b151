"""The cost of encryption: a packet sealed at one end and opened at the other, and an association begun.

The packets come from a real association; sealing and opening are timed in turns, as the two ends would do them.
"""

from __future__ import annotations

import time
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from teleop.protocol.secure.keys import Key, keygen, load_key
from teleop.protocol.secure.secure_link import SecureLink

Row = tuple[str, str, str]
SIZE, PACKETS = 100, 20_000
_HERE, _THERE = ("192.0.2.1", 1), ("192.0.2.2", 2)


def secure(rounds: int) -> list[Row]:
    """Rows of (what, measured, asked): medians over `rounds`."""
    def associated(mine: Key, theirs: Key) -> tuple[SecureLink, SecureLink]:
        caller = SecureLink.calling(mine, theirs.fingerprint, _THERE)
        listener = SecureLink.listening(theirs, mine.fingerprint, bytes(32))
        flying = caller.due(0)
        while flying:
            data, at = flying.pop(0)
            flying += caller.receive(data, _THERE, 0)[1] if at == _HERE else listener.receive(data, _HERE, 0)[1]
        return caller, listener

    with TemporaryDirectory() as name:
        keys = [load_key(keygen(Path(name) / end)[0]) for end in ("master", "slave")]
    plain = bytes(range(SIZE))
    seals, opens, meets = [], [], []
    for _ in range(rounds):
        began = time.perf_counter()
        caller, listener = associated(keys[0], keys[1])
        meets.append(time.perf_counter() - began)
        sealing = opening = 0
        for _ in range(PACKETS // 100):
            start = time.perf_counter_ns()
            sealed = [caller.send(plain) for _ in range(100)]
            between = time.perf_counter_ns()
            opened = [listener.receive(data or b"", _HERE, 0) for data in sealed]
            opening += time.perf_counter_ns() - between
            sealing += between - start
            assert all(got == [plain] for got, _ in opened)
        seals.append(sealing / PACKETS / 1e3)
        opens.append(opening / PACKETS / 1e3)
    both = median(map(sum, zip(seals, opens, strict=True)))
    return [
        (f"seal a packet of {SIZE} bytes", f"{median(seals):.1f} us", ""),
        ("open it", f"{median(opens):.1f} us", ""),
        ("  sent and received together", f"{both:.1f} us", "asked: at most 15"),
        ("an association, both ends' part of it", f"{median(meets) * 1e3:.1f} ms", ""),
    ]
