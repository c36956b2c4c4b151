"""The virtual wall as a law: what it answers to a reading."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from teleop import VirtualWall
from teleop.law import At, find_law, reads, start_at

metres = st.floats(-1.0, 1.0)
speeds = st.floats(-10.0, 10.0)


def felt(law: VirtualWall, x: float, v: float) -> float:
    """The force at a reading; what the law does not read is NaN."""
    f_m, state = law.force((), At(x, v, math.nan, math.nan, math.nan, False, math.inf, math.nan))
    assert state == ()
    return f_m


def test_inside_it_is_a_spring_damper() -> None:
    law = VirtualWall(K=800.0, B=2.0, at=0.03)
    assert felt(law, 0.05, 0.25) == 800.0 * (0.05 - 0.03) + 2.0 * 0.25
    assert felt(law, 0.05, -0.25) == 800.0 * (0.05 - 0.03) - 2.0 * 0.25


@given(x=metres, v=speeds, at=metres)
def test_it_pushes_out_or_not_at_all_and_only_inside(x: float, v: float, at: float) -> None:
    f_m = felt(VirtualWall(K=500.0, B=3.0, at=at), x, v)
    assert f_m >= 0.0
    assert f_m == 0.0 or x > at


def test_it_does_nothing_to_what_leaves_faster_than_the_spring_pushes_nor_on_its_surface_and_nan_stays_nan() -> None:
    assert felt(VirtualWall(K=500.0, B=3.0), 0.01, -2.0) == 0.0
    assert felt(VirtualWall(K=500.0, B=3.0, at=0.02), 0.02, 5.0) == 0.0
    for x, v in ((math.nan, 0.0), (0.1, math.nan)):
        assert math.isnan(felt(VirtualWall(B=1.0), x, v))


def test_it_has_no_memory_and_reads_position_and_velocity_alone() -> None:
    assert VirtualWall().start(start_at(0.2, 0.0, 0.0, 1e-3)) == ()
    assert reads(VirtualWall().force) == {"x", "v"}
    assert find_law("virtual_wall")() == VirtualWall()
