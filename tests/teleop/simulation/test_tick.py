"""The tick: a scene's loop holds what the scene names and no more, and live and virtual runs are made of it alike."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from math import inf
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pytest

from channel.bernoulli import Bernoulli
from channel.delay import Delay
from channel.uniform import UniformJitter
from master.hand import Grip, Sine
from slave.tissue import Tissue
from slave.wall import Wall
from teleop.law import At
from teleop.laws.direct import Direct
from teleop.laws.pfra import PFRA
from teleop.laws.wave import Wave
from teleop.physics.plant import MassDamper, grip_force, move_free, move_gripped
from teleop.scene.playout import Fixed, Hold
from teleop.scene.scene import Scene
from teleop.simulation.bodies import master_coefficients, reference_samples, slave_plants
from teleop.simulation.plan import link_plans
from teleop.simulation.prepared import prepare
from teleop.simulation.source import live_of, rendered
from teleop.simulation.structure import columns, numbers_of, structure_of
from teleop.simulation.trace import EndRecord, assemble
from teleop.simulation.virtual import run
from teleop.stages.device import Device
from teleop.stages.encoder import Encoder
from teleop.stages.force_cap import Cap
from teleop.stages.velocity.low_pass import LowPass
from teleop.stages.watchdog import Watchdog, watchdog_step


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


@pytest.mark.parametrize("law", [Wave(), Direct(K=300.0, B=6.0, kf=0.3)])
def test_three_axes_are_three_runs_of_one_axis_for_a_law_that_does_not_couple_them(law: Any) -> None:
    whole = make(law, axes=3, link=JITTERY, watchdog=Watchdog(timeout=0.01, ramp=0.01), cap=Cap(f_max=2.0, slew=300.0))
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


# Live and virtual


def by_hand(scene: Scene, seed: int) -> dict[str, Any]:
    """The trace of two live ends, fed tick by tick with what plants and link make of their answers."""
    dt, axes = scene.dt_ns / 1e9, range(scene.axes)
    structure, plants = structure_of(scene), slave_plants(scene)
    grip, ref = master_coefficients(scene)[0], reference_samples(scene)
    forth, back = link_plans(scene, seed)
    place = {"m": list(scene.vector("", scene.start_m)), "s": list(scene.vector("", scene.start_s))}
    speed = {e: [0.0] * scene.axes for e in "ms"}
    held = dict.fromkeys("ms", (0.0,) * scene.axes)
    sent: dict[str, list[Any]] = {"m": [], "s": []}
    rows: dict[str, list[float]] = {"m": [], "s": []}
    gain, calm, last = dict.fromkeys("ms", 1.0), dict.fromkeys("ms", inf), dict.fromkeys("ms", -1)

    def touch(e: str, k: int) -> tuple[float, ...] | None:
        if not getattr(structure, e).has.sensed:
            return None
        if e == "s":
            return tuple(plants[i].force(plants[i].c, place[e][i], speed[e][i]) for i in axes)
        if ref is None:
            return (0.0,) * scene.axes
        slope = [(ref[i][k] - ref[i][k - 1]) / dt if k else 0.0 for i in axes]
        return tuple(grip_force(grip, place[e][i], speed[e][i], held[e][i], ref[i][k], slope[i]) for i in axes)

    ends = {}
    for e in "ms":
        end = live_of(scene, e)
        begins = numbers_of(scene, {e: place[e]})
        ends[e] = end(begins, scene.law, dt, tuple(place[e]), tuple(speed[e]), touch(e, 0))
        next(ends[e])
    for k in range(scene.ticks):
        read = {e: (tuple(place[e]), tuple(speed[e]), touch(e, k)) for e in "ms"}
        said = {}
        for e, other, plan in (("m", "s", back), ("s", "m", forth)):
            seq = k - 1 if plan is None else plan.play[k]
            heard = (True, seq, *sent[other][seq]) if seq >= 0 else (False, -1, None, None)
            if scene.watchdog is not None:
                last[e] = k if heard[0] else last[e]
                gain[e], calm[e] = watchdog_step(scene.watchdog.limits(dt), gain[e], calm[e], k - last[e])
            held[e], *said[e], row = ends[e].send((k, *read[e], *heard, gain[e], held[e], 1, 0.0, 1.0))
            rows[e].extend(row)
        for e in "ms":
            sent[e].append(said[e])
        for i in axes:
            x, v, f = place["m"][i], speed["m"][i], held["m"][i]
            if ref is None:
                place["m"][i], speed["m"][i], _ = move_free(grip, x, v, -f)
            else:
                place["m"][i], speed["m"][i] = move_gripped(grip, x, v, f, ref[i][k], ref[i][k + 1])
            move, _, c, *_ = plants[i]
            place["s"][i], speed["s"][i], _ = move(c, place["s"][i], speed["s"][i], held["s"][i])
    return assemble(prepare(scene), {
        e: EndRecord(range(scene.ticks), rows[e], None if plan is None else plan.play)
        for e, plan in (("m", back), ("s", forth))
    })


LIVE = [
    make(Wave(), link=Delay(0.05), energy=True),
    make(Wave(), link=JITTERY, energy=True, playout=Hold()),
    make(Wave(), axes=3, link=JITTERY, energy=True, playout=Fixed(0.015, Hold())),
    make(PFRA(alpha=0.2), link=Delay(0.02), cap=Cap(f_max=2.0, slew=300.0)),
    make(PFRA(alpha=0.2), axes=3, link=JITTERY, observer=None, watchdog=Watchdog(timeout=0.003, ramp=0.002)),
    make(Direct(K=300.0, B=6.0, kf=0.3), hand=False, energy=True),
    make(Curious(), axes=3, link=JITTERY, energy=True, watchdog=Watchdog(timeout=0.003, ramp=0.002)),
    make(Curious(), observer=None, hand=False),
    make(Direct(K=300.0, B=6.0, kf=1.0), axes=3, link=Delay(0.02), watchdog=Watchdog(timeout=0.01, settle=0.02),
         cap=Cap(f_max=8.0, slew=2000.0, v_max=0.3, power=0.02),
         device_m=Device(encoder=Encoder(step=1e-5), velocity=LowPass(cutoff=50.0))),
]


@pytest.mark.parametrize("scene", LIVE)
def test_two_live_ends_fed_with_the_same_messages_make_the_same_run_bit_for_bit(scene: Scene) -> None:
    virtual, live = run(scene, seed=7).trace, by_hand(scene, seed=7)
    assert list(live) == list(virtual)
    assert np.abs(virtual["x_s"]).max() > 0.0
    for name in virtual:
        assert np.array_equal(live[name], virtual[name]), name
