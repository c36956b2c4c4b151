"""From the rows that the two ends left to the columns of a trace."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import nan
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from teleop.errors import NamedValues
from teleop.physics.plant import grip_force
from teleop.simulation.bodies import master_coefficients
from teleop.simulation.prepared import Prepared, prepare
from teleop.simulation.structure import SENSED

BLOCK = 16384  # rows that are worked on at a time, so that a long run needs no second copy of a column

AHEAD = 1_000_000  # ticks without a row that a record may have, 17 min at 1 kHz ...
AHEAD_EACH = 100  # ... and so many more for each row, for what is worked out at every tick in between
UNKNOWN = ("its rows lie so far apart that the forces that were not recorded, and how late ticks were, are not worked "
           "out in between")


class Rows(Protocol):
    """Rows of float64 that are read a part at a time, such as those of a file."""

    def table(self, start: int, stop: int) -> NDArray[np.float64]:
        """The rows from `start` up to `stop`, of shape (rows, columns)."""
        ...


# Where an end's external force (f_h or f_env) is from: the device's sensor, at every tick; or the scene's own bodies,
# which tell it after the run; or it is not known.
ForceSource = Literal["sensor", "bodies", "unknown"]


class EndRecord(NamedTuple):
    """Record of one end: the ticks it ran, its rows, the packets it played."""

    ticks: Any  # whole numbers, one for each row
    rows: Sequence[float] | Rows  # flat floats, or what reads them
    played: Any | None  # the packet played at each of these ticks, or -1; None without a link
    force: ForceSource | None = None  # of a live end; None: a run in virtual time, whose bodies are the scene's own


class Columns(Mapping[str, "NDArray[np.float64]"]):
    """The columns of a trace by name, each an array made when it is asked for and not kept: half an hour is 15 MB each.

    `makers` has the function that makes each.
    """

    def __init__(self, makers: Mapping[str, Callable[[], NDArray[Any]]]) -> None:
        self.makers: dict[str, Callable[[], NDArray[Any]]] = NamedValues("column of this run", makers)

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.makers[name]()

    def __contains__(self, name: object) -> bool:
        return name in self.makers

    def __iter__(self) -> Iterator[str]:
        return iter(self.makers)

    def __len__(self) -> int:
        return len(self.makers)


def blocks(count: int) -> Iterator[slice]:
    """`count` rows in parts of at most `BLOCK`."""
    return (slice(start, min(start + BLOCK, count)) for start in range(0, count, BLOCK))


def seconds(ticks: Any, dt_ns: int) -> NDArray[np.float64]:
    """The times (s) of ticks."""
    t = np.empty(len(ticks))
    for block in blocks(len(t)):
        t[block] = np.asarray(ticks[block], dtype=np.int64) * dt_ns / 1e9
    return t


def end_columns(prepared: Prepared, e: str, record: EndRecord) -> Columns:
    """The columns of one end (m or s) as arrays of shape (rows,), or (rows, axes) where there are several axes.

    The external force is there if it was recorded, or if the scene's own bodies tell it.
    """
    table = _Table(prepared, e, record)
    makers: dict[str, Callable[[], NDArray[Any]]] = {name: partial(table.column, name) for name in table.places}
    if record.played is not None:
        makers[f"seq_{e}"] = lambda: np.array(record.played, dtype=np.int64)
    if SENSED[e] not in makers and record.force in (None, "bodies"):
        until = _until(prepared, record.ticks)
        of_bodies = _hand_force if e == "m" else _touch
        makers[SENSED[e]] = partial(of_bodies, until or prepared, table, known=until is not None)
    return Columns(makers)


def far_apart(ticks: Sequence[int], first: int = 0) -> bool:
    """True if these ticks, of which `first` was the first due, skip too many to look at each of those."""
    return len(ticks) > 0 and int(ticks[-1]) - first >= AHEAD + AHEAD_EACH * len(ticks)


def _until(prepared: Prepared, ticks: Sequence[int]) -> Prepared | None:
    """The scene as far as these ticks go; None if that is too far for as few as they are."""
    if far_apart(ticks):
        return None
    scene, last = prepared.scene, int(ticks[-1]) if len(ticks) else 0
    return prepared if last >= scene.ticks - 1 else prepare(replace(scene, duration=(last + 1) * scene.dt_ns / 1e9))


def assemble(prepared: Prepared, records: Mapping[str, EndRecord]) -> Columns:
    """The trace of a run: `t`, then each end's columns, at the ticks that both ends ran."""
    scene = prepared.scene
    ends = {e: end_columns(prepared, e, record) for e, record in records.items()}
    ticks_m, ticks_s = (np.asarray(records[e].ticks, dtype=np.int64) for e in ("m", "s" if "s" in ends else "m"))
    if not np.array_equal(ticks_m, ticks_s):
        _, *both = np.intersect1d(ticks_m, ticks_s, assume_unique=True, return_indices=True)
        ends = {e: Columns({name: partial(_picked, make, at) for name, make in ends[e].makers.items()})
                for e, at in zip(("m", "s"), both, strict=True)}
        ticks_m = ticks_m[both[0]]
    makers: dict[str, Callable[[], NDArray[Any]]] = {"t": partial(seconds, ticks_m, scene.dt_ns), **ends["m"].makers}
    makers |= ends["s"].makers if "s" in ends else {}
    return Columns({**makers, **(_ledgers(Columns(makers)) if scene.energy else {})})


