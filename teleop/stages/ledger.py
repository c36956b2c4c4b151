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

from teleop.stages.end import Column, End, Run, Stage, law_of
from teleop.stages.record import Record


class WaveLedger(Stage):
    """Half of the squared waves, tick by tick, where the law's messages have waves.

    Of ticks that are left out it has nothing, as it has nothing of the time between two ticks: what the held force does
    then is in `E_port`. Where waves are played by their integral that stage keeps the ledger, held waves and all.
    """

    name: ClassVar[str] = "wave_ledger"

    def columns(self, e: End) -> tuple[Column, ...]:
        out, inward = ("fwd", "bwd") if e.name == "m" else ("bwd", "fwd")
        return Column(f"E_in_{out}", ((e, "E_in"),)), Column(f"E_out_{inward}", ((e, "E_out"),))

    def begin(self, run: Run, e: End, given: Any) -> None:
        e.E_in = e.E_out = 0.0

    def act(self, run: Run, e: End, k: int) -> None:
        if run.has.integral:  # which keeps both itself
            e.E_in = reduce(add, [a.sent.E for a in e.axes])
            e.E_out = reduce(add, [a.E_played for a in e.axes])
        else:
            self.sum(run, e)

    def sum(self, run: Run, e: End) -> None:
        """The energy of this tick's waves."""
        for a in e.axes:
            wave = getattr(a.rx, e.rx_wave) * (True if run.has.repeats else e.got)
            e.E_out = e.E_out + run.half_dt * (wave * wave)
            wave = getattr(a.tx, e.tx_wave)
            e.E_in = e.E_in + run.half_dt * (wave * wave)


class Moved(Record):
    """The motion of one axis, where the reading is not the place."""

    x_was: float  # the place at the tick before, m


class PortLedger(Stage):
    """The work at the port, over the true motion."""

    name: ClassVar[str] = "port_ledger"

    def __init__(self, e: str, axes: int) -> None:
        super().__init__(e, axes)
        self.axes = tuple([Moved(f"{e}{i}") for i in range(axes)])

    def columns(self, e: End) -> tuple[Column, ...]:
        return (Column(f"E_port_{e.name}", ((e, "E_port"),)),)

    def begin(self, run: Run, e: End, given: Any) -> None:
        e.E_port = 0.0
        if e.has.encoder:
            for a, own in zip(e.axes, self.axes, strict=True):
                own.x_was = a.x

    def act(self, run: Run, e: End, k: int) -> None:
        for a, own in zip(e.axes, self.axes, strict=True):
            if e.has.encoder and e.has.scaled:
                e.E_port = e.E_port + a.f * (a.x - own.x_was) / (a.scale_x * a.scale_f)
            elif e.has.encoder:
                e.E_port = e.E_port + a.f * (a.x - own.x_was)
            elif e.has.scaled:  # in the units of the law, in which the ports add up: see `teleop.stages.scaling`
                e.E_port = e.E_port + a.f * a.dx / (a.scale_x * a.scale_f)
            else:
                e.E_port = e.E_port + a.f * a.dx
            if e.has.encoder:
                own.x_was = a.x


class LawLedger(Stage):
    """The energy that the law keeps in its state, where it says how much. An end with sums has one for all its axes."""

    name: ClassVar[str] = "law_ledger"

    stored: Callable[..., Any]

    def columns(self, e: End) -> tuple[Column, ...]:
        return (Column(f"E_law_{e.name}", ((e, "E_law"),)),)

    def begin(self, run: Run, e: End, given: Any) -> None:
        e.E_law = 0.0

    def act(self, run: Run, e: End, k: int) -> None:
        if e.has.sums:
            e.E_law = self.stored(law_of(run, e.axes[0]), e.axes[0].s)
        else:
            e.E_law = reduce(add, [self.stored(law_of(run, a), a.s) for a in e.axes])
