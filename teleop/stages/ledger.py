"""The energy ledgers of an end: what its port and its side of the link take in and give out, along the run.

`E_port` is the work that the held force did over the motion at the port. `E_in` is the energy that the end's waves
bring into the link (forward from the master, backward from the slave), `E_out` what the waves that it plays take out.
`E_law` is what the law says that its state at this end keeps (`teleop.law.offers`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from operator import add
from typing import Any, ClassVar

from teleop.stages.end import Axis, Column, End, Record, Run, Stage, held_of_law, law_of


class WaveLedger(Stage):
    """Half of the squared waves, tick by tick, where the law's messages have waves.

    Of ticks that are left out it has nothing, as it has nothing of the time between two ticks: what the held force does
    then is in `E_port`. Where waves are played by their integral that stage keeps the ledger, held waves and all.
    """

    name: ClassVar[str] = "wave_ledger"
    E_in: float  # J
    E_out: float

    def columns(self, e: End) -> tuple[Column, ...]:
        out, inward = ("fwd", "bwd") if e.name == "m" else ("bwd", "fwd")
        return Column(f"E_in_{out}", ((self, "E_in"),)), Column(f"E_out_{inward}", ((self, "E_out"),))

    def begin(self, run: Run, e: End, numbers: Any) -> None:
        self.E_in = self.E_out = 0.0

    def act(self, run: Run, e: End, k: int) -> None:
        if run.has.integral:  # which keeps both itself
            self.E_in = reduce(add, [a.sent.E for a in e.axes])
            self.E_out = reduce(add, [wave.G for wave in (e.stage.wave_integral or e.stage.wave_energy).axes])
        else:
            self.sum(run, e)

    def sum(self, run: Run, e: End) -> None:
        """The energy of this tick's waves."""
        for a in e.axes:
            wave = getattr(a.rx, e.rx_wave) * (True if run.has.repeats else e.got)
            self.E_out = self.E_out + run.half_dt * (wave * wave)
            wave = getattr(a.tx, e.tx_wave)
            self.E_in = self.E_in + run.half_dt * (wave * wave)


class Moved(Record):
    """The motion of one axis, where the reading is not the place."""

    x_was: float  # the place at the tick before, m


class PortLedger(Stage):
    """The work at the port, over the true motion."""

    name: ClassVar[str] = "port_ledger"
    axis_kind: ClassVar[type[Record]] = Moved
    E_port: float  # J

    def columns(self, e: End) -> tuple[Column, ...]:
        return (Column(f"E_port_{e.name}", ((self, "E_port"),)),)

    def begin(self, run: Run, e: End, numbers: Any) -> None:
        self.E_port = 0.0
        if e.stage.encoder:
            for a, moved in zip(e.axes, self.axes, strict=True):
                moved.x_was = a.x

    def act(self, run: Run, e: End, k: int) -> None:
        if e.stage.operator and e.stage.operator.shape.aligned:  # which moves the law's port without the device's
            self.E_port = self.E_port + e.stage.operator.put_in
        for a, moved in zip(e.axes, self.axes, strict=True):
            if e.stage.handover and e.stage.handover.moves:  # whose port has a second motion
                self.E_port = self.E_port + a.at.f_held * a.at.dx
            elif e.stage.encoder and e.stage.scaling:
                self.E_port = self.E_port + held_of_law(e, a) * (a.x - moved.x_was) / in_joules_of_law(e, a)
            elif e.stage.encoder:
                self.E_port = self.E_port + held_of_law(e, a) * (a.x - moved.x_was)
            elif e.stage.scaling:  # in the units of the law, in which the ports add up: see `teleop.stages.scaling`
                self.E_port = self.E_port + held_of_law(e, a) * a.dx / in_joules_of_law(e, a)
            else:
                self.E_port = self.E_port + held_of_law(e, a) * a.dx
            if e.stage.encoder:
                moved.x_was = a.x


def in_joules_of_law(e: End, a: Axis) -> Any:
    """The slave's joules in one axis for one of the law."""
    return e.stage.scaling.axes[a.i].scale_x * e.stage.scaling.axes[a.i].scale_f


class LawLedger(Stage):
    """The energy that the law keeps in its state, where it says how much. An end with sums has one for all its axes."""

    name: ClassVar[str] = "law_ledger"
    E_law: float  # J
    stored: Callable[..., Any]

    def columns(self, e: End) -> tuple[Column, ...]:
        return (Column(f"E_law_{e.name}", ((self, "E_law"),)),)

    def begin(self, run: Run, e: End, numbers: Any) -> None:
        self.E_law = 0.0

    def act(self, run: Run, e: End, k: int) -> None:
        if e.has.sums:
            self.E_law = self.stored(law_of(run, e.axes[0]), e.axes[0].s)
        else:
            self.E_law = reduce(add, [self.stored(law_of(run, a), a.s) for a in e.axes])
