"""Passive, not passive, not known: a one-port with its encoder, friction, cap, shunt and passivity controller."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import logm

from teleop import Cap, Scene, load_scene
from teleop.analysis.passivity.command import ask, summary, table
from teleop.analysis.passivity.one_port import one_port
from teleop.analysis.zwidth.passive import passive_region
from teleop.physics.relaxing import relaxing_master

T = 1e-3
D = 6e-5


def wall(K: float = 800.0, B: float = 0.0, **own: Any) -> Scene:
    return load_scene("virtual_wall", **{"law.K": K, "law.B": B}, **own)


def inside(scene: Scene, corners: Any = None, scale: float = 1.0) -> bool | None:
    """Is the scene's own (K, B) in the region that `teleop zwidth` claims?"""
    law: Any = scene.law
    corners = passive_region(scene).corners if corners is None else corners
    K, B, around = law.K * scale, law.B * scale, [(0.0, 0.0), *corners]
    sides = [(a[0] - b[0]) * (B - b[1]) - (a[1] - b[1]) * (K - b[0])
             for a, b in zip(around, around[1:] + around[:1], strict=True)]
    return len(corners) > 1 and all(side <= 0.0 for side in sides)


class TestAgreesWithTheZWidth:
    @pytest.mark.parametrize(("step", "friction", "delay"), [
        (None, 0.1, 2), *(pytest.param(*numbers, marks=pytest.mark.full) for numbers in (
            (D, 0.06, 1), (None, 0.0, 0), (D, 0.0, 0), (D, 0.02, 0), (D, 1.0, 0))),
    ])
    def test_walls(self, step: float | None, friction: float, delay: int) -> None:
        corners = passive_region(wall(friction=friction, step=step, delay=delay)).corners
        seen = set()
        for K in (10.0, 100.0, 300.0, 500.0, 650.0, 700.0, 1000.0, 1550.0, 1650.0, 3000.0):
            for B in (0.0, 0.03, 0.3, 0.9):
                scene = wall(K, B, friction=friction, step=step, delay=delay)
                claimed = inside(scene, corners)
                if {inside(scene, corners, scale) for scale in (0.99, 1.01)} != {claimed}:
                    continue  # at the polygon's edge
                got = one_port(scene).passive
                seen.add(claimed)
                if claimed:
                    assert got is True
                elif step is None or friction == 0.0 or B == 0.0:
                    assert got is False  # both conditions are necessary
                else:
                    assert got is not True
        assert seen == ({False} if step and not friction else {True, False})

    def test_a_shunt_counts_as_there(self) -> None:
        for b_e in (0.1, 1.0, 10.0):
            for K, B in ((1200.0, 0.3), (1200.0, 0.7), (2000.0, 0.0), (400.0, 0.9)):
                scene = load_scene("virtual_coupling", b_e=b_e, law="virtual_wall", **{"law.K": K, "law.B": B})
                assert one_port(scene).passive is inside(scene), (b_e, K, B)

    def test_some_walls_are_passive_by_the_shunt_alone(self) -> None:
        own = {"law": "virtual_wall", "law.K": 400.0, "law.B": 0.9}
        assert one_port(load_scene("virtual_coupling", **own)).passive is False
        with_shunt = one_port(load_scene("virtual_coupling", b_e=10.0, **own))
        assert with_shunt.passive is True
        assert "the shunt of its motor adds" in with_shunt.verdict.sentence
        slow = load_scene("virtual_coupling", b_e=10.0, every=2, **own)
        assert one_port(slow).passive is None
        assert one_port(slow).left_out == ("electrical damping",)


class TestAShunt:
    def test_was_left_out_of_what_the_device_has(self) -> None:
        """Of a wall that is damped too much it is the frequency where the two differ most that decides."""
        got = one_port(load_scene("virtual_wall", b_e=0.5, **{"law.K": 400.0, "law.B": 1.5})).verdict
        assert got.sentence == ("not passive: the device has 0.8 N s/m, to which the shunt of its motor adds "
                                "0.4998 N s/m, and needs 1.7 N s/m at 500 Hz, where most is missing")
        slow = one_port(load_scene("virtual_wall", b_e=1.0, **{"law.K": 3210.0})).verdict
        assert slow.sentence == ("not passive: the device has 0.8 N s/m, to which the shunt of its motor adds 0 N s/m, "
                                 "and needs 1.605 N s/m in slow motion, where most is missing")
        told = summary(ask(load_scene("virtual_wall", b_e=1.0, **{"law.K": 3210.0})))
        assert told["shunt"] == {"added_damping": 0.0, "needed_damping": pytest.approx(1.605), "frequency": 0.0}

    @pytest.mark.parametrize(("K", "B", "delay", "cutoff"), [
        (400.0, 1.5, 0, 10.0), (900.0, 0.4, 1, 40.0), (1200.0, 0.7, 0, 150.0),
    ])
    def test_adds_what_the_integral_over_all_that_a_sample_mixes_gives(
        self, K: float, B: float, delay: int, cutoff: float
    ) -> None:
        """Colgate and Schenkel's condition summed by hand, the damping measured on the stage's own exact steps."""
        scene = load_scene("virtual_wall", b_e=2.0, cutoff=cutoff, delay=delay, **{"law.K": K, "law.B": B})
        assert scene.electrical is not None
        device = relaxing_master(scene.master, 0.0, 0.0, 0.0, T, b_e=scene.electrical.b, cutoff=cutoff)
        th = np.linspace(0.0, np.pi, 400)[1:]
        w = (th[:, None] + 2.0 * np.pi * np.arange(-20, 21)) / T  # beyond, r is constant
        r = real_impedance(device.c[:12], w)
        far = 1.0 / (2.0 * np.sin(th / 2.0)) ** 2 * T * T - (1.0 / w**2).sum(axis=1)
        b_eff = ((1.0 / w**2).sum(axis=1) + far) / ((1.0 / (r * w**2)).sum(axis=1) + far / r[:, -1])
        z = np.exp(1j * th)
        needed = -(z ** -(delay + 1.0) * (K * T / (1.0 - 1.0 / z) + B)).real
        worst = int((needed / b_eff).argmax())
        got = one_port(scene)
        assert got.passive is bool((needed <= b_eff).all())
        assert got.verdict.shunt is not None
        assert got.verdict.shunt.adds == pytest.approx(b_eff[worst] - 0.8, rel=2e-3, abs=3e-3)
        assert got.verdict.shunt.needs == pytest.approx(needed[worst], rel=2e-3)


