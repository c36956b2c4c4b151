"""Eight scenes side by side give what each gives by itself: the same bits in every engine, whatever stands beside."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import pytest

from channel.link import parse_link
from slave.tissue import Tissue
from slave.wall import Wall
from teleop import At, Energy, Fixed, Integral, Scaled, Scene, load_scene
from teleop.laws.direct import Back, Direct, Forth
from teleop.laws.pfra import PFRA
from teleop.laws.virtual_wall import VirtualWall
from teleop.simulation.bodies import exact_bodies
from teleop.stages.device import Device
from teleop.stages.encoder import Encoder
from teleop.stages.force_cap import Cap
from teleop.stages.passivity_controller import PassivityController
from teleop.stages.velocity.backward_difference import BackwardDifference
from teleop.stages.watchdog import Watchdog
from teleop.sweeps.chunk import Job, work
from teleop.sweeps.kernels.engines import VECTOR, vector_kernel
from teleop.sweeps.kernels.kernel import Kernel, NotVectorised, available, figures, plain_kernel
from tests.teleop.sweeps.kernels.test_kernel import inputs

ROUGH = "delay(0.01) | uniform(0.01) | bernoulli(0.1) ; delay(0.02)"
MEASURES = ("x_err_rms", "x_err_max", "f_err_rms", "f_m_max", "f_env_max", "E_link_min", "E_port_end", "T_fwd_max")
ENGINES = ("plain", "scalar", "vector")


def assert_same_bits(scenes: list[Scene], seeds: list[int]) -> None:
    """A vector kernel of the first scene's structure gives each what plain Python gives it."""
    first = scenes[0]
    measures = sorted(available(first))
    lanes, alone = [make(first, exact_bodies(first), measures) for make in (vector_kernel, plain_kernel)]

    def rows(kernel: Kernel) -> list[Any]:
        return figures(kernel, [inputs(kernel, of, seed) for of, seed in zip(scenes, seeds, strict=True)])

    assert list(map(repr, rows(lanes))) == list(map(repr, rows(alone)))


def knobs_of(law: str, dice: random.Random, *, wild: bool) -> dict[str, object]:
    """Random knobs of the canonical scene; wild ones diverge now and then, early and late."""
    own = {"wave": {"law.b": dice.uniform(0.5, 20.0)},
           "direct": {"law.kf": dice.choice([0.2, 1.0, 40.0 if wild else 0.5])},
           "pfra": {"law.alpha": dice.random(), "law.kf": dice.choice([0.5, 1.0, 60.0 if wild else 1.0])}}[law]
    return {"law": law, **own, "law.K": dice.uniform(100.0, 5000.0), "law.B": dice.uniform(1.0, 40.0),
            "k_e": 10.0 ** dice.uniform(2.0, 6.0), "d_e": dice.choice([0.0, 1.0, 30.0]),
            "wall": dice.uniform(0.0, 0.04), "amplitude": dice.uniform(0.01, 0.1),
            "delay": dice.choice([0.0, 0.01, 0.03]), "x_limit": 0.5 if wild else 1e6}


LONG = pytest.mark.soak


@pytest.mark.parametrize(("law", "link"), [
    ("wave", None), ("wave", ROUGH), ("direct", ROUGH), ("pfra", ROUGH),
    pytest.param("direct", None, marks=LONG), pytest.param("pfra", None, marks=LONG),
], ids=lambda value: "constant delays" if value is None else "a link of random delays and losses" if "|" in value
    else value)
def test_engines_agree_on_random_scenes_of_every_law(law: str, link: str | None) -> None:
    """Among them runs that diverge at ticks of their own; with shared and with own schedules, paths and lags."""
    dice = random.Random(f"{law}{link}")
    rows = []
    for n in range(27):
        knobs = knobs_of(law, dice, wild=n % 2 == 0)
        if link is not None:
            del knobs["delay"]
            knobs["link"] = link
        rows.append((n, knobs, n % 5))
    done = {engine: work(Job("canonical", {"duration": 0.7}, rows, MEASURES, engine)) for engine in ENGINES}
    assert done["vector"].ran == {("vector", ""): 27}
    assert repr(done["plain"].rows) == repr(done["scalar"].rows) == repr(done["vector"].rows)
    if law != "wave":
        assert {row["status"] for row in done["vector"].rows} == {"ok", "diverged"}


