"""Knobs: a scene's keyword parameters, given as texts or from Python, each checked by name and type."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from channel.delay import Delay
from teleop import Knob, Refused, knob, load_scene
from teleop.errors import number
from teleop.law import Law, OnePortLaw
from teleop.laws.around.names import around
from teleop.laws.pfra import PFRA
from teleop.laws.wave import Wave
from teleop.scene.knobs import knobs_of, read, read_law, settle
from teleop.scene.library import built_in_scenes, scene_function
from teleop.scene.parts import Vector
from teleop.scene.playout import Fixed, Hold, Playout, Zero
from teleop.stages.device import VelocityEstimator
from teleop.stages.velocity.low_pass import LowPass

WAVE, ZERO, DELAY, LOW_PASS = Wave(), Zero(), Delay(0.1), LowPass(cutoff=30.0)


def scene(*, up: Path, k_e: float = 1.0, law: Law = WAVE, steps: int = 3) -> None: ...


def anything(*, k_e: float = 1.0, **rest: float) -> None: ...


def several(*rest: float) -> None: ...


def first(k_e: float = 1.0, /) -> None: ...


class TestNames:
    def test_of_a_function_come_with_type_and_default(self) -> None:
        assert {name: found[:2] for name, found in knobs_of(scene).items()} == {
            "up": (Path, ...), "k_e": (float, 1.0), "law": (Law, Wave()), "steps": (int, 3)}

    def test_that_are_not_given_keep_their_defaults(self) -> None:
        values, of_every_scene = settle("s", scene, {"up": "a", "k_e": "2"})
        assert values == {"up": Path("a"), "k_e": 2.0, "law": Wave(), "steps": 3}
        assert not of_every_scene

    def test_that_every_scene_has_are_kept_apart(self) -> None:
        values, of_every_scene = settle("s", scene, {"up": "a", "x_limit": "0.5"})
        assert "x_limit" not in values
        assert of_every_scene == {"x_limit": (0.5, 0.5)}
        assert load_scene("canonical", x_limit=0.5).x_limit == 0.5

    def test_that_must_be_given_are_asked_for(self) -> None:
        with pytest.raises(Refused, match=r"scene s needs up: add --set up=FILE"):
            settle("s", scene, {})

    def test_that_nobody_knows_are_refused_with_the_nearest(self) -> None:
        with pytest.raises(Refused, match=r"no knob 'k_f'.*did you mean k_e"):
            settle("s", scene, {"up": "a", "k_f": "1"})


    @pytest.mark.parametrize(("function", "shown"), [(anything, r"\*\*rest"), (several, r"\*rest"), (first, "k_e")])
    def test_that_cannot_be_named_are_refused(self, function: Any, shown: str) -> None:
        with pytest.raises(Refused, match=rf"`{shown}.*` cannot be one; write for example `def scene\(\*, k_e"):
            knobs_of(function)


class TestOfALinkThatIsReplaced:
    """A knob that only the scene's own link reads would be swept, and shown, and change nothing."""

    @pytest.mark.parametrize(("of", "key", "value"), [
        ("soft_tissue", "delay", "0.1"), ("soft_tissue", "delay", 0.05), ("jittery_wan", "jitter", 0.01),
        ("jittery_wan", "loss", "0"), ("burst_loss", "to_bad", 0.1), ("blackout", "dark_from", 1.0),
    ])
    @pytest.mark.parametrize("link", ["delay(0.02)", "none", DELAY])
    def test_are_refused_beside_it_also_at_their_defaults(self, of: str, key: str, value: Any, link: Any) -> None:
        with pytest.raises(Refused, match=rf"^{key} sets nothing but the link.*; leave {key} out and write"):
            load_scene(of, link=link, **{key: value})

    def test_are_taken_without_it(self) -> None:
        assert load_scene("soft_tissue", delay=0.1).link == Delay(0.1)

    def test_all_others_are_taken_beside_it(self) -> None:
        made = load_scene("jittery_wan", link="delay(0.1)", k_e=3.0, playout="fixed:0.1", law="wave", dt=2e-3)
        assert (made.link, made.playout, made.dt) == (DELAY, Fixed(0.1), 2e-3)

    def test_that_declare_nothing_are_taken(self, tmp_path: Path) -> None:
        (tmp_path / "mine.py").write_text(
            "from dataclasses import replace\nfrom channel import Delay\nfrom teleop import Fixed, load_scene\n"
            "def scene(*, delay: float = 0.1, other: float = 1.0):\n"
            "    made = load_scene('free_motion')\n"
            "    return replace(made, link=Delay(delay), playout=Fixed(2 * delay))\n")
        at = str(tmp_path / "mine.py")
        assert load_scene(at, delay=0.2, link="delay(0.1)").playout == Fixed(0.4)
        assert load_scene(at, other=0.2, link="delay(0.1)").link == DELAY

    def test_a_scene_is_made_once_whatever_its_knobs_set(self, tmp_path: Path) -> None:
        """Nothing about a knob is found out by making the scene with other numbers."""
        (tmp_path / "counted.py").write_text(
            "from teleop import load_scene\nmade = []\n"
            "def scene(*, delay: float = 0.1):\n    made.append(delay)\n    return load_scene('free_motion')\n")
        load_scene(str(tmp_path / "counted.py"), delay=0.2, link="delay(0.1)")
        function = scene_function(str(tmp_path / "counted.py"))
        assert function.__globals__["made"] == [0.2]  # type: ignore[attr-defined]


