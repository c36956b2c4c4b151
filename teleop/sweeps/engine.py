"""The engine of a sweep: which of plain, c and vector runs its rows, and the kernel that an engine makes.

An engine is chosen once for a sweep (`choose`). A structure of scene that it has no kernel for falls back to the next
plainer, row by row the same bits: vector to c, c to plain.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from importlib import import_module
from threading import Lock
from typing import Any

from teleop.emit.types import NotPrinted
from teleop.errors import Refused, nearest
from teleop.law import functions_of
from teleop.scene.parts import varies
from teleop.scene.scene import Scene
from teleop.simulation.bodies import Bodies
from teleop.simulation.felt import MOST_RANKS, ranks
from teleop.simulation.plan import link_plans
from teleop.simulation.prepared import Prepared, prepare
from teleop.simulation.result import Result
from teleop.sweeps.kernels.figures import KEPT as KEPT_ALONG
from teleop.sweeps.kernels.figures import layout
from teleop.sweeps.kernels.functions import constants
from teleop.sweeps.kernels.kernel import (
    Kernel,
    Leaves,
    LinkSchedule,
    NotCompiled,
    RowInputs,
    figures,
    leaves,
    names_of,
    path_of,
    plain_kernel,
    tree_of,
)

Measure = str | Callable[["Result"], float]

PLAINER = {"vector": "c", "c": "plain"}
ENGINES = ("plain", "c", "vector")
WORTH = 2.0  # s of plain Python above which compiling is worth its time
LONG = 100.0  # s of plain Python above which rows side by side make up for what their kernel compiles longer
PLAIN = 4e-6  # s a tick, about
FEW = 16  # rows that are not worth putting side by side
STAMPED = frozenset(("E_fwd_min", "E_bwd_min"))  # a run with waves and energies alone has them
OF_PLAN = frozenset(("fresh_fwd", "fresh_bwd", "T_fwd_mean", "T_fwd_max", "T_bwd_mean", "T_bwd_max"))  # of its schedule
WHOLE = "a metric needs the whole record of a run"
KEPT = 64  # kernels

_KERNELS: dict[Any, Kernel] = {}
_MAKING = Lock()


def choose(engine: str | None, scene: Scene, rows: int, measures: Sequence[Measure]) -> tuple[str, str]:
    """The engine of a sweep of so many rows like `scene`, and why. Raises `Refused` for one that cannot be had."""
    if engine is not None:
        if engine == "scalar":
            raise Refused("engine scalar, which compiled a row at a time by numba, is gone: take --engine c, which "
                          "gives the same bits")
        if engine not in ENGINES:
            raise Refused(f"there is no engine {engine!r}; {nearest(engine, ENGINES)}")
        if engine != "plain":
            need_compiler(engine)
        return engine, "as asked for"
    if needs_record(measures, scene):
        return "plain", WHOLE
    seconds = PLAIN * scene.ticks * rows
    if seconds < WORTH:
        return "plain", f"about {seconds:.2g} s of plain Python, less than compiling takes"
    enough = f"about {seconds:.3g} s of plain Python"
    if not compiles():
        return "plain", "there is no C compiler; with gcc or clang installed this would be some 100 times faster"
    if rows >= FEW and seconds >= LONG:
        return "vector", f"{enough}, so it is compiled, for several rows side by side"
    return "c", f"{enough}, so it is compiled, for a row at a time"


def compiles() -> bool:
    """True if this machine has a C compiler, by which rows are compiled."""
    from teleop.emit.compiler import find_compiler

    return find_compiler() is not None


def need_compiler(engine: str) -> None:
    """Refuse a compiled engine where there is no C compiler."""
    if not compiles():
        raise Refused(f"engine {engine} needs a C compiler (cc, gcc or clang), and none is found; install one, or take "
                      "--engine plain")


def needs_record(measures: Sequence[Measure], scene: Scene) -> bool:
    """True if one of these metrics needs the whole record of a run, so that no kernel gives it."""
    recorded, stamped = _kinds(tuple(measures))
    if "jerk_999" in measures and ranks(scene.ticks) > MOST_RANKS:
        return True
    if scene.deadband is not None and (not OF_PLAN.isdisjoint(measures) or _delay_varies(scene)):
        return True  # which packets there are is known once it has run
    return recorded or (stamped and scene.energy and scene.has_waves)


def _delay_varies(scene: Scene) -> bool:
    return (scene.link is not None and varies(scene.link)) or any(scene.leaves_out(e) is not None for e in ("m", "s"))


@lru_cache(maxsize=256)
def _kinds(measures: tuple[Measure, ...]) -> tuple[bool, bool]:
    """True if a metric is none that a sweep works out as it goes; true if one is an energy compared with its stamp."""
    without_record = {*KEPT_ALONG, *OF_PLAN, *STAMPED, "swing_end"}
    return any(one not in without_record for one in measures), not STAMPED.isdisjoint(measures)


def kernel_of(prepared: Prepared, measures: tuple[str, ...], engine: str, stamp: object = None
              ) -> tuple[Kernel, Leaves | None]:
    """The kernel of a scene's structure by `engine`, or by the one that it falls back to; kept for the next rows.

    With it the row's numbers laid out flat, if it is compiled. `stamp`: what else tells it from others, see `Stamps`.
    """
    scene, bodies = prepared.scene, prepared.bodies
    flat, why = None, ""
    if engine != "plain":
        try:
            flat = leaves(tree_of(scene, bodies))
        except NotCompiled as reason:
            engine, why = "plain", str(reason)
    ends = scene.per_axis("device_m")[0], scene.per_axis("device_s")[0]
    velocities = [type(device.velocity) for device in ends if device is not None]
    # What the text depends on, and the functions that it names.
    key = (engine, why, measures, layout(measures, scene.ticks).ranks, prepared.structure, functions_of(scene.laws[0]),
           stamp, *velocities, flat and flat.shape, *bodies.functions().values())
    kernel = _KERNELS.get(key)
    if kernel is None:
        with _MAKING:
            kernel = _KERNELS.get(key) or _make_kernel(scene, bodies, measures, engine, why)
            while len(_KERNELS) >= KEPT:
                del _KERNELS[next(iter(_KERNELS))]
            _KERNELS[key] = kernel
    return kernel, None if kernel.engine == "plain" else flat


class Stamps:
    """The constants that kernels are compiled with as they are now; looked at once in the time of a chunk."""

    def __init__(self, engine: str) -> None:
        self._plain, self._constants = engine == "plain", dict[Any, object]()

    def of(self, prepared: Prepared) -> object:
        """Constants of a scene's kernel."""
        if self._plain:
            return None
        scene, bodies = prepared.scene, prepared.bodies
        key = type(scene.laws[0]), *bodies.functions().values()
        if key not in self._constants:
            self._constants[key] = tuple(constants([*names_of(scene, bodies).values()]))
        return self._constants[key]


