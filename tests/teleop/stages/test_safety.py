"""The watchdog's ramp, the cap and the slew limit: what they promise, tick by tick and in whole runs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from math import ceil, inf, isnan, nan

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from channel import Blackout, Delay
from teleop import Direct, load_scene, run
from teleop.stages.force_cap import Cap, cap
from teleop.stages.watchdog import Watchdog, watchdog_step

DTS = (1e-4, 1e-3, 0.003, 0.01)


def gains(dog: Watchdog, dt: float, silences: list[int]) -> list[float]:
    """The watchdog's gain at each of the ticks, from 1."""
    c, g, calm, out = dog.limits(dt), 1.0, inf, []
    for silent in silences:
        g, calm = watchdog_step(c, g, calm, silent)
        out.append(g)
    return out


def silences_of(packets: Iterable[int], count: int) -> list[int]:
    """Ticks since the last packet at each of `count` ticks, of packets that came at these."""
    out, last, came = [], -1, set(packets)
    for k in range(count):
        last = k if k in came else last
        out.append(k - last)
    return out


@given(dt=st.sampled_from(DTS), patience=st.integers(1, 300))
def test_a_timeout_of_n_ticks_is_n_ticks_whatever_rounding_makes_of_the_division(dt: float, patience: int) -> None:
    dog = Watchdog(timeout=patience * dt, ramp=0.0)
    assert gains(dog, dt, [patience]) == [1.0]
    assert gains(dog, dt, [patience + 1]) == [0.0]


@pytest.mark.parametrize("dt", DTS)
@pytest.mark.parametrize("ramp", [0.01, 0.05, 0.3])
def test_the_force_ramps_to_zero_in_the_ramps_time_and_back_in_the_same(dt: float, ramp: float) -> None:
    patience, count = round(0.02 / dt), ceil(ramp / dt - 1e-9)
    got = gains(Watchdog(timeout=0.02, ramp=ramp, settle=0.0), dt, [*range(1, patience + count + 2), *[0] * count])
    ramped = [min(1.0, k * dt / ramp) for k in range(1, count + 1)]
    assert got[:patience] == [1.0] * patience
    assert got[patience:] == pytest.approx([*(1.0 - part for part in ramped), 0.0, *ramped], abs=1e-9)
    assert got[patience + count] == 0.0


# Leaving the safe state


@given(packets=st.sets(st.integers(0, 150)), patience=st.integers(1, 8), wait=st.integers(0, 20),
       ramp=st.integers(0, 9))
@settings(max_examples=50)
def test_after_a_silence_the_gain_rises_when_packets_that_were_never_far_apart_span_the_time(
        packets: set[int], patience: int, wait: int, ramp: int) -> None:
    dt, before = 1e-3, 1.0
    silences = silences_of(packets, 160)
    got = gains(Watchdog(timeout=patience * dt, ramp=ramp * dt, settle=wait * dt), dt, silences)
    for k, g in enumerate(got):
        silent = [i for i in range(k + 1) if silences[i] > patience]
        since = sorted(i for i in packets if silent and silent[-1] < i <= k)
        fine = not silent or (bool(since) and since[-1] - since[0] >= wait)
        step = 1.0 / ramp if ramp else 1.0
        assert g == pytest.approx(min(1.0, before + step) if fine else max(0.0, before - step), abs=1e-12)
        before = g


@given(timeout=st.sampled_from([0.01, 0.2, 1.0]), settle=st.floats(1e-3, 0.5), late=st.integers(1500, 2500))
@settings(max_examples=10)
def test_a_single_late_packet_lifts_nothing_however_short_the_time_is(timeout: float, settle: float, late: int) -> None:
    got = gains(Watchdog(timeout=timeout, settle=settle), 1e-3, silences_of([late], 4000))
    assert not any(got[1300:])


@given(dt=st.sampled_from(DTS), wait=st.integers(1, 300))
def test_a_time_of_n_ticks_is_n_ticks_from_the_first_packet_on(dt: float, wait: int) -> None:
    dog = Watchdog(timeout=2.0 * dt, ramp=0.0, settle=wait * dt)
    got = gains(dog, dt, [1, 2, 3, *[0] * (wait + 1)])
    assert got == [1.0, 1.0, *[0.0] * (wait + 1), 1.0]


numbers = st.floats(-1e6, 1e6)


