"""The damping that a held force needs, alone and behind a coupling: published numbers, brute force, closed loops."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from math import inf, pi
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from teleop import At, VirtualCoupling
from teleop.analysis.models.coupling import (
    alpha_max,
    alpha_miller,
    damping_curve,
    gap,
    lack,
    lack_behind,
    least_real,
    needed_damping,
    rendered,
    stiffness,
)
from teleop.analysis.models.linear import StateSpace
from teleop.analysis.models.peak import highest
from teleop.analysis.models.sampled import damping_curve as curve_alone
from teleop.analysis.models.sampled import needed_damping as needed_alone
from teleop.analysis.models.sampled import of_state_space, quantised_stiffness, spring_damper
from teleop.laws.virtual_coupling import UNSTABLE, Tool, coupling_impedance, tool_impedance
from teleop.physics.plant import linear
from tests.teleop.analysis.models.closed_forms import alpha_max_spring_damper, filtered_wall, wall_damping

T = 1e-3
K = st.floats(0.0, 5e3)
B = st.floats(0.01, 3.0)
part = st.floats(0.0, 0.95)


class TestBound:
    @settings(max_examples=30)
    @given(K=K, B=B, share=part, th=st.floats(0.01, pi), d=st.integers(0, 3))
    def test_no_environment_on_it_asks_for_more(self, K: float, B: float, share: float, th: float, d: int) -> None:
        """Brute force over the reactances of the environment that lacks just alpha."""
        C = complex(spring_damper(K, B, T)(np.exp(1j * th)))
        alpha = share * (K * T / 2 + B)
        rho = C.real - alpha
        Y = np.r_[-np.geomspace(1e-4, 1e4, 4000)[::-1], 0.0, np.geomspace(1e-4, 1e4, 4000)] * rho
        E = rho + 1j * Y - C
        Z = C * E / (C + E)
        worst = (-np.exp(-1j * (d + 1) * th) * Z).real.max()
        bound = damping_curve(spring_damper(K, B, T), alpha, np.array([th]), d=d)[0]
        assert worst <= bound + 1e-6 * (abs(C) ** 2 / rho + 1.0)
        assert worst == pytest.approx(bound, abs=2e-5 * (abs(C) ** 2 / rho + 1.0))

    @settings(max_examples=20)
    @given(K=K, B=B, delta=st.floats(0.01, 8.0))
    def test_without_delay_the_closed_form(self, K: float, B: float, delta: float) -> None:
        exact = alpha_max_spring_damper(delta, K, B, T)
        found = alpha_max(delta, spring_damper(K, B, T), T, tol=1e-7)
        if abs(delta - (K * T / 2 + B)) < 1e-6:
            return
        assert (found is None) == (exact is None)
        if exact is not None:
            assert found == pytest.approx(exact, abs=1e-6)

    def test_with_delay_worse_ones_than_a_clamped_tool_exist(self) -> None:
        for K in (1.0, 700.0, 5e3):
            for d in range(6):
                needed = needed_damping(spring_damper(K, 0.0, T), 0.0, T, d=d).damping
                assert needed == pytest.approx(0.5 * K * T * (d + 1) ** 2, rel=1e-6)
                assert needed >= wall_damping(K, 0.0, T, d).damping * (1 - 1e-9)

    def test_a_coupling_that_lacks_as_much_as_its_own_is_none(self) -> None:
        assert needed_damping(spring_damper(1000.0, 0.1, T), 0.6 + 1e-6, T).damping == inf
        assert alpha_max(0.5, spring_damper(1000.0, 0.1, T), T) is None


class TestMiller:
    """The published condition, which does not know of the sample that holding costs."""

    @settings(max_examples=30)
    @given(delta=st.floats(0.01, 10.0), gamma=st.floats(0.01, 10.0))
    def test_it_is_the_bound_without_that_sample(self, delta: float, gamma: float) -> None:
        alpha = alpha_miller(delta, gamma)
        assert gamma**2 / (gamma - alpha) - gamma == pytest.approx(delta, rel=1e-6)  # real C, e^-jth = 1
        assert alpha_miller(delta, inf) == delta

    @settings(max_examples=30)
    @given(K=K, B=B, more=st.floats(1.0, 5.0))
    def test_it_is_safe_where_the_device_has_the_coupling_s_damping(self, K: float, B: float, more: float) -> None:
        gamma = K * T / 2 + B
        exact = alpha_max_spring_damper(more * gamma * (1 + 1e-12), K, B, T)
        assert exact >= alpha_miller(more * gamma, gamma) - 1e-9

    def test_it_is_not_where_it_has_less(self) -> None:
        """A device of 0.8 N s/m, a coupling of 2 N s/m, and a tool held fast: Miller allows alpha up to 0.57."""
        C = spring_damper(1000.0, 1.5, T)
        assert alpha_miller(0.8, least_real(C, T)) == pytest.approx(0.571, abs=1e-3)
        assert alpha_max(0.8, C, T) is None
        assert needed_alone(C, T).damping > 0.8


def left_alone(law: VirtualCoupling, ticks: int = 1000) -> float:
    """How much a tool on its wall, before a device held fast far away on a weak spring, swings up in `ticks`."""
    hold = 1e-6 * law.k_e
    law = replace(law, K=hold, B=0.0)
    x = 1e6 + 1.0  # presses the tool 1 m into the wall
    at = At(x, 0.0, 0.0, 0.0, 0.0, False, 0.0, T, T)
    tool = Tool(1.0 + 1e-6, 0.0, -1e-6 * law.k_e)
    off = 1e-6
    for _ in range(ticks):
        _, tool = law.force(tool, at)
        off = abs(tool.y - 1.0) + T * abs(tool.u)
        if not off < 0.1:
            break
    return off / 1e-6


tools = st.builds(
    VirtualCoupling, K=st.just(1.0), mass=st.floats(1e-4, 0.1), damping=st.sampled_from([0.0, 0.1, 5.0, 100.0]),
    k_e=st.floats(1e2, 1e5), d_e=st.sampled_from([0.0, 1.0, 30.0]),
    theta_f=st.sampled_from([0.0, 0.3, 0.49, 0.5, 0.7, 1.0]), theta_x=st.sampled_from([0.0, 0.3, 0.5, 0.7, 1.0]))


def polynomials(law: VirtualCoupling) -> tuple[np.ndarray, np.ndarray]:
    """E(z) = N/D, put together from its parts."""
    Q, W = np.array([law.theta_f, 1 - law.theta_f]), np.array([law.theta_x, 1 - law.theta_x])
    step = np.array([1.0, -1.0])
    N = law.mass * np.polymul(step, step)
    N = np.polyadd(N, (law.damping + law.d_e) * T * np.polymul(Q, step))
    return np.polyadd(N, law.k_e * T**2 * np.polymul(Q, W)), T * np.polymul(Q, step)


class TestToolLack:
    @settings(max_examples=60)
    @given(law=tools)
    def test_unstable_by_itself_is_what_grows(self, law: VirtualCoupling) -> None:
        """The law's own tick, apart from the edge itself."""
        size = np.abs(np.roots(polynomials(law)[0])).max()
        if abs(size - 1.0) < 0.02:
            return
        grown = left_alone(law)
        assert (lack_behind(law.coupling(T), T).why == UNSTABLE) == (grown > 100.0)
        assert (size > 1.0) == (grown > 100.0)

    @settings(max_examples=40)
    @given(law=tools)
    def test_with_a_finite_alpha_it_is_positive_real_all_over_the_outside(self, law: VirtualCoupling) -> None:
        found = lack_behind(law.coupling(T), T)
        r, th = np.meshgrid(np.r_[1.0 + np.geomspace(1e-6, 1.0, 25), 3.0, 10.0, 1e3], np.linspace(0.0, pi, 181))
        E = tool_impedance(law, r * np.exp(1j * th), T)
        if not found.why:
            assert (E.real + found.alpha >= -1e-6 * np.abs(E)).all()

    @settings(max_examples=40)
    @given(law=tools.filter(lambda law: law.theta_f < 0.5), alpha=st.floats(0.0, 1e4))
    def test_where_it_anticipates_no_damper_does_it(self, law: VirtualCoupling, alpha: float) -> None:
        assert lack_behind(law.coupling(T), T).alpha == inf
        near = -1e9 if law.theta_f == 0.0 else -(1 - law.theta_f) / law.theta_f
        by = [tool_impedance(law, z, T).real for z in (near * (1 - 1e-9), near * (1 + 1e-9))]
        assert min(by) < -alpha


