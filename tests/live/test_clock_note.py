"""Clocks whose rates differ by more than a slave's grid can follow: the summary says so, and what it costs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from teleop.live.net.wire import Wire, bind_udp
from teleop.live.summary import clock_note, write_end
from teleop.protocol.endpoint import SLEW
from tests.live.conftest import make_shell, summary
from tests.teleop.protocol.virtual_clock import MS, Clock, World, healing

SECONDS = 40.0


def world(ppm: float, **other: Any) -> World:
    """Two ends, the slave's clock so much faster, that have run for a while."""
    made = World(healing(duration=120.0), clocks={"m": Clock(), "s": Clock(7_777_777_777, ppm)}, **other)
    return made.run(SECONDS)


@pytest.mark.parametrize("ppm", [-2000.0, pytest.param(1000.0, marks=pytest.mark.full)])
def test_clocks_of_2000_ppm_are_told_with_their_rate_and_by_how_much_the_grids_came_apart(ppm: float) -> None:
    both = world(ppm)
    for e, sign in (("m", 1), ("s", -1)):
        clock = both.end(e).link.clock
        note = clock_note(both.end(e).link)
        assert note is not None
        told = float(note.split("clock goes ")[1].split(" ppm")[0].replace(",", ""))
        assert told == pytest.approx(abs(ppm), rel=0.02)
        assert ("faster" if ppm * sign > 0 else "slower") in note
        apart = float(note.split("apart by ")[1].split(" ms")[0])
        seconds = (clock.seen_ns - clock.since_ns) / 1e9
        assert apart == pytest.approx((abs(ppm) - 1e6 / SLEW) * seconds / 1e3, abs=abs(ppm) / 1e3 + 5.0)
    slave = both.end("s")
    behind = abs(slave.link.clock.shift_ns + slave._reception.shift_ns) / MS
    assert behind == pytest.approx(apart, abs=abs(ppm) / 1e3 + 5.0), "as far as the slave's grid really stayed behind"


@pytest.mark.parametrize(("ppm", "jitter"), [(450.0, 15 * MS), *(
    pytest.param(*each, marks=pytest.mark.full) for each in ((-450.0, 0), (0.0, 15 * MS)))])
def test_clocks_that_the_grid_can_follow_are_no_note_however_the_link_jitters(ppm: float, jitter: int) -> None:
    both = world(ppm, jitter=jitter)
    assert [clock_note(both.end(e).link) for e in "ms"] == [None, None]


def test_a_way_that_grows_is_not_taken_for_a_clock() -> None:
    """By 40 ms in one direction alone, as a clock of 2,000 ppm does in 20 s."""
    both = World(healing())
    for _ in range(20):
        both.delay["m"] += 2 * MS
        both.run(1.0)
    assert [clock_note(both.end(e).link) for e in "ms"] == [None, None]


def test_clocks_that_came_apart_in_an_earlier_session_are_told_of_too() -> None:
    """The two begin a new session when their grids are too far apart, and then everything of the clocks begins anew."""
    both = world(3000.0)
    both.start("m")
    both.run(2.0)
    slave = both.end("s").link
    assert slave.clock.seen_ns == slave.clock.since_ns, "nothing is known of this session's"
    note = clock_note(slave)
    assert note is not None
    assert re.search(r"goes (2,9|3,0)\d\d ppm slower", note)


def test_the_summary_has_the_note(tmp_path: Path) -> None:
    both = world(3000.0)
    for e in "ms":
        shell = make_shell(both.scene, e, Wire(bind_udp(("127.0.0.1", 0), "--listen"), None), tmp_path / e)
        with shell.wire.sock:
            shell.recorder.begin("bodies")
            shell.endpoint.link = both.end(e).link
            write_end(shell, tmp_path / e, 0, [])
    told = [[note for note in summary(tmp_path / e)["notes"] if "ppm" in note] for e in "ms"]
    assert [len(notes) for notes in told] == [1, 1]
    assert "faster than this one's, and a slave's grid of ticks follows 500 ppm" in told[0][0]
    assert "slower than this one's" in told[1][0]
