"""What stands in the way of a request is found before it runs, and leaves nothing behind."""

from __future__ import annotations

import errno
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import pytest

import teleop.simulation.result
import teleop.terminal.plotting
import teleop.terminal.run

Typed = Callable[..., Any]
SHORT = ("--set", "duration=0.2")

def left_in(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*"))


class TestAWrongRequest:
    @pytest.fixture(autouse=True)
    def files(self, tmp_path: Path) -> None:
        (tmp_path / "taken").mkdir()

    def test_finds_the_folder_taken_before_it_runs(
        self, typed: Typed, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(teleop.terminal.run, "run", lambda *_, **__: pytest.fail("it was computed"))
        typed("run", "canonical", "--out", "taken").assert_refused("there already")

    def test_finds_the_folder_forbidden_before_it_runs(
        self, typed: Typed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        before = left_in(tmp_path)

        def forbidden(*_: object, **__: object) -> None:
            raise PermissionError(errno.EACCES, "Permission denied")

        monkeypatch.setattr(teleop.terminal.run, "run", lambda *_, **__: pytest.fail("it was computed"))
        monkeypatch.setattr(Path, "mkdir", forbidden)
        typed("run", "canonical", "--out", "new/run").assert_refused("Permission denied", "--out")
        assert left_in(tmp_path) == before

    def test_on_a_full_disk_leaves_nothing(
        self, typed: Typed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        before = left_in(tmp_path)

        def full(file: BinaryIO, _: object) -> None:
            file.write(b"half of it")
            raise OSError(errno.ENOSPC, "No space left on device")

        monkeypatch.setattr(teleop.simulation.result, "write_arrays", full)
        answer = typed("run", "canonical", *SHORT, "--out", "new/folders/run")
        answer.assert_refused("No space left", "nothing was left", "--out")
        assert left_in(tmp_path) == before

    def test_interrupted_leaves_nothing(
        self, typed: Typed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        before = left_in(tmp_path)

        def interrupted(*_: object, **__: object) -> None:
            raise KeyboardInterrupt

        monkeypatch.setattr(teleop.terminal.run, "run", interrupted)
        answer = typed("run", "canonical")
        assert (answer.code, answer.out) == (130, "")
        assert answer.err.count("\n") == 1
        assert "interrupted" in answer.err
        assert left_in(tmp_path) == before

    @pytest.mark.parametrize("option", [["--plot"], ["--format", "pdf,svg"]])
    @pytest.mark.parametrize("words", [
        ["run", "canonical"], ["demo"], ["sweep", "soft_tissue", "--grid", "k_e=1,2"], ["precision", "hard_wall"],
        ["stability", "virtual_wall"],
        ["passivity", "virtual_wall"], ["zwidth", "virtual_wall"], ["report", "taken"],
    ], ids=lambda words: words[0])
    def test_without_matplotlib_a_plot_is_refused_before_it_runs(
        self, typed: Typed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], option: list[str]
    ) -> None:
        before = left_in(tmp_path)
        monkeypatch.setattr(teleop.terminal.plotting, "find_spec", lambda _: None)
        typed(*words, *option).assert_refused("pip install 'bilateral-teleop[plot]'")
        assert left_in(tmp_path) == before

    def test_that_is_a_bug_keeps_its_traceback(
        self, typed: Typed, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(teleop.terminal.run, "run", lambda *_, **__: {}["a bug"])
        with pytest.raises(KeyError):
            typed("run", "canonical")
