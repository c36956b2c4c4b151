"""PFRA's weights of what pushes, pulls and acts across the hand, and the rest that the master's damping can take."""

from __future__ import annotations

from dataclasses import replace
from functools import reduce
from itertools import pairwise
from operator import add

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from channel.delay import Delay
from master.hand import Grip, Rest
from slave.tissue import Tissue
from slave.wall import Wall
from teleop import At, MassDamper, Scene, run
from teleop.law.offers import Facts
from teleop.laws.pfra import EPS, PFRA, Back, PFRASums
from teleop.physics.plant import free_space, move_free

Vector = tuple[float, ...]
NAN = float("nan")

force = st.floats(-1e3, 1e3).map(lambda value: round(value, 9))
vectors = st.integers(1, 3).flatmap(lambda n: st.tuples(*[st.tuples(*[force] * n) for _ in range(3)]))
weight = st.floats(0.0, 1.0)


def reflected(law: PFRA, f_env: Vector, f_h: Vector, v: Vector | None = None) -> np.ndarray:
    """The force on the hand, over all axes, as a tick computes it."""
    speeds = v or (0.0,) * len(f_h)
    ats = [At(0.0, speed, f, NAN, NAN, True, NAN, 1e-3) for f, speed in zip(f_h, speeds, strict=True)]
    rxs = [Back(f) for f in f_env]
    sums = [law.master_sums((), at, rx) for at, rx in zip(ats, rxs, strict=True)]
    over = PFRASums(*(reduce(add, values) for values in zip(*sums, strict=True)))
    return np.array([law.master((), at, rx, over)[0] for at, rx in zip(ats, rxs, strict=True)])


@given(forces=vectors, kf=st.floats(0.0, 1e3), alpha=weight)
def test_the_defaults_are_the_law_that_had_no_other_weights_bit_for_bit(
    forces: tuple[Vector, Vector, Vector], kf: float, alpha: float
) -> None:
    f_env, f_h, v = forces
    eh = reduce(add, [kf * e * h for e, h in zip(f_env, f_h, strict=True)])
    share = max(0.0, min(eh / max(reduce(add, [h * h for h in f_h]), EPS), 1.0))
    old = [alpha * (kf * e) + (1.0 - alpha) * (share * h) for e, h in zip(f_env, f_h, strict=True)]
    assert reflected(PFRA(alpha=alpha, kf=kf), f_env, f_h, v).tolist() == old


@given(forces=vectors, push=weight, pull=weight, across=weight, alpha=weight)
def test_each_part_beside_the_hands_has_its_own_weight(
    forces: tuple[Vector, Vector, Vector], push: float, pull: float, across: float, alpha: float
) -> None:
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


@given(forces=vectors)
def test_all_parts_in_full_are_direct_reflection(forces: tuple[Vector, Vector, Vector]) -> None:
    f_env, f_h, _ = forces
    size = max(map(abs, f_env))
    full = PFRA(push=1.0, pull=1.0, across=1.0)
    assert reflected(full, f_env, f_h) == pytest.approx(np.array(f_env), rel=1e-9, abs=1e-9 * size)


@given(forces=vectors, alpha=weight, across=weight, rest_gain=st.floats(0.0, 50.0))
def test_the_rest_that_is_felt_is_at_most_rest_gain_times_the_speed_and_in_its_own_direction(
    forces: tuple[Vector, Vector, Vector], alpha: float, across: float, rest_gain: float
) -> None:
    f_env, f_h, v = forces
    without = PFRA(alpha=alpha, across=across)
    bare = reflected(without, f_env, f_h, v)
    rest = reflected(replace(without, rest_gain=1e9), f_env, f_h, tuple(x + 1.0 for x in v)) - bare  # all of it
    felt = reflected(replace(without, rest_gain=rest_gain), f_env, f_h, v) - bare
    size, most = np.linalg.norm(rest), rest_gain * np.linalg.norm(v)
    grain = 1e-6 * (1.0 + max(map(abs, f_env + f_h)))
    assert np.linalg.norm(felt) <= most + grain
    assert np.linalg.norm(felt) == pytest.approx(min(size, most), abs=grain)
    assert felt @ rest >= -grain * (1.0 + size)


def thrown(law: PFRA, damping: float, axes: int = 1) -> float:
    """The most that a master goes whose hand rests, the slave thrown out of a wall and tissue 50 ms away."""
    hand = Grip(mass=0.1, k=2.0, d=0.1, reference=Rest())
    scene = Scene(
        law=law, master=MassDamper(mass=0.1, damping=damping), slave=MassDamper(mass=0.3, damping=0.1), duration=6.0,
        environment=(Wall(k=1e4, d=1.0), Tissue(k=2e3, d=0.0, at=0.02), None)[:axes], axes=axes, observer=None,
        start_s=(0.02, -0.02, 0.0)[:axes], link=Delay(0.05), hand=hand, x_limit=10.0,
    )
    return float(np.abs(run(scene).trace["x_m"]).max())


@pytest.mark.parametrize("axes", [1, 3])
def test_a_master_at_rest_stays_at_rest_whatever_is_lent_of_the_rest(axes: int) -> None:
    assert thrown(PFRA(rest_gain=100.0), 0.5, axes) == 0.0
    assert thrown(PFRA(across=0.1), 0.5, axes) > 1e-3  # of a hand that rests all is across


def speeds(law: PFRA, body: MassDamper, pushes: list[float], speed: float = 1.0) -> list[float]:
    """Speeds of a master that no hand holds, tick by tick, under reflections of any force."""
    plant, x, v, found = free_space(body, 1e-3).c, 0.0, speed, [speed]
    for push in pushes:
        x, v, _ = move_free(plant, x, v, -float(reflected(law, (push,), (0.0,), (v,))[0]))
        found.append(abs(v))
    return found


@given(pushes=st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=50), kf=st.floats(0.0, 1e3),
       mass=st.floats(0.02, 2.0), damping=st.floats(0.01, 5.0))
def test_a_rest_gain_below_the_damping_makes_no_motion_grow_whatever_is_reflected(
    pushes: list[float], kf: float, mass: float, damping: float
) -> None:
    body = MassDamper(mass=mass, damping=damping)
    found = speeds(PFRA(kf=kf, rest_gain=0.99 * damping), body, pushes)
    assert all(after <= before * (1.0 + 1e-12) for before, after in pairwise(found))


def test_one_above_it_does() -> None:
    found = speeds(PFRA(rest_gain=1.0), MassDamper(mass=0.1, damping=0.5), [-100.0] * 500)
    assert found[-1] > 5.0 * found[0]


@pytest.mark.parametrize(("rest_gain", "damping", "told"), [
    (0.5, 0.5, False), (0.51, 0.5, True), (0.1, 0.0, True), (9.0, NAN, False)])
def test_a_run_says_where_the_rest_is_more_than_the_damping(rest_gain: float, damping: float, told: bool) -> None:
    of = Facts(1e-3, 1, 0.1, damping, 0.5, 1.0, None, None, False, "zero", 1e-3)
    notes = PFRA(rest_gain=rest_gain).conditions(of)
    assert bool(notes) is told
    assert not told or f"--set law.rest_gain={damping:g} is the most" in notes[0]
