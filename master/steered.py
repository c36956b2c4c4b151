"""Steered master: a simulated master whose hand goes where it is told to, by a pointer for example."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, hypot, pi, sin, sqrt
from pathlib import Path

from master.device import SimulatedMaster
from master.hand_record import HandWriter
from teleop.errors import Refused, number, number_of
from teleop.physics.following import following
from teleop.scene.scene import Scene

WORKSPACE = 10.0  # m from 0, in each axis
WHOLE_S = 60.0  # s of a scene's own motion that cannot be sampled as it goes
SWING = 0.5  # Hz, of a hand that swings by itself
ALIGNING = 60.0  # rad/s of an alignment, in which the hand damps the handle besides, to ...
RATIO = 0.8  # ... this damping ratio of the masses on its spring
DRIFTS, BEHIND = 0.1, 0.1  # m/s, s: of a place that moves on
NEAR, SLOW, ENOUGH = 5e-4, 5e-3, 1.5  # m, m/s, s: when an alignment is over


class SteeredMaster(SimulatedMaster):
    """Simulated master whose hand moves as the scene says until it is steered, and then where it is told to.

    What is moved is the hand's reference, through a `Follower` of 30 rad/s and at most 1 m/s; the hand's spring and
    damper pull the handle along, and the handle is pushed back, so that a force is seen. The reference and its speed go
    on through every order, so neither place nor force jumps. An order holds from the tick that was read last. The
    force between hand and handle is always sensed.

    A scene's own motion whose `samples` has no `first` is taken for at most 60 s, and stays where it is then.
    """

    def __init__(self, scene: Scene) -> None:
        self._follow = following(scene.dt_ns / 1e9)
        self._bring = following(scene.dt_ns / 1e9, ALIGNING)
        self._lead = 0.0  # s, of an alignment
        self._own_motion = True  # the reference is the scene's, and no filter's
        self._w = [0.0] * scene.axes  # the speed of the filtered reference, m/s
        self._target: tuple[float, ...] | None = None  # of `steer`
        self._swing: tuple[float, ...] | None = None  # amplitudes about that target, m
        self._steered = False
        self._place: tuple[float, ...] | None = None  # of `align`
        self._align_k = 0  # the tick of that
        self._placed = 0  # the tick at which it was another place last
        self._drift = (0.0,) * scene.axes  # how fast that place moves on, m/s
        self._writer: HandWriter | None = None
        self.whole = max(1, round(WHOLE_S * 1e9) // scene.dt_ns)
        super().__init__(_held_by_hand(scene), senses=True)

    def steer(self, to: Sequence[float] | None, swing: Sequence[float] | None = None) -> None:
        """Move the hand's reference towards `to`, m, a finite number per axis within 10 m of 0.

        None: the hand lets go. The reference then follows the handle itself, so the spring's force fades. `swing`:
        amplitudes (m) by which the target swings about `to`, with the run's clock: 0.5 Hz, every second axis 1 Hz.
        Raises `Refused`, and changes nothing, where `to` or `swing` is no such place.
        """
        target, amplitudes = None if to is None else self._checked(to), None if swing is None else self._checked(swing)
        self._target, self._swing = target, amplitudes
        self._steered = True
        self._leave_own()

    def align(self, to: Sequence[float] | None) -> None:
        """Bring the handle to `to` (m, as in `steer`) before anything else, until it is called with None.

        The reference goes target by the same filter, at 60 rad/s. Masses on a hand's spring swing (that of most scenes
        is damped to 0.28 of critical), so the target is taken back by the speed of the handle times a lead, under
        which they are damped to 0.8. Called again meanwhile, it goes on to another place, and its time counts from the
        first. After it the hand does again what it was told to, or what the scene says. See `aligned`.
        """
        place = None if to is None else self._checked(to)
        if self._place is None or place is None:
            self._align_k, self._drift = self._k, (0.0,) * len(self._x)
        elif self._k > self._placed:  # smoothed, for it is told in steps
            span = (self._k - self._placed) * self._dt
            self._drift = tuple([0.7 * drift + 0.3 * (target - here) / span for drift, target, here in
                                 zip(self._drift, place, self._place, strict=True)])
        self._place, self._placed = place, self._k
        if place is not None:
            self._leave_own()

    @property
    def aligned(self) -> bool:
        """True if the handle is within 0.5 mm of the place of `align`, at its speed within 5 mm/s; or after 1.5 s.

        Of a place that moves on, at up to 0.1 m/s, it may be behind by the way of 0.1 s more. The time is counted in
        ticks. False where it is not being aligned.
        """
        if self._place is None:
            return False
        if self._k - self._align_k >= ceil(ENOUGH / self._dt):
            return True
        drift = hypot(*self._drift)
        off = hypot(*[x - p for x, p in zip(self._x, self._place, strict=True)])
        apart = hypot(*[v - w for v, w in zip(self._v, self._drift, strict=True)])
        return drift < DRIFTS and off < NEAR + BEHIND * drift and apart < SLOW + 0.5 * drift

    def turn(self, scene: Scene, *, again: bool = False) -> None:
        """As `SimulatedMaster.turn`; the hand goes on with what it was told to, and its reference moves without a jump.

        Where it was told nothing yet and the scene's own motion is another, the reference goes over to that. `again`:
        the hand moves as the scene says, until it is steered anew.
        """
        if self._writer is not None and self._writer.newest >= 0:
            self._writer.add(self._k, self._r)  # where it was, of which this tick is the end
        super().turn(_held_by_hand(scene), again=again)

    def record(self, folder: Path | str | None) -> None:
        """Write the reference to `folder`/hand.bin from this tick on, one row a tick; None: close what is written.

        See `master.hand_record` for the file. Raises `OSError` where it cannot be begun; a disk that is full later
        ends the record and not the motion: see `trouble`.
        """
        if self._writer is not None:
            self._writer.add(self._k, self._r)
            self._writer.close()
        self._writer = None if folder is None else HandWriter(Path(folder), round(self._dt * 1e9), len(self._x))

    @property
    def trouble(self) -> str | None:
        """Why the record of the hand stopped, as a sentence; None while nothing is wrong with it."""
        return None if self._writer is None else self._writer.trouble

    def _checked(self, to: Sequence[float]) -> tuple[float, ...]:
        if isinstance(to, str) or not isinstance(to, Sequence) or len(to) != len(self._x):
            raise Refused(f"the hand goes to a place with one number for each of "
                          f"{number_of(len(self._x), 'axis', 'axes')}, in m, not {str(to)[:99]!r}; send for example "
                          f"{[0.03] + [0.0] * (len(self._x) - 1)}")
        place = tuple([number(f"to[{i}]", each) for i, each in enumerate(to)])
        if not all(abs(each) <= WORKSPACE for each in place):
            raise Refused(f"the hand reaches {WORKSPACE:g} m from 0 in each axis, and is told to go to {list(place)}; "
                          "send a place within, in m")
        return place

    def _leave_own(self) -> None:
        """Go on through the filter, with the speed that the scene's own motion has."""
        if self._own_motion:
            self._w = [(r - before) / self._dt for r, before in zip(self._r, self._before, strict=True)]
            self._own_motion = False

    def _settle(self, again: bool, keeps_path: bool) -> None:
        self._lead = _lead(self._scene)
        if again:
            super()._settle(again, keeps_path)
            self._own_motion, self._steered, self._target, self._swing, self._place = True, False, None, None, None
        elif not keeps_path:
            self._leave_own()

    def _ahead(self) -> list[float]:
        if self._own_motion:
            return self._own(self._k + 1)
        if self._place is not None:
            short = [p - self._lead * (v - w) for p, v, w in zip(self._place, self._v, self._drift, strict=True)]
            r, self._w = self._bring.step(self._r, self._w, short)
            return r
        target = self._x if self._target is None else self._target
        if self._target is not None and self._swing is not None:
            phase = 2.0 * pi * SWING * (self._k + 1) * self._dt
            target = [at + by * sin(phase * (1 + i % 2)) for i, (at, by) in
                      enumerate(zip(self._target, self._swing, strict=True))]
        r, self._w = self._follow.step(self._r, self._w, target if self._steered else self._own(self._k + 1))
        return r

    def _move(self) -> None:
        if self._writer is not None:
            self._writer.add(self._k, self._r)
        super()._move()


def _held_by_hand(scene: Scene) -> Scene:
    if not all(hand is not None and hand.k > 0.0 for hand in scene.per_axis("hand")):
        raise Refused(f"scene {scene.name} has no hand with a spring, by which an order could move the master; take a "
                      "scene with one, for example canonical")
    return scene


def _lead(scene: Scene | None) -> float:
    """The time (s) of an alignment's lead, for the damping ratio `RATIO` of the masses on the hand's spring.

    Of several axes the least. None where they swing by themselves at more than half of `ALIGNING`: the filter is too
    slow for those, and the lead would feed the swing. Below that all poles have negative real parts, whatever the
    dampers.
    """
    assert scene is not None
    leads = []
    for hand, body in zip(scene.per_axis("hand"), scene.per_axis("master"), strict=True):
        mass = body.mass + hand.mass
        quick = sqrt(hand.k / mass) > 0.5 * ALIGNING
        leads.append(0.0 if quick else (2.0 * RATIO * sqrt(hand.k * mass) - body.damping - hand.d) / hand.k)
    return max(0.0, min(leads))
