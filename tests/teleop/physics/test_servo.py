"""Position servos: their shaft against closed forms, and the two conditions, searched for what breaks them."""

import random
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from math import inf, sin, tau
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import minimize_scalar

from channel import Delay
from master import Grip, Reach
from slave import HuntCrossley, Tissue, Wall
from teleop import MassDamper, PositionPosition, Refused, Scene, Servo, Wave, load_scene, run
from teleop.analysis.models.linear import linear_scene
from teleop.law import find_law, two_port_laws
from teleop.physics.servo import LEAST, beyond, clip, encoded, goal_of, move_mass, true_touch, turn

NOTHING = (0, 0.0, 0.0, 0.0, 1.0, 1.5, 0.0)
SO101: dict[str, Any] = {"K": 17.8, "damping": 0.6, "friction": 0.15, "stall": 2.94, "backlash": 0.00873,
                         "counts": 4096}
PP = PositionPosition(K=10.0, B=0.4)


def shaft_of(servo: Servo, environment: Any = None, dt: float = 1e-3) -> tuple[Any, Any]:
    """Coefficients of `turn`: of the shaft, and of what it touches."""
    return servo.slave_plant(dt, environment and environment.resistance()).c[:2]


# The shaft


def test_a_shaft_without_backlash_goes_by_the_matrix_exponential_to_the_order_of_its_parts() -> None:
    servo, tissue = Servo(K=40.0, damping=0.3, inertia=0.02, link=0.01), Tissue(k=25.0, d=0.2, at=0.1)
    k, d, m, goal = 40.0 + 25.0, 0.5, 0.03, 0.3
    rest = (40.0 * goal + 25.0 * 0.1) / k
    errors = []
    for parts in (10, 20, 40):
        c, touch = shaft_of(servo, tissue)
        state = (0.0, 1.0, 0.0, 1.0, 0.0)
        for _ in range(100):
            state = turn((*c[:-2], 1e-3 / parts, parts), touch, state, goal, 0.0, 0.0)
        q = expm(0.1 * np.array([[0.0, 1.0], [-k / m, -d / m]])) @ [0.0 - rest, 1.0]
        errors.append(abs(state[0] - rest - q[0]))
    assert errors[0] < 2e-4
    assert all(1.8 < coarse / fine < 2.2 for coarse, fine in pairwise(errors))


def test_gear_friction_and_contact_never_make_energy() -> None:
    """The energy of shaft, teeth and wall never rises: the servo limp, thrown against a wall with wild numbers."""
    dice = random.Random(4)
    for _ in range(60):
        servo = Servo(K=1.0, damping=dice.choice([1e-6, 0.1]), inertia=10.0 ** dice.uniform(-4, 0), stall=1e-12,
                      link=10.0 ** dice.uniform(-4, 0), friction=dice.choice([0.0, 0.2]),
                      backlash=dice.choice([0.0, 0.02]), gear=(10.0 ** dice.uniform(1, 5), dice.choice([0.0, 0.5])))
        wall = Wall(k=10.0 ** dice.uniform(1, 6), d=dice.choice([0.0, 5.0]), at=0.02)
        c, touch = shaft_of(servo, wall)
        *_, inertia, link = c[:4]
        state = (0.0, v := dice.uniform(-5.0, 5.0), 0.0, dice.choice([v, 0.0]) if servo.backlash else v, 0.0)

        def energy(s: Any, c: Any = c, touch: Any = touch, inertia: float = inertia, link: float = link) -> float:
            teeth = beyond(s[2] - s[0], c[7])
            return 0.5 * (inertia * s[3]**2 + link * s[1]**2 + c[8] * teeth**2 + touch[1] * max(0.0, s[0] - 0.02)**2)

        before = energy(state)
        for _ in range(50):
            state = turn(c, touch, state, state[0], 0.0, 0.0)
            assert energy(state) <= before * (1.0 + 1e-9) + 1e-12
            before = energy(state)


def test_what_is_pressed_on_takes_the_torque_of_the_servos_error_less_friction() -> None:
    for environment in (Wall(k=2000.0, d=5.0, at=0.1), Tissue(k=10.0, d=0.1),
                        HuntCrossley(k=500.0, n=1.5, lam=0.1, at=0.1)):
        servo = Servo(**{**SO101, "counts": 0})
        c, touch = shaft_of(servo, environment)
        state: Any = (0.0,) * 5
        for _ in range(3000):
            state = turn(c, touch, state, 0.2, 0.0, 0.0)
        plant = servo.slave_plant(1e-3, environment.resistance())
        torque = true_touch(plant.c, (state,))
        assert abs(state[1]) < 1e-6
        assert torque == pytest.approx(17.8 * (0.2 - state[0]), abs=0.16 + 1e-6)


