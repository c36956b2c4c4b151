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

from channel.delay import Delay
from slave.wall import Wall
from teleop import Refused, Scene, load_scene
from teleop.laws.direct import Direct
from teleop.laws.wave import Wave
from teleop.physics.plant import MassDamper
from teleop.protocol.manifest import fingerprint, manifest_of
from teleop.scene.scene import MOST_TICKS

BODY = MassDamper(mass=1.0, damping=1.0)
WALL = Wall(k=1e3)


def scene(**parts: Any) -> Scene:
    return Scene(**{"law": Wave(), "master": BODY, "slave": BODY, **parts})


class TestTime:
    @given(st.sampled_from([1, 2, 5]), st.integers(-6, 0), st.integers(1, 10_000))
    def test_is_counted_in_whole_ticks_of_whole_nanoseconds(self, digit: int, power: int, ticks: int) -> None:
        dt = Fraction(digit) * Fraction(10) ** power
        made = scene(dt=float(dt), duration=float(dt * ticks))
        assert made.dt_ns == dt * 10**9
        assert made.ticks == ticks

    def test_that_ends_within_a_tick_stops_before_it(self) -> None:
        assert scene(dt=1e-3, duration=0.0109).ticks == 10

    @given(st.floats(1e-6, 10.0), st.floats(1e-6, 1e4))
    def test_has_at_least_one_tick_or_is_refused(self, dt: float, duration: float) -> None:
        assume(duration / dt < MOST_TICKS / 2)
        try:
            assert scene(dt=dt, duration=duration).ticks >= 1
        except Refused:
            assert duration < dt * (1.0 + 1e-9)

    @pytest.mark.parametrize("parts", [
        {"dt": 0.0}, {"dt": -1e-3}, {"dt": float("nan")}, {"dt": 1e-9}, {"dt": 11.0}, {"dt": "1"}, {"dt": True},
        {"duration": 0.0}, {"duration": float("inf")}, {"duration": 1e-4}, {"duration": 1e9}, {"duration": 1e300},
    ])
    def test_that_cannot_be_is_refused(self, parts: dict[str, Any]) -> None:
        with pytest.raises(Refused, match=r"dt|duration"):
            scene(**parts)


class TestAxes:
    def test_a_number_means_along_the_first(self) -> None:
        assert scene(axes=3, start_m=0.1).vector("start_m", 0.1) == (0.1, 0.0, 0.0)
        assert scene(axes=3).environments == (None, None, None)
        assert scene(axes=2, environment=WALL).environments == (WALL, None)

    @pytest.mark.parametrize("parts", [
        {"axes": 0}, {"axes": 17}, {"axes": 2, "start_m": (0.0,)}, {"start_s": (0.0, 0.0)},
        {"axes": 2, "environment": ()}, {"start_m": float("nan")}, {"start_s": float("inf")},
    ])
    def test_that_do_not_fit_are_refused(self, parts: dict[str, Any]) -> None:
        with pytest.raises(Refused):
            scene(**parts)


class TestParts:
    @pytest.mark.parametrize("parts", [{"x_limit": 0.0}, {"observer": 0.0}, {"observer": float("nan")}])
    def test_that_are_out_of_range_are_refused(self, parts: dict[str, Any]) -> None:
        with pytest.raises(Refused):
            scene(**parts)

    @pytest.mark.parametrize(("parts", "words"), [
        ({"playout": 0.1}, r"playout.*not 0\.1; write for example playout=Fixed\(0\.1\)"),
        ({"law": None}, r"law must be something with master_start.*not None; write for example law=Wave\(\)"),
        ({"law": Wave}, "law.*not the class Wave"), ({"law": "wave"}, "law.*not 'wave'"),
        ({"master": 0.1}, r"master.*master=MassDamper\("), ({"slave": None}, r"slave.*slave=MassDamper\("),
        ({"hand": 3}, r"hand.*hand=Grip\("), ({"link": 3}, r"link.*link=Delay\(0\.05\)"),
        ({"link": Delay}, "link.*not the class Delay"), ({"environment": 3}, r"environment.*environment=Wall\("),
        ({"axes": 2, "environment": (WALL, 3)}, "environment.*not 3"), ({"cap": 5.0}, r"cap.*cap=Cap\(f_max=20"),
        ({"watchdog": 0.1}, r"watchdog.*watchdog=Watchdog\(timeout=0\.1"), ({"energy": "no"}, "energy=True"),
        ({"packet_size": 0}, "packet_size must be at least 64, not 0; write for example packet_size=64"),
        ({"packet_size": -5}, "at least 64"), ({"packet_size": 1201}, "at most 1200"),
        ({"packet_size": 99.5}, "packet_size must be a whole number"), ({"packet_size": True}, "must be a number"),
        ({"axes": 17}, "axes must be at most 16, not 17; write for example axes=16"),
    ])
    def test_of_another_shape_are_refused_with_what_to_write(self, parts: dict[str, Any], words: str) -> None:
        with pytest.raises(Refused, match=words):
            scene(**parts)

    def test_of_numpy_become_plain_numbers(self) -> None:
        made = scene(dt=np.float64(1e-3), duration=np.int64(2), axes=np.int8(1), packet_size=np.uint16(80))
        assert made == scene(dt=1e-3, duration=2.0, axes=1, packet_size=80)
        kinds = [type(value) for value in (made.dt, made.duration, made.axes, made.packet_size)]
        assert kinds == [float, float, int, int]

    @pytest.mark.parametrize("mass", [0.0, -1.0, float("nan"), float("inf"), None, "1"])
    def test_a_body_without_a_mass_is_refused(self, mass: Any) -> None:
        with pytest.raises(Refused, match="mass"):
            MassDamper(mass=mass, damping=1.0)

    def test_waves_are_a_matter_of_the_law(self) -> None:
        assert scene(law=Wave()).has_waves
        assert not scene(law=Direct()).has_waves


