"""Aligned text, facts and columns, and numbers as a person reads them: SI prefixes, durations, counts."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop.terminal.table import PREFIX, columns, duration, facts, grouped, si


def test_facts_stand_below_each_other_behind_the_longest_label_each_on_its_line() -> None:
    assert facts([("run", "a"), ("", "b"), ("longest", "c")]) == "run       a\n          b\nlongest   c"
    assert facts([("scene", "x\nstatus   ok\x1b[2J")]) == r"scene   x\nstatus   ok\x1b[2J"
    assert facts([]) == ""


def test_columns_are_as_wide_as_their_widest_cell_and_end_without_blanks() -> None:
    lines = columns([("name", "size", "note"), ("a", "10", ""), ("bcdef", "7", "odd")], left=(0, 2)).splitlines()
    assert lines == ["name   size  note", "a        10", "bcdef     7  odd"]


@given(st.floats(min_value=1e-9, max_value=9.99e11) | st.floats(min_value=-9.99e11, max_value=-1e-9))
def test_a_number_with_a_prefix_reads_back_to_three_digits(value: float) -> None:
    number, unit = si(value, "m").split(" ")
    factor = {letter: 1e3**power for power, letter in PREFIX.items()}[unit.removesuffix("m")]
    assert float(number) * factor == pytest.approx(value, rel=5.001e-3)
    assert 1.0 <= abs(float(number)) < 1000.0
    assert len(re.sub(r"[-.]", "", number)) == 3


def test_a_number_beyond_the_prefixes_or_none_is_read_all_the_same() -> None:
    for value, text in ((0.0, "0 m"), (-0.0, "0 m"), (-0.011, "-11.0 mm"), (999.6, "1.00 km"), (0.0009996, "1.00 mm"),
                        (5.08e17, "5.08e+17 m"), (1.7e-18, "1.70e-18 m"), (float("inf"), "inf m"),
                        (float("nan"), "nan m")):
        assert si(value, "m") == text


@given(st.floats(min_value=0.0, max_value=1e9))
def test_a_duration_reads_back_in_a_unit_that_suits_it(seconds: float) -> None:
    text, unit = duration(seconds).split(" ")
    read = float(text) * {"s": 1.0, "min": 60.0, "h": 3600.0}[unit]
    assert read == pytest.approx(seconds, rel=0.0502, abs=1.0 if unit == "s" else 0.0)
    assert "e" not in text
    assert text != "0"
    assert (unit == "s") == (seconds < 99.5)


@given(st.integers(0, 10**20))
def test_a_count_reads_back_from_groups_of_three(count: int) -> None:
    assert int(grouped(count).replace(" ", "")) == count
    assert all(len(group) == 3 for group in grouped(count).split(" ")[1:])
