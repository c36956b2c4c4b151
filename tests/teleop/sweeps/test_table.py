"""Tables: what rows go in come out, as rows, columns and files."""

from __future__ import annotations

import csv
import json
import tracemalloc
from math import inf, isnan, nan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop import Refused, Table, Wave
from teleop.sweeps.table import TableBuilder

KNOBS, METRICS = ("delay", "law", "n"), ("x_err_rms", "E_link_min")
finite = st.floats(allow_nan=False, allow_infinity=False)
ints = st.integers(-(2**62), 2**62)
mixed = st.one_of(finite, ints, st.text(max_size=5), st.booleans(), st.none(), st.lists(finite, max_size=3))


@st.composite
def tables(draw: st.DrawFn) -> list[dict[str, Any]]:
    """Rows as a sweep makes them, in any order; each knob of one kind or of several."""
    kinds = {knob: draw(st.sampled_from([finite, ints, st.text(max_size=5), st.booleans(), mixed])) for knob in KNOBS}
    rows = []
    for number in draw(st.permutations(range(draw(st.integers(0, 8))))):
        row: dict[str, Any] = {"row": number, "seed": draw(st.integers(0, 2**64 - 1))}
        row |= {knob: draw(kind) for knob, kind in kinds.items()}
        status = draw(st.sampled_from(["ok", "diverged", "refused"]))
        row |= {"status": status, "ticks": draw(st.integers(0, 10**8))}
        if status != "refused":
            row |= {name: draw(finite) for name in METRICS if draw(st.booleans())}
        else:
            row["sentence"] = draw(st.text(max_size=20))
        rows.append(row)
    return rows


def row(number: int, **more: Any) -> dict[str, Any]:
    return {"row": number, "seed": 0, "delay": 0.1, "law": "wave", "n": 1, "status": "ok", "ticks": 10, **more}


def made(*rows: dict[str, Any]) -> Table:
    return Table(rows, KNOBS, METRICS)


