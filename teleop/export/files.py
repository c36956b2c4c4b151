"""A run as a file: a CSV that every reader takes as it is, or an MCAP file for Foxglove and whatever else reads MCAP.

The header of a CSV has the names of the trace; no line of comment, which readers would have to be told of. Every number
has the fewest digits that give the same bits again. A column that a part of the run does not have is empty there. What
each column is, and its unit, is in `FILE-metadata.json`, as the W3C's "CSV on the Web" names and writes it.

An MCAP file has JSON messages with JSON Schema: a topic for each of `teleop.export.columns.TOPICS`, a message a tick,
and `/log` with what happened, as Foxglove's own `foxglove.Log`. The time of a message is nanoseconds since tick 0: no
record has the time of day.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from importlib.util import find_spec
from math import isfinite, isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from teleop.errors import Refused
from teleop.export.columns import TOPICS, Field, Objects, numbers, paths_of
from teleop.export.stored import LogEntry, Part, all_fields
from teleop.storage.strict_json import json_text

if TYPE_CHECKING:
    from mcap.writer import Writer

PART = ("part", "number of the part of the run, which is the folder that it was recorded in")
LOG = "/log"
LEFT_OUT = "left out where it is not a finite number"
DIALECT = "https://json-schema.org/draft/2020-12/schema"
LEVELS = {"unknown": 0, "debug": 1, "info": 2, "warning": 3, "error": 4, "fatal": 5}  # of foxglove.Log


def metadata_of(path: Path) -> Path:
    """The file with what the columns of the CSV at `path` are."""
    return path.with_name(f"{path.name}-metadata.json")


def write_csv(file: BinaryIO, parts: Sequence[Part]) -> int:
    """Write a header and the rows of the run; how many rows."""
    fields = all_fields(parts)
    several = parts[0].number > 0
    names = [*[PART[0]] * several, *[name for one in fields for name in one.flat]]
    file.write(f"{','.join(names)}\n".encode())
    for part in parts:
        lead = [str(part.number)] if several else []
        for block in part.blocks():
            count = len(block["t"])
            if part.shift_ns:
                block["t"] = block["t"] + part.shift_ns / 1e9
            cells: list[Any] = [lead * count] * several
            for one in fields:
                if one.name in part.fields:
                    cells += [_texts(column) for column in numbers([block[one.name]])]
                else:
                    cells += [[""] * count] * one.axes
            file.write("".join([f"{','.join(row)}\n" for row in zip(*cells, strict=True)]).encode())
    file.flush()
    return sum(part.ticks for part in parts)


def _texts(column: list[float]) -> Iterator[str]:
    """The numbers as "CSV on the Web" writes them, which pandas and numpy read too: INF, -INF and NaN."""
    return map(repr, column) if isfinite(sum(column)) else (
        repr(value) if isfinite(value) else "NaN" if isnan(value) else "INF" if value > 0.0 else "-INF"
        for value in column)


def write_metadata(file: BinaryIO, path: Path, parts: Sequence[Part]) -> None:
    """Write what the columns of the CSV at `path` are."""
    columns = [{"name": PART[0], "titles": PART[0], "datatype": "integer", "dc:description": PART[1]}] * (
        parts[0].number > 0)
    columns += [_column(one, i) for one in all_fields(parts) for i in range(one.axes)]
    summary = parts[0].summary
    table = {"@context": "http://www.w3.org/ns/csvw", "url": path.name, "dc:title": summary["scene"],
             "dc:description": summary["sentence"],
             "tableSchema": {"columns": columns, "primaryKey": "t"}}
    file.write(json.dumps(table, indent=2).encode() + b"\n")


def _column(one: Field, i: int) -> dict[str, str]:
    axis = f", along {one.names[i]}" if one.axes > 1 else ""
    unit = {"schema:unitText": one.units[i]} if one.units[i] else {}
    return {"name": one.flat[i], "titles": one.flat[i], "datatype": "number",
            "dc:description": f"{one.quantity.meaning}{axis}", **unit}


def need_mcap() -> None:
    """Refuse where no MCAP file can be written."""
    if find_spec("mcap") is None:
        raise Refused("--mcap needs the package mcap: pip install 'bilateral-teleop[log]', or export with --csv")


def write_mcap(file: BinaryIO, parts: Sequence[Part], library: str) -> dict[str, int]:
    """Write the run into `file`; how many messages each topic has. `library`: the name of what writes it."""
    from mcap.writer import Writer

    writer = Writer(file)
    writer.start(profile="", library=library)
    for part in parts:
        suffix = f" {part.number:02d}" if part.number else ""
        writer.add_metadata(f"teleop{suffix}", _metadata(part))
        document = json.dumps(dict(part.summary), indent=2).encode()
        writer.add_attachment(0, 0, f"summary{suffix.replace(' ', '-')}.json", "application/json", document)
    fields = all_fields(parts)
    count: dict[str, int] = {}
    channels: dict[str, int] = {}
    for topic, meaning in TOPICS.items():
        own_fields = [one for one in fields if one.quantity.topic == topic]
        if own_fields:
            channels[topic] = _channel(writer, f"/{topic}", f"teleop.{topic}", schema_of(topic, meaning, own_fields))
            count[f"/{topic}"] = sum(part.ticks for part in parts if any(one.name in part.fields for one in own_fields))
    log = _channel(writer, LOG, "foxglove.Log", LOG_SCHEMA)
    entries = 0
    sequence = dict.fromkeys(channels, 0)
    for part in parts:
        waiting = part.log()
        entries += len(waiting)
        for ns, topic, text in _messages(part):
            while waiting and waiting[0].ns <= ns:
                _say(writer, log, waiting.pop(0))
            sequence[topic] += 1
            writer.add_message(channels[topic], ns, text.encode(), ns, sequence[topic])
        for one in waiting:
            _say(writer, log, one)
    writer.finish()  # type: ignore[no-untyped-call]  # mcap types none of it
    file.flush()
    return {**count, LOG: entries}


def schema_of(topic: str, meaning: str, fields: Sequence[Field]) -> dict[str, Any]:
    """JSON Schema of a topic's messages, with the unit of each number in its description."""
    properties: dict[str, Any] = {}
    for one in fields:
        text = f"{one.described_whole()}; {LEFT_OUT}"
        if len(paths_of(one)[0]) == 2:
            properties[one.name] = {"type": "number", "description": text}
        else:
            inner = {axis: {"type": "number", "description": f"along {axis}: {one.described(i)}; {LEFT_OUT}"}
                     for i, axis in enumerate(one.names)}
            properties[one.name] = {"type": "object", "description": text, "properties": inner,
                                    "additionalProperties": False}
    return {"$schema": DIALECT, "title": f"teleop.{topic}", "description": meaning, "type": "object",
            "properties": properties, "additionalProperties": False}


