"""How a sweep grows: from a thousand rows to a hundred thousand, from one thread to two, and a million rows in memory.

Whole sweeps, with all that a row costs beside its kernel: scene, coefficients, schedule, its line in the table. What
that is by itself is a row's time in a sweep less that of the kernel, both measured in turn in this process.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from statistics import median

from teleop.bench.kernels import kernel_of
from teleop.scene.library import ROOT
from teleop.scene.loading import load_scene
from teleop.sweeps.grid import grid
from teleop.sweeps.runner import sweep

Row = tuple[str, str, str]
MEASURES = ("x_err_rms", "x_err_max")
FEW, MANY = 1_000, 100_000
SHARED = 30_000  # rows for one thread and for two
PROGRAM = """
import resource
from teleop.bench.scale import million
rows = million()
print(rows, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def scale(rounds: int) -> list[Row]:
    """Rows of (what, measured, asked)."""
    from teleop.sweeps.kernels.compiled import need_numba

    need_numba("vector")
    ticks = load_scene("canonical").ticks
    rows: list[Row] = []
    for engine in ("scalar", "vector"):
        _swept(engine, 16, 1)  # compiles
        kernel = kernel_of(engine, [load_scene("canonical", k_e=k_e) for k_e in _stiffnesses(FEW)], [0] * FEW)
        few, many, ratios, gains, alone = [], [], [], [], []
        for _ in range(rounds):
            few.append(_swept(engine, FEW, 1) / FEW)
            alone.append(_seconds(kernel) / FEW)
            gains.append(_swept(engine, SHARED, 1) / _swept(engine, SHARED, 2))
        for _ in range(max(1, rounds // 3)):
            many.append(_swept(engine, MANY, 1) / MANY)
            ratios.append(many[-1] / median(few))
        rows += [
            *[(f"{engine}, canonical, a row of {count:,}", f"{median(each) * 1e6:.0f} us",
               f"{median(each) / ticks * 1e9:.1f} ns a tick") for count, each in ((FEW, few), (MANY, many))],
            ("  beside its kernel", f"{median(a - b for a, b in zip(few, alone, strict=True)) * 1e6:.0f} us",
             f"kernel {median(alone) * 1e6:.0f} us; asked: at most 60"),
            ("  over that of few", f"{median(ratios):.2f} times", "asked: at most 1.15"),
            (f"{engine}, two threads over one", f"{median(gains):.2f} times", "asked: at least 1.8"),
        ]
    done = subprocess.run([sys.executable, "-c", PROGRAM], cwd=ROOT, capture_output=True, text=True, check=True)
    count, memory = map(int, done.stdout.split())
    rows.append((f"{count:,} rows of 20 ticks", f"{memory / 1e6:.2f} GB", "asked: at most 1"))
    return rows


def _swept(engine: str, rows: int, threads: int) -> float:
    """Seconds for a sweep of the canonical scene over the wall's stiffness."""
    points = grid({"k_e": _stiffnesses(rows)})
    return _seconds(lambda: sweep("canonical", points, metrics=MEASURES, engine=engine, workers=threads))


def _stiffnesses(count: int) -> list[float]:
    """So many values of the wall's stiffness, N/m."""
    return [2500.0 + 5000.0 * n / count for n in range(count)]


def _seconds(call: Callable[[], object]) -> float:
    began = time.perf_counter()
    call()
    return time.perf_counter() - began


def million() -> int:
    """A sweep of a million short rows over two knobs and seeds."""
    points = grid({"k_e": [1000.0 + n for n in range(1000)], "d_e": [0.1 * n for n in range(100)]}, 10)
    return len(sweep("canonical", points, metrics=MEASURES, engine="vector", fixed={"duration": 0.02}))
