"""Where a law's parameters are looked for, and the evolution strategy on functions whose least value is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated

import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop import Knob
from teleop.knob import knobs_of_fields
from teleop.law import find_law, two_port_laws
from teleop.studies.tune.strategy import Strategy, fold, part, ranges_of, value_at
from teleop.sweeps.grid import Range


@dataclass(frozen=True, kw_only=True)
class Numbers:
    """Knobs of every kind of bounds, the ends of a law left out: ranges go by knobs alone."""

    K: Annotated[float, Knob("N/m", "stiffness", low=0.0)] = 300.0
    K_d: Annotated[float, Knob("N/m", "more of it", low=0.0)] = 0.0
    alpha: Annotated[float, Knob("", "weight", low=0.0, high=1.0)] = 0.0
    beta: Annotated[float, Knob("", "small share", low=0.0, high=1.0)] = 0.01
    g: Annotated[float, Knob("", "gain", above=0.0, high=2.0)] = 1.0
    off: Annotated[float, Knob("J", "nothing says how large", low=0.0)] = 0.0
    name: str = "text"


def test_a_range_follows_from_bounds_and_default() -> None:
    found = ranges_of(Numbers())
    assert found.searched == {
        "law.K": Range(10.0, 9000.0, log=True), "law.K_d": Range(0.0, 300.0), "law.alpha": Range(0.0, 1.0),
        "law.beta": Range(0.01 / 30.0, 1.0, log=True), "law.g": Range(1.0 / 30.0, 2.0, log=True),
    }
    assert "neither its value nor its bounds" in found.held["off"]


def test_the_spans_of_every_law_lie_within_its_bounds_and_about_its_own_values() -> None:
    for law in [find_law(name)() for name in two_port_laws()]:
        for knob, span in ranges_of(law).searched.items():
            field = knob.removeprefix("law.")
            declared, value = knobs_of_fields(type(law))[field].knob, getattr(law, field)
            assert declared.span is not None, (law, knob)
            declared.check(knob, (span.low, span.high))
            assert span.low <= value <= span.high or value == 0.0, (law, knob)


def test_a_knob_that_is_set_or_follows_from_the_slave_is_not_turned() -> None:
    """The mass of the predicted slave was searched from 1/30 to 30 times its own."""
    assert ranges_of(find_law("wave_prediction")()).held == {
        "mass": "0.5: the slave's own", "damping": "1: the slave's own"}
    found = ranges_of(find_law("wave")(), ["law.K"])
    assert set(found.searched) == {"law.b", "law.B"}
    assert found.held == {"K": "as set"}


@given(st.sampled_from([Range(0.02, 18.0, log=True), Range(0.0, 1.0), Range(-3.0, 400.0)]), st.floats(0.0, 1.0))
def test_places_are_what_is_typed_within_the_range(span: Range, u: float) -> None:
    value = value_at(span, u)
    assert span.low <= value <= span.high
    assert float(f"{value:.4g}") == value or value in (span.low, span.high)
    assert value_at(span, part(span, value)) == pytest.approx(value, rel=2e-4, abs=1e-12)


def evolved(value: object, generations: int, key: int = 0) -> Strategy:
    strategy = Strategy([0.2, 0.3, 0.9, 0.5], 0.15, (key, 0))
    for _ in range(generations):
        drawn = strategy.ask()
        strategy.tell(drawn, [(value(fold(x)),) for x in drawn])  # type: ignore[operator]
    return strategy


def valley(x: Sequence[float]) -> float:
    """A narrow valley across all coordinates, a thousand times as steep as it is long."""
    along = sum(x) - 2.0
    return along * along + 1e3 * sum((a - b) ** 2 for a, b in pairwise(x))


def test_it_finds_the_end_of_a_valley_that_no_coordinate_goes_along_and_of_a_range() -> None:
    strategy = evolved(valley, 150)
    assert fold([*strategy.mean]) == pytest.approx([0.5] * 4, abs=1e-3)
    assert strategy.spread < 0.01
    assert fold([*evolved(sum, 80).mean]) == pytest.approx([0.0] * 4, abs=0.01)


def test_the_same_key_draws_the_same_points() -> None:
    assert [*evolved(valley, 5).mean] == [*evolved(valley, 5).mean] != [*evolved(valley, 5, key=1).mean]
