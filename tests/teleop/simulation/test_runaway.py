"""Scenes that run away: whatever they run into, they end as runs that diverged, with a summary that can be written."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any, ClassVar

import pytest

from master.hand import Grip, Rest
from slave import HuntCrossley, Moving, StandardLinearSolid, Tissue, Wall
from teleop.law import At
from teleop.laws.direct import Direct
from teleop.laws.virtual_coupling import VirtualCoupling
from teleop.physics.plant import MassDamper
from teleop.physics.relaxing import ElectricalDamping
from teleop.scene.scene import Scene
from teleop.stages.device import Device
from teleop.stages.encoder import Encoder
from teleop.stages.passivity_controller import PassivityController
from teleop.stages.velocity.adaptive_window import BestFit
from teleop.stages.velocity.backward_difference import BackwardDifference
from teleop.stages.velocity.levant import Levant
from teleop.stages.velocity.low_pass import LowPass
from tests.teleop.simulation.extremes import Case, tried

HAND = Grip(mass=0.1, k=100.0, d=0.0, reference=Rest(at=0.2))
MET = {
    "nothing": None, "wall": Wall(k=1e9, d=1e3), "tissue": Tissue(k=1e-6, d=0.0), "Hertz": HuntCrossley(k=1e9),
    "a soft body": HuntCrossley(k=1.0, n=10.0, lam=1e3), "relaxing": StandardLinearSolid(k=1.0, k1=1e3, tau=1e-3),
    "carried": Moving(environment=HuntCrossley(k=1.0, n=3.0), path=Rest(at=0.1)),
}


@dataclass(frozen=True, kw_only=True)
class Bond:
    """A spring-damper that pulls as well as it pushes."""

    K: float
    B: float
    claims: ClassVar[dict[str, str]] = {}

    def start(self, at: At) -> tuple[()]:
        return ()

    def force(self, s: tuple[()], at: At) -> tuple[float, tuple[()]]:
        return self.K * at.x + self.B * at.v, s


def runaway(**parts: Any) -> Case:
    """A light handle, in ticks far too long for what it is on, with bounds beyond every square root."""
    case = tried(0, {}, Scene(**{
        "master": MassDamper(mass=1e-4), "energy": True, "dt": 0.1, "duration": 12.0, "x_limit": 1e300,
        "start_m": 0.1, "passivity": PassivityController(cap=1e3), **parts,
    }))
    assert case.trouble == "", parts
    assert case.result.status == "diverged", parts
    return case


@pytest.mark.full
def test_of_a_slave_ends_with_a_report_of_the_ticks_that_missed_the_tolerance() -> None:
    device = Device(encoder=Encoder(step=1e-3), velocity=Levant(L=1.0))
    for name, friction in product(MET, (0.0, 1.0)):
        if name == "relaxing" and friction:
            continue  # which is refused
        body = MassDamper(mass=1e-4, friction=friction)
        case = runaway(law=Direct(K=1e6, B=0.0), master=body, slave=body, environment=MET[name], hand=HAND,
                       device_m=device, device_s=device)
        soft = friction > 0.0 or name in ("Hertz", "a soft body", "carried")
        report = case.result.extra.get("integration", {})
        assert list(report) == ["master"] * (friction > 0.0) + ["slave"] * soft, (name, friction)
        assert all(said["ticks_over_tolerance"] > 0 for said in report.values()), (name, friction)


@pytest.mark.parametrize("law", [Bond(K=1e6, B=1e6), VirtualCoupling(K=1e6, B=1.0, theta_f=0.0, theta_x=0.0)])
def test_of_a_handle_ends_whatever_its_device_and_law(law: Any) -> None:
    parts: tuple[dict[str, Any], ...] = (
        {}, {"electrical": ElectricalDamping(b=1.0, cutoff=1.0)}, {"hand": HAND},
        {"master": MassDamper(mass=1e-4, friction=1.0), "hand": HAND})
    for velocity, other in product((None, BackwardDifference(), LowPass(), Levant(L=1.0), BestFit(noise=1e-3)), parts):
        runaway(law=law, device_m=Device(encoder=Encoder(step=1e-12), velocity=velocity), **other)
