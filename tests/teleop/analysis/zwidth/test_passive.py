"""The passive and the stable region, and what comes to rest: closed forms, published numbers, runs beside the edge."""

from __future__ import annotations

from dataclasses import replace
from math import expm1, log10, pi, sqrt
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

import teleop.analysis.zwidth.assess
import teleop.analysis.zwidth.plane
from master.hand import Grip, Rest
from teleop import BackwardDifference, Device, ElectricalDamping, MassDamper, Scene, VirtualWall, load_scene, run
from teleop.analysis.models import coupling
from teleop.analysis.models.law_parts import effective_damping, with_gains
from teleop.analysis.models.rest import FreeMotion, settled
from teleop.analysis.models.sampled import needed_damping, quantised_stiffness, spring_damper
from teleop.analysis.stability.assess import critical
from teleop.analysis.zwidth.assess import Curves, curves, device, let_go, most, stiffest_at_rest
from teleop.analysis.zwidth.passive import Point, Region, passive_region
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
from teleop.law import At
from teleop.laws.virtual_coupling import VirtualCoupling
from teleop.stages.encoder import Encoder, encode
from teleop.stages.passivity_controller import PassivityController
from teleop.stages.velocity.levant import Levant
from teleop.stages.velocity.low_pass import LowPass
from tests.fakes import OneSpring, law_of
from tests.teleop.analysis.models.closed_forms import filtered_wall, wall_damping

WALL = VirtualWall(K=800.0)
# The spring-damper with K^2 over 1 kN/m as its stiffness.
Squared = law_of(OneSpring, force=lambda law, s, at: (law.K * law.K * 1e-3 * at.x + law.B * at.v, s))


def handle(law: Any = WALL, *, m: float = 0.04, b: float = 0.8, dt: float = 1e-3, friction: float = 0.0,
           hand: Any = None, electrical: Any = None, **device: Any) -> Scene:
    """A handle, the canonical one, on a virtual wall."""
    return Scene(law=law, master=MassDamper(mass=m, damping=b, friction=friction), hand=hand, dt=dt, duration=1.0,
                 electrical=electrical, device_m=Device(**{"velocity": BackwardDifference(), **device}))


def corners(scene: Scene) -> np.ndarray[Any, Any]:
    found = passive_region(scene).corners
    assert found
    return np.array(found)


def stiffest_alone(region: Region) -> float:
    """The greatest K (N/m) of the region at B = 0."""
    assert region.corners is not None
    return max((K for K, B in region.corners if B == 0.0), default=0.0)


def inside(shape: np.ndarray[Any, Any], point: Point) -> float:
    """How far out a point lies in the polygon of these corners and (0, 0): at most 1 inside."""
    steps = np.diff(shape, axis=0)
    normals = np.column_stack([steps[:, 1], -steps[:, 0]])
    return float(max((normals @ np.array(point)) / (normals * shape[:-1]).sum(axis=1)))


class TestSpringAndDamper:
    def test_without_delay_it_is_the_triangle_of_colgate_and_schenkel(self) -> None:
        for b, T in ((0.8, 1e-3), (5.0, 1e-3), (0.1, 1e-2), (2.0, 1e-4)):
            assert corners(handle(b=b, dt=T)) == pytest.approx(np.array([(2.0 * b / T, 0.0), (0.0, b)]), rel=1e-9)

    @pytest.mark.full
    def test_with_delay_every_corner_needs_all_of_the_damping_and_no_point_inside_more(self) -> None:
        for d in (1, 40):
            shape = corners(handle(delay=d))
            needed = [wall_damping(K, B, 1e-3, d).damping for K, B in shape]
            assert needed == pytest.approx([0.8] * len(shape), rel=1e-9)
            dice = np.random.default_rng(1)
            for K, B in dice.uniform(0.0, 1.2, (60, 2)) * shape.max(axis=0):
                out = wall_damping(K, B, 1e-3, d).damping / 0.8
                assert out == pytest.approx(inside(shape, (K, B)), abs=6e-5)

    def test_a_spring_alone_has_the_bound_of_diolaiti_and_a_damper_lets_a_late_one_be_stiffer(self) -> None:
        for d in (1, 30, 5):
            region = passive_region(handle(delay=d))
            assert stiffest_alone(region) == pytest.approx(0.8 / (1e-3 * (0.5 + d)), rel=1e-8)
        assert region.stiffest > 1.2 * stiffest_alone(region)
        for b, dt, d in ((1.25, 1e-3, 1), (5.0, 1e-3, 5), (5.0, 5e-4, 5)):  # of which the damping is known
            assert inside(corners(handle(b=b, dt=dt, delay=d)), (1.0 / dt, 0.5)) == pytest.approx(1.0, rel=5e-5)


