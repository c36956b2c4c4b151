"""The live line: its numbers, its words, and that they fit."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop import Deadband, Reading, Scene, load_scene
from teleop.live.live_line import LiveLine, live_text
from teleop.protocol.endpoint import Endpoint
from teleop.protocol.session import Session
from teleop.scene.loading import live_knobs
from teleop.scene.scene import both_ends
from teleop.simulation.structure import columns
from teleop.terminal.progress import Progress
from tests.fakes import Terminal

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


def test_of_one_end_the_line_has_all_that_there_is(monkeypatch: pytest.MonkeyPatch) -> None:
    assert shown(monkeypatch, USUAL) == \
        " 50%  5 s left  f 0.0 N  queue 0.7 ms  x 57.3 mm  loss 1%  delay 51 ms"
    assert live_text(USUAL)[1] == "rtt 100 ms  jitter 0.1 ms"


def test_of_both_ends_it_has_forces_queue_positions_and_delay(monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_an_end_that_has_heard_nothing_says_so() -> None:
    text, less = live_text({**USUAL, "delay": None})
    assert text.endswith("  nothing heard")
    assert less == ""


def test_what_has_no_queue_shows_none() -> None:
    assert "queue" not in live_text({**USUAL, "queue": None})[0]


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


def test_extreme_forces_are_told_by_their_order() -> None:
    assert "f 2e+07 N" in live_text({**USUAL, "f": 2e7})[0]


def line_of(scene: Scene, row: tuple[float, ...]) -> dict[str, Any]:
    """What the live line of the master of `scene` says after a tick with this row."""
    endpoint = Endpoint(scene, "m", Session(master=True, manifest={}, number=1))
    endpoint.senses(False)
    told: list[dict[str, Any]] = []
    line = LiveLine(endpoint, told.append)
    line.tick(7, 1000, Reading((0.1,) * scene.axes, (0.0,) * scene.axes), (0.5,) * scene.axes, row)
    line.announce(1 << 40)
    return told[0]


def test_its_queue_is_that_of_the_newest_row_of_several_axes_the_longest() -> None:
    one = both_ends(load_scene("hard_wall", **live_knobs("hard_wall", {})))
    assert line_of(one, (0.1, 0.0, 0.5, 0.004, 1.0, 0.0, 0.0, 0.0))["queue"] == 0.004
    three = both_ends(load_scene("recorded_reach", **live_knobs("recorded_reach", {"law": "wave"})))
    at = columns(three, "m", False).index("queue_m@") * 3
    assert line_of(three, (*(9.0,) * at, 0.001, 0.003, 0.002, *(9.0,) * 9))["queue"] == 0.003


def test_a_scene_whose_messages_are_played_as_they_come_has_none() -> None:
    assert line_of(both_ends(load_scene("hard_wall")), (0.0,) * 7)["queue"] is None


def test_what_a_deadband_did_not_send_is_no_loss_on_the_line() -> None:
    """It said "loss 89 %" of a link that lost nothing."""
    scene = both_ends(load_scene("hard_wall"))
    assert line_of(scene, (0.0,) * 8)["loss"] == 0.0
    assert line_of(replace(scene, deadband=Deadband(k=0.1)), (0.0,) * 8)["loss"] is None
    assert "loss" not in live_text({**USUAL, "loss": None})[0]
