"""`teleop sweep`, its summary and its report, as somebody types them."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable
from pathlib import Path
from shlex import split
from typing import Any

import pytest

import teleop.sweeps.runner
import teleop.terminal.plotting
from teleop import Refused, Table, load_scene, sweep
from teleop.scene.library import built_in_scenes
from teleop.sweeps.pictures.report import (
    PictureRequest,
    joined,
    limits_of,
    picture,
    status_rows,
    summary_of,
    told_of,
    units_of,
    words_of,
    write,
)

Typed = Callable[..., Any]

SHORT = ("--set", "duration=0.1")
FOLDER = Path("runs/soft_tissue-sweep")


class TestTheGrid:
    def test_is_joined_from_all_that_are_typed(self, typed: Typed) -> None:
        words = ("--grid", "delay=0,0.01", "--grid", "k_e=100,200", "d_e=1,2")
        assert json.loads(typed("sweep", "soft_tissue", *words, *SHORT, "--json").out)["rows"] == 8

    def test_of_laws_lost_the_scenes_gains_and_showed_none(self, typed: Typed) -> None:
        shown = typed("sweep", "hard_wall", "--grid", "law=wave,pfra", "k_e=100,200", *SHORT).out
        assert "law      wave(b=20, K=1000, B=20)\nlaw      pfra(alpha=0, " in shown
        assert "note     law pfra runs with its defaults, which are not tuned for scene hard_wall" in shown

    def test_with_a_number_out_of_bounds_behind_a_good_one_refuses_that_row_alone(self, typed: Typed) -> None:
        document = json.loads(typed("sweep", "soft_tissue", "--grid", "k_e=100,-5", *SHORT, "--json").out)
        assert document["counts"] == {"ok": 1, "refused": 1}

    def test_that_differs_from_that_of_the_folder_was_told_by_its_place_in_a_file(self, typed: Typed) -> None:
        typed("sweep", "soft_tissue", "--grid", "k_e=1,2", *SHORT)
        for words, said in ((("k_e=1,3", *SHORT), "value 2 of k_e is 2 there and 3 here"),
                            (("k_e=1,2", "--set", "duration=0.2"), "sweep: duration is 0.1 there and 0.2 here"),
                            (("k_e=1,2", *SHORT, "--seeds", "2"), "the number of seeds is 1 there and 2 here")):
            typed("sweep", "soft_tissue", "--grid", *words).assert_refused(said)


    def test_leaves_a_folder_and_goes_on_there(self, typed: Typed) -> None:
        words = ["soft_tissue", "--grid", "law=wave,direct", "delay=0:0.04:3", "--seeds", "2", *SHORT]
        first = typed("sweep", *words)
        assert "12 done: 12 ok" in first.out, first.err
        told = json.loads(typed("sweep", *words, "--json").out)
        assert (told["done"], told["ran"], told["counts"]) == (12, 0, {"ok": 12})
        assert len((FOLDER / "rows.jsonl").read_text().splitlines()) == 12
        left = json.loads((FOLDER / "summary.json").read_text())
        for name in ("engine", "why", "counts", "rows", "versions"):
            assert left[name] == told[name], name
        assert left["engine"] == "plain"

    @pytest.mark.parametrize("way", ["--latin", "--random"])
    def test_draws_points_from_ranges(self, typed: Typed, way: str) -> None:
        words = ("sweep", "soft_tissue", "--grid", "delay=0:0.05", "k_e=1e2:1e4:log", way, "7", *SHORT, "--json")
        told = json.loads(typed(*words).out)
        assert (told["done"], told["rows"]) == (7, 7)
        assert json.loads(typed(*words).out)["ran"] == 0  # the same points again
        delays = sorted(json.loads(line)["delay"] for line in (FOLDER / "rows.jsonl").read_text().splitlines())
        assert 0.0 <= delays[0] < delays[-1] <= 0.05
        if way == "--latin":
            assert [int(delay / 0.05 * 7) for delay in delays] == list(range(7))


class TestWhatIsTold:
    def test_of_refused_rows_is_why(self, typed: Typed) -> None:
        answer = typed("sweep", "soft_tissue", "--grid", "k_e=1,-1,-2", "d_e=1,2", *SHORT)
        assert "refused   2 rows: k_e must be at least 0 N/m, not -1" in answer.out
        assert "          2 rows: k_e must be at least 0 N/m, not -2" in answer.out
        assert "refused   2 rows: k_e" in typed("report", str(FOLDER)).out

    def test_while_it_runs_begins_with_what_is_there(self, typed: Typed, monkeypatch: pytest.MonkeyPatch) -> None:
        shown: list[tuple[int, int]] = []
        monkeypatch.setattr("teleop.terminal.progress.RowsProgress.show",
                            lambda _, done, of, __: shown.append((done, of)))
        words = ("sweep", "soft_tissue", "--grid", "k_e=1:3:3", *SHORT)
        typed(*words)
        assert (shown[0], shown[-1]) == ((0, 3), (3, 3))
        assert shown == sorted(shown)
        shown.clear()
        typed(*words)
        assert {*shown} == {(3, 3)}

    def test_of_a_finished_sweep_keeps_what_ran_it(self, typed: Typed) -> None:
        words = ("sweep", "soft_tissue", "--grid", "k_e=1:3:3", *SHORT)
        typed(*words, "--engine", "plain")
        first = json.loads((FOLDER / "summary.json").read_text())
        again = typed(*words)
        assert "engine   none, for no row was left to run" in again.out
        second = json.loads((FOLDER / "summary.json").read_text())
        assert second == first
        assert [run["ran"] for run in second["runs"]] == [3]
        assert second["why"] == "as asked for"
        assert json.loads(typed(*words, "--json").out)["ran"] == 0

    def test_of_one_that_goes_on_has_both_calls(self, typed: Typed) -> None:
        words = ("sweep", "soft_tissue", "--grid", "k_e=1:3:3", *SHORT)
        typed(*words)
        rows = FOLDER / "rows.jsonl"
        rows.write_text("".join(rows.read_text().splitlines(keepends=True)[:1]))
        typed(*words, "--engine", "plain")
        runs = json.loads((FOLDER / "summary.json").read_text())["runs"]
        assert [run["ran"] for run in runs] == [3, 2]
        assert [run["command"][-1] for run in runs] == ["duration=0.1", "plain"]
        assert "done" not in runs[0]


    def test_of_one_that_was_stopped_before_its_first_row_is_that_it_goes_on(
        self, typed: Typed, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        pytest.importorskip("matplotlib")

        def stop(*_: object) -> None:
            raise KeyboardInterrupt

        monkeypatch.setattr(teleop.sweeps.runner, "work", stop)
        answer = typed("sweep", "soft_tissue", "--grid", "k_e=1:3:3", *SHORT, "--plot")
        assert answer.code == 130
        out = answer.out
        assert "engine   plain: about" in out
        assert "no plot: no row is there yet" in out
        assert "the same command goes on" in out
        assert json.loads((FOLDER / "summary.json").read_text())["runs"] == []


    def test_of_rows_that_are_not_shown_had_no_word_on_how_to_see_them(self, typed: Typed) -> None:
        said = typed("sweep", "soft_tissue", "--grid", "k_e=1:9:9", *SHORT, "--out", "my rows").out
        line = next(line for line in said.splitlines() if line.startswith("... and"))
        assert line == "... and 3 more: teleop report 'my rows' --rows 9"
        every = typed(*split(line.partition("teleop ")[2])).out
        assert [line.split()[2] for line in every.splitlines()[-10:-1]] == [str(k_e) for k_e in range(1, 10)]
        assert "... and 7 more: teleop report 'my rows' --rows 9" in typed("report", "my rows", "--rows", "2").out


class TestThePicture:
    def test_that_the_grid_cannot_give_is_refused_before_a_row_runs(self, typed: Typed) -> None:
        pytest.importorskip("matplotlib")
        for words, sentence in (
                (["k_e=1", "--plot"], "widen the grid"),
                (["k_e=1,2", "--picture", "stability"], "two knobs with numbers"),
                (["k_e=1,2", "--picture", "heat"], "no picture"), (["k_e=1,2", "--metric", "x_err"], "did you mean"),
                (["k_e=1,1", "--plot"], "several values"),
                (["law=wave,pfra", "k_e=1,2", "--picture", "metric"], "two knobs")):
            typed("sweep", "soft_tissue", *SHORT, "--grid", *words).assert_refused(sentence)
        assert not Path("runs").exists()

    @pytest.mark.parametrize(("words", "kind", "metric"), [
        (["--plot"], None, None), (["--picture", "metric"], "metric", None), (["--metric", "f_m_max"], None, "f_m_max"),
    ])
    def test_is_the_one_that_is_asked_for(
        self, typed: Typed, monkeypatch: pytest.MonkeyPatch, words: list[str], kind: str | None, metric: str | None
    ) -> None:
        pytest.importorskip("matplotlib")
        asked: list[Any] = []
        monkeypatch.setattr("teleop.sweeps.pictures.report.draw",
                            lambda *given, **named: asked.append((given[2], named["metric"])) or [given[1]])
        answer = typed("sweep", "soft_tissue", *SHORT, "--grid", "delay=0,0.1", "k_e=1,2", *words)
        assert answer.out.endswith(f"plot: {FOLDER / 'sweep'}\n")
        typed("report", str(FOLDER), *words)
        assert asked == [(kind, metric)] * 2

    def test_that_fails_after_the_rows_costs_nothing_else(self, typed: Typed, monkeypatch: pytest.MonkeyPatch) -> None:
        pytest.importorskip("matplotlib")

        def forbidden(*_: object, **__: object) -> None:
            raise PermissionError(13, "Permission denied")

        monkeypatch.setattr(teleop.terminal.plotting, "replacing", forbidden)
        answer = typed("sweep", "soft_tissue", *SHORT, "--grid", "k_e=1,2", "--plot")
        assert answer.code == 0
        assert "no plot: could not write" in answer.out
        assert json.loads((FOLDER / "summary.json").read_text())["done"] == 2


class TestReport:
    @pytest.fixture
    def swept(self, typed: Typed) -> Typed:
        typed("sweep", "soft_tissue", "--grid", "delay=0,0.1", "k_e=1,2", *SHORT)
        return typed

    def test_tells_engine_and_why_and_what_it_drew_and_with_json_the_summary_that_is_there(self, swept: Typed) -> None:
        pytest.importorskip("matplotlib")
        stored = json.loads((FOLDER / "summary.json").read_text())
        assert json.loads(swept("report", str(FOLDER), "--json").out) == stored
        assert not (FOLDER / "sweep.png").exists()
        answer = swept("report", str(FOLDER), "--plot")
        assert answer.code == 0
        assert "engine   plain: about" in answer.out
        assert f"\nplot: {FOLDER / 'sweep.png'}\n" in answer.out
        assert (FOLDER / "sweep.png").read_bytes().startswith(b"\x89PNG")

    @pytest.mark.full
    def test_with_another_metric_leaves_the_picture_of_the_first(self, swept: Typed) -> None:
        pytest.importorskip("matplotlib")
        for metric, name in (("x_err_rms", "sweep.png"), ("f_m_max", "sweep-2.png"), ("x_err_rms", "sweep.png")):
            assert f"\nplot: {FOLDER / name}\n" in swept("report", str(FOLDER), "--metric", metric).out

    def test_without_matplotlib_draws_nothing_unless_asked(self, swept: Typed, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(teleop.terminal.plotting, "find_spec", lambda _: None)
        assert "plot" not in swept("report", str(FOLDER)).out
        swept("report", str(FOLDER), "--picture", "curves").assert_refused("pip install")

    def test_of_another_folder_or_a_picture_that_cannot_be_is_refused(self, swept: Typed) -> None:
        pytest.importorskip("matplotlib")
        swept("report", str(FOLDER), "--picture", "heat").assert_refused("there is no picture 'heat'")
        swept("report", "runs").assert_refused(f"such as {FOLDER}")
        swept("run", "canonical", *SHORT, "--out", "here")
        swept("report", "here", "--metric", "x_err_max").assert_refused("which has one plot")
        swept("report", "here", "--rows", "3").assert_refused("holds a run", "leave --rows out")


def call(ran: int, engine: str = "vector", **rest: Any) -> dict[str, Any]:
    return {"command": ["teleop", engine], "engine": engine, "why": "w", "ran": ran, "seconds": float(ran),
            "done": 10, "path": "p", **rest}


class TestASummary:
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


def refused(counts: list[int]) -> Table:
    """So many rows with each sentence, in turn, and a row that is ok."""
    said = [f"why {i}" for i, count in enumerate(counts) for _ in range(count)]
    rows: list[dict[str, Any]] = [{"row": i, "seed": 0, "k": i, "status": "refused", "ticks": 0, "sentence": text}
                                  for i, text in enumerate(said)]
    return Table([*rows, {"row": len(said), "seed": 0, "k": 0, "status": "ok", "ticks": 1}], ("k",), ())


class TestRefusals:
    def test_are_told_by_their_sentences_the_most_frequent_first_and_of_many_kinds_in_part(self) -> None:
        assert status_rows(refused([1, 3])) == [
            ("status", "5 done: 1 ok, 4 refused"), ("refused", "3 rows: why 1"), ("", "1 row: why 0")]
        assert status_rows(refused([5, 4, 3, 2, 1]))[-2:] == [
            ("", "3 rows: why 2"), ("", "and 2 more sentences in 3 rows, which rows.jsonl has")]
        assert status_rows(refused([])) == [("status", "1 done: 1 ok")]
        assert status_rows(Table([], ("k",), ())) == [("status", "0 done: none")]


class TestUnits:
    def test_are_those_that_the_list_of_knobs_shows(self) -> None:
        units = units_of("soft_tissue", ("delay", "law.b"))
        assert {key: unit for key, unit in units.items() if not key.startswith("law.")} == {
            "x_limit": "m", "clutch_ramp": "s", "delay": "s", "k_e": "N/m", "d_e": "N s/m", "amplitude": "m",
            "frequency": "Hz", "observer": "1/s", "dt": "s", "duration": "s"}
        assert (units["law.b"], units["law.K"], units["law.B"]) == ("N s/m", "N/m", "N s/m")

    def test_of_one_name_differ_between_scenes_and_of_one_that_is_gone_are_none(self) -> None:
        assert units_of("rubber", ())["k_e"] == "N/m^n"
        assert units_of("jittery_wan", ())["jitter"] == "s"
        assert "loss" not in units_of("jittery_wan", ())  # a probability
        assert all({"dt", "duration"} <= units_of(name, ()).keys() for name in built_in_scenes())
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

    def test_tells_its_definition_its_rows_as_they_are_and_with_a_summary_what_ran_it(self, folder: Path) -> None:
        told, text, table = told_of(folder)
        assert (told["scene"], told["done"], len(table)) == ("soft_tissue", 6, 6)
        assert told["counts"] == {"ok": 4, "refused": 2}
        assert "engine" not in text
        assert "refused   2 rows: k_e must be at least 0 N/m, not -1" in text
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
