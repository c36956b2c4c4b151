"""First-order adaptive windowing: the slope of the longest line that the last readings allow.

Source: F. Janabi-Sharifi, V. Hayward and C.-S. J. Chen, "Discrete-time adaptive windowing for velocity
estimation", IEEE Trans. Control Systems Technology 8(6), 2000. A window reaches from the newest reading
y(k) back to y(k-n). Its line goes through y(k) with a slope v_n,

    end-fit     v_n = (y(k) - y(k-n))/(n T)                                       the line through both ends
    best-fit    v_n = 6 sum_i (2 i - n) (y(k) - y(k-i)) / (n (n+1) (n+2) T)        least squares over the window

and it must pass within +-noise of every reading in the window. n grows from 1, where the line passes
through both, as long as it does, at most to `most`; the last slope is the velocity.

That the line of slope v (m/s) misses y(k-i) by at most `noise` says |y(k) - y(k-i) - i T v| <= noise: v lies within
noise/(i T) of (y(k) - y(k-i))/(i T). So the readings narrow one interval as n grows, the line of window n is good iff
its slope lies in it, and a step is O(most) where trying every line is O(most^2).

Error. Readings y = x + e, the errors e in an interval of width w; |d2x/dt2| <= a; window n:

    |v_n - dx/dt| <= (w + miss)/(n T) + a n T/2,    miss = 0 for end-fit, `noise` for best-fit.

(y(k) - y(k-n) = x(k) - x(k-n) + e(k) - e(k-n), and the line meets it within `miss`.) With errors of +-noise,
w = 2 noise, the first term of end-fit is 2 noise/(n T). On a steady motion an end-fit line misses a reading by
|e(k-i) - (1 - i/n) e(k) - (i/n) e(k-n)| <= w: with noise >= w, one *whole* step of an encoder, the window of
end-fit never shrinks without an acceleration; with half a step it does, down to one tick.

Ticks that are left out have no reading. A line through y(k) that meets the reading before them within the noise meets
the straight line between the two within less, so readings put there on it narrow no interval: the window goes on
behind them. A gap as long as the longest window, or of no whole ticks, begins a new one.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, nan
from typing import Annotated

from teleop.errors import number, whole_number
from teleop.knob import Knob

TINY = 1e-300  # s: what a span of zero is divided by
LONGEST = 1000  # readings: one second at 1 kHz

State = tuple[float, ...]  # the last `most` readings (m), newest first; NaN where the window does not reach yet


def _missing(count: int) -> State:
    # No reading yet: NaN lies in no interval, so a window ends before it without being told to.
    return (nan,) * count


def _bridged(s: State, x: float, ticks: int) -> State:
    """The state with readings on a straight line at the ticks that were left out before the reading `x` (m)."""
    start, step = s[0], (x - s[0]) / ticks
    for i in range(1, ticks):
        s = (start + step * i,) + s[:-1]  # noqa: RUF005 - compiled code knows no star in a loop
    return s


@dataclass(frozen=True, kw_only=True, slots=True)
class AdaptiveWindow:
    """Numbers and past of either line."""

    noise: Annotated[float, Knob("m", "most by which the line misses a reading: one encoder step", above=0.0)]
    most: Annotated[int, Knob("ticks", "longest window", low=1, high=LONGEST)] = 15

    def __post_init__(self) -> None:
        object.__setattr__(self, "noise", number("noise", self.noise, above=0.0))
        object.__setattr__(self, "most", whole_number("most", self.most, low=1, high=LONGEST))

    def coefficients(self, dt: float) -> tuple[float, float, float, State]:
        """The tick (s), how much a span may differ from it, how far the line may miss a reading, and an empty past."""
        # A line that misses by `noise` exactly, as encoder readings have it, is good whatever rounding makes of it.
        return dt, 1e-6 * dt, self.noise * (1.0 + 1e-9), _missing(self.most - 1)

    def start(self, x: float) -> State:
        """Take one reading at `x` (m)."""
        return (x, *_missing(self.most - 1))


@dataclass(frozen=True, kw_only=True, slots=True)
class EndFit(AdaptiveWindow):
    """Adaptive window with the line through its two ends."""

    @staticmethod
    def step(c: tuple[float, float, float, State], s: State, x: float, span: float) -> tuple[float, State]:
        """Velocity (m/s) at the reading `x` (m), `span` seconds after the one before, and the next state."""
        dt, apart, band, missing = c
        slope = x - s[0]  # m a tick
        if abs(span - dt) > apart:
            ticks = int(min(span / dt, LONGEST) + 0.5)
            if abs(span - ticks * dt) > apart or not 1 < ticks <= len(s):
                return slope / max(span, TINY), (x, *missing)
            s = _bridged(s, x, ticks)
            slope = x - s[0]
        low, high, n = -inf, inf, 0.0
        for before in s:
            n += 1.0
            tried = (x - before) / n
            if not low <= tried <= high:
                break
            slope = tried
            reach = band / n
            if tried - reach > low:  # noqa: PLR1730 - max and min would be half of the time
                low = tried - reach
            if tried + reach < high:  # noqa: PLR1730
                high = tried + reach
        return slope / dt, (x, *s[:-1])


@dataclass(frozen=True, kw_only=True, slots=True)
class BestFit(AdaptiveWindow):
    """Adaptive window with the least-squares slope."""

    @staticmethod
    def step(c: tuple[float, float, float, State], s: State, x: float, span: float) -> tuple[float, State]:
        """Velocity (m/s) at the reading `x` (m), `span` seconds after the one before, and the next state."""
        dt, apart, band, missing = c
        slope = x - s[0]  # m a tick
        if abs(span - dt) > apart:
            ticks = int(min(span / dt, LONGEST) + 0.5)
            if abs(span - ticks * dt) > apart or not 1 < ticks <= len(s):
                return slope / max(span, TINY), (x, *missing)
            s = _bridged(s, x, ticks)
            slope = x - s[0]
        low, high, n = -inf, inf, 0.0
        total = moment = 0.0  # sum_i (y(k) - y(k-i)), and weighted with 2 i
        for before in s:
            n += 1.0
            back = x - before
            total += back
            moment += n * (back + back)
            middle, reach = back / n, band / n
            if middle - reach > low:  # noqa: PLR1730
                low = middle - reach
            if middle + reach < high:  # noqa: PLR1730
                high = middle + reach
            tried = 6.0 / (n * (n + 1.0) * (n + 2.0)) * (moment - n * total)
            if not low <= tried <= high:
                break
            slope = tried
        return slope / dt, (x, *s[:-1])
