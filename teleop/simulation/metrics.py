"""Figures of a run, each with its SI unit, worked out from its trace."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Mapping, Sequence
from itertools import count, takewhile
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from teleop.scene.scene import Scene
from teleop.simulation.felt import AT_REST, END, SUMS, TINY, figures, frame_of, resting, sums_of, turns_of
from teleop.simulation.rest import Still
from teleop.simulation.trace import blocks
from teleop.stages.slave_units import scales, transpose, turn

TWO_ENDS, LINK, WATCHDOG = "a slave", "a link", "a watchdog"  # that a run has
ROTATION = "a rotation"
STANDS, DEADBAND = "a hand that comes to stand", "a deadband"
FREE = "a slave that is moved before it touches anything"
FELT = FREE + ", and a force that is felt then"
PRESSES = "a hand that comes to stand, and a slave that keeps touching something with a place"
SWINGS = "a limit cycle, or one that grows"
PLAYED = "a link and a law of waves, played by their integral or energy"
PORTS, WAVES, STAMPS = "energy=True", "energy=True and a law of waves", "energy=True, a law of waves and a link"
STORED = "energy=True and a law that says what energy it keeps"


class Metric(NamedTuple):
    """A figure of a run: its unit, its meaning, and what a run must have for it; empty: every run has it."""

    unit: str
    meaning: str
    needs: str = ""


METRICS = {
    "x_err_rms": Metric("m", "tracking error: slave against the master as it was one forward delay ago, on a rotation "
                        "by its coordinates phi, rms", TWO_ENDS),
    "x_err_max": Metric("m", "its largest value", TWO_ENDS),
    "angle_err_rms": Metric("rad", "angle between the orientations of the slave and of the master as it was one "
                            "forward delay ago, of several rotations the greatest, rms", ROTATION),
    "angle_err_max": Metric("rad", "its largest value", ROTATION),
    "f_err_rms": Metric("N", "force error: felt against touched one backward delay ago, rms", TWO_ENDS),
    "f_err_max": Metric("N", "its largest value", TWO_ENDS),
    "f_m_max": Metric("N", "largest force of the stack against the hand"),
    "f_s_max": Metric("N", "largest force of the stack on the slave", TWO_ENDS),
    "f_h_max": Metric("N", "largest force of the hand on the master"),
    "f_env_max": Metric("N", "largest force of the slave on its environment", TWO_ENDS),
    "f_m_end": Metric("N", "force of the stack against the hand at the end, mean over the last 0.1 s"),
    "f_env_end": Metric("N", "force of the slave on its environment at the end, mean over the last 0.1 s", TWO_ENDS),
    "T_fwd_mean": Metric("s", "mean age of a forward message when it was first played", LINK),
    "T_fwd_max": Metric("s", "its largest value", LINK),
    "T_bwd_mean": Metric("s", "mean age of a backward message when it was first played", LINK),
    "T_bwd_max": Metric("s", "its largest value", LINK),
    "fresh_fwd": Metric("1", "share of the slave's ticks with a fresh message", LINK),
    "fresh_bwd": Metric("1", "share of the master's ticks with a fresh message", LINK),
    "sent_fwd": Metric("1", "share of the ticks at which the master sent a message", DEADBAND),
    "sent_bwd": Metric("1", "share of the ticks at which the slave sent a message", DEADBAND),
    "queue_fwd_max": Metric("s", "longest queue of forward waves at a tick that played a message", PLAYED),
    "queue_fwd_end": Metric("s", "queue of forward waves at such ticks of the last 0.1 s, mean", PLAYED),
    "queue_bwd_max": Metric("s", "longest queue of backward waves at a tick that played a message", PLAYED),
    "queue_bwd_end": Metric("s", "queue of backward waves at such ticks of the last 0.1 s, mean", PLAYED),
    "E_link_min": Metric("J", "smallest energy stored in the link", WAVES),
    "E_link_end": Metric("J", "energy stored in the link at the end", WAVES),
    "E_port_min": Metric("J", "smallest energy that law and link have taken up at the ports", PORTS),
    "E_port_end": Metric("J", "energy that law and link have taken up at the ports by the end", PORTS),
    "E_law_min": Metric("J", "smallest energy that the law keeps, of which it was given its seed energy", STORED),
    "E_law_end": Metric("J", "energy that the law keeps at the end", STORED),
    "E_fwd_min": Metric("J", "forward: sender's stamped energy less what was received, smallest; below zero at most by "
                        "what was held over ticks that were left out", STAMPS),
    "E_bwd_min": Metric("J", "backward: the same", STAMPS),
    "g_m_min": Metric("1", "smallest gain the master's watchdog came to", WATCHDOG),
    "g_s_min": Metric("1", "smallest gain the slave's watchdog came to", WATCHDOG),
    "swing_end": Metric("m", "swing that is left at the end, peak to peak", STANDS),
    "swing_frequency": Metric("Hz", "its frequency: that at which the master turns", SWINGS),
    "felt_mass": Metric("kg", "mass that the stack adds to the master in free space: f_m fitted to acceleration and "
                        "velocity until the slave touches something", FREE),
    "felt_drag": Metric("N s/m", "drag that it adds, by the same fit", FREE),
    "felt_fit": Metric("1", "share of the variance of f_m that the fit explains", FELT),
    "felt_stiffness": Metric("N/m", "force against the hand by the way of the master beyond the place of what the "
                             "slave touches, means over the last 0.1 s", PRESSES),
    "felt_share": Metric("1", "felt stiffness against that of the environment, as the slave presses it", PRESSES),
    "drift_end": Metric("m", "slave against master at the end, mean over the last 0.1 s; of a slave that presses this "
                        "holds what its coupling gives way", TWO_ENDS),
    "jerk_rms": Metric("N/s", "rate of change of the force against the hand from tick to tick, rms"),
    "jerk_999": Metric("N/s", "its value that at most one tick in a thousand exceeds"),
    "energy_out": Metric("J", "most energy that law and link have given out at the ports beyond what they took up",
                         PORTS),
}
UNITS = {name: metric.unit for name, metric in METRICS.items()}
ROUNDING = 1e-12  # of the greatest figure of a unit: 4500 times the 2^-52 by which a sum of that size errs


_SENT = {"fwd": "sent_m", "bwd": "sent_s"}
_COLUMNS = {"free": ("f_m", "v_m", "v_s", "f_env"), "touch": ("f_env",), "jerk": ("f_m",), "ranks": ("f_m",),
            **{name: (name,) for name in ("f_m", "f_env", "x_m", "x_s")}}  # that sums are of
_ERRORS = {"x_err": ("x_s", "x_m", "seq_s"), "f_err": ("f_m", "f_env", "seq_m")}  # mine, theirs, what played theirs


def metrics(scene: Scene, trace: Mapping[str, Any]) -> dict[str, float]:
    """Figures of `worked_out` that are finite."""
    return finite(worked_out(scene, trace))


def finite(every: dict[str, float]) -> dict[str, float]:
    """Keep the figures that are finite."""
    return {name: value for name, value in every.items() if isfinite(value)}


def resolved(every: Mapping[str, float]) -> dict[str, float]:
    """The figures of one run as they are shown: what is rounding beside the greatest of its unit is 0.

    They are sums and differences of numbers of that size, in double precision, over thousands of ticks.

    >>> resolved({"f_m_max": 3.53, "f_env_end": 4.98e-15, "x_err_max": 1e-14})
    {'f_m_max': 3.53, 'f_env_end': 0.0, 'x_err_max': 1e-14}
    """
    greatest: dict[str, float] = {}
    for name, value in every.items():
        if name in UNITS and isfinite(value):
            greatest[UNITS[name]] = max(greatest.get(UNITS[name], 0.0), abs(value))
    return {name: 0.0 if abs(value) < ROUNDING * greatest.get(UNITS.get(name, ""), 0.0) else value
            for name, value in every.items()}


def worked_out(scene: Scene, trace: Mapping[str, Any]) -> dict[str, float]:
    """Every figure of `UNITS` that the scene has, by name; of one end's trace, those that it is enough for.

    Tracking error is `|x_s(k) - x_m(k - d)|` with d the median age, in ticks, at which forward messages were
    played; force error is `|f_m(k) - f_env(k - d)|` with that of the backward ones. Without a link d is 1.
    """
    ticks = len(trace["t"])
    if not ticks:
        return {}
    dt = scene.dt_ns / 1e9
    out: dict[str, float] = {}
    for way, seq in (("fwd", "seq_s"), ("bwd", "seq_m")):
        age = _ages(trace, seq, dt)
        if age is not None:
            out |= _delays(way, age, ticks)
        out |= _queues(trace, way, seq, dt)
    out |= {f"sent_{way}": float(trace[sent].sum()) / ticks for way, sent in _SENT.items() if sent in trace}
    for name, (mine, theirs, _) in _ERRORS.items():
        if mine in trace and theirs in trace:
            out |= _worst(name, _error(scene, trace, name))
    if "qw_m" in trace and "qw_s" in trace:
        lag = _lag(_ages(trace, "seq_s", dt), dt)
        out |= _worst("angle_err", angle_error(trace, _ticks(trace, dt), lag))
    forces = [name for name in ("f_m", "f_s", "f_h", "f_env") if name in trace]
    out |= {f"{name}_max": _greatest(trace[name]) for name in forces}
    out |= _summed(scene, trace, dt)
    for ledger in ("E_link", "E_port", "E_law"):
        if ledger in trace:
            energy = _begun(trace[ledger])
            out |= {f"{ledger}_min": float(energy.min()), f"{ledger}_end": float(energy[-1])}
    if "E_port_min" in out:
        out["energy_out"] = energy_out(out["E_port_min"])
    for way, e in (("fwd", "s"), ("bwd", "m")):
        if {f"E_in_{way}", f"E_out_{way}", f"seq_{e}"} <= trace.keys():
            out[f"E_{way}_min"] = _stamped(trace, way, e, dt)
    out |= {f"{g}_min": float(trace[g].min()) for g in ("g_m", "g_s") if g in trace}
    return out


def _begun(energy: NDArray[np.float64]) -> NDArray[np.float64]:
    """A ledger without the NaN that it begins with where a live run ended with another session than it began with."""
    return energy[np.argmin(np.isnan(energy)):] if np.isnan(energy[0]) else energy


def of_plan(way: str, play: Sequence[int], dt: float) -> dict[str, float]:
    """Figures of one direction ("fwd" or "bwd") by itself: `play` are the packets played at its ticks, or -1."""
    played = np.asarray(play)
    fresh = np.flatnonzero(played >= 0)
    return _delays(way, (fresh - played[fresh]) * dt, len(played))


def _delays(way: str, age: NDArray[np.float64], ticks: int) -> dict[str, float]:
    out = {f"fresh_{way}": len(age) / ticks}
    return {**out, f"T_{way}_mean": float(age.mean()), f"T_{way}_max": float(age.max())} if len(age) else out


def tracking(scene: Scene, trace: Mapping[str, Any]) -> dict[str, NDArray[np.float64]]:
    """Tracking error `x_err` (m) and force error `f_err` (N) at every tick, as `metrics` defines them.

    NaN at the ticks before the other end's value of one delay ago exists.
    """
    return {name: _error(scene, trace, name) for name in ("x_err", "f_err")}


def _error(scene: Scene, trace: Mapping[str, Any], name: str) -> NDArray[np.float64]:
    """Compute one of the two errors of `tracking`."""
    mine, theirs, seq = _ERRORS[name]
    dt = scene.dt_ns / 1e9
    lag = _lag(_ages(trace, seq, dt), dt)
    x, opposite = trace[mine], law_places(trace)[theirs]
    if scene.scaling is not None or scene.frame is not None:  # in the master's units
        scale_x, scale_f = [_by_axis(one) for one in zip(*scales(scene), strict=True)]
        x = in_base_of_master(scene, x / scale_x) if name == "x_err" else x
        opposite = in_base_of_master(scene, opposite / scale_f) if name == "f_err" else opposite
    return _behind(x, opposite, _ticks(trace, dt), lag)


def in_base_of_master(scene: Scene, columns: NDArray[np.float64]) -> NDArray[np.float64]:
    """Columns of the slave, one for each axis, in the directions of the master's base."""
    if scene.frame is None:
        return columns
    return np.stack(turn(transpose(scene.frame.matrix), scene.frame.triples(scene), columns.T), axis=1)


