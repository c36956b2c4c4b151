"""The simulated slave: at every tick it reads what the equation of motion says, as a robot would."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from master.hand import Sine
from slave.moving import Moving
from slave.robot import SimulatedSlave
from slave.standard_linear_solid import StandardLinearSolid
from slave.tissue import Tissue
from slave.wall import Wall
from teleop.errors import Refused
from teleop.laws.direct import Direct
from teleop.laws.wave import Wave
from teleop.physics.plant import MassDamper
from teleop.protocol.endpoint import Reading
from teleop.protocol.guard import DEADLINE
from teleop.scene.scene import Scene
from teleop.simulation.virtual import run

BODY = MassDamper(mass=0.5, damping=1.0)
TISSUE = Tissue(k=300.0, d=2.0, at=0.001)


def scene(**other: Any) -> Scene:
    """A law that reads f_env."""
    return Scene(**{"law": Direct(), "master": BODY, "slave": BODY, "environment": TISSUE, "duration": 0.3, **other})


def readings(robot: SimulatedSlave, held: list[tuple[float, ...]]) -> list[Reading]:
    """What it reads at each tick, the forces held in between."""
    out = []
    for k, force in enumerate(held):
        out.append(robot.read(k))
        robot.hold(force)
    return out


def test_it_starts_at_rest_where_the_scene_says_and_feels_it() -> None:
    got = SimulatedSlave(scene(start_s=0.011)).read(0)
    assert (got.x, got.v) == ((0.011,), (0.0,))
    assert got.f == pytest.approx((3.0,))


def test_it_moves_as_the_equation_of_motion_says() -> None:
    """M a + b v = f_s - f_env, with f_env the tissue's spring and damper, integrated by DOP853."""
    held = [(3.0 * float(np.sin(0.2 * k)),) for k in range(60)]
    got = readings(SimulatedSlave(scene()), held)
    x, v = 0.0, 0.0
    for k in range(len(held) - 1):
        def rate(t: float, s: Any, f: float = held[k][0]) -> list[float]:
            return [s[1], (f - 300.0 * (s[0] - 0.001) - 2.0 * s[1] - 1.0 * s[1]) / 0.5 + 0.0 * t]

        x, v = solve_ivp(rate, (0.0, 1e-3), (x, v), method="DOP853", rtol=1e-12, atol=1e-15).y[:, -1]
        assert got[k + 1].x[0] == pytest.approx(x, abs=1e-12)
        assert got[k + 1].v[0] == pytest.approx(v, abs=1e-10)
        assert got[k + 1].f == pytest.approx((300.0 * (x - 0.001) + 2.0 * v,), abs=1e-9)


@pytest.mark.parametrize("environment", [
    None, TISSUE, Wall(k=2e4, d=5.0, at=0.002), (Wall(k=5e3, at=-0.001, side=-1), None, TISSUE),
], ids=["free", "tissue", "wall", "three axes"])
def test_given_the_forces_of_a_virtual_run_it_reads_that_run_to_the_bit(environment: Any) -> None:
    axes = len(environment) if isinstance(environment, tuple) else 1
    told = scene(environment=environment, axes=axes, start_m=0.03 if axes == 1 else (-0.02, 0.01, 0.02))
    trace = run(told).trace

    def rows(name: str) -> list[tuple[float, ...]]:
        return [tuple(row) for row in trace[name].reshape(told.ticks, -1).tolist()]

    got = readings(SimulatedSlave(told), rows("f_s"))
    for name, read in (("x_s", [r.x for r in got]), ("v_s", [r.v for r in got]), ("f_env", [r.f for r in got])):
        assert read == rows(name), name
    assert environment is None or max(np.abs(trace["f_env"]).ravel()) > 0.0


def test_over_ticks_that_are_left_out_the_force_goes_on() -> None:
    every, some = SimulatedSlave(scene()), SimulatedSlave(scene())
    for robot in (every, some):
        robot.hold((1.5,))
    step = [every.read(k) for k in range(41)]
    assert some.read(7) == step[7]
    assert some.read(40) == step[40]


def test_without_a_use_for_a_force_sensor_it_has_none() -> None:
    assert SimulatedSlave(scene(law=Wave())).read(5).f is None


def test_a_force_that_is_not_renewed_lapses_at_its_deadline_and_ticks_left_out_before_it_keep_it() -> None:
    """As hardware that lets go by itself: of an end that was killed or hangs, no line runs any more."""
    last = round(DEADLINE / scene().dt)
    long = scene(duration=0.6)
    renewed, forgotten, let_go = SimulatedSlave(long), SimulatedSlave(long), SimulatedSlave(long)
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
    slow = scene(dt=0.4, duration=4.0)
    device, still = SimulatedSlave(slow), SimulatedSlave(slow)
    for k in range(3):
        device.read(k)
        device.hold((1.5,))
        still.read(k)
    assert device.read(3) != still.read(3)


