"""The steered master: a hand that goes where it is told to, and the force that is felt on the way."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from math import exp, hypot, inf, nan
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from master import Grip, Reach, Rest, SimulatedMaster, Sine, SteeredMaster
from master.steered import ALIGNING, ENOUGH, SWING
from teleop import MassDamper, Refused, Scene, Wave
from teleop.physics.following import BANDWIDTH, MOST_SPEED, following

BODY = MassDamper(mass=0.1, damping=0.5)
HAND = Grip(mass=0.4, k=200.0, d=5.0, reference=Sine(amplitude=0.05, frequency=1.0))
STILL = replace(HAND, reference=Rest())
DAY = 86_400.0


def scene(**other: Any) -> Scene:
    return Scene(**{"law": Wave(), "hand": HAND, "master": BODY, "slave": BODY, "duration": DAY, **other})


def felt(device: SteeredMaster, until: int, force: float = 0.0) -> list[tuple[float, float, float, float]]:
    """Reference, place, speed and hand force of the first axis, from the next tick on; `force`: the motor's."""
    out = []
    for k in range(device._k + 1, until + 1):
        device.hold((force,))
        got = device.read(k)
        assert got.f is not None
        out.append((device._r[0], got.x[0], got.v[0], got.f[0]))
    return out


# The filter


def test_a_tick_of_the_filter_and_many_are_the_matrix_exponential_of_its_equation() -> None:
    """r'' = omega^2 (p - r) - 2 omega r', for a target that stays where it is within the tick; by mpmath, 40 digits."""
    with mpmath.workdps(40):
        omega = mpmath.mpf(BANDWIDTH)
        for dt, ticks in ((1e-6, 1), (1e-3, 1), (0.02, 1), (0.1, 1), (1e-3, 200)):
            exact = mpmath.expm(mpmath.matrix([[0, 1], [-omega**2, -2 * omega]]) * mpmath.mpf(dt) * ticks)
            for r, w, p in ((0.0, 0.0, 0.01), (0.02, -0.3, 0.03), (-0.01, 0.8, 0.04)):
                y = exact * mpmath.matrix([mpmath.mpf(r) - mpmath.mpf(p), w])
                there, speed = [r], [w]
                for _ in range(ticks):
                    there, speed = following(dt).step(there, speed, [p])
                assert there[0] == pytest.approx(float(y[0] + mpmath.mpf(p)), rel=1e-14 * ticks, abs=1e-17 * ticks)
                assert speed[0] == pytest.approx(float(y[1]), rel=1e-12 * ticks, abs=1e-15 * ticks)


@settings(max_examples=50)
@given(dt=st.sampled_from([1e-4, 1e-3, 1e-2, 0.05, 0.3]),
       targets=st.lists(st.tuples(*[st.floats(-10.0, 10.0)] * 3), min_size=1, max_size=20),
       ticks=st.integers(1, 20))
def test_the_reference_never_goes_faster_than_a_metre_per_second(dt: float, targets: Any, ticks: int) -> None:
    step, r, w = following(dt), [0.0] * 3, [0.0] * 3
    for target in targets:
        for _ in range(ticks):
            before = r
            r, w = step.step(r, w, target)
            assert hypot(*w) <= MOST_SPEED * (1.0 + 1e-12)
            assert hypot(*[b - a for a, b in zip(before, r, strict=True)]) <= MOST_SPEED * dt * (1.0 + 1e-12) + 1e-14


def test_towards_a_place_far_away_it_comes_close_to_that_speed_and_arrives_without_going_beyond() -> None:
    step, r, w, seen = following(1e-3), [0.0], [0.0], []
    for _ in range(1500):
        r, w = step.step(r, w, [1.0])
        seen.append((r[0], w[0]))
    assert max(speed for _, speed in seen) == pytest.approx(MOST_SPEED, rel=0.01)
    assert max(place for place, _ in seen) <= 1.0
    assert seen[-1] == pytest.approx((1.0, 0.0), abs=1e-5)
    r, w = [0.0], [3.0]
    for _ in range(300):  # what is too fast to begin with falls below the limit
        before = w
        r, w = step.step(r, w, [10.0])
        assert abs(w[0]) < max(abs(before[0]), MOST_SPEED + 1e-12)
    assert abs(w[0]) <= MOST_SPEED


# The device


