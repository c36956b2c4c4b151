"""Rows as JSON objects: every number comes back to the bit, and one that is not finite is left out."""

from __future__ import annotations

import json
from math import isfinite
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from teleop.export.columns import Objects

PATHS = [("t",), ("master", "x", "x"), ("link", "seq"), ("master", "x", "y"), ("master", "50% \"n\"")]
NUMBERS = st.one_of(st.floats(), st.integers(-(10**12), 10**12))


def strict(text: str) -> Any:
    """As a strict reader takes it: it knows no NaN."""
    def refuse(word: str) -> None:
        raise AssertionError(word)

    return json.loads(text, parse_constant=refuse)


@given(st.lists(st.tuples(*[NUMBERS] * len(PATHS)), max_size=5))
def test_every_finite_number_comes_back_to_the_bit_under_its_path(rows: list[tuple[float, ...]]) -> None:
    texts = Objects(PATHS).texts([[row[i] for row in rows] for i in range(len(PATHS))])
    assert len(texts) == len(rows)
    for text, row in zip(texts, rows, strict=True):
        got = strict(text)
        for path, value in zip(PATHS, row, strict=True):
            found: Any = got
            for name in path:
                found = found.get(name, {})
            if isfinite(value):
                assert (repr(found), type(found)) == (repr(value), type(value))
            else:
                assert found == {}


def test_what_is_left_empty_is_left_out_too() -> None:
    assert Objects([("t",), ("x", "x")]).texts([[0.5, 1.5], [float("nan"), 2.5]]) == ['{"t":0.5}',
                                                                                    '{"t":1.5,"x":{"x":2.5}}']


def test_a_sum_that_overflows_leaves_no_number_out() -> None:
    assert Objects([("f",)]).texts([[1e308, 1e308]]) == ['{"f":1e+308}', '{"f":1e+308}']
