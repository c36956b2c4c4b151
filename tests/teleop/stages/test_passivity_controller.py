"""The passivity observer and controller on one port."""

from __future__ import annotations

import json
from math import inf, isnan, nan
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop.__main__ import main
from teleop.stages.passivity_controller import PassivityController, damp


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
