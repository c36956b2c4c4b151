"""A command that works something out: its folder, and Ctrl-C while results are written."""

from __future__ import annotations

import json
import signal
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path

import pytest

from teleop.terminal.answer import Answer, Task, command_of, interrupts_wait


@pytest.fixture(autouse=True)
def ctrl_c() -> Iterator[None]:
    """Ctrl-C as a process has it that was started at a terminal."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_it_raises_nothing_and_is_noted_however_often_it_comes() -> None:
    with interrupts_wait() as interrupt:
        assert not interrupt.is_pending
        for _ in range(3):
            signal.raise_signal(signal.SIGINT)
        assert interrupt.is_pending
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_after_an_error_it_is_as_it_was() -> None:
    with pytest.raises(ZeroDivisionError), interrupts_wait():
        raise ZeroDivisionError
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_where_it_is_ignored_it_stays_so() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with interrupts_wait() as interrupt:
        signal.raise_signal(signal.SIGINT)
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    assert not interrupt.is_pending


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

    def test_without_a_request_for_a_folder_there_is_none(self) -> None:
        answer = command_of(lambda _: self.task(), "test", always=False)(Namespace(out=None))
        assert (answer.text, answer.code, [*Path().iterdir()]) == ("found", 0, [])

    @pytest.mark.parametrize(("code", "names"), [(0, {"numbers", "summary.json"}), (130, set())])
    def test_a_folder_that_can_be_gone_on_with_gets_no_summary_before_the_end(self, code: int, names: set[str]) -> None:
        Path("mine").mkdir()
        answer = command_of(lambda _: self.task(Path("mine"), code), "test")(Namespace(out="mine"))
        assert (answer.code, {path.name for path in Path("mine").iterdir()}) == (code, names)