LOG_SCHEMA: Mapping[str, Any] = {
    "$schema": DIALECT, "title": "foxglove.Log", "description": "what happened, and how the run ended",
    "type": "object",
    "properties": {
        "timestamp": {
            "type": "object", "title": "time", "description": "time since tick 0",
            "properties": {"sec": {"type": "integer", "minimum": 0, "description": "whole seconds"},
                           "nsec": {"type": "integer", "minimum": 0, "maximum": 999_999_999,
                                    "description": "and nanoseconds"}},
            "required": ["sec", "nsec"],
        },
        "level": {"type": "integer", "title": "foxglove.LogLevel", "description": "how grave it is",
                  "oneOf": [{"title": name.upper(), "const": level} for name, level in LEVELS.items()]},
        "message": {"type": "string", "description": "what happened, and why"},
        "name": {"type": "string", "description": "to which end: master or slave; run: to the whole"},
        "file": {"type": "string", "description": "empty: it was no line of a program"},
        "line": {"type": "integer", "minimum": 0, "description": "the same"},
    },
    "required": ["timestamp", "level", "message", "name", "file", "line"],
}


def _channel(writer: Writer, topic: str, name: str, schema: Mapping[str, Any]) -> int:
    number = writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
    return writer.register_channel(topic, "json", number)


def _messages(part: Part) -> Iterator[tuple[int, str, str]]:
    """Time (ns), topic and text of each message of a part, tick by tick."""
    topics = {topic: [one for one in part.fields.values() if one.quantity.topic == topic] for topic in TOPICS}
    objects = {topic: Objects([path for one in own_fields for path in paths_of(one, topic=False)])
               for topic, own_fields in topics.items() if own_fields}
    for block in part.blocks():
        texts = [objects[topic].texts(numbers([block[one.name] for one in topics[topic]])) for topic in objects]
        for t, *row in zip(block["t"].tolist(), *texts, strict=True):
            ns = part.ns(t)
            yield from ((ns, topic, text) for topic, text in zip(objects, row, strict=True))


def _say(writer: Writer, channel: int, one: LogEntry) -> None:
    sec, nsec = divmod(one.ns, 1_000_000_000)
    message = {"timestamp": {"sec": sec, "nsec": nsec}, "level": LEVELS[one.level], "message": one.message,
               "name": one.name, "file": "", "line": 0}
    writer.add_message(channel, one.ns, json.dumps(message).encode(), one.ns)


def _metadata(part: Part) -> dict[str, str]:
    """Metadata of the run, from its summary, as texts."""
    summary = part.summary
    keys = ("scene", "mode", "seed", "dt", "ticks", "status", "sentence", "parameters", "metrics", "notes", "versions",
            "command")
    texts = {key: value if isinstance(value := summary[key], str) else json_text(value)
             for key in keys if key in summary}
    return {**texts, "time": "nanoseconds since tick 0; the time of day is not recorded"}
