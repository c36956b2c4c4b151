"""An arm without its weight, by a model: what the law is left with, what ends it, the observer against the truth."""

from __future__ import annotations

from dataclasses import replace
from math import cos, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from master.device import SimulatedMaster
from slave.mujoco_robot import MuJoCoRobot
from teleop import ArmModel, DeviceError, Reading, Refused, Scene
from teleop.live.devices.compensated import BLIND_S, SLEW_S, Compensated
from teleop.live.devices.guarded_device import GuardedDevice
from teleop.live.devices.opening import find_device
from teleop.live.in_process import run_stepped
from teleop.stages.observer import coefficients, observe
from tests.live.test_arm_model import PLANAR, scene, written

pytest.importorskip("mujoco", reason="mujoco-core is not installed (extra mujoco)")

DT = 1e-3
ARM = "slave/arm.xml"
HEAVY = "slave/arm.xml?gravcomp=0"
HOME = (0.3, np.pi / 3.0, -2.0 * np.pi / 3.0)
TURNTABLE = """
<mujoco>
  <option gravity="0 0 0"/>
  <worldbody>
    <body name="table"><joint name="turn" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="0.001" diaginertia="1e-9 1e-9 1e-9"/>
      <body name="cart"><joint name="out" type="slide" axis="1 0 0"/>
        <inertial pos="0 0 0" mass="1" diaginertia="1e-9 1e-9 1e-9"/></body>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture(autouse=True)
def _not_pressed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slave.mujoco_robot.pressed", lambda *_: [])


class Bench:
    """A device whose readings are set and whose forces are kept. `fails`: what `read` or `hold` raises."""

    deadline = 0.15

    def __init__(self, x: tuple[float, ...], v: tuple[float, ...]) -> None:
        self.x, self.v = x, v
        self.held: list[tuple[float, ...]] = []
        self.fails: set[str] = set()

    def read(self, k: int) -> Reading:
        if "read" in self.fails:
            raise DeviceError("no reading")
        return Reading(self.x, self.v)

    def hold(self, force: tuple[float, ...]) -> None:
        if "hold" in self.fails:
            raise DeviceError("no force")
        self.held.append(force)


def on_arm(device: Any = None, **settings: Any) -> tuple[Any, Compensated]:
    device = device or Bench(HOME, (0.0,) * 3)
    return device, Compensated(device, ArmModel(ARM, scene()), **settings)


def drive(device: Any, ticks: int, *clock: int, force: tuple[float, ...] = (0.0,) * 3) -> None:
    """Read and hold at so many ticks; of a guarded device with a `clock`, too."""
    for k in range(ticks):
        device.read(k, *clock)
        device.hold(force)


class TestTheLaw:
    def test_sees_an_arm_that_moves_as_one_without_weight(self) -> None:
        """Its own caps aside: the same torques move it as they move MuJoCo's arm whose weight is compensated inside."""
        ways = []
        for file, carried in ((ARM, False), (HEAVY, True), (HEAVY, False)):
            robot: Any = MuJoCoRobot(start(), file)
            device = Compensated(robot, ArmModel(ARM, scene()), ramp=0.05) if carried else robot
            if carried:  # from the first tick on
                device._gain, device._carried = 1.0, device.model.at(HOME, (0.0,) * 3).torque
            way = []
            for k in range(800):
                way.append(device.read(k).x)
                device.hold((0.05 * sin(0.02 * k), 0.03 * cos(0.01 * k), 0.02))
            ways.append(np.array(way))
        inside, ours, without = ways
        assert abs(without - inside).max() > 0.15
        np.testing.assert_allclose(ours, inside, atol=4e-3)

    def test_at_the_masters_end_pushes_against_the_hand_and_carries_the_same_weight(self) -> None:
        weights = ArmModel(ARM, scene()).at(HOME, (0.0,) * 3).torque
        assert abs(weights[1:]).min() > 0.2
        for e, push in (("s", 1.0), ("m", -1.0)):
            device, arm = on_arm(e=e)
            drive(arm, 700, force=(0.1, 0.2, -0.3))
            np.testing.assert_allclose(push * np.array(device.held[-1]), weights + push * np.array((0.1, 0.2, -0.3)))

    def test_gets_from_a_held_weight_what_the_damping_in_the_header_takes_up(self, tmp_path: Path) -> None:
        """A pendulum upright, dg/dq = -m g l, is driven by m g l dt (1/2 + d) v; a damping of that much holds it."""
        dt, m, length = 5e-3, 1.0, 0.5
        file = written(tmp_path, "<mujoco><worldbody><body><joint name='lift' axis='0 -1 0'/>"
                       f"<inertial pos='{length} 0 0' mass='{m}' diaginertia='1e-9 1e-9 1e-9'/>"
                       "</body></worldbody></mujoco>")
        inertia, stiffness = m * length ** 2, m * 9.81 * length
        for late in (0, 2):
            bound = stiffness * dt * (0.5 + late)
            for damping in (0.0, bound):
                device = Bench((0.0,), (0.0,))
                arm = Compensated(device, ArmModel(file, scene("lift", dt=dt)), dt=dt)
                arm._gain, arm._carried = 1.0, np.zeros(1)
                x, v, places, n = np.pi / 2.0 - 0.05, 0.05, [np.pi / 2.0 - 0.05] * (late + 1), 50
                for k in range(400):
                    places = [*places[1:], x]
                    device.x = (places[0],)
                    arm.read(k)
                    arm.hold((0.0,))
                    for _ in range(n):
                        v += dt / n * (device.held[-1][0] - stiffness * np.cos(x) - damping * v) / inertia
                        x += dt / n * v
                grown = np.log(v / 0.05) / (400 * dt)
                assert grown == pytest.approx((bound - damping) / inertia, abs=0.1 * bound / inertia)

    def test_gets_no_energy_from_the_coriolis_torques_that_are_compensated(self, tmp_path: Path) -> None:
        """A cart is let out on a turning rail and drawn in on a standing one: all of C v would give 0.9 J a round."""
        file = written(tmp_path, TURNTABLE)
        of = scene("turn,out", "rad,m")
        gains = []
        for compensates in (True, False):
            model = ArmModel(file, of)
            device = Bench((0.0, 0.4), (3.0, 0.0))
            arm = Compensated(device, model, limit=100.0)
            arm._gain, arm.limit = 1.0, arm.limit * 1e3  # no slew limit beside it
            x, v, work = np.array((0.0, 0.4)), np.array((3.0, 0.0)), 0.0
            M = model.at(x, v).inertia
            energy = [0.5 * v @ M @ v]
            for k in range(1500):
                law = np.array((0.0, 40.0 * (0.8 + 0.3 * sin(0.006 * k) - x[1]) - 8.0 * v[1]))
                device.x, device.v = tuple(x), tuple(v)
                arm.read(k)
                arm.hold(tuple(law))
                now = model.at(x, v)
                u = np.array(device.held[-1]) if compensates else law + now.torque
                before = x.copy()
                for _ in range(5):  # of the same torque
                    at = model.at(x, v)
                    v = v + 0.2 * DT * np.linalg.solve(at.inertia, u - at.torque)
                    x = x + 0.2 * DT * v
                work += float(law @ (x - before))
                energy.append(0.5 * v @ model.at(x, v).inertia @ v - work)
            gains.append(max(energy) - energy[0])
        assert gains[0] < 0.05
        assert gains[1] > 1.0

    def test_gets_no_energy_from_compensated_friction_unless_the_file_says_more_than_the_joint_has(self) -> None:
        """The work of the compensation against what true friction takes, with readings that are late and noisy.

        A free joint with Coulomb friction alone, which the noise of its readings would drive if it could.
        """
        rng = np.random.default_rng(3)
        model = ArmModel(ARM, scene())
        for true, drives in ((0.2, False), (0.05, True)):
            model.friction[:] = 0.2
            device, arm = on_arm()
            arm = Compensated(device, model, friction=0.9, ramp=0.05, limit=20.0)
            weight = model.at(HOME, (0.0,) * 3).torque
            v, work, taken, history, speeds = 0.0, 0.0, 0.0, [0.0] * 4, [0.0]
            for k in range(6000):
                history = [*history[1:], v]
                device.v = (history[0] + rng.normal(0.0, 0.05), 0.0, 0.0)
                arm.read(k)
                arm.hold((0.0,) * 3)
                s = device.held[-1][0] - weight[0] if k > 60 else 0.0
                for _ in range(5):
                    pushed = v + 0.2 * DT * s / 0.02
                    slowed = 0.2 * DT * true / 0.02
                    new = 0.0 if abs(pushed) <= slowed else pushed - np.sign(pushed) * slowed
                    way = 0.5 * (v + new) * 0.2 * DT
                    work, taken, v = work + s * way, taken + true * abs(way), new
                speeds.append(abs(v))
                if k == 3000:
                    v += 1.0  # a push by hand
                if not drives:
                    assert work <= taken + 1e-12
            if drives:
                assert work > taken
            assert bool(max(speeds[-500:]) > 0.5) is drives


