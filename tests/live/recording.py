"""Two processes on a virtual clock that leave records, as live ends do: the same at every run, without sockets."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from teleop.live.records.record import RecordWriter
from teleop.scene.scene import Scene
from tests.teleop.protocol.virtual_clock import World


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
