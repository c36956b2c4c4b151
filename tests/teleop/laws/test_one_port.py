"""One-port laws: the virtual wall, and the virtual coupling with its integrators, contact and impedances."""

from __future__ import annotations

import cmath
from dataclasses import replace
from math import inf, isnan, nan, pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop import VirtualWall
from teleop.law import At, find_law, reads, start_at
from teleop.laws.virtual_coupling import Tool, VirtualCoupling, coupling_impedance, rendered_impedance, tool_impedance

metres = st.floats(-1.0, 1.0)
speeds = st.floats(-10.0, 10.0)


def felt(law: VirtualWall, x: float, v: float) -> float:
    """The force at a reading; what the law does not read is NaN."""
    f_m, state = law.force((), At(x, v, nan, nan, nan, False, inf, nan))
    assert state == ()
    return f_m


def test_the_wall_is_a_spring_damper_inside_and_does_nothing_to_what_leaves_fast_or_is_on_its_surface() -> None:
    law = VirtualWall(K=800.0, B=2.0, at=0.03)
    assert felt(law, 0.05, 0.25) == 800.0 * (0.05 - 0.03) + 2.0 * 0.25
    assert felt(law, 0.05, -0.25) == 800.0 * (0.05 - 0.03) - 2.0 * 0.25
    assert felt(VirtualWall(K=500.0, B=3.0), 0.01, -2.0) == 0.0
    assert felt(VirtualWall(K=500.0, B=3.0, at=0.02), 0.02, 5.0) == 0.0
    for x, v in ((nan, 0.0), (0.1, nan)):
        assert isnan(felt(VirtualWall(B=1.0), x, v))


@given(x=metres, v=speeds, at=metres)
def test_it_pushes_out_or_not_at_all_and_only_inside(x: float, v: float, at: float) -> None:
    f_m = felt(VirtualWall(K=500.0, B=3.0, at=at), x, v)
    assert f_m >= 0.0
    assert f_m == 0.0 or x > at


def test_wall_and_coupling_read_position_and_velocity_alone_and_the_wall_has_no_memory() -> None:
    assert VirtualWall().start(start_at(0.2, 0.0, 0.0, 1e-3)) == ()
    assert reads(VirtualWall().force) == {"x", "v"}
    assert find_law("virtual_wall")() == VirtualWall()
    assert reads(VirtualCoupling().force) == {"x", "v", "span"}
    assert find_law("virtual_coupling")() == VirtualCoupling()


# The virtual coupling

DT = 1e-3
WEIGHTS = [(0.0, 0.0), (0.0, 1.0), (0.5, 0.5), (1.0, 1.0), (1.0, 0.0), (0.3, 0.7)]
SOFT = VirtualCoupling(K=300.0, B=0.5, mass=0.1, damping=0.3, k_e=2000.0, d_e=1.5)


def weighted(law: VirtualCoupling, weights: tuple[float, float]) -> VirtualCoupling:
    return replace(law, theta_f=weights[0], theta_x=weights[1])


def reading(x: float, v: float, dt: float = DT) -> At:
    """What the law reads; all else is NaN."""
    return At(x, v, nan, nan, nan, False, inf, dt, dt)


laws = st.builds(
    VirtualCoupling, K=st.floats(0.0, 1e4), B=st.floats(0.0, 10.0), mass=st.floats(1e-3, 1.0),
    damping=st.floats(0.0, 5.0), k_e=st.floats(0.0, 1e6), d_e=st.floats(0.0, 100.0), at=st.floats(-0.02, 0.02),
    theta_f=st.sampled_from([0.0, 0.1, 0.5, 0.8, 1.0]), theta_x=st.sampled_from([0.0, 0.1, 0.5, 0.8, 1.0]),
)
tools = st.builds(Tool, y=st.floats(-0.03, 0.03), u=st.floats(-3.0, 3.0), net=st.floats(-50.0, 50.0))


@given(law=laws, tool=tools, x=st.floats(-0.03, 0.03), v=st.floats(-3.0, 3.0))
def test_a_tick_solves_the_implicit_equations_and_the_wall_obeys_its_law(
        law: VirtualCoupling, tool: Tool, x: float, v: float) -> None:
    f_m, new = law.force(tool, reading(x, v))
    th_f, th_x = law.theta_f, law.theta_x
    assert new.y == pytest.approx(tool.y + DT * ((1.0 - th_x) * tool.u + th_x * new.u), abs=1e-12)
    assert f_m == pytest.approx(law.K * (x - new.y) + law.B * (v - new.u))
    pull = max(1.0, abs(f_m), law.mass * (abs(new.u) + abs(tool.u)) / DT, abs(tool.net), abs(new.net))
    momentum = law.mass * (new.u - tool.u) / DT
    assert momentum == pytest.approx((1.0 - th_f) * tool.net + th_f * new.net, abs=1e-9 * pull)
    f_w, p = f_m - law.damping * new.u - new.net, new.y - law.at
    near = 1e-9 * max(pull, law.k_e * abs(p), law.d_e * abs(new.u))
    push = max(0.0, law.k_e * p + law.d_e * new.u)
    if p > 1e-12:
        assert f_w == pytest.approx(push, abs=near)
    elif p < -1e-12:
        assert f_w == pytest.approx(0.0, abs=near)
    else:  # on the surface: what of the damper's force stops the tool there
        assert -near <= f_w <= max(0.0, law.d_e * new.u) + near


