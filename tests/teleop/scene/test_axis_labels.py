"""Names and units of axes in what a run leaves."""

from __future__ import annotations

import json
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest

from teleop import Result, Scene, load_result, load_scene, run
from teleop.export.files import schema_of, write_csv, write_metadata
from teleop.export.stored import all_fields, read_parts
from teleop.export.stream import GrowingEnd
from teleop.live.records.reader import FILE, read_header
from teleop.live.records.record import RecordWriter
from teleop.scene.axes import AxisLabels, labels_of
from teleop.storage.strict_json import Misshapen
from tests.teleop.scene.unlike import unlike

NAMES, UNITS = ("shoulder", "elbow", "rail"), ("rad", "rad", "m")
ABOUT = {"scene": "hard_wall", "knobs": {}, "seed": 0, "mode": "live", "command": []}


@pytest.fixture(scope="module")
def result() -> Result:
    return run(unlike(duration=0.1))


@pytest.fixture(scope="module")
def folder(result: Result, tmp_path_factory: pytest.TempPathFactory) -> Path:
    at = tmp_path_factory.mktemp("labels") / "run"
    result.save(at)
    return at


def test_are_in_the_summary_and_come_back_with_the_run(folder: Path) -> None:
    told = json.loads((folder / "summary.json").read_text())
    assert (told["axis_names"], told["axis_units"]) == ([*NAMES], [*UNITS])
    assert load_result(folder).labels == AxisLabels(NAMES, UNITS)


def test_a_scene_that_gives_none_leaves_the_files_as_they_were() -> None:
    for scene in (load_scene("canonical", duration=0.01), load_scene("recorded_reach", duration=0.01)):
        assert not {"axis_names", "axis_units"} & run(scene).summary().keys()
        assert labels_of(scene) == AxisLabels()


@pytest.mark.parametrize("wrong", [{"axis_units": ["mm"]}, {"axis_names": "x"}, {"axis_names": ["a"] * 17}])
def test_that_are_none_are_refused_where_the_file_is_read(folder: Path, wrong: dict[str, Any]) -> None:
    from teleop.simulation.summary_shape import RUN

    with pytest.raises(Misshapen):
        RUN({**json.loads((folder / "summary.json").read_text()), **wrong}, "summary.json")


def test_a_csv_has_them_in_its_columns_and_units(folder: Path) -> None:
    parts = read_parts(folder, trust=False)
    rows, about = BytesIO(), BytesIO()
    write_csv(rows, parts)
    write_metadata(about, Path("run.csv"), parts)
    head = rows.getvalue().split(b"\n")[0].decode().split(",")
    columns = {one["name"]: one for one in json.loads(about.getvalue())["tableSchema"]["columns"]}
    assert [*columns] == head
    units = {name: columns[name]["schema:unitText"] for name in
             ("x_m_elbow", "v_s_elbow", "f_m_elbow", "x_m_rail", "v_s_rail", "f_m_rail", "t")}
    assert [*units.values()] == ["rad", "rad/s", "N m", "m", "m/s", "N", "s"]
    assert columns["x_m_elbow"]["dc:description"].endswith(", along elbow")


def test_mcap_has_a_field_for_each_with_its_unit(folder: Path) -> None:
    fields = [one for one in all_fields(read_parts(folder, trust=False)) if one.name in ("f_m", "g_m")]
    own = schema_of("master", "", fields)["properties"]
    assert [*own["f_m"]["properties"]] == [*NAMES]
    assert [text["description"].partition("hand ")[2][:5] for text in own["f_m"]["properties"].values()] == [
        "(N m)", "(N m)", "(N); "]
    assert "(N" not in own["f_m"]["description"]  # of all axes together it has no unit


def live_record(scene: Scene, at: Path) -> bytes:
    writer = RecordWriter(scene, "m", at, ABOUT)
    writer.begin("bodies")
    width = sum(len(part) for part in [json.loads((at / FILE).read_bytes().partition(b"\n")[0])["columns"]]) - 3
    writer.add(0, 0, 0, (0.5,) * width)
    writer.close()
    return (at / FILE).read_bytes()


def test_a_live_record_has_them_in_its_header_and_its_stream(tmp_path: Path) -> None:
    header = read_header(BytesIO(live_record(unlike(), tmp_path)))
    assert (header["axis_names"], header["axis_units"]) == ([*NAMES], [*UNITS])
    end = GrowingEnd(tmp_path, 0)
    end.take(1)
    assert next(one for one in end.fields if one.name == "x_m").flat == ("x_m_shoulder", "x_m_elbow", "x_m_rail")
    end.close()


def test_a_record_from_before_there_were_names_has_those_of_its_number_of_axes(tmp_path: Path) -> None:
    assert b"axis_names" not in live_record(replace(unlike(), names=(), units=()), tmp_path)
    end = GrowingEnd(tmp_path, 0)
    end.take(1)
    assert next(one for one in end.fields if one.name == "x_m").flat == ("x_m_x", "x_m_y", "x_m_z")
    end.close()


def test_a_record_of_sixteen_axes_can_be_read(tmp_path: Path) -> None:
    many = replace(load_scene("recorded_reach"), axes=16, environment=None, hand=None, duration=0.1)
    header = read_header(BytesIO(live_record(many, tmp_path)))
    assert header["axes"] == 16
    assert header["columns"].count("x_m") == 16
