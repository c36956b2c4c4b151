"""What every law keeps to, whatever it claims: each way not to has one sentence, and the right laws have none."""

# ruff: noqa: ARG005 - an end takes what it is given, used or not

from __future__ import annotations

from typing import Any, NamedTuple

import pytest

from teleop import At, Direct, Facts, Refused, Wave, kind, number
from teleop.checks.conformance import try_conformance
from tests.fakes import law_of


class Place(NamedTuple):
    x: float


class Force(NamedTuple):
    f_env: float


def condition(self: Any, facts: Facts) -> tuple[str, ...]:
    least = 100.0 * facts.dt * facts.mass_m + 1.0
    said = f"the master's damping is to be {least:.6g} N s/m, and B_m is {self.B_m:g}: type --set law.B_m="
    return (f"{said}{self.named * least:.9g}",) if self.B_m < least * (1.0 - 1e-6) else ()


Mine = law_of(  # direct reflection with signs (that of the position sent too), a start, and a condition to get wrong
    name="Mine", knobs=[("B_m", float, 1.0), *[(knob, float, 1.0) for knob in (
        "sign_m", "sign_s", "sign_x", "start", "named")]],
    master_start=lambda self, at: ((), Force(0.0)), slave_start=lambda self, at: ((), Place(self.start * at.x)),
    master=lambda self, s, at, rx: (self.sign_m * rx.f_env + self.B_m * at.v, Place(self.sign_x * at.x), s),
    slave=lambda self, s, at, rx: (self.sign_s * (self.K * (rx.x - at.x) - self.B * at.v), Force(at.f), s),
    conditions=condition, __post_init__=lambda self: number("B_m", self.B_m, low=0.0) and None)


@pytest.mark.parametrize("law", [Mine(K=200.0, B=10.0), Direct(), Wave()])
def test_a_law_that_is_in_order_passes(law: Any) -> None:
    try_conformance(law)


def test_a_law_that_diverges_by_its_gains_is_not_told_to_turn_a_sign() -> None:
    """The first excursion of a slave that goes out of bounds said nothing of its signs."""
    try_conformance(Mine(K=1e6, B=0.0))


@pytest.mark.parametrize(("knob", "value", "sentence"), [
    ("sign_m", -1.0, r"pulls the hand into the wall with .* N while the slave presses it with .* N; turn"),
    ("sign_x", -1.0, r"sets its slave going by -.* um while the master goes by .* um, against it; turn the sign"),
    ("sign_s", -1.0, r"Mine.slave begins at 0.3 m and 0.4 m/s with 4 N before any message .*, which drives it on"),
    ("start", 0.0, r"Mine.slave begins at 0.3 m and 0 m/s with -60 N before any message has come"),
    ("named", 0.5, r"with B_m=.* that condition is broken still; name a value that is enough"),
    ("named", 1.5, r"less than B_m=.* is enough; name the least value that is"),
])
def test_what_is_wrong_is_told_in_a_sentence(knob: str, value: float, sentence: str) -> None:
    with pytest.raises(Refused, match=sentence):
        try_conformance(Mine(K=200.0, B=10.0, **{knob: value}))


class Account(NamedTuple):
    x: kind.Sample
    E: kind.Total


class Work(NamedTuple):
    E: float


def coupled(self: Any, s: Work, at: At, rx: Any, over: Work) -> Any:
    E = s.E + self.shared * over.E + (1.0 - self.shared) * at.f_held * at.dx
    return 50.0 * (at.x - rx.x) + at.v, Account(at.x, E), Work(E)


Coupled = law_of(  # a spring between the ends that tells of the work of all axes, or of that of each
    name="Coupled", knobs=[("shared", float, 1.0)], master=coupled, master_sums=lambda self, s, at, rx: Work(
        at.f_held * at.dx), master_start=lambda self, at: (Work(0.0), Account(at.x, 0.0)),
    slave_start=lambda self, at: (Work(0.0), Account(at.x, 0.0)),
    slave=lambda self, s, at, rx: (50.0 * (rx.x - at.x) - at.v, Account(at.x, s.E), Work(s.E - at.f_held * at.dx)))


def test_a_total_of_coupled_axes_is_one() -> None:
    try_conformance(Coupled())
    with pytest.raises(Refused, match=r"Coupled.master couples its axes and tells another E in each; keep one energy"):
        try_conformance(Coupled(shared=0.0))
