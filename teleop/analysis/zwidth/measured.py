"""What comes to rest in virtual time: for what has no eigenvalues, an encoder, friction, a passivity controller.

The experiment: the hand holds still where its reference ends, inside the wall; the device starts at rest `BEFORE` the
wall and is let go, so the hand's spring pulls it in. It runs for `LASTING` s and on for as long as
`teleop.analysis.models.rest` needs to say what it comes to: a swing of a few steps of the encoder still counts as rest
there, a limit cycle beyond them does not.

Behind an encoder what rests and what hums may alternate as K grows. So K is raised from well below in steps of `RATIO`
to the first that does not rest, and the step before it halved: up to there all that were tried rest. A nonlinear loop
may answer otherwise to another start.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from teleop.analysis.models.gains import with_gains
from teleop.analysis.models.rest import HeldGrip, settled
from teleop.errors import Refused

if TYPE_CHECKING:
    from teleop.scene.scene import Scene

BEFORE = 1e-3  # m
LASTING = 1.5  # s
TICKS = (400, 20_000)  # the first run has at least and at most so many
RATIO, HALVED = 1.25, 5  # 1.25^(1/32) is 1.007
HIGHER, LOWER = 32, 10  # steps up and halvings down that are tried: a factor of 1000 each


@dataclass(frozen=True, kw_only=True, slots=True)
class _Staying:
    at: float

    def samples(self, axes: int, count: int, dt_ns: int) -> tuple[list[float], ...]:
        """For each axis the position (m) at the ticks 0 .. count-1."""
        return ([self.at] * count, *[[0.0] * count] * (axes - 1))


def let_go(scene: Scene) -> Scene:
    """The experiment's scene. Refused if no hand presses the device into the wall."""
    if scene.hand is None:
        raise Refused("nothing is measured: without a hand the device leaves the wall; give the scene a hand")
    held = scene.hand.reference.samples(scene.axes, scene.ticks + 1, scene.dt_ns)[0][-1]
    wall = float(getattr(scene.law, "at", 0.0))
    if held <= wall:
        raise Refused(f"nothing is measured: the hand ends at {held:g} m, outside the wall at {wall:g} m; let it reach "
                      "further")
    hand = scene.hand
    T = scene.dt_ns / 1e9
    ticks = min(max(round(LASTING / T), TICKS[0]), TICKS[1])
    return replace(
        scene, start_m=wall - BEFORE, duration=(ticks + 0.5) * T, energy=False,
        hand=HeldGrip(mass=hand.mass, k=hand.k, d=hand.d, reference=_Staying(at=held)),
    )


def stiffest_at_rest(scene: Scene, B: float, *, near: float, low: float = 0.0, high: float | None = None,
                     seed: int = 0, tell: Callable[[], None] = lambda: None) -> float | None:
    """The stiffness (N/m) up to which a `let_go` scene comes to rest, to 1 %; None: it does at none that was tried.

    Looked for from a tenth of `near` on, within low..high; `tell` is called after each run. inf: at rest up to `high`.
    """
    def good(K: float) -> bool:
        found = settled(with_gains(scene, K, B), seed=seed).rests
        tell()
        return found

    K = max(0.1 * near if high is None else min(0.1 * near, high), low)
    if not good(K):
        for _ in range(LOWER):
            K, worse = 0.5 * K, K
            if worse <= low:
                return None
            K = max(K, low)
            if good(K):
                return _halved(good, K, worse)
        return None
    for _ in range(HIGHER):
        if high == K:
            return float("inf")
        K, better = (K * RATIO if high is None else min(K * RATIO, high)), K
        if not good(K):
            return _halved(good, better, K)
    return float("inf")


def _halved(good: Callable[[float], bool], low: float, high: float) -> float:
    for _ in range(HALVED):
        middle = (low * high) ** 0.5
        low, high = (middle, high) if good(middle) else (low, middle)
    return low