def in_order(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return sorted(rows, key=lambda each: each["row"])


def kinds_of(rows: list[dict[str, Any]]) -> list[list[type]]:
    return [[type(value) for value in each.values()] for each in rows]


class TestRows:
    @given(tables())
    def test_come_back_as_they_were_in_the_order_of_their_numbers(self, rows: list[dict[str, Any]]) -> None:
        table = made(*rows)
        assert len(table) == len(rows)
        assert list(table) == [{**each} for each in in_order(rows)]
        wanted = [{name: each[name] for name in got} for got, each in zip(table, in_order(rows), strict=True)]
        assert kinds_of(list(table)) == kinds_of(wanted)

    def test_with_the_same_number_are_one_and_the_first_counts(self) -> None:
        table = made(row(1, ticks=3), row(0), row(1, ticks=4))
        assert [(each["row"], each["ticks"]) for each in table] == [(0, 10), (1, 3)]

    def test_can_be_looked_at_while_they_come(self) -> None:
        builder = TableBuilder(KNOBS, METRICS)
        tables = [builder.table()]
        for number in range(3):
            builder.add(row(number, delay=number if number == 2 else 0.5))
            tables.append(builder.table())
        assert [len(table) for table in tables] == [0, 1, 2, 3]
        assert len(builder) == 3
        assert builder.table()["delay"].tolist() == [0.5, 0.5, 2.0]

    @pytest.mark.parametrize("absent", [None, nan, "nan"])
    def test_without_a_metric_do_not_have_it(self, absent: Any) -> None:
        table = made(row(0, x_err_rms=absent), row(1, x_err_rms=inf), row(2, x_err_rms="-inf"))
        assert [each.get("x_err_rms") for each in table] == [None, inf, -inf]
        assert "x_err_rms" not in next(iter(table))

    @pytest.mark.parametrize(("wrong", "words"), [
        ({"x_err": 1.0}, ("x_err", "did you mean x_err_rms")), ({"seed": 2**64}, ("seed must be",)),
        ({"seed": -1}, ("seed must be",)), ({"row": "0"}, ("row must be", "row=0")),
        ({"ticks": 0.5}, ("ticks must be",)), ({"E_link_min": True}, ("metric",)),
        ({"x_err_rms": "small"}, ("metric x_err_rms must be a number, not 'small'",)),
    ])
    def test_that_do_not_fit_are_refused_and_leave_nothing(self, wrong: Any, words: tuple[str, ...]) -> None:
        builder = TableBuilder(KNOBS, METRICS)
        builder.add(row(0))
        with pytest.raises(Refused) as refused:
            builder.add(row(1, **wrong) if "row" not in wrong else {**row(1), **wrong})
        for word in words:
            assert word in str(refused.value)
        builder.add(row(2))
        assert [each["row"] for each in builder.table()] == [0, 2]
        for name in ("row", "seed", "status", "ticks", *KNOBS):
            with pytest.raises(Refused, match=f"has no {name}, and every row needs one"):
                made({key: value for key, value in row(0).items() if key != name})

    @pytest.mark.parametrize(("knobs", "metrics"), [
        (("delay", "delay"), ()), (("delay",), ("delay",)), (("status",), ()), ((), ("sentence",))])
    def test_with_two_values_of_one_name_are_refused(self, knobs: Any, metrics: Any) -> None:
        with pytest.raises(Refused, match=r"two columns .*; give the metric or the knob another name"):
            Table([], knobs, metrics)


class TestColumns:
    def test_are_numbers_where_they_can_be(self) -> None:
        table = made(row(0, x_err_rms=0.5, delay=0.25, seed=2**64 - 1), row(1, delay=None, n=2), row(2, delay=3))
        assert table["x_err_rms"].dtype == table["delay"].dtype == float
        np.testing.assert_array_equal(table["x_err_rms"], [0.5, nan, nan])
        np.testing.assert_array_equal(table["delay"], [0.25, nan, 3.0])
        np.testing.assert_array_equal(table["n"], [1, 2, 1])
        assert table["n"].dtype == np.int64
        assert table["seed"].tolist() == [2**64 - 1, 0, 0]
        assert table["law"].dtype == table["status"].dtype == object
        assert table["law"].tolist() == ["wave"] * 3
        assert made(row(0, n=True), row(1, n=False))["n"].dtype == bool
        assert all(isnan(value) for value in made(row(0), row(1))["E_link_min"]), "which no row has"
        values = [1.0, "none", [0.1, 0.2], True, None]
        table = made(*(row(i, delay=value) for i, value in enumerate(values)))
        assert table["delay"].tolist() == values

    def test_are_the_callers_own(self) -> None:
        table = made(row(0, x_err_rms=1.0))
        table["x_err_rms"][:] = 2.0
        assert table["x_err_rms"].tolist() == [1.0]

    def test_that_are_not_there_are_refused_with_the_nearest(self) -> None:
        with pytest.raises(Refused, match="no column 'x_err_rsm'; did you mean x_err_rms"):
            made(row(0))["x_err_rsm"]
        with pytest.raises(Refused, match="no column 'x_err_rsm'; did you mean x_err_rms"):
            made(row(0)).where(x_err_rsm=1.0)

    def test_together_are_a_structured_array_that_needs_no_pickle(self, tmp_path: Path) -> None:
        table = made(row(0, x_err_rms=0.5), row(1, law=Wave(b=2.0), status="diverged"))
        np.save(tmp_path / "table.npy", table.array(), allow_pickle=False)
        back = np.load(tmp_path / "table.npy", allow_pickle=False)
        assert back.dtype.names == ("row", "seed", *KNOBS, "status", "ticks", *METRICS)
        assert back["law"].tolist() == ["wave", str(Wave(b=2.0))]
        assert back["status"].tolist() == ["ok", "diverged"]
        np.testing.assert_array_equal(back["x_err_rms"], [0.5, nan])
        assert made().array().shape == (0,)


class TestWhere:
    @given(tables(), st.data())
    def test_keeps_the_rows_that_have_the_values(self, rows: list[dict[str, Any]], data: st.DataObject) -> None:
        knob = data.draw(st.sampled_from(KNOBS))
        value = data.draw(st.sampled_from([each[knob] for each in rows]) if rows else mixed)
        kept = made(*rows).where(**{knob: value, "status": "ok"})
        assert list(kept) == [each for each in in_order(rows) if each["status"] == "ok" and each[knob] == value
                              and isinstance(each[knob], bool) == isinstance(value, bool)]

    def test_knows_numbers_of_numpy_tuples_and_parts(self) -> None:
        table = made(row(0, delay=[0.1, 0.2], law=Wave(b=2.0)), row(1, n=2), row(2, n=3))
        assert len(table.where(delay=(0.1, 0.2))) == len(table.where(law=Wave(b=2.0))) == 1
        assert len(table.where(n=np.int64(2))) == len(table.where(n=2.0)) == 1
        assert len(table.where(n="2")) == len(table.where(law="pfra")) == len(table.where(x_err_rms=0.0)) == 0
        assert table.where(n=2).knobs == KNOBS
        assert table.where().counts() == table.counts()


class TestCounts:
    @given(tables())
    def test_are_of_each_status(self, rows: list[dict[str, Any]]) -> None:
        statuses = [each["status"] for each in rows]
        assert made(*rows).counts() == {status: statuses.count(status) for status in set(statuses)}

    def test_are_in_the_usual_order(self) -> None:
        there = ("refused", "stopped", "ok", "diverged", "unstable", "limit cycle")
        counts = made(*(row(i, status=status) for i, status in enumerate(there))).counts()
        assert list(counts) == ["ok", "limit cycle", "unstable", "diverged", "refused", "stopped"]
        assert made(row(0, status="refused"), row(1)).where(status="ok").counts() == {"ok": 1}


class TestFiles:
    @given(rows=tables())
    def test_of_json_lines_have_one_object_a_line_with_the_same_keys(
            self, rows: list[dict[str, Any]], tmp_path_factory: pytest.TempPathFactory) -> None:
        path = tmp_path_factory.mktemp("table") / "rows.jsonl"
        table = made(*rows)
        table.to_jsonl(path)
        read = [json.loads(line, parse_constant=lambda word: pytest.fail(f"{word} is no JSON"))
                for line in path.read_text(encoding="utf-8").split("\n")[:-1]]
        assert len({tuple(each) for each in read}) <= 1
        optional = {*METRICS, "sentence"}
        assert [{key: value for key, value in each.items() if value is not None or key not in optional}
                for each in read] == list(table)
        assert list(Table(read, KNOBS, METRICS)) == list(table)

    @given(rows=tables())
    def test_of_csv_hold_every_cell(self, rows: list[dict[str, Any]], tmp_path_factory: pytest.TempPathFactory) -> None:
        path = tmp_path_factory.mktemp("table") / "rows.csv"
        table = made(*rows)
        table.to_csv(path)
        with path.open(encoding="utf-8", newline="") as file:
            read = list(csv.DictReader(file))
        assert len(read) == len(rows)
        for got, each in zip(read, table, strict=True):
            for name, text in got.items():
                value = each.get(name)
                if value is None:
                    assert text == ""
                elif isinstance(value, float | int) and not isinstance(value, bool):
                    assert type(value)(text) == value
                else:
                    assert text == (json.dumps(value) if isinstance(value, list) else str(value))

    def test_say_what_was_refused_only_where_something_was(self, tmp_path: Path) -> None:
        made(row(0)).to_csv(tmp_path / "a.csv")
        made(row(0), row(1, status="refused", sentence="no, \"not\" so;\nwrite b=1")).to_csv(tmp_path / "b.csv")
        assert (tmp_path / "b.csv").read_bytes().count(b"\r\n") == 3  # RFC 4180
        assert "sentence" not in (tmp_path / "a.csv").read_text()
        with (tmp_path / "b.csv").open(newline="") as file:
            assert [each["sentence"] for each in csv.DictReader(file)] == ["", "no, \"not\" so;\nwrite b=1"]

    def test_have_null_or_inf_for_what_is_not_finite(self, tmp_path: Path) -> None:
        table = made(row(0, x_err_rms=inf))
        table.to_jsonl(tmp_path / "a.jsonl")
        table.to_csv(tmp_path / "a.csv")
        assert json.loads((tmp_path / "a.jsonl").read_text())["x_err_rms"] is None
        assert (tmp_path / "a.csv").read_text().splitlines()[1].endswith(",inf,")

    def test_are_there_whole_or_as_they_were(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        path = tmp_path / "rows.csv"
        made(row(0)).to_csv(path)
        before = path.read_text()

        def fail(*_: Any) -> Any:
            raise OSError(28, "No space left on device")

        for writes in ("to_csv", "to_jsonl"):
            with monkeypatch.context() as broken:
                broken.setattr("teleop.sweeps.table.Table._values", fail)
                with pytest.raises(Refused, match=r"could not write .*No space left.*; free some space"):
                    getattr(made(row(1)), writes)(path)
        assert path.read_text() == before
        assert [each.name for each in tmp_path.iterdir()] == ["rows.csv"]
        with pytest.raises(Refused, match="write to another path"):
            made(row(0)).to_csv(tmp_path / "missing" / "rows.csv")


class TestText:
    def test_is_the_counts_and_the_first_rows(self) -> None:
        table = made(*(row(i, x_err_rms=i / 3, status="ok" if i else "diverged") for i in range(10)))
        lines = str(table).splitlines()
        assert lines[0] == "10 rows, 3 knobs, 2 metrics: 9 ok, 1 diverged"
        assert lines[1].split() == ["row", "seed", *KNOBS, "status", "ticks", *METRICS]
        assert lines[3].split() == ["1", "0", "0.1", "wave", "1", "ok", "10", "0.3333"]
        assert lines[-1] == "... and 4 more: print(table.text(10))"
        assert len(table.text(10).splitlines()) == 12
        assert table.text(3).splitlines()[-1] == "... and 7 more: print(table.text(10))"
        with pytest.raises(Refused, match="rows must be a whole number from 1"):
            table.text(0)
        assert len(lines) == 9
        assert len({line.rfind(" ", 0, 20) for line in lines[2:-1]}) == 1

    def test_is_one_line_where_python_prints_a_value_or_there_is_nothing_and_stays_narrow(self) -> None:
        assert repr(made(row(0), row(1, status="diverged"))) == (
            "Table(2 rows of delay, law, n: 1 ok, 1 diverged; metrics x_err_rms, E_link_min)")
        assert str(made()) == "0 rows, 3 knobs, 2 metrics"
        assert max(map(len, str(made(row(0, law="a | very | long | link " * 50))).splitlines())) < 120


class TestSize:
    @pytest.mark.full
    def test_is_that_of_the_numbers(self) -> None:
        """A row of 5 knobs and 3 metrics takes about 100 bytes, twice that while the table is made."""
        knobs, metrics = tuple("abcde"), tuple("xyz")
        count = 20_000
        tracemalloc.start()
        try:
            builder = TableBuilder(knobs, metrics)
            for i in range(count):
                builder.add({"row": i, "seed": i % 30, **dict.fromkeys("abc", i * 0.1), "d": f"law{i % 3}", "e": i,
                             "status": "ok", "ticks": 10_000, **dict.fromkeys("xyz", i * 0.3)})
            table = builder.table()
            held, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        assert len(table) == count
        assert held / count < 230.0
        assert peak / count < 260.0

    def test_of_a_column_does_not_grow_with_how_often_a_text_comes(self) -> None:
        table = Table(({"row": i, "seed": 0, "link": "delay(0.05) | uniform(0.02)", "status": "ok", "ticks": 1}
                       for i in range(1000)), ("link",), ())
        assert len({id(value) for value in table["link"]}) == 1
