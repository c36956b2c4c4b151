"""The parts of a one-port loop: the law with its velocity estimator, per unit of stiffness and of damping, and the
damping of the device at each frequency.
"""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from math import pi
from typing import Any, NamedTuple

import numpy as np

from teleop.analysis.models.by_axis import one_loop
from teleop.analysis.models.linear import StateSpace, linear_estimator, matrix
from teleop.analysis.models.loop import transfer
from teleop.analysis.models.one_port_loop import controller, one_axis
from teleop.analysis.models.peak import Points, Reals
from teleop.errors import Refused
from teleop.law import law_name
from teleop.scene.scene import Scene

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
        force = transfer(controller(with_gains(bare, K, B)), z)[:, 0, 0]
        if (np.abs(K * H_K + B * H_B - force) > 1e-6 * (np.abs(K * H_K) + np.abs(B * H_B))).any():
            raise Refused(f"the force of law {law_name(scene.law)} is not linear in K and B; take "
                          "--set law=virtual_wall")
    return parts


def is_linear(estimator: Any, dt: float) -> bool:
    """True if the estimator is linear at all sizes of motion, not only near rest."""
    start, c = estimator.start(0.0), estimator.coefficients(dt)

    def respond(numbers: Any) -> list[float]:
        v, after = estimator.step(c, tuple(numbers[1:]), numbers[0], dt)
        return [v, *after]

    return matrix(respond, 1 + len(start)) is not None


def norms(parts: Parts) -> tuple[float, float]:
    """|h_K|_1 and |h_B|_1 of the impulse responses: the most force per metre of a reading's error, either way."""
    def response(system: StateSpace, scale: float) -> list[float]:
        state, response = system.B[:, 0], [float(system.D[0, 0]) / scale]
        for _ in range(LONGEST):
            response.append(float(system.C[0] @ state) / scale)
            state = system.A @ state
            if not np.abs(state).any() or np.abs(state).max() < 1e-14 * np.abs(system.B).max():
                break
        return response

    stiff, both = response(parts.stiff, 1.0), response(parts.both, 1.0)
    size = max(len(stiff), len(both))
    first, second = (np.pad(each, (0, size - len(each))) for each in (stiff, both))
    return float(np.abs(first).sum() / parts.K0), float(np.abs(second - first).sum() / parts.B0)


def effective_damping(scene: Scene, th: Reals) -> Reals:
    """b_eff(th) of the device (N s/m): its damping, and what a shunt of its motor adds."""
    b = scene.master.damping
    if scene.electrical is None or scene.electrical.b == 0.0:
        return np.full_like(th, b)
    b_e, w_c = scene.electrical.b, 2.0 * pi * scene.electrical.cutoff
    WT = w_c * (b / (b + b_e)) ** 0.5 * scene.dt_ns / 1e9
    half = np.sin(0.5 * th) ** 2
    # S(W)/S(0), with cosh(WT) - cos(th) = 2 sinh(WT/2)^2 + 2 sin(th/2)^2, and e^WT taken out above and below
    share = -np.expm1(-2.0 * WT) / (2.0 * WT) * half / (0.25 * np.expm1(-WT) ** 2 + half * np.exp(-WT))
    effective: Reals = b / (1.0 - b_e / (b + b_e) * share)
    return effective


def check(scene: Scene) -> Scene:
    """The first axis of a scene that has a Z-width; `Refused` for others, with what to type."""
    if scene.slave is not None:
        raise Refused(f"scene {scene.name} has a slave, and a Z-width is that of one device with what its controller "
                      "renders; take a scene without one, for example teleop zwidth virtual_wall")
    one_loop(scene)
    known = {field.name for field in fields(scene.law)} if is_dataclass(scene.law) else set()
    if not all(name in known and isinstance(getattr(scene.law, name), float | int) for name in ("K", "B")):
        raise Refused(f"law {law_name(scene.law)} has no stiffness K and damping B to draw a plane of; take one that "
                      "has, for example --set law=virtual_wall")
    return one_axis(scene)


def with_gains(scene: Scene, K: float, B: float) -> Scene:
    """The scene with another stiffness (N/m) and damping (N s/m) of its law."""
    return replace(scene, law=replace(scene.law, K=K, B=B))


def linear_part(scene: Scene) -> Scene:
    """The scene without what is not linear around the law: encoder, friction, force cap, passivity controller."""
    device = scene.device_m
    return replace(
        scene, cap=None, passivity=None, energy=False, master=replace(scene.master, friction=0.0),
        device_m=None if device is None else replace(device, encoder=None),
    )


def left_out(scene: Scene) -> list[str]:
    """Name the parts of the scene that `linear_part` leaves out."""
    device = scene.device_m
    nonlinear = {
        "its encoder": device is not None and device.encoder is not None,
        "its Coulomb friction": scene.master.friction > 0.0,
        "its force cap": scene.cap is not None,
        "its passivity controller": scene.passivity is not None,
    }
    return [words for words, has in nonlinear.items() if has]


def scales(scene: Scene) -> tuple[float, float]:
    """A stiffness (N/m) and a damping (N s/m) of the device's own size, at which its maps are read off."""
    T = scene.dt_ns / 1e9
    B = max(scene.master.damping, 1e-3 * scene.master.mass / T)
    return B / T, 0.25 * B
