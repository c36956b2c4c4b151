"""The stages beside a device: encoder, estimator, late and slow force, observer of the hand, passivity controller."""

from __future__ import annotations

import json
from math import cos, exp, expm1, floor, inf, isnan, nan, pi, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp

from master.hand import Grip, Sine
from slave.tissue import Tissue
from teleop import PFRA, BackwardDifference, Device, Direct, MassDamper, Scene, VirtualWall, load_scene, run
from teleop.__main__ import main
from teleop.simulation.source import live_of, rendered
from teleop.simulation.structure import columns, numbers_of
from teleop.simulation.tick import LiveTick
from teleop.stages.encoder import Encoder, encode
from teleop.stages.observer import coefficients, observe
from teleop.stages.passivity_controller import PassivityController, damp

STEP = 6.1e-5


def scene(**other: Any) -> Scene:
    base: dict[str, Any] = {
        "law": Direct(K=200.0, B=5.0), "master": MassDamper(mass=0.1, damping=0.5),
        "slave": MassDamper(mass=0.5, damping=1.0), "environment": Tissue(k=100.0, d=2.0),
        "hand": Grip(mass=0.4, k=200.0, d=5.0, reference=Sine(amplitude=0.02, frequency=2.0)), "duration": 0.3,
    }
    return Scene(**{**base, **other})


class TestAnEncoder:
    @given(st.floats(-1.0, 1.0), st.floats(1e-7, 1e-2))
    def test_that_floors_is_below_by_less_than_a_step(self, x: float, step: float) -> None:
        read = encode(Encoder(step=step).coefficients(), x)
        slack = 1e-9 * step + 1e-15 * abs(x)  # x/step is rounded
        assert -slack <= x - read < step + slack

    @given(st.floats(-1.0, 1.0), st.floats(1e-7, 1e-2))
    def test_that_rounds_is_off_by_half_a_step_at_most(self, x: float, step: float) -> None:
        slack = 1e-9 * step + 1e-15 * abs(x)
        assert abs(x - encode(Encoder(step=step, phase=0.5).coefficients(), x)) <= 0.5 * step + slack

    def test_leaves_alone_what_it_cannot_count(self) -> None:
        c = Encoder(step=1e-5).coefficients()
        assert encode(c, inf) == inf
        assert isnan(encode(c, nan))

    def test_is_what_the_law_reads_and_the_trace_has_as_q_and_not_what_the_ledger_of_the_port_takes(self) -> None:
        floors, rounds = Device(encoder=Encoder(step=STEP)), Device(encoder=Encoder(step=STEP, phase=0.5))
        trace = run(scene(device_m=floors, device_s=rounds)).trace
        assert trace["q_m"].tolist() == [STEP * floor(x / STEP) for x in trace["x_m"]]
        assert trace["q_s"].tolist() == [STEP * floor(x / STEP + 0.5) for x in trace["x_s"]]
        asked = 200.0 * (trace["q_m"][:-1] - trace["q_s"][1:]) + 5.0 * (trace["v_m"][:-1] - trace["v_s"][1:])
        assert trace["f_s"][1:] == pytest.approx(asked, abs=1e-12)
        got = run(scene(energy=True, device_m=Device(encoder=Encoder(step=1e-3)))).trace
        taken = np.cumsum(got["f_m"][:-1] * np.diff(got["x_m"])) - np.cumsum(got["f_s"][:-1] * np.diff(got["x_s"]))
        assert got["E_port"][1:] == pytest.approx(taken, abs=1e-12)

