"""Knobs: a scene's keyword parameters, given as texts or from Python, each checked by name and type."""

from __future__ import annotations

import json
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from fractions import Fraction
from hashlib import sha256
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from channel.delay import Delay
from teleop import Knob, Refused, Result, Scaling, knob, load_scene, run, sweep
from teleop.law import Law, OnePortLaw
from teleop.laws.around.names import around
from teleop.laws.pfra import PFRA
from teleop.laws.wave import Wave
from teleop.protocol.manifest import manifest_difference, manifest_of
from teleop.scene.catalogue import units_of
from teleop.scene.knobs import knobs_of, read, read_law, settle
from teleop.scene.library import ROOT, built_in_scenes, scene_function
from teleop.scene.loading import stored_scene
from teleop.scene.parts import Vector
from teleop.scene.playout import Fixed, Hold, Playout, Zero
from teleop.simulation.bodies import exact_bodies
from teleop.stages.device import VelocityEstimator
from teleop.stages.velocity.low_pass import LowPass
from tests.teleop.conftest import Answer

WAVE, ZERO, DELAY, LOW_PASS = Wave(), Zero(), Delay(0.1), LowPass(cutoff=30.0)


def scene(*, up: Path, k_e: float = 1.0, law: Law = WAVE, steps: int = 3) -> None: ...


class TestNames:
    def test_of_a_function_come_with_type_and_default_which_stands_if_they_are_not_given(self) -> None:
        assert {name: found[:2] for name, found in knobs_of(scene).items()} == {
            "up": (Path, ...), "k_e": (float, 1.0), "law": (Law, Wave()), "steps": (int, 3)}
        assert settle("s", scene, {"up": "a", "k_e": "2"}) == (
            {"up": Path("a"), "k_e": 2.0, "law": Wave(), "steps": 3}, {})
        with pytest.raises(Refused, match="scene s needs up: add --set up=FILE"):
            settle("s", scene, {})

    def test_that_every_scene_has_are_kept_apart(self) -> None:
        values, of_every_scene = settle("s", scene, {"up": "a", "x_limit": "0.5"})
        assert "x_limit" not in values
        assert of_every_scene == {"x_limit": (0.5, 0.5)}
        assert load_scene("canonical", x_limit=0.5).x_limit == 0.5
        assert load_scene("canonical", scale_x="0.5").scaling == Scaling(scale_x=0.5)
        both = load_scene("canonical", scale_x=0.5, scale_f=2.0)
        assert both.scaling == Scaling(scale_x=0.5, scale_f=2.0)
        assert (both.knobs["scale_x"], both.knobs["scale_f"]) == (0.5, 2.0)
        assert load_scene("canonical").scaling is None


class TestOfALinkThatIsReplaced:
    """A knob that only the scene's own link reads would be swept, and shown, and change nothing."""

    def test_are_refused_beside_it_also_at_their_defaults(self) -> None:
        given: tuple[tuple[str, str, Any], ...] = (
            ("soft_tissue", "delay", "0.1"), ("soft_tissue", "delay", 0.05), ("jittery_wan", "jitter", 0.01),
            ("jittery_wan", "loss", "0"), ("burst_loss", "to_bad", 0.1), ("blackout", "dark_from", 1.0))
        for name, key, value in given:
            for link in ("delay(0.02)", "none", DELAY):
                with pytest.raises(Refused, match=rf"^{key} sets nothing but the link.*; leave {key} out and write"):
                    load_scene(name, link=link, **{key: value})

    def test_are_taken_without_it_and_all_others_beside_it(self, tmp_path: Path) -> None:
        assert load_scene("soft_tissue", delay=0.1).link == Delay(0.1)
        made = load_scene("jittery_wan", link="delay(0.1)", k_e=3.0, playout="fixed:0.1", law="wave", dt=2e-3)
        assert (made.link, made.playout, made.dt) == (DELAY, Fixed(0.1), 2e-3)
        (tmp_path / "mine.py").write_text(  # they declare nothing
            "from dataclasses import replace\nfrom channel import Delay\nfrom teleop import Fixed, load_scene\n"
            "made = []\ndef scene(*, delay: float = 0.1, other: float = 1.0):\n    made.append(delay)\n"
            "    return replace(load_scene('free_motion'), link=Delay(delay), playout=Fixed(2 * delay))\n")
        path = str(tmp_path / "mine.py")
        assert load_scene(path, delay=0.2, link="delay(0.1)").playout == Fixed(0.4)
        assert load_scene(path, other=0.2, link="delay(0.1)").link == DELAY
        # Nothing about a knob is found out by making the scene with other numbers.
        assert scene_function(path).__globals__["made"] == [0.2, 0.1]

    def test_replaces_the_scenes_own_and_stands_in_its_knobs_as_text(self) -> None:
        for link in ("delay(0.2)", Delay(0.2)):
            got = load_scene("canonical", link=link)
            assert got.link == Delay(0.2)
            assert load_scene("canonical", link=str(got.knobs["link"])).link == Delay(0.2)
        for none in ("none", None):
            got = load_scene("canonical", link=none)
            assert got.link is None
            assert got.knobs["link"] == "none"


