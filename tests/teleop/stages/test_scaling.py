"""Scaling: the slave's places and forces are so many times the master's, and the ledgers still add up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from channel.delay import Delay
from master.hand import Grip, Reach
from slave.tissue import Tissue
from teleop import Cap, Direct, Frame, MassDamper, Scaling, Scene, Wave, find_law, load_scene, run, seed_energy

SMALL = Scaling(scale_x=0.2, scale_f=0.5)  # a slave a fifth of the size, with half of the force


def scene(**parts: object) -> Scene:
    """A hand that reaches out, and a slave in tissue."""
    return Scene(**{
        "law": Direct(K=400.0, B=15.0, kf=0.5), "master": MassDamper(mass=0.1, damping=2.0),
        "slave": MassDamper(mass=0.3, damping=5.0), "environment": Tissue(k=2000.0, d=20.0), "scaling": SMALL,
        "hand": Grip(mass=0.3, k=300.0, d=20.0, reference=Reach(to=0.05, duration=0.5)),
        "duration": 5.0, **parts})


def test_stiff_contact_comes_to_rest_where_the_springs_balance() -> None:
    """f_h = k_h (r - x_m) = kf f_env/scale_f and scale_f K (x_m - x_s/scale_x) = f_env = k_e x_s, solved by hand."""
    of = scene(duration=20.0)
    trace = run(of).trace
    r, k_h, K, kf, k_e = 0.05, 300.0, 400.0, 0.5, 2000.0
    sx, sf = SMALL.scale_x, SMALL.scale_f
    x_s_of_x_m = sf * K / (k_e + sf * K / sx)
    x_m = k_h * r / (k_h + kf * k_e * x_s_of_x_m / sf)
    assert trace["x_m"][-1] == pytest.approx(x_m, rel=1e-6)
    assert trace["x_s"][-1] == pytest.approx(x_s_of_x_m * x_m, rel=1e-6)
    assert trace["f_m"][-1] == pytest.approx(kf * trace["f_env"][-1] / sf, rel=1e-6)


@pytest.mark.parametrize("scaling", [SMALL, Scaling(scale_x=10.0, scale_f=20.0)])
def test_waves_that_are_passive_stay_so_in_the_units_of_the_law(scaling: Scaling) -> None:
    of = scene(law=Wave(b=10.0), link=Delay(0.05), energy=True, scaling=scaling,
               slave=MassDamper(mass=0.3 * scaling.scale_f / scaling.scale_x, damping=2.0))
    trace = run(of).trace
    assert np.isfinite(trace["x_s"]).all()
    assert trace["E_link"].min() >= -1e-12
    alike = run(replace(of, scaling=None, slave=MassDamper(mass=0.3, damping=2.0 * scaling.scale_x / scaling.scale_f),
                        environment=Tissue(k=2000.0 * scaling.scale_x / scaling.scale_f,
                                           d=20.0 * scaling.scale_x / scaling.scale_f))).trace
    for name, factor in (("x_m", 1.0), ("f_m", 1.0), ("x_s", scaling.scale_x), ("f_s", scaling.scale_f),
                         ("E_port", 1.0), ("E_link", 1.0)):
        assert trace[name] == pytest.approx(factor * alike[name], rel=1e-6, abs=1e-9), name


def test_a_scaling_of_one_is_none() -> None:
    one, none = run(scene(scaling=Scaling(), energy=True)).trace, run(scene(scaling=None, energy=True)).trace
    assert all(np.array_equal(one[name], none[name]) for name in none)


# Axis by axis

EACH = (Scaling(scale_x=0.2, scale_f=0.5), Scaling(scale_x=3.0, scale_f=1.0), Scaling(scale_x=1.0, scale_f=0.25))


def test_each_axis_has_scales_of_its_own_and_is_the_scene_of_that_axis() -> None:
    """Of a law that couples none: motion, forces and energy are those of three scenes of one axis."""
    tissues = tuple([Tissue(k=k, d=20.0) for k in (2000.0, 500.0, 1000.0)])
    reach = Reach(to=(0.05, 0.03, -0.04), duration=0.5)
    hands = tuple([Grip(mass=0.3, k=k, d=20.0, reference=reach) for k in (300.0, 200.0, 400.0)])
    of = scene(axes=3, scaling=EACH, environment=tissues, hand=hands, energy=True, duration=1.0)
    got, E_port = run(of), 0.0
    for i, (scaling, tissue, hand) in enumerate(zip(EACH, tissues, hands, strict=True)):
        own = replace(hand, reference=replace(reach, to=reach.to[i]))
        alone = run(scene(scaling=scaling, environment=tissue, hand=own, energy=True, duration=1.0)).trace
        for name in ("x_m", "x_s", "f_m", "f_s", "f_env"):
            assert np.array_equal(got.trace[name][:, i], alone[name]), name
        E_port = E_port + alone["E_port"]
    assert got.trace["E_port"] == pytest.approx(E_port, rel=1e-9, abs=1e-12)
    slave, master = got.trace["x_s"] / [0.2, 3.0, 1.0], got.trace["x_m"]
    assert got.metrics["x_err_max"] == pytest.approx(np.linalg.norm(slave[1:] - master[:-1], axis=1).max(), rel=1e-9)


@pytest.mark.parametrize("law", ["tdpa", *[pytest.param(law, marks=pytest.mark.full) for law in ("two_layer", "pspm")]])
def test_a_law_that_couples_axes_keeps_its_claim_with_unlike_scales(law: str) -> None:
    """The sum over the axes, in the master's joules, of bodies that couple none."""
    of = scene(law=find_law(law)(), axes=2, scaling=EACH[:2], link=Delay(0.05), energy=True, duration=3.0,
               environment=(Tissue(k=4000.0, d=0.0), Tissue(k=50.0, d=0.0)),
               hand=Grip(mass=0.3, k=300.0, d=20.0, reference=Reach(to=(0.05, -0.03), duration=0.5)))
    result = run(of)
    assert result.status == "ok"
    assert result.trace["E_port"].max() > 0.05, "there was work"
    assert result.trace["E_port"].min() >= -seed_energy(of.law) - 1e-12


