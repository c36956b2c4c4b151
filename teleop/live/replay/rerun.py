"""Rerun of one end's law over the record of what it read and heard, by the lines of the tick that ran live.

Of another law, or other knobs, that gives what it would have commanded along the recorded motion, open loop: each end
reads what it read, holds what it held, and has the guard's gain that it had. Where there are both ends' folders, each
hears the messages that the other end's law would have sent, when they came; of one end alone the law hears what was
heard then, so it has to be a law of the same messages.
"""

from __future__ import annotations

from array import array
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from math import isfinite, isnan
from pathlib import Path
from struct import pack, unpack
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.errors import Refused, enumerated
from teleop.law import law_name, messages
from teleop.live.records.end_result import NAMES
from teleop.live.records.inputs import ArrivalTable, Inputs, flat, message_fields, read_arrivals, read_inputs
from teleop.live.records.reader import OWN, check_fits, read_record
from teleop.live.records.record import read_events
from teleop.protocol.end_law import Axes, EndLaw, LawAnswer, Origin
from teleop.protocol.inbox import Inbox
from teleop.protocol.reception import since
from teleop.scene.scene import Scene
from teleop.simulation.prepared import prepare
from teleop.simulation.structure import SENSED, structure_of
from teleop.simulation.tick import LiveTick
from teleop.simulation.trace import EndRecord, blocks, end_columns
from teleop.stages.wave_integral import Integrals

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

KEPT = 65536  # messages of an end that are kept, as far back as an inbox tells packets apart
AHEAD = 64  # ticks by which arrivals are handed over before they are due, as their order is that of their coming


class EndFolder(NamedTuple):
    """Folder of one end: the header of its record, its rows, and its inputs at each of them."""

    folder: Path
    header: dict[str, Any]
    record: EndRecord
    inputs: Inputs

    @property
    def e(self) -> str:
        """The end, m or s."""
        return str(self.header["end"])

    @property
    def ticks(self) -> int:
        """Ticks of which there is all."""
        return min(len(self.record.ticks), len(self.inputs.rows))


def read_end(folder: Path, scene: Scene) -> EndFolder:
    """Read the folder of an end of a run of `scene`. Warns of what is cut off; raises `Refused`."""
    header, record, _ = read_record(folder)
    check_fits(scene, header, record.ticks, folder)
    return EndFolder(folder, header, record, read_inputs(folder, scene, header))


class TickInputs(NamedTuple):
    """Inputs of an end at one tick, as its row has them."""

    k: int  # tick of the grid
    session: int
    fresh: bool
    newest: float
    gain: float
    since: int
    x: Axes
    v: Axes
    f_ext: Axes | None
    f_held: Axes
    rx: Axes  # the message, axis by axis; zeros where there is none
    waves: Axes  # and what its waves have come to, where that is sent along
    switches: tuple[float, float, float]  # of the operator: clutch, presence and scale, as a `LiveTick` has them
    policy: tuple[float, float, Axes | None]  # its switch, whether an action came, and the newest
    origin: Axes | None  # where the positions count from, m; None: the device's zero


# The message that a tick plays: its number, the law's, and what its waves have come to.
Heard = Callable[[TickInputs, bool], tuple[float, Any, Any] | None]


def tick_inputs(end: EndFolder) -> Iterator[tuple[TickInputs, list[float]]]:
    """Inputs of the end, tick by tick, and its outputs: force and message as numbers."""
    at, rows = end.inputs.places, end.inputs.rows
    nothing = slice(0, 0)  # of a law whose messages are empty
    places = [at.get(name, nothing) for name in (f"x_{end.e}", f"v_{end.e}", "f_held", "rx", "waves", "index")]
    sensed = at.get("f_ext")
    switches = slice(at["clutch"].start, at["scale"].stop) if "clutch" in at else None
    policy = at.get("wants")
    answer = at[f"f_{end.e}"].start
    for block in blocks(end.ticks):
        for row in rows.part(block.start, block.stop).tolist():
            k, since, session, fresh, newest, gain = row[:6]
            x, v, held, rx, waves, index = [tuple(row[one]) for one in places]
            yield TickInputs(int(k), int(session), fresh != 0.0, newest, gain, int(since), x, v,
                       None if sensed is None else tuple(row[sensed]), held, rx, waves,
                       (0.0, 1.0, 1.0) if switches is None else (row[switches][0], row[switches][1], row[switches][2]),
                       (0.0, 0.0, None) if policy is None else (*row[policy.start:policy.start + 2],
                                                                tuple(row[at["action"]])),
                       None if isnan(index[0]) else index), row[answer:]


