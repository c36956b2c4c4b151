"""Passivity of a scene without a slave: whether its device dissipates the energy that its sampled controller generates.

The controller is read off the scene's own tick in contact (`teleop.analysis.models.one_port_loop`): law and velocity
estimator. Of a law that offers its coupling (`teleop.law.analysis_offers`), on a backward difference, the impedances
of the coupling and of what is behind it are known in closed form as well.

The damping needed is that of the linear controller alone; what encoder, friction, a cap, a passivity controller and the
motor's shunt make of it is in the verdict, or said to be left out of it.

Two leaks that do not mix (Abbott and Okamura 2005): what holding the force makes, damping takes up; what the encoder's
steps make, Coulomb friction does.

- Damping: `sampled.needed_damping`, necessary and sufficient; with a shunt of the motor against the damping that it
  adds at each frequency (`law_parts.effective_damping`). Friction does not help: of large motions it takes up next to
  nothing.
- Encoder: (D/2)(K |h_K|_1 + B |h_B|_1) <= fc is sufficient (`teleop.analysis.zwidth.passive` derives it). Without
  friction nothing that is rendered is passive: a handle moved slowly to and fro over an edge of the encoder, turning
  whenever the force has changed, is helped on both ways by half the step's force. That is energy to the first order in
  the velocity, of which b takes the second. For a spring alone, whose force changes by K D, the same motion shows
  K D/2 <= fc to be necessary, whatever the delay and the renewal. With a damper and friction no necessary condition
  is claimed, and behind a virtual coupling no sufficient one.
- Cap: a spring alone keeps its bound K (T/2 + d T), and n T for T. Capped it is f = phi(x) with 0 <= phi' <= K, a
  potential W has W' = phi, and over a tick in which x moves by e_k

      W(x + e_k) - W(x) - phi(x_(k-d)) e_k  <=  K e_k^2/2 + K |e_k| (|e_(k-1)| + ... + |e_(k-d)|),

  whose sum is at most (K/2 + d K) sum e_k^2 <= (K/2 + d K) T int v^2. With a damper, or a slew limit, nothing is
  claimed. What is not passive in small motions is so under a cap.
- A passivity controller's held damping makes energy of its own; nothing is claimed of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite, pi
from typing import Any, NamedTuple

import numpy as np

from teleop.analysis.models import coupling, sampled
from teleop.analysis.models.coupling import Lack
from teleop.analysis.models.law_parts import check, effective_damping, law_parts, norms
from teleop.analysis.models.linear import NotLinear, is_linear
from teleop.analysis.models.one_port_loop import controller
from teleop.analysis.models.peak import Reals, highest
from teleop.analysis.models.sampled import Impedance, Needed
from teleop.analysis.passivity.surroundings import linear_parts
from teleop.errors import Refused
from teleop.law.analysis_offers import coupling_of
from teleop.scene.scene import Scene
from teleop.stages.device import Device
from teleop.stages.velocity.backward_difference import BackwardDifference
from teleop.terminal.table import si


class Shunt(NamedTuple):
    """Damping added by the motor's shunt, where the damping available and the damping needed are closest."""

    adds: float  # N s/m
    needs: float  # N s/m, of all the damping there
    frequency: float  # Hz, of that place; 0: from slow motion on


class Verdict(NamedTuple):
    """Verdict on a one-port, with its reason."""

    passive: bool | None  # None: not known
    sentence: str
    left_out: tuple[str, ...]  # the parts with which it is not known
    friction: float | None  # N of Coulomb friction, enough for the encoder; None: there is none, or no bound is known
    spring: bool  # is a spring alone what is rendered
    shunt: Shunt | None  # None: there is none, it is not called on, or not known


