"""The packets that each tick of a run in virtual time plays, and the ticks that it leaves out, before its first tick.

An end that leaves out a tick sends no packet at it, and what comes for it waits for its next tick. There the newest of
all that came wins, as ever; with a fixed delay a packet whose own tick is left out is late, for its instant has passed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from inspect import signature
from numbers import Integral
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from teleop.errors import Refused
from teleop.scene.parts import LeftOutLike
from teleop.scene.playout import Fixed, Playout, Zero
from teleop.scene.scene import Scene
from teleop.stages.memory import LEFT_OUT


class Plan(NamedTuple):
    """Plan of one direction of a link over a run: one packet sent at each tick that its sender runs.

    `sent = received + lost + in_flight` and `received = played + overtaken + late + waiting`.
    """

    played_at: NDArray[np.int64]  # for each tick the packet played, -1 for none, `LEFT_OUT` where the tick is left out
    lag: int  # the greatest tick - play[tick]: messages to keep, less one
    sent: int
    received: int  # packets that came within the run, each counted once
    lost: int  # never came out of the link
    in_flight: int  # came out after the end, or after the receiver's last tick
    duplicates: int  # further copies within the run
    played: int
    overtaken: int  # a newer one was played before, or at the same tick
    late: int  # fixed: came after its tick
    waiting: int  # fixed: came, and its tick is after the end
    due: NDArray[np.int64] | None = None  # by content: of each packet the tick that may play it, see `orders`

    @property
    def orders(self) -> NDArray[np.int64]:
        """Orders for the loop of a run: the packets played; where content decides what is sent, more behind them.

        That is for each packet the tick at which it may be played, and its number: one that never comes has its own
        tick and -1.
        """
        if self.due is None:
            return self.played_at
        numbers = np.arange(len(self.due))
        return np.concatenate([self.played_at, self.due, np.where(self.due > numbers, numbers, -1)])

    @property
    def reach(self) -> int:
        """The most ticks that a message is kept for."""
        if self.due is None:
            return self.lag
        return int((self.due - range(len(self.due))).max(initial=0))

    @property
    def play(self) -> list[int]:
        """The packets played, as a list."""
        played: list[int] = self.played_at.tolist()
        return played

    def packets_until(self, ran: int) -> NDArray[np.int64]:
        """For each of the first `ran` ticks the packet played, or -1."""
        return np.maximum(self.played_at[:ran], -1)


def plan(
    playout: Playout, packet: NDArray[np.int64], time_ns: NDArray[np.int64], count: int, dt_ns: int,
    sent: NDArray[np.bool_] | None = None, left_out: NDArray[np.bool_] | None = None, *, by_content: bool = False,
) -> Plan:
    """The packets played at the ticks 0 .. count-1.

    `packet` and `time_ns` are the arrivals: packet number (0 .. count-1, sent at the tick of its number) and
    the time in ns when a copy of it came out of the link; lost ones are absent, duplicates there twice. `sent`: the
    ticks at which one was sent, `left_out`: those that the receiver leaves out, (count,) each; None: all, and none.
    `by_content`: which packets are sent is known only as the run goes, so it has `due`. Raises `Refused` for a number
    that was not sent.
    """
    if packet.shape != time_ns.shape or (packet.size and not 0 <= packet.min() <= packet.max() < count):
        raise Refused(f"arrivals are packets 0 .. {count - 1} and as many times; check the link's effects")
    tick = np.maximum(packet + 1, -(-time_ns // dt_ns))
    if left_out is not None:
        tick = _next_run(left_out)[np.minimum(tick, count)]
    numbers = np.arange(count, dtype=np.int64)

    never = np.iinfo(np.int64).max
    first = np.full(count, never, dtype=np.int64)  # the tick at which a packet came for the first time
    np.minimum.at(first, packet, tick)
    arrives = first < count

    play = np.full(count, -1, dtype=np.int64)
    at = first
    late = waiting = 0
    if isinstance(playout, Fixed):
        due = numbers + playout.ticks(dt_ns)
        in_time = arrives & (first <= due)
        if left_out is not None:  # it came by then, but nobody was there
            in_time &= ~np.append(left_out, False)[np.minimum(due, count)]
        on = in_time & (due < count)
        at = np.where(on, due, never)
        play[due[on]] = numbers[on]
        late = int(np.count_nonzero(arrives & ~in_time))
        waiting = int(np.count_nonzero(in_time & ~on))
    else:
        np.maximum.at(play, first[arrives], numbers[arrives])
        play[1:][play[1:] <= np.maximum.accumulate(play)[:-1]] = -1

    if left_out is not None:
        play[left_out] = LEFT_OUT
    played = play >= 0
    received = int(np.count_nonzero(arrives))
    lost = int(np.count_nonzero(first == never)) - (0 if sent is None else count - int(np.count_nonzero(sent)))
    total = count if sent is None else int(np.count_nonzero(sent))
    plays = int(np.count_nonzero(played))
    return Plan(
        played_at=play, lag=int((numbers - play)[played].max(initial=0)),
        sent=total, received=received, lost=lost, in_flight=total - received - lost,
        duplicates=int(np.count_nonzero(tick < count)) - received,
        played=plays, overtaken=received - plays - late - waiting, late=late, waiting=waiting,
        due=np.where(at < count, at, numbers) if by_content else None,
    )


def _next_run(left_out: NDArray[np.bool_]) -> NDArray[np.int64]:
    """For each of the ticks 0 .. count the first from there on that is run; that after the end is."""
    count = len(left_out)
    runs = np.append(np.where(left_out, count, np.arange(count, dtype=np.int64)), count)
    after: NDArray[np.int64] = np.minimum.accumulate(runs[::-1])[::-1]
    return after


class LinkPlans(NamedTuple):
    """The plans of the two directions of a link; None without a link, save where an end leaves out ticks.

    Then it is that of a link without delay, which is the same; of a one-port scene `bwd` plays nothing.
    """

    fwd: Plan | None
    bwd: Plan | None


def link_plans(scene: Scene, seed: int, ticks: int | None = None,
               sent_by_end: Sequence[NDArray[np.bool_]] | None = None) -> LinkPlans:
    """The plan of each direction of a scene's link: the packet played at every tick.

    `ticks`: of a run that ended early, how many it had; what was sent and received until then. Raises `Refused` where
    the link does. `sent_by_end`: of a run in which content decides what is sent, the ticks at which each end, master
    and slave, sent its message; without it the plans are those of all that the ends could send, and have `due`.
    """
    count = scene.ticks if ticks is None else ticks
    parts = scene.leaves_out("m"), scene.leaves_out("s")
    if scene.link is None and scene.deadband is None and parts == (None, None):
        return LinkPlans(None, None)
    out = [None if part is None else _left_out(part, end, count, seed) for end, part in enumerate(parts)]
    if scene.slave is None:
        assert out[0] is not None
        return LinkPlans(None, _without_packets(out[0]))
    plans = []
    for direction, (sender, receiver) in enumerate((out, out[::-1])):
        sent = None if sender is None else ~sender
        packet, time_ns = _arrivals(scene, direction, count, seed, sent)
        playout = Zero() if scene.link is None else scene.played_as
        if sent_by_end is not None:
            sent = sent_by_end[direction] if sent is None else sent & sent_by_end[direction]
            were = sent[packet]
            packet, time_ns = packet[were], time_ns[were]
        plans.append(plan(playout, packet, time_ns, count, scene.dt_ns, sent, receiver,
                          by_content=scene.deadband is not None and sent_by_end is None))
    return LinkPlans(*plans)


def _left_out(part: LeftOutLike, end: int, count: int, seed: int) -> NDArray[np.bool_]:
    """The ticks that an end leaves out, of a part that may be the user's own. Raises `Refused` if they are none."""
    out = part.left_out(end, count, seed)
    if not isinstance(out, np.ndarray) or out.dtype != np.bool_ or out.shape != (count,):
        what = f"an array {out.shape} of {out.dtype}" if isinstance(out, np.ndarray) else type(out).__name__
        raise Refused(f"{type(part).__name__}.left_out gives {what}, not a truth for each of {count} ticks; return an "
                      "array such as numpy.zeros(count, dtype=bool)")
    return out