def start(**knobs: Any) -> Scene:
    return replace(scene(**knobs), start_s=HOME, start_m=HOME)


class TestWhatEndsIt:
    def test_it_comes_along_a_ramp_and_no_force_of_its_own_ever_jumps_or_passes_its_limit(self) -> None:
        """Whatever the device does: readings that leap, fail or are not finite, forces that are not taken."""
        rng = np.random.default_rng(5)
        limit = np.array((0.5, 2.0, 1.0))
        for seed in range(20):
            device, arm = on_arm(limit=tuple(limit.tolist()), friction=0.5)
            guarded = GuardedDevice(arm, 3)
            k, given = 0, np.zeros(3)
            for _ in range(400):
                missed = int(rng.choice([1, 1, 1, 1, 1, 2, 5, 200]))
                k += missed
                given = given if missed * DT < 0.135 else np.zeros(3)  # the device has let go by itself meanwhile
                device.x = tuple(rng.uniform(-3.0, 3.0, 3)) if rng.random() < 0.05 else device.x
                device.v = tuple(rng.normal(0.0, rng.choice((10.0, 1e200)), 3)) if rng.random() < 0.2 else (0.0,) * 3
                if rng.random() < 0.02:
                    device.x = (float("nan"), *device.x[1:])
                elif device.x[0] != device.x[0]:
                    device.x = HOME
                device.fails = {each for each, p in (("read", 0.05), ("hold", 0.02)) if rng.random() < p}
                reading = guarded.read(k, 0)
                assert reading is None or np.isfinite(reading.f or np.nan).all()
                if guarded.hold((0.0,) * 3):
                    new = np.array(device.held[-1])
                    assert np.isfinite(new).all()
                    assert (abs(new) <= limit).all(), seed
                    assert (abs(new - given) <= limit * arm._every * DT / SLEW_S + 1e-12).all(), (seed, k)
                    given = new
                else:
                    given = np.zeros(3)  # what it holds now is not known: it begins again at zero
            assert guarded.let_go()
            assert device.held[-1] == (0.0,) * 3

    def test_without_readings_it_is_held_for_half_a_tenth_of_a_second_and_gone_after_a_whole(self) -> None:
        device, arm = on_arm()
        drive(arm, 700)
        whole = np.array(device.held[-1])
        device.fails = {"read"}
        for k in range(700, 820):
            with pytest.raises(DeviceError):
                arm.read(k)
            arm.hold((0.0,) * 3)
        shares = np.array(device.held[700:])[:, 1] / whole[1]
        assert shares[:49].min() == 1.0
        assert (np.diff(shares) <= 0.0).all()
        assert shares[round(BLIND_S / DT)] == 0.0
        assert abs(np.diff(shares)).max() < 0.03
        device.fails = set()
        arm.read(820)
        arm.hold((0.0,) * 3)
        assert abs(device.held[-1][1] / whole[1]) < 0.01  # along the ramp again

    def test_a_run_that_is_over_lowers_it_and_a_second_signal_ends_it_at_once(self) -> None:
        device, arm = on_arm(ramp=0.2)
        drive(arm, 300)
        assert arm.carries
        whole = device.held[-1][1]
        arm.lower()
        k = 300
        while arm.carries:
            arm.read(k)
            arm.hold((0.0,) * 3)
            k += 1
        assert 195 <= k - 300 <= 205
        assert abs(np.diff([each[1] for each in device.held[300:]])).max() < 0.01 * abs(whole)
        guarded = GuardedDevice(on_arm(device, ramp=0.05)[1], 3)
        drive(guarded, 100, 0)
        assert any(device.held[-1])
        assert guarded.carries
        guarded.closed = True  # as a thread beside a loop that hangs leaves it
        guarded.read(100, 0)
        guarded.hold((1.0, 1.0, 1.0))
        assert device.held[-1] == (0.0,) * 3

    def test_joints_that_its_limit_cut_are_a_note(self) -> None:
        _, arm = on_arm(limit=(1.0, 0.1, 1.0))
        drive(arm, 10)
        (note,) = arm.notes
        assert note.startswith("the compensation was cut to its limit: lift at 10 ticks (limit 0.1 N m); type")