def test_scales_are_typed_for_each_axis_and_three_forms_of_one_rotation_are_the_same_frame() -> None:
    made = load_scene("recorded_reach", scale_x="0.5,1,2", scale_f=3.0)
    assert made.scaling == tuple([Scaling(scale_x=one, scale_f=3.0) for one in (0.5, 1.0, 2.0)])
    half = np.linalg.norm(TURN) / 2.0
    quaternion = (np.cos(half), *(np.sin(half) / (2.0 * half) * np.array(TURN)))
    rows = tuple([tuple(row) for row in R.tolist()])
    for rotation in (tuple(map(float, quaternion)), rows):
        assert Frame(rotation=rotation).matrix == pytest.approx(Frame(rotation=TURN).matrix, abs=1e-12)
    typed = load_scene("recorded_reach", frame="0.3,-0.5,1.0").frame
    assert typed == Frame(rotation=TURN)


# A base that is turned

TURN = (0.3, -0.5, 1.0)
R = np.array(Frame(rotation=TURN).matrix).reshape(3, 3)


@pytest.mark.parametrize("name", ["recorded_reach", "pose"])
@pytest.mark.parametrize("law", ["pp", *[pytest.param(law, marks=pytest.mark.full) for law in ("wave", "pspm")]])
def test_a_turned_base_before_nothing_changes_no_motion_of_the_master_and_turns_that_of_the_slave(
        name: str, law: str) -> None:
    """Bodies alike on three axes have no direction, so the law meets them as without a frame."""
    of = replace(load_scene(name, duration=1.5, law=law, energy=True), environment=None, cap=None)
    plain, turned = run(of), run(replace(of, frame=Frame(rotation=TURN)))
    assert turned.trace["x_m"] == pytest.approx(plain.trace["x_m"], abs=1e-12)
    for i in range(0, of.axes, 3):
        for column in ("x_s", "f_s"):
            wanted = plain.trace[column][:, i:i + 3] @ R.T
            assert turned.trace[column][:, i:i + 3] == pytest.approx(wanted, abs=1e-11), column
    assert turned.trace["E_port_s"] == pytest.approx(plain.trace["E_port_s"], abs=1e-12)
    assert turned.metrics["x_err_max"] == pytest.approx(plain.metrics["x_err_max"], rel=1e-9)
    if of.rotations:  # as the law is told it, and so r^-1 q_s r of the slave's own
        for part in "wxyz":
            assert turned.trace[f"q{part}_s"] == pytest.approx(plain.trace[f"q{part}_s"], abs=1e-12)


def test_a_wall_along_x_of_the_slave_is_felt_along_minus_y_by_a_master_whose_base_is_turned_by_a_quarter() -> None:
    """x_s = R x_m with R of 90 degrees about z: the slave's x is the master's -y."""
    of = scene(axes=3, scaling=None, law=Direct(K=400.0, B=15.0), environment=(Tissue(k=2000.0, d=20.0), None, None),
               hand=Grip(mass=0.3, k=300.0, d=20.0, reference=Reach(to=(0.0, -0.05, 0.0), duration=0.5)),
               frame=Frame(rotation=(0.0, 0.0, np.pi / 2.0)), energy=True)
    trace = run(of).trace
    assert trace["f_env"][-1] == pytest.approx([2000.0 * trace["x_s"][-1, 0], 0.0, 0.0], abs=1e-9)
    assert trace["f_env"][-1, 0] > 5.0
    assert trace["f_m"][-1] == pytest.approx([0.0, -trace["f_env"][-1, 0], 0.0], abs=1e-6)


@pytest.mark.parametrize("law", ["wave", *[pytest.param(law, marks=pytest.mark.full) for law in ("pp", "two_layer")]])
def test_a_frame_with_any_rotation_and_size_keeps_the_ledgers_and_the_caps_in_the_slaves_own_axes(law: str) -> None:
    """The slave's axes, scales and surroundings differ; the balance is worked out from the trace by itself."""
    dice = np.random.default_rng(7)
    for _ in range(4):
        q = dice.normal(size=4)
        frame = Frame(rotation=tuple((q / np.linalg.norm(q)).tolist()), scale=float(dice.uniform(0.2, 3.0)))
        of = replace(load_scene("recorded_reach", law=law, energy=True, duration=1.0), frame=frame,
                     scaling=tuple([Scaling(scale_x=a, scale_f=0.5 / a) for a in (0.5, 1.0, 2.0)]),
                     cap=tuple([Cap(f_max=most, slew=1000.0) for most in (0.5, 1.0, 2.0)]),
                     slave=tuple([MassDamper(mass=mass, damping=1.0) for mass in (0.2, 0.5, 1.0)]),
                     link=Delay(0.02))
        trace = run(of).trace
        held = np.vstack([np.zeros(3), trace["f_s"][:-1]])
        work = np.cumsum((held * np.diff(trace["x_s"], axis=0, prepend=trace["x_s"][:1])).sum(axis=1))
        assert trace["E_port_s"] == pytest.approx(work / 0.5, rel=1e-9, abs=1e-12)
        assert (np.abs(trace["f_s"]).max(axis=0) <= [0.5, 1.0, 2.0]).all()
        if law == "wave":
            assert trace["E_link"].min() >= -1e-12