def declaring(*, k: Annotated[float, Knob("N/m", "stiffness", low=0.0, high=1e3)] = 1.0,
        at: Annotated[Vector, Knob("m", "position", low=-1.0)] = 0.0,
        age: Annotated[float | None, Knob("s", "age", above=0.0)] = None,
        steps: Annotated[int, Knob("ticks", "steps", low=1)] = 1,
        shape: Annotated[str, Knob("", "shape", choices=("ball", "cube"))] = "ball") -> None: ...


class TestDeclared:
    """Unit, meaning and bounds stand in the annotation."""

    def test_what_is_out_of_bounds_is_refused_with_unit_and_cure_and_what_is_within_is_read(self) -> None:
        given: tuple[tuple[str, object, str], ...] = (
            ("k", "-1", "k must be at least 0 N/m, not -1; write for example k=0"),
            ("k", "2e3", "k must be at most 1000 N/m, not 2000; write for example k=1000"),
            ("k", 2e3, "k must be at most 1000 N/m, not 2000; write for example k=1000"),
            ("at", "0,-2,0", "at must be at least -1 m, not -2; write for example at=-1"),
            ("age", "0", "age must be above 0 s, not 0; write for example age=1"),
            ("steps", "0", "steps must be at least 1 ticks, not 0; write for example steps=1"),
            ("shape", "bal", "shape is one of ball, cube, not 'bal'; did you mean ball?"))
        for name, value, sentence in given:
            with pytest.raises(Refused) as refused:
                settle("s", declaring, {name: value})
            assert str(refused.value) == sentence
        within = {"k": "1e3", "at": "0,-1", "age": "none", "steps": "2", "shape": "cube"}
        assert settle("s", declaring, within)[0] == {
            "k": 1e3, "at": (0.0, -1.0), "age": None, "steps": 2, "shape": "cube"}

    def test_a_type_may_declare_for_all_that_have_it_and_every_number_of_a_built_in_scene_has_a_meaning(self) -> None:
        def scene(*, dt: knob.Tick = 1e-3, age: knob.MessageAge = None) -> None: ...

        found = {name: (each.kind, each.knob.unit) for name, each in knobs_of(scene).items()}
        assert found == {"dt": (float, "s"), "age": (float | None, "s")}
        plain = {"law", "playout", "velocity"}  # known by their types
        missing = [(name, key) for name in built_in_scenes() for key, found in knobs_of(scene_function(name)).items()
                   if key not in plain and not found.knob.meaning]
        assert missing == []


def bare(law=WAVE, k=1000, m=0.5, energy=True, title="a", up=Path("x"), at=(0.1,), play=ZERO,
         left_out=None, velocity=LOW_PASS, other=DELAY, *, given) -> None: ...


def ruled(law) -> None: ...


class TestWithoutAnnotation:
    """A user's scene need not say what its defaults show."""

    def test_a_knob_is_of_its_defaults_type_and_else_a_number(self) -> None:
        kinds = {name: found.kind for name, found in knobs_of(bare).items()}
        assert kinds == {
            "law": Law | OnePortLaw, "k": float, "m": float, "energy": bool, "title": str, "up": Path, "at": Vector,
            "play": Playout, "left_out": float | None, "velocity": VelocityEstimator, "other": Delay, "given": float,
        }
        assert settle("s", ruled, {"law": "wave", "law.b": "3"})[0] == {"law": Wave(b=3.0)}  # known by its name

    def test_it_is_read_or_refused_as_such(self) -> None:
        as_usual = settle("s", bare, {"given": 1.0})[0]
        read_as: tuple[tuple[str, str, object], ...] = (
            ("law", "pfra", PFRA()), ("k", "0.5", 0.5), ("energy", "no", False), ("title", "b", "b"),
            ("up", "y", Path("y")), ("at", "1,2", (1.0, 2.0)), ("play", "hold", Hold()), ("left_out", "3", 3.0),
            ("left_out", "none", None), ("velocity", "low_pass(cutoff=5)", LowPass(cutoff=5.0)))
        for name, text, value in read_as:
            assert settle("s", bare, {"given": "1", name: text})[0] == {**as_usual, name: value}
        for name, text, words in (
                ("law", "directt", "did you mean direct"), ("energy", "2", "energy is true or false"),
                ("k", "x", "k=1000"), ("other", "delay", "other cannot be written as text"),
                ("play", "x", "play is zero, hold")):
            with pytest.raises(Refused, match=words):
                settle("s", bare, {"given": "1", name: text})


