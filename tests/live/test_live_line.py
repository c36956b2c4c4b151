"""The live line, its numbers, its words, and that they fit; and the notes of an end's summary."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop import Deadband, Energy, Fixed, Hold, Integral, Playout, Reading, Refused, Scaled, Scene, Zero, load_scene
from teleop.live.live_line import LiveLine, live_text
from teleop.live.net.wire import Wire, bind_udp
from teleop.live.options import ticks_of
from teleop.live.summary import clock_note, missed_note, reading_note, sums_note, write_end
from teleop.protocol.endpoint import SLEW, Endpoint
from teleop.protocol.session import Session
from teleop.scene.loading import live_knobs
from teleop.scene.scene import both_ends
from teleop.simulation.structure import columns
from teleop.terminal.progress import Progress
from tests.fakes import Terminal
from tests.live.conftest import make_shell, summary
from tests.teleop.protocol.virtual_clock import MS, Clock, World, healing

USUAL = {"end": "m", "k": 9999, "x": 0.0573, "f": -0.01, "delay": 0.0506, "rtt": 0.1004, "jitter": 0.00012,
         "loss": 0.014, "gain": 1.0, "cause": None, "queue": 0.0007}


def shown(monkeypatch: pytest.MonkeyPatch, *ends: dict[str, Any], done: float = 5000.0) -> str:
    """What stands on a terminal of 80 columns of a run of 10,000 ticks, five seconds after its beginning."""
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setattr(os, "get_terminal_size", lambda _: os.terminal_size((80, 24)))
    stream = Terminal()
    progress = Progress(stream, 10_000)
    progress.show(1.0, 0.0)
    progress.show(done, 5.0, *live_text(*ends))
    return stream.getvalue().split("\r")[-1].rstrip()


def test_the_line_has_all_of_one_end_and_of_both_forces_queue_positions_and_delay(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    assert shown(monkeypatch, USUAL) == \
        " 50%  5 s left  f 0.0 N  queue 0.7 ms  x 57.3 mm  loss 1%  delay 51 ms"
    assert live_text(USUAL)[1] == "rtt 100 ms  jitter 0.1 ms"
    slave = {**USUAL, "end": "s", "x": 0.03, "f": 0.38, "queue": 0.004, "delay": 0.05, "loss": 0.0}
    assert shown(monkeypatch, {**USUAL, "f": 0.41, "loss": 0.0}, slave) == \
        " 50%  5 s left  f 0.4/0.4 N  queue 0.7/4.0 ms  x 57.3/30.0 mm  delay 51/50 ms"


def test_of_both_ends_loss_round_trip_and_jitter_are_the_greater_ones() -> None:
    slave = {**USUAL, "end": "s", "loss": 0.004, "rtt": 0.2, "jitter": 0.02, "delay": None}
    text, less = live_text({**USUAL, "loss": 0.003}, slave)
    assert "delay 51/- ms" in text
    assert "loss" in text  # the slave has heard nothing, so its loss says nothing
    assert "loss 0.3%" in text
    assert less == "rtt 100 ms  jitter 0.1 ms"
    text, less = live_text({**USUAL, "loss": 0.003}, {**slave, "delay": 0.1})
    assert "loss 0.4%" in text
    assert less == "rtt 200 ms  jitter 20 ms"


def test_an_end_that_has_heard_nothing_or_has_no_queue_says_so_and_extreme_forces_are_told_by_their_order() -> None:
    text, less = live_text({**USUAL, "delay": None})
    assert text.endswith("  nothing heard")
    assert less == ""
    assert "queue" not in live_text({**USUAL, "queue": None})[0]
    assert "f 2e+07 N" in live_text({**USUAL, "f": 2e7})[0]


@pytest.mark.parametrize(("ends", "said"), [
    ([{"cause": "a stall: no tick for 12.345 s", "gain": 0.37}], "SAFE 37%, stall"),
    ([{"cause": "the device: it does not answer", "gain": 0.0}], "SAFE 0%, device"),
    ([{}, {"end": "s", "cause": "silence", "gain": 0.2}], "slave SAFE 20%, silence"),
    ([{"cause": "silence", "gain": 0.1}, {"end": "s", "cause": "silence", "gain": 0.2}], "SAFE 10%/20%, silence"),
    ([{"cause": "a new session", "gain": 0.1}, {"end": "s", "cause": "no answer: for 1 s", "gain": 0.2}],
     "SAFE 10%/20%, new sessi/no answer"),
])
def test_first_of_all_it_says_which_end_is_safe_and_why(ends: list[dict[str, Any]], said: str) -> None:
    assert live_text(*({**USUAL, **end} for end in ends))[0].startswith(f"{said}  f ")


seconds = st.floats(0.0, 60.0)
causes = st.none() | st.text(min_size=1, max_size=60) | st.sampled_from([
    "silence", "a stall: no tick for 12.345 s", "the session is over", "a new session", "the device: " + "x" * 200])
numbers = st.fixed_dictionaries({
    "x": st.floats(-1e4, 1e4), "f": st.floats(-9999.0, 9999.0), "queue": st.none() | st.floats(0.0, 9.9),
    "delay": st.none() | seconds, "rtt": st.none() | seconds, "jitter": seconds,
    "loss": st.none() | st.floats(0.0, 1.0), "gain": st.floats(0.0, 1.0),
    "cause": causes.filter(lambda cause: cause is None or cause.isprintable())})


@given(st.lists(numbers, min_size=1, max_size=2), st.floats(2.0, 10_000.0))
def test_whatever_the_numbers_it_fits_80_columns_with_the_forces_and_the_queue(
    ends: list[dict[str, Any]], done: float
) -> None:
    both = [{"end": e, **end} for e, end in zip("ms", ends, strict=False)]
    with pytest.MonkeyPatch.context() as monkeypatch:
        line = shown(monkeypatch, *both, done=done)
    assert len(line) < 80
    forces = "/".join(f"{end['f']:z.1f}" if abs(end["f"]) < 99.95 else f"{end['f']:.0f}" for end in ends)
    assert f"f {forces} N" in line
    assert ("  queue " in line) == any(end["queue"] is not None for end in ends)
    assert ("SAFE" in line) == any(end["cause"] is not None for end in ends)


@given(st.lists(numbers, min_size=2, max_size=2), st.floats(2.0, 10_000.0))
def test_of_many_axes_it_shows_the_one_that_is_loaded_most_and_fits_too(
    ends: list[dict[str, Any]], done: float
) -> None:
    both = [{"end": e, **end, "x": 0.0, "f": 0.0, "axes": [
        ["base", "m", 0.0, 0.0, 1e9], ["shoulder_pitch", "rad", end["x"], end["f"] + 1.0, 1.0]]}
        for e, end in zip("ms", ends, strict=False)]
    with pytest.MonkeyPatch.context() as monkeypatch:
        line = shown(monkeypatch, *both, done=done)
    assert len(line) < 80
    assert "shoulder f " in line
    assert " N m" in line


def line_of(scene: Scene, row: tuple[float, ...]) -> dict[str, Any]:
    """What the live line of the master of `scene` says after a tick with this row."""
    endpoint = Endpoint(scene, "m", Session(master=True, manifest={}, number=1))
    endpoint.senses(False)
    told: list[dict[str, Any]] = []
    line = LiveLine(endpoint, told.append)
    line.tick(7, 1000, Reading((0.1,) * scene.axes, (0.0,) * scene.axes), (0.5,) * scene.axes, row)
    line.announce(1 << 40)
    return told[0]


def test_its_queue_is_that_of_the_newest_row_of_several_axes_the_longest_and_none_where_messages_do_not_wait() -> None:
    one = both_ends(load_scene("hard_wall", **live_knobs("hard_wall", {})))
    assert line_of(one, (0.1, 0.0, 0.5, 0.004, 1.0, 0.0, 0.0, 0.0))["queue"] == 0.004
    three = both_ends(load_scene("recorded_reach", **live_knobs("recorded_reach", {"law": "wave"})))
    at = columns(three, "m", False).index("queue_m@") * 3
    assert line_of(three, (*(9.0,) * at, 0.001, 0.003, 0.002, *(9.0,) * 9))["queue"] == 0.003
    assert line_of(both_ends(load_scene("hard_wall")), (0.0,) * 7)["queue"] is None


def test_what_a_deadband_did_not_send_is_no_loss_on_the_line() -> None:
    """It said "loss 89 %" of a link that lost nothing."""
    scene = both_ends(load_scene("hard_wall"))
    assert line_of(scene, (0.0,) * 8)["loss"] == 0.0
    assert line_of(replace(scene, deadband=Deadband(k=0.1)), (0.0,) * 8)["loss"] is None
    assert "loss" not in live_text({**USUAL, "loss": None})[0]


def test_a_run_of_which_a_third_of_the_ticks_was_left_out_is_not_ok_without_a_word() -> None:
    """On a busy machine the first demo said `ok`, with no force where virtual time has 0.94 N."""
    scene = load_scene("canonical", playout=Integral())
    note = missed_note(3637, 10000, scene)
    assert note is not None
    assert note.startswith("3637 of 10000 ticks (36.4 %) were left out")
    assert note.endswith("try --spin, real-time scheduling (without --no-realtime) or --rate 500")
    refused, given = ({"scheduler": text} for text in ("no (Operation not permitted)", "SCHED_FIFO, priority 40"))
    assert "`teleop doctor` says how" in str(missed_note(3637, 10000, scene, refused))
    assert str(missed_note(3637, 10000, scene, given)).endswith("try --spin or --rate 500")
    assert missed_note(100, 10000, scene) is None, "one of a hundred changes no force that a hand feels"
    assert missed_note(0, 0, scene) is None, "an end that never came to a tick"
    zero = load_scene("hard_wall", playout=Zero())
    with pytest.raises(Refused, match="--rate 500 is not the scene's"):
        ticks_of(zero, 500.0, lockstep=False, spin=False)
    assert str(missed_note(3637, 10000, zero, given)).endswith("or try --spin"), "no rate that is refused"


def test_ticks_that_went_by_in_a_devices_read_are_laid_to_the_device_and_waves_that_do_not_add_up_are_told() -> None:
    note = str(reading_note(4900, 52_000_000, 10_000))
    assert note.startswith("4900 of 10000 ticks went by while the device was read, for up to 52 ms at a time; ")
    assert reading_note(100, 52_000_000, 10_000) is None
    assert reading_note(0, 0, 0) is None
    assert sums_note(0, "master") is None
    assert str(sums_note(1, "slave")).startswith("the slave's waves do not add up: 1 message of it was not taken")
    assert str(sums_note(7, "master")).startswith("the master's waves do not add up: 7 messages of it were not taken")


@pytest.mark.parametrize(("playout", "said"), [
    (Integral(), "its queue of waves grows as long as the longest gap"),
    (Fixed(0.1, Integral()), "its queue of waves grows as long as the longest gap"),
    (Zero(), "so a steady force fades (type --set playout=integral, at both ends)"),
    (Fixed(0.1), "so a steady force fades (type --set playout=fixed:0.1:integral, at both ends)"),
    (Hold(), "which is active"), (Scaled(0.5), "scaled down, so a steady force fades"), (Energy(), "in short bursts"),
], ids=str)
def test_a_note_on_ticks_that_were_left_out_says_what_the_playout_makes_of_them(playout: Playout, said: str) -> None:
    """Of every playout it said that the force fades."""
    assert said in str(missed_note(500, 1000, load_scene("hard_wall", playout=playout)))
    assert "its law does without" in str(missed_note(500, 1000, load_scene("hard_wall", law="pfra", playout=playout)))


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
    # And neither is a way that grows by 40 ms in one direction alone, as a clock of 2,000 ppm does in 20 s.
    both = World(healing())
    for _ in range(20):
        both.delay["m"] += 2 * MS
        both.run(1.0)
    assert [clock_note(both.end(e).link) for e in "ms"] == [None, None]


def test_the_summary_has_the_note_and_clocks_that_came_apart_in_an_earlier_session_are_told_of_too(
    tmp_path: Path
) -> None:
    """The two begin a new session when their grids are too far apart, and then everything of the clocks begins anew."""
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
    both.start("m")
    both.run(2.0)
    slave = both.end("s").link
    assert slave.clock.seen_ns == slave.clock.since_ns, "nothing is known of this session's"
    note = clock_note(slave)
    assert note is not None
    assert re.search(r"goes (2,9|3,0)\d\d ppm slower", note)
