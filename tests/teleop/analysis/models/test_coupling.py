"""What a virtual coupling allows: the derived bound against brute force, closed forms and closed loops."""

from __future__ import annotations

from dataclasses import replace
from math import cos, inf, pi
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
from teleop.analysis.models.sampled import needed_damping as needed_alone
from teleop.analysis.models.sampled import spring_damper
from teleop.laws.virtual_coupling import ANTICIPATES, UNSTABLE, Tool, coupling_impedance, tool_impedance
from teleop.physics.plant import linear
from tests.teleop.analysis.models.closed_forms import alpha_max_spring_damper, wall_damping

T = 1e-3
K = st.floats(0.0, 5e3)
B = st.floats(0.01, 3.0)
part = st.floats(0.0, 0.95)


class TestBound:
    @settings(max_examples=30)
    @given(K=K, B=B, share=part, th=st.floats(0.01, pi), d=st.integers(0, 3))
    def test_no_environment_on_the_circle_asks_for_more(
            self, K: float, B: float, share: float, th: float, d: int) -> None:
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
        assert exact is not None
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

    def test_known_tools(self) -> None:
        every: list[tuple[dict[str, float], str, float]] = [
            ({"theta_f": 0.0}, UNSTABLE, -2.618),  # semi-implicit Euler, k dt^2/m = 5
            ({"theta_f": 0.0, "mass": 0.0251}, ANTICIPATES, -1.0), ({"theta_f": 0.0, "mass": 0.0249}, UNSTABLE, -1.1),
            ({"theta_f": 0.3, "mass": 0.1}, ANTICIPATES, 0.0), ({"theta_f": 0.0, "theta_x": 0.0}, UNSTABLE, 0.0),
            ({"theta_f": 1.0, "theta_x": 0.0}, UNSTABLE, 0.0),
            ({"theta_f": 0.3, "theta_x": 1.0, "mass": 0.0}, UNSTABLE, -7 / 3),
            ({"theta_f": 0.5, "theta_x": 0.5}, "", 0.0), ({}, "", 0.0),
        ]
        for knobs, why, root in every:
            law = VirtualCoupling(**knobs)
            found = lack_behind(law.coupling(T), T)
            assert (found.why, found.alpha) == (why, inf if why else 0.0), knobs
            if abs(root) > 1.2:
                assert np.abs(np.roots(polynomials(law)[0])).max() == pytest.approx(abs(root), rel=1e-3)

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
            assert lack(lambda z, tool=bare: tool_impedance(tool, z, T), T).alpha == pytest.approx(  # type: ignore[misc]
                spring * k * T, abs=1e-7)
            found = lack(lambda z, tool=heavy: tool_impedance(tool, z, T), T)  # type: ignore[misc]
            assert found.alpha == pytest.approx(mass * m / T, abs=1e-4)
            assert (theta_f, theta_x) != (0.0, 1.0) or found.frequency == pytest.approx(500.0, rel=1e-3)


class TestCost:
    law = VirtualCoupling(K=1000.0, B=0.2, mass=0.02, k_e=3000.0)

    def E(self, z: complex) -> complex:
        return tool_impedance(self.law, z, T)

    def C(self, z: complex) -> complex:
        return coupling_impedance(self.law, z, T)

    def test_springs_in_series(self) -> None:
        assert stiffness(rendered(self.C, self.E), T) == pytest.approx(750.0, rel=1e-6)
        assert stiffness(self.E, T) == pytest.approx(3000.0, rel=1e-6)

    def test_what_is_lost(self) -> None:
        f = np.array([1e-3, 5.0, 100.0])
        z = np.exp(2j * pi * f * T)
        E, Z = self.E(z), rendered(self.C, self.E)(z)
        assert gap(self.C, self.E, T, f) == pytest.approx(np.abs(E - Z) / np.abs(E))
        assert gap(self.C, self.E, T, f)[0] == pytest.approx(0.75, rel=1e-4)


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


def test_the_bound_of_a_spring_damper_is_linear_in_the_cosine() -> None:
    K, B, alpha = 800.0, 0.7, 0.5
    th = np.linspace(0.1, pi, 7)
    rho = K * T / 2 + B - alpha
    by_hand = [B * B * cos(t / 2) ** 2 / rho - B * cos(t) + K * T / 2 for t in th]
    assert damping_curve(spring_damper(K, B, T), alpha, th) == pytest.approx(by_hand, rel=1e-10)
