"""The same linear scene without a clock: law, observer and plants in continuous time, the delay e^(-sT).

The plants are those of `teleop.physics.plant` before they are stepped. The law is taken to its own limit for a tick
that goes to zero: its outputs as they are, its state as the derivative (s' - s)/dt, both found from three short ticks
and extrapolated (L. F. Richardson, "The deferred approach to the limit", Phil. Trans. R. Soc. A 226, 1927). A law that
keeps samples in its state, or names the tick before (`f_held`, `dx`), has no such limit and is refused. The observer
becomes `f_h_hat' = L (f_h - f_h_hat)`.
"""

from __future__ import annotations

from collections.abc import Iterator
from heapq import merge
from itertools import count, islice
from math import nan, pi
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np

from teleop.analysis.models import linear
from teleop.analysis.models.by_axis import alike
from teleop.analysis.models.linear import Matrix
from teleop.analysis.models.loop import Crossing, Loop, imaginary_axis, open_poles
from teleop.errors import Refused
from teleop.law import At, law_name, reads, start_at
from teleop.scene.scene import Scene
from teleop.simulation.bodies import exact_bodies
from teleop.simulation.structure import structure_of

NOISE = 1e-8  # of |l_j|, which knows the law's limit no better
SLOWEST = 1e-4  # rad/s: what is slower stays where it is
SHORT = 1e-6  # s, a tick so short that the law is nearly at its limit
MOST_PASSAGES = 100_000


class Continuous(NamedTuple):
    """The delay margin in continuous time."""

    stable_without_delay: bool
    round_trip: float | None  # s, above which the loop is unstable for the first time; None: at no delay
    frequency: float | None  # Hz, at which it then swings


def continuous(scene: Scene) -> Continuous:
    """The shortest round trip at which a linear scene becomes unstable in continuous time.

    Where |l_j(iw)| = 1 a root passes the imaginary axis at `T = (arg l_j - 2 pi k)/w`; the first of these after
    which there is one on the right is the margin (the direct method: K. Walton and J. E. Marshall, "Direct method for
    TDS stability analysis", IEE Proc. D 134(2), 1987). Of several axes the worst. Raises `Refused` if the scene is
    not linear or has no continuous limit.
    """
    scene = linear.about_rest(linear.with_linear_law(scene))
    linear.refuse_nonlinear_parts(scene)
    margins = [_margin(single) for single, _ in alike(scene)]
    return min(margins, key=lambda m: (m.stable_without_delay, m.round_trip is None, m.round_trip or 0.0))


def refuse_ticks(scene: Scene) -> None:
    """Refuse what is made of ticks, or has more states than the ends here are built with."""
    if scene.slave is None:
        raise Refused("a scene without a slave has no link whose delay could be asked for; ask without --continuous")
    structure = structure_of(scene)
    if scene.device_m is not None or scene.device_s is not None:
        raise Refused("a device's estimator and delays are counted in ticks, which continuous time has not; ask "
                      "without --continuous, or leave device_m and device_s out")
    if structure.m.has.inner or structure.s.has.inner:
        raise Refused("a body with a state of its own (electrical damping, a standard linear solid) is not known in "
                      "continuous time here; ask without --continuous")
    for name in ("scaling", "frame"):
        if getattr(scene, name) is not None:
            raise Refused(f"{name} between master and slave is not known in continuous time here; ask without "
                          f"--continuous, or leave {name} out")


def _margin(scene: Scene) -> Continuous:
    master, slave = continuous_ends(scene)
    fastest = float(np.abs(open_poles(master, slave)).max(initial=1.0))
    loop = Loop(master=master, slave=slave, curve=imaginary_axis(SLOWEST, 1e4 * fastest), noise=NOISE)
    if loop.samples[2][-1].real.max() > -1e-9:
        raise Refused("the loop passes fast motion at full strength, so in continuous time no delay is short enough; "
                      "ask without --continuous")
    right = loop.outside(0.0)
    if right:
        return Continuous(False, 0.0, None)
    # Roots pass to the right at exits and to the left at entries; exits are quicker, so they win in the end.
    events = merge(*(_events(c) for c in loop.crossings(0.0) if c.t > 1.0), key=itemgetter(0))
    for delay, crossing in islice(events, MOST_PASSAGES):
        right -= 2 * crossing.into
        if right > 0:
            return Continuous(True, delay, crossing.at.imag / (2.0 * pi))
    return Continuous(True, None, None)


def _events(crossing: Crossing) -> Iterator[tuple[float, Crossing]]:
    """The delays above 0 at which a root passes the axis here, in order."""
    phase = crossing.log.imag % (2.0 * pi)
    for turn in count(0 if phase > 0.0 else 1):
        yield (phase + 2.0 * pi * turn) / crossing.at.imag, crossing


