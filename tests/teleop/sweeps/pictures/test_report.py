"""What is told of a sweep: who ran its rows, why some were refused, in which units it is drawn."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path
from typing import Any

import pytest

from teleop import Refused, Table, load_scene, sweep
from teleop.scene.library import built_in_scenes
from teleop.sweeps.pictures.report import (
    PictureRequest,
    joined,
    limits_of,
    picture,
    sentences,
    status_rows,
    summary_of,
    told_of,
    units_of,
    words_of,
    write,
)


def call(ran: int, engine: str = "vector", **rest: Any) -> dict[str, Any]:
    return {"command": ["teleop", engine], "engine": engine, "why": "w", "ran": ran, "seconds": float(ran),
            "done": 10, "path": "p", **rest}


class TestASummary:
    def test_has_an_entry_for_each_call_that_ran_rows(self) -> None:
        first = joined(call(4), {})
        second = joined(call(6, "plain"), first)
        assert [(run["engine"], run["ran"], run["command"]) for run in second["runs"]] == [
            ("vector", 4, ["teleop", "vector"]), ("plain", 6, ["teleop", "plain"])]
        assert (second["engine"], second["seconds"]) == ("plain", 6.0)
        assert "done" not in second["runs"][0]

    def test_keeps_what_made_the_rows_when_a_call_found_them_all(self) -> None:
        before = joined(call(4), {})
        after = joined(call(0, "plain", done=4), before)
        assert after["runs"] == before["runs"]
        for key in ("engine", "why", "seconds", "command", "ran"):
            assert after[key] == before[key]
        assert after["done"] == 4  # that is of the folder as it is

    def test_of_rows_that_nobody_noted_is_the_calls_own(self) -> None:
        assert joined(call(0), {}) == {**call(0), "runs": []}
        assert joined(call(1), {"runs": "torn"})["runs"][0]["ran"] == 1

    def test_is_written_whole_or_not_at_all(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        assert summary_of(tmp_path) == {}
        write(call(1), tmp_path)
        assert summary_of(tmp_path) == call(1)

        def full(*_: Any, **__: Any) -> None:
            raise OSError(errno.ENOSPC, "No space left on device")

        monkeypatch.setattr(os, "replace", full)
        with pytest.raises(Refused, match="the rows are kept"):
            write(call(2), tmp_path)
        assert summary_of(tmp_path) == call(1)

    @pytest.mark.parametrize("text", ["", "{", "[1]", "\xff"])
    def test_that_cannot_be_read_is_none(self, tmp_path: Path, text: str) -> None:
        (tmp_path / "summary.json").write_text(text, encoding="latin-1")
        assert summary_of(tmp_path) == {}


def refused(counts: list[int]) -> Table:
    """So many rows with each sentence, in turn, and a row that is ok."""
    said = [f"why {i}" for i, count in enumerate(counts) for _ in range(count)]
    rows: list[dict[str, Any]] = [{"row": i, "seed": 0, "k": i, "status": "refused", "ticks": 0, "sentence": text}
                                  for i, text in enumerate(said)]
    return Table([*rows, {"row": len(said), "seed": 0, "k": 0, "status": "ok", "ticks": 1}], ("k",), ())


class TestRefusals:
    def test_are_counted_by_their_sentences_the_most_frequent_first(self) -> None:
        counts = sentences(refused([1, 3, 2]))
        assert list(counts.items()) == [("why 1", 3), ("why 2", 2), ("why 0", 1)]

    def test_are_told_under_the_status(self) -> None:
        assert status_rows(refused([1, 3])) == [
            ("status", "5 done: 1 ok, 4 refused"), ("refused", "3 rows: why 1"), ("", "1 row: why 0")]

    def test_of_many_kinds_are_told_in_part(self) -> None:
        assert status_rows(refused([5, 4, 3, 2, 1]))[-2:] == [
            ("", "3 rows: why 2"), ("", "and 2 more sentences in 3 rows, which rows.jsonl has")]

    def test_that_are_none_take_no_line(self) -> None:
        assert status_rows(refused([])) == [("status", "1 done: 1 ok")]
        assert status_rows(Table([], ("k",), ())) == [("status", "0 done: none")]


class TestUnits:
    def test_are_those_that_the_list_of_knobs_shows(self) -> None:
        units = units_of("soft_tissue", ("delay", "law.b"))
        assert {key: unit for key, unit in units.items() if not key.startswith("law.")} == {
            "x_limit": "m", "clutch_ramp": "s", "delay": "s", "k_e": "N/m", "d_e": "N s/m", "amplitude": "m",
            "frequency": "Hz", "observer": "1/s", "dt": "s", "duration": "s"}
        assert (units["law.b"], units["law.K"], units["law.B"]) == ("N s/m", "N/m", "N s/m")

    def test_of_one_name_differ_between_scenes(self) -> None:
        assert units_of("rubber", ())["k_e"] == "N/m^n"
        assert units_of("jittery_wan", ())["jitter"] == "s"
        assert "loss" not in units_of("jittery_wan", ())  # a probability

    @pytest.mark.parametrize("name", built_in_scenes())
    def test_are_known_for_most_knobs_of_every_scene(self, name: str) -> None:
        assert {"dt", "duration"} <= units_of(name, ()).keys()

    def test_of_a_scene_that_is_gone_are_none(self) -> None:
        assert units_of("gone.py", ("k",)) == {}


def test_limits_are_those_of_the_scene_unless_they_are_turned() -> None:
    first = load_scene("soft_tissue", x_limit=0.3)
    assert limits_of(first, ()) == {"duration": 10.0, "x_limit": 0.3}
    assert limits_of(first, ("x_limit",)) == {"duration": 10.0}


class TestAFolder:
    @pytest.fixture
    def folder(self, tmp_path: Path) -> Path:
        sweep("soft_tissue", {"delay": [0.0, 0.05], "k_e": [100.0, 200.0, -1.0]}, fixed={"duration": 0.1},
              out=tmp_path / "s")
        return tmp_path / "s"

    def test_without_a_summary_tells_its_definition_and_its_rows(self, folder: Path) -> None:
        told, text, table = told_of(folder)
        assert (told["scene"], told["done"], len(table)) == ("soft_tissue", 6, 6)
        assert told["counts"] == {"ok": 4, "refused": 2}
        assert "engine" not in text
        assert "refused   2 rows: k_e must be at least 0 N/m, not -1" in text

    def test_with_one_tells_what_ran_it_and_counts_the_rows_as_they_are(self, folder: Path) -> None:
        write(joined(call(4, why="few rows", done=4, rows=6), joined(call(2), {})), folder)
        told, text, _ = told_of(folder)
        assert "engine    vector: few rows" in text
        assert "2 calls ran rows" in text
        assert (told["done"], told["engine"], len(told["runs"]), told["path"]) == (6, "vector", 2, str(folder))
        json.dumps(told)

    def test_is_drawn_with_units_and_limits(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        pytest.importorskip("matplotlib")
        asked: list[Any] = []
        monkeypatch.setattr("teleop.sweeps.pictures.report.draw",
                            lambda *given, **named: asked.append((given, named)) or [given[1]])
        told, _, table = told_of(folder)
        limits = {"x_limit": 0.3, "duration": 5.0}
        request, drawn_in = PictureRequest("metric", "x_err_max"), folder / "sweep"
        assert picture(table, folder, {**told, "limits": limits}, request, trust=False) == [drawn_in]
        picture(table, folder, told, PictureRequest(), trust=True)
        (first, named), (second, bare) = asked
        assert first[1:] == (drawn_in, "metric")
        assert second[2] is None
        assert named["metric"] == "x_err_max"
        assert named["units"]["k_e"] == "N/m"
        assert named["words"] == {"ok": "ok: within 0.3 m for 5 s", "diverged": "diverged: beyond x_limit = 0.3 m"}
        assert bare["words"] == {}
        assert words_of({"limits": {**limits, "x_limit": 1e6}}, {}) == {"ok": "ok: ran 5 s"}, "a bound that bounds none"
