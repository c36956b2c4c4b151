"""Deadband of a scene: an end sends a message only where it differs enough from the last that it sent (Weber).

Source: P. Hinterseer, S. Hirche, S. Chaudhuri, E. Steinbach and M. Buss, "Perception-based data reduction and
transmission of haptic data in telepresence and teleaction systems", IEEE Trans. Signal Processing 56(2), 2008. Of the
samples and waves q of all axes, `last` being what was sent last, an end sends all where for one of them

    |q - last| > max(k |last|, floor),

or where nothing was sent for `keep_alive`. Totals, which tell of energy, ask for no message of their own. A message
that is not sent is no packet: the link's schedule, which is drawn by packet numbers, is as it would be, and the packets
of those ticks are not in it; a tick plays the newest of those that were sent. (So a link with a queue has that of all
packets.) Where no news means that nothing has changed, a law goes on with the last message, and nothing is lost by it.
Of waves no news is not the last wave, which would be active, but a gap, as a lost packet makes one: they are played by
their integral, whose queue becomes as long as the longest silence. So `keep_alive` is 10 ms if nothing is said, which
saves nine packets of ten at most.

Passive as far as the playout is: it is a loss of packets. What it saves is in the packets of a run (`saved`) and in
`sent_fwd` and `sent_bwd`; what it costs is the tracking error beside them.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Any, ClassVar

from teleop.errors import number
from teleop.kind import kinds
from teleop.stages.end import Axis, Column, End, Places, Record, Run, Stage, elapsed


@dataclass(frozen=True, kw_only=True)
class Deadband:
    """A message is sent where a value differs by more than a share `k` (and `floor`, in its unit) from the last sent.

    After `keep_alive` (s) without one it is sent in any case; None: never for that.
    """

    k: float = 0.1
    floor: float = 1e-3
    keep_alive: float | None = 0.01

    def __post_init__(self) -> None:
        number("k", self.k, low=0.0, high=1.0)
        number("floor", self.floor, low=0.0)
        if self.keep_alive is not None:
            number("keep_alive", self.keep_alive, above=0.0, unit="s")


class Compared(Record):
    """A field of an end's messages in one axis, which decides whether they are sent."""

    q: float  # its value
    last: float  # the value that was sent last
    away: float  # how far they are apart

    def __init__(self, suffix: str, a: Axis, field: str) -> None:
        super().__init__(suffix)
        self.a, self.field = a, field


class Coming(Record):
    """The message of one axis that comes at this tick, with its number behind it."""

    coming: Any


class DeadbandStage(Stage):
    """Decides whether an end's message of this tick is sent: `send`, 1.0 or 0.0, recorded as `sent_m` or `sent_s`."""

    name: ClassVar[str] = "deadband"
    axis_kind: ClassVar[type[Record]] = Coming
    send: float  # 1.0 if the message of this tick is sent, else 0.0
    due: Any  # the tick at which it comes to the other end
    number: float  # its number, counted from 1; 0 if it never comes
    k: float
    floor: float
    renews: float  # s
    silent: float  # since the last message that was sent, s

    @staticmethod
    def structure(end: Any) -> Any:
        """The fields of a message that ask for it to be sent: all but totals, which tell of energy."""
        return tuple([name for name, kind in kinds(end.tx).items() if kind != "total"])

    def __init__(self, e: End, structure: Any) -> None:
        super().__init__(e, structure)
        self.compared = tuple([Compared(f"{a.suffix}_{field}", a, field) for field in structure for a in e.axes])

    @staticmethod
    def numbers(scene: Any, e: str, dt: float, places: Places) -> Any:
        deadband = scene.deadband
        # Half a tick of grace, so that a time of n ticks means n whatever n*dt rounds to.
        return deadband.k, deadband.floor, inf if deadband.keep_alive is None else deadband.keep_alive - 0.5 * dt

    def columns(self, e: End) -> tuple[Column, ...]:
        return (Column(f"sent_{e.name}", ((self, "send"),)),)

    def begin(self, run: Run, e: End, numbers: Any) -> None:
        self.k, self.floor, self.renews = numbers
        self.silent = inf
        self.send = 0.0
        for field in self.compared:
            field.last = 0.0

    def act(self, run: Run, e: End, k: int) -> None:
        self.silent = self.silent + elapsed(run, e)
        self.send = 1.0 if self.silent >= self.renews else 0.0
        for field in self.compared:
            field.q = getattr(field.a.tx, field.field)
            field.away = abs(field.q - field.last)
            self.send = 1.0 if field.away > max(self.k * abs(field.last), self.floor) else self.send
        for field in self.compared:
            field.last = field.q if self.send > 0.0 else field.last
        self.silent = 0.0 if self.send > 0.0 else self.silent
