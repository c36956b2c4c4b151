"""Published comparisons run again: the labels, the numbers of each publication, and what the command leaves."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from teleop.errors import Refused
from teleop.scene.scene import Scene
from teleop.studies.reproduce import PUBLICATIONS, find_publication
from teleop.studies.reproduce.command import result_text
from teleop.studies.reproduce.publication import Replication
from tests.teleop.conftest import Answer

Typed = Callable[..., Answer]

DIFFER = {  # what is known not to come out as printed, and why it cannot
    "gil": {"damping 0 N s/m, 10 ms late", "damping 0 N s/m, 100 ms late", "damping 0.8 N s/m, 5 ms late"},
    "hannaford_ryu": {"the most that the controller added"},
    "two_handles": {"and fails last at"},
    "damping_injection": {"T1^2 + T2^2"},
    "choi_tan": {"increase from 250 Hz to 40 kHz"},
}
OTHERS = {("hannaford_ryu", "fitted"): 1, ("choi_tan", "published"): 2}


class TestALabel:
    @pytest.mark.parametrize(("finding", "label"), [
        (Replication("peak", "33.53", 33.534), "reproduced"),
        (Replication("peak", "33.53", 33.536), "differs"),
        (Replication("peak", "33.53", 33.536, tolerance=0.01), "reproduced"),
        (Replication("peak", "1600", 1600.5), "reproduced"),
        (Replication("peak", "0.8", float("nan")), "differs"),
        (Replication("verdict", "stable", "stable"), "reproduced"),
        (Replication("verdict", "stable", "unstable"), "differs"),
        (Replication("bounces", "6", "many"), "differs"),
        (Replication("peak", "33.53", None), "published"),
        (Replication("bounces", "6", 6.0, is_fitted=True), "fitted"),
    ])
    def test_says_what_came_of_a_number(self, finding: Replication, label: str) -> None:
        assert finding.label == label

    def test_is_told_with_a_digit_more_than_is_printed_or_asked_for(self) -> None:
        assert result_text(Replication("peak", "33.53", 33.53412)) == "33.534"
        assert result_text(Replication("damping", "0.8", 0.8, tolerance=1e-6)) == "0.800000"
        assert result_text(Replication("stiffness", "1600.00", 1605.351, tolerance=32.0)) == "1605.351"
        assert result_text(Replication("peak", "1", None)) == "-"
        assert result_text(Replication("verdict", "stable", "unstable")) == "unstable"


@pytest.mark.parametrize("name", PUBLICATIONS)
def test_a_publication_is_reproduced_but_where_the_reason_is_known(name: str) -> None:
    publication = find_publication(name)
    findings = publication.rerun()
    differ = [finding for finding in findings if finding.label == "differs"]
    known = DIFFER.get(name, set())
    assert {words for finding in differ for words in known if words in finding.what} == known
    assert len(differ) == len(known)
    assert all(finding.remark for finding in findings if finding.label != "reproduced")
    for label in ("fitted", "published"):
        assert sum(finding.label == label for finding in findings) == OTHERS.get((name, label), 0)
    assert publication.name == name


def test_a_wall_with_another_force_would_be_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """A force that is late by a tick, as an unnoticed change of the tick would make it: no number stays."""
    from teleop.studies.reproduce import colgate_schenkel, publication

    def late(K: float, B: float = 0.0, **knobs: object) -> Scene:
        scene = before(K, B, **knobs)
        return replace(scene, device_m=replace(scene.device_m, delay=1)) if scene.device_m else scene

    before = publication.wall
    monkeypatch.setattr(colgate_schenkel, "wall", late)
    labels = [finding.label for finding in colgate_schenkel.rerun()]
    assert labels.count("differs") == 4  # three dampings, and the verdict just above the first


class TestTheCommand:
    def test_tells_published_and_found_beside_each_other(self, typed: Typed) -> None:
        told = typed("reproduce", "encoder_wall")
        assert told.code == 0
        row = next(line for line in told.out.splitlines() if line.startswith("run B (K 2500): observed energy"))
        assert row.split()[-5:] == ["reproduced", "-17.6", "-17.60", "0.05", "mJ"]
        assert told.out.splitlines()[-1] == "15 numbers of teaching material: 15 reproduced"

    def test_counted_formulas_and_fitted_numbers_as_if_a_paper_had_printed_them(self, typed: Typed) -> None:
        assert typed("reproduce", "hannaford_ryu").out.splitlines()[-1] == (
            "7 numbers printed in a paper: 5 reproduced, 1 different, 1 fitted, which is no reproduction")
        counts = typed("reproduce", "colgate_schenkel").out.splitlines()[-1]
        assert counts == "5 numbers of a paper's formula at numbers chosen here: 5 reproduced"

    def test_did_not_say_that_a_tolerance_was_chosen_here(self, typed: Typed) -> None:
        out = typed("reproduce", "hannaford_ryu").out
        row = next(line for line in out.splitlines() if line.startswith("90 kN/m at 1 kHz, no controller"))
        assert row.endswith("swing below 0.02 mm (chosen here)")

    def test_says_why_a_number_differs_and_why_one_was_not_run(self, typed: Typed) -> None:
        out = typed("reproduce", "choi_tan").out
        assert "an increase of 178 %" in out
        assert "judged by people" in out

    def test_leaves_a_document_and_a_page(self, typed: Typed, tmp_path: Path) -> None:
        told = json.loads(typed("reproduce", "diolaiti", "--out", "kept", "--json").out)
        assert json.loads((tmp_path / "kept" / "summary.json").read_text()) == {
            key: value for key, value in told.items() if key != "path"}
        first = told["publications"][0]["findings"][0]
        assert (first["published"], first["label"], first["tolerance"]) == (1.5, "reproduced", 1e-6)
        assert first["tolerance_chosen_here"] is True
        assert first["found"] == pytest.approx(1.5)
        page = (tmp_path / "kept" / "page.md").read_text()
        assert "## diolaiti" in page
        assert "IEEE Trans. Robotics 22(2), 2006" in page
        assert "| 1.5 | 1.500000 |" in page

    def test_of_an_unknown_name_says_the_nearest_and_writes_nothing(self, typed: Typed, tmp_path: Path) -> None:
        typed("reproduce", "dioliti", "--out", "kept").assert_refused("dioliti", "did you mean diolaiti?")
        assert not (tmp_path / "kept").exists()

    def test_without_a_name_has_them_all(self) -> None:
        assert [find_publication(name).name for name in PUBLICATIONS] == list(PUBLICATIONS)
        with pytest.raises(Refused):
            find_publication("publication")


def test_the_row_of_a_master_that_nobody_holds_passed_with_direct_reflection_too() -> None:
    """Nothing was touched in it: f_env was 0 throughout."""
    from teleop.studies.reproduce.polushin import let_go

    moved, touched = let_go("direct")
    assert (moved, touched) == (pytest.approx(0.0812, abs=1e-4), pytest.approx(0.708, abs=1e-3))
    moved, touched = let_go("pfra")
    assert moved == 0.0
    assert touched > 1.0


def test_without_its_tank_the_franken_scene_does_not_come_to_rest() -> None:
    """So that "stable" is a word that the rerun may not have said."""
    from teleop.studies.reproduce.franken import AT_REST, press

    swing, _ = press("direct")
    assert swing > 1000.0 * AT_REST
