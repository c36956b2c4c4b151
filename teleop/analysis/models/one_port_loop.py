"""A scene without a slave as one loop: the device under a sampled one-port law, exactly, tick by tick.

What a tick does is not written again here: it is `teleop.analysis.models.linear.end_function`, the lines of the tick
made into a function of the state, with velocity estimator, computation delay and all. The map is taken about a place
`DEPTH` inside what the law renders, where a law that has modes (a wall touches or does not) is in contact; it must be
affine near there. A force that is renewed every n-th tick makes the loop periodic: its stability is that of the product
of n ticks (Floquet).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import exp, log
from typing import Any, NamedTuple

import numpy as np

from teleop.analysis.models import margins as of_two
from teleop.analysis.models.linear import (
    LinearScene,
    Matrix,
    StateSpace,
    begin,
    end_function,
    is_linear,
    not_linear,
    refuse_nonlinear_parts,
    with_linear_law,
)
from teleop.analysis.models.loop import sampled_loop
from teleop.analysis.models.margins import critical_round_trip
from teleop.analysis.models.peak import Points
from teleop.analysis.models.roots import Mode, dominant
from teleop.errors import Refused
from teleop.law import law_name
from teleop.scene.scene import Scene
from teleop.simulation.structure import structure_of
from teleop.stages.device import Device
from teleop.stages.force_cap import Cap

DEPTH = 1.0  # m
SIZES = [0.25**i for i in range(1, 16)]  # of the neighbourhoods in which the map may be affine
SETTLING = 8  # ticks
MOST_STATES = 400  # of a dense matrix
MOST_DELAY = 64  # ticks of computation that a margin is looked for up to, where the loop cannot be cut open
FEW = 32  # ticks of delay that a dense matrix takes in its stride
AT_REST = 1e-6  # from z = 1: a position that nothing returns, which is not held against the scene


class OnePort(NamedTuple):
    """The closed loop over one period of `every` ticks, and its margins."""

    ticks: list[Matrix]  # the state's map over each tick of the period
    dt: float  # s
    delay: int  # ticks of computation that are in it

    @property
    def period(self) -> Matrix:
        """The map over the whole period."""
        whole = self.ticks[0]
        for tick in self.ticks[1:]:
            whole = tick @ whole
        return whole

    def roots(self) -> Points:
        """The loop's eigenvalues, per period."""
        return np.asarray(np.linalg.eigvals(self.period), dtype=np.complex128)


def one_port(scene: Scene) -> OnePort:
    """The loop of a scene without a slave, in one axis. Refused if it is not linear in contact."""
    scene = one_axis(with_linear_law(scene))
    refuse_nonlinear_parts(scene)
    estimator = scene.device_m and scene.device_m.velocity
    if estimator is not None and not is_linear(estimator, scene.dt_ns / 1e9):
        raise not_linear(scene, "m")  # near rest it may look so
    every = 1 if scene.device_m is None else scene.device_m.every
    delay = 0 if scene.device_m is None else scene.device_m.delay
    return OnePort(_ticks(scene, every), scene.dt_ns / 1e9, delay)


def controller(scene: Scene) -> StateSpace:
    """The sampled controller alone, from the reading x(k) (m) to the force f_m(k) (N) held from that tick on.

    Law and device stages in contact. Refused if the force is renewed more slowly than the tick, or depends on a
    velocity that no estimator makes of the positions.
    """
    loop = one_port(scene)
    if len(loop.ticks) > 1:
        raise Refused(f"the force is renewed every {len(loop.ticks)} ticks, so the controller is not time-invariant; "
                      "set every=1 and a longer tick")
    tick = loop.ticks[0]
    plant = [0, 1, *range(3, 3 + _inner_states(scene))]
    law = [i for i in range(len(tick)) if i not in plant]
    if np.abs(tick[np.ix_(law, plant[1:])]).max(initial=0.0) > 0.0:
        raise Refused(f"law {law_name(scene.law)} reads the velocity itself, which no device has; name an estimator, "
                      "for example device_m=Device(velocity=BackwardDifference())")
    force = tick[2]
    return StateSpace(tick[np.ix_(law, law)], tick[np.ix_(law, [0])], force[law][None, :], force[[0]][None, :])