@given(f_max=st.floats(0.0, 1e3), slew=st.one_of(st.none(), st.floats(1e-3, 1e6)), asked=st.lists(numbers, max_size=50))
def test_what_is_held_is_within_the_cap_and_one_slew_of_what_was_held(
        f_max: float, slew: float | None, asked: list[float]) -> None:
    limits, held = Cap(f_max=f_max, slew=slew).limits(1e-3), 0.0
    for f in asked:
        now = cap(limits, f, held)
        assert abs(now) <= f_max
        if slew is not None:
            assert abs(now - held) <= slew * 1e-3 * (1.0 + 1e-9)
        held = now


@given(f_max=st.floats(0.0, 1e3), slew=st.floats(1.0, 1e6), held=numbers)
def test_a_force_within_both_is_left_alone_bit_for_bit(f_max: float, slew: float, held: float) -> None:
    held = min(max(held, -f_max), f_max)
    assert cap(Cap(f_max=f_max, slew=slew).limits(1e-3), held, held) == held
    assert cap(Cap(f_max=f_max).limits(1e-3), held, -held) == held


def test_it_is_the_nearest_force_within_both() -> None:
    limits = Cap(f_max=5.0, slew=1000.0).limits(1e-3)  # 1 N a tick
    assert cap(limits, 9.0, 4.5) == 5.0
    assert cap(limits, 9.0, 3.0) == 4.0
    assert cap(limits, -9.0, 3.0) == 2.0
    assert cap(limits, -9.0, -4.5) == -5.0
    assert cap(Cap(f_max=5.0).limits(1e-3), inf, 0.0) == 5.0


def test_not_a_number_stays_to_be_seen() -> None:
    for limits in (Cap(f_max=5.0), Cap(f_max=5.0, slew=10.0)):
        assert isnan(cap(limits.limits(1e-3), nan, 1.0))


# Whole runs


def test_in_a_run_the_forces_of_both_ends_keep_to_the_cap() -> None:
    free = run(load_scene("canonical", duration=1.0)).trace
    assert np.abs(free["f_s"]).max() > 2.0
    scene = replace(load_scene("canonical", duration=1.0), cap=Cap(f_max=1.5, slew=100.0))
    trace = run(scene).trace
    for name in ("f_m", "f_s"):
        f = trace[name]
        assert np.abs(f).max() <= 1.5
        assert np.abs(np.diff(f, prepend=0.0)).max() <= 0.1 * (1.0 + 1e-9)
    assert np.abs(trace["f_s"]).max() == 1.5


@pytest.mark.parametrize("wait", [0, 40, 200])
def test_in_a_run_the_watchdog_lets_go_in_a_blackout_and_takes_hold_again(wait: int) -> None:
    dog = Watchdog(timeout=0.1, ramp=0.05, settle=wait * 1e-3)
    scene = replace(load_scene("canonical", duration=2.0, law=Direct(K=200.0, B=5.0)), watchdog=dog,
                    link=Delay(0.05) | Blackout(start=0.75, duration=0.5))
    trace = run(scene).trace
    for e in ("m", "s"):
        g, played = trace[f"g_{e}"], trace[f"seq_{e}"]
        last = int(np.flatnonzero(played == played[:1000].max())[0])
        again = int(np.flatnonzero(played[last + 1:] >= 0)[0]) + last + 1
        assert (g[: last + 101] == 1.0).all()  # the link is slower than nothing, but quicker than the timeout
        assert g[last + 101] < 1.0
        assert (g[last + 151: again + wait] == 0.0).all()
        assert not trace[f"f_{e}"][last + 151: again + wait].any()
        assert g[again + wait] > 0.0
        assert (g[again + wait + 51:] == 1.0).all()
    assert (trace["g_m"][:50] == 1.0).all()


def test_over_a_link_slower_than_the_timeout_the_first_thing_is_a_ramp() -> None:
    dog = Watchdog(timeout=0.1, ramp=0.0, settle=0.1)
    scene = load_scene("canonical", duration=0.5, delay=0.2)
    g = run(replace(scene, watchdog=dog)).trace["g_s"]
    assert (g[:100] == 1.0).all()
    assert (g[100:300] == 0.0).all()
    assert (g[300:] == 1.0).all()
    on_time = run(replace(scene, watchdog=Watchdog(timeout=0.2, ramp=0.0))).trace["g_s"]
    assert (on_time == 1.0).all()