def verdict(scene: Scene, E: Impedance, needed: Needed) -> Verdict:
    """Judge a scene without a slave, given its linear controller E(z) and the damping that it needs."""
    T, device = scene.dt_ns / 1e9, scene.device_m or Device()
    spring, friction = is_spring(E, T) and coupling_of(scene.law, T) is None, _friction_needed(scene)
    (damped, shunt), stepped = _damped(scene, E, needed, device), _stepped(scene, device, friction, spring)
    passive = None if stepped is None else damped is True and stepped
    if not damped:
        passive = False
    left = _unknown(scene, device, E, spring=spring, damped=damped, stepped=stepped)
    sentence = _sentence(scene, needed, passive, damped, stepped, friction, shunt)
    if left:
        them = "it" if len(left) == 1 and not left[0].endswith("s") else "them"
        sentence = f"not known with its {' and '.join(left)}; without {them} {sentence}"
        return Verdict(None, sentence, left, friction, spring, shunt)
    return Verdict(passive, sentence, (), friction, spring, shunt)


def is_spring(E: Impedance, T: float) -> bool:
    """True if the force is the stiffness times the reading and nothing else."""
    z = np.exp(1j * np.array([1e-2, 0.1, 1.0, 2.0, 3.0]))
    H = np.asarray(E(z)) * (1.0 - 1.0 / z) / T
    return bool((np.abs(H - H[0].real) <= 1e-9 * np.abs(H[0])).all())


def _friction_needed(scene: Scene) -> float | None:
    """(D/2)(K |h_K|_1 + B |h_B|_1)."""
    device: Any = scene.device_m
    if device is None or device.encoder is None or coupling_of(scene.law, scene.dt_ns / 1e9) is not None:
        return None
    try:
        law: Any = check(scene).law
        of_K, of_B = norms(law_parts(check(scene)))
    except Refused:
        return None
    return float(0.5 * device.encoder.step * (law.K * of_K + law.B * of_B))


def _damped(scene: Scene, E: Impedance, needed: Needed, device: Device) -> tuple[bool | None, Shunt | None]:
    """True if there is damping enough for the held force, None if that is not known; and the part of a shunt in it.

    The shunt counts where the damping of the device alone is not enough.
    """
    b = scene.master.damping
    enough = b >= needed.damping * (1.0 - 1e-9)
    if enough or scene.electrical is None or scene.electrical.b == 0.0 or not isfinite(needed.damping):
        return enough, None
    if device.every > 1 or b == 0.0:
        return None, None
    T, d = scene.dt_ns / 1e9, device.delay
    share = highest(lambda th: sampled.damping_curve(E, T, th, d=d) / effective_damping(scene, th), d + 1)
    has, at = float(effective_damping(scene, np.array([share.th]))[0]), sampled.frequency(share, T)
    return share.value <= 1.0 + 1e-9, Shunt(has - b if at > 0.0 else 0.0, share.value * has, at)


def _stepped(scene: Scene, device: Device, friction: float | None, spring: bool) -> bool | None:
    """True if there is friction enough for the encoder; None: not known."""
    fc = scene.master.friction
    if device.encoder is None or friction == 0.0:
        return True
    if fc == 0.0:
        return False
    if friction is None:
        return None
    if friction <= fc * (1.0 + 1e-9):
        return True
    return False if spring else None


def _unknown(scene: Scene, device: Device, E: Impedance, *, spring: bool, damped: bool | None,
             stepped: bool | None) -> tuple[str, ...]:
    """The parts with which the verdict is not known."""
    from teleop.analysis.models.coupling import stiffness

    left = ["passivity controller"] if scene.passivity is not None else []
    left += ["left-out ticks"] if scene.left_out_m is not None else []
    if cap := scene.cap:
        plain = cap.slew is None and cap.v_max is None and cap.power is None
        step = 0.0 if device.encoder is None else stiffness(E, scene.dt_ns / 1e9) * device.encoder.step
        if damped and stepped:
            known = spring and plain
        else:
            small = damped is False and scene.master.friction == 0.0 and device.encoder is None
            known = small or (stepped is False and plain and cap.most > step)
        left += [] if known else ["cap"]
    if damped is None and stepped is not False:
        left.append("electrical damping")
    return tuple(left)


