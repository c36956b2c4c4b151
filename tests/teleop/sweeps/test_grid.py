"""Grids: every row is found from its number alone, by the rule of `itertools.product`."""

from __future__ import annotations

import json
import shlex
from contextlib import suppress
from dataclasses import dataclass
from itertools import product
from math import inf, isclose, log, nan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from channel.link import parse_link
from teleop import Refused, Wave, load_scene
from teleop.sweeps.grid import Grid, Range, grid, json_value, parse_axes, parse_ranges, sampled

NAMES = ("delay", "k_e", "d_e", "law", "law.b", "link")
numbers = st.one_of(st.integers(-(10**6), 10**6), st.floats(allow_nan=False, allow_infinity=False))
values = st.one_of(numbers, st.text(max_size=8), st.booleans(), st.none())
seed_lists = st.lists(st.integers(0, 2**64 - 1), min_size=1, max_size=4, unique=True)


@st.composite
def axes(draw: st.DrawFn) -> dict[str, list[Any]]:
    names = draw(st.lists(st.sampled_from(NAMES), unique=True, max_size=4))
    return {name: draw(st.lists(values, min_size=1, max_size=4)) for name in names}


def assert_refused(sentence: pytest.ExceptionInfo[Refused], *words: str) -> None:
    """One sentence that has the words in it and says what to type."""
    said = str(sentence.value)
    assert "\n" not in said
    assert any(cure in said for cure in ("write", "leave", "take ", "make it", "give "))
    for word in words:
        assert word in said


class TestNumbering:
    @given(axes(), seed_lists)
    def test_is_that_of_product_with_the_seeds_last(self, given_axes: dict[str, list[Any]], seeds: list[int]) -> None:
        made = grid(given_axes, seeds)
        rows = [(dict(zip(given_axes, point, strict=True)), seed)
                for point in product(*given_axes.values()) for seed in seeds]
        assert len(made) == len(rows)
        assert [made.point(i) for i in range(len(made))] == rows
        assert made.knobs == tuple(given_axes)

    def test_of_zipped_knobs_goes_through_their_points(self) -> None:
        made = grid({"law": ["wave", "pfra"], ("delay", "k_e"): [(0.0, 1.0), (0.1, 2.0), (0.2, 3.0)]}, 2)
        assert made.knobs == ("law", "delay", "k_e")
        assert len(made) == 12
        assert made.point(9) == ({"law": "pfra", "delay": 0.1, "k_e": 2.0}, 1)
        assert list(made.point(0)[0]) == ["law", "delay", "k_e"]

    def test_of_a_thousand_million_rows_takes_no_room_and_without_axes_is_that_of_the_seeds(self) -> None:
        assert [grid({}, [5, 7]).point(i) for i in (0, 1)] == [({}, 5), ({}, 7)]
        made = grid({"delay": range(1000), "k_e": range(1000)}, 1000)
        assert len(made) == 10**9
        assert made.point(10**9 - 1) == ({"delay": 999, "k_e": 999}, 999)

    def test_ends_with_the_grid(self) -> None:
        for row in (-1, 4, 10**20):
            with pytest.raises(Refused) as refused:
                grid({"delay": [0.0, 0.1]}, 2).point(row)
            assert_refused(refused, f"no row {row}", "0 to 3")


