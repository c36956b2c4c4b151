"""The test vectors of the wire, `teleop/protocol/vectors.json`: datagrams, and the fields of what is accepted.

Whole numbers stand there as text, since some readers of JSON have 53 bits for them. `size`: to which a datagram is
padded, null without padding; `width`: the numbers of a message.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from teleop.protocol.packet import Echo, Kind, Packet

FILE = Path(__file__).parents[3] / "teleop" / "protocol" / "vectors.json"


def vectors() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(FILE.read_text(encoding="utf-8"))
    return found


def packet_of(found: dict[str, Any]) -> Packet:
    kind, payload, echo = Kind[found["kind"]], found["payload"], found["echo"]
    own = int(payload) if kind is Kind.START else tuple(payload) if isinstance(payload, list) else payload
    return Packet(kind, int(found["session"]), found["seq"], int(found["sent_ns"]),
                  None if echo is None else Echo(*map(int, echo)), own, found["E_in"])