class TestTheObserver:
    def test_of_a_constant_mass_is_the_observer_of_the_hands_force(self, tmp_path: Path) -> None:
        """Of one joint with nothing but its inertia: the recursion of `teleop.stages.observer`, to rounding."""
        file = written(tmp_path, TURNTABLE)
        of = scene("out", "m")
        for e, sign in (("m", 1.0), ("s", -1.0)):
            device = Bench((0.0,), (0.0,))
            arm = Compensated(device, ArmModel(file, of), e=e, observer=200.0, limit=1.0)
            c, f, before = coefficients(200.0, 1.0, 0.0, DT), 0.0, 0.0
            rng = np.random.default_rng(2)
            held = 0.0
            for k in range(50):
                v = float(rng.normal())
                device.v = (v,)
                reading = arm.read(k)
                f = 0.0 if k == 0 else observe(c, f, before, v, sign * held)
                assert reading.f is not None
                assert reading.f[0] == pytest.approx(sign * f, abs=1e-9)
                before, held = v, float(rng.normal())
                arm.hold((held,))

    def test_is_off_by_terms_in_the_square_of_the_tick(self, tmp_path: Path) -> None:
        """A fast two-link arm under a torque that swings: unfiltered it falls to a quarter with half a tick."""
        file = written(tmp_path, PLANAR.replace('frictionloss="0.3" damping="0.2"', "").replace(
            'frictionloss="0.1"', ""))
        worst = []
        for dt in (4e-3, 2e-3):
            model = ArmModel(file, scene("shoulder,elbow", dt=dt))
            device = Bench((0.5, -1.0), (1.0, 2.0))
            arm = Compensated(device, model, dt=dt, observer=1e9, limit=50.0)
            x, v, fine, errors, mean = np.array(device.x), np.array(device.v), 40, [], None
            for k in range(round(0.2 / dt)):
                device.x, device.v = tuple(x), tuple(v)
                reading = arm.read(k)
                if mean is not None:
                    errors.append(np.abs(-np.array(reading.f) - mean).max())
                arm.hold((3.0, -1.0))
                u, total = np.array(device.held[-1]), np.zeros(2)
                for n in range(fine):
                    f = np.array((2.0, 1.0)) * sin(9.0 * (k + (n + 0.5) / fine) * dt)
                    total += f / fine
                    # midpoint rule
                    at = model.at(x, v)
                    a = np.linalg.solve(at.inertia, u + f - at.torque)
                    half = 0.5 * dt / fine
                    at = model.at(x + half * v, v + half * a)
                    a2 = np.linalg.solve(at.inertia, u + f - at.torque)
                    x, v = x + 2.0 * half * (v + half * a), v + 2.0 * half * a2
                mean = total
            worst.append(max(errors))
        assert worst[1] < 8e-3
        assert worst[0] / worst[1] == pytest.approx(4.0, rel=0.2)

    def test_follows_mujocos_contact_forces_as_its_low_pass_does(self) -> None:
        """Pressed on wall and table: against the sensor's truth through the same filter, and half a tick later."""
        robot: Any = MuJoCoRobot(replace(scene(), start_s=(0.0, *HOME[1:])), HEAVY)
        read, truth, told = robot.read, [], []

        def sensed(k: int) -> Reading:
            reading: Reading = read(k)
            truth.append(reading.f)
            return reading

        robot.read = sensed
        arm = Compensated(robot, ArmModel(ARM, scene()), ramp=0.05, observer=50.0)
        x = np.array((0.0, *HOME[1:]))
        for k in range(2500):
            reading = arm.read(k)
            told.append(reading.f)
            goal = np.add(x, (0.2 * sin(1e-3 * k), -0.25 * (1.0 - cos(2e-3 * k)), 0.0))
            arm.hold(tuple(np.clip(12.0 * (goal - reading.x) - 0.5 * np.array(reading.v), -3.0, 3.0)))
        true, a, f, passed = np.array(truth), 1.0 - np.exp(-50.0 * DT), np.zeros(3), []
        for each in true:
            f = f + a * (each - f)
            passed.append(f)
        assert abs(true).max() > 1.0
        assert np.sqrt(np.mean((np.array(told) - passed)[300:] ** 2)) < 0.03

    def test_of_an_encoder_has_the_noise_that_the_header_says(self, tmp_path: Path) -> None:
        file = written(tmp_path, TURNTABLE)
        rng = np.random.default_rng(6)
        K, rms, count = 50.0, 0.01, 1e-4
        noise = rng.normal(0.0, rms, 12000)
        places = count * (rng.random(12000) - 0.5)
        for speeds, expected in ((noise, K * rms), (np.diff(places, prepend=0.0) / DT, K * count / (6 ** 0.5 * DT))):
            device = Bench((0.0,), (0.0,))
            arm = Compensated(device, ArmModel(file, scene("out", "m")), observer=K, limit=1.0)
            told = []
            for k, v in enumerate(speeds.tolist()):
                device.v = (v,)
                told.append((arm.read(k).f or (0.0,))[0])
                arm.hold((0.0,))
            assert float(np.std(told[500:])) == pytest.approx(expected, rel=0.1)

    def test_is_what_a_law_reads_as_the_force_of_a_robot_without_a_sensor(self) -> None:
        """In virtual time, by the command's way: `pfra` reads the force on the environment, which nothing senses."""
        class Blind(MuJoCoRobot):
            senses = False

            def read(self, k: int) -> Reading:
                return super().read(k)._replace(f=None)

        def carried(of: Scene) -> Any:
            return Compensated(Blind(of, HEAVY), ArmModel(ARM, of), ramp=0.05, observer=50.0)

        of = start(law="pfra", delay=0.01)
        with pytest.raises(Refused, match="reads the force on the environment"):
            run_stepped(of, {"m": SimulatedMaster, "s": lambda each: Blind(each, ARM)})
        result = run_stepped(of, {"m": SimulatedMaster, "s": carried})
        assert result.status == "ok", result.sentence
        assert np.abs(result.trace["f_env"][500:]).max() < 0.2  # nothing touches it, and its weight is no touch
        assert np.abs(result.trace["x_s"] - HOME).max() < 0.2
        own = Compensated(MuJoCoRobot(start(), HEAVY), ArmModel(ARM, scene()))  # which has a sensor, and keeps it
        assert own.read(0).f == (0.0, 0.0, 0.0)
        assert on_arm()[1].read(0).f == (0.0, 0.0, 0.0)
        assert on_arm()[1]._K is None


