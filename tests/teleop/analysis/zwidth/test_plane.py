"""The stable region, and what comes to rest in virtual time: published numbers, eigenvalues, runs beside the edge."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import teleop.analysis.zwidth.assess
import teleop.analysis.zwidth.plane
from master.hand import Grip, Rest
from teleop import BackwardDifference, Device, ElectricalDamping, MassDamper, Scene, VirtualWall, load_scene, run
from teleop.analysis.models.law_parts import with_gains
from teleop.analysis.models.rest import FreeMotion, settled
from teleop.analysis.stability.assess import critical
from teleop.analysis.zwidth.assess import let_go, stiffest_at_rest
from teleop.analysis.zwidth.passive import passive_region
from teleop.analysis.zwidth.plane import (
    Span,
    boundary,
    is_stable,
    loop,
    most_damping,
    passive_line,
    published_rule,
    rows,
)
from tests.fakes import OneSpring, law_of

# The spring-damper with K^2 over 1 kN/m as its stiffness.
Squared = law_of(OneSpring, force=lambda law, s, at: (law.K * law.K * 1e-3 * at.x + law.B * at.v, s))


def handle(law: Any = None, *, m: float = 0.04, b: float = 0.8, dt: float = 1e-3, hand: Any = None,
           electrical: Any = None, **device: Any) -> Scene:
    return Scene(law=law or VirtualWall(), master=MassDamper(mass=m, damping=b), hand=hand, dt=dt, duration=1.0,
                 electrical=electrical, device_m=Device(velocity=BackwardDifference(), **device))


def finger(mass: float = 0.0) -> Grip:
    return Grip(mass=mass, k=400.0, d=1.0, reference=Rest())


def edge(scene: Scene, B: float = 0.0) -> float:
    return boundary(loop(scene, hand=scene.hand is not None), [B]).K[0]


class TestEdge:
    def test_the_critical_stiffness_of_a_free_handle_and_the_published_lines_beside_it(self) -> None:
        """With a damper as strong as the device the published rule errs the other way."""
        for d, B, K, rule in ((0, 0.0, 1605.35, 1600.0), (1, 0.0, 536.28, 533.33), (5, 0.0, 148.08, 145.45),
                              (10, 0.0, 78.745, 76.19), (100, 0.0, 9.7415, 7.960), (5, 0.8, 282.69, 290.91)):
            scene = handle(delay=d)
            assert edge(scene, B) == pytest.approx(K, abs=6e-3 if K > 100.0 else 6e-4)
            assert published_rule(scene, np.array([B])) == pytest.approx(rule, abs=5e-3)
            assert passive_line(scene, np.array([0.0, 0.4, 0.8])) == pytest.approx([1600.0, 800.0, 0.0])

    @pytest.mark.parametrize("knobs", [
        {"B": 2.0, "delay": 4, "hand": 0.0}, {"B": 0.5, "b_e": 1.0}, *(pytest.param(each, marks=pytest.mark.full)
            for each in ({"B": 0.5}, {"B": 0.5, "hand": 0.02}, {"B": 1.0, "every": 5}, {"delay": 30, "hand": 0.0}))])
    def test_runs_in_virtual_time_die_just_inside_and_grow_just_outside(self, knobs: dict[str, Any]) -> None:
        parts = {"B": 0.0, "hand": None, "b_e": None, **knobs}
        B, mass, b_e = (parts.pop(name) for name in ("B", "hand", "b_e"))
        scene = handle(OneSpring(B=B), hand=None if mass is None else finger(mass),
                       electrical=b_e and ElectricalDamping(b=b_e, cutoff=20.0), **parts)
        K = edge(scene, scene.law.B)
        for factor, grows in ((0.98, False), (1.02, True)):
            one = replace(with_gains(scene, factor * K, scene.law.B), start_m=1e-3, duration=6.0)
            x = np.abs(run(one).trace["x_m"])
            assert (x[-len(x) // 4:].max() > x[len(x) // 4:len(x) // 2].max()) == grows

    def test_it_is_what_the_search_of_the_stability_command_finds(self) -> None:
        scene = handle(hand=finger(), delay=2)
        found = critical(lambda K: with_gains(scene, K, 0.3), "K", low=10.0, high=1e4)
        assert edge(scene, 0.3) == pytest.approx(found.value, rel=1e-5)

    @pytest.mark.parametrize("hand", [None, finger()])
    def test_with_many_ticks_of_delay_it_is_found_without_eigenvalues_and_the_same(
        self, hand: Any, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        scene = handle(hand=hand, delay=9)
        by_roots = loop(scene, hand=True)
        some = [0.0, 1.0, 3.0, 5.0]
        expected, most = boundary(by_roots, some).K, most_damping(by_roots)
        monkeypatch.setattr(teleop.analysis.zwidth.plane, "MANY", 0)
        crossed = loop(scene, hand=True)
        assert by_roots.opened is None
        assert crossed.opened is not None
        assert pytest.approx(expected, rel=1e-7) == boundary(crossed, some).K
        assert most_damping(crossed) == pytest.approx(most, rel=1e-5)

    def test_a_loop_that_is_not_affine_is_asked_place_by_place(self) -> None:
        squared = loop(handle(Squared(K=800.0)), hand=False)
        assert squared.coarse
        assert boundary(squared, [0.0]).K[0] == pytest.approx((1e3 * 1605.35) ** 0.5, rel=1e-4)

    def test_the_stiffness_scales_with_mass_and_all_damping_and_with_the_rate_at_the_same_mass_over_time(self) -> None:
        own = edge(handle(delay=1), 0.5)
        assert edge(handle(m=0.12, b=2.4, delay=1), 1.5) == pytest.approx(3.0 * own, rel=1e-7)
        assert edge(handle(m=0.02, dt=5e-4, delay=1), 0.5) == pytest.approx(2.0 * own, rel=1e-7)


class TestRegion:
    @pytest.mark.full
    def test_what_is_passive_is_stable_in_any_hand(self) -> None:
        for d in (0, 7):
            corners = np.array(passive_region(handle(delay=d)).corners)
            for hand in (None, finger(), finger(0.5)):
                scene = handle(hand=hand, delay=d)
                assert is_stable(loop(scene, hand=True), 0.999 * corners[:, 0], 0.999 * corners[:, 1]).all(), (d, hand)

    def test_with_a_shunt_too_and_four_times_as_far_out_it_is_not(self) -> None:
        for k in (1e4, 50.0, 0.0):
            for mass in (1.0, 0.0):
                scene = handle(hand=Grip(mass=mass, k=k, d=0.0, reference=Rest()),
                               electrical=ElectricalDamping(b=2.0, cutoff=10.0))
                corners = np.array(passive_region(scene).corners)
                assert is_stable(loop(scene, hand=True), 0.999 * corners[:, 0], 0.999 * corners[:, 1]).all(), (k, mass)
        assert not is_stable(loop(scene, hand=True), *(4.0 * corners[corners[:, 0].argmax()]))

    def test_more_damping_of_the_device_never_narrows_it(self) -> None:
        some = [0.0, 1.0, 5.0, 20.0]
        weak, strong = (boundary(loop(handle(b=b), hand=False), some).K for b in (0.8, 1.6))
        assert all(less < more for less, more in zip(weak, strong, strict=True))

    def test_its_rows_end_where_no_stiffness_is_stable_and_a_range_bounds_where_it_is_looked_for(self) -> None:
        free = loop(handle(), hand=False)
        B = rows(free, Span(), Span())
        assert (len(B), B[0]) == (41, 0.0)
        assert is_stable(free, 1.0, 0.999 * B[-1])
        assert not is_stable(free, 1.0, 1.001 * B[-1])
        assert rows(free, Span(1.0, 3.0), Span())[0::40] == [1.0, 3.0]
        assert boundary(free, [0.0], Span(0.0, 1000.0)).K[0] == float("inf")
        assert boundary(free, [0.0], Span(2000.0, 1e4)).K == (0.0,)
        assert boundary(free, [0.0], Span(1500.0, 1e4)).K[0] == pytest.approx(1605.35, abs=5e-3)


def test_up_to_what_is_found_all_that_were_tried_rest() -> None:
    scene = let_go(load_scene("virtual_wall", step=2e-5))
    tried: list[tuple[float, bool]] = []

    def noted(one: Scene, *, seed: int = 0) -> FreeMotion:
        found = settled(one, seed=seed)
        tried.append((one.law.K, found.rests))
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(teleop.analysis.zwidth.assess, "settled", noted)
        K = stiffest_at_rest(scene, 0.2, near=3000.0)
    assert max(tried[:10])[0] > 5.0 * tried[0][0]
    assert all(rested == (stiffness <= K) for stiffness, rested in tried)
    assert min(stiffness for stiffness, rested in tried if not rested) < 1.01 * K


@pytest.mark.full
def test_it_is_looked_for_within_the_range_alone() -> None:
    scene = let_go(load_scene("virtual_wall"))
    asked: list[int] = []
    assert stiffest_at_rest(scene, 0.0, near=3000.0, high=2000.0, tell=lambda: asked.append(1)) == float("inf")
    assert 2 <= len(asked) < 15
    assert stiffest_at_rest(scene, 0.0, near=3000.0, low=5000.0) is None
    assert stiffest_at_rest(scene, 0.0, near=100.0, high=4000.0) == pytest.approx(3600.0, rel=0.05)
    assert stiffest_at_rest(scene, 0.0, near=1e6) == pytest.approx(3600.0, rel=0.05)


def test_the_device_begins_outside_the_wall_and_the_hand_pulls_it_in() -> None:
    scene = let_go(load_scene("virtual_wall", to=0.05))
    assert scene.start_m == pytest.approx(0.029)
    assert scene.hand.reference.samples(1, 3, scene.dt_ns) == ([0.05] * 3,)
