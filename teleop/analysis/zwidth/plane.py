"""The stable region in the plane of virtual stiffness K and damping B, from the eigenvalues of the exact sampled loop.

In contact the map of a tick (`teleop.analysis.models.one_port_loop`) is affine in (K, B) for a law that is felt
directly, so three maps give all of them, M = M_0 + K M_K + B M_B, and the plane's eigenvalues are found many at a time.
A force renewed at every n-th tick is judged by the product of n ticks. A law whose map is not affine, such as a virtual
coupling, has its map worked out at each place, on a coarser net.

The boundary is, for each B, the least K at which the loop is unstable: a net of equal ratios is searched from below and
its first change of verdict halved. What may be stable again above that is not claimed.

Laid over it are two published lines, with the condition as it is printed:

    K T/2 + B = b                   passivity without delay (Colgate and Schenkel 1997)
    K = (b + B)/(T/2 + t_d)         stability for small B and delay (J. J. Gil, E. Sanchez, T. Hulin, C. Preusche and
                                    G. Hirzinger, "Stability boundary for haptic rendering: influence of damping and
                                    delay", J. Computing and Information Science in Engineering 9(1), 2009)

T is the time for which a force is held, n ticks, and t_d the delay of the computation.

Of a loop with many states it is sought, going up from nothing, where a root first meets the circle.
The maps of a law that is felt directly are M_0 + u (K w_K + B w_B)^T, so a root z has, with l = w^T (z - M_0)^-1 u
worked out without the computation's delay of d ticks,

    K l_K(z) + B l_B(z) = z^d.

On z = e^(j th) these are two real equations: for each B the places where Im[(z^d - B l_B)/l_K] changes sign are all
the K at which a root is on the unit circle (D-decomposition: Yu. I. Neimark 1949). Roots move continuously, so a loop
that is stable at K -> 0 stays so up to the least of them. The places are found on a net of 64 to every half turn of z^d
and halved; a K at which a root only touches the circle may lie between them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from teleop.analysis.models.law_parts import linear_part, scales, with_gains
from teleop.analysis.models.one_port_loop import AT_REST, one_port
from teleop.analysis.models.peak import Points, Reals, grid
from teleop.scene.scene import Scene

Maps = tuple[Reals, Reals, Reals]
ROWS = 41  # values of B
NET = 64  # values of K for each before it is halved, HALVED times
MANY = 12  # ticks of delay: beyond, the edge is found where a root first meets the circle
LARGE = 24  # states: a greater loop that is renewed slowly, or one that is not affine, has the coarse net
COARSE = (7, 14, 14)
AT_ONCE = 2_000_000  # numbers of the matrices worked out at once


class LoopFamily(NamedTuple):
    """The loop of a scene's linear part as a function of (K, B)."""

    scene: Scene
    first: Maps | None  # (M_0, M_K, M_B) of the tick that renews the force; None: not affine
    others: Maps | None
    every: int
    states: int
    opened: Open | None = None  # of one that has too many states for its eigenvalues

    @property
    def coarse(self) -> bool:
        """True if its eigenvalues take long to compute."""
        return self.first is None or (self.states > LARGE and self.opened is None)


class Boundary(NamedTuple):
    """For each B (N s/m) the least K (N/m) at which the loop is unstable; inf: none in the range, 0: even the least."""

    B: tuple[float, ...]
    K: tuple[float, ...]

    @property
    def stiffest(self) -> float:
        """The greatest K on it."""
        return max(self.K)


class Span(NamedTuple):
    """A range of K or B that is looked at; high None: as far as the loop is stable."""

    low: float = 0.0
    high: float | None = None


ALL = Span()


def loop(scene: Scene, *, hand: bool) -> LoopFamily:
    """The loop with the scene's hand or a free handle. Refused where it is not linear in contact."""
    scene = linear_part(scene if hand else replace(scene, hand=None))
    device = scene.device_m
    if device is not None and device.every == 1 and device.delay > MANY:
        at_once = _loop(replace(scene, device_m=replace(device, delay=0)))
        cut = at_once.first and cut_open(at_once.first, device.delay)
        if cut:
            return LoopFamily(scene, at_once.first, at_once.others, 1, at_once.states, cut)
    return _loop(scene)


