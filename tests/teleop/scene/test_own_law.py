"""A law in a file of its own, named where a law is named: `law=FILE.py:CLASS`."""

from __future__ import annotations

import json
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from hashlib import sha256
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import pytest

from teleop import Refused, Result, load_scene, run, sweep
from teleop.protocol.manifest import manifest_difference, manifest_of
from teleop.scene.catalogue import units_of
from teleop.scene.library import ROOT
from teleop.scene.loading import stored_scene
from teleop.simulation.bodies import exact_bodies
from tests.teleop.conftest import Answer

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
    """The folder in which all is typed, with law_mine.py and others in it."""
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
        mine = own["PositionPosition"](K=150.0)  # type: ignore[operator]
        expected = run(load_scene("hard_wall", law=mine, duration=0.2)).trace["x_s"].tobytes()
        for law in ("law_mine.py", "law_mine.py:PositionPosition", "./law_mine.py", "two.py:Softer"):
            scene = load_scene("hard_wall", law=law, duration=0.2, **{"law.K": "150"})
            assert run(scene).trace["x_s"].tobytes() == expected, law

    def test_its_number_was_told_in_the_unit_of_a_built_in_law_that_has_one_of_the_same_name(self) -> None:
        law = type(load_scene("soft_tissue", law="law_mine.py").law)
        assert "law.K" not in units_of("soft_tissue", ["law.K"], law)
        assert units_of("soft_tissue", ["law.K"], type(load_scene("soft_tissue", law="wave").law))["law.K"] == "N/m"

    def test_the_example_script_can_be_named_and_a_number_without_a_default_given_by_its_knob(
            self, written: Path) -> None:
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

    def test_another_content_is_another_sweep(self, written: Path) -> None:
        sweep("soft_tissue", self.AXES, fixed=self.FIXED, engine="plain", out="kept")
        sweep("soft_tissue", self.AXES, fixed=self.FIXED, engine="plain", out="kept")
        for old, new in (("+ self.B * at.v,", "- self.B * at.v,"), ("K: float = 100", "K: float = 200")):
            (written / "law_mine.py").write_text(MINE.replace(old, new))
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

    def test_another_content_is_another_kernel(self, written: Path) -> None:
        from teleop.sweeps.kernels.c_kernel import Form, library_name

        names = set()
        for text in (MINE, MINE, MINE.replace("+ self.B * at.v,", "- self.B * at.v,")):
            (written / "law_mine.py").write_text(text)
            scene = load_scene("soft_tissue", law="law_mine.py")
            names.add(library_name(scene, exact_bodies(scene), ["x_err_rms"], Form(), "cc"))
        assert len(names) == 2


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
