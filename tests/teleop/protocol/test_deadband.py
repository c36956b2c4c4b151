"""Live ends with a deadband: what they do not send, and that the other end goes on with what was sent last."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from channel.relay import Relay
from master.device import SimulatedMaster
from slave.robot import SimulatedSlave
from teleop import Cap, Deadband, Refused, Scene, Watchdog, load_scene, run
from teleop.live.options import ticks_of
from teleop.protocol.endpoint import Endpoint
from teleop.protocol.manifest import manifest_difference, manifest_of
from teleop.protocol.session import Session
from teleop.simulation.prepared import prepare
from teleop.simulation.structure import columns
from teleop.simulation.trace import EndRecord, end_columns
from tests.begun import begin
from tests.teleop.protocol.test_endpoint import START

SEED = 3
ROUGH = "delay(0.01) | uniform(0.012) | bernoulli(0.1) | duplicate(0.2, after=0.003)"


def scene(law: str, **parts: Any) -> Scene:
    made = load_scene("canonical", law=law, wall=0.005, link=ROUGH)
    return replace(made, duration=0.4, energy=True, deadband=Deadband(k=0.1), **parts)


def lived(of: Scene) -> tuple[dict[str, Endpoint], dict[str, dict[str, np.ndarray]], dict[str, int]]:
    """Two live ends over a relay: the ends, the columns that they recorded, and the datagrams of each."""
    relay = Relay(of.link, SEED, of.wire_size)  # type: ignore[arg-type]
    devices: dict[str, Any] = {"m": SimulatedMaster(of), "s": SimulatedSlave(of)}
    ends, datagrams = {}, {"m": 0, "s": 0}
    for e in "ms":
        session = Session(master=e == "m", manifest=manifest_of(of), number=7)
        begin(session, START, START)
        session.take_data(START)
        ends[e] = Endpoint(of, e, session)
    rows: dict[str, list[float]] = {"m": [], "s": []}
    played: dict[str, list[int]] = {"m": [], "s": []}
    for k in range(of.ticks):
        now = START + k * of.dt_ns
        for direction, data in relay.due(k * of.dt_ns):
            assert ends["sm"[direction]].receive(data, now) == []
        for direction, e in enumerate("ms"):
            tick = ends[e].tick(k, now, devices[e].read(k))
            devices[e].hold(tick.force)
            rows[e].extend(tick.row)
            played[e].append(tick.played)
            if tick.datagram is not None:
                datagrams[e] += 1
                relay.receive(direction, k, tick.datagram, k * of.dt_ns)
    ready = prepare(of)
    found = {e: end_columns(ready, e, EndRecord(range(of.ticks), rows[e], played[e])) for e in "ms"}
    names = {e: [*[name.removesuffix("@") for name in columns(of, e)], f"seq_{e}"] for e in "ms"}
    return ends, {e: {name: found[e][name] for name in names[e]} for e in "ms"}, datagrams


@pytest.mark.parametrize("of", [scene("direct"), scene("wave"), scene("pfra", watchdog=Watchdog(timeout=0.06),
                                                                      cap=Cap(f_max=9.0))], ids=lambda of: str(of.law))
def test_live_ends_are_the_run_in_virtual_time_and_send_no_datagram_for_what_it_saves(of: Scene) -> None:
    result = run(of, seed=SEED)
    ends, found, datagrams = lived(of)
    for e, way in (("m", "fwd"), ("s", "bwd")):
        assert datagrams[e] == result.packets[way].sent
        assert ends[e].saved == result.packets[way].saved > 0.3 * of.ticks
        assert not ends[e].session.ended
        for name, column in found[e].items():
            assert column.tobytes() == result.trace[name].tobytes(), name
    assert ends["s"].received > 0
    assert np.abs(result.trace["f_s"]).max() > 0.1


def test_ends_with_other_deadbands_are_told_so() -> None:
    of = scene("direct")
    told = manifest_difference(manifest_of(of), manifest_of(replace(of, deadband=Deadband(k=0.2))))
    assert "deadband is Deadband(k=0.1" in str(told)


def test_ends_that_go_by_packets_take_no_deadband() -> None:
    with pytest.raises(Refused, match="each end waits for the other's packet of every tick"):
        ticks_of(scene("direct"), None, lockstep=True, spin=False)