def _loop(scene: Scene) -> LoopFamily:
    K0, B0 = scales(scene)
    places = ((K0, 0.0), (2.0 * K0, 0.0), (K0, B0), (1.7 * K0, 0.6 * B0))
    samples = [one_port(with_gains(scene, K, B)).ticks for K, B in places]
    kinds = []
    for tick in range(min(len(samples[0]), 2)):
        base, stiffer, damped, tried = (maps[tick] for maps in samples)
        M_K, M_B = (stiffer - base) / K0, (damped - base) / B0
        M_0 = base - K0 * M_K
        size = abs(M_0) + K0 * abs(M_K) + B0 * abs(M_B)
        if (abs(M_0 + 1.7 * K0 * M_K + 0.6 * B0 * M_B - tried) > 1e-7 * size + 1e-12).any():
            return LoopFamily(scene, None, None, len(samples[0]), len(base))
        kinds.append((M_0, M_K, M_B))
    return LoopFamily(scene, kinds[0], kinds[-1], len(samples[0]), len(kinds[0][0]))


def is_stable(of: LoopFamily, K: Any, B: Any) -> NDArray[np.bool_]:
    """True where the loop is stable at (K, B): no root outside the unit circle, those at rest at z = 1 aside."""
    K, B = np.broadcast_arrays(np.asarray(K, dtype=float), np.asarray(B, dtype=float))
    if K.size * of.states**2 > AT_ONCE and K.size > 1:
        half = K.size // 2
        parts = [is_stable(of, K.ravel()[some], B.ravel()[some]) for some in (slice(half), slice(half, None))]
        return np.concatenate(parts).reshape(K.shape)
    if of.first is None or of.others is None:
        maps = np.array([one_port(with_gains(of.scene, float(k), float(b))).period
                         for k, b in zip(K.ravel(), B.ravel(), strict=True)])
    else:
        first, later = (M_0 + K.reshape(-1, 1, 1) * M_K + B.reshape(-1, 1, 1) * M_B
                        for M_0, M_K, M_B in (of.first, of.others))
        maps = np.linalg.matrix_power(later, of.every - 1) @ first
    sound = np.isfinite(maps).all(axis=(1, 2))
    roots = np.linalg.eigvals(np.where(sound[:, None, None], maps, 2.0 * np.eye(maps.shape[-1])))
    outside = (np.abs(roots) > 1.0 + 1e-12) & (np.abs(roots - 1.0) > AT_REST)
    return np.asarray(~outside.any(axis=1)).reshape(K.shape)


def top(scene: Scene) -> tuple[float, float]:
    """A stiffness and a damping beyond all that is stable: of a mass that a force turns round within a tick, and more.

    M x'' = -K x held for T overshoots itself threefold at K = 6 M/T^2, -B v at B = 3 M/T; M includes the hand's.
    """
    T = scene.dt_ns / 1e9
    mass = scene.master.mass + (0.0 if scene.hand is None else scene.hand.mass)
    damping = scene.master.damping + (0.0 if scene.hand is None else scene.hand.d)
    damping += 0.0 if scene.electrical is None else scene.electrical.b
    B = 20.0 * (mass / T + damping)
    return B / T, B


def boundary(of: LoopFamily, B: Sequence[float], span: Span = ALL) -> Boundary:
    """The stable region's edge at each of these B, within `span` of K."""
    if of.opened is not None:
        return _crossed(of, of.opened, B, span)
    _, net, halved = COARSE if of.coarse else (ROWS, NET, HALVED)
    high = span.high or top(of.scene)[0]
    Ks = np.geomspace(max(span.low, 1e-7 * high), high, net)
    rows = np.asarray(B, dtype=float)
    good = is_stable(of, *np.meshgrid(Ks, rows))  # (rows, net)
    first = np.where(good.all(axis=1), net, good.argmin(axis=1))
    between = (first > 0) & (first < net)
    low, most = Ks[np.maximum(first - 1, 0)], Ks[np.minimum(first, net - 1)]
    for _ in range(halved if between.any() else 0):
        middle = 0.5 * (low + most)
        below = is_stable(of, middle, rows)
        low, most = np.where(below, middle, low), np.where(below, most, middle)
    edge = np.where(between, 0.5 * (low + most), np.where(first == 0, 0.0, np.inf))
    return Boundary(tuple(rows.tolist()), tuple(edge.tolist()))


def _crossed(of: LoopFamily, cut: Open, B: Sequence[float], span: Span) -> Boundary:
    """The same where the eigenvalues are too many."""
    least, high = max(span.low, 1e-7 * top(of.scene)[0]), span.high or float("inf")
    most, edges = first_B(cut, least), []
    for value in B:
        edge = first_K(cut, value)
        edges.append(0.0 if edge <= least or value >= most else float("inf") if edge > high else edge)
    return Boundary(tuple(B), tuple(edges))


