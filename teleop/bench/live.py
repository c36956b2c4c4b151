"""The cost of a live run: the lateness of its ticks beside a C loop on a timerfd, and its share of a core.

The C loop runs at the same time and is scheduled as the ends are. With `busy` a loop that never sleeps computes on each
core meanwhile, scheduled as all programs are, and each round has a second run, without real-time scheduling.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from teleop.bench.timing import compiled, reason
from teleop.live.process.realtime import PRIORITY
from teleop.scene.library import ROOT

Row = tuple[str, str, str]
SECONDS = 10
START_S = 1.0  # for the processes to start, before the C loop does
QUANTILES = {"p50": "median", "p99": "99 %", "p100": "most"}


class Alone(NamedTuple):
    """Figures of the C loop, by itself: lateness, us; share of a core; its priority under SCHED_FIFO, or 0."""

    p50: float
    p99: float
    cpu: float
    p100: float
    priority: float


class Round(NamedTuple):
    """Figures of a demo, and of the C loop beside it if there is one."""

    ends: dict[str, dict[str, Any]]  # the summaries of "master" and "slave"
    c: Alone | None


def live(rounds: int, *, busy: bool = False) -> list[Row]:
    """Rows of (what, measured, asked): medians over `rounds` demos of 10 s, the C loop running beside each."""
    measured: dict[bool, list[Round]] = {True: [], **({False: []} if busy else {})}
    with TemporaryDirectory() as name:
        folder = Path(name)
        program = compiled("timing", folder)
        for i in range(rounds):
            for realtime, runs in measured.items():
                with computing() if busy else computing(()):
                    runs.append(_round(folder / f"{i}-{realtime}", program, realtime=realtime))
    return [row for realtime, runs in measured.items() for row in rows(runs, realtime=realtime, busy=busy)]


def rows(runs: Sequence[Round], *, realtime: bool, busy: bool) -> list[Row]:
    """The rows of runs that were asked for alike."""
    which = "" if realtime else "--no-realtime, "
    lines: list[Row] = []
    for end in ("master", "slave"):
        for quantile, what in QUANTILES.items():
            late = [run.ends[end]["late_us"][quantile] for run in runs]
            ratios = [us / getattr(run.c, quantile) for us, run in zip(late, runs, strict=True) if run.c is not None]
            bound = "; asked: at most 1.5" if quantile != "p100" and realtime else ""
            lines.append((f"{which}{end}: tick late by, {what}", f"{median(late):.0f} us",
                         f"{median(ratios):.2f} times C{bound}" if ratios else ""))
        lines.append((f"{which}{end}: share of a core", f"{median(run.ends[end]['cpu'] for run in runs) * 100:.1f} %",
                     "asked: at most 10" if realtime and not busy else ""))
        shares = [run.ends[end]["cpu"] / run.c.cpu for run in runs if run.c is not None]
        if shares:
            lines.append((f"{which}{end}: its share over that of C", f"{median(shares):.1f} times",
                          "asked: at most 6" if realtime and not busy else ""))
        skipped = [run.ends[end]["skipped"] for run in runs]
        lines.append((f"{which}{end}: ticks left out, of {SECONDS * 1000}: median, most",
                     f"{median(skipped):.0f}, {max(skipped)}", ""))
    beside = [run.c for run in runs if run.c is not None]
    if not beside:
        return [*lines, ("C loop on a timerfd beside it", reason(), "")]
    scheduler = f"SCHED_FIFO, {beside[0].priority:.0f}" if beside[0].priority else "scheduled as all"
    late_by = [median(getattr(c, quantile) for c in beside) for quantile in QUANTILES]
    return [*lines, (f"{which}C loop beside it, {scheduler}: late by, median / 99 % / most",
                    " / ".join(f"{us:.0f}" for us in late_by) + " us", ""),
            ("  its share of a core, for waking and nothing else", f"{median(c.cpu for c in beside) * 100:.1f} %", "")]


@contextmanager
def computing(cores: Sequence[int] | None = None) -> Iterator[None]:
    """A loop that never sleeps on each of `cores` (left out: on all that this process may use) while the block runs."""
    if cores is None:
        cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else range(os.cpu_count() or 1)
    loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in cores]
    try:
        for core, loop in zip(cores, loops, strict=True):
            if hasattr(os, "sched_setaffinity"):
                os.sched_setaffinity(loop.pid, [core])
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def _round(out: Path, program: str | None, *, realtime: bool) -> Round:
    demo = subprocess.Popen(
        [sys.executable, "-m", "scenarios", "demo", "hard_wall", "--set", f"duration={SECONDS}", "--out", str(out),
         "--json", *([] if realtime else ["--no-realtime"])], stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=ROOT,
    )
    c = None
    if program is not None:
        time.sleep(START_S)
        output = subprocess.run([program, "tick", str(SECONDS * 1000), str(PRIORITY if realtime else 0)], check=True,
                              capture_output=True).stdout
        c = Alone(*map(float, output.split()))
    summary = json.loads(demo.communicate()[0])
    return Round({end: summary[end] for end in ("master", "slave")}, c)
