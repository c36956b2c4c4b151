"""The hand: its grip, and the references it follows."""

import math

import numpy as np
import pytest

from master.hand import Grip, Reach, Rest, Sine

MS = 1_000_000


def test_sine_is_sampled_at_the_ticks_however_late() -> None:
    (x,) = Sine(amplitude=0.05, frequency=1.0).samples(1, 10_001, MS)
    assert len(x) == 10_001
    for k in (0, 250, 7919, 10_000):
        assert x[k] == 0.05 * math.sin(2.0 * math.pi * (k * MS / 1e9))
    assert x[9_250] == pytest.approx(0.05, rel=1e-12)  # t is not accumulated: no drift after 9 s


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


def test_a_number_lies_along_the_first_axis_and_a_tuple_has_an_entry_for_each() -> None:
    assert [*Rest(at=0.02).samples(1, 3, MS)[0]] == [0.02, 0.02, 0.02]
    assert [*Rest().samples(1, 2, MS)[0]] == [0.0, 0.0]
    for one in (Sine(amplitude=0.2, frequency=250.0), Reach(to=0.2, duration=1e-3), Rest(at=0.2)):
        x, y, z = one.samples(3, 2, MS)
        assert x[1] == 0.2, one
        assert [*y] == [*z] == [0.0, 0.0], one
    for each in (Sine(amplitude=(0.1, 0.2, -0.3), frequency=250.0), Rest(at=(0.1, 0.2, -0.3)),
                 Reach(to=(0.1, 0.2, -0.3), duration=1e-3, origin=(1.0, 2.0, 3.0))):
        assert [axis[1] for axis in each.samples(3, 2, MS)] == [0.1, 0.2, -0.3], each


def test_references_and_grips_compare_by_value() -> None:
    one, two = (Grip(mass=m, k=200, d=5, reference=Sine(amplitude=0.05, frequency=1.0)) for m in (0, 0.0))
    assert one == two
    assert hash(one) == hash(two)
