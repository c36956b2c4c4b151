"""Model-mediated: the slave's estimate, the energy that the master's rendering gives, contact that begins and ends."""

from __future__ import annotations

from dataclasses import replace
from math import cos, pi, sin
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from teleop import At, ModelMediated, load_scene, run
from teleop.analysis.stability.assess import stability
from teleop.law import start_at
from teleop.laws.model_mediated import MOST, P_C, P_K, Back, Forth, ModelMediatedMaster, ModelMediatedSlave

LAW = ModelMediated()


def at(x: float, *, v: float = 0.0, f: float = 0.0, f_held: float = 0.0, dx: float = 0.0) -> At:
    return At(x, v, f, f_held, dx, True, 0.0, 1e-3, 1e-3, 1.0)


def estimated(samples: Any, law: ModelMediated = LAW) -> tuple[ModelMediatedSlave, Back]:
    """The slave's state, and what it sends, after samples (x, f_env)."""
    s, _ = law.slave_start(start_at(0.0, 0.0, 0.0, 1e-3))
    sent = Back(0.0, 0.0, 0.0)
    for x, f in samples:
        _, sent, s = law.slave(s, at(x, f=f), Forth(x, 0.0))
    return s, sent


def stirred(n: int) -> list[tuple[float, float]]:
    """The law book's input: a wall of 1500 N/m at 0.0301 m, stirred, with an error of 0.02 N."""
    xs = [0.031 + 0.0008 * sin(2.0 * pi * 4.0 * k / 1000.0) for k in range(n)]
    return [(x, 1500.0 * (x - 0.0301) + 0.02 * cos(2.0 * pi * 37.0 * k / 1000.0)) for k, x in enumerate(xs)]


class TestTheEstimate:
    @pytest.mark.parametrize(("n", "k", "x_0"), [(20, 286.149337, 0.02549877), (2000, 1499.867649, 0.03009994)])
    def test_has_the_numbers_of_the_law_book(self, n: int, k: float, x_0: float) -> None:
        _, sent = estimated(stirred(n))
        assert (round(sent.k, 6), round(sent.x_0, 8), sent.side) == (k, x_0, 1.0)

    @pytest.mark.parametrize("n", [3, 400])
    def test_is_the_weighted_least_squares_of_all_samples_since_the_touch(self, n: int) -> None:
        """The sum of lambda^(n - i) (f_i - a_i theta)^2, and lambda^n theta P0^-1 theta, by one matrix."""
        samples = np.array(stirred(n))
        a = np.column_stack([samples[:, 0] - samples[0, 0], np.ones(n)])
        weight = 0.998 ** np.arange(n - 1, -1, -1.0)
        normal = a.T @ (weight[:, None] * a) + 0.998**n * np.diag([1e-6, 1e-2])
        k, c = np.linalg.solve(normal, a.T @ (weight * samples[:, 1]))
        s, _ = estimated(stirred(n))
        assert (s.k, s.c) == (pytest.approx(k, rel=1e-8), pytest.approx(c, rel=1e-8))

    def test_a_steady_push_for_half_a_minute_leaves_it_bounded_and_ready(self) -> None:
        """Nothing moves, so P would grow by 1/0.998 a sample. The wall then moves 1 mm: the estimate follows."""
        still = [(0.031, 1.5)] * 30_000
        s, sent = estimated(still)
        assert s.p11 <= MOST * P_K * (1.0 + 1e-12)
        assert s.p22 <= MOST * P_C
        assert s.p11 * s.p22 - s.p12 * s.p12 >= 0.0
        assert all(map(np.isfinite, [*s, *sent]))
        _, after = estimated([*still, *[(x + 0.001, f) for x, f in stirred(4000)]])
        assert (after.k, after.x_0) == (pytest.approx(1500.0, rel=1e-2), pytest.approx(0.0311, abs=1e-5))

    @given(side=st.sampled_from([1.0, -1.0]), place=st.floats(-0.5, 0.5), k=st.floats(100.0, 1e4))
    @settings(max_examples=8)
    def test_finds_a_wall_on_either_side(self, side: float, place: float, k: float) -> None:
        depths = [0.002 + 0.001 * sin(0.05 * i) for i in range(900)]
        _, sent = estimated([(place + side * depth, side * k * depth) for depth in depths])
        assert sent.side == side
        assert sent.k == pytest.approx(k, rel=5e-3)
        assert sent.x_0 == pytest.approx(place, abs=1e-5)

    def test_an_estimate_that_went_wrong_is_not_clipped_in_its_state_and_comes_back(self) -> None:
        """A force that falls as the slave goes in has a negative k; with k cut off at 0 in the state x_0 ran away."""
        wrong = [(0.031 + 0.001 * sin(0.05 * i), 2.0 - 800.0 * 0.001 * sin(0.05 * i)) for i in range(1000)]
        s, sent = estimated(wrong)
        assert s.k == pytest.approx(-800.0, rel=1e-2)
        assert sent.k == 0.0
        _, after = estimated([*wrong, *stirred(4000)])
        assert (after.k, after.x_0) == (pytest.approx(1500.0, rel=2e-3), pytest.approx(0.0301, abs=1e-5))