def _by_axis(numbers: tuple[float, ...]) -> Any:
    """Divisor of a column of a trace, whose axes have numbers of their own."""
    return np.array(numbers) if len(set(numbers)) > 1 else numbers[0]


def law_places(trace: Mapping[str, Any]) -> Mapping[str, Any]:
    """The trace with the master's position as its law was told it, where a clutch or a policy stands between."""
    offsets = [name for name in ("offset_m", "offset_policy_m") if name in trace]
    if not offsets or "x_m" not in trace:
        return trace
    x = trace["x_m"]
    for name in offsets:
        x = x - trace[name]
    return ChainMap({"x_m": x}, trace)  # type: ignore[arg-type]  # nothing is written to it


def _ticks(trace: Mapping[str, Any], dt: float) -> NDArray[np.int64]:
    t = trace["t"]
    ticks = np.empty(len(t), dtype=np.int64)
    for block in blocks(len(t)):
        ticks[block] = np.rint(t[block] / dt)
    return ticks


def _ages(trace: Mapping[str, Any], seq: str, dt: float) -> NDArray[np.float64] | None:
    """Ages (s) of the fresh messages when they were played; None without a link."""
    if seq not in trace:
        return None
    played, t = trace[seq], trace["t"]
    age = np.empty(int(np.count_nonzero(played >= 0)))
    at = 0
    for block in blocks(len(t)):
        fresh = played[block] >= 0
        some = (np.rint(t[block] / dt).astype(np.int64)[fresh] - played[block][fresh]) * dt
        age[at : at + len(some)] = some
        at += len(some)
    return age