def test_a_tool_may_be_stopped_on_the_surface_by_a_part_of_the_dampers_force() -> None:
    law = VirtualCoupling(K=0.0, B=0.0, mass=0.1, k_e=0.0, d_e=1e3, at=0.0)
    f_m, new = law.force(Tool(-0.5e-3, 1.0, 0.0), reading(0.0, 0.0))
    assert (f_m, new.y, new.u) == (0.0, 0.0, 0.5)
    assert new.net == pytest.approx(0.1 * (0.5 - 1.0) / DT)


@pytest.mark.parametrize("ticks", [1, 2, 30])
def test_a_tool_coasts_through_ticks_that_were_left_out(ticks: int) -> None:
    """It stood still at them, and the coupling paid out the stretch that this left."""
    law = VirtualCoupling(K=500.0, B=1.0, mass=0.02, k_e=0.0)
    f_m, tool = law.force(Tool(0.0, 0.3, 0.0), reading(0.3 * ticks * DT, 0.3)._replace(span=ticks * DT))
    assert tool.y == pytest.approx(0.3 * ticks * DT, abs=1e-15)
    assert tool.u == pytest.approx(0.3, abs=1e-12)
    assert f_m == pytest.approx(0.0, abs=1e-12)


def test_a_massless_tool_rests_in_balance_between_coupling_and_wall() -> None:
    law = VirtualCoupling(K=500.0, B=0.0, mass=0.0, k_e=2000.0, at=0.01)
    tool = law.start(start_at(0.0, 0.0, 0.0, DT))
    _, tool = law.force(tool, reading(0.005, 5.0))
    assert tool.y == pytest.approx(0.005)  # free: it is where the device is
    f_m, tool = law.force(tool, reading(0.02, 15.0))
    assert f_m == pytest.approx(0.01 * 500.0 * 2000.0 / 2500.0)  # two springs in series
    assert tool.net == pytest.approx(0.0, abs=1e-12)


def test_a_tool_that_starts_behind_the_surface_is_put_before_it() -> None:
    law = VirtualCoupling(K=500.0, at=0.01)
    assert law.start(start_at(0.03, 0.0, 0.0, DT)) == Tool(0.01, 0.0, 500.0 * (0.03 - 0.01))
    assert law.start(start_at(-0.02, 0.0, 0.0, DT)) == Tool(-0.02, 0.0, 0.0)



def linearised(law: VirtualCoupling, z: complex) -> complex:
    """F/V_hat of the law's own map in contact, by differences, which of an affine map are exact."""
    def tick(s: np.ndarray) -> np.ndarray:  # y, u, net, last reading, reading -> y, u, net, reading, force
        y, u, net, last, x = (float(each) for each in s)
        f_m, tool = law.force(Tool(y, u, net), reading(x, (x - last) / DT))
        return np.array([*tool, x, f_m])

    rest = np.array([10.0, 0.0, 0.0, 10.0, 10.0])  # deep inside: the wall is touched for sure
    steps = (1e-2, 1.0, 1e-1, 1e-4, 1e-4)
    columns = [(tick(rest + h * e) - tick(rest - h * e)) / (2.0 * h) for h, e in zip(steps, np.eye(5), strict=True)]
    J = np.array(columns).T
    A, B, C, D = J[:4, :4], J[:4, 4], J[4, :4], J[4, 4]
    force = C @ np.linalg.solve(z * np.eye(4) - A, B) + D
    return complex(force / ((1.0 - 1.0 / z) / DT))


@pytest.mark.parametrize("weights", WEIGHTS)
def test_the_rendered_impedance_is_that_of_the_laws_own_lines(weights: tuple[float, float]) -> None:
    law = weighted(SOFT, weights)
    for th in (0.02, 0.3, 1.1, 2.5, pi):
        z = 1.05 * cmath.exp(1j * th)
        assert linearised(law, z) == pytest.approx(rendered_impedance(law, z, DT), rel=1e-6)


@pytest.mark.parametrize("theta_f", [0.0, 0.5, 1.0])
def test_coupling_and_tool_are_in_series_where_the_position_takes_the_new_velocity(theta_f: float) -> None:
    law = weighted(SOFT, (theta_f, 1.0))
    for th in (0.1, 1.0, 3.0):
        z = cmath.exp(1j * th)
        C, E = coupling_impedance(law, z, DT), tool_impedance(law, z, DT)
        assert rendered_impedance(law, z, DT) == pytest.approx(C * E / (C + E), rel=1e-12)


def test_what_is_no_number_stays_so_in_the_tool() -> None:
    for x, v in ((nan, 0.0), (0.1, nan)):
        f_m, tool = VirtualCoupling().force(Tool(0.0, 0.0, 0.0), reading(x, v))
        assert all(map(isnan, (f_m, *tool)))
