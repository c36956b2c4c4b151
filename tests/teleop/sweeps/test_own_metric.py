"""Rows made ready and their metrics: what a row takes over, and figures of a user that raise or return no number."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from concurrent.futures import Executor, Future
from pathlib import Path
from types import FunctionType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from channel.delay import Delay
from slave.wall import Wall
from teleop import Refused, Result, Wave, load_scene, run, sweep
from teleop.scene.library import scene_function
from teleop.scene.loading import SceneMaker
from teleop.simulation.metrics import UNITS
from teleop.sweeps import engine as engines
from teleop.sweeps.chunk import Job, MetricMistake, Raised, SentMistake, evaluate_metric, work
from teleop.sweeps.rows import RowMaker, same
from tests.programs import compiler_of

FIXED = {"duration": 0.1}
STIFFNESS = {"k_e": [50.0, 100.0, 150.0]}
ROW = {"row": 4, "seed": 7, "law": "wave", "k_e": 50.0}
HERE = r"\(.*test_own_metric\.py:\d+\)"


class Fussy(Exception):
    """Such an exception cannot be made again of its text."""

    def __init__(self, k_e: float, *, limit: float) -> None:
        super().__init__(f"{k_e} N/m is above {limit}")


def soft_only(result: Result) -> float:
    """A figure that some rows do not have."""
    k_e = float(str(result.parameters["k_e"]))
    if k_e > 120.0:
        raise Fussy(k_e, limit=120.0)
    return k_e


class Elsewhere(Executor):
    """An executor to which jobs, and from which results, go as bytes, as they do between processes."""

    def submit(self, fn: Any, /, *args: Any, **_: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(pickle.loads(pickle.dumps(fn(*pickle.loads(pickle.dumps(args))))))
        return future


class TestOneThatRaises:
    def test_left_a_blank_cell_and_now_ends_the_sweep(self) -> None:
        words = f"metric soft_only {HERE} raised Fussy: 150.0 N/m is above 120.0, in row 2 .k_e=150.0, seed=0.; mend it"
        for engine in (None, "vector"):
            compiler_of(engine)
            with pytest.raises(Refused, match=words) as refused:
                sweep("soft_tissue", STIFFNESS, fixed=FIXED, metrics=["x_err_rms", soft_only], engine=engine)
            cause = refused.value.__cause__
            assert isinstance(cause, Fussy)
            assert cause.__traceback__ is not None

    def test_in_another_process_is_told_with_its_traceback_there(self) -> None:
        with pytest.raises(MetricMistake, match=r"raised Fussy: 150\.0") as refused:
            sweep("soft_tissue", STIFFNESS, fixed=FIXED, metrics=[soft_only], executor=Elsewhere())
        assert isinstance(refused.value.__cause__, Raised)
        assert "raise Fussy(k_e, limit=120.0)" in str(refused.value.__cause__)

    def test_keeps_every_row_before_it_also_those_of_its_own_chunk(self, tmp_path: Path) -> None:
        with pytest.raises(MetricMistake):
            sweep("soft_tissue", {"k_e": [50.0 + n for n in range(100)]}, fixed=FIXED, metrics=[soft_only], workers=1,
                  out=tmp_path / "s")
        written = [json.loads(line) for line in (tmp_path / "s/rows.jsonl").read_text().splitlines()]
        assert [row["row"] for row in written] == [*range(71)]  # 50 to 120 N/m
        assert [row["soft_only"] for row in written] == [row["k_e"] for row in written]

    def test_cost_the_rows_of_jobs_that_had_come_with_it(self, tmp_path: Path) -> None:
        """All jobs have come when the first is looked at, so that whichever is looked at first may be the wrong one."""
        for stiffness in ([150.0, 60.0, 70.0, 80.0], [60.0, 150.0, 70.0, 80.0], [60.0, 70.0, 80.0, 150.0]):
            folder = tmp_path / str(stiffness.index(150.0))
            with pytest.raises(MetricMistake):
                sweep("soft_tissue", {"k_e": stiffness}, fixed=FIXED, metrics=[soft_only], executor=Elsewhere(),
                      workers=2, out=folder)
            written = [json.loads(line)["k_e"] for line in (folder / "rows.jsonl").read_text().splitlines()]
            assert written == [60.0, 70.0, 80.0]

    def test_that_wants_to_exit_is_told_too_and_nan_says_that_a_row_has_none(self) -> None:
        def leaves(result: Result) -> float:
            raise SystemExit(result.ticks)

        def none(result: Result) -> float:
            return float("nan") if result.ticks else 0.0

        with pytest.raises(MetricMistake, match=r"raised SystemExit: 100, in row 0"):
            sweep("soft_tissue", fixed=FIXED, metrics=[leaves])
        row, = sweep("soft_tissue", fixed=FIXED, metrics=[none])
        assert "none" not in row

    def test_or_returns_no_number_was_a_blank_cell_or_a_guess_and_is_refused(self) -> None:
        result, value = run(load_scene("soft_tissue", **FIXED)), None

        def odd(result: Result) -> Any:  # noqa: ARG001 - of no run in particular
            return value

        words = rf"metric odd {HERE} returned .*no number .*in row 4 \(law=wave, k_e=50"
        for value in (None, "0.5", np.zeros(3), [1.0], 1j):
            with pytest.raises(MetricMistake, match=words):
                pytest.fail(f"{value}: {evaluate_metric(odd, result, ROW)}")
        for value in (2, np.float32(2.0), np.int64(2), np.array(2.0), 2.0):
            assert evaluate_metric(odd, result, ROW) == 2.0, value


def edited(text: str) -> Callable[[Result], float]:
    names: dict[str, Any] = {}
    exec(f"def rate(result):\n    {text}", names)
    made = names["rate"]
    assert isinstance(made, FunctionType)
    return made


FAILS = "return 1.0 / (result.parameters['k_e'] - 100.0)"
MENDED = "k = result.parameters['k_e'] - 100.0; return 1.0 / (k or 1.0)"


class TestAfterTheMend:
    def swept(self, text: str, folder: Path, executor: Executor | None = None, **named: Any) -> Any:
        return sweep("soft_tissue", STIFFNESS, fixed=FIXED, metrics=[edited(text)], workers=1, out=folder,
                     executor=executor, **named)

    def test_the_sweep_goes_on_where_it_was_told_that_its_rows_stay(self, tmp_path: Path) -> None:
        with pytest.raises(MetricMistake, match=r"division by zero, in row 1 .*mended=\['rate'\]"):
            self.swept(FAILS, tmp_path / "s")
        with pytest.raises(Refused, match=r"metric rate was edited .*--out '.*s-1' .*mended=\['rate'\]"):
            self.swept(MENDED, tmp_path / "s")
        assert self.swept(MENDED, tmp_path / "s", mended=["rate"])["rate"].tolist() == [-1.0 / 50.0, 1.0, 1.0 / 50.0]
        assert len(self.swept(MENDED, tmp_path / "s")) == 3  # the folder is held to the mended one from now on
        with pytest.raises(Refused, match="metric rate was edited"):
            self.swept(FAILS, tmp_path / "s")

    def test_a_sweep_without_a_row_goes_on_without_a_word(self, tmp_path: Path) -> None:
        for text in ("return result.ticks / 0", "return result.missing"):
            with pytest.raises(MetricMistake, match="in row 0"):
                self.swept(text, tmp_path / "s")
        assert len(self.swept("return 1.0", tmp_path / "s")) == 3

    @pytest.mark.parametrize(("names", "words"), [("rate", r"mended=\['rate'\]"), (["x_err_rms"], "no function")])
    def test_only_functions_of_the_sweep_are_mended(self, names: Any, words: str, tmp_path: Path) -> None:
        with pytest.raises(Refused, match=words):
            self.swept("return 1.0", tmp_path / "s", mended=names)
        assert not (tmp_path / "s").exists()

    def test_another_process_cannot_write_while_the_definition_changes(self, tmp_path: Path) -> None:
        with pytest.raises(MetricMistake):
            self.swept(FAILS, tmp_path / "s")
        refused = []

        def also(done: int, _: int) -> None:  # of how many rows there are already, jobs that end at once decide
            with pytest.raises(Refused, match="another process is writing"):
                self.swept(MENDED, tmp_path / "s")
            refused.append(done)

        self.swept(MENDED, tmp_path / "s", mended=["rate"], show=also)
        assert refused


def test_a_metric_without_lines_in_the_kernels_was_a_blank_column(monkeypatch: pytest.MonkeyPatch) -> None:
    """Such a one takes the whole record, as a function does; every metric has a column where its run has it."""
    engines._kinds.cache_clear()
    monkeypatch.setattr(engines, "KEPT_ALONG", {})
    row, = sweep("soft_tissue", fixed=FIXED, metrics=["f_m_max"])
    engines._kinds.cache_clear()
    single = run(load_scene("soft_tissue", **FIXED)).metrics
    assert row["f_m_max"] == single["f_m_max"]
    monkeypatch.undo()
    row, = sweep("soft_tissue", fixed=FIXED, metrics=[*UNITS])
    assert {name: row[name] for name in UNITS if name in row} == {**single}


def test_a_mistake_on_its_way_through_dask_brought_a_cause_that_could_not_be_made_again() -> None:
    """dask has exceptions pickled together with their causes, by tblib, whatever they say of themselves."""
    mistake = MetricMistake("metric x returned None")
    sent = pickle.loads(pickle.dumps(SentMistake(mistake))).error
    assert (str(sent), sent.__cause__) == (str(mistake), None)
    pickling = pytest.importorskip("tblib.pickling_support")
    mistake = MetricMistake("metric x raised Fussy")
    mistake.__cause__ = Fussy(150.0, limit=120.0)
    pickling.install(mistake)
    sent = pickle.loads(pickle.dumps(SentMistake(mistake))).error
    assert str(sent) == str(mistake)
    assert "150.0 N/m is above 120.0" in str(sent.__cause__)


MEASURES = ("x_err_rms", "f_err_max", "f_env_max", "E_link_min")
LOSSY = {"duration": 0.2, "link": "delay(0.02) | bernoulli(0.05)"}
KNOBS: list[dict[str, Any]] = [  # one after another, each with another part changed, and back again
    {"k_e": 5e3}, {"k_e": 6e3}, {"k_e": 6e3, "d_e": 7.0}, {"k_e": 0.0, "d_e": 0.0}, {"k_e": 5e3},
    {"law.K": 400.0}, {"law": "pfra"}, {"law": "wave"}, {"law": "wave", "k_e": 1e3}, {"law": "pfra", "k_e": 1e3},
    {"amplitude": 0.04}, {"k_h": 100.0}, {"k_h": 100.0, "k_e": 2e3}, {"link": "delay(0.01)"},
    {"link": "delay(0.01)", "k_e": 2e3}, {"observer": 100.0}, {"observer": None}, {"energy": False}, {"dt": 0.002},
    {"duration": 0.1}, {"wall": -0.0}, {"wall": 0.0}, {"k_e": -1.0}, {"k_e": 5e3},
]


def job(knobs: list[dict[str, Any]], engine: str) -> Job:
    return Job("canonical", {}, [(i, {**LOSSY, **own}, 1) for i, own in enumerate(knobs)], MEASURES, engine)


ALIKE = [own for own in KNOBS if not {"law", "energy", "observer"} & own.keys()]  # all run by one kernel


@pytest.mark.parametrize(("engine", "given"), [("plain", KNOBS), ("c", ALIKE), *[
    pytest.param(engine, KNOBS, marks=pytest.mark.full) for engine in ("c", "vector")]],
    ids=["plain", "c, of one law", "c", "vector"])
def test_a_row_is_what_it_is_alone_whatever_rows_came_before_it(engine: str, given: list[dict[str, Any]]) -> None:
    compiler_of(engine)
    # Rows of one job have the same knobs: each has all of them here.
    every = dict.fromkeys(name for own in given for name in own)
    default = {"k_e": 5e3, "d_e": 5.0, "law": "wave", "law.K": 500.0, "amplitude": 0.05, "k_h": 200.0,
               "observer": 200.0, "energy": True, "dt": 1e-3, "wall": 0.03, **LOSSY}
    rows = [{name: {**default, **own}[name] for name in every} for own in given]
    rows = [row if row.get("law", "wave") == "wave" else {**row, "law.K": 30.0} for row in rows]
    done = work(job(rows, engine))
    assert given is KNOBS or {*done.ran} == {(engine, "")}
    together = done.rows
    alone = [{**work(job([row], "plain")).rows[0], "row": i} for i, row in enumerate(rows)]
    assert together == alone
    assert {row["status"] for row in together} >= {"ok", "refused"}


def test_rows_that_differ_in_a_wall_alone_share_all_but_its_numbers() -> None:
    maker = RowMaker("canonical", {"duration": 0.02}, MEASURES, "plain")
    for k_e in (1e3, 2e3, 3e3):
        maker.add({}, {"k_e": k_e}, 0)
    group, = maker.groups
    first, second, third = group.rows
    assert first.path is second.path is third.path
    assert first.schedules is second.schedules is third.schedules
    assert len({str(ready.tree[-1].c_s) for ready in group.rows}) == 3
    assert first.tree[:-1] == second.tree[:-1] == third.tree[:-1]


def test_knobs_that_rows_share_are_read_once_and_those_that_differ_in_every_row() -> None:
    function = scene_function("canonical")
    maker = SceneMaker(function, "canonical", {"duration": "0.3", "law.K": 400.0, "link": "delay(0.01)", "x_limit": 5})
    for k_e in (1e3, "2e3", 3):
        scene = maker.scene({"k_e": k_e})
        assert scene == load_scene(
            "canonical", **{"duration": 0.3, "law.K": 400.0, "link": "delay(0.01)", "x_limit": 5.0, "k_e": k_e})
        assert scene.knobs["k_e"] == float(k_e)
    for wrong, why in ((-1.0, "k_e must be at least 0 N/m"), ("soft", "k_e must be a number"), (True, "k_e")):
        with pytest.raises(Refused, match=why):
            maker.scene({"k_e": wrong})
    for law in ("wave", Wave(K=1.0)):  # the shared K is that of any law
        assert maker.scene({"law": law}).law.K == 400.0


def test_same_is_to_the_bit_and_a_part_that_may_change_is_never_the_same() -> None:
    assert same(Wall(k=1.0, at=0.0), Wall(k=1.0, at=0.0))
    assert not same(Wall(k=1.0, at=0.0), Wall(k=1.0, at=-0.0))
    assert not same(1, True)
    assert not same(1, 1.0)
    assert not same(float("nan"), float("nan"))
    assert same((1.0, None, "a"), (1.0, None, "a"))
    assert same(Wave(), Wave())
    assert not same(Delay(0.1), Delay(0.2))
    may_change = SimpleNamespace(k=1.0)
    assert not same(may_change, may_change)
    assert not same([1.0], [1.0])


def test_a_scene_that_changes_an_object_of_its_own_from_row_to_row_gets_what_it_changed(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "from dataclasses import replace\n"
        "from scenarios.canonical import scene as canonical\n"
        "from slave.wall import Wall\n"
        "class Mine:\n    k = 0.0\n    def plant(self, body, dt):\n        return Wall(k=self.k).plant(body, dt)\n"
        "MINE = Mine()\n"
        "def scene(*, k: float = 1e3, duration: float = 0.3):\n    MINE.k = k\n"
        "    return replace(canonical(duration=duration), environment=MINE)\n")
    rows = [(i, {"k": k}, 0) for i, k in enumerate((1e3, 5e3, 1e4))]
    found = work(Job(str(tmp_path / "mine.py"), {}, rows, ("f_env_max",), "plain")).rows
    assert len({row["f_env_max"] for row in found}) == 3
