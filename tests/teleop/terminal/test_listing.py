"""What `teleop list` says: names, knobs, tables, and of laws what they send and claim on which condition."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import MISSING, replace
from pathlib import Path
from typing import Any, NamedTuple

import teleop
from channel.link import EFFECTS
from teleop import PFRA, At, Scene, Wave, find_law, kind, load_scene, run, seed_energy
from teleop.law import BUILT_IN
from teleop.scene.knobs import COMMON
from teleop.scene.library import ROOT, built_in_scenes
from teleop.scene.playout import as_typed
from teleop.simulation.integrators.methods import METHODS
from teleop.simulation.metrics import METRICS
from teleop.simulation.structure import structure_of
from teleop.stages.order import STAGES, Place
from teleop.terminal.listing import law_line, law_words
from tests.fakes import law_of
from tests.teleop.conftest import Answer

Typed = Callable[..., Answer]


class TestList:
    def test_names_every_scene_law_and_effect_with_a_line_and_a_kind_is_its_part_of_the_whole(
            self, typed: Typed) -> None:
        lines = typed("list").out.splitlines()
        words = {parts[0]: parts[1] for line in lines if len(parts := line.split(maxsplit=1)) == 2}
        for name in (*built_in_scenes(), *BUILT_IN, *EFFECTS):
            assert len(words[name]) > 10, name
        whole = json.loads(typed("list", "--json").out)
        for part in ("scenes", "laws", "effects", "estimators"):
            rows = json.loads(typed("list", part, "--json").out)[part]
            assert [{"name": row["name"], "meaning": row["meaning"]} for row in rows] == whole[part]  # laws have more

    def test_says_of_every_knob_what_it_is_and_in_which_unit(self, typed: Typed) -> None:
        for name in sorted({*built_in_scenes(), *EFFECTS, *BUILT_IN}):
            for block in typed("list", name).out.rstrip("\n").split("\n\n"):
                if block.startswith("what it sends"):  # a law's words, below its knobs
                    continue
                heading, *rows = [line for line in block.splitlines()[1:] if not line.startswith("  set with")] or [""]
                place = heading.index("default") + len("default") if rows else 0
                assert [row.split()[0] for row in rows if not row[place:].partition("  ")[2].strip()] == [], name

    def test_of_a_scene_shows_its_knobs_and_those_that_every_scene_takes(self, typed: Typed) -> None:
        """`x_limit` was accepted by --set and named by no list."""
        out = typed("list", "canonical").out
        rows = [line.split() for line in out.splitlines()]
        assert ["delay", "float", "0.05", "s,", "delay"] in [row[:5] for row in rows]
        assert ["energy", "bool", "True"] in [row[:3] for row in rows]
        assert ["observer", "float", "|", "None", "200.0"] in [row[:5] for row in rows]
        lines = out.partition("knobs of every scene")[2].splitlines()
        assert {line.split()[0] for line in lines[2:]} - {"set"} == set(COMMON)
        document = json.loads(typed("list", "canonical", "--json").out)["found"][0]
        assert {knob["name"]: knob["unit"] for knob in document["of_every_scene"]}["x_limit"] == "m"
        knobs = {knob["name"]: knob for knob in json.loads(typed("list", "lte", "--json").out)["found"][0]["knobs"]}
        assert knobs["up"]["must_be_given"]
        assert knobs["up"]["default"] is None
        assert (knobs["f_max"]["type"], knobs["f_max"]["low"], knobs["f_max"]["default"]) == ("float | None", 0.0, 20.0)

    def test_of_a_law_shows_what_the_numbers_mean_and_of_a_name_of_two_things_both(self, typed: Typed) -> None:
        out = typed("list", "wave").out
        assert "Wave variables" in out
        assert "N s/m, wave impedance, > 0" in out
        out = typed("list", "blackout").out
        assert "scene blackout" in out
        assert "effect blackout" in out

    def test_of_a_file_shows_the_scene_and_the_law_in_it(self, typed: Typed, tmp_path: Path) -> None:
        (tmp_path / "law.py").write_text((ROOT / "scenarios" / "examples" / "law.py").read_text())
        for name in ("law.py", "law.py:SmoothReflection"):
            out = typed("list", name).out
            assert f"law {name}: The slave tracks the master's position" in out
            assert f"set with: --set law={name} --set law.NAME=VALUE" in out
            assert "what it sends" in out
        (tmp_path / "both.py").write_text(
            "from dataclasses import dataclass\n@dataclass\nclass Law:\n    def start(self, at): ...\n"
            "    def force(self, s, at): ...\n\ndef scene(*, steps: int = 3):\n    'A scene that a user wrote.'\n")
        out = typed("list", "both.py").out
        assert out.startswith("scene both.py")
        assert "A scene that a user wrote." in out
        assert ["steps", "int", "3"] in [line.split() for line in out.splitlines()]
        assert "\nlaw both.py\n" in out


class TestTables:
    def test_metrics_are_all_there_and_bodies_are_the_methods_by_names_that_run_takes(self, typed: Typed) -> None:
        rows = json.loads(typed("list", "metrics", "--json").out)["metrics"]
        assert [row["name"] for row in rows] == [*METRICS]
        assert all(row["unit"] and row["meaning"] and row["needs"] for row in rows)
        assert "scenarios/examples/metric.py" in typed("list", "metrics").out
        rows = json.loads(typed("list", "bodies", "--json").out)["bodies"]
        assert [row["name"] for row in rows] == ["exact", *(f"{method.name}:N" for method in METHODS)]
        assert [row["order"] for row in rows] == [None, *(method.order for method in METHODS)]
        for row in rows:
            run(load_scene("hard_wall", duration=0.01), bodies=row["name"].replace("N", "2"))

    def test_playouts_are_what_their_knob_takes(self, typed: Typed) -> None:
        """Their claims: tests/scenarios/test_random_links.py."""
        rows = json.loads(typed("list", "playout", "--json").out)["playout"]
        words = {"SECONDS": "0.1", "TARGET": "0.01", "RATE": "0.1", "GAPS": "integral"}
        typed_as = [re.sub("[A-Z]+", lambda found: words[found[0]], row["name"]) for row in rows]
        made = [load_scene("hard_wall", playout=each).playout for each in typed_as]
        assert [as_typed(each) for each in made if each is not None] == typed_as
        assert len(set(map(str, made))) == len(rows) == 8

    def test_stages_are_in_the_order_of_the_tick_and_each_is_turned_on_by_the_field_that_the_list_names(
            self, typed: Typed) -> None:
        rows = json.loads(typed("list", "stages", "--json").out)["stages"]
        names = [row["name"] for row in rows]
        assert [name for name in names if name != "(law)"] == [place.name for place in STAGES]
        assert names[names.index("(law)") - 1:names.index("(law)") + 2] == ["wave_scaling", "(law)", "compute_delay"]
        laws = {"observer": PFRA(), "law_ledger": find_law("pspm")()}  # those that have use for the stage
        for place in STAGES:
            bare = replace(load_scene("canonical"), observer=None, energy=False, law=laws.get(place.name, Wave()))
            if place.name == "orientation":  # three axes of a rotation beside three of a translation
                bare = replace(bare, axes=6, units=("m", "m", "m", "rad", "rad", "rad"))
            named = replace(bare, **eval(f"dict({place.field})", {name: getattr(teleop, name) for name in PARTS}))
            ends = {"both": "ms", "master": "m", "slave": "s"}[place.ends]
            ends = "m" if "device_m" in place.field else "s" if place.field.startswith("slave=") else ends
            assert with_stage(bare, place) == "", place
            assert with_stage(named, place) == ends, place


PARTS = ("Cap", "Deadband", "Device", "Encoder", "Energy", "Handover", "Integral", "LowPass", "Operator",
         "PassivityController", "Scaled", "Scaling", "Servo", "Watchdog")


def with_stage(scene: Scene, place: Place) -> str:
    return "".join(e for e in "ms" if place.stage() in getattr(structure_of(scene), e).stages)


TWO_PORTS = sorted(name for name in BUILT_IN if hasattr(find_law(name), "master"))


class Forth(NamedTuple):
    u: kind.Wave
    E: kind.Total
    x: float


def start(_law: Any, at: At) -> Any:
    return (), Forth(0.0, 0.0, at.x)


MINE = law_of(
    name="Mine", knobs=[("E0", float, 0.03)], claims={"E_link": "zero in gaps", "E_law": "constant delay"},
    master_start=start, slave_start=start, master=lambda _, s, _at, rx: (0.0, rx, s),
    slave=lambda _, s, _at, rx: (0.0, rx, s), master_stored=lambda law, _: law.E0, slave_stored=lambda _, _s: 0.0,
    conditions=lambda _, facts: ("it asks for less loss",) if facts.lossy else ())


def test_a_line_has_kinds_of_fields_conditions_of_claims_and_the_energy_at_the_start() -> None:
    said = law_line(MINE())
    assert said is not None
    assert (said.fwd, said.bwd) == ("wave u, total E, x", "wave u, total E, x")
    assert said.claimed == "E_link with zero in gaps, E_law over constant delay"
    assert said.seed == 0.03


def test_the_words_on_one_law_have_its_conditions_over_links_that_break_them() -> None:
    assert law_words(law_of(knobs=[("needed", float, MISSING)])) == ([], {})  # it is known by its knobs alone
    lines, document = law_words(MINE)
    told = "\n".join(lines)
    assert "claims E_link >= 0 over every link, with waves played as zero in gaps" in told
    assert "claims E_law >= 0 over a constant delay without loss" in told
    assert "30.0 mJ to begin with" in told
    assert "over a constant 50 ms" not in told
    assert "50 to 70 ms each way with 5 % loss, in the scene canonical: it asks for less loss" in told
    assert document["conditions"]["a constant 50 ms each way"] == []


def test_the_table_has_a_line_for_each_of_at_least_fifteen_laws_with_two_ports(typed: Typed) -> None:
    rows = {row["name"]: row for row in json.loads(typed("list", "laws", "--json").out)["laws"]}
    assert set(rows) == set(BUILT_IN)
    assert len(TWO_PORTS) >= 15
    for name in TWO_PORTS:
        row, law = rows[name], find_law(name)()
        assert row["fwd"]
        assert row["bwd"]
        assert all(ledger in row["claims"] for ledger in law.claims)
        assert (row["claims"] == "nothing") == (not law.claims)
        assert (row["seed_energy"] is None) == (not hasattr(law, "master_stored"))
        assert len(row["meaning"]) > 10
    assert rows["virtual_wall"]["fwd"] == "(one port)"
    assert rows["wave"]["claims"] == "E_link over any link"


def test_of_one_law_the_claims_stand_below_its_knobs(typed: Typed) -> None:
    for name in ("wave", "tdpa"):
        knobs, words = typed("list", name).out.split("\n\n")
        assert knobs.startswith(f"law {name}: ")
        law = find_law(name)()
        assert [line.split()[1] for line in words.splitlines() if line.startswith("  claims")] == list(law.claims)
        document = json.loads(typed("list", name, "--json").out)["found"][0]
        assert document["claims"] == dict(law.claims)
        assert document["seed_energy"] == (seed_energy(law) if hasattr(law, "master_stored") else None)