def _sentence(scene: Scene, needed: Needed, passive: bool | None, damped: bool | None, stepped: bool | None,
              friction: float | None, shunt: Shunt | None) -> str:
    if not isfinite(needed.damping):
        return "not passive with any damping: the law's stiffness is negative"
    b, fc = scene.master.damping, scene.master.friction
    word = {True: "passive", False: "not passive", None: "not known"}[passive]
    where = f"most at {si(needed.frequency, 'Hz')}" if needed.frequency > 0.0 else "from slow motion on"
    has = f"the device has {b:.4g} N s/m and needs {needed.damping:.4g} N s/m, {where}"
    if shunt is not None:
        where = f"at {si(shunt.frequency, 'Hz')}" if shunt.frequency > 0.0 else "in slow motion"
        why = "they are closest" if damped else "most is missing"
        has = (f"the device has {b:.4g} N s/m, to which the shunt of its motor adds {shunt.adds:.4g} N s/m, and needs "
               f"{shunt.needs:.4g} N s/m {where}, where {why}")
    if scene.device_m is None or scene.device_m.encoder is None:
        return f"{word}: {has}"
    if stepped is False and fc == 0.0:
        steps = "without Coulomb friction nothing takes up what the encoder's steps make"
    elif friction is None:
        steps = "what the law makes of an encoder's steps has no known bound"
    elif stepped is None:
        steps = (f"{friction:.4g} N of Coulomb friction would do for the encoder's steps, and less may; "
                 f"it has {fc:.4g} N")
    else:
        steps = f"for the encoder's steps it has {fc:.4g} N of Coulomb friction and needs {friction:.4g} N"
    return f"{word}: {has}; {steps}" if stepped or not damped else f"{word}: {steps}; {has}"  # what decides first


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
    try:
        rendered = controller(scene)
    except NotLinear as refused:
        velocity = scene.device_m and scene.device_m.velocity
        linear = "law, for example --set law=virtual_wall"
        if velocity is not None and not is_linear(velocity, T):
            linear = "one, --set 'velocity=backward_difference()'"
        raise Refused(f"{refused.why}; take a linear {linear}, or run it with teleop run and energy in the scene, "
                      "which sums what its port takes and gives") from None
    if (np.abs(np.linalg.eigvals(rendered.A)) > 1.0 + 1e-6).any():
        raise Refused("the controller grows by itself, whatever it is joined to, so no damping makes it passive; try a "
                      "simulated tool of more mass, or backward Euler, --set law.theta_f=1 --set law.theta_x=1")
    return sampled.of_state_space(rendered, T)


def _behind(scene: Scene, device: Any, T: float) -> Behind | None:
    offered = coupling_of(scene.law, T) if isinstance(device.velocity, BackwardDifference) else None
    if offered is None:
        return None
    C, E, delta = offered.C, offered.E, scene.master.damping
    gamma, lacks = coupling.least_real(C, T), coupling.lack_behind(offered, T)
    exact = device.every == 1 and offered.series  # the derivation's own conditions
    others = {name: coupled for name, law in offered.others.items() if (coupled := coupling_of(law, T)) is not None}
    return Behind(
        C=C, E=E, alpha=lacks, gamma=gamma, miller=coupling.alpha_miller(delta, gamma),
        most=coupling.alpha_max(delta, C, T, d=device.delay) if exact else None, conditions=exact,
        passive_needs=coupling.needed_damping(C, 0.0, T, d=device.delay).damping,
        alone=sampled.needed_damping(E, T, d=device.delay, every=device.every).damping,
        stiffness=coupling.stiffness(E, T), by={name: law.E for name, law in others.items()},
        integrators={name: coupling.lack_behind(law, T) for name, law in others.items()},
    )
