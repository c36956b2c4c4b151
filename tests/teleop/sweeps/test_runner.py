"""Sweeps: rows that are runs, whatever runs them, in any order, after any stop."""

from __future__ import annotations

import json
import re
import signal
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from threading import Event
from typing import Any

import pytest

import teleop.sweeps.runner
from channel.delay import Delay
from teleop import Direct, Refused, Result, Wave, load_scene, run, sweep
from teleop.laws.direct import Forth
from teleop.sweeps.chunk import ChunkResult, Job, work
from teleop.sweeps.runner import carry_out, cores, plan_sweep
from tests.programs import COMPILERS, compiler_of, program

AXES = {"law": ["wave", "direct", "pfra"], "k_e": [100.0, 400.0]}
FIXED = {"duration": 0.3, "link": "delay(0.01) | uniform(0.02) | bernoulli(0.1)"}


def rows(table: Any) -> list[dict[str, Any]]:
    """Its rows in the order of their numbers."""
    return sorted(({k: v for k, v in row.items() if v is not None} for row in table), key=lambda row: row["row"])


def peak(result: Result) -> float:
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
    @pytest.mark.parametrize("engine", ["plain", pytest.param("c", marks=pytest.mark.full), "vector"])
    def test_is_the_run_of_its_knobs_and_seed(self, engine: str) -> None:
        compiler_of(engine)
        axes = AXES if engine == "plain" else {**AXES, "law": ["wave"]}
        table = sweep("soft_tissue", axes, seeds=2, fixed=FIXED, engine=engine,
                      metrics=["x_err_rms", "f_m_max", "E_link_min", "E_port_end", "fresh_fwd", "T_bwd_mean"])
        assert len(table) == 4 * len(axes["law"])
        for row in rows(table):
            single = run(load_scene("soft_tissue", **FIXED, law=row["law"], k_e=row["k_e"]), seed=row["seed"])
            assert (row["status"], row["ticks"]) == (single.status, single.ticks)
            for name in ("x_err_rms", "f_m_max", "E_link_min", "E_port_end", "fresh_fwd", "T_bwd_mean"):
                assert row.get(name) == single.metrics.get(name)

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

    def test_that_cannot_be_is_refused_by_itself_and_one_whose_bodies_cannot_be_made_stopped_the_sweep(self) -> None:
        """Friction and electrical damping are known one by one only, which the bodies say, not the scene."""
        for scene, axes, fixed, words in (
                ("soft_tissue", {"k_e": [100.0, -1.0]}, FIXED, "k_e"),
                ("virtual_wall", {"friction": [0.0, 0.1]}, {"b_e": 1.0, "duration": 0.1}, "leave one of them out")):
            good, bad = rows(sweep(scene, axes, fixed=fixed))
            assert (good["status"], bad["status"]) == ("ok", "refused")
            assert words in bad["sentence"]


def test_whoever_runs_it_the_rows_are_the_same() -> None:
    one_by_one = rows(sweep("soft_tissue", AXES, seeds=3, fixed=FIXED))
    for pool in (Backwards(), ThreadPoolExecutor(1), ThreadPoolExecutor(3), ProcessPoolExecutor(2)):
        with pool:
            assert rows(sweep("soft_tissue", AXES, seeds=3, fixed=FIXED, executor=pool)) == one_by_one, pool


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


@pytest.mark.parametrize(("engine", "metrics"), [
    *[("plain", metrics) for metrics in ([], ["fresh_fwd"], ["g_m_min"], ["E_link_min"])], ("vector", []),
    *[pytest.param(*each, marks=pytest.mark.full) for each in (
        ("c", []), ("vector", ["fresh_fwd"]), ("vector", ["g_m_min"]), ("vector", ["E_link_min"]))]])


def test_a_kernel_that_is_asked_for_no_figure_of_its_own_runs_all_the_same(engine: str, metrics: list[str]) -> None:
    compiler_of(engine)
    fixed = {"duration": 0.1, "law": "direct", "energy": bool(metrics)}
    row, = rows(sweep("soft_tissue", {}, fixed=fixed, metrics=metrics, engine=engine))
    single = run(load_scene("soft_tissue", **fixed))
    assert (row["status"], row["ticks"]) == (single.status, single.ticks)
    assert {name: row[name] for name in metrics if name in row} == {
        name: single.metrics[name] for name in metrics if name in single.metrics}


def test_a_law_with_a_field_that_is_no_number_runs_in_plain_python_and_the_sweep_says_so() -> None:
    compiler_of("vector")
    plan = plan_sweep("soft_tissue", {}, fixed={"law": Moody(), "duration": 0.05}, engine="vector")
    carry_out(plan)
    ((engine, why), count), = plan.ran.items()
    assert (engine, count) == ("plain", 1)
    assert "mode='calm'" in why


def test_what_has_no_line_in_c_is_said_with_its_file_and_line() -> None:
    program(*COMPILERS)
    plan = plan_sweep("soft_tissue", {}, fixed={"law": Rooted(), "duration": 0.05}, engine="vector")
    carry_out(plan)
    ((engine, why), _), = plan.ran.items()
    assert engine == "plain"
    assert re.search(r"test_runner.py:\d+: .*has no line in C", why), why


