"""Result of a run: a status with its sentence, figures, packet counts, and the trace."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from teleop.errors import NamedValues, Refused
from teleop.law import law_name
from teleop.scene.axes import AxisLabels, labels_in, labels_of
from teleop.scene.library import own_file
from teleop.scene.scene import Scene
from teleop.simulation.metrics import UNITS, finite, resolved, worked_out
from teleop.simulation.plan import Packets
from teleop.simulation.trace import blocks
from teleop.storage.files import read_bytes, replacing
from teleop.storage.folder import new_folder
from teleop.storage.strict_json import Misshapen, json_value, parse, write_document
from teleop.version import __version__

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from teleop.simulation.ending import Ending

RUNNING = "still running"  # the status of a live run that has not ended: its result is of the ticks recorded so far
strips_of: Callable[[Result], str] | None = None  # figures in a notebook; `teleop`, which may draw, sets it
LATEST = 1e9  # s, of a stored trace: the longest run with the greatest dt


def versions(*also: str) -> dict[str, str]:
    """The versions that a document says it was made by: of this package, Python, numpy, and the packages `also`."""
    versions = {"bilateral-teleop": __version__, "python": sys.version.split()[0], "numpy": np.__version__}
    if also:
        from importlib.metadata import version

        versions |= {name: version(name) for name in also}
    return versions


def head(*, status: str, sentence: str, scene: str, mode: str, parameters: Mapping[str, object], seed: int | None,
         command: Sequence[str], dt: float | None, also: Sequence[str] = ()) -> dict[str, Any]:
    """The keys that the JSON document of every command about a scene begins with; dt in s.

    Of several runs `parameters`, `seed` and `dt` say what all have in common; None where they differ.
    """
    return {"status": status, "sentence": sentence, "scene": scene, "mode": mode, "parameters": dict(parameters),
            "seed": seed, "versions": versions(*also), "command": list(command), "dt": dt}


@dataclass(frozen=True, kw_only=True, repr=False)
class Result:
    """Result of one run. `trace` maps names to arrays, one row per tick, SI units; `metrics` names to figures.

    `status` is ok, limit cycle or unstable (a swing stays or grows although nothing moves the scene any more, see
    `teleop.simulation.rest`), diverged, or of a live run stopped.
    """

    scene: str
    parameters: Mapping[str, object]
    seed: int
    mode: str  # virtual, lockstep or live
    status: str
    sentence: str
    ticks: int
    dt: float
    run_time: float | None  # s
    metrics: Mapping[str, float]
    packets: Mapping[str, Packets]
    notes: Sequence[str] = ()
    extra: Mapping[str, object] = field(default_factory=dict)
    trace: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)  # seq_m and seq_s: whole numbers
    path: Path | None = None

    def __repr__(self) -> str:
        """Scene, law and status in one line."""
        law = law_with_gains(self.parameters.get("law"))
        return f"Result({self.scene}, law {law}, {self.mode}: {self.status}, {self.ticks} ticks of {self.dt:g} s)"

    def _repr_html_(self) -> str:
        """Strips over time and a table for a notebook: how the run ended, its figures with units, its notes."""
        from html import escape

        rows = [("status", f"{self.status}: {self.sentence}"), ("law", law_with_gains(self.parameters.get("law"))),
                *[(name, f"{value:.4g} {self.labels.unit(UNITS[name])}".removesuffix(" 1"))
                  for name, value in resolved(self.metrics).items()],
                *[("note", note) for note in self.notes]]
        cells = "".join(f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in rows)
        table = f"<table><caption>{escape(self.scene)}, {self.mode}, seed {self.seed}</caption>{cells}</table>"
        return strips_of(self) + table if strips_of is not None and self.trace else table

    @property
    def labels(self) -> AxisLabels:
        """Names and units of the axes, as the scene gives them."""
        return labels_in(self.extra)

    @classmethod
    def make(
        cls, scene: Scene, ending: Ending, *, seed: int, mode: str, ticks: int, run_time: float | None,
        trace: Mapping[str, Any], packets: Mapping[str, Packets], extra: Mapping[str, object],
    ) -> Result:
        """The result of a run of `scene`, its metrics worked out from the trace; a note names those not finite."""
        every = worked_out(scene, trace) | dict(ending.at_rest)
        lost = ", ".join(sorted(every.keys() - finite(every).keys()))
        notes = [*ending.notes, *[f"not finite, and so left out of the metrics: {lost}"] * bool(lost)]
        return cls(
            scene=scene.name, parameters=parameters(scene), seed=seed, mode=mode, status=ending.status,
            sentence=ending.sentence, ticks=ticks, dt=scene.dt_ns / 1e9, run_time=run_time,
            metrics=NamedValues("metric", finite(every)), packets=packets,
            notes=tuple(notes), extra={**labels_of(scene).document(), **extra}, trace=trace,
        )

    def summary(self, command: Sequence[str] = ()) -> dict[str, Any]:
        """Document for summary.json: a number that is not finite is the text "inf", "-inf" or "nan"."""
        labels = self.labels
        summary: dict[str, Any] = json_value({
            **head(status=self.status, sentence=self.sentence, scene=self.scene, mode=self.mode,
                   parameters=self.parameters, seed=self.seed, command=command, dt=self.dt),
            "ticks": self.ticks, "run_time": self.run_time,
            "metrics": {k: {"value": v, "unit": labels.unit(UNITS[k])} for k, v in self.metrics.items()},
            "packets": {way: asdict(counts) for way, counts in self.packets.items()},
            "notes": list(self.notes), **self.extra,
        })
        return summary

    def save(self, folder: Path, command: Sequence[str] = ()) -> Result:
        """Write summary.json and trace.npz as the new `folder`, all of it or nothing."""
        with new_folder(folder) as new:
            self.write(new.inside, command)
        return replace(self, path=folder)

    def write(self, folder: Path, command: Sequence[str] = ()) -> None:
        """Write the files of the run into a folder that is there, each in the place of one that it may hold."""
        summary = self.summary(command)
        write_npz(folder / "trace.npz", self.trace)
        write_document(folder / "summary.json", summary)


def write_npz(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write arrays as the file `path`, whole or not at all."""
    with replacing(path) as file:
        write_arrays(file, arrays)


