"""Sweeps: rows that are runs, whatever runs them, in any order, after any stop."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from channel.delay import Delay
from teleop import Refused, load_scene, run, sweep
from teleop.laws.direct import Direct, Forth
from teleop.laws.wave import Wave
from teleop.scene.library import ROOT
from teleop.simulation.result import Result
from teleop.sweeps.runner import carry_out, cores, plan_sweep

AXES = {"law": ["wave", "direct", "pfra"], "k_e": [100.0, 400.0]}
FIXED = {"duration": 0.3, "link": "delay(0.01) | uniform(0.02) | bernoulli(0.1)"}


def rows(table: Any) -> list[dict[str, Any]]:
    """Its rows in the order of their numbers."""
    return sorted(({k: v for k, v in row.items() if v is not None} for row in table), key=lambda row: row["row"])


def peak(result: Result) -> float:
    """A figure of the user's own."""
    return float(abs(result.trace["f_m"]).max()) + 1.0


class Backwards(Executor):
    """An executor that does one job at a time, the newest first, when a result is asked for."""

    def __init__(self) -> None:
        self.waiting: list[tuple[Future[Any], Callable[..., Any], tuple[Any, ...]]] = []
        self.pool = ThreadPoolExecutor(1)

    def submit(self, fn: Any, /, *args: Any, **_: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self.waiting.append((future, fn, args))
        self.pool.submit(self._one)
        return future

    def _one(self) -> None:
        future, fn, args = self.waiting.pop()
        future.set_result(fn(*args))


class TestARow:
    @pytest.mark.parametrize("engine", ["plain", "scalar", "vector"])
    def test_is_the_run_of_its_knobs_and_seed(self, engine: str) -> None:
        table = sweep("soft_tissue", AXES, seeds=2, fixed=FIXED, engine=engine,
                      metrics=["x_err_rms", "f_m_max", "E_link_min", "E_port_end", "fresh_fwd", "T_bwd_mean"])
        assert len(table) == 12
        for row in rows(table):
            single = run(load_scene("soft_tissue", **FIXED, law=row["law"], k_e=row["k_e"]), seed=row["seed"])
            assert (row["status"], row["ticks"]) == (single.status, single.ticks)
            for name in ("x_err_rms", "f_m_max", "E_link_min", "E_port_end", "fresh_fwd", "T_bwd_mean"):
                assert row.get(name) == single.metrics.get(name)

    def test_depends_on_no_other_row(self) -> None:
        few = rows(sweep("soft_tissue", {"d_e": [2.0], "k_e": [100.0]}, seeds=[5], fixed=FIXED))
        many = rows(sweep("soft_tissue", {"d_e": [1.0, 2.0, 5.0], "k_e": [50.0, 100.0]}, seeds=[3, 5], fixed=FIXED))
        same = [row for row in many if (row["d_e"], row["k_e"], row["seed"]) == (2.0, 100.0, 5)]
        assert [{**row, "row": 0} for row in same] == few

    def test_has_a_users_own_figure_and_those_that_need_a_record(self) -> None:
        row, = rows(sweep("soft_tissue", {}, fixed=FIXED, metrics=[peak, "E_fwd_min", "f_m_end"]))
        single = run(load_scene("soft_tissue", **FIXED))
        assert row["peak"] == peak(single)
        assert (row["E_fwd_min"], row["f_m_end"]) == (single.metrics["E_fwd_min"], single.metrics["f_m_end"])

    def test_has_the_queue_of_waves_that_are_played_by_their_integral(self) -> None:
        knobs = {"link": "delay(0.02)|bernoulli(0.1)", "duration": 1.0}
        row, = rows(sweep("hard_wall", {}, fixed=knobs, metrics=["queue_fwd_end", "queue_bwd_max"]))
        single = run(load_scene("hard_wall", **knobs)).metrics
        assert (row["queue_fwd_end"], row["queue_bwd_max"]) == (single["queue_fwd_end"], single["queue_bwd_max"])

    def test_that_cannot_be_is_refused_by_itself(self) -> None:
        table = sweep("soft_tissue", {"k_e": [100.0, -1.0]}, fixed=FIXED)
        good, bad = rows(table)
        assert good["status"] == "ok"
        assert bad["status"] == "refused"
        assert "k_e" in bad["sentence"]

    def test_whose_bodies_cannot_be_made_stopped_the_whole_sweep(self) -> None:
        """Friction and electrical damping are known one by one only, which the bodies say, not the scene."""
        good, bad = rows(sweep("virtual_wall", {"friction": [0.0, 0.1]}, fixed={"b_e": 1.0, "duration": 0.1}))
        assert good["status"] == "ok"
        assert bad["status"] == "refused"
        assert "leave one of them out" in bad["sentence"]

    def test_that_diverges_is_a_row(self) -> None:
        row, = rows(sweep("soft_tissue", {"law": ["direct"]}, fixed={**FIXED, "x_limit": 1e-3}))
        single = run(load_scene("soft_tissue", **FIXED, law="direct", x_limit=1e-3))
        assert row["status"] == single.status == "diverged"
        assert row["ticks"] == single.ticks
        assert row["x_err_rms"] == single.metrics["x_err_rms"]


class TestWhoeverRunsIt:
    @pytest.mark.parametrize(
        "executor", [None, Backwards, lambda: ThreadPoolExecutor(3), lambda: ProcessPoolExecutor(2)])
    def test_the_rows_are_the_same(self, executor: Callable[[], Executor] | None) -> None:
        pool = None if executor is None else executor()
        table = sweep("soft_tissue", AXES, seeds=3, fixed=FIXED, executor=pool)
        if pool is not None:
            pool.shutdown()
        one_by_one = sweep("soft_tissue", AXES, seeds=3, fixed=FIXED, executor=ThreadPoolExecutor(1))
        assert rows(table) == rows(one_by_one)

    def test_is_told_how_far_it_has_come(self) -> None:
        told: list[tuple[int, int]] = []
        sweep("soft_tissue", AXES, fixed=FIXED, show=lambda done, of: told.append((done, of)))
        assert told == sorted(told)
        assert told[-1] == (6, 6)


class TestAStop:
    def test_loses_no_row_that_was_finished_and_makes_none_twice(self, tmp_path: Path) -> None:
        def stop(done: int, _: int) -> None:
            if done >= 4:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            sweep("soft_tissue", AXES, seeds=4, fixed=FIXED, out=tmp_path / "s", show=stop)
        lines = (tmp_path / "s" / "rows.jsonl").read_text().splitlines()
        assert 4 <= len(lines) < 24
        table = sweep("soft_tissue", AXES, seeds=4, fixed=FIXED, out=tmp_path / "s")
        assert [row["row"] for row in rows(table)] == list(range(24))
        assert rows(table) == rows(sweep("soft_tissue", AXES, seeds=4, fixed=FIXED))
        written = [json.loads(line)["row"] for line in (tmp_path / "s" / "rows.jsonl").read_text().splitlines()]
        assert sorted(written) == list(range(24))

    def test_of_another_sweep_is_not_gone_on_with(self, tmp_path: Path) -> None:
        sweep("soft_tissue", {"d_e": [0.0]}, fixed=FIXED, out=tmp_path / "s")
        for other in ({"axes": {"d_e": [0.1]}}, {"fixed": {**FIXED, "k_e": 3.0}}, {"metrics": ["f_m_max"]}):
            with pytest.raises(Refused):
                sweep("soft_tissue", **{"axes": {"d_e": [0.0]}, "fixed": FIXED, "out": tmp_path / "s", **other})  # type: ignore[arg-type]  # one of them is other


class Water:
    """A link that says nothing of itself but where it lies in memory."""

    def arrivals(self, *given: Any) -> Any:
        return Delay(0.01).arrivals(*given)


def test_a_part_that_reads_differently_at_every_start_is_refused_before_its_folder_is_made(tmp_path: Path) -> None:
    """Such a folder could never be gone on with."""
    with pytest.raises(Refused, match="link"):
        sweep("soft_tissue", {}, fixed={"link": Water(), "duration": 0.1}, out=tmp_path / "s")
    assert not (tmp_path / "s").exists()


OWN = """
from teleop import load_scene

def scene(*, k_e: float = 100.0):
    return load_scene("soft_tissue", duration={duration}, k_e=k_e)
"""


def test_rows_of_an_edited_scene_file_do_not_join_those_of_before(tmp_path: Path) -> None:
    own, axes = tmp_path / "own.py", {"k_e": [50.0, 100.0]}
    own.write_text(OWN.replace("{duration}", "0.1"))
    sweep(own, axes, out=tmp_path / "s")
    sweep(own, axes, out=tmp_path / "s")
    own.write_text(OWN.replace("{duration}", "0.2"))
    with pytest.raises(Refused, match="sources"):
        sweep(own, axes, out=tmp_path / "s")


def test_a_number_typed_otherwise_is_the_same_sweep(tmp_path: Path) -> None:
    for typed in ("0.1", "0.10", 0.1):
        assert len(sweep("soft_tissue", {}, fixed={"duration": typed}, out=tmp_path / "s")) == 1


@pytest.mark.parametrize("engine", ["plain", "scalar", "vector"])
@pytest.mark.parametrize("metrics", [[], ["fresh_fwd"], ["g_m_min"], ["E_link_min"]])
def test_a_kernel_that_is_asked_for_no_figure_of_its_own_runs_all_the_same(engine: str, metrics: list[str]) -> None:
    fixed = {"duration": 0.1, "law": "direct"}
    row, = rows(sweep("soft_tissue", {}, fixed=fixed, metrics=metrics, engine=engine))
    single = run(load_scene("soft_tissue", **fixed))
    assert (row["status"], row["ticks"]) == (single.status, single.ticks)
    assert {name: row[name] for name in metrics if name in row} == {
        name: single.metrics[name] for name in metrics if name in single.metrics}


def test_a_law_with_a_field_that_is_no_number_runs_in_plain_python_and_the_sweep_says_so() -> None:
    plan = plan_sweep("soft_tissue", {}, fixed={"law": Moody(), "duration": 0.05}, engine="vector")
    carry_out(plan)
    ((engine, why), count), = plan.ran.items()
    assert (engine, count) == ("plain", 1)
    assert "mode='calm'" in why


def test_what_numba_cannot_take_is_said_in_its_own_words() -> None:
    plan = plan_sweep("soft_tissue", {}, fixed={"law": Rooted(), "duration": 0.05}, engine="scalar")
    carry_out(plan)
    ((engine, why), _), = plan.ran.items()
    assert engine == "plain"
    assert why.startswith("UnsupportedBytecodeError: Use of unsupported opcode")
    assert "During" not in why


def test_figures_that_need_a_record_are_said_to_be_run_in_plain_python() -> None:
    plan = plan_sweep("canonical", {"k_e": [1e3 + n for n in range(400)]}, metrics=["x_err_rms", "E_fwd_min"])
    assert (plan.engine, plan.why) == ("plain", "a metric needs the whole record of a run")


@pytest.mark.parametrize("metrics", [["x_err_rms"], ["E_fwd_min", "x_err_rms"]])
def test_a_law_that_divides_by_zero_in_one_row_loses_no_other(metrics: list[str]) -> None:
    laws = [Divides(K=300.0), Divides(K=0.0)]
    good, bad = rows(sweep("canonical", {"law": laws}, fixed={"duration": 0.1}, metrics=metrics, engine="plain"))
    assert bad["status"] == "refused"
    assert re.match(r"Divides\.slave \(.*test_runner\.py:\d+\) raised ZeroDivisionError: .*; guard", bad["sentence"])
    assert good["status"] == "ok"


@dataclass(frozen=True, kw_only=True)
class Divides(Wave):
    def slave(self, s: Any, at: Any, rx: Any) -> Any:
        return super().slave(s, at._replace(x=at.x + 0.0 / self.K), rx)


@dataclass(frozen=True, kw_only=True)
class Moody(Direct):
    mode: str = "calm"


@dataclass(frozen=True, kw_only=True)
class Rooted(Direct):
    def master(self, s: Any, at: Any, rx: Any) -> Any:
        return rx.f_env * hypot3(1.0, **{}), Forth(at.x, at.v), s


def hypot3(x: float, **_: float) -> float:
    return x


def test_the_usual_figures_are_those_that_any_law_of_the_grid_has() -> None:
    for laws in (["direct", "wave"], ["wave", "direct"]):
        assert "E_link_min" in plan_sweep("canonical", {"law": laws}).definition()["metrics"]


def test_rows_that_grow_dear_are_not_handed_out_by_the_thousand() -> None:
    """The first half of the rows takes nothing, for they are refused at once."""
    sizes: list[int] = []

    class Watched(Backwards):
        def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Any:
            sizes.append(len(args[0].rows))
            return super().submit(fn, *args, **kwargs)

    ranges = {"duration": [0.01] + [-1.0] * 300 + [3.0] * 60}
    sweep("soft_tissue", ranges, metrics=["x_err_rms"], engine="plain", executor=Watched())
    assert max(b / a for a, b in pairwise(sizes)) <= 4.0


def test_what_a_folder_is_held_to_is_the_value_of_every_knob() -> None:
    plan = plan_sweep("soft_tissue", {"delay": [0.0]}, fixed={"law": Wave(b=3.0)})
    assert plan.definition() == plan_sweep("soft_tissue", {"delay": [0.0]}, fixed={"law": Wave(b=3.0)}).definition()
    assert plan.definition() != plan_sweep("soft_tissue", {"delay": [0.0]}, fixed={"law": Wave(b=4.0)}).definition()


class TestAWrongRequest:
    @pytest.mark.parametrize(("request_", "words"), [
        ({"axes": {"stiffness": [1.0]}}, "no knob 'stiffness'"),
        ({"axes": {"delay": []}}, "no values"),
        ({"metrics": ["x_err"]}, r"no metric 'x_err'; did you mean"),
        ({"engine": "vector9"}, "no engine"),
        ({"axes": {"delay": [0.1]}, "fixed": {"delay": 0.2}}, "leave one of them out"),
        ({"seeds": 0}, "seed"),
    ])
    def test_is_refused_before_anything_runs(self, request_: dict[str, Any], words: str) -> None:
        with pytest.raises(Refused, match=words):
            plan_sweep("soft_tissue", **{"axes": {}, **request_})

    def test_without_numba_an_engine_that_needs_it_says_what_to_install(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
        with pytest.raises(Refused, match=r"pip install 'bilateral-teleop\[batch\]'"):
            plan_sweep("soft_tissue", engine="scalar")
        assert plan_sweep("satellite", {"delay": [0.1 * i for i in range(100)]}).engine == "plain"


class TestTheCommand:
    def typed(self, folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([sys.executable, "-m", "scenarios", "sweep", *words], cwd=folder, text=True, check=False,
                              capture_output=True, env={"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin"})

    def test_leaves_a_folder_and_goes_on_there(self, tmp_path: Path) -> None:
        words = ["soft_tissue", "--grid", "law=wave,direct", "delay=0:0.04:3", "--seeds", "2", "--set", "duration=0.2"]
        first = self.typed(tmp_path, *words)
        assert first.returncode == 0, first.stderr
        assert "12 done: 12 ok" in first.stdout
        folder = tmp_path / "runs" / "soft_tissue-sweep"
        again = self.typed(tmp_path, *words, "--json")
        told = json.loads(again.stdout)
        assert (told["done"], told["ran"]) == (12, 0)
        assert told["counts"] == {"ok": 12}
        assert len((folder / "rows.jsonl").read_text().splitlines()) == 12
        left = json.loads((folder / "summary.json").read_text())
        assert {name: left[name] for name in ("engine", "why", "counts", "rows", "versions")} == {
            name: told[name] for name in ("engine", "why", "counts", "rows", "versions")}
        assert left["engine"] == "plain"
        other = self.typed(tmp_path, *words[:-1], "duration=0.3")
        assert other.returncode == 2
        assert other.stderr.count("\n") == 1

    @pytest.mark.parametrize("way", ["--latin", "--random"])
    def test_draws_points_from_ranges(self, way: str, tmp_path: Path) -> None:
        words = ["soft_tissue", "--grid", "delay=0:0.05", "k_e=1e2:1e4:log", way, "7"]
        words += ["--set", "duration=0.1", "--json"]
        told = json.loads(self.typed(tmp_path, *words).stdout)
        assert (told["done"], told["rows"]) == (7, 7)
        assert json.loads(self.typed(tmp_path, *words).stdout)["ran"] == 0  # the same points again
        lines = (tmp_path / "runs/soft_tissue-sweep/rows.jsonl").read_text().splitlines()
        delays = sorted(json.loads(line)["delay"] for line in lines)
        assert 0.0 <= delays[0] < delays[-1] <= 0.05
        if way == "--latin":
            assert [int(delay / 0.05 * 7) for delay in delays] == list(range(7))

    @pytest.mark.parametrize(("words", "said"), [
        (["soft_tissue", "--grid", "delay=0:1", "--latin", "3", "--random", "3"], "leave one of them out"),
        (["soft_tissue", "--grid", "delay="], "delay"), (["soft_tissue", "--grid", "stiff=1,2"], "no knob"),
        (["soft_tissue", "--grid", "delay=0:1:3", "k_e=1:2:100000", "--seeds", "100000"], "--yes"),
        (["nowhere", "--grid", "delay=1"], "no scene"),
    ])
    def test_refuses_in_one_sentence(self, words: list[str], said: str, tmp_path: Path) -> None:
        got = self.typed(tmp_path, *words)
        assert got.returncode == 2
        assert got.stderr.count("\n") == 1
        assert said in got.stderr
        assert not (tmp_path / "runs").exists()


class TestWorkers:
    def test_are_as_many_as_this_process_may_use_cores(self) -> None:
        plan = plan_sweep("soft_tissue", {"k_e": [50.0, 100.0]}, fixed=FIXED)
        assert plan.workers == 0
        carry_out(plan)
        assert plan.workers == cores() >= 1

    def test_are_those_that_were_asked_for(self) -> None:
        plan = plan_sweep("soft_tissue", {"k_e": [50.0, 100.0]}, fixed=FIXED)
        carry_out(plan, workers=3)
        assert plan.workers == 3

    def test_are_a_whole_number_or_nothing_is_written(self, tmp_path: Path) -> None:
        with pytest.raises(Refused, match="workers must be a whole number from 1"):
            sweep("soft_tissue", {}, workers=0, out=tmp_path / "s")
        assert not (tmp_path / "s").exists()
