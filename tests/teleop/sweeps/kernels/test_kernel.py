"""A kernel gives what a single run gives, to the last bit: in plain Python and compiled, for every scene there is."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pytest

from channel.link import parse_link
from scenarios.virtual_wall import scene as virtual_wall
from slave.tissue import Tissue
from slave.wall import Wall
from teleop import At, Scene, load_scene, run
from teleop.laws.direct import Direct
from teleop.laws.pfra import PFRA
from teleop.scene.library import ROOT, built_in_scenes
from teleop.simulation.bodies import exact_bodies, reference_samples
from teleop.simulation.plan import link_plans
from teleop.stages.device import Device
from teleop.stages.encoder import Encoder
from teleop.stages.force_cap import Cap
from teleop.stages.velocity.low_pass import LowPass
from teleop.stages.watchdog import Watchdog
from teleop.sweeps.kernels import compiled
from teleop.sweeps.kernels.compiled import NotCompiled, module_text
from teleop.sweeps.kernels.engines import SCALAR, scalar_kernel
from teleop.sweeps.kernels.kernel import (
    Kernel,
    LinkSchedule,
    RowInputs,
    available,
    figures,
    kernel_lines,
    leaves,
    plain_kernel,
    tree_of,
)

ROUGH = "delay(0.01) | uniform(0.01) | bernoulli(0.1) ; delay(0.02)"
SHORT = 0.4  # s


def scene(name: str, folder: Path, **knobs: Any) -> Scene:
    if name == "lte":
        (folder / "trace").write_text("".join(f"{ms}\n" for ms in range(1, 50)))
        knobs |= {"up": folder / "trace", "down": folder / "trace"}
    return replace(load_scene(name, **knobs), duration=SHORT)


def row(kernel: Kernel, of: Scene, seed: int) -> tuple[str, int, dict[str, float]]:
    """What one row of a sweep comes to."""
    return figures(kernel, [inputs(kernel, of, seed)])[0]


def inputs(kernel: Kernel, of: Scene, seed: int) -> RowInputs:
    """What the kernel is given for a row."""
    schedule, bodies, path = LinkSchedule.of(link_plans(of, seed)), exact_bodies(of), reference_samples(of)
    if kernel.engine == "plain":
        return RowInputs(tree_of(of, bodies, compiled=False), None, of.ticks, schedule, path)
    arrays = tuple(np.asarray(axis) for axis in path or ())
    return RowInputs(None, leaves(tree_of(of, bodies)), of.ticks, schedule, arrays)


def assert_as_a_run(kernel: Kernel, of: Scene, seed: int = 3) -> None:
    single = run(of, seed=seed)
    assert row(kernel, of, seed) == (
        single.status, single.ticks, {name: single.metrics[name] for name in kernel.measures if name in single.metrics})


HARD = Wall(k=2e4, d=10.0, at=0.004)
MORE = {
    "rough link, energy": lambda: replace(load_scene("canonical", link=ROUGH, energy=True), duration=SHORT),
    "diverges": lambda: replace(load_scene("canonical", law=Direct(kf=50.0, K=3000.0)), duration=2.0, x_limit=10.0),
    "diverges late over a rough link": lambda: replace(
        load_scene("canonical", law=Direct(kf=50.0, K=3000.0), link=ROUGH), duration=2.0, x_limit=1.0),
    "overflows": lambda: replace(load_scene("canonical", law=Direct(kf=1e308)), duration=SHORT, start_s=0.05),
    "three axes": lambda: Scene(
        law=PFRA(alpha=0.3), master=load_scene("canonical").master, slave=load_scene("canonical").slave, axes=3,
        environment=(HARD, None, Tissue(k=200.0, d=1.0)), hand=load_scene("recorded_reach").hand, energy=True,
        link=parse_link(ROUGH), duration=SHORT),
    "eleven axes, of which two begin with the same digit": lambda: Scene(
        law=PFRA(alpha=0.3), master=load_scene("canonical").master, slave=load_scene("canonical").slave, axes=11,
        hand=load_scene("canonical").hand, link=parse_link(ROUGH), duration=0.1),
    "devices": lambda: replace(
        load_scene("canonical", law=PFRA(alpha=0.2)), duration=SHORT, cap=Cap(f_max=3.0, slew=500.0),
        watchdog=Watchdog(timeout=0.02), device_m=Device(encoder=Encoder(step=1e-4), velocity=LowPass(cutoff=40.0),
                                                         every=3, delay=2)),
    "limits": lambda: replace(
        load_scene("canonical", law=Direct(), link=ROUGH, energy=True), duration=SHORT,
        cap=Cap(f_max=5.0, slew=2000.0, v_max=0.2, power=0.01), watchdog=Watchdog(timeout=0.012, settle=0.02)),
    "limits, not a number": lambda: replace(
        load_scene("canonical", law=Direct(kf=1e308)), duration=SHORT, start_s=0.05, cap=Cap(f_max=9.0, power=1e-3)),
}


class TestInPlainPython:
    @pytest.mark.parametrize("name", built_in_scenes())
    def test_every_scenes_row_is_its_run(self, name: str, tmp_path: Path) -> None:
        of = scene(name, tmp_path)
        assert_as_a_run(plain_kernel(of, exact_bodies(of), sorted(available(of))), of)

    @pytest.mark.parametrize("name", MORE)
    def test_and_that_of_others(self, name: str) -> None:
        of = MORE[name]()
        assert_as_a_run(plain_kernel(of, exact_bodies(of), sorted(available(of))), of)

    def test_figures_that_are_not_asked_for_have_no_lines(self) -> None:
        of = load_scene("canonical", energy=True)
        assert "force_s0" not in kernel_lines(of, ("x_err_max",)).text()
        assert "force_s0" in kernel_lines(of, ("f_env_max",)).text()
        assert "old_x" not in kernel_lines(of, ("f_m_max",)).text()


class TestCompiled:
    @pytest.mark.parametrize("name", ["canonical", "recorded_reach", "encoder_wall", "virtual_coupling", "jittery_wan"])
    def test_every_engine_agrees_to_the_last_bit(self, name: str, tmp_path: Path) -> None:
        of = scene(name, tmp_path)
        assert_as_a_run(scalar_kernel(of, exact_bodies(of), sorted(available(of))), of)

    @pytest.mark.parametrize("name", ["rough link, energy", "diverges late over a rough link", "overflows", "devices",
                                      "limits", "limits, not a number"])
    def test_on_random_links_and_where_a_run_ends_early(self, name: str) -> None:
        of = MORE[name]()
        kernel = scalar_kernel(of, exact_bodies(of), sorted(available(of)))
        for seed in range(5):
            assert_as_a_run(kernel, of, seed)

    def test_one_kernel_serves_every_number(self) -> None:
        of = replace(virtual_wall(), duration=SHORT)
        kernel = scalar_kernel(of, exact_bodies(of), ("f_m_max",))
        for K, dt in ((100.0, 1e-3), (5000.0, 1e-3), (5000.0, 3e-4)):
            assert_as_a_run(kernel, replace(of, law=replace(of.law, K=K), dt=dt))

    def test_what_another_process_cannot_find_is_not_compiled(self) -> None:
        of = replace(load_scene("canonical"), law=Local(), duration=SHORT)
        bodies = exact_bodies(of)._replace(instead={"move_s0": lambda *rest: (*rest[1:3], 0)})
        with pytest.raises(NotCompiled, match="made during the run"):
            scalar_kernel(of, bodies, ("x_err_max",))


class Nothing(NamedTuple):
    x: float


@dataclass(frozen=True, kw_only=True)
class Local:
    claims: ClassVar[dict[str, str]] = {}

    def master_start(self, at: At) -> Any:
        return (), Nothing(at.x)

    def slave_start(self, at: At) -> Any:
        return (), Nothing(at.x)

    def master(self, s: Any, at: At, rx: Nothing) -> Any:
        return 0.0 * rx.x, Nothing(at.x), s

    def slave(self, s: Any, at: At, rx: Nothing) -> Any:
        return 0.0 * rx.x, Nothing(at.x), s


LAW = '''
import gains
from dataclasses import dataclass
from typing import ClassVar

PARTS = ({tuple}, 1.0)

def push(x):
    return {factor} * x * PARTS[0] * gains.G

@dataclass(frozen=True, kw_only=True)
class Mine:
    claims: ClassVar[dict[str, str]] = {}
    def start(self, at): return ()
    def force(self, s, at): return push(at.x), s
'''
SCENE = """
from dataclasses import replace
from mine import Mine
from teleop import Scene, load_scene