class TestValues:
    def test_of_numpy_become_pythons_own(self) -> None:
        made = grid({"delay": np.linspace(0.0, 0.5, 3), "n": np.arange(2), "start": [np.array([0.1, 0.2])]})
        knobs = made.point(len(made) - 1)[0]
        assert knobs == {"delay": 0.5, "n": 1, "start": (0.1, 0.2)}
        assert [type(value) for value in knobs.values()] == [float, int, tuple]

    def test_may_be_parts(self) -> None:
        made = grid({"law": [Wave(b=2.0), "pfra"], "link": [parse_link("delay(0.1)"), None]})
        assert made.point(0)[0] == {"law": Wave(b=2.0), "link": parse_link("delay(0.1)")}
        assert load_scene("canonical", **made.point(0)[0]).law == Wave(b=2.0)

    @pytest.mark.parametrize(("wrong", "words"), [
        ({"delay": []}, ("delay has no values", '"delay": [1.0, 2.0]')),
        ({"delay": [0.0, nan]}, ("delay must be finite, not nan",)),
        ({"delay": [(0.0, -inf)]}, ("delay must be finite, not -inf",)),
        ({"delay": np.array([inf])}, ("delay must be finite, not inf",)),
        ({"delay": 0.1}, ('"delay": [0.1]',)), ({"delay": np.array(0.1)}, ('"delay": [',)),
        ({"law": "wave"}, ("law takes a list", "\"law\": ['wave']")),
        ({"law": {"wave", "pfra"}}, ("a set has none", "write a list")),
        ({"delay": [1.0], ("delay", "k_e"): [(1.0, 2.0)]}, ("delay is in the grid twice",)),
        ({("delay", "delay"): [(1.0, 2.0)]}, ("delay is in the grid twice",)),
        ({("delay", "k_e"): [(1.0,)]}, ("a point has 2 values, not (1.0,)", "('delay', 'k_e'): [(1.0, 1.0)")),
        ({("delay", "k_e"): []}, ("the axis delay, k_e has no values",)),
        ({("delay", "k_e"): [1.0]}, ("delay, k_e takes a list",)),
        ({(): [()]}, ("no knobs",)),
        ({"seed": [1]}, ("write seeds=30",)), ({"status": ["ok"]}, ("another name",)),
        ({3: [1.0]}, ("called by a text, not 3",)), ({" ": [1.0]}, ("called by a text",)),
        ({"law": [object()]}, ("no table can tell", "dataclass")),
        ([("delay", [1.0])], ("are a dict",)),
    ])
    def test_that_make_no_axis_are_refused(self, wrong: Any, words: tuple[str, ...]) -> None:
        with pytest.raises(Refused) as refused:
            grid(wrong)
        assert_refused(refused, *words)

    def test_without_an_end_or_too_many_to_number_are_refused(self, monkeypatch: pytest.MonkeyPatch) -> None:
        with pytest.raises(Refused) as refused:
            grid({name: range(10**4) for name in NAMES})
        assert_refused(refused, "1e+24 rows")
        monkeypatch.setattr("teleop.sweeps.grid.MOST_VALUES", 100)
        assert len(grid({"n": range(100)})) == 100
        with pytest.raises(Refused) as refused:
            grid({"delay": (0.0 for _ in iter(int, 1))})
        assert_refused(refused, "delay has more than 100 values")


class TestSeeds:
    def test_are_counted_from_zero_like_a_single_run(self) -> None:
        assert grid({}).seeds == range(1)
        assert grid({}, 30).seeds == range(30)
        assert grid({}, np.int64(2)).seeds == range(2)  # as numpy's
        assert grid({}, range(10, 0, -5)).point(1) == ({}, 5)

    @given(st.integers(0, 2**63), st.integers(1, 1000), st.integers(1, 5))
    def test_are_the_same_however_they_were_given(self, first: int, step: int, count: int) -> None:
        spaced = range(first, first + step * count, step)
        assert grid({}, spaced).definition() == grid({}, list(spaced)).definition()
        assert grid({}, spaced) == grid({}, list(spaced))

    @pytest.mark.parametrize(("wrong", "words"), [
        (0, "at least one seed"), (-3, "at least one seed"), ([], "at least one seed"), (range(0), "at least one seed"),
        (True, "seeds=30"), (1.5, "seeds=30"), ("12", "seeds=30"), (None, "seeds=30"),
        ([1.0], "whole number"), ([1, -1], "from 0 to"), ([2**64], "from 0 to"), ([True], "whole number"),
        (["1"], "whole number"), (range(-1, 3), "from 0 to"), ([1, 2, 1], "twice"),
    ])
    def test_that_are_none_are_refused(self, wrong: Any, words: str) -> None:
        with pytest.raises(Refused) as refused:
            grid({}, wrong)
        assert_refused(refused, words)


