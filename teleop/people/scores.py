"""Scores of reaches and of questionnaires: Fitts' throughput after ISO 9241-411, and NASA-TLX, raw and weighted.

Fitts: of the reaches to one target the effective distance is the mean of where they end, the effective width is
4.133 standard deviations of it, the effective index of difficulty is ID = log2(D/W + 1), and the throughput is
ID over the mean time; a person's throughput is the mean over the targets (ISO/TS 9241-411:2012, annex B).

NASA-TLX (S. G. Hart and L. E. Staveland, "Development of NASA-TLX", 1988): six ratings from 0 to 100. Raw: their mean.
Weighted: each rating counts as often as it was chosen in the 15 pairs of items, over 15.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from itertools import combinations
from math import log2, nan, sqrt

TLX_ITEMS = ("mental demand", "physical demand", "temporal demand", "performance", "effort", "frustration")
EFFECTIVE = 4.133  # standard deviations of where reaches end, that make the effective width
PAIRS = tuple(combinations(range(len(TLX_ITEMS)), 2))


def throughput(reaches: Sequence[tuple[float, float, float, float]]) -> float:
    """Throughput of a person's reaches (distance, width, end, time), bit/s; NaN where no target has two of them."""
    by_target = defaultdict(list)
    for distance, width, end, time in reaches:
        by_target[distance, width].append((end, time))
    values = []
    for several in by_target.values():
        n = len(several)
        mean = sum(end for end, _ in several) / n
        spread = sqrt(sum((end - mean) ** 2 for end, _ in several) / (n - 1)) if n > 1 else 0.0
        if spread > 0.0 and mean > 0.0:
            values.append(log2(mean / (EFFECTIVE * spread) + 1.0) * n / sum(time for _, time in several))
    return sum(values) / len(values) if values else nan


def tlx_raw(ratings: Sequence[float]) -> float:
    """The mean of the six ratings.

    >>> tlx_raw((55, 10, 40, 25, 60, 35))
    37.5
    """
    return sum(ratings) / len(TLX_ITEMS)


def tlx_weights(chosen: Sequence[int]) -> tuple[int, ...]:
    """Number of times that each item was chosen in the pairs."""
    return tuple(sum(each == item for each in chosen) for item in range(len(TLX_ITEMS)))


def tlx_weighted(ratings: Sequence[float], weights: Sequence[int]) -> float:
    """The ratings, each weighted by how often its item was chosen.

    >>> round(tlx_weighted((55, 10, 40, 25, 60, 35), (5, 0, 3, 1, 4, 2)), 4)
    48.6667
    """
    return sum(rating * weight for rating, weight in zip(ratings, weights, strict=True)) / len(PAIRS)
