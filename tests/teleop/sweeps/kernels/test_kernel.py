"""Kernels: what is compiled and what not, kept and never stale; the bits that they give are in `tests/engines`."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from scenarios.virtual_wall import scene as virtual_wall
from slave import StandardLinearSolid, Wall
from teleop import At, Device, Scene, load_scene, run
from teleop.laws.direct import Back, Direct, Forth
from teleop.physics.carried import at_rest, carried, is_carried
from teleop.physics.plant import MassDamper, free_space
from teleop.scene.library import ROOT
from teleop.simulation.bodies import exact_bodies, with_inner
from teleop.simulation.prepared import prepare
from teleop.sweeps.chunk import Job, work
from teleop.sweeps.engine import kernel_of
from teleop.sweeps.kernels import c_kernel
from teleop.sweeps.kernels.c_kernel import Form, kernel_text
from teleop.sweeps.kernels.kernel import Kernel, NotCompiled, figures, kernel_lines
from teleop.sweeps.runner import plan_sweep
from tests.engines.engines import assert_as_plain, inputs, kernel_rows
from tests.fakes import law_of
from tests.programs import COMPILERS, program


def test_a_kernel_has_lines_for_what_the_scene_names_and_the_figures_that_are_asked_for_alone() -> None:
    of = load_scene("canonical", energy=True)
    assert "force_s0" not in kernel_lines(of, ("x_err_max",)).text()
    assert "force_s0" in kernel_lines(of, ("f_env_max",)).text()
    assert "old_x" not in kernel_lines(of, ("f_m_max",)).text()
    of = replace(load_scene("free_motion", link="none"), energy=False)
    text = kernel_text(of, exact_bodies(of), ("x_err_rms",), Form(4))
    assert "move_free" in text
    for line in ("move_wall", "E_port", "packet(", "watch(", "f_err", "newest_"):
        assert line not in text


def test_the_engine_of_a_few_rows_is_another_than_that_of_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("teleop.emit.compiler.find_compiler", lambda: "cc")

    def chosen(rows: int, seconds: float) -> str:
        return plan_sweep("canonical", {"k_e": [1e3 + n for n in range(rows)]}, fixed={"duration": seconds}).engine

    assert [chosen(8, 6000.0), chosen(400, 10.0), chosen(4000, 10.0), chosen(400, 0.1)] == ["c", "c", "vector", "plain"]


def test_what_moves_in_the_same_kind_of_environment_is_the_same_part() -> None:
    """Or every row of a sweep would have a kernel of its own."""
    one, other = (load_scene("beating_heart", k_e=k) for k in (100.0, 200.0))
    assert exact_bodies(one).functions() == exact_bodies(other).functions()
    free = free_space(one.master, 1e-3)
    assert with_inner(free).move is with_inner(free._replace(c=(1.0,) * 4)).move


def test_a_carried_plant_knows_the_one_that_it_carries() -> None:
    body = MassDamper(mass=0.5)
    for still in (Wall(k=1e3, d=1.0).plant(body, 1e-3), StandardLinearSolid(k=1.0, k1=2.0, tau=0.1).plant(body, 1e-3)):
        assert not is_carried(still)
        moving = carried(still, [0.0, 0.1, 0.0], body, 1e-3)
        assert is_carried(moving)
        assert at_rest(moving) == still


GAINS = (1.0, 2.0)


def loops(self: Any, s: Any, at: At, rx: Forth) -> Any:
    f_s = 0.0
    for _ in range(2):
        f_s = f_s + 0.5 * self.K * (rx.x - at.x)
    return f_s - self.B * at.v, Back(at.f), s


SLAVES: dict[str, Any] = {
    "loops": loops,
    "lists": lambda self, s, at, rx: (
        sum([gain * rx.x for gain in GAINS]) - self.K * at.x - self.B * at.v, Back(at.f), s),
    "powers": lambda self, s, at, rx: (self.K * (rx.x - at.x)**3 - self.B * at.v, Back(at.f), s),
    "waits": lambda self, s, at, rx: (self.K * (rx.x - at.x) * (not at.fresh) - self.B * at.v, Back(at.f), s),
    "counts": lambda self, s, at, rx: (self.K * (rx.x - at.x) - self.B * at.v, Back(at.v > 0.0), s),
}


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.full] * (name not in ("loops", "lists")))
                                  for name in SLAVES])
def test_a_law_that_cannot_be_compiled_runs_otherwise_with_the_same_bits(name: str) -> None:
    """Each row with a schedule of its own: another kernel over lanes, compiled when it is needed."""
    program(*COMPILERS)
    rows = [(n, {"k_e": 100.0 + n}, n) for n in range(9)]
    law = law_of(Direct, slave=SLAVES[name])()
    fixed = {"law": law, "duration": 0.1, "link": "delay(0.005) | bernoulli(0.3)", "energy": False}
    done = [work(Job("canonical", fixed, rows, ("x_err_rms", "f_m_max"), each))
            for each in ("plain", "vector", "vector")]  # the third finds the kernel made
    assert repr(done[0].rows) == repr(done[1].rows) == repr(done[2].rows)
    for each in done[1:]:
        ((ran, reason), count), = each.ran.items()
        assert (ran, count) == ("plain" if name == "lists" else "vector", 9), reason
        assert name != "lists" or "`sum` compensates" in reason


OWN = """
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple
from teleop import Plant, Scene, load_scene