class TestLack:
    def test_on_the_circle_springs_and_masses_by_integrator(self) -> None:
        k, m = 400.0, 0.02
        for theta_f, theta_x, spring, mass in ((0.0, 0.0, 0.5, 2.0), (0.0, 1.0, 0.0, 2.0), (0.5, 0.5, 0.0, 0.0),
                                               (1.0, 1.0, 0.0, 0.0)):
            bare = VirtualCoupling(K=1.0, mass=0.0 if theta_f else 1e-300, k_e=k, theta_f=theta_f, theta_x=theta_x)
            heavy = VirtualCoupling(K=1.0, mass=m, k_e=0.0, theta_f=theta_f, theta_x=theta_x)
            assert lack(lambda z, tool=bare: tool_impedance(tool, z, T), T).alpha == pytest.approx(
                spring * k * T, abs=1e-7)
            found = lack(lambda z, tool=heavy: tool_impedance(tool, z, T), T)
            assert found.alpha == pytest.approx(mass * m / T, abs=1e-4)
            assert (theta_f, theta_x) != (0.0, 1.0) or found.frequency == pytest.approx(500.0, rel=1e-3)


def test_a_coupling_is_a_spring_in_series_which_is_what_is_lost() -> None:
    law = VirtualCoupling(K=1000.0, B=0.2, mass=0.02, k_e=3000.0)
    E, C = partial(tool_impedance, law, dt=T), partial(coupling_impedance, law, dt=T)
    assert stiffness(rendered(C, E), T) == pytest.approx(750.0, rel=1e-6)
    assert stiffness(E, T) == pytest.approx(3000.0, rel=1e-6)
    f = np.array([1e-3, 5.0, 100.0])
    z = np.exp(2j * pi * f * T)
    assert gap(C, E, T, f) == pytest.approx(np.abs(E(z) - rendered(C, E)(z)) / np.abs(E(z)))
    assert gap(C, E, T, f)[0] == pytest.approx(0.75, rel=1e-4)


