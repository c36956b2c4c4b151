"""From rows to arrays: names, shapes, and what is worked out after the run."""

from __future__ import annotations

import gc
import weakref
from dataclasses import replace

import numpy as np
import pytest

import teleop.simulation.trace
from channel.delay import Delay
from master.hand import Grip, Sine
from slave.wall import Wall
from teleop import PFRA, Direct, MassDamper, Scene, Wave, run
from teleop.simulation.prepared import prepare
from teleop.simulation.trace import Columns, EndRecord, assemble, end_columns

SINE = Sine(amplitude=0.05, frequency=1.0)
SCENE = Scene(
    law=Wave(), master=MassDamper(mass=0.1, damping=0.5), slave=MassDamper(mass=0.5, damping=1.0), link=Delay(0.01),
    hand=Grip(mass=0.4, k=200.0, d=5.0, reference=SINE), environment=Wall(k=5e3, d=5.0, at=0.03), duration=0.5,
)
PREPARED = prepare(SCENE)


def test_a_trace_has_t_first_and_the_symbols_of_what_the_scene_has() -> None:
    assert list(run(SCENE).trace) == [
        "t", "x_m", "v_m", "f_m", "seq_m", "f_h", "x_s", "v_s", "f_s", "seq_s", "f_env",
    ]
    assert list(run(replace(SCENE, link=None, law=PFRA())).trace) == [
        "t", "x_m", "v_m", "f_m", "f_h_hat", "f_h", "x_s", "v_s", "f_env", "f_s",
    ]


def test_t_is_ticks_times_dt_never_added_up() -> None:
    trace = run(replace(SCENE, dt=0.0007, duration=0.7)).trace
    assert np.array_equal(trace["t"], np.arange(1000) * 700_000 / 1e9)


def test_columns_of_a_trace_lie_together_in_memory() -> None:
    assert all(column.flags.c_contiguous for column in run(replace(SCENE, axes=3, duration=0.02)).trace.values())


def test_what_is_sensed_in_the_run_and_what_is_worked_out_after_it_are_the_same_forces() -> None:
    """Direct reads f_env, and PFRA with a sensor f_h; with neither, they come from the trace."""
    law = PFRA(alpha=1.0, kf=0.2, K=200.0, B=5.0)
    sensed = run(replace(SCENE, law=law, observer=None)).trace
    worked_out = run(replace(SCENE, law=Direct(kf=0.2, K=200.0, B=5.0))).trace
    assert np.abs(sensed["f_h"]).max() > 0.1
    assert np.array_equal(sensed["f_h"], worked_out["f_h"])
    waves = run(SCENE).trace
    wall = SCENE.environments[0].plant(SCENE.slave, 1e-3)
    assert np.abs(waves["f_env"]).max() > 0.1
    met = [wall.force(wall.c, x, v) for x, v in zip(waves["x_s"], waves["v_s"], strict=True)]
    assert waves["f_env"].tolist() == met


def test_the_hands_force_is_what_moves_the_master_alone() -> None:
    """M_m a + b_m v = f_h - f_m, with a on the left of the tick from the body of both, 0.5 kg."""
    trace = run(SCENE).trace
    x, v, f_h = trace["x_m"], trace["v_m"], trace["f_h"]
    held = np.concatenate([[0.0], trace["f_m"][:-1]])
    r = 0.05 * np.sin(2.0 * np.pi * trace["t"])
    slope = np.concatenate([[0.0], np.diff(r) / 1e-3])
    a = (200.0 * (r - x) + 5.0 * (slope - v) - 0.5 * v - held) / 0.5
    assert f_h == pytest.approx(0.1 * a + 0.5 * v + held, abs=1e-12)


def test_nobody_holds_a_master_with_no_force() -> None:
    trace = run(replace(SCENE, hand=None, start_m=0.01)).trace
    assert not trace["f_h"].any()


def rows(ticks: range) -> list[float]:
    """Rows x, v, f of one end, x being the tick."""
    return [value for k in ticks for value in (float(k), 0.5, 0.25)]


def test_two_ends_are_joined_at_the_ticks_that_both_ran() -> None:
    skipped = [0, 1, 2, 5, 6, 9]
    records = {
        "m": EndRecord(range(8), rows(range(8)), [-1, 0, 1, 2, 3, 4, 5, 6]),
        "s": EndRecord(skipped, [v for k in skipped for v in (float(-k), 0.0, 0.0)], [-1, -1, 0, 3, 4, 7]),
    }
    trace = assemble(PREPARED, records)
    assert trace["t"].tolist() == [0.0, 0.001, 0.002, 0.005, 0.006]
    assert trace["x_m"].tolist() == [0.0, 1.0, 2.0, 5.0, 6.0]
    assert trace["x_s"].tolist() == [0.0, -1.0, -2.0, -5.0, -6.0]
    assert trace["seq_m"].tolist() == [-1, 0, 1, 4, 5]
    assert trace["seq_s"].tolist() == [-1, -1, 0, 3, 4]


def test_ends_that_share_no_tick_leave_empty_columns() -> None:
    records = {"m": EndRecord(range(3), rows(range(3)), [-1] * 3), "s": EndRecord([], [], [])}
    assert all(len(column) == 0 for column in assemble(PREPARED, records).values())


def test_one_end_alone_has_its_own_columns() -> None:
    got = end_columns(PREPARED, "s", EndRecord(range(3), rows(range(3)), [-1, 0, 1]))
    assert set(got) == {"x_s", "v_s", "f_s", "seq_s", "f_env"}
    assert got["x_s"].tolist() == [0.0, 1.0, 2.0]
    assert got["seq_s"].dtype == np.int64


def test_a_trace_is_the_same_to_the_bit_however_many_rows_are_worked_on_at_a_time(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = replace(SCENE, energy=True, axes=3, environment=(Wall(k=5e3, d=5.0, at=0.03), None, None), duration=0.02)
    whole = run(scene)
    for size in (1, 7, 20, 1000):
        monkeypatch.setattr(teleop.simulation.trace, "BLOCK", size)
        parts = run(scene)
        assert whole.metrics == parts.metrics, size
        assert {name: column.tobytes() for name, column in whole.trace.items()} == {
            name: column.tobytes() for name, column in parts.trace.items()}, size


def test_the_rows_of_a_run_that_is_over_did_not_stay_in_memory_until_a_garbage_collection() -> None:
    class Zeros:
        def table(self, start: int, stop: int) -> np.ndarray:
            return np.zeros((stop - start, 20))

    def read(rows: Zeros) -> float:
        records = {e: EndRecord(range(5), rows, None) for e in ("m", "s")}
        return float(assemble(prepare(replace(SCENE, energy=True)), records)["E_link"].sum())

    rows = Zeros()
    gone = weakref.ref(rows)
    gc.disable()
    try:
        assert read(rows) == 0.0
        del rows
        assert gone() is None
    finally:
        gc.enable()


def test_a_column_is_made_when_it_is_asked_for_and_not_kept() -> None:
    asked: list[str] = []
    got = Columns({"x_m": lambda: (asked.append("x_m"), np.zeros(3))[1], "v_m": lambda: np.ones(3)})
    assert list(got) == ["x_m", "v_m"]
    assert "x_m" in got
    assert "t" not in got
    assert got.keys() >= {"v_m"}
    assert asked == []
    assert len(got["x_m"]) == len(got["x_m"])
    assert asked == ["x_m", "x_m"]
