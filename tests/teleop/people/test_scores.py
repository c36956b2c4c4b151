"""Scores against their closed forms and printed numbers."""

from __future__ import annotations

from itertools import combinations
from math import isnan, log2

import numpy as np
import pytest

from teleop.people.scores import PAIRS, throughput, tlx_raw, tlx_weighted, tlx_weights


def test_tlx_is_the_printed_one() -> None:
    ratings = (55, 10, 40, 25, 60, 35)
    assert tlx_raw(ratings) == 37.5
    weights = (5, 0, 3, 1, 4, 2)
    assert tlx_weighted(ratings, weights) == pytest.approx(48.6667, abs=5e-5)
    wins = [max(pair, key=lambda item: weights[item]) for pair in combinations(range(6), 2)]
    assert tlx_weights(wins) == weights
    assert sum(weights) == len(PAIRS) == 15


def test_throughput_goes_by_where_reaches_end() -> None:
    """Two targets with ends of a known mean and deviation: log2(D/(4.133 s) + 1) over the mean time, then the mean."""
    ends = np.array([-1.0, 1.0, -1.0, 1.0])
    reaches, expected = [], []
    for distance, width, deviation, time in ((0.1, 0.02, 0.004, 0.8), (0.05, 0.02, 0.002, 0.5)):
        spread = deviation * ends / np.sqrt(4.0 / 3.0)
        reaches += [(distance, width, distance - 0.001 + float(each), time) for each in spread]
        expected.append(log2((distance - 0.001) / (4.133 * deviation) + 1.0) / time)
    assert throughput(reaches) == pytest.approx(sum(expected) / 2.0, rel=1e-12)
    assert isnan(throughput(reaches[:1]))
