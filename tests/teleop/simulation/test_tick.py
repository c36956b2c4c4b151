"""The tick: a scene's loop holds what the scene names and no more, and ticks that are left out hold the force.

A loop and a live end as they are made of the tick stand in `loops/`, so that a review reads plain Python. After a
change of the tick that is meant, write them anew: `python -m tests.teleop.simulation.test_tick`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pytest

from channel import Bernoulli, Delay, LeftOut, LeftOutTicks, UniformJitter, parse_link
from master.hand import Grip, Sine
from slave import Tissue, Wall
from teleop import PFRA, At, Cap, Direct, Hold, MassDamper, Refused, Scene, Watchdog, Wave, Zero, load_scene, run
from teleop.analysis.models.linear import linear_scene
from teleop.analysis.passivity.one_port import one_port
from teleop.analysis.passivity.surroundings import linear_parts
from teleop.scene.scene import both_ends
from teleop.simulation.source import bind, functions, live_of, rendered
from teleop.simulation.structure import columns, live_structure, numbers_of, run_of, structure_of
from teleop.simulation.tick import live
from teleop.stages.end import Recorder


class Note(NamedTuple):
    x: float
    f_e: float


class Sums(NamedTuple):
    power: float
    push: float


def read_all(at: At, over: Sums) -> float:
    """Something of every field of `At`."""
    timed = 0.1 * (min(at.age, 1.0) + at.dt) * at.fresh + at.gain * at.span
    return timed + 0.01 * over.push + over.power - at.v


@dataclass(frozen=True, kw_only=True)
class Curious:
    """A law that reads every field at both ends, couples the axes at both, and can write down what it is told."""

    told: dict[str, list[At]] | None = None
    claims: ClassVar[dict[str, str]] = {}

    def master_start(self, at: At) -> tuple[Note, Note]:
        return Note(at.x, at.f), Note(at.x, 0.0)

    def slave_start(self, at: At) -> tuple[Note, Note]:
        return Note(at.x, at.f), Note(at.x, 0.0)

    def master_sums(self, s: Note, at: At, rx: Note) -> Sums:
        return Sums(at.f_held * at.dx, at.f + rx.f_e)

    def slave_sums(self, s: Note, at: At, rx: Note) -> Sums:
        return Sums(at.f_held * at.dx, rx.f_e)

    def master(self, s: Note, at: At, rx: Note, over: Sums) -> tuple[float, Note, Note]:
        if self.told is not None:
            self.told["m"].append(at)
        f_m = 30.0 * (at.x - s.x) + 0.1 * rx.f_e - read_all(at, over)
        return f_m, Note(at.x, at.v), Note(0.9 * s.x + 0.1 * at.x, at.f)

    def slave(self, s: Note, at: At, rx: Note, over: Sums) -> tuple[float, Note, Note]:
        if self.told is not None:
            self.told["s"].append(at)
        return 300.0 * (rx.x - at.x) + 10.0 * read_all(at, over), Note(at.x, at.f), Note(at.x, at.f_held)


LAWS = (Wave(), Direct(K=300.0, B=6.0, kf=0.3), PFRA(K=300.0, B=6.0), Curious())
JITTERY = Delay(0.01) | UniformJitter(0.01) | Bernoulli(0.2)
AMPLITUDE, PLACES = (0.05, 0.03, -0.02), (0.01, -0.02, 0.0)


def make(law: Any, axes: int = 1, *, hand: bool = True, **other: Any) -> Scene:
    """A scene in which things touch, in each of its axes."""
    grip = Grip(mass=0.2, k=100.0, d=3.0, reference=Sine(amplitude=AMPLITUDE[:axes], frequency=2.0))
    environment = (Wall(k=2000.0, d=2.0, at=0.01), Tissue(k=200.0, d=1.0, at=-0.02), None)[:axes]
    return Scene(**{
        "law": law, "axes": axes, "master": MassDamper(mass=0.1, damping=0.5), "duration": 0.3,
        "slave": MassDamper(mass=0.3, damping=1.0), "hand": grip if hand else None, "environment": environment,
        "start_m": PLACES[:axes], "start_s": PLACES[:axes], **other,
    })


# A scene pays only for what it names


def words(scene: Scene) -> set[str]:
    """Every name in the loop of a scene and in its two live ends."""
    return set(re.findall(r"[A-Za-z_]\w*", rendered(scene) + rendered(scene, "m") + rendered(scene, "s")))


BARE = make(Direct(), hand=False)
NAMES = [
    (make(Wave(), link=JITTERY), BARE, {"ring_m0", "ring_s0", "seq_m"}),
    (make(Wave(), energy=True), make(Wave()), {"E_in_m", "E_out_s", "E_in_s", "E_out_m", "E_port_m",
                                               "E_port_s", "dx_m0", "x_before_m0", "wave_m"}),
    (make(Direct(), energy=True), make(Wave()), {"E_port_m", "E_port_s"}),
    (make(PFRA()), make(PFRA(), observer=None), {"c_obs_m0", "observe", "v_before_m0"}),
    (make(PFRA(), observer=None), make(PFRA()), {"f_ext_m0"}),
    (make(Direct()), make(Wave()), {"f_ext_s0"}),
    (make(Direct(), watchdog=Watchdog()), make(Direct()), {"c_dog_m", "quiet_ticks_m", "watchdog_step", "heard_m"}),
    (make(Direct(), cap=Cap(f_max=1.0)), make(Direct()), {"c_cap_m", "cap"}),
    (make(Direct(), cap=Cap(f_max=1.0, v_max=1.0)), make(Direct(), cap=Cap(f_max=1.0)), {"c_speed_m", "limit_speed"}),
    (make(Direct(), cap=Cap(f_max=1.0, power=1.0)), make(Direct(), cap=Cap(f_max=1.0, v_max=1.0)),
     {"c_power_m", "E_left_m", "E_left_s", "spend", "refill", "limit_power", "dx_m0", "dx_s0"}),
    (make(Direct()), BARE, {"move_gripped", "r_m0"}),
    (BARE, make(Direct()), {"move_free"}),
    (make(Curious()), make(Direct()), {"age_m", "age_s", "newest_m", "total_m", "total_s", "sums_m0", "over_m"}),
    (make(Direct(), axes=3), make(Direct()), {"x_m1", "x_s2", "f_m1"}),
]


@pytest.mark.parametrize(("named", "left_out", "names"), NAMES)
def test_a_text_names_what_its_scene_names_and_nothing_else(named: Scene, left_out: Scene, names: set[str]) -> None:
    assert names <= words(named)
    assert not names & words(left_out)


def test_a_scene_without_waves_has_no_ledger_of_the_link_and_one_that_reads_no_force_no_sensor() -> None:
    assert not {name for name in words(make(Direct(), energy=True)) if name.startswith(("E_in", "E_out"))}
    wave, direct = structure_of(make(Wave())), structure_of(make(Direct()))
    assert [end.has.sensed or end.has_stage("observer") for end in (wave.m, wave.s)] == [False, False]
    assert [end.has.sensed or end.has_stage("observer") for end in (direct.m, direct.s)] == [False, True]


def every_kind() -> Iterator[Scene]:
    """Scenes of every structure, thinned out."""
    yes_no = (False, True)
    kinds = product(LAWS, (1, 3), yes_no, yes_no, yes_no, yes_no, yes_no, (None, 200.0))
    for n, (law, axes, link, hand, held, safe, energy, observer) in enumerate(kinds):
        if n % 7:
            continue
        yield make(
            law, axes, hand=hand, link=JITTERY if link else None, energy=energy, observer=observer, duration=0.03,
            watchdog=Watchdog(timeout=0.005, ramp=0.003) if safe else None,
            cap=Cap(f_max=2.0, slew=500.0, v_max=0.5, power=0.1 if n % 2 else None) if safe else None,
            **({"playout": Hold()} if held else {}),
        )


def test_every_structure_records_the_columns_that_it_says() -> None:
    for scene in every_kind():
        trace = run(scene, seed=1).trace
        for e in ("m", "s"):
            for column in columns(scene, e):
                array, per_axis = trace[column.removesuffix("@")], "@" in column and scene.axes > 1
                assert array.shape == ((scene.ticks, scene.axes) if per_axis else (scene.ticks,))
                assert np.isfinite(array).all()


# Axes


def test_sums_go_over_the_axes_from_left_to_right() -> None:
    """Not with `sum`, which compensates from Python 3.12 on: the bits would depend on the version."""
    sums = [" + ".join([f"sums_m{axis}.{field}" for axis in range(3)]) for field in ("eh", "hh", "ee", "vv")]
    three = f"Sums_m({', '.join(sums)})"
    assert f"over_m = {three}" in rendered(make(PFRA(), axes=3))
    assert "over_m = sums_m0\n" in rendered(make(PFRA(), axes=1))


# What an end is told


@pytest.mark.parametrize("link", [JITTERY, None])
@pytest.mark.parametrize("observer", [200.0, None])
def test_an_end_is_told_its_reading_what_was_held_and_how_old_the_news_is(link: Any, observer: float | None) -> None:
    told: dict[str, list[At]] = {"m": [], "s": []}
    scene = make(Curious(told=told), link=link, observer=observer, cap=Cap(f_max=1.0, slew=100.0))
    trace = run(scene, seed=3).trace
    for e, touch in (("m", "f_h" if observer is None else "f_h_hat"), ("s", "f_env")):
        at = At(*np.array(told[e]).T)
        before = np.concatenate([[0.0], trace[f"f_{e}"][:-1]])
        assert np.array_equal(at.x, trace[f"x_{e}"])
        assert np.array_equal(at.v, trace[f"v_{e}"])
        assert np.array_equal(at.f, trace[touch])
        assert np.array_equal(at.f_held, before)
        assert np.array_equal(at.dx, np.diff(trace[f"x_{e}"], prepend=trace[f"x_{e}"][0]))
        k = np.arange(scene.ticks)
        seq = trace[f"seq_{e}"] if link else k - 1
        newest = np.maximum.accumulate(seq)
        assert np.array_equal(at.fresh, seq >= 0)
        assert np.array_equal(at.age, np.where(newest >= 0, (k - newest) * 1e-3, np.inf))
        assert (at.dt == 1e-3).all()


def test_no_link_is_a_delay_of_nothing_also_for_a_law_that_reads_all_and_where_ticks_are_left_out() -> None:
    none, zero = run(make(Curious(), energy=True)).trace, run(make(Curious(), energy=True, link=Delay(0.0))).trace
    assert all(np.array_equal(none[name], zero[name]) for name in none)
    # Without a link the newest message of the other end's ticks until then is there.
    none, zero = [run(replace(pressed(left_out_m=SOME, left_out_s=LeftOut(0.1)), link=each)).trace
                  for each in (None, parse_link("delay(0)"))]
    assert all(np.array_equal(none[name], zero[name]) for name in zero)


# Live


@pytest.mark.parametrize("e", ["m", "s"])
def test_a_live_end_has_the_bits_of_the_tick_as_it_stands(e: str) -> None:
    scene = load_scene("hard_wall", law="pfra")
    stands = run_of(live_structure(structure_of(scene), e), Recorder())
    bind(stands, functions(scene))
    numbers = numbers_of(scene, {e: (0.0,)})
    beginning: tuple[Any, ...] = (numbers, scene.law, 1e-3, (0.0,), (0.0,), (0.0,))
    made, stood = live_of(scene, e)(*beginning), live(stands, getattr(stands, e), *beginning)
    next(made)
    next(stood)
    for k, missed in ((0, 1), (1, 1), (5, 4), (6, 1)):
        sent = (k, (0.01 * k,), (0.1,), (0.3,), False, -1, None, None, 1.0 if missed == 1 else 0.0, (0.2,), missed,
                0.0, 1.0, 1.0, 0.0, 0.0, None)
        assert repr(made.send(sent)) == repr(stood.send(sent))


# Ticks that are left out

SOME = LeftOutTicks((25, 26, 27, 35, 50, 51, 90, 91, 92, 93, 94))


def pressed(**other: Any) -> Scene:
    """A scene in which both ends do something at every tick."""
    return replace(load_scene("canonical", link="delay(0.01)"), **{"duration": 0.3, "energy": True, **other})


def held(trace: Any, name: str) -> np.ndarray:
    """The ticks at which a column is what it was at the tick before."""
    column = trace[name]
    return np.flatnonzero(column[1:] == column[:-1]) + 1


def test_the_force_is_held_while_the_bodies_move() -> None:
    for e, peer in ("ms", "sm"):
        trace = run(pressed(**{f"left_out_{e}": SOME})).trace
        assert [k for k in held(trace, f"f_{e}").tolist() if k > 15] == [*SOME.ticks], e
        assert not np.isin(SOME.ticks, held(trace, f"x_{e}")).any(), e
        assert [k for k in held(trace, f"f_{peer}").tolist() if k > 15] == [], e


def test_a_packet_of_a_tick_that_is_left_out_is_never_sent_and_what_comes_at_one_waits_or_is_late() -> None:
    result = run(pressed(left_out_m=SOME, left_out_s=LeftOutTicks((40, 41))))
    forth, back = result.trace["seq_s"], result.trace["seq_m"]
    assert not np.isin(forth, SOME.ticks).any()
    assert not np.isin(back, (40, 41)).any()
    assert (forth[[40, 41]] == -1).all()
    assert forth[39] == 29
    assert forth[42] == 32  # 30 and 31 have come too, and the newest wins
    sent = result.packets["fwd"].sent
    assert sent == result.ticks - len(SOME.ticks)
    assert result.packets["fwd"].overtaken == 2
    assert result.packets["bwd"].sent == result.ticks - 2
    assert sent == result.packets["fwd"].received + result.packets["fwd"].in_flight
    scene = pressed(left_out_s=LeftOutTicks((40, 41)))
    result = run(replace(scene, playout=load_scene("canonical", playout="fixed:0.02").playout))
    assert result.packets["fwd"].late == 2
    assert not np.isin((20, 21), result.trace["seq_s"]).any()


def test_a_scene_without_ticks_left_out_has_the_bits_and_the_lines_of_before() -> None:
    scene = replace(pressed(), playout=Zero())  # with ticks left out another would be the default
    assert rendered(replace(scene, left_out_m=None)) == rendered(scene)
    none = run(replace(scene, left_out_m=LeftOutTicks(()), left_out_s=LeftOutTicks(()))).trace
    full = run(scene).trace
    assert all(np.array_equal(none[name], full[name]) for name in full)


def test_a_one_port_scene_leaves_out_ticks_too() -> None:
    scene = replace(load_scene("virtual_wall", left_out=0.2), duration=1.5)
    result = run(scene, seed=2)
    assert "seq_m" not in result.trace
    assert result.packets == {}
    pressing = np.flatnonzero(result.trace["f_m"] > 0.0)
    late = np.flatnonzero(scene.left_out_m.left_out(0, scene.ticks, 2))
    assert np.isin(late, pressing).mean() > 0.1
    assert np.isin(np.intersect1d(late, pressing), held(result.trace, "f_m")).all()


def test_passivity_says_that_ticks_are_left_out_and_not_that_it_is_passive_with_them() -> None:
    port = one_port(load_scene("virtual_wall", left_out=0.1))
    assert port.passive is None
    assert port.verdict.sentence.startswith("not known with its left-out ticks; without them passive")
    _, left = linear_parts(load_scene("soft_tissue", law="direct", left_out=0.1))
    assert left[-2:] == ["ticks that the master leaves out", "ticks that the slave leaves out"]


def test_ticks_of_ones_own_that_are_no_truths_are_refused() -> None:
    """A list ended in a TypeError of numpy's, and numbers in place of truths in a run without a single packet."""
    class Own:
        out: Any = None

        def left_out(self, end: int, count: int, seed: int) -> Any:
            return self.out

    for Own.out in ([True] * 300, np.zeros(299, dtype=bool), np.zeros(300, dtype=int), None):
        with pytest.raises(Refused, match=r"^Own.left_out gives .*, not a truth for each of 300 ticks; return an arr"):
            run(pressed(left_out_m=Own()))


