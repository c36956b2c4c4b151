"""A linear teleoperator as a two-port: its hybrid matrix over frequency, from the hand's port to the environment's.

    [ f_h  ]   [h11  h12] [ v_m   ]
    [ -v_s ] = [h21  h22] [ f_env ]

B. Hannaford, "A design framework for teleoperators with kinesthetic feedback", IEEE Trans. Robotics and Automation
5(4), 1989, with f_h the force of the hand on the master and f_env that of the slave on the environment, so that f_h v_m
and f_env (-v_s) are the powers into the two ports: h11 is the impedance of free motion, h12 and -h21 the force and
velocity that are passed on, both 1 at best, 1/h22 what a clamped master feels like from outside. Both devices' masses
and dampings are in it, the hand and the environment are not.

Llewellyn's criterion (F. B. Llewellyn, "Some fundamental properties of transmission systems", Proc. IRE 40(3), 1952):
no passive pair of terminations makes the two-port swing up iff at every frequency

    Re h11 >= 0,   Re h22 >= 0,   eta = -cos(arg h12 h21) + 2 Re h11 Re h22/|h12 h21| >= 1,

and h11 and h22 have no poles in the right half-plane, and on the axis simple ones with positive residues. The poles are
not looked at here: a loop inside the teleoperator that grows by itself (`teleop stability` sees it) is the condition's
failure, whatever eta says. `raisbeck` is the stricter question: is the two-port itself passive.

In continuous time a law is taken to its limit for short ticks, with the delays e^(-s T_fwd), e^(-s T_bwd). Sampled, it
is as the scene runs it: readings at the ticks (the left limit, so a force sensor feels the force held before), whole
ticks of delay, held forces. A held force answers a sinusoid of frequency w with one of w and with images at w + 2 pi
l/dt. The matrix is that of the component at w, where holding multiplies by (1 - e^-jwT)/(jwT), and is exact as such,
for the slave's own motion under the held force is sampled exactly. What a hand or an environment makes of the images is
not in it, so the sampled criterion is one for slow terminations, and no bound near half the rate.
"""

from __future__ import annotations

from dataclasses import replace
from math import pi
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from teleop.analysis.models.continuous import law_limit, refuse_ticks
from teleop.analysis.models.linear import Matrix, like, matrix
from teleop.analysis.models.peak import Points, Reals
from teleop.analysis.passivity.surroundings import delays, linear_parts, ticks
from teleop.errors import Refused
from teleop.law import At, law_name, start_at
from teleop.law.analysis_offers import linear_hint
from teleop.physics.plant import MassDamper, linear
from teleop.scene.scene import Scene
from teleop.stages.observer import coefficients

READINGS = 5  # of an end: x, v, f, f_held, dx


class Readings(NamedTuple):
    """Readings of an end as they follow from force and motion at the port, over frequency."""

    held: Points  # the force held before, over the force now
    moved: Points  # dx over x
    sense: Points  # what the law is told of the hand's force, over what a sensor would feel
    sensed: Points  # that, over v_m
    through: Points  # that, over f_m


class Driven(NamedTuple):
    """The slave's samples over the force held on it."""

    x: Points
    v: Points


def assembled(s: Points, ends: Any, delay: Any, r: Readings, driven: Driven, *, bare: Points, hold: Points,
              velocity: Any, inertia: Points, acts: Any = (1.0, 1.0)) -> Points:
    """h (n, 2, 2) from the equations of both ends: (force, tx) = law (readings, rx), rx the other's tx, delayed.

    s (n,): i w. ends: the laws by `law_transfer`. delay: of a message forth and back, as factors. bare: the slave's
    velocity over force. hold: what holding makes of a force. velocity: of each end, what the law is told of it over it,
    None for the truth. inertia: f_h over v_m of the master alone. acts: of each end, the delay of its force, a factor.
    """
    n, (master, slave) = len(s), ends
    out, home = master.shape[1] - 1, slave.shape[1] - 1  # fields forth, fields back
    size = 2 + out + home  # unknown: f_m, f_s as they act, the messages sent forth, those sent back
    f_m, f_s, forth, back = 0, 1, slice(2, 2 + out), slice(2 + out, size)
    at_m, at_s = np.zeros((2, n, READINGS, size + 2), dtype=np.complex128)  # of the unknowns, then of v_m and f_env
    v_m, f_env = size, size + 1
    at_m[:, 0, v_m], at_m[:, 1, v_m] = 1.0 / s, 1.0 if velocity[0] is None else velocity[0]
    at_m[:, 2, v_m], at_m[:, 2, f_m] = r.sense * r.sensed, r.sense * r.through
    at_m[:, 3, f_m], at_m[:, 4] = r.held, r.moved[:, None] * at_m[:, 0]
    at_s[:, 0, f_s], at_s[:, 0, f_env] = driven.x, -bare / s
    at_s[:, 1, f_s], at_s[:, 1, f_env] = driven.v, -bare
    if velocity[1] is not None:  # made of positions
        at_s[:, 1] = (velocity[1] * s)[:, None] * at_s[:, 0]
    at_s[:, 2, f_env], at_s[:, 3, f_s], at_s[:, 4] = 1.0, r.held, r.moved[:, None] * at_s[:, 0]
    both = np.zeros((n, size, size + 2), dtype=np.complex128)
    for law, at, rx, lag, force, sent, act in ((master, at_m, back, delay[1], f_m, forth, acts[0]),
                                               (slave, at_s, forth, delay[0], f_s, back, acts[1])):
        answer = law[:, :, :READINGS] @ at
        answer[:, :, rx] += law[:, :, READINGS:] * lag[:, None, None]
        answer[:, 0] *= np.broadcast_to(act, n)[:, None]
        both[:, force], both[:, sent] = answer[:, 0], answer[:, 1:]
    unknown = np.linalg.solve(np.eye(size) - both[:, :, :size], both[:, :, size:])
    h = np.empty((n, 2, 2), dtype=np.complex128)
    h[:, 0] = hold[:, None] * unknown[:, f_m]
    h[:, 0, 0] += inertia
    h[:, 1] = -(bare * hold)[:, None] * unknown[:, f_s]
    h[:, 1, 1] += bare
    return h