class TestRead:
    @given(st.floats(allow_nan=False, allow_infinity=False), st.integers(-(2**53), 2**53))
    def test_numbers_come_from_their_own_text_to_the_last_bit(self, value: float, whole: int) -> None:
        assert read("k", repr(value), float) == value == read("k", value, float)
        got = read("n", str(whole), int)
        assert got == whole
        assert isinstance(got, int)

    def test_numbers_may_be_of_numpy_of_several_axes_or_left_out(self) -> None:
        for value in (np.float32(0.5), np.float64(0.5), Fraction(1, 2)):
            assert type(read("k", value, float)) is float
            assert read("k", value, float) == 0.5
        assert read("n", np.int64(3), int) == 3
        assert type(read("n", np.uint8(3), int)) is int
        assert read("to", "0.1,0,-2", Vector) == (0.1, 0.0, -2.0)
        assert read("to", (0.1, 2), Vector) == (0.1, 2.0)
        assert read("to", "0.1", Vector) == 0.1
        assert read("observer", "none", float | None) is None
        assert read("observer", None, float | None) is None
        assert read("observer", "5", float | None) == 5.0

    def test_truths_playouts_paths_and_what_no_text_can_say(self) -> None:
        for text in ("true", "True", "yes", "on", "1"):
            assert read("energy", text, bool) is True
        for text in ("false", "FALSE", "no", "off", "0"):
            assert read("energy", text, bool) is False
        for text, playout in (("zero", Zero()), ("hold", Hold()), ("fixed:0.1", Fixed(0.1)),
                              ("fixed:0.1:hold", Fixed(0.1, Hold()))):
            assert read("playout", text, Playout) == playout == read("playout", playout, Playout)
        assert read("up", "some/file", Path) == Path("some/file")  # it is not looked at
        thing = object()
        assert read("thing", thing, object) is thing


class TestLaws:
    def test_are_named_and_tuned_and_keep_the_numbers_of_the_scene_that_are_not_turned(self) -> None:
        assert read("remote", "pfra", Law) == PFRA()
        assert read("remote", WAVE, OnePortLaw | None) is WAVE
        assert load_scene("canonical", law="pfra").law == PFRA()
        base: Any = load_scene("canonical").law
        assert load_scene("canonical", **{"law.b": "4", "law": "wave"}).law == Wave(b=4.0, K=base.K, B=base.B)

    def test_of_the_scene_lost_its_gains_where_it_was_named(self) -> None:
        """Also with stages, and for each axis."""
        own = Wave(b=20.0, K=1000.0, B=20.0)
        for knobs, law in (
                ({"law": "wave"}, own), ({"law": "wave", "law.b": "3"}, Wave(b=3.0, K=1000.0, B=20.0)),
                ({"law": "wave", "law.b": "3,4"}, (Wave(b=3.0, K=1000.0, B=20.0), Wave(b=4.0, K=1000.0, B=20.0))),
                ({"law": "wave()"}, Wave()), ({"law": "wave(b=3.0)"}, Wave(b=3.0)), ({"law": "pfra"}, PFRA()),
                ({"law": "deadband(0.1) | wave"}, around("deadband(0.1)", own)),
                ({"law": "deadband(0.1) | wave()"}, around("deadband(0.1)", Wave()))):
            assert settle("hard_wall", scene_function("hard_wall"), knobs)[0]["law"] == law, knobs
        staged, each = around("deadband(0.3)", Wave(b=20.0)), (Wave(b=20.0), Wave(b=10.0))
        for text, law, read_as in (
                ("deadband | wave", staged, staged), ("wave", staged, Wave(b=20.0)), ("wave", each, each),
                ("deadband(0.1) | wave", staged, around("deadband(0.1)", Wave(b=20.0)))):
            assert read_law(text, law) == read_as


