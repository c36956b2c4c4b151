"""Runs in virtual time: the same bits for the same seed, an independent reference, and runs that go wrong."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import count, pairwise
from math import sqrt
from typing import Any, ClassVar

import numpy as np
import pytest

from channel.bernoulli import Bernoulli
from channel.delay import Delay
from channel.link import Link
from channel.uniform import UniformJitter
from master.hand import Grip, Rest, Sine
from slave.tissue import Tissue
from slave.wall import Wall
from teleop.errors import Refused
from teleop.law import At
from teleop.laws.direct import Back, Direct, Forth
from teleop.laws.wave import Wave
from teleop.physics.plant import MassDamper
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene
from teleop.simulation.virtual import run

ROUGH = Delay(0.02) | UniformJitter(0.02) | Bernoulli(0.2)


def same(one: Any, other: Any) -> bool:
    """Are two runs the same to the bit, in all that they recorded?"""
    return list(one.trace) == list(other.trace) and all(
        np.array_equal(one.trace[name], other.trace[name], equal_nan=True) for name in one.trace
    )


def test_the_name_of_a_scene_in_place_of_a_scene_is_answered_with_how_to_load_it() -> None:
    with pytest.raises(Refused, match=r"give run a Scene, not 'canonical'; .* run\(load_scene\('canonical'\)\)"):
        run("canonical")  # type: ignore[arg-type]


# Seeds


@pytest.mark.parametrize("kind", [np.int64, np.uint64, np.uint8])
def test_a_seed_of_numpy_is_the_same_seed(kind: Any) -> None:
    scene = load_scene("canonical", duration=0.1, link=ROUGH)
    one, other = run(scene, seed=7), run(scene, seed=kind(7))
    assert same(one, other)
    assert type(other.seed) is int


def test_the_same_seed_gives_the_same_bits() -> None:
    scene = load_scene("canonical", duration=0.5, link=ROUGH)
    one, other = run(scene, seed=3), run(scene, seed=3)
    assert same(one, other)
    assert one.metrics == other.metrics
    assert one.packets == other.packets


def test_other_seeds_draw_other_links() -> None:
    scene = load_scene("canonical", duration=0.5, link=ROUGH)
    runs = [run(scene, seed=seed) for seed in (0, 1, 2**64 - 1)]
    assert not any(same(one, other) for one, other in pairwise(runs))


def test_a_seed_means_nothing_to_a_link_without_dice() -> None:
    scene = load_scene("canonical", duration=0.5)
    assert same(run(scene, seed=0), run(scene, seed=9))


@pytest.mark.parametrize("seed", [-1, 2**64, 1.0, True, "1", None])
def test_what_is_no_seed_is_refused(seed: Any) -> None:
    with pytest.raises(Refused, match=r"seed must be a whole number .* write --seed 1"):
        run(load_scene("canonical", duration=0.01), seed=seed)


# Delays


@pytest.mark.parametrize("law", [Wave(), Direct(K=200.0, B=5.0, kf=0.2)])
def test_no_link_zero_delay_and_one_tick_are_the_same_run(law: Any) -> None:
    scene = load_scene("canonical", duration=0.6, law=law)
    without = run(replace(scene, link=None))
    for delay in (0.0, 1e-9, 0.5e-3, 1e-3):
        linked = run(replace(scene, link=Delay(delay)))
        for name, column in without.trace.items():
            assert np.array_equal(column, linked.trace[name]), (delay, name)
    assert not same(without, run(replace(scene, link=Delay(1.001e-3))))


@pytest.mark.parametrize(("dt", "delay", "ticks"), [
    (1e-3, 0.05, 50), (1e-3, 0.0501, 51), (1e-3, 0.0499, 50), (0.7e-3, 0.07, 100), (0.01, 0.3, 30), (1e-3, 0.0, 1),
])
def test_a_delay_is_whole_ticks_rounded_up_at_every_tick(dt: float, delay: float, ticks: int) -> None:
    trace = run(load_scene("canonical", dt=dt, delay=delay, duration=1500 * dt)).trace
    k = np.arange(1500)
    for seq in ("seq_m", "seq_s"):
        assert np.array_equal(trace[seq], np.where(k >= ticks, k - ticks, -1))


def test_each_direction_has_its_own_delay() -> None:
    scene = load_scene("canonical", duration=0.3)
    trace = run(replace(scene, link=Link(fwd=Delay(0.03), bwd=Delay(0.11)))).trace
    assert trace["seq_s"][200] == 170
    assert trace["seq_m"][200] == 90


# Status


def test_a_run_that_ends_says_so() -> None:
    got = run(load_scene("canonical", duration=0.25))
    assert (got.status, got.ticks, got.mode) == ("ok", 250, "virtual")
    assert got.sentence == "ran to its end, 250 ticks of 0.001 s"


UNSTABLE = Scene(
    law=Direct(K=2000.0, B=8.0, kf=3.0), master=MassDamper(mass=0.04, damping=0.8), link=Delay(0.05),
    slave=MassDamper(mass=0.04, damping=0.8), environment=Tissue(k=2000.0, d=0.0), start_m=1e-3, duration=60.0,
    hand=Grip(mass=0.0, k=100.0, d=2.0, reference=Rest()), x_limit=1e3, energy=True,
)


def test_a_run_that_diverges_ends_early_and_says_when_and_what() -> None:
    got = run(UNSTABLE)
    assert got.status == "diverged"
    assert 100 < got.ticks < UNSTABLE.ticks
    assert all(len(column) == got.ticks for column in got.trace.values())
    when = f"diverged at t = {(got.ticks - 1) * 1e-3:g} s (tick {got.ticks - 1}): "
    assert got.sentence.startswith(when)
    rest = got.sentence.removeprefix(when)
    assert rest in {f"{name} passed 1000 m; a smaller dt, gain or delay may hold it" for name in ("x_m", "x_s")}
    assert np.abs(got.trace["x_m"]).max() < 1e3  # the record ends before the limit was passed


@dataclass(frozen=True, kw_only=True)
class Breaks:
    """Direct, until the master's force is no number any more."""

    at: float
    claims: ClassVar[dict[str, str]] = {}

    def master_start(self, at: At) -> tuple[tuple[()], Back]:
        return Direct().master_start(at)

    def slave_start(self, at: At) -> tuple[tuple[()], Forth]:
        return Direct().slave_start(at)

    def master(self, s: tuple[()], at: At, rx: Back) -> tuple[float, Forth, tuple[()]]:
        return (float("nan") if at.x > self.at else 0.0), Forth(at.x, at.v), s

    def slave(self, s: tuple[()], at: At, rx: Forth) -> tuple[float, Back, tuple[()]]:
        return 0.0, Back(0.0), s


