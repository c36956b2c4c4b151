"""The evolution strategy, on functions whose least value is known."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import pytest

from teleop.studies.tune.strategy import Strategy, fold


def evolved(value: object, generations: int, key: int = 0) -> Strategy:
    strategy = Strategy([0.2, 0.3, 0.9, 0.5], 0.15, (key, 0))
    for _ in range(generations):
        drawn = strategy.ask()
        strategy.tell(drawn, [(value(fold(x)),) for x in drawn])  # type: ignore[operator]
    return strategy


def valley(x: Sequence[float]) -> float:
    """A narrow valley across all coordinates, a thousand times as steep as it is long."""
    along = sum(x) - 2.0
    return along * along + 1e3 * sum((a - b) ** 2 for a, b in pairwise(x))


def test_it_finds_the_end_of_a_valley_that_no_coordinate_goes_along() -> None:
    strategy = evolved(valley, 150)
    assert fold([*strategy.mean]) == pytest.approx([0.5] * 4, abs=1e-3)
    assert strategy.spread < 0.01


def test_a_least_value_at_the_end_of_a_range_is_found() -> None:
    assert fold([*evolved(sum, 80).mean]) == pytest.approx([0.0] * 4, abs=0.01)


def test_the_same_key_draws_the_same_points() -> None:
    assert [*evolved(valley, 5).mean] == [*evolved(valley, 5).mean] != [*evolved(valley, 5, key=1).mean]