def test_an_end_that_runs_no_tick_is_not_said_to_have_too_long_a_link() -> None:
    note = next(note for note in run(pressed(left_out_s=LeftOut(1.0))).notes if "played none" in note)
    assert "none came before the last tick that the slave ran; type a smaller --set left_out" in note


def test_what_needs_every_tick_says_what_to_type() -> None:
    scene = load_scene("soft_tissue", law="direct", left_out=0.1)
    with pytest.raises(Refused, match="leave it out with --set left_out=0"):
        linear_scene(scene)
    with pytest.raises(Refused, match="in virtual time alone"):
        both_ends(scene)
    with pytest.raises(Refused, match="left_out_s"):
        replace(load_scene("virtual_wall"), left_out_s=SOME)
    with pytest.raises(Refused, match=r"LeftOut\(0.1\)"):
        pressed(left_out_m=0.1)


# As it was read

FOLDER = Path(__file__).with_name("loops")
LOOPS = {
    "canonical.txt": lambda: rendered(load_scene("canonical")),
    "canonical_live_master.txt": lambda: rendered(load_scene("canonical"), "m"),
}


@pytest.mark.parametrize("name", LOOPS)
def test_a_scenes_loop_is_the_one_that_was_read(name: str) -> None:
    assert LOOPS[name]() == (FOLDER / name).read_text()


if __name__ == "__main__":
    for each, made in LOOPS.items():
        (FOLDER / each).write_text(made())
