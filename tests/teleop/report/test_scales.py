"""Axes: where values lie, and ticks at round numbers."""

from __future__ import annotations

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from teleop.report.scales import PlotAxis, along, around

SIZES = st.floats(-1e29, 1e29, allow_nan=False)


@given(low=SIZES, high=SIZES)
def test_all_values_lie_on_the_axis_around_them_and_it_has_two_ticks_or_more(low: float, high: float) -> None:
    assume(low <= high)
    axis = around(low, high)
    assert 0.0 <= axis.at(low) <= axis.at(high) <= 1.0
    ticks = [value for value, _ in axis.ticks(5)]
    assert 2 <= len(ticks) <= 6
    assert all(-1e-6 <= axis.at(value) <= 1.0 + 1e-6 for value in ticks)
    assert ticks == sorted(set(ticks))


def test_ticks_are_labelled_by_round_numbers() -> None:
    assert [said for _, said in around(0.0, 0.06).ticks(4)] == ["0", "0.02", "0.04", "0.06"]
    assert [said for _, said in PlotAxis(-0.5, 1.5).ticks(4)] == ["-0.5", "0", "0.5", "1.0", "1.5"]
    assert [said for _, said in PlotAxis(20.0, 5e3, log=True).ticks(5)] == ["100", "1000"]


def test_within_a_decade_a_log_axis_has_ticks_between() -> None:
    assert [said for _, said in PlotAxis(1.5, 8.0, log=True).ticks(5)] == ["2", "5"]


def test_an_axis_that_bends_has_its_zero_and_its_decades() -> None:
    axis = along([0.0, 0.1, 1.0, 10.0, 100.0], "symlog", 0.1)
    assert [axis.at(value) for value in (0.0, 0.1, 100.0)] == [0.0, 0.5 / 3.5, 1.0]
    assert axis.at(10.0) - axis.at(1.0) == pytest.approx(axis.at(100.0) - axis.at(10.0))


def test_what_has_no_values_has_an_axis_all_the_same() -> None:
    assert around(float("inf"), float("-inf")) == PlotAxis(0.0, 1.0)
    assert around(0.0, 0.0).at(0.0) == 0.5
