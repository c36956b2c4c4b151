"""A stand-in of slave, channel and master, which answers at once and writes records of a few rows."""

from __future__ import annotations

import json
import shutil
import struct
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from teleop.live.records.reader import FILE

COLUMNS = {"m": ["k", "late_ns", "seq", "x_m", "f_m"], "s": ["k", "late_ns", "seq", "x_s", "f_s"]}
DELAY = 20  # ticks, of the link each way


class FakeRig:
    """A rig whose master follows the hand, and whose slave follows that 20 ms later, on the clock `now` (s).

    `takes(knobs)`: s from a turn's order to full force.
    """

    def __init__(self, folder: Path, now: Callable[[], float], takes: Callable[[Mapping[str, str]], float]) -> None:
        self._folder, self._now, self._takes = folder, now, takes
        self.lost, self.is_recorded = False, True
        self.live: dict[str, dict[str, Any]] = {"m": {"loss": 0.0}, "s": {"loss": 0.0}}
        self.done: list[tuple[str, Any]] = []  # what was asked of it, in order
        self.hand: list[tuple[float, float]] = [(0.0, 0.0)]  # when the hand was moved, and where
        self._ready_at, self._part = 0.0, 0
        self.folders: dict[str, Path] = {}

    def begin(self) -> None:
        self.done.append(("begin", None))
        self.lost = False

    def turn(self, knobs: Mapping[str, str], home: Sequence[float]) -> None:
        self.done.append(("turn", dict(knobs)))
        self.write()
        self._ready_at, self._part = self._now() + self._takes(knobs), self._part + 1
        self.hand.append((self._now(), home[0]))
        self.folders = {e: self._folder / f"{self._part:04d}" / name for e, name in (("m", "master"), ("s", "slave"))}

    @property
    def is_ready(self) -> bool:
        return self._now() >= self._ready_at

    def let_go(self) -> None:
        self.done.append(("let go", None))
        self.write()

    def end_record(self) -> None:
        self.done.append(("end", None))

    def steer(self, to: Sequence[float] | None) -> None:
        if to is not None:
            self.hand.append((self._now(), to[0]))

    def drop(self, folders: Sequence[Path]) -> None:
        for folder in folders:
            shutil.rmtree(folder.parent, ignore_errors=True)

    @property
    def tick(self) -> int:
        return round(1e3 * self._now())

    def at(self, k: int) -> float:
        """Where the hand is at a tick, m."""
        return next(to for since, to in reversed(self.hand) if k >= 1e3 * since or since == 0.0)

    def places(self) -> dict[str, Any]:
        k = self.tick
        return {"hand": (self.at(k),), "master": (self.at(k),), "slave": (self.at(k - DELAY),)}

    def path(self, e: str, count: int) -> list[Any]:
        return [(self.at(k - DELAY),) for k in range(self.tick - count + 1, self.tick + 1)]

    def write(self) -> None:
        """Write the records of the newest turn, of the last three seconds."""
        for e, folder in self.folders.items():
            folder.mkdir(parents=True, exist_ok=True)
            header = {"end": e, "dt_ns": 1_000_000, "axes": 1, "scene": "hard_wall", "knobs": {}, "seed": 0,
                      "mode": "live", "force": "sensor", "columns": COLUMNS[e]}
            rows = b"".join(struct.pack("<5d", k, 0.0, max(-1, k - DELAY), self.at(k - DELAY * (e == "s")),
                                        100.0 * self.at(k)) for k in range(max(0, self.tick - 3000), self.tick + 1))
            (folder / FILE).write_bytes(json.dumps(header).encode() + b"\n" + rows)
