"""Each effect against what its knobs say: distributions, shares and bursts; how effects are joined, and conform."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from channel import (
    Bernoulli,
    Blackout,
    Chain,
    Delay,
    Duplicate,
    Effect,
    GammaJitter,
    GilbertElliott,
    InOrder,
    Ints,
    Mahimahi,
    NormalJitter,
    Rng,
    UniformJitter,
    by_time,
    check_effect,
    describe,
    parse_link,
)
from channel.link import EFFECTS
from channel.schedule import Order
from teleop.errors import Refused

COUNT, MS = 20_000, 1_000_000


def delays(effect: Effect, seed: int = 1, direction: int = 0) -> NDArray[np.float64]:
    packet, time_ns = effect.arrivals(direction, COUNT, MS, seed, 100)
    by_packet = np.argsort(packet)
    assert np.array_equal(packet[by_packet], np.arange(COUNT))
    return (time_ns[by_packet] - packet[by_packet] * MS) / 1e9


def lost(effect: Effect, count: int, seed: int = 1) -> NDArray[np.bool_]:
    """Which of the packets 0..count-1 never arrive."""
    return ~np.isin(np.arange(count), effect.arrivals(0, count, MS, seed, 100).packet)


def bursts(gone: NDArray[np.bool_]) -> NDArray[np.int64]:
    edges = np.diff(np.concatenate(([0], gone.astype(int), [0])))
    return np.flatnonzero(edges < 0) - np.flatnonzero(edges > 0)


# Delays


def test_a_constant_delay_is_exact_in_nanoseconds_and_so_is_a_jitter_without_a_width() -> None:
    for effect, expected_ns in (
            (Delay(0.05), 50_000_000), (Delay(0), 0), (Delay(1e-9), 1), (Delay(0.0012345678), 1_234_568),
            (UniformJitter(0.0), 0), (NormalJitter(0.01, 0.0), 10_000_000), (GammaJitter(0.0, 1.0), 0)):
        packet, time_ns = effect.arrivals(0, 1000, MS, 1, 100)
        assert packet.tolist() == list(range(1000)), effect
        assert time_ns.tolist() == [k * MS + expected_ns for k in range(1000)], effect


def test_a_jitter_has_its_distribution_and_packets_are_independent() -> None:
    """Kolmogorov-Smirnov against the closed form; mean and variance; no correlation with the next packet."""
    gamma = scipy.stats.gamma
    for effect, law in (
        (UniformJitter(0.02), scipy.stats.uniform(0, 0.02)), (NormalJitter(0.05, 0.005), scipy.stats.norm(0.05, 0.005)),
        (GammaJitter(0.02, 2.0), gamma(2.0, scale=0.01)), (GammaJitter(0.02, 1.0), scipy.stats.expon(scale=0.02)),
        (GammaJitter(0.05, 0.3), gamma(0.3, scale=0.05 / 0.3)), (GammaJitter(0.05, 400.0), gamma(400.0, scale=1.25e-4)),
    ):
        got = delays(effect)
        assert scipy.stats.kstest(got, law.cdf).pvalue > 1e-3, effect
        assert got.mean() == pytest.approx(law.mean(), abs=4 * law.std() / np.sqrt(COUNT)), effect
        assert got.var() == pytest.approx(law.var(), rel=0.1), effect
        for one, other in ((got[1:], got[:-1]), (got, delays(effect, direction=1)), (got, delays(effect, seed=2))):
            assert abs(np.corrcoef(one, other)[0, 1]) < 4 / np.sqrt(COUNT), effect


def test_of_a_normal_jitter_what_is_below_zero_becomes_zero() -> None:
    """With the probability and the mean that the docstring states."""
    mean, sigma = 0.002, 0.002
    got = delays(NormalJitter(mean, sigma))
    assert scipy.stats.binomtest(int((got == 0).sum()), COUNT, scipy.stats.norm.cdf(-mean / sigma)).pvalue > 1e-3
    assert scipy.stats.kstest(got[got > 0], scipy.stats.truncnorm(-mean / sigma, np.inf, mean, sigma).cdf).pvalue > 1e-3
    expected = mean * scipy.stats.norm.cdf(mean / sigma) + sigma * scipy.stats.norm.pdf(mean / sigma)
    assert got.mean() == pytest.approx(expected, abs=4 * sigma / np.sqrt(COUNT))
    assert got.min() == 0.0


# Losses


def test_bernoulli_has_its_share_and_geometric_bursts() -> None:
    for p in (0.01, 0.3, 0.9):
        gone = lost(Bernoulli(p), 50_000)
        assert scipy.stats.binomtest(int(gone.sum()), len(gone), p).pvalue > 1e-3, p
        runs = bursts(gone)
        assert runs.mean() == pytest.approx(1 / (1 - p), abs=4 * np.sqrt(p) / (1 - p) / np.sqrt(len(runs))), p
    assert not lost(Bernoulli(0), 5000).any()
    assert lost(Bernoulli(1), 5000).all()


@pytest.mark.parametrize(("p", "r", "g", "h"), [
    (0.01, 0.3, 0.0, 1.0), (0.05, 0.05, 0.0, 0.5), (0.002, 0.1, 0.001, 0.7), (0.8, 0.9, 0.1, 0.6),
    (1.0, 0.4, 0.0, 1.0)])
def test_gilbert_elliott_has_its_closed_forms(p: float, r: float, g: float, h: float) -> None:
    """Mean loss and burst length over 100,000 packets; the losses' correlation decays as (1 - p - r)^lag."""
    effect, count = GilbertElliott(p, r, loss_good=g, loss_bad=h), 100_000
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
        assert np.mean(runs == 1) == pytest.approx(scipy.stats.geom(r).pmf(1), abs=4 / np.sqrt(len(runs)))