class Word(NamedTuple):
    x: float


@dataclass(frozen=True, kw_only=True)
class Mine:
    K: float = 100.0
    claims: ClassVar[dict[str, str]] = {}
    def master_start(self, at): return (), Word(at.x)
    def slave_start(self, at): return (), Word(at.x)
    def master(self, s, at, rx): return self.K * (at.x - rx.x), Word(at.x), s
    def slave(self, s, at, rx): return self.K * (rx.x - at.x) - 4.0 * at.v, Word(at.x), s


def move(c, x, v, f):
    k, table = c
    return x + 1e-3 * v, v + 1e-3 * (f - k * table[1] * x - 2.0 * v), 0


def force(c, x, v):
    return c[0] * c[1][1] * x


@dataclass(frozen=True, kw_only=True)
class Springs:
    k: float
    def plant(self, body, dt): return Plant(move, force, (1.0, [0.0, self.k]))
    def resistance(self): raise NotImplementedError


def scene(*, k: float = 10.0, law: object = Mine()) -> Scene:
    return replace(load_scene("free_motion", link="none", duration=0.2), law=Mine(), environment=Springs(k=k),
                   energy=False)
"""


def test_a_law_and_a_body_of_a_scene_file_are_compiled_and_each_row_has_its_own_lists(tmp_path: Path) -> None:
    program(*COMPILERS)
    (tmp_path / "own.py").write_text(OWN)
    rows = [(n, {"k": 5.0 * n}, 0) for n in range(9)]
    done = {one: work(Job(str(tmp_path / "own.py"), {}, rows, ("x_err_rms", "f_s_max"), one))
            for one in ("vector", "plain")}
    assert repr(done["vector"].rows) == repr(done["plain"].rows)
    assert len({row["f_s_max"] for row in done["vector"].rows}) == 9
    ((ran, _), _), = done["vector"].ran.items()
    assert ran == "c"


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
import json, os, sys
from pathlib import Path
from teleop import load_scene, run
from teleop.simulation.bodies import exact_bodies
from teleop.sweeps.chunk import Job, work
from teleop.sweeps.kernels.c_kernel import Form, library_name
measures = ("f_m_max",)
for files, is_run in json.loads(sys.argv[1]):
    for name, text in files.items():
        Path(name).write_text(text)
    if child := os.fork():  # which imports nothing anew but what is edited
        assert os.waitpid(child, 0)[1] == 0
        continue
    of = load_scene("./own.py")
    print(*[library_name(of, exact_bodies(of), measures, form, "cc") for form in (Form(), Form(4))])
    for engine in ("c", "vector") * is_run:
        done = work(Job("./own.py", {}, [(0, {}, 1)], measures, engine))
        assert list(done.ran) == [(engine, "")], done.ran
        assert done.rows[0]["f_m_max"] == run(of, seed=1).metrics["f_m_max"], done.rows
    break
"""


