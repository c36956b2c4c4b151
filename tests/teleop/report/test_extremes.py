"""What is drawn of a column of a record: its extremes in each column of pixels, and gaps where there are none."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from teleop.report.scales import GREATEST
from teleop.report.svg import line_of
from teleop.simulation.trace import BLOCK

VALUES = st.floats(allow_nan=True, allow_infinity=True, width=64)


@given(values=arrays(float, st.integers(20, 200), elements=VALUES), columns=st.integers(2, 10))
def test_each_column_of_pixels_has_the_extremes_of_its_rows(values: Any, columns: int) -> None:
    t = np.arange(len(values)) * 0.001
    high = len(values) * 0.001
    line = line_of(t, values, 0.0, high, columns)
    place = np.minimum((t * (columns / high)).astype(int), columns - 1)
    sound = np.where(np.abs(values) <= GREATEST, values, np.nan)
    for column in range(columns):
        rows = sound[place == column]
        known = rows[np.isfinite(rows)]
        if len(known):
            assert line.least[column] == known.min()
            assert line.greatest[column] == known.max()
        else:
            assert np.isnan(line.least[column])
            assert np.isnan(line.greatest[column])


@given(values=arrays(float, st.integers(1, 15), elements=VALUES))
def test_of_few_rows_each_is_a_point(values: Any) -> None:
    t = np.arange(len(values)) * 0.5
    line = line_of(t, values, 0.0, len(values) * 0.5, 8)
    assert line.x.tolist() == pytest.approx([i / len(values) for i in range(len(values))])
    assert np.array_equal(line.least, np.where(np.abs(values) <= GREATEST, values, np.nan), equal_nan=True)
    assert np.array_equal(line.least, line.greatest, equal_nan=True)


def test_a_spike_of_one_tick_in_a_million_is_seen_across_the_blocks_that_are_read() -> None:
    values = np.zeros(1_000_000)
    values[[BLOCK - 1, BLOCK, 777_777]] = 1.0, -2.0, 3.0
    line = line_of(np.arange(1_000_000) * 1e-3, values, 0.0, 1000.0, 600)
    assert line.range() == (-2.0, 3.0)
    assert np.flatnonzero(line.greatest == 3.0).tolist() == [777_777 * 600 // 1_000_000]
    edge = BLOCK * 600 // 1_000_000
    assert (line.least[edge], line.greatest[edge]) == (-2.0, 1.0)


def test_ticks_that_were_left_out_for_longer_than_a_column_are_a_gap() -> None:
    t = np.concatenate([np.arange(0, 4000), np.arange(8000, 10_000)]) * 1e-3
    line = line_of(t, np.ones(6000), 0.0, 10.0, 100)
    assert np.isnan(line.least).nonzero()[0].tolist() == [*range(40, 80)]