def declaring(
    *,
    k: Annotated[float, Knob("N/m", "stiffness", low=0.0, high=1e3)] = 1.0,
    at: Annotated[Vector, Knob("m", "position", low=-1.0)] = 0.0,
    age: Annotated[float | None, Knob("s", "age", above=0.0)] = None,
    steps: Annotated[int, Knob("ticks", "steps", low=1)] = 1,
    shape: Annotated[str, Knob("", "shape", choices=("ball", "cube"))] = "ball",
) -> None: ...


class TestDeclared:
    """Unit, meaning and bounds stand in the annotation."""

    @pytest.mark.parametrize(("name", "value", "sentence"), [
        ("k", "-1", "k must be at least 0 N/m, not -1; write for example k=0"),
        ("k", "2e3", "k must be at most 1000 N/m, not 2000; write for example k=1000"),
        ("k", 2e3, "k must be at most 1000 N/m, not 2000; write for example k=1000"),
        ("k", -1.0, "k must be at least 0 N/m, not -1; write for example k=0"),
        ("at", "0,-2,0", "at must be at least -1 m, not -2; write for example at=-1"),
        ("age", "0", "age must be above 0 s, not 0; write for example age=1"),
        ("steps", "0", "steps must be at least 1 ticks, not 0; write for example steps=1"),
        ("shape", "bal", "shape is one of ball, cube, not 'bal'; did you mean ball?"),
    ])
    def test_what_is_out_of_bounds_is_refused_with_unit_and_cure(
        self, name: str, value: object, sentence: str
    ) -> None:
        with pytest.raises(Refused) as refused:
            settle("s", declaring, {name: value})
        assert str(refused.value) == sentence

    def test_what_is_within_is_read_as_without(self) -> None:
        given = {"k": "1e3", "at": "0,-1", "age": "none", "steps": "2", "shape": "cube"}
        assert settle("s", declaring, given)[0] == {
            "k": 1e3, "at": (0.0, -1.0), "age": None, "steps": 2, "shape": "cube"}

    def test_a_type_may_declare_for_all_that_have_it(self) -> None:
        def scene(*, dt: knob.Tick = 1e-3, age: knob.MessageAge = None) -> None: ...

        found = {name: (each.kind, each.knob.unit) for name, each in knobs_of(scene).items()}
        assert found == {"dt": (float, "s"), "age": (float | None, "s")}

    @pytest.mark.parametrize("name", built_in_scenes())
    def test_every_number_of_a_built_in_scene_declares_its_meaning(self, name: str) -> None:
        plain = {"law", "playout", "velocity"}  # known by their types
        missing = [key for key, found in knobs_of(scene_function(name)).items()
                   if key not in plain and not found.knob.meaning]
        assert missing == []


