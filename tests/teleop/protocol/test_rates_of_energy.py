"""Laws that keep energy, at ends of different rates over a rough link: what they keep came in by their ports.

A sum of energy is a total, so the newest message tells all of it, however many ticks of the other end it stands for.
Energy sent in parts would be counted twice by a faster end, and averaged away by a slower one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from teleop import find_law, seed_energy
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


@pytest.mark.parametrize("name", KEEPERS)
@pytest.mark.parametrize("rates", ["1000 and 250 Hz", "250 and 1000 Hz", "333 and 500 Hz"])
def test_what_a_law_keeps_came_in_by_its_ports(rates: str, name: str) -> None:
    law: Any = find_law(name)()
    world = ran(law, RATES[rates])
    ports, kept = [[column(world, e, f"{ledger}_{e}") for e in "ms"] for ledger in ("E_port", "E_law")]
    ks = sorted(set.intersection(*map(set, ports)))
    m, s, H_m, H_s = (np.array([each[k] for k in ks]) for each in (*ports, *kept))
    books = m - s + seed_energy(law, DT) - H_m - H_s
    work = np.maximum.accumulate(np.abs(np.diff(m, prepend=0.0)) + np.abs(np.diff(s, prepend=0.0)))
    assert books.min() >= -1e-9
    assert (H_m + H_s + work).min() >= -1e-9
    assert max(abs(m).max(), abs(s).max()) > 1e-3, "and it is not nothing that went through"
    for e in "ms":
        assert len(world.done[e]) > 100
