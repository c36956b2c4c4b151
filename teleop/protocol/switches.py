"""The switches of an operator at a live end: whether device and scene agree on them, and what is told of them."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from typing import Any

from teleop.protocol.guard import ForceGuard
from teleop.scene.scene import Scene
from teleop.stages.alignment import BEHIND, LEAD, NEAR
from teleop.stages.end import SWITCHES

APART_NS = 100_000_000  # between two events of a kind: a switch that bounces must not fill what is kept of events
MOST = 1000  # events of all kinds

SAYS = {
    ("clutch", 1.0): "the operator holds the clutch open: there is no force, and the slave holds",
    ("clutch", 2.0): "the operator holds the clutch of the translation open: along those axes there is no force, and "
                     "the slave holds",
    ("clutch", 3.0): "the operator holds the clutch of the rotation open: about those axes there is no torque, and "
                     "the slave holds",
    ("clutch", 0.0): "the clutch is closed: positions count from here",
    ("present", 0.0): "nobody is there: there is no force, and the slave holds",
    ("present", 1.0): "the operator is there: positions count from here",
}


class EventLimit:
    """Limit of what an end tells of in the ticks of `tick_ns`: ten events of a kind in a second, `MOST` of all."""

    def __init__(self, tick_ns: int) -> None:
        self._tick_ns = tick_ns
        self._last_ns: dict[str, int] = {}  # of the run, by the kind
        self._count = 0

    def admits(self, k: int, kind: str, apart_ns: int = APART_NS) -> bool:
        """Reserve an event at tick k; False if it comes too soon, or after too many."""
        now = k * self._tick_ns
        if now - self._last_ns.get(kind, -apart_ns) < apart_ns or self._count >= MOST:
            return False
        self._last_ns[kind], self._count = now, self._count + 1
        return True


class SwitchEvents:
    """Tells of each switch that has changed, ten times a second at most, and of a clutch that does not close."""

    def __init__(self, scene: Scene, columns: Sequence[str]) -> None:
        """`columns`: those of a row of the master's record, one for each number."""
        self._at = {name: columns.index(f"{name}_m") for name in SWITCHES}
        self._moduli = [i for i, name in enumerate(columns) if name in ("g_clutch_m", "g_turn_m")]
        self._apart, self._way = ([i for i, name in enumerate(columns) if name == wanted]
                                  for wanted in ("apart_m@", "way_m@"))
        operator, axes = scene.operator, scene.axes
        self._within = () if operator is None else operator.within(axes)
        self._speed, self._most = ((), ()) if operator is None else (
            operator.by_axis("align", axes, 0.0), operator.by_axis("align_most", axes, inf))
        self._names, self._units = scene.axis_names, scene.axis_units
        self._limit = EventLimit(scene.dt_ns)
        self._is = {"clutch": 0.0, "present": 1.0}
        self._stays = ""  # what was told of a clutch that stays open

    def update(self, k: int, row: Sequence[float], guard: ForceGuard) -> None:
        """Row of tick k of the grid."""
        clutch, present = row[self._at["clutch"]], row[self._at["present"]]
        if self._is["clutch"] != clutch:
            self._changed(k, "clutch", clutch, guard)
        if self._is["present"] != present:
            self._changed(k, "present", present, guard)
        if self._apart or self._way:
            stays = present > 0.0 and clutch == 0.0 and any(row[i] == 0.0 for i in self._moduli)
            self._closes(k, row, guard, stays=stays)

    def _changed(self, k: int, name: str, state: float, guard: ForceGuard) -> None:
        if self._limit.admits(k, name):
            self._is[name] = state
            guard.tell(k, name, SAYS[name, state])

    def _closes(self, k: int, row: Sequence[float], guard: ForceGuard, *, stays: bool) -> None:
        """Say why the clutch stays open, each reason once."""
        which, why = self._reason(row) if stays else ("", "")
        if which and which != self._stays and self._limit.admits(k, "apart"):
            guard.tell(k, "clutch", why)
            self._stays = which
        elif not stays:
            self._stays = ""

    def _reason(self, row: Sequence[float]) -> tuple[str, str]:
        """Reason that keeps it open, in a word and as a sentence."""
        way = [abs(row[i]) for i in self._way]
        ahead = [abs(row[i]) for i in self._apart] if self._way else []
        if any(each > most for each, most in zip(way, self._most, strict=False)):
            size, name, unit, most = self._worst(way, self._most)
            return "refused", (f"the arm is not aligned: the handle is {size} {unit} from it on axis {name}, and "
                               f"align_most is {most:g} {unit}; move the handle nearer to the arm, and close the "
                               "clutch again")
        goes_on = any(each > NEAR * speed for each, speed in zip(way, self._speed, strict=False) if speed > 0.0)
        if any(each > (LEAD if goes_on else BEHIND) * speed > 0.0
               for each, speed in zip(ahead, self._speed, strict=False)):
            size, name, unit, _ = self._worst(ahead, self._speed)
            return "waits", (f"the alignment waits for the arm, which is {size} {unit} behind on axis {name}; free it, "
                             "or open the clutch, which stops it where it is")
        if goes_on:
            size, name, unit, speed = self._worst(way, self._speed)
            return "aligns", (f"the arm is brought to the handle, {size} {unit} away on axis {name}, at {speed:g} "
                              f"{unit}/s: hold the clutch closed, and open it to stop")
        if self._apart and any(abs(row[i]) > within for i, within in zip(self._apart, self._within, strict=True)):
            size, name, unit, within = self._worst([abs(row[i]) for i in self._apart], self._within)
            return "apart", (f"the clutch stays open: the ends are {size} {unit} apart on axis {name}, and it closes "
                             f"within {within:g} {unit}; free the slave, which its law draws to the master meanwhile, "
                             "or start either end again, which counts both from where they are")
        return "", ""

    def _worst(self, sizes: Sequence[float], bounds: Sequence[float]) -> tuple[str, str, str, float]:
        """The size that is the greatest share of its bound, the name and unit of its axis, and the bound."""
        i = max(range(len(sizes)), key=lambda i: sizes[i] / bounds[i] if bounds[i] > 0.0 else 0.0)
        return f"{sizes[i]:.3g}", self._names[i], self._units[i], bounds[i]


def switches_of(reading: Any) -> tuple[str, ...]:
    """The switches that the device of this reading has."""
    return tuple([name for name in SWITCHES if getattr(reading, name) is not None])


def unlike(scene: Scene, e: str, has: tuple[str, ...]) -> str | None:
    """Why the switches of the device at the end `e` do not go with the scene; None: they do."""
    if e == "s":
        return None if not has else (
            f"the slave's robot has the switch {has[0]}, and an operator's switches are the master's; have the robot "
            f"read {has[0]}=None, and the master's device the switch")
    needs = () if scene.operator is None else scene.operator.needs
    for name in SWITCHES:
        if name in needs and name not in has:
            return (f"the scene needs the switch {name} of the master's device, whose reading has {name}=None; have it "
                    f"read {name} as True or False, or leave {name} out of what the scene needs")
    if has and scene.operator is None:
        return (f"the master's device has the switch {has[0]}, which the scene {scene.name} does not heed; have it "
                "heeded, with --set clutch_ramp=0.05 at both ends or operator=Operator() in the scene, or read "
                f"{has[0]}=None")
    return None
