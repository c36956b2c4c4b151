"""What is drawn of a column of a record: its extremes in each column of pixels, and gaps where there are none."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from teleop.simulation.trace import BLOCK
from teleop.terminal.run_plot import GREATEST, extremes

VALUES = st.floats(allow_nan=True, allow_infinity=True, width=64)


def drawn(t: Any, values: Any, high: float, columns: int) -> tuple[Any, Any, Any]:
    """Where both points of a column are, and the lower and the higher one."""
    at, heights = (each.reshape(-1, 2) for each in extremes(t, values, 0.0, high, columns))
    assert np.array_equal(at[:, 0], at[:, 1])
    return at[:, 0], heights.min(axis=1), heights.max(axis=1)


@given(values=arrays(float, st.integers(1, 200), elements=VALUES), columns=st.integers(2, 10))
def test_each_column_of_pixels_has_the_extremes_of_its_rows_and_of_few_rows_each_is_a_point(
    values: Any, columns: int
) -> None:
    t = np.arange(len(values)) * 0.001
    high = len(values) * 0.001
    sound = np.where(np.abs(values) <= GREATEST, values, np.nan)
    at, least, greatest = drawn(t, values, high, columns)
    if len(values) < 2 * columns:
        assert np.array_equal(at, t)
        rows = [sound[i:i + 1] for i in range(len(values))]
    else:
        place = np.minimum((t * (columns / high)).astype(int), columns - 1)
        rows = [sound[place == column] for column in range(columns)]
    some = [each[np.isfinite(each)] for each in rows]
    assert np.array_equal(least, [each.min() if len(each) else np.nan for each in some], equal_nan=True)
    assert np.array_equal(greatest, [each.max() if len(each) else np.nan for each in some], equal_nan=True)


def test_a_spike_of_one_tick_in_a_million_is_seen_across_the_blocks_that_are_read() -> None:
    values = np.zeros(1_000_000)
    values[[BLOCK - 1, BLOCK, 777_777]] = 1.0, -2.0, 3.0
    _, least, greatest = drawn(np.arange(1_000_000) * 1e-3, values, 1000.0, 600)
    assert np.flatnonzero(greatest == 3.0).tolist() == [777_777 * 600 // 1_000_000]
    edge = BLOCK * 600 // 1_000_000
    assert (least[edge], greatest[edge]) == (-2.0, 1.0)


def test_ticks_that_were_left_out_for_longer_than_a_column_are_a_gap() -> None:
    t = np.concatenate([np.arange(0, 4000), np.arange(8000, 10_000)]) * 1e-3
    _, least, _ = drawn(t, np.ones(6000), 10.0, 100)
    assert np.isnan(least).nonzero()[0].tolist() == [*range(40, 80)]
