"""Losses, copies and blackouts: stated shares and burst lengths, and where the knobs end."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

from channel.bernoulli import Bernoulli
from channel.blackout import Blackout
from channel.duplicate import Duplicate
from channel.effect import Effect
from channel.gilbert_elliott import GilbertElliott
from channel.rng import Rng
from teleop.errors import Refused

MS = 1_000_000


def lost(effect: Effect, count: int, seed: int = 1) -> NDArray[np.bool_]:
    """Which of the packets 0..count-1 never arrive."""
    return ~np.isin(np.arange(count), effect.arrivals(0, count, MS, seed, 100).packet)


def bursts(gone: NDArray[np.bool_]) -> NDArray[np.int64]:
    """The lengths of all runs of losses."""
    edges = np.diff(np.concatenate(([0], gone.astype(int), [0])))
    return np.flatnonzero(edges < 0) - np.flatnonzero(edges > 0)


@pytest.mark.parametrize("p", [0.01, 0.3, 0.9])
def test_bernoulli_share_and_geometric_bursts(p: float) -> None:
    gone = lost(Bernoulli(p), 50_000)
    assert stats.binomtest(int(gone.sum()), len(gone), p).pvalue > 1e-3
    runs = bursts(gone)
    assert runs.mean() == pytest.approx(1 / (1 - p), abs=4 * np.sqrt(p) / (1 - p) / np.sqrt(len(runs)))


def test_bernoulli_at_its_ends() -> None:
    assert not lost(Bernoulli(0), 5000).any()
    assert lost(Bernoulli(1), 5000).all()


@pytest.mark.parametrize(("p", "r", "g", "h"), [
    (0.01, 0.3, 0.0, 1.0), (0.05, 0.05, 0.0, 0.5), (0.002, 0.1, 0.001, 0.7), (0.8, 0.9, 0.1, 0.6),
    (1.0, 0.4, 0.0, 1.0)])
def test_gilbert_elliott_closed_forms(p: float, r: float, g: float, h: float) -> None:
    """Mean loss and burst length over 200,000 packets; the losses' correlation decays as (1 - p - r)^lag."""
    effect = GilbertElliott(p, r, loss_good=g, loss_bad=h)
    count = 200_000
    gone = lost(effect, count)
    pi_bad = p / (p + r)
    mean = (1 - pi_bad) * g + pi_bad * h
    rho = (h - g) ** 2 * pi_bad * (1 - pi_bad) / (mean * (1 - mean))  # correlation of losses, extrapolated to lag 0
    decay = 1 - p - r
    spread = np.sqrt(mean * (1 - mean) * (1 + 2 * rho * decay / (1 - decay)) / count)
    assert effect.mean_loss == pytest.approx(mean, rel=1e-12)
    assert gone.mean() == pytest.approx(mean, abs=4 * spread)
    for lag in (1, 2, 5):
        assert np.corrcoef(gone[lag:], gone[:-lag])[0, 1] == pytest.approx(rho * decay**lag, abs=0.05)
    runs = bursts(gone)
    assert runs.mean() == pytest.approx(effect.mean_burst, abs=5 * runs.std() / np.sqrt(len(runs)))
    if (g, h) == (0.0, 1.0):
        assert effect.mean_burst == pytest.approx(1 / r)
        geometric = stats.geom(r)
        assert np.mean(runs == 1) == pytest.approx(geometric.pmf(1), abs=4 / np.sqrt(len(runs)))


def test_gilbert_elliott_is_stationary_from_packet_0() -> None:
    effect = GilbertElliott(0.01, 0.03)
    first = [lost(effect, 1, seed)[0] for seed in range(3000)]
    assert stats.binomtest(int(sum(first)), len(first), effect.mean_loss).pvalue > 1e-3


@settings(max_examples=40)
@given(p=st.sampled_from([0.0, 1e-4, 0.02, 0.5, 0.97, 1.0]), r=st.sampled_from([0.0, 1e-4, 0.1, 0.5, 0.9, 1.0]),
       seed=st.integers(0, 99), asked=st.lists(st.integers(0, 5000), min_size=1, max_size=5))
