"""Live ends that leave out ticks are the run in virtual time in which the same ticks are left out, bit for bit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from channel import LeftOut, LeftOutTicks
from channel.relay import Relay
from master.device import SimulatedMaster
from slave.robot import SimulatedSlave
from teleop import Cap, Device, EndFit, Fixed, Hold, LowPass, Scene, Watchdog, Zero, load_scene, run
from teleop.laws.pfra import PFRA
from teleop.laws.wave import Wave
from teleop.protocol.endpoint import Endpoint, Stepped
from teleop.protocol.manifest import manifest_of
from teleop.protocol.session import Session
from teleop.scene.playout import Integral
from teleop.simulation.plan import link_plans
from teleop.simulation.prepared import prepare
from teleop.simulation.structure import columns
from teleop.simulation.trace import EndRecord, end_columns
from teleop.stages.encoder import Encoder
from tests.begun import begin
from tests.teleop.law.test_span import Timed
from tests.teleop.protocol.test_endpoint import START

SEED = 3
ROUGH = "delay(0.01) | uniform(0.012) | bernoulli(0.1) | duplicate(0.2, after=0.003)"


def scene(law: Any, **other: Any) -> Scene:
    """A swing against a wall over a rough link, a fifth of the ticks left out in stretches at both ends."""
    base = load_scene("canonical", law=law, wall=0.005, link=other.pop("link", ROUGH))
    parts: dict[str, Any] = {"duration": 0.4, "energy": True, "left_out_m": LeftOut(0.2, 3.0),
                             "left_out_s": LeftOut(0.2), "playout": Zero(), **other}
    return replace(base, **parts)


def lived(of: Scene, *, stepped: bool) -> dict[str, tuple[list[int], dict[str, np.ndarray]]]:
    """The ticks that each of two live ends ran, and the columns that they recorded."""
    relay = Relay(of.link, SEED, of.wire_size)  # type: ignore[arg-type]
    devices: dict[str, Any] = {"m": SimulatedMaster(of), "s": SimulatedSlave(of)}
    plans = dict(zip("sm", link_plans(of, SEED), strict=True))
    ends, out = {}, {}
    for number, e in enumerate("ms"):
        session = Session(master=e == "m", manifest=manifest_of(of), number=7)
        begin(session, START, START)
        session.take_data(START)
        ends[e] = Endpoint(of, e, session, Stepped(plans[e]) if stepped else None)
        out[e] = getattr(of, f"left_out_{e}").left_out(number, of.ticks, SEED)
    ticks: dict[str, list[int]] = {"m": [], "s": []}
    rows: dict[str, list[float]] = {"m": [], "s": []}
    played: dict[str, list[int]] = {"m": [], "s": []}
    for k in range(of.ticks):
        now = START + k * of.dt_ns
        for direction, data in relay.due(k * of.dt_ns):
            assert ends["sm"[direction]].receive(data, now) == []
        for direction, e in enumerate("ms"):
            if out[e][k]:
                continue
            tick = ends[e].tick(k, now, devices[e].read(k))
            devices[e].hold(tick.force)
            ticks[e].append(k)
            rows[e].extend(tick.row)
            played[e].append(tick.played)
            assert tick.datagram is not None
            relay.receive(direction, k, tick.datagram, k * of.dt_ns)
    ready = prepare(of)
    found = {e: end_columns(ready, e, EndRecord(ticks[e], rows[e], played[e])) for e in "ms"}
    names = {e: [*[name.removesuffix("@") for name in columns(of, e)], f"seq_{e}"] for e in "ms"}
    return {e: (ticks[e], {name: found[e][name] for name in names[e]}) for e in "ms"}


def assert_same(of: Scene, *, stepped: bool) -> None:
    virtual = run(of, seed=SEED).trace
    for ticks, found in lived(of, stepped=stepped).values():
        assert 0.7 * of.ticks < len(ticks) < 0.9 * of.ticks
        for name, column in found.items():
            assert column.tobytes() == virtual[name][ticks].tobytes(), name
    assert np.abs(virtual["f_s"]).max() > 0.1


DEVICES = {"device_m": Device(velocity=LowPass(cutoff=40.0)),
           "device_s": Device(encoder=Encoder(step=1e-5), velocity=EndFit(noise=1e-5), every=3, delay=2)}
CASES = {
    "waves, zero": lambda: scene(Wave()),
    "waves, hold": lambda: scene(Wave(), playout=Hold()),
    "waves, fixed": lambda: scene(Wave(), playout=Fixed(0.02)),
    "waves, by their integral": lambda: scene(Wave(), playout=Integral()),
    "observer, caps, devices": lambda: scene(PFRA(alpha=0.2), cap=Cap(f_max=9.0, slew=2000.0, power=0.05), **DEVICES),
    "span and gain": lambda: scene(Timed()),
}


@pytest.mark.parametrize("name", CASES)
def test_live_ends_that_leave_out_ticks_are_the_run_in_virtual_time(name: str) -> None:
    assert_same(CASES[name](), stepped=False)


WATCHED = Watchdog(timeout=0.012, ramp=0.01, settle=0.02)


@pytest.mark.parametrize("law", [Timed(), PFRA(alpha=0.2)])
def test_the_watchdog_too_where_packets_are_played_by_a_schedule(law: Any) -> None:
    """In silences and in stalls; live a datagram counts from its coming, a message in virtual time from its playing."""
    link = "delay(0.03) | blackout(0.1, 0.06) | bernoulli(0.1)"
    stalls = LeftOutTicks((5, 6, 50, *range(230, 250), 260, *range(300, 315), *range(330, 355)))
    of = scene(law, link=link, watchdog=WATCHED, left_out_m=stalls, cap=Cap(slew=3000.0))
    virtual = run(of, seed=SEED).trace
    assert {0.0, 1.0} < set(virtual["g_m"].tolist())
    assert virtual["g_m"][249] == 1.0  # stalled, and nothing was read
    assert virtual["g_m"][250] == 0.0  # for longer than timeout and ramp
    assert_same(of, stepped=True)
