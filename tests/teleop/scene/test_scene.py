"""A scene: what it refuses, how it counts time, and what both ends of a live run compare."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from slave.wall import Wall
from teleop import Direct, MassDamper, Refused, Scene, Wave, around, load_scene
from teleop.protocol.endpoint import Endpoint
from teleop.protocol.manifest import manifest_of
from teleop.protocol.session import Session
from teleop.scene.scene import MOST_TICKS

BODY = MassDamper(mass=1.0, damping=1.0)
WALL = Wall(k=1e3)


def scene(**parts: Any) -> Scene:
    return Scene(**{"law": Wave(), "master": BODY, "slave": BODY, **parts})


@given(st.sampled_from([1, 2, 5]), st.integers(-6, 0), st.integers(1, 10_000))
def test_time_is_counted_in_whole_ticks_of_whole_nanoseconds(digit: int, power: int, ticks: int) -> None:
    dt = Fraction(digit) * Fraction(10) ** power
    made = scene(dt=float(dt), duration=float(dt * ticks))
    assert made.dt_ns == dt * 10**9
    assert made.ticks == ticks
    assert scene(dt=1e-3, duration=0.0109).ticks == 10, "one that ends within a tick stops before it"


@given(st.floats(1e-6, 10.0), st.floats(1e-6, 1e4))
def test_time_has_at_least_one_tick_or_is_refused(dt: float, duration: float) -> None:
    assume(duration / dt < MOST_TICKS / 2)
    try:
        assert scene(dt=dt, duration=duration).ticks >= 1
    except Refused:
        assert duration < dt * (1.0 + 1e-9)


def test_a_number_means_along_the_first_axis_and_numbers_of_numpy_become_plain_ones() -> None:
    assert scene(axes=3, start_m=0.1).vector("start_m", 0.1) == (0.1, 0.0, 0.0)
    assert scene(axes=3).environments == (None, None, None)
    assert scene(axes=2, environment=WALL).environments == (WALL, None)
    made = scene(dt=np.float64(1e-3), duration=np.int64(2), axes=np.int8(1), packet_size=np.uint16(80))
    assert made == scene(dt=1e-3, duration=2.0, axes=1, packet_size=80)
    kinds = [type(value) for value in (made.dt, made.duration, made.axes, made.packet_size)]
    assert kinds == [float, float, int, int]
    assert scene(law=Wave()).has_waves
    assert not scene(law=Direct()).has_waves


def test_a_packet_is_as_large_as_usual_or_as_its_messages_need_or_refused_whatever_scene_was_made_before() -> None:
    canonical = load_scene("canonical")
    with pytest.raises(Refused, match="at least 81 bytes, which the message of law direct in 1 axis needs"):
        replace(canonical, law=Direct(), packet_size=80)
    assert replace(canonical, law=Direct(), packet_size=81).wire_size == 81
    assert replace(canonical, law=Direct(), packet_size=73, energy=False).wire_size == 73  # no energy behind it
    assert replace(canonical, law=Direct()).wire_size == 100
    assert load_scene("recorded_reach").wire_size == 200
    large = load_scene("canonical", law="guard | wave", playout="integral")  # three numbers, and T, U and E
    assert large.wire_size == large.least_packet == 109
    Endpoint(large, "s", Session(master=False, manifest=manifest_of(large), number=7))
    replace(canonical, law=Wave(), packet_size=91)
    with pytest.raises(Refused, match="at least 109 bytes"):
        replace(canonical, law=around("guard", Wave()), packet_size=91, playout=large.playout)


def test_a_manifest_differs_where_the_scenes_differ_and_nowhere_else() -> None:
    base = load_scene("canonical")
    mine = manifest_of(base)
    for scene, key in (
            (load_scene("canonical", delay=0.1), "delay"), (load_scene("canonical", law="pfra"), "law"),
            (load_scene("canonical", **{"law.b": 3.0}), "law"), (load_scene("canonical", dt=2e-3), "dt"),
            (load_scene("canonical", energy=False), "energy"), (replace(base, name="other"), "scene"),
            (load_scene("canonical", observer=None), "observer"), (replace(base, packet_size=99), "packet_size"),
            (replace(base, axes=2, packet_size=100), "axes"), (replace(base, start_m=0.1), "start_m")):
        theirs = manifest_of(scene)
        apart = {name for name in mine if mine[name] != theirs[name]}
        assert apart - {"link"} == {key}  # a knob of the link shows there too
        assert ("link" in apart) == (key == "delay")
    assert manifest_of(load_scene("canonical", delay="0.05")) == mine
    mine, theirs = (manifest_of(load_scene("canonical", link=f"delay({d})")) for d in (0.1, 0.2))
    assert {name for name in mine if mine[name] != theirs[name]} == {"link"}


UNDECLARED = """
from channel import Blackout
from master import Grip, Rest
from slave import Wall
from teleop import MassDamper, Scene, Wave


def scene(*, k_e=5.0, k_h=5.0, dark_for=1.0, duration=1.0):
    return Scene(
        law=Wave(), master=MassDamper(mass=0.1), slave=MassDamper(mass=0.5), duration=duration,
        hand=Grip(mass=0.4, k=k_h, d=5.0, reference=Rest()), link=Blackout(0.5, dark_for), environment=Wall(k=k_e),
    )
"""


def test_a_knob_that_declares_nothing_is_named_as_it_was_typed_or_all_are_shown_that_it_may_be(tmp_path: Path) -> None:
    """The part that it sets refuses its number, in its own words."""
    path = tmp_path / "undeclared.py"
    path.write_text(UNDECLARED)
    for knobs, sentence in (
            ({"k_e": "-5", "k_h": "5", "duration": "2"}, "^k_e must be at least 0, not -5; write for example k_e=0$"),
            ({"dark_for": -1, "duration": 2}, "^dark_for must be at least 0, not -1; write for example dark_for=0$"),
            ({"duration": -1, "dark_for": 2}, "^duration must be above 0, not -1"),
            ({"k_e": "-5", "k_h": "-5"}, r"^k must be at least 0, .* \(scene .* with k_e=-5\.0, k_h=-5\.0\)$")):
        with pytest.raises(Refused, match=sentence):
            load_scene(str(path), **knobs)


def test_a_scene_that_is_like_one_which_passed_is_still_checked_where_it_differs() -> None:
    """Also in a part whose class does not tell."""
    class Body:
        def __init__(self, **own: float) -> None:
            vars(self).update(own)

    passed = {"law": Wave(), "master": MassDamper(mass=0.1), "slave": MassDamper(mass=0.5), "dt": 1e-3}
    Scene(**passed)
    assert type(Scene(**{**passed, "axes": 1.0}).axes) is int
    Scene(**{**passed, "slave": Body(mass=0.5, damping=1.0, friction=0.0)})
    for name, value in {"dt": -1e-3, "observer": -1.0, "axes": True, "start_m": float("nan"), "duration": []}.items():
        with pytest.raises(Refused, match=name):
            Scene(**{**passed, name: value})
    with pytest.raises(Refused, match="damping"):
        Scene(**{**passed, "slave": Body(mass=0.5)})
