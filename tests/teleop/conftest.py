"""Ways to type a command: in this process, and in one of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from teleop.__main__ import main
from teleop.scene.library import ROOT


class Answer(NamedTuple):
    """What a command came to."""

    code: int
    out: str
    err: str

    def assert_refused(self, *words: str) -> None:
        """Exit code 2, nothing on stdout, one sentence on stderr that has the words in it."""
        assert self.code == 2
        assert self.out == ""
        assert self.err.startswith("teleop: ")
        assert self.err.count("\n") == 1
        for word in words:
            assert word in self.err


@pytest.fixture
def typed(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., Answer]:
    """`typed(*arguments)`: `teleop ARGUMENTS` in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def type_it(*argv: str) -> Answer:
        code = main(argv)
        return Answer(code, *capsys.readouterr())

    return type_it


@pytest.fixture
def process(tmp_path: Path) -> Callable[..., subprocess.Popen[str]]:
    """`process(*arguments)`: `python ARGUMENTS` in an empty folder, this house on its path."""

    own = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}

    def start(*arguments: str, stdout: Any = subprocess.PIPE) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, *arguments], cwd=tmp_path, env={**own, "PYTHONPATH": str(ROOT)}, text=True,
            stdout=stdout, stderr=subprocess.PIPE,
        )

    return start


@pytest.fixture
def ended() -> Callable[[subprocess.Popen[str]], Answer]:
    """`ended(process)`: wait for it, and what it came to."""

    def wait(started: subprocess.Popen[str]) -> Answer:
        out, err = started.communicate()
        return Answer(started.returncode, out or "", err)

    return wait
