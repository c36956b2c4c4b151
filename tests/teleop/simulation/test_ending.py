"""Warnings of a run that came to its end: motion that law and link feed, and packets that nobody played."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from master.hand import Grip, Sine
from teleop import Direct, MassDamper, Scene, VirtualWall, load_scene, run
from teleop.analysis.stability.assess import is_stable
from teleop.simulation.ending import scene_arguments
from teleop.simulation.notes import unplayed
from teleop.simulation.plan import Packets
from teleop.simulation.rest import swings, trend


def warned(result: Any, word: str) -> list[str]:
    return [note for note in result.notes if word in note]


class TestMotionThatGrows:
    def test_of_a_loop_that_comes_to_its_end_is_warned_of_where_it_is_unstable_and_not_where_it_is_stable(self) -> None:
        loops: list[tuple[bool, dict[str, Any]]] = [
            (False, {"delay": 0.02}), (False, {"delay": 0.005, "k_e": 700.0}), (True, {"delay": 0.01}),
            (True, {"delay": 0.005, "k_e": 400.0}), (True, {"law": "wave", "delay": 0.1, "k_e": 5e3})]
        for stable, knobs in loops:
            scene = load_scene("soft_tissue", **{"law": "direct", **knobs})
            got = run(scene)
            notes = warned(got, "grows")
            assert (is_stable(scene), bool(notes)) == (stable, not stable), knobs
            assert got.status == "ok", knobs
            assert all(note.endswith("teleop stability " + scene_arguments(scene)) for note in notes), knobs

    def test_says_what_the_ledger_says_in_a_run_at_20_m_and_262_kJ_that_was_ok_without_a_word(self) -> None:
        got = run(load_scene("soft_tissue", law="direct", delay=0.1))
        note, = warned(got, "grows")
        swung = [min((x - np.minimum.accumulate(x)).max(), (np.maximum.accumulate(x) - x).max())
                 for x in (got.trace["x_m"][8750:], got.trace["x_m"][3750:5000])]
        assert f"a swing of {swung[0]:.3g} m peak to peak in the last eighth" in note
        assert f"of {swung[1]:.3g} m half a run before, where the hand's reference moves over 0.1 m" in note
        # The force of the last tick has moved nothing yet.
        assert f"given out {-got.metrics['E_port_end']:.3g} J" in note

    def test_of_a_wall_that_moves_is_warned_of_too(self) -> None:
        assert warned(run(load_scene("beating_heart", law="direct", delay=0.1)), "grows")
        assert not warned(run(load_scene("beating_heart", law="direct", delay=0.005)), "grows")

    def test_to_138_m_after_a_reach_that_its_delay_left_no_time_to_judge_was_ok_without_a_word(self) -> None:
        got = run(load_scene("relaxing_tissue", law="direct", delay=0.1))
        assert (got.status, round(got.metrics["swing_end"])) == ("ok", 138)
        assert "too short a time for a verdict" in got.sentence
        note, = warned(got, "grows")
        assert "where the hand's reference moves over 0.03 m" in note
        assert not warned(run(load_scene("rubber", law="wave", delay=0.1)), "grows")  # it dies away

    def test_of_a_body_at_resonance_that_the_hand_alone_feeds_is_not_warned_of(self) -> None:
        """Undamped at 10 Hz: a reference of 1 mm at 10 Hz makes it swing by 63 mm more each second."""
        scene = Scene(law=VirtualWall(K=1.0, at=1.0), master=MassDamper(mass=1.0), dt=1e-3, duration=2.0,
                      hand=Grip(mass=0.0, k=(20.0 * np.pi) ** 2, d=0.0, reference=Sine(amplitude=1e-3, frequency=10.0)))
        got = run(scene)
        assert swings([got.trace["x_m"]], 250)[-1] == pytest.approx(2.0 * 2e-3 * np.pi * 10.0, rel=0.1)
        assert trend(swings([got.trace["x_m"]], 250)) == "grows"
        assert not got.notes


class TestPacketsThatWereNotPlayed:
    def test_of_a_link_longer_than_the_run_or_that_were_all_lost_or_due_after_the_end_are_told_of(self) -> None:
        got = run(load_scene("hard_wall", delay=80.0, duration=1.0))
        forward, back = warned(got, "played none")
        assert forward.startswith("the slave played none of the 1000 packets that the master sent")
        assert back.startswith("the master played none")
        assert "none came within the 1 s of the run" in forward
        assert "--set delay" in forward
        note, = warned(run(load_scene("hard_wall", link="bernoulli(1) ; delay(0.01)", duration=0.2)), "played none")
        assert "the link lost them all" in note
        notes = warned(run(load_scene("burst_loss", playout="fixed:1.5", duration=1.0)), "played none")
        assert all("their time to be played was after the end" in note for note in notes)
        assert len(notes) == 2

    def test_of_a_playout_shorter_than_the_delay_say_which_is_long_enough(self) -> None:
        playout, enough, slow = "fixed:0.015:hold", "fixed:0.02:hold", {"link": "delay(0.02)", "duration": 0.5}
        forward, back = warned(run(load_scene("burst_loss", playout=playout, **slow)), "too late")
        assert forward.startswith("480 packets came to the slave too late to be played, and 0 were played")
        assert "to the master" in back
        assert f"({playout})" in forward
        assert forward.endswith(f"type --set playout={enough}")
        assert not warned(run(load_scene("burst_loss", playout=enough, **slow)), "played")

    def test_of_a_playout_that_the_scenes_file_has_said_to_edit_it_though_every_scene_takes_the_knob(
        self, tmp_path: Path
    ) -> None:
        (tmp_path / "own.py").write_text(
            "from dataclasses import replace\nfrom scenarios import canonical\nfrom teleop import Fixed\n"
            "def scene(*, delay: float = 0.02):\n"
            "    return replace(canonical.scene(delay=delay, duration=0.2), playout=Fixed(0.01))\n")
        scene = load_scene(str(tmp_path / "own.py"))
        assert warned(run(scene), "too late")[0].endswith("type --set playout=fixed:0.02")
        assert "write playout=Fixed(delay=0.02" in warned(run(replace(scene, knobs={})), "too late")[0]
        assert not warned(run(load_scene(str(tmp_path / "own.py"), playout="fixed:0.02")), "too late")

    def test_of_jitter_beyond_the_playout_are_told_of_in_the_one_direction(self) -> None:
        scene = load_scene("burst_loss", playout="fixed:0.022", link="delay(0.02) | uniform(0.02) ; delay(0.01)",
                           duration=0.5)
        note, = warned(run(scene), "too late")
        assert "to the slave" in note
        longer = note.rsplit("=", 1)[1]
        got = run(load_scene("burst_loss", playout=longer, link="delay(0.02) | uniform(0.02) ; delay(0.01)",
                             duration=0.5))
        assert got.packets["fwd"].late <= 0.01 * got.packets["fwd"].received
        assert not warned(got, "too late")

    def test_of_a_live_run_say_a_playout_that_has_room_for_what_the_machine_adds(self) -> None:
        scene = load_scene("burst_loss", playout="fixed:0.02", link="delay(0.02)", duration=0.5)
        counts = {"fwd": Packets(sent=500, received=480, late=480), "bwd": Packets(sent=500, received=480)}
        trace = {"seq_s": np.full(500, -1), "seq_m": np.arange(500) - 20}
        note, = unplayed(scene, trace, counts, seed=0, live=True)
        assert note.endswith("type --set playout=fixed:0.03")

    @pytest.mark.parametrize(("playout", "cure"), [("zero", "integral"), ("fixed:0.03", "fixed:0.03:integral")])
    def test_that_leave_gaps_which_are_played_as_zero_are_told_of_as_what_fades(self, playout: str, cure: str) -> None:
        lossy = {"link": "delay(0.02) | bernoulli(0.05) ; delay(0.02)", "duration": 1.0}
        note, = warned(run(load_scene("hard_wall", playout=playout, **lossy)), "fades")
        assert re.fullmatch(r"waves were played as zero in gaps, \d\d of 9[78]\d ticks at the slave: a steady force "
                            rf"fades; type --set playout={cure}", note)
        assert not warned(run(load_scene("hard_wall", playout=cure, **lossy)), "fades")
        assert not warned(run(load_scene("hard_wall", playout=playout, link="delay(0.02)", duration=0.2)), "fades")
        assert not warned(run(load_scene("hard_wall", law="pfra", playout=playout, **lossy)), "fades")
        scene = replace(load_scene("hard_wall", playout=playout, **lossy), knobs={})
        assert "in a scene of your own write playout=" in warned(run(scene), "fades")[0]

@pytest.mark.parametrize(("name", "knobs", "text"), [
    ("hard_wall", {}, "hard_wall"),
    ("hard_wall", {"law": "pfra", "law.alpha": 0.5, "k_e": 1e3}, "hard_wall --set k_e=1000.0 --set law=pfra --set "
                                                                 "law.alpha=0.5"),
    ("canonical", {"law.b": 3.0, "link": "delay(0.01) | bernoulli(0.1)"}, "canonical --set law.b=3.0 --link "),
    ("burst_loss", {"playout": "fixed:0.1:hold"}, "burst_loss --set playout=fixed:0.1:hold"),
    ("recorded_reach", {"observer": 50.0, "power": 1.0}, "recorded_reach --set"),
])
def test_a_scene_as_it_is_typed_is_the_scene_again(name: str, knobs: dict[str, Any], text: str) -> None:
    from shlex import split

    scene = load_scene(name, **knobs)
    said = scene_arguments(scene)
    assert set(split(text)) <= set(split(said))
    first, *rest = split(said)
    again = load_scene(first, **{"link" if flag == "--link" else each.split("=", 1)[0]:
                                 each if flag == "--link" else each.split("=", 1)[1]
                                 for flag, each in zip(rest[::2], rest[1::2], strict=True)})
    assert again == scene


def test_a_scene_of_ones_own_is_typed_as_its_file(tmp_path: Path) -> None:
    made = tmp_path / "mine.py"
    made.write_text("from scenarios.hard_wall import scene\n")
    assert scene_arguments(load_scene(str(made), law=Direct())) == "mine.py, with its path and the --set of the run"


def test_a_wall_that_is_pressed_through_jitter_is_no_limit_cycle() -> None:
    """What the jitter makes of the held force, 0.1 mm, was called one; a swing of the loop itself still is."""
    rough = "delay(0.04) | uniform(0.02) | bernoulli(0.1)"
    pressed = run(load_scene("hard_wall", link=rough))
    assert pressed.metrics["swing_end"] > 5e-5
    assert pressed.status == "ok"
    assert run(load_scene("hard_wall", link=rough, law="direct")).status == "limit cycle"


@pytest.mark.full
def test_the_swing_of_joints_was_told_in_m() -> None:
    cases: list[tuple[dict[str, Any], str]] = [
        ({"delay": 0.1, "duration": 9.0}, "unstable"), ({"delay": 0.1}, "ok"), ({"x_limit": 0.5}, "diverged")]
    for knobs, status in cases:
        got = run(load_scene("leader_follower", **knobs))
        assert got.status == status, knobs
        assert set(re.findall(r"\d (m|rad)\b", got.sentence)) == {"rad"}, knobs


def test_the_motion_of_an_axis_that_turns_was_told_to_grow_in_m() -> None:
    note, = warned(run(replace(load_scene("soft_tissue", law="direct", delay=0.1), units=("rad",))), "grows")
    assert len(re.findall(r"\d rad\b", note)) == 3
    assert not re.findall(r"\d m\b", note)