def test_a_plan_has_the_figures_of_any_law_of_its_grid_the_value_of_every_knob_and_says_what_needs_a_record() -> None:
    for laws in (["direct", "wave"], ["wave", "direct"]):
        assert "E_link_min" in plan_sweep("canonical", {"law": laws}).definition()["metrics"]
    one, same, other = (plan_sweep("soft_tissue", {"delay": [0.0]}, fixed={"law": Wave(b=b)}) for b in (3.0, 3.0, 4.0))
    assert one.definition() == same.definition() != other.definition()
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


@pytest.mark.full
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


class TestAWrongRequest:
    def test_is_refused_before_anything_runs(self) -> None:
        for axes, other, words in (({}, {"metrics": ["x_err"]}, r"no metric 'x_err'; did you mean"),
                                   ({"delay": [0.1]}, {"fixed": {"delay": 0.2}}, "leave one of them out"),
                                   ({}, {"seeds": 0}, "seed")):
            with pytest.raises(Refused, match=words):
                plan_sweep("soft_tissue", axes, **other)  # of other kinds

    def test_without_a_compiler_an_engine_says_what_to_install(self, monkeypatch: pytest.MonkeyPatch) -> None:
        grid = {"delay": [0.1 * i for i in range(100)]}
        for compiler, engine in (("/usr/bin/cc", "c"), (None, "plain")):
            monkeypatch.setattr("teleop.emit.compiler.find_compiler", lambda compiler=compiler: compiler)
            assert plan_sweep("satellite", grid).engine == engine
        assert "there is no C compiler; with gcc or clang installed" in plan_sweep("satellite", grid).why
        for engine in ("c", "vector"):
            with pytest.raises(Refused, match=rf"engine {engine} needs a C compiler \(cc, gcc or clang\), and none is"):
                plan_sweep("soft_tissue", engine=engine)


def test_workers_are_as_many_as_this_process_may_use_cores_or_the_number_that_was_asked_for(tmp_path: Path) -> None:
    for asked, workers in (({}, cores()), ({"workers": 3}, 3)):
        plan = plan_sweep("soft_tissue", {"k_e": [50.0, 100.0]}, fixed=FIXED)
        assert plan.workers == 0
        carry_out(plan, **asked)
        assert plan.workers == workers >= 1
    with pytest.raises(Refused, match="workers must be a whole number from 1"):
        sweep("soft_tissue", {}, workers=0, out=tmp_path / "s")
    assert not (tmp_path / "s").exists()


def test_an_interrupt_while_a_job_compiles_waited_for_its_end(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A compiler asks nobody whether it may go on: the second row's job stands for it."""
    compiling, compiled, ended = Event(), Event(), Event()

    def compiles(job: Job, *told: Any) -> ChunkResult:
        if job.rows[0][0] == 0:
            return work(job, *told)
        compiling.set()
        compiled.wait(60.0)
        ended.set()
        return work(job, *told)

    def interrupt(done: int, _: int) -> None:
        if done:
            compiling.wait(60.0)
            raise KeyboardInterrupt

    monkeypatch.setattr(teleop.sweeps.runner, "work", compiles)
    with pytest.raises(KeyboardInterrupt):
        sweep("soft_tissue", {"k_e": [1.0, 2.0, 3.0]}, fixed=FIXED, workers=1, show=interrupt, out=tmp_path / "s")
    assert not ended.is_set()
    compiled.set()
    monkeypatch.undo()
    assert len(sweep("soft_tissue", {"k_e": [1.0, 2.0, 3.0]}, fixed=FIXED, out=tmp_path / "s")) == 3
    written = [json.loads(line)["row"] for line in (tmp_path / "s" / "rows.jsonl").read_text().splitlines()]
    assert sorted(written) == [0, 1, 2]


SLOW = """
import time
from pathlib import Path
from teleop import load_scene


def scene(*, k_e: float = 100.0):
    if k_e == 3.0:
        Path("busy").touch()
        time.sleep(600.0)
    return load_scene("soft_tissue", duration=0.1, k_e=k_e)
"""


@pytest.mark.live
def test_an_interrupted_process_stayed_until_its_threads_were_done(process: Any, ended: Any, tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text(SLOW)
    running = process("-m", "teleop", "sweep", "slow.py", "--grid", "k_e=1,2,3", "--workers", "1", "--engine", "plain")
    began = time.monotonic()
    while not (tmp_path / "busy").exists():
        assert running.poll() is None
        assert time.monotonic() < began + 120.0
        time.sleep(0.01)
    running.send_signal(signal.SIGINT)
    answer = ended(running)
    assert time.monotonic() < began + 300.0  # of the 600 that its thread goes on for
    assert answer.code == 130
    assert "interrupted: the same command goes on from here" in answer.out
    assert "Traceback" not in answer.err
    assert json.loads((tmp_path / "runs/slow-sweep/summary.json").read_text())["status"] == "interrupted"
