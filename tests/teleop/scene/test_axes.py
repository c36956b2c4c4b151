"""Axes with units, names and parts of their own."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from channel import Delay
from master import Grip, Sine
from teleop import (
    TDPA,
    Cap,
    Device,
    Encoder,
    LowPass,
    MassDamper,
    PositionPosition,
    Refused,
    Scene,
    Wave,
    each_axis,
    load_scene,
    run,
    sweep,
)
from teleop.scene.scene import on_axis
from tests.teleop.scene import unlike as own_file
from tests.teleop.scene.unlike import GAINS, LAWS, MASSES, unlike

FILE = str(own_file.__file__)
COUPLED = {"tdpa"}  # laws whose energy is one for all axes


class TestEachAxis:
    @pytest.mark.parametrize("law", [law for law in LAWS if law not in COUPLED])
    def test_moves_as_it_does_alone(self, law: str) -> None:
        """What does not couple the axes leaves each as the one-axis scene of it has it, to the bit."""
        scene = unlike(LAWS[law], hand=Grip(mass=0.4, k=200.0, d=5.0, reference=Sine(amplitude=0.05, frequency=1.0)))
        # A link draws by the size of the packets only if it has a rate, so the packets of one axis meet the same fate.
        trace = run(scene, seed=3).trace
        for i in range(3):
            own = on_axis(scene, i)
            assert (own.axes, own.axis_names[0], own.axis_units[0]) == (1, scene.axis_names[i], scene.axis_units[i])
            alone = run(own, seed=3).trace
            for name in ("x_m", "v_m", "f_m", "x_s", "v_s", "f_s", "f_env"):
                assert np.array_equal(trace[name][:, i], alone[name]), name

    def test_has_its_own_body_hand_cap_and_encoder(self) -> None:
        base = run(unlike(), seed=3).trace
        for name, value, changed in (
                ("master", MassDamper(mass=0.15, damping=0.5), "x_m"), ("slave", MassDamper(mass=0.9), "x_s"),
                ("law", PositionPosition(K=150.0, B=5.0), "f_m"), ("cap", Cap(f_max=0.05), "f_m"),
                ("device_m", Device(encoder=Encoder(step=1e-3), velocity=LowPass(cutoff=30.0)), "q_m")):
            scene = unlike()
            parts = list(scene.per_axis(name))
            parts[0] = value
            trace = run(replace(scene, **{name: tuple(parts)}), seed=3).trace
            assert not np.array_equal(trace[changed][:, 0], base[changed][:, 0]), name
            assert np.array_equal(trace[changed][:, 1:], base[changed][:, 1:]), name
        assert np.abs(base["f_m"][:, 0]).max() <= 5.0
        assert np.array_equal(np.round(base["q_m"] / (1e-5, 2e-5, 4e-5)) * (1e-5, 2e-5, 4e-5), base["q_m"])

    def test_that_nobody_holds_moves_freely_beside_others(self) -> None:
        own = on_axis(unlike(), 1)
        assert own.reference is None
        still = run(replace(own, law=PositionPosition(K=200.0, B=5.0), cap=None, device_m=None), seed=3).trace
        assert still["x_m"][0] == 0.02

    def test_with_parts_that_are_alike_is_the_scene_of_one_part_for_all(self) -> None:
        scene = load_scene("recorded_reach", law="pp", duration=1.0)
        apart = replace(scene, **{name: scene.per_axis(name) for name in ("law", "master", "slave", "hand", "cap")})
        one, other = run(scene, seed=1).trace, run(apart, seed=1).trace
        assert all(np.array_equal(one[name], other[name], equal_nan=True) for name in one)

    def test_takes_numbers_of_a_part_as_a_tuple_or_as_one(self) -> None:
        assert each_axis(MassDamper, 3, mass=0.5) == MassDamper(mass=0.5)
        assert [each.mass for each in each_axis(MassDamper, 3, mass=MASSES)] == [*MASSES]
        with pytest.raises(Refused, match="mass has 3 numbers, the scene has 2 axes"):
            each_axis(MassDamper, 2, mass=MASSES)


class TestGains:
    def test_of_a_law_are_typed_axis_by_axis(self, tmp_path: Any) -> None:
        scene = load_scene("recorded_reach", law="pp", **{"law.K": "300,200,100", "law.B": "5"})
        assert [law.K for law in scene.laws] == [*GAINS]
        assert {law.B for law in scene.laws} == {5.0}

    def test_of_the_wrong_number_are_refused(self) -> None:
        with pytest.raises(Refused, match="law names 2 axes, the scene has 3; write one number for all axes, or one"):
            load_scene("recorded_reach", law="pp", **{"law.K": "300,200"})
        with pytest.raises(Refused, match=r"law.K has 2 and law.B has 3; write one number"):
            load_scene("recorded_reach", law="pp", **{"law.K": "300,200", "law.B": "1,2,3"})
        with pytest.raises(Refused, match=r"law.K must be a number.*'x'"):
            load_scene("recorded_reach", law="pp", **{"law.K": "300,x,1"})

    def test_are_in_the_summary_of_a_run(self) -> None:
        scene = load_scene("recorded_reach", law="pp", duration=0.1, **{"law.K": "300,200,100"})
        law: Any = run(scene).summary()["parameters"]["law"]
        assert law["K"] == [*GAINS]
        assert isinstance(law["B"], float)


@pytest.mark.parametrize("axes", [1, 6, 16])
def test_as_many_as_sixteen_run(axes: int) -> None:
    scene = Scene(law=PositionPosition(K=200.0, B=5.0), axes=axes, link=Delay(0.01), duration=0.2,
                  start_m=(0.01,) * axes, master=MassDamper(mass=0.1), slave=MassDamper(mass=0.5))
    assert run(scene).status == "ok"
    assert len(scene.axis_names) == axes == len(set(scene.axis_names))


REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"names": ("a", "b")}, "names has 2 entries, the scene has 3 axes"),
    ({"names": ("a", "a", "b")}, "two axes have the name a"),
    ({"names": ("a", "b c", "d")}, "'b c' is none"),
    ({"names": "abc"}, "names must be a tuple of texts"),
    ({"units": ("m", "m", "mm")}, "the unit of an axis is m or rad, not 'mm'"),
    ({"master": (MassDamper(mass=1.0),) * 2}, "master names 2 axes, the scene has 3"),
    ({"master": (MassDamper(mass=1.0), None, MassDamper(mass=1.0))}, "master is None on the axis with index 1"),
    ({"slave": (MassDamper(mass=1.0), MassDamper(mass=1.0), 3.0)}, "slave must be something with mass"),
    ({"law": (Wave(), Wave(), PositionPosition())}, "of one class.*not PositionPosition and Wave"),
    ({"device_m": (Device(), Device(), Device(every=2))}, "device_m differ in more than numbers"),
    ({"device_m": (Device(encoder=Encoder(step=1e-5)), Device(), Device())}, "an encoder or none"),
    ({"cap": (Cap(power=1.0), Cap(power=2.0), Cap(power=1.0))}, "the same power"),
    ({"cap": (Cap(f_max=1.0), 3.0, None)}, "cap must be something with limits"),
]


@pytest.mark.parametrize(("parts", "sentence"), REFUSED)
def test_parts_that_do_not_go_together_are_refused(parts: dict[str, Any], sentence: str) -> None:
    with pytest.raises(Refused, match=sentence):
        unlike(**parts)


def test_a_law_is_told_of_by_the_axes_on_which_its_condition_breaks() -> None:
    scene = unlike(tuple([TDPA(K=K, B=0.5, alpha_max=300.0) for K in (1500.0, 1500.0, 10.0)]), device_m=None)
    told = [note for note in run(scene).notes if note.startswith("shoulder and elbow: ")]
    assert told, run(scene).notes
    unlike_numbers = replace(scene, law=tuple([TDPA(K=K, B=0.5, alpha_max=300.0) for K in (1500.0, 1600.0, 10.0)]),
                             device_m=None)
    told = [note for note in run(unlike_numbers).notes if "the coupling of a slave that owes" in note]
    assert len(told) == 1
    assert told[0].startswith("shoulder: ")
    assert told[0].endswith("law.B=0.7837 is the least (and elbow, with their own numbers)")



@pytest.mark.parametrize("law", ["pp"])
def test_engines_agree_on_axes_that_are_unlike(law: str) -> None:
    metrics = ("x_err_rms", "f_m_max", "f_s_max", "energy_out", "jerk_rms")
    told = {engine: sweep(FILE, {"start": [0.01, 0.02, 0.03]}, fixed={"gains": law, "duration": 0.3}, metrics=metrics,
                          engine=engine) for engine in ("plain", "scalar", "vector")}
    rows = [[[row[name] for name in metrics] for row in table] for table in told.values()]
    assert rows[0] == rows[1] == rows[2]
