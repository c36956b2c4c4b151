"""Inputs of a live end and when they came, beside its record: from these its law can be run again.

`inputs.bin` has a row of little-endian float64 for each tick: what the end's tick was sent (see `Endpoint.tick`), and
the force and the message that it answered with. `arrivals.bin` has a row of little-endian int64 for each message of the
law that came, copies too: the session, the packet's number, when it came (ns on the run's grid of ticks), and the
first tick that could take it, which decides. What the link lost is not there. Each file begins with one line of JSON.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from itertools import chain
from pathlib import Path
from struct import Struct
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

from teleop.errors import Refused
from teleop.law import messages
from teleop.live.records.reader import LONGEST, RecordFile, TruncatedRecord, sound_rows
from teleop.protocol.manifest import MOST_EVERY
from teleop.scene.scene import MOST_TICKS, Scene
from teleop.simulation.structure import structure_of
from teleop.stages.end import SWITCHES
from teleop.stages.wave_integral import Integrals
from teleop.storage.files import open_regular
from teleop.storage.strict_json import Misshapen, list_of, one_of, parse, record, text, whole

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

INPUTS, ARRIVALS = "inputs.bin", "arrivals.bin"
VERSION = 1
ARRIVAL = ("session", "packet", "time_ns", "tick")
MOST = 64  # arrivals for each tick that are kept, many times what a link brings: a flood must not fill the disk
_ARRIVAL = Struct(f"<{len(ARRIVAL)}q")
_SAME = ("end", "dt_ns", "axes", "scene", "knobs", "seed", "mode")  # as in the header of the record beside it
_FLOATS = ("k", "since", "session", "fresh", "newest", "gain")  # columns that stand once; since: ticks since the last
_HEADER = record({
    "version": whole(low=1), "end": one_of("m", "s"), "dt_ns": whole(low=1000, high=10**10),
    "columns": list_of(text, most=1000), "mode": one_of("live", "lockstep"),
}, {"every": whole(low=1, high=MOST_EVERY)})


def input_columns(scene: Scene, e: str, sensor: bool) -> list[str]:
    """The columns of `inputs.bin` of the end `e`; messages axis by axis, as `rx.NAME` and `tx.NAME`."""
    axes, (hears, sends) = scene.axes, message_fields(scene, e)
    along = Integrals._fields if structure_of(scene).has.integral else ()  # of each axis, behind the law's message
    per_axis = [f"x_{e}", f"v_{e}", *["f_ext"] * sensor, "f_held"]
    operated = (*SWITCHES, "scale") if getattr(structure_of(scene), e).has_stage("operator") else ()
    policy = ["wants", "renewed", *["action"] * axes] if getattr(structure_of(scene), e).has_stage("handover") else []
    return [*_FLOATS, *operated, *policy, *[name for name in per_axis for _ in range(axes)],
            *[f"rx.{name}" for name in hears] * axes, *[f"waves.{name}" for name in along] * axes, *["index"] * axes,
            *[f"f_{e}"] * axes, *[f"tx.{name}" for name in sends] * axes, *[f"sent.{name}" for name in along] * axes]


def message_fields(scene: Scene, e: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The fields of the messages that the end `e` hears, and of those that it sends."""
    forth, back = messages(scene.laws[0], scene.dt_ns / 1e9)
    hears, sends = (back, forth) if e == "m" else (forth, back)
    return hears._fields, sends._fields


def flat(several: tuple[Any, ...]) -> list[Any]:
    """The numbers of a message, axis by axis."""
    return [*chain.from_iterable(several)]