# -- turning to another scene -----------------------------------------------------------------------------------------


HEART = Moving(environment=Wall(k=2e3, d=5.0, at=0.001), path=Sine(amplitude=0.005, frequency=1.2))
SOLID = StandardLinearSolid(k=300.0, k1=700.0, tau=0.1)


@pytest.mark.parametrize("other", [
    {"law": Wave()}, {"environment": Wall(k=2e4, at=-0.001)}, {"environment": None}, {"slave": MassDamper(mass=2.0)},
], ids=["another law", "another wall", "nothing to touch", "another body"])
def test_turned_to_another_scene_it_goes_on_from_the_same_place_and_speed_to_the_bit(other: dict[str, Any]) -> None:
    robot, held = SimulatedSlave(scene()), [(3.0 * float(np.sin(0.2 * k)),) for k in range(200)]
    readings(robot, held[:90])
    before = robot.read(90)
    robot.turn(scene(**other))
    assert robot.read(90)[:2] == before[:2]
    fresh = SimulatedSlave(scene(**other))
    fresh.read(90)
    fresh._x, fresh._v, fresh._f = list(before.x), list(before.v), list(held[89])
    for k in range(91, 200):
        assert robot.read(k) == fresh.read(k)
        robot.hold(held[k])
        fresh.hold(held[k])


@pytest.mark.parametrize("environment", [HEART, SOLID, Moving(environment=SOLID, path=HEART.path)],
                         ids=["a wall that moves", "tissue that relaxes", "both"])
def test_a_turn_to_the_same_environment_cannot_be_felt(environment: Any) -> None:
    turned, alone = (SimulatedSlave(scene(environment=environment)) for _ in "ab")
    for robot in (turned, alone):
        robot.hold((2.0,))
        robot.read(100)
    turned.turn(scene(environment=environment, x_limit=1.0))
    assert [turned.read(k) for k in range(100, 290)] == [alone.read(k) for k in range(100, 290)]


def test_turned_to_an_environment_that_moves_it_finds_it_where_it_would_be_by_then() -> None:
    turned, alone = SimulatedSlave(scene()), SimulatedSlave(scene(environment=HEART))
    for robot in (turned, alone):
        robot.read(200)
        robot._x, robot._v, robot._f = [0.02], [0.1], [1.0]
    turned.turn(scene(environment=HEART))
    assert [turned.read(k) for k in range(200, 290)] == [alone.read(k) for k in range(200, 290)]


@pytest.mark.parametrize("environment", [TISSUE, HEART, SOLID], ids=["tissue", "heart", "solid"])
def test_started_again_it_is_at_rest_at_the_new_scenes_start_and_what_moves_begins_anew(environment: Any) -> None:
    robot, fresh = (SimulatedSlave(scene(environment=environment, start_s=0.002)) for _ in "ab")
    robot.hold((3.0,))
    robot.read(130)
    robot.turn(scene(environment=environment, start_s=0.002), again=True)
    assert [robot.read(130 + k) for k in range(250)] == [fresh.read(k) for k in range(250)]


def test_a_turn_to_other_ticks_is_refused_and_changes_nothing() -> None:
    robot, alone = SimulatedSlave(scene(start_s=0.01)), SimulatedSlave(scene(start_s=0.01))
    robot.read(20)
    with pytest.raises(Refused, match=r"dt=0.001 s and 1 axis, and scene scene has dt=0.002 s and 1 axis; take one"):
        robot.turn(scene(dt=2e-3))
    assert robot.read(60) == alone.read(60)


def test_a_sensor_may_be_asked_for_or_be_done_without() -> None:
    assert SimulatedSlave(scene(law=Wave()), senses=True).read(5).f == SimulatedSlave(scene()).read(5).f
    assert SimulatedSlave(scene(), senses=False).read(5).f is None


def test_beside_a_heart_that_beats_for_a_day_it_moves_as_in_a_short_run() -> None:
    """And begins at once: the day's path would be 86 million samples."""
    asked: list[int] = []

    class Beat:
        def samples(self, axes: int, count: int, dt_ns: int, first: int = 0) -> Any:
            asked.append(count)
            return HEART.path.samples(axes, count, dt_ns, first=first)  # type: ignore[call-arg]

    day = SimulatedSlave(scene(environment=replace(HEART, path=Beat()), duration=86_400.0))
    assert sum(asked) < 1000
    told = scene(environment=HEART, duration=2.0, start_s=0.0)
    trace = run(told).trace  # samples all of it before it begins
    for k, force in enumerate(trace["f_s"].tolist()):
        got = day.read(k)
        assert (got.x[0], got.v[0]) == (trace["x_s"][k], trace["v_s"][k])
        day.hold((force,))
    assert sum(asked) < 3000