def test_coulomb_friction_holds_a_shaft_and_lets_it_go_at_its_torque() -> None:
    c, _ = shaft_of(Servo(K=10.0, damping=0.1, friction=0.2))
    assert turn(c, NOTHING, (0.0,) * 5, 0.0199, 0.0, 0.0)[0] == 0.0
    assert turn(c, NOTHING, (0.0,) * 5, 0.0201, 0.0, 0.0)[0] > 0.0


def test_readings_are_whole_counts_and_pass_on_what_is_not_finite() -> None:
    step = tau / 4096
    assert [encoded(x, step) / step for x in (0.49 * step, 0.51 * step, -0.51 * step)] == [0.0, 1.0, -1.0]
    assert encoded(inf, step) == inf
    assert encoded(0.3, 0.0) == 0.3


# The mass


def test_a_step_of_the_mass_is_the_one_root_of_its_implicit_equation() -> None:
    dice = random.Random(1)
    for _ in range(300):
        servo = Servo(K=10.0 ** dice.uniform(0, 3), damping=1.0, friction=1.0, stall=dice.uniform(0.1, 3.0),
                      dead=dice.uniform(0.0, 1.0), M=10.0 ** dice.uniform(-3, 0), D=dice.uniform(0.0, 2.0),
                      drive="mass")
        c = servo.drive_numbers(2e-4)  # one part
        x, v, f, reading = (dice.uniform(-1.0, 1.0) for _ in range(4))
        x1, v1 = move_mass(c, x, v, f, reading)
        pull = clip(beyond(servo.K * (x1 - reading), servo.dead), servo.stall)
        assert x1 == pytest.approx(x + 2e-4 * v1, abs=1e-15)
        assert servo.M * (v1 - v) / 2e-4 + servo.D * v1 == pytest.approx(f - pull, rel=1e-9, abs=1e-9)


def lags(dice: random.Random, kind: str, most: int, count: int) -> list[int]:
    """Ages, in parts, of what is in use at each part: never above `most`, and never followed by something older."""
    if kind == "constant":
        return [most] * count
    made: list[int] = []
    while len(made) < count:
        held = most if kind == "held" else dice.randrange(1, most + 1)
        late = min(made[-1] + 1, most - held) if made and kind == "varying" else 0
        made += [late + i for i in range(held)]
    return made


def worst_of(seed: int, *, share: float = 1.0, periods: int = 8) -> float:
    """The least of `int F v + D int v^2` (J) over a motion of the mass from rest, for D = share (K d)^2/(4 damping).

    The mass is moved by force: with a sine, and a second one beside it. Goals and readings are as old as `lags` has it,
    d in all. In half of the cases the inertia is the worst one of a steady motion, J w^2 = K + k + 2 damping/d, at
    which the bound is reached where w d is small.
    """
    dice = random.Random(seed)
    h, most = 1e-4, dice.randrange(20, 100)  # s, and parts
    d = (2 * most + 2) * h
    K, worst = 10.0 ** dice.uniform(0.5, 2.0), dice.random() < 0.5
    damping = K * d / dice.uniform(2.0, 8.0) if worst else dice.uniform(0.2, 2.0)
    friction, stall, k_e, second = (0.0, inf, 0.0, 0.0) if worst else (
        dice.choice([0.0, 0.15]), dice.choice([inf, 0.5]), 10.0 ** dice.uniform(0, 4), 0.3)
    w = dice.uniform(0.2, 0.6) / d
    inertia = (K + 2.0 * damping / d) / w**2 if worst else 10.0 ** dice.uniform(-3, 0)
    servo = Servo(K=K, damping=damping, friction=friction, stall=stall, dead=friction * dice.choice([0.0, 1.0]),
                  inertia=inertia, link=1e-9, drive="mass")
    environment = None if worst else dice.choice([None, Tissue(k=k_e, d=0.0), Wall(k=k_e, d=1.0, at=0.05)])
    c, touch = shaft_of(servo, environment)
    c, state = (*c[:-2], h, 1), (0.0,) * 5
    count, D = int(periods * tau / w / h), share * (K * d) ** 2 / (4.0 * damping)
    kinds = ("constant",) if worst else ("constant", "held", "varying")
    ages = [lags(dice, dice.choice(kinds), most, count) for _ in range(2)]
    xs, shafts, work, least = [0.0], [0.0], 0.0, 0.0
    for k in range(count):
        state = turn(c, touch, state, xs[max(0, k - ages[0][k])], 0.0, 0.0)
        shafts.append(state[0])
        t = (k + 1) * h
        xs.append((1.0 - second) * sin(w * t) + second * sin(2.7 * w * t))
        reading = shafts[max(0, k - ages[1][k])]
        move = xs[-1] - xs[-2]
        work += clip(beyond(K * (xs[-1] - reading), servo.dead), stall) * move + D * move * move / h
        least = min(least, work)
    return least


