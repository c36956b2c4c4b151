"""A run as MCAP, read back by the library's own reader."""

from __future__ import annotations

import json
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from teleop import load_result
from teleop.export.columns import TOPICS, field, quantity
from teleop.export.files import LEVELS, write_mcap
from teleop.export.stored import read_parts

pytest.importorskip("mcap", reason="needs the extra `log`")

from mcap.reader import make_reader

Stored = Callable[[str], Path]
Message = tuple[int, dict[str, Any]]


def written(folder: Path) -> BytesIO:
    file = BytesIO()
    write_mcap(file, read_parts(folder, trust=False), "a test")
    return file


def read(file: BytesIO) -> tuple[dict[str, list[Message]], dict[str, dict[str, Any]]]:
    """The messages of each topic, and its schema."""
    file.seek(0)
    messages: dict[str, list[Message]] = {}
    schemas = {}
    for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
        assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
        assert message.publish_time == message.log_time
        messages.setdefault(channel.topic, []).append((message.log_time, json.loads(message.data)))
        schemas[channel.topic] = {"name": schema.name, **json.loads(schema.data)}
    return messages, schemas


@pytest.mark.parametrize("scene", ["recorded_reach", "virtual_wall"])
def test_every_number_of_the_trace_comes_back_to_the_bit_at_its_tick(stored: Stored, scene: str) -> None:
    trace = load_result(stored(scene)).trace
    messages, _ = read(written(stored(scene)))
    for name in trace.keys() - {"t"}:
        column, found = trace[name], quantity(name)
        told = messages[f"/{found.topic}"]
        assert [ns for ns, _ in told] == [round(t * 1e9) for t in trace["t"]]
        if not found.axes:
            got = [message[name] for _, message in told]
        else:
            axes = field("x_m", 1 if column.ndim == 1 else column.shape[1]).names
            got = [[message[name][axis] for axis in axes] for _, message in told]
        assert np.array_equal(np.array(got).reshape(column.shape), column), name
    assert {*messages} == {f"/{quantity(name).topic}" for name in trace.keys() - {"t"}} | {"/log"}


def types_of(schema: dict[str, Any]) -> list[Any]:
    return [schema.get("type"), *[one for inner in schema.get("properties", {}).values() for one in types_of(inner)]]


def test_every_message_fits_its_schema_whose_fields_have_one_type_for_foxglove_and_their_units(stored: Stored) -> None:
    jsonschema = pytest.importorskip("jsonschema", reason="needs the extra `test`")
    for scene in ("canonical", "recorded_reach"):
        messages, schemas = read(written(stored(scene)))
        for topic, inner in messages.items():
            assert {*types_of(schemas[topic])} <= {"object", "number", "integer", "string"}
            validator = jsonschema.Draft202012Validator(schemas[topic])
            jsonschema.Draft202012Validator.check_schema(schemas[topic])
            for _, message in [*inner[:9], *inner[9::10]]:
                validator.validate(message)
            assert validator.is_valid({**inner[0][1], "another": 1}) == (topic == "/log")
    own = schemas["/slave"]["properties"]
    assert own["v_s"]["properties"]["z"]["description"].startswith("along z: velocity of the slave (m/s)")
    assert own["f_env"]["description"].startswith("force of the slave on its environment (N)")
    assert schemas["/energy"]["properties"]["E_port"]["description"].endswith("; left out where it is not a finite "
                                                                              "number")
    assert {name for name, schema in schemas.items() if schema["name"] == f"teleop.{name[1:]}"} == {
        f"/{topic}" for topic in TOPICS}


def test_a_number_that_is_not_finite_is_left_out(tmp_path: Path, stored: Stored) -> None:
    result = load_result(stored("canonical"))
    trace = {name: column.copy() for name, column in result.trace.items()}
    trace["f_m"][[3, 7]] = np.nan, np.inf
    trace["E_link"][5] = -np.inf
    object.__setattr__(result, "trace", trace)
    result.save(tmp_path / "run")
    messages, schemas = read(written(tmp_path / "run"))
    assert [i for i, (_, message) in enumerate(messages["/master"]) if "f_m" not in message] == [3, 7]
    assert [i for i, (_, message) in enumerate(messages["/energy"]) if "E_link" not in message] == [5]
    assert messages["/master"][3][1]["x_m"] == {"x": trace["x_m"][3]}
    assert "left out where it is not a finite number" in schemas["/master"]["properties"]["f_m"]["description"]


def test_events_are_what_foxglove_calls_a_log_and_messages_are_counted_and_lie_in_order_of_time(demo: Path) -> None:
    file = BytesIO()
    counts = write_mcap(file, read_parts(demo, trust=False), "a test")
    messages, schemas = read(file)
    assert schemas["/log"]["name"] == "foxglove.Log"
    told = {(message["name"], message["message"]): (ns, message["level"]) for ns, message in messages["/log"]}
    assert told["master", "safe: silence: no fresh packet for 0.8 s"] == (120_000_000, LEVELS["warning"])
    assert told["master", "released: fresh packets for 0.05 s"] == (300_000_000, LEVELS["info"])
    assert told["slave", "met: session 1"] == (0, LEVELS["info"])
    assert told["run", "run of canonical, law wave(b=2, K=500, B=20)"] == (0, LEVELS["info"])
    last = messages["/log"][-1]
    assert last[1]["message"].startswith("stopped: the process ended without a word after tick 399")
    assert last[1]["level"] == LEVELS["warning"]
    for ns, message in messages["/log"]:
        assert message["timestamp"] == {"sec": ns // 10**9, "nsec": ns % 10**9}
    assert counts == {topic: len(inner) for topic, inner in messages.items()}
    assert counts["/master"] == 390
    file.seek(0)
    times = [message.log_time for _, _, message in make_reader(file).iter_messages(log_time_order=False)]
    assert times == sorted(times)


def test_the_parts_of_a_turned_run_lie_on_one_axis_of_time(turned_run: Path) -> None:
    messages, _ = read(written(turned_run))
    times = [ns // 10**6 for ns, _ in messages["/master"]]
    assert times == [*range(200), *range(220, 500), *range(500, 600)]
    begun = [(ns // 10**6, message["message"].split("(")[0]) for ns, message in messages["/log"]
             if "part " in message["message"]]
    assert begun == [(0, "part 01 of canonical, law wave"), (220, "part 02 of canonical, law tdpa"),
                     (500, "part 03 of canonical, law wave")]
    waves = [ns // 10**6 for ns, message in messages["/energy"] if "E_in_fwd" in message]
    assert waves == [*range(200), *range(500, 600)]  # tdpa has none


def test_the_summary_of_the_run_is_in_the_file(stored: Stored, turned_run: Path) -> None:
    file = written(stored("canonical"))
    file.seek(0)
    about, = make_reader(file).iter_metadata()
    assert about.name == "teleop"
    assert about.metadata["scene"] == "canonical"
    assert "the time of day is not recorded" in about.metadata["time"]
    file.seek(0)
    summary, = make_reader(file).iter_attachments()
    assert summary.name == "summary.json"
    assert json.loads(summary.data) == json.loads((stored("canonical") / "summary.json").read_text())
    file = written(turned_run)
    file.seek(0)
    assert [one.name for one in make_reader(file).iter_metadata()] == ["teleop 01", "teleop 02", "teleop 03"]
    file.seek(0)
    assert {one.name for one in make_reader(file).iter_attachments()} == {
        f"summary-{number:02d}.json" for number in (1, 2, 3)}
