"""What another law, or other knobs, would have commanded along a recorded motion: open loop.

Each end reads what it read, holds what it held, and has the guard's gain that it had. Where there are both ends'
folders, each hears the messages that the other end's law would have sent, when they came; of one end alone the law
hears what was heard then, so it has to be a law of the same messages.
"""

from __future__ import annotations

from array import array
from bisect import bisect_right
from collections.abc import Sequence
from functools import partial
from math import isfinite
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.errors import Refused, enumerated
from teleop.law import law_name
from teleop.live.records.end_result import NAMES
from teleop.live.records.inputs import Arrivals, message_fields, read_arrivals
from teleop.live.records.record import read_events
from teleop.live.replay.rerun import EndFolder, Rerun, Told, told
from teleop.protocol.inbox import Inbox
from teleop.scene.scene import Scene
from teleop.simulation.prepared import prepare
from teleop.simulation.structure import SENSED, structure_of
from teleop.simulation.trace import end_columns
from teleop.stages.wave_integral import Integrals

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

KEPT = 65536  # messages of an end that are kept, as far back as an inbox tells packets apart
AHEAD = 64  # ticks by which arrivals are handed over before they are due, as their order is that of their coming


class Commanded(NamedTuple):
    """What one end's law commanded, and what the other one would have: arrays of a row for each tick."""

    k: NDArray[np.int64]
    recorded: NDArray[np.float64]  # N, (ticks, axes)
    commanded: NDArray[np.float64]
    unknown: int = 0  # messages that it played in the run, sent at ticks that the other end's folder does not have


def commanded(ends: Sequence[EndFolder], base: Scene, scene: Scene) -> dict[str, Commanded]:
    """What the law of `scene` would have commanded at each of `ends` of a run of `base`. Raises `Refused`."""
    import numpy as np

    if (scene.dt_ns, scene.axes) != (base.dt_ns, base.axes):
        raise Refused("the record has the ticks and the axes of its run, and none of another dt or number of axes; "
                      "leave out what sets them")
    if len(ends) == 1:
        _check_same_messages(ends[0], base, scene)
    elif any(end.inputs.every != 1 for end in ends):
        raise Refused("the ends ticked at a rate of their own (--rate), so what they would have heard of each other is "
                      "not known; give one end's folder, and a law of the same messages")
    reruns = {end.e: Rerun(end, scene, _touch(end, base, scene)) for end in ends}
    sources = {end.e: told(end) for end in ends}
    exchange = None if len(ends) == 1 else Exchange(ends, scene)
    found = {end.e: (array("q"), array("d"), array("d")) for end in ends}  # 24 bytes a tick, in one axis
    waiting = {e: first for e, source in sources.items() if (first := next(source, None)) is not None}
    while waiting:
        e = min(waiting, key=lambda e: (waiting[e][0].k, e))
        one, answered = waiting.pop(e)
        got = reruns[e].tick(one, None if exchange is None else partial(exchange.play, e))
        if exchange is not None:
            exchange.send(e, one.k, (got.tx, got.sent))
        ticks, was, now = found[e]
        ticks.append(one.k)
        was.extend(answered[: scene.axes])
        now.extend(got.force)
        if (following := next(sources[e], None)) is not None:
            waiting[e] = following
    return {e: Commanded(np.array(k, np.int64), np.array(was, float).reshape(-1, scene.axes),
                         np.array(now, float).reshape(-1, scene.axes), 0 if exchange is None else exchange.unknown[e])
            for e, (k, was, now) in found.items()}


