"""Result of one end's part of a run: the columns of its record, and how late its ticks were."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from teleop.scene.scene import Scene
from teleop.simulation.ending import Ending
from teleop.simulation.plan import Packets
from teleop.simulation.prepared import prepare
from teleop.simulation.result import Result
from teleop.simulation.trace import Columns, EndRecord, end_columns, far_apart, seconds

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

UNRELEASED = "unreleased"  # the status of a run whose device did not take zero force
NAMES = {"m": "master", "s": "slave"}
UNSENSED = {
    "m": "the device has no force sensor, so there is no f_h",
    "s": "the device has no force sensor, so there is no f_env, nor a force error, which compares f_m with it",
}
WAYS = {"m": ("fwd", "bwd"), "s": ("bwd", "fwd")}  # the direction an end sends in, and the other


def end_result(
    scene: Scene, e: str, record: EndRecord, late: Any, ending: Ending, *, seed: int, mode: str, facts: dict[str, Any],
    packets: dict[str, Packets], first: int, every: int,
) -> Result:
    """Make the result of one end's part of a run: its columns, and the figures that they are enough for.

    `first`: the first tick that was due; `every`: and then every so many.
    """
    trace = Columns({"t": lambda: seconds(record.ticks, scene.dt_ns), **end_columns(prepare(scene), e, record).makers,
                     f"late_{e}": lambda: _scaled(late, 1e9)})
    if record.force == "unknown":
        ending = ending._replace(notes=(*ending.notes, UNSENSED[e]))
    of_end = {
        "status": ending.status, "sentence": ending.sentence, "ticks": len(record.ticks), **facts,
        "late_us": spread_us(lateness(record.ticks, late, scene.dt_ns, first, every)),
    }
    return Result.make(scene, ending, seed=seed, mode=mode, ticks=len(record.ticks), run_time=None, trace=trace,
                       packets=packets, extra={"end": NAMES[e], NAMES[e]: of_end})


def lateness(ticks: Any, late: Any, dt_ns: int, first: int = 0, every: int = 1) -> NDArray[np.float64]:
    """Lateness (ns) of each tick that was due, including those that were skipped for a late one.

    `late` is that of the ticks that ran, each against its own instant; the skipped ones before it were due
    that much and one tick more, two ticks more, ... before. Nothing is told where too many were (`far_apart`).

    >>> lateness([0, 3], [5.0, 7.0], 100).tolist()
    [5.0, 7.0, 107.0, 207.0]
    """
    import numpy as np

    late_ns = np.asarray(late, dtype=float)
    if far_apart(ticks, first):
        return late_ns[:0]
    due = np.asarray(np.diff(np.asarray(ticks, dtype=np.int64), prepend=first - every), dtype=np.int64)
    due //= every
    if (due == 1).all():
        return late_ns
    ends = np.add.accumulate(np.maximum(due, 0, out=due))
    out = np.repeat(late_ns, due)
    for i in np.flatnonzero(due > 1):
        out[ends[i] - due[i] : ends[i]] += np.arange(due[i]) * (every * dt_ns)
    return out


def spread_us(late: Any) -> dict[str, float]:
    """Median, 99th percentile and most (us) of latenesses in ns; nothing of none."""
    import numpy as np

    late_us = _scaled(late, 1e3)
    return {f"p{q}": float(np.percentile(late_us, q, overwrite_input=True)) for q in (50, 99, 100)} \
        if len(late_us) else {}


def _scaled(column: Any, divisor: float) -> NDArray[np.float64]:
    import numpy as np

    out: NDArray[np.float64] = np.array(column, dtype=float)
    out /= divisor
    return out
