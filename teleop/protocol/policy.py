"""The policy of a live master: the newest of its actions from orders, a page of memory and the scene, and its events.

A tick is sent three things of it (`teleop.simulation.tick.LiveTick`): whether its switch is on, whether an action came
since the last tick, and the newest. They are in `inputs.bin`, so a replay needs no policy.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from inspect import signature
from math import ceil, inf
from typing import NamedTuple

from teleop.errors import Refused, number, number_of
from teleop.protocol.guard import ForceGuard
from teleop.protocol.switches import APART_NS, EventLimit
from teleop.scene.scene import Scene
from teleop.stages.authority import Standing
from teleop.stages.handover import Actions
from teleop.stages.operator import scheduled

AT_ONCE = 64  # actions that are drawn at once, so that no tick waits for many
LONGEST = 3600.0  # s of a reference that cannot be sampled as it goes

Axes = tuple[float, ...]
SAYS = {
    Standing.OPERATOR: "the operator has authority",
    Standing.POLICY: "the policy has authority",
    Standing.LATE: "the policy gave way: no action came in time, or all leapt; it goes on with the next",
    Standing.GRIPPED: "the operator took over by force; switch the policy off and on to let it have authority again",
    Standing.PAUSED: "the policy waits: the link is not there, or the operator's clutch is open",
}


class PolicyWord(NamedTuple):
    """Message of a policy, or of whoever switches it: None where it says nothing of that."""

    takes: bool | None = None
    to: Axes | None = None


class PolicyInput:
    """Inputs that the ticks of the master get of a policy. `dt`: of the end's own ticks, s."""

    def __init__(self, scene: Scene, dt: float) -> None:
        self.page: Callable[[], PolicyWord | None] | None = None  # where another process writes actions
        self._dt, self._axes = dt, scene.axes
        self._takes: bool | None = None  # by the last order; None: by the scene
        self._pending: Axes | None = None
        self._action: Axes = (0.0,) * scene.axes
        self._drawn = Actions([inf], ())
        self._next = 0  # of those drawn
        self._count = 0  # actions that were drawn so far
        assert scene.handover is not None
        self._of = scene.handover
        self._switched = self._of.switched(dt)
        self._goes_on = self._of.policy is not None
        if self._goes_on and "first" not in signature(self._of.policy.samples).parameters:
            self._draw(ceil(min(scene.duration, LONGEST) * self._of.rate) + 1)
            self._goes_on = False

    def order(self, takes: bool | None = None, to: Sequence[float] | None = None) -> None:
        """Switch the policy on or off, or take its next action (m, or rad; one for each axis). Raises `Refused`."""
        if to is not None:
            if isinstance(to, str) or not isinstance(to, Sequence) or len(to) != self._axes:
                raise Refused(f"an action has one number for each of {number_of(self._axes, 'axis', 'axes')}, in m or "
                              f"rad, not {str(to)[:99]!r}; send for example {[0.1] + [0.0] * (self._axes - 1)}")
            self._pending = tuple([number(f"to[{i}]", each) for i, each in enumerate(to)])
        if takes is not None:
            self._takes = takes

    def at(self, k: int) -> tuple[float, float, Axes]:
        """The switch, whether an action came, and the newest action, of the end's own tick k."""
        renewed = 0.0
        while True:
            if self._drawn.due[self._next] <= k:
                self._action = tuple([each[self._next] for each in self._drawn.targets])
                self._next, renewed = self._next + 1, 1.0
            elif self._goes_on and self._drawn.due[self._next] == inf and self._of.due(self._count, self._dt) <= k:
                self._draw(AT_ONCE)
            else:
                break
        if self.page is not None and (word := self.page()) is not None:
            self._takes = self._takes if word.takes is None else word.takes
            self._pending = word.to or self._pending
        if self._pending is not None:
            self._action, self._pending, renewed = self._pending, None, 1.0
            self._drawn, self._next, self._goes_on = Actions([inf], ()), 0, False  # what the scene has stood in for it
        on = scheduled(self._switched, k) > 0.0 if self._takes is None else self._takes
        return 1.0 if on else 0.0, renewed, self._action

    def _draw(self, count: int) -> None:
        """Draw so many more of the scene's own actions."""
        self._drawn = self._of.actions(self._axes, count, self._dt, self._count)
        self._count, self._next = self._count + count, 0


class PolicyEvents:
    """Events of a policy: who has authority, when that changes, ten a second at most.

    `columns`: those of a row of the master's record, one for each number.
    """

    def __init__(self, scene: Scene, columns: Sequence[str]) -> None:
        self._at, self._refused_at = columns.index("policy_m"), columns.index("refused_m")
        self._offsets = [i for i, name in enumerate(columns) if name == "offset_policy_m@"]
        self._limit = EventLimit(scene.dt_ns)
        self._leap = scene.handover.leap  # type: ignore[union-attr]  # it has one
        self._is, self._refused = Standing.OPERATOR, 0.0

    def update(self, k: int, row: Sequence[float], guard: ForceGuard) -> None:
        """Row of tick k of the grid."""
        if row[self._at] != self._is and self._limit.admits(k, "policy"):
            self._is = Standing(int(row[self._at]))
            guard.tell(k, "policy", SAYS[self._is] + self._away(row))
        if row[self._refused_at] > self._refused and self._limit.admits(k, "refused", 10 * APART_NS):
            refused = int(row[self._refused_at] - self._refused)
            self._refused = row[self._refused_at]
            guard.tell(k, "policy", f"{number_of(refused, 'action')} of the policy refused: farther than {self._leap} "
                       "from where it was (m or rad), or no number; send smaller steps, or set leap higher")

    def _away(self, row: Sequence[float]) -> str:
        """The offset that a policy without a motor at the leader has left, in words."""
        if self._is == Standing.POLICY or not self._offsets:
            return ""
        far = max([row[i] for i in self._offsets], key=abs)
        return f"; the handle is {far:.3g} m or rad from where its law was told, and that stays"
