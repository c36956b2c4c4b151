"""Stages around a law as text, in every place that takes a law by its name."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pytest

from teleop import PFRA, Direct, Refused, Wave, around, load_scene, run, sweep
from teleop.law import law_name, reads
from teleop.laws.around.compose import StageEnd, compose
from teleop.laws.around.names import STAGES
from teleop.protocol.manifest import manifest_difference, manifest_of
from teleop.scene.library import ROOT
from teleop.scene.loading import asks_for_trust
from teleop.simulation.ending import scene_arguments as as_typed
from teleop.simulation.prepared import prepare
from teleop.simulation.result import parameters
from teleop.sweeps.kernels.c_kernel import Form, library_name
from tests.fakes import law_of
from tests.programs import compiler_of
from tests.teleop.conftest import Answer

Typed = Callable[..., Answer]
MINE = (ROOT / "scenarios" / "examples" / "law.py").read_text()


def test_a_text_names_stages_and_law_with_their_numbers_which_are_knobs_beside_each_other_of_one_class() -> None:
    assert load_scene("canonical", law="deadband(0.2, floor=1e-4) | wave(b=3)").law == around(
        "deadband(k=0.2, floor=1e-4)", Wave(b=3.0))
    assert load_scene("canonical", law="deadband|wave").law == around("deadband()", Wave())
    assert load_scene("canonical", law="wave(b=3.0)").law == Wave(b=3.0)
    law = load_scene("canonical", **{"law": "deadband(0.2) | wave(b=3.0)", "law.b": 4.0, "law.deadband_k": 0.3}).law
    assert (law.b, law.deadband_k, law.deadband_floor) == (4.0, 0.3, 1e-3)
    assert [field.name for field in fields(law)] == ["b", "K", "B", "deadband_k", "deadband_floor"]
    assert type(law) is type(around("deadband(0.1)", Wave()))
    assert law_name(law) == "deadband | wave"


def test_a_law_with_a_name_of_the_stage_is_told_so() -> None:
    mine = law_of(name="Mine", knobs=[("deadband_k", float, 1.0)])()
    with pytest.raises(Refused, match="has a field deadband_k, which is one of the stage"):
        around("deadband", mine)


class Commanded(NamedTuple):
    force: float


@dataclass(frozen=True)
class Softer:
    """A share of the law's force reaches the device."""

    share: float = 0.5

    name: ClassVar[str] = "softer"
    shows: ClassVar[tuple[str, ...]] = ("softer_force",)
    begun: ClassVar[Any] = Commanded(0.0)

    @classmethod
    def end(cls, _name: str, _sends: Any) -> Any:
        return StageEnd(lambda _, _at: (Softer.begun, ()), lambda softer, _s, _at, _rx, _over, f, tx: (
            softer.share * f, tx, (), Commanded(f)))

    @classmethod
    def claims_of(cls, _claims: Any) -> Any:
        return {}


def test_a_stage_of_ones_own_runs_in_every_engine_to_the_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    compiler_of("vector")
    monkeypatch.setitem(STAGES, "softer", f"{__name__}:Softer")
    axes = {"law.softer_share": [0.5, 1.0], "law.guard_k": [5000.0, 1.0]}
    fixed = {"law": "guard | softer | direct", "duration": 0.3, "energy": False}
    plain, *compiled = [sweep("free_motion", axes, fixed=fixed, engine=engine, metrics=["x_err_rms"])["x_err_rms"]
                        for engine in ("plain", "vector")]
    assert len(set(plain)) == 4
    assert all(np.array_equal(plain, each) for each in compiled)
    alone, whole = [run(load_scene("free_motion", law=law, duration=0.3)).trace
                    for law in (Direct(), compose(Softer(share=1.0), Direct()))]
    assert all(np.array_equal(alone[name], whole[name], equal_nan=True) for name in alone)
    assert np.array_equal(whole["softer_force_m"], whole["f_m"])


def test_a_law_is_read_through_several_stages_its_rows_share_a_kernel_and_an_analysis_takes_the_law_inside() -> None:
    law = type(around("guard | deadband", PFRA()))
    assert reads(law.master) == reads(PFRA.master) | {"v", "dt"}
    assert reads(law.master_sums) == reads(PFRA.master_sums) | {"f_held", "dx"}
    scenes = [load_scene("free_motion", law=f"deadband({k}) | pfra", duration=0.3) for k in (0.1, 0.2)]
    assert len({library_name(scene, prepare(scene).bodies, ("x_err_rms",), Form(4), "cc") for scene in scenes}) == 1
    law = around("deadband(0.1) | guard", Wave(b=3.0))
    assert law.linear() == Wave(b=3.0)


