"""What columns are: each that a scene of the house records is known, with its unit."""

from __future__ import annotations

import pytest

from teleop import load_scene
from teleop.export.columns import KNOWN, TOPICS, field, paths_of, quantity
from teleop.scene.catalogue import names
from teleop.simulation.structure import columns

WITHOUT = {"lte"}  # it asks for recordings
SCENES = sorted({*names()["scenes"]} - WITHOUT)


@pytest.mark.parametrize("scene", SCENES)
def test_every_column_of_a_scene_is_known_with_its_unit_and_as_many_axes(scene: str) -> None:
    made = load_scene(scene)
    for e in "ms" if made.slave is not None else "m":
        for name in columns(made, e):
            found = KNOWN[name.removesuffix("@")]
            assert found.unit
            assert found.axes == name.endswith("@"), name


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
