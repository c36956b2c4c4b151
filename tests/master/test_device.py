"""The simulated master: at every tick it reads what the equation of motion says, as a device would."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from master.device import SimulatedMaster
from master.hand import Grip, Reach, Sine
from teleop.errors import Refused
from teleop.laws.pfra import PFRA
from teleop.laws.wave import Wave
from teleop.physics.plant import MassDamper
from teleop.protocol.endpoint import Reading
from teleop.protocol.guard import DEADLINE
from teleop.scene.scene import Scene
from teleop.simulation.virtual import run

BODY = MassDamper(mass=0.1, damping=0.5)
HAND = Grip(mass=0.4, k=200.0, d=5.0, reference=Sine(amplitude=0.05, frequency=3.0))


def scene(**other: Any) -> Scene:
    """A law that reads f_h, and a sensor to read it with."""
    parts: dict[str, Any] = {"law": PFRA(), "observer": None, "hand": HAND, "duration": 0.3}
    return Scene(**{"master": BODY, "slave": BODY, **parts, **other})


def forces(count: int, axes: int = 1) -> list[tuple[float, ...]]:
    return [tuple(2.0 * np.sin(0.3 * k + i) for i in range(axes)) for k in range(count)]


def readings(device: SimulatedMaster, held: list[tuple[float, ...]]) -> list[Reading]:
    """What it reads at each tick, the forces held in between."""
    out = []
    for k, force in enumerate(held):
        out.append(device.read(k))
        device.hold(force)
    return out


def test_it_starts_at_rest_where_the_scene_says() -> None:
    device = SimulatedMaster(scene(axes=3, start_m=(0.01, 0.0, -0.02)))
    got = device.read(0)
    assert (got.x, got.v) == ((0.01, 0.0, -0.02), (0.0, 0.0, 0.0))
    assert device.read(0) == got  # to look twice moves nothing


@pytest.mark.parametrize("hand", [HAND, None], ids=["gripped", "alone"])
def test_it_moves_as_the_equation_of_motion_says(hand: Grip | None) -> None:
    """M a + b v = f_h - f_m, with f_h the grip's spring, damper and inertia, integrated by DOP853."""
    ticks = 60
    held = forces(ticks)
    got = readings(SimulatedMaster(scene(hand=hand)), held)
    r = HAND.reference.samples(1, ticks + 1, 1_000_000)[0]
    x, v = 0.0, 0.0
    for k in range(ticks - 1):
        slope = (r[k + 1] - r[k]) / 1e-3

        def pull(t: float, x: float, v: float, k: int = k, slope: float = slope) -> float:
            return 0.0 if hand is None else 200.0 * (r[k] + slope * t - x) + 5.0 * (slope - v)

        def rate(t: float, s: Any, pull: Any = pull, f: float = held[k][0]) -> list[float]:
            mass = 0.1 + (0.0 if hand is None else 0.4)
            return [s[1], (pull(t, s[0], s[1]) - f - 0.5 * s[1]) / mass]

        end = solve_ivp(rate, (0.0, 1e-3), (x, v), method="DOP853", rtol=1e-12, atol=1e-15)
        x, v = end.y[:, -1]
        assert got[k + 1].x[0] == pytest.approx(x, abs=1e-12)
        assert got[k + 1].v[0] == pytest.approx(v, abs=1e-10)
        touch = got[k + 1].f
        assert touch is not None
        # What passes through the grip: spring and damper, less the hand's own inertia, with the old force acting.
        inertia = 0.0 if hand is None else 0.4 * rate(1e-3, (x, v))[1]
        assert touch[0] == pytest.approx(pull(1e-3, x, v) - inertia, abs=1e-9)


@pytest.mark.parametrize("other", [
    {}, {"hand": None, "start_m": 0.02}, {"axes": 3, "environment": (None,) * 3},
    {"axes": 2, "environment": (None, None), "hand": replace(HAND, reference=Reach(to=0.05, start=0.05, duration=0.1))},
], ids=["one axis", "no hand", "three axes", "a reach"])
def test_given_the_forces_of_a_virtual_run_it_reads_that_run_to_the_bit(other: dict[str, Any]) -> None:
    told = scene(**other)
    trace = run(told).trace

    def rows(name: str) -> list[tuple[float, ...]]:
        return [tuple(row) for row in trace[name].reshape(told.ticks, -1).tolist()]

    got = readings(SimulatedMaster(told), rows("f_m"))
    for name, read in (("x_m", [r.x for r in got]), ("v_m", [r.v for r in got]), ("f_h", [r.f for r in got])):
        assert read == rows(name), name


def test_over_ticks_that_are_left_out_the_force_goes_on() -> None:
    every, some = SimulatedMaster(scene()), SimulatedMaster(scene())
    for device in (every, some):
        device.hold((1.5,))
    step = [every.read(k) for k in range(41)]
    assert some.read(7) == step[7]
    assert some.read(40) == step[40]


def test_it_can_be_read_one_tick_beyond_the_last() -> None:
    assert len(SimulatedMaster(scene()).read(scene().ticks).x) == 1


@pytest.mark.parametrize("other", [{"law": Wave()}, {"observer": 200.0}], ids=["wave", "pfra with an observer"])
def test_without_a_use_for_a_force_sensor_it_has_none(other: dict[str, Any]) -> None:
    assert SimulatedMaster(scene(**other)).read(5).f is None


