"""The simulated master and slave: at every tick each reads what the equation of motion says, as hardware would."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from master import Grip, Reach, SimulatedMaster, Sine
from slave import Moving, SimulatedSlave, StandardLinearSolid, Tissue, Wall
from teleop import PFRA, Direct, MassDamper, Reading, Refused, Scene, Wave, run
from teleop.protocol.guard import DEADLINE

BODY = MassDamper(mass=0.1, damping=0.5)
HAND = Grip(mass=0.4, k=200.0, d=5.0, reference=Sine(amplitude=0.05, frequency=3.0))
TISSUE = Tissue(k=300.0, d=2.0, at=0.001)
HEART = Moving(environment=Wall(k=2e3, d=5.0, at=0.001), path=Sine(amplitude=0.005, frequency=1.2))
SOLID = StandardLinearSolid(k=300.0, k1=700.0, tau=0.1)


def master(**other: Any) -> Scene:
    """A law that reads f_h, and a sensor to read it with."""
    return Scene(**{"master": BODY, "slave": BODY, "law": PFRA(), "observer": None, "hand": HAND, "duration": 0.3,
                    **other})


def slave(**other: Any) -> Scene:
    """A law that reads f_env."""
    body = MassDamper(mass=0.5, damping=1.0)
    return Scene(**{"law": Direct(), "master": body, "slave": body, "environment": TISSUE, "duration": 0.3, **other})


both = pytest.mark.parametrize(("Device", "scene"), [(SimulatedMaster, master), (SimulatedSlave, slave)])


def readings(device: Any, held: Sequence[tuple[float, ...]]) -> list[Reading]:
    out = []
    for k, force in enumerate(held):
        out.append(device.read(k))
        device.hold(force)
    return out


def forces(count: int) -> list[tuple[float]]:
    return [(2.0 * float(np.sin(0.3 * k)),) for k in range(count)]


def moved(rate: Any, x: float, v: float) -> tuple[float, float]:
    """The state a tick later, by DOP853."""
    x, v = solve_ivp(rate, (0.0, 1e-3), (x, v), method="DOP853", rtol=1e-12, atol=1e-15).y[:, -1]
    return x, v


@pytest.mark.parametrize("hand", [HAND, None], ids=["gripped", "alone"])
def test_a_master_moves_as_the_equation_of_motion_says(hand: Grip | None) -> None:
    """M a + b v = f_h - f_m, with f_h the grip's spring, damper and inertia."""
    held = forces(30)
    got = readings(SimulatedMaster(master(hand=hand)), held)
    r = HAND.reference.samples(1, len(held) + 1, 1_000_000)[0]
    x, v = 0.0, 0.0
    for k in range(len(held) - 1):
        slope = (r[k + 1] - r[k]) / 1e-3

        def pull(t: float, x: float, v: float, k: int = k, slope: float = slope) -> float:
            return 0.0 if hand is None else 200.0 * (r[k] + slope * t - x) + 5.0 * (slope - v)

        def rate(t: float, s: Any, pull: Any = pull, f: float = held[k][0]) -> list[float]:
            mass = 0.1 + (0.0 if hand is None else 0.4)
            return [s[1], (pull(t, s[0], s[1]) - f - 0.5 * s[1]) / mass]

        x, v = moved(rate, x, v)
        assert got[k + 1].x[0] == pytest.approx(x, abs=1e-12)
        assert got[k + 1].v[0] == pytest.approx(v, abs=1e-10)
        # What passes through the grip: spring and damper, less the hand's own inertia, with the old force acting.
        inertia = 0.0 if hand is None else 0.4 * rate(1e-3, (x, v))[1]
        assert got[k + 1].f == pytest.approx((pull(1e-3, x, v) - inertia,), abs=1e-9)


WALLS = (Wall(k=5e3, at=-0.001, side=-1), None, TISSUE)


