"""What every law keeps to, whatever it claims: each way not to has one sentence, and the right laws have none."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import pytest

from teleop import At, Direct, Facts, Refused, Wave, kind
from teleop.checks import law as law_module
from teleop.checks.conformance import try_conformance
from teleop.checks.law import try_engines
from teleop.errors import number


class Place(NamedTuple):
    x: float


class Force(NamedTuple):
    f_env: float


@dataclass(frozen=True, kw_only=True)
class Mine:
    """Direct reflection with signs, a start, and a condition to get wrong."""

    K: float = 200.0
    B: float = 10.0
    B_m: float = 1.0
    sign_m: float = 1.0
    sign_s: float = 1.0
    sign_x: float = 1.0  # of the position that is sent
    start: float = 1.0
    named: float = 1.0  # of the least sufficient damping, what the sentence tells to type
    claims: ClassVar[dict[str, str]] = {}

    def __post_init__(self) -> None:
        number("B_m", self.B_m, low=0.0)

    def master_start(self, at: At) -> Any:
        return (), Force(0.0)

    def slave_start(self, at: At) -> Any:
        return (), Place(self.start * at.x)

    def master(self, s: Any, at: At, rx: Any) -> Any:
        return self.sign_m * rx.f_env + self.B_m * at.v, Place(self.sign_x * at.x), s

    def slave(self, s: Any, at: At, rx: Any) -> Any:
        return self.sign_s * (self.K * (rx.x - at.x) - self.B * at.v), Force(at.f), s

    def conditions(self, facts: Facts) -> tuple[str, ...]:
        least = 100.0 * facts.dt * facts.mass_m + 1.0
        said = f"the master's damping is to be {least:.6g} N s/m, and B_m is {self.B_m:g}: type --set law.B_m="
        return (f"{said}{self.named * least:.9g}",) if self.B_m < least * (1.0 - 1e-6) else ()


@pytest.mark.parametrize("law", [Mine(), Direct(), Wave()])
def test_a_law_that_is_in_order_passes(law: Any) -> None:
    try_conformance(law)


@pytest.mark.parametrize(("law", "sentence"), [
    (Mine(sign_m=-1.0), r"pulls the hand into the wall with .* N while the slave presses it with .* N; turn"),
    (Mine(sign_x=-1.0), r"sets its slave going by -.* um while the master goes by .* um, against it; turn the sign"),
    (Mine(sign_s=-1.0), r"Mine.slave begins at 0.3 m and 0.4 m/s with 4 N before any message .*, which drives it on"),
    (Mine(start=0.0), r"Mine.slave begins at 0.3 m and 0 m/s with -60 N before any message has come"),
    (Mine(named=0.5), r"with B_m=.* that condition is broken still; name a value that is enough"),
    (Mine(named=1.5), r"less than B_m=.* is enough; name the least value that is"),
])
def test_what_is_wrong_is_told_in_a_sentence(law: Any, sentence: str) -> None:
    with pytest.raises(Refused, match=sentence):
        try_conformance(law)


class Account(NamedTuple):
    x: kind.Sample
    E: kind.Total


class Work(NamedTuple):
    E: float


@dataclass(frozen=True, kw_only=True)
class Coupled:
    """A spring between the ends that tells of the work of all axes, or of that of each."""

    shared: float = 1.0
    claims: ClassVar[dict[str, str]] = {}

    def master_start(self, at: At) -> Any:
        return Work(0.0), Account(at.x, 0.0)

    def slave_start(self, at: At) -> Any:
        return Work(0.0), Account(at.x, 0.0)

    def master_sums(self, s: Work, at: At, rx: Any) -> Work:
        return Work(at.f_held * at.dx)

    def master(self, s: Work, at: At, rx: Any, over: Work) -> Any:
        E = s.E + self.shared * over.E + (1.0 - self.shared) * at.f_held * at.dx
        return 50.0 * (at.x - rx.x) + at.v, Account(at.x, E), Work(E)

    def slave(self, s: Work, at: At, rx: Any) -> Any:
        return 50.0 * (rx.x - at.x) - at.v, Account(at.x, s.E), Work(s.E - at.f_held * at.dx)


def test_a_total_of_coupled_axes_is_one() -> None:
    try_conformance(Coupled())
    with pytest.raises(Refused, match=r"Coupled.master couples its axes and tells another E in each; keep one energy"):
        try_conformance(Coupled(shared=0.0))


class TestEngines:
    @pytest.mark.parametrize("compiled", [False, True])
    def test_every_engine_has_the_bits_of_a_single_run(self, compiled: bool) -> None:
        try_engines(Direct(), compiled=compiled)

    def test_a_figure_that_is_off_by_a_bit_is_caught(self, monkeypatch: pytest.MonkeyPatch) -> None:
        own = law_module.run

        def off(scene: Any) -> Any:
            result = own(scene)
            more = {**result.metrics, "f_m_max": result.metrics["f_m_max"] * (1.0 + 2.0 ** -52)}
            return replace(result, metrics=more)

        monkeypatch.setattr(law_module, "run", off)
        with pytest.raises(Refused, match=r"Direct gives f_m_max = .* by the engine plain, and .* in a single run"):
            try_engines(Direct(), compiled=False)


def test_a_law_that_diverges_by_its_gains_is_not_told_to_turn_a_sign() -> None:
    """The first excursion of a slave that goes out of bounds said nothing of its signs."""
    try_conformance(Mine(K=1e6, B=0.0))
