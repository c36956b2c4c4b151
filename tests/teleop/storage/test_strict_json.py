"""JSON out of a folder of unknown origin: whatever is wrong with it is one sentence, and nothing is taken that is."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from teleop import load_scene, run
from teleop.simulation.summary_shape import RUN
from teleop.storage.strict_json import (
    Misshapen,
    between,
    dict_of,
    either,
    list_of,
    one_of,
    optional,
    parse,
    parse_line,
    record,
    text,
    truth,
    whole,
    write_document,
)

JSON: Any = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4), max_leaves=20)


@pytest.mark.parametrize(("data", "says"), [
    (b"", "no JSON"), (b"{", "no JSON"), (b"\xff", "no JSON"), (b"[1,]", "no JSON"), (b"[1] 2", "no JSON"),
    (b"NaN", "NaN"), (b'{"a": -Infinity}', "-Infinity"), (b"1e999", "1e999, which is not finite"),
    (b"1" * 301, "a whole number of 301 digits"), (b'{"a": 1, "b": 2, "a": 1}', "'a' twice"),
    (b"[" * 33 + b"]" * 33, "more than 32 deep"), (b"[" * 100_000, "brackets"), (b'{"a":' * 100_000 + b"1", "brackets"),
])
def test_deep_doubled_endless_and_torn_json_is_one_sentence(data: bytes, says: str) -> None:
    with pytest.raises(Misshapen, match=says) as raised:
        parse(data)
    assert len(str(raised.value)) < 200


@given(JSON)
@settings(deadline=None)
def test_what_is_written_is_read_back(value: Any) -> None:
    data = json.dumps(value).encode()
    assert parse(data) == parse_line(data) == value


def test_a_line_may_hold_numbers_that_its_caller_has_to_look_at() -> None:
    assert parse_line(b"1e999") == float("inf")
    with pytest.raises(Misshapen, match="NaN"):
        parse_line(b"NaN")


@pytest.mark.parametrize(("check", "good", "bad", "says"), [
    (text, "a", 3, "it must be a text, not 3"), (truth, True, 1, "true or false"),
    (whole(low=0, high=5), 5, 6, "at most 5"), (whole(low=0), 0, -1, "at least 0"), (whole(), -7, 1.0, "whole number"),
    (whole(), 1, True, "not True"), (between(0.0, 1.0), 1, 1.5, "from 0 to 1"),
    (one_of("m", "s"), "m", ["m"], "m or s, not a list"), (optional(text), None, {}, "a text, not an object"),
    (either(text, whole()), 3, None, "a whole number, not None"), (list_of(text), ["a"], ["a", 1], r"it\[1\] must be"),
    (list_of(text, most=1), [], ["a", "b"], "more than 1"), (dict_of(whole()), {"a": 1}, {"a": "x"}, r"it\.a must be"),
    (record({"a": text}), {"a": "x", "b": 1}, {"b": 1}, "it has no a"), (record({}), {}, [], "an object"),
    (record({}, {"a": text}), {}, {"a": 2}, r"it\.a must be a text"),
])
def test_a_wrong_type_is_named_with_its_place(check: Any, good: Any, bad: Any, says: str) -> None:
    check(good, "it")
    with pytest.raises(Misshapen, match=says):
        check(bad, "it")


def test_a_long_wrong_value_is_not_told_at_length() -> None:
    with pytest.raises(Misshapen) as raised:
        whole()("x" * 10_000, "n" * 10_000)
    assert len(str(raised.value)) < 400


class TestTheSummaryOfARun:
    SUMMARY: Any = json.loads(json.dumps(run(load_scene("rubber", duration=0.02)).summary(["teleop"]), default=str))

    def test_as_it_is_written_is_taken(self) -> None:
        RUN(self.SUMMARY, "summary.json")

    @given(st.data())
    @settings(deadline=None, max_examples=200)
    def test_with_anything_in_place_of_a_value_is_taken_or_is_one_sentence(self, data: Any) -> None:
        changed = copy.deepcopy(self.SUMMARY)
        at, key = changed, data.draw(st.sampled_from(sorted(changed)))
        while isinstance(at[key], dict) and at[key] and data.draw(st.booleans()):
            at = at[key]
            key = data.draw(st.sampled_from(sorted(at)))
        at[key] = data.draw(JSON)
        said = "summary.json"
        try:
            RUN(changed, "summary.json")
        except Misshapen as wrong:
            said = str(wrong)
        assert said.startswith("summary.json")


def test_a_document_is_written_whole_and_reads_back(tmp_path: Path) -> None:
    write_document(tmp_path / "summary.json", {"K": float("inf"), "corners": [(0.0, 1.5)]})
    assert parse((tmp_path / "summary.json").read_bytes()) == {"K": "inf", "corners": [[0.0, 1.5]]}
    with pytest.raises(RecursionError):
        write_document(tmp_path / "summary.json", deep(100_000))
    assert [path.name for path in tmp_path.iterdir()] == ["summary.json"]


def deep(levels: int) -> list[Any]:
    """Lists within lists, too many to write."""
    found: list[Any] = []
    for _ in range(levels):
        found = [found]
    return found
