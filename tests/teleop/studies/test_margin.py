"""Margins of scenes: published cases, what is taken for what, and where there is none."""

from __future__ import annotations

from math import inf, isnan
from typing import Any

import pytest

from channel import Delay
from master import Grip, Rest
from slave import HuntCrossley, Tissue, Wall
from teleop import Direct, MassDamper, PositionPosition, Scene, load_scene, run, sweep
from teleop.analysis.stability.assess import is_stable, stability
from teleop.studies.margin import delay_margin, gain_margin, margin, stable_with

HANDLE = MassDamper(mass=0.04, damping=0.8)


def handles(law: Any, environment: Any, **more: Any) -> Scene:
    """Two handles and a hand of 100 N/m and 2 N s/m."""
    return Scene(law=law, hand=Grip(mass=0.0, k=100.0, d=2.0, reference=Rest()), master=HANDLE, slave=HANDLE,
                 environment=environment, **more)


@pytest.mark.parametrize(("law", "wall", "first"), [
    (Direct(K=400.0, B=4.0), 400.0, 9), (Direct(K=2000.0, B=8.0), 2000.0, 2),
    (PositionPosition(K=2000.0, B=8.0), 2000.0, 11)])
def test_a_wall_has_the_delay_margin_of_the_slave_that_stays_in_it(law: Any, wall: float, first: int) -> None:
    """ORACLES 6: sampled at 1 kHz these are first unstable at round trips of so many ticks; the least there is is 2."""
    found = margin(handles(law, Wall(k=wall, at=0.01)))
    assert found.delay == pytest.approx((first - 1 - 2) * 1e-3)


def test_the_gain_margin_is_the_factor_on_the_force_that_is_fed_back() -> None:
    wall = Wall(k=400.0, at=0.01)
    found = margin(handles(Direct(K=400.0, B=4.0), wall, link=Delay(0.002)))
    for share, stable in ((0.999, True), (1.001, False)):
        law = Direct(K=400.0, B=4.0, kf=share * found.gain)
        assert is_stable(handles(law, Tissue(k=400.0, d=0.0), link=Delay(0.002))) == stable
    assert found.gain > 1.0
    assert found.where == "in contact"


@pytest.mark.full
def test_axes_with_parts_of_their_own_have_the_margins_of_the_worst() -> None:
    own = stability(load_scene("pose", f_max=None, slew=None, k_e=0.0, d_e=0.0))
    assert gain_margin(run(load_scene("pose", duration=0.02))) == own.gain_margin  # its wall takes none


def test_a_loop_stands_what_its_margin_says() -> None:
    scene = load_scene("hard_wall", law=Direct(K=100.0, B=20.0, kf=0.05), delay=0.03)
    gain = margin(scene).gain
    assert 1.0 < gain < 1e3
    for factor in (0.6, 0.95, 1.05, 1.6):
        stood = stable_with(scene, factor * gain)
        assert stood[0] == (factor < 1.0), factor
        assert ("times its gain is unstable" in stood[1]) == (factor > 1.0), factor


@pytest.mark.full
def test_small_motion_is_judged_without_caps_encoders_and_friction_and_a_passive_law_stands_every_delay() -> None:
    plain = margin(load_scene("hard_wall", f_max=None, slew=None))
    assert plain.delay == inf
    assert plain == margin(load_scene("hard_wall")) == margin(load_scene("hard_wall", f_max=5.0, power=0.1))
    assert margin(load_scene("encoder_wall", step=1e-4)) == margin(load_scene("encoder_wall", step=1e-6))


@pytest.mark.full
def test_a_link_that_varies_is_taken_for_its_median_age_and_the_queue() -> None:
    law = {"law": "p_d", "law.B": 30.0}
    varied = load_scene("hard_wall", link="delay(0.03) | uniform(0.02) ; delay(0.01) | bernoulli(0.3)", **law)
    found = margin(varied, seed=4)
    told = found.assumed[0].removeprefix("the link delays by ").removesuffix(" s and 0.01 s, its median ages")
    assert float(told) == pytest.approx(run(varied, seed=4).metrics["T_fwd_mean"], abs=1.5e-3)
    assert found[:3] == margin(load_scene("hard_wall", link=f"delay({told}) ; delay(0.01)", **law))[:3]
    queued = margin(load_scene("hard_wall", playout="integral:0.02"))
    assert queued.assumed == ("the link delays by 0.07 s and 0.07 s, its median ages",)
    left = margin(load_scene("hard_wall", left_out=0.1))
    assert left.assumed == ("the link delays by 0.05 s and 0.05 s, its median ages",)


def test_what_has_no_linear_form_has_none_and_says_why() -> None:
    found = margin(load_scene("hard_wall", law="pfra"))
    assert isnan(found.gain)
    assert isnan(found.delay)
    assert "pfra is not linear" in found.why
    bounded = margin(handles(Direct(), HuntCrossley(k=1e4)))
    assert isnan(bounded.gain)
    assert "HuntCrossley" in bounded.why


def test_it_is_a_metric_of_runs_and_sweeps() -> None:
    knobs = {"law": "direct", "duration": 0.1, "delay": 0.002}
    table = sweep("hard_wall", {"law.K": [10.0, 1000.0]}, fixed=knobs, metrics=[gain_margin, delay_margin])
    own = [margin(load_scene("hard_wall", **knobs, **{"law.K": K})) for K in (10.0, 1000.0)]
    assert table["gain_margin"].tolist() == [each.gain for each in own]
    assert table["delay_margin"].tolist() == [each.delay for each in own]
    result = run(load_scene("virtual_wall", duration=0.1))
    assert gain_margin(result) == margin(load_scene("virtual_wall")).gain > 1.0
