"""Every built-in effect keeps its promises, and `check_effect` notices each way of breaking one."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest

from channel.conformance import check_effect
from channel.delay import Delay
from channel.effect import Effect
from channel.link import EFFECTS, describe, parse_link
from channel.rng import Ints, Rng
from channel.schedule import Order, by_time
from teleop.errors import Refused


def test_every_built_in_effect_conforms(every_effect: list[Effect]) -> None:
    for effect in every_effect:
        check_effect(effect)
        check_effect(effect, size=1500)


def test_no_built_in_effect_is_left_out(every_effect: list[Effect]) -> None:
    assert {describe(effect).partition("(")[0] for effect in every_effect} == set(EFFECTS)
    for effect in every_effect:
        assert parse_link(describe(effect)) == effect


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
        later = rng.uniform(packet)
        match self.fault:
            case "wrote to its input":
                time_ns += 1
            case "int64":
                return packet, time_ns.astype(np.float64), state  # type: ignore[return-value]
            case "not sorted":
                return packet, time_ns + (later * 1e8).astype(np.int64), state
            case "invented":
                return packet + 10**6, time_ns, state
            case "before it entered":
                return packet, time_ns - 1, state
            case "changes a state":
                state[1] = seen + len(packet)
                return packet, time_ns + seen, state
            case "random numbers of its own":
                keep = np.random.default_rng().random(len(packet)) < 0.5
                return packet[keep], time_ns[keep], state
            case "pieces":
                return packet[1:], time_ns[1:], state
            case "order of packets":
                keep = (np.arange(len(packet)) + seen) % 3 > 0
                return packet[keep], time_ns[keep], [rng, seen + len(packet)]
            case "reorders":
                return *by_time(packet, time_ns + (later * 1e8).astype(np.int64)), state
            case "both directions" | "every place":
                other = Rng(rng.seed, rng.direction if self.fault == "every place" else 0,
                             rng.place if self.fault == "both directions" else 0)
                keep = other.uniform(packet) < 0.5
                return packet[keep], time_ns[keep], state
        return packet, time_ns, state


def test_a_sound_effect_of_ones_own_passes() -> None:
    check_effect(Broken("none"))


@dataclass(frozen=True)
class LateDelay(Delay):
    """A delay that adds 1 ns to what it states."""

    def carry(self, state: None, packet: Ints, time_ns: Ints, size: int) -> tuple[Ints, Ints, None]:
        return packet, time_ns + self.constant_ns + 1, None


def test_an_effect_that_does_more_than_its_constant_delay_is_refused() -> None:
    with pytest.raises(Refused, match="does more than the constant delay that its `constant_ns` states"):
        check_effect(LateDelay(0.01))


@pytest.mark.parametrize("fault", [
    "wrote to its input", "int64", "not sorted", "invented", "before it entered", "changes a state",
    "random numbers of its own", "pieces", "order of packets", "reorders", "both directions", "every place"])
def test_each_fault_is_named(fault: str) -> None:
    with pytest.raises(Refused, match=fault):
        check_effect(Broken(fault))