def law_transfer(law: Matrix, states: int, p: Points) -> Points:
    """(force and message) over (readings, rx) at p = z or s, (n, 1 + fields, READINGS + fields in)."""
    shown = law[states:, states:] + np.zeros((len(p), 1, 1))
    if not states:
        return shown.astype(np.complex128)
    inner: Any = np.linalg.solve(p[:, None, None] * np.eye(states) - law[:states, :states], law[:states, states:] + 0j)
    response: Points = shown + law[states:, :states] @ inner
    return response


NAMES = {"m": "master", "s": "slave"}


class TwoPort(NamedTuple):
    """A hybrid matrix over frequency."""

    frequency: Reals  # (n,), Hz
    h: Points  # (n, 2, 2): N s/m, 1; 1, m/(N s)

    @property
    def eta(self) -> Reals:
        """Llewellyn's parameter (n,); inf where nothing is passed on one way."""
        h = self.h
        product = h[:, 0, 1] * h[:, 1, 0]
        size = np.abs(product)
        with np.errstate(divide="ignore", invalid="ignore"):
            eta: Reals = np.where(size > 0.0, (2.0 * h[:, 0, 0].real * h[:, 1, 1].real - product.real) / size, np.inf)
        return eta

    @property
    def absolutely_stable(self) -> NDArray[np.bool_]:
        """True at each frequency where Llewellyn's criterion holds, to 1e-9: lossless ends meet it with equality."""
        h = self.h
        passive: NDArray[np.bool_] = (
            (h[:, 0, 0].real >= -_rounding(h[:, 0, 0])) & (h[:, 1, 1].real >= -_rounding(h[:, 1, 1]))
            & (self.eta >= 1.0 - 1e-9)
        )
        return passive

    @property
    def raisbeck(self) -> Reals:
        """(n,) at least 0 where the two-port is passive: 4 Re h11 Re h22 - |h12 + conj h21|^2 (and Re h11 >= 0).

        That is four times the determinant of the Hermitian part of h (G. Raisbeck, "A definition of passive linear
        networks in terms of time and energy", J. Applied Physics 25(12), 1954).
        """
        h = self.h
        margin: Reals = 4.0 * h[:, 0, 0].real * h[:, 1, 1].real - np.abs(h[:, 0, 1] + h[:, 1, 0].conj()) ** 2
        return margin

    def perceived_impedance(self, touched: Points) -> Points:
        """The impedance that the hand feels (N s/m) of an environment `touched` (N s/m, n or a number)."""
        h = self.h
        impedance: Points = h[:, 0, 0] - h[:, 0, 1] * h[:, 1, 0] * touched / (1.0 + h[:, 1, 1] * touched)
        return impedance


def _rounding(values: Points) -> Reals:
    rounding: Reals = 1e-9 * np.abs(values)
    return rounding


def continuous_two_port(scene: Scene, frequency: Reals) -> TwoPort:
    """The hybrid matrix in continuous time at frequencies (Hz, above 0), of the scene's first axis.

    Without a link there is no delay. Refused if the law is not linear or has no continuous limit.
    """
    body = _need_slave(scene)
    scene, _ = linear_parts(scene)
    refuse_ticks(replace(scene, environment=None, electrical=None))
    s: Any = 2j * pi * np.asarray(frequency, dtype=float)
    ends = []
    for e in ("m", "s"):
        law, states, inputs = law_limit(scene, e)
        wide = np.zeros((len(law), states + READINGS + inputs))
        wide[:, :states + 3], wide[:, states + READINGS:] = law[:, :states + 3], law[:, states + 3:]
        ends.append(law_transfer(wide, states, s))
    forth, back = delays(scene)
    still, one = 0.0 * s, np.ones_like(s)
    sense = one if scene.observer is None else scene.observer / (s + scene.observer)
    inertia = _mechanical(scene, s)
    reading = Readings(held=still, moved=still, sense=sense, sensed=inertia, through=one)
    bare = 1.0 / (body.mass * s + body.damping)
    driven = Driven(x=bare / s, v=bare)
    return TwoPort(np.asarray(frequency, dtype=float), assembled(
        s, ends, (np.exp(-s * forth), np.exp(-s * back)), reading, driven, bare=bare, hold=one, velocity=(None, None),
        inertia=inertia))