def test_the_masss_damping_pays_for_all_that_a_late_servo_can_give_and_half_of_it_does_not() -> None:
    assert min(worst_of(seed) for seed in range(30)) > -1e-6
    assert min(worst_of(seed, share=0.5) for seed in range(30)) < -1.0


@pytest.mark.full
@pytest.mark.parametrize("thousand", range(10))
def test_the_masss_damping_pays_over_ten_thousand_motions(thousand: int) -> None:
    assert min(worst_of(1000 * thousand + seed, periods=2) for seed in range(1000)) > -1e-6


# The offset


def growth(damping: float, tissue: float) -> float:
    """Energy of a servo in a lossless tissue, in the last half second of three beside that after the first half."""
    servo = Servo(K=17.8, damping=damping, bus=(0.02, 0.02))
    plant = servo.slave_plant(1e-3, Tissue(k=tissue, d=0.0).resistance())
    x, v, z, energy = 0.0, 0.0, ((0.0, 1.0, 0.0, 1.0, 0.0), *plant.start[1:]), []
    for _ in range(3000):
        x, v, _, z = plant.move(plant.c, x, v, 0.0, z)
        energy.append(servo.mass * z[0][1] ** 2 + (tissue + 17.8) * z[0][0] ** 2)
    return sum(energy[-500:]) / sum(energy[500:1000])


def test_an_offset_drive_without_its_damping_feeds_what_it_touches_and_with_it_does_not() -> None:
    """The lateness is 41 ms in the mean: sin(w d)/w is least near 110 rad/s, where 460 N m/rad swing the shaft."""
    tissues = (380.0, 459.0, 550.0)
    assert max(growth(0.9 * LEAST * 17.8 * 0.041, tissue) for tissue in tissues) > 1.5
    assert max(growth(LEAST * 17.8 * Servo(K=1.0, damping=1.0, bus=(0.02, 0.02)).lateness(1e-3), tissue)
               for tissue in (150.0, *tissues, 900.0)) < 1.0
    least = minimize_scalar(lambda y: sin(y) / y, bounds=(4.0, 5.0), method="bounded").fun
    assert least == pytest.approx(-LEAST, abs=1e-6)


def test_the_goal_of_an_offset_drive_is_a_torque_from_where_the_servo_was_read() -> None:
    c = Servo(K=20.0, damping=1.0, stall=2.0).drive_numbers(1e-3)
    assert [goal_of(c, 9.0, f, 0.3) for f in (0.0, 1.0, -5.0)] == [0.3, 0.3 + 0.05, 0.3 - 0.1]
    mass = Servo(K=20.0, damping=1.0, stall=2.0, drive="mass").drive_numbers(1e-3)
    assert goal_of(mass, 9.0, 1.0, 0.3) == 9.0


# In a scene


def joint(drive: str = "offset", *, law: Any = PP, environment: Any = None, slave: Any = None, **numbers: Any) -> Scene:
    """A light handle of one joint, held at 15 N m/rad, and a servo of the class of an SO-101's, at 200 Hz."""
    servo = Servo(**{**SO101, "bus": (0.005, 0.005), "every": 5, "drive": drive, "dead": 0.15, **numbers})
    return Scene(
        law=law, units=("rad",), master=MassDamper(mass=0.01, damping=0.05), link=Delay(0.05), slave=slave or servo,
        hand=Grip(mass=0.02, k=15.0, d=0.5, reference=Reach(to=(0.6,), start=0.5, duration=1.0)), observer=None,
        environment=environment, duration=8.0, energy=True)


SPRING, STOP = Tissue(k=10.0, d=0.05), Wall(k=2000.0, d=5.0, at=0.3)


def test_a_servo_by_its_offset_follows_as_a_motor_with_torque_does() -> None:
    for environment in (None, SPRING, STOP):
        servo, motor = (run(joint(environment=environment, slave=slave)) for slave in (
            None, MassDamper(mass=0.038, damping=0.6, friction=0.15)))
        assert (servo.status, motor.status) == ("ok", "ok")
        assert servo.trace["f_m"][-1] == pytest.approx(motor.trace["f_m"][-1], abs=0.16)
        error = [np.sqrt(np.mean((one.trace[x] - one.trace["x_m"]) ** 2))
                 for one, x in ((servo, "shaft_s"), (motor, "x_s"))]
        assert error[0] < 1.25 * error[1]


def test_a_mass_renders_what_its_servo_touches() -> None:
    for law in (PositionPosition(K=10.0, B=0.4), Wave(b=0.5, K=10.0, B=0.4)):
        for environment in (SPRING, STOP):
            result = run(joint("mass", law=law, environment=environment))
            felt, touched = (np.mean(result.trace[name][-500:]) for name in ("f_m", "touch_s"))
            assert result.status == "ok"
            assert 0.8 < felt / touched < 1.1


