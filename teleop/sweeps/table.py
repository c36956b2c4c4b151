"""The rows of a sweep as a table: columns, one number a cell, filled row by row.

A row is a dict: `row` (its number in the grid), `seed`, each knob with its value as given, `status`, `ticks`, each
metric that it has, and `sentence` where it was refused. A million rows of 5 knobs and 3 metrics take about 100 MB.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from contextlib import contextmanager
from csv import writer
from dataclasses import dataclass
from json import dumps
from math import isfinite, isnan, nan
from numbers import Real
from pathlib import Path
from types import NoneType
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from teleop.errors import Refused, nearest, number_of
from teleop.storage.files import replacing_text
from teleop.sweeps.grid import check_count, json_value
from teleop.terminal.table import columns, printable

STATUSES = ("ok", "limit cycle", "unstable", "diverged", "refused")  # the order in which they are counted
SHOWN = 6  # rows of a table as text
_BLOCK = 10_000  # rows that are made into Python's own values at a time
_WHOLE = {"row": "q", "seed": "Q", "ticks": "q"}  # whole numbers of 64 bits, seeds without a sign


@dataclass(frozen=True, kw_only=True, slots=True)
class TableColumn:
    """Numbers, one a row; with `values` they are places in it, for what is text or of several kinds."""

    cells: NDArray[Any]
    values: tuple[Any, ...] | None = None

    def at(self, order: NDArray[Any]) -> TableColumn:
        """The rows that `order` names (numbers, or a truth for each)."""
        return TableColumn(cells=self.cells[order], values=self.values)

    def read(self, start: int, stop: int) -> list[Any]:
        """Rows start .. stop-1 as Python's own values."""
        cells: list[Any] = self.cells[start:stop].tolist()
        return cells if self.values is None else [self.values[cell] for cell in cells]

    def array(self) -> NDArray[Any]:
        """Floats if all are numbers (None is NaN), ints or truths if all are those, objects otherwise."""
        if self.values is None:
            return self.cells.copy()
        kinds = {type(value) for value in self.values}
        if kinds and kinds <= {int, float, type(None)} and kinds != {type(None)}:
            array = np.array([nan if value is None else float(value) for value in self.values])
        else:
            array = np.empty(len(self.values), bool if kinds == {bool} else object)
            for i, value in enumerate(self.values):
                array[i] = value
        return np.asarray(array[self.cells])

    def equals(self, value: Any) -> NDArray[np.bool_]:
        """Mask of the rows that have this value."""
        wanted = json_value(value.item() if isinstance(value, np.generic) else value)
        if self.values is None:
            is_number = isinstance(wanted, int | float) and not isinstance(wanted, bool)
            return np.asarray(self.cells == wanted) if is_number else np.zeros(len(self.cells), bool)
        fits = [json_value(each) == wanted and isinstance(each, bool) == isinstance(wanted, bool)
                for each in self.values]
        return np.array(fits, bool)[self.cells] if fits else np.zeros(len(self.cells), bool)