def in_process(folder: Path, *words: str) -> subprocess.Popen[str]:
    """A Python there, with a cache of its own."""
    return subprocess.Popen(
        [sys.executable, *words], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{folder}", "XDG_CACHE_HOME": str(folder / "cache"),
             "PYTHONDONTWRITEBYTECODE": "1"})


def output(process: subprocess.Popen[str]) -> str:
    out, err = process.communicate()
    assert process.returncode == 0, err
    return out


def test_an_edited_law_is_never_served_stale(tmp_path: Path) -> None:
    """Not even when something was edited that a function below it names."""
    program(*COMPILERS)
    edits = [({"own.py": SCENE, "mine.py": LAW.replace("{factor}", factor).replace("{tuple}", part),
               "gains.py": f"G = {gain}"}, is_run)
             for factor, part, gain, is_run in (("50.0", "1.0", 1.0, True), ("70.0", "1.0", 1.0, False), (
                 "50.0", "1.0", 1.0, False), ("50.0", "2.0", 1.0, False), ("50.0", "1.0", 3.0, True))]
    names = output(in_process(tmp_path, "-c", PROGRAM, json.dumps(edits))).splitlines()
    assert (len(names), names[0]) == (5, names[2])
    for each in zip(*map(str.split, names), strict=True):
        assert len(set(each)) == 4  # the function, a tuple beside it, and another module of the user's own


def test_a_folder_that_cannot_be_written_to_leaves_the_kernel_in_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "taken").write_text("a file where the folder should be")
    program(*COMPILERS)
    monkeypatch.setattr(c_kernel, "folder", lambda: tmp_path / "taken" / "kernels")
    of, measures = replace(virtual_wall(b=0.81), duration=0.05, energy=False), ("f_m_max",)
    single = run(of)
    for engine in ("c", "alike"):
        assert kernel_rows(engine, [of], measures=measures) == [
            (single.status, single.ticks, {name: single.metrics[name] for name in measures})]
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]


SCRIPT = """
from dataclasses import dataclass
from typing import ClassVar
from teleop.sweeps.runner import carry_out, plan_sweep


def push(x):
    return 50.0 * x


@dataclass(frozen=True, kw_only=True)
class Mine:
    claims: ClassVar[dict[str, str]] = {}
    def start(self, at): return ()
    def force(self, s, at): return push(at.x), s

plan = plan_sweep("virtual_wall", {"k": [1e3, 2e3]}, fixed={"law": Mine(), "energy": False, "duration": 0.1},
                  metrics=["f_m_max"], engine="c")
print(carry_out(plan).counts(), dict(plan.ran))
"""


def test_a_law_in_the_users_own_script_is_compiled_too(tmp_path: Path) -> None:
    program(*COMPILERS)
    (tmp_path / "script.py").write_text(SCRIPT)
    assert output(in_process(tmp_path, "script.py")) == "{'ok': 2} {('c', ''): 2}\n"


@pytest.mark.full
def test_processes_that_make_the_same_kernel_at_once_do_not_disturb_each_other(tmp_path: Path) -> None:
    program(*COMPILERS)
    (tmp_path / "script.py").write_text(SCRIPT)
    at_once = [in_process(tmp_path, "script.py") for _ in range(2)]
    assert {output(each) for each in at_once} == {"{'ok': 2} {('c', ''): 2}\n"}
    left = sorted(path.name for path in (tmp_path / "cache/bilateral-teleop/kernels").iterdir())
    assert sum(name.endswith(".so") for name in left) == 1
    assert not any(name.endswith(".part") for name in left)