class Ratio(NamedTuple):
    """A rational function of z."""

    over: np.ndarray
    under: np.ndarray


def in_series(C: Ratio, E: Ratio) -> Ratio:
    return Ratio(np.polymul(C.over, E.over),
                 np.polyadd(np.polymul(C.over, E.under), np.polymul(E.over, C.under)))


def radius(Z: Ratio, d: int, m: float, b: float, k: float) -> float:
    """Spectral radius of a device with a hand's spring k under a held Z (1 - z^-1)/T, apart from roots at z = 1."""
    s = linear(m, b, k, T)
    plant = Ratio(np.array([s.b1, s.a12 * s.b2 - s.a22 * s.b1]),
                  np.array([1.0, -s.a11 - s.a22, s.a11 * s.a22 - s.a12 * s.a21]))
    law = Ratio(np.polymul(Z.over, [1.0, -1.0]), T * np.polymul(Z.under, [1.0, *[0.0] * (d + 1)]))
    roots = np.roots(np.polyadd(np.polymul(plant.under, law.under), np.polymul(plant.over, law.over)))
    return float(np.abs(roots[np.abs(roots - 1.0) > 1e-4]).max())


def coupling(K: float, B: float) -> Ratio:
    return Ratio(np.array([K * T + B, -B]), np.array([1.0, -1.0]))


def environment(alpha: float, b: float, k: float, m: float) -> Ratio:
    """A trapezoid spring or mass, which loses nothing, a damper b, less a damper alpha."""
    if k > 0.0:
        lossless = Ratio(0.5 * k * T * np.array([1.0, 1.0]), np.array([1.0, -1.0]))
    else:
        lossless = Ratio(2.0 * m / T * np.array([1.0, -1.0]), np.array([1.0, 1.0]))
    return Ratio(np.polyadd(lossless.over, (b - alpha) * lossless.under), lossless.under)


