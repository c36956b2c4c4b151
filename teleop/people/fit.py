"""The psychometric fit: Weber fractions of felt stiffness by maximum likelihood, many people at once.

    P("second") = lapse/2 + (1 - lapse) Phi((x + bias)/(sqrt 2 w)),        x = ln(k_f of the second/k_f of the first)

x keeps its sign, and the answer is which interval was stiffer: folded to |x| and correct, a bias towards one interval
would widen w. With the slope a = 1/(sqrt 2 w) and m = a bias this is a probit in a x + m, whose likelihood is climbed
by Fisher's scoring with steps halved until they lead up, within `LEAST_W` and `MOST_W`; the lapse, between 0 and
`MOST_LAPSE`, is found outside of that by golden sections.

A person answers some dozens of trials, and the likeliest w of so few is biased downwards, and 0 where no answer was
wrong. So a person's fit has its bias reduced (D. Firth, "Bias reduction of maximum likelihood estimates", Biometrika
80, 1993): half the logarithm of the information's determinant is added, Jeffreys' prior. Over 64 trials at 350, 420,
600 and 720 N/m felt beside 500, w = .15 and lapses of .02 the mean of ln w of 2000 observers is then off by .02 with a
standard deviation of .20, and without it by -.09 with .37. Nor do so few tell a lapse from a small w: it is the plan's
(`Analysis.lapse`), the same for all people and conditions.

The interval of a w is that of the profile likelihood, without the prior: all w whose greatest likelihood over bias and
lapse is within half a quantile of chi2(1) of the greatest one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import exp, inf, log, pi, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from teleop.errors import Refused

Floats = NDArray[np.float64]
MOST_LAPSE = 0.1
LEAST_W, MOST_W = 0.005, 5.0  # at one of these the answers tell no w
_STEPS, _HALVINGS, _SECTIONS = 25, 6, 12  # of scoring, of one of its steps, of the lapse
_TINY = 1e-4  # step of a difference quotient
_GOLDEN = 0.5 * (sqrt(5.0) - 1.0)


def special() -> Any:
    """The functions of scipy that the analysis uses. Raises `Refused` without the extra."""
    try:
        import scipy.special
    except ImportError:
        raise Refused("the analysis needs scipy; install it with: pip install 'bilateral-teleop[people]'") from None
    return scipy.special


class Answers(NamedTuple):
    """Answers by stimulus, a row for each fit: each x, how often it was shown, how often the second was the answer."""

    x: Floats
    shown: Floats
    second: Floats


@dataclass(frozen=True, slots=True)
class Fit:
    """A fitted observer; `low` and `high` are the ends of the interval of w, inf where the likelihood has no bound."""

    w: float
    bias: float
    lapse: float
    likelihood: float  # its logarithm
    trials: int
    low: float = 0.0
    high: float = inf

    @property
    def is_at_bound(self) -> bool:
        """True if the answers tell no w: all as a w of 0 would have them, or as by chance."""
        return not LEAST_W * 1.01 < self.w < MOST_W / 1.01 or self.likelihood > -1e-6


class Climbed(NamedTuple):
    """The likeliest slope a and shift m of each row, and the logarithm of the likelihood."""

    a: Floats
    m: Floats
    likelihood: Floats


class _Point(NamedTuple):
    """The likelihood of each row at a slope and a shift, its slope there, and Fisher's information."""

    value: Floats
    g_a: Floats
    g_m: Floats
    i_aa: Floats
    i_am: Floats
    i_mm: Floats
    determinant: Floats


def grouped(several: Sequence[Sequence[tuple[float, bool]]]) -> Answers:
    """Answers (x, second) of each row, counted by x; a short row ends in stimuli that were never shown."""
    tables = []
    for pairs in several:
        x, where = np.unique(np.array([x for x, _ in pairs]), return_inverse=True)
        tables.append((x, np.bincount(where), np.bincount(where, weights=[float(second) for _, second in pairs])))
    room = np.zeros((3, len(tables), max(len(x) for x, _, _ in tables)))
    for row, table in enumerate(tables):
        for part, values in zip(room, table, strict=True):
            part[row, :len(values)] = values
    return Answers(*room)


