"""Every built-in effect keeps its promises, and `check_effect` notices each way of breaking one."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest

from channel import Delay, Effect, Ints, Mahimahi, Rng, by_time, check_effect, describe, parse_link
from channel.link import EFFECTS
from channel.schedule import Order
from teleop.errors import Refused


def test_every_built_in_effect_conforms_and_none_is_forgotten(every_effect: list[Effect]) -> None:
    for effect in every_effect:
        check_effect(effect)
        if isinstance(effect, Mahimahi):  # of the others none looks at the size
            check_effect(effect, size=1500)
        assert parse_link(describe(effect)) == effect
    assert {describe(effect).partition("(")[0] for effect in every_effect} == set(EFFECTS)


@dataclass(frozen=True)
class Broken(Effect):
    """An effect with one fault."""

    fault: str
    order: ClassVar[Order] = "any"
    reorders: ClassVar[bool] = False

    def begin(self, rng: Rng) -> Any:
        return [rng, 0]

    def carry(self, state: Any, packet: Ints, time_ns: Ints, size: int) -> tuple[Ints, Ints, Any]:
        rng, seen = state
        later = (rng.uniform(packet) * 1e8).astype(np.int64)
        keep = np.ones(len(packet), bool)
        match self.fault:
            case "wrote to its input":
                time_ns += 1
            case "int64":
                return packet, time_ns.astype(np.float64), state  # type: ignore[return-value]
            case "not sorted":
                return packet, time_ns + later, state
            case "invented":
                return packet + 10**6, time_ns, state
            case "before it entered":
                return packet, time_ns - 1, state
            case "changes a state":
                state[1] = seen + len(packet)
                return packet, time_ns + seen, state
            case "random numbers of its own":
                keep = np.random.default_rng().random(len(packet)) < 0.5
            case "pieces":
                keep = np.arange(len(packet)) > 0
            case "order of packets":
                keep, state = (np.arange(len(packet)) + seen) % 3 > 0, [rng, seen + len(packet)]
            case "reorders":
                return *by_time(packet, time_ns + later), state
            case "both directions":
                keep = Rng(rng.seed, 0, rng.place).uniform(packet) < 0.5
            case "every place":
                keep = Rng(rng.seed, rng.direction, 0).uniform(packet) < 0.5
        return packet[keep], time_ns[keep], state


@dataclass(frozen=True)
class LateDelay(Delay):
    """A delay that adds 1 ns to what it states."""

    def carry(self, state: None, packet: Ints, time_ns: Ints, size: int) -> tuple[Ints, Ints, None]:
        return packet, time_ns + self.constant_ns + 1, None


@pytest.mark.parametrize("fault", [
    "wrote to its input", "int64", "not sorted", "invented", "before it entered", "changes a state",
    "random numbers of its own", "pieces", "order of packets", "reorders", "both directions", "every place"])
def test_each_fault_is_named(fault: str) -> None:
    with pytest.raises(Refused, match=fault):
        check_effect(Broken(fault))


def test_a_sound_effect_of_ones_own_passes_and_one_that_does_more_than_its_constant_delay_does_not() -> None:
    check_effect(Broken("none"))
    with pytest.raises(Refused, match="does more than the constant delay that its `constant_ns` states"):
        check_effect(LateDelay(0.01))
