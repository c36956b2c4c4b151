"""Answers of Python to inputs, tick by tick: the reference that printed C is compared with.

A row is an `init` or a tick, as numbers: which of the two, whether Python raised, the inputs, and the answer. Where
Python raised at a tick its generator is over, so a new one is brought to the same state by the inputs since it began.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import inf, nan
from typing import Any, NamedTuple

from teleop.emit.ticks import PrintedTick
from teleop.emit.types import NOTHING, SCALARS, Array, Printed, Struct, part, parts_of
from teleop.law import messages
from teleop.scene.scene import Scene
from teleop.simulation.source import live_of
from teleop.simulation.structure import end_scene, numbers_of
from teleop.simulation.tick import LiveTick
from teleop.simulation.virtual import run
from teleop.stages.wave_integral import Integrals

WILD = (inf, -inf, nan, 5e-324, -1e-310, 1.7e308, -1e300, 0.0, -0.0, 4.5e15)
RAISES = (ArithmeticError, ValueError, IndexError)
INIT, TICK = 0.0, 1.0


class Vectors(NamedTuple):
    """Rows of numbers, and what each column of inputs and of answers is in C."""

    inputs: list[tuple[str, str]]  # a place in C, and its type
    answers: list[tuple[str, str]]
    rows: list[list[float]]
    width: int  # of the inputs

    def add(self, kind: float, failed: bool, inputs: Any, answer: Any = ()) -> None:
        """Append a row: of an `init` or a tick, whether Python raised, and numbers in tuples of any depth."""
        numbers, out = [[float(one) for one in _numbers(each)] for each in (inputs, answer)]
        self.rows.append([kind, float(failed), *numbers, *[0.0] * (self.width - len(numbers)), *out,
                          *[0.0] * (len(self.answers) - len(out))])

    def add_tick(self, tick: PrintedTick, now: LiveTick, answer: Any) -> None:
        """Append what Python answered to a tick, None where it raised."""
        fields = dict(zip(("force", "tx", "sent", "row"), answer or (), strict=bool(answer)))
        self.add(TICK, answer is None, tuple([getattr(now, name) for name in tick.records["in"]]),
                 tuple([fields[name] for name in tick.records["out"] if fields]))


def places(kind: Any, text: str) -> Iterator[tuple[str, str]]:
    """The numbers of a record or an array, each with its type."""
    if kind in SCALARS:
        yield text, kind
    elif isinstance(kind, Struct | Array):
        for i, of in enumerate(parts_of(kind)):
            if of != NOTHING:
                one: Any = part(Printed(kind, text), i)
                yield from places(of, one.text)


def vectors(scene: Scene, e: str, tick: PrintedTick, *, count: int, seed: int = 0, wild: float = 0.0, again: int = 500,
            sensor: bool | None = None) -> Vectors:
    """`count` rows. `wild`: the share of numbers that are infinite, NaN, subnormal or huge; `again`: ticks from one
    `init` to the next."""
    inputs = [each for name, kind in tick.records["in"].items() for each in places(kind, f"in->{name}")]
    answers = [each for name, kind in tick.records["out"].items() for each in places(kind, f"out->{name}")]
    made = Vectors(inputs, answers, [], max(len(inputs), 3 * scene.axes))
    hand = DrawnInputs(scene, e, seed, wild)
    end = ReferenceEnd(scene, e, sensor)
    while len(made.rows) < count:
        if end.past is None or len(end.past) >= again:
            start = hand.start()
            made.add(INIT, end.begin(*start), start)
        else:
            now = hand.tick(end.force)
            made.add_tick(tick, now, end.tick(now))
    return made


def run_vectors(scene: Scene, e: str, tick: PrintedTick) -> Vectors:
    """Rows of a run in virtual time, of a scene with one axis that plays no integrals."""
    made = vectors(scene, e, tick, count=0)
    trace, both = run(scene).trace, scene.slave is not None
    ends = {each: ReferenceEnd(scene, each, None) for each in "ms"[:1 + both]}
    columns = {each: [trace[name].tolist() for name in (f"x_{each}", f"v_{each}", {"m": "f_h", "s": "f_env"}[each])]
               for each in ends}
    played = {each: trace[f"seq_{each}"].astype(int).tolist() if both else [-1] * len(trace["t"]) for each in ends}
    kinds: Any = messages(scene.laws[0], scene.dt_ns / 1e9) if both else ()
    nothing = {each: (kind(*[0.0] * len(kind._fields)),) for each, kind in zip("sm", kinds, strict=both)}
    sent: dict[str, list[Any]] = {"m": [], "s": []}
    for k in range(len(trace["t"])):
        for each, end in ends.items():
            seq, readings = played[each][k], [(column[k],) for column in columns[each]]
            if k == 0:
                failed = end.begin(*readings)
                if each == e:
                    made.add(INIT, failed, tuple(readings))
            rx = sent["s" if each == "m" else "m"][seq] if seq >= 0 else nothing.get(each)
            x, v, touch = readings
            now = LiveTick(k, x, v, touch, seq >= 0, float(seq), rx, (), 1.0, end.force, 1, 0.0, 1.0,
                           action=x)
            answer = end.tick(now)
            sent[each].append(answer[1])
            if each == e:
                made.add_tick(tick, now, answer)
    return made


def _numbers(value: Any) -> Iterator[Any]:
    if isinstance(value, tuple):
        for each in value:
            yield from _numbers(each)
    else:
        yield value


class ReferenceEnd:
    """The generator of an end, which begins again where it raised."""

    def __init__(self, scene: Scene, e: str, sensor: bool | None) -> None:
        self._scene, self._e, self._live = end_scene(scene, e), e, live_of(end_scene(scene, e), e, sensor)
        self._start: Any = None
        self._running: Any = None
        self.past: list[LiveTick] | None = None  # the inputs since it began; None: it has to begin
        self.force = (0.0,) * scene.axes

    def begin(self, x: Any, v: Any, touch: Any) -> bool:
        """Begin at rest at `x`; True if Python raised."""
        self._start, self.past = (x, v, touch), []
        try:
            self._fresh()
        except RAISES:
            self.past = None
        return self.past is None

    def _fresh(self) -> None:
        x, v, touch = self._start
        scene = self._scene
        self._running = self._live(numbers_of(scene, {self._e: x}), scene.law, scene.dt_ns / 1e9, x, v, touch)
        self._running.send(None)

    def tick(self, now: LiveTick) -> Any:
        """The answer to a tick's inputs; None if Python raised, and then it stands where it stood."""
        assert self.past is not None
        try:
            answer = self._running.send(now)
        except RAISES:
            self._fresh()
            for each in self.past:
                self._running.send(each)
            return None
        self.past.append(now)
        self.force = answer[0]
        return answer


