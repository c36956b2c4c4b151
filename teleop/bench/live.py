"""The cost of a live run: the lateness of its ticks beside a C loop on a timerfd, and its share of a core."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

from teleop.bench.compiled import compiled, reason
from teleop.scene.library import ROOT

Row = tuple[str, str, str]
SECONDS = 10


def live(rounds: int) -> list[Row]:
    """Rows of (what, measured, asked): medians over `rounds` demos of 10 s, the C loop running beside each."""
    ends: dict[str, list[dict[str, Any]]] = {"master": [], "slave": []}
    beside: list[list[float]] = []  # of each round: median, 99 %, us; share of a core
    with TemporaryDirectory() as name:
        folder = Path(name)
        program = compiled("timing", folder)
        loop = (program, "tick", str(SECONDS * 1000)) if program else None
        for i in range(rounds):
            c = subprocess.Popen(loop, stdout=subprocess.PIPE) if loop else None
            summary = _demo(folder / str(i))
            for end, summaries in ends.items():
                summaries.append(summary[end])
            if c is not None:
                beside.append([float(word) for word in c.communicate()[0].split()])
    rows: list[Row] = []
    for end, summaries in ends.items():
        for place, (quantile, what) in enumerate((("p50", "median"), ("p99", "99 %"))):
            late = [summary["late_us"][quantile] for summary in summaries]
            ratio = median(own / c[place] for own, c in zip(late, beside, strict=True)) if beside else None
            rows.append((f"{end}: tick late by, {what}", f"{median(late):.0f} us",
                         f"{ratio:.2f} times C; asked: at most 1.5" if ratio else ""))
        rows.append((f"{end}: share of a core", f"{median(s['cpu'] for s in summaries) * 100:.1f} %",
                     "asked: at most 10"))
        skipped = median(s["skipped"] for s in summaries)
        rows.append((f"{end}: ticks skipped, of {SECONDS * 1000}", f"{skipped:.0f}", ""))
    if beside:
        rows.append(("C loop on a timerfd beside it: late by, median / 99 %",
                     f"{median(c[0] for c in beside):.0f} / {median(c[1] for c in beside):.0f} us", ""))
        rows.append(("  its share of a core, for waking and nothing else",
                     f"{median(c[2] for c in beside) * 100:.1f} %", ""))
    else:
        rows.append(("C loop on a timerfd beside it", reason(), ""))
    return rows


def _demo(out: Path) -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, "-m", "scenarios", "demo", "hard_wall", "--set", f"duration={SECONDS}", "--out", str(out),
         "--json"], check=True, capture_output=True, cwd=ROOT,
    )
    summary: dict[str, Any] = json.loads(done.stdout)
    return summary
