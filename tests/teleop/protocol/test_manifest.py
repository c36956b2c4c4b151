"""What two ends have to agree on: the sentence that they stop with names what differs, and what to type."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop.protocol.manifest import manifest_difference, manifest_of
from teleop.protocol.packet import one_line
from teleop.scene.loading import load_scene


def test_equal_manifests_do_not_differ() -> None:
    assert manifest_difference({}, {}) is None
    assert manifest_difference({"a": "1", "b": "2"}, {"b": "2", "a": "1"}) is None


def test_the_sentence_names_the_knob_both_values_and_what_to_type() -> None:
    mine = {"wire version": "1", "scene": "hard_wall", "k_e": "50000.0", "dt": "0.001"}
    assert manifest_difference(mine, mine | {"k_e": "2000.0"}) == (
        "k_e is 50000.0 here and 2000.0 there: start both ends with the same --set k_e=50000.0"
    )
    two = manifest_difference(mine, mine | {"k_e": "2000.0", "dt": "0.01"})
    assert two is not None
    assert "(1 more differs)" in two
    assert "--set start='(0, 1)'" in (manifest_difference({"start": "(0, 1)"}, {"start": "0"}) or "")


@pytest.mark.parametrize(
    ("name", "more", "cure"),
    [("wire version", "", "same release"), ("scene", "", "same scene"), ("law", " (1 more differs)", "law.*")],
)
def test_what_explains_the_rest_is_named_first(name: str, more: str, cure: str) -> None:
    mine = {"k_e": "1", name: "x"}
    sentence = manifest_difference(mine, {"k_e": "2", name: "y"})
    assert sentence is not None
    assert sentence.startswith(f"{name} is x here and y there{more}: ")
    assert cure in sentence


LOCKSTEP, BY_CLOCK = {"mode": "lockstep", "seed": "0"}, {"mode": "live"}


@pytest.mark.parametrize(("here", "there", "name", "more"), [
    ({}, {"k_e": "1e3"}, "k_e", 0),
    ({"f_max": "3"}, {}, "f_max", 0),
    ({"delay": "0.1"}, {"k_e": "1e3"}, "delay", 1),
    ({}, {"scene": "soft_tissue"}, "scene", 0),
    ({}, {"link": "delay(0.1)"}, "link", 0),
    (LOCKSTEP, BY_CLOCK, "mode", 0),
    (BY_CLOCK, LOCKSTEP | {"k_e": "1e3"}, "mode", 1),
])
def test_what_follows_from_another_is_not_counted(
    here: dict[str, str], there: dict[str, str], name: str, more: int
) -> None:
    """One knob that was turned at one end alone said "(1 more differs)": the part that it sets."""
    def told(typed: dict[str, str]) -> dict[str, str]:
        of_run = {key: typed[key] for key in typed if key in ("mode", "seed")}
        knobs = {key: value for key, value in typed.items() if key not in (*of_run, "scene")}
        return {**manifest_of(load_scene(typed.get("scene", "hard_wall"), **knobs)), **of_run}

    sentence = manifest_difference(told(here), told(there))
    assert sentence is not None
    assert sentence.startswith(f"{name} is ")
    assert ("more differ" in sentence) == bool(more)
    assert not more or f"({more} more differs)" in sentence


def test_an_entry_of_one_end_only_is_missing_at_the_other() -> None:
    for here, there in (({"a": ""}, {}), ({}, {"a": ""})):
        sentence = manifest_difference(here, there)
        assert sentence is not None
        assert "missing" in sentence
        assert "empty" in sentence
        assert "--set" not in sentence


manifests = st.dictionaries(st.sampled_from(["scene", "law", "a", "b"]), st.sampled_from(["", "1", "2"]))


@given(manifests, manifests)
def test_manifests_differ_exactly_if_they_are_not_equal(mine: dict[str, str], theirs: dict[str, str]) -> None:
    assert (manifest_difference(mine, theirs) is None) == (mine == theirs)


def test_the_sentence_about_huge_values_still_fits_with_its_cure() -> None:
    sentence = manifest_difference({"k": "x" * 5000}, {"k": "y" * 5000})
    assert sentence is not None
    assert one_line(sentence) == sentence
