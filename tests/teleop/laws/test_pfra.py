"""Projection-based force reflection: every property it is known by, tick by tick and in whole runs."""

from __future__ import annotations

from dataclasses import replace
from functools import reduce
from math import exp, sqrt
from operator import add

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from channel.bernoulli import Bernoulli
from channel.delay import Delay
from channel.uniform import UniformJitter
from master.hand import Grip, Rest, Sine
from slave.tissue import Tissue
from slave.wall import Wall
from teleop.errors import Refused
from teleop.law import At
from teleop.laws.direct import Direct
from teleop.laws.pfra import EPS, PFRA, Back, PFRASums
from teleop.physics.plant import MassDamper, free_space, move_free
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene
from teleop.simulation.virtual import run
from teleop.stages.observer import coefficients, observe

Vector = tuple[float, ...]

force = st.floats(-1e3, 1e3).map(lambda value: round(value, 9))
gain = st.floats(0.0, 1e3)
vector = st.integers(1, 3).flatmap(lambda n: st.tuples(st.tuples(*[force] * n), st.tuples(*[force] * n)))


def reflected(law: PFRA, f_env: Vector, f_h_hat: Vector) -> Vector:
    """The force on the hand, over all axes, as a tick computes it."""
    nan = float("nan")
    ats = [At(0.0, 0.0, f, nan, nan, True, nan, 1e-3) for f in f_h_hat]
    rxs = [Back(f) for f in f_env]
    sums = [law.master_sums((), at, rx) for at, rx in zip(ats, rxs, strict=True)]
    over = PFRASums(*(reduce(add, values) for values in zip(*sums, strict=True)))
    return tuple(law.master((), at, rx, over)[0] for at, rx in zip(ats, rxs, strict=True))


def size(f: Vector) -> float:
    return sqrt(sum(part * part for part in f))


@given(f_env=force, f_h_hat=force, kf=gain)
@settings(max_examples=300)
def test_in_one_axis_it_is_the_reflected_force_clipped_between_nothing_and_the_hands(
    f_env: float, f_h_hat: float, kf: float
) -> None:
    if f_h_hat * f_h_hat < EPS:
        return
    clipped = min(max(kf * f_env, min(0.0, f_h_hat)), max(0.0, f_h_hat))
    assert reflected(PFRA(kf=kf), (f_env,), (f_h_hat,))[0] == pytest.approx(clipped, rel=1e-15)


@given(forces=vector, kf=gain)
@settings(max_examples=300)
def test_with_alpha_0_it_never_pushes_with_the_hand_nor_harder_than_the_hand(
    forces: tuple[Vector, Vector], kf: float
) -> None:
    """<f_r, f_h_hat> >= 0 and |f_r| <= |f_h_hat|, the whole vectors'."""
    f_env, f_h_hat = forces
    f_r = reflected(PFRA(kf=kf), f_env, f_h_hat)
    assert sum(a * b for a, b in zip(f_r, f_h_hat, strict=True)) >= 0.0
    assert size(f_r) <= size(f_h_hat)


@given(forces=vector, kf=gain)
@settings(max_examples=200)
def test_with_alpha_0_it_is_the_nearest_point_of_the_hands_segment(
    forces: tuple[Vector, Vector], kf: float
) -> None:
    """phi_env is the projection of kf f_env on the segment from 0 to f_h_hat: no point of it is nearer."""
    f_env, f_h_hat = forces
    if size(f_h_hat) ** 2 < EPS:
        return
    wanted = np.array(f_env) * kf
    distance = np.linalg.norm(np.array(reflected(PFRA(kf=kf), f_env, f_h_hat)) - wanted)
    others = np.linspace(0.0, 1.0, 101)[:, None] * np.array(f_h_hat) - wanted
    assert distance <= np.linalg.norm(others, axis=1).min() * (1.0 + 1e-12) + 1e-9


@given(forces=vector, kf=gain, alpha=st.floats(0.0, 1.0))
@settings(max_examples=200)
def test_alpha_weighs_direct_reflection_against_the_projection(
    forces: tuple[Vector, Vector], kf: float, alpha: float
) -> None:
    mixed, none, all_of_it = (np.array(reflected(PFRA(kf=kf, alpha=a), *forces)) for a in (alpha, 0.0, 1.0))
    assert mixed == pytest.approx(alpha * all_of_it + (1.0 - alpha) * none, rel=1e-12, abs=1e-12)


