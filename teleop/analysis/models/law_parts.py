"""The parts of a one-port loop: the law with its velocity estimator, per unit of stiffness and of damping, and the
damping of the device at each frequency.
"""

from __future__ import annotations

from dataclasses import replace
from math import pi
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.analysis.models.gains import linear_part, scales, with_gains
from teleop.analysis.models.linear import linear_estimator, matrix
from teleop.analysis.models.loop import transfer
from teleop.analysis.models.one_port_loop import controller
from teleop.errors import Refused
from teleop.law import law_name

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from teleop.analysis.models.linear import StateSpace
    from teleop.scene.scene import Scene

    Points = NDArray[np.complex128]
    Reals = NDArray[np.float64]

LONGEST = 100_000  # ticks of an impulse response


class Parts(NamedTuple):
    """The law and its estimator from the reading (m) to the force (N), without the computation's delay."""

    stiff: StateSpace  # with K = K0, B = 0
    both: StateSpace  # with K = K0, B = B0
    K0: float
    B0: float

    def responses(self, z: Points) -> tuple[Points, Points]:
        """H_K(z) and H_B(z): the force per metre for K = 1 and for B = 1."""
        stiff = transfer(self.stiff, z)[:, 0, 0]
        return stiff / self.K0, (transfer(self.both, z)[:, 0, 0] - stiff) / self.B0


def law_parts(scene: Scene) -> Parts:
    """The law of a scene without a slave, apart for K and B. Refused where its force is not linear in them."""
    import numpy as np

    bare = replace(linear_part(scene), electrical=None)
    if bare.device_m is not None:
        bare = replace(bare, device_m=replace(bare.device_m, every=1, delay=0))
    K0, B0 = scales(scene)
    velocity = bare.device_m and bare.device_m.velocity
    if velocity is not None and not is_linear(velocity, bare.dt_ns / 1e9):
        raise Refused(f"the velocity estimator {type(velocity).__name__} is not linear; {linear_estimator(scene)}")
    parts = Parts(controller(with_gains(bare, K0, 0.0)), controller(with_gains(bare, K0, B0)), K0, B0)
    z = np.exp(1j * np.array([1e-3, 0.1, 1.0, 2.0, 3.1]))
    for K, B in ((3.0 * K0, 0.4 * B0), (0.7 * K0, 0.0)):
        H_K, H_B = parts.responses(z)
        asked = transfer(controller(with_gains(bare, K, B)), z)[:, 0, 0]
        if (np.abs(K * H_K + B * H_B - asked) > 1e-6 * (np.abs(K * H_K) + np.abs(B * H_B))).any():
            raise Refused(f"the force of law {law_name(scene.law)} is not linear in K and B; take "
                          "--set law=virtual_wall")
    return parts


def is_linear(estimator: Any, dt: float) -> bool:
    """True if the estimator is linear at all sizes of motion, not only near rest."""
    start, c = estimator.start(0.0), estimator.coefficients(dt)

    def respond(given: Any) -> list[float]:
        v, after = estimator.step(c, tuple(given[1:]), given[0], dt)
        return [v, *after]

    return matrix(respond, 1 + len(start)) is not None


def norms(parts: Parts) -> tuple[float, float]:
    """|h_K|_1 and |h_B|_1 of the impulse responses: the most force per metre of a reading's error, either way."""
    import numpy as np

    def response(system: StateSpace, scale: float) -> list[float]:
        state, found = system.B[:, 0], [float(system.D[0, 0]) / scale]
        for _ in range(LONGEST):
            found.append(float(system.C[0] @ state) / scale)
            state = system.A @ state
            if not np.abs(state).any() or np.abs(state).max() < 1e-14 * np.abs(system.B).max():
                break
        return found

    stiff, both = response(parts.stiff, 1.0), response(parts.both, 1.0)
    size = max(len(stiff), len(both))
    first, second = (np.pad(each, (0, size - len(each))) for each in (stiff, both))
    return float(np.abs(first).sum() / parts.K0), float(np.abs(second - first).sum() / parts.B0)


def effective_damping(scene: Scene, th: Reals) -> Reals:
    """b_eff(th) of the device (N s/m): its damping, and what a shunt of its motor adds."""
    import numpy as np

    b = scene.master.damping
    if scene.electrical is None or scene.electrical.b == 0.0:
        return np.full_like(th, b)
    b_e, w_c = scene.electrical.b, 2.0 * pi * scene.electrical.cutoff
    WT = w_c * (b / (b + b_e)) ** 0.5 * scene.dt_ns / 1e9
    half = np.sin(0.5 * th) ** 2
    # S(W)/S(0), with cosh(WT) - cos(th) = 2 sinh(WT/2)^2 + 2 sin(th/2)^2, and e^WT taken out above and below
    share = -np.expm1(-2.0 * WT) / (2.0 * WT) * half / (0.25 * np.expm1(-WT) ** 2 + half * np.exp(-WT))
    found: Reals = b / (1.0 - b_e / (b + b_e) * share)
    return found