def sampled_two_port(scene: Scene, frequency: Reals, *, seed: int = 0) -> TwoPort:
    """The hybrid matrix of the scene as it runs, at frequencies (Hz) between 0 and half the rate, of its first axis.

    Refused if the law is not linear, the link not a constant delay or a force renewed more slowly than the tick.
    """
    body = _need_slave(scene)
    scene, _ = linear_parts(scene)
    dt = scene.dt_ns / 1e9
    s: Any = 2j * pi * np.asarray(frequency, dtype=float)
    z = np.exp(s * dt)
    late = 1.0 / z
    forth, back = ticks(scene, seed)
    ends = [law_transfer(*_law_matrix(scene, e, dt, delay * dt), z) for e, delay in (("m", back), ("s", forth))]
    inertia = _mechanical(scene, s)
    velocity = [_estimated(device, z, dt, s) for device in (scene.device_m, scene.device_s)]
    sense, sensed = np.ones_like(s), inertia
    if scene.observer is not None:
        c = coefficients(scene.observer, scene.master.mass, scene.master.damping, dt)
        sense, sensed = c.rate / (1.0 - (1.0 - c.rate) * late), c.gain * (1.0 - c.e * late)
        sensed = sensed if velocity[0] is None else sensed * velocity[0]
    reading = Readings(held=late, moved=1.0 - late, sense=sense, sensed=sensed, through=late)
    step = linear(body.mass, body.damping, 0.0, dt)
    v = step.b2 / (z - step.a22)
    driven = Driven(x=(step.a12 * v + step.b1) / (z - 1.0), v=v)
    acts = [np.ones_like(s) if device is None else late**device.delay for device in (scene.device_m, scene.device_s)]
    bare = 1.0 / (body.mass * s + body.damping)
    return TwoPort(np.asarray(frequency, dtype=float), assembled(
        s, ends, (late**forth, late**back), reading, driven, bare=bare, hold=(1.0 - late) / (s * dt),
        velocity=velocity, inertia=inertia, acts=acts))


def _law_matrix(scene: Scene, e: str, dt: float, age: float) -> tuple[Matrix, int]:
    """Compute one end of the law in one axis: (state, x, v, f, f_held, dx, rx) to (state', force, message)."""
    law: Any = scene.law
    name = NAMES[e]
    end, start, sums = getattr(law, name), getattr(law, f"{name}_start"), getattr(law, f"{name}_sums", None)
    sample, message = start(start_at(0.0, 0.0, 0.0, dt))
    states = len(sample)

    def respond(numbers: Any) -> list[float]:
        take = iter(numbers)
        s = like(sample, take)
        x, v, f, f_held, dx = (next(take) for _ in range(READINGS))
        at = At(x, v, f, f_held, dx, True, age, dt, dt)
        rx = like(message, take)
        f, tx, after = end(s, at, rx, *((sums(s, at, rx),) if sums else ()))
        return [*after, f, *tx]

    response = matrix(respond, states + READINGS + len(message))
    if response is None:
        hint = linear_hint(law, "write ")
        raise Refused(f"law {law_name(law)} is not linear at the {name}, so it has no hybrid matrix; {hint}"
                      f"{', or ' * bool(hint)}run it with teleop run and energy in the scene, which sums what its "
                      "ports take and give")
    return response, states


def _estimated(device: Any, z: Points, dt: float, s: Points) -> Points | None:
    """The velocity that the law is given, over the velocity; None if that is it."""
    if device is None or device.velocity is None:
        return None
    estimator = device.velocity
    c, start = estimator.coefficients(dt), estimator.start(0.0)

    def respond(numbers: Any) -> list[float]:
        v, after = estimator.step(c, tuple(numbers[:-1]), numbers[-1], dt)
        return [*after, v]

    response = matrix(respond, len(start) + 1)
    if response is None:
        raise Refused(f"the velocity estimator {type(estimator).__name__} is not linear, so the scene has no hybrid "
                      "matrix; take BackwardDifference or LowPass")
    made: Points = law_transfer(response, len(start), z)[:, 0, 0] / s
    return made


def _mechanical(scene: Scene, s: Points) -> Points:
    """f_h over v_m of the master alone: its mass, damping and the shunt of its motor."""
    impedance: NDArray[np.complex128] = scene.master.mass * s + scene.master.damping
    if scene.electrical is not None:
        impedance = impedance + scene.electrical.b * s / (s + 2.0 * pi * scene.electrical.cutoff)
    return impedance


def _need_slave(scene: Scene) -> MassDamper:
    if scene.slave is None:
        raise Refused("a scene without a slave has one port, and no hybrid matrix; give it slave=MassDamper(mass=0.5)")
    for name in ("scaling", "frame"):
        if getattr(scene, name) is not None:
            raise Refused(f"the hybrid matrix of a scene with {name} is not known here; leave {name} out, which "
                          "changes the passivity of no port")
    slave: MassDamper = scene.slave
    return slave