class TestDefinition:
    @given(axes(), seed_lists)
    def test_is_json_and_equal_for_equal_grids(self, given_axes: dict[str, list[Any]], seeds: list[int]) -> None:
        told = grid(given_axes, seeds).definition()
        assert told == grid({name: tuple(each) for name, each in given_axes.items()}, tuple(seeds)).definition()
        assert json.loads(json.dumps(told, allow_nan=False)) == told

    @given(axes(), axes(), seed_lists, seed_lists)
    def test_differs_where_the_rows_do(self, one: Any, other: Any, seeds: list[int], others: list[int]) -> None:
        a, b = grid(one, seeds), grid(other, others)
        same = len(a) == len(b) and a.knobs == b.knobs and all(a.point(i) == b.point(i) for i in range(len(a)))
        assert (a.definition() == b.definition()) == (same and one == other)

    def test_names_knobs_values_and_seeds(self) -> None:
        told = grid({"law": [Wave(b=2.0), "pfra"], ("to", "up"): [((0.1, 0.2), Path("a/b"))]}, 2).definition()
        assert told == {
            "axes": [{"knobs": ["law"], "values": [repr(Wave(b=2.0)), "pfra"]},
                     {"knobs": ["to", "up"], "values": [[[0.1, 0.2], "a/b"]]}],
            "seeds": {"first": 0, "step": 1, "count": 2},
        }

    @settings(max_examples=20)
    @given(st.integers(0, 1499))
    def test_of_a_long_axis_is_short_and_tells_any_change(self, at: int) -> None:
        other = list(range(1500))
        other[at] += 5000
        told = grid({"n": range(1500)}).definition()
        assert len(json.dumps(told)) < 400
        assert told == grid({"n": [float(i) for i in range(1500)]}).definition()
        assert told != grid({"n": other}).definition()

    def test_holds_no_object_by_its_address(self) -> None:
        @dataclass(frozen=True)
        class Mine:
            b: float = 1.0

        assert " at 0x" not in json.dumps(grid({"law": [Mine()]}).definition())
        assert json_value(Mine()) == repr(Mine())


class TestRange:
    @given(st.floats(-1e300, 1e300), st.floats(-1e300, 1e300), st.integers(2, 40))
    @example(-1.7e308, 1.7e308, 5)
    def test_has_both_ends_and_even_steps(self, low: float, high: float, n: int) -> None:
        assume(low != high)
        got = Range(low, high).values(n)
        assert len(got) == n
        assert (got[0], got[-1]) == (low, high)
        assert got == sorted(got, reverse=low > high)
        for k, value in enumerate(got):
            even = low * (1 - k / (n - 1)) + high * (k / (n - 1))
            assert isclose(value, even, rel_tol=1e-12, abs_tol=1e-15 * max(abs(low), abs(high)))

    @given(st.integers(-300, 300), st.integers(1, 100))
    def test_has_the_numbers_that_one_would_type(self, first: int, count: int) -> None:
        got = Range(float(f"{first}e-2"), float(f"{first + count}e-2")).values(count + 1)
        assert got == [float(f"{i}e-2") for i in range(first, first + count + 1)]

    @given(st.floats(5e-324, 1e308), st.floats(5e-324, 1e308), st.integers(2, 40))
    def test_by_equal_ratios_has_both_ends_exactly(self, low: float, high: float, n: int) -> None:
        assume(low != high)
        got = Range(low, high, log=True).values(n)
        assert len(got) == n
        assert (got[0], got[-1]) == (low, high)
        assert got == sorted(got, reverse=low > high)
        for k, value in enumerate(got):
            even = log(low) * (1 - k / (n - 1)) + log(high) * (k / (n - 1))
            assert isclose(log(value), even, rel_tol=1e-13, abs_tol=1e-12) or value < 1e-300

    @given(st.integers(-30, 30), st.integers(1, 8), st.integers(1, 4))
    def test_by_equal_ratios_hits_whole_decades(self, first: int, decades: int, each: int) -> None:
        got = Range(10.0**first, 10.0 ** (first + decades), log=True).values(decades * each + 1)
        assert got[::each] == [10.0**i for i in range(first, first + decades + 1)]

    @given(st.floats(1e-300, 1e300), st.floats(1e-300, 1e300), st.booleans(), st.floats(0.0, 1.0))
    @example(0.1, 0.1 + 1.4e-17, False, 0.3)
    @example(0.3, 0.30000000000000004, True, 0.5)
    def test_is_not_left_by_any_part_of_the_way(self, low: float, high: float, log: bool, u: float) -> None:
        assume(low != high)
        over = Range(low, high, log=log)
        assert min(low, high) <= over.at(u) <= max(low, high)
        assert over.at(0.0) == low
        assert isclose(over.at(1.0), high, rel_tol=1e-12)

    @pytest.mark.parametrize(("low", "high", "log", "n", "words"), [
        (1.0, 1.0, False, 3, "single value"), (0.0, 1.0, True, 3, "above 0"), (-2.0, -1.0, True, 3, "above 0"),
        (nan, 1.0, False, 3, "finite"), (0.0, inf, False, 3, "finite"), ("0", 1.0, False, 3, "a number"),
        *[(0.0, 1.0, False, n, "values") for n in (0, 1, -1, 2.0, True, 10**7)],
    ])
    def test_of_nothing_or_in_too_few_or_too_many_values_is_refused(
            self, low: Any, high: Any, log: bool, n: Any, words: str) -> None:
        with pytest.raises(Refused) as refused:
            Range(low, high, log=log).values(n)
        assert_refused(refused, words)


