"""The verdict on a one-port: passive, not passive or not known, with encoder, friction, shunt, cap and controller.

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

from math import isfinite
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.analysis.models import sampled
from teleop.analysis.models.peak import highest
from teleop.errors import Refused
from teleop.law.analysis_offers import coupling_of
from teleop.stages.device import Device
from teleop.terminal.table import si

if TYPE_CHECKING:
    from teleop.analysis.models.sampled import Impedance, Needed
    from teleop.scene.scene import Scene


class Shunt(NamedTuple):
    """What the shunt of the motor adds where the damping that there is and the damping needed are closest."""

    adds: float  # N s/m
    needs: float  # N s/m, of all the damping there
    frequency: float  # Hz, of that place; 0: from slow motion on


class Verdict(NamedTuple):
    """Whether a one-port is passive, and why."""

    passive: bool | None  # None: not known
    sentence: str
    left_out: tuple[str, ...]  # the parts with which it is not known
    asked: float | None  # N of Coulomb friction, enough for the encoder; None: there is none, or no bound is known
    spring: bool  # is a spring alone what is rendered
    shunt: Shunt | None  # None: there is none, it is not called on, or not known


def verdict(scene: Scene, E: Impedance, needed: Needed) -> Verdict:
    """Judge a scene without a slave, given its linear controller E(z) and the damping that it needs."""
    T, device = scene.dt_ns / 1e9, scene.device_m or Device()
    spring, asked = is_spring(E, T) and coupling_of(scene.law, T) is None, _asked(scene)
    (damped, shunt), stepped = _damped(scene, E, needed, device), _stepped(scene, device, asked, spring)
    passive = None if stepped is None else damped is True and stepped
    if not damped:
        passive = False
    left = _unknown(scene, device, E, spring=spring, damped=damped, stepped=stepped)
    said = _sentence(scene, needed, passive, damped, stepped, asked, shunt)
    if left:
        them = "it" if len(left) == 1 and not left[0].endswith("s") else "them"
        said = f"not known with its {' and '.join(left)}; without {them} {said}"
        return Verdict(None, said, left, asked, spring, shunt)
    return Verdict(passive, said, (), asked, spring, shunt)


def is_spring(E: Impedance, T: float) -> bool:
    """True if the force is the stiffness times the reading and nothing else."""
    import numpy as np

    z = np.exp(1j * np.array([1e-2, 0.1, 1.0, 2.0, 3.0]))
    H = np.asarray(E(z)) * (1.0 - 1.0 / z) / T
    return bool((np.abs(H - H[0].real) <= 1e-9 * np.abs(H[0])).all())


def _asked(scene: Scene) -> float | None:
    """(D/2)(K |h_K|_1 + B |h_B|_1)."""
    from teleop.analysis.models.gains import check
    from teleop.analysis.models.law_parts import law_parts, norms

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
    import numpy as np

    from teleop.analysis.models.law_parts import effective_damping

    T, d = scene.dt_ns / 1e9, device.delay
    share = highest(lambda th: sampled.damping_curve(E, T, th, d=d) / effective_damping(scene, th), d + 1)
    has, at = float(effective_damping(scene, np.array([share.th]))[0]), sampled.frequency(share, T)
    return share.value <= 1.0 + 1e-9, Shunt(has - b if at > 0.0 else 0.0, share.value * has, at)


def _stepped(scene: Scene, device: Device, asked: float | None, spring: bool) -> bool | None:
    """True if there is friction enough for the encoder; None: not known."""
    fc = scene.master.friction
    if device.encoder is None or asked == 0.0:
        return True
    if fc == 0.0:
        return False
    if asked is None:
        return None
    if asked <= fc * (1.0 + 1e-9):
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
              asked: float | None, shunt: Shunt | None) -> str:
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
    elif asked is None:
        steps = "what the law makes of an encoder's steps has no known bound"
    elif stepped is None:
        steps = f"{asked:.4g} N of Coulomb friction would do for the encoder's steps, and less may; it has {fc:.4g} N"
    else:
        steps = f"for the encoder's steps it has {fc:.4g} N of Coulomb friction and needs {asked:.4g} N"
    return f"{word}: {has}; {steps}" if stepped or not damped else f"{word}: {steps}; {has}"  # what decides first
