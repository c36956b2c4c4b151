"""What one who can read the link and write to it does: packets of one's own, and hands on the path."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from channel.link import parse_link
from teleop import Fixed, Hold, Playout, Reading, Scene, Watchdog, Zero
from teleop.protocol.endpoint import Endpoint
from teleop.protocol.manifest import manifest_of
from teleop.protocol.packet import Echo, Kind, Packet, Payload, encode
from tests.teleop.protocol.ends import MS, START, Both, scene

OURS, OTHER = 7, 700  # session numbers
LINK = parse_link("delay(0.01)")
WATCHED = scene(link=LINK, watchdog=Watchdog(timeout=0.05, ramp=0.02))
MANIFEST = manifest_of(WATCHED)
STILL = Reading((0.0,), (0.0,), (0.0,))
PLAYOUTS: list[Playout] = [Zero(), Hold(), Fixed(0.02)]


def data(seq: int, wave: float = 0.1, *, to: str = "s", **changes: Any) -> bytes:
    """A message of our session, sent at tick `seq`, as whoever knows the session number can make it."""
    kind = Kind.FORTH if to == "s" else Kind.BACK
    return encode(Packet(kind, OURS, seq, START + seq * MS, None, (wave,), 0.0)._replace(**changes))


def control(kind: Kind, payload: Payload, session: int = OURS, sent_ns: int = START, echo: Echo | None = None) -> bytes:
    """A word of the session itself."""
    return encode(Packet(kind, session, 0, sent_ns, echo, payload))


def at(k: int) -> int:
    return START + k * MS


def ticks(end: Endpoint, several: Iterable[int], came: Callable[[int], Iterable[bytes]]) -> list[int]:
    """What `end` plays at these ticks, when before each of them this comes."""
    played = []
    for k in several:
        for datagram in came(k):
            end.receive(datagram, at(k))
        played.append(end.tick(k, at(k), STILL).played)
    return played


Change = Callable[[str, int, bytes], Iterable[tuple[int, bytes]]]


def untouched(_e: str, _k: int, datagram: bytes) -> list[tuple[int, bytes]]:
    return [(10, datagram)]


def handed_on(change: Change, given: Scene = WATCHED) -> Both:
    """A run in which every message goes through the hands of one on the path.

    `change` says what comes to end e instead of packet k, and how many ticks after it was sent.
    """
    under_way: dict[int, list[tuple[str, bytes]]] = {}

    def hands(now: int, both: Both) -> list[tuple[str, bytes]]:
        for e, other in ("ms", "sm"):
            if now:
                for after, datagram in change(e, now - 1, both.sent[other][now - 1]):
                    under_way.setdefault(now - 1 + after, []).append((e, datagram))
        return under_way.pop(now, [])

    return Both(given, intruder=hands, silent=lambda _e, _k: True).run()


TAKEOVER: list[tuple[Kind, Payload]] = [
    (Kind.HELLO, MANIFEST), (Kind.HELLO, {"scene": "mine"}), (Kind.WELCOME, {"scene": "mine"}), (Kind.START, at(200)),
    (Kind.REFUSE, "go away"), (Kind.BYE, "emergency stop"),
]
