"""What a run comes to, by oscillators whose decay is known in closed form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import teleop.analysis.models.rest
from master.hand import Grip, Rest
from teleop import BackwardDifference, Device, Encoder, MassDamper, Scene, VirtualWall, load_scene
from teleop.analysis.models.rest import QUIET, settled
from teleop.simulation.rest import frequency
from tests.fakes import OneSpring


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
            assert got.amplitude is not None
            assert got.amplitude < QUIET

    def test_a_decay_slower_than_the_longest_run_is_seen_to_be_one(self) -> None:
        got = settled(spring(0.1))  # e^-3.2 in 64 s
        assert (got.verdict, got.rests) == ("stable", True)
        assert "still dies away after 64 s: 10 Hz" in got.sentence
        # The last window is the last eighth, and its swing that of its beginning without the wandering of the mean.
        assert got.amplitude == pytest.approx(1e-3 * np.exp(-0.05 * 56.0), rel=0.02)

    def test_what_nothing_damps_swings_for_ever(self) -> None:
        got = settled(spring(0.0))
        assert (got.verdict, got.rests) == ("limit cycle", False)
        assert got.amplitude == pytest.approx(1e-3, rel=1e-2)
        assert got.frequency == pytest.approx(10.0, rel=1e-3)

    @pytest.mark.parametrize("damping", [-1.0, pytest.param(-0.05, marks=pytest.mark.full)])
    def test_what_grows_is_unstable_whether_it_diverges_or_not(self, damping: float) -> None:
        got = settled(spring(1.0, law=OneSpring(K=0.0, B=damping - 1.0)))
        assert (got.verdict, got.rests) == ("unstable", False)
        assert (got.amplitude is None) == (damping == -1.0)

    @pytest.mark.parametrize(("step", "rests"), [(1.1e-3, True), (0.9e-3, False)])
    def test_within_two_steps_of_an_encoder_a_limit_cycle_counts_as_rest(self, step: float, rests: bool) -> None:
        coarse = Device(encoder=Encoder(step=step), velocity=BackwardDifference())
        got = settled(spring(0.0, device_m=coarse))  # 2 mm peak to peak
        assert (got.verdict, got.rests) == ("limit cycle", rests)
        assert ("counts as rest" in got.sentence) == rests

    def test_a_slow_decay_behind_an_encoder_is_not_trusted(self) -> None:
        fine = Device(encoder=Encoder(step=1e-6), velocity=BackwardDifference())
        got = settled(spring(0.1, device_m=fine))
        assert (got.verdict, got.rests) == ("limit cycle", False)
        assert "has not come to rest after 64 s" in got.sentence

    def test_two_lengths_must_agree_and_then_it_ends(self, monkeypatch: pytest.MonkeyPatch) -> None:
        for sizes, lengths in (([1.0, 1.0], 2), ([1.0, 0.5, 0.5], 3),  # it stays at each length, but not the same
                               ([1.0, 0.5, 0.25, 1e-8], 4)):
            rest = iter(sizes)
            asked = swings(monkeypatch, lambda rest=rest: next(rest))
            got = settled(spring(0.0))
            assert asked == [2000 * 2**i for i in range(lengths)]
            assert got.amplitude == pytest.approx(sizes[-1], rel=0.1)
            assert got.verdict == ("stable" if sizes[-1] < QUIET else "limit cycle")

    def test_what_ticks_that_are_left_out_move_for_ever_is_no_limit_cycle(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
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
