"""The switches of an operator at a live end: whether device and scene agree on them, and what is told of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from teleop.protocol.guard import ForceGuard
from teleop.scene.scene import Scene
from teleop.stages.end import SWITCHES

APART_NS = 100_000_000  # between two events of a switch: one that bounces must not fill what is kept of events
MOST = 1000  # events of the switches that are told

SAYS = {
    ("clutch", True): "the operator holds the clutch open: there is no force, and the slave holds",
    ("clutch", False): "the clutch is closed: positions count from here",
    ("present", False): "nobody is there: there is no force, and the slave holds",
    ("present", True): "the operator is there: positions count from here",
}


class SwitchEvents:
    """Tells of each switch that has changed, ten times a second at most, and of a clutch that does not close."""

    def __init__(self, scene: Scene, columns: Sequence[str]) -> None:
        """`columns`: those of a row of the master's record, one for each number."""
        self._at = {name: columns.index(f"{name}_m") for name in SWITCHES}
        self._modulus = columns.index("g_clutch_m")
        self._apart = [i for i, name in enumerate(columns) if name == "apart_m@"]
        self._within = () if scene.operator is None else scene.operator.within(scene.axes)
        self._names, self._units = scene.axis_names, scene.axis_units
        self._ns = scene.dt_ns
        self._is = {"clutch": False, "present": True}
        self._told_ns = dict.fromkeys((*SWITCHES, "apart"), -APART_NS)  # of the run, of the last event
        self._stays = False  # was it told that the clutch stays open
        self._count = 0

    def update(self, k: int, row: Sequence[float], guard: ForceGuard) -> None:
        """Row of tick k of the grid."""
        clutch, present = row[self._at["clutch"]] > 0.0, row[self._at["present"]] > 0.0
        if self._is["clutch"] is not clutch:
            self._changed(k, "clutch", clutch, guard)
        if self._is["present"] is not present:
            self._changed(k, "present", present, guard)
        if self._apart:
            self._closes(k, row, guard, stays=row[self._modulus] == 0.0 and present and not clutch)

    def _changed(self, k: int, name: str, on: bool, guard: ForceGuard) -> None:
        if self._may(k, name):
            self._is[name] = on
            guard.tell(k, name, SAYS[name, on])

    def _closes(self, k: int, row: Sequence[float], guard: ForceGuard, *, stays: bool) -> None:
        """Say so where the clutch stays open, for the ends are too far apart."""
        if stays and not self._stays and self._may(k, "apart"):
            i = max(range(len(self._apart)), key=lambda i: abs(row[self._apart[i]]) / self._within[i])
            unit = self._units[i]
            guard.tell(k, "clutch", f"the clutch stays open: the ends are {abs(row[self._apart[i]]):.3g} {unit} apart "
                       f"on axis {self._names[i]}, and it closes within {self._within[i]:g} {unit}; free the slave, "
                       "which its law draws to the master meanwhile, or start either end again, which counts both "
                       "from where they are")
            self._stays = True
        elif not stays:
            self._stays = False

    def _may(self, k: int, name: str) -> bool:
        """Reserve an event at tick k; False if it comes too soon, or after too many."""
        if k * self._ns - self._told_ns[name] < APART_NS or self._count >= MOST:
            return False
        self._told_ns[name], self._count = k * self._ns, self._count + 1
        return True


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