QUEUES = (Integral(), Integral(0.005), Integral(0.05, settle=0.01, memory=0.5),
          Integral(settle=1.0, memory=0.0, ahead=0.0))


def waves_over_own_links(dice: random.Random, playouts: tuple[Any, ...], **more: Any) -> list[Any]:
    """Rows whose playouts have other numbers, each over a link of its own."""
    return [(n, {"playout": playouts[n % len(playouts)], "law.b": dice.uniform(0.5, 20.0),
                 "link": f"delay({0.001 * n}) | uniform(0.02) | bernoulli({0.05 * n}) ; delay(0.02) | bernoulli(0.3)",
                 **more}, n) for n in range(11)]


def assert_engines_agree(
        scene: str, fixed: dict[str, Any], rows: list[Any], engines: tuple[str, ...],
        measures: tuple[str, ...] = MEASURES) -> None:
    done = {engine: work(Job(scene, fixed, rows, measures, engine)) for engine in ("plain", *engines)}
    assert {engine: one.ran for engine, one in done.items()} == {engine: {(engine, ""): 11} for engine in done}
    assert {repr(one.rows) for one in done.values()} == {repr(done["plain"].rows)}
    assert len({row["x_err_rms"] for row in done["plain"].rows}) == 11


def test_lanes_may_differ_in_the_queues_that_they_keep() -> None:
    rows = waves_over_own_links(random.Random(4), QUEUES, law="wave")
    assert_engines_agree("canonical", {"duration": 0.7}, rows, ("scalar", "vector"))


@pytest.mark.soak
def test_waves_of_three_axes_have_lanes() -> None:
    rows = waves_over_own_links(random.Random(5), QUEUES)
    fixed = {"duration": 0.5, "law": "wave", "energy": False}
    assert_engines_agree("recorded_reach", fixed, rows, ("vector",), ("x_err_rms",))


@pytest.mark.soak
@pytest.mark.parametrize("playouts", [
    QUEUES, (Energy(),), (Scaled(0.1), Scaled(0.0)), tuple([Fixed(0.03 + 0.01 * n, Integral()) for n in range(5)]),
], ids=["integral", "energy", "scaled", "fixed"])
@pytest.mark.parametrize("scene", ["canonical", "recorded_reach"])
@pytest.mark.parametrize("left_out", [{}, {"left_out": 0.2}], ids=["every tick", "ticks left out"])
def test_every_playout_of_waves_has_the_same_bits_in_every_engine(
    playouts: tuple[Any, ...], scene: str, left_out: dict[str, float]
) -> None:
    rows = waves_over_own_links(random.Random(6), playouts, **left_out)
    assert_engines_agree(scene, {"duration": 0.5, "law": "wave", "energy": True}, rows, ("scalar", "vector"))


HARD = Wall(k=2e4, d=10.0, at=0.004)
SCENES = {
    "one-port law": ("virtual_wall", {}),
    "encoder, low-pass, late and slow force, cap, watchdog": ("canonical", {
        "law": PFRA(alpha=0.2), "cap": Cap(f_max=3.0, slew=500.0), "watchdog": Watchdog(timeout=0.02),
        "device_m": Device(encoder=Encoder(step=1e-4), velocity=BackwardDifference(), every=3, delay=2)}),
    "passivity controller": ("virtual_wall", {"passivity": PassivityController(cap=1.0)}),
    "three axes, walls and tissue, no link": ("canonical", {
        "law": PFRA(alpha=0.3), "axes": 3, "environment": (HARD, None, Tissue(k=200.0, d=1.0)), "link": None}),
}


@pytest.mark.parametrize("name", SCENES)
def test_what_else_a_scene_may_name_has_lanes(name: str) -> None:
    scene, parts = SCENES[name]
    of = replace(load_scene(scene), duration=0.3, **parts)
    scenes = [replace(of, master=replace(of.master, mass=0.05 + 0.02 * n)) for n in range(11)]
    assert_same_bits(scenes, [1] * 11)


