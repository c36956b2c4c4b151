"""The matrices of a linear scene are the tick itself, and the count of roots is that of the eigenvalues."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from itertools import pairwise
from math import nextafter
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pytest

import teleop.analysis.models.roots
from channel.link import parse_link
from master.hand import Grip, Rest
from slave import Tissue, Wall
from teleop import PFRA, At, Direct, Fixed, MassDamper, Refused, Scene, Watchdog, Wave, load_scene, run
from teleop.analysis.models.linear import LinearScene, StateSpace, linear_scene, link_ticks, matrix
from teleop.analysis.models.loop import Loop, circle, open_poles, sampled_loop, transfer
from teleop.analysis.models.margins import critical_round_trip, gain_margin, integrators
from teleop.analysis.models.roots import dense, dominant, greatest
from teleop.law import start_at
from teleop.scene.playout import Hold as Repeat


class Everything(NamedTuple):
    x: float
    force: float


class Memory(NamedTuple):
    one: float
    two: float


@dataclass(frozen=True, kw_only=True)
class Nosy:
    """A linear law that reads all there is to read, and remembers."""

    claims: ClassVar[dict[str, str]] = {}

    def master_start(self, at: At) -> tuple[Memory, Everything]:
        return Memory(at.x, 0.0), Everything(at.x, 0.0)

    slave_start = master_start

    def master(self, s: Memory, at: At, rx: Everything) -> tuple[float, Everything, Memory]:
        late = at.age if at.age < 1.0 else at.dt
        push = 20.0 * (at.x - rx.x) + 3.0 * at.v + 0.1 * at.f + 0.2 * at.f_held + 2.0 * at.dx / at.dt
        push += 5e3 * late * at.x
        return push + 0.5 * s.two, Everything(at.x, push - s.one), Memory(0.9 * s.one + at.x, 0.5 * s.two + rx.force)

    slave = master


def scene_of(law: Any, **changes: Any) -> Scene:
    scene = Scene(
        law=law, master=MassDamper(mass=0.1, damping=0.5), slave=MassDamper(mass=0.5, damping=1.0),
        hand=Grip(mass=0.4, k=200.0, d=5.0, reference=Rest()), environment=Tissue(k=200.0, d=2.0),
        link=parse_link("delay(0.004) ; delay(0.0065)"), duration=0.4, start_m=0.01, start_s=0.02,
    )
    return replace(scene, **changes)


def by_matrices(scene: Scene) -> dict[str, Any]:
    """Positions and forces of a run from rest at its start, by nothing but the matrices and two queues."""
    linear, axes, law = linear_scene(scene), scene.axes, scene.law
    rows: dict[str, list[Any]] = {"x_m": [], "f_m": [], "x_s": [], "f_s": []}
    queues, states = {}, {}
    for e, start, at, delay in (("m", law.master_start, scene.vector("start_m", scene.start_m), linear.back),
                                ("s", law.slave_start, scene.vector("start_s", scene.start_s), linear.forth)):
        end = linear.master if e == "m" else linear.slave
        begun = [start(start_at(x, 0.0, 0.0, scene.dt)) for x in at]
        law_state = [number for s, _ in begun for number in s]
        motion = [number for x in at for number in (x, 0.0, 0.0)]
        size = (len(end.A) - len(motion) - len(law_state)) // axes
        extra = {0: [], 1: list(at), 2: [0.0, 0.0] * axes, 3: [*at, *[0.0, 0.0] * axes]}[size]
        states[e] = np.array([*motion, *extra, *law_state])
        queues[e] = deque([np.array([number for _, rx in begun for number in rx])] * delay)
    for _ in range(scene.ticks):
        sent = {}
        for e, end in (("m", linear.master), ("s", linear.slave)):
            state, rx = states[e], queues[e].popleft()
            rows[f"x_{e}"].append(state[0:3 * axes:3])
            sent[e] = end.C @ state + end.D @ rx
            states[e] = end.A @ state + end.B @ rx
            rows[f"f_{e}"].append(states[e][2:3 * axes:3])
        queues["s"].append(sent["m"])
        queues["m"].append(sent["s"])
    return {name: np.array(row).squeeze() for name, row in rows.items()}


class TestTheMatrices:
    @pytest.mark.parametrize("law", [
        Wave(), Nosy(), *(pytest.param(law, marks=pytest.mark.full) for law in (Direct(), PFRA(alpha=1.0)))])
    def test_run_as_the_tick_runs(self, law: Any) -> None:
        every: list[dict[str, Any]] = [
            {}, {"observer": None}, {"hand": None}, {"environment": None}, {"link": None}, {"watchdog": Watchdog()},
            {"axes": 3, "start_m": (0.01, 0.0, -0.03)}, {"energy": True}, {"dt": 1e-4, "duration": 0.05}]
        for changes in every:
            scene = scene_of(law, playout=Repeat(), **{"duration": 0.1, **changes})
            scene = replace(scene, link=scene.link and parse_link("delay(0)")) if type(law) is Nosy else scene
            trace, ours = run(scene).trace, by_matrices(scene)
            for name, column in ours.items():
                size = np.abs(trace[name]).max()
                np.testing.assert_allclose(column, trace[name], rtol=0.0, atol=1e-9 * size, err_msg=f"{name}{changes}")

    def test_know_how_old_a_message_is(self) -> None:
        found = linear_scene(scene_of(Nosy(), hand=None, observer=None))
        assert (found.forth, found.back) == (4, 7)
        for end, age in ((found.master, 0.007), (found.slave, 0.004)):
            touched = 0.1 * (200.0 if end is found.slave else 0.0)
            assert end.A[2, 0] == pytest.approx(20.0 + touched + 2.0 / 1e-3 + 5e3 * age)

    def test_do_not_depend_on_where_things_rest(self) -> None:
        here = linear_scene(scene_of(Wave()))
        there = linear_scene(scene_of(Wave(), environment=Tissue(k=200.0, d=2.0, at=0.3)))
        for one, other in zip(here.slave, there.slave, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-11)


class TestWhatIsNotLinear:
    def test_is_refused_wherever_it_stands(self) -> None:
        jitter = parse_link("delay(0.01) | uniform(0.01)")
        every: list[tuple[str, dict[str, Any]]] = [
            ("Wall", {"environment": Wall(k=1e3, at=5e3)}), ("Wall", {"environment": (None, Wall(k=1e3)), "axes": 2}),
            ("same number of ticks", {"link": jitter}),
            ("same number of ticks", {"link": jitter, "playout": Fixed(0.005)}),
        ]
        for words, changes in every:
            with pytest.raises(Refused, match=words):
                linear_scene(scene_of(Direct(), **changes))

    def test_is_seen_however_far_out_or_near_it_bends_and_an_affine_function_has_its_matrix(self) -> None:
        linear_scene(scene_of(PFRA(alpha=1.0), environment=Wall(k=0.0)))  # a wall without force, and all is reflected
        bent: list[Any] = [
            lambda v: [abs(v[0]), v[1]], lambda v: [max(v[0], -1e5), v[1]],
            lambda v: [v[0] if abs(v[0]) > 1e-5 else 0.0, v[1]], lambda v: [v[0] * v[1]], lambda v: [1.0 / v[0]],
            lambda _: [float("nan")]]
        assert [matrix(each, 2) for each in bent] == [None] * len(bent)
        found = matrix(lambda v: [3.0 * v[0] - 1e6 * v[1] + 7.0, 1e-7 * v[1]], 2)
        np.testing.assert_allclose(found, [[3.0, -1e6], [0.0, 1e-7]], rtol=1e-9)


def test_the_delay_is_counted_in_whole_ticks_from_sending_to_use() -> None:
    for link, playout, ticks in (
        ("none", None, (1, 1)), ("delay(0)", None, (1, 1)), ("delay(0.0042) ; delay(0.005)", None, (5, 5)),
        ("delay(0.3) ; delay(2.5)", None, (300, 2500)), ("delay(0.01) | uniform(0.01)", Fixed(0.03), (30, 30)),
        ("delay(0.01)", Fixed(0.0101), (11, 11)),
    ):
        scene = load_scene("soft_tissue", link=link)
        assert link_ticks(scene if playout is None else replace(scene, playout=playout)) == ticks, link


def gain_of(gain: float) -> StateSpace:
    return StateSpace(np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1)), np.array([[gain]]))


def some(seeds: list[int], *more: int) -> Any:
    """Seeds of the ordinary suite, and more of them with `-m full`."""
    return pytest.mark.parametrize("seed", [*seeds, *(pytest.param(seed, marks=pytest.mark.full) for seed in more)])


def random_end(dice: np.random.Generator, states: int, into: int, out: int, radius: float) -> StateSpace:
    A = dice.normal(size=(states, states))
    A *= radius / np.abs(np.linalg.eigvals(A)).max()
    return StateSpace(A, dice.normal(size=(states, into)), dice.normal(size=(out, states)) * 0.2,
                      dice.normal(size=(out, into)) * 0.4)


def random_loop(seed: int) -> LinearScene:
    """Ends of 1 to 5 states, stable or not, 1 to 3 fields each way, up to 40 ticks of delay."""
    dice = np.random.default_rng(seed)
    forth, back = dice.integers(1, 4, 2)
    radius = dice.choice([0.5, 0.98, 0.9999, 1.02], 2)
    return LinearScene(random_end(dice, int(dice.integers(1, 6)), int(back), int(forth), radius[0]),
                  random_end(dice, int(dice.integers(1, 6)), int(forth), int(back), radius[1]),
                  int(dice.integers(1, 20)), int(dice.integers(1, 20)), 1e-3)


def roots_of(linear: LinearScene) -> Any:
    """Independently: both delay lines in full, forth and back."""
    m, s = linear.master, linear.slave
    sizes = [len(m.A), len(s.A), *[len(m.C)] * linear.forth, *[len(s.C)] * linear.back]
    at = np.concatenate([[0], np.cumsum(sizes)])
    block = [slice(a, b) for a, b in pairwise(at)]
    whole = np.zeros((at[-1], at[-1]))
    first_forth, first_back = 2, 2 + linear.forth
    heard_m, heard_s = block[-1], block[first_back - 1]
    whole[block[0], block[0]], whole[block[0], heard_m] = m.A, m.B
    whole[block[1], block[1]], whole[block[1], heard_s] = s.A, s.B
    whole[block[first_forth], block[0]] = m.C
    whole[block[first_forth], heard_m] += m.D
    whole[block[first_back], block[1]] = s.C
    whole[block[first_back], heard_s] += s.D
    for i in range(3, len(sizes)):
        if i != first_back:
            whole[block[i], block[i - 1]] += np.eye(sizes[i])
    return np.linalg.eigvals(whole)


class TestTheCount:
    @some([*range(8)], *range(8, 30))
    def test_is_that_of_the_eigenvalues_at_every_radius_and_gain(self, seed: int) -> None:
        linear = random_loop(seed)
        sizes = {gain: np.abs(roots_of(scaled(linear, gain))) for gain in (1.0, 0.05, 3.0)}
        for radius in (1.0, 0.9, 0.99, 1.003, 1.05):
            loop = sampled_loop(linear, radius)
            for gain, size in sizes.items():
                assert np.abs(size - radius).min() > 1e-9
                assert loop.outside(linear.round_trip, gain) == np.count_nonzero(size > radius), (gain, radius)

    def test_sees_a_resonance_far_narrower_than_its_first_samples(self) -> None:
        """It rings for billions of ticks, and beside it there is nothing; its peak is 3."""
        pole = (1.0 - 2e-10) * np.exp(1.2345j)
        A = np.array([[pole.real, pole.imag], [-pole.imag, pole.real]])
        for sign in (1.0, -1.0):
            end = StateSpace(A, np.array([[1.0], [0.0]]), sign * np.array([[1.2e-9, 0.0]]), np.zeros((1, 1)))
            for delay in (2, 3, 4, 5):
                linear = LinearScene(end, gain_of(1.0), 1, delay - 1, 1e-3)
                sizes = np.abs(np.linalg.eigvals(dense(linear)))
                assert sampled_loop(linear).outside(delay) == np.count_nonzero(sizes > 1.0 + 1e-11)

    @pytest.mark.parametrize("rise", [1e-3, 1e-5])
    def test_sees_a_peak_that_passes_1_between_two_samples(self, rise: float) -> None:
        """Then there are as many roots as the delay turns in the band that is above 1, and no more."""
        pole = 0.5 * np.exp(1.1j)
        A = np.array([[pole.real, pole.imag], [-pole.imag, pole.real]])
        end = StateSpace(A, np.array([[1.0], [0.0]]), np.array([[1.0, 0.0]]), np.zeros((1, 1)))
        theta = np.linspace(0.5, 1.5, 200_001)
        gain = transfer(end, np.exp(1j * theta))[:, 0, 0]
        top = np.abs(gain).max()
        linear = LinearScene(end._replace(C=end.C * (1.0 + rise) / top), gain_of(1.0), 1_000, 2_000, 1e-3)
        above = np.flatnonzero(np.abs(gain) * (1.0 + rise) / top > 1.0)
        psi = np.angle(gain[above[[0, -1]]]) - 3_000 * theta[above[[0, -1]]]
        turns = np.floor(psi / (2.0 * np.pi))
        assert turns[0] > turns[1]
        assert sampled_loop(linear).outside(3_000) == 2 * (turns[0] - turns[1])

    @pytest.mark.parametrize("states", [1, 2])
    def test_leaves_out_what_rests_and_counts_it_by_itself(self, states: int) -> None:
        """A free mass with damping (one root at 1) and without (two), beside a loop that is stable."""
        A = np.array([[1.0, 1e-3], [0.0, 1.0 if states == 2 else 0.99]])
        master = StateSpace(A, np.array([[0.0], [1e-3]]), np.array([[0.0, 0.0]]), np.ones((1, 1)))
        slave = StateSpace(np.array([[0.5]]), np.ones((1, 1)), np.array([[0.1]]), np.zeros((1, 1)))
        linear = LinearScene(master, slave, 3, 3, 1e-3)
        assert sampled_loop(linear).outside(6) == 0
        assert integrators(linear) == states

    def test_of_a_gain_on_its_own_is_the_delay_itself(self) -> None:
        """z^d = g has d roots of the same magnitude, all outside if g > 1."""
        for delay in (2, 7, 2_001):
            for gain, count in ((1.01, delay), (-1.01, delay), (0.99, 0), (-0.99, 0)):
                linear = LinearScene(gain_of(gain), gain_of(1.0), 1, delay - 1, 1e-3)
                assert sampled_loop(linear).outside(delay) == count


class TestTheMargins:
    @some([1, 5, 8, 26, 29, 37], *range(2, 5), 0, 6, 7, *range(9, 16))
    def test_put_a_root_on_the_unit_circle(self, seed: int) -> None:
        linear = random_loop(seed)
        margin = gain_margin(linear)
        stable = np.abs(roots_of(linear)).max() < 1.0
        if margin is None:
            assert stable or np.abs(roots_of(scaled(linear, 1e-6))).max() > 1.0
            return
        assert (margin > 1.0) == stable
        near = 1e-7 if stable else 1e-4  # a root that leaves at z = 1 is seen when it is 1e-9 out
        assert np.abs(roots_of(scaled(linear, margin * (1.0 - near)))).max() < 1.0
        assert np.abs(roots_of(scaled(linear, margin * (1.0 + near)))).max() > 1.0
        if stable:  # nothing happens on the way there
            assert all(np.abs(roots_of(scaled(linear, g))).max() < 1.0 for g in np.linspace(1.0, margin, 20)[:-1])

    @some([0, 1, 2, 3], *range(4, 12))
    def test_name_the_first_unstable_round_trip(self, seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
        linear = scaled(random_loop(seed), 0.3)
        counts: list[float] = []
        outside = Loop.outside
        monkeypatch.setattr(Loop, "outside", lambda loop, *args: counts.append(args[0]) or outside(loop, *args))
        critical = critical_round_trip(linear)
        assert len(counts) <= 3  # at 2 ticks, and on both sides of the answer
        most = 40 if critical is None else critical
        sizes = [np.abs(roots_of(linear._replace(forth=1, back=d - 1))).max() for d in range(2, most + 1)]
        assert [d for d, size in enumerate(sizes, 2) if size > 1.0] == ([] if critical is None else [critical])

    @some([2, 35], 0, 1, 3, 4, 5)
    def test_find_the_same_last_mode_by_either_way(self, seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
        linear = random_loop(seed)._replace(forth=40, back=30)
        roots = roots_of(linear)
        greatest = roots[np.abs(roots).argmax()]
        for most in (400, 0):
            monkeypatch.setattr(teleop.analysis.models.roots, "MOST_STATES", most)
            mode = dominant(linear, 0)
            assert abs(mode.z) == pytest.approx(abs(greatest), abs=1e-7)
            assert np.abs(roots - mode.z).min() < 1e-6


class TestTheRootsOfALongDelay:
    @some([0, 1, 2, 3], *range(4, 14))
    def test_have_the_dominant_one_whenever_the_count_has_one(self, seed: int) -> None:
        """Ends at random and 400 to 40,000 ticks; on every other seed the gain's peak is within 1e-6 to 0.1 of 1."""
        dice = np.random.default_rng(seed)
        delay = int(10.0 ** dice.uniform(2.6, 4.6))
        linear = random_loop(seed)._replace(forth=delay // 2, back=delay - delay // 2)
        linear = scaled(linear, 10.0 ** dice.uniform(-1.0, 1.0))
        if seed % 2:
            peak = np.exp(sampled_loop(linear).samples[2].real.max())
            linear = scaled(linear, (1.0 + 10.0 ** dice.uniform(-6.0, -1.0)) / peak)
        growing = sampled_loop(linear).outside(delay)
        mode = dominant(linear, integrators(linear))
        level = float(np.log(np.abs(mode.z)))
        assert (level > 0.0) == (growing > 0)
        near = 1e-4 * abs(level) + 3e-11
        assert sampled_loop(linear, np.exp(level + near)).outside(delay) == 0
        assert sampled_loop(linear, np.exp(level - near)).outside(delay) > 0
        if np.abs(open_poles(linear.master, linear.slave)).max() < 1.0:  # beside one that grows all is nearly singular
            assert least_singular(linear, mode.z) < 1e-8

    @some([103], 55, 72)
    def test_are_the_greatest_among_the_eigenvalues(self, seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(teleop.analysis.models.roots, "MOST_STATES", 0)
        linear = scaled(random_loop(seed)._replace(forth=50, back=72), 0.5)
        own = roots_of(linear)
        found = greatest(linear, 30)
        assert found.complete
        assert 28 <= len(found.z) <= 30
        sizes = np.sort(np.abs(own))[::-1][:len(found.z)]
        assert np.sort(np.abs(found.z))[::-1] == pytest.approx(sizes, abs=1e-7)
        assert np.abs(own[:, None] - found.z).min(axis=0).max() < 1e-7


def least_singular(linear: LinearScene, z: complex) -> float:
    """Of I - z^-d P_m(z) P_s(z) and of both ends' zI - A: 0 where z is a root."""
    loop = transfer(linear.master, np.array([z]))[0] @ transfer(linear.slave, np.array([z]))[0]
    each = [np.eye(len(loop)) - loop * np.exp(-linear.round_trip * np.log(z)),
            *(z * np.eye(len(end.A)) - end.A for end in (linear.master, linear.slave))]
    return float(min(np.linalg.svd(one)[1].min() / max(1.0, np.abs(one).max()) for one in each))


class TestAGainMarginOfWhatRests:
    @pytest.mark.parametrize("delay", [4, 700])
    def test_was_the_distance_of_the_curve_from_1(self, delay: int) -> None:
        """l(1) = 1: a root rests at z = 1 and leaves the unit circle with any more gain."""
        lag = StateSpace(np.array([[0.9]]), np.ones((1, 1)), np.array([[0.1]]), np.zeros((1, 1)))
        linear = LinearScene(lag, gain_of(1.0), 1, delay - 1, 1e-3)
        assert integrators(linear) == 1
        assert gain_margin(linear) == 1.0
        if delay < 100:  # of which the eigenvalues are quick
            assert np.abs(roots_of(scaled(linear, 1.0 + 1e-6))).max() > 1.0 + 1e-9

    def test_that_no_gain_moves_is_that_of_the_other_roots(self) -> None:
        """The same beside a free mass, whose position is not sent: 1/l is reached at half the gain."""
        free = np.array([[1.0, 1e-3], [0.0, 0.99]])
        A = np.block([[free, np.zeros((2, 1))], [np.zeros((1, 2)), np.array([[0.9]])]])
        master = StateSpace(A, np.array([[0.0], [1e-3], [1.0]]), np.array([[0.0, 0.0, 0.05]]), np.zeros((1, 1)))
        linear = LinearScene(master, gain_of(1.0), 2, 2, 1e-3)
        assert integrators(linear) == 1
        assert gain_margin(linear) == pytest.approx(2.0, abs=1e-3)


def scaled(linear: LinearScene, gain: float) -> LinearScene:
    return linear._replace(slave=linear.slave._replace(C=gain * linear.slave.C, D=gain * linear.slave.D))


def test_the_curve_keeps_outside_the_circle() -> None:
    for radius in (1.0, 1.5):
        curve = circle(radius, 1e-6)
        z = curve.point(np.linspace(0.0, curve.length, 1001))
        assert (np.abs(z) >= radius).all()
        assert z[0].imag == 0.0
        assert z[-1].real == pytest.approx(-radius)
        assert not curve.outside(np.array([nextafter(radius, 0.0) + 0j]))[0]