class TestClosedLoops:
    @settings(max_examples=40)
    @given(K=st.floats(10.0, 5e3), B=B, share=part, d=st.integers(0, 2), b=st.sampled_from([0.0, 0.1, 5.0]),
           k=st.sampled_from([0.0, 10.0, 1e3, 1e5]), m_e=st.floats(1e-4, 1.0), m=st.floats(5e-3, 1.0),
           hand=st.floats(1.0, 5e3))
    def test_with_the_needed_damping_every_loop_is_stable(
            self, K: float, B: float, share: float, d: int, b: float, k: float, m_e: float, m: float, hand: float
            ) -> None:
        alpha = share * (K * T / 2 + B)
        needed = needed_damping(spring_damper(K, B, T), alpha, T, d=d).damping
        Z = in_series(coupling(K, B), environment(alpha, b, k, m_e))
        assert radius(Z, d, m, needed * (1 + 1e-6), hand) <= 1.0 + 1e-6

    def test_without_a_coupling_an_environment_that_lacks_nothing_may_need_anything(self) -> None:
        for k in (1e3, 1e5, 1e7):
            E = spring_damper(k, 0.0, T)
            assert lack(E, T).alpha == 0.0
            assert needed_alone(E, T).damping == pytest.approx(k * T / 2)


springs = st.floats(0.0, 1e4)
dampers = st.floats(-5.0, 5.0)


def test_walls_with_known_limits() -> None:
    for K, B, d, b_min in ((1600.0, 0.0, 0, 0.8), (800.0, 0.4, 0, 0.8), (1000.0, 0.0, 1, 1.5), (1000.0, 0.5, 1, 1.25),
                           (1000.0, 0.5, 5, 5.0)):
        assert wall_damping(K, B, T, d).damping == pytest.approx(b_min, rel=1e-11)
        assert needed_alone(spring_damper(K, B, T), T, d=d).damping == pytest.approx(b_min, rel=1e-9)


class TestSpringDamper:
    @settings(max_examples=30)
    @given(K=springs, B=dampers, d=st.integers(0, 40))
    def test_the_search_for_any_controller_agrees_with_the_closed_form_and_that_with_the_printed_rules(
            self, K: float, B: float, d: int) -> None:
        """Colgate's, of no delay, and that of a spring alone: half a sample and the delay."""
        found = needed_alone(spring_damper(K, B, T), T, d=d)
        assert found.damping == pytest.approx(wall_damping(K, B, T, d).damping, rel=1e-8, abs=1e-9)
        assert wall_damping(K, B, T).damping == pytest.approx(K * T / 2 + abs(B), rel=1e-10, abs=1e-12)
        assert wall_damping(K, 0.0, T, 7 * d).damping == pytest.approx(K * T * (0.5 + 7 * d), rel=1e-10)

    def test_where_the_most_is_needed(self) -> None:
        assert wall_damping(1000.0, 0.5, T).frequency == pytest.approx(500.0)
        assert wall_damping(1000.0, 0.0, T, 3).frequency == 0.0
        assert wall_damping(1000.0, 0.5, T, 1).frequency == pytest.approx(1 / 6 / T, rel=1e-6)  # cos(th) = 1/2

    def test_ten_seconds_of_delay_cost_as_much_and_a_negative_spring_is_never_passive(self) -> None:
        assert needed_alone(spring_damper(1000.0, 0.5, T), T, d=10_000).damping == pytest.approx(1e4, rel=1e-8)
        assert needed_alone(spring_damper(-1.0, 5.0, T), T).damping == float("inf")


def colgate_schenkel(H: complex, w: float) -> float:
    """The printed condition's right side for a force over position H at one frequency."""
    turn = np.exp(-1j * w * T)
    return float(T / 2 / (1 - np.cos(w * T)) * ((1 - turn) * H).real)


@settings(max_examples=50)
@given(K=springs, B=dampers, cut=st.floats(1.0, 400.0), w=st.floats(10.0, pi / T), d=st.integers(0, 5))
def test_the_curve_is_colgate_and_schenkels(K: float, B: float, cut: float, w: float, d: int) -> None:
    z = np.exp(1j * w * T)
    a = np.exp(-2 * pi * cut * T)
    H = (K + B * (1 - a) / (1 - a / z) * (1 - 1 / z) / T) * z**-d
    got = curve_alone(filtered_wall(K, B, T, cut), T, np.array([w * T]), d=d)[0]
    assert got == pytest.approx(colgate_schenkel(H, w), rel=1e-7, abs=1e-7)