NARROW: dict[str, Callable[[random.Random], float | None]] = {
    "slew": lambda dice: dice.choice([None, 300.0, 1e4]), "v_max": lambda dice: 10.0 ** dice.uniform(-4.0, 0.5),
    "power": lambda dice: 10.0 ** dice.uniform(-6.0, 0.0),
}
LIMITED: dict[str, tuple[str, dict[str, Any], list[str]]] = {
    "two ends": ("canonical", {"law": Direct(K=500.0, B=20.0), "energy": True, "link": parse_link(ROUGH)}, [*NARROW]),
    "three axes, encoders, estimators, late, watched": ("canonical", {
        "law": PFRA(alpha=0.5), "axes": 3, "environment": (HARD, None, Tissue(k=200.0, d=1.0)),
        "watchdog": Watchdog(timeout=0.015, settle=0.03), "link": parse_link(ROUGH),
        "device_m": Device(encoder=Encoder(step=1e-4), velocity=BackwardDifference(), delay=2),
        "device_s": Device(encoder=Encoder(step=1e-5))}, [*NARROW]),
    "one-port": ("virtual_wall", {"law": VirtualWall(K=8e3, at=0.01)}, ["power"]),
    "one-port, speed": ("virtual_wall", {"law": VirtualWall(K=8e3, at=0.01)}, ["v_max"]),
}


@pytest.mark.parametrize("name", LIMITED)
def test_velocity_caps_and_energy_budgets_have_lanes(name: str) -> None:
    """Of random limits, many so narrow that they act at most ticks."""
    dice = random.Random(name)
    scene, parts, named = LIMITED[name]
    of = replace(load_scene(scene), duration=0.5, **parts)
    scenes = [replace(of, cap=Cap(f_max=dice.uniform(0.5, 20.0), **{one: NARROW[one](dice) for one in named}))
              for _ in range(13)]
    assert_same_bits(scenes, [*range(13)])


def test_limits_are_swept_as_knobs_with_none_among_them() -> None:
    limits = [(None, None), *product((1e-3, 0.05, 1.0), (0.05, 0.1, 3.0))]
    rows = [(n, {"power": power, "v_max": v_max}, n) for n, (power, v_max) in enumerate(limits)]
    done = {engine: work(Job("hard_wall", {"duration": 3.0, "law": "direct"}, rows, MEASURES, engine))
            for engine in ("plain", "vector")}
    assert done["vector"].ran == {("vector", ""): 10}
    assert repr(done["plain"].rows) == repr(done["vector"].rows)
    assert len({row["x_err_rms"] for row in done["plain"].rows}) > 3


def test_lanes_whose_playout_and_hand_differ_stand_beside_each_other() -> None:
    of = replace(load_scene("jittery_wan"), duration=0.4)
    assert of.hand is not None
    paths = [load_scene("canonical", amplitude=0.01 * n).hand.reference for n in range(1, 4)]  # type: ignore[union-attr]
    scenes = [replace(of, hand=replace(of.hand, reference=paths[n % 3])) for n in range(9)]
    assert_same_bits(scenes, list(range(9)))


GAINS = (1.0, 2.0)


@dataclass(frozen=True, kw_only=True)
class Lists(Direct):
    def slave(self, s: Any, at: At, rx: Forth) -> Any:
        return sum([gain * rx.x for gain in GAINS]) - self.K * at.x - self.B * at.v, Back(at.f), s


@dataclass(frozen=True, kw_only=True)
class Powers(Direct):
    def slave(self, s: Any, at: At, rx: Forth) -> Any:
        return self.K * (rx.x - at.x)**3 - self.B * at.v, Back(at.f), s


@dataclass(frozen=True, kw_only=True)
class Waits(Direct):
    def slave(self, s: Any, at: At, rx: Forth) -> Any:
        return self.K * (rx.x - at.x) * (not at.fresh) - self.B * at.v, Back(at.f), s


@dataclass(frozen=True, kw_only=True)
class Counts(Direct):
    def slave(self, s: Any, at: At, rx: Forth) -> Any:
        return self.K * (rx.x - at.x) - self.B * at.v, Back(at.v > 0.0), s


@pytest.mark.parametrize(("law", "engine", "why"), [
    (Lists(), "scalar", "a comprehension"), (Powers(), "plain", "`**` with a whole number"),
    (Waits(), "scalar", ""), (Counts(), "plain", ""),
])
def test_a_law_that_cannot_be_compiled_runs_otherwise_with_the_same_bits(law: Any, engine: str, why: str) -> None:
    """Each row with a schedule of its own: another kernel over lanes, compiled when it is needed."""
    rows = [(n, {"k_e": 100.0 + n}, n) for n in range(9)]
    fixed = {"law": law, "duration": 0.1, "link": "delay(0.005) | bernoulli(0.3)", "energy": False}
    done = {one: work(Job("canonical", fixed, rows, MEASURES, one)) for one in ("plain", "vector")}
    assert repr(done["plain"].rows) == repr(done["vector"].rows)
    ((ran, reason), count), = done["vector"].ran.items()
    assert count == 9
    assert why in reason
    assert ran in (engine, "vector", "scalar") if not why else ran == engine


