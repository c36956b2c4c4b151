"""The watchdog's ramp, the cap and the slew limit: what they promise, tick by tick and in whole runs."""

from __future__ import annotations

from dataclasses import replace
from math import ceil, inf, isnan, nan

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from channel.blackout import Blackout
from channel.delay import Delay
from teleop.errors import Refused
from teleop.laws.direct import Direct
from teleop.lockstep import run
from teleop.safety import Cap, Watchdog, cap, watch
from teleop.scene import load_scene

DTS = (1e-4, 1e-3, 0.003, 0.01)


def gains(dog: Watchdog, dt: float, silences: list[int]) -> list[float]:
    """The watchdog's gain at each of the ticks, from 1."""
    c, g, out = dog.limits(dt), 1.0, []
    for silent in silences:
        g = watch(c, g, silent)
        out.append(g)
    return out


@pytest.mark.parametrize("dt", DTS)
@given(patience=st.integers(1, 300))
@settings(derandomize=True)
def test_a_timeout_of_n_ticks_is_n_ticks_whatever_rounding_makes_of_the_division(dt: float, patience: int) -> None:
    dog = Watchdog(timeout=patience * dt, ramp=0.0)
    assert gains(dog, dt, [patience]) == [1.0]
    assert gains(dog, dt, [patience + 1]) == [0.0]


@pytest.mark.parametrize("dt", DTS)
@pytest.mark.parametrize("ramp", [0.01, 0.05, 0.3])
def test_the_force_ramps_to_zero_in_the_ramps_time_and_back_in_the_same(dt: float, ramp: float) -> None:
    patience, count = round(0.02 / dt), ceil(ramp / dt - 1e-9)
    got = gains(Watchdog(timeout=0.02, ramp=ramp), dt, [*range(1, patience + count + 2), *[0] * count])
    ramped = [min(1.0, k * dt / ramp) for k in range(1, count + 1)]
    assert got[:patience] == [1.0] * patience
    assert got[patience:] == pytest.approx([*(1.0 - part for part in ramped), 0.0, *ramped], abs=1e-9)
    assert got[patience + count] == 0.0


@given(silences=st.lists(st.integers(0, 60), max_size=80), timeout=st.floats(1e-3, 0.05), ramp=st.floats(0.0, 0.1))
@settings(derandomize=True)
def test_the_gain_stays_between_0_and_1_and_changes_by_a_step_at_most(
    silences: list[int], timeout: float, ramp: float
) -> None:
    dog = Watchdog(timeout=timeout, ramp=ramp)
    step, before = dog.limits(1e-3).step, 1.0
    for g in gains(dog, 1e-3, silences):
        assert 0.0 <= g <= 1.0
        assert abs(g - before) <= step * (1.0 + 1e-12)
        before = g


def test_a_ramp_of_nothing_is_a_switch() -> None:
    dog = Watchdog(timeout=0.003, ramp=0.0)
    assert gains(dog, 1e-3, [1, 2, 3, 4, 5, 0, 1]) == [1.0, 1.0, 1.0, 0.0, 0.0, 1.0, 1.0]


numbers = st.floats(-1e6, 1e6)


@given(f_max=st.floats(0.0, 1e3), slew=st.one_of(st.none(), st.floats(1e-3, 1e6)), asked=st.lists(numbers, max_size=50))
@settings(derandomize=True)
def test_what_is_held_is_within_the_cap_and_one_slew_of_what_was_held(
    f_max: float, slew: float | None, asked: list[float]
) -> None:
    limits, held = Cap(f_max=f_max, slew=slew).limits(1e-3), 0.0
    for f in asked:
        now = cap(limits, f, held)
        assert abs(now) <= f_max
        if slew is not None:
            assert abs(now - held) <= slew * 1e-3 * (1.0 + 1e-9)
        held = now


@given(f_max=st.floats(0.0, 1e3), slew=st.floats(1.0, 1e6), held=numbers)
@settings(derandomize=True)
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


@pytest.mark.parametrize("limits", [Cap(f_max=5.0).limits(1e-3), Cap(f_max=5.0, slew=10.0).limits(1e-3)])
def test_not_a_number_stays_to_be_seen(limits: tuple[float, float]) -> None:
    assert isnan(cap(limits, nan, 1.0))  # type: ignore[arg-type]


@pytest.mark.parametrize(("make", "name"), [
    (lambda: Watchdog(timeout=0.0), "timeout"), (lambda: Watchdog(ramp=-1.0), "ramp"),
    (lambda: Watchdog(timeout=nan), "timeout"), (lambda: Cap(f_max=-1.0), "f_max"),
    (lambda: Cap(f_max=1.0, slew=0.0), "slew"), (lambda: Cap(f_max=inf), "f_max"),
])
def test_senseless_limits_are_refused(make: object, name: str) -> None:
    with pytest.raises(Refused, match=name):
        make()  # type: ignore[operator]


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


def test_a_cap_that_is_never_reached_changes_nothing() -> None:
    scene = load_scene("canonical", duration=1.0)
    free, capped = run(scene).trace, run(replace(scene, cap=Cap(f_max=1e6))).trace
    assert all(np.array_equal(free[name], capped[name]) for name in free)


def test_in_a_run_the_watchdog_lets_go_in_a_blackout_and_takes_hold_again() -> None:
    dog = Watchdog(timeout=0.1, ramp=0.05)
    scene = replace(load_scene("canonical", duration=2.0, law=Direct(K=200.0, B=5.0)), watchdog=dog,
                    link=Delay(0.05) | Blackout(start=0.75, duration=0.5))
    trace = run(scene).trace
    for e in ("m", "s"):
        g, played = trace[f"g_{e}"], trace[f"seq_{e}"]
        last = int(np.flatnonzero(played == played[:1000].max())[0])
        again = int(np.flatnonzero(played[last + 1:] >= 0)[0]) + last + 1
        assert (g[: last + 101] == 1.0).all()  # the link is slower than nothing, but quicker than the timeout
        assert g[last + 101] < 1.0
        assert (g[last + 151: again] == 0.0).all()
        assert not trace[f"f_{e}"][last + 151: again].any()
        assert (g[again + 51:] == 1.0).all()
    assert (trace["g_m"][:50] == 1.0).all()


def test_over_a_link_slower_than_the_timeout_the_first_thing_is_a_ramp() -> None:
    dog = Watchdog(timeout=0.1, ramp=0.0)
    scene = load_scene("canonical", duration=0.5, delay=0.2)
    g = run(replace(scene, watchdog=dog)).trace["g_s"]
    assert (g[:100] == 1.0).all()
    assert (g[100:200] == 0.0).all()
    assert (g[200:] == 1.0).all()
    on_time = run(replace(scene, watchdog=Watchdog(timeout=0.2, ramp=0.0))).trace["g_s"]
    assert (on_time == 1.0).all()
