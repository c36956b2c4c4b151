"""`teleop passivity` as a user asks it: one port and two, tables, JSON, files, figures, refusals."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from teleop import LowPass, Refused, load_scene
from teleop.__main__ import main
from teleop.analysis.models import sampled
from teleop.analysis.models.by_axis import along
from teleop.analysis.passivity.command import ask, summary, table
from teleop.analysis.passivity.one_port import one_port
from teleop.laws.virtual_coupling import ANTICIPATES, UNSTABLE
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
        soft, hard = replace(one.law, K=500.0), replace(one.law, K=800.0)  # type: ignore[type-var]
        two = replace(one, axes=2, law=(soft, hard))
        assert [ask(along(two, name)).one.stiffness for name in "xy"] == pytest.approx([500.0, 800.0])  # type: ignore[union-attr]


class TestOnePort:
    def test_a_wall(self) -> None:
        got = one_port(load_scene("virtual_wall", **{"law.K": 800.0, "law.B": 0.3}))
        assert got.needed.damping == pytest.approx(0.7, rel=1e-9)
        assert got.stiffness == pytest.approx(800.0)
        assert got.passive
        assert not one_port(load_scene("virtual_wall", **{"law.K": 800.0, "law.B": 0.41})).passive

    def test_delay_and_slow_renewal(self) -> None:
        for delay, every in ((3, 1), (0, 4), (2, 3)):
            got = one_port(load_scene("virtual_wall", delay=delay, every=every, **{"law.B": 0.2}))
            wanted = sampled.needed_damping(sampled.spring_damper(800.0, 0.2, T), T, d=delay, every=every)
            assert got.needed.damping == pytest.approx(wanted.damping, rel=1e-8), (delay, every)

    def test_a_filtered_velocity(self) -> None:
        scene = load_scene("virtual_wall", **{"law.B": 0.4})
        assert scene.device_m is not None
        slow = replace(scene, device_m=replace(scene.device_m, velocity=LowPass(cutoff=30.0)))
        wanted = sampled.needed_damping(filtered_wall(800.0, 0.4, T, 30.0), T)
        assert one_port(slow).needed.damping == pytest.approx(wanted.damping, rel=1e-8)

    def test_the_closed_form_of_a_coupling_is_its_controller(self) -> None:
        from teleop.analysis.passivity.one_port import _controller

        scene = load_scene("virtual_coupling")
        th = np.geomspace(1e-2, 3.0, 20)
        by_ticks, closed = (sampled.smooth(E, th) for E in (_controller(scene, T), one_port(scene).E))
        assert by_ticks == pytest.approx(closed, rel=1e-7)

    def test_a_coupling_to_an_active_tool(self) -> None:
        got = one_port(load_scene("virtual_coupling", b=1.2, **{
            "law.theta_f": 0.0, "law.k_e": 2000.0, "law.mass": 1e-3})).behind
        assert got is not None
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
def test_no_dashed_curve_is_hidden_under_a_solid_one_of_its_colour(
    scene: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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


class TestCommand:
    def test_json(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["passivity", "virtual_wall", "--set", "law.K=1600", "--json"]) == 0
        told = json.loads(capsys.readouterr().out)
        assert told["needed_damping"] == pytest.approx(0.8, rel=1e-9)
        assert told["passive"]

    def test_files_and_figure(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        pytest.importorskip("matplotlib")
        for scene, *more in (("virtual_wall", "--plot"), ("virtual_coupling",), ("soft_tissue",)):
            out = tmp_path / scene
            assert main(["passivity", scene, "--out", str(out), "--json", *more]) == 0
            assert json.loads(capsys.readouterr().out)["path"] == str(out)
            drawn = {"passivity.png"} if more else set()
            assert {path.name for path in out.iterdir()} == {"summary.json", "curves.npz"} | drawn
            with np.load(out / "curves.npz") as curves:
                assert all(np.isfinite(curves[key]).all() for key in curves if not key.endswith("eta"))
        assert (tmp_path / "virtual_wall" / "passivity.png").read_bytes()[:4] == b"\x89PNG"
