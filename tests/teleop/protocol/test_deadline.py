"""When an end counts as silent to the watchdog of its device, whatever stands still meanwhile."""

from __future__ import annotations

from teleop.protocol.guard import Silence

MS = 1_000_000
DEADLINE = 150 * MS


def looks(silence: Silence, beat: int, *at: int) -> list[bool]:
    """Is it overdue at these times (ms), the last heartbeat having been at `beat`?"""
    return [silence.overdue(ms * MS, beat * MS) for ms in at]


def test_a_heartbeat_is_overdue_after_the_deadline_and_not_before() -> None:
    silence = Silence(DEADLINE)
    assert looks(silence, 1, *range(1, 152, 10), 151) == [False] * 17
    assert looks(silence, 1, 152) == [True]


def test_without_a_force_there_is_nothing_to_let_go_of() -> None:
    assert looks(Silence(DEADLINE), 0, 10, 20, 400, 410) == [False] * 4


def test_a_watchdog_that_stood_still_itself_gives_the_end_time_to_renew() -> None:
    """Both had been kept from running, and the one that came back first judged the other."""
    silence = Silence(DEADLINE)
    assert looks(silence, 100, 110, 120) == [False, False]
    assert looks(silence, 100, 900, 910, 920) == [False, False, False]
    assert looks(silence, 925, 930, 1000) == [False, False]


def test_an_end_that_does_not_use_that_time_is_silent() -> None:
    silence = Silence(DEADLINE)
    assert looks(silence, 100, 110, 900, 910, 920, 931) == [False, False, False, False, True]


def test_a_watchdog_that_is_late_at_every_look_acts_at_the_second_one() -> None:
    assert looks(Silence(DEADLINE), 100, 110, 900, 1700, 2500) == [False, False, True, True]
