"""The screen: texts folded between words on a terminal, with colours for statuses, notes, the safe state and headings.

The text is made without them, so widths, files, pipes and --json have none; they are laid over it where it is printed.
NO_COLOR (https://no-color.org), set to anything, and TERM=dumb switch them off.

Red, green and magenta alone, as the terminal has them: in the palettes of seven common terminals they keep a contrast
of 2.2 at least, on a light ground and on a dark one; yellow, blue and cyan fall to 1.6 and 2.0 on one of the two. No
colour says what the words do not.
"""

from __future__ import annotations

import os
import re
from typing import TextIO

from teleop.terminal.table import folded

GOOD, BAD, NOTICE, BOLD = "32", "31", "35", "1"  # green, red, magenta: SGR of ECMA-48

_OF = {"ok": GOOD, "stable": GOOD,
       "limit cycle": NOTICE, "stopped": NOTICE, "still running": NOTICE, "unsettled": NOTICE, "refused": NOTICE,
       "poor": NOTICE,
       "unstable": BAD, "diverged": BAD, "unreleased": BAD}
_STATUS = re.compile(rf"(?:(?<=  )|(?<=\d ))(?:{'|'.join(_OF)})(?=[:,;]|$|  )")  # a cell, or behind a count of them
_LABEL = re.compile(r"(?:note|safe state|watchdog)(?= {3})")  # of a table of facts
_FIRST = re.compile(r"\S+(?: \S+)* {3,}")  # the first label of such a table: what follows is its heading
_SECTION = re.compile(r"\w[\w ,]*")  # a line over others that are set in by two
_SAFE = re.compile(r"(?:master |slave )?SAFE [^ ]+ .+?(?=  |$)")


def render(text: str, stream: TextIO) -> str:
    """The text of an answer as it is printed on `stream`."""
    width = columns(stream) if stream.isatty() else 0
    return answer(folded(text, width) if width else text, stream)


def columns(stream: TextIO) -> int:
    """The width of the terminal behind `stream`; 0 where it cannot be told."""
    try:
        return os.get_terminal_size(stream.fileno()).columns
    except (OSError, ValueError):
        return 0


def has_colours(stream: TextIO) -> bool:
    """True if `stream` is a terminal that shows colours, and nobody has asked for none."""
    return not os.environ.get("NO_COLOR") and os.environ.get("TERM", "dumb") != "dumb" and stream.isatty()


def painted(text: str, colour: str, stream: TextIO) -> str:
    """`text` in `colour` where `stream` has colours, else as it is."""
    return _in(colour, text) if has_colours(stream) else text


def answer(text: str, stream: TextIO) -> str:
    """The text of an answer with its colours where `stream` has them: statuses, labels of notes, headings."""
    if not has_colours(stream):
        return text
    lines = text.split("\n")
    return "\n".join(_line(line, after, first=i == 0)
                     for i, (line, after) in enumerate(zip(lines, [*lines[1:], ""], strict=True)))


def live_line(text: str, stream: TextIO) -> str:
    """A line of progress, with the safe state in a colour where `stream` has colours."""
    return _SAFE.sub(lambda part: _in(BAD, part[0]), text) if has_colours(stream) else text


def _line(line: str, after: str, *, first: bool) -> str:
    if _SECTION.fullmatch(line) and after.startswith("  "):
        return _in(BOLD, line)
    if first and (label := _FIRST.match(line)) is not None:
        return line[:label.end()] + _in(BOLD, line[label.end():])
    if (label := _LABEL.match(line)) is not None:
        return _in(NOTICE, label[0]) + line[label.end():]
    return _STATUS.sub(lambda part: _in(_OF[part[0]], part[0]), line)


def _in(colour: str, text: str) -> str:
    return f"\x1b[{colour}m{text}\x1b[0m"
