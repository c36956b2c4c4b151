"""Ends of a link by themselves, without a law or a body: what they send of waves, and what they play of them.

Both are the stages of `teleop.stages.wave_integral` over records of their own, as they stand. `mutant` gives the same
of a text that is wrong somewhere.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from random import Random
from types import ModuleType, SimpleNamespace
from typing import Any, NamedTuple

from teleop.scene.playout import Gaps, Integral
from teleop.stages import wave_integral
from teleop.stages.end import End, EndHas, Run, RunHas
from teleop.stages.wave_integral import Integrals

DT = 1e-3
NOTHING = Integrals(0.0, 0.0, 0.0)  # what has been heard before the first message
STAGES = {"wave_integral": "WaveIntegralStage", "wave_energy": "WaveEnergyStage"}


class Message(NamedTuple):
    u: float


class Alone:
    """One end of one axis, whose law is left out."""

    def __init__(self, playout: Gaps | None = None, *, dt: float = DT, leaves_out: bool = False,
                 module: Any = wave_integral) -> None:
        playout = playout or Integral()
        self.run, self.e = Run(), End("s", 1, EndHas(leaves_out=leaves_out))
        self.run.has = RunHas(integral=True)
        self.run.dt, self.run.half_dt = dt, 0.5 * dt
        self.e.rx_wave, self.e.rx_fields, self.e.tx_wave, self.e.Message = "u", ("u",), "u", Message
        self.axis, = self.e.axes
        self.axis.rx = Message(0.0)
        self.stage = getattr(module, STAGES[str(getattr(playout, "stage", None))])(self.e, None)
        given = self.stage.numbers(SimpleNamespace(wave_playout=playout), "s", dt, [0.0])
        self.stage.begin(self.run, self.e, given)
        self.own, = self.stage.axes

    def send(self, q: float, span: float | None = None) -> Integrals:
        """Send a wave, `span` s after the one before; returns what goes with it."""
        self.e.span = self.run.dt if span is None else span
        self.axis.tx = Message(q)
        self.stage.act(self.run, self.e, 0)
        sent: Integrals = self.axis.sent
        return sent

    def play(self, heard: Integrals, span: float | None = None) -> float:
        """The wave that is played at a tick, `span` s after the one before; `heard`: what came with the newest."""
        self.e.span = self.run.dt if span is None else span
        self.e.got = heard is not self.axis.heard
        self.axis.heard = heard
        self.stage.receive(self.run, self.e)
        p: float = self.own.p
        return p


def mutant(*changes: tuple[str, str]) -> ModuleType:
    """The stage's module with each of these texts in place of another, wherever that stands; it has to stand there."""
    text = Path(wave_integral.__file__).read_text()
    for old, made in changes:
        assert old in text, f"no longer in the stage, so nothing would be tried: {old}"
        text = text.replace(old, made)
    module = ModuleType("mutant")
    exec(compile(text, "mutant", "exec"), vars(module))
    return module


class Tick(NamedTuple):
    """One tick of the receiver."""

    p: float
    heard: Integrals  # by then
    sent: Integrals  # by then
    waves_sent: float  # the integral of what was really sent until now and will be held for the tick that began
    waves_played: float  # the integral of what was really held at the receiver until now


def over_a_link(
        sender: Alone, receiver: Alone, waves: Sequence[float], dice: Random, *, loss: float = 0.0, delay: int = 5,
        jitter: int = 0, left_out: float = 0.0, every: tuple[int, int] = (1, 1), calm: int = 0) -> Iterator[Tick]:
    """The receiver's ticks, for one wave each millisecond, as the sender's tick finds it. The newest message wins.

    `every`: milliseconds of the sender's tick and of the receiver's. In the last `calm` of them nothing is lost.
    """
    arriving: dict[int, list[Integrals]] = {}
    heard = sent = NOTHING
    since_sent = since_played = 0  # ms
    waves_sent = waves_played = now = 0.0
    for k, q in enumerate(waves):
        since_sent, since_played = since_sent + 1, since_played + 1
        waves_sent += DT * now
        waves_played += DT * receiver.own.p
        if k % every[0] == 0 and (k == 0 or dice.random() >= left_out):
            sent, now = sender.send(q, max(since_sent, every[0]) * DT), q
            since_sent = 0
            if k >= len(waves) - calm or dice.random() >= loss:
                arriving.setdefault(k + delay + dice.randrange(jitter + 1), []).append(sent)
        for each in arriving.pop(k, ()):
            heard = max(heard, each)
        if k % every[1] == 0 and (k == 0 or dice.random() >= left_out):
            p = receiver.play(heard, max(since_played, every[1]) * DT)
            since_played = 0
            yield Tick(p, heard, sent, waves_sent + (every[0] - since_sent) * DT * now, waves_played)
