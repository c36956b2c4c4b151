"""HTML and SVG put together from elements: every text is escaped, so that none of them can become markup.

What folders hold (names of scenes, sentences, knobs) is text that others wrote. A text goes into a page only by
`element`, which escapes it; what is not escaped is a `Markup`, and only this module makes one out of a text.
"""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Iterable, Sequence
from hashlib import sha256
from html import escape

from teleop.terminal.plotting import BLACK, BLUE, BROWN, DARK, FRAME, GREEN, GRID, PURPLE, RED, SKY, WINE
from teleop.terminal.table import printable

LONGEST = 2000  # characters of one text
SHORT = 24  # characters of a cell, or of its row's name, that is not broken
LONG_WORD = 40  # characters of a word that is broken anywhere
_PATH = re.compile(r"[MLlqcz0-9 .-]*")
# What stays on one line: a number with its unit, and an option, which a browser would break behind its hyphens.
_WHOLE = re.compile(r"(?<![\w.])(?:[-+]?\d[\d.]*(?:e[-+]?\d+)? (?:%|[numkMG]?(?:m|s|N|J|W|Hz|rad|kg|deg)\b[^\s,;:)]*"
                    r"(?: [ms]/(?:m|rad|s)\b)?|1/s|times)|--[\w-]+(?: [\w.-]+=\S+)?)")


class Markup(str):
    """Text that is markup already, of the functions here alone."""

    __slots__ = ()


def element(name: str, attributes: dict[str, object] | None = None, *inside: str) -> Markup:
    """The element `name` around `inside`, in which all but `Markup` is escaped. An attribute that is None is left out.

    >>> print(element("td", {"class": "n"}, "a < b"))
    <td class="n">a &lt; b</td>
    """
    texts = "".join(f' {key}="{text(value if isinstance(value, str) else str(value))}"'
                   for key, value in (attributes or {}).items() if value is not None)
    return Markup(f"<{name}{texts}>{''.join(map(text, inside))}</{name}>")


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


def text(part: str) -> Markup:
    """`part` escaped, with what a reader would obey (controls, changes of direction) written out; `Markup` as it is."""
    return part if isinstance(part, Markup) else Markup(escape(printable(part, most=LONGEST)))


def table(head: Sequence[str], rows: Iterable[Sequence[str]], *, numbers: bool = True, even: bool = False) -> Markup:
    """A table; of each row the first cell is its heading. `numbers`: the other cells are numbers, set to the right.

    `even`: its columns are alike, and it is as wide as the page.
    """
    lines = [element("tr", None, element("th", {"scope": "row", "class": "w" if len(row[0]) > SHORT else None},
                                         row[0]), *[_cell(one, numbers) for one in row[1:]]) for row in rows]
    top = element("tr", None, *[element("th", {"scope": "col", "class": "n" if numbers and i else None}, one)
                                for i, one in enumerate(head)])
    parts = [element("thead", None, top)] * bool(head)
    return element("div", {"class": "scroll"}, element("table", {"class": "even" if even else None}, *parts,
                                                       element("tbody", None, *lines)))


def _cell(sentence: str, numbers: bool) -> Markup:
    """A cell of a table."""
    kinds = ["n"] * numbers + [kind for kind in [_breaks(sentence)] if kind]
    return element("td", {"class": " ".join(kinds) or None}, *unbroken(sentence))


def _breaks(sentence: str) -> str | None:
    """The class of a cell: a short one is not broken, one with a long word is broken anywhere."""
    if isinstance(sentence, Markup) or any(len(word) > LONG_WORD for word in sentence.split()):
        return "w"
    return "k" if len(sentence) <= SHORT else None


def unbroken(sentence: str) -> list[str]:
    """The parts of a text, of which a number with its unit and an option are elements that no line end parts.

    >>> print(*unbroken("up to 20 N; type --set duration=3"), sep="|")
    up to |<span class="k">20 N</span>|; type |<span class="k">--set duration=3</span>
    """
    if isinstance(sentence, Markup) or len(sentence) <= SHORT:
        return [sentence]
    parts: list[str] = []
    at = 0
    for match in _WHOLE.finditer(sentence[:LONGEST]):
        if len(match[0]) <= LONG_WORD:
            parts += [sentence[at:match.start()], element("span", {"class": "k"}, match[0])]
            at = match.end()
    return [part for part in [*parts, sentence[at:]] if part]


def facts(rows: Iterable[tuple[str, str]]) -> Markup:
    """Labels, each with what is said of it; an empty label goes on with the last."""
    return table((), rows, numbers=False)


def pairs(rows: Iterable[tuple[str, str]]) -> Markup:
    """Short names and values, side by side."""
    return element("dl", None, *[element("div", None, element("dt", None, name), element("dd", None, value))
                                 for name, value in rows])


