"""Position-position: its two ends, what two handles feel, the delay it stands."""

from __future__ import annotations

import pytest

from channel.delay import Delay
from master.hand import Grip, Rest
from slave.tissue import Tissue
from teleop import Refused, Scene
from teleop.analysis.models.continuous import continuous
from teleop.analysis.passivity.judge import two_ports
from teleop.analysis.stability.assess import stability
from teleop.law.offers import AgeRange as Age
from teleop.laws.pp import Back, Forth, PositionPosition, PositionPositionEnd
from teleop.physics.plant import MassDamper
from tests.teleop.law.test_injection import CONSTANT
from tests.teleop.laws.test_p_d import at

SLACK = PositionPositionEnd(0.0)
HANDLE = MassDamper(mass=0.04, damping=0.8)


def test_each_end_is_drawn_to_the_others_motion() -> None:
    law = PositionPosition(K=100.0, B=4.0)
    assert law.master(SLACK, at(0.03, 0.2), Back(0.01, 0.1)) == (100.0 * (0.03 - 0.01) + 4.0 * (0.2 - 0.1),
                                                                 Forth(0.03, 0.2), SLACK)
    assert law.slave(SLACK, at(0.01, 0.1), Forth(0.03, 0.2)) == (100.0 * (0.03 - 0.01) + 4.0 * (0.2 - 0.1),
                                                                 Back(0.01, 0.1), SLACK)


@pytest.mark.parametrize(("T", "free"), [(0.0, "1.680"), (0.05, "40.975")])
def test_two_handles_feel_the_known_numbers(T: float, free: str) -> None:
    """0.04 kg, 0.8 N s/m, coupling and wall of 400 N/m: 200 N/m are felt; |Z| in free space at 1 Hz."""
    law = PositionPosition(K=400.0, B=4.0).linear()
    scene = Scene(law=law, master=HANDLE, slave=HANDLE, environment=Tissue(k=400.0, d=0.0), duration=1.0,
                  link=Delay(T) if T else None)
    got = two_ports(scene).continuous
    assert got is not None
    assert got.felt == pytest.approx(200.0, abs=0.01)
    assert f"{got.free:.3f}" == free
    assert got.absolutely_stable == (T == 0.0)


def test_the_delay_it_stands_is_the_known_one() -> None:
    """Hand 100 N/m and 2 N s/m, coupling 2000 and 8, wall 2000 N/m: 14.840 ms, first unstable at 11 ticks of 1 ms."""
    hand = Grip(mass=0.0, k=100.0, d=2.0, reference=Rest())
    scene = Scene(law=PositionPosition(K=2000.0, B=8.0).linear(), master=HANDLE, slave=HANDLE, hand=hand, duration=1.0,
                  environment=Tissue(k=2000.0, d=0.0))
    found = continuous(scene).round_trip
    assert found is not None
    assert round(found * 1e3, 3) == 14.840
    assert stability(scene).critical_round_trip == 11


def test_over_a_delay_it_takes_the_ends_own_damping_or_a_law_that_injects_it() -> None:
    near = CONSTANT._replace(fwd=Age(1e-3, 1e-3), bwd=Age(1e-3, 1e-3), damping_m=0.5, damping_s=1.0)
    assert PositionPosition().conditions(near) == ()
    (told,) = PositionPosition(K=400.0, B=4.0).conditions(CONSTANT)
    assert "--set law=pd_d --set law.K=400 --set law.K_d=4 --set law.B=" in told
    (varies,) = PositionPosition(K=400.0, B=4.0).conditions(CONSTANT._replace(lossy=True))
    assert "--set law=p_d --set law.K=400 --set law.B=20.4" in varies


@pytest.mark.parametrize(("knob", "value"), [("K", -1.0), ("B", -1.0), ("rejoin", -1.0), ("K", float("nan"))])
def test_knobs_out_of_range_are_refused(knob: str, value: float) -> None:
    with pytest.raises(Refused, match=knob):
        PositionPosition(**{knob: value})