def test_until_it_is_steered_it_is_the_simulated_master_to_the_bit_and_ticks_left_out_are_caught_up() -> None:
    assert SimulatedMaster(scene()).read(3).f is None
    plain, steered = SimulatedMaster(scene(), senses=True), SteeredMaster(scene())  # whatever the law reads
    for k in range(400):
        assert steered.read(k) == plain.read(k)
        for device in (plain, steered):
            device.hold((0.002 * k,))
    every, some = SteeredMaster(scene()), SteeredMaster(scene())
    for device in (every, some):
        device.read(300)
        device.steer([0.08])
    step = {k: every.read(k) for k in range(301, 380)}
    assert some.read(317) == step[317]
    assert some.read(379) == step[379]


def test_steered_it_moves_as_master_and_hand_do_under_the_filtered_reference() -> None:
    """M a + b v = k (r - x) + d (r' - v) - f_m with r straight between the ticks, integrated by DOP853."""
    device = SteeredMaster(scene(hand=STILL))
    device.hold((0.7,))
    device.steer([0.03])
    x, v, r, w = 0.0, 0.0, [0.0], [0.0]
    for k in range(1, 30):
        there, w = following(1e-3).step(r, w, [0.03])
        slope = (there[0] - r[0]) / 1e-3

        def rate(t: float, s: Any, r: float = r[0], slope: float = slope) -> list[float]:
            return [s[1], (200.0 * (r + slope * t - s[0]) + 5.0 * (slope - s[1]) - 0.5 * s[1] - 0.7) / 0.5]

        x, v = solve_ivp(rate, (0.0, 1e-3), (x, v), method="DOP853", rtol=1e-12, atol=1e-15).y[:, -1]
        r = there
        got = device.read(k)
        device.hold((0.7,))
        assert (got.x[0], got.v[0]) == pytest.approx((x, v), abs=1e-10)


ORDERS = {
    "steer": lambda device: device.steer([0.09]),
    "let go": lambda device: device.steer(None),
    "align": lambda device: device.align([0.0]),
    "turn to the same hand": lambda device: device.turn(scene(environment=None)),
    "turn to another motion of the hand": lambda device: device.turn(scene(hand=replace(HAND, reference=Rest(at=0.2)))),
    "turn to a motion that begins here, at another speed": lambda device: device.turn(
        scene(hand=replace(HAND, reference=Sine(amplitude=0.05, frequency=5.0)))),
}


@pytest.mark.parametrize("order", ORDERS)
def test_no_order_makes_the_force_of_the_hand_or_its_reference_jump(order: str) -> None:
    """From tick to tick the force changes by no more than the filter's own acceleration makes it.

    The reference's speed changes by at most (2 omega + omega) V dt = 0.18 m/s a tick where the handle is aligned, with
    omega = 60 rad/s; the force by the damper times that, by the spring at 1 m/s and by what the handle itself does.
    """
    for first in ("own", "steered", "let go", "aligned"):
        device = SteeredMaster(scene())
        device.read(200)
        if first in ("steered", "let go"):
            device.steer([0.02] if first == "steered" else None)
        elif first == "aligned":
            device.align([0.01])
        device.hold((2.0,))
        device.read(201)
        before = felt(device, 230, 2.0)
        ORDERS[order](device)
        seen = [*before, *felt(device, 400, 2.0)]
        most = max(abs(b[0] - a[0]) for a, b in pairwise(seen))
        bends = max(abs(c[0] - 2.0 * b[0] + a[0]) for a, b, c in zip(seen, seen[1:], seen[2:], strict=False))
        force = max(abs(b[3] - a[3]) for a, b in pairwise(seen))
        assert most <= MOST_SPEED * 1e-3 * 1.001, first
        assert bends <= 3.0 * ALIGNING * 1e-3 * MOST_SPEED * 1e-3, first
        assert force <= 0.6, (first, "newtons; a jump of the reference by 1 mm makes it more than 1")
    device._r = [device._r[0] + 1e-3]  # which this test would see
    assert abs(device.read(400).f[0] - seen[-1][3]) > 1.0


