"""Four channels: the equations of both ends, the felt impedance of free motion, what a delay does."""

from __future__ import annotations

from dataclasses import replace
from math import pi
from typing import Any

import numpy as np
import pytest

from channel.delay import Delay
from teleop import At, MassDamper, Scene, check_law, load_scene, run
from teleop.analysis.passivity.two_port import continuous_two_port
from teleop.law.offers import AgeRange as Age
from teleop.laws.four_channel import Back, Forth, FourChannel, FourChannelEnd
from tests.teleop.law.test_injection import CONSTANT

SLACK = FourChannelEnd(0.0)
MASTER, SLAVE = MassDamper(mass=0.1, damping=0.5), MassDamper(mass=0.5, damping=1.0)


def at(x: float, v: float, f: float, gain: float = 1.0) -> At:
    nan = float("nan")
    return At(x, v, f, nan, nan, True, nan, 1e-3, 1e-3, gain)


def ports(law: FourChannel, T: float, f: Any, master: MassDamper = MASTER, slave: MassDamper = SLAVE) -> Any:
    """The two-port with force sensors at both ends, in continuous time."""
    scene = Scene(law=law.linear(), master=master, slave=slave, link=Delay(T) if T else None, duration=1.0,
                  observer=None)
    return continuous_two_port(scene, np.asarray(f))


def test_it_keeps_the_contract_with_local_force_feedback() -> None:
    check_law(FourChannel(C5=0.5, C6=0.7), compiled=False)


def test_each_end_has_motion_and_force_of_the_other_and_its_own_force_back() -> None:
    law = FourChannel(K=200.0, B=4.0, C5=0.5, C6=0.7)
    f_m, forth, _ = law.master(SLACK, at(0.03, 0.2, 5.0), Back(0.01, 0.1, 3.0))
    assert f_m == pytest.approx(200.0 * 0.02 + 4.0 * 0.1 + 1.7 * 3.0 - 0.7 * 5.0, rel=1e-15)
    assert forth == Forth(0.03, 0.2, 5.0)
    f_s, back, _ = law.slave(SLACK, at(0.01, 0.1, 3.0), Forth(0.03, 0.2, 5.0))
    assert f_s == pytest.approx(200.0 * 0.02 + 4.0 * 0.1 + 1.5 * 5.0 - 0.5 * 3.0, rel=1e-15)
    assert back == Back(0.01, 0.1, 3.0)


@pytest.mark.parametrize(("T", "C", "felt"), [
    (0.0, 0.0, [1.213881, 2.095240]), (0.0, 1.0, [0.606941, 1.047620]), (0.0, 4.0, [0.242776, 0.419048]),
    (0.05, 0.0, [10.952544, 11.610362, 2.389956]),
])
def test_the_felt_impedance_of_free_motion_is_that_of_the_law_book(T: float, C: float, felt: list[float]) -> None:
    """|Z| at 0.5, 1 and 5 Hz, N s/m, of C5 = C6 = C; the ends of `canonical`. By the stack, and by hand:

    Z_m v_m = (1 + C6) f - C v_m + C e v_s and Z_s v_s = C e v_m - C v_s + (1 + C5) e f, with e = exp(-s T).
    """
    f = np.array([0.5, 1.0, 5.0])[:len(felt)]
    h11 = ports(FourChannel(K=200.0, B=4.0, C5=C, C6=C), T, f).h[:, 0, 0]
    assert np.round(np.abs(h11), 6).tolist() == felt
    s = 2j * pi * f
    late, spring = np.exp(-s * T), 4.0 + 200.0 / s
    Z_m, Z_s = 0.1 * s + 0.5, 0.5 * s + 1.0
    by_hand = (Z_m + spring - (late * spring) ** 2 / (Z_s + spring)) / (
        1.0 + C + late * late * spring * (1.0 + C) / (Z_s + spring))
    assert h11 == pytest.approx(by_hand, rel=1e-6)


@pytest.mark.parametrize("T", [0.0, 0.003, 0.2])
@pytest.mark.parametrize("C", [0.5, 3.0])
def test_local_force_feedback_divides_what_is_felt_in_free_motion(T: float, C: float) -> None:
    f = np.geomspace(0.1, 30.0, 9)
    bare, fed = (ports(FourChannel(C5=each, C6=each), T, f).h[:, 0, 0] for each in (0.0, C))
    assert fed == pytest.approx(bare / (1.0 + C), rel=1e-6)


def test_between_equal_ends_it_is_passive_without_delay_and_active_with_any() -> None:
    f = np.geomspace(0.05, 50.0, 300)
    law = FourChannel(C5=0.5, C6=0.5)
    assert ports(law, 0.0, f, SLAVE, SLAVE).eta.min() > 1.0 - 1e-6
    assert ports(law, 0.0, f).eta.min() < 0.99
    for T in (0.5e-3, 0.005, 0.05, 0.5):
        assert ports(law, T, f, SLAVE, SLAVE).eta.min() < 0.99
        assert ports(law, T, f).eta.min() < 0.99


@pytest.mark.parametrize(("C6", "bounded"), [(1.2, True), (1.3, False)])
def test_a_sensor_that_feels_the_hands_mass_makes_a_loop_of_its_share(C6: float, bounded: bool) -> None:
    """C6 m_h/(M_m + m_h) is 0.96 and 1.04 with 0.4 kg of hand at 0.1 kg of master; the force turns at each tick."""
    scene = load_scene("free_motion", law=FourChannel(C6=C6), delay=0.0)
    got = run(replace(scene, observer=None, duration=0.5)).trace["f_m"]
    assert (abs(got).max() < 10.0) == bounded
    assert bounded or got[-1] * got[-2] < 0.0


def test_it_says_that_it_is_active_with_delay() -> None:
    (told,) = FourChannel().conditions(CONSTANT)
    assert "T1 + T2 = 0.1 s" in told
    assert "--set delay=0" in told
    near = CONSTANT._replace(fwd=Age(1e-3, 1e-3), bwd=Age(1e-3, 1e-3))
    assert FourChannel().conditions(near) == ()
    assert "0.1 kg" in FourChannel().conditions(near._replace(mass_m=0.1))[0]
    assert "no message" in FourChannel().conditions(near._replace(fwd=None))[0]
