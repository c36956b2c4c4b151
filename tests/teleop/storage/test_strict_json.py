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


@given(JSON)
@settings(deadline=None)
def test_what_is_written_is_read_back(value: Any) -> None:
    data = json.dumps(value).encode()
    assert parse(data) == parse_line(data) == value


def test_a_line_may_hold_numbers_that_its_caller_has_to_look_at() -> None:
    assert parse_line(b"1e999") == float("inf")


def test_what_is_right_is_taken_and_a_long_wrong_value_is_not_told_at_length() -> None:
    """What is wrong: tests/refusals.toml."""
    checks: tuple[tuple[Any, Any], ...] = (
        (text, "a"), (truth, True), (whole(low=0, high=5), 5), (whole(low=0), 0), (whole(), -7), (between(0.0, 1.0), 1),
        (one_of("m", "s"), "m"), (optional(text), None), (either(text, whole()), 3), (list_of(text), ["a"]),
        (list_of(text, most=1), []), (dict_of(whole()), {"a": 1}), (record({"a": text}), {"a": "x", "b": 1}),
        (record({}, {"a": text}), {}))
    for check, value in checks:
        check(value, "it")
    for wrong in (lambda: whole()("x" * 10_000, "n" * 10_000), lambda: parse(b"[" * 100_000)):
        with pytest.raises(Misshapen) as raised:
            wrong()
        assert len(str(raised.value)) < 400


@pytest.fixture(scope="module")
def summary() -> Any:
    """The summary of a run."""
    return json.loads(json.dumps(run(load_scene("rubber", duration=0.02)).summary(["teleop"]), default=str))


@given(st.data())
@settings(deadline=None)
def test_a_summary_with_anything_in_place_of_a_value_is_taken_or_is_one_sentence(summary: Any, data: Any) -> None:
    RUN(summary, "summary.json")
    changed = copy.deepcopy(summary)
    place, key = changed, data.draw(st.sampled_from(sorted(changed)))
    while isinstance(place[key], dict) and place[key] and data.draw(st.booleans()):
        place = place[key]
        key = data.draw(st.sampled_from(sorted(place)))
    place[key] = data.draw(JSON)
    sentence = "summary.json"
    try:
        RUN(changed, "summary.json")
    except Misshapen as wrong:
        sentence = str(wrong)
    assert sentence.startswith("summary.json")


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
