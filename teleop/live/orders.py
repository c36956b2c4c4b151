"""Orders to a live process: lines of JSON on its standard input, from the process that started it.

A live page is the parent of the three processes that it shows, and steers them so: no port and no token between them.
What an order may be is below; `teleop.live.turning` and `channel.__main__` carry them out.
"""

from __future__ import annotations

import os
from argparse import ArgumentParser
from collections.abc import Callable, Iterator
from itertools import chain
from time import monotonic_ns
from typing import Any

from teleop.storage.strict_json import (
    Check,
    Misshapen,
    dict_of,
    json_text,
    list_of,
    one_of,
    optional,
    parse,
    real,
    record,
    text,
    truth,
)

SHARE = 0.3  # of a tick: beyond it a flood would starve the tick
MOST_PIECES = 1024  # at one tick, however cheap they are
STDIN = 0
LONGEST = 1 << 13  # bytes of a line: what is longer takes a millisecond and more to read
PIECE = 1 << 12  # bytes that are read at once
MOST = 16  # lines and pieces at one tick
SHARE_NS = 100_000  # of a tick of 1 ms a tenth, and as much of a longer one
_MOST_AXES = 16
_place = optional(list_of(real, most=_MOST_AXES))
_TURN = {"order": one_of("turn"), "knobs": dict_of(text)}
SHAPES: dict[str, Check] = {
    "hand": record({"order": one_of("hand"), "to": _place}, {"swing": _place}),
    "align": record({"order": one_of("align"), "to": list_of(real, most=_MOST_AXES)}),
    "idle": record({"order": one_of("idle")}),
    "clutch": record({"order": one_of("clutch"), "open": truth}),
    "scale": record({"order": one_of("scale"), "to": real}),
    "policy": record({"order": one_of("policy")}, {"takes": truth, "to": list_of(real, most=_MOST_AXES)}),
    "turn": record({**_TURN, "out": text}, {"again": truth, "align": _place}),
}
"""By the word behind `order`: what an end takes."""
OF_THE_RELAY: dict[str, Check] = {"turn": record(_TURN)}
"""What the relay takes."""


def intake(within_ns: int, *, least: int = 1, most: int = MOST_PIECES,
           clock: Callable[[], int] = monotonic_ns) -> Iterator[int]:
    """Count the pieces that may be taken in now: `least` whatever they cost, and up to `most` within `within_ns`.

    One bound for datagrams, for orders and for messages of a device's service. What is left over waits for the next
    tick: whoever sends without pause is slowed down or loses packets, and the force is renewed all the same.

    >>> list(intake(0, least=2)), list(intake(10**12, most=3))
    ([0, 1], [0, 1, 2])
    """
    return chain(range(min(least, most)), _until(clock() + within_ns, range(least, most), clock))


def _until(end_ns: int, pieces: range, clock: Callable[[], int]) -> Iterator[int]:
    for taken in pieces:
        if clock() >= end_ns:
            return
        yield taken


def orders_option(parser: ArgumentParser) -> None:
    """Let a live process take --orders."""
    parser.add_argument("--orders", action="store_true", help="take orders on standard input, a line of JSON each, as "
                        "`teleop demo --page` gives them (see teleop/live/README.md); its end ends this process")


class Orders:
    """The lines that come on `fd`, read without waiting, some of them at each call. `over`: there will be no more."""

    def __init__(self, shapes: dict[str, Check], take: Callable[[dict[str, Any]], None], fd: int = STDIN) -> None:
        self.fd, self.over = fd, False
        self._shapes, self._take = shapes, take
        self._rest = bytearray()
        self._ended = False
        os.set_blocking(fd, False)

    @property
    def waiting(self) -> bool:
        """True if there are lines that were read and not carried out yet."""
        return b"\n" in self._rest or (self._ended and not self.over)

    def read(self, clock: Callable[[], int] = monotonic_ns) -> None:
        """Hand over orders that have come, as many as a tick has time for; what is none is refused, in a sentence."""
        for _ in intake(SHARE_NS, most=MOST, clock=clock):
            end = self._rest.find(b"\n")
            if end >= 0:
                line = bytes(self._rest[:end])
                del self._rest[:end + 1]
                self._obey(line)
            elif self._ended or not self._more():
                break
        self.over = self._ended and b"\n" not in self._rest

    def _more(self) -> bool:
        """Read a piece, without lines that are empty; False if there is nothing now."""
        try:
            data = os.read(self.fd, PIECE)
        except BlockingIOError:
            return False
        except OSError:
            data = b""
        self._ended = not data
        self._rest += data
        if self._rest[:1].isspace():
            self._rest = self._rest.lstrip()
        if len(self._rest) > LONGEST and b"\n" not in self._rest:
            self._rest.clear()
            refuse(f"an order is a line of at most {LONGEST} bytes; this one is longer")
        return not self._ended

    def _obey(self, line: bytes) -> None:
        try:
            order = parse(line)
            word = order.get("order") if isinstance(order, dict) else None
            if word not in self._shapes:
                raise Misshapen(f"`order` must be one of {', '.join(self._shapes)}")
            self._shapes[word](order, "it")
        except Misshapen as error:
            refuse(f"an order is a line of JSON such as {{\"order\": \"clutch\", \"open\": true}}: {error}")
        else:
            self._take(order)


def refuse(sentence: str) -> None:
    """Say that an order was not carried out, and why."""
    tell("refused", sentence=sentence)


def tell(event: str, **fields: Any) -> None:
    """Say an event as a line of JSON on standard output, as all events of a live process are said."""
    print(json_text({"event": event, **fields}), flush=True)
