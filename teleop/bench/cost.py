"""The processor time of a live end's tick, in all and part by part; of another tree beside it, in the same run.

    python -m teleop.bench cost --rounds 8 --against ../before     # a worktree of the commit before

The two trees take turns, so that what else the machine does disturbs both. Live: the system's count of processor time
over a demo at 1 kHz, mean of its two ends. Back to back: see `teleop.bench.back_to_back`; live each part takes about
twice as long, since it finds its caches cold.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

from teleop.scene.library import ROOT

Row = tuple[str, str, str]
SECONDS = 4
LIVE, WHOLE = "live, processor time of a tick", "back to back"


def cost(rounds: int, against: str | None = None) -> list[Row]:
    """Rows of (what, us a tick, the same of the tree `against` and the ratio): medians over `rounds`."""
    hot = str(Path(__file__).with_name("back_to_back.py"))
    trees = [ROOT] if against is None else [ROOT, Path(against).resolve()]
    found: dict[Path, list[dict[str, float]]] = {tree: [] for tree in trees}
    with TemporaryDirectory() as folder:
        for i in range(rounds):
            for tree in trees if i % 2 else trees[::-1]:
                parts: dict[str, float] = json.loads(_python(tree, "-P", hot))
                out = Path(folder) / f"{i}-{trees.index(tree)}"
                found[tree].append({LIVE: _live(tree, out), WHOLE: parts.pop("whole"),
                                    **{f"  {part}": us for part, us in parts.items()}})
    medians = [{what: median(one[what] for one in each) for what in each[0]} for each in found.values()]
    return [(what, f"{us:.1f} us", "" if len(medians) < 2 else _beside(us, medians[1][what]))
            for what, us in medians[0].items()]


def _beside(us: float, before: float) -> str:
    ratio = f", {us / before:.2f} times" if before > 0.0 else ""
    return f"before: {before:.1f} us{ratio}"


def _live(tree: Path, out: Path) -> float:
    """Processor time (us) of a tick that ran, mean of the two ends of a demo."""
    words = ("hard_wall", "--set", f"duration={SECONDS}", "--out", str(out), "--json")
    summary: dict[str, Any] = json.loads(_python(tree, "-m", "scenarios", "demo", *words))
    return sum(float(summary[end]["cpu"] / (1e3 - summary[end]["skipped"] / SECONDS) * 1e6)
               for end in ("master", "slave")) / 2


def _python(tree: Path, *words: str) -> str:
    done = subprocess.run([sys.executable, *words], cwd=tree, env={**os.environ, "PYTHONPATH": str(tree)}, check=True,
                          capture_output=True, text=True)
    return done.stdout
