"""Two live ends driven by hand: ticks are exact, and a relay carries what they send."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from channel.relay import Relay
from master.device import SimulatedMaster
from slave.robot import SimulatedSlave
from teleop import Reading, Scene, Wave, load_scene
from teleop.protocol.endpoint import Endpoint, Stepped
from teleop.protocol.manifest import manifest_of
from teleop.protocol.packet import Packet, decode
from teleop.protocol.session import Session
from teleop.simulation.plan import link_plans
from teleop.simulation.prepared import prepare
from teleop.simulation.structure import columns
from teleop.simulation.trace import EndRecord, assemble, end_columns
from tests.begun import begin

MS = 1_000_000
START = 10**12  # tick 0 on both clocks
SEED = 3
ROUGH = "uniform(0.012) | bernoulli(0.1) | duplicate(0.2, after=0.003)"


def scene(law: Any = None, **parts: Any) -> Scene:
    """A hand that pushes a slave against a wall; `parts` of a scene replace its own."""
    knobs: dict[str, Any] = {"law": law or Wave(), "duration": 0.4, "wall": 0.005, "delay": 0.02}
    return replace(load_scene("canonical", **knobs), **parts)


def packet_in(data: bytes, width: int = 1) -> Packet:
    packet = decode(data, width)
    assert isinstance(packet, Packet), packet
    return packet


def reading(x: float, v: float = 0.0) -> Reading:
    return Reading((x,), (v,), (0.0,))


def met(of: Scene, *, is_stepped: bool = False, base: int = 0) -> dict[str, Endpoint]:
    """Two ends that have agreed to start at START; `is_stepped`: each plays by the schedule of its link.

    `base`: the tick at START, at which they join a run that has been going on.
    """
    ends = {}
    plans = dict(zip("sm", link_plans(of, SEED), strict=True)) if is_stepped else {}
    for e in "ms":
        session = Session(master=e == "m", manifest=manifest_of(of), number=7)
        begin(session, START - base * of.dt_ns, START)
        session.take_data(START)
        ends[e] = Endpoint(of, e, session, Stepped(plans[e]) if is_stepped else None)
        if base:
            ends[e].join(base)
    return ends


@dataclass
class Both:
    """The two ends of a scene, at the ticks that it does not leave out, over its link."""

    scene: Scene
    intruder: Callable[[int, Both], Sequence[tuple[str, bytes]]] = lambda _k, _both: ()  # what else comes before tick k
    silent: Callable[[str, int], bool] = lambda _e, _k: False  # what an end sends at this tick is lost
    trouble: Callable[[str, int], str | None] = lambda _e, _k: None  # why an end may hold no force
    is_stepped: bool = False
    base: int = 0  # the number of the first tick
    ends: dict[str, Endpoint] = field(init=False)

    def __post_init__(self) -> None:
        self.ends = met(self.scene, is_stepped=self.is_stepped, base=self.base)
        self.sent: dict[str, list[bytes]] = {"m": [], "s": []}
        self.rows: dict[str, list[float]] = {"m": [], "s": []}
        self.played: dict[str, list[int]] = {"m": [], "s": []}
        self.held: dict[str, list[tuple[float, ...]]] = {"m": [], "s": []}
        self.ticks: dict[str, list[int]] = {"m": [], "s": []}

    def run(self) -> Both:
        of = self.scene
        relay = Relay(of.link, SEED, of.wire_size)
        devices: dict[str, Any] = {"m": SimulatedMaster(of), "s": SimulatedSlave(of)}
        skips = {e: part.left_out(i, of.ticks, SEED)
                 for i, e in enumerate("ms") if (part := getattr(of, f"left_out_{e}")) is not None}
        for k in range(of.ticks):
            at = k * of.dt_ns
            for direction, data in relay.due(at):
                assert self.ends["sm"[direction]].receive(data, START + at) == []
            for e, data in self.intruder(k, self):
                self.ends[e].receive(data, START + at)
            for direction, e in enumerate("ms"):
                if e in skips and skips[e][k]:
                    continue
                out = self.ends[e].tick(self.base + k, START + at, devices[e].read(k), self.trouble(e, k))
                devices[e].hold(out.force)
                self.ticks[e].append(k)
                self.rows[e].extend(out.row)
                self.played[e].append(out.played - self.base if out.played >= 0 else -1)
                self.held[e].append(out.force)
                if out.datagram is None:
                    assert of.deadband is not None or self.ends[e].session.ended is not None
                    continue
                self.sent[e].append(out.datagram)
                if not self.silent(e, k):
                    relay.receive(direction, k, out.datagram, at)
        return self

    def trace(self) -> dict[str, Any]:
        link = self.scene.link is not None
        return assemble(prepare(self.scene), {
            e: EndRecord(range(self.scene.ticks), self.rows[e], self.played[e] if link else None) for e in "ms"})

    def assert_records(self, trace: Any) -> None:
        """Each end has recorded, at the ticks that it ran, what the trace of a run has there, to the bit."""
        ready = prepare(self.scene)
        for e in "ms":
            played = self.played[e] if self.scene.link is not None else None
            recorded = end_columns(ready, e, EndRecord(self.ticks[e], self.rows[e], played))
            for name in [*[one.removesuffix("@") for one in columns(self.scene, e)], *[f"seq_{e}"] * bool(played)]:
                assert recorded[name].tobytes() == trace[name][self.ticks[e]].tobytes(), name

    def gains(self, e: str = "s") -> np.ndarray[Any, Any]:
        """What the guard let through, tick by tick."""
        rows = np.reshape(self.rows[e], (self.scene.ticks, -1))
        return rows[:, columns(self.scene, e).index(f"g_{e}")]
