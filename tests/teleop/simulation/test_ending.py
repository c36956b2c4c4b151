"""The judgement of a run: motion that law and link feed, packets that nobody played, and what stays at rest."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from master.hand import Grip, Reach, Rest, Sine
from slave import Moving, Wall
from teleop import BackwardDifference, Device, Direct, Encoder, MassDamper, Scene, VirtualWall, load_scene, run, sweep
from teleop.analysis.stability.assess import is_stable
from teleop.scene.library import built_in_scenes
from teleop.simulation.ending import scene_arguments
from teleop.simulation.notes import unplayed
from teleop.simulation.plan import Packets
from teleop.simulation.prepared import prepare
from teleop.simulation.rest import FELT, LATE, WINDOWS, swings, trend
from teleop.sweeps.engine import needs_record
from tests.programs import compiler_of


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


def swing(x: Any) -> float:
    return swings([np.asarray(x, dtype=float)], len(x), 1)[0]


class TestTheSwingOfAWindow:
    @given(st.lists(st.floats(-1.0, 1.0), min_size=2, max_size=30))
    def test_is_the_lesser_of_the_largest_rise_and_the_largest_fall(self, x: list[float]) -> None:
        steps = [b - a for i, a in enumerate(x) for b in x[i:]]
        assert swing(x) == min(max(steps), -min(steps))

    def test_is_the_greatest_of_all_ends_and_axes_in_each_window(self) -> None:
        one = np.array([0.0, 1.0, 0.0, 0.0, 2.0, 0.0])
        two = np.stack([0.0 * one, 1.5 * np.roll(one, 3)], axis=1)
        assert swings([one, two], 3, 2) == [3.0, 2.0]


class TestTheTrend:
    @given(st.floats(0.05, 0.997))
    def test_of_an_exponential_decay_or_growth_is_seen_at_any_rate(self, ratio: float) -> None:
        sizes = [ratio ** i for i in range(LATE)]
        assert (trend(sizes), trend(sizes[::-1])) == ("falls", "grows")

    @given(st.floats(0.05, 0.7), st.floats(1.0, 30.0), st.sampled_from([-1.0, 1.0]))
    def test_towards_a_swing_that_stays_is_to_stay(self, ratio: float, left: float, side: float) -> None:
        sizes = [left + 0.9 * side * ratio ** i for i in range(LATE)]
        assert trend(sizes) == "stays"

    def test_of_a_limit_cycle_that_wavers_is_to_stay(self) -> None:
        for sizes in ([0.14, 0.12, 0.14, 0.12, 0.12], [0.13, 0.16, 0.12, 0.10, 0.10],
                      [0.079, 0.079, 0.079, 0.079, 0.0792], [0.10618, 0.10552, 0.10525, 0.10359, 0.10329],
                      [0.0592, 0.0667, 0.1029, 0.1327, 0.1317]):
            assert trend(sizes) == "stays", sizes


def oscillator(damping: float, **other: Any) -> Scene:
    """1 kg at 10 Hz on a hand's spring, let go 1 mm off; the wall is out of reach. Decays as exp(-damping t/2)."""
    hand = Grip(mass=0.0, k=(20.0 * np.pi) ** 2, d=max(damping, 0.0), reference=Rest(at=0.0))
    made = Scene(law=VirtualWall(K=1.0, at=1.0), master=MassDamper(mass=1.0), hand=hand, start_m=1e-3, dt=1e-3,
                 device_m=Device(velocity=BackwardDifference()), duration=2.0)
    return replace(made, **other)


