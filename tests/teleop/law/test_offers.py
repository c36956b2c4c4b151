"""Offers of a law beside its ends: the energy that it keeps, its conditions, what it is to the analyses."""

# ruff: noqa: ARG001, ARG005 - an end takes what it is given, used or not

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pytest

from channel import Bernoulli, Delay, LeftOut
from teleop import (
    At,
    Coupling,
    Energy,
    Fixed,
    Hold,
    Integral,
    MassDamper,
    PDamped,
    Refused,
    Scaling,
    Scene,
    VirtualCoupling,
    Wave,
    Zero,
    load_scene,
    run,
)
from teleop.analysis.models.one_port_loop import controller
from teleop.analysis.passivity.command import ask
from teleop.analysis.passivity.command import table as passivity_table
from teleop.analysis.passivity.one_port import one_port
from teleop.analysis.stability.assess import stability
from teleop.analysis.zwidth.assess import curves, levers
from teleop.analysis.zwidth.passive import passive_region
from teleop.checks.trials import try_claims
from teleop.knob import knobs_of_fields
from teleop.law import find_law, known_laws
from teleop.law.analysis_offers import coupling_of, described, instead, linear_law
from teleop.law.offers import AgeRange as Ages
from teleop.law.offers import Facts, broken, seed_energy
from teleop.simulation.notes import facts_of, fitted
from tests.fakes import OneSpring, law_of
from tests.teleop.conftest import Answer


class Place(NamedTuple):
    x: float


class Bank(NamedTuple):
    E: float


def master(self: Any, s: Bank, at: At, rx: Place) -> Any:
    work = (1.0 - self.wrong) * at.f_held * at.dx + self.wrong * self.B * at.v * at.v * at.span
    return self.B * at.v, Place(at.x), Bank(s.E + work)


def conditions(self: Any, facts: Facts) -> tuple[str, ...]:
    told = f"B is to be below {facts.mass_m:g}: --set law.B"
    return (told,) if facts.mass_m < self.B else ()


# A damper at each end, and the energy that it took up. The other end is of no interest to it. `wrong`: the share of the
# work that is told as B v^2 dt, which is no work of a force that is held.
Dampers = law_of(
    name="Dampers", knobs=[("seed", float, 0.01), ("wrong", float, 0.0)], shows=("E",), claims={"E_law": "any link"},
    master_start=lambda self, at: (Bank(self.seed), Place(at.x)), master=master,
    slave_start=lambda self, at: (Bank(self.seed), Place(at.x)),
    slave=lambda self, s, at, rx: (-self.B * at.v, Place(at.x), Bank(s.E - at.f_held * at.dx)),
    master_stored=lambda self, s: s.E, slave_stored=lambda self, s: s.E, conditions=conditions,
    fitted=lambda self, facts: replace(self, B=min(self.B, 0.5 * facts.mass_m)))
Coupled = law_of(  # the same with one energy for all axes
    Dampers, name="Coupled", master_sums=lambda self, s, at, rx: Place(at.f_held * at.dx),
    master=lambda self, s, at, rx, over: (self.B * at.v, Place(at.x), Bank(s.E + over.x)))


def scene(law: Any = None, **other: Any) -> Scene:
    return replace(load_scene("canonical", law=law or Dampers(B=0.5), duration=1.0), energy=True, **other)


class TestEnergyThatALawKeeps:
    @pytest.mark.parametrize("axes", [1, 3])
    def test_it_is_the_sum_of_both_ends_and_all_axes_and_what_a_law_shows_is_a_column_of_each_end(
            self, axes: int) -> None:
        trace = run(scene(axes=axes)).trace
        assert trace["E_law"] == pytest.approx(trace["E_port"] + 2 * axes * 0.01, abs=1e-15)
        assert seed_energy(Dampers(), axes=axes) == 2 * axes * 0.01
        shown = [trace[f"E_{e}"].reshape(len(trace["t"]), axes).sum(axis=1) for e in "ms"]
        assert sum(shown) == pytest.approx(trace["E_law"], abs=1e-15)

    def test_an_end_that_couples_its_axes_keeps_one_energy_for_all_and_a_law_without_any_has_no_column(self) -> None:
        trace = run(scene(Coupled(B=0.5), axes=3)).trace
        assert trace["E_law"] == pytest.approx(trace["E_port"] + (1 + 3) * 0.01, abs=1e-15)
        assert seed_energy(Coupled(), axes=3) == pytest.approx((1 + 3) * 0.01)
        assert "E_law" not in run(scene(Wave())).trace
        assert seed_energy(Wave()) == 0.0


def test_honest_books_pass_and_a_work_that_no_held_force_does_or_energy_below_zero_is_caught() -> None:
    try_claims(Dampers(B=0.5))
    try_claims(Coupled(B=0.5))
    for law, said in ((Dampers(B=0.5, wrong=1.0), r", but at tick \d+ its master keeps .* J more than came in by"),
                      (Dampers(B=-2.0), r", which fell to -.* J at tick \d+, below zero by more than")):
        with pytest.raises(Refused, match=f"claims E_law{said}"):
            try_claims(law)


def test_a_field_that_is_a_column_already_or_that_no_state_has_is_not_shown() -> None:
    double = law_of(Dampers, shows=("x",), master_start=lambda self, at: (Place(at.x), Place(at.x)),
                    master=lambda self, s, at, rx: (0.0, Place(at.x), s), master_stored=lambda self, s: 0.0)
    with pytest.raises(Refused, match="the law shows x, and x_m is a column of every record; give that field"):
        run(scene(double()))
    with pytest.raises(Refused, match="shows 'e', which no state of its has"):
        scene(law_of(Dampers, shows=("e",))())