def most_damping(of: LoopFamily, span: Span = ALL) -> float:
    """The least B at which the loop is unstable with next to no K; 0 if every one is."""
    if of.opened is not None:
        return first_B(of.opened, max(span.low, 1e-7 * top(of.scene)[0]))
    _, net, halved = COARSE if of.coarse else (ROWS, NET, HALVED)
    K, high = top(of.scene)
    least = np.array(max(span.low, 1e-7 * K))
    Bs = np.geomspace(1e-5 * high, high, net)
    good = is_stable(of, least, Bs)
    if good.all() or not good[0]:
        return float(good[0]) * high
    low, high = Bs[good.argmin() - 1], Bs[good.argmin()]
    for _ in range(halved):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_stable(of, least, np.array(middle)) else (low, middle)
    return float(high)


def rows(of: LoopFamily, span: Span, stiffness: Span) -> list[float]:
    """The values of B at which the boundary is looked for."""
    count, _, _ = COARSE if of.coarse else (ROWS, NET, HALVED)
    high = span.high or most_damping(of, stiffness)
    return [float(B) for B in np.linspace(span.low, max(high, span.low), count)]


def passive_line(scene: Scene, B: Reals) -> Reals:
    """K on the line K T/2 + B = b, T the time for which a force is held."""
    held, _ = _times(scene)
    K: Reals = 2.0 * (scene.master.damping - B) / held
    return K


def published_rule(scene: Scene, B: Reals) -> Reals:
    """K on the line K = (b + B)/(T/2 + t_d)."""
    held, late = _times(scene)
    K: Reals = (scene.master.damping + B) / (0.5 * held + late)
    return K


def _times(scene: Scene) -> tuple[float, float]:
    """For how long a force is held, and how late it is computed, s."""
    T = scene.dt_ns / 1e9
    return (T, 0.0) if scene.device_m is None else (T * scene.device_m.every, T * scene.device_m.delay)


HALVED = 36


class Open(NamedTuple):
    """The loop cut open at the force: l_K and l_B without the delay, and the delay d in ticks."""

    still: Reals  # M_0
    u: Reals
    w_K: Reals
    w_B: Reals
    d: int
    net: tuple[Reals, Points, Points] | None = None  # th, l_K and l_B at the places tried first

    def gains(self, th: Reals) -> tuple[Points, Points]:
        """l_K and l_B at e^(j th)."""
        z = np.exp(1j * th)
        whole = z[:, None, None] * np.eye(len(self.still)) - self.still
        response: Points = np.linalg.solve(whole, self.u.astype(complex)[:, None])[:, :, 0]
        return response @ self.w_K.astype(complex), response @ self.w_B.astype(complex)


def cut_open(maps: Maps, d: int) -> Open | None:
    """The open loop of maps without delay; None where K and B do not act through one force."""
    still, M_K, M_B = maps
    U, S, V = np.linalg.svd(np.hstack([M_K, M_B]))
    if S[1] > 1e-9 * S[0]:
        return None
    w = S[0] * V[0]
    cut = Open(still, U[:, 0], w[:len(still)], w[len(still):], d)
    th = grid(d + 1.0)
    return cut._replace(net=(th, *cut.gains(th)))


def first_K(of: Open, B: float) -> float:
    """The least K > 0 with a root on the circle; inf if there is none."""
    return _first(of, lambda z_d, l_K, l_B: (z_d - B * l_B) / l_K)


def first_B(of: Open, K: float) -> float:
    """The least B > 0 with a root on the circle; inf if there is none."""
    return _first(of, lambda z_d, l_K, l_B: (z_d - K * l_K) / l_B)


def _first(of: Open, solved: Callable[[Points, Points, Points], Points]) -> float:
    def gain(th: Reals) -> Points:
        return solved(np.exp(1j * of.d * th), *of.gains(th))

    assert of.net is not None
    th, *known = of.net
    values = solved(np.exp(1j * of.d * th), *known)
    half_turn = float(values[-1].real)  # real at th = pi
    angles = [half_turn] if half_turn > 0.0 else []
    # Within a step of the net the gain moves little: who is far from the least needs no closer look.
    at = np.flatnonzero(np.sign(values.imag[:-2]) != np.sign(values.imag[1:-1]))
    at = at[np.maximum(values.real[at], values.real[at + 1]) > 0.0]
    low, high, rising = th[at], th[at + 1], values.imag[at] < 0.0
    for _ in range(HALVED if len(at) else 0):
        middle = 0.5 * (low + high)
        below = (gain(middle).imag < 0.0) == rising
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    ends = gain(0.5 * (low + high)) if len(at) else values[:0]
    # A sign changes at a pole of the gain too, where it is endless and not zero.
    angles += [float(value.real) for value in ends if value.real > 0.0 and abs(value.imag) < 1e-3 * abs(value)]
    return min(angles, default=float("inf"))
