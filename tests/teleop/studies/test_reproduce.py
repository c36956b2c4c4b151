"""Published comparisons run again: the labels, the numbers of each publication, and what the command leaves."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from teleop import Refused, Scene
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


def test_a_label_says_what_came_of_a_number_told_with_a_digit_more_than_is_printed_or_asked_for() -> None:
    for finding, label, result in (
            (Replication("peak", "33.53", 33.53412), "reproduced", "33.534"),
            (Replication("peak", "33.53", 33.536), "differs", "33.536"),
            (Replication("peak", "33.53", 33.536, tolerance=0.01), "reproduced", "33.536"),
            (Replication("peak", "1600", 1600.5), "reproduced", "1600.5"),
            (Replication("damping", "0.8", 0.8, tolerance=1e-6), "reproduced", "0.800000"),
            (Replication("stiffness", "1600.00", 1605.351, tolerance=32.0), "reproduced", "1605.351"),
            (Replication("peak", "0.8", float("nan")), "differs", "nan"),
            (Replication("verdict", "stable", "stable"), "reproduced", "stable"),
            (Replication("verdict", "stable", "unstable"), "differs", "unstable"),
            (Replication("bounces", "6", "many"), "differs", "many"),
            (Replication("peak", "33.53", None), "published", "-"),
            (Replication("bounces", "6", 6.0, is_fitted=True), "fitted", "6.0")):
        assert (finding.label, result_text(finding)) == (label, result), finding


@pytest.mark.parametrize("name", [
    pytest.param(each, marks=[pytest.mark.full] * (i > 0)) for i, each in enumerate(PUBLICATIONS)])
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
    def test_tells_published_and_found_beside_each_other_and_how_many_of_which_kind(self, typed: Typed) -> None:
        lines = typed("reproduce", "encoder_wall").out.splitlines()
        row = next(line for line in lines if line.startswith("run B (K 2500): observed energy"))
        assert row.split()[-5:] == ["reproduced", "-17.6", "-17.60", "0.05", "mJ"]
        assert lines[-1] == "15 numbers of teaching material: 15 reproduced"
        lines = typed("reproduce", "colgate_schenkel").out.splitlines()
        assert lines[-1] == "5 numbers of a paper's formula at numbers chosen here: 5 reproduced"

    def test_counted_fitted_numbers_as_reproduced_and_hid_that_a_tolerance_was_chosen_here(self, typed: Typed) -> None:
        """It says why a number differs and why one was not run, too."""
        lines = typed("reproduce", "hannaford_ryu").out.splitlines()
        assert lines[-1] == (
            "7 numbers printed in a paper: 5 reproduced, 1 different, 1 fitted, which is no reproduction")
        row = next(line for line in lines if line.startswith("90 kN/m at 1 kHz, no controller"))
        assert row.endswith("swing below 0.02 mm (chosen here)")
        out = typed("reproduce", "choi_tan").out
        assert "an increase of 178 %" in out
        assert "judged by people" in out

    def test_leaves_a_document_and_a_page(self, typed: Typed, tmp_path: Path) -> None:
        document = json.loads(typed("reproduce", "diolaiti", "--out", "kept", "--json").out)
        assert json.loads((tmp_path / "kept" / "summary.json").read_text()) == {
            key: value for key, value in document.items() if key != "path"}
        first = document["publications"][0]["findings"][0]
        assert (first["published"], first["label"], first["tolerance"]) == (1.5, "reproduced", 1e-6)
        assert first["tolerance_chosen_here"] is True
        assert first["found"] == pytest.approx(1.5)
        page = (tmp_path / "kept" / "page.md").read_text()
        for words in ("## diolaiti", "IEEE Trans. Robotics 22(2), 2006", "| 1.5 | 1.500000 |"):
            assert words in page
        assert [find_publication(name).name for name in PUBLICATIONS] == list(PUBLICATIONS), "without a name all"
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
