"""A run as CSV, read back by Python's own reader, by numpy and by pandas."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from io import BytesIO, StringIO
from pathlib import Path

import numpy as np
import pytest

from teleop import load_result
from teleop.__main__ import main
from teleop.export.columns import KNOWN
from teleop.export.files import write_csv, write_metadata
from teleop.export.stored import read_parts
from teleop.scene.library import ROOT

Stored = Callable[[str], Path]


def written(folder: Path) -> bytes:
    file = BytesIO()
    write_csv(file, read_parts(folder, trust=False))
    return file.getvalue()


def test_every_number_of_the_trace_comes_back_to_the_bit_by_any_reader(stored: Stored) -> None:
    for scene in ("canonical", "recorded_reach", "virtual_wall"):
        trace = load_result(stored(scene)).trace
        head, *rows = csv.reader(StringIO(written(stored(scene)).decode()))
        expected = [name if trace[name].ndim == 1 else f"{name}_{axis}" for name in trace
                    for axis in "xyz"[: 1 if trace[name].ndim == 1 else trace[name].shape[1]]]
        assert head == expected
        got = np.array([[float(cell) for cell in row] for row in rows])
        assert np.array_equal(got, np.column_stack([trace[name] for name in trace])), scene
    trace, data = load_result(stored("canonical")).trace, written(stored("canonical"))
    table = np.genfromtxt(BytesIO(data), delimiter=",", names=True)
    assert table.dtype.names == tuple(trace)
    assert all(np.array_equal(table[name], trace[name]) for name in trace)
    pandas = pytest.importorskip("pandas", reason="needs the extra `test`")
    table = pandas.read_csv(BytesIO(data))
    assert [*table.columns] == [*trace]
    for name, column in trace.items():
        assert str(table.dtypes[name]) == str(column.dtype)
        assert np.array_equal(table[name].to_numpy(), column), name


def test_the_example_for_pandas_on_the_page_runs_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("pandas", reason="needs the extra `test`")
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "teleop" / "export" / "README.md").read_text()
    shell, = re.findall(r"## pandas\n\n```sh\n(.*?)```", page, re.DOTALL)
    for line in shell.splitlines():
        assert main(line.split()[1:]) == 0
    capsys.readouterr()
    code, = re.findall(r"```py\n(.*?)```", page, re.DOTALL)
    exec(compile(code, "page", "exec", dont_inherit=True), {})
    out = capsys.readouterr().out
    assert "mean" in out
    assert 0.8 < float(out.rpartition(":")[2]) < 1.2  # waves: what is felt is what is touched, at rest


def test_numbers_that_are_not_finite_are_read_as_such(tmp_path: Path, stored: Stored) -> None:
    result = load_result(stored("canonical"))
    trace = {name: column.copy() for name, column in result.trace.items()}
    odd = [np.nan, np.inf, -np.inf]
    trace["f_m"][2:5] = odd
    object.__setattr__(result, "trace", trace)
    result.save(tmp_path / "run")
    text = written(tmp_path / "run")
    assert np.array_equal(np.genfromtxt(BytesIO(text), delimiter=",", names=True)["f_m"][2:5], odd, equal_nan=True)
    pandas = pytest.importorskip("pandas", reason="needs the extra `test`")
    assert np.array_equal(pandas.read_csv(BytesIO(text))["f_m"][2:5], odd, equal_nan=True)


def test_the_parts_of_a_turned_run_say_which_they_are_and_are_empty_without_such_a_column(turned_run: Path) -> None:
    table = np.genfromtxt(BytesIO(written(turned_run)), delimiter=",", names=True)
    assert np.array_equal(table["part"], np.repeat([1, 2, 3], [200, 280, 100]))
    assert np.allclose(1e3 * table["t"], [*range(200), *range(220, 500), *range(500, 600)])
    assert (np.diff(table["t"]) > 0.0).all()
    assert np.array_equal(np.isnan(table["E_in_fwd"]), table["part"] == 2)


def test_what_its_columns_are_lies_beside_it_as_csv_on_the_web_has_it(stored: Stored) -> None:
    parts = read_parts(stored("recorded_reach"), trust=False)
    table, file = BytesIO(), BytesIO()
    write_csv(table, parts)
    write_metadata(file, Path("some/reach.csv"), parts)
    about = json.loads(file.getvalue())
    assert (about["@context"], about["url"]) == ("http://www.w3.org/ns/csvw", "reach.csv")
    columns = {one["name"]: one for one in about["tableSchema"]["columns"]}
    assert [*columns] == table.getvalue().split(b"\n")[0].decode().split(",")
    assert columns["f_h_y"]["dc:description"] == f"{KNOWN['f_h'].meaning}, along y"
    assert columns["f_h_y"]["schema:unitText"] == "N"
    assert columns["t"]["schema:unitText"] == "s"
