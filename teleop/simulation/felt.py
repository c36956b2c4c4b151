"""Perceived figures of a run: mass and drag in free space, stiffness at the wall, steady forces, smoothness, drift.

Each figure follows from a few sums over the ticks, added in their order, so that a sweep keeps the sums as it goes
(`teleop.sweeps.kernels.sums`) and a single run adds them up from its trace, with the same bits. `SUMS` says which
figure needs which sums. With x, v, f of the master (m), of the slave (s), and k the tick:

**Free space** is a run from when the slave first moves until it first touches something (f_env other than 0): what
comes after holds what the link and the law still reflect of the contact. Over its ticks f_m is fitted by least squares,

    f_m = felt_mass a + felt_drag v + a constant,      a = (v(k) - v(k-1))/dt, v = (v(k) + v(k-1))/2, f_m = f_m(k-1),

so each force goes with the motion that it was held over, as in the ledger E_port. Both come on top of the master's own
mass and damping. At a steady sine of frequency w they are Im Z/w and Re Z of the impedance Z that the stack shows at
it, with the hold of one tick: a law f_m = B v has a drag of B and a mass of -B dt/2. So the mass is below zero where
the stack feels like a spring. Several axes share mass and drag; each has a constant of its own. There is no fit
where the motion does not tell mass from drag: where the condition number of the correlation matrix of a and v, which is
(1 + |r|)/(1 - |r|), is above `WORST`. `felt_fit` is the share of the variance of f_m that the fit explains.

**Pressing**: in a scene that nothing moves any more, where the slave touches a place `at` in each tick of the last
`END`, the means of that time give, along the force on what the slave touches,

    felt_stiffness = f_m/(x_m - at),      felt_share = felt_stiffness/(f_env/(x_s - at)).

For waves through a constant delay this is `1/(1/K + 1/k_e + (T_fwd + T_bwd)/(2 b))`, beside the hand's own 1/k_h. It is
the place of the wall that counts, not where the master was when the slave came there. There is no stiffness where the
master has not passed the place of the wall, as after a drift of the positions.

**Smoothness** is the rate of change of f_m from tick to tick, `jerk`, N/s. The 99.9 % value is the least that at most
one tick in a thousand exceeds: of n steps the (n // 1000 + 1)th largest, an order statistic that needs no histogram,
since so few of the largest are to be kept.

**A limit cycle**, or what grows, has the frequency of the axis of the master that swings most, which is what the hand
feels: over the last two windows of `teleop.simulation.rest` the times at which its velocity leaves a band about 0
upwards, having been below it since the last; the band is a quarter of the greatest speed of the window before.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import ceil, isfinite, nan, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from teleop.scene.scene import Scene
from teleop.simulation.rest import risen
from teleop.simulation.trace import blocks
from teleop.stages.slave_units import scales, transpose, turn

TINY = 1e-300
END = 0.1  # s, before the end: a force that jumps from tick to tick, under loss, is told by its mean
WORST = 100.0  # condition number above which mass and drag are not told apart
RARE = 1000  # ticks of which one may be above the 99.9 % value
MOST_RANKS = 32  # of the largest that a kernel keeps; of longer runs the whole record is needed
QUARTER = 0.25  # of the greatest speed: the band that a velocity has to pass to be counted as turning

SUMS = {  # figure -> the sums that it follows from
    "felt_mass": ("free",), "felt_drag": ("free",), "felt_fit": ("free",),
    "f_m_end": ("f_m",), "f_env_end": ("f_env",), "drift_end": ("x_m", "x_s"),
    "felt_stiffness": ("f_m", "x_m", "f_env", "touch"), "felt_share": ("f_m", "x_m", "f_env", "touch", "x_s"),
    "jerk_rms": ("jerk",), "jerk_999": ("jerk", "ranks"),
    "swing_frequency": ("turns",),
}
OF_SLAVE = frozenset(SUMS) - {"f_m_end", "jerk_rms", "jerk_999", "swing_frequency"}
AT_REST = frozenset(("swing_frequency", "felt_stiffness", "felt_share"))  # once nothing moves the scene any more
AT_END = ("f_m", "f_env", "x_m", "x_s", "touch")  # sums over the last `END`


class Basis(NamedTuple):
    """Properties of a scene by which the figures are worked out."""

    dt: float  # s
    axes: int
    scales: tuple[tuple[float, float], ...]  # of each axis (scale_x, scale_f), see `teleop.stages.scaling`
    at: tuple[float, ...]  # the place of what the slave touches, of each axis, m; NaN where it has none
    triples: tuple[int, ...] = ()  # the first of each three axes that are turned,
    matrix: tuple[float, ...] = ()  # ... by this rotation from the master's base to the slave's

    @property
    def last(self) -> int:
        """The ticks of the last `END`."""
        return max(1, ceil(END / self.dt - 0.5))


def frame_of(scene: Scene) -> Basis:
    """Make the `Basis` of a scene."""
    places = [getattr(each, "at", nan) for each in scene.environments] if scene.slave is not None else []
    return Basis(scene.dt_ns / 1e9, scene.axes, scales(scene),
                 tuple([float(at) if isinstance(at, int | float) else nan for at in places]),
                 *(() if scene.frame is None else (scene.frame.triples(scene), scene.frame.matrix)))


def ranks(ticks: int) -> int:
    """Number of the largest steps among so many ticks that the 99.9 % value needs."""
    return max(0, ticks - 1) // RARE + 1


def names(group: str, axes: int, ranked: int) -> tuple[str, ...]:
    """The sums of a group, in order; `ranked`: how many of the largest steps."""
    if group == "free":
        return ("free_n", *[f"free_{one}{i}" for i in range(axes) for one in ("a", "v", "f")],
                *[f"free_{two}" for two in ("aa", "av", "vv", "fa", "fv", "ff")])
    if group in AT_END:
        return tuple([f"{group}_{i}" for i in range(axes)])
    if group == "turns":
        return tuple([f"{one}_{i}" for i in range(axes) for one in ("rise", "fall", "turns", "first", "latest")])
    return ("jerk_sq",) if group == "jerk" else tuple([f"rank_{i}" for i in range(ranked)])


# From the sums to the figures


def figures(wanted: Sequence[str], sums: Mapping[str, float], frame: Basis, ran: int, late: int
            ) -> dict[str, float]:
    """Figures that these sums of a run of so many ticks have, except the ones of `AT_REST`.

    `late`: the ticks of the last `END`.
    """
    values: dict[str, float] = {}
    if any(name.startswith("felt") for name in wanted):
        values |= free(sums, frame)
    if "jerk_rms" in wanted or "jerk_999" in wanted:
        values |= smoothness(sums, frame, ran)
    for name in ("f_m_end", "f_env_end"):
        if name in wanted:
            values[name] = length(means(sums, name.removesuffix("_end"), frame, late))
    if "drift_end" in wanted:
        slave = [s / scale_x for s, (scale_x, _) in zip(means(sums, "x_s", frame, late), frame.scales, strict=True)]
        slave = turn(transpose(frame.matrix), frame.triples, slave)
        values["drift_end"] = length([s - m for s, m in zip(slave, means(sums, "x_m", frame, late), strict=True)])
    return {name: values[name] for name in wanted if name in values}


def resting(wanted: Sequence[str], sums: Mapping[str, float], frame: Basis, status: str) -> dict[str, float]:
    """Figures of `AT_REST` that these sums have, of a run that came to its end with this status."""
    values: dict[str, float] = {}
    if "felt_stiffness" in wanted or "felt_share" in wanted:
        values |= stiffness(sums, frame)
    if "swing_frequency" in wanted and status != "ok":
        values |= turning(sums, frame)
    return {name: values[name] for name in wanted if name in values}


def means(sums: Mapping[str, float], group: str, frame: Basis, count: int) -> list[float]:
    """The means of each axis over the last `END`."""
    return [sums[name] / count for name in names(group, frame.axes, 0)]


def length(parts: Sequence[float]) -> float:
    """Magnitude over the axes, as `teleop.simulation.metrics.magnitude` has it."""
    if len(parts) == 1:
        return abs(parts[0])
    top = max(*[abs(part) for part in parts], TINY)
    total = 0.0
    for part in parts:
        total += (part / top) * (part / top)
    return top * sqrt(total)


def free(sums: Mapping[str, float], frame: Basis) -> dict[str, float]:
    """Mass (kg), drag (N s/m) and the share that they explain; none where the motion does not tell them apart."""
    n = sums.get("free_n", 0.0)
    if n < 3.0 or not all(isfinite(sums[name]) for name in names("free", frame.axes, 0)):
        return {}

    def centred(one: str, second: str) -> float:
        total = sums[f"free_{one}{second}"]
        for i in range(frame.axes):
            total -= sums[f"free_{one}{i}"] * (sums[f"free_{second}{i}"] / n)
        return total

    aa, av, vv, fa, fv, ff = (centred(*two) for two in ("aa", "av", "vv", "fa", "fv", "ff"))
    if not (aa > 1e-12 * sums["free_aa"] and vv > 1e-12 * sums["free_vv"]):
        return {}
    r = av / (sqrt(aa) * sqrt(vv))
    if not 1.0 + abs(r) <= WORST * (1.0 - abs(r)):
        return {}
    rest = 1.0 - r * r
    per_tick, drag = (fa - av * (fv / vv)) / (aa * rest), (fv - av * (fa / aa)) / (vv * rest)
    values = {"felt_mass": per_tick * frame.dt, "felt_drag": drag}
    return values | ({"felt_fit": (per_tick * fa + drag * fv) / ff} if ff > 1e-12 * sums["free_ff"] else {})


def stiffness(sums: Mapping[str, float], frame: Basis) -> dict[str, float]:
    """Felt stiffness (N/m), and its share of what the slave feels of its environment; of axes that it touches alone."""
    count = frame.last
    axes = [i for i in range(frame.axes) if sums[f"touch_{i}"] == count and isfinite(frame.at[i])]
    touched = felt = way = own_way = 0.0
    f_m, x_m = [turn(frame.matrix, frame.triples, means(sums, name, frame, count)) for name in ("f_m", "x_m")]
    for i in axes:
        scale_x, scale_f = frame.scales[i]
        force, at = sums[f"f_env_{i}"] / count / scale_f, frame.at[i] / scale_x
        touched += force * force
        felt += force * f_m[i]
        way += force * (x_m[i] - at)
        if f"x_s_{i}" in sums:
            own_way += force * (sums[f"x_s_{i}"] / count / scale_x - at)
    if not (way > 0.0 and isfinite(felt)):
        return {}
    values = {"felt_stiffness": felt / way}
    return values | ({"felt_share": felt / way * (own_way / touched)} if own_way > 0.0 and touched > 0.0 else {})


def smoothness(sums: Mapping[str, float], frame: Basis, ran: int) -> dict[str, float]:
    """The rate of change of f_m, rms and 99.9 % (N/s)."""
    steps = int(sums.get("steps", ran - 1))
    if steps < 1 or "jerk_sq" not in sums:
        return {}
    total = sums["jerk_sq"]
    if not isfinite(total):
        return {}
    values = {"jerk_rms": sqrt(total / steps) / frame.dt}
    rank = f"rank_{ranks(steps + 1) - 1}"
    return values | ({"jerk_999": sums[rank] / frame.dt} if rank in sums else {})


def turning(sums: Mapping[str, float], frame: Basis) -> dict[str, float]:
    """The frequency (Hz) of the axis of the master that swings most; none of what turned but once."""
    most = max(range(frame.axes), key=lambda i: min(sums[f"rise_{i}"], sums[f"fall_{i}"]))
    count, first, latest = (sums[f"{name}_{most}"] for name in ("turns", "first", "latest"))
    if count < 2.0 or not latest > first:
        return {}
    return {"swing_frequency": (count - 1.0) / ((latest - first) * frame.dt)}


# From a trace to the sums


def in_order(values: NDArray[Any], total: float = 0.0) -> float:
    """`total` and the values, added from the first tick to the last, as a sweep adds them as it goes."""
    with np.errstate(all="ignore"):
        for block in blocks(len(values)):
            total = np.add.accumulate(np.concatenate([[total], values[block]]))[-1]
    return float(total)


def sums_of(frame: Basis, trace: Mapping[str, Any], groups: Sequence[str], first: int, size: Any) -> dict[str, float]:
    """The sums of these groups of a trace, those of a group that it is not enough for left out.

    `first`: the first row of the last `END`; `size`: the magnitude over the axes of each row. Of the columns no more
    than two are held at a time: half an hour of a live run is 15 MB each.
    """
    values: dict[str, float] = {}
    t, axes = trace["t"], frame.axes
    follows = np.diff(t) < 1.5 * frame.dt  # live, ticks may be missing
    with np.errstate(all="ignore"):  # the last rows of a run that diverged
        if "free" in groups and all(name in trace for name in ("f_m", "v_m", "v_s", "f_env")):
            values |= _free_sums(trace, axes, follows)
        for group in AT_END:
            name = "f_env" if group == "touch" else group
            if group in groups and name in trace and (column := trace[name]).size == len(t) * axes:
                late = column[first:].reshape(-1, axes)
                late = np.where(np.abs(late) > 0.0, 1.0, 0.0) if group == "touch" else late
                values |= zip(names(group, axes, 0), map(in_order, late.T), strict=True)
        if "jerk" in groups and "f_m" in trace and len(t) > 1:
            force = trace["f_m"]
            steps = np.concatenate([size(np.diff(force[block.start:block.stop + 1], axis=0))
                                    for block in blocks(len(t) - 1)])[follows]
            values["jerk_sq"] = in_order(steps * steps)
            if isfinite(values["jerk_sq"]) and len(steps):
                rank = ranks(len(steps) + 1)
                steps.partition(len(steps) - rank)
                values[f"rank_{rank - 1}"] = float(steps[len(steps) - rank])
            values["steps"] = float(len(steps))
    return values


def _free_sums(trace: Mapping[str, Any], axes: int, follows: NDArray[np.bool_]) -> dict[str, float]:
    """The sums over free space."""
    rows = len(follows) + 1
    touches = ~(np.abs(trace["f_env"].reshape(rows, -1)) <= 0.0).all(axis=1)
    moves = (np.abs(trace["v_s"].reshape(rows, -1)) > 0.0).any(axis=1)
    since = max(int(moves.argmax()) if moves.any() else rows, 1) - 1
    until = int(touches.argmax()) if touches.any() else rows
    speed, force = trace["v_m"], trace["f_m"]
    if until - since < 2 or not speed.size == force.size == rows * axes:
        return {}
    speed, force = speed.reshape(rows, axes), force.reshape(rows, axes)
    sums = dict.fromkeys(names("free", axes, 0), 0.0)
    for block in blocks(until - 1 - since):
        here = slice(since + block.start, since + block.stop)
        goes = follows[here]
        v = speed[here.start:here.stop + 1]
        of = {"a": np.diff(v, axis=0)[goes], "v": (0.5 * (v[1:] + v[:-1]))[goes], "f": force[here][goes]}
        sums["free_n"] += float(np.count_nonzero(goes))
        for name, columns in of.items():
            for i, column in enumerate(columns.T):
                sums[f"free_{name}{i}"] = in_order(column, sums[f"free_{name}{i}"])
        for one, second in ("aa", "av", "vv", "fa", "fv", "ff"):
            product = of[one] * of[second]
            total = product[:, 0]
            for column in product.T[1:]:
                total = total + column
            sums[f"free_{one}{second}"] = in_order(total, sums[f"free_{one}{second}"])
    return sums


def turns_of(trace: Mapping[str, Any], window: int) -> dict[str, float]:
    """The sums of `turns` of a trace: see `BandCrossings` of `teleop.sweeps.kernels.sums`."""
    values: dict[str, float] = {}
    x, v = (trace[name].reshape(len(trace["t"]), -1) for name in ("x_m", "v_m"))
    for i in range(v.shape[1]):
        speeds, late = v[-3 * window:-2 * window, i], v[-2 * window:, i]
        level = QUARTER * float(np.abs(speeds).max())
        side = np.where(late > level, 1, np.where(late < -level, -1, 0))
        some = np.flatnonzero(side)
        ups = some[1:][(side[some][1:] > 0) & (side[some][:-1] < 0)]
        at = []
        for k in ups[[0, -1]] if len(ups) else ():
            now, was = float(late[k]), float(late[k - 1])
            at.append(float(len(v) - 2 * window + int(k)) - (now - level) / (now - was))
        turns = (*risen(x[-window:, i]), float(len(ups)), *(at or (-1.0, -1.0)))
        values |= zip([f"{name}_{i}" for name in ("rise", "fall", "turns", "first", "latest")], turns, strict=True)
    return values
