"""What a run in virtual time leaves behind: the rows of both ends."""

from __future__ import annotations

from typing import Any

from teleop.simulation.tick import row
from teleop.stages.end import End, Recorder, Run


class RowRecorder(Recorder):
    """A row of each end at every tick, handed to the two functions that the run is asked with."""

    rows_m: Any
    rows_s: Any

    def begin(self, run: Run, asked: Any, size: int) -> None:
        self.rows_m = asked[0]
        if run.has.slave:
            self.rows_s = asked[1]

    def step(self, run: Run, k: int) -> None:
        self.rows_m(row(run.m))
        if run.has.slave:
            self.rows_s(row(run.s))

    def told(self, run: Run, ticks: int, complete: bool) -> Any:
        """Ticks that ran, ticks with too many contact events, where it left its bounds, and the inner states."""
        ends = None if complete else tuple([places(e) for e in run.ends])
        return ticks, run.capped if run.has.slave else 0, ends, (inner(run.m), inner(run.s))


def places(e: End) -> tuple[float, ...]:
    """Where an end is."""
    return tuple([a.x for a in e.axes])


def inner(e: End) -> tuple[Any, ...]:
    """The inner states of an end's bodies."""
    return tuple([a.z for a in e.axes]) if e.has.inner else ()
