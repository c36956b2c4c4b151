"""An evolution strategy with covariance matrix adaptation, CMA-ES: it asks for points and is given their ranks.

Source: N. Hansen, "The CMA evolution strategy: a tutorial", arXiv:1604.00772 (2016), section 4 and table 1, without its
negative weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, log, sqrt
from statistics import NormalDist

import numpy as np


class Strategy:
    """A strategy from `mean` with the standard deviation `step`, over any coordinates; `key` keys its draws."""

    def __init__(self, mean: Sequence[float], step: float, key: tuple[int, int]) -> None:
        n = len(mean)
        self.mean, self.step, self.n = np.array(mean, dtype=float), step, n
        self.size = max(10, 4 + int(3.0 * log(n)))
        weights = log(0.5 * (self.size + 1)) - np.log(np.arange(1, self.size // 2 + 1))
        self.weights = weights / weights.sum()
        self.mu = float(1.0 / (self.weights @ self.weights))
        self.c_s = (self.mu + 2.0) / (n + self.mu + 5.0)
        self.d_s = 1.0 + 2.0 * max(0.0, sqrt((self.mu - 1.0) / (n + 1.0)) - 1.0) + self.c_s
        self.c_c = (4.0 + self.mu / n) / (n + 4.0 + 2.0 * self.mu / n)
        self.c_1 = 2.0 / ((n + 1.3) ** 2 + self.mu)
        self.c_mu = min(1.0 - self.c_1, 2.0 * (self.mu - 2.0 + 1.0 / self.mu) / ((n + 2.0) ** 2 + self.mu))
        self.norm = sqrt(n) * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n * n))  # of a normal vector, expected
        self.C, self.p_s, self.p_c = np.eye(n), np.zeros(n), np.zeros(n)
        self.axes, self.lengths = np.eye(n), np.ones(n)
        self.generation = 0
        self._dice = np.random.Philox(key=np.array([key[0], key[1] + 1], np.uint64))

    @property
    def spread(self) -> float:
        """The largest standard deviation along any axis, in parts of a range."""
        return float(self.step * self.lengths.max())

    def ask(self) -> list[list[float]]:
        """The points of a generation."""
        raw = (np.asarray(self._dice.random_raw(self.size * self.n), np.uint64) >> np.uint64(11)).astype(float)
        normal = NormalDist().inv_cdf
        z = np.array([normal((each + 0.5) * 2.0**-53) for each in raw]).reshape(self.size, self.n)
        drawn: list[list[float]] = (self.mean + self.step * (z * self.lengths) @ self.axes.T).tolist()
        return drawn

    def tell(self, drawn: Sequence[Sequence[float]], orders: Sequence[tuple[float, ...]]) -> None:
        """Take in what the points of the last generation came to; the least order is best."""
        ranked = sorted(range(len(drawn)), key=lambda i: (orders[i], i))[:len(self.weights)]
        y = (np.array([drawn[i] for i in ranked]) - self.mean) / self.step
        mean = self.weights @ y
        self.mean = self.mean + self.step * mean
        self.generation += 1
        white = self.axes @ ((self.axes.T @ mean) / self.lengths)
        self.p_s = (1.0 - self.c_s) * self.p_s + sqrt(self.c_s * (2.0 - self.c_s) * self.mu) * white
        size = float(np.linalg.norm(self.p_s))
        slow = size / sqrt(1.0 - (1.0 - self.c_s) ** (2 * self.generation)) < (1.4 + 2.0 / (self.n + 1.0)) * self.norm
        self.p_c = (1.0 - self.c_c) * self.p_c + slow * sqrt(self.c_c * (2.0 - self.c_c) * self.mu) * mean
        lost = (1.0 - slow) * self.c_c * (2.0 - self.c_c)
        self.C = ((1.0 - self.c_1 - self.c_mu + self.c_1 * lost) * self.C + self.c_1 * np.outer(self.p_c, self.p_c)
                  + self.c_mu * (self.weights * y.T) @ y)
        self.step *= exp(min(1.0, self.c_s / self.d_s * (size / self.norm - 1.0)))
        values, self.axes = np.linalg.eigh(0.5 * (self.C + self.C.T))
        self.lengths = np.sqrt(np.maximum(values, 1e-20))


def folded(point: Sequence[float]) -> list[float]:
    """Parts of ranges, reflected at 0 and 1.

    >>> folded([0.25, -0.25, 1.25, 2.5])
    [0.25, 0.25, 0.75, 0.5]
    """
    return [min(x % 2.0, 2.0 - x % 2.0) for x in point]
