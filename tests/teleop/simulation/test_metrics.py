"""Figures and traces of a run: on traces made by hand whose answers can be seen, and ledgers summed anew."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from math import inf, nan, sqrt
from typing import Any

import numpy as np
import pytest

import teleop.simulation.trace
from channel import Bernoulli, Delay, UniformJitter
from master.hand import Grip, Sine
from slave.wall import Wall
from teleop import PFRA, Direct, Hold, MassDamper, Scene, Wave, Zero, load_scene, run
from teleop.scene.playout import integrates
from teleop.simulation import metrics as needs
from teleop.simulation.metrics import METRICS, metrics
from teleop.simulation.prepared import prepare
from teleop.simulation.structure import structure_of
from teleop.simulation.trace import Columns, EndRecord, assemble, end_columns

SCENE = Scene(law=Direct(), master=MassDamper(mass=1.0), slave=MassDamper(mass=1.0), dt=1e-3, duration=1.0)
N = 100


def trace(**columns: Any) -> dict[str, Any]:
    """A trace of N ticks at rest, some columns replaced."""
    rest = {name: np.zeros(N) for name in ("x_m", "v_m", "f_m", "x_s", "v_s", "f_s", "f_h", "f_env")}
    return {"t": np.arange(N) * 1e-3, **rest, **columns}


def later(column: np.ndarray, ticks: int) -> np.ndarray:
    """`column` as it is seen `ticks` ticks later, NaN before: what must not be looked at."""
    return np.concatenate([np.full(ticks, nan), column[: len(column) - ticks]])


def played(age: int) -> np.ndarray:
    """The packets of a constant delay of `age` ticks."""
    seq = np.arange(N) - age
    return np.where(seq >= 0, seq, -1)


WAVY = np.sin(0.3 * np.arange(N)) + 0.01 * np.arange(N)


def test_tracking_and_force_are_judged_against_the_other_end_as_it_was_a_delay_ago() -> None:
    for age, off in product((1, 7, 50), (0.0, 0.25)):
        got = metrics(SCENE, trace(x_m=WAVY, x_s=later(WAVY, age) + off, seq_s=played(age),
                                   f_env=WAVY, f_m=later(WAVY, 9), seq_m=played(9)))
        assert (got["x_err_rms"], got["x_err_max"]) == pytest.approx((off, off), rel=1e-12, abs=0.0), age
        assert got["f_err_rms"] == 0.0
    got = metrics(SCENE, trace(x_m=WAVY, x_s=later(WAVY, 1), f_env=WAVY, f_m=later(WAVY, 1)))  # no link: a tick
    assert got["x_err_max"] == got["f_err_max"] == 0.0
    assert not [name for name in got if name.startswith(("T_", "fresh_"))]
    got = metrics(SCENE, trace(x_s=np.where(np.arange(N) % 2, 0.3, -0.1), seq_s=played(10), seq_m=played(10)))
    assert (got["x_err_rms"], got["x_err_max"]) == pytest.approx((sqrt((0.09 + 0.01) / 2.0), 0.3))


def test_after_hours_the_delay_is_still_whole_ticks() -> None:
    """At 40,000 s the last digit of t is 7e-12 s."""
    t = np.arange(40_000_000, 40_000_000 + N) / 1e3
    seq = np.where(played(7) >= 0, played(7) + 40_000_000, -1)
    got = metrics(SCENE, trace(t=t, x_m=WAVY, x_s=later(WAVY, 7), seq_s=seq, seq_m=seq))
    assert got["x_err_max"] == 0.0
    assert got["T_fwd_max"] == pytest.approx(7e-3)


def test_ticks_that_a_live_end_skipped_are_no_error() -> None:
    """Tick 50 to 59 are missing; where the tick a delay ago is missing, the last one before it is looked at."""
    keep = np.r_[0:50, 60:N]
    still = np.ones(N)
    columns = trace(x_m=still, x_s=later(still, 7), seq_s=played(7), seq_m=played(7))
    got = metrics(SCENE, {name: column[keep] for name, column in columns.items()})
    assert got["x_err_max"] == 0.0
    ramp = np.arange(N) * 1.0
    columns = trace(x_m=ramp, x_s=later(ramp, 7), seq_s=played(7), seq_m=played(7))
    got = metrics(SCENE, {name: column[keep] for name, column in columns.items()})
    assert got["x_err_max"] == 10.0  # tick 66 should see 59 and sees 49
    assert got["T_fwd_max"] == pytest.approx(7e-3)


def test_in_three_axes_sizes_are_lengths() -> None:
    along = np.tile([3.0, 0.0, -4.0], (N, 1))
    zero = np.zeros((N, 3))
    scene = replace(SCENE, axes=3)
    got = metrics(scene, trace(**dict.fromkeys(("x_m", "f_m", "f_h", "f_s", "f_env"), zero) | {"x_s": along}))
    assert got["x_err_rms"] == got["x_err_max"] == 5.0
    got = metrics(scene, trace(**dict.fromkeys(("x_m", "x_s", "f_m", "f_h", "f_s", "f_env"), along)))
    assert got["f_m_max"] == got["f_s_max"] == got["f_h_max"] == got["f_env_max"] == 5.0


def test_the_force_at_the_end_is_the_mean_of_the_last_tenth_of_a_second_also_where_ticks_are_missing() -> None:
    t = np.arange(1000) * 1e-3
    force = np.where(t < 0.9 - 1e-9, 5.0, np.where(np.arange(1000) % 2, 3.0, -1.0))  # at the end 1 N in the mean
    rest = {name: np.zeros(1000) for name in ("x_m", "x_s", "f_s", "f_h")}
    got = metrics(SCENE, {"t": t, **rest, "f_m": force, "f_env": -2.0 * force})
    assert (got["f_m_end"], got["f_env_end"]) == (1.0, 2.0)
    some = np.ones(1000, bool)
    some[905:955] = some[200:300] = False  # ticks that a live end left out
    got = metrics(SCENE, {"t": t[some], **{name: column[some] for name, column in rest.items()},
                          "f_m": force[some], "f_env": force[some]})
    assert got["f_m_end"] == pytest.approx(force[900:][some[900:]].mean(), abs=1e-15)
    along = np.tile([3.0, 0.0, -4.0], (N, 1)) * np.where(np.arange(N) % 2, 2.0, 0.0)[:, None]
    three = dict.fromkeys(("x_m", "x_s", "f_s", "f_h", "f_env"), np.zeros((N, 3)))
    assert metrics(replace(SCENE, axes=3), trace(**three, f_m=along))["f_m_end"] == 5.0  # of three axes a length
    slow = {name: column[:3] for name, column in trace(f_m=np.array([1.0, 2.0, 3.0] + [0.0] * (N - 3))).items()}
    assert metrics(replace(SCENE, dt=0.5), {**slow, "t": np.arange(3) * 0.5})["f_m_end"] == 3.0


def test_the_queue_is_told_of_the_ticks_that_played_a_message() -> None:
    """In a gap it shortens as the newest message ages, and what is left out of it may be less than nothing."""
    t = np.arange(1000) * 1e-3
    fresh = np.arange(1000) % 4 == 0
    queue = np.where(fresh, np.where(t < 0.9 - 1e-9, 7e-3, 4e-3), -1.0)
    rest = {name: np.zeros(1000) for name in ("x_m", "x_s", "f_m", "f_s", "f_h", "f_env")}
    seq = np.where(fresh, np.arange(1000) - 4, -1)
    one = {"t": t, **rest, "seq_s": seq, "seq_m": seq}
    got = metrics(SCENE, {**one, "queue_s": queue, "queue_m": 0.5 * queue})
    assert (got["queue_fwd_max"], got["queue_bwd_max"]) == (7e-3, 3.5e-3)
    assert (got["queue_fwd_end"], got["queue_bwd_end"]) == pytest.approx((4e-3, 2e-3), abs=1e-15)
    assert not [name for name in metrics(SCENE, one) if name.startswith("queue")]
    three = np.stack([0.1 * queue, queue, 0.0 * queue], axis=1)  # of several axes the longest
    assert metrics(SCENE, {**one, "queue_s": three})["queue_fwd_end"] == pytest.approx(4e-3, abs=1e-15)
    silent = {**one, "seq_s": np.where(t < 0.8, seq, -1), "queue_s": queue}
    assert "queue_fwd_end" not in metrics(SCENE, silent)  # nothing came in the last 0.1 s
    assert metrics(SCENE, silent)["queue_fwd_max"] == 7e-3


def test_ages_and_freshness_of_the_messages_that_were_played() -> None:
    """Every second tick plays the packet of 4 ticks ago, and once one of 10 ticks ago."""
    seq = np.where(np.arange(N) % 2 == 0, np.arange(N) - 4, -1)
    seq[:4] = -1
    seq[40] = 30
    got = metrics(SCENE, trace(seq_s=seq, seq_m=np.full(N, -1)))
    assert got["fresh_fwd"] == pytest.approx(48 / N)
    assert got["T_fwd_max"] == pytest.approx(0.010)
    assert got["T_fwd_mean"] == pytest.approx((47 * 4 + 10) / 48 * 1e-3)
    assert got["fresh_bwd"] == 0.0
    assert "T_bwd_mean" not in got


def test_the_least_and_the_last_of_each_ledger() -> None:
    ledger = np.array([0.0, 2.0, -1.0, *[0.5] * (N - 3)])
    got = metrics(SCENE, trace(E_link=ledger, E_port=2.0 * ledger, E_law=ledger + 3.0))
    assert (got["E_link_min"], got["E_link_end"], got["E_port_min"], got["E_port_end"]) == (-1.0, 0.5, -2.0, 1.0)
    assert (got["E_law_min"], got["E_law_end"]) == (2.0, 3.5), "a least that is above zero is not zero"
    got = metrics(SCENE, trace(g_m=np.linspace(1.0, 0.2, N), g_s=np.ones(N)))
    assert (got["g_m_min"], got["g_s_min"]) == (0.2, 1.0)
    assert metrics(SCENE, {name: column[:0] for name, column in trace().items()}) == {}, "without a tick there is none"


def test_energy_received_is_compared_with_the_stamp_of_the_packet_it_came_with() -> None:
    """The sender put in 1 J a tick; a receiver that took out 3 J more than it knew of is seen."""
    sent = np.arange(1.0, N + 1.0)
    seq = played(5)
    honest = np.where(seq >= 0, seq + 1.0, 0.0)
    got = metrics(SCENE, trace(seq_s=seq, seq_m=seq, E_in_fwd=sent, E_out_fwd=honest, E_in_bwd=sent, E_out_bwd=honest))
    assert got["E_fwd_min"] == got["E_bwd_min"] == 0.0
    greedy = honest + 3.0 * (np.arange(N) == 60)
    got = metrics(SCENE, trace(seq_s=seq, seq_m=seq, E_in_fwd=sent, E_out_fwd=greedy, E_in_bwd=sent, E_out_bwd=honest))
    assert (got["E_fwd_min"], got["E_bwd_min"]) == (-3.0, 0.0)


def test_a_figure_that_is_no_finite_number_is_left_out() -> None:
    x_s = np.zeros(N)
    for x_s[-1] in (nan, inf):
        got = metrics(SCENE, trace(x_s=x_s, seq_s=played(2), seq_m=played(2)))
        assert not got.keys() & {"x_err_rms", "x_err_max"}
        assert got["f_err_max"] == 0.0


NEEDS: dict[str, Callable[[Scene], bool]] = {
    "": lambda _: True, needs.TWO_ENDS: lambda s: s.slave is not None,
    needs.LINK: lambda s: s.link is not None, needs.PORTS: lambda s: s.energy,
    needs.WAVES: lambda s: s.energy and s.has_waves, needs.WATCHDOG: lambda s: s.watchdog is not None,
    needs.STAMPS: lambda s: s.energy and s.has_waves and s.link is not None,
    needs.STANDS: lambda s: prepare(s).still is not None, needs.STORED: lambda s: structure_of(s).has.stored,
    needs.DEADBAND: lambda s: s.deadband is not None, needs.ROTATION: lambda s: bool(s.rotations),
    needs.PLAYED: lambda s: s.link is not None and s.has_waves and integrates(s.played_as),
}


def test_a_run_has_the_figures_that_the_list_says_it_has() -> None:
    moved = (needs.FREE, needs.FELT, needs.PRESSES, needs.SWINGS)
    by_its_motion = {name for name, metric in METRICS.items() if metric.needs in moved}
    scenes: list[tuple[str, dict[str, Any]]] = [
        ("canonical", {}), ("canonical", {"energy": False}), ("local", {"law": "direct"}), ("hard_wall", {}),
        ("encoder_wall", {}), ("canonical", {"playout": "integral"}), ("canonical", {"playout": "energy"}),
        ("canonical", {"law": "direct", "playout": "integral"}), ("canonical", {"deadband": 0.1}), ("pose", {})]
    made = [replace(load_scene(name, **knobs), duration=0.45) for name, knobs in scenes]
    for scene in (*made, replace(made[0], hand=None)):
        assert set(run(scene).metrics) - by_its_motion == {
            name for name, metric in METRICS.items() if name not in by_its_motion and NEEDS[metric.needs](scene)}, scene


# From rows to arrays

SINE = Sine(amplitude=0.05, frequency=1.0)
PRESSED = Scene(
    law=Wave(), master=MassDamper(mass=0.1, damping=0.5), slave=MassDamper(mass=0.5, damping=1.0), link=Delay(0.01),
    hand=Grip(mass=0.4, k=200.0, d=5.0, reference=SINE), environment=Wall(k=5e3, d=5.0, at=0.03), duration=0.5,
)
PREPARED = prepare(PRESSED)


def test_a_trace_has_t_first_never_added_up_then_the_symbols_of_its_scene_in_columns_that_lie_together() -> None:
    assert list(run(PRESSED).trace) == [
        "t", "x_m", "v_m", "f_m", "seq_m", "f_h", "x_s", "v_s", "f_s", "seq_s", "f_env",
    ]
    assert list(run(replace(PRESSED, link=None, law=PFRA())).trace) == [
        "t", "x_m", "v_m", "f_m", "f_h_hat", "f_h", "x_s", "v_s", "f_env", "f_s",
    ]
    trace = run(replace(PRESSED, dt=0.0007, duration=0.7)).trace
    assert np.array_equal(trace["t"], np.arange(1000) * 700_000 / 1e9)
    assert all(column.flags.c_contiguous for column in run(replace(PRESSED, axes=3, duration=0.02)).trace.values())


def test_what_is_sensed_in_the_run_and_what_is_worked_out_after_it_are_the_same_forces() -> None:
    """Direct reads f_env, and PFRA with a sensor f_h; with neither, they come from the trace."""
    law = PFRA(alpha=1.0, kf=0.2, K=200.0, B=5.0)
    sensed = run(replace(PRESSED, law=law, observer=None)).trace
    worked_out = run(replace(PRESSED, law=Direct(kf=0.2, K=200.0, B=5.0))).trace
    assert np.abs(sensed["f_h"]).max() > 0.1
    assert np.array_equal(sensed["f_h"], worked_out["f_h"])
    waves = run(PRESSED).trace
    wall = PRESSED.environments[0].plant(PRESSED.slave, 1e-3)
    assert np.abs(waves["f_env"]).max() > 0.1
    met = [wall.force(wall.c, x, v) for x, v in zip(waves["x_s"], waves["v_s"], strict=True)]
    assert waves["f_env"].tolist() == met


def test_the_hands_force_is_what_moves_the_master_alone() -> None:
    """M_m a + b_m v = f_h - f_m, with a on the left of the tick from the body of both, 0.5 kg."""
    trace = run(PRESSED).trace
    x, v, f_h = trace["x_m"], trace["v_m"], trace["f_h"]
    held = np.concatenate([[0.0], trace["f_m"][:-1]])
    r = 0.05 * np.sin(2.0 * np.pi * trace["t"])
    slope = np.concatenate([[0.0], np.diff(r) / 1e-3])
    a = (200.0 * (r - x) + 5.0 * (slope - v) - 0.5 * v - held) / 0.5
    assert f_h == pytest.approx(0.1 * a + 0.5 * v + held, abs=1e-12)


def test_nobody_holds_a_master_with_no_force() -> None:
    trace = run(replace(PRESSED, hand=None, start_m=0.01)).trace
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


def test_one_end_alone_has_its_own_columns_and_ends_that_share_no_tick_leave_empty_ones() -> None:
    records = {"m": EndRecord(range(3), rows(range(3)), [-1] * 3), "s": EndRecord([], [], [])}
    assert all(len(column) == 0 for column in assemble(PREPARED, records).values())
    got = end_columns(PREPARED, "s", EndRecord(range(3), rows(range(3)), [-1, 0, 1]))
    assert set(got) == {"x_s", "v_s", "f_s", "seq_s", "f_env"}
    assert got["x_s"].tolist() == [0.0, 1.0, 2.0]
    assert got["seq_s"].dtype == np.int64


def test_a_trace_is_the_same_to_the_bit_however_many_rows_are_worked_on_at_a_time(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = replace(PRESSED, energy=True, axes=3, environment=(Wall(k=5e3, d=5.0, at=0.03), None, None), duration=0.02)
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
        return float(assemble(prepare(replace(PRESSED, energy=True)), records)["E_link"].sum())

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


# The two ledgers, E_link and E_port, against their definitions summed anew from the trace

DT, B = 1e-3, 2.0
LINKS = {
    "none": None, "zero": Delay(0.0), "50 ms": Delay(0.05),
    "rough": Delay(0.01) | UniformJitter(0.02) | Bernoulli(0.2),
}


def make(**other: Any) -> Scene:
    """A hand that swings a master over waves, and a slave that strikes a wall."""
    return Scene(**{
        "law": Wave(b=B), "master": MassDamper(mass=0.1, damping=0.5), "slave": MassDamper(mass=0.5, damping=1.0),
        "hand": Grip(mass=0.4, k=200.0, d=5.0, reference=Sine(amplitude=0.05, frequency=1.0)),
        "environment": Wall(k=5e3, d=5.0, at=0.02), "energy": True, "duration": 1.0, "playout": Zero(), **other,
    })


def waves(trace: dict[str, Any]) -> tuple[np.ndarray, ...]:
    """u_m, w_m, u_s, w_s of every tick: the master's from f_m and v_m, the slave's by who played what."""
    root = sqrt(2.0 * B)
    u_m = (B * trace["v_m"] + trace["f_m"]) / root
    w_m = (B * trace["v_m"] - trace["f_m"]) / root
    fresh = trace["seq_s"] >= 0
    u_s = np.where(fresh if u_m.ndim == 1 else fresh[:, None], u_m[trace["seq_s"]], 0.0)
    w_s = u_s - sqrt(2.0 / B) * trace["f_s"]
    return u_m, w_m, u_s, w_s


def summed(power: np.ndarray) -> np.ndarray:
    """Over the axes, and over the ticks so far."""
    return np.cumsum(0.5 * DT * (power if power.ndim == 1 else power.sum(axis=1)))


@pytest.mark.parametrize("axes", [1, 3])
@pytest.mark.parametrize("link", ["zero", "50 ms", "rough"])
def test_e_link_is_the_sum_of_the_waves_that_went_in_less_those_that_came_out(link: str, axes: int) -> None:
    hand = Grip(mass=0.4, k=200.0, d=5.0, reference=Sine(amplitude=(0.05, 0.02, -0.03)[:axes], frequency=1.0))
    trace = dict(run(make(link=LINKS[link], axes=axes, hand=hand), seed=2).trace)
    u_m, w_m, u_s, w_s = waves(trace)
    assert trace["E_link"] == pytest.approx(summed(u_m**2 + w_s**2 - u_s**2 - w_m**2), abs=1e-13)
    for name, wave in (("E_in_fwd", u_m), ("E_in_bwd", w_s), ("E_out_fwd", u_s), ("E_out_bwd", w_m)):
        assert trace[name] == pytest.approx(summed(wave**2), abs=1e-13)
    assert trace["E_link"].max() > 1e-5


def test_over_a_constant_delay_e_link_is_what_is_under_way() -> None:
    """Stored is each wave that was sent within the last `delay` ticks, this one's included."""
    for delay in (1, 7, 400):
        trace = dict(run(make(link=Delay(delay * DT))).trace)
        u_m, _, _, w_s = waves(trace)
        sent = np.concatenate([np.zeros(delay), summed(u_m**2 + w_s**2)])
        assert trace["E_link"] == pytest.approx(sent[delay:] - sent[:-delay], abs=1e-13), delay
        if delay == 1:  # as without a link
            for name, column in run(make(link=None)).trace.items():
                assert np.array_equal(column, trace[name]), name


