"""The answers of the commands: every document begins alike, a folder is whole or none, and Ctrl-C while one is written.

A number without a bound is null in every document.
"""

from __future__ import annotations

import json
import signal
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from teleop.terminal.answer import Answer, Task, command_of, interrupts_wait
from teleop.terminal.options import typed_number, typed_range

HEAD = ["status", "sentence", "scene", "mode", "parameters", "seed", "versions", "command", "dt"]
SHORT = ("--set", "duration=0.05")
PRECISION = ("precision", "hard_wall", "--set", "duration=0.02", "--rounds", "1")


def keys_of(document: Any, path: tuple[str, ...] = ()) -> set[str]:
    if isinstance(document, list):
        return {key for each in document for key in keys_of(each, path)}
    if not isinstance(document, dict):
        return set()
    return {name for key, each in document.items() for name in (
        key, ".".join([*path, key]), *keys_of(each, (*path, key)))}


@pytest.mark.parametrize(("words", "mode"), [
    (("run", "local", *SHORT), "virtual"), (("stability", "soft_tissue", "--continuous"), "stability"),
    (("stability", "local", "--set", "duration=0.5", "--time"), "stability"), (PRECISION, "precision"),
    (("passivity", "virtual_wall"), "passivity"), (("passivity", "canonical"), "passivity"),
])
def test_every_document_about_a_scene_begins_alike_is_the_file_in_the_folder_and_names_units_of_keys_that_are_there(
        typed: Callable[..., Any], words: tuple[str, ...], mode: str) -> None:
    document = json.loads(typed(*words, "--seed", "3", "--json", "--out", "here").out)
    assert [*document][:len(HEAD)] == HEAD
    assert (document["scene"], document["mode"], document["seed"]) == (words[1], mode, 3)
    assert {"bilateral-teleop", "python", "numpy"} <= {*document["versions"]}
    assert document["command"][:2] == ["teleop", words[0]]
    assert document["dt"] == 1e-3
    assert document.pop("path") == "here"
    assert document == json.loads(Path("here/summary.json").read_text())
    if words[0] != "run":
        units = document.pop("units")
        assert {*units} <= keys_of(document)
        assert len(units) >= 3


def test_the_document_of_a_sweep_had_no_head(typed: Callable[..., Any]) -> None:
    """What differs between its rows is null, or left out of the parameters."""
    words = ("sweep", "local", *SHORT, "--json")
    document = json.loads(typed(*words, "--grid", "k_e=100,200").out)
    assert [*document][:len(HEAD)] == HEAD
    assert (document["scene"], document["mode"], document["seed"], document["dt"]) == ("local", "sweep", 0, 1e-3)
    assert document["sentence"] == "2 of 2 rows done: 2 ok"
    single = json.loads(typed("run", "local", *SHORT, "--json").out)
    assert document["parameters"] == {name: value for name, value in single["parameters"].items() if name != "k_e"}
    several = json.loads(typed(*words, "--grid", "dt=1e-3,5e-4", "law.b=1,2", "--seeds", "2", "--out", "b").out)
    assert (several["seed"], several["dt"]) == (None, None)
    assert "dt" not in several["parameters"]
    assert "b" not in several["parameters"]["law"]
    assert [*json.loads(typed("report", "b", "--json").out)][:len(HEAD)] == HEAD


def test_the_round_trip_had_one_unit_in_ticks_and_in_seconds_and_a_joint_that_of_a_line(
        typed: Callable[..., Any]) -> None:
    def units(*words: str) -> dict[str, str]:
        return dict(json.loads(typed(*words, "--json").out)["units"])

    found = units("stability", "soft_tissue", "--set", "law=direct", "--continuous", "--critical", "k_e", "--tol", "50")
    assert (found["round_trip"], found["continuous.round_trip"]) == ("ticks", "s")
    assert found["value"] == "N/m"  # the knob's
    joint = ("--set", "duration=0.2")
    assert "N m/rad" in units("passivity", "leader_follower", "--axis", "elbow", *joint).values()
    assert "rad" in units("stability", "leader_follower", "--time", *joint).values()


def test_ctrl_c_raises_nothing_and_is_noted_however_often_and_is_as_it_was_afterwards() -> None:
    """Also after an error; where it is ignored it stays so."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with interrupts_wait() as interrupt:
            assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
            signal.raise_signal(signal.SIGINT)
        assert not interrupt.is_pending
        signal.signal(signal.SIGINT, signal.default_int_handler)
        with pytest.raises(ZeroDivisionError), interrupts_wait():
            raise ZeroDivisionError
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        with interrupts_wait() as interrupt:
            assert not interrupt.is_pending
            for _ in range(3):
                signal.raise_signal(signal.SIGINT)
            assert interrupt.is_pending
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)


class TestCommand:
    @pytest.fixture(autouse=True)
    def here(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.chdir(tmp_path)

    @staticmethod
    def task(folder: Path | None = None, code: int = 0) -> Task:
        def draw(path: Path, _: object) -> list[Path]:
            signal.raise_signal(signal.SIGINT)
            path.write_text("whole")
            return [path]

        return Task("wall", lambda: Answer("found", {"status": "done"}, code, {
            "numbers": lambda path: path.write_text("1")}, {"first": draw, "second": draw}), folder)

    def test_an_interrupt_while_it_drew_lost_the_numbers(self) -> None:
        pytest.importorskip("matplotlib")
        answer = command_of(lambda _: self.task(), "test")(Namespace(out=None, plot=True, format=None))
        assert answer.code == 130
        assert answer.text.splitlines()[1:] == [
            "interrupted before it was drawn: second", "written to runs/wall-test-1", "plot: runs/wall-test-1/first"]
        assert {path.name for path in Path("runs/wall-test-1").iterdir()} == {"numbers", "summary.json", "first"}
        assert json.loads(Path("runs/wall-test-1/summary.json").read_text()) == {
            "status": "interrupted", "notes": ["interrupted before it was drawn: second"]}

    def test_a_folder_that_can_be_gone_on_with_gets_no_summary_before_the_end_and_without_a_request_there_is_none(
            self) -> None:
        answer = command_of(lambda _: self.task(), "test", always=False)(Namespace(out=None))
        assert (answer.text, answer.code, [*Path().iterdir()]) == ("found", 0, [])
        for code, names in ((130, set()), (0, {"numbers", "summary.json"})):
            Path("mine").mkdir(exist_ok=True)
            answer = command_of(lambda _, code=code: self.task(Path("mine"), code), "test")(
                Namespace(out="mine"))
            assert (answer.code, {path.name for path in Path("mine").iterdir()}) == (code, names)
        assert typed_range("--range", "-1:2e3", example="1:2") == (-1.0, 2000.0)
        assert typed_number("--tol", "1e-3", example="0.01") == 1e-3