class TestFilterAndSlowForce:
    def test_behind_a_low_pass_every_corner_needs_all_of_the_damping(self) -> None:
        shape = corners(handle(velocity=LowPass(cutoff=30.0)))
        needed = [needed_damping(filtered_wall(K, B, 1e-3, 30.0), 1e-3).damping for K, B in shape[::7]]
        assert needed == pytest.approx([0.8] * len(needed), rel=1e-7)
        assert shape[-1, 1] > 5.0  # of a damper that is slow at the frequencies where it would be too strong

    @pytest.mark.full
    def test_a_force_renewed_slowly_has_the_region_of_its_own_condition(self) -> None:
        for d in (0, 2):
            shape = corners(handle(every=3, delay=d))
            some = shape[[0, len(shape) // 2, -1]]
            needed = [needed_damping(spring_damper(K, B, 1e-3), 1e-3, d=d, every=3).damping for K, B in some]
            assert needed == pytest.approx([0.8] * 3, rel=1e-6)

    def test_a_spring_renewed_at_every_fifth_tick_is_one_of_a_fifth_of_the_rate(self) -> None:
        assert passive_region(handle(every=5)).stiffest == pytest.approx(2.0 * 0.8 / 5e-3, rel=1e-4)


class TestShunt:
    def test_the_damping_is_the_harmonic_mean_over_the_frequencies_that_a_sample_mixes(self) -> None:
        th = np.array([1e-3, 0.1, 1.0, 3.0])
        w = (th[:, None] + 2.0 * pi * np.arange(-200_000, 200_001)) / 1e-3
        for b, b_e, cutoff in ((0.8, 0.8, 10.0), (0.1, 5.0, 100.0), (2.0, 0.5, 400.0)):
            scene = replace(handle(b=b), electrical=ElectricalDamping(b=b_e, cutoff=cutoff))
            r = b + b_e * w**2 / (w**2 + (2.0 * pi * cutoff) ** 2)
            mean = (1.0 / w**2).sum(axis=1) / (1.0 / (r * w**2)).sum(axis=1)
            assert effective_damping(scene, th) == pytest.approx(mean, rel=1e-5)

    def test_it_widens_the_region_up_to_that_of_a_damper_as_strong_but_helps_no_spring_alone(self) -> None:
        """A slow hand does not feel it."""
        own, both = (passive_region(handle(b=b)).stiffest or 0.0 for b in (0.8, 1.6))
        with_shunt = [passive_region(replace(handle(), electrical=ElectricalDamping(b=0.8, cutoff=f))).stiffest or 0.0
                      for f in (1e-3, 10.0, 100.0, 1e7)]
        assert with_shunt == sorted(with_shunt, reverse=True)
        assert with_shunt[-1] == pytest.approx(own, rel=1e-3)
        assert own < with_shunt[1] < both
        region = passive_region(replace(handle(), electrical=ElectricalDamping(b=0.8, cutoff=10.0)))
        assert stiffest_alone(region) == pytest.approx(1600.0, rel=1e-6)


class TestEncoder:
    def test_a_spring_has_the_bound_of_abbott_and_okamura(self) -> None:
        for friction in (0.002, 0.05):
            region = passive_region(handle(friction=friction, encoder=Encoder(step=2e-5)))
            assert region.stiffest == pytest.approx(quantised_stiffness(b=0.8, T=1e-3, step=2e-5, friction=friction))

    def test_a_damper_may_make_no_more_force_of_a_step_than_friction_holds(self) -> None:
        shape = corners(handle(friction=2e-3, encoder=Encoder(step=2e-5)))
        assert shape == pytest.approx(np.array([(200.0, 0.0), (0.0, 2e-3 * 1e-3 / 2e-5)]))

    def test_a_handle_that_trembles_across_an_edge_takes_just_that_from_a_damper(self) -> None:
        step, T, B, tremble = 2e-5, 1e-3, 0.1, 1e-9
        law = VirtualWall(K=1e-3, B=B, at=-100.0)  # deep inside, so that it never lets go
        taken, q_before = 0.0, encode((step, 0.0), -tremble)
        x = -tremble
        for k in range(1, 201):
            x = tremble * (1.0 if k % 2 else -1.0)
            q = encode((step, 0.0), x)
            f, _ = law.force((), At(q, (q - q_before) / T, 0.0, 0.0, 0.0, False, float("inf"), T))
            taken += (f - 0.1) * 2.0 * x  # the next tick moves it back by 2 |x|; 0.1 N is the wall's constant push
            q_before = q
        assert taken / (200 * 2.0 * tremble) == pytest.approx(B * step / T, rel=1e-3)

    def test_a_filter_makes_less_of_a_step(self) -> None:
        fast, slow = (corners(handle(friction=2e-3, encoder=Encoder(step=2e-5), velocity=v))[-1, 1]
                      for v in (BackwardDifference(), LowPass(cutoff=30.0)))
        assert slow / fast == pytest.approx(-1.0 / expm1(-2.0 * pi * 30.0 * 1e-3))


class TestOthers:
    def test_what_keeps_nothing_passive_or_is_not_claimed_for_says_why(self) -> None:
        shunt = ElectricalDamping(b=0.8, cutoff=10.0)
        for scene, corners, words in (
                (handle(velocity=Levant(L=10.0)), None, "Levant"), (handle(velocity=None), None, "velocity itself"),
                (replace(handle(b=0.0), electrical=shunt), None, "slow hand"),
                (handle(encoder=Encoder(step=1e-9)), (), "without Coulomb friction"), (handle(b=0.0), (), "--set b="),
                (replace(handle(), passivity=PassivityController(cap=0.8)), None, "measured"),
                (handle(law=VirtualCoupling(theta_x=0.5)), None, ""),
                (handle(law=Squared(K=800.0)), None, "not linear in K and B")):
            region = passive_region(scene)
            assert region.corners == corners, words
            assert region.stiffest == region.most_damped == (None if corners is None else 0.0)
            assert words in region.sentence

    def test_behind_a_coupling_without_delay_it_is_the_same_triangle(self) -> None:
        shape = corners(handle(law=VirtualCoupling()))
        assert shape == pytest.approx(np.array([(1600.0, 0.0), (0.0, 0.8)]), rel=1e-6, abs=1e-6)

    @pytest.mark.full
    def test_behind_a_coupling_with_delay_any_environment_costs_more_than_a_rigid_one(self) -> None:
        free, rigid = corners(handle(law=VirtualCoupling(), delay=2)), corners(handle(delay=2))
        assert all(inside(rigid, (K, B)) < 1.0 + 1e-4 for K, B in free)
        assert max(K for K, _ in free) < 0.95 * max(K for K, _ in rigid)
        assert free[0, 0] < 0.6 * rigid[0, 0]
        needed = [coupling.needed_damping(spring_damper(K, B, 1e-3), 0.0, 1e-3, d=2).damping for K, B in free[::9]]
        assert needed == pytest.approx([0.8] * len(needed), rel=1e-6)


def found(scene: Scene) -> Curves:
    return curves(scene, passive_region(scene))


def test_the_curves_are_a_spring_then_a_damper_over_a_damper_then_a_mass() -> None:
    got = found(handle(b=8.0))
    assert got.upper is not None
    w = 2.0 * pi * got.frequency
    assert got.frequency[[0, 200, 600]] == pytest.approx([0.1, 1.0, 100.0])
    assert got.upper == pytest.approx(np.maximum(16000.0 / w, 8.0), rel=1e-6)
    assert got.lower == pytest.approx(np.hypot(8.0, 0.04 * w))


def test_the_canonical_handle_has_a_z_width_of_254_newton_seconds_per_metre_and_the_area_between_the_curves() -> None:
    def gap(decade: float) -> float:
        w = 2.0 * pi * 10.0**decade
        return max(log10(1600.0 / w / sqrt(0.8**2 + (0.04 * w) ** 2)), 0.0)

    area = quad(gap, -1.0, 2.0, limit=200, points=[1.5])[0]
    got = found(handle())
    assert got.at_one == pytest.approx((1600.0 / (2.0 * pi), sqrt(0.8**2 + (0.08 * pi) ** 2)), rel=1e-6)
    assert got.width == pytest.approx(254.648 - 0.83855, abs=1e-3)
    assert got.area == pytest.approx(area, rel=1e-4)
    assert got.gap == pytest.approx(area / 3.0, rel=1e-4)
    got = found(handle(dt=1e-2))  # a slow controller is asked up to half its rate only
    assert got.frequency[-1] == pytest.approx(50.0)
    assert got.area == pytest.approx((got.gap or 0.0) * log10(500.0))


@pytest.mark.full
def test_no_point_of_the_passive_region_is_above_the_upper_curve() -> None:
    scene = handle(delay=3)
    corners = np.array(passive_region(scene).corners)
    frequency = np.array([0.1, 1.0, 10.0, 100.0])
    upper = most(scene, passive_region(scene).corners or (), frequency)
    dice = np.random.default_rng(3)
    weights = dice.dirichlet(np.ones(len(corners)), 50)
    for K, B in weights @ corners:
        assert (np.abs(K / (2j * pi * frequency) + B) <= upper * (1.0 + 1e-12)).all()
    assert upper[0] == pytest.approx(corners[:, 0].max() / (0.2 * pi), rel=1e-3)


def test_a_filtered_damper_counts_as_the_filter_leaves_it() -> None:
    scene = handle(velocity=LowPass(cutoff=30.0))
    frequency = np.array([1.0, 100.0])
    z = np.exp(2j * pi * frequency * 1e-3)
    a = np.exp(-2.0 * pi * 30.0 * 1e-3)
    assert most(scene, ((0.0, 2.0),), frequency) == pytest.approx(2.0 * np.abs((1.0 - a) / (1.0 - a / z)), rel=1e-6)


def test_a_shunt_is_a_damper_above_its_cutoff_alone() -> None:
    scene = replace(handle(), electrical=ElectricalDamping(b=2.0, cutoff=10.0))
    slow, fast = device(scene, np.array([1e-3, 1e3]))
    assert slow == pytest.approx(0.8, rel=1e-3)
    assert fast == pytest.approx(abs(2.8 + 0.04 * 2e3j * pi), rel=1e-3)


def test_behind_a_coupling_the_device_carries_the_tool_along() -> None:
    scene = handle(law=VirtualCoupling(K=1600.0, B=0.0, mass=0.02))
    assert device(scene, np.array([1.0]))[0] == pytest.approx(abs(0.8 + 0.06 * 2j * pi), rel=2e-3)
    got = found(scene)
    assert got.at_one[0] == pytest.approx(1600.0 / (2.0 * pi), rel=1e-6)


def test_where_nothing_is_passive_there_is_no_width_and_where_nothing_is_claimed_no_number() -> None:
    nothing = found(handle(encoder=Encoder(step=1e-5)))
    assert (nothing.width, nothing.area, nothing.gap) == (0.0, 0.0, 0.0)
    unknown = found(handle(velocity=None))
    assert (unknown.upper, unknown.width, unknown.area) == (None, None, None)
    assert unknown.at_one[1] == pytest.approx(0.83855, abs=1e-5)


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
