"""What rows of sweeps have in common and is made once in a process: kernels, schedules, the paths of hands."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pickle import UnpicklingError
from threading import Lock
from typing import Any

from teleop.errors import Refused
from teleop.law import functions_of
from teleop.scene.scene import Scene
from teleop.simulation.bodies import Bodies, exact_bodies, reference_samples
from teleop.simulation.plan import link_plans
from teleop.simulation.structure import structure_of
from teleop.sweeps.kernels.kernel import Inputs, Kernel, NotCompiled, Water, figures, plain, tree_of
from teleop.sweeps.kernels.leaves import Leaves, leaves

KEPT = 64  # kernels
TICKS = 4_000_000  # of schedules and paths, about: 64 MB
PLAINER = {"vector": "scalar", "scalar": "plain"}

_HELD: dict[Any, tuple[Any, int]] = {}  # what was made, and for how many ticks
_KERNELS: dict[Any, Kernel] = {}
_MAKING, _KEEPING = Lock(), Lock()


class Schedules:
    """The link of some rows: what a seed makes of it, drawn when it is asked for."""

    __slots__ = ("_key", "_scene", "_seed")

    def __init__(self, key: Any, scene: Scene, seed: int) -> None:
        self._key, self._scene, self._seed = key, scene, seed

    @property
    def dt(self) -> float:
        """The tick, s."""
        return self._scene.dt_ns / 1e9

    def water(self) -> Water:
        """The packets played at each tick. Raises `Refused` where the link does."""
        return _once(self._key, self._scene.ticks, lambda: Water.of(link_plans(self._scene, self._seed)))  # type: ignore[no-any-return]


def schedules_key(scene: Scene, seed: int) -> Any:
    """What tells the schedules of a row from those of others."""
    if scene.link is None:
        return "no link", scene.ticks, scene.dt_ns
    key = scene.link, scene.playout, seed, scene.ticks, scene.dt_ns, scene.wire_size
    try:
        hash(key)
    except TypeError:  # a link of the user's own that has no hash
        return id(scene.link), key[1:], object()
    return key


def path_of(scene: Scene, *, compiled: bool) -> Any:
    """The hand's path, as lists for plain Python and as arrays for compiled code."""
    if scene.hand is None:
        return () if compiled else None

    def make() -> Any:
        import numpy as np

        path = reference_samples(scene) or ()
        if len(path) != scene.axes or any(len(axis) <= scene.ticks for axis in path):
            raise Refused(f"the hand's path has not the {scene.ticks + 1} samples for each of {scene.axes} axes that "
                          "it was asked for; see its samples(axes, count, dt_ns)")
        return tuple([np.ascontiguousarray(axis, dtype=np.float64) for axis in path]) if compiled else path

    return _once(("path", scene.hand.reference, scene.axes, scene.ticks, scene.dt_ns, compiled), scene.ticks, make)


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


def kernel_of(scene: Scene, bodies: Bodies, measures: tuple[str, ...], engine: str, stamp: object = None
              ) -> tuple[Kernel, Leaves | None]:
    """The kernel of a scene's structure, by `engine`, or by a plainer one where it is not made for that.

    With it the row's numbers laid out flat, if it is compiled. `stamp`: what else tells it from others.
    """
    flat, why = None, ""
    if engine != "plain":
        try:
            flat = leaves(tree_of(scene, bodies))
        except NotCompiled as reason:
            engine, why = "plain", str(reason)
    velocities = [type(device.velocity) for device in (scene.device_m, scene.device_s) if device is not None]
    # What the text depends on, and the functions that it names.
    key = (engine, why, measures, structure_of(scene), functions_of(scene.law), stamp, *velocities,
           flat and flat.shape, *bodies.functions().values())
    kernel = _KERNELS.get(key)
    if kernel is None:
        with _MAKING:
            kernel = _KERNELS.get(key) or _made(scene, bodies, measures, engine, why)
            while len(_KERNELS) >= KEPT:
                del _KERNELS[next(iter(_KERNELS))]
            _KERNELS[key] = kernel
    return kernel, None if kernel.engine == "plain" else flat


def _made(scene: Scene, bodies: Bodies, measures: tuple[str, ...], engine: str, why: str) -> Kernel:
    if engine == "plain":
        return plain(scene, bodies, measures)._replace(why=why)
    from importlib import import_module

    from teleop.sweeps.kernels.compiled import cause

    make = getattr(import_module(f"teleop.sweeps.kernels.{engine}"), engine)
    two = replace(scene, duration=min(scene.ticks, 2) * scene.dt)  # ticks, enough to have it compiled
    given = Inputs(None, leaves(tree_of(two, exact_bodies(two))), two.ticks, Water.of(link_plans(two, 0)),
                   path_of(two, compiled=True))
    try:
        try:
            kernel: Kernel = make(scene, bodies, measures)
            figures(kernel, [given])
        except (OSError, EOFError, UnpicklingError, UnicodeDecodeError):  # the cache is full, or damaged
            kernel = make(scene, bodies, measures, keep=False)
            figures(kernel, [given])
    except Exception as error:  # whatever stands in the way of compiling, there is another way to run the rows
        return _made(scene, bodies, measures, PLAINER[engine], cause(error))
    return kernel._replace(why=why, plainer=lambda reason: _made(scene, bodies, measures, PLAINER[engine], reason))
