"""The hand: its grip, and the references it follows."""

import math

import numpy as np
import pytest

from master.hand import Grip, Reach, Rest, Sine
from teleop.errors import Refused

MS = 1_000_000


def test_sine_is_sampled_at_the_ticks_however_late() -> None:
    (x,) = Sine(amplitude=0.05, frequency=1.0).samples(1, 10_001, MS)
    assert len(x) == 10_001
    for k in (0, 250, 7919, 10_000):
        assert x[k] == 0.05 * math.sin(2.0 * math.pi * (k * MS / 1e9))
    assert x[9_250] == pytest.approx(0.05, rel=1e-12)  # t is not accumulated: no drift after 9 s


def test_sine_faster_than_the_ticks_can_show_is_refused() -> None:
    Sine(amplitude=1.0, frequency=500.0).samples(1, 2, MS)
    with pytest.raises(Refused, match="more than half the tick rate, 500 Hz"):
        Sine(amplitude=1.0, frequency=501.0).samples(1, 2, MS)


def test_reach_is_the_minimum_jerk_polynomial() -> None:
    # Flash and Hogan 1985: rest at both ends, half way at half time, peak speed 15/8 of the mean.
    (x,) = Reach(to=0.3, start=0.5, duration=0.8, origin=0.1).samples(1, 2001, MS)
    path = (np.array(x) - 0.1) / 0.2
    s = (np.arange(2001) / 1000.0 - 0.5) / 0.8
    inside = (s >= 0) & (s <= 1)
    np.testing.assert_allclose(path[inside], np.polyval([6, -15, 10, 0, 0, 0], s[inside]), atol=1e-14)
    assert set(path[s < 0]) == {0.0}
    assert set(np.array(x)[s >= 1]) == {0.3}
    assert path[900] == pytest.approx(0.5, abs=1e-14)
    speed = np.diff(path) * 1000.0 * 0.8
    assert speed.max() == pytest.approx(15 / 8, rel=1e-5)
    assert speed.min() >= 0.0
    assert abs(np.diff(speed)[[500, 1299]]).max() < 1e-4  # no step in acceleration at the ends
    np.testing.assert_allclose(path[500:1301] + path[500:1301][::-1], 1.0, atol=1e-14)


def test_reach_has_less_jerk_than_its_neighbours() -> None:
    # Any change that keeps rest at both ends costs jerk; the least is 720 D^2/T^5.
    dt = 1e-3
    (x,) = Reach(to=1.0, duration=1.0).samples(1, 1001, MS)
    s = np.arange(1001) * dt

    def jerk(path: np.ndarray) -> float:
        return float((np.diff(path, 3) ** 2).sum() / dt**5)

    assert jerk(np.array(x)) == pytest.approx(720.0, rel=0.02)
    for size in (-3.0, 3.0):
        assert jerk(np.array(x) + size * (s * (1 - s)) ** 3) > jerk(np.array(x)) + 10.0


def test_hold_stays() -> None:
    assert [*Rest(at=0.02).samples(1, 3, MS)[0]] == [0.02, 0.02, 0.02]
    assert [*Rest().samples(1, 2, MS)[0]] == [0.0, 0.0]


@pytest.mark.parametrize("reference", [
    Sine(amplitude=0.2, frequency=250.0), Reach(to=0.2, duration=1e-3), Rest(at=0.2),
])
def test_a_number_lies_along_the_first_axis(reference: Rest) -> None:
    x, y, z = reference.samples(3, 2, MS)
    assert x[1] == 0.2
    assert [*y] == [*z] == [0.0, 0.0]


@pytest.mark.parametrize("reference", [
    Sine(amplitude=(0.1, 0.2, -0.3), frequency=250.0),
    Reach(to=(0.1, 0.2, -0.3), duration=1e-3, origin=(1.0, 2.0, 3.0)),
    Rest(at=(0.1, 0.2, -0.3)),
])
def test_a_tuple_has_an_entry_for_each_axis(reference: Rest) -> None:
    assert [axis[1] for axis in reference.samples(3, 2, MS)] == [0.1, 0.2, -0.3]
    with pytest.raises(Refused, match=r"has 3 entries, the scene has axes=1"):
        reference.samples(1, 2, MS)


def test_references_and_grips_compare_by_value() -> None:
    one, two = (Grip(mass=m, k=200, d=5, reference=Sine(amplitude=0.05, frequency=1.0)) for m in (0, 0.0))
    assert one == two
    assert hash(one) == hash(two)


@pytest.mark.parametrize(("make", "says"), [
    (lambda: Sine(amplitude=math.nan, frequency=1.0), "amplitude must be finite"),
    (lambda: Sine(amplitude=0.1, frequency=-1.0), "frequency must be at least 0"),
    (lambda: Sine(amplitude=(), frequency=1.0), "amplitude must have an entry for each axis"),
    (lambda: Reach(to=(0.1, math.inf), duration=1.0), r"to\[1\] must be finite"),
    (lambda: Reach(to=0.1, duration=0.0), "duration must be above 0"),
    (lambda: Reach(to=0.1, duration=1.0, start=None), "start must be a number"),  # type: ignore[arg-type]
    (lambda: Rest(at=[0.1]), "at must be a number"),  # type: ignore[arg-type]
    (lambda: Grip(mass=-0.1, k=1.0, d=1.0, reference=Rest()), "mass must be at least 0"),
    (lambda: Grip(mass=0.1, k=math.inf, d=1.0, reference=Rest()), "k must be finite"),
    (lambda: Grip(mass=0.1, k=1.0, d=1.0, reference=0.05), "write for example reference=Rest"),  # type: ignore[arg-type]
])
def test_impossible_hands_are_refused(make: type, says: str) -> None:
    with pytest.raises(Refused, match=says):
        make()
