"""check_law tells the author of a one-port law of each kind of slip which one it is."""

# ruff: noqa: ARG005 - a law takes what it is given, used or not

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import pytest

from teleop.checks.law import check_law
from teleop.errors import Refused, number
from teleop.law import At
from teleop.laws.virtual_coupling import VirtualCoupling
from teleop.laws.virtual_wall import VirtualWall

NOTHING: dict[str, str] = {}


@pytest.mark.parametrize("law", [
    VirtualWall(), VirtualWall(K=0.0), VirtualWall(K=1e9, B=1e4, at=-3.0),
    VirtualCoupling(), VirtualCoupling(mass=0.0), VirtualCoupling(K=1e9, B=0.0, k_e=1e12, d_e=1e3),
    VirtualCoupling(theta_f=0.0, theta_x=0.0, K=1e12, mass=1e-6),  # diverges, which is no fault of form
    VirtualCoupling(theta_f=0.5, theta_x=0.5, mass=0.0, d_e=5.0),
    VirtualCoupling(theta_f=0.0, theta_x=1.0), VirtualCoupling(theta_f=0.01, theta_x=0.01, d_e=5.0),
])
def test_the_one_port_laws_conform_whatever_their_knobs(law: Any) -> None:
    check_law(law)


class S(NamedTuple):
    y: float


class T(NamedTuple):
    y: float


def start(at: At) -> Any:
    return S(at.x)


def force(s: Any, at: At) -> Any:
    return 10.0 * (at.x - s.y), S(0.5 * (at.x + s.y))


def spoilt(claims: Any = NOTHING, **parts: Any) -> Any:
    """A one-port law that is in order, but for the parts given."""

    @dataclass(frozen=True, kw_only=True)
    class Spoilt:
        K: float = 1.0

        def __post_init__(self) -> None:
            number("K", self.K)

    Spoilt.claims = claims  # type: ignore[attr-defined]
    for name, part in {"start": start, "force": force, **parts}.items():
        if part is not None:
            setattr(Spoilt, name, staticmethod(part))
    return Spoilt()


def test_the_law_that_is_spoilt_below_is_in_order() -> None:
    check_law(spoilt())


def counting() -> Any:
    calls = []

    def counts(s: Any, at: At) -> Any:
        calls.append(at)
        return float(len(calls)), s

    return counts


def fuses() -> Any:
    """Answers twice as ever, and differently when it is asked the same for a third time, much later."""
    seen: dict[At, int] = {}

    def burns(s: Any, at: At) -> Any:
        seen[at] = seen.get(at, 0) + 1
        return 1.0 if seen[at] > 2 and not any(map(math.isnan, at)) else 0.0, s

    return burns


def hides(s: Any, at: At) -> Any:
    return at[1], s


def starts_on_force(at: At) -> Any:
    return S(at.f)


def raises(s: Any, at: At) -> Any:
    return at.x**2, s


SLIPS = [
    ({"force": None}, "has no force; a one-port law has start and force"),
    ({"start": None}, "has no start; a one-port law has start and force"),
    ({"start": lambda at: [at.x]}, "returns the state"),
    ({"start": lambda at: S(0)}, "start .* returns the state with y=0 of type int"),
    ({"start": lambda at: S(1.0 / at.x)}, "raised ZeroDivisionError"),
    ({"start": starts_on_force}, "reads f, but Spoilt.force does not"),
    ({"force": lambda s, at: 10.0 * at.x}, "returns 0.0 of type float; write return force, state"),
    ({"force": lambda s, at: (10.0 * at.x, S(at.x), S(at.x))}, "returns 3 values; write return force, state"),
    ({"force": lambda s, at: (at.x > 0.0, s)}, "returns the force (True|False) of type bool; write it as a float"),
    ({"force": lambda s, at: (at.x, T(at.x))}, "returns a state of type T, but start one of type S"),
    ({"force": lambda s, at: (at.x, S(1))}, "force .* returns the state with y=1 of type int"),
    ({"force": lambda s, at: (at.x / (at.v + 1e-320), s)}, "for finite arguments"),
    ({"force": lambda s, at: (at.x, S(math.inf))}, "for finite arguments"),
    ({"force": raises}, "raised OverflowError"),
    ({"force": counting()}, "differently the second time"),
    ({"force": hides}, "reads v where it cannot be seen"),
    ({"claims": {"E_link": "any link"}}, "a one-port law has no link"),
    ({"claims": {"E_prt": "any link"}}, "which is no ledger"),
    ({"claims": None}, "claims is None"),
]


@pytest.mark.parametrize(("parts", "said"), SLIPS, ids=[said for _, said in SLIPS])
def test_a_slip_is_told_in_one_sentence(parts: dict[str, Any], said: str) -> None:
    with pytest.raises(Refused, match=said) as refused:
        check_law(spoilt(**parts))
    assert "\n" not in str(refused.value)


def test_a_law_that_remembers_outside_its_state_is_found_on_asking_again_later() -> None:
    with pytest.raises(Refused, match="differently the second time"):
        check_law(spoilt(force=fuses()))


def test_a_law_that_changes_itself_is_found() -> None:
    @dataclass(frozen=True, kw_only=True)
    class Sly:
        K: float = 1.0
        claims = NOTHING

        def start(self, at: At) -> Any:
            return ()

        def force(self, s: Any, at: At) -> Any:
            object.__setattr__(self, "K", 2.0)
            return at.x, s

    with pytest.raises(Refused, match=r"Sly.force \(.*py:\d+\) changes the law, K=2.0"):
        check_law(Sly())


def test_a_knob_that_is_no_number_is_refused_as_in_any_law() -> None:
    @dataclass(frozen=True)
    class Positional:
        K: float = 1.0
        claims = NOTHING

        def start(self, at: At) -> Any:
            return ()

        def force(self, s: Any, at: At) -> Any:
            return at.x, s

    with pytest.raises(Refused, match="kw_only=True"):
        check_law(Positional())


def test_a_claim_of_its_port_is_tried_in_closed_loops() -> None:
    check_law(spoilt({"E_port": "any link"}, force=lambda s, at: (0.0, s)))
    with pytest.raises(Refused, match="claims E_port, which fell to -"):
        check_law(spoilt({"E_port": "any link"}, force=lambda s, at: (500.0 * at.x, s)))


def test_a_law_with_parts_of_two_ends_is_told_which_of_those_it_lacks() -> None:
    with pytest.raises(Refused, match="has no master_start; a law has master_start, master, slave_start and slave"):
        check_law(spoilt(slave=lambda s, at, rx: (0.0, rx, s)))
