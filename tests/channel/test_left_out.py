"""Ticks that an end leaves out: shares and stretches as they are asked for, the same whatever else is drawn."""

from __future__ import annotations

import numpy as np
import pytest

from channel import LeftOut, LeftOutTicks

COUNT = 40_000


@pytest.mark.parametrize(("share", "stretch"), [(0.01, None), (0.2, None), (0.05, 1.0), (0.2, 8.0), (0.44, 20.0)])
def test_share_and_mean_stretch_are_those_that_were_asked_for(share: float, stretch: float | None) -> None:
    out = LeftOut(share, stretch).left_out(0, COUNT, seed=5)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], out, [False]]).astype(int)))
    stretches = edges[1::2] - edges[::2]
    mean = 1.0 / (1.0 - share) if stretch is None else stretch
    cycles = share * COUNT / mean
    assert out.mean() == pytest.approx(share, rel=5.0 / np.sqrt(cycles))
    assert stretches.mean() == pytest.approx(mean, rel=5.0 / np.sqrt(cycles))
    assert stretch != 1.0 or stretches.max() == 1


def test_a_draw_depends_on_seed_end_and_tick_alone_and_leaves_tick_0_in() -> None:
    for stretch in (None, 4.0):
        ticks = LeftOut(0.3, stretch)
        one = ticks.left_out(0, COUNT, seed=1)
        assert np.array_equal(ticks.left_out(0, 1000, seed=1), one[:1000])
        assert not np.array_equal(ticks.left_out(1, COUNT, seed=1), one)
        assert not np.array_equal(ticks.left_out(0, COUNT, seed=2), one)
        assert not any(ticks.left_out(0, 5, seed=seed)[0] for seed in range(50))


def test_none_and_all_are_shares_too_and_ticks_may_be_named() -> None:
    assert LeftOut(0.0).left_out(0, 100, seed=0).sum() == 0
    assert LeftOut(1.0).left_out(0, 100, seed=0).sum() == 99
    assert np.flatnonzero(LeftOutTicks((0, 3, 4, 1000)).left_out(1, 10, seed=9)).tolist() == [0, 3, 4]