def test_a_force_that_is_no_number_is_named() -> None:
    got = run(load_scene("canonical", law=Breaks(at=0.02)))
    assert got.status == "diverged"
    assert "f_m is not finite, as Breaks.master returned; a smaller dt" in got.sentence
    assert np.isnan(got.trace["f_m"][-1])
    assert np.isfinite(got.trace["f_m"][:-1]).all()


def test_a_clock_times_the_loop_and_without_one_there_is_no_time() -> None:
    scene, ticking = load_scene("canonical", duration=0.01), count(0, 2_500_000_000)
    assert run(scene).run_time is None
    assert run(scene, clock=lambda: next(ticking)).run_time == 2.5


def test_packets_are_counted() -> None:
    got = run(load_scene("canonical", duration=0.2))
    for way in ("fwd", "bwd"):
        counts = got.packets[way]
        assert (counts.sent, counts.received, counts.in_flight, counts.lost) == (200, 150, 50, 0)
    bare = run(replace(load_scene("canonical", duration=0.2), link=None)).packets["fwd"]
    assert (bare.sent, bare.received, bare.in_flight) == (200, 199, 1)


# Plants at their edges, in whole runs


def pushed(**other: Any) -> Any:
    """A slave that is drawn to and fro across a wall, everything else left as it is."""
    return run(Scene(**{
        "law": Direct(K=300.0, B=4.0, kf=0.1), "master": MassDamper(mass=0.1), "slave": MassDamper(mass=0.3),
        "hand": Grip(mass=0.2, k=300.0, d=2.0, reference=Sine(amplitude=0.05, frequency=2.0)), "link": Delay(0.01),
        "environment": Wall(k=5e3, at=0.01), "duration": 1.0, "energy": True, **other,
    }))


def test_a_wall_on_the_other_side_mirrors_the_whole_run() -> None:
    hand = Grip(mass=0.2, k=300.0, d=2.0, reference=Sine(amplitude=-0.05, frequency=2.0))
    one, other = pushed().trace, pushed(environment=Wall(k=5e3, at=-0.01, side=-1), hand=hand).trace
    assert one["f_env"].max() > 1.0
    for name in ("x_m", "v_m", "f_m", "f_h", "x_s", "v_s", "f_s", "f_env"):
        assert np.array_equal(one[name], -other[name]), name
    assert np.array_equal(one["E_port"], other["E_port"])


@pytest.mark.parametrize("side", [1, -1])
def test_a_slave_that_starts_inside_the_wall_is_pushed_out(side: int) -> None:
    law = Direct(K=0.0, B=0.0, kf=0.0)
    got = pushed(law=law, environment=Wall(k=5e3, at=0.01, side=side), start_s=0.01 + 0.02 * side, hand=None)
    trace = got.trace
    assert trace["f_env"][0] == pytest.approx(100.0 * side)
    # All of k p^2/2 becomes M v^2/2, and there it stays.
    assert trace["v_s"][-1] == pytest.approx(-side * 0.02 * sqrt(5e3 / 0.3), rel=1e-12)
    assert got.status == "ok"


@pytest.mark.parametrize("other", [
    {"environment": Wall(k=5e3, d=0.0, at=0.01), "master": MassDamper(mass=0.1), "slave": MassDamper(mass=0.3)},
    {"environment": Wall(k=0.0, d=5.0, at=0.01)}, {"environment": Wall(k=0.0, d=0.0, at=0.01)},
    {"environment": Wall(k=1e8, d=0.0, at=0.0)}, {"environment": Tissue(k=0.0, d=0.0)},
    {"hand": Grip(mass=0.0, k=0.0, d=0.0, reference=Rest()), "start_m": 0.05},
], ids=["no damping", "no stiffness", "no wall", "very stiff", "no tissue", "limp hand"])
def test_coefficients_may_be_zero_or_huge(other: dict[str, Any]) -> None:
    got = pushed(**other)
    assert got.status == "ok"
    assert all(np.isfinite(column).all() for column in got.trace.values())


def test_a_wall_of_nothing_is_free_space() -> None:
    assert same(pushed(environment=Wall(k=0.0, d=0.0, at=0.01)), pushed(environment=None))
