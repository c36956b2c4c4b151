"""Aligned text: labelled facts, and tables with columns."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Collection, Iterable, Sequence


def printable(text: str, *, lines: bool = False, most: int = 4000) -> str:
    r"""`text` on one line, with at most `most` characters, and what a terminal would obey written out.

    That is whatever `str.isprintable` does not count in: control and escape characters, changes of the direction of
    writing, halves of characters, line ends. With `lines` the line ends stay and the length is not bounded.

    >>> print(printable("a\x1b[2Jb\u202ec\nd"))
    a\x1b[2Jb\u202ec\nd
    """
    if not lines and len(text) > most:
        text = f"{text[:most - 3]}..."
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or (lines and c == "\n") else c.encode("unicode_escape").decode()
                   for c in text)


def facts(rows: Iterable[tuple[str, str]]) -> str:
    """A line for each label and what is said of it, the texts below each other; an empty label goes on with the last.

    >>> print(facts([("run", "hard_wall, law wave"), ("status", "ok")]))
    run      hard_wall, law wave
    status   ok
    """
    table_lines = list(rows)
    width = max((len(label) for label, _ in table_lines), default=0)
    return "\n".join(f"{label:<{width}}   {printable(text)}".rstrip() for label, text in table_lines)


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
        name, words = line[:at], line[at:]
        if not words or words[0] == " " or name[-3:] != "   " or "  " in name.rstrip():
            return "\n".join([*out, *lines[n:]])
        short = len(line) <= width or _TYPED.search(words) is not None
        out += [line] if short else textwrap.wrap(words, width, initial_indent=name, subsequent_indent=" " * at,
                                                  break_long_words=False, break_on_hyphens=False)
    return "\n".join(out)


def columns(lines: Iterable[Sequence[str]], *, left: Collection[int] = (0,)) -> str:
    """Lines of equally many cells, the columns `left` flush left and all others flush right.

    >>> print(columns([("block", "rows"), ("delays", "12")]))
    block   rows
    delays    12
    """
    table_lines = [*lines]
    widths = [max(map(len, cells)) for cells in zip(*table_lines, strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(width) if i in left else cell.rjust(width)
                  for i, (cell, width) in enumerate(zip(line, widths, strict=True))).rstrip()
        for line in table_lines)


PREFIX = {-3: "n", -2: "u", -1: "m", 0: "", 1: "k", 2: "M", 3: "G"}  # u: a terminal may know ASCII only


def si(value: float, unit: str) -> str:
    """`value` to three digits with an SI prefix; without a unit, of axes in m and rad together, without a prefix too.

    >>> si(0.03181, "m"), si(-1.1e-2, "J"), si(999.96, "N"), si(0.0, "J"), si(0.0049812, "")
    ('31.8 mm', '-11.0 mJ', '1.00 kN', '0 J', '0.00498')
    """
    if not unit:
        return f"{value:.3g}"
    if value == 0.0:
        return f"0 {unit}"
    digits, _, power = f"{value:.2e}".partition("e")
    if power == "":  # not finite
        return f"{value} {unit}"
    thousands, rest = divmod(int(power), 3)
    if thousands not in PREFIX:
        return f"{value:.2e} {unit}"
    return f"{float(digits) * 10**rest:.{2 - rest}f} {PREFIX[thousands]}{unit}"


def duration(seconds: float) -> str:
    """A time in whole seconds, or in min or h to two digits.

    >>> duration(0.2), duration(41.3), duration(750.0), duration(4e4), duration(3.6e6)
    ('1 s', '41 s', '12 min', '11 h', '1000 h')
    """
    if seconds < 99.5:
        return f"{max(seconds, 1.0):.0f} s"
    return f"{two_digits(seconds / 60.0)} min" if seconds < 99.5 * 60.0 else f"{two_digits(seconds / 3600.0)} h"


def grouped(count: int) -> str:
    """A count with its thousands apart: it is counted at a glance, where 1e+10 has to be read.

    >>> grouped(4800), grouped(10_000_000_000)
    ('4800', '10 000 000 000')
    """
    return f"{count:,}".replace(",", " ") if count >= 10_000 else str(count)


def two_digits(value: float) -> str:
    """A value to two digits, or to a whole number, without an exponent."""
    return f"{value:.0f}" if value >= 10.0 else f"{value:.2g}" if value >= 1e-3 else f"{value:.1e}"
