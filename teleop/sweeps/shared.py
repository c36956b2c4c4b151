"""What rows of sweeps have in common and is made once in a process: the schedules of links and the paths of hands."""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock
from typing import Any

from teleop.errors import Refused
from teleop.scene.scene import Scene
from teleop.simulation.bodies import reference_samples
from teleop.simulation.plan import link_plans
from teleop.sweeps.kernels.kernel import LinkSchedule

TICKS = 4_000_000  # of schedules and paths, about: 64 MB

_HELD: dict[Any, tuple[Any, int]] = {}  # what was made, and for how many ticks
_KEEPING = Lock()


class Schedules:
    """The link of some rows: what a seed makes of it, drawn when it is asked for."""

    __slots__ = ("_key", "_scene", "_seed")

    def __init__(self, key: Any, scene: Scene, seed: int) -> None:
        self._key, self._scene, self._seed = key, scene, seed

    @property
    def dt(self) -> float:
        """The tick, s."""
        return self._scene.dt_ns / 1e9

    def schedule(self) -> LinkSchedule:
        """The packets played at each tick. Raises `Refused` where the link does."""
        return _once(self._key, self._scene.ticks, lambda: LinkSchedule.of(link_plans(self._scene, self._seed)))  # type: ignore[no-any-return]


def schedules_key(scene: Scene, seed: int) -> Any:
    """What tells the schedules of a row from those of others."""
    left_out = scene.left_out_m, scene.left_out_s
    if scene.link is None and left_out == (None, None) and scene.deadband is None:
        return "no link", scene.ticks, scene.dt_ns
    key = scene.link, scene.played_as, seed, scene.ticks, scene.dt_ns, scene.wire_size, left_out, (
        scene.slave is None, scene.deadband is None)
    try:
        hash(key)
    except TypeError:  # a link of the user's own that has no hash
        return id(scene.link), key[2:6], object()
    return key


def path_of(scene: Scene, *, compiled: bool) -> Any:
    """The hand's path, as lists for plain Python and as arrays for compiled code."""
    if scene.reference is None:
        return () if compiled else None

    def make() -> Any:
        import numpy as np

        path = reference_samples(scene) or ()
        if len(path) != scene.axes or any(len(axis) <= scene.ticks for axis in path):
            raise Refused(f"the hand's path has not the {scene.ticks + 1} samples for each of {scene.axes} axes that "
                          "it was asked for; see its samples(axes, count, dt_ns)")
        return tuple([np.ascontiguousarray(axis, dtype=np.float64) for axis in path]) if compiled else path

    return _once(("path", scene.reference, scene.axes, scene.ticks, scene.dt_ns, compiled), scene.ticks, make)


def _once(key: Any, ticks: int, make: Callable[[], Any]) -> Any:
    """What `make` gives, kept for the next rows; the oldest is dropped. A key that cannot be kept is made anew."""
    try:
        if (held := _HELD.get(key)) is not None:
            return held[0]
    except TypeError:  # a link or a path of the user's own that has no hash
        return make()
    made = make()
    with _KEEPING:
        _HELD[key] = made, ticks
        total = sum(each for _, each in _HELD.values()) if len(_HELD) * ticks > TICKS else 0
        while total > TICKS and len(_HELD) > 1:
            total -= _HELD.pop(next(iter(_HELD)))[1]
    return made