@pytest.mark.parametrize("scene", [
    master(), master(hand=None, start_m=0.02), master(axes=3, environment=(None,) * 3),
    master(axes=2, environment=(None, None), hand=replace(HAND, reference=Reach(to=0.05, start=0.05, duration=0.1))),
    slave(environment=None, start_m=0.03), slave(start_m=0.03),
    slave(environment=Wall(k=2e4, d=5.0, at=0.002), start_m=0.03),
    slave(environment=WALLS, axes=3, start_m=(-0.02, 0.01, 0.02)),
], ids=["hand", "no hand", "three axes", "a reach", "free", "tissue", "wall", "three walls"])
def test_given_the_forces_of_a_virtual_run_it_reads_that_run_to_the_bit(scene: Scene) -> None:
    trace = run(scene).trace
    e, Device, f = ("m", SimulatedMaster, "f_h") if scene.observer is None and isinstance(scene.law, PFRA) else (
        "s", SimulatedSlave, "f_env")
    rows = {name: [tuple(row) for row in trace[name].reshape(scene.ticks, -1).tolist()]
            for name in (f"x_{e}", f"v_{e}", f"f_{e}", f)}
    for name, read in zip((f"x_{e}", f"v_{e}", f), zip(*readings(Device(scene), rows[f"f_{e}"]), strict=True),
                          strict=False):
        assert list(read) == rows[name], name
    assert np.abs(trace[f]).max() > 0.0 or (scene.environment if e == "s" else scene.hand) is None


@both
def test_it_starts_at_rest_goes_on_over_ticks_left_out_and_has_a_force_sensor_where_one_is_of_use_or_asked_for(
    Device: Any, scene: Any
) -> None:
    first = Device(scene(start_m=0.011, start_s=0.011)).read(0)
    assert (first.x, first.v) == ((0.011,), (0.0,))
    every, some = Device(scene()), Device(scene())
    assert every.read(0) == every.read(0), "to look twice moves nothing"
    for device in (every, some):
        device.hold((1.5,))
    step = [every.read(k) for k in range(41)]
    assert some.read(7) == step[7]
    assert some.read(40) == step[40]
    assert len(every.read(scene().ticks).x) == 1, "and one tick beyond the last"
    assert Device(scene(law=Wave())).read(5).f is None
    assert Device(scene(law=Wave()), senses=True).read(5).f == Device(scene()).read(5).f
    assert Device(scene(), senses=False).read(5).f is None
    assert SimulatedMaster(master(observer=200.0)).read(5).f is None


@both
def test_a_force_that_is_not_renewed_lapses_at_its_deadline_and_ticks_left_out_before_it_keep_it(
    Device: Any, scene: Any
) -> None:
    """As hardware that lets go by itself: of an end that was killed or hangs, no line runs any more."""
    last = round(DEADLINE / scene().dt)
    renewed, forgotten, let_go = (Device(scene(duration=0.6)) for _ in range(3))
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
    slow = scene(dt=0.4, duration=4.0, law=Wave(), hand=None)
    device, still = Device(slow), Device(slow)
    for k in range(3):
        device.read(k)
        device.hold((1.5,))
        still.read(k)
    assert device.read(3) != still.read(3), "renewed at every tick, however long a tick is"


# Turned to another scene


@pytest.mark.parametrize(("Device", "scene", "others"), [
    (SimulatedMaster, master, [
        {"law": Wave()}, {"master": MassDamper(mass=0.3, damping=2.0)}, {"hand": replace(HAND, k=90.0)}, {"hand": None},
        {"master": MassDamper(mass=0.1, friction=0.4)}]),
    (SimulatedSlave, slave, [
        {"law": Wave()}, {"environment": Wall(k=2e4, at=-0.001)}, {"environment": None},
        {"slave": MassDamper(mass=2.0)}]),
])
def test_turned_to_another_scene_it_goes_on_from_the_same_place_and_speed_to_the_bit(
    Device: Any, scene: Any, others: list[dict[str, Any]]
) -> None:
    """And from then on it moves as one of that scene does from there, under the same reference."""
    held = forces(140)
    for other in others:
        device, fresh = Device(scene()), Device(scene(**other))
        readings(device, held[:90])
        before = device.read(90)
        device.turn(scene(**other))
        assert device.read(90)[:2] == before[:2], other
        fresh.read(90)
        fresh._x, fresh._v, fresh._f = list(before.x), list(before.v), list(held[89])
        for k in range(91, 140):
            assert device.read(k) == fresh.read(k), other
            device.hold(held[k])
            fresh.hold(held[k])