@given(forces=vector, kf=gain)
def test_alpha_1_is_direct_reflection_bit_for_bit(forces: tuple[Vector, Vector], kf: float) -> None:
    f_env, f_h_hat = forces
    assert reflected(PFRA(kf=kf, alpha=1.0), f_env, f_h_hat) == tuple(kf * f for f in f_env)


def test_a_force_across_the_hands_is_not_felt_and_one_along_is() -> None:
    law = PFRA()
    assert reflected(law, (0.0, 4.0, 0.0), (2.0, 0.0, 0.0)) == (0.0, 0.0, 0.0)
    assert reflected(law, (1.5, 4.0, 0.0), (2.0, 0.0, 0.0)) == (1.5, 0.0, 0.0)
    assert reflected(law, (3.0, 3.0, 3.0), (1.0, 1.0, 1.0)) == (1.0, 1.0, 1.0)


@pytest.mark.parametrize(("knob", "value"), [
    ("alpha", -0.1), ("alpha", 1.1), ("kf", -1.0), ("K", -1.0), ("B", -1.0), ("alpha", float("nan"))
])
def test_knobs_out_of_range_are_refused(knob: str, value: float) -> None:
    with pytest.raises(Refused, match=knob):
        PFRA(**{knob: value})


# Whole runs


@pytest.mark.parametrize("observer", [200.0, None], ids=["observer", "sensor"])
@pytest.mark.parametrize("axes", [1, 3])
def test_alpha_1_is_direct_reflection_in_a_whole_run(axes: int, observer: float | None) -> None:
    """Every array that both runs record is the same, bit for bit but for the sign of a zero."""
    hand = Grip(mass=0.2, k=100.0, d=2.0, reference=Sine(amplitude=(0.05, 0.03, -0.04)[:axes], frequency=1.3))
    walls = (Wall(k=2e3, d=2.0, at=0.01), Tissue(k=300.0, d=1.0), None)[:axes]
    scene = Scene(
        law=PFRA(alpha=1.0, kf=0.3, K=400.0, B=8.0), hand=hand, master=MassDamper(mass=0.1, damping=0.5), axes=axes,
        slave=MassDamper(mass=0.3, damping=1.0), environment=walls, observer=observer, duration=1.0,
        link=Delay(0.02) | UniformJitter(0.01) | Bernoulli(0.1),
    )
    projected = run(scene, seed=3).trace
    direct = run(replace(scene, law=Direct(kf=0.3, K=400.0, B=8.0)), seed=3).trace
    assert projected["f_m"].any()
    for name in direct:
        assert np.array_equal(projected[name], direct[name]), name


@given(kf=st.floats(0.0, 1e6), delay=st.floats(0.0, 0.3), push=st.floats(0.001, 0.05),
       observer=st.sampled_from([None, 50.0, 200.0]), axes=st.sampled_from([1, 3]), seed=st.integers(0, 99))
@settings(max_examples=25)
def test_a_master_at_rest_that_no_hand_has_held_is_never_moved(
    kf: float, delay: float, push: float, observer: float | None, axes: int, seed: int
) -> None:
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


def test_direct_reflection_would_have_moved_it() -> None:
    scene = Scene(
        law=PFRA(alpha=0.01), master=MassDamper(mass=0.1), slave=MassDamper(mass=0.3), duration=0.5,
        environment=Wall(k=1e4), start_s=0.01, link=Delay(0.05),
    )
    assert run(scene).trace["x_m"].any()


def test_a_hand_that_rests_is_not_moved_either() -> None:
    scene = Scene(
        law=PFRA(kf=10.0), master=MassDamper(mass=0.1), slave=MassDamper(mass=0.3), duration=0.5, start_s=0.02,
        hand=Grip(mass=0.3, k=200.0, d=5.0, reference=Rest()), environment=Wall(k=1e4), link=Delay(0.05),
        observer=None,
    )
    assert not run(scene).trace["x_m"].any()


