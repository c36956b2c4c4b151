"""A scene without a slave against its model by hand, and what a run comes to by oscillators of known decay."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

import teleop.analysis.models.rest
from master.hand import Grip, Rest
from scenarios.encoder_wall import scene as encoder_wall
from teleop import (
    BackwardDifference,
    Device,
    Encoder,
    LowPass,
    MassDamper,
    Refused,
    Scene,
    VirtualCoupling,
    VirtualWall,
    load_scene,
    run,
)
from teleop.analysis.models.loop import transfer
from teleop.analysis.models.one_port_loop import controller, one_port
from teleop.analysis.models.rest import QUIET, settled
from teleop.analysis.stability.assess import critical, is_stable, stability, swing
from teleop.laws.virtual_coupling import rendered_impedance
from teleop.simulation.rest import frequency
from tests.fakes import OneSpring

M, B, T = 0.04, 0.8, 1e-3


def scene(K: float = 800.0, *, damper: float = 0.0, delay: int = 0, every: int = 1, velocity: Any = None,
          **other: Any) -> Scene:
    device = Device(velocity=velocity or BackwardDifference(), delay=delay, every=every)
    return Scene(law=VirtualWall(K=K, B=damper), master=MassDamper(mass=M, damping=B), device_m=device, dt=T,
                 **{"duration": 1.0, **other})


def by_hand(K: float, damper: float, delay: int, every: int = 1) -> float:
    """Spectral radius of a held force on a mass, spring and backward-difference damper, delay as a shift register."""
    step = expm(np.array([[0.0, 1.0, 0.0], [0.0, -B / M, -1.0 / M], [0.0, 0.0, 0.0]]) * T)
    n = 3 + delay + 1  # x, v, x before, forces on their way, the force held
    whole = np.eye(n)
    for k in range(every):
        tick = np.zeros((n, n))
        new = np.zeros(n)
        new[[0, 2]] = K + damper / T, -damper / T
        line = [np.eye(n)[3 + i] for i in range(delay)] + [new]
        force = line[0] if k == 0 else np.eye(n)[-1]
        tick[:2] = step[:2, :2] @ np.eye(n)[:2] + np.outer(step[:2, 2], force)
        tick[2, 0] = 1.0
        for i in range(delay):
            tick[3 + i] = line[i + 1]
        tick[-1] = force
        whole = tick @ whole
    return float(np.abs(np.linalg.eigvals(whole)).max())


class TestTheLoop:
    def test_has_the_roots_of_the_model_by_hand(self) -> None:
        for delay, every, damper in product((0, 1, 4), (1, 3), (0.0, 0.4)):
            roots = one_port(scene(300.0, damper=damper, delay=delay, every=every)).roots()
            assert np.abs(roots).max() == pytest.approx(by_hand(300.0, damper, delay, every), abs=1e-9)

    def test_is_lost_at_the_computed_stiffness_and_with_a_damper_earlier_than_the_linear_rule_says(self) -> None:
        for damper, delay, printed in ((0.0, 0, 1605.35), (0.0, 10, 78.745), (B, 5, 282.69)):
            edge = critical(lambda K, c=damper, d=delay: scene(K, damper=c, delay=d), "K", low=printed / 2, high=1e4)
            assert edge.value == pytest.approx(printed, abs=0.006)
            assert edge.stable == "below"
        assert edge.value < (B + B) / (0.5 * T + 5 * T)
        got = stability(scene(800.0))
        assert (got.verdict, got.critical_round_trip) == ("stable", 1)
        assert got.gain_margin * 800.0 == pytest.approx(1605.35, abs=0.01)
        assert (is_stable(scene(800.0)), is_stable(scene(800.0, delay=1))) == (True, False)

    def test_is_the_same_wherever_the_wall_stands(self) -> None:
        there = replace(scene(), law=VirtualWall(K=800.0, at=0.37))
        assert np.sort_complex(one_port(there).roots()) == pytest.approx(np.sort_complex(one_port(scene()).roots()))

    @pytest.mark.parametrize(("velocity", "every"), [
        (LowPass(cutoff=50.0), 4), *(pytest.param(*parts, marks=pytest.mark.full) for parts in (
            (LowPass(cutoff=50.0), 1), (BackwardDifference(), 1), (BackwardDifference(), 4)))])
    def test_says_what_a_run_does_on_both_sides(self, velocity: Any, every: int) -> None:
        def made(K: float) -> Scene:  # pressed 50 N deep, so that a small swing stays in contact
            return scene(K, damper=0.3, velocity=velocity, every=every, start_m=50.0 / (50.0 + K) + 1e-6, duration=3.0,
                         hand=Grip(mass=0.0, k=50.0, d=0.0, reference=Rest(at=1.0)))

        edge = critical(made, "K", low=10.0, high=1e5).value
        for K, grows in ((0.97 * edge, False), (1.03 * edge, True)):
            x = run(made(K)).trace["x_m"]
            late, early = np.ptp(x[-300:]), np.ptp(x[500:800])
            assert (late > early) == grows


class TestALongDelay:
    """Of the computation: kept as a number, as the link's is in a scene with a slave."""

    @pytest.mark.full
    def test_has_the_roots_of_the_dense_model(self) -> None:
        for K, delay in ((30.0, 40), (5.0, 100), (300.0, 57)):
            got = stability(scene(K, delay=delay))
            greatest = by_hand(K, 0.0, delay)
            assert abs(got.mode.z) == pytest.approx(greatest, abs=1e-7)
            assert (got.unstable > 0) == (greatest > 1.0)

    def test_of_ten_seconds_is_no_dearer_than_of_ten_milliseconds(self) -> None:
        got = stability(scene(0.05, delay=10_000))
        assert got.verdict == "stable"
        assert got.critical_round_trip is not None
        least = got.critical_round_trip
        assert not is_stable(scene(0.05, delay=least))
        assert is_stable(scene(0.05, delay=least - 1))

    def test_of_a_law_that_reads_the_held_force_is_dense(self) -> None:
        slow = stability(scene(300.0, every=3))
        assert slow.tried is not None
        assert slow.critical_round_trip is not None