def test_gilbert_elliott_is_stationary_from_packet_0() -> None:
    effect = GilbertElliott(0.01, 0.03)
    first = [lost(effect, 1, seed)[0] for seed in range(1000)]
    assert scipy.stats.binomtest(int(sum(first)), len(first), effect.mean_loss).pvalue > 1e-3
    far = np.array([2**40 + 5])  # found by looking back, in no more than a few blocks
    assert effect.bad(effect.begin(Rng(1, 0, 0)), far) == effect.bad(effect.begin(Rng(1, 0, 0)), far)


@settings(max_examples=25)
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


def test_duplicates_have_their_share_come_after_their_time_and_share_their_fate_behind_each_other() -> None:
    packet, time_ns = Duplicate(0.2, after=0.0035).arrivals(0, COUNT, MS, 1, 100)
    numbers, copies = np.unique(packet, return_counts=True)
    assert np.array_equal(numbers, np.arange(COUNT))
    assert set(copies.tolist()) == {1, 2}
    assert scipy.stats.binomtest(int((copies == 2).sum()), COUNT, 0.2).pvalue > 1e-3
    late = time_ns - packet * MS
    assert set(late.tolist()) == {0, 3_500_000}
    assert (late > 0).sum() == (copies == 2).sum()
    lossy = (Duplicate(1.0) | Bernoulli(0.5)).arrivals(0, 1000, MS, 1, 100).packet
    assert set(np.unique(lossy, return_counts=True)[1].tolist()) == {2}


def test_a_blackout_loses_what_gets_there_meanwhile() -> None:
    """First instant inside, last outside; once, or again and again; before the start nothing."""
    assert np.flatnonzero(lost(Blackout(0.1, 0.05), 1000)).tolist() == list(range(100, 150))
    again = [k for k in range(1000) if k >= 100 and (k - 100) % 200 < 50]
    assert np.flatnonzero(lost(Blackout(0.1, 0.05, every=0.2), 1000)).tolist() == again
    assert not lost(Blackout(0.1, 0.0), 1000).any()


# Joined


