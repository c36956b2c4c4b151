"""Constant delay and jitters: every stated distribution against scipy, packets independent of each other."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from channel.delay import Delay
from channel.effect import Effect
from channel.gamma import GammaJitter
from channel.normal import NormalJitter
from channel.uniform import UniformJitter
from teleop.errors import Refused

COUNT = 20_000


def delays(effect: Effect, seed: int = 1, direction: int = 0) -> NDArray[np.float64]:
    """Each packet's delay, s, in order of number."""
    packet, time_ns = effect.arrivals(direction, COUNT, 1_000_000, seed, 100)
    by_number = np.argsort(packet)
    assert np.array_equal(packet[by_number], np.arange(COUNT))
    return (time_ns[by_number] - packet[by_number] * 1_000_000) / 1e9


@pytest.mark.parametrize(("delay", "expected_ns"), [(0.05, 50_000_000), (0, 0), (1e-9, 1), (0.0012345678, 1_234_568)])
def test_a_constant_delay_is_exact_in_nanoseconds(delay: float, expected_ns: int) -> None:
    packet, time_ns = Delay(delay).arrivals(0, 1000, 1_000_000, 1, 100)
    assert packet.tolist() == list(range(1000))
    assert time_ns.tolist() == [k * 1_000_000 + expected_ns for k in range(1000)]


@pytest.mark.parametrize(("effect", "law"), [
    (UniformJitter(0.02), stats.uniform(0, 0.02)),
    (NormalJitter(0.05, 0.005), stats.norm(0.05, 0.005)),
    (GammaJitter(0.02, 2.0), stats.gamma(2.0, scale=0.01)),
    (GammaJitter(0.02, 1.0), stats.expon(scale=0.02)),
    (GammaJitter(0.05, 0.3), stats.gamma(0.3, scale=0.05 / 0.3)),
    (GammaJitter(0.05, 400.0), stats.gamma(400.0, scale=0.05 / 400)),
])
def test_marginal_and_independence(effect: Effect, law: Any) -> None:
    """Kolmogorov-Smirnov against the closed form; mean and variance; no correlation with the next packet."""
    got = delays(effect)
    assert stats.kstest(got, law.cdf).pvalue > 1e-3
    assert got.mean() == pytest.approx(law.mean(), abs=4 * law.std() / np.sqrt(COUNT))
    assert got.var() == pytest.approx(law.var(), rel=0.1)
    assert abs(np.corrcoef(got[1:], got[:-1])[0, 1]) < 4 / np.sqrt(COUNT)
    assert abs(np.corrcoef(got, delays(effect, direction=1))[0, 1]) < 4 / np.sqrt(COUNT)
    assert abs(np.corrcoef(got, delays(effect, seed=2))[0, 1]) < 4 / np.sqrt(COUNT)


def test_rectified_normal() -> None:
    """Below zero becomes zero, with the probability and the mean that the docstring states."""
    mean, sigma = 0.002, 0.002
    got = delays(NormalJitter(mean, sigma))
    at_zero = stats.norm.cdf(-mean / sigma)
    assert stats.binomtest(int((got == 0).sum()), COUNT, at_zero).pvalue > 1e-3
    assert stats.kstest(got[got > 0], stats.truncnorm(-mean / sigma, np.inf, mean, sigma).cdf).pvalue > 1e-3
    expected = mean * stats.norm.cdf(mean / sigma) + sigma * stats.norm.pdf(mean / sigma)
    assert got.mean() == pytest.approx(expected, abs=4 * sigma / np.sqrt(COUNT))
    assert got.min() == 0.0


def test_iid_jitter_overtakes() -> None:
    """At 1 kHz iid jitter of 20 ms delivers out of order: every packet is late only if none newer came first."""
    packet, _ = UniformJitter(0.02).arrivals(0, COUNT, 1_000_000, 1, 100)
    fresh = packet == np.maximum.accumulate(packet)
    none_newer_first = np.mean([np.prod([min(1.0, 1 - (d - j) / 20) for j in range(1, int(d) + 1)])
                                for d in np.linspace(0, 20, 2001)[:-1]])  # over this packet's own delay, ms
    assert fresh.mean() == pytest.approx(none_newer_first, abs=0.02)


def test_degenerate_jitters() -> None:
    assert not delays(UniformJitter(0.0)).any()
    assert (delays(NormalJitter(0.01, 0.0)) == 0.01).all()
    assert not delays(GammaJitter(0.0, 1.0)).any()


@pytest.mark.parametrize(("make", "sentence"), [
    (lambda: Delay(3601.0), "delay must be at most 3600 s.*kept in memory"),
    (lambda: Delay(-1e-9), "delay must be at least 0"),
    (lambda: Delay(float("nan")), "delay must be finite"),
    (lambda: Delay("50 ms"), "delay must be a number"),  # type: ignore[arg-type]
    (lambda: UniformJitter(float("inf")), "width must be finite"),
    (lambda: NormalJitter(0.01, -1.0), "sigma must be at least 0"),
    (lambda: NormalJitter(1e4, 1.0), "mean must be at most 3600"),
    (lambda: GammaJitter(0.01, 0.0), "shape must be at least 0.05"),
    (lambda: GammaJitter(-0.01, 1.0), "mean must be at least 0"),
])
def test_refusals(make, sentence: str) -> None:
    with pytest.raises(Refused, match=sentence):
        make()
