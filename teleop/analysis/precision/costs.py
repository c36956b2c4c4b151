"""The cost of a contender: the time to move the bodies by one tick, from states of a run, and that of a whole run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from teleop.physics.plant import move_free, move_gripped
from teleop.simulation.bodies import Bodies, reference_samples
from teleop.simulation.integrators.parts import is_carried, whole_plants

if TYPE_CHECKING:
    from teleop.analysis.precision.contenders.contenders import Contender
    from teleop.scene.scene import Scene

Clock = Callable[[], int]
Move = Callable[..., tuple[Any, ...]]


def step_costs(some: Sequence[Contender], scene: Scene, trace: Mapping[str, Any], clock: Clock, samples: int,
               rounds: int) -> dict[str, float]:
    """Nanoseconds to move all bodies by one tick from states of the run, by contender: the least of some rounds.

    An inner state, if there is one, is the one after the sampled tick before.
    """
    ran = len(trace["t"])
    at = range(0, ran, max(1, ran // samples))
    reference = reference_samples(scene)
    slaves, masters = ([list(zip(*(column(trace, f"{name}_{e}", i)[at].tolist() for name in "xvf"), strict=True))
                        for i in range(scene.axes)] for e in "sm")
    if reference is not None:
        masters = [[(*state, r[k], r[k + 1]) for k, state in zip(at, own, strict=True)]
                   for r, own in zip(reference, masters, strict=True)]
    elif some[0].bodies.inner_m:
        masters = [[(*state, 0.0, 0.0) for state in own] for own in masters]
    carried = [is_carried(plant) for plant in whole_plants(scene)]
    jobs: dict[str, list[tuple[Move, Any, list[tuple[Any, ...]]]]] = {}
    for c in some:
        own = c.bodies
        move = _master(own, held=reference is not None)
        inner = own.inner_m or (None,) * scene.axes
        jobs[c.key] = [_job(move, held, states, at, z)
                       for held, states, z in zip(own.master, masters, inner, strict=True)]
        jobs[c.key] += [_job(plant.move, plant.c, states, at, plant.start, ticks=ticks)
                        for plant, states, ticks in zip(own.slaves, slaves, carried, strict=True)]
    times: dict[str, list[float]] = {key: [] for key in jobs}
    for _ in range(rounds):
        for key, job in jobs.items():
            began = clock()
            for move, held, states in job:
                for state in states:
                    move(held, *state)
            times[key].append((clock() - began) / len(at))
    return {key: min(several) for key, several in times.items()}


def run_costs(everyone: Sequence[Contender], scene: Scene, trace: Mapping[str, Any], clock: Clock, each: float
              ) -> dict[str, float]:
    """Seconds that a run of each contender will take: `each` of the first one, and more where its steps take more."""
    step: dict[str, float] = {}
    for c in everyone:
        step |= step_costs([c], scene, trace, clock, 10 if c.rtol else 50, 2)
    first = step[everyone[0].key]
    return {key: each + max(0.0, ns - first) * 1e-9 * scene.ticks for key, ns in step.items()}


def column(trace: Mapping[str, Any], name: str, axis: int) -> Any:
    """One axis of a column of the trace."""
    values = trace[name]
    return values if values.ndim == 1 else values[:, axis]


def _master(bodies: Bodies, *, held: bool) -> Move:
    """The function that moves the master."""
    if bodies.inner_m:
        move: Move = bodies.instead["move_held"]
        return move
    name, exact = ("move_gripped", move_gripped) if held else ("move_free", move_free)
    return bodies.instead.get(name, exact)  # type: ignore[no-any-return]


def _job(move: Move, c: Any, states: list[tuple[Any, ...]], at: range, z: Any, *, ticks: bool = False
         ) -> tuple[Move, Any, list[tuple[Any, ...]]]:
    """The function to time, its coefficients, and the states, each followed by the inner state if there is one.

    The inner state of an environment that moves begins with the tick.
    """
    if z is None:
        return move, c, states
    whole = []
    for k, state in zip(at, states, strict=True):
        z = (k, *z[1:]) if ticks else z
        whole.append((*state, z))
        z = move(c, *state, z)[-1]
    return move, c, whole