class Rerun:
    """The law of one end, tick by tick, in `scene`, which may have another law or other knobs than the run had."""

    def __init__(self, end: EndFolder, scene: Scene, touch: NDArray[np.float64] | None = None) -> None:
        """`touch`: the external force at each row (N, per axis) where the device sensed none and the law reads one."""
        e, every = end.e, end.inputs.every
        self._every, self._touch, self._at = every, touch, 0
        self._axes, self._origin = scene.axes, Origin(scene, e)
        at_rate = replace(scene, dt=scene.dt * every) if every != 1 else scene
        self._law = EndLaw(at_rate, e, end.inputs.sensor or touch is not None, self._origin)
        forth, back = messages(scene.laws[0], at_rate.dt_ns / 1e9)
        self._kind = back if e == "m" else forth
        self._session = 0

    def tick(self, inputs: TickInputs, heard: Heard | None = None) -> LawAnswer:
        """Run one tick. `heard`: what it plays then in place of the message in its record."""
        touch = inputs.f_ext
        if self._touch is not None:
            touch = tuple(self._touch[self._at].tolist())
            self._at += 1
        begins = inputs.session != self._session
        if begins:
            self._session = inputs.session
            self._law.begin(inputs.x, inputs.v, touch)
        if heard is None:
            got, newest, rx, waves = inputs.fresh, inputs.newest, None, None
            if got:
                rx, waves = self._by_axis(self._kind, inputs.rx), self._by_axis(Integrals, inputs.waves)
        else:
            played = heard(inputs, begins)
            got, newest, rx, waves = (False, -1, None, None) if played is None else (True, *played)
        self._origin.at = inputs.origin
        return self._law.answer(LiveTick(
            inputs.k // self._every, inputs.x, inputs.v, touch, got, newest, rx, waves, inputs.gain, inputs.f_held,
            inputs.since, *inputs.switches, *inputs.policy))

    def _by_axis(self, kind: Any, numbers: Axes) -> tuple[Any, ...] | None:
        """A message of each axis out of its numbers; None where none is sent along."""
        n = len(kind._fields)
        return tuple([kind(*numbers[i * n : i * n + n]) for i in range(self._axes)]) if numbers or not n else None


class Difference(NamedTuple):
    """The first number in which a replay is not what was recorded."""

    k: int
    field: str
    recorded: float
    replayed: float


def difference(end: EndFolder, scene: Scene) -> Difference | None:
    """Run the law of `end` again, and compare force, message and row bit by bit; None if all are the same."""
    import numpy as np

    rerun = Rerun(end, scene)
    at, e = end.inputs.places, end.e
    fields = [*end.inputs.header["columns"][at[f"f_{e}"].start :], *end.header["columns"][len(OWN) :]]
    table: Any = end.record.rows
    row, ticks = 0, np.asarray(end.record.ticks)
    rows: list[list[float]] = []
    for i, (one, answered) in enumerate(tick_inputs(end)):
        if i == row:
            rows = table.table(i, row := min(i + 4096, end.ticks)).tolist()
        if one.k != ticks[i]:
            raise Refused(f"{end.folder} has tick {int(ticks[i])} in its record and tick {one.k} in what it was told; "
                          "its files are of two runs: give the folder as the end wrote it")
        force, tx, sent, answered_row = rerun.tick(one)
        replayed = (*force, *flat(tx), *flat(sent or ()), *answered_row)
        recorded = (*answered, *rows[i - row])
        form = f"<{len(fields)}d"
        if pack(form, *replayed) != pack(form, *recorded):
            for name, was, now in zip(fields, unpack(form, pack(form, *recorded)),
                                      unpack(form, pack(form, *replayed)), strict=True):
                if pack("<d", was) != pack("<d", now):
                    return Difference(one.k, name, was, now)
    return None