def test_gilbert_elliott_state_is_the_chain_step_by_step(p: float, r: float, seed: int, asked: list[int]) -> None:
    """Whatever packets are asked for, and in which order: the state is that of the chain started at packet 0."""
    if p + r == 0:
        return
    effect = GilbertElliott(p, r)
    u = Rng(seed, 0, 0).uniform(np.arange(5001))
    bad = bool(u[0] < p / (p + r))
    chain = [bad]
    for draw in u[1:].tolist():
        bad = draw < 1 - r if bad else draw < p
        chain.append(bad)
    state = effect.begin(Rng(seed, 0, 0))
    assert effect.bad(state, np.array(asked)).tolist() == [chain[k] for k in asked]
    assert effect.bad(state, np.arange(5001)).tolist() == chain
    assert [bool(effect.bad(state, np.array([k]))[0]) for k in asked] == [chain[k] for k in asked]


def test_gilbert_elliott_far_from_the_start_is_found_by_looking_back() -> None:
    """A packet number of 2^40 costs no more than a few blocks."""
    effect = GilbertElliott(0.01, 0.1)
    far = np.array([2**40 + 5])
    assert effect.bad(effect.begin(Rng(1, 0, 0)), far) == effect.bad(effect.begin(Rng(1, 0, 0)), far)


def test_duplicate_share_and_times() -> None:
    packet, time_ns = Duplicate(0.2, after=0.0035).arrivals(0, 20_000, MS, 1, 100)
    numbers, copies = np.unique(packet, return_counts=True)
    assert np.array_equal(numbers, np.arange(20_000))
    assert set(copies.tolist()) == {1, 2}
    assert stats.binomtest(int((copies == 2).sum()), 20_000, 0.2).pvalue > 1e-3
    late = time_ns - packet * MS
    assert set(late.tolist()) == {0, 3_500_000}
    assert (late > 0).sum() == (copies == 2).sum()


def test_copies_behind_each_other_share_their_fate() -> None:
    both = Duplicate(1.0) | Bernoulli(0.5)
    _, copies = np.unique(both.arrivals(0, 1000, MS, 1, 100).packet, return_counts=True)
    assert set(copies.tolist()) == {2}


def test_blackout_loses_what_gets_there_meanwhile() -> None:
    """First instant inside, last outside; once, or again and again; before the start nothing."""
    assert np.flatnonzero(lost(Blackout(0.1, 0.05), 1000)).tolist() == list(range(100, 150))
    again = [k for k in range(1000) if k >= 100 and (k - 100) % 200 < 50]
    assert np.flatnonzero(lost(Blackout(0.1, 0.05, every=0.2), 1000)).tolist() == again
    assert not lost(Blackout(0.1, 0.0), 1000).any()


@pytest.mark.parametrize(("make", "sentence"), [
    (lambda: Bernoulli(1.1), "p must be at most 1"),
    (lambda: Bernoulli(-0.1), "p must be at least 0"),
    (lambda: Bernoulli(True), "p must be a number"),
    (lambda: GilbertElliott(0.0, 0.0), r"never changes.*bernoulli\(p\)"),
    (lambda: GilbertElliott(0.1, 2.0), "p_bad_to_good must be at most 1"),
    (lambda: GilbertElliott(0.1, 0.2, loss_bad=float("nan")), "loss_bad must be finite"),
    (lambda: Duplicate(0.1, after=-1.0), "after must be at least 0"),
    (lambda: Duplicate(0.1, after=4000.0), "after must be at most 3600"),
    (lambda: Blackout(-1.0, 1.0), "start must be at least 0"),
    (lambda: Blackout(1.0, 2.0, every=2.0), "every must be longer than duration.*every=5"),
])
def test_refusals(make, sentence: str) -> None:
    with pytest.raises(Refused, match=sentence):
        make()