def test_in_a_whole_run_the_reflection_keeps_to_the_observed_hand() -> None:
    # In a light contact where the hand speeds up: there it pushes, and has something to resist with.
    scene = load_scene("canonical", law=PFRA(kf=2.0), wall=-0.03, duration=3.0)
    trace = run(scene).trace
    f_m, f_h_hat = trace["f_m"], trace["f_h_hat"]
    assert np.abs(f_m).max() > 1.0
    assert (f_m * f_h_hat >= 0.0).all()
    assert (np.abs(f_m) <= np.abs(f_h_hat)).all()


# After letting go


def let_go(L: float, f_env: float, f_h_hat: float, *, body: MassDamper, speed: float = 0.0,
           dt: float = 1e-3) -> tuple[float, float, float]:
    """Impulse of the reflection (N s), integral of |f_h_hat| (N s), and how far the master went (m).

    Nobody holds the master any more; the observer still remembers f_h_hat, and f_env stays on.
    """
    law, plant = PFRA(), free_space(body, dt).c
    c = coefficients(L, body.mass, body.damping, dt)
    x, v, f_m, impulse, memory = 0.0, speed, 0.0, 0.0, 0.0
    for _ in range(5000):
        f_m = reflected(law, (f_env,), (f_h_hat,))[0]
        impulse += dt * abs(f_m)
        memory += dt * abs(f_h_hat)
        before = v
        x, v, _ = move_free(plant, x, v, -f_m)
        f_h_hat = observe(c, f_h_hat, before, v, f_m)
    return impulse, memory, x


@given(L=st.floats(10.0, 500.0), f_env=st.floats(0.1, 50.0), f_h_hat=st.floats(0.1, 50.0),
       mass=st.floats(0.02, 2.0), damping=st.floats(0.0, 5.0), speed=st.floats(-1.0, 1.0))
@settings(max_examples=20)
def test_after_letting_go_the_impulse_is_at_most_what_the_observer_still_remembers(
    L: float, f_env: float, f_h_hat: float, mass: float, damping: float, speed: float
) -> None:
    impulse, memory, _ = let_go(L, f_env, f_h_hat, body=MassDamper(mass=mass, damping=damping), speed=speed)
    assert impulse <= memory * (1.0 + 1e-12)
    assert memory == pytest.approx(f_h_hat * 1e-3 / (1.0 - exp(-L * 1e-3)), rel=1e-6)


def test_a_master_that_no_hand_holds_was_said_never_to_move_and_did_after_letting_go() -> None:
    """At rest it stays while f_h_hat is 0; let go at 5 N it goes as far as the impulse over b, less with a larger L."""
    body = MassDamper(mass=0.1, damping=0.5)
    assert let_go(50.0, 5.0, 0.0, body=body) == (0.0, 0.0, 0.0)
    went = []
    for L in (50.0, 200.0):
        for f_env in (5.0, 5e3):
            impulse, memory, x = let_go(L, f_env, 5.0, body=body)
            assert 0.0 < impulse <= memory * (1.0 + 1e-12)
            assert 1e-3 < abs(x) <= memory / body.damping * (1.0 + 1e-9)
            assert memory == pytest.approx(5.0 * 1e-3 / (1.0 - exp(-L * 1e-3)), rel=1e-9)
        went.append(abs(x))
    assert went[1] < 0.3 * went[0]


def test_with_a_force_sensor_a_master_that_is_let_go_coasts_as_if_there_were_no_reflection() -> None:
    sent = [reflected(PFRA(kf=1e6), (f_env,), (0.0,))[0] for f_env in (5.0, -5.0)]
    assert sent == [0.0, 0.0]


@pytest.mark.parametrize("L", [50.0, 200.0])
def test_a_faster_observer_forgets_sooner_and_the_master_goes_less_far(L: float) -> None:
    """Held against f_env = 5 N until it is let go: m x'' + b x' = -5 exp(-L t), which ends at x = -5/(b L)."""
    body, dt = MassDamper(mass=0.1, damping=0.5), 1e-3
    impulse, memory, x = let_go(L, 5.0, 5.0, body=body, dt=dt)
    assert impulse == pytest.approx(memory, rel=1e-12)
    assert x == pytest.approx(-impulse / body.damping, rel=1e-6)
    assert impulse == pytest.approx(5.0 / L, rel=0.6 * L * dt)
