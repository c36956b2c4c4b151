"""Says when a loop shakes, by a rule on its forces alone, second by second.

It is judged only where nobody has moved the hand for those seconds. It shakes when the force of an end came to its cap
in each of two spans of 1, 2 or 4 s, one after the other, and in each swung by half of the cap and more: a loop over
half a second each way takes some seconds for one swing. Or when its swing was greater in each of four seconds than in
the one before, by a tenth and more, and is above `LEAST` by then. It is over when the swing of such a span was below
half of what it was for two seconds, whoever moves the hand.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from itertools import pairwise

from teleop.live.page.rows import Extremes

AT_CAP, OF_CAP = 0.98, 0.5  # of the cap: what counts as being there; the swing
LEAST = 1.0  # N of swing
GROWS = 1.1  # from one second to the next
SECONDS = 4  # that are compared
SPANS = (1, 2, 4)  # s: two of each are compared
CALM = 2  # s

Swings = dict[tuple[str, int], tuple[float, float]]  # by end and axis: the least and the greatest force, N


class Shaking:
    """`f_max`: the cap of each axis, N (N m of one that turns); None: there is none. Times are in s."""

    def __init__(self, f_max: Sequence[float | None]) -> None:
        self.shakes = False
        self._f_max = [*f_max]
        self._seconds: deque[Swings] = deque(maxlen=2 * SPANS[-1])
        self._span = 1  # s of the span in which it was seen to shake
        self._now: Swings = {}  # of the second that goes on
        self._since: float | None = None  # when it began
        self._still = 0  # whole seconds in which nobody moved the hand
        self._moved = False  # somebody did in this one
        self._was = 0.0  # N of swing when it began to shake
        self._calm = 0  # s

    def moved(self) -> None:
        """Somebody moves the hand now, or the law begins anew."""
        self._moved = True

    def sentence(self, now: float, forces: dict[str, Extremes]) -> str | None:
        """What there is to say after these forces (N) of the ends have come."""
        if self._since is None:
            self._since = now
        said = None
        if now - self._since >= 1.0:
            said = self._second()
            self._since, self._now, self._moved = now, {}, False
        for e, (lows, highs) in forces.items():
            for axis, (low, high) in enumerate(zip(lows, highs, strict=True)):
                least, most = self._now.get((e, axis), (low, high))
                self._now[e, axis] = min(least, low), max(most, high)
        return said

    def _second(self) -> str | None:
        """Judge by the seconds that are over."""
        self._seconds.append(self._now)
        self._still = 0 if self._moved else self._still + 1
        if self.shakes:
            swing = max((high - low for low, high in (self._over(which, self._span) for which in self._now)),
                        default=0.0)
            self._calm = self._calm + 1 if swing < self._was / 2.0 else 0
            self.shakes = self._calm < CALM
            if self.shakes:
                return None
            self._seconds.clear()
            self._still = 0
            return "stable again"
        for which in self._now:
            capped = next((span for span in SPANS if self._still >= 2 * span and all(
                self._comes_to_cap(which[1], self._over(which, span, before)) for before in (0, span))), None)
            swings = [high - low for low, high in (self._over(which, 1, before) for before in range(SECONDS))][::-1]
            if capped is not None or (self._still >= SECONDS and _grow(swings)):
                self.shakes, self._calm, self._span = True, 0, capped or 1
                low, high = self._over(which, self._span)
                self._was = high - low
                how = ("comes to its cap again and again, and the cap holds it" if capped
                       else f"swings by {self._was:.1f} N, more each second")
                return (f"unstable: while nobody moves the hand the force {how}; another law, less delay or a "
                        "softer environment ends it")
        return None

    def _over(self, which: tuple[str, int], span: int, before: int = 0) -> tuple[float, float]:
        """The least and the greatest force (N) of `span` seconds that ended `before` seconds ago; 0 of none."""
        ends = len(self._seconds) - before
        seconds = [self._seconds[i][which] for i in range(max(0, ends - span), ends) if which in self._seconds[i]]
        return min((low for low, _ in seconds), default=0.0), max((high for _, high in seconds), default=0.0)

    def _comes_to_cap(self, axis: int, second: tuple[float, float]) -> bool:
        low, high = second
        cap = self._f_max[axis] if axis < len(self._f_max) else None
        return cap is not None and max(high, -low) >= AT_CAP * cap and high - low >= OF_CAP * cap


def _grow(swings: list[float]) -> bool:
    return len(swings) == SECONDS and swings[-1] > LEAST and all(
        after > GROWS * before for before, after in pairwise(swings))
