"""What a law offers to the analyses: a law of one's own with the same offers has the same analysis."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pytest

from teleop import At, Coupling, PDamped, Refused, Scene, VirtualCoupling, load_scene
from teleop.analysis.models.one_port_loop import controller
from teleop.analysis.passivity.command import ask
from teleop.analysis.passivity.command import table as passivity_table
from teleop.analysis.passivity.one_port import one_port
from teleop.analysis.stability.assess import stability
from teleop.analysis.zwidth.assess import curves, levers
from teleop.analysis.zwidth.passive import passive_region
from teleop.law.analysis_offers import coupling_of, described, instead, linear_law
from tests.fakes import OneSpring, law_of
from tests.teleop.conftest import Answer

Typed = Callable[..., Answer]


class Tool(NamedTuple):
    y: float  # m
    u: float  # m/s


@dataclass(frozen=True, kw_only=True)
class Bonded:
    """A tool on a spring that is bonded to it, behind a coupling, by backward Euler: no class of the package."""

    K: float = 1000.0
    B: float = 0.2
    mass: float = 0.02
    k_e: float = 1e5

    claims: ClassVar[Mapping[str, str]] = {}

    def start(self, at: At) -> Tool:
        return Tool(at.x, 0.0)

    def force(self, s: Tool, at: At) -> tuple[float, Tool]:
        dt, K, B = at.span, self.K, self.B
        push = self.mass / dt * s.u + K * (at.x - s.y) + B * at.v - self.k_e * s.y
        u = push / (self.mass / dt + B + (K + self.k_e) * dt)
        y = s.y + dt * u
        return K * (at.x - y) + B * (at.v - u), Tool(y, u)


@dataclass(frozen=True, kw_only=True)
class Offering(Bonded):
    """The same, and it says what it is: impedances written from its own equations."""

    def coupling(self, dt: float) -> Coupling:
        def C(z: Any) -> Any:
            return self.B + self.K * dt / (1.0 - 1.0 / z)

        def E(z: Any, k_e: float = self.k_e) -> Any:
            return self.mass * (1.0 - 1.0 / z) / dt + k_e * dt / (1.0 - 1.0 / z)

        return Coupling(C=C, E=E, free=lambda z: C(z) * E(z, 0.0) / (C(z) + E(z, 0.0)), others={"backward": self})


def with_law(law: Any, **knobs: object) -> Scene:
    return replace(load_scene("virtual_coupling", **knobs), law=law)


class TestACouplingOfOnesOwn:
    def test_is_what_its_ticks_render(self) -> None:
        own = Offering().coupling(1e-3)
        for theta in (0.01, 0.5, 3.0):
            z = np.exp(1j * theta)
            law = controller(with_law(Offering()))
            H = law.C @ np.linalg.solve(z * np.eye(len(law.A)) - law.A, law.B) + law.D
            assert H[0, 0] * 1e-3 / (1.0 - 1.0 / z) == pytest.approx(own.C(z) * own.E(z) / (own.C(z) + own.E(z)))

    @pytest.mark.parametrize(("K", "k_e"), [(1000.0, 1e5), (300.0, 50.0)])
    def test_has_the_verdict_the_bounds_the_passive_region_and_the_curves_of_the_built_in_one(
            self, K: float, k_e: float) -> None:
        scenes = [with_law(law) for law in (Offering(K=K, k_e=k_e), VirtualCoupling(K=K, k_e=k_e, mass=0.02))]
        mine, built_in = map(one_port, scenes)
        assert mine.behind is not None
        assert built_in.behind is not None
        assert mine.passive is built_in.passive
        assert mine.needed.damping == pytest.approx(built_in.needed.damping, rel=1e-7)
        for name in ("gamma", "miller", "most", "passive_needs", "alone", "stiffness"):
            assert getattr(mine.behind, name) == pytest.approx(getattr(built_in.behind, name), rel=1e-7), name
        assert mine.behind.alpha.alpha == pytest.approx(built_in.behind.alpha.alpha, abs=1e-9)
        assert mine.behind.integrators == {"backward": mine.behind.alpha}
        assert "by integrator   backward passive" in passivity_table(ask(scenes[0]))
        regions = [passive_region(scene) for scene in scenes]
        assert regions[0].corners is not None
        assert np.array(regions[0].corners) == pytest.approx(np.array(regions[1].corners), rel=1e-7, abs=1e-9)
        of_mine, of_built_in = (curves(scene, region) for scene, region in zip(scenes, regions, strict=True))
        assert of_mine.lower == pytest.approx(of_built_in.lower)
        assert of_mine.width == pytest.approx(of_built_in.width)
        assert [lever.name for lever in levers(scenes[0])] == [lever.name for lever in levers(scenes[1])]

    def test_that_it_does_not_offer_is_judged_as_a_whole_and_behind_an_encoder_has_no_known_bound_either(self) -> None:
        bare, offering = one_port(with_law(Bonded())), one_port(with_law(Offering()))
        assert bare.behind is None
        assert bare.needed.damping == offering.needed.damping  # that is read off the ticks
        assert "virtual coupling" in [lever.name for lever in levers(with_law(Bonded()))]
        scene = with_law(Offering(), step=1e-5, friction=1.0)
        assert one_port(scene).passive is None
        assert passive_region(scene).corners is None
        assert one_port(replace(scene, law=Bonded())).verdict.friction is None  # that is no spring and damper

    def test_without_series_or_passive_integrator_has_no_region_and_of_another_type_is_refused(self) -> None:
        """It is told which integrator would do, and what to write."""
        @dataclass(frozen=True, kw_only=True)
        class Early(Offering):
            def coupling(self, dt: float) -> Coupling:
                return super().coupling(dt)._replace(keeps=False, others={"backward": Offering()})

        class Wrong(Bonded):
            def coupling(self, dt: float) -> Any:
                return dt

        region = passive_region(with_law(Early()))
        assert region.corners is None
        assert region.sentence.endswith("take backward Euler")
        with pytest.raises(Refused, match=r"Wrong.coupling returned float; write return Coupling\("):
            coupling_of(Wrong(), 1e-3)
        assert coupling_of(Bonded(), 1e-3) is None


CLIPPED = '''
"""A law that is not linear, and offers the one that it is while it does not saturate."""
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from teleop import At, Direct


class Motion(NamedTuple):
    x: float
    v: float


class Force(NamedTuple):
    f_env: float


@dataclass(frozen=True, kw_only=True)
class Clipped:
    """Direct reflection of at most 2 N."""

    K: float = 500.0
    B: float = 20.0
    claims: ClassVar[dict[str, str]] = {}

    def master_start(self, at: At):
        return (), Force(0.0)

    def slave_start(self, at: At):
        return (), Motion(at.x, 0.0)

    def master(self, s, at: At, rx: Force):
        return max(-2.0, min(rx.f_env, 2.0)), Motion(at.x, at.v), s

    def slave(self, s, at: At, rx: Motion):
        return self.K * (rx.x - at.x) + self.B * (rx.v - at.v), Force(at.f), s


@dataclass(frozen=True, kw_only=True)
class Offered(Clipped):
    """The same with its offer."""

    def linear(self):
        return Direct(K=self.K, B=self.B)
'''


class TestALinearLawInItsPlace:

    def test_has_its_roots_margins_and_hybrid_matrix_and_the_report_says_so(self, tmp_path: Path, typed: Typed) -> None:
        """In virtual time it is not taken, and without the offer the law is refused."""
        (tmp_path / "clipped.py").write_text(CLIPPED)
        law, delay = ("--set", "law=clipped.py:Offered"), ("--set", "delay=0.005")
        for command, more in (("stability", delay), ("passivity", ())):
            own, linear = (typed(command, "soft_tissue", *words, *more).out.splitlines()
                           for words in (law, ("--set", "law=direct")))
            said = [line for line in own if line not in linear]
            assert said[-1].endswith("Offered is not linear: direct(K=500, B=20, kf=1) stands in its place")
            assert [line.split()[0] for line in said] == ["scene", "law"]
            assert [line for line in own if line not in said] == linear[1:]
        assert "stands in its place" not in typed("stability", "soft_tissue", *law, *delay, "--time").out
        typed("stability", "soft_tissue", "--set", "law=clipped.py:Clipped").assert_refused(
            "Clipped is not linear at the master")

    def test_of_a_one_port_law_is_taken_by_its_loop(self) -> None:
        def force(self: Any, s: tuple[()], at: At) -> tuple[float, tuple[()]]:
            p = max(at.x - self.wall, 0.0)
            return self.K * p * (1.0 + p), s

        hardening = law_of(OneSpring, name="Hardening", knobs=[("wall", float, 0.03)], force=force,
                           linear=lambda self: load_scene("virtual_wall", **{"law.K": self.K}).law)
        scene = load_scene("virtual_wall", **{"law.K": 400.0})
        mine = replace(scene, law=hardening())
        assert stability(mine) == stability(scene)
        assert one_port(mine).needed == one_port(scene).needed
        assert instead(mine.law).startswith("Hardening is not linear: virtual_wall(K=400")

    def test_that_is_the_law_with_another_parameter_is_said_and_one_without_the_offer_stands_for_itself(self) -> None:
        law = PDamped(K=80.0, B=3.0)
        assert instead(law) == "p_d is taken with rejoin=1e+12, as it is linear"
        assert instead(law.linear()) == ""
        assert linear_law(VirtualCoupling()) is None
        assert instead(VirtualCoupling()) == ""
        assert described(Bonded(K=2.0)) == "Bonded(K=2, B=0.2, mass=0.02, k_e=100000)"
