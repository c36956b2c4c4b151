"""Laws that keep energy, at ends of different rates over a rough link: what they keep came in by their ports.

A sum of energy is a total, so the newest message tells all of it, however many ticks of the other end it stands for.
Energy that is sent in parts is counted twice by a faster end.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pytest

from teleop import At, find_law, seed_energy
from teleop.law import known_laws
from teleop.law.offers import claims_of
from tests.teleop.protocol.test_rates import RATES, ROUGH, column
from tests.teleop.protocol.virtual_clock import MS, World, healing

KEEPERS = [name for name in known_laws() if "E_law" in claims_of(find_law(name)())]
DT, SECONDS = 1e-3, 1.5


def ran(law: Any, every: tuple[int, int]) -> World:
    scene = healing(law, dt=DT, duration=5.0, cap=None)
    return World(scene, every=dict(zip("ms", every, strict=True)), delay={"m": 5 * MS, "s": 5 * MS}, seed=4,
                 **ROUGH).run(SECONDS)


def test_there_are_such_laws() -> None:
    assert {"tdpa", "two_layer", "pspm"} <= set(KEEPERS)


class Part(NamedTuple):
    q: float  # J, sent at this tick


class Tank(NamedTuple):
    E: float


@dataclass(frozen=True, kw_only=True)
class InParts:
    """Dampers at both ends; of the energy that they take up each sends a tenth at every tick, and adds what comes."""

    claims: ClassVar[dict[str, str]] = {"E_law": "any link"}

    def master_start(self, at: At) -> Any:
        return Tank(0.0), Part(0.0)

    def slave_start(self, at: At) -> Any:
        return Tank(0.0), Part(0.0)

    def master(self, s: Tank, at: At, rx: Part) -> Any:
        E = s.E + at.f_held * at.dx + rx.q * at.fresh
        return at.v, Part(0.1 * E), Tank(0.9 * E)

    def slave(self, s: Tank, at: At, rx: Part) -> Any:
        E = s.E - at.f_held * at.dx + rx.q * at.fresh
        return 200.0 * (0.02 - at.x) - at.v, Part(0.1 * E), Tank(0.9 * E)

    def master_stored(self, s: Tank) -> float:
        return s.E

    def slave_stored(self, s: Tank) -> float:
        return s.E


def books(law: Any, every: tuple[int, int]) -> tuple[Any, Any, Any]:
    """What came in by the ports less what is kept, what is kept and the greatest work of a tick so far, and the work
    that went through, J, at the ticks that both ends ran."""
    world = ran(law, every)
    ports, kept = [[column(world, e, f"{ledger}_{e}") for e in "ms"] for ledger in ("E_port", "E_law")]
    ks = sorted(set.intersection(*map(set, ports)))
    m, s, H_m, H_s = (np.array([each[k] for k in ks]) for each in (*ports, *kept))
    work = np.abs(np.diff(m, prepend=0.0)) + np.abs(np.diff(s, prepend=0.0))
    return m - s + seed_energy(law, DT) - H_m - H_s, H_m + H_s + np.maximum.accumulate(work), np.sum(work)


@pytest.mark.parametrize("name", KEEPERS)
@pytest.mark.parametrize("rates", ["1000 and 250 Hz", "250 and 1000 Hz", "333 and 500 Hz"])
def test_what_a_law_keeps_came_in_by_its_ports(rates: str, name: str) -> None:
    honest, left, through = books(find_law(name)(), RATES[rates])
    assert honest.min() >= -1e-9
    assert left.min() >= -1e-9
    assert through > 1e-3, "and it is not nothing that went through"


def test_energy_that_is_sent_in_parts_is_counted_twice_by_a_faster_end() -> None:
    honest, *_ = books(InParts(), RATES["1000 and 250 Hz"])
    assert honest.min() < -1e-6
