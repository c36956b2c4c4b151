"""What `teleop list` says: names, knobs, metrics, playouts, stages and integrators."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

import teleop
from channel.link import EFFECTS
from teleop import PFRA, Refused, Scaling, Scene, Wave, find_law, load_scene, run
from teleop.law import BUILT_IN
from teleop.scene.knobs import COMMON
from teleop.scene.library import ROOT, built_in_scenes
from teleop.scene.playout import as_typed
from teleop.simulation.integrators.methods import METHODS
from teleop.simulation.metrics import METRICS
from teleop.simulation.structure import structure_of
from teleop.stages.order import STAGES, Place
from tests.teleop.conftest import Answer

Typed = Callable[..., Answer]


class TestList:
    def test_names_every_scene_law_and_effect_with_a_line(self, typed: Typed) -> None:
        lines = typed("list").out.splitlines()
        told = {words[0]: words[1] for line in lines if len(words := line.split(maxsplit=1)) == 2}
        for name in (*built_in_scenes(), *BUILT_IN, *EFFECTS):
            assert len(told[name]) > 10

    def test_of_a_scene_shows_its_knobs_with_type_and_default(self, typed: Typed) -> None:
        rows = [line.split() for line in typed("list", "canonical").out.splitlines()]
        assert ["delay", "float", "0.05", "s,", "delay"] in [row[:5] for row in rows]
        assert ["energy", "bool", "True"] in [row[:3] for row in rows]
        assert ["observer", "float", "|", "None", "200.0"] in [row[:5] for row in rows]

    @pytest.mark.parametrize("name", sorted({*built_in_scenes(), *EFFECTS, *BUILT_IN}))
    def test_says_of_every_knob_what_it_is_and_in_which_unit(self, name: str, typed: Typed) -> None:
        for block in typed("list", name).out.rstrip("\n").split("\n\n"):
            if block.startswith("what it sends"):  # a law's words, below its knobs
                continue
            heading, *rows = [line for line in block.splitlines()[1:] if not line.startswith("  set with")] or [""]
            said = heading.index("default") + len("default") if rows else 0
            assert [row.split()[0] for row in rows if not row[said:].partition("  ")[2].strip()] == []

    def test_of_a_law_shows_what_the_numbers_mean(self, typed: Typed) -> None:
        out = typed("list", "wave").out
        assert "Wave variables" in out
        assert "N s/m, wave impedance, > 0" in out

    def test_of_a_name_that_a_scene_and_an_effect_share_shows_both(self, typed: Typed) -> None:
        out = typed("list", "blackout").out
        assert "scene blackout" in out
        assert "effect blackout" in out

    def test_of_a_path_shows_a_users_own_scene(self, typed: Typed, tmp_path: Path) -> None:
        (tmp_path / "mine.py").write_text("def scene(*, steps: int = 3):\n    'A scene that a user wrote.'\n")
        out = typed("list", "mine.py").out
        assert "A scene that a user wrote." in out
        assert ["steps", "int", "3"] in [line.split() for line in out.splitlines()]

    @pytest.mark.parametrize("kind", ["scenes", "laws", "effects", "estimators"])
    def test_of_a_kind_is_its_part_of_the_whole(self, kind: str, typed: Typed) -> None:
        own = [{"name": row["name"], "meaning": row["meaning"]}  # of laws there is more
               for row in json.loads(typed("list", kind, "--json").out)[kind]]
        assert own == json.loads(typed("list", "--json").out)[kind]

    def test_of_a_kind_that_is_misspelt_names_it(self, typed: Typed) -> None:
        typed("list", "metric").assert_refused("did you mean metrics?")

    def test_of_a_kind_that_has_another_name_names_the_kinds(self, typed: Typed) -> None:
        """`teleop list integrators` named forty scenes, laws and effects, and not `bodies`."""
        typed("list", "integrators").assert_refused("and the kinds scenes", "bodies")

    def test_of_a_scene_shows_the_knobs_that_every_scene_takes(self, typed: Typed) -> None:
        """`x_limit` was accepted by --set and named by no list."""
        lines = typed("list", "canonical").out.partition("knobs of every scene")[2].splitlines()
        assert {line.split()[0] for line in lines[2:]} - {"set"} == set(COMMON)
        told = json.loads(typed("list", "canonical", "--json").out)["found"][0]
        assert {knob["name"]: knob["unit"] for knob in told["of_every_scene"]}["x_limit"] == "m"

    def test_of_a_scene_as_json_says_what_a_knob_may_be(self, typed: Typed) -> None:
        knobs = {knob["name"]: knob for knob in json.loads(typed("list", "lte", "--json").out)["found"][0]["knobs"]}
        assert knobs["up"]["must_be_given"]
        assert knobs["up"]["default"] is None
        assert (knobs["f_max"]["type"], knobs["f_max"]["low"], knobs["f_max"]["default"]) == ("float | None", 0.0, 20.0)

    @pytest.mark.parametrize("name", ["law.py", "law.py:SmoothReflection"])
    def test_of_a_law_in_a_file_shows_its_knobs(self, name: str, typed: Typed, tmp_path: Path) -> None:
        (tmp_path / "law.py").write_text((ROOT / "scenarios" / "examples" / "law.py").read_text())
        out = typed("list", name).out
        assert f"law {name}: The slave tracks the master's position" in out
        assert f"set with: --set law={name} --set law.NAME=VALUE" in out

    def test_of_a_file_with_a_scene_and_a_law_shows_both(self, typed: Typed, tmp_path: Path) -> None:
        text = "class Law:\n    def start(self, at): ...\n    def force(self, s, at): ...\n\ndef scene(): ...\n"
        (tmp_path / "both.py").write_text(text.replace("class", "from dataclasses import dataclass\n@dataclass\nclass"))
        out = typed("list", "both.py").out
        assert out.startswith("scene both.py\n")
        assert "\nlaw both.py\n" in out


class TestTables:
    def test_metrics_are_all_there_with_unit_meaning_and_what_they_need(self, typed: Typed) -> None:
        rows = json.loads(typed("list", "metrics", "--json").out)["metrics"]
        assert [row["name"] for row in rows] == [*METRICS]
        assert all(row["unit"] and row["meaning"] and row["needs"] for row in rows)
        assert "scenarios/examples/metric.py" in typed("list", "metrics").out

    def test_bodies_are_the_methods_by_names_that_run_takes(self, typed: Typed) -> None:
        rows = json.loads(typed("list", "bodies", "--json").out)["bodies"]
        assert [row["name"] for row in rows] == ["exact", *(f"{method.name}:N" for method in METHODS)]
        assert [row["order"] for row in rows] == [None, *(method.order for method in METHODS)]
        for row in rows:
            run(load_scene("hard_wall", duration=0.01), bodies=row["name"].replace("N", "2"))

    def test_playouts_are_what_their_knob_takes(self, typed: Typed) -> None:
        rows = json.loads(typed("list", "playout", "--json").out)["playout"]
        words = {"SECONDS": "0.1", "TARGET": "0.01", "RATE": "0.1", "GAPS": "integral"}
        typed_as = [re.sub("[A-Z]+", lambda found: words[found[0]], row["name"]) for row in rows]
        made = [load_scene("hard_wall", playout=each).playout for each in typed_as]
        assert [as_typed(each) for each in made if each is not None] == typed_as
        assert len(set(map(str, made))) == len(rows) == 8

    @pytest.mark.parametrize(  # of hold see tests/scenarios/test_random_links.py
        "playout", ["zero", "fixed:0.08", "integral", "integral:0.01", "energy", "fixed:0.06:integral"])
    def test_a_playout_keeps_what_the_list_claims(self, playout: str) -> None:
        scene = load_scene("jittery_wan", playout=playout, link="delay(0.05) | uniform(0.03) | bernoulli(0.4)",
                           f_max="none", slew="none", timeout="none")
        assert run(scene).metrics["E_link_min"] > -1e-9

    def test_stages_are_in_the_order_of_the_tick_with_the_law_between(self, typed: Typed) -> None:
        rows = json.loads(typed("list", "stages", "--json").out)["stages"]
        names = [row["name"] for row in rows]
        assert [name for name in names if name != "(law)"] == [place.name for place in STAGES]
        assert names[names.index("(law)") - 1:names.index("(law)") + 2] == ["wave_scaling", "(law)", "compute_delay"]

    @pytest.mark.parametrize("place", STAGES, ids=lambda place: place.name)
    def test_a_stage_is_turned_on_by_the_field_that_the_list_names(self, place: Place) -> None:
        laws = {"observer": PFRA(), "law_ledger": find_law("pspm")()}  # those that have use for the stage
        bare = replace(load_scene("canonical"), observer=None, energy=False, law=laws.get(place.name, Wave()))
        if place.name == "orientation":  # three axes of a rotation beside three of a translation
            bare = replace(bare, axes=6, units=("m", "m", "m", "rad", "rad", "rad"))
        named = replace(bare, **eval(f"dict({place.field})", {name: getattr(teleop, name) for name in PARTS}))
        ends = {"both": "ms", "master": "m", "slave": "s"}[place.ends]
        assert with_stage(bare, place) == ""
        assert with_stage(named, place) == ("m" if "device_m" in place.field else ends)


PARTS = ("Cap", "Deadband", "Device", "Encoder", "Energy", "Integral", "LowPass", "Operator", "PassivityController",
         "Scaled", "Scaling", "Watchdog")


def with_stage(scene: Scene, place: Place) -> str:
    """The ends of a scene that have a stage."""
    return "".join(e for e in "ms" if place.stage() in getattr(structure_of(scene), e).stages)


class TestKnobsOfEveryScene:
    def test_scaling_is_set_by_its_two_numbers(self) -> None:
        assert load_scene("canonical", scale_x="0.5").scaling == Scaling(scale_x=0.5)
        both = load_scene("canonical", scale_x=0.5, scale_f=2.0)
        assert both.scaling == Scaling(scale_x=0.5, scale_f=2.0)
        assert (both.knobs["scale_x"], both.knobs["scale_f"]) == (0.5, 2.0)
        assert load_scene("canonical").scaling is None

    @pytest.mark.parametrize(("knobs", "words"), [
        ({"scale_x": "0"}, "scale_x must be above 0"), ({"scale_f": "none"}, "scale_f must be a number"),
        ({"x_limit": "-1"}, "x_limit must be above 0 m"), ({"playout": "zeros"}, "playout is zero, hold"),
        ({"playout": "hold", "link": "none"}, "^playout=hold sets nothing in .* without a link.*or write"),
    ])
    def test_that_cannot_be_are_refused(self, knobs: dict[str, str], words: str) -> None:
        with pytest.raises(Refused, match=words):
            load_scene("canonical", **knobs)

    def test_of_a_scene_without_a_slave_are_refused_where_they_need_one(self) -> None:
        with pytest.raises(Refused, match="without a slave has no scaling"):
            load_scene("virtual_wall", scale_x=2.0)
        with pytest.raises(Refused, match=r"^playout=fixed:0\.1 sets nothing in a scene without a link; leave it out$"):
            load_scene("virtual_wall", playout="fixed:0.1")  # nor would a link go with it
