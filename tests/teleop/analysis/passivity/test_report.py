"""`teleop passivity`: one port and two as a user asks for them, and whether it is passive, not passive or not known."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import logm

from teleop import Cap, LowPass, Refused, Scene, load_scene
from teleop.__main__ import main
from teleop.analysis.models import sampled
from teleop.analysis.models.by_axis import along
from teleop.analysis.passivity.command import ask, summary, table
from teleop.analysis.passivity.one_port import one_port
from teleop.analysis.zwidth.passive import passive_region
from teleop.laws.virtual_coupling import ANTICIPATES, UNSTABLE
from teleop.physics.relaxing import relaxing_master
from tests.teleop.analysis.models.closed_forms import filtered_wall

T = 1e-3


class TestOneAxisOfSeveral:
    """--axis NAME asks of the loop along that axis, in its units, and of no other."""

    def test_of_a_two_port(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["passivity", "pose", "--axis", "rx"]) == 0
        out = capsys.readouterr().out
        assert "felt of 0.01 N m/rad touched" in out  # k_t
        assert "N/m" not in out
        units = summary(ask(along(load_scene("pose"), "rx")))["units"]
        assert (units["felt_stiffness"], units["free_impedance"], units["range"]) == ("N m/rad", "N m s/rad", "Hz")

    def test_of_a_one_port(self) -> None:
        """Of two axes the second is the wall that the scene of one axis has by itself, the first another."""
        one = load_scene("virtual_wall")
        soft, hard = replace(one.law, K=500.0), replace(one.law, K=800.0)
        two = replace(one, axes=2, law=(soft, hard))
        assert [ask(along(two, name)).one.stiffness for name in "xy"] == pytest.approx([500.0, 800.0])


class TestOnePort:
    def test_delay_slow_renewal_and_a_filtered_velocity(self) -> None:
        for delay, every in ((3, 1), (0, 4), (2, 3)):
            got = one_port(load_scene("virtual_wall", delay=delay, every=every, **{"law.B": 0.2}))
            wanted = sampled.needed_damping(sampled.spring_damper(800.0, 0.2, T), T, d=delay, every=every)
            assert got.needed.damping == pytest.approx(wanted.damping, rel=1e-8), (delay, every)
        scene = load_scene("virtual_wall", **{"law.B": 0.4})
        assert scene.device_m is not None
        slow = replace(scene, device_m=replace(scene.device_m, velocity=LowPass(cutoff=30.0)))
        wanted = sampled.needed_damping(filtered_wall(800.0, 0.4, T, 30.0), T)
        assert one_port(slow).needed.damping == pytest.approx(wanted.damping, rel=1e-8)

    def test_a_coupling_to_an_active_tool(self) -> None:
        got = one_port(load_scene("virtual_coupling", b=1.2, **{
            "law.theta_f": 0.0, "law.k_e": 2000.0, "law.mass": 1e-3})).behind
        assert got.alpha.alpha == np.inf  # on the circle 2 m/T - k_e T/2 = 1, but E has a pole at infinity
        assert got.gamma == pytest.approx(0.7)
        assert got.miller == pytest.approx(1.2 * 0.7 / 1.9)
        assert got.most == pytest.approx(0.7 - 0.04 / 0.9, rel=1e-6)
        assert {name: (lack.alpha, lack.why) for name, lack in got.integrators.items()} == {
            "explicit": (np.inf, UNSTABLE), "semi-implicit": (np.inf, ANTICIPATES), "trapezoid": (0.0, ""),
            "backward": (0.0, "")}

    def test_no_damper_makes_an_explicit_tool_passive(self) -> None:
        got = ask(load_scene("virtual_coupling", **{"law.theta_f": 0.3, "law.mass": 0.1}))
        told = json.loads(json.dumps(summary(got), allow_nan=False, default=str))["coupling"]
        assert told["alpha_e"] is None
        assert told["alpha_by_integrator"] == {
            "explicit": None, "semi-implicit": None, "trapezoid": 0.0, "backward": 0.0}
        assert told["why_not"] == {"alpha_e": ANTICIPATES, "explicit": UNSTABLE, "semi-implicit": ANTICIPATES}
        assert f"not passive by any alpha_e: {ANTICIPATES}" in table(got)
        assert f"explicit {UNSTABLE}, semi-implicit {ANTICIPATES}, trapezoid passive" in table(got)

    def test_a_semi_implicit_tool_needs_a_mass(self) -> None:
        """z = -1 is a root of m (z-1)^2 + B T (z-1) + (K + k_e) T^2 z at 4 m = 2 B T + (K + k_e) T^2."""
        least = (2 * 0.2 * T + 101_000.0 * T**2) / 4
        own = {"law.theta_f": 0.0, "law.k_e": 1e5}
        assert one_port(load_scene("virtual_coupling", **own, **{"law.mass": 1.01 * least})).behind is not None
        with pytest.raises(Refused, match="grows by itself"):
            one_port(load_scene("virtual_coupling", **own, **{"law.mass": 0.99 * least}))


def test_every_answer_is_json_and_a_short_table() -> None:
    for name, ports in (("virtual_wall", 1), ("virtual_coupling", 1), ("encoder_wall", 1), ("canonical", 2)):
        answer = ask(load_scene(name))
        told = json.loads(json.dumps(summary(answer), allow_nan=False, default=str))
        assert told["ports"] == ports
        assert answer.sentence in table(answer)
        assert len(table(answer).splitlines()) <= 12


@pytest.mark.parametrize("scene", ["soft_tissue", pytest.param("canonical", marks=pytest.mark.full)])
def test_no_dashed_curve_is_hidden_by_a_solid_one(scene: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    from teleop.analysis.passivity import command

    made: list[Any] = []
    monkeypatch.setattr(command.plot, "save", lambda figure, *_: made.append(figure) or [])
    command.draw(ask(load_scene(scene, law="wave" if scene == "canonical" else "direct")), tmp_path / "p")
    seen = 0
    for axes in made[0].axes:
        lines = axes.get_lines()
        for i, dashed in enumerate(lines):
            for under in lines[:i] if dashed.get_linestyle() == "--" else ():
                if under.get_color() == dashed.get_color():
                    assert under.get_linewidth() > 2.0 * dashed.get_linewidth()
                    assert under.get_alpha() <= 0.5
                    seen += 1
            assert not any(later.get_color() == dashed.get_color() and later.get_linestyle() == "-"
                           for later in lines[i + 1:] if dashed.get_linestyle() == "--")
    assert seen == 6


def test_the_command_leaves_files_and_a_figure(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    for scene, *more in (("virtual_wall", "--set", "law.K=1600", "--plot"), ("virtual_coupling",), ("soft_tissue",)):
        out = tmp_path / scene
        assert main(["passivity", scene, "--out", str(out), "--json", *more]) == 0
        told = json.loads(capsys.readouterr().out)
        assert told["path"] == str(out)
        assert scene != "virtual_wall" or (told["passive"], told["needed_damping"]) == (True, pytest.approx(0.8))
        drawn = {"passivity.png"} if more else set()
        assert {path.name for path in out.iterdir()} == {"summary.json", "curves.npz"} | drawn
        with np.load(out / "curves.npz") as curves:
            assert all(np.isfinite(curves[key]).all() for key in curves if not key.endswith("eta"))
    assert (tmp_path / "virtual_wall" / "passivity.png").read_bytes()[:4] == b"\x89PNG"


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

    def test_a_shunt_counts_as_there_and_some_walls_are_passive_by_it_alone(self) -> None:
        for b_e in (0.1, 1.0, 10.0):
            for K, B in ((1200.0, 0.3), (1200.0, 0.7), (2000.0, 0.0), (400.0, 0.9)):
                scene = load_scene("virtual_coupling", b_e=b_e, law="virtual_wall", **{"law.K": K, "law.B": B})
                assert one_port(scene).passive is inside(scene), (b_e, K, B)
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
    def test_adds_the_integral_of_all_that_a_sample_mixes(self, K: float, B: float, delay: int, cutoff: float) -> None:
        """Colgate and Schenkel's condition summed by hand, the damping measured on the stage's own exact steps."""
        scene = load_scene("virtual_wall", b_e=2.0, cutoff=cutoff, delay=delay, **{"law.K": K, "law.B": B})
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

    def test_a_spring_alone_is_at_the_bound_of_abbott_and_okamura_and_with_a_damper_that_much_is_enough(self) -> None:
        """(D/2)(K + 2 B/T): with a damper less may be enough, too."""
        for B, friction, passive in ((0.0, 0.0239, False), (0.0, 0.0241, True), (0.1, 0.0299, None),
                                     (0.1, 0.0301, True), (0.5, 10.0, False), (0.5, 0.01, False)):
            got = one_port(wall(B=B, step=D, friction=friction))
            assert got.passive is passive, (B, friction)
            assert got.verdict.friction == pytest.approx(D / 2 * (800.0 + 2 * B / T))
            assert got.quantised == (None if B else pytest.approx(2 * friction / D)), "a bound of springs alone"

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