def continuous_ends(scene: Scene) -> tuple[linear.StateSpace, linear.StateSpace]:
    """Both ends of a scene of one axis as `X' = A X + B rx`, `tx = C X + D rx`."""
    refuse_ticks(scene)
    assert scene.slave is not None  # refused above
    body, hand = scene.master, scene.hand
    mass, k, d = (hand.mass, hand.k, hand.d) if hand is not None else (0.0, 0.0, 0.0)
    master = _end(scene, "m", mass=body.mass + mass, damping=body.damping + d, k=k, push=-1.0,
                  sensor=(-k, -d, mass / (body.mass + mass)),
                  bandwidth=scene.observer if structure_of(scene).m.has_stage("observer") else None)
    _, force, c, *_ = exact_bodies(scene).slaves[0]
    rest = force(c, 0.0, 0.0)
    k_e, d_e = force(c, 1.0, 0.0) - rest, force(c, 0.0, 1.0) - rest
    slave = _end(scene, "s", mass=scene.slave.mass, damping=scene.slave.damping + d_e, k=k_e, push=1.0,
                 sensor=(k_e, d_e, 0.0), bandwidth=None)
    return master, slave


def _end(scene: Scene, e: str, *, mass: float, damping: float, k: float, push: float,
         sensor: tuple[float, float, float], bandwidth: float | None) -> linear.StateSpace:
    """`mass x'' + damping x' + k x = push f`, read by a sensor `f = k' x + d' v - m' (mass a)` and held by the law."""
    law, states, inputs = law_limit(scene, e)
    n = 2 + (bandwidth is not None) + states

    def respond(point: Any) -> list[float]:
        x, v = point[0], point[1]
        state, rx = point[n - states:n], point[n:]
        spring, damper, inertia = sensor
        still = spring * x + damper * v + inertia * (damping * v + k * x)  # the sensor's reading without the force
        through = -inertia * push
        touch = point[2] if bandwidth is not None else 0.0
        answer = law @ np.array([*state, x, v, touch, *rx])
        f = answer[states]
        if bandwidth is None:  # the sensor reads the force that its reading makes
            loop = law[states, states + 2] * through
            if abs(loop) >= 1.0:
                raise Refused("the force that the law makes of a force reading exceeds it, which no tick is short "
                              "enough for; ask without --continuous")
            f = (f + law[states, states + 2] * still) / (1.0 - loop)
            answer = answer + law[:, states + 2] * (still + through * f)
        a = (push * f - damping * v - k * x) / mass
        seen = [] if bandwidth is None else [bandwidth * (still + through * f - touch)]
        return [v, a, *seen, *answer[:states], *answer[states + 1:]]

    response = np.array([respond(row) for row in np.eye(n + inputs)]).T
    return linear.StateSpace(response[:n, :n], response[:n, n:], response[n:, :n], response[n:, n:])


def law_limit(scene: Scene, e: str) -> tuple[Matrix, int, int]:
    """Compute one end of the law for a tick of zero: from (state, x, v, f, message) to (state', force, message).

    Of its state that which something depends on: what is read after ticks that were left out alone has no part in it.
    """
    law: Any = scene.law
    name = {"m": "master", "s": "slave"}[e]
    end, start, sums = getattr(law, name), getattr(law, f"{name}_start"), getattr(law, f"{name}_sums", None)
    tied = {"f_held", "dx", "age"} & (reads(end) | reads(sums or len))
    if tied:
        raise Refused(f"law {law_name(law)} reads {' and '.join(sorted(tied))}, which have no meaning without a tick; "
                      "ask without --continuous")
    sample, message = start(start_at(0.0, 0.0, 0.0, 1e-3))
    states, inputs = len(sample), len(message)

    def short(dt: float) -> Matrix:
        def respond(numbers: Any) -> list[float]:
            take = iter(numbers)
            s = linear.like(sample, take)
            at = At(next(take), next(take), next(take), nan, nan, True, nan, dt, dt)
            rx = linear.like(message, take)
            over = (sums(s, at, rx),) if sums else ()
            f, tx, after = end(s, at, rx, *over)
            return [*after, f, *tx]

        response = linear.matrix(respond, states + 3 + inputs)
        if response is None:
            raise linear.not_linear(scene, e)
        unread = [i for i in range(states) if not response[:, i].any()]
        response = np.delete(np.delete(response, unread, axis=0), unread, axis=1)
        remaining = states - len(unread)
        response[:remaining] = (response[:remaining] - np.eye(remaining, response.shape[1])) / dt
        return response

    one, half, quarter = short(SHORT), short(SHORT / 2.0), short(SHORT / 4.0)
    if (np.abs(quarter) > 1.5 * np.abs(half) + 1e-6 * (1.0 + np.abs(half).max())).any():
        raise Refused(f"law {law_name(law)} has no limit for short ticks, since it keeps samples or divides by dt; "
                      "ask without --continuous")
    twice = [2.0 * half - one, 2.0 * quarter - half]
    return (4.0 * twice[1] - twice[0]) / 3.0, one.shape[1] - 3 - inputs, inputs


