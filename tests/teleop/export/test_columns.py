"""Columns with their units, and rows as JSON objects whose numbers come back to the bit, but those not finite."""

from __future__ import annotations

import json
from math import isfinite
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from teleop import load_scene
from teleop.export.columns import KNOWN, TOPICS, Objects, field, paths_of, quantity
from teleop.scene.catalogue import names
from teleop.simulation.structure import columns

WITHOUT = {"lte"}  # it asks for recordings
SCENES = sorted({*names()["scenes"]} - WITHOUT)


def test_every_column_of_a_scene_is_known_with_its_unit_and_as_many_axes() -> None:
    for scene in SCENES:
        made = load_scene(scene)
        for e in "ms" if made.slave is not None else "m":
            for name in columns(made, e):
                found = KNOWN[name.removesuffix("@")]
                assert found.unit, (scene, name)
                assert found.axes == name.endswith("@"), (scene, name)


def test_every_column_has_a_topic_and_a_meaning_of_its_own() -> None:
    assert {one.topic for one in KNOWN.values()} == {*TOPICS, ""}
    assert len({one.meaning for one in KNOWN.values()}) == len(KNOWN)


def test_the_ends_of_the_link_are_told_apart() -> None:
    assert "backward message that the master played" in quantity("seq_m").meaning
    assert "forward message that the slave played" in quantity("seq_s").meaning
    assert "the master's waves have brought into the link, forward" in quantity("E_in_fwd").meaning
    assert "played at the slave have taken out of the link, forward" in quantity("E_out_fwd").meaning
    assert "the slave's waves have brought into the link, backward" in quantity("E_in_bwd").meaning
    assert "played at the master have taken out of the link, backward" in quantity("E_out_bwd").meaning


def test_one_axis_is_an_object_with_x_as_three_are_with_x_y_and_z() -> None:
    assert paths_of(field("x_m", 1)) == [("master", "x_m", "x")]
    assert paths_of(field("x_m", 3), topic=False) == [("x_m", "x"), ("x_m", "y"), ("x_m", "z")]
    assert paths_of(field("g_s", 1)) == [("slave", "g_s")]
    assert field("x_m", 1).flat == ("x_m",)
    assert field("f_env", 2).flat == ("f_env_x", "f_env_y")


def test_a_field_that_a_law_shows_says_whose_it_is() -> None:
    assert quantity("stored_s") == ("", "stored of the state of the slave's law, in its own unit", "slave", True)


PATHS = [("t",), ("master", "x", "x"), ("link", "seq"), ("master", "x", "y"), ("master", "50% \"n\"")]
NUMBERS = st.one_of(st.floats(), st.integers(-(10**12), 10**12))


def strict(text: str) -> Any:
    """As a strict reader takes it: it knows no NaN."""
    def refuse(word: str) -> None:
        raise AssertionError(word)

    return json.loads(text, parse_constant=refuse)


@given(st.lists(st.tuples(*[NUMBERS] * len(PATHS)), max_size=5))
def test_every_finite_number_comes_back_to_the_bit_under_its_path(rows: list[tuple[float, ...]]) -> None:
    texts = Objects(PATHS).texts([[row[i] for row in rows] for i in range(len(PATHS))])
    assert len(texts) == len(rows)
    for text, row in zip(texts, rows, strict=True):
        got = strict(text)
        for path, value in zip(PATHS, row, strict=True):
            found: Any = got
            for name in path:
                found = found.get(name, {})
            if isfinite(value):
                assert (repr(found), type(found)) == (repr(value), type(value))
            else:
                assert found == {}


def test_what_is_left_empty_is_left_out_too() -> None:
    assert Objects([("t",), ("x", "x")]).texts([[0.5, 1.5], [float("nan"), 2.5]]) == ['{"t":0.5}',
                                                                                    '{"t":1.5,"x":{"x":2.5}}']


def test_a_sum_that_overflows_leaves_no_number_out() -> None:
    assert Objects([("f",)]).texts([[1e308, 1e308]]) == ['{"f":1e+308}', '{"f":1e+308}']
