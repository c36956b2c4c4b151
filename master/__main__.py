"""Command `python -m master SCENE --peer HOST:PORT`: the master's end as a process."""

from __future__ import annotations

from collections.abc import Sequence

from master.device import SimulatedMaster
from teleop.live.end import end_main


def main(argv: Sequence[str] | None = None) -> int:
    """Run the master's end; returns the exit code."""
    return end_main("m", SimulatedMaster, argv)


if __name__ == "__main__":
    raise SystemExit(main())