class TestTheController:
    def test_is_spring_and_damper_of_the_reading_with_its_delay(self) -> None:
        z = np.exp(1j * np.array([0.01, 0.7, 3.0]))
        for d in (0, 3):
            got = transfer(controller(scene(700.0, damper=0.5, delay=d)), z)[:, 0, 0]
            assert got == pytest.approx((700.0 + 0.5 * (1.0 - 1.0 / z) / T) * z**-d, rel=1e-9)

    def test_of_a_virtual_coupling_is_its_impedance_by_every_integrator(self) -> None:
        """Though the tool starts on the wall's surface, where the law has a kink."""
        for weights in ((0.0, 0.0), (0.0, 1.0), (0.5, 0.5), (1.0, 1.0)):
            law = VirtualCoupling(mass=0.1, k_e=2e4, d_e=1.0, theta_f=weights[0], theta_x=weights[1])
            for theta in (0.01, 0.5, 3.0):
                z = np.exp(1j * theta)
                H = transfer(controller(replace(scene(), law=law)), np.array([z]))[0, 0, 0]
                assert H * T / (1.0 - 1.0 / z) == pytest.approx(rendered_impedance(law, z, T), rel=1e-7)

    def test_of_a_velocity_that_no_device_has_is_refused(self) -> None:
        bare = replace(scene(700.0, damper=0.5), device_m=None)
        with pytest.raises(Refused, match="name an estimator"):
            controller(bare)


