"""The folder of a live run that never ran: its records say what a test has them say."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from teleop.live.records.record import RecordWriter
from teleop.scene.loading import load_scene
from teleop.simulation.structure import columns

MS = 1_000_000


def live_run(
    folder: Path, fwd: Iterable[tuple[int, int, int]], bwd: Iterable[tuple[int, int, int]], *, ticks: int = 1000,
    left_out: dict[str, set[int]] | None = None, **other: Any
) -> Path:
    """A demo's folder whose ends ran these ticks and got these (packet, time in ns, tick): `fwd` came to the slave."""
    scene = load_scene("hard_wall", duration=ticks / 1000)
    for e, name, came in (("m", "master", bwd), ("s", "slave", fwd)):
        (folder / name).mkdir(parents=True)
        about = {"scene": "hard_wall", "knobs": {"duration": str(ticks / 1000)}, "seed": 0, "mode": "live", **other}
        writer = RecordWriter(scene, e, folder / name, about)
        writer.begin("bodies")
        row = (0.0,) * len(columns(scene, e, False))
        for arrival in came:
            writer.inputs.arrived(1, *arrival)
            writer.inputs.flush()
        for k in range(ticks):
            if k not in (left_out or {}).get(e, ()):
                writer.add(k, 0, -1, row)
        writer.close()
    return folder