def test_a_hand_that_lets_go_has_no_force_soon_and_drives_nothing() -> None:
    """The spring is drawn by 4 cm; let go, the force is gone within half a second and the handle comes to rest."""
    device = SteeredMaster(scene(hand=STILL))
    device.steer([0.05])
    assert felt(device, 3000, 8.0)[-1][3] == pytest.approx(8.0, rel=1e-3)
    device.steer(None)
    seen = felt(device, 4500)
    assert abs(seen[500][3]) < 0.02
    assert abs(seen[-1][2]) < 1e-6, "at rest"
    assert abs(seen[-1][3]) < 1e-5


@settings(max_examples=5)
@given(k=st.floats(1.0, 5e3), d=st.floats(0.0, 50.0), mass=st.floats(0.05, 2.0), b=st.floats(0.0, 5.0),
       v=st.floats(-1.0, 1.0), off=st.floats(-0.02, 0.02))
def test_let_go_in_any_motion_it_comes_to_rest(k: float, d: float, mass: float, b: float, v: float, off: float) -> None:
    """Without damping of its own, too: a filter that follows the handle can only take energy out of it."""
    device = SteeredMaster(scene(hand=Grip(mass=0.0, k=k, d=d, reference=Rest()), master=MassDamper(
        mass=mass, damping=b)))
    device._v, device._x = [v], [off]
    device.steer(None)
    least = 0.5 * mass * v * v + 0.5 * k * off * off
    energies = [0.5 * mass * got.v[0] ** 2 + 0.5 * k * (device._r[0] - got.x[0]) ** 2
                for got in map(device.read, range(0, 30_000, 200))]
    assert max(energies) <= 1.5 * least + 1e-12
    slow = 2.0 * mass * BANDWIDTH**2 / k  # of the slowest pole, about
    assert energies[-1] <= max(0.01, exp(-30.0 / (slow + 1.0))) * least + 1e-12


# Aligning


def test_it_brings_the_handle_to_the_place_and_says_when_it_is_there() -> None:
    device = SteeredMaster(scene(hand=replace(HAND, reference=Reach(to=0.05, duration=0.5))))
    device.read(2000)
    assert not device.aligned, "nothing was asked"
    device.align([0.03])
    assert not device.aligned
    took = next(k for k in range(2001, 2700) if (device.read(k), device.aligned)[1])
    assert took < 2350, "well before its time is up, though this hand's spring is damped to 0.28 of critical"
    assert device.read(took).x[0] == pytest.approx(0.03, abs=5e-4)
    assert abs(device.read(took).v[0]) < 5e-3
    device.align(None)
    assert not device.aligned
    assert device.read(5000).x[0] == pytest.approx(0.05, abs=1e-4), "the hand does again what the scene says"
    device.align([0.02])
    device.read(5300)
    device.steer([0.07])
    assert device.read(6500).x[0] == pytest.approx(0.02, abs=1e-4), "what is ordered meanwhile is done after it"
    device.align(None)
    assert device.read(9000).x[0] == pytest.approx(0.07, abs=1e-4)


@settings(max_examples=12)
@given(k=st.floats(1.0, 5e4), ratio=st.floats(0.0, 2.0), mass=st.floats(0.05, 5.0), share=st.floats(0.0, 1.0))
def test_an_alignment_feeds_no_swing_whatever_the_hand(k: float, ratio: float, mass: float, share: float) -> None:
    """The energy in masses and spring about the place does not grow from one second to the next."""
    damping = 2.0 * ratio * float(np.sqrt(k * mass))
    device = SteeredMaster(scene(hand=Grip(mass=0.0, k=k, d=share * damping, reference=Rest()), master=MassDamper(
        mass=mass, damping=(1.0 - share) * damping)))
    device._v = [0.2]
    device.align([0.01])
    energies = [0.5 * mass * got.v[0] ** 2 + 0.5 * k * (0.01 - got.x[0]) ** 2 for got in map(device.read, range(3000))]
    each = [max(energies[since:since + 1000]) for since in range(0, 3000, 1000)]
    assert all(after <= before * (1.0 + 1e-6) + 1e-15 for before, after in pairwise(each))


def test_an_alignment_that_does_not_come_to_an_end_is_over_after_its_time_in_ticks() -> None:
    """Held back, or to a place that moves on at 0.2 m/s, which has no more time for that."""
    for every, place, force in ((1, 0.0, 30.0), (7, 0.0, 30.0), (20, 2e-4, 0.0)):
        device = SteeredMaster(scene(hand=STILL))
        device.align([0.05])
        for k in range(0, 1700, every):
            if place:
                device.align([0.02 + place * k])
            device.read(k)
            device.hold((force,))
            assert device.aligned == (k >= round(ENOUGH * 1e3)), (every, k)
    assert device.read(1700).x[0] > 0.3, "it follows meanwhile"