class TestInTime:
    """What is not linear is judged by a run: an encoder's limit cycle is its own verdict."""

    def test_a_wall_too_stiff_or_too_slow_hums_and_a_soft_one_or_a_passivity_controller_brings_it_to_rest(self) -> None:
        for scene, hertz in ((encoder_wall(K=2500.0), 34.5), (encoder_wall(every=5), 21.0), (encoder_wall(), None),
                             (encoder_wall(every=5, cap=0.8), None)):
            got = swing(scene)
            assert (got.verdict, got.rests) == (("stable", True) if hertz is None else ("limit cycle", False))
            assert hertz is None or got.frequency == pytest.approx(hertz, abs=1.0)

    def test_a_passivity_controller_leaves_a_hum_of_a_step_of_the_encoder(self) -> None:
        """It is a limit cycle, 33 times less than without the controller, and counts as rest."""
        got, without = (swing(encoder_wall(K=2500.0, cap=cap)) for cap in (0.8, None))
        assert (got.verdict, got.rests) == ("limit cycle", True)
        assert got.amplitude == pytest.approx(26e-6, abs=1e-6)
        assert without.amplitude > 30.0 * got.amplitude
        assert "0.84 steps of the encoder, which counts as rest, as up to 2 steps do" in got.sentence

    @pytest.mark.parametrize(("K", "steps", "duration"), [
        (1450.0, 5.4, 1.5), *(pytest.param(*numbers, marks=pytest.mark.full) for numbers in (
            (1550.0, 12.5, 1.5), (1600.0, 14.6, 1.5), (1450.0, 5.4, 5.0), (1550.0, 12.5, 5.0), (1600.0, 14.6, 5.0)))])
    def test_a_decay_to_a_limit_cycle_is_no_rest_in_a_short_run(self, K: float, steps: float, duration: float) -> None:
        """After 1.5 s these still fall, and were called stable."""
        got = swing(encoder_wall(K=K, duration=duration))
        assert (got.verdict, got.rests) == ("limit cycle", False)
        assert got.amplitude == pytest.approx(0.5 * steps * 2.0 * np.pi * 0.01 / 1024.0, rel=0.03)


def spring(damping: float, **other: Any) -> Scene:
    """1 kg at 10 Hz on a hand's spring, let go 1 mm off; the wall is out of reach. Decays as exp(-damping t/2)."""
    hand = Grip(mass=0.0, k=(20.0 * np.pi) ** 2, d=damping, reference=Rest(at=0.0))
    made = Scene(law=VirtualWall(K=1.0, at=1.0), master=MassDamper(mass=1.0), hand=hand, start_m=1e-3, dt=1e-3,
                 device_m=Device(velocity=BackwardDifference()), duration=2.0)
    return replace(made, **other)


def swings(monkeypatch: pytest.MonkeyPatch, amplitude: Callable[[], Any]) -> list[int]:
    """Let every run be a swing at 40 Hz; the list of their ticks."""
    asked: list[int] = []

    def swinging(scene: Scene, **_: int) -> SimpleNamespace:
        asked.append(scene.ticks)
        x = amplitude() * np.sin(80.0 * np.pi * np.arange(scene.ticks) * 1e-3)
        return SimpleNamespace(status="ok", ticks=scene.ticks, dt=1e-3, trace={"x_m": x})

    monkeypatch.setattr(teleop.analysis.models.rest, "run", swinging)
    return asked