class TestAnEstimator:
    def test_gives_the_law_its_velocity_and_the_trace_v_hat(self) -> None:
        got = run(scene(device_m=Device(velocity=BackwardDifference()), device_s=Device(velocity=BackwardDifference())))
        trace = got.trace
        for e in "ms":
            assert trace[f"v_hat_{e}"][1:] == pytest.approx(np.diff(trace[f"x_{e}"]) / 1e-3, abs=1e-12)
        asked = 200.0 * (trace["x_m"][:-1] - trace["x_s"][1:]) + 5.0 * (trace["v_hat_m"][:-1] - trace["v_hat_s"][1:])
        assert trace["f_s"][1:] == pytest.approx(asked, abs=1e-12)

    def test_knows_over_how_many_ticks_a_stall_went(self) -> None:
        of = scene(device_m=Device(velocity=BackwardDifference()))
        begins = numbers_of(of, {"m": (0.0,)})
        live = live_of(of, "m")(begins, of.law, 1e-3, (0.0,), (0.0,), None)
        live.send(None)
        seen, force = [], (0.0,)
        for k, x in ((0, 0.0), (1, 0.001), (5, 0.009), (6, 0.009)):  # the ticks 2 to 4 were missed
            force, _, _, row = live.send(LiveTick(
                k, (x,), (99.0,), None, False, -1, None, None, 1.0, force, 1, 0.0, 1.0))
            seen.append(row[columns(of, "m").index("v_hat_m@")])
        assert seen == pytest.approx([0.0, 1.0, 2.0, 0.0])

    def test_is_what_the_observer_of_the_hand_works_with(self) -> None:
        exact = run(scene(law=PFRA(alpha=0.5)))
        device = Device(encoder=Encoder(step=1e-3), velocity=BackwardDifference())
        coarse = run(scene(law=PFRA(alpha=0.5), device_m=device))
        assert np.abs(coarse.trace["f_h_hat"]).max() > 2.0 * np.abs(exact.trace["f_h_hat"]).max()


class TestAForce:
    def test_that_is_late_or_slow_is_that_of_a_tick_before(self) -> None:
        """Computed so many ticks after its reading; renewed every so many; of both kinds first late and then held."""
        for delay, every in ((1, 1), (7, 1), (0, 2), (0, 5), (3, 4)):
            device = Device(delay=delay, every=every)
            trace = run(scene(law=VirtualWall(K=300.0), slave=None, environment=None, device_m=device)).trace
            read = np.arange(len(trace["t"])) // every * every - delay
            newest = np.where(read >= 0, trace["x_m"][np.maximum(read, 0)], 0.0)
            assert trace["f_m"].tolist() == [300.0 * x if x > 0.0 else 0.0 for x in newest], (delay, every)


class TestADevice:
    def test_that_adds_nothing_changes_no_bit(self) -> None:
        plain, with_device = run(scene()).trace, run(scene(device_m=Device(), device_s=Device())).trace
        assert all((plain[name] == with_device[name]).all() for name in plain)
        assert rendered(scene()) == rendered(scene(device_m=Device()))


def test_beyond_what_can_be_counted_a_reading_is_the_same_wherever_it_is_worked_out() -> None:
    """Compiled code counts to 2^63; from 2^53 on every float is a whole number anyway."""
    for x in (1e14, -3.3e20, 1e300):
        assert encode((1e-5, 0.5), x) == pytest.approx(x, rel=1e-15)
    for count in (2.0**53 - 1.0, 2.0**53, 2.0**60):
        assert encode((1.0, 0.0), count) == count


INSTANT = 1e9  # 1/s: a filter so fast that f_h_hat is f_bar itself

masses, dampings = st.floats(0.01, 10.0), st.one_of(st.just(0.0), st.floats(1e-9, 100.0))
ticks = st.sampled_from([1e-4, 1e-3, 1e-2])


def speed_after(v: float, f: float, M: float, b: float, dt: float) -> float:
    """M dv/dt + b v = f over dt, f constant; in closed form."""
    decay = b * dt / M
    return v * exp(-decay) + (f / b * -expm1(-decay) if b > 0.0 else f * dt / M)


