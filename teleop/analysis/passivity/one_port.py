"""Passivity of a scene without a slave: whether its device dissipates the energy that its sampled controller generates.

The controller is read off the scene's own tick in contact (`teleop.analysis.models.one_port_loop`): law and velocity
estimator. Of a law that offers its coupling (`teleop.law.analysis_offers`), on a backward difference, the impedances
of the coupling and of what is behind it are known in closed form as well.

The damping needed is that of the linear controller alone; what encoder, friction, a cap, a passivity controller and the
motor's shunt make of it is in the verdict (`teleop.analysis.passivity.verdict`), or said to be left out of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import pi
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.analysis.models import coupling, sampled
from teleop.analysis.passivity.surroundings import linear_parts
from teleop.analysis.passivity.verdict import Verdict, verdict
from teleop.errors import Refused
from teleop.law.analysis_offers import coupling_of
from teleop.scene.scene import Scene

if TYPE_CHECKING:
    from teleop.analysis.models.coupling import Lack
    from teleop.analysis.models.peak import Reals
    from teleop.analysis.models.sampled import Impedance, Needed


class Behind(NamedTuple):
    """A virtual coupling and what is behind it."""

    C: Impedance
    E: Impedance
    alpha: Lack  # of the environment as it is integrated
    gamma: float  # N s/m, of the coupling
    miller: float  # N s/m, what alpha must be below by Miller, Colgate and Freeman
    most: float | None  # N s/m, what it must be below with the sample of the hold; None: not even 0 will do
    passive_needs: float  # N s/m, the damping that every passive environment behind the coupling can do with
    conditions: bool  # are the two above known: backward sums, a force renewed at every tick
    alone: float  # N s/m, damping needed to render the environment without a coupling
    stiffness: float  # N/m, of the environment at rest
    by: dict[str, Impedance]  # the same environment by each integrator
    integrators: dict[str, Lack]  # and what it lacks then


@dataclass(frozen=True, kw_only=True)
class RenderedImpedance:
    """A rendered impedance and the damping that it needs."""

    E: Impedance
    T: float  # s
    d: int  # ticks of delay
    every: int  # ticks after which the force is renewed
    damping: float  # N s/m, of the device
    needed: Needed
    stiffness: float  # N/m, rendered at rest
    quantised: float | None  # N/m, the most that an encoder and friction allow; None: no encoder, or no spring alone
    behind: Behind | None  # if the law offers a coupling
    verdict: Verdict

    @property
    def passive(self) -> bool | None:
        """True if the port is passive with all that is in the scene, False if not; None: not known."""
        return self.verdict.passive

    @property
    def left_out(self) -> tuple[str, ...]:
        """The parts with which that is not known."""
        return self.verdict.left_out

    def curve(self, frequency: Reals) -> Reals:
        """The damping needed at frequencies (Hz) below half the rate of renewal."""
        return sampled.damping_curve(self.E, self.T, 2.0 * pi * self.every * self.T * frequency, d=self.d,
                                     every=self.every)


def one_port(scene: Scene) -> RenderedImpedance:
    """The one-port of a scene without a slave. Refused if its law is not linear in contact."""
    if scene.slave is not None:
        raise Refused("a scene with a slave has two ports; ask for its hybrid matrix "
                      "(teleop.analysis.passivity.two_port)")
    from teleop.stages.device import Device

    T = scene.dt_ns / 1e9
    device = scene.device_m or Device()
    bare, _ = linear_parts(scene)
    E = _controller(replace(bare, electrical=None, device_m=replace(device, encoder=None, every=1, delay=0)), T)
    needed = sampled.needed_damping(E, T, d=device.delay, every=device.every)
    judged = verdict(scene, E, needed)
    simple = device.every == 1 and device.delay == 0 and judged.spring  # Abbott and Okamura's conditions
    return RenderedImpedance(
        E=E, T=T, d=device.delay, every=device.every, damping=scene.master.damping, needed=needed,
        stiffness=coupling.stiffness(E, T), verdict=judged,
        quantised=sampled.quantised_stiffness(b=scene.master.damping, T=T, step=device.encoder.step,
                                              friction=scene.master.friction) if simple and device.encoder else None,
        behind=_behind(scene, device, T),
    )


def _controller(scene: Scene, T: float) -> Impedance:
    import numpy as np

    from teleop.analysis.models.linear import INSTEAD, is_linear
    from teleop.analysis.models.one_port_loop import controller

    try:
        found = controller(scene)
    except Refused as refused:
        why, _, rest = str(refused).partition(f"; {INSTEAD}")
        if rest or INSTEAD in str(refused):
            velocity = scene.device_m and scene.device_m.velocity
            linear = "law, for example --set law=virtual_wall"
            if velocity is not None and not is_linear(velocity, T):
                linear = "one, --set 'velocity=backward_difference()'"
            raise Refused(f"{why}; take a linear {linear}, or run it with teleop run and energy in the scene, which "
                          "sums what its port takes and gives") from None
        raise
    if (np.abs(np.linalg.eigvals(found.A)) > 1.0 + 1e-6).any():
        raise Refused("the controller grows by itself, whatever it is joined to, so no damping makes it passive; try a "
                      "simulated tool of more mass, or backward Euler, --set law.theta_f=1 --set law.theta_x=1")
    return sampled.of_state_space(found, T)


def _behind(scene: Scene, device: Any, T: float) -> Behind | None:
    from teleop.stages.velocity.backward_difference import BackwardDifference

    offered = coupling_of(scene.law, T) if isinstance(device.velocity, BackwardDifference) else None
    if offered is None:
        return None
    C, E, delta = offered.C, offered.E, scene.master.damping
    gamma, lacks = coupling.least_real(C, T), coupling.lack_behind(offered, T)
    exact = device.every == 1 and offered.series  # the derivation's own conditions
    others = {name: own for name, law in offered.others.items() if (own := coupling_of(law, T)) is not None}
    return Behind(
        C=C, E=E, alpha=lacks, gamma=gamma, miller=coupling.alpha_miller(delta, gamma),
        most=coupling.alpha_max(delta, C, T, d=device.delay) if exact else None, conditions=exact,
        passive_needs=coupling.needed_damping(C, 0.0, T, d=device.delay).damping,
        alone=sampled.needed_damping(E, T, d=device.delay, every=device.every).damping,
        stiffness=coupling.stiffness(E, T), by={name: own.E for name, own in others.items()},
        integrators={name: coupling.lack_behind(own, T) for name, own in others.items()},
    )
