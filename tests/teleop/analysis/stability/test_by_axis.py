"""Stability of several axes, and the numbers behind its plots against the loop's own equations."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

import teleop.analysis.stability.command
from teleop import Refused, Scene, load_scene
from teleop.analysis.models.linear import linear_scene
from teleop.analysis.models.loop import sampled_loop
from teleop.analysis.models.margins import critical_round_trip, integrators
from teleop.analysis.stability import report
from teleop.analysis.stability.assess import KICK, Staying, is_stable, kicked_axes, stability
from teleop.analysis.stability.command import Picture, picture, sweep
from teleop.analysis.stability.report import ask, summary, table

LINEAR = {"friction_m": 0.0, "friction_s": 0.0, "f_max": None}


def joints(**knobs: Any) -> Scene:
    return load_scene("leader_follower", **LINEAR, **knobs)


@pytest.mark.parametrize(("law", "delay"), [("pp", 0.05), pytest.param("pp", 0.01, marks=pytest.mark.full),
                                            pytest.param("wave", 0.01, marks=pytest.mark.full)])
def test_what_each_axis_has_is_together_what_the_loop_of_all_has(law: str, delay: float) -> None:
    """Three joints in one pair of matrices, their roots counted at once, beside one joint after the other."""
    scene = joints(law=law, delay=delay)
    parts = {name: scene.per_axis(name)[1:4] for name in ("law", "master", "slave", "hand", "environment")}
    hands = parts.pop("hand")
    three = replace(scene, axes=3, names=scene.names[1:4], units=scene.units[1:4], **parts,
                    hand=tuple(replace(hand, reference=replace(hand.reference, to=(0.1, 0.2, 0.3))) for hand in hands))
    found, whole = stability(three), linear_scene(three)
    assert found.unstable == sampled_loop(whole).outside(whole.round_trip)
    assert found.integrators == integrators(whole)
    assert found.critical_round_trip == critical_round_trip(whole)
    assert is_stable(three) == (found.verdict == "stable")
    assert (found.verdict == "unstable") == (delay == 0.05)
    assert [names for names, _ in found.axes] == [("shoulder",), ("elbow",), ("forearm",)]


def test_axes_that_are_alike_are_judged_once() -> None:
    one = load_scene("free_motion", law="pp")
    found, alone = stability(replace(one, axes=6)), stability(one)
    assert [names for names, _ in found.axes] == [("axis1", "axis2", "axis3", "axis4", "axis5", "axis6")]
    assert found.integrators == 6 * alone.integrators
    assert (found.mode, found.gain_margin, found.critical_round_trip) == (
        alone.mode, alone.gain_margin, alone.critical_round_trip)


def test_axes_that_a_law_couples_are_judged_together() -> None:
    knobs = {"law": "pfra", "law.alpha": "1"}  # which is linear
    assert stability(replace(load_scene("soft_tissue", **knobs), axes=2)).axes == ()


@pytest.mark.full
def test_all_that_stands_in_the_way_is_named_at_once_and_what_is_told_to_type_takes_it_away() -> None:
    for scene, law, words in (
        ("leader_follower", "pp", "a force cap and Coulomb friction are not linear"),
        ("pose", "pfra", "a force cap, Wall and law pfra over an orientation are not linear"),
        ("encoder_wall", "", "a force cap and an encoder are not linear"),
    ):
        knobs: dict[str, object] = {"law": law} if law else {}
        with pytest.raises(Refused, match=words) as caught:
            ask(scene, knobs)
        typed = dict(re.findall(r"--set ([\w.]+)=(\w+)", str(caught.value)))
        assert ask(scene, {**knobs, **typed}).sentence == "stable: no root outside the unit circle"


@pytest.mark.full
def test_the_answer_names_the_axes() -> None:
    weak = (300.0, 375.0, 150.0, 300.0, 25.0, 10.0)  # ten times the forearm's
    answer = ask("leader_follower", {**LINEAR, "law.K": ",".join(map(str, weak))})
    assert "outside the unit circle (forearm)" in answer.sentence
    told = table(answer)
    assert [line.split()[:2] for line in told.splitlines()[-6:]] == [
        ["base", "stable"], ["shoulder", "stable"], ["elbow", "stable"], ["forearm", "unstable"], ["wrist", "stable"],
        ["flange", "stable"]]
    document = summary(answer)
    assert [axis["verdict"] for axis in document["axes"]] == ["stable"] * 3 + ["unstable"] + ["stable"] * 2
    assert document["dominant"] == document["axes"][3]["dominant"]


def test_in_virtual_time_each_joint_is_kicked() -> None:
    scene = load_scene("leader_follower")
    assert scene.reference is not None
    assert kicked_axes(scene) == (0, 1, 2, 3, 4, 5)
    assert kicked_axes(load_scene("recorded_reach")) == (0,)
    path = Staying(path=scene.reference, until=10, kicked=(0, 5)).samples(6, 60, scene.dt_ns)
    moved = [max(axis) - axis[-1] for axis in path]
    assert moved == pytest.approx([KICK, 0.0, 0.0, 0.0, 0.0, KICK], abs=1e-5)


Typed = Callable[..., Any]


def drawn(scene: Scene) -> Picture:
    found = stability(scene)
    return picture(scene, unstable=found.unstable > 0, gain_margin=found.gain_margin)


def open_loop_at(scene: Scene, f: float) -> complex:
    """-z^-d P_m P_s of a scene that sends one field back, straight from its matrices."""
    linear = linear_scene(scene)
    z = np.exp(2j * np.pi * f * linear.dt)
    both = [C @ np.linalg.inv(z * np.eye(len(A)) - A) @ B + D for A, B, C, D in (linear.master, linear.slave)]
    return complex(-np.trace(both[0] @ both[1]) * z**-linear.round_trip)


class TestTheOpenLoop:
    def test_has_its_margins_where_it_passes_1_and_minus_1(self) -> None:
        scene = load_scene("soft_tissue", law="direct", delay=0.005)
        loop, gain = drawn(scene).loop, stability(scene).gain_margin
        at = brentq(lambda f: abs(open_loop_at(scene, f)) - 1.0, 3.5, 5.0, xtol=1e-12)
        slow = brentq(lambda f: abs(open_loop_at(scene, f)) - 1.0, 0.5, 2.5, xtol=1e-12)
        least = min(abs(np.angle(-open_loop_at(scene, f))) for f in (at, slow))
        assert loop.phase_margin == pytest.approx(least, abs=1e-6)
        assert loop.gain_crossover == pytest.approx(at, rel=1e-6)
        crossing = brentq(lambda f: open_loop_at(scene, f).imag, 4.5, 6.0, xtol=1e-12)
        assert open_loop_at(scene, crossing).real == pytest.approx(-1.0 / gain, rel=1e-6)
        assert loop.phase_crossover == pytest.approx(crossing, rel=0.02)

    def test_is_the_same_by_every_branch_of_three_equal_axes(self) -> None:
        tissue = load_scene("soft_tissue", law="direct", delay=0.005)
        three = Scene(law=tissue.law, master=tissue.master, slave=tissue.slave, hand=tissue.hand, link=tissue.link,
                      environment=tissue.environments * 3, axes=3, duration=1.0)
        one, all_three = drawn(tissue).loop, drawn(three).loop
        assert all_three.L.shape[1] == 3
        assert np.sort(np.abs(all_three.L), axis=1)[:, 0] == pytest.approx(np.abs(one.L[:, 0]), rel=1e-6, abs=1e-9)
        assert all_three.phase_margin == pytest.approx(one.phase_margin, abs=1e-6)

    def test_of_an_unstable_loop_has_no_phase_margin_and_of_a_force_that_is_renewed_slowly_there_is_none(self) -> None:
        loop = drawn(load_scene("soft_tissue", law="direct", delay=0.05)).loop
        assert loop.phase_margin is None
        assert loop.gain_crossover is not None
        found = drawn(load_scene("virtual_wall", every=3))
        assert found.loop is None
        assert found.period == pytest.approx(3e-3)
        assert len(found.roots.z) == found.roots.total


@pytest.mark.full
def test_the_roots_have_the_dominant_mode_and_all_that_grow() -> None:
    for delay in (0.005, 0.5):
        scene = load_scene("soft_tissue", law="direct", delay=delay)
        found, roots = stability(scene), drawn(scene).roots
        assert roots.complete
        assert np.abs(roots.z - found.mode.z).min() < 1e-9
        assert np.count_nonzero(np.abs(roots.z) > 1.0) == found.unstable
        assert len(roots.z) == min(200, roots.total)


def test_a_knob_has_margins_that_end_where_the_growth_begins() -> None:
    swept = sweep(lambda K: load_scene("virtual_wall", **{"law.K": K}), [100.0, 1000.0, 3000.0, 6000.0])
    stable = swept.growth < 0.0
    assert list(stable) == [True, True, True, False]
    assert ((swept.gain_margin > 1.0) == stable).all()
    assert (np.isfinite(swept.phase_margin) <= stable).all()


class TestTheCommand:
    def test_draws_roots_loop_and_the_knob(self, typed: Typed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(report, "PLACES", 4)
        answer = typed("stability", "virtual_wall", "--critical", "law.K", "--range", "3000:5000", "--tol", "1",
                       "--plot", "--out", "here")
        assert answer.code == 0
        assert {path.name for path in (tmp_path / "here").iterdir()} == {
            "summary.json", "curves.npz", "stability.png", "critical.png"}
        told = json.loads((tmp_path / "here" / "summary.json").read_text())
        assert told["open_loop"]["phase_margin"] > 0.0
        assert told["roots"] == {"drawn": 4, "total": 4, "complete": True}
        with np.load(tmp_path / "here" / "curves.npz") as arrays:
            assert (np.diff(arrays["swept_values"]) > 0.0).all()
            assert told["critical"]["value"] in arrays["swept_values"]
            assert arrays["L"].shape == (len(arrays["frequency"]), 1)

    @pytest.mark.full
    def test_draws_what_nothing_closes_and_what_has_no_open_loop(self, typed: Typed, tmp_path: Path) -> None:
        for folder, *arguments in (("open", "free_motion", "--set", "law=direct"),
                                   ("slow", "virtual_wall", "--set", "every=3")):
            assert typed("stability", *arguments, "--plot", "--out", folder).code == 0
            assert (tmp_path / folder / "stability.png").read_bytes().startswith(b"\x89PNG")

    @pytest.mark.full
    def test_keeps_the_critical_value_when_the_margins_over_the_knob_are_interrupted(
        self, typed: Typed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def interrupted(*_: Any, **__: Any) -> None:
            raise KeyboardInterrupt

        monkeypatch.setattr(report, "PLACES", 4)
        monkeypatch.setattr(teleop.analysis.stability.command, "sweep", interrupted)
        answer = typed("stability", "virtual_wall", "--critical", "law.K", "--range", "3000:5000", "--tol", "100",
                       "--plot", "--out", "here")
        assert answer.code == 130
        assert "the margins over the knob are missing" in answer.out
        assert {path.name for path in (tmp_path / "here").iterdir()} == {"summary.json", "curves.npz", "stability.png"}
        told = json.loads((tmp_path / "here" / "summary.json").read_text())
        assert (told["status"], told["critical"]["stable"]) == ("interrupted", "below")