def scene(*, duration: float = 0.2) -> Scene:
    return replace(load_scene("virtual_wall", energy=False), law=Mine(), duration=duration)
"""
PROGRAM = """
from teleop import load_scene, run
from teleop.sweeps.chunk import Job, work
done = work(Job("./own.py", {}, [(0, {}, 1)], ("f_m_max",), "scalar"))
single = run(load_scene("./own.py"), seed=1)
assert list(done.ran) == [("scalar", "")], done.ran
assert done.rows[0]["f_m_max"] == single.metrics["f_m_max"], (done.rows, single.metrics)
print(repr(done.rows[0]["f_m_max"]))
"""


def test_an_edited_law_is_never_served_stale(tmp_path: Path) -> None:
    """Not even when something was edited that a function below it names, which numba's own cache does not see."""
    said = []
    (tmp_path / "own.py").write_text(SCENE)
    edits = (50.0, 1.0, 1.0), (70.0, 1.0, 1.0), (50.0, 1.0, 1.0), (50.0, 2.0, 1.0), (50.0, 1.0, 3.0)
    for factor, part, gain in edits:
        (tmp_path / "mine.py").write_text(LAW.replace("{factor}", str(factor)).replace("{tuple}", str(part)))
        (tmp_path / "gains.py").write_text(f"G = {gain}")
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM], cwd=tmp_path, capture_output=True, text=True, check=False,
            env={**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{tmp_path}", "XDG_CACHE_HOME": str(tmp_path / "cache"),
                 "PYTHONDONTWRITEBYTECODE": "1"},
        )
        assert done.returncode == 0, done.stderr
        said.append(done.stdout)
    assert said[0] == said[2]
    assert len(set(said)) == 4  # the function, a tuple beside it, and another module of the user's own
    assert len(list((tmp_path / "cache/bilateral-teleop/kernels").glob("teleop_kernel_*.py"))) == 4


