"""The stable region: published and computed stiffnesses, runs in virtual time just inside and outside, scaling."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import teleop.analysis.zwidth.plane
from master.hand import Grip, Rest
from teleop import BackwardDifference, Device, ElectricalDamping, MassDamper, Scene, VirtualWall, run
from teleop.analysis.models.law_parts import with_gains
from teleop.analysis.stability.assess import critical
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
    def test_the_critical_stiffness_of_a_free_handle(self) -> None:
        for d, K in ((0, 1605.35), (1, 536.28), (5, 148.08), (10, 78.745), (100, 9.7415)):
            assert edge(handle(delay=d)) == pytest.approx(K, abs=6e-3 if K > 100.0 else 6e-4)

    def test_with_a_damper_as_strong_as_the_device_the_published_rule_errs_the_other_way(self) -> None:
        scene = handle(delay=5)
        assert edge(scene, 0.8) == pytest.approx(282.69, abs=5e-3)
        assert float(published_rule(scene, 0.8)) == pytest.approx(290.91, abs=5e-3)  # type: ignore[arg-type]

    def test_the_lines_laid_over_are_the_published_ones(self) -> None:
        for d, K in ((0, 1600.0), (1, 533.33), (5, 145.45), (10, 76.19), (100, 7.960)):
            assert published_rule(handle(delay=d), np.array([0.0])) == pytest.approx(K, abs=5e-3)
            line = passive_line(handle(delay=d), np.array([0.0, 0.4, 0.8]))
            assert line == pytest.approx([1600.0, 800.0, 0.0])

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

    def test_scaling_the_mass_and_all_damping_scales_the_stiffness(self) -> None:
        assert edge(handle(m=0.12, b=2.4, delay=1), 1.5) == pytest.approx(3.0 * edge(handle(delay=1), 0.5), rel=1e-7)

    def test_at_twice_the_rate_with_the_same_mass_over_time_the_stiffness_doubles(self) -> None:
        assert edge(handle(m=0.02, dt=5e-4, delay=1), 0.5) == pytest.approx(2.0 * edge(handle(delay=1), 0.5), rel=1e-7)


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

    def test_its_rows_end_where_no_stiffness_is_stable(self) -> None:
        free = loop(handle(), hand=False)
        B = rows(free, Span(), Span())
        assert len(B) == 41
        assert B[0] == 0.0
        assert is_stable(free, 1.0, 0.999 * B[-1])
        assert not is_stable(free, 1.0, 1.001 * B[-1])

    def test_a_range_bounds_where_it_is_looked_for(self) -> None:
        free = loop(handle(), hand=False)
        assert rows(free, Span(1.0, 3.0), Span())[0::40] == [1.0, 3.0]
        assert boundary(free, [0.0], Span(0.0, 1000.0)).K[0] == float("inf")
        assert boundary(free, [0.0], Span(2000.0, 1e4)).K == (0.0,)
        assert boundary(free, [0.0], Span(1500.0, 1e4)).K[0] == pytest.approx(1605.35, abs=5e-3)
