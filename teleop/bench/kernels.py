"""Kernels made ready to be timed: what the sweep engine runs, without the rows around it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

from teleop.scene.scene import Scene
from teleop.simulation.bodies import exact_bodies, reference_samples
from teleop.simulation.plan import link_plans
from teleop.sweeps.kernels.kernel import Inputs, LinkSchedule, tree_of
from teleop.sweeps.kernels.leaves import leaves

MEASURES = ("x_err_rms", "x_err_max")


def kernel_of(engine: str, scenes: Sequence[Scene], seeds: Sequence[int]) -> Callable[[], Any]:
    """A call that runs these rows by the kernel of the first scene's structure; scenes of one link share a schedule."""
    import numpy as np

    schedules: dict[Any, LinkSchedule] = {}
    paths: dict[Any, Any] = {}
    rows = []
    for scene, seed in zip(scenes, seeds, strict=True):
        schedule = schedules.setdefault((scene.link, seed), LinkSchedule.of(link_plans(scene, seed)))
        reference = scene.hand and scene.hand.reference
        path = paths.setdefault(reference, tuple([np.asarray(axis) for axis in reference_samples(scene) or ()]))
        rows.append(Inputs(None, leaves(tree_of(scene, exact_bodies(scene))), scene.ticks, schedule, path))
    make = getattr(import_module(f"teleop.sweeps.kernels.{engine}"), engine)
    kernel = make(scenes[0], exact_bodies(scenes[0]), MEASURES)
    lags = [row.schedule.lags for row in rows]
    return lambda: kernel.run(rows, lags)
