"""A virtual coupling around a law: a spring in series, a tool with a mass of its own, and what the device has to be."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from teleop import PFRA, TDPA, At, Direct, PDamped, Refused, Wave, around, check_law, facts_of, load_scene, run
from teleop.analysis.models.linear import linear_scene
from tests.engines.engines import one_lane_after_the_other

WAVES = {0.0: 3.9736, 0.05: 0.936037}  # N, pressed for ever by hard_wall: without a coupling, see test_touch


@pytest.mark.full
@pytest.mark.parametrize(("stages", "law"), [
    (stages, law) for stages in ("virtual_coupling", "guard | virtual_coupling")
    for law in (Wave(), Direct(), PFRA(), TDPA())])
def test_it_stands_around_every_kind_of_law(stages: str, law: Any) -> None:
    check_law(around(stages, law), compiled=False)


@pytest.mark.full
@pytest.mark.parametrize(("delay", "K"), [(0.0, 400.0), (0.05, 100.0)])
def test_pressed_for_ever_it_is_a_spring_in_series(delay: float, K: float) -> None:
    """f = way/(sum of all that gives way), so the coupling adds 1/K to what the waves alone leave of 30 mm."""
    law = around(f"virtual_coupling(K={K}, B=2.0)", Wave())
    result = run(load_scene("hard_wall", law=law, delay=delay, duration=20.0))
    assert result.metrics["f_m_end"] == pytest.approx(0.03 / (0.03 / WAVES[delay] + 1.0 / K), rel=1e-3)


def test_a_stiff_coupling_to_a_heavy_tool_is_a_heavier_device() -> None:
    """With the tool's mass of 1 kg and K = 10 kN/m, the felt mass in free motion is that of the waves and 1 kg more."""
    free = load_scene("free_motion", delay=0.0)
    alone = run(replace(free, law=Wave())).metrics["felt_mass"]
    law = around("virtual_coupling(K=1e4, B=5.0, mass=1.0, damping=0.0)", Wave())
    assert run(replace(free, law=law)).metrics["felt_mass"] == pytest.approx(alone + 1.0, rel=0.02)


def test_a_device_that_is_let_go_takes_the_tool_with_it() -> None:
    """Otherwise the coupling would be stretched by all that the hand moves meanwhile."""
    law = around("virtual_coupling(K=400.0)", Direct())
    s, rx = law.master_start(At(0.0, 0.0, 0.0, 0.0, 0.0, False, 1.0, 1e-3, 1e-3))
    for k in range(1, 301):
        at = At(1e-3 * k, 1.0, 0.0, 0.0, 1e-3, False, 1.0, 1e-3, 1e-3, 0.0)
        f_m, _, s = law.master(s, at, rx)
    assert abs(f_m) < 1.0
    assert s.virtual_coupling_y == pytest.approx(0.3, abs=2e-3)


def test_what_a_law_sums_over_the_axes_is_of_the_tool() -> None:
    law, at = around("virtual_coupling", TDPA()), At(2e-3, 0.5, 0.0, 3.0, 2e-3, True, 0.0, 1e-3, 1e-3)
    s, rx = law.master_start(at._replace(x=0.0, v=0.0))
    over = law.master_sums(s, at, rx)
    assert over.w == 0.0  # on which nothing was held yet, as 3 N were on the device
    assert over.vv == law.master(s, at, rx, over)[2].virtual_coupling_u ** 2


def test_what_the_device_has_to_have_is_told() -> None:
    scene = load_scene("hard_wall")
    own = scene.master.damping
    for law, said in ((around("virtual_coupling(K=2000.0, B=0.0)", Direct()), "law.virtual_coupling_K=1000"),
                      (around("virtual_coupling(K=400.0, B=1.0)", Direct()), "law.virtual_coupling_B=0.3 is the most")):
        told = law.conditions(facts_of(replace(scene, law=law)))
        assert own == 0.5
        assert [said in one for one in told] == [True]
    assert around("virtual_coupling", Direct()).conditions(facts_of(scene)) == ()


def test_the_law_around_which_it_stands_has_the_tool_for_a_master() -> None:
    """P+d is as well damped as the tool is."""
    alone = PDamped(K=400.0, B=15.0)
    facts = facts_of(load_scene("hard_wall", law=alone, delay=0.05))
    assert len(alone.conditions(facts)) == 1
    assert around("virtual_coupling(damping=0.5)", alone).conditions(facts) == alone.conditions(facts)
    assert around("virtual_coupling(damping=30.0)", alone).conditions(facts) == ()


def test_it_is_linear_as_its_law_is() -> None:
    scene = replace(load_scene("soft_tissue", law=around("virtual_coupling", Direct())), cap=None, watchdog=None)
    assert type(scene.law.linear()) is type(scene.law)
    linear_scene(scene)


def test_its_lines_run_over_all_lanes_at_once() -> None:
    of = load_scene("canonical", law=around("virtual_coupling", Wave()))
    assert one_lane_after_the_other(of) == {"move_wall"}


def test_the_one_port_law_of_this_name_is_still_that() -> None:
    assert load_scene("virtual_coupling", law="virtual_coupling(K=500)").law.K == 500.0
    with pytest.raises(Refused, match="stands around a law with two ends"):
        load_scene("hard_wall", law="guard | virtual_coupling")
