"""The numbers behind the plots of a linear scene's stability: its roots, its open loop, and both over a knob.

The open loop is L_j(w) = -z^-d l_j(z) at z = e^(jwT), of which `teleop.analysis.models.loop` says what l_j is: the
eigenvalues of both ends in series, the delay between them, with the sign that makes -1 the critical point of Nyquist's
criterion. Its phase margin is the least rotation, either way, that brings an L_j of magnitude 1 to -1.
"""

from collections.abc import Callable, Sequence
from math import pi
from typing import Any, NamedTuple

import numpy as np

from teleop.analysis.models.by_axis import alike, couples
from teleop.analysis.models.linear import LinearScene, linear_scene
from teleop.analysis.models.loop import gains, in_order, indent, sampled_loop
from teleop.analysis.models.one_port_loop import cut_open, gain_and_mode, one_port
from teleop.analysis.models.peak import Points, Reals
from teleop.analysis.models.roots import MOST_STATES, Roots, dominant, greatest, states
from teleop.scene.scene import Scene
from teleop.terminal.answer import WithUnit

DRAWN = 200  # roots of a loop with more states than a dense matrix has
SLOWEST = 0.01  # Hz
PLACES = 1500  # of the frequencies by equal ratios
MOST_PLACES = 40_000  # with those that a delay asks for


class OpenLoop(NamedTuple):
    """The open loop over frequency, and where it passes 1 in magnitude and -1 in phase."""

    frequency: Reals  # Hz, (n,)
    L: Points  # (n, branches)
    delay: float  # s, the round trip that is in it
    phase_margin: float | None  # rad; None: its magnitude is nowhere 1, or the loop is unstable
    gain_crossover: float | None  # Hz, where that is; of an unstable loop the slowest
    phase_crossover: float | None  # Hz, where the gain margin is


class Picture(NamedTuple):
    """Numbers that are drawn of one scene."""

    roots: Roots
    period: float  # s, after which a motion z^k is taken
    loop: OpenLoop | None  # None: the loop cannot be cut open, see `cut_open`


class MarginCurves(NamedTuple):
    """Margins over values of a knob, each (n,); nan where there is none."""

    values: Reals
    growth: Reals  # 1/s, of the dominant mode
    gain_margin: Reals
    phase_margin: Reals  # rad


def picture(scene: Scene, *, unstable: bool, gain_margin: float | None, seed: int = 0) -> Picture:
    """The numbers behind the plot of a scene of that verdict and gain margin. Refused if it is not linear."""
    linear = linear_loop(scene, seed)
    if scene.slave is None and (linear is None or states(linear) <= MOST_STATES):
        whole = one_port(scene)
        z = whole.roots()
        roots, period = Roots(z[np.argsort(-np.abs(z))], len(z), True), whole.dt * len(whole.ticks)
        return Picture(roots, period, linear and open_loop(linear, unstable=unstable, gain_margin=gain_margin))
    assert linear is not None
    loop = open_loop(linear, unstable=unstable, gain_margin=gain_margin)
    return Picture(greatest(linear, DRAWN), linear.dt, loop)


def linear_loop(scene: Scene, seed: int) -> LinearScene | None:
    """The scene as two ends and the delay between them; None for a loop that cannot be cut so."""
    if scene.slave is None:
        return cut_open(scene)
    return linear_scene(scene, seed=seed)


def open_loop(linear: LinearScene, *, unstable: bool, gain_margin: float | None) -> OpenLoop:
    """The open loop from `SLOWEST` to half the rate, as finely as its delay turns it."""
    d, top = linear.round_trip, 0.5 / linear.dt
    even = np.linspace(0.0, top, min(32 * d + 2, MOST_PLACES))[1:]
    f = np.union1d(np.geomspace(min(SLOWEST, 1e-3 * top), top, PLACES), even)
    z = np.exp(2j * pi * linear.dt * f)
    L = -in_order(gains(linear.master, linear.slave, z)) * np.exp(-2j * pi * linear.dt * d * f)[:, None]
    margin, crossover = _phase_margin(linear)
    return OpenLoop(f, L, d * linear.dt, None if unstable else margin, crossover, _phase_crossover(f, L, gain_margin))