def real_impedance(step: Any, w: Any) -> Any:
    """Re f/v (N s/m) at w (rad/s) of the continuous system whose exact step over T is `step`, rows of (A, b)."""
    whole = np.vstack([np.array(step, dtype=float).reshape(3, 4), [0.0, 0.0, 0.0, 1.0]])
    rate = logm(whole).real / T
    inner = 1j * np.asarray(w)[..., None, None] * np.eye(3) - rate[:3, :3]
    v: Any = np.linalg.solve(inner, rate[:3, 3:] + 0j)[..., 1, 0]
    return (1.0 / v).real


class TestEncoder:
    def test_without_friction_nothing_is_passive_but_a_wall_of_nothing(self) -> None:
        for K in (400.0, 1450.0):
            got = ask(load_scene("encoder_wall", K=K))
            assert summary(got)["passive"] is False
            assert got.sentence.startswith("not passive: without Coulomb friction nothing takes up")
            assert got.left_out == ()
            assert "left out" not in table(got)
            assert "no spring is passive behind it without friction" in table(got)
        assert one_port(wall(0.0, 0.0, step=D)).passive is True

    def test_a_spring_alone_is_at_the_bound_of_abbott_and_okamura(self) -> None:
        for friction, passive in ((0.0239, False), (0.0241, True)):
            got = one_port(wall(step=D, friction=friction))
            assert got.passive is passive
            assert got.verdict.friction == pytest.approx(800.0 * D / 2)
            assert got.quantised == pytest.approx(2 * friction / D)

    def test_with_a_damper(self) -> None:
        """(D/2)(K + 2 B/T) is enough; less may be."""
        for B, friction, passive in ((0.1, 0.0299, None), (0.1, 0.0301, True), (0.5, 10.0, False), (0.5, 0.01, False)):
            got = one_port(wall(B=B, step=D, friction=friction))
            assert got.passive is passive, (B, friction)
            assert got.verdict.friction == pytest.approx(D / 2 * (800.0 + 2 * B / T))
            assert got.quantised is None  # a bound of springs alone

    def test_behind_a_virtual_coupling_it_has_no_known_bound(self) -> None:
        got = ask(load_scene("virtual_coupling", step=D, friction=1.0))
        assert summary(got)["passive"] is None
        assert summary(got)["quantised_stiffness"] is None
        assert "a spring alone" not in table(got)
        assert got.sentence.startswith("not known: ")


class TestLeftOut:
    def test_a_passivity_controller_is_not_judged(self) -> None:
        for K, without in ((400.0, "without it passive"), (2000.0, "without it not passive")):
            got = ask(load_scene("encoder_wall", K=K, cap=0.8, step=None))
            assert summary(got)["passive"] is None
            assert got.left_out == ("passivity controller",)
            assert got.sentence.startswith(f"not known with its passivity controller; {without}: the device has")
            assert "left out" in table(got)

    def test_a_cap(self) -> None:
        every: list[tuple[dict[str, float], float | None, bool | None]] = [
            ({}, None, True), ({}, 100.0, None), ({"B": 0.1}, None, None), ({"K": 2000.0}, 100.0, False),
            ({"K": 2000.0, "friction": 0.1}, None, None), ({"step": D}, None, False), ({"step": D}, 100.0, None),
            ({"step": D, "friction": 1.0}, None, True),
        ]
        for more, slew, passive in every:
            got = one_port(replace(wall(**more), cap=Cap(f_max=2.0, slew=slew)))
            assert got.passive is passive, (more, slew)
            assert got.left_out == (("cap",) if passive is None else ())
        for limit in ({"v_max": 0.1}, {"power": 1.0}):  # which act on driving force, and may take braking force too
            assert one_port(replace(wall(), cap=Cap(f_max=2.0, **limit))).passive is None