def _lag(age: NDArray[np.float64] | None, dt: float) -> int:
    """The median age in whole ticks, a half rounded up; 1 without a link."""
    if age is None:
        return 1
    if not len(age):
        return 0
    age.partition(len(age) // 2)
    return int(np.floor(age[len(age) // 2] / dt + 0.5))


def _greatest(column: NDArray[Any]) -> float:
    """The greatest magnitude; NaN if there is one."""
    return float(np.max([magnitude(column[block]).max() for block in blocks(len(column))]))


def _queues(trace: Mapping[str, Any], way: str, seq: str, dt: float) -> dict[str, float]:
    """The queue of one direction, of several axes the longest, at the ticks that played a message.

    In a gap the queue shortens as the age of the newest message grows. So queue and age add up to what a wave takes
    where a message was just played. Where none was in the last `END`, nothing is left that has an end.
    """
    name = f"queue_{seq[-1]}"
    if name not in trace or seq not in trace:
        return {}
    fresh = trace[seq] >= 0
    queue = trace[name].reshape(len(fresh), -1).max(axis=1)
    last = queue[_last(trace, dt):][fresh[_last(trace, dt):]]
    out = {f"queue_{way}_max": float(queue[fresh].max())} if fresh.any() else {}
    return {**out, f"queue_{way}_end": float(last.mean())} if len(last) else out


def _last(trace: Mapping[str, Any], dt: float) -> int:
    """The first row of the last `END`, of which there is one at least; live, ticks may be missing."""
    t = trace["t"]
    return min(int(np.searchsorted(t, t[-1] - END + 0.5 * dt)), len(t) - 1)


def energy_out(least: float) -> float:
    """The most energy that was given out, of the least that was taken up, J."""
    return 0.0 if least >= 0.0 else -least


def _summed(scene: Scene, trace: Mapping[str, Any], dt: float) -> dict[str, float]:
    """The figures of `SUMS`, except those of `AT_REST`."""
    present = [name for name in SUMS if name not in AT_REST and all(
        column in trace for group in SUMS[name] for column in _COLUMNS[group])]
    groups = {group for name in present for group in SUMS[name]}
    first = _last(trace, dt)
    frame = frame_of(scene)._replace(axes=trace["f_m"][:1].size) if "f_m" in trace else frame_of(scene)
    sums = sums_of(frame, law_places(trace), tuple(groups), first, magnitude)
    return figures(present, sums, frame, len(trace["t"]), len(trace["t"]) - first)


def found_at_rest(scene: Scene, trace: Mapping[str, Any], still: Still, status: str) -> dict[str, float]:
    """The figures of `AT_REST` of a run that came to its end with this status, where nothing moves it any more."""
    frame = frame_of(scene)
    sums = {} if status == "ok" else turns_of(trace, still.window)
    wanted = ["swing_frequency"]
    if scene.slave is not None and {"f_m", "f_env", "x_m", "x_s"} <= trace.keys():
        groups = SUMS["felt_share"]
        sums |= sums_of(frame, law_places(trace), groups, _last(trace, frame.dt), magnitude)
        wanted += ["felt_stiffness", "felt_share"]
    return resting(wanted, sums, frame, status)


def magnitude(column: NDArray[Any]) -> NDArray[Any]:
    """Magnitude over the axes, without squares that overflow where the magnitude does not."""
    with np.errstate(all="ignore"):  # the last rows of a run that diverged
        size: NDArray[Any] = np.abs(column)
        if column.ndim == 1:
            return size
        # As `teleop.sweeps.kernels.figures.magnitude3` has it, in the same order: a sweep gives the same bits.
        top = np.maximum(size.max(axis=1), TINY)
        parts = (column / top[:, None]).T
        total = parts[0] * parts[0]
        for part in parts[1:]:
            total = total + part * part
        return np.asarray(top * np.sqrt(total))


def _behind(mine: NDArray[Any], theirs: NDArray[Any], ticks: NDArray[np.int64], lag: int) -> NDArray[np.float64]:
    """Magnitude of `mine(k) - theirs(k - lag)`; NaN before the first tick at which both exist."""
    size = np.full(len(ticks), np.nan)
    with np.errstate(all="ignore"):
        for block in blocks(len(ticks)):
            at = np.searchsorted(ticks, ticks[block] - lag, side="right") - 1
            has = at >= 0
            size[block][has] = magnitude(mine[block][has] - theirs[at[has]])
    return size


def _worst(name: str, size: NDArray[np.float64]) -> dict[str, float]:
    """RMS and maximum, from the first tick on at which there is an error to speak of."""
    has = ~np.isnan(size)
    if not has.any():
        return {}
    size = size[has.argmax():]
    total = 0.0
    with np.errstate(all="ignore"):
        for block in blocks(len(size)):  # summed in the order of the ticks, as a sweep does as it goes
            total = np.add.accumulate(np.concatenate([[total], size[block] * size[block]]))[-1]
        return {f"{name}_rms": float(np.sqrt(total / len(size))), f"{name}_max": float(size.max())}


def _stamped(trace: Mapping[str, Any], way: str, e: str, dt: float) -> float:
    """Smallest of (energy the sender had put in when it sent) - (energy taken out when it was played)."""
    played = trace[f"seq_{e}"]
    ticks, sent, taken = _ticks(trace, dt), trace[f"E_in_{way}"], trace[f"E_out_{way}"]
    least = []
    with np.errstate(all="ignore"):
        for block in blocks(len(ticks)):
            row = np.searchsorted(ticks, played[block])
            ok = (played[block] >= 0) & (row < len(ticks))
            ok[ok] = ticks[row[ok]] == played[block][ok]
            if ok.any():
                least.append((sent[row[ok]] - taken[block][ok]).min())
    return float(np.min(least)) if least else 0.0


def quaternions(trace: Mapping[str, Any], e: str) -> list[NDArray[np.float64]]:
    """The orientation of each rotation of an end, m or s, as (w, x, y, z) in rows: of shape (4, ticks)."""
    numbers = takewhile(lambda n: f"qw{n}_{e}" in trace, ("" if i == 1 else str(i) for i in count(1)))
    return [np.stack([trace[f"q{part}{n}_{e}"] for part in "wxyz"]) for n in numbers]


def angle_error(trace: Mapping[str, Any], ticks: NDArray[np.int64], lag: int) -> NDArray[np.float64]:
    """The angle (rad) from the slave's orientation to that of the master `lag` ticks before, at every tick.

    Of several rotations the greatest; NaN before the first tick at which both exist.
    """
    at = np.searchsorted(ticks, ticks - lag, side="right") - 1
    has = at >= 0
    size = np.full(len(ticks), np.nan)
    for master, slave in zip(quaternions(trace, "m"), quaternions(trace, "s"), strict=True):
        a, b = master[:, at[has]], slave[:, has]
        with np.errstate(all="ignore"):
            along = np.abs((a * b).sum(axis=0))
            across = np.linalg.norm(a[0] * b[1:] - b[0] * a[1:] + np.cross(a[1:], b[1:], axis=0), axis=0)
            size[has] = np.fmax(size[has], 2.0 * np.arctan2(across, along))
    return size
