"""The engine `c` where something is in its way; its bits are in `tests/engines`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import hypot
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from scenarios.virtual_wall import scene as virtual_wall
from teleop import Device, Scene, run
from teleop.simulation.prepared import prepare
from teleop.sweeps.engine import kernel_of
from teleop.sweeps.kernels import c_kernel
from teleop.sweeps.kernels.kernel import Kernel, NotCompiled, figures
from tests.engines.engines import inputs
from tests.programs import COMPILERS, program


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


@dataclass(frozen=True, kw_only=True)
class Hypotenuse:
    """A law with a function that has no line in C."""

    K: float = 100.0

    def start(self, at: Any) -> tuple[()]:
        return ()

    def force(self, s: tuple[()], at: Any) -> tuple[float, tuple[()]]:
        return self.K * hypot(at.x, 0.0), s


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


def test_what_has_no_line_in_c_runs_by_another_engine_which_says_why() -> None:
    program(*COMPILERS)
    of = scene_of(Hypotenuse())
    kernel, row = row_of(of)
    assert kernel.engine == "plain"
    assert "`hypot` is rounded otherwise" in kernel.why
    assert row[2]["f_m_max"] == run(of).metrics["f_m_max"]


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