class DrawnInputs:
    """DrawnInputs of an end that a seed draws: a hand that moves, messages that come, come late or not at all."""

    def __init__(self, scene: Scene, e: str, seed: int, wild: float) -> None:
        import numpy as np

        self._dice, self._wild, self._scene = np.random.Generator(np.random.Philox(seed)), wild, scene
        self._message: Any = messages(scene.laws[0], scene.dt_ns / 1e9)[e == "m"] if scene.slave is not None else None
        self._k = self._newest = 0
        self._x: list[float] = []
        self._v: list[float] = []
        self._sums: list[list[float]] = []
        self._gain = 1.0

    def _number(self, value: float) -> float:
        if self._wild and self._dice.random() < self._wild:
            return float(self._dice.choice(WILD))
        return float(value)

    def _normal(self, size: float) -> float:
        return self._number(size * float(self._dice.normal()))

    def start(self) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
        """Draw where the end begins: position, velocity and external force, per axis."""
        axes = range(self._scene.axes)
        self._k, self._newest, self._gain = int(self._dice.integers(0, 1000)), -1, 1.0
        self._x, self._v = [0.05 * float(self._dice.normal()) for _ in axes], [0.0 for _ in axes]
        self._sums = [[0.0, 0.0, 0.0] for _ in axes]
        return tuple(self._x), tuple([self._normal(0.01) for _ in axes]), tuple([self._normal(0.1) for _ in axes])

    def tick(self, force: tuple[float, ...]) -> LiveTick:
        """The inputs of the next tick."""
        dice, axes, dt = self._dice, range(self._scene.axes), self._scene.dt_ns / 1e9
        step = 1 if dice.random() < 0.95 else int(dice.integers(2, 20))
        self._k += step
        for i in axes:
            self._v[i] += -0.02 * self._v[i] - 0.4 * dt * self._x[i] + 0.02 * float(dice.normal())
            self._x[i] += step * dt * self._v[i]
        got, lag = self._message is not None and bool(dice.random() < 0.8), int(dice.integers(1, 40))
        sizes, rx = (0.05, 0.3, 3.0, 400.0), ()
        if got:
            self._newest = max(self._newest, self._k - lag)
        if self._message is not None:
            rx = tuple([self._message(*[self._normal(float(dice.choice(sizes))) for _ in self._message._fields])
                        for _ in axes])
        for each in self._sums:
            wave = float(dice.normal())
            each[0] += step * dt
            each[1] += step * dt * wave
            each[2] += step * dt * 0.5 * wave * wave
        heard = tuple([Integrals(*map(self._number, each)) for each in self._sums])
        if dice.random() < 0.02:
            self._gain = float(dice.choice((0.0, 0.5, 1.0)))
        self._gain = min(1.0, self._gain + 0.02)
        every = int(dice.choice((1, 1, 1, 2)))
        held = tuple([self._number(each if dice.random() < 0.95 else float(dice.normal())) for each in force])
        return LiveTick(
            self._k, tuple(map(self._number, self._x)), tuple(map(self._number, self._v)),
            tuple([self._normal(1.0) for _ in axes]), got, self._newest / every, rx, heard, self._gain, held,
            step + int(dice.random() < 0.1), float(dice.random() < 0.05), float(dice.random() < 0.97),
            float(dice.choice((1.0, 1.0, 0.5, 3.0))), *self._policy())

    def _policy(self) -> tuple[Any, ...]:
        """The policy's switch, whether an action came, and one near the end; nothing in a scene without a policy."""
        if self._scene.handover is None:
            return ()
        dice = self._dice
        return (float(dice.random() < 0.9), float(dice.random() < 0.1),
                tuple([self._number(x + 0.1 * float(dice.normal())) for x in self._x]))