def bare(law=WAVE, k=1000, m=0.5, energy=True, title="a", up=Path("x"), at=(0.1,), play=ZERO,  # type: ignore[no-untyped-def]
         left_out=None, velocity=LOW_PASS, other=DELAY, *, given) -> None: ...


def ruled(law) -> None: ...  # type: ignore[no-untyped-def]


class TestWithoutAnnotation:
    """A user's scene need not say what its defaults show."""

    def test_a_knob_is_of_its_defaults_type_and_else_a_number(self) -> None:
        kinds = {name: found.kind for name, found in knobs_of(bare).items()}
        assert kinds == {
            "law": Law | OnePortLaw, "k": float, "m": float, "energy": bool, "title": str, "up": Path, "at": Vector,
            "play": Playout, "left_out": float | None, "velocity": VelocityEstimator, "other": Delay, "given": float,
        }

    @pytest.mark.parametrize(("name", "text", "value"), [
        ("law", "pfra", PFRA()), ("k", "0.5", 0.5), ("energy", "no", False), ("title", "b", "b"),
        ("up", "y", Path("y")), ("at", "1,2", (1.0, 2.0)), ("play", "hold", Hold()),
        ("left_out", "3", 3.0), ("left_out", "none", None),
        ("velocity", "low_pass(cutoff=5)", LowPass(cutoff=5.0)),
    ])
    def test_it_is_read_as_such(self, name: str, text: str, value: object) -> None:
        assert settle("s", bare, {"given": "1", name: text})[0] | {"given": 1.0} == {
            **settle("s", bare, {"given": 1.0})[0], name: value}

    def test_a_law_is_known_by_its_name_alone_and_tuned(self) -> None:
        assert settle("s", ruled, {"law": "wave", "law.b": "3"})[0] == {"law": Wave(b=3.0)}

    @pytest.mark.parametrize(("name", "text", "words"), [
        ("law", "directt", "did you mean direct"), ("energy", "2", "energy is true or false"), ("k", "x", "k=1000"),
        ("other", "delay", "other cannot be written as text"), ("play", "x", "play is zero, hold"),
    ])
    def test_what_is_wrong_is_refused_in_its_terms(self, name: str, text: str, words: str) -> None:
        with pytest.raises(Refused, match=words):
            settle("s", bare, {"given": "1", name: text})


