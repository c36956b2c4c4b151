"""Stability of scenes with several axes: each by itself where nothing couples them, else all together."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import pytest

from teleop import Refused, Scene, load_scene
from teleop.analysis.models.linear import linear_scene
from teleop.analysis.models.loop import sampled_loop
from teleop.analysis.models.margins import critical_round_trip, integrators
from teleop.analysis.stability.assess import KICK, Staying, is_stable, kicked_axes, stability
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
