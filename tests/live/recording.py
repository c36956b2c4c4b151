"""Records as live ends leave them: written row by row; of two processes on a virtual clock, without sockets."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from teleop import Scene, load_scene
from teleop.live.records.record import RecordWriter
from teleop.protocol.guard import Event
from teleop.simulation.structure import columns
from tests.teleop.protocol.virtual_clock import World


def still(k: int) -> tuple[int, int, float]:
    """What a row has of tick k: how late (ns), the packet, and each number of it."""
    return 1000, k - 5 if k >= 5 else -1, 1e-3


def record_of(folder: Path, e: str = "m", ticks: Iterable[int] = (), *, events: Iterable[Event] = (),
              force: Any = "bodies", row: Callable[[int], tuple[int, int, Any]] = still, duration: str = "1.0",
              **knobs: Any) -> RecordWriter:
    """A record of an end of hard_wall, open yet, with a row at each of these ticks; `row`: see `still`."""
    folder.mkdir(parents=True, exist_ok=True)
    typed = {"duration": duration, **knobs}
    scene = load_scene("hard_wall", **typed)
    about = {"scene": "hard_wall", "knobs": typed, "seed": 0, "mode": "live", "command": []}
    recorder = RecordWriter(scene, e, folder, about)
    recorder.begin(force)
    for event in events:
        recorder.note(event)
    add_rows(recorder, ticks, row, width=len(columns(scene, e, {"sensor": True, "unknown": False}.get(force))))
    return recorder


def add_rows(recorder: RecordWriter, ticks: Iterable[int], row: Callable[[int], tuple[int, int, Any]] = still, *,
             width: int = 0) -> None:
    width = width or len(columns(recorder._scene, recorder._e))
    for k in ticks:
        late, packet, numbers = row(k)
        recorder.add(k, late, packet, numbers if isinstance(numbers, tuple) else (numbers,) * width)


@dataclass
class Recording(World):
    """One that is started anew begins another record, below `out`."""

    out: Path = Path()
    writers: list[tuple[Path, RecordWriter, int]] = field(default_factory=list)  # and the rows that were there before

    def start(self, e: str, *, scene: Scene | None = None) -> None:
        super().start(e, scene=scene)
        folder = self.out / f"{e}{len(self.writers)}"
        folder.mkdir()
        about = {"scene": "canonical", "knobs": {}, "seed": 0, "mode": "live", "every": self.every[e]}
        writer = RecordWriter(self.scene, e, folder, about)
        writer.begin("bodies")
        self.end(e).witness = writer.inputs
        self.writers.append((folder, writer, len(self.done[e])))

    def folders(self) -> list[tuple[Path, str]]:
        """Write the rows of each process; its folder, and which end it was."""
        told = []
        for i, (folder, writer, since) in enumerate(self.writers):
            e = folder.name[0]
            until = next((at for other, _, at in self.writers[i + 1 :] if other.name[0] == e), len(self.done[e]))
            for done in self.done[e][since:until]:
                writer.add(done.k, 0, done.played, done.row)
            writer.close()
            told.append((folder, e))
        return told
