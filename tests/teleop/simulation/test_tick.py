"""The tick: a scene's loop holds what the scene names and no more."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pytest

from channel import Bernoulli, Delay, UniformJitter
from master.hand import Grip, Sine
from slave import Tissue, Wall
from teleop import PFRA, At, Cap, Direct, Hold, MassDamper, Scene, Watchdog, Wave, load_scene, run
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


def test_an_energy_scene_without_waves_has_no_ledger_of_the_link() -> None:
    assert not {name for name in words(make(Direct(), energy=True)) if name.startswith(("E_in", "E_out"))}


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


def test_a_law_that_reads_no_force_needs_neither_sensor_nor_observer() -> None:
    wave, direct = structure_of(make(Wave())), structure_of(make(Direct()))
    assert [end.has.sensed or end.has_stage("observer") for end in (wave.m, wave.s)] == [False, False]
    assert [end.has.sensed or end.has_stage("observer") for end in (direct.m, direct.s)] == [False, True]


# Axes


def test_three_axes_are_three_runs_of_one_axis_for_a_law_that_does_not_couple_them() -> None:
    whole = make(Direct(K=300.0, B=6.0, kf=0.3), axes=3, link=JITTERY, watchdog=Watchdog(timeout=0.01, ramp=0.01),
                 cap=Cap(f_max=2.0, slew=300.0))
    together = run(whole, seed=5).trace
    for axis in range(3):
        alone = run(replace(
            whole, axes=1, environment=whole.environments[axis], start_m=PLACES[axis], start_s=PLACES[axis],
            hand=Grip(mass=0.2, k=100.0, d=3.0, reference=Sine(amplitude=AMPLITUDE[axis], frequency=2.0)),
        ), seed=5).trace
        assert set(alone) == set(together)
        for name, column in alone.items():
            whole_column = together[name]
            assert np.array_equal(column, whole_column[:, axis] if whole_column.ndim == 2 else whole_column), name


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


def test_no_link_is_a_delay_of_nothing_for_a_law_that_reads_all_there_is() -> None:
    none, zero = run(make(Curious(), energy=True)).trace, run(make(Curious(), energy=True, link=Delay(0.0))).trace
    assert all(np.array_equal(none[name], zero[name]) for name in none)


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
