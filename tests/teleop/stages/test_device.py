"""The device stages of a tick: encoder, estimator, late and slow force, as a run records them."""

from __future__ import annotations

from dataclasses import replace
from math import floor, inf, isnan, nan
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from master.hand import Grip, Sine
from slave.tissue import Tissue
from teleop import PFRA, BackwardDifference, Device, Direct, MassDamper, Scene, VirtualWall, run
from teleop.simulation.source import live_of, rendered
from teleop.simulation.structure import columns, numbers_of
from teleop.simulation.tick import LiveTick
from teleop.stages.encoder import Encoder, encode

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

    def test_is_what_the_law_reads_and_what_a_trace_has_as_q(self) -> None:
        floors, rounds = Device(encoder=Encoder(step=STEP)), Device(encoder=Encoder(step=STEP, phase=0.5))
        trace = run(scene(device_m=floors, device_s=rounds)).trace
        assert trace["q_m"].tolist() == [STEP * floor(x / STEP) for x in trace["x_m"]]
        assert trace["q_s"].tolist() == [STEP * floor(x / STEP + 0.5) for x in trace["x_s"]]
        asked = 200.0 * (trace["q_m"][:-1] - trace["q_s"][1:]) + 5.0 * (trace["v_m"][:-1] - trace["v_s"][1:])
        assert trace["f_s"][1:] == pytest.approx(asked, abs=1e-12)

    def test_does_not_touch_the_ledger_of_what_the_port_really_took(self) -> None:
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

    def test_in_three_axes_is_three(self) -> None:
        device = Device(encoder=Encoder(step=STEP), velocity=BackwardDifference(), delay=2, every=3)
        one = run(scene(device_m=device)).trace
        moved = replace(scene(device_m=device).hand, reference=Sine(amplitude=(0.0, 0.02, 0.02), frequency=2.0))
        tissue = Tissue(k=100.0, d=2.0)
        three = run(scene(device_m=device, hand=moved, axes=3, environment=(None, tissue, tissue))).trace
        for name in ("q_m", "v_hat_m", "f_m"):
            assert (three[name][:, 1] == one[name]).all()
            assert (three[name][:, 2] == one[name]).all()

def test_beyond_what_can_be_counted_a_reading_is_the_same_wherever_it_is_worked_out() -> None:
    """Compiled code counts to 2^63; from 2^53 on every float is a whole number anyway."""
    for x in (1e14, -3.3e20, 1e300):
        assert encode((1e-5, 0.5), x) == pytest.approx(x, rel=1e-15)
    for count in (2.0**53 - 1.0, 2.0**53, 2.0**60):
        assert encode((1.0, 0.0), count) == count
