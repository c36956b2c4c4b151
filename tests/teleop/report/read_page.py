"""A page of `teleop report` as a test reads it: elements, texts, figures and the points of their curves."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from itertools import accumulate
from xml.etree import ElementTree

from teleop.terminal.plotting import FRAME

SVG = "{http://www.w3.org/2000/svg}"
ALONE = {"meta", "link", "br", "img", "input", "hr"}  # elements of HTML that have no end


class Page(HTMLParser):
    """The elements of a page with their attributes, and its texts; every element that begins ends."""

    def __init__(self, data: bytes) -> None:
        super().__init__(convert_charrefs=True)
        self.source = data.decode()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[str] = []
        self._open: list[str] = []
        self._goes_on = False  # the last text: the part in a span belongs to it
        self.feed(self.source)
        self.close()
        assert self._open == []
        self.figures = [ElementTree.fromstring(one) for one in re.findall(r"<svg.*?</svg>", self.source, re.S)]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        self._goes_on &= tag == "span"
        if tag not in ALONE:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag
        self._goes_on &= tag == "span"

    def handle_data(self, data: str) -> None:
        if self._open and self._open[-1] != "style":
            if self._goes_on:
                self.texts[-1] += data
            else:
                self.texts.append(data)
            self._goes_on = True

    @property
    def text(self) -> str:
        """All that is read, one text after the other."""
        return "\n".join(self.texts)

    def figure(self, title: str) -> ElementTree.Element:
        return next(one for one in self.figures if one.findtext(f"{SVG}title") == title)

    def assert_needs_nothing_else(self) -> None:
        """No script, nothing that is loaded, nothing that is sent, no style but that which the policy names."""
        tags = {tag for tag, _ in self.elements}
        assert not tags & {"script", "link", "img", "iframe", "object", "embed", "form", "base", "foreignobject", "use",
                           "image", "a", "animate", "set"}
        for _, attributes in self.elements:
            assert not {"src", "href", "xlink:href", "style", "srcset", "action"} & attributes.keys()
            assert not any(name.startswith("on") for name in attributes)
        assert "url(" not in self.source
        assert "@import" not in self.source
        policy = next(attributes["content"] for tag, attributes in self.elements
                      if attributes.get("http-equiv") == "Content-Security-Policy")
        assert policy.startswith("default-src 'none'; style-src 'sha256-")


def curves(figure: ElementTree.Element) -> dict[str, list[list[tuple[float, float]]]]:
    """What has a name in a figure: of each curve the pieces between its gaps, as points of the drawing."""
    found: dict[str, list[list[tuple[float, float]]]] = {}
    for group in figure.iter():
        name = group.findtext(f"{SVG}title") if group is not figure else None
        for path in group.iter(f"{SVG}path") if name is not None else ():
            found.setdefault(str(name), []).extend(points(str(path.get("d"))))
    return found


def points(path: str) -> list[list[tuple[float, float]]]:
    """The points of a path of moves and relative lines."""
    pieces = [[float(number) for number in re.findall(r"-?\d*\.?\d+", piece)] for piece in path.split("M")[1:]]
    return [[*zip(accumulate(piece[::2]), accumulate(piece[1::2]), strict=True)] for piece in pieces]


def texts(figure: ElementTree.Element) -> list[str]:
    return [str(one.text) for one in figure.iter(f"{SVG}text")]


def frames(figure: ElementTree.Element) -> list[tuple[float, float, float, float]]:
    """Left, top, width and height of each panel."""
    sides = [points(str(one.get("d")))[0] for one in figure.iter(f"{SVG}path") if one.get("stroke") == FRAME.lower()]
    return [(left, top, right - left, foot - top) for ((left, foot), (_, top)), ((right, _), _) in
            zip(sides[::4], sides[1::4], strict=True)]