class OpenLoopForces(NamedTuple):
    """Forces that one end's law commanded, and that the other law would have: arrays of a row for each tick."""

    k: NDArray[np.int64]
    recorded: NDArray[np.float64]  # N, (ticks, axes)
    commanded: NDArray[np.float64]
    unknown: int = 0  # messages that it played in the run, sent at ticks that the other end's folder does not have


def command_open_loop(ends: Sequence[EndFolder], base: Scene, scene: Scene) -> dict[str, OpenLoopForces]:
    """Run the law of `scene` open loop at each of `ends` of a run of `base`. Raises `Refused`."""
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
    sources = {end.e: tick_inputs(end) for end in ends}
    exchange = None if len(ends) == 1 else Exchange(ends, scene)
    forces = {end.e: (array("q"), array("d"), array("d")) for end in ends}  # 24 bytes a tick, in one axis
    waiting = {e: first for e, source in sources.items() if (first := next(source, None)) is not None}
    while waiting:
        e = min(waiting, key=lambda e: (waiting[e][0].k, e))
        one, answered = waiting.pop(e)
        force, tx, sent, _ = reruns[e].tick(one, None if exchange is None else partial(exchange.play, e))
        if exchange is not None:
            exchange.send(e, one.k, (tx, sent))
        ticks, was, now = forces[e]
        ticks.append(one.k)
        was.extend(answered[: scene.axes])
        now.extend(force)
        if (following := next(sources[e], None)) is not None:
            waiting[e] = following
    return {e: OpenLoopForces(np.array(k, np.int64), np.array(was, float).reshape(-1, scene.axes),
                         np.array(now, float).reshape(-1, scene.axes), 0 if exchange is None else exchange.unknown[e])
            for e, (k, was, now) in forces.items()}


class Exchange:
    """The messages of both ends on the way that the recorded ones took."""

    def __init__(self, ends: Sequence[EndFolder], scene: Scene) -> None:
        self._scene = scene
        self._sent: dict[str, dict[int, Any]] = {end.e: {} for end in ends}
        self._arrivals: dict[str, ArrivalTable | None] = {
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

    def play(self, e: str, inputs: TickInputs, begins: bool) -> tuple[int, Any, Any] | None:
        """The message that the end `e` plays at a tick, see `Heard`. `begins`: it is the first tick of a session."""
        arrivals, k = self._arrivals[e], inputs.k
        if begins:
            self._before.pop(e, None)
        if arrivals is None:  # it went by packets, each played by a schedule
            packet = int(inputs.newest) if inputs.fresh and isfinite(inputs.newest) else None
        else:
            i, session = self._next[e], arrivals.session
            if begins:
                self._inboxes[e] = Inbox(self._scene.played_as, self._scene.dt_ns, tick=k - 1)
                i = max(i, bisect_right(session, inputs.session - 1))
            inbox = self._inboxes[e]
            while i < len(session) and session[i] == inputs.session and arrivals.tick[i] <= k + AHEAD:
                inbox.add(int(arrivals.packet[i]), int(arrivals.tick[i]), None)
                i += 1
            self._next[e] = i
            got = inbox.take(k)
            packet = None if got is None else got[0]
        message = self._sent["s" if e == "m" else "m"].get(-1 if packet is None else packet)
        if packet is None or message is None:
            self.unknown[e] += packet is not None
            return None
        tx, waves = message
        if waves is not None and (inputs.session > 1 or e in self._joined):
            waves = since(self._before.setdefault(e, waves), waves)
        return packet, tx, waves


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