def test_a_place_that_moves_on_slowly_is_reached_in_time() -> None:
    """A slave that left the wall at 10 mm/s held up a turn until the time was over."""
    for speed in (0.0, 0.01, 0.05):
        device, k = SteeredMaster(scene(hand=HAND)), 0
        while not device.aligned:
            place = 0.02 - speed * 1e-3 * k
            device.align([place])
            x = device.read(k).x[0]
            k += 16
            assert k < 600, speed
        assert abs(x - place) < 5e-4 + 0.1 * speed, speed


# Turning


def test_a_turn_keeps_place_speed_and_what_the_hand_was_told_to_the_bit_and_started_again_it_begins_anew() -> None:
    turned, other, fresh = SteeredMaster(scene()), SteeredMaster(scene()), SteeredMaster(scene(start_m=0.01))
    for device in (turned, other):
        device.read(150)
        device.steer([0.06])
        device.read(220)
        device.hold((1.0,))
    before = turned.read(220)
    turned.turn(scene(observer=None, duration=DAY))
    assert turned.read(220) == before
    assert [turned.read(k) for k in range(221, 300)] == [other.read(k) for k in range(221, 300)]
    turned.align([0.03])
    turned.read(431)
    turned.hold((3.0,))
    turned.turn(scene(start_m=0.01), again=True)
    assert [turned.read(431 + k) for k in range(300)] == [fresh.read(k) for k in range(300)]
    assert not turned.aligned


def test_a_place_with_other_axes_or_out_of_reach_or_a_swing_that_is_none_is_refused_and_changes_nothing() -> None:
    device, other = SteeredMaster(scene()), SteeredMaster(scene())
    axes = r"one number for each of 1 axis.*send for example \[0.03\]"
    for order in (device.steer, device.align):
        for wrong in ([0.1, 0.2], [], 0.1, "0", {"x": 1.0}):
            with pytest.raises(Refused, match=axes):
                order(wrong)
        for place in (nan, inf, -inf, "x", None, True, 10.1, -1e300):
            with pytest.raises(Refused, match=r"to\[0\] must be|10 m from 0"):
                order([place])
    swings: tuple[Any, ...] = ([nan], [11.0], [0.01, 0.02], "far")
    for swing in swings:
        with pytest.raises(Refused):
            device.steer([0.02], swing)
    assert device.read(300) == other.read(300)


def test_a_scene_whose_hand_cannot_pull_is_refused_also_by_a_turn() -> None:
    for hand in (None, replace(HAND, k=0.0)):
        with pytest.raises(Refused, match="no hand with a spring"):
            SteeredMaster(scene(hand=hand))
        device, other = SteeredMaster(scene()), SteeredMaster(scene())
        device.read(10)
        with pytest.raises(Refused, match="no hand with a spring"):
            device.turn(scene(hand=hand))
        assert device.read(300) == other.read(300)


def test_in_three_axes_each_goes_its_own_way_and_all_together_at_most_at_the_limit() -> None:
    device = SteeredMaster(scene(axes=3, environment=(None,) * 3, hand=STILL))
    device.steer([1.0, -2.0, 0.0])
    steps = []
    for k in range(1, 500):
        before = list(device._r)
        device.read(k)
        steps.append(np.subtract(device._r, before))
    assert max(np.linalg.norm(steps, axis=1)) == pytest.approx(1e-3, rel=0.01)
    assert device._r[1] == pytest.approx(-2.0 * device._r[0])
    assert device._r[2] == 0.0
    assert device.read(8000).x == pytest.approx((1.0, -2.0, 0.0), abs=1e-6)


# Open-ended


def test_of_a_motion_that_cannot_be_sampled_as_it_goes_it_takes_a_minute() -> None:
    asked: list[int] = []

    class Whole:
        """A reference without `first`."""

        def samples(self, axes: int, count: int, dt_ns: int) -> tuple[list[float], ...]:
            asked.append(count)
            return tuple([[1e-6 * k for k in range(count)] for _ in range(axes)])

    device = SteeredMaster(scene(hand=replace(HAND, reference=Whole())))
    assert asked == [60_000]
    device.read(61_000)
    assert device._r[0] == pytest.approx(0.06 - 1e-6, rel=1e-9)
    assert device._r == device._before, "it stays where it is"


