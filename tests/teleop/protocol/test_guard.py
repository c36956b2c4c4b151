"""The safe state of a live end: every cause, the way down, the way back, and what is written down of it."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from teleop.protocol.guard import MOST_EVENTS, UNNAMED, Event, ForceGuard, Silence
from teleop.protocol.states import Cause, Reason
from teleop.stages.watchdog import Watchdog, watchdog_step
from tests.teleop.protocol.ends import MS, met, scene

DT = 0.01
DOG = Watchdog(timeout=0.1, ramp=0.05, settle=0.08)  # 10, 5 and 8 ticks
DOWN = [0.8, 0.6, 0.4, 0.2, 0.0]


def guard(dog: Watchdog | None = DOG, **other: bool) -> ForceGuard:
    return ForceGuard(dog, DT, **other)


def play(one: ForceGuard, ticks: range, got: bool = True, trouble: str | None = None) -> list[float]:
    reason = None if trouble is None else Reason(Cause.DEVICE, trouble)
    return [one.step(k, got, reason) for k in ticks]


def calm(dog: Watchdog | None = DOG, until: int = 100) -> ForceGuard:
    """One to which a packet came at every tick before `until`."""
    one = guard(dog)
    assert set(play(one, range(until))) == {1.0}
    assert one.events == []
    return one


def whats(one: ForceGuard) -> list[tuple[int, str]]:
    return [event[:2] for event in one.events]


# Silence


def test_silence_for_longer_than_the_timeout_lets_go_along_the_ramp_and_it_takes_hold_again_after_settle() -> None:
    one = calm()
    assert play(one, range(100, 110), got=False) == [1.0] * 10
    assert not one.safe
    assert play(one, range(110, 200), got=False) == pytest.approx([*DOWN, *[0.0] * 85])
    assert (one.safe, one.entries, one.cause) == (True, 1, one.events[0].why)
    assert one.events == [Event(110, "safe", "silence: no fresh packet for 0.1 s", Cause.SILENCE)]
    assert play(one, range(200, 208)) == [0.0] * 8
    assert one.safe, "the time is from the first packet to the last"
    assert play(one, range(208, 214)) == pytest.approx([0.2, 0.4, 0.6, 0.8, 1.0, 1.0])
    assert (one.safe, one.cause) == (False, None)
    assert whats(one) == [(110, "safe"), (208, "released")]


@settings(max_examples=100)
@given(st.lists(st.booleans(), max_size=120), st.floats(0.0, 0.2), st.floats(0.0, 0.2))
def test_by_silence_alone_it_is_the_watchdog_of_virtual_time(came: list[bool], ramp: float, settle: float) -> None:
    """Released is said when the gain rises, and not before."""
    dog = Watchdog(timeout=0.1, ramp=ramp, settle=settle)
    one, limits = guard(dog), dog.limits(DT)
    gain, quiet, heard = 1.0, float("inf"), -1
    for k, got in enumerate(came):
        heard, before, was_safe = k if got else heard, gain, one.safe
        gain, quiet = watchdog_step(limits, gain, quiet, k - heard)
        assert one.step(k, got) == gain
        assert ((k, "released") in whats(one)) is (was_safe and gain > before)


# A stall


def test_after_a_stall_it_is_safe_before_it_puts_out_any_force_and_the_ramp_has_run_on_meanwhile() -> None:
    for away in (10, 12, 14, 20, 1000):
        one = calm()
        gain = one.step(100 + away, True)
        if away <= 10:
            assert (gain, one.safe) == (1.0, False)
        else:
            assert gain == pytest.approx(max(0.0, 1.0 - 0.2 * (away + 1)), abs=1e-12), away
            assert (one.safe, one.events[0].what) == (True, "safe")
            assert one.events[0].why == f"a stall: no tick for {away * DT:.3f} s"
    late = guard()
    assert late.step(50, True) == 0.0, "a stall counts from the first tick that was due"
    assert "stall" in late.events[0].why
    slow = guard(replace(DOG, ramp=1.0))
    play(slow, range(100))
    assert slow.step(100 + 20, True) == pytest.approx(1.0 - 21 / 100)


@pytest.mark.parametrize("every", [1, 3])
def test_after_a_stall_in_which_the_device_let_go_the_force_begins_at_zero_and_does_not_jump(every: int) -> None:
    """The device lapses after 0.15 s, the scene's watchdog waits for 0.8 s: the gain was 1, and the force came back.

    A tick that is as long as the deadline is no stall.
    """
    one = ForceGuard(replace(DOG, timeout=0.8, ramp=0.5), DT * every, every=every)
    one.lapse_after(0.15)
    ticks = range(0, 300, every)
    assert {one.step(k, True) for k in ticks} == {1.0}
    short = ticks[-1] + 12
    assert (one.step(short, True), one.safe, one.lapsed) == (1.0, False, False), "shorter: the force is still there"
    back = short + 18
    assert (one.step(back, True), one.safe, one.lapsed) == (0.0, True, True)
    assert one.events[-1].why.startswith("a stall: no tick for 0.1")
    rising = [one.step(k, True) for k in range(back + every, back + 180, every)]
    assert not one.lapsed
    assert max(b - a for a, b in pairwise(rising)) == pytest.approx(DT * every / 0.5)
    assert rising[-1] == 1.0
    slow = ForceGuard(DOG, 0.2)
    slow.lapse_after(0.15)
    assert {slow.step(k, True) for k in range(20)} == {1.0}


def test_a_short_stall_on_the_way_down_does_not_slow_it_and_on_the_way_up_does_not_hurry_it() -> None:
    one = calm()
    play(one, range(100, 111), got=False)
    assert one.gain == pytest.approx(0.8)
    assert one.step(113, False) == pytest.approx(0.2)
    two = calm()
    play(two, range(100, 200), got=False)
    play(two, range(200, 209))
    assert two.gain == pytest.approx(0.2)
    assert two.step(212, True) == pytest.approx(0.4)


# Trouble


def test_whatever_else_is_wrong_lets_go_and_is_named_once_however_long_it_lasts_beside_a_silence_too() -> None:
    one = calm()
    assert play(one, range(100, 130), trouble="the device: not finite") == pytest.approx([*DOWN, *[0.0] * 25])
    assert one.cause == "the device: not finite"
    assert play(one, range(130, 138)) == [0.0] * 8
    assert one.step(139, True) > 0.0
    assert whats(one) == [(100, "safe"), (139, "released")]
    assert one.entries == 1
    two = guard(DOG)
    last = round(DOG.timeout / DT) + 5
    play(two, range(last), got=False)
    two.step(last, False, Reason(Cause.DEVICE, "the device: usb gone"))
    two.step(last + 1, False)
    assert [event.why.split(":")[0] for event in two.events] == ["silence", "the device"]
    assert two.entries == 1


def test_every_entry_has_its_cause_and_the_newest_cause_is_the_one_that_holds() -> None:
    one = calm()
    play(one, range(100, 103), trouble="the device: gone")
    play(one, range(103, 130), got=False)
    assert one.cause is not None
    assert "silence" in one.cause
    play(one, range(130, 150))
    one.step(170, True)
    play(one, range(171, 200))
    one.begin(200, "the law begins from rest")
    play(one, range(200, 230))
    assert whats(one) == [(100, "safe"), (138, "released"), (170, "safe"), (179, "released"), (200, "session"),
                          (200, "safe"), (208, "released")]
    assert [event.why.split(":")[0] for event in one.events if event.what == "safe"] == [
        "the device", "a stall", "a new session"]
    assert one.entries == 3


# A new session


@pytest.mark.parametrize("after", [3, 50])
@pytest.mark.parametrize("cause", ["session", "trouble", "stall"])
def test_the_time_to_settle_counts_from_the_first_packet_after_the_cause_and_not_from_the_cause(
    cause: str, after: int
) -> None:
    """With a timeout that is longer than `settle` the first packet could come that late without any silence."""
    one = calm(replace(DOG, timeout=2.0))
    first = 100
    if cause == "session":
        one.begin(100, "the law begins from rest")
    elif cause == "trouble":
        play(one, range(100, 120), trouble="the device")
        first = 120
    else:
        one.step(400, False)
        first = 401
    gains = play(one, range(first, first + after), got=False) + play(one, range(first + after, first + after + 8))
    assert gains[5:] == [0.0] * (len(gains) - 5)
    assert one.step(first + after + 8, True) > 0.0


# Where nothing is named


def test_a_scene_without_a_watchdog_has_one_that_counts_from_the_start() -> None:
    """A peer that died before its first packet must not leave an end pushing for ever."""
    last = round(UNNAMED.timeout / DT) - 1
    assert 0.5 <= UNNAMED.timeout <= 1.0
    one = guard(None)
    assert set(play(one, range(last + 1), got=False)) == {1.0}
    assert one.step(last + 1, False) < 1.0
    assert whats(one) == [(last + 1, "safe")]


def test_what_waited_at_an_end_that_stood_still_does_not_show_that_its_sender_is_there() -> None:
    one = guard(DOG)
    play(one, range(10), got=True)
    late = 10 + 5 * round(DOG.timeout / DT)
    for k in range(late, late + 50):  # one a tick of those that came while it stood still, the last at tick 40
        assert one.step(k, True, arrived=40) < 1.0
    assert one.gain == 0.0
    assert one.safe


def test_a_stepped_end_has_none_but_the_one_that_its_scene_names_and_any_other_has_one() -> None:
    one = guard(None, stepped=True)
    assert [one.step(k, False, Reason(Cause.DEVICE, "trouble")) for k in (0, 5000)] == [1.0, 1.0]
    one.begin(5001, "again")
    assert one.step(5001, False) == 1.0
    for dog, is_stepped, is_safe in ((None, True, False), (None, False, True), (DOG, True, True)):
        end = met(scene(watchdog=dog), is_stepped=is_stepped)["s"]
        assert end.guard.step(0, True) == 1.0
        for k in range(1, 1100):
            end.guard.step(k, False)
        assert end.guard.safe is is_safe, (dog, is_stepped)


# An end that ticks at every n-th tick


@pytest.mark.parametrize("every", [2, 5])
def test_time_is_counted_in_its_own_ticks_and_events_in_those_of_the_grid(every: int) -> None:
    one = ForceGuard(DOG, DT, every=every)
    for k in range(0, 100 * every, every):
        assert one.step(k, True) == 1.0
    gains = [one.step(k, False) for k in range(100 * every, 116 * every, every)]
    assert gains == pytest.approx([*[1.0] * 10, *DOWN, 0.0])
    assert one.events[0].k == 110 * every
    stalled = ForceGuard(DOG, DT, every=every)
    stalled.step(0, True)
    assert stalled.step(11 * every, True) == 1.0
    assert stalled.step(23 * every, True) == 0.0
    assert stalled.events[0].why == "a stall: no tick for 0.110 s"


def test_what_is_kept_of_events_is_bounded_and_what_is_counted_is_not() -> None:
    one = guard(Watchdog(timeout=0.01, ramp=0.0, settle=0.0))
    for k in range(0, 8 * MOST_EVENTS, 4):
        play(one, range(k, k + 3), got=False)
        one.step(k + 3, True)
    assert len(one.events) == MOST_EVENTS
    assert one.entries == 2 * MOST_EVENTS


# The age of what is played


def test_messages_that_are_older_than_the_watchdog_allows_count_as_none_and_the_cause_is_their_age() -> None:
    one = guard(replace(DOG, age=0.5))
    assert [one.step(k, True, age=50) for k in range(50)] == [1.0] * 50
    gains = [one.step(k, True, age=51) for k in range(50, 70)]
    assert gains == pytest.approx([*[1.0] * 10, *DOWN, *[0.0] * 5])
    assert [event.why for event in one.events] == ["age: messages come more than 0.5 s after they were sent"]
    assert (one.old, one.oldest) == (20, pytest.approx(0.51))
    assert str(one.cause).startswith("age")
    silent = guard(replace(DOG, age=0.5))
    for k in range(60):
        silent.step(k, k < 30, age=60)
    assert str(silent.cause).startswith("silence"), "and silence after old messages is silence"
    assert Watchdog().age == UNNAMED.age == 2.5
    free = guard(replace(DOG, age=None))
    assert [free.step(k, True, age=10**9) for k in range(50)] == [1.0] * 50
    assert (free.old, free.age) == (0, None)
    assert [one.step(k, True, age=20) for k in range(70, 78)] == [0.0] * 8
    assert one.step(78, True, age=20) > 0.0
    assert one.events[-1].what == "released"


DEVICE = Reason(Cause.DEVICE, "the device")


@settings(max_examples=60)
@given(st.lists(st.tuples(
    st.integers(1, 3), st.booleans(), st.integers(0, 40), st.integers(0, 60), st.sampled_from([0.0, 0.02, 0.04]),
    st.sampled_from([None, None, None, None, DEVICE])), max_size=120), st.sampled_from([1, 3]))
def test_where_all_is_well_the_short_way_through_a_tick_is_the_long_one(
    ticks: list[tuple[int, bool, int, int, float, Reason | None]], every: int
) -> None:
    """Full gain stays where nothing is wrong: what is left out there changes nothing, then or later."""
    class Long(ForceGuard):
        def _is_well(self, unheard: float, age: int, silent: int) -> bool:
            return False

    guards = [kind(Watchdog(timeout=0.03, ramp=0.004, settle=0.01, age=0.05), 0.001 * every, every=every)
              for kind in (ForceGuard, Long)]
    for guard in guards:
        guard.lapse_after(0.15)
    k = 0
    for steps, got, ago, age, unheard, trouble in [(1, True, 0, 0, 0.0, None)] * 20 + ticks:
        k += steps * every
        told = [(guard.step(k, got, trouble, arrived=k - ago, unheard=unheard, age=age), guard.safe, guard.cause,
                 guard.lapsed, guard.events, guard.old) for guard in guards]
        assert told[0] == told[1]


# The watchdog of a device: when its end counts as silent


def test_a_heartbeat_is_overdue_after_the_deadline_and_a_watchdog_that_stood_still_itself_gives_time_to_renew() -> None:
    """Both had been kept from running, and the one that came back first judged the other. It gives no more than that.

    Not overdue is one without a force.
    """
    silence = Silence(150 * MS)
    assert [silence.overdue(ms * MS, MS) for ms in (*range(1, 152, 10), 151, 152)] == [False] * 17 + [True]
    assert not any(Silence(150 * MS).overdue(ms * MS, 0) for ms in (10, 20, 400, 410))
    for looks in ({100: {110: False, 120: False, 900: False, 910: False, 920: False}, 925: {930: False, 1000: False}},
                  {100: {110: False, 900: False, 910: False, 920: False, 931: True}},
                  {100: {110: False, 900: False, 1700: True, 2500: True}}):  # late at every look
        silence = Silence(150 * MS)
        for beat, expected in looks.items():
            assert {ms: silence.overdue(ms * MS, beat * MS) for ms in expected} == expected