class TestNumbers:
    @given(st.floats(allow_nan=False, allow_infinity=False))
    def test_are_read_from_their_own_text_to_the_last_bit(self, value: float) -> None:
        assert read("k", repr(value), float) == value
        assert read("k", value, float) == value

    @given(st.integers(-(2**53), 2**53))
    def test_that_are_whole_stay_whole(self, value: int) -> None:
        got = read("n", str(value), int)
        assert got == value
        assert isinstance(got, int)

    @pytest.mark.parametrize("value", ["nan", "inf", "-inf", "1e999", "", "1,5", "0x10", "one", True, None, [1.0]])
    def test_that_are_none_are_refused(self, value: object) -> None:
        with pytest.raises(Refused, match="k must be"):
            read("k", value, float)

    def test_in_several_axes_are_parted_by_commas(self) -> None:
        assert read("to", "0.1,0,-2", Vector) == (0.1, 0.0, -2.0)
        assert read("to", (0.1, 2), Vector) == (0.1, 2.0)
        assert read("to", "0.1", Vector) == 0.1
        with pytest.raises(Refused, match="to must be a number"):
            read("to", "0.1,,3", Vector)

    def test_that_may_be_left_out_take_none(self) -> None:
        assert read("observer", "none", float | None) is None
        assert read("observer", None, float | None) is None
        assert read("observer", "5", float | None) == 5.0


    def test_of_numpy_are_numbers(self) -> None:
        for value in (np.float32(0.5), np.float64(0.5), Fraction(1, 2)):
            assert type(read("k", value, float)) is float
            assert read("k", value, float) == 0.5
        assert read("n", np.int64(3), int) == 3
        assert type(read("n", np.uint8(3), int)) is int
        for none in (np.bool_(True), np.array([1.0]), 1j):
            with pytest.raises(Refused, match="k must be a number"):
                read("k", none, float)

    @pytest.mark.parametrize("value", [10**400, -(10**400), Fraction(10**400)])
    def test_beyond_all_floats_are_refused(self, value: Any) -> None:
        with pytest.raises(Refused, match="k must be finite"):
            read("k", value, float)

    @pytest.mark.parametrize(("limits", "value", "sentence"), [
        ({"low": 0.0}, -1, "delay must be at least 0, not -1; write for example delay=0"),
        ({"above": 0.0}, 0, "delay must be above 0, not 0; write for example delay=1"),
        ({"above": 0.0, "high": 0.5}, 0, "delay must be above 0, not 0; write for example delay=0.5"),
        ({"high": 3.0}, 4, "delay must be at most 3, not 4; write for example delay=3"),
    ])
    def test_out_of_range_are_told_what_to_type(self, limits: Any, value: float, sentence: str) -> None:
        with pytest.raises(Refused) as refused:
            number("delay", value, **limits)
        assert str(refused.value) == sentence
        assert number("delay", float(sentence.rpartition("=")[2]), **limits) >= 0.0


class TestOtherKinds:
    @pytest.mark.parametrize("text", ["true", "True", "yes", "on", "1"])
    def test_truths(self, text: str) -> None:
        assert read("energy", text, bool) is True

    @pytest.mark.parametrize("text", ["false", "FALSE", "no", "off", "0"])
    def test_untruths(self, text: str) -> None:
        assert read("energy", text, bool) is False

    @pytest.mark.parametrize(
        ("text", "playout"),
        [("zero", Zero()), ("hold", Hold()), ("fixed:0.1", Fixed(0.1)), ("fixed:0.1:hold", Fixed(0.1, Hold()))],
    )
    def test_playouts(self, text: str, playout: Playout) -> None:
        assert read("playout", text, Playout) == playout
        assert read("playout", playout, Playout) == playout

    @pytest.mark.parametrize(
        "text", ["fixed", "fixed:", "fixed:soon", "fixed:-1", "fixed:0.1:", "fixed:0.1:never", "hold:1", "none"])
    def test_playouts_that_are_none(self, text: str) -> None:
        with pytest.raises(Refused):
            read("playout", text, Playout)

    @pytest.mark.parametrize(("text", "wrong"), [
        ("integral:-1", "the target must be at least 0, not -1"), ("scaled:2", "the rate must be at most 1, not 2"),
        ("fixed:-1", "the playout delay must be above 0, not -1")])
    def test_a_number_within_a_playout_out_of_bounds_has_no_cure_that_cannot_be_typed(self, text: str, wrong: str
                                                                                      ) -> None:
        """It said to write target=0, which is no knob."""
        with pytest.raises(Refused, match=rf"^in playout={text} {wrong}; playout is .*; write playout=fixed:0.1$"):
            read("playout", text, Playout)

    def test_paths_are_not_looked_at(self) -> None:
        assert read("up", "some/file", Path) == Path("some/file")
        with pytest.raises(Refused, match="up is the path"):
            read("up", "", Path)

    def test_what_no_text_can_say_is_left_to_python(self) -> None:
        thing = object()
        assert read("thing", thing, object) is thing
        with pytest.raises(Refused, match="set it from Python"):
            read("thing", "text", object)


