"""The packets of a run, counted by what became of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from teleop.scene.scene import Scene
from teleop.simulation.plan import LinkPlans, Plan, link_plans


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


def packet_counts(scene: Scene, seed: int, ran: int, told: Sequence[Any] | None = None) -> dict[str, Packets]:
    """The packets of each direction until tick `ran`, as the schedule has them; `told`: see `link_plans`."""
    counts = counts_of(link_plans(scene, seed, ran, told), ran)
    if told is None:
        return counts
    could = counts_of(link_plans(scene, seed, ran), ran)
    return {way: replace(each, saved=could[way].sent - each.sent) for way, each in counts.items()}


def counts_of(plans: LinkPlans, ran: int) -> dict[str, Packets]:
    """The packets of each direction of two plans, "fwd" and "bwd"; without a link no packet is lost."""
    return {name: Packets.without_link(ran) if each is None else Packets.of_plan(each)
            for name, each in zip(plans._fields, plans, strict=True)}
