"""Knobs that declare themselves: the declaration in an annotation, and the check of a dataclass against it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any

import pytest

from teleop import Knob, Refused, check_knobs
from teleop.knob import UNDECLARED, Declared, declared, knobs_of_fields

METRES = Knob("m", "position")


@dataclass(frozen=True, kw_only=True)
class Part:
    K: Annotated[float, Knob("N/m", "stiffness", low=0.0)] = 1.0
    share: Annotated[float, Knob("", "share", above=0.0, high=1.0)] = 0.5
    age: Annotated[float | None, Knob("s", "age", above=0.0)] = None
    mode: str = "calm"
    bare: float = 0.0
    needed: Annotated[float, METRES]
    made: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        check_knobs(self)


def test_a_declaration_is_taken_out_of_its_annotation() -> None:
    hints: tuple[tuple[Any, Any], ...] = (
        (float, (float, UNDECLARED)), (Annotated[float, METRES], (float, METRES)),
        (Annotated[float, "a text of another library"], (float, UNDECLARED)),
        (Annotated[float | None, METRES], (float | None, METRES)),
        (Annotated[float, METRES] | None, (float | None, METRES)),
        (Annotated[Annotated[float, Knob("s")], METRES], (float, METRES)))
    for hint, found in hints:
        assert declared(hint) == found, hint


def test_the_fields_that_are_given_are_the_knobs_of_a_part() -> None:
    found = knobs_of_fields(Part)
    assert [*found] == ["K", "share", "age", "mode", "bare", "needed"]
    assert found["needed"] == Declared(float, ..., METRES)
    assert found["bare"] == Declared(float, 0.0, UNDECLARED)


def test_a_part_with_a_type_that_cannot_be_found_has_knobs_that_declare_nothing() -> None:
    @dataclass(frozen=True)
    class Odd:
        K: Nowhere = 1.0  # noqa: F821

    assert knobs_of_fields(Odd) == {"K": Declared("Nowhere", 1.0, UNDECLARED)}


def test_a_part_out_of_its_bounds_is_refused_with_the_unit() -> None:
    given: tuple[tuple[dict[str, Any], str], ...] = (
        ({"K": -1}, "K must be at least 0 N/m, not -1; write for example K=0"),
        ({"share": 0.0}, "share must be above 0, not 0; write for example share=1"),
        ({"age": 0.0}, "age must be above 0 s, not 0; write for example age=1"),
        ({"bare": float("nan")}, "bare must be finite, not nan; write for example bare=1"),
        ({"needed": "far"}, "needed must be a number, not 'far'; write for example needed=1"))
    for parts, sentence in given:
        with pytest.raises(Refused) as refused:
            Part(**{"needed": 0.0, **parts})
        assert str(refused.value) == sentence
