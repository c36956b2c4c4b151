"""What a user feels of a run: closed forms of springs, dampers and masses, and the same bits in every engine."""

from __future__ import annotations

from dataclasses import replace
from math import pi, sqrt
from typing import Any

import numpy as np
import pytest

from channel import Delay
from master import Grip, Sine
from slave import Tissue, Wall
from teleop import Direct, MassDamper, Scene, Wave, load_scene, run, sweep
from teleop.simulation.felt import SUMS, Basis, figures, ranks, smoothness, stiffness
from teleop.simulation.metrics import METRICS, metrics
from teleop.sweeps.engine import needs_record

SCENE = Scene(law=Direct(), master=MassDamper(mass=1.0), slave=MassDamper(mass=1.0), dt=1e-3, duration=1.0)
N, DT = 2000, 1e-3
T = np.arange(N) * DT
DICE = np.random.default_rng(5)
V = np.cumsum(DICE.normal(size=(N, 3)), axis=0) * 0.01 + 0.3  # m/s


def held(f: np.ndarray) -> np.ndarray:
    """Forces that go with the motion up to the next tick as those that were held until then."""
    return np.concatenate([f[1:], f[:1] * 0.0])


def trace(v: np.ndarray, f: np.ndarray, **columns: Any) -> dict[str, Any]:
    """A trace of a master that moves with v against f, of a slave that touches nothing."""
    rest = np.zeros_like(v)
    return {"t": T[:len(v)], "x_m": rest, "v_m": v, "f_m": f, "x_s": rest, "v_s": v, "f_s": rest, "f_h": rest,
            "f_env": rest, **columns}