def test_a_recorded_hand_that_was_recorded_anew_moves_anew(tmp_path: Path) -> None:
    told = []
    for x in (0.01, 0.05):
        (tmp_path / "hand.csv").write_text(f"t,x\n0,0\n1,{x}\n")
        rows = [(0, {"motion": str(tmp_path / "hand.csv"), "duration": 0.5}, 0)]
        told.append(work(Job("recorded_reach", {}, rows, ("x_err_max",), "plain")).rows[0])
    assert told[0]["x_err_max"] != told[1]["x_err_max"]


@pytest.mark.full
@pytest.mark.parametrize("lanes", [2, 8])
def test_a_register_of_another_size_holds_the_same_bits(lanes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    program(*COMPILERS)
    monkeypatch.setattr(c_kernel.Target, "lanes", lanes)
    for name in ("ticks left out", "a one-port"):
        for engine in ("alike", "apart"):
            assert_as_plain(name, engine)


class Turns(NamedTuple):
    count: float


@dataclass(frozen=True, kw_only=True)
class Divides:
    """A law that divides by zero at its 20th tick, after which it goes on as before."""

    at: float = 20.0

    def start(self, at: Any) -> Turns:
        return Turns(0.0)

    def force(self, s: Turns, at: Any) -> tuple[float, Turns]:
        scale = 1.0 / (s.count - self.at)
        return (100.0 * at.x if scale * scale < 4.0 else 0.0), Turns(s.count + 1.0)


def scene_of(law: Any) -> Scene:
    return replace(virtual_wall(b=0.81, energy=False), law=law, duration=0.1)


def row_of(of: Scene) -> tuple[Kernel, Any]:
    kernel, _ = kernel_of(prepare(of), ("f_m_max",), "c")
    return kernel, figures(kernel, [inputs(kernel, of, 0)])[0]


def test_a_row_in_which_python_would_have_raised_ends_as_diverged() -> None:
    program(*COMPILERS)
    with pytest.raises(Exception, match="division"):
        run(scene_of(Divides()))
    kernel, (status, ticks, _) = row_of(scene_of(Divides()))
    assert (kernel.engine, status, ticks) == ("c", "diverged", 100)
    assert row_of(scene_of(Divides(at=-1.0)))[1][0] == "ok"


def test_a_row_of_very_many_numbers_kept_the_compiler_busy_for_a_minute() -> None:
    program(*COMPILERS)
    of = replace(virtual_wall(b=0.81), device_m=Device(delay=3000))
    with pytest.raises(NotCompiled, match="numbers, above 2000, which are too many to be laid out"):
        c_kernel.c_kernel(of, prepare(of).bodies, ("f_m_max",))


def test_without_a_compiler_a_row_runs_by_another_engine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(c_kernel, "find_compiler", lambda: None)
    kernel, _ = row_of(replace(scene_of(Divides(at=-2.0)), energy=True))
    assert (kernel.engine, kernel.why) == ("plain", "there is no C compiler")


def test_a_damaged_library_in_the_cache_is_compiled_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program(*COMPILERS)
    monkeypatch.setattr(c_kernel, "folder", lambda: tmp_path / "kernels")
    of = replace(scene_of(Divides(at=-3.0)), observer=None)
    made = prepare(of)
    c_kernel.c_kernel(of, made.bodies, ("f_m_max",))
    library, = (tmp_path / "kernels").iterdir()
    library.unlink()  # a library that is loaded is not written to
    library.write_bytes(b"\x7fELF and no more")
    kernel, row = row_of(of)
    assert (kernel.engine, kernel.why) == ("c", "")
    assert row[2]["f_m_max"] == run(of).metrics["f_m_max"]
