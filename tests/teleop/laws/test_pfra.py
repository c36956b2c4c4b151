"""Projection-based force reflection: every property it is known by, tick by tick and in whole runs."""

from __future__ import annotations

from dataclasses import replace
from functools import reduce
from itertools import pairwise
from math import exp, sqrt
from operator import add

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from channel import Bernoulli, Delay, UniformJitter
from master.hand import Grip, Sine
from slave import Tissue, Wall
from teleop import PFRA, At, Direct, Facts, MassDamper, Scene, run
from teleop.laws.pfra import EPS, Back, PFRASums
from teleop.physics.plant import free_space, move_free
from teleop.stages.observer import coefficients, observe

Vector = tuple[float, ...]
NAN = float("nan")

force = st.floats(-1e3, 1e3).map(lambda value: round(value, 9))
gain = st.floats(0.0, 1e3)
vector = st.integers(1, 3).flatmap(lambda n: st.tuples(st.tuples(*[force] * n), st.tuples(*[force] * n)))


def reflected(law: PFRA, f_env: Vector, f_h_hat: Vector, v: Vector | None = None) -> Vector:
    """The force on the hand, over all axes, as a tick computes it."""
    ats = [At(0.0, speed, f, NAN, NAN, True, NAN, 1e-3)
           for f, speed in zip(f_h_hat, v or (0.0,) * len(f_h_hat), strict=True)]
    rxs = [Back(f) for f in f_env]
    sums = [law.master_sums((), at, rx) for at, rx in zip(ats, rxs, strict=True)]
    over = PFRASums(*(reduce(add, values) for values in zip(*sums, strict=True)))
    return tuple(law.master((), at, rx, over)[0] for at, rx in zip(ats, rxs, strict=True))


def size(f: Vector) -> float:
    return sqrt(sum(part * part for part in f))


@given(forces=vector, kf=gain)
@settings(max_examples=50)
def test_with_alpha_0_it_never_pushes_with_the_hand_nor_harder_than_the_hand(
        forces: tuple[Vector, Vector], kf: float) -> None:
    """<f_r, f_h_hat> >= 0 and |f_r| <= |f_h_hat|, the whole vectors'."""
    f_env, f_h_hat = forces
    f_r = reflected(PFRA(kf=kf), f_env, f_h_hat)
    assert sum(a * b for a, b in zip(f_r, f_h_hat, strict=True)) >= 0.0
    assert size(f_r) <= size(f_h_hat)


# Whole runs


@pytest.mark.parametrize(("axes", "observer"), [(1, 200.0), (3, None)], ids=["observer", "sensor, three axes"])
def test_alpha_1_is_direct_reflection_in_a_whole_run(axes: int, observer: float | None) -> None:
    """Every array that both runs record is the same, bit for bit but for the sign of a zero."""
    hand = Grip(mass=0.2, k=100.0, d=2.0, reference=Sine(amplitude=(0.05, 0.03, -0.04)[:axes], frequency=1.3))
    walls = (Wall(k=2e3, d=2.0, at=0.01), Tissue(k=300.0, d=1.0), None)[:axes]
    scene = Scene(
        law=PFRA(alpha=1.0, kf=0.3, K=400.0, B=8.0), hand=hand, master=MassDamper(mass=0.1, damping=0.5), axes=axes,
        slave=MassDamper(mass=0.3, damping=1.0), environment=walls, observer=observer, duration=0.5,
        link=Delay(0.02) | UniformJitter(0.01) | Bernoulli(0.1),
    )
    projected = run(scene, seed=3).trace
    direct = run(replace(scene, law=Direct(kf=0.3, K=400.0, B=8.0)), seed=3).trace
    assert projected["f_m"].any()
    for name in direct:
        assert np.array_equal(projected[name], direct[name]), name


@given(kf=st.floats(0.0, 1e6), delay=st.floats(0.0, 0.3), push=st.floats(0.001, 0.05),
       observer=st.sampled_from([None, 50.0, 200.0]), axes=st.sampled_from([1, 3]), seed=st.integers(0, 99))