def _phase_margin(linear: LinearScene) -> tuple[float | None, float | None]:
    """The least angle (rad) to -1 where the magnitude is 1, and that frequency (Hz)."""
    d, angles = linear.round_trip, []
    for crossing in sampled_loop(linear).crossings(d):
        if crossing.at.imag > 2.0 * indent(linear):
            psi = (crossing.log - d * crossing.at).imag
            angles.append((abs((psi + pi) % (2.0 * pi) - pi), crossing.at.imag / (2.0 * pi * linear.dt)))
    return min(angles) if angles else (None, None)


def _phase_crossover(f: Reals, L: Points, gain_margin: float | None) -> float | None:
    """The frequency (Hz) at which the gain margin brings an L_j to -1; 0 for what rests."""
    if gain_margin is None or gain_margin == 1.0:
        return None if gain_margin is None else 0.0
    passed = (L.imag[1:] * L.imag[:-1] <= 0.0) & (L.real[1:] < 0.0) & (L.real[:-1] < 0.0)
    i, j = np.nonzero(passed)
    ends = [(float(f[k]), float(abs(size))) for k in (0, -1) for size in L[k] if abs(np.angle(-size)) < 1e-2]
    crossings = ends + [(float(f[a]), float(abs(L[a, b]))) for a, b in zip(i, j, strict=True)]
    near = min(crossings, key=lambda one: abs(np.log(max(one[1], 1e-300) * gain_margin)), default=None)
    return near[0] if near is not None and abs(near[1] * gain_margin - 1.0) < 0.2 else None


def sweep(make: Callable[[float], Scene], values: Sequence[float], *, seed: int = 0,
          tell: Callable[[int], None] | None = None) -> MarginCurves:
    """The dominant growth rate and both margins at values of a knob. `tell` is called with how many are done."""
    rows = []
    for i, value in enumerate(values):
        rows.append(_margins(make(value), seed))
        if tell is not None:
            tell(i + 1)
    growth, gain, phase = np.array(rows, dtype=float).reshape(-1, 3).T
    return MarginCurves(np.array(values, dtype=float), growth, gain, phase)


def _margins(scene: Scene, seed: int) -> tuple[float | None, float | None, float | None]:
    """Growth of the dominant mode (1/s), gain and phase margin (rad) of one scene; of several axes the worst of each.

    Of a scene that is unstable on some axes the gain margin is that of those, as in `Stability`.
    """
    if scene.axes > 1 and not couples(scene):
        every = [_margins(single, seed) for single, _ in alike(scene)]
        shaky = [each for each in every if each[0] is not None and each[0] > 0.0] or every
        return (max((a for a, _, _ in every if a is not None), default=None),
                min((b for _, b, _ in shaky if b is not None), default=None),
                None if len(shaky) < len(every) else min((c for _, _, c in every if c is not None), default=None))
    linear = linear_loop(scene, seed)
    if scene.slave is None:
        margin = gain_and_mode(scene, linear)
        mode, gain, unstable = margin.mode, margin.gain_margin, margin.unstable
    else:
        from teleop.analysis.models.margins import gain_margin, integrators

        assert linear is not None
        mode, gain = dominant(linear, integrators(linear)), gain_margin(linear)
        unstable = sampled_loop(linear).outside(linear.round_trip)
    phase = None if linear is None or unstable else _phase_margin(linear)[0]
    return mode and mode.growth, gain, phase


def numbers(drawn: Picture) -> dict[str, Any]:
    """The keys of the JSON document on a picture."""
    loop = drawn.loop
    return {
        "roots": {"drawn": len(drawn.roots.z), "total": drawn.roots.total, "complete": drawn.roots.complete},
        "open_loop": loop and {
            "phase_margin": WithUnit(loop.phase_margin, "rad"), "gain_crossover": WithUnit(loop.gain_crossover, "Hz"),
            "phase_crossover": WithUnit(loop.phase_crossover, "Hz"),
        },
    }


def curves(drawn: Picture, swept: MarginCurves | None) -> dict[str, Any]:
    """The arrays: `roots` z, `frequency` and `L` of the open loop, and of a knob `swept_values` and what is over it."""
    arrays: dict[str, Any] = {"roots": drawn.roots.z}
    if drawn.loop is not None:
        arrays |= {"frequency": drawn.loop.frequency, "L": drawn.loop.L}
    return arrays if swept is None else arrays | {f"swept_{name}": each for name, each in swept._asdict().items()}
