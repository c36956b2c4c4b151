"""`teleop sweep` and `teleop report` of a sweep, as somebody types them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from shlex import split
from typing import Any

import pytest

import teleop.sweeps.runner
import teleop.terminal.plotting

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

    def test_while_it_runs_begins_at_once_with_what_is_there(
        self, typed: Typed, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        shown: list[tuple[int, int]] = []
        monkeypatch.setattr("teleop.terminal.progress.RowsProgress.show",
                            lambda _, done, of, __: shown.append((done, of)))
        words = ("sweep", "soft_tissue", "--grid", "k_e=1:3:3", *SHORT)
        typed(*words)
        assert shown[0] == (0, 3)
        assert shown[-1] == (3, 3)
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


class TestTheRowsThatAreNotShown:
    def test_had_no_word_on_how_to_see_them(self, typed: Typed) -> None:
        said = typed("sweep", "soft_tissue", "--grid", "k_e=1:9:9", *SHORT, "--out", "my rows").out
        line = next(line for line in said.splitlines() if line.startswith("... and"))
        assert line == "... and 3 more: teleop report 'my rows' --rows 9"
        every = typed(*split(line.partition("teleop ")[2])).out
        assert [line.split()[2] for line in every.splitlines()[-10:-1]] == [str(k_e) for k_e in range(1, 10)]
        assert "... and 7 more: teleop report 'my rows' --rows 9" in typed("report", "my rows", "--rows", "2").out

    def test_are_of_a_sweep_alone(self, typed: Typed) -> None:
        typed("run", "local", *SHORT, "--out", "one")
        typed("report", "one", "--rows", "3").assert_refused("holds a run", "leave --rows out")


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

    def test_tells_engine_and_why_and_what_it_drew(self, swept: Typed) -> None:
        pytest.importorskip("matplotlib")
        answer = swept("report", str(FOLDER), "--plot")
        assert answer.code == 0
        assert "engine   plain: about" in answer.out
        assert f"\nplot: {FOLDER / 'sweep.png'}\n" in answer.out
        assert (FOLDER / "sweep.png").read_bytes().startswith(b"\x89PNG")

    def test_with_json_is_the_summary_that_is_there(self, swept: Typed) -> None:
        stored = json.loads((FOLDER / "summary.json").read_text())
        assert json.loads(swept("report", str(FOLDER), "--json").out) == stored
        assert not (FOLDER / "sweep.png").exists()

    @pytest.mark.full
    def test_with_another_metric_leaves_the_picture_of_the_first(self, swept: Typed) -> None:
        pytest.importorskip("matplotlib")
        for metric, name in (("x_err_rms", "sweep.png"), ("f_m_max", "sweep-2.png"), ("x_err_rms", "sweep.png")):
            assert f"\nplot: {FOLDER / name}\n" in swept("report", str(FOLDER), "--metric", metric).out

    def test_without_matplotlib_draws_nothing_unless_it_is_asked_to(
        self, swept: Typed, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(teleop.terminal.plotting, "find_spec", lambda _: None)
        assert "plot" not in swept("report", str(FOLDER)).out
        swept("report", str(FOLDER), "--picture", "curves").assert_refused("pip install")

    def test_of_a_picture_that_cannot_be_is_refused(self, swept: Typed) -> None:
        pytest.importorskip("matplotlib")
        swept("report", str(FOLDER), "--picture", "heat").assert_refused("there is no picture 'heat'")

    def test_of_a_folder_without_either_teaches(self, swept: Typed) -> None:
        swept("report", "nowhere").assert_refused("there is no folder nowhere", "teleop sweep")
        swept("report", "runs").assert_refused(f"such as {FOLDER}")
        Path("empty").mkdir()
        swept("report", "empty").assert_refused("no run and no sweep")

    def test_of_a_run_has_one_plot(self, typed: Typed) -> None:
        typed("run", "canonical", *SHORT, "--out", "here")
        typed("report", "here", "--metric", "x_err_max").assert_refused("which has one plot")
