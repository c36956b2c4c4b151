"""The parts of what a page has shown, a folder for each turn, and their index.

    runs/SCENE-page-N/page.json      which parts there are, with the knobs of each
    runs/SCENE-page-N/01/master      what the master left of the first part
    runs/SCENE-page-N/01/slave
    runs/SCENE-page-N/02/...
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from teleop.errors import Refused
from teleop.live.records.end_result import NAMES
from teleop.live.records.merge import merge
from teleop.live.records.record import FILE
from teleop.scene.loading import load_scene
from teleop.scene.scene import both_ends
from teleop.simulation.result import Result
from teleop.storage.strict_json import write_document

INDEX = "page.json"
VERSION = 1


class Part(NamedTuple):
    """One part. `k`: its first tick; `why`: start, turn, again, or lost, when a process had ended."""

    folder: str
    knobs: dict[str, str]
    k: int
    why: str


class Parts:
    """Those in `folder`. `about`: scene, seed and command, as the index has them."""

    def __init__(self, folder: Path, about: Mapping[str, Any]) -> None:
        self.folder = folder
        self._about = {"version": VERSION, **about}
        self._parts: list[Part] = []

    def __len__(self) -> int:
        return len(self._parts)

    @property
    def ran(self) -> bool:
        """True if there is anything to keep: an end has begun a record."""
        return any((end / FILE).is_file() for part in self._parts for end in self._ends(part).values())

    @property
    def newest(self) -> dict[str, Path]:
        """The folders of the two ends, m and s, of the newest part."""
        return self._ends(self._parts[-1])

    def begin(self, knobs: Mapping[str, str], k: int, why: str) -> dict[str, Path]:
        """Another part, from tick k on; the folders that its two ends are to make. Raises `OSError`: there is none."""
        self._parts.append(Part(f"{len(self._parts) + 1:02d}", dict(knobs), k, why))
        try:
            self._write()
        except OSError:
            self._parts.pop()
            raise
        return self.newest

    def began(self, k: int) -> None:
        """The newest part began at tick k."""
        self._parts[-1] = self._parts[-1]._replace(k=k)
        self._write()

    def merge_all(self, name: str, command: Sequence[str], say: Callable[[str], None],
                  stop: Callable[[], bool]) -> list[Result]:
        """Put the two ends of each part of scene `name` together and write what came of it, until `stop`.

        What cannot be put together is told by `say`, and the others go on.
        """
        done = []
        for part in self._parts:
            ends, folder = self._ends(part), self.folder / part.folder
            if stop():
                say(f"interrupted: `teleop report {folder}` puts the two ends of the rest together")
                break
            there = [end for end in ends.values() if (end / FILE).is_file()]
            if len(there) < len(ends):
                if there:
                    say(f"part {part.folder}: only the {there[0].name} came to it, so there is nothing to put together")
                continue
            try:
                scene = both_ends(load_scene(name, **part.knobs))
                result = merge(scene, ends["m"], ends["s"])
                result.write(folder, command)
            except (Refused, OSError) as error:
                say(f"part {part.folder}: {error}")
            else:
                done.append(replace(result, path=folder))
        return done

    def _ends(self, part: Part) -> dict[str, Path]:
        return {e: self.folder / part.folder / name for e, name in NAMES.items()}

    def _write(self) -> None:
        write_document(self.folder / INDEX, {**self._about, "parts": [part._asdict() for part in self._parts]})