class TestRest:
    def test_is_a_swing_that_is_gone_however_long_that_takes(self) -> None:
        for damping in (30.0, 1.0):
            got = settled(spring(damping))
            assert (got.verdict, got.rests) == ("stable", True)
            assert got.amplitude < QUIET

    @pytest.mark.parametrize(("damping", "step", "verdict", "rests", "amplitude", "said"), [
        # e^-3.2 in 64 s; the last window is the last eighth, its swing that of its beginning without a drift
        (0.1, None, "stable", True, 1e-3 * np.exp(-0.05 * 56.0), "still dies away after 64 s: 10 Hz"),
        (0.0, None, "limit cycle", False, 1e-3, ""),
        (0.0, 1.1e-3, "limit cycle", True, None, "counts as rest"),  # 2 mm peak to peak, within two steps
        (0.0, 0.9e-3, "limit cycle", False, None, ""),
        (0.1, 1e-6, "limit cycle", False, None, "has not come to rest after 64 s"),  # a slow decay is not trusted there
    ])
    def test_is_told_from_what_swings_for_ever_and_behind_an_encoder_to_two_of_its_steps(
        self, damping: float, step: float | None, verdict: str, rests: bool, amplitude: float | None, said: str
    ) -> None:
        device = Device(encoder=step and Encoder(step=step), velocity=BackwardDifference())
        got = settled(spring(damping, device_m=device))
        assert (got.verdict, got.rests) == (verdict, rests)
        assert said in got.sentence
        assert ("counts as rest" in got.sentence) == (said == "counts as rest")
        assert amplitude is None or got.amplitude == pytest.approx(amplitude, rel=0.02)
        assert got.frequency == pytest.approx(10.0, rel=1e-3) or verdict == "stable"

    @pytest.mark.parametrize("damping", [-1.0, pytest.param(-0.05, marks=pytest.mark.full)])
    def test_what_grows_is_unstable_whether_it_diverges_or_not(self, damping: float) -> None:
        got = settled(spring(1.0, law=OneSpring(K=0.0, B=damping - 1.0)))
        assert (got.verdict, got.rests) == ("unstable", False)
        assert (got.amplitude is None) == (damping == -1.0)

    def test_two_lengths_must_agree_and_then_it_ends(self, monkeypatch: pytest.MonkeyPatch) -> None:
        for sizes, lengths in (([1.0, 1.0], 2), ([1.0, 0.5, 0.5], 3),  # it stays at each length, but not the same
                               ([1.0, 0.5, 0.25, 1e-8], 4)):
            rest = iter(sizes)
            asked = swings(monkeypatch, lambda rest=rest: next(rest))
            got = settled(spring(0.0))
            assert asked == [2000 * 2**i for i in range(lengths)]
            assert got.amplitude == pytest.approx(sizes[-1], rel=0.1)
            assert got.verdict == ("stable" if sizes[-1] < QUIET else "limit cycle")

    def test_what_skipped_ticks_move_for_ever_is_no_limit_cycle(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """A run over a lossy link was ok, and `stability --time` called the same 0.02 mm a limit cycle."""
        moved = load_scene("soft_tissue", left_out=0.1, duration=2.0)
        for size, verdict in ((2e-4, "stable"), (2e-3, "limit cycle")):
            swings(monkeypatch, lambda size=size: 0.5 * size)
            found = settled(moved)
            assert (found.verdict, found.rests) == (verdict, verdict == "stable")
            assert settled(replace(moved, left_out_m=None, left_out_s=None)).verdict == "limit cycle"
            assert settled(spring(0.0, left_out_m=moved.left_out_m)).verdict == "limit cycle"

    @pytest.mark.parametrize(("until", "after", "lengths", "said"), [
        (100.0, 0.0, [1, 2], "keeps swinging: 40 Hz"),
        (1.0, -1e-4, [1, 2, 4, 8, 16, 32], "still dies away after 32 s: 40 Hz")])
    def test_is_looked_for_after_what_moved_it(
        self, until: float, after: float, lengths: list[int], said: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def amplitude() -> Any:
            k = np.arange(asked[-1])
            return np.where(k < 3000, until, np.exp(after * k))

        asked = swings(monkeypatch, amplitude)
        assert settled(spring(0.0, duration=4.0), since=3000).sentence.startswith(said)
        assert asked == [3000 + 1000 * times for times in lengths]


def test_a_frequency_between_two_lines_is_found() -> None:
    t = np.arange(4000) * 1e-3
    assert frequency(np.sin(2.0 * np.pi * 17.123 * t), 1e-3) == pytest.approx(17.123, abs=5e-3)