def test_the_linear_model_of_a_servo_answers_as_its_run_does() -> None:
    """The slave's state space beside the run: same messages in, same ones out, to rounding."""
    for drive in ("offset", "mass"):
        scene = joint(drive, every=1, friction=0.0, stall=inf, backlash=0.0, counts=0, dead=0.0, D=0.2,
                      bus=(0.003, 0.004), environment=SPRING)
        model = linear_scene(scene).slave
        trace = run(scene).trace
        state = np.zeros(len(model.A))
        for k in range(400):
            sent = np.array([trace[name][k - 50] if k >= 50 else 0.0 for name in ("x_m", "v_m")])
            out = model.C @ state + model.D @ sent
            assert out[0] == pytest.approx(trace["x_s"][k], abs=1e-9)
            state = model.A @ state + model.B @ sent


def test_numbers_of_a_servo_that_cannot_be() -> None:
    refused: tuple[tuple[Callable[[], object], str], ...] = (
        (lambda: joint(damping=0.05), "take K=11.5 at most, or damping=0.07734, or a lateness of 0.01293 s"),
        (lambda: joint("mass", D=0.01), "take D=0.05281, or K=7.745 at most, or a lateness of 0.008703 s"),
        (lambda: joint(bus=(0.3, 0.0)), "is at most 200 ticks late each way, not 300"),
        (lambda: joint(drive="torque"), "drive must be offset or mass, not 'torque'"),
        (lambda: joint("mass", dead=0.2), "a dead zone of 0.2 N m makes energy beyond a friction of 0.15 N m"),
        (lambda: joint(bus=0.01), "bus must be two numbers"),
        (lambda: run(joint(environment=MovingWall())), "a position servo is not known in MovingWall"),
        (lambda: Scene(law=PositionPosition(), axes=2, master=MassDamper(mass=1.0), slave=(
            Servo(K=1.0, damping=1.0), MassDamper(mass=1.0))), "the slave is a position servo on some axes"),
        (lambda: run(load_scene("servo_arm"), bodies="sdirk2:4"), "a position servo is moved by its own steps alone"),
    )
    for make, words in refused:
        with pytest.raises(Refused) as told:
            make()
        assert words in str(told.value), str(told.value)
    joint(damping=0.07734)
    joint("mass", D=0.0529)


class MovingWall:
    """An environment with a step of its own for a plain body, and no resistance."""

    def plant(self, body: MassDamper, dt: float) -> object:
        raise AssertionError


GAINS = {"K": 10.0, "B": 0.4, "b": 0.5, "K_d": 0.4, "K_p": 10.0, "B_p": 0.4, "B_m": 0.2, "B_s": 0.4}


def judged(name: str, delay: float, environment: Any, drive: str) -> tuple[str, float, float]:
    """Status of a law on a servo or (drive "") on a motor with torque; rms error of the motion; felt over touched."""
    law = find_law(name)()
    law = replace(law, **{key: value for key, value in GAINS.items() if hasattr(law, key)})
    motor = MassDamper(mass=0.038, damping=0.6, friction=0.15) if not drive else None
    result = run(replace(joint(drive or "offset", law=law, environment=environment, slave=motor), link=Delay(delay),
                         duration=12.0))
    trace = result.trace
    error = np.sqrt(np.mean((trace["shaft_s" if drive else "x_s"] - trace["x_m"]) ** 2))
    touched = np.mean(trace["touch_s" if drive else "f_env"][-400:])
    return result.status, float(error), float(np.mean(trace["f_m"][-400:]) / touched) if touched > 0.2 else np.nan


@pytest.mark.full
def test_every_law_runs_on_a_servo_as_it_does_on_a_motor_with_torque() -> None:
    """Seventeen laws, three delays, nothing, a spring and a hard stop: 153 runs of each drive."""
    cases = [(name, delay, environment) for name in two_port_laws() for delay in (0.02, 0.05, 0.1)
             for environment in (None, SPRING, STOP)]
    found = {drive: {case: judged(*case, drive) for case in cases} for drive in ("", "offset", "mass")}
    worse = [case for case in cases if found["offset"][case][0] != "ok" == found[""][case][0]]
    assert len(worse) <= 4, worse
    ratios = [found["offset"][case][1] / found[""][case][1] for case in cases
              if case[2] is None and found[""][case][0] == "ok"]
    assert np.median(ratios) < 1.25
    assert {status for status, *_ in found["mass"].values()} <= {"ok", "limit cycle"}
    felt = [share for status, _, share in found["mass"].values() if status == "ok" and np.isfinite(share)]
    assert 0.91 < np.median(felt) < 0.99