class TestStatus:
    def test_of_an_oscillation_that_nothing_damps_is_a_limit_cycle_and_of_one_that_decays_ok(self) -> None:
        got = run(oscillator(0.0))
        assert got.status == "limit cycle"
        assert got.metrics["swing_end"] == pytest.approx(2e-3, rel=1e-3)
        assert "since t = 0 s, and it keeps swinging: 10 Hz, 0.002 m peak to peak" in got.sentence
        for damping in (0.2, 1.0, 8.0):
            got = run(oscillator(damping))
            assert (got.status, got.sentence) == ("ok", "ran to its end, 2000 ticks of 0.001 s"), damping
            late, early = (2e-3 * np.exp(-0.5 * damping * t) for t in (1.75 + 0.1, 1.75))  # a period of the last window
            assert late < got.metrics["swing_end"] < early, damping

    def test_of_a_swing_too_small_to_be_felt_or_within_two_steps_of_an_encoder_is_ok(self) -> None:
        assert run(oscillator(0.0, start_m=0.49 * FELT)).status == "ok"
        assert run(oscillator(0.0, start_m=0.51 * FELT)).status == "limit cycle"
        for step, status in ((1.1e-3, "ok"), (0.9e-3, "limit cycle")):
            device = Device(encoder=Encoder(step=step), velocity=BackwardDifference())
            assert run(oscillator(0.0, device_m=device)).status == status, step

    def test_of_a_swing_that_grows_while_nothing_moves_the_scene_is_unstable(self) -> None:
        got = run(load_scene("relaxing_tissue", law="direct", delay=0.01))
        assert got.status == "unstable"
        assert "nothing has moved the scene since t = 0.7 s, and it swings ever more" in got.sentence

    def test_a_limit_cycle_of_a_reach_into_a_hard_wall_was_called_ok(self) -> None:
        got = run(load_scene("hard_wall", law="direct"))
        assert got.status == "limit cycle"
        last = got.trace["x_m"][-1000:], got.trace["x_s"][-1000:]
        assert got.metrics["swing_end"] == pytest.approx(max(np.ptp(x) for x in last), rel=2e-3)
        assert got.sentence.endswith("to see what becomes of it: teleop stability hard_wall --set law=direct --time")

    def test_where_the_delay_takes_most_of_the_time_there_is_none_and_the_sentence_says_how_long_it_takes(self) -> None:
        got = run(load_scene("hard_wall", law="direct", delay=0.3))
        assert got.status == "ok"
        assert "too short a time for a verdict; type --set duration=16.4" in got.sentence
        assert run(load_scene("hard_wall", law="direct", delay=0.3, duration=16.5)).status == "limit cycle"

    def test_a_delay_of_the_computation_was_no_delay_and_what_diverges_later_rested_or_was_a_limit_cycle(self) -> None:
        duration, knobs = "5.548", {"delay": 200, "law.K": 1000.0, "law.B": 0.0}
        got = run(load_scene("virtual_wall", **knobs))
        assert got.status == "ok"
        assert got.sentence.endswith(f"too short a time for a verdict; type --set duration={duration}")
        enough = run(load_scene("virtual_wall", **knobs, duration=float(duration)))
        assert (enough.status, "too short" in enough.sentence) == ("unstable", False)

    def test_a_decay_in_windows_shorter_than_its_period_was_a_limit_cycle(self) -> None:
        slow = Grip(mass=0.0, k=100.0, d=1.5, reference=Rest(at=0.0))  # 1 kg at 1.6 Hz, by e in 1.3 s
        for duration in (0.65, 1.3, 2.0):
            assert run(oscillator(0.0, hand=slow, start_m=0.05, duration=duration)).status == "ok", duration
        assert prepare(oscillator(0.0, hand=slow)).still.periods == 943

    def test_a_force_that_is_renewed_slowly_is_late_too(self) -> None:
        device = Device(every=11, delay=3)
        still = prepare(oscillator(0.0, device_m=device)).still
        assert still is not None
        assert (still.late, still.least(60)) == (13, 219)

    @pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.full] * (name != "hard_wall"))
                                      for name in sorted({*built_in_scenes()} - {"lte"})])
    def test_of_every_scene_as_it_is_is_ok_without_a_warning(self, name: str) -> None:
        scene = load_scene(name)
        got = run(scene if scene.duration < 3600.0 else replace(scene, duration=10.0))  # one for machines lasts a day
        assert got.status == "ok"
        assert got.sentence == f"ran to its end, {got.ticks} ticks of {got.dt:g} s"
        assert not any("grows" in note or "playout" in note or "played" in note for note in got.notes)


REACH = Reach(to=0.05, start=0.1, duration=0.4)