def _picked(make: Callable[[], NDArray[Any]], at: NDArray[np.int64]) -> NDArray[Any]:
    return make()[at]


def _ledgers(sums: Columns) -> dict[str, Callable[[], NDArray[Any]]]:
    """E_link, E_port and E_law from each end's own sums, so that both ways of running add in the same order.

    They are not added to `sums` itself: what held each other would keep all rows until the next garbage collection.
    """
    def link() -> NDArray[Any]:
        with np.errstate(all="ignore"):  # a run that diverges ends with sums that are infinite
            stored: NDArray[Any] = sums["E_in_fwd"]
            stored -= sums["E_out_fwd"]
            back = sums["E_in_bwd"]
            back -= sums["E_out_bwd"]
            stored += back
            return stored

    def port() -> NDArray[Any]:
        with np.errstate(all="ignore"):
            port_energy: NDArray[Any] = sums["E_port_m"]
            if "E_port_s" in sums:
                port_energy -= sums["E_port_s"]
            return port_energy

    def law() -> NDArray[Any]:
        with np.errstate(all="ignore"):
            total: NDArray[Any] = sums["E_law_m"]
            total += sums["E_law_s"]
            return total

    return {**({"E_link": link} if "E_in_fwd" in sums else {}), "E_port": port,
            **({"E_law": law} if "E_law_m" in sums else {})}


class _Table:
    """The rows of an end and where in them each column stands."""

    def __init__(self, prepared: Prepared, e: str, record: EndRecord) -> None:
        names = prepared.columns(e, None if record.force is None else record.force == "sensor")
        widths = [prepared.scene.axes if "@" in name else 1 for name in names]
        ends = np.add.accumulate(widths).tolist()
        self.places = {name.removesuffix("@"): slice(end - width, end)
                       for name, width, end in zip(names, widths, ends, strict=True)}
        self.ticks = record.ticks
        rows: Any = record.rows
        self._read = rows.table if hasattr(rows, "table") else _slices(np.asarray(rows, dtype=float), ends[-1])

    def __len__(self) -> int:
        return len(self.ticks)

    def part(self, block: slice) -> NDArray[np.float64]:
        """The rows of `block`, of shape (rows, columns)."""
        return self._read(block.start, block.stop)

    def column(self, name: str) -> NDArray[np.float64]:
        """Column of all rows."""
        at = self.places[name]
        width = at.stop - at.start
        out = np.empty(len(self) if width == 1 else (len(self), width))
        for block in blocks(len(self)):
            part = self.part(block)[:, at]
            out[block] = part[:, 0] if width == 1 else part
        return out


def _slices(flat: NDArray[np.float64], width: int) -> Callable[[int, int], NDArray[np.float64]]:
    """Reader of the rows from one up to another of a table that lies flat in memory."""
    whole = flat.reshape(-1, width)
    return lambda start, stop: whole[start:stop]


def _per_axis(part: NDArray[Any], at: slice) -> NDArray[Any]:
    """Column of some rows as an array of shape (axes, rows)."""
    return part[:, at].T


def _of_axes(count: int, axes: int) -> NDArray[np.float64]:
    return np.empty(count) if axes == 1 else np.empty((count, axes))


def _hand_force(prepared: Prepared, table: _Table, *, known: bool) -> NDArray[Any]:
    """f_h of a master without a force sensor, worked out after the run from what it recorded; NaN if not `known`."""
    scene = prepared.scene
    out = _of_axes(len(table), scene.axes)
    if not known:
        out[:] = np.nan
        return out
    reference = prepared.reference
    if reference is None:
        out[:] = 0.0
        return out
    coefficients, dt = master_coefficients(scene), scene.dt_ns / 1e9
    paths = [np.asarray(axis, dtype=float) for axis in reference]
    held = np.zeros((scene.axes, 1))  # the force of the tick before
    with np.errstate(all="ignore"):  # the last rows of a run that diverged
        for block in blocks(len(table)):
            part = table.part(block)
            x, v, f = (_per_axis(part, table.places[name]) for name in ("x_m", "v_m", "f_m"))
            before, held = np.concatenate([held, f[:, :-1]], axis=1), f[:, -1:]
            k = np.asarray(table.ticks[block], dtype=np.int64)
            for i, (c, r) in enumerate(zip(coefficients, paths, strict=True)):
                slope = np.where(k > 0, (r[k] - r[k - 1]) / dt, 0.0)
                force = grip_force(c, x[i], v[i], before[i], r[k], slope)  # type: ignore[arg-type]  # rows at once
                out[(block, i)[: out.ndim]] = force
    return out


def _touch(prepared: Prepared, table: _Table, *, known: bool) -> NDArray[Any]:
    """f_env of a slave whose law reads no force, worked out after the run; NaN if not `known`."""
    out = _of_axes(len(table), prepared.scene.axes)
    if not known:
        out[:] = nan
        return out
    plants = prepared.slaves
    for block in blocks(len(table)):
        part = table.part(block)
        x, v = (_per_axis(part, table.places[name]).tolist() for name in ("x_s", "v_s"))
        for i, plant in enumerate(plants):
            forces = [plant.force(plant.c, a, b) for a, b in zip(x[i], v[i], strict=True)]
            out[(block, i)[: out.ndim]] = forces
    return out
