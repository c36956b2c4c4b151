"""What a live run costs: how late its ticks are, beside a C loop on `clock_nanosleep`, and its share of a core."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

from teleop.library import ROOT

Row = tuple[str, str, str]
SECONDS = 10
C_LOOP = r"""
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include <sys/resource.h>
static int order(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}
int main(int argc, char **argv) {
    int n = atoi(argv[1]);
    double *late = malloc(n * sizeof *late);
    struct timespec due, now;
    clock_gettime(CLOCK_MONOTONIC, &due);
    for (int i = 0; i < n; i++) {
        due.tv_nsec += 1000000;
        if (due.tv_nsec >= 1000000000) { due.tv_nsec -= 1000000000; due.tv_sec++; }
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL);
        clock_gettime(CLOCK_MONOTONIC, &now);
        late[i] = (now.tv_sec - due.tv_sec) * 1e6 + (now.tv_nsec - due.tv_nsec) * 1e-3;
    }
    struct rusage used;
    getrusage(RUSAGE_SELF, &used);
    double cpu = used.ru_utime.tv_sec + used.ru_stime.tv_sec + (used.ru_utime.tv_usec + used.ru_stime.tv_usec) * 1e-6;
    qsort(late, n, sizeof *late, order);
    printf("%.1f %.1f %.4f\n", late[n / 2], late[(int)(n * 0.99)], cpu / (n * 1e-3));
    return 0;
}
"""


def live(rounds: int) -> list[Row]:
    """Rows of (what, measured, asked): medians over `rounds` demos of 10 s, the C loop running beside each."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        loop = _compiled(folder)
        ends: dict[str, list[dict[str, Any]]] = {"master": [], "slave": []}
        beside: list[list[float]] = []
        for i in range(rounds):
            c = subprocess.Popen([loop, str(SECONDS * 1000)], stdout=subprocess.PIPE) if loop else None
            summary = _demo(folder / str(i))
            for end, summaries in ends.items():
                summaries.append(summary[end])
            if c is not None:
                beside.append([float(word) for word in c.communicate()[0].split()])
    rows: list[Row] = []
    for end, summaries in ends.items():
        late = {q: median(s["late_us"][q] for s in summaries) for q in ("p50", "p99")}
        rows.append((f"{end}: tick late by, median", f"{late['p50']:.0f} us", "asked: at most 100"))
        asked = ""
        if beside:
            ratio = median(s["late_us"]["p99"] / c[1] for s, c in zip(summaries, beside, strict=True))
            asked = f"{ratio:.2f} times C; asked: at most 1.5"
        rows.append((f"{end}: tick late by, p99", f"{late['p99']:.0f} us", asked))
        rows.append((f"{end}: share of a core", f"{median(s['cpu'] for s in summaries) * 100:.1f} %",
                     "asked: at most 10"))
        skipped = median(s["skipped"] for s in summaries)
        rows.append((f"{end}: ticks skipped, of {SECONDS * 1000}", f"{skipped:.0f}", ""))
    if beside:
        rows.append(("C clock_nanosleep beside it: late by, median / p99",
                     f"{median(c[0] for c in beside):.0f} / {median(c[1] for c in beside):.0f} us", ""))
        rows.append(("  its share of a core, for waking and nothing else",
                     f"{median(c[2] for c in beside) * 100:.1f} %", ""))
    else:
        rows.append(("C clock_nanosleep beside it", "no C compiler here", ""))
    return rows


def _compiled(folder: Path) -> str | None:
    compiler = os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        return None
    (folder / "loop.c").write_text(C_LOOP)
    subprocess.run([compiler, "-O2", "-o", str(folder / "loop"), str(folder / "loop.c")], check=True)
    return str(folder / "loop")


def _demo(out: Path) -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, "-m", "scenarios", "demo", "hard_wall", "--set", f"duration={SECONDS}", "--out", str(out),
         "--json"], check=True, capture_output=True, cwd=ROOT,
    )
    summary: dict[str, Any] = json.loads(done.stdout)
    return summary
