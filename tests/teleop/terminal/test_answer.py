"""The answers of the commands: every document begins alike, and a number without a bound is null."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

HEAD = ["status", "sentence", "scene", "mode", "parameters", "seed", "versions", "command", "dt"]


@pytest.mark.parametrize(("words", "mode"), [
    (("run", "local", "--set", "duration=0.05"), "virtual"),
    (("stability", "soft_tissue", "--set", "delay=0.005"), "stability"),
    (("stability", "local", "--set", "duration=0.5", "--time"), "stability"),
    (("passivity", "virtual_wall"), "passivity"),
    (("precision", "hard_wall", "--set", "duration=0.02", "--rounds", "1"), "precision"),
])
def test_every_document_about_a_scene_begins_alike(typed: Callable[..., Any], words: tuple[str, ...], mode: str
                                                   ) -> None:
    told = json.loads(typed(*words, "--seed", "3", "--json").out)
    assert [*told][:len(HEAD)] == HEAD
    assert (told["scene"], told["mode"], told["seed"]) == (words[1], mode, 3)
    assert {"bilateral-teleop", "python", "numpy"} <= {*told["versions"]}
    assert told["command"][:2] == ["teleop", words[0]]
    assert told["dt"] == 1e-3


def test_the_document_of_a_sweep_had_no_head(typed: Callable[..., Any]) -> None:
    """What differs between its rows is null, or left out of the parameters."""
    words = ("sweep", "local", "--set", "duration=0.05", "--json")
    told = json.loads(typed(*words, "--grid", "k_e=100,200").out)
    assert [*told][:len(HEAD)] == HEAD
    assert (told["scene"], told["mode"], told["seed"], told["dt"]) == ("local", "sweep", 0, 1e-3)
    assert told["sentence"] == "2 of 2 rows done: 2 ok"
    single = json.loads(typed("run", "local", "--set", "duration=0.05", "--json").out)
    assert told["parameters"] == {name: value for name, value in single["parameters"].items() if name != "k_e"}
    several = json.loads(typed(*words, "--grid", "dt=1e-3,5e-4", "law.b=1,2", "--seeds", "2", "--out", "b").out)
    assert (several["seed"], several["dt"]) == (None, None)
    assert "dt" not in several["parameters"]
    assert "b" not in several["parameters"]["law"]
    assert [*json.loads(typed("report", "b", "--json").out)][:len(HEAD)] == HEAD


@pytest.mark.parametrize("words", [
    ("run", "local", "--set", "duration=0.05"), ("stability", "soft_tissue", "--set", "delay=0.005"),
    ("passivity", "virtual_wall"),
])
def test_the_file_in_the_folder_is_the_document_that_is_printed(typed: Callable[..., Any], words: tuple[str, ...]
                                                                ) -> None:
    told = json.loads(typed(*words, "--json", "--out", "here").out)
    assert told.pop("path") == "here"
    assert told == json.loads(Path("here/summary.json").read_text())


def keys_of(document: Any, path: tuple[str, ...] = ()) -> set[str]:
    """Every key of a document, and its path."""
    if isinstance(document, list):
        return {key for each in document for key in keys_of(each, path)}
    if not isinstance(document, dict):
        return set()
    return {name for key, each in document.items() for name in (
        key, ".".join([*path, key]), *keys_of(each, (*path, key)))}


@pytest.mark.parametrize("words", [
    ("passivity", "canonical"), ("passivity", "virtual_coupling"), ("stability", "soft_tissue", "--continuous"),
    ("stability", "local", "--set", "duration=0.5", "--time"),
    ("precision", "hard_wall", "--set", "duration=0.02", "--rounds", "1"),
])
def test_units_were_named_of_keys_that_are_not_there(typed: Callable[..., Any], words: tuple[str, ...]) -> None:
    told = json.loads(typed(*words, "--json").out)
    units = told.pop("units")
    assert {*units} <= keys_of(told)
    assert len(units) >= 3


def test_the_round_trip_had_one_unit_in_ticks_and_in_seconds(typed: Callable[..., Any]) -> None:
    units = json.loads(typed("stability", "soft_tissue", "--set", "law=direct", "--continuous", "--critical", "k_e",
                             "--tol", "1", "--json").out)["units"]
    assert (units["round_trip"], units["continuous.round_trip"]) == ("ticks", "s")
    assert units["value"] == "N/m"  # the knob's


@pytest.mark.parametrize(("words", "unit"), [
    (("passivity", "leader_follower", "--axis", "elbow"), "N m/rad"),
    (("stability", "leader_follower", "--time"), "rad"),
])
def test_of_a_joint_the_units_were_those_of_a_line(typed: Callable[..., Any], words: tuple[str, ...], unit: str
                                                   ) -> None:
    assert unit in json.loads(typed(*words, "--set", "duration=0.2", "--json").out)["units"].values()