class TestContact:
    def test_before_the_first_one_there_is_no_model_and_then_the_assumed_stiffness(self) -> None:
        _, sent = estimated([(0.001 * i, 0.0) for i in range(50)])
        assert (sent.k, sent.side) == (0.0, 0.0)
        f_m, _, s = LAW.master(ModelMediatedMaster(0.0, 0.0), at(0.05, v=0.3), sent)
        assert (f_m, s) == (LAW.B_m * 0.3, ModelMediatedMaster(0.0, 0.0))
        _, sent = estimated([(0.031, 0.3)], ModelMediated(k_0=800.0))
        assert sent.k == pytest.approx(800.0)
        assert sent.x_0 == pytest.approx(0.031 - 0.3 / 800.0, abs=1e-5)

    def test_after_it_the_model_stays_and_the_next_touch_begins_at_its_own_place(self) -> None:
        outside = [(0.02, 0.0)] * 500
        s, sent = estimated([*stirred(2000), *outside])
        assert (round(sent.k, 6), round(sent.x_0, 8)) == (1499.867649, 0.03009994)
        assert s.touching == 0.0
        again, _ = estimated([*stirred(2000), *outside, (0.0255, 0.3)])
        assert (again.touching, again.x_c) == (1.0, 0.0255)

    def test_a_wall_that_went_away_is_forgotten_where_the_slave_passes_its_place(self) -> None:
        _, sent = estimated([*stirred(2000), *[(0.031 + 0.001 * sin(0.05 * i), 0.0) for i in range(3000)]])
        assert sent.k * max(0.032 - sent.x_0, 0.0) < 2.0 * LAW.touch

class TestTheMasters:
    def test_force_is_that_of_the_model_as_far_as_spring_and_tank_have_the_energy(self) -> None:
        f_m, _, s = LAW.master(ModelMediatedMaster(1.0, 0.0), at(0.033, v=0.1), Back(2000.0, 0.03, 1.0))
        assert f_m == pytest.approx(2000.0 * 0.003 + LAW.B_m * 0.1)
        assert s.k == 2000.0
        assert s.stored == pytest.approx(0.5 * 2000.0 * 0.003**2 + LAW.E_max)  # what is above the tank's is dropped
        # k' = min(k, 2 (V + tank)/p^2): 4 mJ at 3 mm is 888.9 N/m.
        f_m, _, s = LAW.master(ModelMediatedMaster(0.004, 100.0), at(0.033), Back(5000.0, 0.03, 1.0))
        assert s.k == pytest.approx(2.0 * 0.004 / 0.003**2)
        assert f_m == pytest.approx(s.k * 0.003)
        assert 0.5 * s.k * 0.003**2 == pytest.approx(s.stored)

    @given(data=st.data())
    @settings(max_examples=15)
    def test_port_gives_no_more_than_it_took_but_the_error_of_one_held_tick(self, data: st.DataObject) -> None:
        """Any velocities at the ticks, linear between them, and another model at each: the work that the held force
        takes stays above -(k' dx^2/2 + B_m v^2 dt/4) of the worst tick."""
        law = ModelMediated(B_m=data.draw(st.floats(0.0, 5.0)), E_max=data.draw(st.floats(0.0, 1.0)))
        dice = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
        smooth = data.draw(st.floats(0.0, 0.99))
        s, _ = law.master_start(start_at(0.0, 0.0, 0.0, 1e-3))
        x = v = f = dx = work = 0.0
        slack = 1e-12
        for _ in range(400):
            rx = Back(1e4 * dice.random(), x + 0.02 * dice.normal(), float(dice.integers(-1, 2)))
            f, _, s = law.master(s, at(x, v=v, f_held=f, dx=dx), rx)
            assert s.stored >= -slack
            after = smooth * v + (1.0 - smooth) * dice.normal()
            dx = 0.5e-3 * (v + after)
            slack = max(slack, 0.5 * s.k * dx * dx + 0.25e-3 * law.B_m * after * after)
            work, x, v = work + f * dx, x + dx, after
            assert work >= -slack


def test_scenes_with_a_delay_are_bounded_and_the_master_never_feeds_the_hand() -> None:
    """Where waves feel a spring of b/T, the model is felt at once: a hard wall over 50 ms, touched twice a second."""
    for scene in ("canonical", "soft_tissue", "beating_heart"):
        got = run(replace(load_scene(scene, law=LAW, delay=0.05), duration=2.0))
        work = np.cumsum(got.trace["f_m"][:-1] * np.diff(got.trace["x_m"]))
        assert got.status == "ok"
        assert work.min() > -1e-4
    assert run(replace(load_scene("canonical", law=LAW, delay=0.05), duration=2.0)).trace["f_m"].max() > 10.0


def test_the_analyses_take_the_model_as_it_is_assumed() -> None:
    law = ModelMediated(k_0=700.0, B_m=2.0)
    found = stability(load_scene("soft_tissue", law=law, delay=0.2))
    assert (found.verdict, found.critical_round_trip) == ("stable", None)  # nothing that comes back moves the master
    held = law.linear()
    here = start_at(0.01, 0.0, 0.0, 1e-3)
    assert held.master((), here._replace(v=0.5), held.master_start(here)[1])[0] == 700.0 * 0.01 + 2.0 * 0.5
    assert held.slave((), here, Forth(0.03, 0.2))[0] == LAW.slave(LAW.slave_start(here)[0], here, Forth(0.03, 0.2))[0]
