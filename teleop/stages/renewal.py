"""The renewal of the force: at every n-th tick, and held in between.

Where such a tick is left out, the next that is run renews the force in its place.
"""

from __future__ import annotations

from typing import Any, ClassVar

from teleop.stages.end import End, Places, Record, Run, Stage


class Renewed(Record):
    """The newest force of one axis that was let through."""

    f_renewed: float


class RenewalStage(Stage):
    """The hold of `Device(every=...)`, in ticks."""

    name: ClassVar[str] = "renewal"
    axis_kind: ClassVar[type[Record]] = Renewed
    every: int
    since_last: Any  # ticks since the last

    @staticmethod
    def numbers(scene: Any, e: str, dt: float, places: Places) -> Any:
        return scene.per_axis(f"device_{e}")[0].every

    def memory(self, e: End) -> tuple[tuple[Record, str], ...]:
        return tuple([(hold, "f_renewed") for hold in self.axes])

    def begin(self, run: Run, e: End, numbers: Any) -> None:
        self.every = numbers
        for hold in self.axes:
            hold.f_renewed = 0.0

    def late(self, run: Run, e: End, ticks: int, since: int) -> None:
        self.since_last = ticks

    def act(self, run: Run, e: End, k: int) -> None:
        for a, hold in zip(e.axes, self.axes, strict=True):
            if e.has.leaves_out:
                a.f_cmd = hold.f_renewed = a.f_cmd if self.since_last > k % self.every else hold.f_renewed
            else:
                a.f_cmd = hold.f_renewed = hold.f_renewed if k % self.every else a.f_cmd
