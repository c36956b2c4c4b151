"""Grids as a person types them in a shell, with and without quotes. What is refused: tests/refusals.toml."""

from __future__ import annotations

import shlex
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from teleop import Refused
from teleop.sweeps.grid import Range, grid, parse_axes, parse_ranges

NAMES = ("delay", "k_e", "d_e", "law", "law.b", "link")
numbers = st.one_of(st.integers(-(10**6), 10**6), st.floats(allow_nan=False, allow_infinity=False))
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