def test_a_force_that_is_not_renewed_lapses_at_its_deadline_and_ticks_left_out_before_it_keep_it() -> None:
    """As hardware that lets go by itself: of an end that was killed or hangs, no line runs any more."""
    last = round(DEADLINE / scene().dt)
    long = scene(duration=0.6)
    renewed, forgotten, let_go = SimulatedMaster(long), SimulatedMaster(long), SimulatedMaster(long)
    for device in (renewed, forgotten, let_go):
        device.read(3)
        device.hold((1.5,))
    for k in range(4, 3 + last):
        renewed.read(k)
        renewed.hold((1.5,))
    assert forgotten.read(3 + last) == renewed.read(3 + last), "to the bit, until the deadline"
    let_go.read(3 + last)
    let_go.hold((0.0,))
    assert forgotten.read(3 + 2 * last) == let_go.read(3 + 2 * last) != renewed.read(3 + 2 * last)
    forgotten.hold((1.5,))
    assert forgotten.read(5 + 2 * last) != let_go.read(5 + 2 * last), "and it takes hold again"


def test_a_force_that_is_renewed_at_every_tick_never_lapses_however_long_a_tick_is() -> None:
    slow = scene(dt=0.4, duration=4.0, law=Wave(), hand=None)
    device, still = SimulatedMaster(slow), SimulatedMaster(slow)
    for k in range(3):
        device.read(k)
        device.hold((1.5,))
        still.read(k)
    assert device.read(3) != still.read(3)


# -- turning to another scene -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("other", [
    {"law": Wave()}, {"master": MassDamper(mass=0.3, damping=2.0)}, {"hand": replace(HAND, k=90.0)}, {"hand": None},
    {"master": MassDamper(mass=0.1, friction=0.4)},
], ids=["another law", "another body", "another hand", "no hand", "friction"])
def test_turned_to_another_scene_it_goes_on_from_the_same_place_and_speed_to_the_bit(other: dict[str, Any]) -> None:
    """And from then on it moves as a master of that scene does from there, under the same reference."""
    device = SimulatedMaster(scene())
    held = forces(200)
    readings(device, held[:90])
    before = device.read(90)
    device.turn(scene(**other))
    assert device.read(90)[:2] == before[:2]
    fresh = SimulatedMaster(scene(**other))
    fresh.read(90)
    fresh._x, fresh._v, fresh._f = list(before.x), list(before.v), list(held[89])
    for k in range(91, 200):
        assert device.read(k) == fresh.read(k)
        device.hold(held[k])
        fresh.hold(held[k])


def test_started_again_it_is_at_rest_at_the_new_scenes_start_and_its_hand_begins_anew() -> None:
    device, fresh = SimulatedMaster(scene()), SimulatedMaster(scene(start_m=0.02))
    readings(device, forces(101))
    device.turn(scene(start_m=0.02), again=True)
    assert device.read(100) == fresh.read(0) == device.read(100)
    assert [device.read(100 + k) for k in range(250)] == [fresh.read(k) for k in range(250)]


@pytest.mark.parametrize(("other", "said"), [
    ({"dt": 2e-3}, r"it has dt=0.001 s and 1 axis, and scene scene has dt=0.002 s and 1 axis"),
    ({"axes": 3, "environment": (None,) * 3}, "dt=0.001 s and 3 axes"),
])
def test_a_turn_to_other_ticks_or_axes_is_refused_and_changes_nothing(other: dict[str, Any], said: str) -> None:
    device, alone = SimulatedMaster(scene()), SimulatedMaster(scene())
    device.read(20)
    with pytest.raises(Refused, match=said):
        device.turn(scene(**other))
    assert device.read(60) == alone.read(60)


def test_a_turn_to_what_has_no_exact_step_changes_nothing() -> None:
    device, alone = SimulatedMaster(scene()), SimulatedMaster(scene())
    device.read(20)
    with pytest.raises(Refused, match="no finite step"):
        device.turn(scene(law=Wave(), hand=replace(HAND, k=1e308), master=MassDamper(mass=1e-9)))
    assert device.read(60) == alone.read(60)


def test_a_sensor_may_be_asked_for_or_be_done_without() -> None:
    assert SimulatedMaster(scene(law=Wave()), senses=True).read(5).f == SimulatedMaster(scene()).read(5).f
    assert SimulatedMaster(scene(), senses=False).read(5).f is None


class Known:
    """A reference that can be sampled from any tick on, and notes how many samples were asked of it at most at once."""

    def __init__(self) -> None:
        self.asked: list[int] = []

    def samples(self, axes: int, count: int, dt_ns: int, first: int = 0) -> tuple[Any, ...]:
        self.asked.append(count)
        return HAND.reference.samples(axes, count, dt_ns, first=first)  # type: ignore[call-arg]


def test_a_run_of_a_day_begins_with_few_samples_and_moves_as_a_short_one_does() -> None:
    reference = Known()
    day = SimulatedMaster(scene(hand=replace(HAND, reference=reference), duration=86_400.0))
    assert sum(reference.asked) < 1000
    short = SimulatedMaster(scene(duration=2.0))
    assert [day.read(k) for k in range(2000)] == [short.read(k) for k in range(2000)]
    assert max(reference.asked) < 1000
    assert sum(reference.asked) < 3000
