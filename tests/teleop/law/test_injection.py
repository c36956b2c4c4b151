"""The damping that a delayed spring asks for: closed forms, the numbers of the law book, the exact sampled two-port."""

from __future__ import annotations

from math import isnan, nan
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from channel.delay import Delay as LinkDelay
from teleop import MassDamper, PDDamped, Scene
from teleop.analysis.passivity.two_port import sampled_two_port
from teleop.law import injection
from teleop.law.injection import least_damping, strongest
from teleop.law.offers import AgeRange, Facts

CONSTANT = Facts(dt=1e-3, axes=1, mass_m=5.0, damping_m=0.0, mass_s=5.0, damping_s=0.0, fwd=AgeRange(0.05, 0.05),
                 bwd=AgeRange(0.05, 0.05), lossy=False, playout="zero", held=1e-3)


@given(K_d=st.floats(0.0, 50.0), c=st.floats(0.0, 50.0))
@settings(max_examples=60)
def test_the_strongest_coupling_of_the_ends_is_that_of_a_search_over_all_frequencies(K_d: float, c: float) -> None:
    phi = np.linspace(1e-9, 40.0, 40_001)
    found = np.abs(K_d * np.cos(phi) - c * np.sin(phi) / phi).max()
    assert strongest(K_d, c) == pytest.approx(found, rel=1e-6, abs=1e-9)
    assert strongest(K_d, c) >= found * (1.0 - 1e-12)


def test_equal_ends_need_this_part_of_c_and_sampled_their_delay_is_a_tick_longer() -> None:
    """The numbers of the law book: B/c at K_d/c, in continuous time; c = K (T1 + T2)/2."""
    K, round_trip = 400.0, 0.1
    c = 0.5 * K * round_trip
    for ratio, least in ((0.4, 0.236738), (0.5, 0.163517), (2.0, 0.028146)):
        assert round(least_damping(K, ratio * c, round_trip, 0.0, 0.0, 0.0) / c, 6) == least
    assert least_damping(K, 0.0, round_trip, 1e-3, 0.0, 0.0) == pytest.approx(K * 0.051, rel=1e-12)
    assert least_damping(K, 0.0, round_trip, 0.0, 0.0, 0.0) == pytest.approx(K * 0.050, rel=1e-12)


@given(ratio=st.floats(0.0, 0.2))
def test_a_little_damping_over_the_link_saves_twice_what_it_is(ratio: float) -> None:
    assert least_damping(2.0, ratio, 1.0, 0.0, nan, nan) == pytest.approx(1.0 - 2.0 * ratio, abs=1e-12)


@given(K=st.floats(1.0, 1e4), T1=st.floats(0.0, 0.5), T2=st.floats(1e-3, 0.5), b_m=st.floats(0.0, 5.0),
       b_s=st.floats(0.0, 5.0))
def test_without_a_damper_over_the_link_the_product_of_both_ends_counts(
        K: float, T1: float, T2: float, b_m: float, b_s: float) -> None:
    """4 B_m B_s = K^2 (T1 + T2)^2 at the least B, if any is missing."""
    B = least_damping(K, 0.0, T1 + T2, 0.0, b_m, b_s)
    have, want = 4.0 * (B + b_m) * (B + b_s), (K * (T1 + T2)) ** 2
    assert have == pytest.approx(want, rel=1e-9) if B > 0.0 else have >= want * (1.0 - 1e-12)


@pytest.mark.parametrize(("K", "K_d", "b_m", "b_s", "M"), [
    (400.0, 0.0, 0.0, 0.0, 5.0), (400.0, 0.0, 0.5, 8.0, 5.0), (100.0, 2.0, 0.1, 0.1, 0.5), (100.0, 2.0, 0.1, 1.5, 0.5),
    (100.0, 0.5, 0.3, 0.3, 0.5), (300.0, 4.0, 0.8, 0.8, 1.0),
])
def test_the_least_damping_is_where_the_sampled_two_port_becomes_passive(
        K: float, K_d: float, b_m: float, b_s: float, M: float) -> None:
    """Raisbeck's criterion on the hybrid matrix of the scene as it runs, tick, hold and bodies; up to 60 Hz."""
    least = least_damping(K, K_d, 0.1, 1e-3, b_m, b_s)

    def lack(B: float) -> float:
        law = PDDamped(K=K, K_d=K_d, B=B).linear()
        scene = Scene(law=law, master=MassDamper(mass=M, damping=b_m), slave=MassDamper(mass=M, damping=b_s),
                      link=LinkDelay(0.05), duration=0.1)
        return float(sampled_two_port(scene, np.geomspace(0.05, 60.0, 400)).raisbeck.min())

    assert lack(1.003 * least) >= 0.0
    assert lack(0.99 * least) < -1e-6


class TestConditions:
    def test_too_little_is_told_with_the_least_that_breaks_none(self) -> None:
        """14.5 N s/m is enough by the weaker condition in circulation, on T1^2 + T2^2; 20 without the tick."""
        for B in (0.0, 14.5, 20.0, 20.39):
            (told,) = injection.conditions("P+d", CONSTANT, 400.0, 0.0, B)
            assert "4 B_m B_s >= K^2 (T1 + T2)^2" in told
            assert f"B_m = {B:g}" in told
            assert "--set law.B=20.4 is the least" in told
        assert injection.conditions("P+d", CONSTANT, 400.0, 0.0, 20.4) == ()

    def test_each_ends_own_damping_counts_and_of_a_delay_that_varies_the_greatest(self) -> None:
        ragged = {"fwd": AgeRange(0.01, 0.08), "bwd": AgeRange(0.05, 0.06), "lossy": True}
        for changes, least in (({"damping_m": 6.0, "damping_s": 6.0}, "14.4"),
                               ({"damping_m": nan, "damping_s": nan}, "20.4"),
                               (ragged, "28.4")):  # 400 (0.14 + 0.002)/2
            (told,) = injection.conditions("P+d", CONSTANT._replace(**changes), 400.0, 0.0, 0.0)
            assert f"law.B={least} is" in told

    def test_a_damper_over_the_link_takes_a_constant_delay_and_with_no_message_one_way_none_is_enough(self) -> None:
        changes: Any
        for changes in ({"lossy": True}, {"fwd": AgeRange(0.05, 0.07)}):
            (told,) = injection.conditions("PD+d", CONSTANT._replace(**changes), 400.0, 2.0, 100.0)
            assert "constant delay" in told
            assert "--set law=p_d" in told
        silent = CONSTANT._replace(bwd=None)
        assert "no message" in injection.conditions("P+d", silent, 400.0, 0.0, 1e6)[0]
        assert injection.needed(silent, 400.0, 0.0) is None

    @given(K=st.floats(1.0, 1e4), K_d=st.floats(0.0, 20.0), least=st.floats(1e-3, 0.2), b=st.floats(0.0, 4.0))
    @settings(max_examples=40)
    def test_what_is_to_be_typed_is_enough(self, K: float, K_d: float, least: float, b: float) -> None:
        facts = CONSTANT._replace(fwd=AgeRange(least, least), damping_m=b)
        told = injection.conditions("PD+d", facts, K, K_d, 0.0)
        for sentence in told:
            B = float(sentence.partition("law.B=")[2].partition(" ")[0])
            assert injection.conditions("PD+d", facts, K, K_d, B) == ()
            need = injection.needed(facts, K, K_d)
            assert need is not None
            assert not isnan(B)
            assert 1.0011 * need >= B
