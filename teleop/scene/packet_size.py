"""The size of a DATA packet on the wire (`teleop.protocol.packet`), which a scene is held to before anything runs."""

from __future__ import annotations

from struct import Struct

from teleop.errors import Refused

MOST_DATA = 1200  # bytes: below every MTU in use, so that a packet is never cut into fragments
HEAD = Struct("!2sBBH")
CHECKSUM = 4
LEAST = HEAD.size + CHECKSUM
FLOAT = 9  # msgpack's size of a float, and of an integer of 64 bits


def least_size(width: int, *, energy: bool = True) -> int:
    """The bytes that a DATA packet of `width` numbers needs at most; `energy`: E_in is sent along.

    Bytes of UDP payload. Raises `Refused` if no packet can carry that many numbers.

    >>> least_size(5, energy=False)
    100
    """
    # The array, session, seq, sent_ns, echo, payload, and E_in or nil.
    payload = (1 if width < 16 else 3) + width * FLOAT
    body = 1 + FLOAT + 5 + FLOAT + (1 + 2 * FLOAT) + payload + (FLOAT if energy else 1)
    if LEAST + body > MOST_DATA:
        raise Refused(f"a packet carries at most {MOST_DATA} bytes, too few for {width} numbers; send fewer")
    return LEAST + body