class Exchange:
    """The messages of both ends on the way that the recorded ones took."""

    def __init__(self, ends: Sequence[EndFolder], scene: Scene) -> None:
        self._scene = scene
        self._sent: dict[str, dict[int, Any]] = {end.e: {} for end in ends}
        self._arrivals: dict[str, Arrivals | None] = {
            end.e: None if end.header["mode"] == "lockstep" else read_arrivals(end.folder) for end in ends}
        self._inboxes: dict[str, Inbox[None]] = {}
        self._next = {end.e: 0 for end in ends}  # of the arrivals
        # Of a session that did not begin with tick 0 at both ends: what waves had come to in the first message played.
        self._before: dict[str, tuple[Integrals, ...]] = {}
        self.unknown = {end.e: 0 for end in ends}  # messages that came and that the other end's folder has no tick of
        self._joined = {end.e for end in ends if any(one["what"] == "joined" for one in read_events(end.folder))}

    def send(self, e: str, k: int, message: tuple[Any, Any]) -> None:
        """The end `e` sends its message of tick k: the law's, and what its waves have come to."""
        sent = self._sent[e]
        sent[k] = message
        if len(sent) > 2 * KEPT:
            self._sent[e] = {at: sent[at] for at in [*sent][-KEPT:]}

    def play(self, e: str, told: Told, begins: bool) -> tuple[int, Any, Any] | None:
        """The message that the end `e` plays at a tick, see `Heard`. `begins`: it is the first tick of a session."""
        arrivals, k = self._arrivals[e], told.k
        if begins:
            self._before.pop(e, None)
        if arrivals is None:  # it went by packets, each played by a schedule
            packet = int(told.newest) if told.fresh and isfinite(told.newest) else None
        else:
            i, session = self._next[e], arrivals.session
            if begins:
                self._inboxes[e] = Inbox(self._scene.played_as, self._scene.dt_ns, tick=k - 1)
                i = max(i, bisect_right(session, told.session - 1))
            inbox = self._inboxes[e]
            while i < len(session) and session[i] == told.session and arrivals.tick[i] <= k + AHEAD:
                inbox.put(int(arrivals.packet[i]), int(arrivals.tick[i]), None)
                i += 1
            self._next[e] = i
            got = inbox.take(k)
            packet = None if got is None else got[0]
        message = self._sent["s" if e == "m" else "m"].get(-1 if packet is None else packet)
        if packet is None or message is None:
            self.unknown[e] += packet is not None
            return None
        tx, waves = message
        if waves is not None and (told.session > 1 or e in self._joined):
            waves = since(self._before.setdefault(e, waves), waves)
        return packet, tx, waves


def since(before: tuple[Integrals, ...], waves: tuple[Integrals, ...]) -> tuple[Integrals, ...]:
    """What waves have come to since they had come to as much, per axis."""
    return tuple([Integrals(*[now - then for now, then in zip(each, one, strict=True)])
                  for each, one in zip(waves, before, strict=True)])


def _check_same_messages(end: EndFolder, base: Scene, scene: Scene) -> None:
    """Refuse another law's messages in the place of those that the end heard."""
    were, are = (message_fields(each, end.e)[0] for each in (base, scene))
    if were != are:
        raise Refused(f"the {NAMES[end.e]} heard {enumerated(were)} of the law {law_name(base.law)}, and the law "
                      f"{law_name(scene.laws[0])} hears {enumerated(are)}; give both ends' folders, and each hears "
                      "what the other end's law would have sent")
    if structure_of(scene).has.integral and not structure_of(base).has.integral:
        raise Refused("the messages of the run came without what their waves have come to, by which this playout plays "
                      "them; give both ends' folders, or leave playout out")


def _touch(end: EndFolder, base: Scene, scene: Scene) -> NDArray[np.float64] | None:
    """The external force at each row, worked out from the scene's bodies, if the law reads what no device sensed."""
    has = getattr(structure_of(scene), end.e).has
    if end.inputs.sensor or not has.felt:
        return None
    makers = end_columns(prepare(base), end.e, end.record).makers
    if SENSED[end.e] not in makers:
        raise Refused(f"the law {law_name(scene.laws[0])} reads {SENSED[end.e]}, and the {NAMES[end.e]}'s device "
                      "sensed none; take a law that reads none")
    force: NDArray[np.float64] = makers[SENSED[end.e]]()
    return force.reshape(-1, scene.axes)
