"""Runs to export: in virtual time, of live ends whose records are written here row by row, and in parts."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest

from teleop import load_scene, run
from teleop.live.records.reader import OWN, header_columns
from teleop.live.records.record import RecordWriter
from teleop.protocol.guard import Event
from teleop.storage.folder import claim


class LiveEnd:
    """An end of `canonical` that is running: it holds its folder, and writes rows drawn from a seed.

    That it is closed says no more than that its process is gone: it has left no summary.
    """

    def __init__(self, folder: Path, e: str, ticks: Iterable[int], *, knobs: dict[str, str] | None = None,
                 events: Iterable[Event] = (), scene: str = "canonical") -> None:
        knobs = {"playout": "integral", **(knobs or {})}
        self.scene, self.e, self.claim = load_scene(scene, **knobs), e, claim(folder)
        about = {"scene": scene, "knobs": knobs, "seed": 0, "mode": "live", "every": 1}
        self.writer = RecordWriter(self.scene, e, folder, about)
        self.writer.begin("bodies")
        for event in events:
            self.writer.note(event)
        self.add(ticks)

    def add(self, ticks: Iterable[int]) -> None:
        """Write the rows of these ticks; they are on the disk."""
        width = len(header_columns(self.scene, self.e, "bodies")) - len(OWN)
        for k in ticks:
            drawn = random.Random(k)
            row = tuple([drawn.uniform(-0.01, 0.01) for _ in range(width)])
            self.writer.add(k, drawn.randrange(10**5), k - 50, row)
        self.writer.flush()

    def close(self) -> None:
        self.writer.close()
        self.claim.close()


@pytest.fixture(scope="session")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """`stored("canonical")`: the folder of a run of 0.3 s in virtual time; shared, and not to be written to."""
    made: dict[str, Path] = {}

    def make(scene: str) -> Path:
        if scene not in made:
            made[scene] = tmp_path_factory.mktemp("stored") / scene
            run(load_scene(scene, duration=0.3)).save(made[scene], ["teleop", "run", scene])
        return made[scene]

    return make


@pytest.fixture
def demo(tmp_path: Path) -> Path:
    """The folder of a live run of both ends that were killed: 400 ticks of the master, 390 of the slave."""
    told = [Event(0, "met", "session 1"), Event(120, "safe", "silence: no fresh packet for 0.8 s"),
            Event(300, "released", "fresh packets for 0.05 s")]
    for e, name, ticks, events in (("m", "master", 400, told), ("s", "slave", 390, told[:1])):
        LiveEnd(tmp_path / "demo" / name, e, range(ticks), events=events).close()
    return tmp_path / "demo"


@pytest.fixture
def turned_run(tmp_path: Path) -> Path:
    """The folder of a live run that was turned twice; the last time its ends were started anew, from tick 0 on."""
    folder = tmp_path / "turned"
    for number, ticks, law in ((1, range(200), "wave"), (2, range(220, 500), "tdpa"), (3, range(100), "wave")):
        for e, name in (("m", "master"), ("s", "slave")):
            LiveEnd(folder / f"{number:02d}" / name, e, ticks, knobs={"law": law},
                     events=[Event(ticks.start, "met", f"session {number}")]).close()
    return folder