# What a colour of a figure is on a dark ground; any other is seen on both.
_DARK = {BLACK: "#e6e6e6", BLUE: SKY, RED: "#FF8A3D", DARK: "#A8A8A8", GREEN: "#2BC79A", PURPLE: "#B79CF0",
         BROWN: "#C08A7C", WINE: "#D06088", GRID: "#2a2e34", FRAME: "#3a3f46"}
_ON_LIGHT = "--back:#fff;--ink:#1b1b1b;--soft:#5c5c5c;--rule:#d9d9d9;--grid:#e9e9e9;--good:#00724f;--bad:#b53a00;"
_ON_DARK = "--back:#15181c;--ink:#e6e6e6;--soft:#a3a3a3;--rule:#3a3f46;--grid:#2a2e34;--good:#3ddc9f;--bad:#ff9a5c;"
_IN_FIGURES = "".join(f'svg [{name}="{light.lower()}"]{{{name}:{dark}}}' for light, dark in _DARK.items()
                      for name in ("fill", "stroke"))
CSS = f"""
:root{{color-scheme:light dark;{_ON_LIGHT}}}
@media (prefers-color-scheme:dark){{:root{{{_ON_DARK}}}}}
@media screen and (prefers-color-scheme:dark){{{_IN_FIGURES}}}
@media print{{:root{{color-scheme:light;{_ON_LIGHT}--ink:#000}}}}
*{{box-sizing:border-box}}
body{{margin:0 auto;padding:1.2rem;max-width:76rem;background:var(--back);color:var(--ink);
font:15px/1.45 system-ui,-apple-system,"Segoe UI",Roboto,"Liberation Sans",Arial,sans-serif}}
h1,h2,h3{{line-height:1.2;margin:0 0 .3rem}}h1{{font-size:1.5rem}}h2{{font-size:1.2rem;margin-top:1.6rem}}
h3{{font-size:1rem;margin-top:1.1rem}}p{{margin:.3rem 0;max-width:60rem}}
.sub,footer,figcaption{{color:var(--soft)}}.out{{font-size:1.05rem}}.out b{{margin-right:.4em}}
.good{{color:var(--good)}}.bad{{color:var(--bad)}}
figure{{margin:.5rem 0 0;break-inside:avoid}}figcaption{{font-size:.85em}}svg{{display:block;width:100%;height:auto}}
svg[width]{{width:auto;max-width:100%}}
svg{{font-size:10px}}svg text:not([fill]){{fill:var(--ink)}}svg path{{stroke-linejoin:round;stroke-linecap:round}}
svg path[stroke-dasharray]{{stroke-linecap:butt}}
@media screen and (max-width:40rem){{figure{{overflow-x:auto}}svg{{min-width:36rem}}.even{{min-width:36rem}}}}
.scroll{{overflow-x:auto}}table{{border-collapse:collapse;margin:.6rem 0;font-size:.87em;break-inside:auto}}
caption,.cap{{text-align:left;font-weight:600;padding-bottom:.2rem}}
th,td{{text-align:left;vertical-align:top;padding:.12rem .9rem .12rem 0;border-top:1px solid var(--grid)}}
thead th{{border-top:0;vertical-align:bottom}}
th[scope=row]{{font-weight:400;color:var(--soft)}}th.n,td.n{{text-align:right;font-variant-numeric:tabular-nums}}
tr{{break-inside:avoid}}.small{{font-size:.82em}}.k,th[scope=row]:not(.w){{white-space:nowrap}}.w,.out{{overflow-wrap:anywhere}}
table.even{{width:100%;table-layout:fixed}}
dl{{display:flex;flex-wrap:wrap;gap:.1rem 1.2rem;margin:.4rem 0;font-size:.87em}}
dl div{{display:flex;gap:.4em;max-width:100%}}dt{{color:var(--soft)}}dd{{margin:0;overflow-wrap:anywhere;min-width:0}}
code,pre{{font:.87em/1.4 ui-monospace,SFMono-Regular,Menlo,Consolas,"Liberation Mono",monospace;overflow-wrap:anywhere}}
pre{{white-space:pre-wrap;margin:.4rem 0}}footer{{margin-top:1.4rem;font-size:.85em;border-top:1px solid var(--rule);
padding-top:.5rem}}
@page{{margin:12mm 13mm}}
@media print{{body{{padding:0;max-width:none;font-size:9.5pt;line-height:1.3}}h1{{font-size:15pt}}
h2,h3{{break-after:avoid}}.scroll{{overflow:visible}}*{{print-color-adjust:exact;-webkit-print-color-adjust:exact}}}}
"""
STYLE = CSS.replace("\n", "")
DIGEST = b64encode(sha256(STYLE.encode()).digest()).decode()  # by which the page allows this style and no other