# A law in a file of its own, named where a law is named: `law=FILE.py:CLASS`


Typed = Callable[..., Answer]
EXAMPLE = (ROOT / "scenarios" / "examples" / "law.py").read_text()
MINE = """
from dataclasses import dataclass
from typing import ClassVar, NamedTuple
from teleop import At

class Forth(NamedTuple):
    x: float

class Back(NamedTuple):
    x: float

@dataclass(frozen=True, kw_only=True)
class PositionPosition:
    K: float = 100.0
    B: float = 4.0
    claims: ClassVar[dict[str, str]] = {}
    def master_start(self, at: At): return (), Back(at.x)
    def slave_start(self, at: At): return (), Forth(at.x)
    def master(self, s, at: At, rx: Back): return self.K * (at.x - rx.x) + self.B * at.v, Forth(at.x), s
    def slave(self, s, at: At, rx: Forth): return self.K * (rx.x - at.x) - self.B * at.v, Back(at.x), s
"""
ONE_PORT = """
from dataclasses import dataclass
from typing import ClassVar

@dataclass(frozen=True, kw_only=True)
class Spring:
    K: float
    claims: ClassVar[dict[str, str]] = {}
    def start(self, at): return ()
    def force(self, s, at): return self.K * at.x, s
"""
SHORT = ["--set", "duration=0.2"]


def greatest(result: Result) -> float:
    """The greatest force at the hand, N: a metric that takes a row's whole record."""
    return float(result.trace["f_m"].max())


@pytest.fixture(autouse=True)
def written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "law_mine.py").write_text(MINE)
    (tmp_path / "two.py").write_text(MINE + MINE[MINE.index("@dataclass"):].replace("PositionPosition", "Softer"))
    (tmp_path / "spring.py").write_text(ONE_PORT)
    monkeypatch.chdir(tmp_path)
    return tmp_path


class TestOnTheCommandLine:
    def test_runs_with_its_knobs_and_the_summary_has_its_file_and_digest(self, typed: Typed, written: Path) -> None:
        assert typed("run", "hard_wall", "--set", "law=law_mine.py", "--set", "law.K=150", *SHORT).code == 0
        law = json.loads((written / "runs/hard_wall-1/summary.json").read_text())["parameters"]["law"]
        digest = sha256(MINE.encode()).hexdigest()[:12]
        assert law == {"name": "PositionPosition", "K": 150.0, "B": 4.0, "file": str(written / "law_mine.py"),
                       "sha256": digest}
        assert "law PositionPosition" in typed("report", "runs/hard_wall-1").out

    def test_is_the_law_that_a_script_would_give(self) -> None:
        own: dict[str, object] = {}
        exec(compile(MINE, "own", "exec", dont_inherit=True), own)
        mine = own["PositionPosition"](K=150.0)
        expected = run(load_scene("hard_wall", law=mine, duration=0.2)).trace["x_s"].tobytes()
        for law in ("law_mine.py", "law_mine.py:PositionPosition", "./law_mine.py", "two.py:Softer"):
            scene = load_scene("hard_wall", law=law, duration=0.2, **{"law.K": "150"})
            assert run(scene).trace["x_s"].tobytes() == expected, law

    def test_its_number_was_told_in_the_unit_of_a_built_in_law_that_has_one_of_the_same_name(
            self, written: Path) -> None:
        """The example script can be named, and a number without a default given by its knob."""
        law = type(load_scene("soft_tissue", law="law_mine.py").law)
        assert "law.K" not in units_of("soft_tissue", ["law.K"], law)
        assert units_of("soft_tissue", ["law.K"], type(load_scene("soft_tissue", law="wave").law))["law.K"] == "N/m"
        (written / "law.py").write_text(EXAMPLE)
        assert load_scene("soft_tissue", law="law.py", **{"law.cutoff": 2.0}).law.cutoff == 2.0
        assert load_scene("virtual_wall", law="spring.py", **{"law.K": "3"}).law.K == 3.0

    def test_an_edit_within_the_same_second_and_of_the_same_length_is_seen(self, written: Path) -> None:
        """Python's own loader took the compiled code of the first content for the second."""
        gains = []
        for gain in ("100.0", "200.0"):
            (written / "law_mine.py").write_text(MINE.replace("100.0", gain))
            gains.append(load_scene("hard_wall", law="law_mine.py").law.K)
        assert gains == [100.0, 200.0]
        assert not (written / "__pycache__").exists()