def one_axis(scene: Scene) -> Scene:
    """Its first axis: the others are the same loop."""
    if scene.axes == 1:
        return scene
    start = scene.vector("start_m", scene.start_m)[0]
    return replace(scene, axes=1, names=(), units=scene.axis_units[:1], start_m=start)


def cut_open(scene: Scene) -> LinearScene | None:
    """The loop cut open at the force: device and controller as two ends, the computation's delay between them.

    Kept as a number beside the matrices the delay costs nothing, whatever its length. None where the loop is not of
    that form: a force renewed more slowly than the tick, or a law that reads what acts on its device (a force sensor,
    an observer, the force that was held), which is the late one.
    """
    scene = one_axis(with_linear_law(scene))
    device = scene.device_m or Device()
    if device.every > 1:
        return None
    prompt = replace(scene, device_m=replace(device, delay=0))
    tick, dead = one_port(prompt).ticks[0], _ticks(replace(prompt, cap=Cap(f_max=0.0)), 1)[0]
    inner = _inner_states(prompt)
    body = [0, 1, *range(3, 3 + inner)]
    states = [i for i in range(len(tick)) if i not in (2, *body)]
    if tick[np.ix_([2, *states], [2, *body[2:]])].any():
        return None
    force = tick[2]
    strongest = int(np.abs(force).argmax())
    push = (tick - dead)[body, strongest] / force[strongest] if force.any() else np.zeros(len(body))
    read = np.eye(2, len(body))  # position and velocity
    plant = StateSpace(dead[np.ix_(body, body)], push[:, None], read, np.zeros((2, 1)))
    law = StateSpace(tick[np.ix_(states, states)], tick[np.ix_(states, [0, 1])], force[states][None, :],
                     force[[0, 1]][None, :])
    return LinearScene(plant, law, device.delay, 0, scene.dt_ns / 1e9)


def _inner_states(scene: Scene) -> int:
    """States of the device beside position, velocity and held force."""
    if not structure_of(scene).m.has.inner:
        return 0
    return len(begin(scene, "m")) - len(begin(replace(scene, electrical=None), "m"))


class Margins(NamedTuple):
    """Roots and margins of a one-port loop."""

    unstable: int  # roots outside the unit circle
    integrators: int
    mode: Mode | None
    gain_margin: float | None  # the factor on the force that changes the verdict
    critical_delay: int | None  # ticks of computation, the least at which it is unstable; None: at none up to `tried`
    tried: int | None  # ticks; None: at any


def margins(scene: Scene) -> Margins:
    """Roots and margins of a scene without a slave."""
    linear = cut_open(scene)
    margin = gain_and_mode(scene, linear)
    if linear is None:
        return margin._replace(critical_delay=_critical_delay(scene), tried=MOST_DELAY)
    return margin._replace(critical_delay=critical_round_trip(linear, 0))


def gain_and_mode(scene: Scene, linear: LinearScene | None) -> Margins:
    """The same but for the delay; `linear` is the scene `cut_open`."""
    if linear is None or linear.forth == 0:
        whole = one_port(scene)
        gain = _gain_margin(scene) if linear is None else of_two.gain_margin(linear)
        return Margins(unstable_roots(whole), *_dominant(whole), gain, None, None)
    unstable, resting = sampled_loop(linear).outside(linear.round_trip), of_two.integrators(linear)
    return Margins(unstable, resting, dominant(linear, resting), of_two.gain_margin(linear), None, None)


def settles(scene: Scene) -> bool:
    """True if no root lies outside the unit circle; quicker than `margins`."""
    delay = 0 if scene.device_m is None else scene.device_m.delay
    if delay > FEW:
        linear = cut_open(scene)
        if linear is not None:
            return not sampled_loop(linear).outside(linear.round_trip)
    return not unstable_roots(one_port(scene))


def unstable_roots(loop: OnePort) -> int:
    """Eigenvalues outside the unit circle, those at rest at z = 1 aside."""
    roots = loop.roots()
    return int(np.count_nonzero((np.abs(roots) > 1.0 + 1e-12) & (np.abs(roots - 1.0) > AT_REST)))


