"""The adversarial search of `check_law`: it finds the claims that trials at ordinary gains let pass."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import pytest

from teleop.checks.law import check_law
from teleop.checks.search import try_worst
from teleop.checks.trials import RandomLink, try_claims
from teleop.errors import Refused, number
from teleop.law import At, find_law, known_laws
from teleop.law.offers import Facts, claims_of, enough
from teleop.laws.around.names import around
from teleop.laws.direct import Direct
from teleop.laws.tdpa import TDPA
from tests.teleop.checks.mutants_energy import hold_unbooked, mutant

CLAIMING = [name for name in known_laws() if not {"E_law", "E_port"}.isdisjoint(claims_of(find_law(name)()))]


def _old_conditions(self: TDPA, facts: Facts) -> tuple[str, ...]:
    """What TDPA said to be enough: B >= K dt/2 of the coupling, and dampers that bodies can be held by."""
    least, most = 0.5 * self.K * facts.dt, facts.mass_m / facts.held
    bounds = [("B", least > self.B, enough(least, least=True)),
              ("alpha_max", self.alpha_max > most, enough(most, least=False)),
              ("B", self.B * facts.held > 2.0 * facts.mass_s, enough(2.0 * facts.mass_s / facts.held, least=False))]
    return tuple([f"{knob} is out of bounds; --set law.{knob}={value}" for knob, breaks, value in bounds if breaks])


OLD = mutant(TDPA, "HoldUnbooked", slave_sums=hold_unbooked, conditions=_old_conditions)


def test_a_coupling_whose_hold_is_not_booked_passes_the_trials_and_is_found_by_the_search() -> None:
    try_claims(OLD)
    with pytest.raises(Refused, match=r"claims E_law, but at tick \d+ its slave keeps .* J more than came in") as got:
        check_law(OLD, compiled=False)
    with pytest.raises(Refused) as again:
        try_worst(OLD)
    assert str(again.value) == str(got.value)  # the same points each time


@pytest.mark.parametrize("key", ["another", "and another"])
def test_the_search_finds_it_whatever_points_it_begins_with(key: str) -> None:
    with pytest.raises(Refused, match="its slave keeps"):
        try_worst(OLD, key=key)


@dataclass(frozen=True, kw_only=True)
class Damper:
    """A damper at a port, which gives energy out where it turns the master round within a tick: b > 2 m/dt."""

    b: float = 5.0
    claims: ClassVar[dict[str, str]] = {"E_port": "any link"}

    def __post_init__(self) -> None:
        number("b", self.b, low=0.0)

    def start(self, at: At) -> tuple[()]:
        return ()

    def force(self, s: Any, at: At) -> Any:
        return self.b * at.v, s


def test_a_one_port_law_that_claims_its_port_at_any_gain_is_found() -> None:
    with pytest.raises(Refused, match=r"claims E_port, which fell to -.* Damper\(b=\d+"):
        check_law(Damper())


def test_what_a_search_has_seen_is_in_its_answer() -> None:
    worst = try_worst(TDPA(), runs=12)
    assert worst.runs == 24
    assert set(worst.fractions) == set(worst.scenes) == {"books", "E_law"}
    assert worst.fractions["books"] <= 1e-6
    assert -1.0 <= worst.port <= 0.0
    assert worst.fractions["E_law"] <= 1.0


def test_a_law_that_claims_neither_is_not_searched() -> None:
    assert try_worst(Direct()).runs == 0


def test_nothing_comes_in_a_blackout() -> None:
    packets = RandomLink(ticks=5, loss=0.0, jitter=0, copies=0.0, key=0.1, blackout=30).arrivals(0, 120, 10**6, 0, 100)
    assert set(packets.packet.tolist()) == {*range(30), *range(60, 90)}


@pytest.mark.soak
@pytest.mark.parametrize("name", [*CLAIMING, "guard"])
def test_long_searches_find_nothing_and_print_what_came_closest(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    law = around("guard", Direct()) if name == "guard" else find_law(name)()
    found = [try_worst(law, runs=400, key=key) for key in "abcde"]
    worst = min(each.port for each in found)
    with capsys.disabled():
        print(f"\n{name}: {sum(each.runs for each in found)} runs, least E_port {-worst:.4f} of its bound, E_law "
              f"{max(each.fractions['E_law'] for each in found):.4f} of it")
    assert worst >= -1.0
