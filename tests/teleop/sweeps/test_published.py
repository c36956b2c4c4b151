"""Numbers that are known otherwise, found again by a sweep in every engine."""

from __future__ import annotations

from pathlib import Path

import pytest

from teleop import load_scene, sweep
from teleop.analysis.stability.assess import critical

SCENE = '''
from master import Grip, Rest
from teleop import BackwardDifference, Device, MassDamper, Scene, VirtualWall

def scene(*, K: float = 100.0, delay: int = 0, near: float = 100.0, duration: float = 60.0) -> Scene:
    """A handle pressed some 30 mm into a virtual wall, 0.1 mm from rest: it swings in contact, and dies or grows."""
    press = 0.03 * near
    return Scene(
        law=VirtualWall(K=K), master=MassDamper(mass=0.04, damping=0.8), start_m=press / (K + 1.0) + 1e-4,
        hand=Grip(mass=0.0, k=1.0, d=0.0, reference=Rest(at=press)), x_limit=0.05, dt=1e-3, duration=duration,
        device_m=Device(velocity=BackwardDifference(), delay=delay),
    )
'''


@pytest.mark.parametrize("engine", ["plain", "scalar", "vector"])
@pytest.mark.parametrize(("delay", "computed"), [(0, 1605.35), (1, 536.28), (5, 148.08), (10, 78.745)])
def test_the_critical_stiffness_of_a_sampled_wall(engine: str, delay: int, computed: float, tmp_path: Path) -> None:
    """m = 0.04 kg, b = 0.8 N s/m, 1 kHz: eigenvalues of the exact model say where; runs say the same to 1 %."""
    (tmp_path / "pressed.py").write_text(SCENE)
    name, knobs = str(tmp_path / "pressed.py"), {"delay": delay, "near": computed}
    edge = critical(lambda K: load_scene(name, **knobs, K=K), "K", low=0.5 * computed, high=2.0 * computed).value
    assert edge == pytest.approx(computed, rel=0.02)  # the hand that presses is a spring of 1 N/m
    table = sweep(name, {"K": [factor * edge for factor in (0.97, 0.99, 1.01, 1.03)]}, fixed=knobs, engine=engine)
    assert [row["status"] for row in table] == ["ok", "ok", "diverged", "diverged"]


HANDLES = '''
from channel import Delay, Link
from master import Grip, Rest
from slave import Tissue
from teleop import Direct, MassDamper, Scene

def scene(*, forth: int = 1, back: int = 1, k: float = 400.0, duration: float = 60.0) -> Scene:
    """Two handles, position-force, held by 100 N/m and 2 N s/m on a bonded wall, let go 1 mm from rest."""
    handle = MassDamper(mass=0.04, damping=0.8)
    return Scene(
        law=Direct(K=k, B=0.01 * k if k == 400.0 else 8.0), master=handle, slave=handle, start_m=1e-3,
        hand=Grip(mass=0.0, k=100.0, d=2.0, reference=Rest()), environment=Tissue(k=k, d=0.0), observer=None,
        link=Link(Delay(1e-3 * forth), Delay(1e-3 * back)), x_limit=0.1, dt=1e-3, duration=duration,
    )
'''


@pytest.mark.parametrize("engine", ["plain", "scalar", "vector"])
@pytest.mark.parametrize(("k", "trips", "first"), [(400.0, (7, 8, 9, 10), 9), (2000.0, (2, 3), 2)])
def test_the_delay_margin_of_two_handles(
    engine: str, k: float, trips: tuple[int, ...], first: int, tmp_path: Path
) -> None:
    """Position-force at 1 kHz is first unstable at a round trip of 9 ticks; on the stiff wall at the least there is."""
    (tmp_path / "handles.py").write_text(HANDLES)
    ways = [(trip // 2, trip - trip // 2) for trip in trips]
    table = sweep(str(tmp_path / "handles.py"), {("forth", "back"): ways}, fixed={"k": k}, engine=engine)
    assert [row["status"] for row in table] == ["ok" if trip < first else "diverged" for trip in trips]
