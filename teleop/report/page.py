"""The page: one file of HTML without a script, without anything loaded, the same bytes for the same sections."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from shlex import join
from typing import Any, NamedTuple

from teleop.report.figures import NO_FIGURE
from teleop.report.markup import DIGEST, STYLE, Markup, element, empty, facts, pairs, unbroken
from teleop.simulation.result import Result
from teleop.terminal.answer import Answer
from teleop.version import __version__

GOOD = ("ok", "done", "feasible")  # what a status is called that nothing is wrong with
ENDED = ("stopped", "interrupted")  # by somebody
POLICY = f"default-src 'none'; style-src 'sha256-{DIGEST}'; base-uri 'none'; form-action 'none'"


@dataclass(frozen=True, kw_only=True)
class Section:
    """Section of a page on one folder, or on several side by side."""

    title: str
    under: str = ""  # where it is from, in a line below the title
    status: str = ""
    sentence: str = ""  # the outcome
    blocks: Sequence[Markup] = ()


def page(sections: Sequence[Section]) -> bytes:
    """The page of these sections, at least one, as UTF-8."""
    title = sections[0].title if len(sections) == 1 else f"{len(sections)} reports"
    top = [element("h1", None, title)] if len(sections) > 1 else []
    without = [each for each in sections if NO_FIGURE in each.blocks]
    body = [*top, *[_rows_of(each, "h2" if top else "h1", omit=each in without[1:]) for each in sections],
            element("footer", None, f"Made by teleop report, bilateral-teleop {__version__}.")]
    head = element(
        "head", None, empty("meta", {"charset": "utf-8"}),
        empty("meta", {"http-equiv": "Content-Security-Policy", "content": POLICY}),
        empty("meta", {"name": "viewport", "content": "width=device-width, initial-scale=1"}),
        empty("meta", {"name": "referrer", "content": "no-referrer"}),
        element("title", None, title), element("style", None, Markup(STYLE)))
    return f"<!DOCTYPE html>\n{element('html', {'lang': 'en'}, head, element('body', None, *body))}\n".encode()


def _rows_of(section: Section, heading: str, *, omit: bool) -> Markup:
    """A section under its heading; `omit`: that it has no figures was said before."""
    parts = [element(heading, None, section.title)]
    if section.under:
        parts.append(element("p", {"class": "sub"}, section.under))
    if section.status or section.sentence:
        parts.append(outcome(section.status, section.sentence))
    return element("section", None, *parts, *[each for each in section.blocks if not (omit and each == NO_FIGURE)])


def outcome(status: str, sentence: str) -> Markup:
    """A status and its sentence, which may begin with the status itself."""
    rest = sentence.removeprefix(status).lstrip(": ") if status else sentence
    kind = "good" if status in GOOD else None if status in ENDED else "bad"
    return element("p", {"class": "out"}, *[element("b", {"class": kind}, status)] * bool(status), *unbroken(rest))


def heading(title: str) -> Markup:
    """The heading of a part of a section."""
    return element("h3", None, title)


def parameters(values: Mapping[str, Any], units: Mapping[str, str] | None = None, title: str = "Parameters"
               ) -> list[Markup]:
    """Knobs and their values, those of a law among them; nothing of none."""
    flat = flattened(values)
    if not flat:
        return []
    known = units or {}
    return [heading(title), pairs((name, with_unit(value, known.get(name, ""))) for name, value in flat.items())]


def with_unit(value: object, unit: str) -> str:
    """A value with its unit, where it is a number and has one.

    >>> with_unit(0.05, "s"), with_unit(None, "W"), with_unit("wave", "")
    ('0.05 s', 'none', 'wave')
    """
    number = isinstance(value, int | float) and not isinstance(value, bool) and unit not in ("", "1")
    return f"{sentence_of(value)} {unit}" if number else sentence_of(value)


def cell(value: object) -> str:
    """A value in a table: a number to four digits.

    >>> cell(0.00123456), cell(12345.6), cell("ok")
    ('0.001235', '12346', 'ok')
    """
    if not isinstance(value, float):
        return sentence_of(value)
    return f"{value:.0f}" if 1e4 <= abs(value) < 1e7 else f"{value:.4g}"


def flattened(values: Mapping[str, Any]) -> dict[str, Any]:
    """The knobs of a document by name; those of its law as `law.NAME`."""
    headers: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            headers[name] = value.get("name", "")
            headers |= {f"{name}.{key}": each for key, each in value.items() if key != "name"}
        else:
            headers[name] = value
    return headers


def sentence_of(value: object) -> str:
    """A value of a document as a person reads it."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list | tuple):
        return ", ".join(map(sentence_of, value))
    return "none" if value is None else str(value)


def made_by(document: Mapping[str, Any]) -> list[Markup]:
    """The command and the versions that a document was made by, as far as it says."""
    command, versions = document.get("command"), document.get("versions")
    rows: list[tuple[str, str]] = []
    if isinstance(command, list) and command:
        rows.append(("command", element("code", None, join(map(str, command)))))
    if isinstance(versions, Mapping) and versions:
        rows.append(("versions", ", ".join(f"{name} {version}" for name, version in versions.items())))
    return [heading("Made by"), facts(rows)] if rows else []


class FolderReport(NamedTuple):
    """A folder: what the terminal says of it, and either its run or what makes its part of the page."""

    folder: Path
    answer: Answer
    result: Result | None = None
    running: bool = False  # it is of a run or a sweep that goes on: there is no page of it yet
    section: Callable[[], Section] | None = None
