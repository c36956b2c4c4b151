"""The law of one end, tick by tick: a live end asks it over its devices and messages, a replay over their record."""

from __future__ import annotations

from typing import Any, NamedTuple

from teleop.kind import positions
from teleop.law import messages
from teleop.scene.scene import Scene
from teleop.simulation.source import live_of
from teleop.simulation.structure import columns, end_scene, numbers_of
from teleop.simulation.tick import LiveTick
from teleop.stages.wave_integral import Integrals

Axes = tuple[float, ...]


class RowPlaces(NamedTuple):
    """Places of columns in a row of the record; None where the row has no such column."""

    E_in: int | None  # energy that came in at this end, J
    E_out: int | None  # energy that the messages played here may have brought, J
    sent: int | None  # did the deadband let the message through
    positions: list[int]  # of the device
    queues: list[int]  # of waves (s), one an axis

    @classmethod
    def of(cls, e: str, names: list[str]) -> RowPlaces:
        """The places at the end `e` in a row with these columns; the name of a column per axis stands once an axis."""
        into, out = ("fwd", "bwd") if e == "m" else ("bwd", "fwd")
        E_in, E_out, sent = (names.index(name) if name in names else None for name in (
            f"E_in_{into}", f"E_out_{out}", f"sent_{e}"))
        return cls(E_in, E_out, sent, [i for i, name in enumerate(names) if name in (f"x_{e}@", f"q_{e}@")],
                   [i for i, name in enumerate(names) if name == f"queue_{e}@"])


class Origin:
    """Origin of a law's positions, in the device's own: `at` is None where the two are the same."""

    def __init__(self, scene: Scene, e: str) -> None:
        self._starts = scene.vector(f"start_{e}", getattr(scene, f"start_{e}"))
        self._devices = scene.per_axis(f"device_{e}")
        self.placed = False  # is it known where the device was before tick 0
        speeds = () if scene.operator is None else scene.operator.by_axis("align", scene.axes, 0.0)
        located = any(speeds) and bool(positions(messages(scene.laws[0])[1]))
        self.pinned = tuple([located and speed > 0.0 for speed in speeds]) if located else ()  # count from the device's
        self.away: Axes | None = None  # how far that is from where the scene begins, if it is not there
        self.at: Axes | None = None

    def place(self, x: Axes, *, moves: bool) -> None:
        """Take note of where the device is before tick 0. `moves`: the law's positions may count from elsewhere."""
        self.placed = True
        if x != self._starts and moves:
            self.away = tuple([a - b for a, b in zip(x, self._starts, strict=True)])

    def move(self, x: Axes) -> None:
        """Count from `x`, or from the nearest whole step of an encoder; an axis that is aligned from its own zero."""
        at = tuple([0.0 if pin else each for pin, each in zip(self.pinned, x, strict=True)]) if self.pinned else x
        if self._devices[0] is not None and self._devices[0].encoder is not None:
            from teleop.stages.encoder import encode

            at = tuple([encode((of.encoder.step, 0.5), each) for of, each in zip(self._devices, at, strict=True)])
        self.at = at

    def of_law(self, x: Axes) -> Axes:
        """A position of the device as the law sees it."""
        return x if self.at is None else tuple([a - b for a, b in zip(x, self.at, strict=True)])


LawAnswer = tuple[Axes, tuple[Any, ...], tuple[Integrals, ...] | None, Axes]
"""Force (N, per axis), message per axis, the integrals of its waves where they are sent along, and the record's row."""


class EndLaw:
    """The law at the end `e` of `scene`, whose tick is this end's own. `sensor`: the device senses the external force.

    `names`: the columns of a row, one for each number. `begun`: it has begun a session.
    """

    def __init__(self, scene: Scene, e: str, sensor: bool, origin: Origin) -> None:
        scene = end_scene(scene, e)
        self.names = [name for name in columns(scene, e, sensor) for _ in range(scene.axes if "@" in name else 1)]
        self.places = RowPlaces.of(e, self.names)
        self.begun = False
        self._scene, self._e, self._origin = scene, e, origin
        self._live = live_of(scene, e, sensor)
        self._started: Any = None

    def begin(self, x: Axes, v: Axes, f: Axes | None) -> None:
        """Begin it from rest with the reading of a session's first tick; `x` counts from the origin."""
        scene, self.begun = self._scene, True
        self._started = self._live(numbers_of(scene, {self._e: x}), scene.law, scene.dt_ns / 1e9, x, v, f)
        next(self._started)

    def answer(self, inputs: LiveTick) -> LawAnswer:
        """Run one tick; positions in the row are as the device reads them."""
        answer: LawAnswer = self._started.send(inputs)
        if (origin := self._origin.at) is None:
            return answer
        force, tx, sent, row = answer
        out = list(row)
        for n, i in enumerate(self.places.positions):
            out[i] += origin[n % len(origin)]
        return force, tx, sent, tuple(out)