def _without_packets(left_out: NDArray[np.bool_]) -> Plan:
    """The plan of an end to which nothing is sent."""
    return Plan(np.where(left_out, LEFT_OUT, -1), 0, 0, 0, 0, 0, 0, 0, 0, 0, 0)


def _arrivals(scene: Scene, direction: int, count: int, seed: int, sent: NDArray[np.bool_] | None
              ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The packets that come in one direction, and when (ns)."""
    if scene.link is None:
        packet = np.arange(count, dtype=np.int64) if sent is None else np.flatnonzero(sent)
        return packet, packet * scene.dt_ns
    draw: Any = scene.link.arrivals
    if sent is None or "sent" in signature(draw).parameters:
        some = {} if sent is None else {"sent": sent}
        arrivals = draw(direction, count, scene.dt_ns, seed, scene.wire_size, **some)
        return arrivals.packet, arrivals.time_ns
    arrivals = draw(direction, count, scene.dt_ns, seed, scene.wire_size)
    were = sent[arrivals.packet]
    return arrivals.packet[were], arrivals.time_ns[were]


def median_age(played: Any) -> int:
    """The median age of the messages that were played, in ticks, the later of two; 0 of none.

    `played`: for each tick the packet played, or -1; anything that numpy makes an array of.
    """
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


@dataclass(frozen=True, kw_only=True)
class Packets:
    """Counts of one direction. `rejected` names the cause of each refusal; it happens live only."""

    sent: int = 0
    received: int = 0
    lost: int = 0
    late: int = 0
    overtaken: int = 0
    duplicates: int = 0
    in_flight: int = 0
    saved: int = 0  # that a deadband did not send
    rejected: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def of_plan(cls, plan: Plan) -> Packets:
        """The counts of a direction that was drawn up front."""
        return cls(sent=plan.sent, received=plan.received, lost=plan.lost, late=plan.late, overtaken=plan.overtaken,
                   duplicates=plan.duplicates, in_flight=plan.in_flight)

    @classmethod
    def without_link(cls, ticks: int) -> Packets:
        """No queue and no packets: each end sees the other's last message."""
        return cls(sent=ticks, received=max(0, ticks - 1), in_flight=min(1, ticks))


def packet_counts(scene: Scene, seed: int, ran: int, sent_by_end: Sequence[Any] | None = None) -> dict[str, Packets]:
    """The packets of each direction until tick `ran`, as the schedule has them; `sent_by_end`: see `link_plans`."""
    counts = counts_of(link_plans(scene, seed, ran, sent_by_end), ran)
    if sent_by_end is None:
        return counts
    could = counts_of(link_plans(scene, seed, ran), ran)
    return {way: replace(each, saved=could[way].sent - each.sent) for way, each in counts.items()}


def counts_of(plans: LinkPlans, ran: int) -> dict[str, Packets]:
    """The packets of each direction of two plans, "fwd" and "bwd"; without a link no packet is lost."""
    return {name: Packets.without_link(ran) if each is None else Packets.of_plan(each)
            for name, each in zip(plans._fields, plans, strict=True)}
