"""What it costs to play waves by their integral: runs and kernels of each playout beside those of `zero`.

Of the canonical scene over 50 ms each way, where every playout plays the same waves, and over jitter and loss. Only the
processor's time is counted, of each playout in turns, and the least of all rounds.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from teleop.bench.kernels import kernel_of
from teleop.scene.loading import load_scene
from teleop.simulation.virtual import run

Row = tuple[str, str, str]
LINKS = {"50 ms": "delay(0.05)", "jitter and loss": "delay(0.05) | uniform(0.02) | bernoulli(0.1)"}
PLAYOUTS = ("zero", "integral", "integral:0.005", "energy", "scaled:0.1")
ASKED = {"integral": "asked: at most 1.5", "integral:0.005": "asked: at most 1.5"}
ROWS = {"plain": 1, "scalar": 1, "vector": 8}  # at once


def playout(rounds: int) -> list[Row]:
    """Rows of (what, measured, asked)."""
    from teleop.sweeps.kernels.compiled import need_numba

    need_numba("scalar")
    rows: list[Row] = []
    for engine, count in ROWS.items():
        for what, link in LINKS.items():
            calls = {name: ready(engine, name, link, count) for name in PLAYOUTS}
            least = dict.fromkeys(PLAYOUTS, float("inf"))
            for call in calls.values():
                call()
            for _ in range(4 * rounds):
                for name, call in calls.items():
                    least[name] = min(least[name], seconds(call))
            ticks = count * load_scene("canonical").ticks
            rows += [(f"{engine}, {what}: zero", f"{least['zero'] / ticks * 1e9:.1f} ns a tick", ""),
                     *((f"  {name}", f"{least[name] / least['zero']:.2f} times", ASKED.get(name, ""))
                       for name in PLAYOUTS[1:])]
    return rows


def ready(engine: str, name: str, link: str, count: int) -> Callable[[], Any]:
    """A call that runs `count` rows of a playout."""
    scenes = [load_scene("canonical", playout=name, link=link, k_e=5000.0 + 10.0 * n) for n in range(count)]
    if engine == "plain":
        return lambda: run(scenes[0])
    return kernel_of(engine, scenes, [1] * count)


def seconds(call: Callable[[], Any]) -> float:
    """Of the processor."""
    began = time.process_time()
    call()
    return time.process_time() - began
