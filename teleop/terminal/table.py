"""Aligned text: labelled facts, and tables with columns."""

from __future__ import annotations

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
