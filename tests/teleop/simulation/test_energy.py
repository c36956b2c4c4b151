"""The two ledgers, E_link and E_port, against their definitions summed anew from the trace."""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
import pytest

from channel import Bernoulli, Delay, UniformJitter
from master.hand import Grip, Sine
from slave.wall import Wall
from teleop import PFRA, Direct, Fixed, Hold, MassDamper, Scene, Wave, Zero, run

DT, B = 1e-3, 2.0
LINKS = {
    "none": None, "zero": Delay(0.0), "50 ms": Delay(0.05),
    "rough": Delay(0.01) | UniformJitter(0.02) | Bernoulli(0.2),
}


def make(**other: Any) -> Scene:
    """A hand that swings a master over waves, and a slave that strikes a wall."""
    return Scene(**{
        "law": Wave(b=B), "master": MassDamper(mass=0.1, damping=0.5), "slave": MassDamper(mass=0.5, damping=1.0),
        "hand": Grip(mass=0.4, k=200.0, d=5.0, reference=Sine(amplitude=0.05, frequency=1.0)),
        "environment": Wall(k=5e3, d=5.0, at=0.02), "energy": True, "duration": 1.0, "playout": Zero(), **other,
    })


def waves(trace: dict[str, Any]) -> tuple[np.ndarray, ...]:
    """u_m, w_m, u_s, w_s of every tick: the master's from f_m and v_m, the slave's by who played what."""
    root = sqrt(2.0 * B)
    u_m = (B * trace["v_m"] + trace["f_m"]) / root
    w_m = (B * trace["v_m"] - trace["f_m"]) / root
    fresh = trace["seq_s"] >= 0
    u_s = np.where(fresh if u_m.ndim == 1 else fresh[:, None], u_m[trace["seq_s"]], 0.0)
    w_s = u_s - sqrt(2.0 / B) * trace["f_s"]
    return u_m, w_m, u_s, w_s


def summed(power: np.ndarray) -> np.ndarray:
    """Over the axes, and over the ticks so far."""
    return np.cumsum(0.5 * DT * (power if power.ndim == 1 else power.sum(axis=1)))


@pytest.mark.parametrize("axes", [1, 3])
@pytest.mark.parametrize("link", ["zero", "50 ms", "rough"])
def test_e_link_is_the_sum_of_the_waves_that_went_in_less_those_that_came_out(link: str, axes: int) -> None:
    hand = Grip(mass=0.4, k=200.0, d=5.0, reference=Sine(amplitude=(0.05, 0.02, -0.03)[:axes], frequency=1.0))
    trace = dict(run(make(link=LINKS[link], axes=axes, hand=hand), seed=2).trace)
    u_m, w_m, u_s, w_s = waves(trace)
    assert trace["E_link"] == pytest.approx(summed(u_m**2 + w_s**2 - u_s**2 - w_m**2), abs=1e-13)
    for name, wave in (("E_in_fwd", u_m), ("E_in_bwd", w_s), ("E_out_fwd", u_s), ("E_out_bwd", w_m)):
        assert trace[name] == pytest.approx(summed(wave**2), abs=1e-13)
    assert trace["E_link"].max() > 1e-5


def test_over_a_constant_delay_e_link_is_what_is_under_way() -> None:
    """Stored is each wave that was sent within the last `delay` ticks, this one's included."""
    for delay in (1, 7, 400):
        trace = dict(run(make(link=Delay(delay * DT))).trace)
        u_m, _, _, w_s = waves(trace)
        sent = np.concatenate([np.zeros(delay), summed(u_m**2 + w_s**2)])
        assert trace["E_link"] == pytest.approx(sent[delay:] - sent[:-delay], abs=1e-13), delay
        if delay == 1:  # as without a link
            for name, column in run(make(link=None)).trace.items():
                assert np.array_equal(column, trace[name]), name


def test_e_port_pairs_each_held_force_with_the_motion_it_was_held_over() -> None:
    for law, axes, link in ((Wave(b=B), 1, "rough"), (PFRA(K=200.0, B=5.0), 3, "50 ms"),
                            (Direct(K=200.0, B=5.0, kf=0.3), 3, "rough"), (Wave(b=B), 3, "none")):
        trace = run(make(law=law, link=LINKS[link], axes=axes), seed=2).trace
        f_m, f_s, x_m, x_s = (trace[name].reshape(-1, axes) for name in ("f_m", "f_s", "x_m", "x_s"))
        steps = (f_m[:-1] * np.diff(x_m, axis=0) - f_s[:-1] * np.diff(x_s, axis=0)).sum(axis=1)
        assert trace["E_port"] == pytest.approx(np.concatenate([[0.0], np.cumsum(steps)]), abs=1e-12), (law, link)
        assert np.abs(trace["E_port"]).max() > 1e-4, (law, link)


def test_what_the_port_gives_the_slave_is_its_motion() -> None:
    """A free slave without damping has the energy M v^2/2 that the held force put into it: exactly that pairing."""
    scene = make(environment=None, slave=MassDamper(mass=0.5), link=Delay(0.02))
    trace = run(scene).trace
    given = trace["E_port_m"] - trace["E_port"]
    assert given == pytest.approx(0.25 * trace["v_s"] ** 2, abs=1e-13)


def test_the_hold_leaks_at_the_port_beside_a_perfect_link() -> None:
    """E_port may fall below zero where E_link does not: it contains the hold's own leak."""
    scene = make(link=Delay(0.0), law=Wave(b=20.0, K=2e4, B=5.0), slave=MassDamper(mass=0.05), duration=2.0)
    got = run(scene).metrics
    assert got["E_link_min"] >= 0.0
    assert got["E_port_min"] < -1e-4


@pytest.mark.parametrize("playout", [None, Fixed(0.04)])
def test_energy_received_is_never_above_the_stamp_of_its_packet_in_either_direction(playout: Fixed | None) -> None:
    scene = make(link=LINKS["rough"], **({"playout": playout} if playout else {}))
    got = run(scene, seed=4).metrics
    assert got["E_fwd_min"] >= -1e-12
    assert got["E_bwd_min"] >= -1e-12


def test_held_waves_are_counted_as_often_as_they_are_used() -> None:
    trace = dict(run(make(link=LINKS["rough"], playout=Hold()), seed=2).trace)
    root = sqrt(2.0 * B)
    w_m = (B * trace["v_m"] - trace["f_m"]) / root
    assert (trace["seq_m"] < 0).mean() > 0.3
    assert trace["E_out_bwd"] == pytest.approx(summed(w_m**2), abs=1e-13)


def test_a_scene_that_does_not_ask_has_no_ledger() -> None:
    asked, silent = run(make(link=LINKS["rough"]), seed=1), run(make(link=LINKS["rough"], energy=False), seed=1)
    assert not [name for name in silent.trace if name.startswith("E_")]
    assert not [name for name in silent.metrics if name.startswith("E_")]
    assert all(np.array_equal(asked.trace[name], silent.trace[name]) for name in silent.trace)


def test_a_law_without_waves_has_the_ports_ledger_alone() -> None:
    ledgers = {name for name in run(make(law=Direct(), duration=0.05)).trace if name.startswith("E_")}
    assert ledgers == {"E_port", "E_port_m", "E_port_s"}