def _dominant(loop: OnePort) -> tuple[int, Mode | None]:
    """Roots at rest, and the greatest of the others as a motion."""
    roots = loop.roots()
    moving = roots[np.abs(roots - 1.0) > AT_REST]
    greatest = complex(moving[np.argmax(np.abs(moving))]) if moving.size else 0j
    period = loop.dt * len(loop.ticks)
    return len(roots) - len(moving), Mode.of(greatest, period) if abs(greatest) > 1e-6 else None


def _gain_margin(scene: Scene) -> float | None:
    """The factor on the force, nearest to 1, that changes the verdict; None if none from 1e-6 to 1e6 does.

    A tick's map is affine in that factor: it is known from the map as it is and that of a force held at zero.
    """
    whole = one_port(scene)
    dead = _ticks(replace(one_axis(with_linear_law(scene)), cap=Cap(f_max=0.0)), len(whole.ticks))
    unstable = unstable_roots(whole) > 0

    def changed(step: float) -> bool:
        ticks = [off + exp(step) * (on - off) for on, off in zip(whole.ticks, dead, strict=True)]
        return (unstable_roots(whole._replace(ticks=ticks)) > 0) != unstable

    brackets = []
    for way in (1.0, -1.0):
        steps = [way * i * log(1e6) / 64 for i in range(65)]
        first = next((i for i, step in enumerate(steps) if i and changed(step)), None)
        if first is not None:
            low, high = steps[first - 1], steps[first]
            for _ in range(40):
                middle = 0.5 * (low + high)
                low, high = (low, middle) if changed(middle) else (middle, high)
            brackets.append(high)
    return exp(min(brackets, key=abs)) if brackets else None


def _critical_delay(scene: Scene) -> int | None:
    """The least whole number of ticks of computation at which the loop is unstable; None if none up to `MOST_DELAY`."""
    for ticks in range(MOST_DELAY + 1):
        device = replace(scene.device_m or Device(), delay=ticks)
        if unstable_roots(one_port(replace(scene, device_m=device))):
            return ticks
    return None


def _ticks(scene: Scene, every: int) -> list[Matrix]:
    """The maps of the ticks of one period: the first, which renews the force, and the others."""
    base = begin(scene, "m", getattr(scene.law, "at", 0.0) + DEPTH)
    if len(base) > MOST_STATES:
        raise Refused(f"the loop has {len(base)} states, more than the {MOST_STATES} of a dense matrix; lower the "
                      "device's delay, or renew the force at every tick")
    for _ in range(SETTLING):
        kinds = [near(_state_after(scene, k), base) for k in range(min(every, 2))]
        maps = [kind for kind in kinds if kind is not None]
        if len(maps) == len(kinds):
            return [maps[min(k, 1)] for k in range(every)]
        # A simulated tool starts on the surface, where no map is affine: the device waits until it has moved on.
        base = [*base[:2], *_state_after(scene, 0)(base)[2:]]
    raise not_linear(scene, "m")


def _state_after(scene: Scene, k: int) -> Callable[[Any], list[float]]:
    step = end_function(scene, "m", k)
    return lambda numbers: step(numbers)[0]


def near(function: Callable[[Any], Sequence[float]], base: Sequence[float]) -> Matrix | None:
    """The Jacobian about `base` of a function that is affine near there, or None.

    Read off at steps to both sides in the largest neighbourhood of `SIZES` in which it is affine, which it must be at
    32 points there to 1e-9 of the terms that meet.
    """
    n = len(base)
    middle = np.array(base, dtype=float)

    def at(point: Any) -> Matrix:
        return np.array(function((middle + point).tolist()), dtype=float)

    dice = np.random.Generator(np.random.Philox(key=1))  # the same points each time
    points = dice.uniform(-1.0, 1.0, (32, n))
    zero = at(np.zeros(n))
    for size in SIZES:
        jacobian = np.array([(at(size * row) - at(-size * row)) / (2.0 * size) for row in np.eye(n)]).T
        met = np.abs(jacobian) @ np.full(n, size) + np.abs(zero) + np.abs(jacobian) @ np.abs(middle)
        if np.isfinite(jacobian).all() and all(
                (np.abs(at(size * p) - zero - jacobian @ (size * p)) <= 1e-9 * size * met + 1e-12 * met).all()
                for p in points):
            return jacobian
    return None