@pytest.mark.parametrize(("Device", "scene"), [
    (SimulatedMaster, master(start_m=0.02)), (SimulatedSlave, slave(start_s=0.002)),
    (SimulatedSlave, slave(start_s=0.002, environment=HEART)),
    (SimulatedSlave, slave(start_s=0.002, environment=SOLID)),
], ids=["hand", "tissue", "heart", "solid"])
def test_started_again_it_is_at_rest_at_the_new_scenes_start_and_what_moves_begins_anew(
    Device: Any, scene: Scene
) -> None:
    device, fresh = Device(replace(scene, start_m=0.0, start_s=0.0)), Device(scene)
    readings(device, forces(131))
    device.turn(scene, again=True)
    assert [device.read(130 + k) for k in range(250)] == [fresh.read(k) for k in range(250)]


@both
def test_a_turn_to_other_ticks_or_axes_or_to_what_has_no_exact_step_is_refused_and_changes_nothing(
    Device: Any, scene: Any
) -> None:
    device, alone = Device(scene(start_s=0.01)), Device(scene(start_s=0.01))
    device.read(20)
    light = MassDamper(mass=1e-9)
    for other, said in (
        ({"dt": 2e-3}, r"it has dt=0.001 s and 1 axis, and scene scene has dt=0.002 s and 1 axis; take one"),
        ({"axes": 3, "environment": (None,) * 3}, "dt=0.001 s and 3 axes"),
        ({"law": Wave(), "hand": replace(HAND, k=1e308), "environment": Tissue(k=1e308, d=0.0), "master": light,
          "slave": light}, "no finite step"),
    ):
        with pytest.raises(Refused, match=said):
            device.turn(scene(**other))
    assert device.read(60) == alone.read(60)


class Known:
    """A reference that can be sampled from any tick on, and notes how many samples were asked of it at once."""

    def __init__(self, of: Any) -> None:
        self.of, self.asked = of, list[int]()

    def samples(self, axes: int, count: int, dt_ns: int, first: int = 0) -> Any:
        self.asked.append(count)
        return self.of.samples(axes, count, dt_ns, first=first)


def test_a_run_of_a_day_begins_with_few_samples_and_moves_as_a_short_one_does() -> None:
    """The day's path would be 86 million samples."""
    reference, beat = Known(HAND.reference), Known(HEART.path)
    for day, short, known in (
        (SimulatedMaster(master(hand=replace(HAND, reference=reference), duration=86_400.0)),
         SimulatedMaster(master(duration=1.5)), reference),
        (SimulatedSlave(slave(environment=replace(HEART, path=beat), duration=86_400.0)),
         SimulatedSlave(slave(environment=HEART, duration=1.5)), beat),
    ):
        assert sum(known.asked) < 1000
        assert readings(day, forces(1500)) == readings(short, forces(1500))
        assert max(known.asked) < 1000
        assert sum(known.asked) < 3000


# What an environment of the slave keeps


def test_a_turn_to_the_same_environment_cannot_be_felt_and_one_that_moves_is_found_where_it_would_be_by_then() -> None:
    for environment in (HEART, SOLID, Moving(environment=SOLID, path=HEART.path)):
        turned, alone = (SimulatedSlave(slave(environment=environment)) for _ in "ab")
        for robot in (turned, alone):
            robot.hold((2.0,))
            robot.read(100)
        turned.turn(slave(environment=environment, x_limit=1.0))
        assert [turned.read(k) for k in range(100, 290)] == [alone.read(k) for k in range(100, 290)]
    turned, alone = SimulatedSlave(slave()), SimulatedSlave(slave(environment=HEART))
    for robot in (turned, alone):
        robot.read(200)
        robot._x, robot._v, robot._f = [0.02], [0.1], [1.0]
    turned.turn(slave(environment=HEART))
    assert [turned.read(k) for k in range(200, 290)] == [alone.read(k) for k in range(200, 290)]
