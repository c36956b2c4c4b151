"""Figures of a run, each with its SI unit, worked out from its trace."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import TYPE_CHECKING, Any

from teleop.scene import Scene

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

UNITS = {
    "x_err_rms": "m", "x_err_max": "m", "f_err_rms": "N", "f_err_max": "N", "f_m_max": "N", "f_s_max": "N",
    "f_h_max": "N", "f_env_max": "N", "T_fwd_mean": "s", "T_fwd_max": "s", "T_bwd_mean": "s", "T_bwd_max": "s",
    "fresh_fwd": "1", "fresh_bwd": "1", "E_link_min": "J", "E_link_end": "J", "E_port_min": "J",
    "E_port_end": "J", "E_fwd_min": "J", "E_bwd_min": "J", "g_m_min": "1", "g_s_min": "1",
}
MEANING = {
    "x_err_rms": "tracking: slave against the master as it was one forward delay ago",
    "f_err_rms": "force felt against the force touched one backward delay ago",
    "T_fwd_mean": "age of a forward message when it was first played",
    "fresh_fwd": "share of the slave's ticks with a fresh message",
    "E_link_min": "smallest energy stored in the link",
    "E_fwd_min": "forward: sender's stamped energy less what was received, smallest",
    "g_m_min": "smallest gain the master's watchdog came to",
}


TINY = 1e-300


def metrics(scene: Scene, trace: dict[str, Any]) -> dict[str, float]:
    """Those of `worked_out` that are finite."""
    return finite(worked_out(scene, trace))


def finite(every: dict[str, float]) -> dict[str, float]:
    """Those that are finite."""
    return {name: value for name, value in every.items() if isfinite(value)}


def worked_out(scene: Scene, trace: dict[str, Any]) -> dict[str, float]:
    """Every figure of `UNITS` that the scene has, by name; of one end's trace, those that it is enough for.

    Tracking error is `|x_s(k) - x_m(k - d)|` with d the median age, in ticks, at which forward messages were
    played; force error is `|f_m(k) - f_env(k - d)|` with that of the backward ones. Without a link d is 1.
    """
    if not len(trace["t"]):
        return {}
    dt = scene.dt_ns / 1e9
    out: dict[str, float] = {}
    for way, seq in (("fwd", "seq_s"), ("bwd", "seq_m")):
        age = _ages(trace, seq, dt)
        if age is not None:
            out |= _delays(way, age, len(trace["t"]))
    if "x_m" in trace and "x_s" in trace:
        for name, size in tracking(scene, trace).items():
            out |= _worst(name, size)
    forces = [name for name in ("f_m", "f_s", "f_h", "f_env") if name in trace]
    out |= {f"{name}_max": float(magnitude(trace[name]).max()) for name in forces}
    for ledger in ("E_link", "E_port"):
        if ledger in trace:
            out |= {f"{ledger}_min": float(trace[ledger].min()), f"{ledger}_end": float(trace[ledger][-1])}
    for way, e in (("fwd", "s"), ("bwd", "m")):
        if {f"E_in_{way}", f"E_out_{way}", f"seq_{e}"} <= trace.keys():
            out[f"E_{way}_min"] = _stamped(trace, way, e, dt)
    out |= {f"{g}_min": float(trace[g].min()) for g in ("g_m", "g_s") if g in trace}
    return out


def of_plan(way: str, play: Sequence[int], dt: float) -> dict[str, float]:
    """What a run has of one direction ("fwd" or "bwd") by itself: `play` are the packets played at its ticks, or -1."""
    import numpy as np

    played = np.asarray(play)
    fresh = np.flatnonzero(played >= 0)
    return _delays(way, (fresh - played[fresh]) * dt, len(played))


def _delays(way: str, age: NDArray[np.float64], ticks: int) -> dict[str, float]:
    out = {f"fresh_{way}": len(age) / ticks}
    return {**out, f"T_{way}_mean": float(age.mean()), f"T_{way}_max": float(age.max())} if len(age) else out


def tracking(scene: Scene, trace: dict[str, Any]) -> dict[str, NDArray[np.float64]]:
    """Tracking error `x_err` (m) and force error `f_err` (N) at every tick, as `metrics` defines them.

    NaN at the ticks before the other end's value of one delay ago exists.
    """
    dt = scene.dt_ns / 1e9
    ticks = _ticks(trace, dt)
    forth, back = (_lag(_ages(trace, seq, dt), dt) for seq in ("seq_s", "seq_m"))
    return {"x_err": _behind(trace["x_s"], trace["x_m"], ticks, forth),
            "f_err": _behind(trace["f_m"], trace["f_env"], ticks, back)}


def _ticks(trace: dict[str, Any], dt: float) -> NDArray[np.int64]:
    import numpy as np

    ticks: NDArray[np.int64] = np.rint(trace["t"] / dt).astype(np.int64)
    return ticks


def _ages(trace: dict[str, Any], seq: str, dt: float) -> NDArray[np.float64] | None:
    """Ages (s) of the fresh messages when they were played; None without a link."""
    if seq not in trace:
        return None
    fresh = trace[seq] >= 0
    age: NDArray[np.float64] = (_ticks(trace, dt)[fresh] - trace[seq][fresh]) * dt
    return age


def _lag(age: NDArray[np.float64] | None, dt: float) -> int:
    """The median age in whole ticks, a half rounded up; 1 without a link."""
    import numpy as np

    if age is None:
        return 1
    return int(np.floor(np.sort(age)[len(age) // 2] / dt + 0.5)) if len(age) else 0


def magnitude(column: NDArray[Any]) -> NDArray[Any]:
    """Magnitude over the axes, without squares that overflow where the magnitude does not."""
    import numpy as np

    with np.errstate(all="ignore"):  # the last rows of a run that diverged
        size: NDArray[Any] = np.abs(column)
        if column.ndim == 1:
            return size
        # As `teleop.batch.measures.magnitude3` has it, in the same order: a sweep gives the same bits.
        top = np.maximum(size.max(axis=1), TINY)
        parts = (column / top[:, None]).T
        total = parts[0] * parts[0]
        for part in parts[1:]:
            total = total + part * part
        return np.asarray(top * np.sqrt(total))


def _behind(mine: NDArray[Any], theirs: NDArray[Any], ticks: NDArray[np.int64], lag: int) -> NDArray[np.float64]:
    """Magnitude of `mine(k) - theirs(k - lag)`; NaN before the first tick at which both exist."""
    import numpy as np

    at = np.searchsorted(ticks, ticks - lag, side="right") - 1
    size = np.full(len(ticks), np.nan)
    has = at >= 0
    with np.errstate(all="ignore"):
        size[has] = magnitude(mine[has] - theirs[at[has]])
    return size


def _worst(name: str, size: NDArray[np.float64]) -> dict[str, float]:
    """RMS and maximum, from the first tick on at which there is an error to speak of."""
    import numpy as np

    has = np.flatnonzero(~np.isnan(size))
    if not len(has):
        return {}
    size = size[has[0]:]
    with np.errstate(all="ignore"):
        # summed in the order of the ticks, as a sweep does as it goes
        return {f"{name}_rms": float(np.sqrt(np.add.accumulate(size * size)[-1] / len(size))),
                f"{name}_max": float(size.max())}


def _stamped(trace: dict[str, Any], way: str, e: str, dt: float) -> float:
    """Smallest of (energy the sender had put in when it sent) - (energy taken out when it was played)."""
    import numpy as np

    played = trace[f"seq_{e}"]
    ticks = _ticks(trace, dt)
    row = np.searchsorted(ticks, played)
    ok = (played >= 0) & (row < len(ticks))
    ok[ok] = ticks[row[ok]] == played[ok]
    if not ok.any():
        return 0.0
    with np.errstate(all="ignore"):
        return float((trace[f"E_in_{way}"][row[ok]] - trace[f"E_out_{way}"][ok]).min())
