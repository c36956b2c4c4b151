"""The deadband around a law: what is sent, what it claims, and that it is the law itself with k = 0."""

from __future__ import annotations

from dataclasses import replace
from math import pi, sin
from typing import Any

import numpy as np
import pytest

from teleop import PFRA, TDPA, At, Direct, around, check_law, load_scene, run
from teleop.laws.around import compose
from teleop.laws.around.deadband import FIELDS, DeadbandWrapper, HeldSample, HeldWave, asks, hold, hold_wave, wave_asks
from teleop.laws.wave import Back, Wave

LAWS = pytest.mark.parametrize("law", [Wave(), *[pytest.param(law, marks=pytest.mark.full) for law in (
    Direct(), PFRA(alpha=0.3))]], ids=lambda law: type(law).__name__)


def at(x: float, v: float, *, dt: float = 1e-3, span: float = 1e-3) -> At:
    return At(x, v, 0.0, 0.0, 0.0, True, 1e-3, dt, span)


def test_a_sine_sends_as_many_of_a_thousand_samples_as_weber_says() -> None:
    law = around("deadband(0.1, floor=1e-3)", Direct(K=0.0))
    for hertz, sent in ((1, 129), (2, 207), (5, 369)):  # counted by the rule
        q = [sin(2.0 * pi * hertz * k / 1000.0) for k in range(1000)]
        s, rx = law.master_start(at(0.0, 0.0))
        heard = []
        for each in q:
            _, tx, s = law.master(s, at(each, 0.0), rx)
            heard.append(tx.x)
        assert s.deadband_sent == sent + 1  # the first message, of which the other end knows nothing
        assert all(abs(a - b) <= max(0.1 * abs(b), 1e-3) for a, b in zip(q, heard, strict=True))


def test_a_message_that_is_not_sent_has_the_values_of_the_last_one() -> None:
    law = around("deadband(0.1)", Direct())
    s, rx = law.master_start(at(0.0, 0.0))
    _, first, s = law.master(s, at(1.0, 2.0), rx)
    _, second, s = law.master(s, at(1.05, 2.1), rx)
    _, third, s = law.master(s, at(1.05, 2.3), rx)  # the velocity has moved, so the message is sent with its position
    assert (first, second, third) == ((1.0, 2.0), (1.0, 2.0), (1.05, 2.3))
    assert s.deadband_sent == 2.0


@pytest.mark.parametrize("law", [Wave(), TDPA(), Direct(), PFRA(alpha=0.3)], ids=lambda law: type(law).__name__)
def test_with_k_zero_it_is_the_law_to_the_bit(law: Any) -> None:
    scene = replace(load_scene("canonical", delay=0.02, duration=0.6), energy=True)
    alone, within_it = [run(replace(scene, law=each)).trace for each in (law, around("deadband(0.0, floor=0.5)", law))]
    assert "E_law" in within_it or type(law) is not TDPA
    assert all(np.array_equal(alone[name], within_it[name], equal_nan=True) for name in alone)


@LAWS
def test_what_comes_out_is_a_law_that_keeps_what_it_claims(law: Any) -> None:
    composed = around("deadband(0.3, floor=0.05)", law)
    check_law(composed, compiled=False)
    assert ("E_link" in composed.claims) == ("E_link" in law.claims)


def test_a_deadband_that_holds_waves_as_it_holds_samples_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    def hold_as_sample(s: HeldWave, at: At, is_sent: float, q: float) -> tuple[float, HeldWave]:
        last = hold(HeldSample(s.last), at, is_sent, q)[0]
        return last, HeldWave(last, 0.0, 0.0)

    monkeypatch.setattr(compose, "_MADE", {})
    monkeypatch.setitem(FIELDS, "wave", {**FIELDS["wave"], "ask": asks, "hold_field": hold_as_sample})
    with pytest.raises(ValueError, match="more than the waves brought"):
        check_law(around("deadband(0.3, floor=0.05)", Wave()))


def test_waves_that_are_sent_never_have_more_energy_than_those_there_were() -> None:
    law = around("deadband(0.4, floor=0.2)", Wave())
    s, _ = law.master_start(at(0.0, 0.0))
    there = sent = 0.0
    rng = np.random.default_rng(3)
    v, held, u_before, tx_before = 0.0, 0, 0.0, 0.0
    for k in range(4000):
        v += 0.02 * rng.standard_normal() - 0.01 * v
        left_out = 5 * (k % 50 == 17)
        _, tx, after = law.master(s, at(0.0, v, span=1e-3 * (1 + left_out)), Back(0.0))
        u = (2.0 * law.b) ** 0.5 * v
        there += 1e-3 * (0.5 * u * u + left_out * 0.5 * u_before * u_before)
        sent += 1e-3 * (0.5 * tx.u * tx.u + left_out * 0.5 * tx_before * tx_before)
        assert sent <= there + 1e-12 or left_out  # while ticks are left out the last wave goes on: paid at once
        held += after.deadband_sent == s.deadband_sent
        s, u_before, tx_before = after, u, tx.u
    assert sent <= there + 1e-12
    assert held > 1000


def test_numbers_that_are_none_are_sent_and_not_kept() -> None:
    nan, deadband, rest = float("nan"), DeadbandWrapper(0.1, 1e-3), at(0.0, 0.0)
    assert asks(deadband, HeldSample(0.0), rest, nan) == 1.0
    assert asks(deadband, HeldSample(nan), rest, 1.0) == 1.0
    assert str(hold(HeldSample(5.0), rest, 1.0, -0.0)[0]) == "-0.0"
    assert hold(HeldSample(5.0), rest, 0.0, 3.0)[0] == 5.0
    deadband = DeadbandWrapper(1.0, 1e-3)  # none of these waves has moved
    assert wave_asks(deadband, HeldWave(2.0, 0.0, 0.0), rest, 1.0) == 1.0
    assert wave_asks(deadband, HeldWave(2.0, 1.5e-3, 0.0), rest, 1.0) == 0.0
    assert hold_wave(HeldWave(0.0, -1e-3, 0.0), rest, 1.0, 2.0)[0] == pytest.approx(2.0**0.5)
