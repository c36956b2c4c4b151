"""Effects: rules that map a time-sorted run of packets to another; and chains of effects.

An effect knows packets by number and time, never by content. What it decides, it decides when a packet
enters: `carry` returns everything that will ever come of the packets handed to it. Its random numbers are keyed by
(seed, direction, place in the chain, packet, draw), so both copies of a doubled packet meet the same
verdict behind it, and no verdict depends on which other packets there are.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from os import PathLike, fspath
from typing import TYPE_CHECKING, ClassVar, NoReturn
from zlib import crc32

from channel.rng import Bools, Ints, Rng
from channel.schedule import Arrivals, Order, State, Stream, arrivals
from teleop.errors import Refused, number

if TYPE_CHECKING:
    from teleop.scene.parts import LeftOutLike

LONGEST = 3600.0  # s; packets under way are kept in memory, so no delay may be longer


class LinkPart(ABC):
    """A path between the two ends: an effect, a chain of effects, or a link of two directions."""

    __slots__ = ()

    @abstractmethod
    def in_direction(self, direction: int) -> tuple[Effect, ...]:
        """The effects that a packet passes in this direction (0: fwd, master to slave; 1: bwd)."""

    def leaves_out(self, end: int, dt_ns: int) -> LeftOutLike | None:
        """The ticks (of dt_ns) that end 0, the master, or 1, the slave, leaves out with this link; None: none."""
        return None

    def arrivals(self, direction: int, count: int, dt_ns: int, seed: int, size: int,
                 sent: Bools | None = None) -> Arrivals:
        """The arrivals when packets 0..count-1 are sent at k*dt_ns: see `channel.schedule.arrivals`."""
        return arrivals(self, direction, count, dt_ns, seed, size, sent)

    def stream(self, direction: int, seed: int, size: int) -> Stream:
        """The same packet by packet: see `channel.schedule.Stream`."""
        return Stream(self, direction, seed, size)


class Effect(LinkPart):
    """The base of all effects; final subclasses are frozen dataclasses.

    A subclass writes `carry`, and `begin` where it has a state. `check_effect` (channel.conformance) tries what is
    promised here.
    """

    __slots__ = ()

    order: ClassVar[Order] = "any"
    """The order in which packets must be handed over. "any": a verdict depends on the packet and its own time alone, so
    runs may be cut anywhere; "time": as they enter, sorted by (time, number): a queue; "number": sorted
    by (number, time): what keeps packets in the order in which they were sent."""

    reorders: ClassVar[bool] = True
    """True if packets may leave in another order than they entered."""

    @property
    def constant_ns(self) -> int | None:
        """The delay of every packet (ns), if a constant delay is all that the effect does; otherwise None."""
        return None

    def begin(self, rng: Rng) -> State:
        """The state before the first packet; `rng` is this effect's own, for its direction and place.

        Left out, the random numbers are the whole state.
        """
        return rng

    @abstractmethod
    def carry(self, state: State, packet: Ints, time_ns: Ints, size: int) -> tuple[Ints, Ints, State]:
        """The packets that leave and when, and the next state.

        packet, time_ns: (n,) int64, sorted by time (by number if that is the effect's `order`), ns from the
        start of the session; not to be written to. size: bytes on the wire. Returns (m,) int64 arrays sorted
        by (time, number): a lost packet is absent, a doubled one is there twice. No packet leaves before it
        entered. One long run and the same run in consecutive pieces give the same rows.
        """

    def in_direction(self, direction: int) -> tuple[Effect, ...]:
        """Effects of either direction: this one."""
        return (self,)

    def __or__(self, after: Effect | Chain) -> Chain:
        """This effect, then `after`."""
        return Chain((self,)) | after if isinstance(after, Effect | Chain) else NotImplemented


@dataclass(frozen=True, slots=True)
class Chain(LinkPart):
    """Effects one after the other: `Delay(0.05) | Bernoulli(0.02)`.

    Refused: `in_order` behind a queue that already receives packets out of order. When the queue drops a
    packet, those waiting for it could only be let go too late or clairvoyantly.
    """

    effects: tuple[Effect, ...]

    def __post_init__(self) -> None:
        disordered = queued = False
        for effect in self.effects:
            if not isinstance(effect, Effect):
                raise Refused(f"a link is made of effects, not {effect!r}; write for example Delay(0.05)")
            if effect.order == "number":
                if queued:
                    raise Refused("in_order() cannot stand behind a queue that receives packets out of order;"
                                  " write it right behind the jitter: jitter | in_order() | queue")
                disordered = False
            queued = queued or (effect.order == "time" and disordered)
            disordered = disordered or effect.reorders

    def in_direction(self, direction: int) -> tuple[Effect, ...]:
        """Effects of either direction: these."""
        return self.effects

    def leaves_out(self, end: int, dt_ns: int) -> LeftOutLike | None:
        """The ticks that an end leaves out: those of the first effect that brings some."""
        brought = (effect.leaves_out(end, dt_ns) for effect in self.effects)
        return next((ticks for ticks in brought if ticks is not None), None)

    def __or__(self, after: Effect | Chain) -> Chain:
        """Append `after` to these effects."""
        if not isinstance(after, Effect | Chain):
            return NotImplemented
        return Chain(self.effects + (after.effects if isinstance(after, Chain) else (after,)))


def seconds(name: str, value: object, *, above: float | None = None) -> float:
    """`value` as a time in s that a packet may spend on its way: from 0 (or above `above`) to an hour."""
    got = number(name, value, low=None if above is not None else 0.0, above=above)
    if got > LONGEST:
        raise Refused(f"{name} must be at most {LONGEST:g} s, not {got:g}: every packet under way is kept in "
                      f"memory; write for example {name}=0.5")
    return got


def probability(name: str, value: object) -> float:
    """`value` as a probability, 0 to 1."""
    return number(name, value, low=0.0, high=1.0)


def read_recording(name: str, path: str | PathLike[str]) -> tuple[str, list[str], int]:
    """The path as text, the lines of the file, and the CRC-32 of its bytes.

    The checksum makes effects that replay different recordings of the same name different objects.
    """
    from teleop.storage.files import read_bytes

    if not isinstance(path, str | PathLike):
        raise Refused(f"path must name a recording, not {path!r}; write for example {name}(\"file.txt\")")
    where = fspath(path)
    try:
        data = read_bytes(where)
    except OSError as error:
        raise Refused(f"{where} cannot be read ({error.strerror or error}): {name} replays a recording; "
                      "give the path of a file, or of a part of it that is to be replayed") from None
    try:
        lines = data.decode("utf-8").splitlines()
    except UnicodeDecodeError as error:
        refuse_line(where, data.count(b"\n", 0, error.start) + 1, f"this is not text; {name} reads the text "
                    "that was recorded, unpacked")
    if not any(line.strip() for line in lines):
        raise Refused(f"{where} is empty: there is nothing to replay; record again")
    return where, lines, crc32(data)


def refuse_line(path: str, line: int, what: str) -> NoReturn:
    """Refuses a recording because of one line: what is wrong with it and what to do."""
    raise Refused(f"{path}, line {line}: {what}")