def test_a_filter_as_matrices_needs_the_same() -> None:
    """v_f' = a v_f + (1 - a)(x - x_before)/T, f = K x + B v_f'."""
    K, B, a = 900.0, 0.7, np.exp(-2 * pi * 30.0 * T)
    gain = (1 - a) / T
    matrices = StateSpace(np.array([[a, -gain], [0.0, 0.0]]), np.array([[gain], [1.0]]),
                          np.array([[B * a, -B * gain]]), np.array([[K + B * gain]]))
    got = needed_alone(of_state_space(matrices, T), T, d=2)
    assert got.damping == pytest.approx(needed_alone(filtered_wall(K, B, T, 30.0), T, d=2).damping, rel=1e-8)


def energy_bound(K: float, B: float, d: int, every: int, renewals: int = 30, parts: int = 4) -> float:
    """The most that a force takes from a motion over its int v^2, as an eigenvalue: from the time domain alone.

    The motion is straight over `parts` of every tick, begins at rest and lasts a while, so this is a lower bound.
    """
    ticks = renewals * every
    n, h = ticks * parts, T / parts
    x = np.tri(n, n) * h  # after each part, of the velocities
    at = np.vstack([np.zeros(n), x[parts - 1::parts]])  # at the ticks
    law = K * at[:ticks] + B * np.vstack([np.zeros(n), np.diff(at[:ticks], axis=0)]) / T
    work = np.zeros((n, n))
    for k in range(ticks):
        start = k // every * every - d
        if start >= 0:
            work += np.outer(at[k + 1] - at[k], law[start])
    return float(-np.linalg.eigvalsh(0.5 * (work + work.T)).min() / h)


def test_a_force_renewed_slowly_makes_as_much_energy_as_the_form_says() -> None:
    for K, B, d, every in ((1000.0, 0.0, 0, 1), (1000.0, 0.4, 1, 1), (1000.0, 0.0, 0, 3), (1000.0, 0.0, 1, 2),
                           (1000.0, 0.5, 0, 3), (1000.0, -0.4, 2, 4)):
        bound = needed_alone(spring_damper(K, B, T), T, d=d, every=every).damping
        assert 0.93 * bound < energy_bound(K, B, d, every) < bound * (1 + 1e-9), (B, d, every)


@given(K=springs, every=st.integers(1, 12), periods=st.integers(0, 3))
@settings(max_examples=12)
def test_a_spring_renewed_slowly_is_one_with_a_longer_sample(K: float, every: int, periods: int) -> None:
    got = needed_alone(spring_damper(K, 0.0, T), T, d=periods * every, every=every).damping
    assert got == pytest.approx(K * every * T * (0.5 + periods), rel=1e-8, abs=1e-9)


def test_a_delay_of_part_of_a_period_needs_more_than_the_sum_of_both() -> None:
    got = needed_alone(spring_damper(1000.0, 0.0, T), T, d=1, every=2).damping
    assert got == pytest.approx(1.0 * (1 + 5**0.5 / 2), rel=1e-8)  # not K (nT/2 + dT) = 2


@settings(max_examples=30)
@given(place=st.floats(0.01, 3.1), width=st.floats(0.05, 2.0))
def test_a_maximum_between_two_places_is_zoomed_in_on(place: float, width: float) -> None:
    found = highest(lambda th: 2.0 - ((th - place) / width) ** 2)
    assert found.value == pytest.approx(2.0, abs=1e-14)
    assert found.th == pytest.approx(place, abs=1e-6)


def test_the_stiffness_behind_an_encoder_is_the_smaller_of_both_bounds() -> None:
    for step, friction, K in ((1e-5, 0.02, 1600.0), (1e-5, 0.004, 800.0), (0.0, 0.0, 1600.0), (1e-5, 0.0, 0.0)):
        assert quantised_stiffness(b=0.8, T=T, step=step, friction=friction) == pytest.approx(K)
