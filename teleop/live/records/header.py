"""What a live end's record says of itself, and which of its rows can be what it says; see `record`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, BinaryIO

from teleop.errors import Refused
from teleop.protocol.manifest import MOST_EVERY
from teleop.scene.axes import MOST_AXES
from teleop.scene.axis_labels import SHAPES
from teleop.scene.library import own_file
from teleop.scene.scene import MOST_TICKS, Scene
from teleop.simulation.structure import SENSED, columns
from teleop.simulation.summary_shape import MOST_SEED
from teleop.simulation.trace import ForceSource
from teleop.storage.strict_json import Misshapen, each, named, one_of, parse, record, text, whole

OWN = ("k", "late_ns", "seq")  # columns before the end's
LAW = "law_sha256"  # of a law in a file of the user's own: the first digits of that of its content, as it ran
LONGEST = 1 << 20  # bytes of a header
MOST_COLUMNS = 100 * MOST_AXES
_BLOCK = 4096  # rows that are looked at together
_LARGEST = float(1 << 53)  # a whole number that a float holds exactly
_HEADER = record({
    "end": one_of("m", "s"), "dt_ns": whole(low=1000, high=10**10), "axes": whole(low=1, high=MOST_AXES), "scene": text,
    "knobs": named(text), "seed": whole(low=0, high=MOST_SEED), "mode": one_of("live", "lockstep"),
    "columns": each(text, most=MOST_COLUMNS),
}, {"every": whole(low=1, high=MOST_EVERY), "command": each(text), "force": one_of("sensor", "bodies", "unknown"),
    LAW: text, **SHAPES})


def header_columns(scene: Scene, e: str, force: ForceSource) -> list[str]:
    """The columns of the record of the end `e`, each once per axis where it has axes."""
    found = list(OWN)
    for name in columns(scene, e, force == "sensor"):
        found += [name.removesuffix("@")] * (scene.axes if "@" in name else 1)
    return found


def own_law(scene: Scene) -> dict[str, str]:
    """What a header says of a law in a file of the user's own; nothing of one that comes with a package."""
    own = own_file(type(scene.laws[0]))
    return {} if own is None else {LAW: own.digest}


def read_header(file: BinaryIO) -> dict[str, Any]:
    """The first line of a record, which leaves `file` at its first row. Raises `Misshapen`."""
    line = file.readline(LONGEST)
    if not line.endswith(b"\n"):
        raise Misshapen("its first line is no header")
    header: dict[str, Any] = parse(line)
    _HEADER(header, "its header")
    if len(header["columns"]) <= len(OWN):
        raise Misshapen("its header names no column")
    if "force" not in header:  # of a release that did not say whose device it was
        header["force"] = "sensor" if SENSED[header["end"]] in header["columns"] else "unknown"
    return header


def sound_rows(file: BinaryIO, width: int) -> tuple[int, str]:
    """How many rows from here on can be ticks of a run, and why the rest cannot: what is left out of the record.

    A row can be one if its tick is whole and later than the one before, its lateness and its packet are numbers. What
    a machine without power left unwritten, or others wrote, ends the record there, before any room is made for it.
    """
    import numpy as np

    count, last = 0, -1.0
    while block := file.read(8 * width * _BLOCK):
        whole = len(block) // (8 * width)
        table = np.frombuffer(block[: 8 * width * whole], dtype="<f8").reshape(-1, width)
        ticks, late, played = table[:, 0], table[:, 1], table[:, 2]
        with np.errstate(invalid="ignore"):
            sound = (np.diff(ticks, prepend=last) > 0.0) & (ticks == np.floor(ticks)) & (ticks < MOST_TICKS)
            sound &= (np.abs(late) < _LARGEST) & (np.abs(played) < _LARGEST) & (played == np.floor(played))
        if not sound.all():
            return count + int(np.argmin(sound)), "damaged, with a row that is no tick of a run"
        count += whole
        if whole * 8 * width < len(block):
            return count, "cut off in the middle of a row, as by a killed process"
        last = ticks[-1]
    return count, ""


def check_fits(scene: Scene, header: dict[str, Any], ticks: Sequence[int], folder: object) -> None:
    """Refuse a record that cannot be of a run of `scene`: of another law or other columns, or with ticks beyond it."""
    if LAW in header and own_law(scene) != {LAW: header[LAW]}:
        raise Refused(f"the file of the law was edited since the run in {folder}, and a summary would tell of a law "
                      "that did not run; put back the file as it was")
    own = (scene.dt_ns, scene.axes, header_columns(scene, header["end"], header["force"]))
    if own != (header["dt_ns"], header["axes"], header["columns"]):
        raise Refused(f"the record in {folder} is not of the scene {scene.name} as it is here: its tick, axes or "
                      "columns are others; install the release that wrote it, or give another folder")
    if len(ticks) and ticks[-1] >= scene.ticks:
        raise Refused(f"the record in {folder} has a tick {ticks[-1]}, and its run has the ticks 0 to "
                      f"{scene.ticks - 1}; the file is damaged: give another folder")
