"""The psychometric fit: Weber fractions of felt stiffness by maximum likelihood, many people at once.

    P("second") = lapse/2 + (1 - lapse) Phi((x + bias)/(sqrt 2 w)),        x = ln(k_f of the second/k_f of the first)

x keeps its sign, and the answer is which interval was stiffer: folded to |x| and correct, a bias towards one interval
would widen w. With the slope a = 1/(sqrt 2 w) and m = a bias this is a probit in a x + m, whose likelihood is climbed
by Fisher's scoring with steps halved until they lead up, within `LEAST_W` and `MOST_W`; the lapse, between 0 and
`MOST_LAPSE`, is found outside of that by golden sections. The interval is that of the profile likelihood: all w whose
greatest likelihood over bias and lapse is within half a quantile of chi2(1) of the greatest one.
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
        """True if the answers tell no w: all correct, or as by chance."""
        return not LEAST_W * 1.01 < self.w < MOST_W / 1.01


class Climbed(NamedTuple):
    """The likeliest slope a and shift m of each row, and the logarithm of the likelihood."""

    a: Floats
    m: Floats
    likelihood: Floats


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


def climb(answers: Answers, lapse: Floats, a: Floats | None = None) -> Climbed:
    """The likeliest slope and shift of each row with its `lapse`; with these slopes `a`, the shift alone."""
    x, shown, second = answers
    first, ndtr, attentive = shown - second, special().ndtr, (1.0 - lapse)[:, None]

    def likelihood(a: Floats, m: Floats) -> tuple[Floats, Floats, Floats]:
        z = a[:, None] * x + m[:, None]
        p = np.clip(0.5 * lapse[:, None] + attentive * ndtr(z), 1e-12, 1.0 - 1e-12)
        return (second * np.log(p) + first * np.log1p(-p)).sum(axis=1), z, p

    slope = 1.0 / (sqrt(2.0) * np.array([MOST_W, LEAST_W]))
    is_free = a is None
    spread = np.abs(x * shown).sum(axis=1) / shown.sum(axis=1)
    a = 1.0 / np.maximum(spread, 1e-3) if a is None else a
    m = np.zeros_like(a)
    value, z, p = likelihood(a, m)
    for _ in range(_STEPS):
        density = attentive * np.exp(-0.5 * z * z) / sqrt(2.0 * pi)
        by_z = (second - shown * p) * density / (p * (1.0 - p))
        weight = shown * density * density / (p * (1.0 - p)) + 1e-12
        g_a, g_m = (by_z * x).sum(axis=1), by_z.sum(axis=1)
        i_aa, i_am, i_mm = (weight * x * x).sum(axis=1), (weight * x).sum(axis=1), weight.sum(axis=1)
        if is_free:
            determinant = np.maximum(i_aa * i_mm - i_am * i_am, 1e-12 * i_aa * i_mm)
            step_a, step_m = (i_mm * g_a - i_am * g_m) / determinant, (i_aa * g_m - i_am * g_a) / determinant
        else:
            step_a, step_m = np.zeros_like(a), g_m / i_mm
        size = np.ones_like(a)
        for _ in range(_HALVINGS):
            new_a, new_m = a + size * step_a, np.clip(m + size * step_m, -8.0, 8.0)
            new_a = np.clip(new_a, *slope) if is_free else new_a
            new_value = likelihood(new_a, new_m)[0]
            leads_down = new_value < value
            if not leads_down.any():
                break
            size = np.where(leads_down, 0.5 * size, size)
        rises = np.where(leads_down, 0.0, new_value - value)
        a, m = np.where(leads_down, a, new_a), np.where(leads_down, m, new_m)
        value, z, p = likelihood(a, m)
        if not (rises > 1e-10).any():
            break
    return Climbed(a, m, value)


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


def common_lapse(answers: Answers) -> float:
    """The lapse with which all rows, each with a w and a bias of its own, are likeliest together.

    With a lapse for each row, a person's few wrong answers to easy levels are as likely a lapse with a small w as none
    with a large one, and w is all over the place.
    """
    rows = len(answers.x)

    def together(lapse: Floats) -> Floats:
        return np.asarray(climb(answers, np.repeat(lapse, rows)).likelihood.sum(keepdims=True))

    return float(likeliest_lapse(together, 1)[0])


def fit(answers: Answers, lapse: float | None = None) -> list[Fit]:
    """Fit an observer to each row, where the `lapse` is known with that one."""
    rows = len(answers.x)
    lapses = (np.full(rows, lapse) if lapse is not None else
              likeliest_lapse(lambda each: climb(answers, each).likelihood, rows))
    got = climb(answers, lapses)
    return [Fit(1.0 / (sqrt(2.0) * a), m / a, each, value, int(shown)) for a, m, value, each, shown in zip(
        *(part.tolist() for part in got), lapses.tolist(), answers.shown.sum(axis=1), strict=True)]


def with_interval(answers: Answers, fitted: Fit, level: float) -> Fit:
    """The fit of one row with the interval of its w."""
    if fitted.is_at_bound:
        return fitted
    threshold = fitted.likelihood - 0.5 * float(special().chdtri(1, 1.0 - level))

    def outside(log_w: Floats) -> NDArray[np.bool_]:
        """True for each w that is less likely than the interval's ends."""
        rows = Answers(*(np.repeat(part, len(log_w), axis=0) for part in answers))
        slopes = np.exp(-log_w) / sqrt(2.0)
        best = likeliest_lapse(lambda lapse: climb(rows, lapse, slopes).likelihood, len(log_w))
        return np.asarray(climb(rows, best, slopes).likelihood < threshold)

    ends = []
    for bound, none in ((log(LEAST_W), 0.0), (log(MOST_W), inf)):
        near, far, is_bounded = log(fitted.w), bound, True
        for _ in range(4):  # each finds the end 16 times as closely
            grid = np.linspace(near, far, 17)[1:]
            beyond = np.flatnonzero(outside(grid))
            if not len(beyond):
                is_bounded = False
                break
            i = int(beyond[0])
            near, far = (near if i == 0 else float(grid[i - 1])), float(grid[i])
        ends.append(exp(0.5 * (near + far)) if is_bounded else none)
    return replace(fitted, low=ends[0], high=ends[1])