class TableBuilder:
    """Takes rows in any order and one by one; `table` gives those that have come so far."""

    __slots__ = ("_columns", "knobs", "metrics")

    def __init__(self, knobs: Sequence[str], metrics: Sequence[str]) -> None:
        self.knobs, self.metrics = tuple(knobs), tuple(metrics)
        names = ["row", "seed", *self.knobs, "status", "ticks", *self.metrics, "sentence"]
        twice = next((name for i, name in enumerate(names) if name in names[:i]), None)
        if twice is not None:
            raise Refused(f"the table would have two columns {twice}; give the metric or the knob another name")
        self._columns: dict[str, _Growing] = {name: _Growing() for name in names}
        self._columns["status"].recode()
        self._columns["sentence"].recode()
        for name, code in _WHOLE.items():
            self._columns[name].cells = array(code)

    def add(self, row: Mapping[str, Any]) -> None:
        """Take a row; `Refused`, and nothing taken, if it does not fit. It lacks a metric that is None or NaN."""
        columns = self._columns
        for name in row:
            if name not in columns:
                raise Refused(f"row {row.get('row')} has {name}, which is no column; {nearest(name, columns)}")
        for name in (*_WHOLE, "status", *self.knobs):
            if name not in row:
                raise Refused(f"row {row.get('row')} has no {name}, and every row needs one; add it to the row")
        for name, code in _WHOLE.items():
            value, low = row[name], 0 if code == "Q" else -(1 << 63)
            if type(value) is not int or not low <= value < low + (1 << 64):
                raise Refused(f"{name} must be a whole number of 64 bits, not {value!r}; write for example {name}=0")
        for name in ("status", "sentence"):
            if not (row.get(name) is None or isinstance(row[name], str)):
                raise Refused(f"row {row['row']} has a {name} that is no text; write it as one")
        figures = [(columns[name], self._figure(name, row.get(name))) for name in self.metrics]
        for name in _WHOLE:
            columns[name].cells.append(row[name])
        for column, figure in figures:
            column.cells.append(figure)
        for name in (*self.knobs, "status", "sentence"):
            columns[name].add(row.get(name))

    def extend(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Take several rows, as `add` takes one; many that are alike at a time, column by column."""
        names = rows[0].keys() if rows else frozenset[str]()
        if not all(row.keys() == names for row in rows) or not self._takes(
                values := {name: [row[name] for row in rows] for name in names}, names):
            for row in rows:
                self.add(row)
            return
        for name, column in self._columns.items():
            if name in _WHOLE:
                column.cells.extend(values[name])
            elif name in self.metrics:
                column.cells.extend(values.get(name) or [nan] * len(rows))
            else:
                column.extend(values.get(name) or [None] * len(rows))

    def _takes(self, values: Mapping[str, list[Any]], names: Set[str]) -> bool:
        """True if columns of rows are of the kinds that most are: nothing in them needs a look of its own."""
        if not {*_WHOLE, "status", *self.knobs} <= names <= self._columns.keys() - {"sentence"}:
            return False
        return (all({*map(type, values[name])} == {int} and min(values[name]) >= 0 and max(values[name]) < 1 << 63
                    for name in _WHOLE)
                and {*map(type, values["status"])} == {str}
                and all({*map(type, values[name])} == {float} for name in self.metrics if name in names))

    @staticmethod
    def _figure(name: str, value: Any) -> float:
        if value is None or value in ("inf", "-inf", "nan"):  # these as a file of JSON has them
            return nan if value is None else float(value)
        if isinstance(value, bool) or not isinstance(value, Real):
            raise Refused(f"metric {name} must be a number, not {value!r}; let it return a float")
        return float(value)

    def __len__(self) -> int:
        return len(self._columns["row"].cells)

    def table(self) -> Table:
        """The rows so far, in the order of their numbers; of those with the same number the first that came."""
        columns = {name: grown.column() for name, grown in self._columns.items()}
        numbers = columns["row"].cells
        if not bool(np.all(numbers[1:] > numbers[:-1])):
            order = np.unique(numbers, return_index=True)[1]
            columns = {name: column.at(order) for name, column in columns.items()}
        return _of(columns, self.knobs, self.metrics)


class Table:
    """The rows of a sweep, in the order of their numbers. `table["x_err_rms"]` is a column as an array."""

    __slots__ = ("_columns", "knobs", "metrics")

    def __init__(self, rows: Iterable[Mapping[str, Any]], knobs: Sequence[str], metrics: Sequence[str]) -> None:
        builder = TableBuilder(knobs, metrics)
        for row in rows:
            builder.add(row)
        made = builder.table()
        self._columns: dict[str, TableColumn] = made._columns
        self.knobs: tuple[str, ...] = made.knobs
        self.metrics: tuple[str, ...] = made.metrics

    def __len__(self) -> int:
        return len(self._columns["row"].cells)

    def __repr__(self) -> str:
        """Rows, knobs, metrics and how the rows ended, in one line."""
        ended = ", ".join(f"{count} {status}" for status, count in self.counts().items())
        return (f"Table({number_of(len(self), 'row')} of {', '.join(self.knobs) or 'seeds'}: {ended or 'none yet'}; "
                f"metrics {', '.join(self.metrics)})")

    def __iter__(self) -> Iterator[dict[str, Any]]:
        """Each row as the dict that it came as."""
        absent = {*self.metrics, "sentence"}
        for names, values in self._values([*self._columns]):
            yield {name: value for name, value in zip(names, values, strict=True)
                   if not (name in absent and _missing(value))}

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A column, (rows,): numbers with NaN where there is none, or objects (texts, several kinds)."""
        return self._column(name).array()

    def array(self) -> NDArray[Any]:
        """Columns but the sentence as one structured array, texts as texts: `np.save` writes it as it is."""
        columns = {name: self[name] for name in self._columns if name != "sentence"}
        texts = {name: np.array([str(value) for value in self._columns[name].values or ("",)])
                 for name, column in columns.items() if column.dtype == object}
        kinds = [(name, texts[name].dtype if name in texts else column.dtype) for name, column in columns.items()]
        out: NDArray[Any] = np.empty(len(self), kinds)
        for name, column in columns.items():
            out[name] = texts[name][self._columns[name].cells] if name in texts else column
        return out

    def where(self, **wanted: Any) -> Table:
        """The rows that have these values, all of them: `table.where(status="ok", law="wave")`."""
        keep = np.ones(len(self), bool)
        for name, value in wanted.items():
            keep &= self._column(name).equals(value)
        return _of({name: column.at(keep) for name, column in self._columns.items()}, self.knobs, self.metrics)

    def counts(self) -> dict[str, int]:
        """Number of rows for each status: ok, limit cycle, unstable, diverged, refused, and any other."""
        column = self._columns["status"]
        number = np.bincount(column.cells, minlength=len(column.values or ())).tolist()
        count_of = {str(value): count for value, count in zip(column.values or (), number, strict=False) if count}
        order = (*STATUSES, *sorted({*count_of} - {*STATUSES}))
        return {status: count_of[status] for status in order if status in count_of}

    def to_csv(self, path: Path | str) -> None:
        """Write all rows under a heading; a cell without a value is empty, numbers are to their last digit."""
        with _whole(Path(path)) as file:
            lines = writer(file)  # with \r\n after a line (RFC 4180), so that a text with either sign is put in quotes
            lines.writerow(self._file_columns())
            for _, values in self._values(self._file_columns()):
                lines.writerow(["" if _missing(value) else _cell(value) for value in values])

    def to_jsonl(self, path: Path | str) -> None:
        """Write one JSON object a line, each with all columns; null where there is no value or it is not finite.

        `pandas.read_json(path, lines=True)` reads it as it is.
        """
        with _whole(Path(path)) as file:
            for names, values in self._values(self._file_columns()):
                cells = (None if type(value) is float and not isfinite(value) else json_value(value)
                         for value in values)
                file.write(dumps(dict(zip(names, cells, strict=True)), allow_nan=False) + "\n")

    def __str__(self) -> str:
        """Summary of the statuses, and the first rows."""
        return self.text()

    def text(self, rows: int | None = None, *, all_by: str = "") -> str:
        """Summary of the statuses, and the first `rows` rows; left out, a few.

        `all_by`: what the last line says to type for all of them; left out, a call of this.
        """
        shown = min(SHOWN if rows is None else check_count("rows", rows), len(self))
        first = ", ".join(f"{number_of(len(each), noun)}" for each, noun in (
            (self, "row"), (self.knobs, "knob"), (self.metrics, "metric")))
        if not len(self):
            return first
        ended = ", ".join(f"{count} {printable(status)}" for status, count in self.counts().items())
        names = [name for name in self._columns if name != "sentence"]
        cells = self._values(names, shown)
        lines = [[printable(name, most=60) for name in names], *([*map(_short, values)] for _, values in cells)]
        to_type = all_by or f"print(table.text({len(self)}))"
        tail = [f"... and {len(self) - shown} more: {to_type}"] if len(self) > shown else []
        return "\n".join([f"{first}: {ended}", columns(lines, left=()), *tail])

    def _column(self, name: str) -> TableColumn:
        if name not in self._columns:
            raise Refused(f"the table has no column {name!r}; {nearest(str(name), self._columns)}")
        return self._columns[name]

    def _file_columns(self) -> list[str]:
        """The columns for a file: the sentence only where a row has one."""
        silent = self._columns["sentence"].equals(None).all()
        return [name for name in self._columns if name != "sentence" or not silent]

    def _values(self, names: Sequence[str], stop: int | None = None) -> Iterator[tuple[Sequence[str], tuple[Any, ...]]]:
        """The values of each row, some rows at a time so that few of them are Python objects at once."""
        end = len(self) if stop is None else stop
        for start in range(0, end, _BLOCK):
            block = [self._columns[name].read(start, min(start + _BLOCK, end)) for name in names]
            for values in zip(*block, strict=True):
                yield names, values


class _Growing:
    """A column that grows: floats, or whole numbers, as long as all are; places in a list of values otherwise."""

    __slots__ = ("_places", "cells", "values")

    def __init__(self) -> None:
        self.cells: array[Any] = array("d")
        self.values: list[Any] | None = None
        self._places: dict[Any, int] = {}

    def add(self, value: Any) -> None:
        if self.values is None:
            code = _code(value)
            if code and not self.cells:
                self.cells = array(code)
            elif code != self.cells.typecode:
                self.recode()
        self.cells.append(value if self.values is None else self._place(value))

    def extend(self, values: Sequence[Any]) -> None:
        """Add several values."""
        if self.values is None and {*map(type, values)} == {float} and (self.cells.typecode == "d"):
            self.cells.extend(values)
        elif self.values is not None and len({*map(type, values)}) == 1 and type(values[0]) in (str, NoneType):
            places = {value: self._place(value) for value in dict.fromkeys(values)}
            self.cells.extend([places[value] for value in values])
        else:
            for value in values:
                self.add(value)

    def recode(self) -> None:
        """From numbers to places in a list of values."""
        earlier, self.values = self.cells, []
        self.cells = array("I", [self._place(each) for each in earlier])

    def column(self) -> TableColumn:
        values = None if self.values is None else tuple(self.values)
        return TableColumn(cells=np.array(self.cells, dtype=self.cells.typecode), values=values)

    def _place(self, value: Any) -> int:
        key = value if type(value) is str else (type(value), repr(value))
        place = self._places.get(key)
        if place is None:
            place = self._places[key] = len(self._places)
            self.values.append(value)  # type: ignore[union-attr]  # a list from here on
        return place


def _code(value: object) -> str | None:
    """The kind of array for a number; None for what has none."""
    if type(value) is float:
        return "d"
    return "q" if type(value) is int and -(1 << 63) <= value < 1 << 63 else None


def _of(columns: dict[str, TableColumn], knobs: tuple[str, ...], metrics: tuple[str, ...]) -> Table:
    table = object.__new__(Table)  # without its rows
    table._columns, table.knobs, table.metrics = columns, knobs, metrics
    return table


def _missing(value: Any) -> bool:
    return value is None or (type(value) is float and isnan(value))


def _cell(value: Any) -> Any:
    """A value for CSV: a list as JSON."""
    return dumps(json_value(value)) if isinstance(value, list | tuple) else value


def _short(value: Any) -> str:
    text = f"{value:.4g}".replace("nan", "") if type(value) is float else printable(str(value), most=24)
    return text if len(text) <= 24 else f"{text[:21]}..."


@contextmanager
def _whole(path: Path) -> Iterator[IO[str]]:
    """A file to write into that takes the place of `path` when all went well, and is gone when it did not."""
    try:
        with replacing_text(path) as file:
            yield file
    except OSError as error:
        raise Refused(f"could not write {path} ({error.strerror or error}), so it is as it was; free some space, or "
                      "write to another path") from error
