"""Axes with units, names and parts of their own, what a run leaves of them, and those of a rotation."""

from __future__ import annotations

import json
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from channel import Delay
from master import Grip, Sine
from teleop import (
    TDPA,
    MassDamper,
    ModelMediated,
    PositionPosition,
    Refused,
    Scene,
    VirtualWall,
    Wave,
    around,
    each_axis,
    load_result,
    load_scene,
    run,
)
from teleop.export.files import schema_of, write_csv, write_metadata
from teleop.export.stored import all_fields, read_parts
from teleop.export.stream import GrowingEnd
from teleop.live.records.reader import FILE, read_header
from teleop.live.records.record import RecordWriter
from teleop.scene.axes import AxisLabels, labels_of
from teleop.scene.scene import on_axis, without_orientation
from teleop.simulation.summary_shape import RUN
from teleop.storage.strict_json import Misshapen
from tests.fakes import Springs
from tests.teleop.scene.unlike import GAINS, LAWS, MASSES, unlike
from tests.teleop.stages.tumbling import tumbling

COUPLED = {"tdpa"}  # laws whose energy is one for all axes


class TestEachAxis:
    @pytest.mark.parametrize("law", ["wave", *[
        pytest.param(law, marks=pytest.mark.full) for law in LAWS if law not in {"wave", *COUPLED}]])
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

    def test_with_parts_that_are_alike_is_the_scene_of_one_part_for_all_and_numbers_are_a_tuple_or_one(self) -> None:
        scene = load_scene("recorded_reach", law="pp", duration=1.0)
        apart = replace(scene, **{name: scene.per_axis(name) for name in ("law", "master", "slave", "hand", "cap")})
        one, other = run(scene, seed=1).trace, run(apart, seed=1).trace
        assert all(np.array_equal(one[name], other[name], equal_nan=True) for name in one)
        assert each_axis(MassDamper, 3, mass=0.5) == MassDamper(mass=0.5)
        assert [each.mass for each in each_axis(MassDamper, 3, mass=MASSES)] == [*MASSES]
        assert on_axis(unlike(), 1).reference is None, "nobody holds that one"


def test_gains_of_a_law_are_typed_axis_by_axis_and_are_in_the_summary_of_a_run() -> None:
    scene = load_scene("recorded_reach", law="pp", duration=0.1, **{"law.K": "300,200,100", "law.B": "5"})
    assert [law.K for law in scene.laws] == [*GAINS]
    assert {law.B for law in scene.laws} == {5.0}
    law: Any = run(scene).summary()["parameters"]["law"]
    assert law["K"] == [*GAINS]
    assert isinstance(law["B"], float)


def test_as_many_as_sixteen_run_and_their_record_can_be_read(tmp_path: Path) -> None:
    scene = Scene(law=PositionPosition(K=200.0, B=5.0), axes=16, link=Delay(0.01), duration=0.05,
                  start_m=(0.01,) * 16, master=MassDamper(mass=0.1), slave=MassDamper(mass=0.5))
    assert run(scene).status == "ok"
    assert len(scene.axis_names) == 16 == len(set(scene.axis_names))
    header = read_header(BytesIO(live_record(scene, tmp_path)))
    assert (header["axes"], header["columns"].count("x_m")) == (16, 16)


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


NAMES, UNITS = ("shoulder", "elbow", "rail"), ("rad", "rad", "m")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    at = tmp_path_factory.mktemp("labels") / "run"
    run(unlike(duration=0.1)).save(at)
    return at


def test_labels_are_in_the_summary_and_come_back_with_the_run_and_a_scene_without_leaves_the_files_as_they_were(
    folder: Path
) -> None:
    told = json.loads((folder / "summary.json").read_text())
    assert (told["axis_names"], told["axis_units"]) == ([*NAMES], [*UNITS])
    assert load_result(folder).labels == AxisLabels(NAMES, UNITS)
    for wrong in ({"axis_units": ["mm"]}, {"axis_names": "x"}, {"axis_names": ["a"] * 17}):
        with pytest.raises(Misshapen):
            RUN({**told, **wrong}, "summary.json")
    for name in ("canonical", "recorded_reach"):
        scene = load_scene(name, duration=0.01)
        assert not {"axis_names", "axis_units"} & run(scene).summary().keys()
        assert labels_of(scene) == AxisLabels()


