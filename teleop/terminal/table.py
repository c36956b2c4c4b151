"""Aligned text: labelled facts, and tables with columns."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Collection, Iterable, Sequence

from teleop.terminal.printable import printable


def facts(rows: Iterable[tuple[str, str]]) -> str:
    """A line for each label and what is said of it, the texts below each other; an empty label goes on with the last.

    >>> print(facts([("run", "hard_wall, law wave"), ("status", "ok")]))
    run      hard_wall, law wave
    status   ok
    """
    told = list(rows)
    width = max((len(label) for label, _ in told), default=0)
    return "\n".join(f"{label:<{width}}   {printable(text)}".rstrip() for label, text in told)


_LABEL = re.compile(r"\S+(?: \S+)* {3,}")
_TYPED = re.compile(r"`| --|type  |://")  # what is to be typed stays on one line, so that it can be copied
_LEAST = 30  # columns for a text to be folded in


def folded(text: str, width: int) -> str:
    """The text with the facts that it begins with folded between words at `width` columns, under their own beginning.

    >>> print(folded("run      hard_wall, law wave, virtual time, seed 0\\nstatus   ok", 44))
    run      hard_wall, law wave, virtual time,
             seed 0
    status   ok
    """
    lines = text.split("\n")
    label = _LABEL.match(lines[0])
    if label is None or width - (at := label.end()) < _LEAST:
        return text
    out: list[str] = []
    for n, line in enumerate(lines):
        name, said = line[:at], line[at:]
        if not said or said[0] == " " or name[-3:] != "   " or "  " in name.rstrip():
            return "\n".join([*out, *lines[n:]])
        short = len(line) <= width or _TYPED.search(said) is not None
        out += [line] if short else textwrap.wrap(said, width, initial_indent=name, subsequent_indent=" " * at,
                                                  break_long_words=False, break_on_hyphens=False)
    return "\n".join(out)


def columns(lines: Iterable[Sequence[str]], *, left: Collection[int] = (0,)) -> str:
    """Lines of equally many cells, the columns `left` flush left and all others flush right.

    >>> print(columns([("block", "rows"), ("delays", "12")]))
    block   rows
    delays    12
    """
    told = [*lines]
    widths = [max(map(len, cells)) for cells in zip(*told, strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(width) if i in left else cell.rjust(width)
                  for i, (cell, width) in enumerate(zip(line, widths, strict=True))).rstrip()
        for line in told)