def kernel_maker(engine: str) -> Callable[..., Kernel]:
    """The function that makes the kernels of a compiled engine from a scene, its bodies and the figures asked of it."""
    maker: Callable[..., Kernel] = getattr(import_module("teleop.sweeps.kernels.c_kernel"), f"{engine}_kernel")
    return maker


def _make_kernel(scene: Scene, bodies: Bodies, measures: tuple[str, ...], engine: str, why: str) -> Kernel:
    if engine == "plain":
        return plain_kernel(scene, bodies, measures)._replace(why=why)
    make = kernel_maker(engine)
    two = prepare(replace(scene, duration=min(scene.ticks, 2) * scene.dt))  # ticks, enough to have it compiled
    inputs = RowInputs(None, leaves(tree_of(two.scene, two.bodies)), two.scene.ticks,
                   LinkSchedule.of(link_plans(two.scene, 0)), path_of(two.scene, compiled=True))
    try:
        kernel: Kernel = make(scene, bodies, measures)
        figures(kernel, [inputs])
    except Exception as error:  # whatever stands in the way of compiling, there is another way to run the rows
        reason = str(error) if isinstance(error, NotCompiled | NotPrinted) else f"{type(error).__name__}: {error}"
        return _make_kernel(scene, bodies, measures, PLAINER[engine], reason)
    return kernel._replace(why=why, fallback=lambda reason: _make_kernel(
        scene, bodies, measures, PLAINER[engine], reason))