def test_effects_are_values_and_joining_them_is_flat_and_associative() -> None:
    a, b, c = Delay(1), Bernoulli(0.2), UniformJitter(0.01)
    assert a == Delay(1.0)
    assert repr(a) == "Delay(delay=1.0)"
    with pytest.raises(AttributeError):
        a.delay = 2.0  # frozen
    assert (a | b) | c == a | (b | c) == Chain((a, b, c))
    assert ((a | b) | (c | a)).effects == (a, b, c, a)
    assert (a | b) != (b | a)
    assert len({a | b, a | b, b | a}) == 2
    for wrong in (lambda: a | 3, lambda: (a | b) | None):  # refused
        with pytest.raises(TypeError):
            wrong()


def test_in_order_behind_a_queue_that_sees_disorder_is_refused(recordings: Path) -> None:
    """When such a queue drops a packet, those that wait for it could only leave late or with foresight."""
    queue, jitter = Mahimahi(str(recordings / "trace")), UniformJitter(0.01)
    for wrong in (lambda: jitter | queue | InOrder(),
                  lambda: Duplicate(0.1) | Delay(0.1) | queue | Delay(0.1) | InOrder()):
        with pytest.raises(Refused, match=r"in_order\(\) cannot stand behind a queue"):
            wrong()
    assert len((queue | jitter | InOrder() | queue | jitter | InOrder()).effects) == 6


# What `check_effect` asks of every effect


def test_every_built_in_effect_conforms_and_none_is_forgotten(every_effect: list[Effect]) -> None:
    for effect in every_effect:
        check_effect(effect)
        if isinstance(effect, Mahimahi):  # of the others none looks at the size
            check_effect(effect, size=1500)
        assert parse_link(describe(effect)) == effect
    assert {describe(effect).partition("(")[0] for effect in every_effect} == set(EFFECTS)


@dataclass(frozen=True)
class Broken(Effect):
    fault: str
    order: ClassVar[Order] = "any"
    reorders: ClassVar[bool] = False

    def begin(self, rng: Rng) -> Any:
        return [rng, 0]

    def carry(self, state: Any, packet: Ints, time_ns: Ints, size: int) -> tuple[Ints, Ints, Any]:
        rng, seen = state
        later = (rng.uniform(packet) * 1e8).astype(np.int64)
        keep = np.ones(len(packet), bool)
        match self.fault:
            case "wrote to its input":
                time_ns += 1
            case "int64":
                return packet, time_ns.astype(np.float64), state
            case "not sorted":
                return packet, time_ns + later, state
            case "invented":
                return packet + 10**6, time_ns, state
            case "before it entered":
                return packet, time_ns - 1, state
            case "changes a state":
                state[1] = seen + len(packet)
                return packet, time_ns + seen, state
            case "random numbers of its own":
                keep = np.random.default_rng().random(len(packet)) < 0.5
            case "pieces":
                keep = np.arange(len(packet)) > 0
            case "order of packets":
                keep, state = (np.arange(len(packet)) + seen) % 3 > 0, [rng, seen + len(packet)]
            case "reorders":
                return *by_time(packet, time_ns + later), state
            case "both directions":
                keep = Rng(rng.seed, 0, rng.place).uniform(packet) < 0.5
            case "every place":
                keep = Rng(rng.seed, rng.direction, 0).uniform(packet) < 0.5
        return packet[keep], time_ns[keep], state


@dataclass(frozen=True)
class LateDelay(Delay):
    """A delay that adds 1 ns to what it states."""

    def carry(self, state: None, packet: Ints, time_ns: Ints, size: int) -> tuple[Ints, Ints, None]:
        return packet, time_ns + self.constant_ns + 1, None


def test_each_fault_is_named_and_a_sound_effect_of_ones_own_passes() -> None:
    for fault in ("wrote to its input", "int64", "not sorted", "invented", "before it entered", "changes a state",
                  "random numbers of its own", "pieces", "order of packets", "reorders", "both directions",
                  "every place"):
        with pytest.raises(Refused, match=fault):
            check_effect(Broken(fault))
    check_effect(Broken("none"))
    with pytest.raises(Refused, match="does more than the constant delay that its `constant_ns` states"):
        check_effect(LateDelay(0.01))