class TestTyped:
    def test_a_model_stands_before_a_bar_and_behind_it_the_device(self) -> None:
        text = f"compensated:{ARM}?friction=0.5&limit=3&ramp=0.05&observer=40&joints=turn,lift,bend | mujoco:{HEAVY}"
        arm: Any = find_device("s", text).open(start())
        assert (arm.limit.tolist(), arm.deadline, arm.simulated) == ([3.0] * 3, 0.15, True)
        for k in range(1500):
            reading = arm.read(k)
            arm.hold((0.0,) * 3)
        assert abs(np.array(reading.v)).max() < 1e-2

    def test_what_is_typed_wrong_is_refused_in_one_sentence(self) -> None:
        for text, says in (
            (ARM, r"compensated names a model and, behind a \|, the device whose arm it is, not 'slave/arm\.xml'"),
            (f"{ARM} | nothing", "there is no robot 'nothing'"),
            (f"{ARM}?friction=1.2 | mujoco", "compensated's friction must be at most 0.9"),
            (f"{ARM}?limit=0 | mujoco", "limit must be above 0"),
            (f"{ARM} | mujoco", "this device's arm has no weight that a model could carry: .* unless .gravcomp=0"),
            (f"{ARM} | simulated", "this device's arm has no weight"),
            (f"{ARM}?limit=1,2 | mujoco:{HEAVY}", "limit has 2 numbers, and there are 3 joints"),
            (f"{ARM}?weight=1 | mujoco", "compensated has no setting 'weight'"),
            (f"{ARM}?joints=turn,lift,knee | mujoco", "joints= knee are no joints"),
        ):
            with pytest.raises(Refused, match=says):
                find_device("s", f"compensated:{text}").open(start())


def test_zero_force_is_tried_again_of_a_device_that_held_a_weight_and_a_reading_that_is_not_finite_handed_on() -> None:
    """It counted as one without a force on, so that one failure of the last zero was the end of it."""
    device, arm = on_arm()
    guarded = GuardedDevice(arm, 3)
    drive(guarded, 100, 0)
    device.fails = {"hold"}
    assert not guarded.let_go()
    assert guarded.forced
    device.fails = set()
    assert guarded.let_go()
    assert not guarded.forced
    device, arm = on_arm()
    guarded = GuardedDevice(arm, 3)
    drive(guarded, 100, 0)
    held = device.held[-1]
    device.v = (float("nan"), 0.0, 0.0)
    assert guarded.read(100, 0) is None
    assert guarded.trouble == "what it reads is not finite"
    guarded.hold((0.0,) * 3)
    assert device.held[-1] == pytest.approx(held, rel=1e-9)