class InputWriter:
    """Appends to both files in `folder`, `flush` by `flush`. A full disk stops it, never the loop: see `trouble`."""

    def __init__(self, scene: Scene, e: str, folder: Path, about: Mapping[str, Any]) -> None:
        """`about`: the header of the record beside it, as far as it is known."""
        self.trouble: str | None = None
        self._scene, self._e, self._folder, self._about = scene, e, folder, about
        self._files: list[BinaryIO] = []
        self._rows = bytearray()
        self._arrivals = bytearray()
        self._most = _ARRIVAL.size * MOST  # bytes of what may come until the next tick
        self._room = self._most
        self._lost = 0
        hears, _ = message_fields(scene, e)
        self._nothing = (0.0,) * (len(hears) * scene.axes)
        self._no_waves = (0.0,) * (len(Integrals._fields) * scene.axes)
        self._no_index = (float("nan"),) * scene.axes
        self._operated, self._handed = (
            getattr(structure_of(scene), e).has_stage(name) for name in ("operator", "handover"))

    def begin(self, sensor: bool) -> None:
        """Write the headers, before the first tick. `sensor`: does the end's device sense the external force."""
        columns = input_columns(self._scene, self._e, sensor)
        self._pack = Struct(f"<{len(columns)}d").pack
        for name, of in ((INPUTS, columns), (ARRIVALS, list(ARRIVAL))):
            if name == ARRIVALS and self._about.get("mode") == "lockstep":
                continue  # its packets come as often as they are asked for, and are played by a schedule
            file = (self._folder / name).open("wb")
            self._files.append(file)
            file.write(json.dumps({"version": VERSION, **self._about, "columns": of}).encode() + b"\n")
            file.flush()

    def ticked(self, k: int, session: int, inputs: tuple[Any, ...], index: tuple[float, ...] | None,
               force: tuple[float, ...], tx: tuple[Any, ...], sent: tuple[Any, ...] | None) -> None:
        """Tick k of the grid has run in the end's `session`-th session: what its tick was sent, and its answer.

        `index`: where the law's positions count from (m, per axis), if not from the device's zero.
        """
        _, x, v, touch, got, newest, rx, waves, gain, held, since, *operator = inputs
        heard = self._nothing if rx is None else rx[0] if len(rx) == 1 else flat(rx)
        answer = tx[0] if len(tx) == 1 else flat(tx)
        if sent is not None:
            heard = *heard, *(self._no_waves if waves is None else flat(waves))
            answer = *answer, *flat(sent)
        switches = operator[:3] if self._operated else []
        if self._handed:
            wants, renewed, action = operator[3:]
            switches = [*switches, wants, renewed, *action]
        self._rows += self._pack(k, since, session, got, newest, gain, *switches, *x, *v, *(touch or ()), *held, *heard,
                                 *(index or self._no_index), *force, *answer)
        self._room = len(self._arrivals) + self._most

    def arrived(self, session: int, packet: int, time_ns: int, tick: int) -> None:
        """A message of the law came, to be taken at `tick` or after it."""
        if len(self._arrivals) < self._room:
            self._arrivals += _ARRIVAL.pack(session, packet, time_ns, tick)
        else:
            self._lost += 1

    def flush(self) -> None:
        """Hand what there is to the system."""
        written = self._rows, self._arrivals
        self._rows, self._arrivals, self._room = bytearray(), bytearray(), self._most
        if self.trouble is not None:
            return
        try:
            for file, data in zip(self._files, written, strict=False):
                file.write(data)
                file.flush()
        except OSError as error:
            self.trouble = f"the record of what it was told stopped: {error.strerror or error}"

    def close(self) -> None:
        """Write the rest."""
        self.flush()
        for file in self._files:
            try:
                file.close()
            except OSError as error:
                self.trouble = self.trouble or f"the record was not closed: {error.strerror or error}"
        self._files = []
        if self._lost and self.trouble is None:
            self.trouble = (f"{self._lost} messages of the law that came are not in {ARRIVALS}: more than {MOST} came "
                            "for a tick")


class Inputs(NamedTuple):
    """The rows of `inputs.bin`, read a part at a time, and where in them each column stands."""

    header: dict[str, Any]
    rows: RecordFile
    places: dict[str, slice]  # columns of one name, and of one message, stand beside each other
    sensor: bool  # does the device sense the external force

    @property
    def every(self) -> int:
        """The end ticked at every so many ticks of the grid."""
        return int(self.header.get("every", 1))


