"""The matrices of a linear scene are the tick itself; what is not linear is refused, with what to do instead."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pytest

from channel.link import parse_link
from master.hand import Grip, Rest
from slave import Tissue, Wall
from teleop import PFRA, At, Direct, Fixed, MassDamper, Refused, Scene, Watchdog, Wave, load_scene, run
from teleop.analysis.models.linear import linear_scene, link_ticks, matrix
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

    def test_is_not_a_wall_without_force_nor_pfra_that_reflects_all(self) -> None:
        linear_scene(scene_of(PFRA(alpha=1.0), environment=Wall(k=0.0)))

    def test_is_seen_however_far_out_or_near_it_bends(self) -> None:
        bent: list[Any] = [
            lambda v: [abs(v[0]), v[1]], lambda v: [max(v[0], -1e5), v[1]],
            lambda v: [v[0] if abs(v[0]) > 1e-5 else 0.0, v[1]], lambda v: [v[0] * v[1]], lambda v: [1.0 / v[0]],
            lambda _: [float("nan")]]
        assert [matrix(each, 2) for each in bent] == [None] * len(bent)

    def test_leaves_an_affine_function_its_matrix(self) -> None:
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