class TestLaws:
    def test_may_be_a_knob_of_another_name(self) -> None:
        assert read("remote", "pfra", Law) == PFRA()
        assert read("remote", WAVE, OnePortLaw | None) is WAVE
        with pytest.raises(Refused, match=r"remote must be a law or the name of one, not 3; write remote=wave"):
            read("remote", 3, Law)

    def test_are_named_and_tuned(self) -> None:
        assert load_scene("canonical", law="pfra").law == PFRA()
        tuned = load_scene("canonical", **{"law.b": "4", "law": "wave"}).law
        assert tuned == Wave(b=4.0)

    def test_keep_the_numbers_of_the_scene_that_are_not_turned(self) -> None:
        base: Any = load_scene("canonical").law
        assert load_scene("canonical", **{"law.b": 3.0}).law == Wave(b=3.0, K=base.K, B=base.B)

    @pytest.mark.parametrize(("given", "law"), [
        ({"law": "wave"}, Wave(b=20.0, K=1000.0, B=20.0)),
        ({"law": "wave", "law.b": "3"}, Wave(b=3.0, K=1000.0, B=20.0)),
        ({"law": "wave", "law.b": "3,4"}, (Wave(b=3.0, K=1000.0, B=20.0), Wave(b=4.0, K=1000.0, B=20.0))),
        ({"law": "wave()"}, Wave()), ({"law": "wave(b=3.0)"}, Wave(b=3.0)),
        ({"law": "deadband(0.1) | wave"}, around("deadband(0.1)", Wave(b=20.0, K=1000.0, B=20.0))),
        ({"law": "deadband(0.1) | wave()"}, around("deadband(0.1)", Wave())),
        ({"law": "pfra"}, PFRA()),
    ])
    def test_of_the_scene_lost_its_gains_where_it_was_named(self, given: dict[str, Any], law: object) -> None:
        values, _ = settle("hard_wall", scene_function("hard_wall"), given)
        assert values["law"] == law

    def test_of_the_scene_with_stages_of_its_own_lost_their_numbers_where_it_was_named(self) -> None:
        own = around("deadband(0.3)", Wave(b=20.0))
        assert read_law("deadband | wave", own) is own
        assert read_law("deadband(0.1) | wave", own) == around("deadband(0.1)", Wave(b=20.0))
        assert read_law("wave", own) == Wave(b=20.0)

    def test_of_each_axis_of_the_scene_lost_their_gains_where_they_were_named(self) -> None:
        own = (Wave(b=20.0), Wave(b=10.0))
        assert read_law("wave", own) == own

    def test_out_of_their_domain_are_refused_with_what_they_are_and_where_that_comes_from(self) -> None:
        with pytest.raises(Refused) as refused:
            load_scene("canonical", **{"law": "two_layer", "law.beta": 2.0})
        assert str(refused.value) == (
            "law.beta must be at most 1, not 2; write for example law.beta=1 (share of its tank that an end sends in a "
            "tick; source: the head of teleop/laws/two_layer.py)")

    @pytest.mark.parametrize(("given", "words"), [
        ({"law": "wavee"}, "did you mean wave"), ({"law.c": "1"}, "law wave has no knob 'c'"),
        ({"law.b": "nan"}, "law.b must be finite"), ({"law": 3}, "law=wave"), ({"law.b": "-1"}, "b must be above 0"),
    ])
    def test_that_are_wrong_are_refused(self, given: dict[str, Any], words: str) -> None:
        with pytest.raises(Refused, match=words):
            load_scene("canonical", **given)


class TestLinks:
    def test_replace_the_scenes_own_and_stand_in_its_knobs_as_text(self) -> None:
        for link in ("delay(0.2)", Delay(0.2)):
            got = load_scene("canonical", link=link)
            assert got.link == Delay(0.2)
            assert load_scene("canonical", link=str(got.knobs["link"])).link == Delay(0.2)

    @pytest.mark.parametrize("link", ["none", None])
    def test_may_be_left_out(self, link: str | None) -> None:
        got = load_scene("canonical", link=link)
        assert got.link is None
        assert got.knobs["link"] == "none"