def test_a_csv_has_them_in_its_columns_and_units_and_mcap_a_field_for_each(folder: Path) -> None:
    parts = read_parts(folder, trust=False)
    rows, about = BytesIO(), BytesIO()
    write_csv(rows, parts)
    write_metadata(about, Path("run.csv"), parts)
    head = rows.getvalue().split(b"\n")[0].decode().split(",")
    columns = {one["name"]: one for one in json.loads(about.getvalue())["tableSchema"]["columns"]}
    assert [*columns] == head
    units = [columns[name]["schema:unitText"] for name in
             ("x_m_elbow", "v_s_elbow", "f_m_elbow", "x_m_rail", "v_s_rail", "f_m_rail", "t")]
    assert units == ["rad", "rad/s", "N m", "m", "m/s", "N", "s"]
    assert columns["x_m_elbow"]["dc:description"].endswith(", along elbow")
    own = schema_of("master", "", [one for one in all_fields(parts) if one.name in ("f_m", "g_m")])["properties"]
    assert [*own["f_m"]["properties"]] == [*NAMES]
    assert [text["description"].partition("hand ")[2][:5] for text in own["f_m"]["properties"].values()] == [
        "(N m)", "(N m)", "(N); "]
    assert "(N" not in own["f_m"]["description"]  # of all axes together it has no unit


def live_record(scene: Scene, at: Path) -> bytes:
    writer = RecordWriter(scene, "m", at, {"scene": "hard_wall", "knobs": {}, "seed": 0, "mode": "live", "command": []})
    writer.begin("bodies")
    width = len(json.loads((at / FILE).read_bytes().partition(b"\n")[0])["columns"]) - 3
    writer.add(0, 0, 0, (0.5,) * width)
    writer.close()
    return (at / FILE).read_bytes()


def test_a_live_record_has_them_in_its_header_and_its_stream_and_one_without_those_of_its_number_of_axes(
    tmp_path: Path
) -> None:
    """As one from before there were names."""
    for folder, scene, names in (("named", unlike(), NAMES), ("old", replace(unlike(), names=(), units=()), "xyz")):
        (at := tmp_path / folder).mkdir()
        record = live_record(scene, at)
        if folder == "named":
            header = read_header(BytesIO(record))
            assert (header["axis_names"], header["axis_units"]) == ([*NAMES], [*UNITS])
        assert (b"axis_names" in record) == (folder == "named")
        end = GrowingEnd(at, 0)
        end.take(1)
        assert next(one for one in end.fields if one.name == "x_m").flat == tuple(f"x_m_{name}" for name in names)
        end.close()


# Rotations: which axes, which laws, and what has to be alike on them


LIGHT, HEAVY = MassDamper(mass=0.001, damping=0.005), MassDamper(mass=0.002, damping=0.005)


def test_what_cannot_turn_is_refused_in_one_sentence() -> None:
    tumbling()  # scenes of the same classes have passed before
    for parts, sentence in (
            ({"law": ModelMediated()},
             "law model_mediated does not run on the axes of a rotation: its model is a spring"),
            ({"law": around("virtual_coupling", Wave())}, "its tool has a place on each axis by itself"),
            ({"law": Springs()}, "declares none of its messages or its state as one, as x: kind.Position does"),
            ({"law": (PositionPosition(), PositionPosition(), PositionPosition(K=1.0))}, "has one law for all three"),
            ({"slave": (LIGHT, HEAVY, LIGHT)}, "the slave of one differs; give the three the same slave"),
            ({"slave": None, "link": None, "law": VirtualWall(K=1.0)}, "a scene without a slave has no rotations")):
        with pytest.raises(Refused, match=sentence):
            tumbling(**parts)


def test_axes_of_a_rotation_are_in_rad_and_each_is_analysed_by_itself_and_a_deadband_keeps_positions() -> None:
    scene = tumbling(axes=4, rotations=(1,), hand=None)
    assert scene.axis_units == ("m", "rad", "rad", "rad")
    assert on_axis(scene, 2).rotations == ()
    assert on_axis(scene, 2).axis_units == ("rad",)
    law = around("deadband(0.1)", PositionPosition())
    assert without_orientation(law) == ""
    assert tumbling(law=law).rotations == (0,)