@dataclass(frozen=True, kw_only=True)
class Saturates(Direct):
    """A law with branches, one of which returns."""

    def slave(self, s: Any, at: At, rx: Forth) -> Any:
        f_s = self.K * (rx.x - at.x) - self.B * at.v
        if not at.fresh:
            return 0.5 * f_s, Back(at.f), s
        if f_s > 2.0:
            f_s = 2.0
        elif f_s < -1.0 and at.v > 0.0:
            f_s = f_s + self.B * at.v
        return f_s, Back(at.f if at.f > 0.0 else 0.0), s


@dataclass(frozen=True, kw_only=True)
class Loops(Direct):
    def slave(self, s: Any, at: At, rx: Forth) -> Any:
        f_s = 0.0
        for _ in range(2):
            f_s = f_s + 0.5 * self.K * (rx.x - at.x)
        return f_s - self.B * at.v, Back(at.f), s


class TestWhatHasNoLanes:
    def test_a_law_with_a_loop_runs_one_scene_at_a_time_and_the_sweep_says_why(self) -> None:
        rows = [(n, {"k_e": 200.0 + 10.0 * n}, 0) for n in range(9)]
        done = {engine: work(Job("canonical", {"duration": 0.1, "law": Loops()}, rows, ("f_m_max",), engine))
                for engine in ("plain", "vector", "vector")}  # the second finds the kernel made
        ((engine, why), rows_so), = done["vector"].ran.items()
        assert (engine, rows_so) == ("scalar", 9)
        assert "Loops.slave has a loop" in why
        assert repr(done["plain"].rows) == repr(done["vector"].rows)

    def test_so_does_a_body_with_an_inner_state(self) -> None:
        of = replace(load_scene("relaxing_tissue"), duration=0.1)
        with pytest.raises(NotVectorised, match="inner state"):
            vector_kernel(of, exact_bodies(of), ("x_err_rms",))


@pytest.mark.parametrize(("scene", "knobs"), [
    ("virtual_coupling", {}), ("canonical", {"law": Saturates()}),
    ("canonical", {"law": Saturates(), "link": "delay(0.005) | bernoulli(0.3)"}),
], ids=["virtual_coupling", "shared schedules", "schedules of their own"])
def test_a_law_with_an_if_ran_one_scene_at_a_time(scene: str, knobs: dict[str, Any]) -> None:
    knob = "law.K" if scene == "virtual_coupling" else "k_e"
    rows = [(n, {knob: 200.0 + 30.0 * n}, n) for n in range(9)]
    done = {engine: work(Job(scene, {"duration": 0.3, **knobs}, rows, ("f_m_max",), engine))
            for engine in ("plain", "vector")}
    assert done["vector"].ran == {("vector", ""): 9}
    assert repr(done["plain"].rows) == repr(done["vector"].rows)


def test_six_axes_ran_one_scene_at_a_time() -> None:
    rows = [(n, {"delay": 0.01 * n}, n) for n in range(3)]
    done = {engine: work(Job("pose", {"duration": 0.2}, rows, ("x_err_rms", "f_m_max"), engine))
            for engine in ("plain", "vector")}
    assert done["vector"].ran == {("vector", ""): 3}
    assert repr(done["plain"].rows) == repr(done["vector"].rows)


def test_the_engine_of_a_few_rows_is_another_than_that_of_many() -> None:
    from teleop.sweeps.runner import plan_sweep

    def chosen(rows: int, seconds: float) -> str:
        return plan_sweep("canonical", {"k_e": [1e3 + n for n in range(rows)]}, fixed={"duration": seconds}).engine

    assert [chosen(8, 600.0), chosen(400, 10.0), chosen(400, 0.1)] == ["scalar", "vector", "plain"]


def test_a_kernel_of_lanes_holds_only_what_the_scene_names() -> None:
    from teleop.sweeps.kernels.compiled import module_text

    of = replace(load_scene("free_motion", link="none"), energy=False)
    text, _ = module_text(of, exact_bodies(of), ("x_err_rms",), VECTOR)
    assert "move_free" in text
    for line in ("move_wall", "E_port", "packet(", "watch(", "f_err", "newest"):
        assert line not in text.partition("def loop")[2]