class TestNothingMovesAScene:
    def test_from_where_its_hand_stays(self) -> None:
        scene = load_scene("hard_wall", duration=2.0)
        for reference, since in ((REACH, 500), (Rest(at=0.01), 0)):
            still = prepare(replace(scene, hand=replace(scene.hand, reference=reference))).still
            assert still is not None
            assert (still.since, still.window) == (since, (2000 - since) // WINDOWS), reference

    def test_from_its_start_without_a_hand_and_never_where_hand_or_wall_moves_to_the_end(self) -> None:
        still = prepare(replace(load_scene("hard_wall"), hand=None)).still
        assert still is not None
        assert still.since == 0
        wall = Moving(environment=Wall(k=1e3, at=1.0), path=Sine(amplitude=0.01, frequency=1.0))
        assert prepare(replace(load_scene("hard_wall"), environment=wall)).still is None
        for name in ("canonical", "beating_heart", "recorded_reach"):
            assert prepare(load_scene(name)).still is None, name
            assert "swing_end" not in run(load_scene(name, duration=0.5)).metrics, name

    def test_too_late_to_tell(self) -> None:
        scene = load_scene("hard_wall", duration=2.0 + 0.001 * (50 * WINDOWS - 1))
        assert prepare(scene).still is None
        assert prepare(replace(scene, duration=2.4)).still is not None


SCENE = '''
from master import Grip, Reach
from teleop import Device, Encoder, MassDamper, Scene, VirtualWall
from teleop.stages.velocity.backward_difference import BackwardDifference

def scene(*, K: float = 500.0, reach: float = 0.3) -> Scene:
    """A reach into a rendered wall; after it nothing moves."""
    return Scene(law=VirtualWall(K=K, B=0.0, at=0.01), master=MassDamper(mass=0.1), dt=1e-3, duration=1.5,
                 hand=Grip(mass=0.0, k=400.0, d=0.5, reference=Reach(to=0.02, duration=reach)),
                 device_m=Device(encoder=Encoder(step=2e-5), velocity=BackwardDifference()))
'''


@pytest.fixture
def rendered(tmp_path: Path) -> Path:
    """The file of a scene whose hand comes to stand when its knob says so, or in time for no verdict at all."""
    (tmp_path / "rendered.py").write_text(SCENE)
    return tmp_path / "rendered.py"


class TestASweep:
    @pytest.mark.parametrize("engine", ["plain", pytest.param("c", marks=pytest.mark.full), "vector"])
    def test_gives_every_row_the_status_and_the_swing_of_its_run_whenever_each_comes_to_stand(
        self, engine: str, rendered: Path
    ) -> None:
        compiler_of(engine)
        axes = {"reach": [0.2, 0.3, 0.7, 1.4], "K": [50.0, 500.0, 4000.0, 8000.0]}
        table = sweep(rendered, axes, metrics=["swing_end", "f_m_max"], engine=engine)
        for row in table:
            single = run(load_scene(str(rendered), reach=row["reach"], K=row["K"]))
            assert (row["status"], row["ticks"]) == (single.status, single.ticks)
            assert [row.get(name) for name in table.metrics] == [single.metrics.get(name) for name in table.metrics]
        assert {"ok", "unstable"} <= table.counts().keys()
        assert np.isnan(table["swing_end"]).sum() == 4  # nothing is told of those that stand at 1.4 s
        assert not needs_record(("swing_end",), load_scene(str(rendered)))  # which would be plain Python

    def test_keeps_the_swing_to_itself_unless_it_is_asked_for(self, rendered: Path) -> None:
        row, = sweep(rendered, {"K": [500.0]}, metrics=["f_m_max"], engine="plain")
        assert set(row) == {"row", "seed", "K", "status", "ticks", "f_m_max"}

    def test_that_takes_functions_of_the_record_goes_by_the_same_status(self, rendered: Path) -> None:
        def longest(result: Any) -> float:
            return float(result.ticks)

        own: list[Any] = [longest]
        table, plain = [sweep(rendered, {"K": [500.0, 8000.0]}, metrics=["swing_end", *more]) for more in (own, [])]
        assert (table["status"].tolist(), table["swing_end"].tolist()) == (
            plain["status"].tolist(), plain["swing_end"].tolist())
