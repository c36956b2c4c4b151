"""Command `python -m slave SCENE --listen HOST:PORT`: the slave's end as a process."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from slave.robot import SimulatedSlave
from teleop.live.end import end_main


def main(argv: Sequence[str] | None = None) -> int:
    """Run the slave's end; returns the exit code."""
    return end_main("s", SimulatedSlave, argv, ordered=partial(SimulatedSlave, senses=True))


if __name__ == "__main__":
    raise SystemExit(main())
