"""Simulated master: a device held by the scene's hand, moved exactly between the ticks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from teleop.physics.plant import Plant, grip_force, move_free, move_gripped
from teleop.protocol.endpoint import Axes, Reading
from teleop.protocol.guard import DEADLINE
from teleop.scene.scene import Scene
from teleop.simulation.bodies import WHOLE, check_turn, held_masters, master_coefficients, path_of
from teleop.simulation.structure import structure_of


class SimulatedMaster:
    """Device of the master in simulation: its motion under the motor's force, which is held between the ticks.

    A force that is not renewed within its deadline lapses: the motion goes on without it.
    It has a force sensor if the scene's law reads f_h and the scene has no observer of it, and if the motion has an
    inner state, since the hand's force cannot be computed afterwards then; `senses`: it has one whatever the scene, or
    none.
    """

    deadline = DEADLINE
    scene_body = True
    whole = WHOLE  # ticks of a reference that is not sampled as it goes, see `teleop.simulation.bodies.path_of`

    def __init__(self, scene: Scene, *, senses: bool | None = None) -> None:
        self._senses = senses
        self._k = self._renewed = self._since = 0  # the tick, that of the newest force, and that of the scene's start
        self._scene: Scene | None = None
        self._held: tuple[Plant, ...] | None = None
        self._c: tuple[Any, ...] = ()
        self._x: list[float] = []
        self._v: list[float] = []
        self._f: list[float] = []
        self._z: list[Any] = []
        self._reference: tuple[Sequence[float], ...] | None = None
        self._r, self._before = [0.0] * scene.axes, [0.0] * scene.axes  # the hand's reference at this tick and the last
        self._take(scene, again=True)

    def read(self, k: int) -> Reading:
        """Position, velocity and hand force, the left limit at tick k. Ticks may be left out, not taken twice.

        After the scene's last tick the hand's reference stays where it is.
        """
        while self._k < k:
            if self._k - self._renewed >= self._lapse:
                self._f = [0.0] * len(self._f)
            self._move()
            self._k += 1
        return Reading(tuple(self._x), tuple(self._v), self._hand() if self._sensor else None)

    def hold(self, force: Axes) -> None:
        """Hold `force` (N, against the hand) from now on."""
        self._f, self._renewed = list(force), self._k

    def turn(self, scene: Scene, *, again: bool = False) -> None:
        """Go on with the bodies and the hand of `scene`, at the same tick, from the same position and velocity.

        The ticks are counted on, also those of the hand's own motion. `again`: at rest where the new scene starts, with
        no force held, and the hand's own motion begins anew. Raises `Refused`, and changes nothing, where dt or axes
        are others.
        """
        check_turn(self._scene, scene)
        self._take(scene, again)

    def _take(self, scene: Scene, again: bool) -> None:
        """Be the master of `scene`; what it refuses, it refuses before anything is changed."""
        has = structure_of(scene).m.has
        held = held_masters(scene) if has.inner else None
        c = master_coefficients(scene) if held is None else tuple([each.c for each in held])
        keeps_path = self._keeps_path(scene)
        reference = self._reference if keeps_path else None if scene.reference is None else path_of(
            scene.reference, scene.axes, scene.ticks + 1, scene.dt_ns, self.whole)
        goes_on = not again and self._held is not None and held is not None and held[0].move is self._held[0].move
        x = list(scene.vector("start_m", scene.start_m))
        self._z = self._z if goes_on else [None] * scene.axes if held is None else [each.start for each in held]
        self._scene, self._held, self._c, self._reference = scene, held, c, reference
        self._dt, self._lapse = scene.dt_ns / 1e9, max(1, round(DEADLINE * 1e9 / scene.dt_ns))  # s, ticks
        self._sensor = has.felt if self._senses is None else self._senses
        if again:
            self._x, self._v, self._f = x, [0.0] * scene.axes, [0.0] * scene.axes
            self._since = self._renewed = self._k
        if reference is None:
            self._r = self._before = [0.0] * scene.axes
        else:
            self._settle(again, keeps_path)

    def _keeps_path(self, scene: Scene) -> bool:
        """True if the hand's own motion is the same in `scene`, so that its samples serve on."""
        old = self._scene
        if old is None or old.reference is None or scene.reference is None or scene.ticks != old.ticks:
            return False
        try:
            return bool(scene.reference == old.reference)
        except ValueError:  # arrays have no one answer
            return False

    def _settle(self, again: bool, keeps_path: bool) -> None:
        """Find the hand's reference at this tick and the one before, in a new scene; `keeps_path`: its path stays."""
        self._r, self._before = self._own(self._k), self._own(max(self._k - 1, self._since))

    def _own(self, k: int) -> list[float]:
        """The hand's own motion at tick k, m, per axis."""
        assert self._reference is not None
        k -= self._since
        return [r[k] if k < len(r) else r[-1] for r in self._reference]

    def _ahead(self) -> list[float]:
        """The hand's reference at the next tick, m, per axis."""
        return self._own(self._k + 1)

    def _move(self) -> None:
        """Move all axes over one tick, with the hand's reference."""
        r_next = self._ahead() if self._reference is not None else self._r
        for i, (c, x, v, f, r0, r1) in enumerate(zip(self._c, self._x, self._v, self._f, self._r, r_next, strict=True)):
            if self._held is not None:
                self._x[i], self._v[i], self._z[i] = self._held[i].move(c, x, v, f, r0, r1, self._z[i])
            elif self._reference is None:
                self._x[i], self._v[i], _ = move_free(c, x, v, -f)
            else:
                self._x[i], self._v[i] = move_gripped(c, x, v, f, r0, r1)
        self._before, self._r = self._r, r_next

    def _hand(self) -> Axes:
        if self._reference is None:
            return (0.0,) * len(self._x)
        return tuple([self._grip(i) for i in range(len(self._x))])

    def _grip(self, i: int) -> float:
        r = self._r[i]
        state = self._c[i], self._x[i], self._v[i], self._f[i], r, (r - self._before[i]) / self._dt
        if self._held is None:
            return grip_force(*state)
        return float(self._held[i].force(*state, self._z[i]))
