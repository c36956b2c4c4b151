"""The stiffness of a MuJoCo contact, as it is told before a run, is what a press of the test's own finds."""

from __future__ import annotations

import re
from copy import copy
from pathlib import Path

import pytest

from slave.mujoco_model import OWN, load
from slave.mujoco_robot import MuJoCoBody, pressed
from tests.slave.test_mujoco_robot import scene, slider

pytest.importorskip("mujoco", reason="mujoco-core is not installed (extra mujoco)")


def told(file: str | None = None, axes: int = 3) -> tuple[str, list[float]]:
    """The sentence, and the two stiffnesses in it, N/m."""
    model = load(scene(axes), file)
    text = pressed(model, copy(MuJoCoBody(model)))[0]
    return text, [float(each.replace(",", "")) for each in re.findall(r"([\d,]+) N/m at", text)]


def depth(force: float) -> float:
    """How far the arm stands along x when it has long been pushed by `force` alone, m."""
    body = MuJoCoBody(load(scene(3)))
    body.hold((force, 0.0, 0.0))
    for _ in range(6000):
        body.step()
    return body.read().x[0]


def test_it_is_the_slope_of_force_over_depth_at_two_forces() -> None:
    text, found = told()
    assert "along +x" in text
    for force, stiffness in zip((2.0, 10.0), found, strict=True):
        part = 0.2 * force
        assert stiffness == pytest.approx(2.0 * part / (depth(force + part) - depth(force - part)), rel=0.02)
    assert found[1] > 1.3 * found[0]  # not linear


@pytest.mark.parametrize(("time", "low", "high"), [(0.04, 0.2, 0.5), (0.01, 2.0, 5.0)])
def test_a_contact_that_the_file_makes_softer_or_harder_is_told_so(
    time: float, low: float, high: float, tmp_path: Path
) -> None:
    """MuJoCo's stiffness goes as the time constant of a contact, here 0.02 s, to the power -2."""
    other = tmp_path / "other.xml"
    other.write_text(OWN.read_text().replace('<geom contype="1"', f'<geom solref="{time} 1" contype="1"'))
    assert all(low < one / usual < high for one, usual in zip(told(str(other))[1], told()[1], strict=True))


def test_that_there_is_nothing_to_touch_is_told(tmp_path: Path) -> None:
    text, found = told(slider(tmp_path), axes=1)
    assert found == []
    assert "came upon nothing within 0.2 m of its start" in text