def motion(v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Acceleration and mean velocity over the tick before; of the first tick none."""
    return np.diff(v, axis=0, prepend=v[:1]) / DT, 0.5 * (v + np.concatenate([v[:1], v[:-1]]))


class TestFreeSpace:
    def test_a_mass_and_a_damper_are_found_as_they_are_and_a_damper_by_the_reading_with_minus_half_a_tick(self) -> None:
        for axes, v, weight in ((1, V[:, 0], 1.0), (3, V, np.array([1.0, -4.0, 2.5]))):
            a, mean = motion(v)
            got = metrics(replace(SCENE, axes=axes), trace(v, held(0.7 * a + 3.0 * mean + weight)))
            assert (got["felt_mass"], got["felt_drag"]) == pytest.approx((0.7, 3.0), rel=1e-9), axes
            assert got["felt_fit"] == pytest.approx(1.0, abs=1e-12), axes
        # The hold of a tick: f_m(k) = B v(k) lags half a tick behind the motion that it is held over.
        got = metrics(SCENE, trace(V[:, 0], 3.0 * V[:, 0]))
        assert (got["felt_mass"], got["felt_drag"]) == pytest.approx((-3.0 * DT / 2.0, 3.0), rel=1e-9)

    def test_noise_that_no_motion_explains_is_told_by_the_share_that_the_fit_explains(self) -> None:
        _, mean = motion(V[:, 0])
        drag = 3.0 * mean
        noise = DICE.normal(size=N)
        got = metrics(SCENE, trace(V[:, 0], held(drag + noise)))
        assert got["felt_fit"] == pytest.approx(np.var(drag) / (np.var(drag) + np.var(noise)), abs=0.03)

    def test_is_from_the_slaves_first_motion_to_its_first_touch(self) -> None:
        v, until, since = V[:, 0], 900, 300
        a, mean = motion(v)
        force = held(0.2 * a + mean)
        force[:since - 1] = force[until:] = 50.0
        touch, moves = np.zeros(N), v.copy()
        touch[until], moves[:since] = -0.1, 0.0  # once is enough
        got = metrics(SCENE, trace(v, force, f_env=touch, v_s=moves))
        assert (got["felt_mass"], got["felt_drag"]) == pytest.approx((0.2, 1.0), rel=1e-8)

    @pytest.mark.parametrize(("v", "columns"), [
        (np.zeros(N), {}), (np.full(N, 0.3), {}),
        (np.exp(T), {}),  # a is v
        (V[:, 0], {"v_s": np.zeros(N)}), (V[:, 0], {"f_env": np.full(N, 1e-12)}),
    ], ids=["rest", "a steady way", "an exponential", "a slave that never moves", "a slave that always touches"])
    def test_motion_that_does_not_tell_them_apart_has_none(self, v: np.ndarray, columns: dict[str, Any]) -> None:
        assert not [name for name in metrics(SCENE, trace(v, 2.0 * v, **columns)) if name.startswith("felt")]

    def test_ticks_that_a_live_end_skipped_have_no_part_in_it(self) -> None:
        v = V[:, 0]
        a, mean = motion(v)
        keep = np.r_[0:50, 60:N]
        columns = trace(v, held(0.7 * a + 3.0 * mean), t=T)
        got = metrics(SCENE, {name: column[keep] for name, column in columns.items()})
        assert (got["felt_mass"], got["felt_drag"]) == pytest.approx((0.7, 3.0), rel=1e-9)

    def test_waves_to_a_free_slave_have_the_impedance_of_their_closed_form(self) -> None:
        """Z_in = b (1 - G e^-2sT)/(1 + G e^-2sT), G = (b - Z)/(b + Z), Z the slave behind its coupling (ORACLES 5)."""
        b, K, B, m, d, T1, f = 2.0, 500.0, 20.0, 0.5, 1.0, 0.05, 1.0
        scene = Scene(
            law=Wave(b=b, K=K, B=B), hand=Grip(mass=0.0, k=500.0, d=5.0, reference=Sine(amplitude=0.03, frequency=f)),
            master=MassDamper(mass=0.1, damping=0.5), link=Delay(T1), slave=MassDamper(mass=m, damping=d),
            duration=60.0)
        s = 2j * pi * f
        coupling, body = B + K / s, m * s + d
        load = coupling * body / (coupling + body)
        G = (b - load) / (b + load)
        Z = b * (1.0 - G * np.exp(-2.0 * s * T1)) / (1.0 + G * np.exp(-2.0 * s * T1))
        Z = Z * np.exp(-s * DT / 2.0)  # the hold
        got = run(scene).metrics
        assert got["felt_drag"] == pytest.approx(Z.real, rel=0.01)
        assert got["felt_mass"] == pytest.approx(Z.imag / s.imag, rel=0.005)
        assert got["felt_fit"] > 0.98


class TestPressing:
    def test_the_stiffness_of_waves_is_that_of_their_statics(self) -> None:
        """1/(1/K + 1/k_e + (T1 + T2)/(2 b)), of which each is a tick at least (ORACLES 11)."""
        for delay, duration in ((0.0, 5.0), (0.05, 20.0)):
            got = run(load_scene("hard_wall", delay=delay, duration=duration)).metrics
            k = 1.0 / (1.0 / 1000.0 + 1.0 / 2e4 + 2.0 * max(delay, DT) / 40.0)
            assert (got["felt_stiffness"], got["felt_share"], got["f_m_end"]) == pytest.approx(
                (k, k / 2e4, 0.03 / (1.0 / 200.0 + 1.0 / k)), rel=2e-3), delay

    def test_a_bad_link_and_a_wall_of_2_kN_per_m(self) -> None:
        """80 ms +- 20 ms of jitter, 3 % loss: what was found by hand, 14.4 mm rms and 154 N/m felt of 2,000."""
        got = run(load_scene("hard_wall", k_e=2000.0, link="delay(0.06) | uniform(0.04) | bernoulli(0.03)",
                             playout="fixed:0.1:hold", **{"law.b": 20.0, "law.K": 1000.0})).metrics
        assert got["felt_stiffness"] == pytest.approx(154.0, abs=0.5)
        assert got["felt_share"] == pytest.approx(154.0 / 2000.0, rel=0.01)
        assert got["x_err_rms"] == pytest.approx(14.4e-3, abs=0.1e-3)

    def test_a_wall_on_the_other_side_and_a_scaled_slave(self) -> None:
        frame = Basis(1e-3, 1, ((2.0, 5.0),), (-0.04,))  # the wall is at -0.02 m in the master's units
        sums = {"f_m_0": -3.0, "x_m_0": -0.03, "f_env_0": -15.0, "touch_0": 1.0, "x_s_0": -0.045}
        sums = {name: 100.0 * value for name, value in sums.items()}
        found = stiffness(sums, frame)
        assert found["felt_stiffness"] == pytest.approx(3.0 / 0.01)
        assert found["felt_share"] == pytest.approx(3.0 / 0.01 / (3.0 / 0.0025))
        assert stiffness({**sums, "touch_0": 99.0}, frame) == {}  # it left the wall in between
        assert stiffness({**sums, "x_m_0": -1.9}, frame) == {}  # drifted: the master is before the wall

    def test_of_several_axes_those_that_touch(self) -> None:
        frame = Basis(1e-3, 3, ((1.0, 1.0),) * 3, (0.0, 0.0, 0.0))
        sums = {"f_m_0": 2.0, "x_m_0": 0.01, "f_env_0": 2.0, "touch_0": 1.0, "f_m_1": 9.0, "x_m_1": 1.0, "f_env_1": 0.0,
                "touch_1": 0.0, "f_m_2": 4.0, "x_m_2": 0.02, "f_env_2": 4.0, "touch_2": 1.0}
        assert stiffness({name: 100.0 * value for name, value in sums.items()}, frame)["felt_stiffness"] == (
            pytest.approx(200.0))

    def test_a_scene_that_is_moved_to_its_end_has_none(self) -> None:
        scene = load_scene("soft_tissue", duration=1.0)
        assert isinstance(scene.environment, Tissue)
        assert "felt_stiffness" not in run(scene).metrics


class TestSmoothness:
    def test_of_a_sine_and_of_single_jumps(self) -> None:
        w = 2.0 * pi * 4.0
        got = metrics(SCENE, trace(V[:, 0], 3.0 * np.sin(w * T)))
        assert got["jerk_rms"] == pytest.approx(3.0 * w / sqrt(2.0), rel=2e-3)
        assert got["jerk_999"] == pytest.approx(3.0 * w, rel=1e-3)
        for jumps, least in ((1, 0.0), (2, 5.0 / DT)):  # of 1999 steps one may be above it
            force = np.where(np.arange(N) < 700, 0.0, 5.0) * 1.0
            force[1500:] += 5.0 * (jumps - 1)
            assert metrics(SCENE, trace(V[:, 0], force))["jerk_999"] == pytest.approx(least)

    def test_in_three_axes_a_step_is_a_length(self) -> None:
        force = np.zeros((N, 3))
        force[500:] = (3.0, 0.0, -4.0)
        got = metrics(replace(SCENE, axes=3), trace(V, force))
        assert got["jerk_rms"] == pytest.approx(5.0 / DT / sqrt(N - 1))

    def test_at_most_one_step_in_a_thousand_is_above_it(self) -> None:
        for n in (2, 999, 1000, 1001, 2000, 2001, 7345):
            steps = np.sort(DICE.random(n))[::-1]
            value = smoothness({"jerk_sq": 1.0, **{f"rank_{i}": float(step) for i, step in enumerate(steps)}},
                               Basis(1.0, 1, ((1.0, 1.0),), (0.0,)), n + 1)["jerk_999"]
            assert 1000 * np.count_nonzero(steps > value) <= n < 1000 * (np.count_nonzero(steps >= value))
            assert ranks(n + 1) == np.count_nonzero(steps >= value)


class TestTheRest:
    def test_drift_is_of_the_last_tenth_of_a_second_in_the_units_of_the_law(self) -> None:
        x_m, x_s = np.full(N, 0.2), np.where(np.arange(N) % 2, 0.24, 0.22)
        x_s[:-100] = 7.0
        got = metrics(SCENE, trace(V[:, 0], V[:, 0], x_m=x_m, x_s=x_s))
        assert got["drift_end"] == pytest.approx(0.03)
        frame = Basis(1e-3, 2, ((2.0, 1.0), (2.0, 1.0)), (0.0, 0.0))
        sums = {"x_m_0": 100.0, "x_m_1": 50.0, "x_s_0": 206.0, "x_s_1": 92.0}
        assert figures(("drift_end",), sums, frame, 500, 100)["drift_end"] == pytest.approx(0.05)

    def test_energy_given_out_is_the_deepest_that_the_ledger_went(self) -> None:
        ledger = np.concatenate([[0.0, 2.0, -1.5], np.full(N - 3, 0.5)])
        assert metrics(SCENE, trace(V[:, 0], V[:, 0], E_port=ledger))["energy_out"] == 1.5
        assert metrics(SCENE, trace(V[:, 0], V[:, 0], E_port=np.abs(ledger)))["energy_out"] == 0.0

    def test_a_limit_cycle_has_the_frequency_of_the_masters_turns(self) -> None:
        """By an independent count: the spectrum of the master's place over the last seconds."""
        got = run(load_scene("hard_wall", law="direct", delay=0.05, duration=12.0, **{"law.K": 1000.0}))
        assert got.status == "limit cycle"
        late = got.trace["x_m"][-4096:]
        lines = np.abs(np.fft.rfft((late - late.mean()) * np.hanning(4096), 1 << 18))
        assert got.metrics["swing_frequency"] == pytest.approx(lines.argmax() / (1 << 18) / 1e-3, rel=0.01)
        assert f"{got.metrics['swing_frequency']:.3g} Hz" in got.sentence
        assert "swing_frequency" not in run(load_scene("hard_wall", duration=6.0)).metrics


def test_more_ticks_than_are_summed_at_once_have_the_bits_of_a_single_run_in_a_kernel() -> None:
    asked = [name for name in METRICS if name in SUMS or name in ("energy_out", "f_m_max", "E_port_min")]
    assert not needs_record(tuple(asked), load_scene("free_motion"))
    row, = sweep("free_motion", {"delay": [0.02]}, fixed={"duration": 20.0}, seeds=[3], metrics=asked, engine="plain")
    single = run(load_scene("free_motion", delay=0.02, duration=20.0), seed=3).metrics
    assert {each: row.get(each) for each in asked} == {each: single.get(each) for each in asked}


def test_what_is_not_asked_for_has_no_lines_and_the_largest_steps_of_a_long_run_need_its_record() -> None:
    from teleop.sweeps.kernels.kernel import kernel_lines

    scene = load_scene("hard_wall")
    assert "_sums" not in kernel_lines(scene, ("x_err_max", "f_m_max")).text()
    assert "v_was_0_sums" in kernel_lines(scene, ("felt_mass",)).text()
    assert "free_aa_sums" not in kernel_lines(scene, ("jerk_rms",)).text()
    assert not needs_record(("jerk_999",), load_scene("hard_wall", duration=32.0))
    assert needs_record(("jerk_999",), load_scene("hard_wall", duration=32.1))
    assert not needs_record(("jerk_rms",), load_scene("hard_wall", duration=100.0))


def test_a_wall_of_its_own_place_in_each_row() -> None:
    """A row whose environment alone differs takes the kernel of another, and its own place."""
    table = sweep("hard_wall", {"wall": [0.02, 0.03]}, fixed={"duration": 4.0}, metrics=["felt_stiffness"])
    assert table["felt_stiffness"][0] == pytest.approx(table["felt_stiffness"][1], rel=5e-3)
    assert isinstance(load_scene("hard_wall").environment, Wall)