class TestConditions:
    def test_a_condition_is_a_note_of_the_run_and_a_law_is_fitted_to_the_bodies_and_meets_a_scaled_slave(self) -> None:
        """f = 1 N of the law on 3 kg, scaled by (0.5, 4), gives 4/3 m/s^2, which the law sees as 8/3: 3/8 kg."""
        for B, is_noted in ((3.0, True), (1e-3, False)):
            assert any("B is to be below" in note for note in run(scene(Dampers(B=B))).notes) is is_noted
        assert 0.5 * scene().master.mass == fitted(scene(Dampers(B=3.0))).law.B
        assert fitted(scene(Wave())).law == Wave()
        own = replace(scene(), slave=MassDamper(mass=3.0, damping=2.0), scaling=Scaling(scale_x=0.5, scale_f=4.0))
        assert (facts_of(own).mass_s, facts_of(own).damping_s) == (0.375, 0.25)

    def test_delays_are_the_ages_of_what_is_played_gaps_included(self) -> None:
        assert facts_of(scene(link=None)).fwd == Ages(0.001, 0.001)
        steady = facts_of(scene(link=Delay(0.02)))
        assert steady.fwd == pytest.approx(Ages(0.02, 0.02))
        assert not steady.lossy
        lossy = facts_of(scene(link=Delay(0.02) | Bernoulli(0.5)), seed=3)
        assert lossy.lossy
        assert lossy.bwd is not None
        assert lossy.bwd.least == pytest.approx(0.02)
        assert lossy.bwd.greatest >= 0.025

    @pytest.mark.parametrize("law", ["tdpa", "pspm", "two_layer"])
    def test_a_damper_is_held_for_as_long_as_ticks_are_left_out(self, law: str) -> None:
        """The bound was that of a tick, and a damper that a light body turned round in ten of them was no note."""
        late = load_scene("hard_wall", law=law, left_out=0.6, duration=2.0, energy=True)
        own = replace(late, master=replace(late.master, mass=0.05), slave=replace(late.slave, mass=0.05))
        assert facts_of(own).held > 5e-3
        assert any("T the longest tick" in note or "m/T of the slave" in note for note in run(own).notes)
        assert facts_of(replace(own, left_out_m=None, left_out_s=None)).held == 1e-3

    @pytest.mark.parametrize(("playout", "condition", "said"), [
        (Hold(), "any link", "playout holds waves in the gaps, which is active: E_link may fall below zero"),
        (Fixed(0.05, Hold()), "any link", "playout holds waves in the gaps, which is active: E_link may fall below"),
        (Fixed(0.05, Integral()), "any link", None),
        (Fixed(0.05, Integral()), "zero in gaps", "zero in gaps, and the playout is integral"),
        (Zero(), "any link", None), (Integral(), "any link", None), (Fixed(0.05), "zero in gaps", None),
        (Integral(), "zero in gaps", "where waves are played as zero in gaps, and the playout is integral"),
        (Zero(), "constant delay", "over a constant delay without loss, and this link varies"),
    ])
    def test_a_claim_whose_condition_the_link_breaks_is_told(self, playout: Any, condition: str, said: str | None
                                                             ) -> None:
        law = law_of(Wave, claims={"E_link": condition})()
        facts = facts_of(scene(law, link=Delay(0.02) | Bernoulli(0.1), playout=playout))
        told = broken(law, facts)
        assert [said in one for one in told] == [True] if said else told == []


def test_waves_that_are_played_at_once_are_held_over_ticks_that_are_left_out_and_that_is_told() -> None:
    """Of 120 loops with a fifth of the ticks left out E_link fell in 11, by up to 18 % of the energy sent."""
    late = scene(Wave(), link=Delay(0.02), playout=Energy())
    assert broken(Wave(), facts_of(late)) == []
    (told,) = broken(Wave(), facts_of(replace(late, left_out_s=LeftOut(0.2))))
    assert "E_link may fall below zero; type --set playout=integral" in told


def test_a_message_field_with_a_name_of_the_situation_is_refused() -> None:
    """A field f in a message switched the force sensor on, which took an observer at every tick."""

    class Force(NamedTuple):
        f: float

    with pytest.raises(Refused, match="has a message with the field f, a name of At"):
        scene(law_of(Dampers, master_start=lambda self, at: (Bank(0.0), Force(0.0)))())


@pytest.mark.parametrize("name", [name for name in known_laws() if hasattr(find_law(name), "fitted")])
def test_a_law_that_fitted_itself_broke_its_own_condition(name: str) -> None:
    """Dampers were fitted to 2 m/T where the condition says m/T, so a search went back to points that broke it."""
    kind = find_law(name)
    laws = [replace(kind(), **{knob: end}) for knob, each in knobs_of_fields(kind).items()
            for end in each.knob.span or ()]
    assert laws
    for held, ages in product((1e-3, 3e-3), (Ages(0.05, 0.05), Ages(0.06, 0.1))):
        facts = Facts(1e-3, 1, 0.1, 0.5, 0.3, 1.0, ages, ages, ages.greatest > ages.least, "integral", held)
        for law in laws:
            fit = law.fitted(facts)
            assert not hasattr(fit, "conditions") or fit.conditions(facts) == ()


# What a law offers to the analyses: one of the same offers has the same analysis


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