def test_a_stage_whose_record_has_a_name_of_at_is_told_so(monkeypatch: pytest.MonkeyPatch) -> None:
    class Force(NamedTuple):
        f: float

    monkeypatch.setattr(Softer, "begun", Force(0.0))
    with pytest.raises(Refused, match="the stage softer has a record with the field f, a name of At"):
        compose(Softer(), Wave(b=1.0))


def test_a_composed_law_goes_to_another_process() -> None:
    law = around("deadband(0.2)", Wave(b=3.0))
    assert pickle.loads(pickle.dumps(law)) == law
    told = subprocess.run([sys.executable, "-c", "import pickle, sys; print(pickle.load(sys.stdin.buffer))"],
                          input=pickle.dumps(law), capture_output=True, check=True, cwd=ROOT)
    assert told.stdout.decode().strip() == repr(law)


def test_a_grid_and_a_summary_name_it_and_a_command_repeats_it(typed: Typed, tmp_path: Path) -> None:
    answer = typed("sweep", "canonical", "--set", "duration=0.1", "--grid",
                   "law=deadband(k=0.1,floor=1e-3) | wave,wave delay=0:0.05:2", "--out", str(tmp_path / "s"))
    assert answer.code == 0
    scene = load_scene("canonical", law="deadband(0.2) | wave(b=3.0)", duration=0.1)
    told = parameters(scene)["law"]
    assert told == {"name": "deadband | wave", "b": 3.0, "K": 500.0, "B": 20.0, "deadband_k": 0.2,
                    "deadband_floor": 1e-3}
    again = {f"law.{key}": value for key, value in told.items() if key != "name"}
    assert load_scene("canonical", law=told["name"], **again).law == scene.law
    assert as_typed(scene) == ("canonical --set law='deadband | wave' --set law.b=3.0 --set law.deadband_k=0.2 "
                            "--set duration=0.1")


def test_the_list_has_the_knobs_of_a_stage_and_of_a_law_with_it(typed: Typed) -> None:
    found = json.loads(typed("list", "deadband(0.2) | wave", "--json").out)["found"][0]
    assert [knob["name"] for knob in found["knobs"]] == ["b", "K", "B", "deadband_k", "deadband_floor"]
    assert "deadband_floor" in typed("list", "deadband").out
    assert "deadband" in typed("list", "around").out


def test_a_law_of_a_file_has_stages_too_and_is_told_apart_by_its_file(tmp_path: Path) -> None:
    file = tmp_path / "law_mine.py"
    file.write_text(MINE)
    text = f"deadband(0.1) | {file}"
    scene = load_scene("canonical", law=text, duration=0.2)
    assert run(scene).status == "ok"
    before = manifest_of(scene)
    assert Path(str(parameters(scene)["law"]["file"])).name == "law_mine.py"
    file.write_text(MINE + "\nEDITED = True\n")
    os.utime(file, ns=(1, 1))
    after = manifest_of(load_scene("canonical", law=text, duration=0.2))
    assert "law source" in str(manifest_difference(before, after))


def test_a_stored_text_that_names_a_file_is_not_run_without_trust() -> None:
    for text in ("deadband(0.1) | {}", "{}(K=3.0)", "deadband(0.1) | {}:SmoothReflection(K=3.0)", "deadband(0.1 | {}"):
        assert asks_for_trust("canonical", {"law": text.format("law_mine.py")}), text


def test_a_mistake_of_the_law_inside_is_told_with_its_own_line(tmp_path: Path) -> None:
    file = tmp_path / "law_wrong.py"
    line = "return self.K * (rx.x - at.x)"
    assert line in MINE
    file.write_text(MINE.replace(line, "return 1.0 / (rx.x < 0.02) + self.K * (rx.x - at.x)"))
    with pytest.raises(Refused, match=r"SmoothReflection.slave \(.*law_wrong.py:\d+\) raised ZeroDivisionError"):
        run(load_scene("canonical", law=f"deadband(0.1) | {file}", duration=0.2))
