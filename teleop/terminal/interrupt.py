"""Ctrl-C while results are being written: it waits, so that what was found is kept."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress


class Waiting:
    """An interrupt that waits: `came` is True from the first Ctrl-C on."""

    __slots__ = ("came",)

    def __init__(self) -> None:
        self.came = False

    def __call__(self, *_: object) -> None:
        self.came = True


@contextmanager
def interrupts_wait() -> Iterator[Waiting]:
    """Have Ctrl-C raise nothing until the end; where it is ignored, or already has a handler, that stays."""
    waiting = Waiting()
    ours = False
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        with suppress(ValueError):  # in a thread, which Ctrl-C does not reach
            signal.signal(signal.SIGINT, waiting)
            ours = True
    try:
        yield waiting
    finally:
        if ours:
            signal.signal(signal.SIGINT, signal.default_int_handler)
