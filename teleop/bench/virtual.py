"""What a run in virtual time costs: per tick, as a whole process, in memory.

The machine's own speed is measured in the same rounds by the loop that the figure is stated with:
`x = x*1.0001 + 0.5` a thousand times, about 30 us where 4 us per tick are asked for.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import time
import timeit
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from teleop.scene.library import ROOT
from teleop.scene.loading import load_scene
from teleop.simulation.virtual import run

Row = tuple[str, str, str]
LOOP = "for i in range(1000): x=x*1.0001+0.5"


def virtual(rounds: int) -> list[Row]:
    """Rows of (what, measured, asked)."""
    scene = load_scene("canonical")
    yardstick, per_tick = [], []
    for _ in range(rounds):
        yardstick.append(min(timeit.repeat(LOOP, "x=0.0", number=200, repeat=5)) / 200 * 1e6)
        took = run(scene, clock=time.perf_counter_ns).run_time
        assert took is not None
        per_tick.append(took / scene.ticks * 1e6)
    scaled = median(t * 30.0 / y for t, y in zip(per_tick, yardstick, strict=True))
    rows = [
        ("yardstick loop", f"{median(yardstick):.1f} us", ""),
        ("canonical scene, plain Python, per tick", f"{median(per_tick):.2f} us", ""),
        ("  the same where the yardstick takes 30 us", f"{scaled:.2f} us", "asked: at most 4"),
    ]
    with TemporaryDirectory() as folder:
        ours, numpys = [], []
        for i in range(2 * rounds):
            numpys.append(_seconds(["-c", "import numpy"]))
            ours.append(_seconds(["-m", "scenarios", "run", "hard_wall", "--out", str(Path(folder) / str(i))]))
    ratio = median(ours) / median(numpys)
    rows += [
        ("`teleop run hard_wall`, whole process", f"{median(ours) * 1e3:.0f} ms", ""),
        ("  over `python -c 'import numpy'`", f"{ratio:.2f} times", "asked: at most 3.5"),
        ("  peak memory of the largest process", f"{_peak():.0f} MB", "asked: at most 80"),
    ]
    return rows


def _seconds(arguments: list[str]) -> float:
    began = time.perf_counter()
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL, cwd=ROOT)
    return time.perf_counter() - began


def _peak() -> float:
    """MB, over the child processes so far; Linux counts in KiB."""
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
