"""Ticks that an end leaves out: shares and stretches as they are asked for, the same whatever else is drawn."""

from __future__ import annotations

import numpy as np
import pytest

from channel import LeftOut, LeftOutTicks
from teleop import Refused

COUNT = 40_000


def stretches(out: np.ndarray) -> np.ndarray:
    """The lengths of the stretches of true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], out, [False]]).astype(int)))
    return edges[1::2] - edges[::2]


@pytest.mark.parametrize(("share", "stretch"), [(0.01, None), (0.2, None), (0.05, 1.0), (0.2, 8.0), (0.44, 20.0)])
def test_share_and_mean_stretch_are_those_that_were_asked_for(share: float, stretch: float | None) -> None:
    out = LeftOut(share, stretch).left_out(0, COUNT, seed=5)
    mean = 1.0 / (1.0 - share) if stretch is None else stretch
    cycles = share * COUNT / mean
    assert out.mean() == pytest.approx(share, rel=5.0 / np.sqrt(cycles))
    assert stretches(out).mean() == pytest.approx(mean, rel=5.0 / np.sqrt(cycles))
    assert stretch != 1.0 or stretches(out).max() == 1


@pytest.mark.parametrize("stretch", [None, 4.0])
def test_a_draw_depends_on_seed_end_and_tick_alone_and_leaves_tick_0_in(stretch: float | None) -> None:
    ticks = LeftOut(0.3, stretch)
    one = ticks.left_out(0, COUNT, seed=1)
    assert np.array_equal(ticks.left_out(0, 1000, seed=1), one[:1000])
    assert not np.array_equal(ticks.left_out(1, COUNT, seed=1), one)
    assert not np.array_equal(ticks.left_out(0, COUNT, seed=2), one)
    assert not any(ticks.left_out(0, 5, seed=seed)[0] for seed in range(50))


def test_none_and_all_are_shares_too() -> None:
    assert LeftOut(0.0).left_out(0, 100, seed=0).sum() == 0
    assert LeftOut(1.0).left_out(0, 100, seed=0).sum() == 99


def test_given_ticks_are_left_out_whatever_the_seed() -> None:
    ticks = LeftOutTicks((0, 3, 4, 1000))
    assert np.flatnonzero(ticks.left_out(1, 10, seed=9)).tolist() == [0, 3, 4]


@pytest.mark.parametrize("ticks", [(3, 3), (4, 3), (-1,), (0.5,)])
def test_ticks_that_are_none_or_out_of_order_are_refused(ticks: tuple[int, ...]) -> None:
    with pytest.raises(Refused, match="ticks"):
        LeftOutTicks(ticks)


@pytest.mark.parametrize(("share", "stretch"), [(1.2, None), (-0.1, None), (0.5, 0.5), (0.9, 2.0), (1.0, 5.0)])
def test_shares_and_stretches_that_cannot_be_are_refused(share: float, stretch: float | None) -> None:
    with pytest.raises(Refused, match=r"share|stretch"):
        LeftOut(share, stretch)
