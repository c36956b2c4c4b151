"""A peer, or one in between without keys, that lies about what its waves have come to: T, U and E of each message."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from math import inf

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from channel.link import parse_link
from teleop import Cap, Energy, Fixed, Integral
from teleop.protocol.packet import Packet, encode
from teleop.protocol.reception import IntegralCheck
from teleop.stages.wave_integral import Integrals
from tests.teleop.protocol.ends import MS, ROUGH, Both, met, packet_in, scene
from tests.teleop.protocol.threats.hands import STILL, WATCHED, at, handed_on
from tests.teleop.protocol.virtual_clock import World, healing

INTEGRAL = replace(WATCHED, playout=Integral(), cap=Cap(f_max=2.0, slew=200.0))
Lie = Callable[[Integrals, int], Integrals]


def lying(lie: Lie | None, ticks: range) -> Both:
    """A run in which the master's messages of these ticks carry something else to the slave, or nothing comes."""
    def change(e: str, k: int, datagram: bytes) -> list[tuple[int, bytes]]:
        if e == "s" and k in ticks:
            if lie is None:
                return []
            packet = packet_in(datagram, 4)
            u, U, E, T = packet.payload  # of a message of the law
            told = lie(Integrals(T, U, E), k)
            datagram = encode(packet._replace(payload=(u, told.U, told.E, told.T)), len(datagram))
        return [(10, datagram)]

    return handed_on(change, INTEGRAL)


def test_a_message_that_does_not_add_up_is_counted_and_as_one_that_was_lost() -> None:
    """Times far ahead, ahead, back and below nothing; energies; a jump of the integral; beyond all squares."""
    def lie(told: Integrals, k: int) -> Integrals:
        T, U, E = told
        lies = ((T + 1e9, U, E), (T + 0.01, U, E), (0.5 * T, U, E), (-T, U, E), (T, U, 0.0), (T, U, -1e9),
                (T, U + 1.0, E), (T, 1e6, 1e9), (T, -1e308, 1e308))
        return Integrals(*lies[k % len(lies)])

    both, lost = lying(lie, range(100, 120)), lying(None, range(100, 120))
    assert both.ends["s"].rejected == {"integrals": 20}
    assert not both.ends["m"].rejected
    assert both.rows == lost.rows
    assert both.played["s"][130:] == list(range(120, WATCHED.ticks - 10))
    assert both.trace()["E_link"].min() > -1e-9


def test_whose_messages_never_add_up_is_as_one_that_is_silent() -> None:
    both = lying(lambda told, _k: told._replace(T=2.0 * told.T), range(100, 400))
    assert both.ends["s"].rejected == {"integrals": WATCHED.ticks - 110}
    gain = both.gains()
    assert gain[110 - 1 + 51] < 1.0
    assert gain[-1] == 0.0
    assert both.held["s"][-1] == (0.0,)


@pytest.mark.parametrize(("U", "E"), [(-1e3, 1e9), (1e150, 1e304)])
def test_a_peer_that_claims_endless_energy_is_bounded_by_cap_and_slew(U: float, E: float) -> None:
    """It adds up: such a wave could have been sent. So it is played, as far as force and slew may go."""
    both = lying(lambda told, _k: told._replace(U=U, E=E), range(100, 101))
    assert both.played["s"][110] == 100
    for e in "ms":
        force = np.array([0.0, *(f for f, in both.held[e])])
        assert np.isfinite(force).all()
        assert np.abs(force).max() <= 2.0
        assert np.abs(np.diff(force)).max() <= 200.0 * 1e-3 + 1e-12
        assert both.ends[e].force_failed is None
    assert max(abs(f) for f, in both.held["s"]) == 2.0


def test_a_peer_that_claims_endless_energy_gives_out_no_more_power_than_the_budget_has() -> None:
    limited = replace(INTEGRAL, cap=Cap(f_max=20.0, slew=2000.0, power=0.05))
    end = met(limited)["s"]
    came = encode(Packet(end.format.hears, 7, 0, at(0), None, (0.1, 1e3, 1e9, 1e-3)))
    end.receive(came, at(1))
    moved = STILL._replace(v=(0.5,))
    spent, forces = 0.0, []
    for k in range(1, 400):
        force, = end.tick(k, at(k), moved._replace(x=(0.5e-3 * (k - 1),))).force
        spent += max(0.0, force) * 0.5e-3
        forces.append(force)
    most = max(forces)
    assert most > 5.0
    # A second's worth in hand, what comes in, and what is owed: see `teleop.stages.energy_budget`.
    assert spent <= 0.05 * (1.0 + 0.4) + most * 0.5e-3 + 0.5 * most**2 / (2.0 * 2000.0)