def test_a_folder_that_cannot_be_written_to_leaves_the_kernel_in_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "taken").write_text("a file where the folder should be")
    monkeypatch.setattr(compiled, "folder", lambda: tmp_path / "taken" / "kernels")
    of = replace(virtual_wall(b=0.81), duration=0.05)
    text, name = module_text(of, exact_bodies(of), ("f_m_max", "E_port_end"), SCALAR)
    sys.modules.pop(f"teleop_kernel_{name}", None)
    assert_as_a_run(scalar_kernel(of, exact_bodies(of), ("f_m_max", "E_port_end")), of)
    assert "def loop(" in text


SCRIPT = """
from dataclasses import dataclass
from typing import ClassVar, NamedTuple
from teleop.sweeps.runner import carry_out, plan_sweep

class Word(NamedTuple):
    x: float

def push(x):
    return 50.0 * x

@dataclass(frozen=True, kw_only=True)
class Mine:
    K: float = 100.0
    claims: ClassVar[dict[str, str]] = {}
    def master_start(self, at): return (), Word(at.x)
    def slave_start(self, at): return (), Word(at.x)
    def master(self, s, at, rx): return push(at.x - rx.x), Word(at.x), s
    def slave(self, s, at, rx): return self.K * (rx.x - at.x) - 4.0 * at.v, Word(at.x), s

plan = plan_sweep("free_motion", {"delay": [0.01, 0.02]}, fixed={"law": Mine(), "duration": 0.1}, engine="scalar")
print(carry_out(plan).counts(), dict(plan.ran))
"""
SMALL = """
from teleop.sweeps.runner import carry_out, plan_sweep
plan = plan_sweep("virtual_wall", {"k": [1e3, 2e3]}, fixed={"energy": False, "duration": 0.1}, engine="scalar")
print(carry_out(plan).counts(), dict(plan.ran))
"""


def test_a_law_in_the_users_own_script_is_compiled_too(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, check=True,
        env={**os.environ, "PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(tmp_path / "cache")},
    )
    assert done.stdout == "{'ok': 2} {('scalar', ''): 2}\n"


def test_processes_that_make_the_same_kernel_at_once_do_not_disturb_each_other(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(SMALL)
    env = {**os.environ, "PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    at_once = [subprocess.Popen([sys.executable, "script.py"], cwd=tmp_path, env=env, stdout=subprocess.PIPE, text=True)
               for _ in range(3)]
    assert {one.communicate()[0] for one in at_once} == {"{'ok': 2} {('scalar', ''): 2}\n"}
    left = sorted(path.name for path in (tmp_path / "cache/bilateral-teleop/kernels").iterdir())
    assert sum(name.endswith(".py") for name in left) == 1
    assert not any(name.endswith(".part") for name in left)
