"""A run as a CSV file that every reader takes as it is, and beside it what its columns are.

The header has the names of the trace; no line of comment, which readers would have to be told of. Every number has the
fewest digits that give the same bits again. A column that a part of the run does not have is empty there. What each
column is, and its unit, is in `FILE-metadata.json`, as the W3C's "CSV on the Web" names and writes it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from math import isfinite, isnan
from pathlib import Path
from typing import Any, BinaryIO

from teleop.export.columns import Field, numbers
from teleop.export.stored import Part, all_fields

PART = ("part", "number of the part of the run, which is the folder that it was recorded in")


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