# What adds up is taken: by whatever wave, whatever ticks were left out, in whatever order it comes


@pytest.mark.parametrize("playout", [Integral(0.005), Energy(), Fixed(0.02, Integral())], ids=str)
def test_no_honest_message_is_refused_over_a_rough_link(playout: Integral | Energy | Fixed) -> None:
    both = Both(scene(link=parse_link(ROUGH), playout=playout)).run()
    assert min(both.ends[e].received for e in "ms") > 100
    assert not any(both.ends[e].rejected for e in "ms")


def test_no_honest_message_is_refused_of_ends_that_stand_still_are_cut_off_or_begin_anew() -> None:
    world = World(healing(playout=Integral()), jitter=5 * MS)

    def settled() -> None:
        world.run(0.1)
        world.assert_both_play()
        for e in "ms":
            assert world.end(e).received > 0
            assert not world.end(e).rejected["integrals"]

    settled()
    for e, away in (("s", 0.05), ("m", 0.3), ("s", 1.5)):
        world.stand_still(e, away)
        settled()
    world.cut_off("ms", 2.0)
    settled()
    for who in ("m", "s", "ms"):
        world.restart(who, 0.7)
        settled()


def sent(waves: list[tuple[float, int, int]], every: int, dt: float) -> list[tuple[int, Integrals]]:
    """The messages of a sender: of each its wave, how many ticks it left out before, and how many had no reading."""
    k, q, told, out = 0, 0.0, Integrals(0.0, 0.0, 0.0), []
    for wave, left_out, blind in waves:
        held, own = left_out * every * dt, every * dt
        told = Integrals(told.T + (held + own), told.U + held * q + own * wave,
                         told.E + held * (0.5 * q * q) + 0.5 * own * (wave * wave))
        k, q = k + (left_out + blind) * every, wave
        out.append((k, told))
        k += every
    return out


waves = st.floats(-10.0, 10.0) | st.sampled_from([0.0, 0.7, 1e-9, -1e-160, 1e3])
gaps = st.sampled_from([0, 0, 0, 1, 3])


@given(st.lists(st.tuples(waves, gaps, gaps), min_size=2, max_size=40), st.integers(1, 5),
       st.sampled_from([1e-3, 1e-4, 0.1]), st.randoms(use_true_random=False), st.integers(0, 30))
@settings(max_examples=50)
def test_every_honest_message_adds_up_in_whatever_order_and_number(
    waves: list[tuple[float, int, int]], every: int, dt: float, dice: object, near: int
) -> None:
    said = [each for each in sent(waves, every, dt) for _ in range(2)]
    order = sorted(range(len(said)), key=lambda i: i + near * dice.random())
    sums = IntegralCheck(dt, 1)
    assert all(sums.add_up(said[i][0], (said[i][1],), every) for i in order)


def test_a_steady_wave_adds_up_after_millions_of_ticks() -> None:
    """It fulfils the inequality with equality, and each of the sums is rounded at every tick."""
    T = 1e4
    told, sums = Integrals(T, 0.7 * T, 0.245 * T), IntegralCheck(1e-3, 1)
    sums._at, sums._then = 10_000_000, (told,)
    for k in range(10_000_001, 10_020_000):
        told = Integrals(told.T + 1e-3, told.U + 1e-3 * 0.7, told.E + 0.5e-3 * (0.7 * 0.7))
        assert k % 7 or sums.add_up(k, (told,), 1)
    assert not sums.add_up(10_020_000, (told._replace(T=told.T + 2e-3),), 1)


@given(st.lists(st.builds(Integrals, *[st.floats(-inf, inf, allow_nan=False, allow_infinity=False)] * 3), max_size=8))
@example([Integrals(2e-3, 1e-3, 0.0)])  # energy that is taken back while the integral stands
@settings(max_examples=50)
def test_whatever_is_taken_grows_with_its_number(told: list[Integrals]) -> None:
    sums, taken = IntegralCheck(1e-3, 1), [Integrals(0.0, 0.0, 0.0)]
    for k, each in enumerate([Integrals(1e-3, 1e-3, 1e-3), *told]):
        if sums.add_up(k, (each,), 1):
            taken.append(each)
            assert 0.0 < each.T <= (k + 1) * 1.001e-3
    assert len(taken) >= 2
    assert all(one.E <= other.E for one, other in pairwise(taken))