class TestManifest:
    BASE = load_scene("canonical")

    @pytest.mark.parametrize(("other", "key"), [
        (load_scene("canonical", delay=0.1), "delay"), (load_scene("canonical", law="pfra"), "law"),
        (load_scene("canonical", **{"law.b": 3.0}), "law"), (load_scene("canonical", dt=2e-3), "dt"),
        (load_scene("canonical", energy=False), "energy"), (load_scene("canonical", observer=None), "observer"),
        (replace(BASE, axes=2, packet_size=100), "axes"), (replace(BASE, packet_size=99), "packet_size"),
        (replace(BASE, start_m=0.1), "start_m"), (replace(BASE, name="other"), "scene"),
    ])
    def test_differs_where_the_scenes_differ_and_nowhere_else(self, other: Scene, key: str) -> None:
        mine, theirs = manifest_of(self.BASE), manifest_of(other)
        apart = {name for name in mine if mine[name] != theirs[name]}
        assert apart - {"link"} == {key}  # a knob of the link shows there too
        assert ("link" in apart) == (key == "delay")

    def test_of_another_link_differs_in_the_link(self) -> None:
        mine, theirs = (manifest_of(load_scene("canonical", link=f"delay({d})")) for d in (0.1, 0.2))
        assert {name for name in mine if mine[name] != theirs[name]} == {"link"}

    def test_of_the_same_scene_is_the_same_text(self) -> None:
        assert manifest_of(load_scene("canonical", delay="0.05")) == manifest_of(self.BASE)

    def test_tells_files_apart_by_what_is_in_them_not_by_where_they_lie(self, tmp_path: Path) -> None:
        for folder, text in (("a", "1"), ("b", "1"), ("c", "2")):
            (tmp_path / folder).mkdir()
            (tmp_path / folder / "up").write_text(text)
        a, b, c = (fingerprint(tmp_path / folder / "up") for folder in "abc")
        assert a == b != c
        assert str(tmp_path) not in a


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


class TestKnobsThatDeclareNothing:
    """The part that a knob sets refuses its number, in its own words."""

    @pytest.fixture
    def path(self, tmp_path: Path) -> str:
        (tmp_path / "undeclared.py").write_text(UNDECLARED)
        return str(tmp_path / "undeclared.py")

    def test_are_named_as_they_were_typed_where_the_part_knows_them_by_another_name(self, path: str) -> None:
        with pytest.raises(Refused, match=r"^k_e must be at least 0, not -5; write for example k_e=0$"):
            load_scene(path, k_e="-5", k_h="5", duration="2")

    def test_are_named_even_where_the_part_calls_them_like_another_knob_that_was_set(self, path: str) -> None:
        with pytest.raises(Refused, match=r"^dark_for must be at least 0, not -1; write for example dark_for=0$"):
            load_scene(path, dark_for=-1, duration=2)
        with pytest.raises(Refused, match=r"^duration must be above 0, not -1"):
            load_scene(path, duration=-1, dark_for=2)

    def test_are_all_shown_where_it_cannot_be_told_which_one_it_was(self, path: str) -> None:
        with pytest.raises(Refused, match=r"^k must be at least 0, .* \(scene .* with k_e=-5\.0, k_h=-5\.0\)$"):
            load_scene(path, k_e="-5", k_h="-5")


class TestLoading:
    @pytest.mark.parametrize("name", [3, None, Path("mine.py")])
    def test_refuses_a_name_that_is_no_text(self, name: Any) -> None:
        with pytest.raises(Refused, match=r"write for example load_scene\('canonical'\)"):
            load_scene(name)

    def test_refuses_a_link_that_is_none(self) -> None:
        with pytest.raises(Refused, match=r"link must be something with arrivals, not 3; .*link=Delay\(0\.05\)"):
            load_scene("canonical", link=3)

    def test_refuses_a_scene_that_stops_or_returns_something_else(self, tmp_path: Path) -> None:
        (tmp_path / "stops.py").write_text("def scene(): return 1 / 0\n")
        (tmp_path / "other.py").write_text("def scene(): return 3\n")
        with pytest.raises(Refused, match=r"stops\.py stopped with ZeroDivisionError"):
            load_scene(str(tmp_path / "stops.py"))
        with pytest.raises(Refused, match=r"returned int; its function must return a teleop\.Scene"):
            load_scene(str(tmp_path / "other.py"))


def test_a_scene_that_is_like_one_which_passed_is_still_checked_where_it_differs() -> None:
    passed = {"law": Wave(), "master": MassDamper(mass=0.1), "slave": MassDamper(mass=0.5), "dt": 1e-3}
    Scene(**passed)
    assert type(Scene(**{**passed, "axes": 1.0}).axes) is int
    for name, value in {"dt": -1e-3, "observer": -1.0, "axes": True, "start_m": float("nan"), "duration": []}.items():
        with pytest.raises(Refused, match=name):
            Scene(**{**passed, name: value})


def test_a_part_is_judged_by_itself_where_its_class_does_not_tell() -> None:
    class Body:
        def __init__(self, **own: float) -> None:
            vars(self).update(own)

    made = {"law": Wave(), "master": MassDamper(mass=0.1)}
    Scene(**made, slave=Body(mass=0.5, damping=1.0, friction=0.0))
    with pytest.raises(Refused, match="damping"):
        Scene(**made, slave=Body(mass=0.5))