@given(M=masses, b=dampings, dt=ticks, f_h=st.floats(-50.0, 50.0), f_m=st.floats(-50.0, 50.0), v=st.floats(-2.0, 2.0))
@settings(max_examples=80)
def test_a_constant_force_is_observed_exactly(M: float, b: float, dt: float, f_h: float, f_m: float, v: float) -> None:
    c = coefficients(INSTANT, M, b, dt)
    after = speed_after(v, f_h - f_m, M, b, dt)
    # What is lost is the last digit of the velocities times the gain, or the last of the smallest number.
    lost = 1e-15 * (c.gain * (abs(v) + abs(after)) + abs(f_m) + abs(f_h)) + 1e-300
    assert observe(c, 0.0, v, after, f_m) == pytest.approx(f_h, abs=4.0 * lost)


@pytest.mark.parametrize("b", [0.0, 1e-6, 0.5, 40.0])
def test_a_varying_force_is_observed_as_its_exponentially_weighted_mean(b: float) -> None:
    """Against quadrature of the weight and a tight integration of the motion: sine of the hand, 1 kHz."""
    M, dt, f_m, omega = 0.1, 1e-3, 1.3, 2.0 * pi * 40.0

    def f_h(t: float) -> float:
        return 5.0 * sin(omega * t) + 2.0

    def weight(t: float) -> float:
        return exp(-b * (dt - t) / M)

    def motion(t: float, v: np.ndarray) -> np.ndarray:
        return (f_h(t) - f_m - b * v) / M

    c = coefficients(INSTANT, M, b, dt)
    after = solve_ivp(motion, (0.0, dt), [0.2], method="DOP853", rtol=1e-13, atol=1e-15).y[0, -1]
    mean = quad(lambda t: f_h(t) * weight(t), 0.0, dt, epsabs=1e-14)[0] / quad(weight, 0.0, dt, epsabs=1e-14)[0]
    assert observe(c, 0.0, 0.2, after, f_m) == pytest.approx(mean, abs=1e-10)


@given(M=masses, dt=ticks, v=st.floats(-2.0, 2.0), after=st.floats(-2.0, 2.0), f_m=st.floats(-50.0, 50.0))
def test_without_damping_it_is_mass_times_acceleration_and_the_limit_is_smooth(
        M: float, dt: float, v: float, after: float, f_m: float) -> None:
    none = observe(coefficients(INSTANT, M, 0.0, dt), 0.0, v, after, f_m)
    assert none == pytest.approx(M * (after - v) / dt + f_m, abs=1e-12 * M / dt)
    for little in (1e-300, 1e-18, 1e-9):
        near = observe(coefficients(INSTANT, M, little, dt), 0.0, v, after, f_m)
        assert near == pytest.approx(none, abs=2.0 * little + 1e-12 * M / dt)


@given(L=st.floats(1.0, 1000.0), f_h=st.floats(-50.0, 50.0), b=dampings)
def test_it_comes_to_a_constant_force_as_a_first_order_filter(L: float, f_h: float, b: float) -> None:
    """f_h_hat(t) = f_h (1 - exp(-L t)), exactly at every tick, whatever f_m does meanwhile."""
    M, dt, v, f_h_hat = 0.1, 1e-3, 0.0, 0.0
    c = coefficients(L, M, b, dt)
    for k in range(1, 101):
        f_m = cos(k)
        after = speed_after(v, f_h - f_m, M, b, dt)
        f_h_hat = observe(c, f_h_hat, v, after, f_m)
        v = after
        assert f_h_hat == pytest.approx(f_h * -expm1(-L * k * dt), abs=1e-10)


def test_a_stall_of_many_ticks_does_not_throw_the_live_estimate_off() -> None:
    """A held force and a constant hand, seen again after 70 ticks: the estimate is the hand's force still."""
    scene = load_scene("canonical", law="pfra", observer=INSTANT)
    M, b, dt = scene.master.mass, scene.master.damping, 1e-3
    begins = numbers_of(scene, {"m": (0.0,)})
    live = live_of(scene, "m")(begins, scene.law, dt, (0.0,), (0.0,), None)
    live.send(None)
    at = [name.removesuffix("@") for name in columns(scene, "m")].index("f_h_hat")
    v, before, f_m = 0.0, 0, 0.0
    for k in (0, 1, 2, 72, 73, 200):
        v, before = speed_after(v, 0.3 - f_m, M, b, (k - before) * dt), k
        force, _, _, row = live.send(LiveTick(
            k, (0.0,), (v,), None, False, -1, None, None, 1.0, (f_m,), 1, 0.0, 1.0))
        f_m = force[0]
        if k:
            assert row[at] == pytest.approx(0.3, abs=1e-9)


