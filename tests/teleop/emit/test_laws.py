"""Every law in C with every bit, tame and with 1 % of the inputs infinite, NaN, subnormal or huge; and in float."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from teleop import PositionPosition, Refused, Scene, VirtualWall, check_law, find_law, load_scene, run
from teleop.emit import compiled as compiled_module
from teleop.emit.compiled import float_error, ran
from teleop.emit.files import files
from teleop.emit.types import FLOAT, Types
from teleop.emit.vectors import run_vectors
from teleop.law import BUILT_IN
from tests.programs import COMPILERS, program
from tests.teleop.emit.printed import assert_same, compiled, differences


def scene_with(law: str, **knobs: Any) -> Scene:
    """The canonical scene with this law, or one with one port."""
    return load_scene("canonical" if hasattr(find_law(law), "slave") else "virtual_wall", law=law, **knobs)


ORDINARY = ("tdpa", "model_mediated", "wave_prediction", "virtual_wall")


@pytest.mark.parametrize("law", [pytest.param(each, marks=[pytest.mark.full] * (each not in ORDINARY))
                                 for each in BUILT_IN])
def test_a_law_printed_as_c_has_the_bits_of_python(law: str, tmp_path: Path) -> None:
    scene = scene_with(law)
    for e in "ms" if scene.slave is not None else "m":
        assert_same(scene, e, tmp_path / e)


@pytest.mark.full
@pytest.mark.parametrize("law", BUILT_IN)
def test_a_law_keeps_its_bits_for_a_hundred_thousand_ticks(law: str, tmp_path: Path) -> None:
    scene = scene_with(law)
    for e in "ms" if scene.slave is not None else "m":
        assert_same(scene, e, tmp_path / e, count=100_000, again=2000)


def test_check_law_compares_the_law_in_c(monkeypatch: pytest.MonkeyPatch) -> None:
    program(*COMPILERS)
    seen: list[str] = []

    def differing(built: Path, rows: object = None) -> str:
        seen.append(built.name)
        return f"tick 3: force[0] is 0x1p+0, in Python 0x1p+1 {rows}\n"

    check_law(VirtualWall(), c=True)
    monkeypatch.setattr(compiled_module, "differences", differing)
    with pytest.raises(ValueError, match="PositionPosition is another law in C, at the end m: tick 3: force"):
        check_law(PositionPosition(), compiled=False, c=True)
    assert set(seen) == {"check"}


@pytest.mark.parametrize("law", [pytest.param(each, marks=[pytest.mark.full] * (each != "wave_prediction"))
                                 for each in BUILT_IN])
def test_over_a_run_a_float_is_near_double_or_refused_and_double_has_every_bit(law: str, tmp_path: Path) -> None:
    program(*COMPILERS)
    scene = scene_with(law, duration=3)
    trace = run(scene).trace
    for e in "ms" if scene.slave is not None else "m":
        made = files(scene, e, e)
        rows = run_vectors(scene, e, made.tick)
        forces = [row[2 + rows.width] for row in rows.rows[1:]]
        assert forces == trace[f"f_{e}"].tolist(), "the rows are those of the run"
        assert differences(compiled(made, tmp_path / e), rows) == ""
        try:
            made = files(scene, e, e, real=FLOAT)
        except Refused:
            continue
        done = ran(compiled(made, tmp_path / f"{e}_float"), rows)
        off, greatest = map(float, re.findall(r"([\d.e+-]+) N", done.stdout))
        assert off <= 5e-6 * greatest, done.stdout
        assert off > 0.0, "it is in float"


def test_an_error_beyond_a_thousandth_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    program(*COMPILERS)
    assert re.fullmatch(r"Over a run of the canonical scene: .* by up to .* N, \de-0[67] of the greatest, [\d.]+ N\.",
                        float_error(scene_with("p_d", duration=3), "m"))
    real_number: Any = Types.real_number
    monkeypatch.setattr(Types, "real_number", lambda self, value: real_number(self, float(f"{value:.2g}") * 1.01))
    with pytest.raises(Refused, match="in float p_d is too far from double over the canonical scene"):
        float_error(scene_with("p_d", duration=3), "m")


def test_a_printed_float_says_how_far_it_is_off(tmp_path: Path) -> None:
    program(*COMPILERS)
    scene = load_scene("bench_top", law="pp")
    made = files(scene, "s", "s", real=FLOAT, off=lambda: "Off by 1e-06 N.")
    assert "prints how far the force is off. Off by 1e-06 N." in made.texts["README.md"]
    assert not re.search(r"\bdouble\b", made.texts["bench_top_s.c"]), "not even the guard is in double"
    assert differences(compiled(made, tmp_path)) == ""
