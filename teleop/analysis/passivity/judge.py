"""A two-port over a range of frequencies: where Llewellyn's criterion fails, what is felt of what is touched."""

from __future__ import annotations

from collections.abc import Callable
from math import pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from teleop.analysis.models.by_axis import one_loop
from teleop.analysis.models.peak import Points, Reals
from teleop.analysis.passivity.two_port import TwoPort, continuous_two_port, sampled_two_port
from teleop.errors import Refused
from teleop.scene.scene import Scene

PLACES = 2000  # of the range, by equal ratios
MOST_PLACES = 100_000  # with those that a delay asks for
SLOW, UNIT = 0.01, 1.0  # Hz, at which stiffness and free motion are told
ROUNDS = 6  # of zooming in on an edge, each to a sixteenth


class Band(NamedTuple):
    """An interval of frequencies."""

    low: float  # Hz
    high: float  # Hz


class Judged(NamedTuple):
    """Verdict on a two-port over a range."""

    port: TwoPort
    bands: tuple[Band, ...]  # where the criterion fails
    least: float  # of Llewellyn's parameter
    at: float  # Hz, where it is least
    passive: bool  # is the two-port so by itself
    free: float  # N s/m, |h11| at 1 Hz
    felt: float | None  # N/m, |Z| w at 0.01 Hz with the scene's environment; None: that is not linear

    @property
    def absolutely_stable(self) -> bool:
        """True if Llewellyn's criterion holds all over the range."""
        return not self.bands


class TwoPorts(NamedTuple):
    """A scene's two-port as it runs, and without a clock."""

    sampled: Judged | None
    continuous: Judged | None
    why_not: dict[str, str]  # of the one that there is not
    touched: Callable[[Reals], Points] | None  # N s/m, what the slave touches; None: not linear
    stiffness: float | None  # N/m, of that at 0.01 Hz
    low: float  # Hz
    high: float  # Hz


def two_ports(scene: Scene, *, low: float = 0.1, high: float | None = None, seed: int = 0) -> TwoPorts:
    """Judge a scene's two-port from `low` to `high` (Hz; left out: 0.49 of the rate). Refused if it has none.

    In continuous time a law may have no limit, and sampled a force be renewed slowly: then there is one of the two.
    """
    from teleop.analysis.passivity.surroundings import delays, touched

    scene = one_loop(scene)
    top = 0.49e9 / scene.dt_ns
    high = top if high is None else high
    if not 0.0 < low < high <= top:
        raise Refused(f"the range {low:g}:{high:g} Hz must lie above 0 and not above 0.49 of the rate, {top:g} Hz "
                      "here, its lower end first; write for example --range 0.1:100")
    one_hertz = touched(scene, _axis(_array([UNIT])))

    def at(frequency: Reals) -> Points:
        impedance = touched(scene, _axis(frequency))
        assert impedance is not None
        return impedance

    around = None if one_hertz is None else at
    why: dict[str, str] = {}
    judged: dict[str, Judged] = {}
    makes: dict[str, Callable[[Reals], TwoPort]] = {
        "sampled": lambda f: sampled_two_port(scene, f, seed=seed),
        "continuous": lambda f: continuous_two_port(scene, f),
    }
    refused = None
    for name, make in makes.items():
        try:
            trip = sum(delays(scene, seed))
            judged[name] = judge(make, low=low, high=high, trip=trip, touched=around)
        except Refused as error:
            refused = refused or error
            why[name] = str(error).partition(";")[0]
    if not judged and refused is not None:
        raise refused
    stiff = None if around is None else float(abs(around(_array([SLOW]))[0])) * 2.0 * pi * SLOW
    return TwoPorts(judged.get("sampled"), judged.get("continuous"), why, around, stiff, low, high)


def judge(make: Callable[[Reals], TwoPort], *, low: float, high: float, trip: float = 0.0,
          touched: Callable[[Reals], Points] | None = None) -> Judged:
    """Judge a two-port given as a function of frequencies (Hz); `trip` is the round trip (s), which sets the grid.

    Edges of bands to 1e-6 of them. What fails between two places of the grid is not seen.
    """
    turns = min(int(32.0 * trip * (high - low)), MOST_PLACES)
    port = make(np.union1d(np.geomspace(low, high, PLACES), np.linspace(low, high, max(turns, 2))))
    f, eta, good = port.frequency, port.eta, port.absolutely_stable
    changes = np.flatnonzero(good[1:] != good[:-1])
    edges = _edges(make, f[changes], f[changes + 1])
    edges = [float(low)] * (not good[0]) + edges + [float(high)] * (not good[-1])
    slow = make(np.array([SLOW, UNIT]))
    worst = int(eta.argmin())
    least, at = float(eta[worst]), float(f[worst])
    for _ in range(ROUNDS):
        near = make(np.linspace(f[max(worst - 1, 0)], f[min(worst + 1, len(f) - 1)], 17))
        f, worst = near.frequency, int(near.eta.argmin())
        if near.eta[worst] < least:
            least, at = float(near.eta[worst]), float(f[worst])
    felt = None
    if touched is not None:
        felt = float(abs(slow.perceived_impedance(touched(slow.frequency))[0])) * 2.0 * pi * SLOW
    scale = np.abs(port.h[:, 0, 1]) ** 2 + np.abs(port.h[:, 1, 0]) ** 2
    passive = bool((port.raisbeck >= -1e-9 * scale).all() and (port.h[:, 0, 0].real >= 0.0).all())
    bands = tuple(Band(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True))
    return Judged(port, bands, least, at, passive, float(abs(slow.h[1, 0, 0])), felt)


def _edges(make: Callable[[Reals], TwoPort], low: Reals, high: Reals) -> list[float]:
    """Frequencies at which the verdict changes between each two given ones, all zoomed in on at once."""
    column = np.arange(len(low))
    for _ in range(ROUNDS if len(low) else 0):
        f = np.linspace(low, high, 17)
        good = make(f.ravel()).absolutely_stable.reshape(f.shape)
        first = np.maximum((good != good[0]).argmax(axis=0), 1)
        low, high = f[first - 1, column], f[first, column]
    middle: list[float] = (0.5 * (low + high)).tolist()
    return middle


def _axis(frequency: Reals) -> Points:
    return (2j * pi * frequency).astype(np.complex128)


def _array(values: list[float]) -> NDArray[np.float64]:
    return np.array(values)
