"""Command `python -m master SCENE --peer HOST:PORT`: the master's end as a process."""

from __future__ import annotations

from collections.abc import Sequence

from master.device import SimulatedMaster
from teleop.live.devices.guarded_device import LiveDevice
from teleop.live.end import end_main
from teleop.scene.scene import Scene


def main(argv: Sequence[str] | None = None) -> int:
    """Run the master's end; returns the exit code."""
    def steered(scene: Scene) -> LiveDevice:
        from master.steered import SteeredMaster

        return SteeredMaster(scene)

    return end_main("m", SimulatedMaster, argv, ordered=steered)


if __name__ == "__main__":
    raise SystemExit(main())
