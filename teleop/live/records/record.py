"""The record that a live end appends to as it goes: flat, so that what is on disk can be read at any time.

One line of JSON (the header), then rows of little-endian float64: tick, lateness (ns), packet played,
and the end's columns. A row cut off at the end is left out when it is read, with a warning. What happened, and at which
tick, goes to a file beside it as it happens, one line of JSON each.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from struct import Struct
from typing import Any, BinaryIO

from teleop.errors import Refused
from teleop.live.records.end_result import NAMES
from teleop.live.records.inputs import InputWriter
from teleop.live.records.reader import (
    FILE,
    IDLE,
    OWN,
    header_columns,
    law_entry,
)
from teleop.protocol.guard import Event
from teleop.scene.axes import labels_of
from teleop.scene.scene import Scene
from teleop.simulation.summary_shape import EVENT
from teleop.simulation.trace import ForceSource
from teleop.storage.files import read_bytes
from teleop.storage.folder import Claim, claim
from teleop.storage.strict_json import Misshapen, parse_line

EVENTS = "events.jsonl"
NEWEST = 4000  # rows of the file of the newest rows, which then begins anew
EVERY = 250  # rows between two writes, at most
EVERY_NS = 250_000_000  # and so much time, by the scene's clock


class RecordWriter:
    """Appends an end's rows to `folder/record.bin`. A full disk stops the record, never the loop."""

    def __init__(self, scene: Scene, e: str, folder: Path, about: Mapping[str, Any], every: int = EVERY) -> None:
        """`about` says which run this is, as `merge` reads it: scene, knobs, seed, mode, command.

        `every`: rows between two writes at most, for whoever follows the record as it grows.
        """
        self.trouble: str | None = None
        self._about = {"end": e, "dt_ns": scene.dt_ns, "axes": scene.axes, **about, **labels_of(scene).document(),
                       **law_entry(scene)}
        self._scene, self._e, self._folder = scene, e, folder
        self._rows = bytearray()
        self._pack: Callable[..., bytes] | None = None  # of one row, whose width the first one tells
        self._count = 0
        self._file: BinaryIO | None = None
        self._header = b""
        self._idle = False  # the record is whole, and the newest rows go to `IDLE`
        self._all = max(1, min(EVERY, EVERY_NS // scene.dt_ns))
        self._every = min(every, self._all)
        self.inputs = InputWriter(scene, e, folder, self._about)

    def begin(self, force: ForceSource) -> None:
        """Write the header, before the first tick. `force`: where the end's external force is from."""
        header = {**self._about, "force": force, "columns": header_columns(self._scene, self._e, force)}
        self._header = json.dumps(header).encode() + b"\n"
        self._file = (self._folder / FILE).open("wb")
        self._file.write(self._header)
        self._file.flush()
        self.inputs.begin(force == "sensor")

    def add(self, k: int, late_ns: int, played: int, row: tuple[float, ...]) -> None:
        """Append the row of one tick."""
        if self._pack is None:
            self._pack = Struct(f"<{len(OWN) + len(row)}d").pack
        self._rows += self._pack(k, late_ns, played, *row)  # at once: floats kept until the next write cost cache
        self._count += 1
        if self._count % self._every == 0:
            if self._idle and self._count >= NEWEST:
                self._begin_idle()
            if self._count // self._every % (self._all // self._every):
                self._flush_rows()  # of what it was told nobody follows the record
            else:
                self.flush()

    def idle(self) -> None:
        """Write no more of the run; the newest rows alone stay to be followed, in the file `IDLE` beside the record."""
        if not self._idle and self._file is not None:
            self.close()
            self._idle, self._file = True, None
            with suppress(OSError):
                self._file = (self._folder / IDLE).open("wb")
            self._begin_idle()

    def _begin_idle(self) -> None:
        """Begin the file of the newest rows anew; without it nobody can look on, and no more is lost."""
        self._rows, self._count = bytearray(), 0
        try:
            if self._file is not None:
                self._file.seek(0)
                self._file.truncate()
                self._file.write(self._header)
                self._file.flush()
        except OSError:
            self._file = None

    def note(self, event: Event) -> None:
        """Write down that something has happened; on the disk at once."""
        if self.trouble is not None:
            return
        try:
            with (self._folder / EVENTS).open("a") as file:
                file.write(json.dumps(event.document()) + "\n")
        except OSError as error:
            self.trouble = f"the record of events stopped at row {self._count}: {error.strerror or error}"

    def flush(self) -> None:
        """Hand what there is to the system."""
        self.inputs.flush()
        self._flush_rows()

    def _flush_rows(self) -> None:
        rows, self._rows = self._rows, bytearray()
        if self.trouble is not None or self._file is None:
            return
        try:
            self._file.write(rows)
            self._file.flush()
        except OSError as error:
            self.trouble = f"the record stopped at row {self._count}: {error.strerror or error}"

    def close(self) -> None:
        """Write the rest."""
        self.flush()
        try:
            if self._file is not None:
                self._file.close()
        except OSError as error:
            self.trouble = self.trouble or f"the record was not closed: {error.strerror or error}"
        self.inputs.close()
        if self._idle:
            with suppress(OSError):
                (self._folder / IDLE).unlink()


def read_events(folder: Path) -> list[dict[str, Any]]:
    """Read the events of the end whose record is in `folder`, without a line that was cut off."""
    try:
        lines = read_bytes(folder / EVENTS, links=False).splitlines()
    except OSError:
        return []
    events = []
    for line in lines:
        with suppress(Misshapen):
            event = parse_line(line)
            EVENT(event, "event")
            events.append(event)
    return events


def check_one_run(folders: Mapping[str, Path], headers: Mapping[str, Mapping[str, Any]], keys: Iterable[str]) -> None:
    """Refuse folders of m and s that were not of one run, by these keys of their headers and by their events."""
    for e, folder in folders.items():
        if headers[e]["end"] != e:
            raise Refused(f"{folder} is of a {NAMES[headers[e]['end']]}; give the master's folder first, then the "
                          "slave's")
    met = [{event["why"] for event in read_events(folder) if event["what"] == "met"} for folder in folders.values()]
    if any(headers["m"][key] != headers["s"][key] for key in keys) or (all(met) and not met[0] & met[1]):
        raise Refused(f"{folders['m']} and {folders['s']} are not the two ends of one run; give two that ran together")


class RunFolder:
    """The folder that a live run writes into, `path`; it is gone again in the end unless it was told to be kept."""

    def __init__(self, claimed: Claim) -> None:
        self._claimed, self._is_kept = claimed, False

    @property
    def path(self) -> Path:
        """The folder."""
        return self._claimed.path

    def keep(self) -> None:
        """There is something in it to keep."""
        self._is_kept = True

    def go_on(self, claimed: Claim) -> None:
        """Go on in another folder; the one before is whole, and is kept."""
        self._claimed.close()
        self._claimed, self._is_kept = claimed, False

    def close(self) -> None:
        """Remove it if nothing is to be kept, and let go of it."""
        if not self._is_kept:
            self._claimed.drop()
        self._claimed.close()


@contextmanager
def fresh_folder(out: Path | str | None, stem: str = "run") -> Iterator[RunFolder]:
    """The folder of a live run, claimed as `teleop.storage.folder.claim` does.

    It cannot be written beside and moved as a whole: what a killed process leaves has to be found.
    """
    folder = RunFolder(claim(out, stem))
    try:
        yield folder
    finally:
        folder.close()
