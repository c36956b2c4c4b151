"""Runs in virtual time: the same bits for the same seed, an independent reference, and runs that go wrong."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import count, pairwise
from math import pi, sin, sqrt
from typing import Any, ClassVar

import numpy as np
import pytest
from scipy.linalg import expm

import teleop.simulation.bodies
from channel import Bernoulli, Delay, Link, UniformJitter
from master.hand import Grip, Rest
from slave import Tissue
from teleop import Direct, MassDamper, Refused, Scene, Wave, load_scene, run
from teleop.analysis.precision.reference.reference import settle
from teleop.physics.sdirk import WALL
from teleop.simulation.prepared import prepare
from teleop.simulation.virtual import run_prepared

ROUGH = Delay(0.02) | UniformJitter(0.02) | Bernoulli(0.2)


def same(one: Any, other: Any) -> bool:
    """Are two runs the same to the bit, in all that they recorded?"""
    return list(one.trace) == list(other.trace) and all(
        np.array_equal(one.trace[name], other.trace[name], equal_nan=True) for name in one.trace
    )


def test_the_name_of_a_scene_in_place_of_a_scene_is_answered_with_how_to_load_it() -> None:
    with pytest.raises(Refused, match=r"give run a Scene, not 'canonical'; .* run\(load_scene\('canonical'\)\)"):
        run("canonical")  # type: ignore[arg-type]


# A scene worked out once


def test_every_part_is_made_once_and_a_run_builds_the_slave_once(monkeypatch: pytest.MonkeyPatch) -> None:
    built = []
    build = teleop.simulation.bodies._slave

    def counted(*given: object) -> object:
        built.append(given)
        return build(*given)  # type: ignore[arg-type]

    monkeypatch.setattr(teleop.simulation.bodies, "_slave", counted)
    prepared = prepare(load_scene("canonical", duration=0.2))
    assert run_prepared(prepared).status == "ok"
    assert len(built) == prepared.scene.axes
    for part in ("bodies", "slaves", "reference", "starts", "numbers", "loop"):
        assert getattr(prepared, part) is getattr(prepared, part), part
    assert prepared.bodies.slaves is prepared.slaves


def test_a_prepared_scene_runs_again_and_again_with_the_bits_of_a_run() -> None:
    scene = load_scene("canonical", duration=0.2, link=ROUGH)
    prepared, once = prepare(scene), run(scene, seed=3)
    for _ in range(2):
        again = run_prepared(prepared, seed=3)
        assert same(again, once)
        assert (again.metrics, again.sentence, again.packets) == (once.metrics, once.sentence, once.packets)


# Seeds


def test_a_seed_of_any_kind_draws_the_link_and_nothing_else() -> None:
    rough, constant = load_scene("canonical", duration=0.5, link=ROUGH), load_scene("canonical", duration=0.5)
    runs = [run(rough, seed=seed) for seed in (7, 1, 2**64 - 1)]
    assert not any(same(one, other) for one, other in pairwise(runs))
    assert same(run(constant, seed=0), run(constant, seed=9))
    for kind in (np.int64, np.uint64, np.uint8):
        got = run(rough, seed=kind(7))
        assert same(runs[0], got), kind
        assert type(got.seed) is int, kind


def test_what_is_no_seed_is_refused() -> None:
    wrong: tuple[Any, ...] = (-1, 2**64, 1.0, True, "1", None)
    for seed in wrong:
        with pytest.raises(Refused, match=r"seed must be a whole number .* write --seed 1"):
            pytest.fail(f"{seed!r}: {run(load_scene('canonical', duration=0.01), seed=seed)}")


# Delays


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


def test_a_run_that_ends_says_so_counts_its_packets_and_has_the_time_of_its_clock() -> None:
    ticking = count(0, 2_500_000_000)
    got = run(load_scene("canonical", duration=0.2), clock=lambda: next(ticking))
    assert (got.status, got.ticks, got.mode, got.run_time) == ("ok", 200, "virtual", 2.5)
    assert got.sentence == "ran to its end, 200 ticks of 0.001 s"
    for way in ("fwd", "bwd"):
        counts = got.packets[way]
        assert (counts.sent, counts.received, counts.in_flight, counts.lost) == (200, 150, 50, 0)
    bare = run(replace(load_scene("canonical", duration=0.2), link=None))
    assert (bare.packets["fwd"].sent, bare.packets["fwd"].received, bare.packets["fwd"].in_flight) == (200, 199, 1)
    assert bare.run_time is None


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


# The canonical scene against an independent reference: its equations, and integrators made by others


@dataclass
class Reference:
    """The canonical scene as its equations say, by general-purpose integrators.

    The gripped master goes by a matrix exponential of the whole state (x, v, x_ref, v_ref, f), the slave by
    DOP853 with the changes of contact located as events; waves go through plain lists. Nothing of the stack's own
    steps is used.
    """

    b: float = 2.0
    K: float = 500.0
    B: float = 20.0
    delay: int = 50
    dt: float = 1e-3

    k_e: ClassVar[float] = 5000.0
    d_e: ClassVar[float] = 5.0
    at: ClassVar[float] = 0.03

    def __post_init__(self) -> None:
        M, b_m, k_h, d_h = 0.1 + 0.4, 0.5, 200.0, 5.0
        rates = np.zeros((5, 5))
        rates[0, 1] = rates[2, 3] = 1.0
        rates[1] = np.array([-k_h, -(d_h + b_m), k_h, d_h, -1.0]) / M
        self.master_step = expm(rates * self.dt)
        self.contacts = 0

    def slave_step(self, x: float, v: float, f: float) -> tuple[float, float]:
        """0.5 kg and 1 N s/m beside a wall that cannot pull, f held."""
        wall = (WALL, 0.5, 1.0, self.k_e, self.d_e, 1.5, 0.0, 0.0)
        p, u, changes = settle(wall, float(x) - self.at, float(v), float(f), 0.0, self.dt, "DOP853")
        self.contacts += changes
        return self.at + p, u

    def run(self, ticks: int) -> dict[str, np.ndarray]:
        root, b, K, B, dt = sqrt(2.0 * self.b), self.b, self.K, self.B, self.dt
        x_m = v_m = x_s = v_s = x_d = 0.0
        u_sent, w_sent = [0.0] * self.delay, [0.0] * self.delay
        rows = []
        for k in range(ticks):
            w_m, u_s = w_sent[k], u_sent[k]
            f_m = b * v_m - root * w_m
            u_sent.append(root * v_m - w_m)
            v_d = (root * u_s - K * (x_d - x_s) + B * v_s) / (b + B + K * dt)
            x_d += dt * v_d
            f_s = root * u_s - b * v_d
            w_sent.append(u_s - sqrt(2.0 / b) * f_s)
            rows.append((x_m, v_m, f_m, x_s, v_s, f_s))
            r0, r1 = (0.05 * sin(2.0 * pi * dt * j) for j in (k, k + 1))
            x_m, v_m, *_ = self.master_step @ [x_m, v_m, r0, (r1 - r0) / dt, f_m]
            x_s, v_s = self.slave_step(x_s, v_s, f_s)
        return dict(zip(("x_m", "v_m", "f_m", "x_s", "v_s", "f_s"), np.array(rows).T, strict=True))


@pytest.mark.parametrize("reference", [Reference(), *[pytest.param(each, marks=pytest.mark.full) for each in (
    Reference(b=0.5, K=4000.0, B=30.0, delay=7), Reference(b=4.0, K=200.0, B=5.0, delay=1))]])
def test_the_canonical_scene_is_what_its_equations_say(reference: Reference) -> None:
    want = reference.run(2000)
    law = Wave(b=reference.b, K=reference.K, B=reference.B)
    got = run(load_scene("canonical", duration=2.0, law=law, delay=reference.delay * 1e-3)).trace
    assert reference.contacts >= 4
    assert got["f_env"].max() > 0.5
    assert got["f_env"].min() == 0.0  # it cannot pull
    for name, scale in (("x_m", 1.0), ("v_m", 10.0), ("f_m", 10.0), ("x_s", 1.0), ("v_s", 100.0), ("f_s", 100.0)):
        assert np.abs(got[name] - want[name]).max() < 1e-11 * scale, name
