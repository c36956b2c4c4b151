"""The line in a terminal that shows how far a command has come."""

from __future__ import annotations

import sys
from argparse import Namespace
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TextIO

from teleop.errors import plural
from teleop.terminal import screen
from teleop.terminal.screen import columns
from teleop.terminal.table import duration, grouped, two_digits

Show = Callable[[float, str], None]  # how much is done, and a text

RATE_AFTER = 0.5  # s of rows before their rate is told: the first few come in a bunch
RATE_OVER = 10.0  # s that it is taken over, or as long as a few rows last
BAR_FROM = 60  # columns; a bar in fewer would come and go with what stands behind it


class Progress:
    """Progress on one line of `stream`, of something of size `total`.

    On a terminal the line is written over itself; elsewhere there is a plain line now and then, and none for
    what takes no longer. The safe state in its text is in a colour, where the terminal has any.
    """

    __slots__ = ("_first", "_line", "_total")

    def __init__(self, stream: TextIO, total: float) -> None:
        self._line, self._total = _StatusLine(stream), total
        self._first: tuple[float, float] | None = None  # what was done at the first call, and when

    def show(self, done: float, now_s: float, text: str = "", less: str = "") -> None:
        """`done` of the total is done at `now_s` (s, of any clock that does not go back); `text` follows.

        Parts of a text are two spaces apart, what matters most first. Where it is narrow the bar gives way, then `less`
        from its last part on, then the time left, then the last parts of `text`.
        """
        first, began = self._first = self._first or (done, now_s)
        if not self._line.is_due(now_s, done >= self._total):
            return
        part = min(max(done / self._total, 0.0), 1.0) if self._total > 0.0 else 1.0
        left = ""
        if first < done < self._total:
            left = f"{duration((now_s - began) * (self._total - done) / (done - first))} left"
        ahead = f"{part:4.0%}"
        self._line.write(part, *(_joined(ahead, left, text, later) for later in (*_shorter(less), "")),
                         *(_joined(ahead, shorter) for shorter in _shorter(text)))

    def end(self) -> None:
        """Leave the line as it stands and go on below it."""
        self._line.end()


@contextmanager
def shown_on(stream: TextIO | None, clock: Callable[[], float], total: float = 1.0) -> Iterator[Show]:
    """`show(done, text)`, which tells on `stream` how much of `total` is done; None: nothing is told.

    `clock` gives the time in s; the line is ended however the work ends.
    """
    if stream is None:
        yield lambda *_: None
        return
    line = Progress(stream, total)
    try:
        yield lambda done, text: line.show(done, clock(), text)
    finally:
        line.end()


def shown_for(args: Namespace, total: float = 1.0) -> AbstractContextManager[Show]:
    """The same for a command: on standard error, by its clock; nothing with --json."""
    return shown_on(None if args.json else sys.stderr, args.seconds, total)


class RowsProgress:
    """Progress in rows on one line of `stream`, as `Progress` shows it.

    Rows that were there at the first call took no time now. The rate and the time left are those of the rows after the
    first that come: before these come what is compiled, processes that start and files that are read.
    """

    __slots__ = ("_before", "_line", "_progress_times")

    def __init__(self, stream: TextIO) -> None:
        self._line = _StatusLine(stream)
        self._before: int | None = None  # rows that were there at the first call
        self._progress_times: deque[tuple[int, float]] = deque()  # how many were there when, of the last seconds

    def show(self, done: int, total: int, now_s: float) -> None:
        """`done` of `total` rows are there at `now_s` (s, of any clock that does not go back)."""
        if self._before is None:
            self._before = done
        progress_times = self._progress_times
        if done > self._before:
            progress_times.append((done, now_s))
        while len(progress_times) > 2 and progress_times[1][1] <= now_s - RATE_OVER:
            progress_times.popleft()
        if not self._line.is_due(now_s, done >= total):
            return
        count, rate, left = f"{grouped(done)} of {grouped(total)}", "", ""
        if done == self._before:
            rate = "starting" if done < total else ""
        elif done > progress_times[0][0] and now_s - progress_times[0][1] >= RATE_AFTER:
            a_second = (done - progress_times[0][0]) / (now_s - progress_times[0][1])
            rate = f"{two_digits(a_second)} rows/s"
            left = f"{duration((total - done) / a_second)} left" if done < total else ""
        rows = f"{count} {plural(total, 'row')}"
        texts = [[rows, rate, left], [rows, left or rate], [count, left or rate], [count]]
        self._line.write(done / total if total else 1.0, *(_joined(*words) for words in texts))

    def end(self) -> None:
        """Leave the line as it stands and go on below it."""
        self._line.end()


def _joined(*words: str) -> str:
    """The words that there are, two spaces apart."""
    return "  ".join(filter(None, words))


def _shorter(text: str) -> Iterator[str]:
    """The text, and what is left of it without its last parts, down to the first.

    >>> [*_shorter("f 1.0 N  x 2.0 mm")]
    ['f 1.0 N  x 2.0 mm', 'f 1.0 N']
    """
    yield text
    while "  " in text:
        text = text.rpartition("  ")[0]
        yield text


class _StatusLine:
    """A line that is written over itself on a terminal, and anew now and then elsewhere."""

    __slots__ = ("_due", "_stream", "_terminal", "_width")

    def __init__(self, stream: TextIO) -> None:
        self._stream, self._terminal = stream, stream.isatty()
        self._due: float | None = None  # the time before which nothing is written
        self._width = 0  # of what stands on the terminal's line

    def is_due(self, now_s: float, last: bool) -> bool:
        """True if it is time to write: on a terminal at once, ten times a second and at the `last`; else every 5 s."""
        if self._due is None:
            self._due = now_s if self._terminal else now_s + 5.0
        if now_s < self._due and not (self._terminal and last):
            return False
        self._due = now_s + (0.1 if self._terminal else 5.0)
        return True

    def write(self, part: float, *texts: str) -> None:
        """The first of `texts` that fits, behind a bar if there is room for that too; cut if none does."""
        if not self._terminal:
            self._stream.write(texts[0].strip() + "\n")
        else:
            filled = round(20 * part)
            bar = "[" + "#" * filled + "." * (20 - filled) + "]  "
            room = (columns(self._stream) or 80) - 1
            fitting = [text for text in (*[bar + texts[0]] * (room >= BAR_FROM), *texts) if len(text) <= room]
            line = (fitting or [texts[-1][:room]])[0]
            self._stream.write("\r" + screen.live_line(line, self._stream) + " " * (self._width - len(line)))
            self._width = len(line)
        self._stream.flush()

    def end(self) -> None:
        """Go on below the line, if there is one."""
        if self._width:
            self._stream.write("\n")
            self._stream.flush()
            self._width = 0
