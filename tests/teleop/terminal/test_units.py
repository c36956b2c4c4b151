"""Numbers as a person reads them: SI prefixes, durations, counts."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop.terminal.table import PREFIX, duration, grouped, si


class TestSI:
    @pytest.mark.parametrize(
        ("value", "unit", "text"),
        [
            (0.0318, "m", "31.8 mm"), (-0.011, "J", "-11.0 mJ"), (3.4e-6, "s", "3.40 us"), (0.0, "J", "0 J"),
            (-0.0, "J", "0 J"), (1.0, "N", "1.00 N"), (999.4, "N", "999 N"), (999.6, "N", "1.00 kN"),
            (0.0009996, "m", "1.00 mm"), (1e6, "m", "1.00 Mm"), (5.08e17, "J", "5.08e+17 J"),
            (1.7e-18, "J", "1.70e-18 J"), (float("inf"), "m", "inf m"), (float("nan"), "N", "nan N"),
        ],
    )
    def test_known_texts(self, value: float, unit: str, text: str) -> None:
        assert si(value, unit) == text

    @given(st.floats(min_value=1e-9, max_value=9.99e11) | st.floats(min_value=-9.99e11, max_value=-1e-9))
    def test_reads_back_to_three_digits(self, value: float) -> None:
        number, unit = si(value, "m").split(" ")
        factor = {letter: 1e3**power for power, letter in PREFIX.items()}[unit.removesuffix("m")]
        assert float(number) * factor == pytest.approx(value, rel=5.001e-3)
        assert 1.0 <= abs(float(number)) < 1000.0
        assert len(re.sub(r"[-.]", "", number)) == 3


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
