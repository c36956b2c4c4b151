"""Passive set-point modulation: how far a set point goes, what an end keeps, and the figures of the law book."""

from __future__ import annotations

from math import sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop import At, facts_of, load_scene, run, seed_energy
from teleop.laws.pspm import PSPM, Back, PSPMEnd, PSPMSums
from tests.teleop.laws.printed import assert_printed, printed, tracking_mm

DT = 1e-3
place = st.floats(-0.1, 0.1).map(lambda value: round(value, 9))


def at(x: float = 0.0, v: float = 0.0, f_held: float = 0.0, dx: float = 0.0) -> At:
    return At(x, v, float("nan"), f_held, dx, True, 0.0, DT, DT, 1.0)


def master(law: PSPM, s: PSPMEnd, here: At, rx: Back) -> tuple[float, PSPMEnd]:
    """Force and state after one tick in one axis."""
    f_m, _, after = law.master(s, here, rx, law.master_sums(s, here, rx))
    return f_m, after


@pytest.mark.parametrize(("scene", "delay", "wanted"), [
    ("free_motion", 0.05, ("0.00250773", "7.26979", "0.470793")),
    ("canonical", 0.01, ("0.00533417", "6.80620", "1.07034")),
    ("soft_tissue", 0.05, ("0.00534201", "5.76631", "0.230831")),
])
def test_two_seconds(scene: str, delay: float, wanted: tuple[str, ...]) -> None:
    assert_printed(PSPM(), scene, delay, *wanted)


@pytest.mark.full
@pytest.mark.parametrize(("scene", "wanted"), [
    ("canonical", "3.3"), ("hard_wall", "7.8"), ("soft_tissue", "5.2"), ("free_motion", "2.7"),
])
def test_tracking_of_ten_seconds_over_50_ms(scene: str, wanted: str) -> None:
    tracking, touch = tracking_mm(PSPM(), scene)
    assert printed(tracking, wanted) == wanted
    if scene == "canonical":
        assert touch == 0.0  # the drag keeps the hand off the wall, so this error is no good work


def test_a_set_point_goes_as_far_as_the_energy_does() -> None:
    """A worked example: y' at x 0.02, y 0.015, E 1e-3 and the other end at 0.05."""
    law = PSPM()
    s = PSPMEnd(0.015, 1e-3 + 0.5 * law.K * 0.005**2, 0.0, 0.0)
    _, after = master(law, s, at(0.02), Back(0.05, 0.0))
    assert f"{after.y:.7f}" == "0.0253852"
    assert after.y - 0.02 == pytest.approx(sqrt(0.005**2 + 2e-3 / law.K), rel=1e-12)


@given(x=place, y=place, other=place, T=st.floats(-0.01, 0.1), came=st.floats(0.0, 0.1), w=st.floats(-1e-3, 1e-3))
def test_the_energy_of_the_spring_is_never_more_than_the_end_keeps(
        x: float, y: float, other: float, T: float, came: float, w: float) -> None:
    law = PSPM()
    _, after = master(law, PSPMEnd(y, T, 0.0, 0.0), at(x, f_held=1.0, dx=w), Back(other, came))
    spring = 0.5 * law.K * (x - after.y) ** 2
    assert spring <= max(after.T, 0.0) * (1.0 + 1e-9) + 1e-18
    assert min(x, other) - 1e-15 <= after.y <= max(x, other) + 1e-15
    assert after.T - spring <= law.E_max + 1e-15  # the rest is sent on
    taken = after.T + after.S - (T + w)
    room = law.E_max - (T + w - 0.5 * law.K * (x - y) ** 2)
    assert taken == pytest.approx(min(came, max(room, 0.0)), abs=1e-15)  # and of what came only what fits is taken


def test_an_end_without_energy_has_its_set_point_at_itself_and_is_only_damped() -> None:
    law = PSPM()
    f_m, after = master(law, PSPMEnd(0.1, -1e-3, 0.0, 0.0), at(0.02, v=0.3), Back(0.5, 0.0))
    assert (after.y, f_m) == (0.02, pytest.approx(law.B_m * 0.3))


def test_three_axes_share_one_radius() -> None:
    law, s, rest = PSPM(), PSPMEnd(0.0, 1e-3, 0.0, 0.0), at()
    others = (0.06, -0.03, 0.02)
    over = PSPMSums(*np.sum([law.master_sums(s, rest, Back(x, 0.0)) for x in others], axis=0).tolist())
    ends = [law.master(s, rest, Back(x, 0.0), over)[2] for x in others]
    points = np.array([end.y for end in ends])
    assert np.linalg.norm(points) == pytest.approx(sqrt(2e-3 / law.K))
    assert points / points[0] == pytest.approx(np.array(others) / others[0])
    assert len({end[1:] for end in ends}) == 1


def test_a_device_that_is_let_have_less_force_keeps_what_it_did_not_spend() -> None:
    """The motor held a quarter of f = K (y - x) over a motion towards y: three quarters of the spring's are left."""
    law, T = PSPM(E_max=1.0), 0.5 * 500.0 * 0.01**2
    f, d = 0.25 * 500.0 * 0.01, -1e-4
    _, after = master(law, PSPMEnd(0.0, T, 0.0, 0.0), at(0.01 + d, f_held=f, dx=d), Back(0.01 + d, 0.0))
    assert pytest.approx(T + f * d, rel=1e-12) == after.T


def test_what_the_books_lack_is_what_did_not_fit() -> None:
    """E_port = T_m + T_s + under way - 2 E_0 + dropped, and with room for all that comes nothing is dropped."""
    for room in (10.0, 0.005):
        trace = run(load_scene("soft_tissue", law=PSPM(E_max=room), duration=1.0)).trace
        dropped = trace["E_port"] + 0.02 - trace["E_law"]
        assert np.diff(dropped).min() > -1e-12
        assert (dropped.max() < 1e-12) == (room == 10.0)
    assert seed_energy(PSPM()) == 0.02


def test_a_spring_that_throws_a_body_further_than_its_energy_is_told_of() -> None:
    facts = facts_of(load_scene("canonical", law=PSPM()))
    most = min(facts.mass_m, facts.mass_s) / facts.dt**2
    told, = PSPM(K=1.01 * most).conditions(facts)
    assert f"--set law.K={most:.6g} is the most" in told
    assert PSPM(K=0.99 * most).conditions(facts) == ()


def test_a_damper_that_takes_more_than_all_motion_in_a_tick_is_told_of() -> None:
    facts = facts_of(load_scene("canonical", law=PSPM(B_m=250.0)))
    told, = PSPM(B_m=250.0).conditions(facts)
    assert "B <= m/T, T the longest tick, which B_m = 250 N s/m is not; --set law.B_m=100 is the most" in told
