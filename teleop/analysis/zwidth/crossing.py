"""The stable region's edge of a loop with many states: where, going up from nothing, a root first meets the circle.

The maps of a law that is felt directly are M_0 + u (K w_K + B w_B)^T, so a root z has, with l = w^T (z - M_0)^-1 u
worked out without the computation's delay of d ticks,

    K l_K(z) + B l_B(z) = z^d.

On z = e^(j th) these are two real equations: for each B the places where Im[(z^d - B l_B)/l_K] changes sign are all
the K at which a root is on the unit circle (D-decomposition: Yu. I. Neimark 1949). Roots move continuously, so a loop
that is stable at K -> 0 stays so up to the least of them. The places are found on a net of 64 to every half turn of z^d
and halved; a K at which a root only touches the circle may lie between them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from teleop.analysis.models.peak import grid

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Reals = NDArray[np.float64]
    Points = NDArray[np.complex128]
    Maps = tuple[Reals, Reals, Reals]

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
        import numpy as np

        z = np.exp(1j * th)
        whole = z[:, None, None] * np.eye(len(self.still)) - self.still
        found: Points = np.linalg.solve(whole, self.u.astype(complex)[:, None])[:, :, 0]
        return found @ self.w_K.astype(complex), found @ self.w_B.astype(complex)


def opened(maps: Maps, d: int) -> Open | None:
    """The open loop of maps without delay; None where K and B do not act through one force."""
    import numpy as np

    still, M_K, M_B = maps
    U, S, V = np.linalg.svd(np.hstack([M_K, M_B]))
    if S[1] > 1e-9 * S[0]:
        return None
    w = S[0] * V[0]
    found = Open(still, U[:, 0], w[:len(still)], w[len(still):], d)
    th = grid(d + 1.0)
    return found._replace(net=(th, *found.gains(th)))


def first_K(of: Open, B: float) -> float:
    """The least K > 0 with a root on the circle; inf if there is none."""
    return _first(of, lambda z_d, l_K, l_B: (z_d - B * l_B) / l_K)


def first_B(of: Open, K: float) -> float:
    """The least B > 0 with a root on the circle; inf if there is none."""
    return _first(of, lambda z_d, l_K, l_B: (z_d - K * l_K) / l_B)


def _first(of: Open, solved: Callable[[Points, Points, Points], Points]) -> float:
    import numpy as np

    def gain(th: Reals) -> Points:
        return solved(np.exp(1j * of.d * th), *of.gains(th))

    assert of.net is not None
    th, *known = of.net
    values = solved(np.exp(1j * of.d * th), *known)
    half_turn = float(values[-1].real)  # real at th = pi
    found = [half_turn] if half_turn > 0.0 else []
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
    found += [float(value.real) for value in ends if value.real > 0.0 and abs(value.imag) < 1e-3 * abs(value)]
    return min(found, default=float("inf"))