def climb(answers: Answers, lapse: Floats, a: Floats | None = None, *, reduced: bool = False) -> Climbed:
    """The likeliest slope and shift of each row with its `lapse`; with these slopes `a`, the shift alone.

    `reduced`: with half the logarithm of the information's determinant added to the logarithm of the likelihood.
    """
    x, shown, second = answers
    first, ndtr, attentive = shown - second, special().ndtr, (1.0 - lapse)[:, None]

    def at(a: Floats, m: Floats) -> _Point:
        z = a[:, None] * x + m[:, None]
        p = np.clip(0.5 * lapse[:, None] + attentive * ndtr(z), 1e-12, 1.0 - 1e-12)
        density = attentive * np.exp(-0.5 * z * z) / sqrt(2.0 * pi)
        by_z = (second - shown * p) * density / (p * (1.0 - p))
        weight = shown * density * density / (p * (1.0 - p)) + 1e-12
        weight_x = weight * x
        i_aa, i_am, i_mm = (weight_x * x).sum(axis=1), weight_x.sum(axis=1), weight.sum(axis=1)
        determinant = np.maximum(i_aa * i_mm - i_am * i_am, 1e-12 * i_aa * i_mm)
        value = (second * np.log(p) + first * np.log1p(-p)).sum(axis=1)
        return _Point(value + 0.5 * np.log(determinant) if reduced else value, (by_z * x).sum(axis=1),
                      by_z.sum(axis=1), i_aa, i_am, i_mm, determinant)

    def of_information(a: Floats, m: Floats) -> tuple[Floats, Floats]:
        """The slope of half the logarithm of the determinant."""
        ends = [np.log(at(a + step_a * a, m + step_m).determinant)
                for step_a, step_m in ((_TINY, 0.0), (-_TINY, 0.0), (0.0, _TINY), (0.0, -_TINY))]
        return (ends[0] - ends[1]) / (4.0 * _TINY * a), (ends[2] - ends[3]) / (4.0 * _TINY)

    slopes = 1.0 / (sqrt(2.0) * np.array([MOST_W, LEAST_W]))
    is_free = a is None
    a = 1.0 / np.maximum(np.abs(x * shown).sum(axis=1) / shown.sum(axis=1), 1e-3) if a is None else a
    m = np.zeros_like(a)
    here = at(a, m)
    for _ in range(_STEPS):
        g_a, g_m = here.g_a, here.g_m
        if reduced:
            more_a, more_m = of_information(a, m)
            g_a, g_m = g_a + more_a, g_m + more_m
        if is_free:
            step_a = (here.i_mm * g_a - here.i_am * g_m) / here.determinant
            step_m = (here.i_aa * g_m - here.i_am * g_a) / here.determinant
        else:
            step_a, step_m = np.zeros_like(a), g_m / here.i_mm
        size = np.ones_like(a)
        for _ in range(_HALVINGS):
            new_a = np.clip(a + size * step_a, *slopes) if is_free else a
            new_m = np.clip(m + size * step_m, -8.0, 8.0)
            leads_down = at(new_a, new_m).value < here.value
            if not leads_down.any():
                break
            size = np.where(leads_down, 0.5 * size, size)
        a, m = np.where(leads_down, a, new_a), np.where(leads_down, m, new_m)
        before, here = here.value, at(a, m)
        if not (here.value > before + 1e-9).any():
            break
    return Climbed(a, m, here.value)


def likeliest_lapse(likelihood: Callable[[Floats], Floats], rows: int) -> Floats:
    """The lapse of each row at which `likelihood` is greatest, by golden sections, with both ends tried."""
    low, high = np.zeros(rows), np.full(rows, MOST_LAPSE)
    for _ in range(_SECTIONS):
        first, second = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        falls = likelihood(first) > likelihood(second)
        low, high = np.where(falls, low, first), np.where(falls, second, high)
    tried = np.stack([0.5 * (low + high), np.zeros(rows), np.full(rows, MOST_LAPSE)])
    best = np.argmax(np.stack([likelihood(each) for each in tried]), axis=0)
    return np.asarray(tried[best, np.arange(rows)])


def fit(answers: Answers, lapse: float | None = None) -> list[Fit]:
    """Fit an observer to each row; where the `lapse` is known with that one, and with the bias reduced."""
    rows = len(answers.x)
    lapses = (np.full(rows, lapse) if lapse is not None else
              likeliest_lapse(lambda each: climb(answers, each).likelihood, rows))
    got = climb(answers, lapses, reduced=lapse is not None)
    return [Fit(1.0 / (sqrt(2.0) * a), m / a, each, value, int(shown)) for a, m, value, each, shown in zip(
        *(part.tolist() for part in got), lapses.tolist(), answers.shown.sum(axis=1), strict=True)]


def deviance(answers: Answers, likelihood: Floats, log_w: Floats) -> Floats:
    """Twice the logarithm of the likelihood that each row loses by its w, whatever bias and lapse, against its best."""
    slopes = np.exp(-log_w) / sqrt(2.0)
    best = likeliest_lapse(lambda lapse: climb(answers, lapse, slopes).likelihood, len(log_w))
    return np.asarray(2.0 * (likelihood - climb(answers, best, slopes).likelihood))


def with_interval(answers: Answers, fitted: Fit, level: float) -> Fit:
    """The fit of one row with the profile-likelihood interval of its w."""
    if fitted.is_at_bound:
        return fitted
    threshold = float(special().chdtri(1, 1.0 - level))
    ends = []
    for bound, none in ((log(LEAST_W), 0.0), (log(MOST_W), inf)):
        near, end = log(fitted.w), none
        grid = near + (bound - near) * np.linspace(0.0, 1.0, 25)[1:] ** 2
        for _ in range(2):  # among steps that widen outwards, then within one of them
            rows = Answers(*(np.repeat(part, len(grid), axis=0) for part in answers))
            lost = deviance(rows, np.full(len(grid), fitted.likelihood), grid)
            beyond = np.flatnonzero(lost >= threshold)
            if not len(beyond):
                break
            i = int(beyond[0])
            inner, lost_inner = (near, 0.0) if i == 0 else (float(grid[i - 1]), float(lost[i - 1]))
            end = exp(inner + (grid[i] - inner) * (threshold - lost_inner) / (float(lost[i]) - lost_inner))
            near, grid = inner, np.linspace(inner, float(grid[i]), 12)[1:]
        ends.append(end)
    return replace(fitted, low=ends[0], high=ends[1])
