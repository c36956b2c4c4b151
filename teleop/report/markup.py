"""HTML and SVG put together from elements: every text is escaped, so that none of them can become markup.

What folders hold (names of scenes, sentences, knobs) is text that others wrote. A text goes into a page only by
`element`, which escapes it; what is not escaped is a `Markup`, and only this module makes one out of a text.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from html import escape

from teleop.terminal.table import printable

LONGEST = 2000  # characters of one text
SHORT = 16  # characters of a cell that is not broken
_PATH = re.compile(r"[MmLlhvHVz0-9 .-]*")


class Markup(str):
    """Text that is markup already, of the functions here alone."""

    __slots__ = ()


NOTHING = Markup("")


def element(name: str, attributes: dict[str, object] | None = None, *inside: str) -> Markup:
    """The element `name` around `inside`, in which all but `Markup` is escaped. An attribute that is None is left out.

    >>> print(element("td", {"class": "n"}, "a < b"))
    <td class="n">a &lt; b</td>
    """
    told = "".join(f' {key}="{text(value if isinstance(value, str) else str(value))}"'
                   for key, value in (attributes or {}).items() if value is not None)
    return Markup(f"<{name}{told}>{''.join(map(text, inside))}</{name}>")


def empty(name: str, attributes: dict[str, object]) -> Markup:
    """An element with nothing in it.

    >>> print(empty("rect", {"x": 1}))
    <rect x="1"/>
    """
    return Markup(element(name, attributes).removesuffix(f"></{name}>") + "/>")


def path_data(commands: str) -> Markup:
    """The commands of a path, which may be longer than a text, and have letters and numbers alone.

    Raises `ValueError` of anything else.
    """
    if not _PATH.fullmatch(commands):
        raise ValueError("commands of a path are letters and numbers")
    return Markup(commands)


def joined(parts: Iterable[str]) -> Markup:
    """One after the other, all but `Markup` escaped."""
    return Markup("".join(map(text, parts)))


def text(part: str) -> Markup:
    """`part` escaped, with what a reader would obey (controls, changes of direction) written out; `Markup` as it is."""
    return part if isinstance(part, Markup) else Markup(escape(printable(part, most=LONGEST)))


def table(head: Sequence[str], rows: Iterable[Sequence[str]], *, numbers: bool = True, even: bool = False) -> Markup:
    """A table; of each row the first cell is its heading. `numbers`: the other cells are numbers, set to the right.

    `even`: its columns are alike, and it is as wide as the page.
    """
    lines = [element("tr", None, element("th", {"scope": "row"}, row[0]), *[_cell(one, numbers) for one in row[1:]])
             for row in rows]
    top = element("tr", None, *[element("th", {"scope": "col", "class": "n" if numbers and i else None}, one)
                                for i, one in enumerate(head)])
    parts = [element("thead", None, top)] * bool(head)
    return element("div", {"class": "scroll"}, element("table", {"class": "even" if even else None}, *parts,
                                                       element("tbody", None, *lines)))


def _cell(said: str, numbers: bool) -> Markup:
    """A cell; what is short stays on one line."""
    kinds = ["n"] * numbers + ["k"] * (not isinstance(said, Markup) and len(said) <= SHORT)
    return element("td", {"class": " ".join(kinds) or None}, said)


def facts(rows: Iterable[tuple[str, str]]) -> Markup:
    """Labels, each with what is said of it; an empty label goes on with the last."""
    return table((), rows, numbers=False)


def pairs(rows: Iterable[tuple[str, str]]) -> Markup:
    """Short names and values, side by side."""
    return element("dl", None, *[element("div", None, element("dt", None, name), element("dd", None, value))
                                 for name, value in rows])
