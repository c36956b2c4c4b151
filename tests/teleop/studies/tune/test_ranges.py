"""Where a law's parameters are looked for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop import Knob
from teleop.errors import Refused
from teleop.knob import knobs_of_fields
from teleop.law import find_law, two_port_laws
from teleop.studies.tune.strategy import part, ranges_of, value_at
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


@pytest.mark.parametrize("name", two_port_laws())
def test_the_spans_of_a_law_lie_within_its_bounds_and_about_its_own_values(name: str) -> None:
    law = find_law(name)()
    for knob, span in ranges_of(law).searched.items():
        field = knob.removeprefix("law.")
        declared, own = knobs_of_fields(type(law))[field].knob, getattr(law, field)
        assert declared.span is not None, knob
        declared.check(knob, (span.low, span.high))
        assert span.low <= own <= span.high or own == 0.0


def test_a_knob_that_follows_from_the_slave_is_not_turned() -> None:
    """The mass of the predicted slave was searched from 1/30 to 30 times its own."""
    stay = ranges_of(find_law("wave_prediction")()).held
    assert stay == {"mass": "0.5: the slave's own", "damping": "1: the slave's own"}


def test_a_knob_that_is_set_is_not_turned() -> None:
    found = ranges_of(find_law("wave")(), ["law.K"])
    assert set(found.searched) == {"law.b", "law.B"}
    assert found.held == {"K": "as set"}


def test_a_knob_that_the_law_has_not_is_refused_with_the_nearest() -> None:
    with pytest.raises(Refused, match=r"law wave has no knob 'k'; there are: B, K, b"):
        ranges_of(find_law("wave")(), ["law.k"])


def test_a_law_with_nothing_left_to_tune_is_refused() -> None:
    with pytest.raises(Refused, match="nothing to tune"):
        ranges_of(find_law("wave")(), ["law.K", "law.B", "law.b"])


@given(st.sampled_from([Range(0.02, 18.0, log=True), Range(0.0, 1.0), Range(-3.0, 400.0)]), st.floats(0.0, 1.0))
def test_places_are_what_is_typed_within_the_range(span: Range, u: float) -> None:
    value = value_at(span, u)
    assert span.low <= value <= span.high
    assert float(f"{value:.4g}") == value or value in (span.low, span.high)
    assert value_at(span, part(span, value)) == pytest.approx(value, rel=2e-4, abs=1e-12)
