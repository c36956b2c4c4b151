"""A turn: a live end goes on with another law, link or environment, in the same process and on the same grid of ticks.

    order "turn" -> the session is over for this end: its force falls along the watchdog's ramp
                 -> at zero force: the scene with its new knobs, an endpoint and a record of their own
                 -> the next session, for which both ends compare the new manifests
                 -> released by the guard, as after every session that was over

Both ends are given the order, in any order in time: who is turned first asks the other again and again, or does not
answer it, until that one is turned too. No message of the former law is read as one of the next, since a session that
is over carries none and the next has another number.

A person presses a wall, and the force falls: the hand slides on, and the law would begin from there, with a wall that
is no longer felt. So an order may say where the slave is (`align`): before the next session a device that can (see
`master.steered`) brings the master there, and then lets the hand go on to where it wants to be. Orders "align" follow
a slave that moves on meanwhile.

The order "idle" ends the end's record: what the ticks come to from then on is in a short file of the newest rows alone,
for whoever looks on, until a turn begins the next record.

The order "policy" switches a policy on or off (`takes`), or is its next action (`to`): see `teleop.stages.handover`.

The order "clutch" ends the session in the same way and begins none until it is closed again: positions count from where
each end is by then.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from teleop.errors import Refused
from teleop.live.devices.guarded_device import deadline_of
from teleop.live.orders import SHAPES, Orders, refuse, tell
from teleop.live.records.record import RecordWriter, RunFolder
from teleop.live.shell import EndCounts, Shell
from teleop.protocol.endpoint import Endpoint
from teleop.protocol.guard import Event
from teleop.protocol.packet import Code
from teleop.scene.scene import Scene
from teleop.storage.folder import claim

Load = Callable[[dict[str, str]], tuple[Scene, dict[str, str], dict[str, str]]]
"""From knobs as texts to the scene, the knobs of its record and its manifest. Raises `Refused`."""


class Turning:
    """Carries out orders at the end that `shell` owns. `load` makes the scene; `record` the writer of its record.

    `device`: what stands at the end. It may have `steer`, `align` and `aligned`, `turn` and `record`, as the simulated
    ones have; of any other a turn changes the law alone.
    """

    def __init__(self, shell: Shell, device: Any, folder: RunFolder, knobs: dict[str, str], load: Load,
                 record: Callable[[Scene, dict[str, str]], RecordWriter]) -> None:
        self._shell, self._folder, self._knobs, self._load, self._record = shell, folder, knobs, load, record
        self._device = device
        self._orders = Orders(SHAPES, self.take)
        self._waits: set[Code] = set()  # for these no next session is begun
        self._next: dict[str, Any] | None = None  # the turn that is under way, before zero force
        self._newest: dict[str, Any] | None = None  # the turn that came meanwhile
        self._met = 0  # sessions, when the turn was made
        self._turned = False  # is it made, and not released yet
        self._aligning = False  # is the master on its way to where the next session begins
        self._record_hand()

    def obey(self) -> bool:
        """Carry out orders that have come, and go on with a turn; False if there will be no more of them."""
        self._orders.read()
        if self._next is not None or self._turned:
            self._look()
        return not self._orders.over

    def take(self, order: dict[str, Any]) -> None:
        """Carry out one order, as `teleop.live.orders.SHAPES` has them."""
        word = order["order"]
        if word == "hand":
            self._hand(order["to"], order.get("swing"))
        elif word == "align":
            if self._aligning:  # the slave has moved on meanwhile
                self._align(order["to"])
        elif word == "idle":
            self._idle()
        elif word == "clutch":
            self._clutch(order["open"])
        elif word == "scale":
            self._scale(order["to"])
        elif word == "policy":
            self._policy(order.get("takes"), order.get("to"))
        elif self._next is None and not self._turned:
            self._begin(order)
        else:
            self._newest = order  # of several that came meanwhile the last one counts

    def close(self) -> None:
        """The run is over: what the device writes down of its hand is whole."""
        if hasattr(self._device, "record"):
            self._device.record(None)

    def _idle(self) -> None:
        """Write no more of the run until the next turn, which begins a record of its own."""
        if self._next is None and not self._turned:
            self._shell.endpoint.witness = None
            self._shell.recorder.idle()
            if hasattr(self._device, "record"):
                self._device.record(None)

    def _hand(self, to: list[float] | None, swing: list[float] | None) -> None:
        if not hasattr(self._device, "steer"):
            refuse("this end's device has no hand that can be moved; orders `hand` are for a simulated master")
            return
        try:
            about = () if swing is None else (tuple(map(float, swing)),)
            self._device.steer(None if to is None else tuple(map(float, to)), *about)
        except Refused as refused:
            refuse(str(refused))

    def _policy(self, takes: bool | None, to: list[float] | None) -> None:
        """Switch the policy on or off, or hand its next action to the ticks."""
        policy = self._shell.endpoint.policy
        if policy is None:
            refuse("this end has no policy; orders `policy` are for the master of a scene with handover=Handover()")
            return
        try:
            policy.order(takes, None if to is None else tuple(map(float, to)))
        except Refused as refused:
            refuse(str(refused))

    def _clutch(self, is_open: bool) -> None:
        if is_open:
            self._shell.endpoint.session.end(Code.CLUTCH)
            self._wait(Code.CLUTCH)
        else:
            self._go_on(Code.CLUTCH)

    def _scale(self, to: float) -> None:
        """Set the scale of the operator's transformer, in the session that runs and in those after it."""
        endpoint = self._shell.endpoint
        try:
            if endpoint.e != "m" or endpoint.scene.operator is None:
                raise Refused("a scale is set at a master whose scene has an operator's clutch, between whose device "
                              "and law it stands; order it there, and start both ends with --set clutch_ramp=0.05")
            endpoint.set_scale(self._shell.counts.last, to)
        except Refused as refused:
            refuse(str(refused))

    def _begin(self, order: dict[str, Any]) -> None:
        self._next = order
        self._wait(Code.TURN)
        self._shell.endpoint.session.end(Code.TURN)
        self._look()

    def _wait(self, why: Code) -> None:
        self._waits.add(why)
        self._shell.endpoint.session.renews = False

    def _go_on(self, why: Code) -> None:
        self._waits.discard(why)
        self._shell.endpoint.session.renews = not self._waits

    def _look(self) -> None:
        """See how far the turn has come, at each tick until it is done."""
        if self._next is not None and self._shell.endpoint.session.zero_force:
            order, self._next = self._next, None
            self._turn(order)
        elif self._turned and Code.TURN in self._waits:
            if not self._aligning or self._device.aligned:
                self._go_on(Code.TURN)
        elif self._turned and self._is_released():
            self._turned = False
            self._align(None)
        if self._next is None and not self._turned and self._newest is not None:
            order, self._newest = self._newest, None
            self._begin(order)

    def _is_released(self) -> bool:
        """True if the law's force is on again, or another turn or the clutch has ended the session meanwhile."""
        endpoint = self._shell.endpoint
        session = endpoint.session
        return self._newest is not None or (session.met > self._met and (
            session.ended is not None or not endpoint.guard.safe))

    def _turn(self, order: dict[str, Any]) -> None:
        """The end holds no force: make it one of the scene that is asked for."""
        shell = self._shell
        try:
            scene, knobs, manifest = self._load(order["knobs"])
            _check_alike(shell.scene, scene)
            endpoint = Endpoint(scene, shell.endpoint.e, shell.endpoint.session)
            endpoint.senses(bool(shell.device.sensor), shell.device.switches)
            if endpoint.policy is not None and shell.endpoint.policy is not None:
                endpoint.policy.page = shell.endpoint.policy.page
            deadline = deadline_of(self._device, endpoint)
            claimed = claim(order["out"])
            try:
                if hasattr(self._device, "turn"):
                    self._device.turn(scene, again=order.get("again", False))
            except Refused:
                claimed.drop()
                claimed.close()
                raise
        except Refused as refused:
            refuse(str(refused))
            self._go_on(Code.TURN)
            return
        k = shell.counts.last + shell.endpoint.every
        shell.recorder.note(Event(shell.counts.ran, "turned", _changes(self._knobs, knobs)))
        self._knobs = knobs
        shell.recorder.close()
        self._folder.go_on(claimed)
        self._folder.keep()
        recorder = self._record(scene, knobs)
        recorder.begin(shell.device.force_source)
        endpoint.session.manifest, endpoint.scale = manifest, shell.endpoint.scale
        if deadline is not None:
            endpoint.guard.lapse_after(deadline)
        endpoint.join(k, Code.TURN.sentence)
        shell.go_on(endpoint, recorder, EndCounts(last=shell.counts.last, first=k, ran=shell.counts.last))
        self._record_hand()
        self._met, self._turned = endpoint.session.met, True
        self._align(order.get("align"))
        tell("turned", k=k, out=order["out"])

    def _record_hand(self) -> None:
        if hasattr(self._device, "record"):
            self._device.record(self._folder.path)

    def _align(self, to: list[float] | None) -> None:
        if not hasattr(self._device, "align"):
            return
        try:
            self._device.align(None if to is None else tuple(map(float, to)))
            self._aligning = to is not None
        except Refused as refused:
            refuse(str(refused))


def _changes(before: dict[str, str], after: dict[str, str]) -> str:
    """Differences between the knobs, as text.

    >>> _changes({"law": "pfra", "delay": "0.1"}, {"delay": "0.2"})
    "delay=0.2, the scene's own law"
    """
    changed = [f"{name}={value}" for name, value in after.items() if before.get(name) != value]
    changed += [f"the scene's own {name}" for name in before if name not in after]
    return ", ".join(changed) or "the same again"


def _check_alike(before: Scene, after: Scene) -> None:
    """Refuse a scene that the running end cannot go on with: its grid of ticks and its axes stay."""
    if (before.dt_ns, before.axes) != (after.dt_ns, after.axes):
        raise Refused(f"a turn keeps the tick and the axes of the run, dt={before.dt:g} s and {before.axes}, and this "
                      f"one asks for dt={after.dt:g} s and {after.axes}; start both ends anew for that")