class TestSample:
    @given(st.integers(1, 200), st.integers(0, 2**64 - 1))
    def test_of_a_latin_hypercube_has_one_point_in_each_part_of_every_knob(self, n: int, key: int) -> None:
        made = sampled({"delay": Range(0.0, 1.0), "k_e": Range(1e2, 1e6, log=True)}, n, key=key, latin=True)
        points = [made.point(i)[0] for i in range(n)]
        for u in ([p["delay"] for p in points], [log(p["k_e"] / 1e2) / log(1e4) for p in points]):
            assert len(u) == n
            for k, value in enumerate(sorted(u)):
                assert k / n - 1e-12 <= value <= (k + 1) / n + 1e-12

    @given(st.integers(1, 20), st.integers(1, 20), st.integers(0, 99))
    def test_of_a_latin_hypercube_draws_entries_equally_often(self, n: int, times: int, key: int) -> None:
        made = sampled({"law": [f"law{i}" for i in range(n)]}, n * times, key=key, latin=True)
        drawn = [made.point(i)[0]["law"] for i in range(len(made))]
        assert {drawn.count(f"law{i}") for i in range(n)} == {times}

    @given(st.integers(1, 50), st.integers(0, 50), st.integers(0, 99))
    def test_that_is_independent_keeps_its_points_when_it_grows(self, n: int, more: int, key: int) -> None:
        ranges: dict[str, Any] = {"delay": Range(0.0, 0.5), "law": ["wave", "pfra"]}
        few, many = (sampled(ranges, count, key=key, latin=False) for count in (n, n + more))
        assert [few.point(i) for i in range(n)] == [many.point(i) for i in range(n)]

    @pytest.mark.parametrize("latin", [True, False])
    def test_draws_each_knob_by_itself_and_is_the_same_for_the_same_key_alone(self, latin: bool) -> None:
        one = sampled({"delay": Range(0.0, 0.5)}, 100, key=3, latin=latin)
        two = sampled({"k_e": Range(1.0, 2.0), "delay": Range(0.0, 0.5)}, 100, key=3, latin=latin)
        assert [one.point(i)[0]["delay"] for i in range(100)] == [two.point(i)[0]["delay"] for i in range(100)]
        u = np.array([[two.point(i)[0]["k_e"] - 1.0, two.point(i)[0]["delay"] * 2.0] for i in range(100)])
        assert abs(np.corrcoef(u.T)[0, 1]) < 0.3  # three deviations of 100 independent pairs
        made = [sampled({"delay": Range(0.0, 0.5)}, 50, key=key, latin=latin) for key in (1, 1, 2)]
        assert made[0] == made[1] != made[2]
        assert made[0].definition() == made[1].definition() != made[2].definition()

    def test_is_spread_evenly(self) -> None:
        made = sampled({"delay": Range(0.0, 1.0)}, 4000, key=1, latin=False)
        drawn = np.sort([made.point(i)[0]["delay"] for i in range(4000)])
        gap = np.max(np.abs(drawn - (np.arange(4000) + 0.5) / 4000))
        assert gap < 1.63 / np.sqrt(4000)  # Kolmogorov-Smirnov at 1 %
        assert len(set(drawn)) == 4000

    def test_is_one_axis_and_has_seeds(self) -> None:
        made = sampled({"delay": Range(0.0, 1.0), "law": ["wave"]}, 5, key=1, latin=True, seeds=3)
        assert (len(made.axes), len(made), made.knobs) == (1, 15, ("delay", "law"))
        assert isinstance(made, Grid)

    @pytest.mark.parametrize(("ranges", "n", "key", "words"), [
        ({"delay": Range(0.0, 1.0)}, 0, 1, "n must be"), ({"delay": Range(0.0, 1.0)}, 2.5, 1, "n must be"),
        ({"delay": Range(0.0, 1.0)}, 5, -1, "key must be"), ({"delay": Range(0.0, 1.0)}, 5, 0.5, "key must be"),
        ({}, 5, 1, "at least one knob"), ({"law": []}, 5, 1, "law has no values"), ({"law": "wave"}, 5, 1, "a list"),
        ({"delay": [nan]}, 5, 1, "finite"), ({"seed": [1]}, 5, 1, "seeds=30"),
    ])
    def test_of_nothing_is_refused(self, ranges: Any, n: Any, key: Any, words: str) -> None:
        with pytest.raises(Refused) as refused:
            sampled(ranges, n, key=key, latin=True)
        assert_refused(refused, words)


