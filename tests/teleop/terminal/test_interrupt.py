"""Ctrl-C while results are written: it waits, and what others have made of it stays."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest

from teleop.terminal.interrupt import interrupts_wait


@pytest.fixture(autouse=True)
def ctrl_c() -> Iterator[None]:
    """Ctrl-C as a process has it that was started at a terminal."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_it_raises_nothing_and_is_noted_however_often_it_comes() -> None:
    with interrupts_wait() as interrupt:
        assert not interrupt.came
        for _ in range(3):
            signal.raise_signal(signal.SIGINT)
        assert interrupt.came
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
    assert not interrupt.came
