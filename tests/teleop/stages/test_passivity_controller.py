"""The passivity observer and controller on one port."""

from __future__ import annotations

from dataclasses import replace
from math import inf, isnan, nan, pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenarios.encoder_wall import scene as encoder_wall
from teleop.analysis.precision.contenders.contenders import method_bodies
from teleop.analysis.precision.contenders.methods import METHODS
from teleop.errors import Refused
from teleop.simulation.result import Result
from teleop.simulation.virtual import run
from teleop.stages.passivity_controller import PassivityController, damp

SEMI_IMPLICIT = next(method for method in METHODS if method.name == "semi_implicit_euler")


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

    def test_leaves_a_passive_port_and_a_slow_one_alone(self) -> None:
        c = PassivityController(cap=5.0, v_min=0.01).limits(1e-3)
        assert damp(c, 1e-9, 1.0) == damp(c, 0.0, -1.0) == damp(c, -1.0, 0.01) == 0.0
        assert damp(c, -1.0, -0.011) == pytest.approx(-0.055)

    def test_shows_what_is_not_a_number_and_stands_what_is_extreme(self) -> None:
        c = PassivityController(cap=5.0).limits(1e-3)
        assert isnan(damp(c, nan, 1.0))
        assert damp(c, -1e300, 1e-200) == pytest.approx(5e-200)
        assert damp(c, -inf, 1.0) == 5.0

    @pytest.mark.parametrize("wrong", [{"cap": -1.0}, {"cap": 1.0, "v_min": -1.0}, {"cap": nan}])
    def test_that_cannot_be_is_refused(self, wrong: dict[str, float]) -> None:
        with pytest.raises(Refused):
            PassivityController(**wrong)


def observed(result: Result) -> float:
    """Energy (mJ) that the port took, in readings, each held force with the step it was held over."""
    trace = result.trace
    return 1e3 * float(np.sum(trace["f_m"][:-1] * np.diff(trace["q_m"])))


class TestAWallAFingerAnEncoder:
    """A lab's five runs (m = 0.04 kg, b = 0.8 N s/m, 1024 lines on 10 mm, 40 sub-steps a tick): to its digits."""

    @pytest.mark.parametrize(("K", "every", "cap", "peak", "swing", "energy"), [
        (400.0, 1, None, "33.53", "0.001", "-0.32"),
        (2500.0, 1, None, "31.79", "1.658", "-17.6"),
        (2500.0, 1, 0.8, "31.79", "0.080", "-1.81"),
        (400.0, 5, None, "34.07", "5.277", "-69.7"),
        (400.0, 5, 0.8, "33.90", "0.001", "-1.44"),
    ])
    def test_is_reproduced_with_the_labs_own_integrator(
        self, K: float, every: int, cap: float | None, peak: str, swing: str, energy: str
    ) -> None:
        scene = encoder_wall(K=K, every=every, cap=cap)
        got = run(scene, bodies=method_bodies(scene, SEMI_IMPLICIT, 40))
        x = 1e3 * got.trace["x_m"]
        assert f"{x.max():.2f}" == peak
        assert f"{np.ptp(x[1000:]):.3f}" == swing
        places = len(energy.partition(".")[2])
        assert f"{observed(got):.{places}f}" == energy
        if cap is not None:
            assert got.trace["E_po"][-1] * 1e3 == pytest.approx(observed(got), abs=1e-9)

    def test_hums_at_the_frequencies_that_were_seen(self) -> None:
        for K, every, seen in ((2500.0, 1, 34.0), (400.0, 5, 21.0)):
            x = run(encoder_wall(K=K, every=every)).trace["x_m"][500:]
            lines = np.abs(np.fft.rfft((x - x.mean()) * np.hanning(len(x))))
            assert lines.argmax() / (len(x) * 1e-3) == pytest.approx(seen, abs=1.01)

    def test_the_pairing_with_the_step_before_would_report_a_leak_as_dissipation(self) -> None:
        scene = encoder_wall(K=2500.0)
        got = run(scene, bodies=method_bodies(scene, SEMI_IMPLICIT, 40))
        backward = 1e3 * float(np.sum(got.trace["f_m"][1:] * np.diff(got.trace["q_m"])))
        assert observed(got) == pytest.approx(-17.6, abs=0.05)
        assert 15.0 < backward < 25.0


class TestTheObserver:
    def test_sums_what_the_readings_say_and_reads_nothing_else(self) -> None:
        trace = run(encoder_wall(K=2500.0, cap=0.8)).trace
        sums = np.concatenate([[0.0], np.cumsum(trace["f_m"][:-1] * np.diff(trace["q_m"]))])
        assert trace["E_po"] == pytest.approx(sums, abs=1e-15)

    def test_with_a_high_cap_keeps_a_free_device_passive_where_it_was_not(self) -> None:
        """Without an encoder what is observed is what the port took, and the damping pays it back."""
        bare = replace(encoder_wall(K=2500.0, step=None, f_max=1e3), cap=None)
        kept = replace(bare, passivity=PassivityController(cap=30.0))
        assert run(bare).trace["E_port"].min() < -1e-3
        assert run(kept).trace["E_port"].min() > 0.02 * run(bare).trace["E_port"].min()

    def test_is_not_there_where_it_is_not_named(self) -> None:
        assert "E_po" not in run(encoder_wall()).trace
        assert 2.0 * pi * 0.01 / 1024.0 == pytest.approx(6.136e-5, rel=1e-3)