# As a person types them in a shell, with and without quotes


LINKS = ["delay(0.05)", "delay(0.05) | uniform(0.02)", "delay(0.05) | gamma(0.01, 2.0) ; delay(0.2)", "none",
         "mahimahi('up, down.txt', queue=2000) | bernoulli(p=0.02)"]


class TestTyped:
    @pytest.mark.parametrize(("command", "read"), [
        ("delay=0:0.5:6", {"delay": [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]}),
        ("k_e=1e2:1e6:5:log", {"k_e": [1e2, 1e3, 1e4, 1e5, 1e6]}),
        ("law=wave,pfra n=1,2,3", {"law": ["wave", "pfra"], "n": [1, 2, 3]}),
        ("'law=wave,pfra n=1, 2 ,3'", {"law": ["wave", "pfra"], "n": [1, 2, 3]}),
        ("'delay = 0.1, 0.2'  'law = wave'", {"delay": [0.1, 0.2], "law": ["wave"]}),
        ("delay=0:0.2:3,0.5,1", {"delay": [0.0, 0.1, 0.2, 0.5, 1]}),
        ("law.b=4 start=-1:1:3", {"law.b": [4], "start": [-1.0, 0.0, 1.0]}),
        ("delay,k_e=0.01/1e3,0.02/2e3", {("delay", "k_e"): [(0.01, 1e3), (0.02, 2e3)]}),
        ("'delay, k_e = 0.01 / 1e3, 0.02 / 2e3'", {("delay", "k_e"): [(0.01, 1e3), (0.02, 2e3)]}),
        ("delay,k_e=0:0.2:3/1:100:3:log", {("delay", "k_e"): [(0.0, 1.0), (0.1, 10.0), (0.2, 100.0)]}),
        ("law,law.b=wave/1:3:3,pfra/1", {("law", "law.b"): [("wave", 1.0), ("wave", 2.0), ("wave", 3.0), ("pfra", 1)]}),
        ("playout=zero,fixed:0.1,fixed:0.1:hold", {"playout": ["zero", "fixed:0.1", "fixed:0.1:hold"]}),
        ("up=/data/a.csv,b/c.csv", {"up": ["/data/a.csv", "b/c.csv"]}),
        ("\"start='0.1,0,-2','0,0,0'\"", {"start": ["0.1,0,-2", "0,0,0"]}),
        ("\"name='1','0:1:5',''\"", {"name": ["1", "0:1:5", ""]}),
        ("energy=true,no", {"energy": ["true", "no"]}),
        ("'link=delay(0.05) | gamma(0.01, 2.0),none'", {"link": ["delay(0.05) | gamma(0.01, 2.0)", "none"]}),
        ("'link=bernoulli(p=0.02) law=wave'", {"link": ["bernoulli(p=0.02)"], "law": ["wave"]}),
        ("link='delay(0.05) ; delay(0.2)' law=wave", {"link": ["delay(0.05) ; delay(0.2)"], "law": ["wave"]}),
        ("\"link='delay(0.05) | uniform(0.02)','none'\"", {"link": ["delay(0.05) | uniform(0.02)", "none"]}),
        ("name=it\\'s", {"name": ["it's"]}),
        ("\"link=ping_log('a(b.txt'),delay(0.1)\"", {"link": ["ping_log('a(b.txt')", "delay(0.1)"]}),
    ])
    def test_in_a_shell_it_is_read_as_it_looks(self, command: str, read: dict[Any, Any]) -> None:
        got = parse_axes(shlex.split(command))
        assert got == read
        assert [type(v) for each in got.values() for v in each] == [type(v) for each in read.values() for v in each]
        assert grid(got).definition() == grid(read).definition()

    @given(st.dictionaries(st.sampled_from(NAMES), st.lists(
        st.one_of(numbers, st.sampled_from(LINKS), st.text(st.characters(codec="utf-8"), max_size=12)), min_size=1),
        min_size=1))
    def test_what_is_in_quotes_comes_back(self, wanted: dict[str, list[Any]]) -> None:
        texts = [text for each in wanted.values() for text in each if isinstance(text, str)]
        assume(not any('"' in text and "'" in text for text in texts))
        spelled = [f"{name}={','.join(map(_quoted, each))}" for name, each in wanted.items()]
        assert parse_axes(shlex.split(shlex.join(spelled))) == wanted
        assert parse_axes([" ".join(spelled)]) == wanted

    @given(st.lists(st.sampled_from(LINKS), min_size=1))
    def test_links_need_no_quotes(self, links: list[str]) -> None:
        assert parse_axes([f"link={','.join(links)}", "law=wave"]) == {"link": links, "law": ["wave"]}
        assert parse_axes([f"link,n={','.join(f'{each}/1' for each in links)}"]) == {
            ("link", "n"): [(each, 1) for each in links]}

    @given(st.text(max_size=30))
    def test_nothing_else_happens_whatever_is_typed(self, text: str) -> None:
        for each in (text, f"delay={text}", f"delay,k_e={text}"):
            for reads in (parse_axes, parse_ranges):
                with suppress(Refused):
                    reads([each])

    def test_ranges_to_draw_from(self) -> None:
        read = parse_ranges(["delay=0:0.5 k_e=1e2:1e6:log", "law=wave,pfra", "playout=fixed:0.1", "n=3"])
        assert read == {"delay": Range(0.0, 0.5), "k_e": Range(1e2, 1e6, log=True), "law": ["wave", "pfra"],
                        "playout": ["fixed:0.1"], "n": [3]}


def _quoted(value: Any) -> str:
    """A value as a careful person types it: every text in quotes."""
    if not isinstance(value, str):
        return repr(value)
    return f'"{value}"' if "'" in value else f"'{value}'"
