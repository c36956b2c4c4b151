"""Orientation: ends meet where they stand and not where they count, nothing unwinds, and no coupling makes energy."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from channel.link import parse_link
from master.hand import Grip, Reach
from slave.tissue import Tissue
from teleop import PSPM, TDPA, FourChannel, PDamped, Scene, TwoLayer, Wave, WavePosition, find_law, fitted, run
from teleop.kind import positions
from teleop.law import known_laws, law_name, start_at
from teleop.laws.pp import PositionPosition
from tests.teleop.stages.tumbling import apart, counted, orientations, tumbling

ROUGH = parse_link("delay(0.01) | uniform(0.02) | bernoulli(0.1)")
POSITIONS: dict[str, Any] = {
    "pp": PositionPosition(K=1.0, B=0.01), "p_d": PDamped(K=0.5, B=0.02), "four_channel": FourChannel(K=0.5, B=0.01),
    "pspm": PSPM(K=1.0, B_m=0.01, B_s=0.02, E_0=0.01, E_max=0.05), "tdpa": TDPA(K=1.0, B=0.02, alpha_max=0.5),
    "two_layer": TwoLayer(K=1.0, B=0.02, alpha=5.0, d_max=0.5, k=5.0),
}
WAVES: dict[str, Any] = {"wave": Wave(b=0.02, K=1.0, B=0.02),
                         "wave_position": WavePosition(b=0.02, K=1.0, B=0.02, K_p=0.2, B_p=0.005)}


@pytest.mark.parametrize("name", ["pp", *[pytest.param(name, marks=pytest.mark.full) for name in (
    "four_channel", "pspm", "tdpa")]])
def test_after_a_tumble_the_ends_stand_alike_and_not_only_their_angles(name: str) -> None:
    """The hand stops, nothing is touched: the orientations meet. Axis by axis the angles do, and the tools do not."""
    scene = tumbling(law=POSITIONS[name], duration=8.0)
    result = run(scene)
    m, s = [orientations(result.trace, e) for e in "ms"]
    for e, q in (("m", m), ("s", s)):
        assert np.abs(apart(q, counted(result.trace[f"x_{e}"]))).max() < 1e-12
    assert apart(m, s)[-1] < 1e-4
    assert apart(m, s).max() > 1e-2
    flat = run(replace(scene, rotations=(), units=("rad",) * 3)).trace
    assert apart(counted(flat["x_m"]), counted(flat["x_s"]))[-1] > 0.03


@pytest.mark.full
def test_waves_keep_an_offset_of_orientations_which_ties_between_these_draw_back_in_part() -> None:
    """Of the offset o that reflections leave, o/(1 + K_p (1/K + (T1 + T2)/(2 b))) at the most: see `wave_position`."""
    left = {name: apart(*[orientations(run(tumbling(law=law, duration=9.0)).trace, e) for e in "ms"])[-1]
            for name, law in WAVES.items()}
    assert 0.02 < left["wave_position"] < 0.6 * left["wave"] < 0.1


def turning(angle: float, **parts: Any) -> Scene:
    axis = np.array((0.6, 0.0, 0.8)) * angle
    hand = Grip(mass=0.001, k=2.0, d=0.05, reference=Reach(to=tuple(axis.tolist()), start=0.2, duration=3.0))
    return tumbling(**{"hand": hand, **parts})


def test_of_every_listed_law_the_places_in_messages_and_states_are_positions() -> None:
    """Any other kind of field is a plain number, whose difference goes the long way round."""
    places = set()
    for law in [law for name in known_laws() if hasattr(law := find_law(name)(), "master_start")]:
        for start in (law.master_start, law.slave_start):
            for record in [type(each) for each in start(start_at(0.0, 0.0, 0.0, 1e-3)) if each != ()]:
                names = ("x", "y") if type(law) is PSPM else ("x", "x_d")
                named = {field for field in record._fields if field in names}
                assert named == set(positions(record)), record
                places |= {(law_name(law), field) for field in named}
    assert {law for law, _ in places} == {name for name in known_laws() if not name.startswith("virtual")}


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.full] * (name not in ("tdpa", "wave_position")))
                                  for name in (*POSITIONS, *WAVES)])
def test_about_an_axis_that_stays_a_rotation_is_as_a_translation(name: str) -> None:
    """One and a half turns, which do not unwind: the same motions and forces as of three translations, to rounding."""
    law = {**POSITIONS, **WAVES}[name]
    turned, moved = run(turning(3.0 * np.pi, law=law)).trace, run(
        turning(3.0 * np.pi, law=law, rotations=(), units=("rad",) * 3)).trace
    assert np.abs(turned["x_s"] - moved["x_s"]).max() < 1e-10
    assert np.abs(turned["f_m"] - moved["f_m"]).max() < 1e-10
    assert turned["x_s"][-1] == pytest.approx((1.8 * np.pi, 0.0, 2.4 * np.pi), abs=0.01)


def test_a_tool_that_turned_by_two_thirds_of_a_turn_in_a_blackout_is_followed_all_the_way() -> None:
    """The relative rotation passes pi while messages still come late: the slave goes on, and not back the short way."""
    scene = turning(1.5 * np.pi, law=PDamped(K=0.05, B=0.05), duration=12.0,
                    hand=Grip(mass=0.001, k=5.0, d=0.1, reference=Reach(
                        to=(0.9 * np.pi, 0.0, 1.2 * np.pi), start=0.2, duration=0.3)))
    trace = run(scene).trace
    q_m, q_s = [orientations(trace, e) for e in "ms"]
    assert np.linalg.norm(trace["x_m"] - trace["x_s"], axis=1).max() > 1.2 * np.pi
    assert np.diff(trace["x_s"][:, 2]).min() > -1e-3
    assert apart(q_m, q_s)[-1] < 0.05
    assert np.linalg.norm(trace["x_m"] - trace["x_s"], axis=1)[-1] < 0.05


def test_ends_that_begin_a_whole_turn_apart_stand_alike_and_draw_at_nothing() -> None:
    trace = run(turning(0.0, start_m=(0.0, 0.0, 2.0 * np.pi), hand=None, duration=0.1)).trace
    assert np.abs(trace["f_m"]).max() + np.abs(trace["f_s"]).max() < 1e-14


@pytest.mark.parametrize(("turns", "link"), [
    (0.8, "delay(0.01) | blackout(0.2, 0.5)"), (1.3, "delay(0.01) | blackout(0, 0.7) ; delay(0.01)")])
def test_ends_that_turned_apart_by_more_than_half_a_turn_in_a_silence_do_not_spin_each_other_for_ever(
        turns: float, link: str) -> None:
    """Both reckon the same way back, so their torques are opposite and they come to rest."""
    drag = Grip(mass=5e-4, k=0.0, d=0.5, reference=Reach(to=(0.0, 0.0, 2.0 * np.pi * turns), start=0.3, duration=0.4))
    trace = run(turning(0.0, law=PDamped(K=0.2, B=0.02), hand=drag, duration=5.0, link=parse_link(link))).trace
    apart_by = trace["x_m"][700, 2] - trace["x_s"][700, 2]
    assert np.pi < apart_by < 4.0 * np.pi
    assert not np.any(trace["x_s"][700])
    assert np.abs(trace["v_m"][-1]).max() + np.abs(trace["v_s"][-1]).max() < 0.01
    assert np.abs(trace["f_m"][-1]).max() + np.abs(trace["f_s"][-1]).max() < 0.002
    assert apart(*[orientations(trace, e) for e in "ms"])[-1] < 0.01
    assert trace["E_port"][-1] > trace["E_port"][700] - 0.1 * apart_by ** 2, "no more than the spring held"


@pytest.mark.parametrize("name", ["wave", "pspm", *[pytest.param(name, marks=pytest.mark.full) for name in (
    "tdpa", "two_layer", "wave_position", "p_d")]])
def test_over_a_rough_link_a_law_keeps_its_ledger_on_rotations_as_on_translations(name: str) -> None:
    """A tumble against springs and dampers, 10 % lost and 20 ms of jitter."""
    law = {**POSITIONS, **WAVES}[name]
    scene = tumbling(law=law, link=ROUGH, environment=(Tissue(k=0.1, d=0.005),) * 3)
    if name in ("p_d", "wave_position"):
        scene = fitted(scene)
    turned, moved = run(scene, seed=4), run(replace(scene, rotations=(), units=("rad",) * 3), seed=4)
    assert turned.status == moved.status == "ok"
    ledger = {"wave": "E_link_min", "wave_position": "E_port_min", "p_d": "E_port_min"}.get(name, "E_law_min")
    assert turned.metrics[ledger] > -1e-6 if ledger != "E_law_min" else turned.metrics[ledger] > -1e-3
    if ledger == "E_law_min":
        book = turned.trace["E_port"] + turned.trace["E_law"][0] - turned.trace["E_law"]
        assert book.min() > -1e-4


class Columns:
    """Columns of the tumble, each so many times as large, as the way of a hand."""

    def __init__(self, *columns: tuple[int, float]) -> None:
        self.columns = columns

    def samples(self, axes: int, count: int, dt_ns: int, first: int = 0) -> Any:
        once = tumbling().hand.reference.samples(3, count, dt_ns, first)
        return tuple([[size * each for each in once[i]] for i, size in self.columns])


def test_two_rotations_are_counted_each_by_itself_and_leave_the_translations_beside_them_as_they_are() -> None:
    """To the bit: the same tumble twice, and x beside one."""
    def of(*columns: tuple[int, float], rotations: tuple[int, ...]) -> Any:
        return run(tumbling(axes=len(columns), rotations=rotations, duration=1.0, hand=Grip(
            mass=0.001, k=2.0, d=0.05, reference=Columns(*columns)))).trace

    turns = ((0, 1.0), (1, 1.0), (2, 1.0))
    one, two = of(*turns, rotations=(0,)), of(*turns, *turns, rotations=(0, 3))
    assert np.array_equal(two["x_s"], np.hstack([one["x_s"]] * 2))
    assert all(np.array_equal(two[f"q{part}2_s"], one[f"q{part}_s"]) for part in "wxyz")
    beside, alone = of((0, 0.1), *turns, rotations=(1,)), of((0, 0.1), rotations=())
    assert np.array_equal(beside["x_s"][:, 0], alone["x_s"])