@settings(max_examples=15)
def test_a_master_at_rest_that_no_hand_has_held_is_never_moved(
        kf: float, delay: float, push: float, observer: float | None, axes: int, seed: int) -> None:
    """The slave starts inside a wall that throws it out; alpha = 0, any gain, any delay, even a held message."""
    walls = (Wall(k=1e4, d=1.0), Tissue(k=2e3, d=0.0, at=0.02), None)[:axes]
    scene = Scene(
        law=PFRA(kf=kf), master=MassDamper(mass=0.1, damping=0.5), slave=MassDamper(mass=0.3, damping=0.1),
        environment=walls, start_s=(push, -push, 0.0)[:axes], observer=observer, axes=axes, duration=0.5,
        link=Delay(delay) | UniformJitter(0.01),
    )
    trace = run(scene, seed=seed).trace
    assert np.abs(trace["f_env"]).max() > 1.0
    assert not trace["x_m"].any()
    assert not trace["f_m"].any()


# After letting go


def let_go(L: float, f_env: float, f_h_hat: float, *, body: MassDamper, speed: float = 0.0,
           dt: float = 1e-3, ticks: int = 1500) -> tuple[float, float, float]:
    """Impulse of the reflection (N s), integral of |f_h_hat| (N s), and how far the master went (m).

    Nobody holds the master any more; the observer still remembers f_h_hat, and f_env stays on.
    """
    law, plant = PFRA(), free_space(body, dt).c
    c = coefficients(L, body.mass, body.damping, dt)
    x, v, f_m, impulse, memory = 0.0, speed, 0.0, 0.0, 0.0
    for _ in range(ticks):
        f_m = reflected(law, (f_env,), (f_h_hat,))[0]
        impulse += dt * abs(f_m)
        memory += dt * abs(f_h_hat)
        before = v
        x, v, _ = move_free(plant, x, v, -f_m)
        f_h_hat = observe(c, f_h_hat, before, v, f_m)
    return impulse, memory, x


@given(L=st.floats(10.0, 500.0), f_env=st.floats(0.1, 50.0), f_h_hat=st.floats(0.1, 50.0),
       mass=st.floats(0.02, 2.0), damping=st.floats(0.0, 5.0), speed=st.floats(-1.0, 1.0))
@settings(max_examples=8)
def test_after_letting_go_the_impulse_is_at_most_what_the_observer_still_remembers(
        L: float, f_env: float, f_h_hat: float, mass: float, damping: float, speed: float) -> None:
    impulse, memory, _ = let_go(L, f_env, f_h_hat, body=MassDamper(mass=mass, damping=damping), speed=speed)
    assert impulse <= memory * (1.0 + 1e-12)
    assert memory == pytest.approx(f_h_hat * 1e-3 / (1.0 - exp(-L * 1e-3)), rel=1e-6)


@pytest.mark.parametrize("L", [50.0, 200.0])
def test_a_faster_observer_forgets_sooner_and_the_master_goes_less_far(L: float) -> None:
    """Held against f_env = 5 N until it is let go: m x'' + b x' = -5 exp(-L t), which ends at x = -5/(b L)."""
    body, dt = MassDamper(mass=0.1, damping=0.5), 1e-3
    impulse, memory, x = let_go(L, 5.0, 5.0, body=body, dt=dt, ticks=5000)
    assert impulse == pytest.approx(memory, rel=1e-12)
    assert x == pytest.approx(-impulse / body.damping, rel=1e-6)
    assert impulse == pytest.approx(5.0 / L, rel=0.6 * L * dt)


# Weights of what pushes, pulls and acts across the hand, and the rest that the master's damping can take

vectors = st.integers(1, 3).flatmap(lambda n: st.tuples(*[st.tuples(*[force] * n) for _ in range(3)]))
weight = st.floats(0.0, 1.0)


@given(forces=vectors, kf=st.floats(0.0, 1e3), alpha=weight)
def test_the_defaults_are_the_law_that_had_no_other_weights_bit_for_bit(
        forces: tuple[Vector, Vector, Vector], kf: float, alpha: float) -> None:
    f_env, f_h, v = forces
    eh = reduce(add, [kf * e * h for e, h in zip(f_env, f_h, strict=True)])
    share = max(0.0, min(eh / max(reduce(add, [h * h for h in f_h]), EPS), 1.0))
    old = [alpha * (kf * e) + (1.0 - alpha) * (share * h) for e, h in zip(f_env, f_h, strict=True)]
    assert reflected(PFRA(alpha=alpha, kf=kf), f_env, f_h, v) == tuple(old)