def write_arrays(file: BinaryIO, arrays: Mapping[str, Any]) -> None:
    """Write arrays to a file as `numpy.savez` does, with one of them in memory at a time."""
    from zipfile import ZIP_STORED, ZipFile

    with ZipFile(file, "w", ZIP_STORED, allowZip64=True) as archive:
        for name in arrays:
            array = np.ascontiguousarray(arrays[name])
            with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
                np.lib.format.write_array_header_1_0(entry, np.lib.format.header_data_from_array_1_0(array))
                for block in blocks(len(array)):
                    entry.write(array[block].data)


def parameters(scene: Scene) -> dict[str, object]:
    """The scene's knobs as JSON can hold them; the law by its name and numbers, one of the user's own by its file too.

    Of that file there are its path and the first 12 digits of its SHA-256. A number of the law that differs between the
    axes is a list with that of each.
    """
    plain: dict[str, object] = {}
    laws = scene.laws
    for key, value in {**scene.knobs, "law": scene.law}.items():
        if key == "law" and is_dataclass(laws[0]):
            user_file = own_file(type(laws[0]))
            source = {} if user_file is None else {"file": str(user_file.path), "sha256": user_file.digest}
            numbers = {f.name: [getattr(law, f.name) for law in laws] for f in fields(laws[0])}
            plain[key] = {"name": law_name(laws[0]), **source, **{
                name: each[0] if each.count(each[0]) == len(each) else each for name, each in numbers.items()}}
        else:
            plain[key] = value if isinstance(value, int | float | str | list | tuple | None) else str(value)
    return plain


def law_with_gains(law: object) -> str:
    """The law as `parameters` has it, in one line.

    >>> law_with_gains({"name": "wave", "b": 20.0, "K": [1000.0, 500.0]})
    'wave(b=20, K=(1000, 500))'
    """
    if not isinstance(law, Mapping):
        return str(law)
    gains = ", ".join(f"{name}={_gain(value)}" for name, value in law.items() if name not in ("name", "file", "sha256"))
    return f"{law['name']}({gains})"


def _gain(value: object) -> str:
    if isinstance(value, list | tuple):
        return f"({', '.join(map(_gain, value))})"
    return f"{value:g}" if isinstance(value, int | float) else str(value)


def read_result(folder: Path) -> Result:
    """The run whose files lie complete in `folder`, its trace as arrays. Raises `Refused` if there is none.

    The folder may be of unknown origin: nothing in it is run, no link is followed, and memory goes with the size of its
    files. A live run that goes on, or whose process was killed, is read by `teleop.load_result`.
    """
    try:
        return _read(folder)
    except Exception as error:  # no folder, no JSON, no zip, cut short, of another version
        raise incomplete(folder, error) from error


def incomplete(folder: Path, error: Exception) -> Refused:
    """Sentence on a folder whose run cannot be read because of `error`."""
    return Refused(f"{folder} holds no complete run ({_why(error)}); give the folder that `teleop run` printed")


def _why(error: Exception) -> str:
    """Sentence on a fault of a stored run, with the file that has it where that is known."""
    if isinstance(error, OSError) and error.strerror:
        return f"{Path(str(error.filename)).name}: {error.strerror}" if error.filename else error.strerror
    return str(error) if isinstance(error, Misshapen) else f"{type(error).__name__}: {error}"


def has_record(folder: Path) -> bool:
    """True if there is any of `records_in`."""
    return next(records_in(folder), None) is not None


def records_in(folder: Path) -> Iterator[Path]:
    """The records of live ends in `folder`, in the folders of it, and in those below them."""
    return (path for level in ("", "*/", "*/*/") for path in folder.glob(f"{level}record.bin"))


def stored_summary(folder: Path) -> dict[str, Any]:
    """Read the summary.json in `folder` and check its shape. Raises `OSError` or `Misshapen`."""
    from teleop.simulation.summary_shape import RUN

    summary: dict[str, Any] = parse(read_bytes(folder / "summary.json", links=False))
    RUN(summary, "summary.json")
    return summary


def _read(at: Path) -> Result:
    from teleop.storage.archive import read_arrays

    summary = stored_summary(at)
    trace = read_arrays(at / "trace.npz", summary["ticks"])
    t = None if "t" not in trace else np.asarray(trace["t"], dtype=float)
    if t is None or t.ndim != 1 or not (np.isfinite(t).all() and (np.diff(t) > 0.0).all() and
                                         (np.abs(t) <= LATEST).all()):
        raise Misshapen(f"trace.npz has no times t that grow from row to row, up to {LATEST:g} s")
    known = {"status", "sentence", "scene", "mode", "parameters", "seed", "dt", "ticks", "run_time"}
    rest = {"versions", "command", "metrics", "packets", "notes"}
    return Result(
        **{key: summary[key] for key in known},
        metrics=NamedValues("metric", {key: entry["value"] for key, entry in summary["metrics"].items()}),
        packets={way: Packets(**counts) for way, counts in summary["packets"].items()},
        notes=tuple(summary["notes"]), extra={k: v for k, v in summary.items() if k not in known | rest},
        trace=NamedValues("column of this run", trace), path=at,
    )
