"""From the rows that the two ends left to the arrays of a trace."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.scene import Scene
from teleop.tick import columns

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


AHEAD = 1_000_000  # ticks without a row that a record may have, 17 min at 1 kHz ...
AHEAD_EACH = 100  # ... and so many more for each row, for what is worked out at every tick in between
UNKNOWN = ("its rows lie so far apart that the forces that were not recorded, and how late ticks were, are not worked "
           "out in between")

Reference = tuple[list[float], ...] | None  # the hand's, per axis at the ticks 0 .. n


class EndRecord(NamedTuple):
    """What one end wrote down: the ticks it ran, its rows as flat floats, the packets it played."""

    ticks: Sequence[int]
    rows: Sequence[float]
    played: Sequence[int] | None  # the packet played at each of these ticks, or -1; None without a link


def end_arrays(
    scene: Scene, e: str, record: EndRecord, reference: Reference = None
) -> dict[str, NDArray[Any]]:
    """One end's columns as arrays of shape (rows,), or (rows, axes) where there are several axes.

    `reference` are the hand's samples at the ticks, if the caller has them already.
    """
    import numpy as np

    names = columns(scene, e)
    widths = [scene.axes if "@" in name else 1 for name in names]
    table: NDArray[np.float64] = np.array(record.rows, dtype=float).reshape(-1, sum(widths))
    out: dict[str, NDArray[Any]] = {}
    at = 0
    for name, width in zip(names, widths, strict=True):
        block = table[:, at : at + width]
        out[name.removesuffix("@")] = np.ascontiguousarray(block[:, 0] if width == 1 else block)
        at += width
    if record.played is not None:
        out[f"seq_{e}"] = np.array(record.played, dtype=np.int64)
    until, unknown = _until(scene, record.ticks), np.full_like(out[f"x_{e}"], np.nan)
    if e == "m" and "f_h" not in out:
        out["f_h"] = unknown if until is None else _hand_force(until, record.ticks, out, reference)
    if e == "s" and "f_env" not in out:
        out["f_env"] = unknown if until is None else _touch(until, out)
    return out


def far_apart(ticks: Sequence[int], first: int = 0) -> bool:
    """Do these ticks, of which `first` was the first that was due, leave out too many to look at each of those?"""
    return len(ticks) > 0 and ticks[-1] - first >= AHEAD + AHEAD_EACH * len(ticks)


def _until(scene: Scene, ticks: Sequence[int]) -> Scene | None:
    """The scene as far as these ticks go; None if that is too far for as few as they are."""
    if far_apart(ticks):
        return None
    last = ticks[-1] if len(ticks) else 0
    return scene if last >= scene.ticks - 1 else replace(scene, duration=(last + 1) * scene.dt_ns / 1e9)


def assemble(
    scene: Scene, records: dict[str, EndRecord], reference: Reference = None
) -> dict[str, NDArray[Any]]:
    """The trace of a run: `t`, then each end's columns, at the ticks that both ends ran."""
    import numpy as np

    ends = {e: end_arrays(scene, e, record, reference) for e, record in records.items()}
    ticks_m, ticks_s = (np.asarray(records[e].ticks, dtype=np.int64) for e in ("m", "s" if "s" in ends else "m"))
    if not np.array_equal(ticks_m, ticks_s):
        both, at_m, at_s = np.intersect1d(ticks_m, ticks_s, assume_unique=True, return_indices=True)
        ends = {
            e: {name: column[at] for name, column in ends[e].items()} for e, at in (("m", at_m), ("s", at_s))
        }
        ticks_m = both
    trace: dict[str, NDArray[Any]] = {"t": ticks_m * scene.dt_ns / 1e9, **ends["m"], **ends.get("s", {})}
    if scene.energy:
        _add_ledgers(trace)
    return trace


def _add_ledgers(trace: dict[str, NDArray[Any]]) -> None:
    """E_link and E_port from each end's own sums, so that both ways of running add in the same order."""
    import numpy as np

    with np.errstate(all="ignore"):  # a run that diverges ends with sums that are infinite
        if "E_in_fwd" in trace:
            trace["E_link"] = (trace["E_in_fwd"] - trace["E_out_fwd"]) + (trace["E_in_bwd"] - trace["E_out_bwd"])
        trace["E_port"] = trace["E_port_m"] - trace["E_port_s"] if "E_port_s" in trace else trace["E_port_m"].copy()


def _per_axis(column: NDArray[Any]) -> list[list[float]]:
    return [column.tolist()] if column.ndim == 1 else column.T.tolist()


def _back_together(axes: list[list[float]]) -> NDArray[Any]:
    import numpy as np

    return np.array(axes[0]) if len(axes) == 1 else np.array(axes).T.copy()


def _hand_force(
    scene: Scene, ticks: Sequence[int], out: dict[str, NDArray[Any]], reference: Reference
) -> NDArray[Any]:
    """f_h of a master without a force sensor, worked out after the run from what it recorded."""
    import numpy as np

    from teleop.bodies import master_plant, reference_samples

    reference = reference or reference_samples(scene)
    if reference is None:
        return np.zeros_like(out["x_m"])
    from teleop.plant import grip_force

    c, dt = master_plant(scene), scene.dt_ns / 1e9
    forces = []
    for x, v, f, r in zip(*(_per_axis(out[name]) for name in ("x_m", "v_m", "f_m")), reference, strict=True):
        held = [0.0, *f[:-1]]
        forces.append([
            grip_force(c, x[i], v[i], held[i], r[k], (r[k] - r[k - 1]) / dt if k else 0.0) for i, k in enumerate(ticks)
        ])
    return _back_together(forces)


def _touch(scene: Scene, out: dict[str, NDArray[Any]]) -> NDArray[Any]:
    """f_env of a slave whose law reads no force, worked out after the run."""
    from teleop.bodies import slave_plants

    return _back_together([
        [plant.force(plant.c, a, b) for a, b in zip(x, v, strict=True)]
        for plant, x, v in zip(slave_plants(scene), _per_axis(out["x_s"]), _per_axis(out["v_s"]), strict=True)
    ])
