"""Direct position-force control: what each end does, and the delay it stands."""

from __future__ import annotations

import numpy as np
import pytest

from channel import Delay, Link
from master.hand import Grip, Rest
from slave.tissue import Tissue
from teleop import MassDamper, Scene, run
from teleop.law import At, start_at
from teleop.laws.direct import Back, Direct, Forth


def test_the_slave_is_drawn_to_the_master_by_a_spring_damper() -> None:
    at = At(0.02, 0.1, 7.0, 0.0, 0.0, True, 0.0, 1e-3)
    f_s, back, _ = Direct(K=500.0, B=20.0).slave((), at, Forth(0.05, 0.3))
    assert f_s == 500.0 * (0.05 - 0.02) + 20.0 * (0.3 - 0.1)
    assert back == Back(7.0)


def test_the_hand_gets_the_force_as_it_came_times_the_gain() -> None:
    at = At(0.02, 0.1, 7.0, 0.0, 0.0, False, 1.0, 1e-3)
    assert Direct(kf=0.5).master((), at, Back(3.0)) == (1.5, Forth(0.02, 0.1), ())


def test_until_the_first_message_the_slave_stays_and_the_hand_feels_nothing() -> None:
    law, at = Direct(), start_at(0.4, 0.0, 0.0, 1e-3)
    (state, held), (_, none) = law.slave_start(at), law.master_start(at)
    assert law.slave(state, at, held)[0] == 0.0
    assert none == Back(0.0)


def growth(round_trip: int, *, dt: float, K: float, B: float, k_e: float) -> float:
    """How a small oscillation has grown over the second half of a run, two handles of 0.04 kg.

    Forth and back take `round_trip` ticks together. The hand is 100 N/m and 2 N s/m, held still; the slave
    is bonded to a wall of k_e.
    """
    there = round_trip // 2
    handle = MassDamper(mass=0.04, damping=0.8)
    scene = Scene(
        law=Direct(K=K, B=B), master=handle, slave=handle, environment=Tissue(k=k_e, d=0.0),
        hand=Grip(mass=0.0, k=100.0, d=2.0, reference=Rest(at=0.0)), start_m=1e-3, dt=dt, duration=4.0,
        link=Link(fwd=Delay(there * dt), bwd=Delay((round_trip - there) * dt)), x_limit=1e9,
    )
    x = np.abs(run(scene).trace["x_m"])
    half = len(x) // 2
    return float(np.log(x[-half // 4:].max() / x[half: half + half // 4].max()))


@pytest.mark.parametrize(("stable", "unstable", "dt", "K", "B", "k_e"), [
    (94, 95, 1e-4, 400.0, 4.0, 400.0),  # first unstable at 9.5 ms, continuous time 9.504 ms
    (14, 15, 1e-4, 2000.0, 8.0, 2000.0),  # 1.5 ms, continuous time 1.520 ms
    (8, 9, 1e-3, 400.0, 4.0, 400.0),  # sampled at 1 kHz: first unstable at 9 ticks
    (0, 2, 1e-3, 2000.0, 8.0, 2000.0),  # and at 2, the least there is
])
def test_it_is_stable_up_to_the_delay_that_theory_gives(
        stable: int, unstable: int, dt: float, K: float, B: float, k_e: float) -> None:
    """Known margins: |L| = 1 of the loop hand and master, delay, coupled slave in the wall, delay."""
    assert stable == 0 or growth(stable, dt=dt, K=K, B=B, k_e=k_e) < 0.0
    assert growth(unstable, dt=dt, K=K, B=B, k_e=k_e) > 0.0