class TestTheController:
    @given(st.floats(-1.0, 1.0), st.floats(-10.0, 10.0), st.floats(0.0, 100.0), st.floats(0.0, 1.0))
    def test_only_ever_brakes_and_never_above_its_cap(self, E: float, v: float, cap: float, v_min: float) -> None:
        f = damp(PassivityController(cap=cap, v_min=v_min).limits(1e-3), E, v)
        assert f * v >= 0.0
        assert abs(f) <= cap * abs(v) * (1.0 + 1e-12)

    @given(st.floats(-1.0, -1e-9), st.floats(1e-3, 10.0))
    def test_without_a_cap_takes_up_the_balance_within_a_tick(self, E: float, v: float) -> None:
        f = damp(PassivityController(cap=1e300).limits(1e-3), E, v)
        assert f * v * 1e-3 == pytest.approx(-E)

    def test_leaves_a_passive_port_and_a_slow_one_alone_and_stands_what_is_extreme_or_no_number(self) -> None:
        c = PassivityController(cap=5.0, v_min=0.01).limits(1e-3)
        assert damp(c, 1e-9, 1.0) == damp(c, 0.0, -1.0) == damp(c, -1.0, 0.01) == 0.0
        assert damp(c, -1.0, -0.011) == pytest.approx(-0.055)
        c = PassivityController(cap=5.0).limits(1e-3)
        assert isnan(damp(c, nan, 1.0))
        assert damp(c, -1e300, 1e-200) == pytest.approx(5e-200)
        assert damp(c, -inf, 1.0) == 5.0

class TestAWallAFingerAnEncoder:
    """A lab's five runs (m = 0.04 kg, b = 0.8 N s/m, 1024 lines on 10 mm, 40 sub-steps a tick): to its digits."""

    @pytest.mark.parametrize(("knobs", "peak", "swing", "energy"), [
        ("K=400", "33.53", "0.001", "-0.32"),
        ("K=2500", "31.79", "1.658", "-17.6"),
        ("K=2500 cap=0.8", "31.79", "0.080", "-1.81"),
        ("K=400 every=5", "34.07", "5.277", "-69.7"),
        ("K=400 every=5 cap=0.8", "33.90", "0.001", "-1.44"),
    ])
    def test_is_reproduced_from_the_command_line_with_the_labs_own_integrator(
            self, knobs: str, peak: str, swing: str, energy: str, tmp_path: Path) -> None:
        set_ = [word for knob in knobs.split() for word in ("--set", knob)]
        out = tmp_path / "out"
        assert main(["run", "encoder_wall", *set_, "--bodies", "semi-implicit:40", "--out", str(out)]) == 0
        trace = np.load(out / "trace.npz")
        x = 1e3 * trace["x_m"]
        assert f"{x.max():.2f}" == peak
        assert f"{np.ptp(x[1000:]):.3f}" == swing
        observed = 1e3 * float(np.sum(trace["f_m"][:-1] * np.diff(trace["q_m"])))  # each force with its own step
        assert f"{observed:.{len(energy.partition('.')[2])}f}" == energy
        if "cap" in knobs:
            assert trace["E_po"][-1] * 1e3 == pytest.approx(observed, abs=1e-9)
        summary = json.loads((out / "summary.json").read_text())
        assert summary["bodies"] == "semi_implicit_euler:40"
        assert any("semi-implicit Euler, 40 sub-steps a tick" in note for note in summary["notes"])