@given(forces=vectors, push=weight, pull=weight, across=weight, alpha=weight)
def test_each_part_beside_the_hands_has_its_own_weight(
        forces: tuple[Vector, Vector, Vector], push: float, pull: float, across: float, alpha: float) -> None:
    """Against the parts by numpy: along the hand what exceeds it or pulls it on, and what is across."""
    f_env, f_h = np.array(forces[0]), np.array(forces[1])
    if f_h @ f_h < 1e-6:
        return
    q = f_env @ f_h / (f_h @ f_h)
    parts = {"push": max(q - 1.0, 0.0) * f_h, "pull": min(q, 0.0) * f_h, "across": f_env - q * f_h}
    weights = {"push": push, "pull": pull, "across": across}
    want = min(max(q, 0.0), 1.0) * f_h + sum(min(alpha + weights[name], 1.0) * part for name, part in parts.items())
    got = reflected(PFRA(alpha=alpha, push=push, pull=pull, across=across), forces[0], forces[1])
    assert got == pytest.approx(want, rel=1e-9, abs=1e-9 * (1.0 + float(np.abs(f_env).max())))


@given(forces=vectors, alpha=weight, across=weight, rest_gain=st.floats(0.0, 50.0))
@example(forces=((30.0, 40.0), (5.0, 0.0), (0.1, 0.0)), alpha=0.0, across=0.0, rest_gain=2.0)  # slow, and both parts
def test_the_rest_that_is_felt_is_at_most_rest_gain_times_the_speed_and_in_its_own_direction(
        forces: tuple[Vector, Vector, Vector], alpha: float, across: float, rest_gain: float) -> None:
    f_env, f_h, v = forces
    without = PFRA(alpha=alpha, across=across)
    bare = np.array(reflected(without, f_env, f_h, v))
    rest = reflected(replace(without, rest_gain=1e9), f_env, f_h, tuple(x + 1.0 for x in v)) - bare  # all of it
    felt = reflected(replace(without, rest_gain=rest_gain), f_env, f_h, v) - bare
    all_of_it, most = np.linalg.norm(rest), rest_gain * np.linalg.norm(v)
    grain = 1e-6 * (1.0 + max(map(abs, f_env + f_h)))
    assert np.linalg.norm(felt) <= most + grain
    assert np.linalg.norm(felt) == pytest.approx(min(all_of_it, most), abs=grain)
    assert felt @ rest >= -grain * (1.0 + all_of_it)


def speeds(law: PFRA, body: MassDamper, pushes: list[float], speed: float = 1.0) -> list[float]:
    """Speeds of a master that no hand holds, tick by tick, under reflections of any force."""
    plant, x, v, found = free_space(body, 1e-3).c, 0.0, speed, [speed]
    for push in pushes:
        x, v, _ = move_free(plant, x, v, -reflected(law, (push,), (0.0,), (v,))[0])
        found.append(abs(v))
    return found


@given(pushes=st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=50), kf=st.floats(0.0, 1e3),
       mass=st.floats(0.02, 2.0), damping=st.floats(0.01, 5.0))
def test_a_rest_gain_below_the_damping_makes_no_motion_grow_whatever_is_reflected(
        pushes: list[float], kf: float, mass: float, damping: float) -> None:
    body = MassDamper(mass=mass, damping=damping)
    found = speeds(PFRA(kf=kf, rest_gain=0.99 * damping), body, pushes)
    assert all(after <= before * (1.0 + 1e-12) for before, after in pairwise(found))
    above = speeds(PFRA(rest_gain=1.0), MassDamper(mass=0.1, damping=0.5), [-100.0] * 500)
    assert above[-1] > 5.0 * above[0], "one above it does"


@pytest.mark.parametrize(("rest_gain", "damping", "told"), [
    (0.5, 0.5, False), (0.51, 0.5, True), (0.1, 0.0, True), (9.0, NAN, False)])
def test_a_run_says_where_the_rest_is_more_than_the_damping(rest_gain: float, damping: float, told: bool) -> None:
    of = Facts(1e-3, 1, 0.1, damping, 0.5, 1.0, None, None, False, "zero", 1e-3)
    notes = PFRA(rest_gain=rest_gain).conditions(of)
    assert bool(notes) is told
    assert not told or f"--set law.rest_gain={damping:g} is the most" in notes[0]
