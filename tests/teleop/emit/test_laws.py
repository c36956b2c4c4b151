"""Every law with every bit: at each end, tame and with 1 % of the inputs infinite, NaN, subnormal or huge."""

from __future__ import annotations

from pathlib import Path

import pytest

from teleop import PositionPosition, VirtualWall, check_law, find_law, load_scene
from teleop.emit import compiled as compiled_module
from teleop.law import BUILT_IN
from tests.programs import COMPILERS, program
from tests.teleop.emit.printed import assert_same

ORDINARY = ("tdpa", "model_mediated", "wave_prediction", "virtual_wall")


@pytest.mark.parametrize("law", [pytest.param(each, marks=[pytest.mark.full] * (each not in ORDINARY))
                                 for each in BUILT_IN])
def test_a_law_printed_as_c_has_the_bits_of_python(law: str, tmp_path: Path) -> None:
    two_ends = hasattr(find_law(law), "slave")
    scene = load_scene("canonical" if two_ends else "virtual_wall", law=law)
    for e in ("m", "s") if two_ends else ("m",):
        assert_same(scene, e, tmp_path / e)


@pytest.mark.full
@pytest.mark.parametrize("law", BUILT_IN)
def test_a_law_keeps_its_bits_for_a_hundred_thousand_ticks(law: str, tmp_path: Path) -> None:
    two_ends = hasattr(find_law(law), "slave")
    scene = load_scene("canonical" if two_ends else "virtual_wall", law=law)
    for e in ("m", "s") if two_ends else ("m",):
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
