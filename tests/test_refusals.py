"""Requests that are refused, each with its whole sentence: those in `refusals.toml`, through the commands' own entries.

A request of a command has exit code 2, nothing on stdout, one sentence on stderr, and leaves nothing behind. What is
typed in Python raises `Refused`, or the error that the sentence begins with. To add one, write the request with "" and
copy its line from the failure.
"""

from __future__ import annotations

import importlib
import json
import shlex
import tomllib
from collections.abc import Callable
from math import inf, nan
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import teleop
from teleop import Refused
from teleop.__main__ import main

REQUESTS: dict[str, Any] = tomllib.loads(Path(__file__).with_name("refusals.toml").read_text())
PROGRAMS = ("master", "slave", "channel")


def matches(sentence: str, text: str) -> bool:
    """True if the text is the sentence, in which each … stands for any words that are the machine's."""
    first, *rest = sentence.split("…")
    if not rest:
        return text == sentence
    place = len(first)
    for part in rest[:-1]:
        found = text.find(part, place)
        if found < 0:
            return False
        place = found + len(part)
    return text.startswith(first) and text.endswith(rest[-1]) and len(text) - len(rest[-1]) >= place


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder in which requests are typed, with the files of `refusals.toml`."""
    monkeypatch.chdir(tmp_path)
    for name, text in REQUESTS["files"].items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text) if text else path.mkdir()
    return tmp_path


def assert_answered(requests: dict[str, str], ask: Callable[[str], str]) -> None:
    """Fail with all requests whose answer is not the sentence, as lines for `refusals.toml`."""
    answers = {request: ask(request) for request in requests}
    wrong = [request for request, sentence in requests.items() if not matches(sentence, answers[request])]
    if wrong:
        lines = [f"{json.dumps(request)} = {json.dumps(answers[request], ensure_ascii=False)}" for request in wrong]
        pytest.fail("\n".join(["these are answered otherwise:", *lines]), pytrace=False)


@pytest.mark.parametrize("section", REQUESTS["commands"])
def test_a_wrong_command_is_refused_in_one_sentence_and_leaves_nothing(folder: Path, capsys: pytest.CaptureFixture[str],
        section: str) -> None:
    def ask(request: str) -> str:
        words = shlex.split(request)
        before = sorted(folder.rglob("*"))
        if words and words[0] in PROGRAMS:
            program = importlib.import_module(f"{words[0]}.__main__")
            code = program.main(words[1:])
        else:
            code = main(words)
        out, err = capsys.readouterr()
        after = [path for path in sorted(folder.rglob("*")) if "__pycache__" not in path.parts]
        if (code, out, after, err[:8], err.count("\n")) != (2, "", before, "teleop: ", 1):
            return f"exit code {code}, {out!r} on stdout, {err!r} on stderr, and left {set(after) - set(before)}"
        return err[8:-1]

    assert_answered(REQUESTS["commands"][section], ask)


@pytest.mark.parametrize("module", REQUESTS["python"])
@pytest.mark.usefixtures("folder")
def test_a_wrong_value_is_refused_in_one_sentence(module: str) -> None:
    home = importlib.import_module(module)
    exports = {name: getattr(part, name) for part in (teleop, home) for name in getattr(part, "__all__", ())}
    names = {"np": np, "inf": inf, "nan": nan, "Path": Path, **exports, **vars(home)}

    def ask(request: str) -> str:
        try:
            value = eval(request, {**names})
        except Refused as refusal:
            return str(refusal)
        except Exception as error:
            return f"{type(error).__name__}: {error}"
        return f"no refusal but {value!r}"

    assert_answered(REQUESTS["python"][module], ask)