class ArrivalTable(NamedTuple):
    """The rows of `arrivals.bin`: int64 arrays, one number for each message that came, in the order of their coming."""

    header: dict[str, Any]
    session: NDArray[np.int64]
    packet: NDArray[np.int64]
    time_ns: NDArray[np.int64]
    tick: NDArray[np.int64]


def read_inputs(folder: Path, scene: Scene, beside: Mapping[str, Any]) -> Inputs:
    """Read the inputs of the end that wrote `folder` in a run of `scene`; `beside`: the header of its record.

    Warns of rows that are cut off or damaged. Raises `Refused`.
    """
    path = folder / INPUTS
    try:
        with open_regular(path, links=False) as file:
            header = _header(file, folder, INPUTS)
            names, start = header["columns"], file.tell()
            count, rest = sound_rows(file, max(3, len(names)))
    except (OSError, Misshapen) as error:
        raise _none(folder, INPUTS, error) from error
    sensor = "f_ext" in names
    if any(header.get(key) != beside[key] for key in _SAME) or names != input_columns(scene, header["end"], sensor):
        raise Refused(f"{path} is not of the run whose record lies beside it: its scene, tick or columns are others; "
                      "give the folder as the end wrote it")
    if rest:
        _warn(path, rest, count)
    places: dict[str, slice] = {}
    for i, name in enumerate(names):
        key = name.partition(".")[0]
        places[key] = slice(places[key].start if key in places else i, i + 1)
    return Inputs(header, RecordFile(path, start, len(names), count), places, sensor)


def read_arrivals(folder: Path) -> ArrivalTable:
    """The messages that came to the end that wrote `folder`. Warns of rows that are cut off or damaged.

    Raises `Refused`. Memory goes with the size of the file.
    """
    import numpy as np

    path = folder / ARRIVALS
    try:
        with open_regular(path, links=False) as file:
            header = _header(file, folder, ARRIVALS)
            if header["columns"] != [*ARRIVAL]:
                raise Misshapen("its columns are others")
            data = file.read()
    except (OSError, Misshapen) as error:
        raise _none(folder, ARRIVALS, error) from error
    width = len(ARRIVAL)
    count = len(data) // (8 * width)
    table = np.frombuffer(data[: 8 * width * count], dtype="<i8").reshape(-1, width).astype(np.int64)
    session, packet, time_ns, tick = table.T
    sound = (np.diff(session, prepend=1) >= 0) & (packet >= 0) & (packet < MOST_TICKS)
    sound &= (np.abs(time_ns) < 1 << 62) & (tick >= 0) & (tick <= 2 * MOST_TICKS)
    if not sound.all():
        count = int(np.argmin(sound))
        _warn(path, "damaged, with a row that is no packet of a run", count)
    elif 8 * width * count < len(data):
        _warn(path, "cut off in the middle of a row, as by a killed process", count)
    return ArrivalTable(header, session[:count], packet[:count], time_ns[:count], tick[:count])


def _header(file: BinaryIO, folder: Path, name: str) -> dict[str, Any]:
    line = file.readline(LONGEST)
    if not line.endswith(b"\n"):
        raise Misshapen("its first line is no header")
    header: dict[str, Any] = parse(line)
    _HEADER(header, "its header")
    if header["version"] != VERSION:
        raise Refused(f"{folder / name} is of version {header['version']}, and this release reads version {VERSION}; "
                      "install the release that wrote it, or run again with this one")
    return header


def _none(folder: Path, name: str, error: OSError | Misshapen) -> Refused:
    why = error.strerror if isinstance(error, OSError) else error
    cure = "give the folder that a live end of this release wrote, or that of a demo"
    if name == ARRIVALS:
        cure += "; an end that went by packets (--lockstep) has none: its link is a schedule, and --link names it"
    return Refused(f"{folder} holds no {name} to run again ({why}); {cure}")


def _warn(path: Path, what: str, count: int) -> None:
    warnings.warn(f"{path} is {what}: row {count} and what came after it are lost", TruncatedRecord, stacklevel=3)
