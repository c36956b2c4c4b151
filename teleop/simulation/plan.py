"""The packets that each tick of a run in virtual time plays, worked out before its first tick."""

from __future__ import annotations

from collections.abc import Iterable
from numbers import Integral
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.errors import Refused
from teleop.scene.playout import Fixed, Playout
from teleop.scene.scene import Scene

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class Plan(NamedTuple):
    """What one direction of a link comes to over a run of `sent` ticks, one packet sent at each.

    `sent = received + lost + in_flight` and `received = played + overtaken + late + waiting`.
    """

    played_at: NDArray[np.int64]  # for each tick the packet played, or -1
    lag: int  # the greatest tick - play[tick]: messages to keep, less one
    sent: int
    received: int  # packets that came within the run, each counted once
    lost: int  # never came out of the link
    in_flight: int  # came out after the end
    duplicates: int  # further copies within the run
    played: int
    overtaken: int  # a newer one was played before, or at the same tick
    late: int  # fixed: came after its tick
    waiting: int  # fixed: came, and its tick is after the end

    @property
    def play(self) -> list[int]:
        """The packets played, as a list."""
        played: list[int] = self.played_at.tolist()
        return played


def plan(
    playout: Playout, packet: NDArray[np.int64], time_ns: NDArray[np.int64], count: int, dt_ns: int
) -> Plan:
    """The packets played at the ticks 0 .. count-1.

    `packet` and `time_ns` are the arrivals: packet number (0 .. count-1, sent at the tick of its number) and
    the time in ns when a copy of it came out of the link; lost ones are absent, duplicates there twice.
    Raises `Refused` for a number that was not sent.
    """
    import numpy as np

    if packet.shape != time_ns.shape or (packet.size and not 0 <= packet.min() <= packet.max() < count):
        raise Refused(f"arrivals are packets 0 .. {count - 1} and as many times; check the link's effects")
    tick = np.maximum(packet + 1, -(-time_ns // dt_ns))
    numbers = np.arange(count, dtype=np.int64)

    never = np.iinfo(np.int64).max
    first = np.full(count, never, dtype=np.int64)  # the tick at which a packet came for the first time
    np.minimum.at(first, packet, tick)
    came = first < count

    play = np.full(count, -1, dtype=np.int64)
    late = waiting = 0
    if isinstance(playout, Fixed):
        due = numbers + playout.ticks(dt_ns)
        in_time = came & (first <= due)
        on = in_time & (due < count)
        play[due[on]] = numbers[on]
        late = int(np.count_nonzero(came & ~in_time))
        waiting = int(np.count_nonzero(in_time & ~on))
    else:
        np.maximum.at(play, first[came], numbers[came])
        play[1:][play[1:] <= np.maximum.accumulate(play)[:-1]] = -1

    played = play >= 0
    received = int(np.count_nonzero(came))
    lost = int(np.count_nonzero(first == never))
    plays = int(np.count_nonzero(played))
    return Plan(
        played_at=play, lag=int((numbers - play)[played].max(initial=0)),
        sent=count, received=received, lost=lost, in_flight=count - received - lost,
        duplicates=int(np.count_nonzero(tick < count)) - received,
        played=plays, overtaken=received - plays - late - waiting, late=late, waiting=waiting,
    )


class LinkPlans(NamedTuple):
    """The plans of the two directions of a link; None without a link."""

    fwd: Plan | None
    bwd: Plan | None


def link_plans(scene: Scene, seed: int, ticks: int | None = None) -> LinkPlans:
    """The plan of each direction of a scene's link: the packet played at every tick.

    `ticks`: of a run that ended early, how many it had; what was sent and received until then. Raises `Refused` where
    the link does.
    """
    count = scene.ticks if ticks is None else ticks
    if scene.link is None:
        return LinkPlans(None, None)
    plans = []
    for direction in (0, 1):
        arrivals = scene.link.arrivals(direction, count, scene.dt_ns, seed, scene.wire_size)
        plans.append(plan(scene.playout, arrivals.packet, arrivals.time_ns, count, scene.dt_ns))
    return LinkPlans(*plans)


def median_age(played: Any) -> int:
    """The median age of the messages that were played, in ticks, the later of two; 0 of none.

    `played`: for each tick the packet played, or -1; anything that numpy makes an array of.
    """
    import numpy as np

    packets = np.asarray(played, dtype=np.int64)
    fresh = np.flatnonzero(packets >= 0)
    ages = np.sort(fresh - packets[fresh])
    return int(ages[len(ages) // 2]) if len(ages) else 0


def round_trip(played: Iterable[Any | None]) -> int:
    """The round trip that the messages of a run had, ticks: the median ages of both directions; 1 each without a link.

    `played`: of each direction for each tick the packet played, or -1; None without a link.
    """
    return sum(1 if each is None else median_age(each) for each in played)


def check_seed(seed: int) -> int:
    """The seed as an int, also that of numpy. Raises `Refused` for one that does not key the dice."""
    if isinstance(seed, bool) or not isinstance(seed, Integral) or not 0 <= seed < 1 << 64:
        raise Refused(f"seed must be a whole number from 0 to 2^64-1, not {seed!r}; write --seed 1")
    return int(seed)