class TestInASweep:
    AXES = {"law": ["direct", "law_mine.py:PositionPosition"], "delay": [0.0, 0.02]}  # noqa: RUF012
    FIXED = {"duration": 0.05}  # noqa: RUF012

    def test_rows_are_the_runs_also_in_processes_of_their_own(self) -> None:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            table = sweep("soft_tissue", self.AXES, fixed=self.FIXED, engine="plain", executor=pool)
        for row in table:
            alone = run(load_scene("soft_tissue", law=row["law"], delay=row["delay"], **self.FIXED))
            assert row["x_err_rms"] == alone.metrics["x_err_rms"]

    def test_another_content_is_another_sweep_and_another_kernel(self, written: Path) -> None:
        from teleop.sweeps.kernels.c_kernel import Form, library_name

        def kernel() -> str:
            scene = load_scene("soft_tissue", law="law_mine.py")
            return library_name(scene, exact_bodies(scene), ["x_err_rms"], Form(), "cc")

        same = kernel()
        for _ in range(2):
            sweep("soft_tissue", self.AXES, fixed=self.FIXED, engine="plain", out="kept")
            assert kernel() == same
        for old, new in (("+ self.B * at.v,", "- self.B * at.v,"), ("K: float = 100", "K: float = 200")):
            (written / "law_mine.py").write_text(MINE.replace(old, new))
            assert (kernel() == same) == ("100" in old), "numbers are passed to it"
            with pytest.raises(Refused, match="a law was edited"):
                sweep("soft_tissue", self.AXES, fixed=self.FIXED, engine="plain", out="kept")

    @pytest.mark.parametrize("measure", ["x_err_rms", greatest])
    def test_an_edit_while_it_ran_left_rows_of_two_laws_in_one_table(self, measure: Any, written: Path) -> None:
        def edit(done: int, _total: int) -> None:
            if done:
                (written / "edited").write_text(MINE.replace("K: float = 100", "K: float = 200"))
                (written / "edited").replace(written / "law_mine.py")  # at once: nobody reads half of it

        with pytest.raises(Refused, match=r"law_mine.py was edited while the sweep ran; .* into another folder"):
            sweep("soft_tissue", {"delay": [0.001 * i for i in range(20)]}, metrics=[measure], workers=1, out="kept",
                  fixed={"law": "law_mine.py", **self.FIXED}, engine="plain", show=edit)
        rows = [json.loads(line) for line in (written / "kept" / "rows.jsonl").read_text().splitlines()]
        assert 0 < len(rows) < 20
        (written / "law_mine.py").write_text(MINE)
        for row in rows:
            alone = run(load_scene("soft_tissue", law="law_mine.py", delay=row["delay"], **self.FIXED))
            assert row.get("x_err_rms", row.get("greatest")) in (alone.metrics["x_err_rms"], greatest(alone))


def test_the_same_file_elsewhere_goes_together_with_it_and_another_content_does_not(written: Path) -> None:
    """Two different laws called `wave` went together: their sources were taken for those of the release."""
    def told(folder: str, text: str) -> dict[str, str]:
        (written / folder).mkdir()
        (written / folder / "law_mine.py").write_text(text)
        return manifest_of(load_scene("hard_wall", law=f"{folder}/law_mine.py"))

    one = told("one", MINE)
    assert manifest_difference(one, told("copy", MINE)) is None
    edited = manifest_difference(one, told("edited", MINE.replace("+ self.B", "- self.B")))
    assert str(edited).startswith("law source is law_mine.py (")
    assert told("wave", MINE.replace("PositionPosition", "wave"))["law source"].startswith("law_mine.py (")


def test_of_a_stored_folder_is_run_with_trust_and_a_sweep_is_shown_without_it(typed: Typed, written: Path) -> None:
    assert stored_scene("hard_wall", {"law": "law_mine.py", "law.K": "3"}, trust=True).law.K == 3.0
    sweep("soft_tissue", {"law": ["direct", "law_mine.py"]}, fixed={"duration": 0.1}, engine="plain", out="kept")
    (written / "law_mine.py").write_text("raise AssertionError('run by a report')\n")
    assert "law_mine.py" in typed("report", "kept").out
