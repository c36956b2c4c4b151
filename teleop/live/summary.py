"""What a live end leaves in its folder beside its record: trace.npz and summary.json."""

from __future__ import annotations

import json
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from teleop.endpoint import Times
from teleop.errors import Refused
from teleop.live.record import FILE, read_record

if TYPE_CHECKING:
    from teleop.live.shell import Shell

NAMES = {"m": "master", "s": "slave"}


def write_end(shell: Shell, folder: Path, seed: int, command: list[str]) -> dict[str, Any]:
    """Write trace.npz, from the record in `folder`, and summary.json; returns the summary.

    Raises `Refused` if the disk takes no more; the record as far as it came is left there.
    """
    try:
        late = _write_trace(shell, folder)
        summary = _summary(shell, seed, command, late)
        text = json.dumps(summary, indent=2, default=str)
        (folder / "summary.json").write_text(text + "\n")
    except OSError as error:
        for name in ("trace.npz", "summary.json"):
            with suppress(OSError):
                (folder / name).unlink(missing_ok=True)
        raise Refused(
            f"{shell.sentence}, but its summary could not be written ({error.strerror or error}); what was recorded "
            f"is in {folder / FILE}: free some space and run it again"
        ) from error
    return summary


def _write_trace(shell: Shell, folder: Path) -> list[float]:
    """The end's arrays; the lateness (ns) of its ticks."""
    import numpy as np

    from teleop.trace import end_arrays

    scene, e = shell.scene, shell.endpoint.e
    _, record, late = read_record(folder)
    arrays: dict[str, Any] = {"t": np.array(record.ticks, dtype=np.int64) * scene.dt_ns / 1e9}
    arrays |= {**end_arrays(scene, e, record), f"late_{e}": np.array(late) / 1e9}
    np.savez(folder / "trace.npz", **arrays)
    return late


def _summary(shell: Shell, seed: int, command: list[str], late: list[float]) -> dict[str, Any]:
    import numpy as np

    from teleop import __version__
    from teleop.result import parameters

    scene, endpoint, session = shell.scene, shell.endpoint, shell.endpoint.session
    inbox: Any = endpoint.inbox
    late_us = np.array(late) / 1e3
    return {
        "status": shell.status, "sentence": shell.sentence, "end": NAMES[endpoint.e], "scene": scene.name,
        "mode": "lockstep" if endpoint.stepped else "live", "parameters": parameters(scene), "seed": seed,
        "dt": scene.dt_ns / 1e9, "ticks": shell.ticks, "skipped": shell.skipped,
        "versions": {"bilateral-teleop": __version__, "python": sys.version.split()[0]}, "command": command,
        "packets": {
            "sent": shell.data_sent, "unsent": shell.wire.unsent,
            "received": getattr(inbox, "received", endpoint.received),
            **{name: getattr(inbox, name, 0) for name in ("late", "overtaken", "duplicates", "refused")},
            "rejected": dict(endpoint.rejected),
        },
        "late_us": {f"p{q}": float(np.percentile(late_us, q)) for q in (50, 99, 100)} if late else {},
        "delay": _seconds(endpoint.way), "rtt": _seconds(endpoint.rtt),
        "clock": {"start_ns": session.start_ns, "offset_ns": session.offset_ns,
                  "uncertainty_ns": None if session.rtt_ns is None else session.rtt_ns // 2},
        "stamp_margin": endpoint.stamp_margin, "cpu": shell.cpu, "record": shell.recorder.trouble,
    }


def _seconds(times: Times) -> dict[str, float] | None:
    if not times.count:
        return None
    return {"mean": times.total / times.count / 1e9, "least": times.least / 1e9, "most": times.most / 1e9}