def test_e_port_pairs_each_held_force_with_the_motion_it_was_held_over() -> None:
    for law, axes, link in ((Wave(b=B), 1, "rough"), (PFRA(K=200.0, B=5.0), 3, "50 ms"),
                            (Direct(K=200.0, B=5.0, kf=0.3), 3, "rough"), (Wave(b=B), 3, "none")):
        trace = run(make(law=law, link=LINKS[link], axes=axes), seed=2).trace
        f_m, f_s, x_m, x_s = (trace[name].reshape(-1, axes) for name in ("f_m", "f_s", "x_m", "x_s"))
        steps = (f_m[:-1] * np.diff(x_m, axis=0) - f_s[:-1] * np.diff(x_s, axis=0)).sum(axis=1)
        assert trace["E_port"] == pytest.approx(np.concatenate([[0.0], np.cumsum(steps)]), abs=1e-12), (law, link)
        assert np.abs(trace["E_port"]).max() > 1e-4, (law, link)


def test_the_hold_leaks_at_the_port_beside_a_perfect_link() -> None:
    """E_port may fall below zero where E_link does not: it contains the hold's own leak."""
    scene = make(link=Delay(0.0), law=Wave(b=20.0, K=2e4, B=5.0), slave=MassDamper(mass=0.05), duration=2.0)
    got = run(scene).metrics
    assert got["E_link_min"] >= 0.0
    assert got["E_port_min"] < -1e-4


def test_held_waves_are_counted_as_often_as_they_are_used() -> None:
    trace = dict(run(make(link=LINKS["rough"], playout=Hold()), seed=2).trace)
    root = sqrt(2.0 * B)
    w_m = (B * trace["v_m"] - trace["f_m"]) / root
    assert (trace["seq_m"] < 0).mean() > 0.3
    assert trace["E_out_bwd"] == pytest.approx(summed(w_m**2), abs=1e-13)


def test_a_scene_that_does_not_ask_has_no_ledger_and_a_law_without_waves_the_ports_alone() -> None:
    asked, silent = run(make(link=LINKS["rough"]), seed=1), run(make(link=LINKS["rough"], energy=False), seed=1)
    assert not [name for name in silent.trace if name.startswith("E_")]
    assert not [name for name in silent.metrics if name.startswith("E_")]
    assert all(np.array_equal(asked.trace[name], silent.trace[name]) for name in silent.trace)
    ledgers = {name for name in run(make(law=Direct(), duration=0.05)).trace if name.startswith("E_")}
    assert ledgers == {"E_port", "E_port_m", "E_port_s"}
