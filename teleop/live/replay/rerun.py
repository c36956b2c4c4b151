"""One end's law run again over the record of what it read and heard, by the lines of the tick that ran live."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from math import isnan
from pathlib import Path
from struct import pack, unpack
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.errors import Refused
from teleop.law import messages
from teleop.live.records.header import OWN, check_fits
from teleop.live.records.inputs import Inputs, flat, read_inputs
from teleop.live.records.record import read_record
from teleop.scene.scene import Scene
from teleop.simulation.given import numbers_of
from teleop.simulation.source import live_of
from teleop.simulation.structure import columns
from teleop.simulation.trace import EndRecord, blocks
from teleop.stages.wave_integral import Integrals

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Axes = tuple[float, ...]


class EndFolder(NamedTuple):
    """What one end left: the header of its record, its rows, and what it was told at each of them."""

    folder: Path
    header: dict[str, Any]
    record: EndRecord
    inputs: Inputs

    @property
    def e(self) -> str:
        """Which end it is, m or s."""
        return str(self.header["end"])

    @property
    def ticks(self) -> int:
        """Ticks of which there is all."""
        return min(len(self.record.ticks), len(self.inputs.rows))


def read_end(folder: Path, scene: Scene) -> EndFolder:
    """What the end that wrote `folder` left of a run of `scene`. Warns of what is cut off; raises `Refused`."""
    header, record, _ = read_record(folder)
    check_fits(scene, header, record.ticks, folder)
    return EndFolder(folder, header, record, read_inputs(folder, scene, header))


class Told(NamedTuple):
    """What an end was told at one tick, as its row has it."""

    k: int  # tick of the grid
    session: int
    fresh: bool
    newest: float
    gain: float
    since: int
    x: Axes
    v: Axes
    f_ext: Axes | None
    f_held: Axes
    rx: Axes  # the message, axis by axis; zeros where there is none
    waves: Axes  # and what its waves have come to, where that is sent along
    switches: Axes  # of the operator: 1.0 while the clutch is held open, 1.0 while the operator is there
    origin: Axes | None  # where the positions count from, m; None: the device's zero


# The message that a tick plays: its number, the law's, and what its waves have come to.
Heard = Callable[[Told, bool], tuple[float, Any, Any] | None]


class Answered(NamedTuple):
    """What an end answered with at one tick: the force (N, per axis), its message by axis, its row."""

    k: int
    force: Axes
    tx: tuple[Any, ...]
    sent: tuple[Any, ...] | None  # what its waves have come to, where that is sent along
    row: Axes


def told(end: EndFolder) -> Iterator[tuple[Told, list[float]]]:
    """What the end was told, tick by tick, and what it answered with: force and message as numbers."""
    at, rows = end.inputs.places, end.inputs.rows
    nothing = slice(0, 0)  # of a law whose messages are empty
    places = [at.get(name, nothing) for name in (f"x_{end.e}", f"v_{end.e}", "f_held", "rx", "waves", "index")]
    sensed = at.get("f_ext")
    switches = slice(at["clutch"].start, at["present"].stop) if "clutch" in at else None
    answer = at[f"f_{end.e}"].start
    for block in blocks(end.ticks):
        for row in rows.part(block.start, block.stop).tolist():
            k, since, session, fresh, newest, gain = row[:6]
            x, v, held, rx, waves, index = [tuple(row[one]) for one in places]
            yield Told(int(k), int(session), fresh != 0.0, newest, gain, int(since), x, v,
                       None if sensed is None else tuple(row[sensed]), held, rx, waves,
                       (0.0, 1.0) if switches is None else tuple(row[switches]),
                       None if isnan(index[0]) else index), row[answer:]


class Rerun:
    """The law of one end, tick by tick, in `scene`, which may have another law or other knobs than the run had."""

    def __init__(self, end: EndFolder, scene: Scene, touch: NDArray[np.float64] | None = None) -> None:
        """`touch`: the external force at each row (N, per axis) where the device sensed none and the law reads one."""
        e, every = end.e, end.inputs.every
        self.e, self._every, self._touch, self._at = e, every, touch, 0
        self._own = replace(scene, dt=scene.dt * every) if every != 1 else scene
        self.sensor = end.inputs.sensor or touch is not None
        self._live = live_of(self._own, e, self.sensor)
        forth, back = messages(scene.laws[0], self._own.dt_ns / 1e9)
        self._kind = back if e == "m" else forth
        names = columns(scene, e, self.sensor)
        flat = [name for name in names for _ in range(scene.axes if "@" in name else 1)]
        self.columns = [name.removesuffix("@") for name in flat]
        self._places = [i for i, name in enumerate(flat) if name in (f"x_{e}@", f"q_{e}@")]
        self._session = 0
        self._started: Any = None  # the generator of its session

    def tick(self, told: Told, heard: Heard | None = None) -> Answered:
        """Run one tick. `heard`: what it plays then in place of the message in its record."""
        touch = told.f_ext
        if self._touch is not None:
            touch = tuple(self._touch[self._at].tolist())
            self._at += 1
        begins = told.session != self._session
        if begins:
            self._session = told.session
            given = numbers_of(self._own, {self.e: told.x})
            dt = self._own.dt_ns / 1e9
            self._started = self._live(given, self._own.law, dt, told.x, told.v, touch)
            next(self._started)
        if heard is None:
            got, newest, rx, waves = told.fresh, told.newest, None, None
            if got:
                rx, waves = self._by_axis(self._kind, told.rx), self._by_axis(Integrals, told.waves)
        else:
            played = heard(told, begins)
            got, newest, rx, waves = (False, -1, None, None) if played is None else (True, *played)
        force, tx, sent, row = self._started.send((
            told.k // self._every, told.x, told.v, touch, got, newest, rx, waves, told.gain, told.f_held, told.since,
            *told.switches))
        if told.origin is not None:
            row = self._physical(row, told.origin)
        return Answered(told.k, force, tx, sent, row)

    def _by_axis(self, kind: Any, numbers: Axes) -> tuple[Any, ...] | None:
        """A message of each axis out of its numbers; None where none is sent along."""
        n = len(kind._fields)
        return tuple([kind(*numbers[i * n : i * n + n]) for i in range(self._own.axes)]) if numbers or not n else None

    def _physical(self, row: Axes, index: Axes) -> Axes:
        out = list(row)
        for n, i in enumerate(self._places):
            out[i] += index[n % len(index)]
        return tuple(out)


class Difference(NamedTuple):
    """The first number in which a replay is not what was recorded."""

    k: int
    field: str
    recorded: float
    replayed: float


def difference(end: EndFolder, scene: Scene) -> Difference | None:
    """Run the law of `end` again, and compare force, message and row bit by bit; None if all are the same."""
    import numpy as np

    rerun = Rerun(end, scene)
    at, e = end.inputs.places, end.e
    fields = [*end.inputs.header["columns"][at[f"f_{e}"].start :], *end.header["columns"][len(OWN) :]]
    table: Any = end.record.rows
    row, ticks = 0, np.asarray(end.record.ticks)
    rows: list[list[float]] = []
    for i, (one, answered) in enumerate(told(end)):
        if i == row:
            rows = table.table(i, row := min(i + 4096, end.ticks)).tolist()
        if one.k != ticks[i]:
            raise Refused(f"{end.folder} has tick {int(ticks[i])} in its record and tick {one.k} in what it was told; "
                          "its files are of two runs: give the folder as the end wrote it")
        got = rerun.tick(one)
        replayed = (*got.force, *flat(got.tx), *flat(got.sent or ()), *got.row)
        recorded = (*answered, *rows[i - row])
        form = f"<{len(fields)}d"
        if pack(form, *replayed) != pack(form, *recorded):
            for name, was, now in zip(fields, unpack(form, pack(form, *recorded)),
                                      unpack(form, pack(form, *replayed)), strict=True):
                if pack("<d", was) != pack("<d", now):
                    return Difference(one.k, name, was, now)
    return None