# Its record


def rows(path: Path, axes: int = 1) -> np.ndarray[Any, Any]:
    data = path.read_bytes()
    return np.frombuffer(data[data.index(b"\n") + 1:], dtype="<f8").reshape(-1, 1 + axes)


def test_its_record_has_the_reference_of_every_tick_also_of_those_left_out_and_what_is_killed_lacks_few(
    tmp_path: Path
) -> None:
    device = SteeredMaster(scene())
    device.read(5)
    device.record(tmp_path)
    expected = [(5, device._r[0])]
    device.steer([0.04])
    for k in range(6, 900):
        device.read(k)
        expected.append((k, device._r[0]))
    assert 0 <= len(expected) - len(rows(tmp_path / "hand.bin")) < 16
    device.read(903)
    device.record(None)
    assert json.loads((tmp_path / "hand.bin").read_bytes().split(b"\n", 1)[0]) == {
        "version": 1, "dt_ns": 1_000_000, "axes": 1}
    got = rows(tmp_path / "hand.bin")
    assert got[:, 0].tolist() == list(range(5, 904))
    assert [tuple(row) for row in got[:len(expected)].tolist()] == expected


def test_a_record_ends_where_the_hand_was_and_the_next_begins_where_it_is(tmp_path: Path) -> None:
    """In whichever order a device is turned and its record begun."""
    for folder in ("a", "b", "c"):
        (tmp_path / folder).mkdir()
    device = SteeredMaster(scene())
    device.record(tmp_path / "a")
    device.read(100)
    there = device._r[0]
    device.turn(scene(), again=True)
    device.record(tmp_path / "b")
    device.read(200)
    device.record(tmp_path / "c")
    device.turn(scene(), again=True)
    device.read(210)
    device.record(None)
    a, b, c = (rows(tmp_path / folder / "hand.bin") for folder in "abc")
    assert a[-1].tolist() == [100, there]
    assert b[0].tolist() == [100.0, 0.0]
    assert c[0].tolist() == [200.0, 0.0]
    assert (b[-1, 0], c[-1, 0]) == (200, 210)


def test_a_full_disk_ends_the_record_and_not_the_motion(tmp_path: Path) -> None:
    device, other = SteeredMaster(scene()), SteeredMaster(scene())

    class Full:
        def write(self, _data: bytes) -> None:
            raise OSError(28, "No space left on device")

        def close(self) -> None:
            pass

    device.record(tmp_path)
    assert device._writer is not None
    device._writer._file.close()
    device._writer._file = Full()
    assert device.read(600) == other.read(600)
    assert device.trouble == "the record of the hand stopped at row 16: No space left on device"
    device.record(None)


def test_a_hand_that_swings_does_so_by_the_runs_clock_and_a_new_target_ends_it_without_a_jump() -> None:
    """Against the filter's own answer to a sine, computed apart: gain and phase of omega^2/(s + omega)^2."""
    device = SteeredMaster(scene(hand=STILL))
    device.steer([0.01], [0.02])
    path = np.array([each[0] for each in felt(device, 6000)])
    turn = 2.0 * np.pi * SWING
    answer = 0.02 / (1.0 + 1j * turn / BANDWIDTH) ** 2
    t = np.arange(1, len(path) + 1) * 1e-3 + 0.5e-3  # a target that is held from tick to tick is half a tick ahead
    np.testing.assert_allclose(path[2000:], 0.01 + np.imag(answer * np.exp(1j * turn * t))[2000:], atol=1e-6)
    device.steer([0.01], [0.02])  # told again, as after a turn, it goes on
    again = np.array([each[0] for each in felt(device, 8000)])
    assert np.abs(np.diff(np.concatenate([path[-1:], again]))).max() < 1.01 * np.abs(np.diff(path)).max()
    device.steer([-0.03])
    moved = np.array([each[0] for each in felt(device, 9500)])
    assert np.abs(np.diff(np.concatenate([again[-1:], moved]))).max() < 1e-3 * MOST_SPEED
    assert moved[-1] == pytest.approx(-0.03, abs=1e-6)
