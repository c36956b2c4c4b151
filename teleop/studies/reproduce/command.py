"""The command `teleop reproduce`: rerun published numbers, and show them beside the results here."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Mapping, Sequence
from functools import partial
from math import floor, log10
from pathlib import Path
from typing import Any

from teleop.errors import number_of
from teleop.simulation.result import head
from teleop.studies.reproduce import PUBLICATIONS, find_publication
from teleop.studies.reproduce.publication import (
    DIFFERS,
    FITTED,
    PUBLISHED,
    REPRODUCED,
    NumberSource,
    Publication,
    Replication,
)
from teleop.terminal.answer import Answer, Task, command_of
from teleop.terminal.table import columns

Reruns = Mapping[str, tuple[Publication, Sequence[Replication]]]
WORDS = {REPRODUCED: "reproduced", DIFFERS: "different", FITTED: "fitted, which is no reproduction",
         PUBLISHED: "quoted and not run"}
PAGE = "page.md"


def find(args: Namespace) -> Task:
    """Rerun one publication, or all. Raises `Refused`."""
    names = PUBLICATIONS if args.name is None else (args.name,)
    publications = [find_publication(name) for name in names]  # all, before any is run

    def work() -> Answer:
        reruns = {each.name: (each, each.rerun()) for each in publications}
        return Answer(table(reruns), document(reruns, args.typed), files={PAGE: partial(write_page, reruns)})

    return Task("published", work)


command = command_of(find, "reproduce", always=False)


def document(reruns: Reruns, typed: Sequence[str]) -> dict[str, Any]:
    """The reruns as JSON."""
    return {
        **head(status="done", sentence="; ".join(verdict(reruns)), scene=", ".join(reruns), mode="reproduce",
               parameters={}, seed=None, command=typed, dt=None),
        "publications": [{"name": each.name, "kind": each.kind.value, "source": each.source, "about": each.about,
                          "setting": each.setting, "findings": [_number_document(number) for number in numbers]}
                         for each, numbers in reruns.values()],
    }


def verdict(reruns: Reruns) -> list[str]:
    """A sentence for each source of numbers, with the count by label: the sources weigh unlike."""
    sentences = []
    for source in NumberSource:
        labels = [each.label for publication, numbers in reruns.values() if publication.kind is source
                  for each in numbers]
        counts = [f"{labels.count(label)} {words}" for label, words in WORDS.items() if label in labels]
        if labels:
            sentences.append(f"{number_of(len(labels), 'number')} {source.value}: {', '.join(counts)}")
    return sentences


def _number_document(number: Replication) -> dict[str, Any]:
    return {"what": number.what, "label": number.label, "printed": number.printed, "published": number.value,
            "found": number.result, "unit": number.unit,
            "tolerance": number.tolerance if number.within is None else number.within,
            "tolerance_chosen_here": number.tolerance is not None, "remark": number.remark}


def table(reruns: Reruns) -> str:
    """The numbers of each publication under its source, for a terminal."""
    blocks = []
    for publication, numbers in reruns.values():
        lines = [("what", "label", "published", "here", "tolerance", "unit"), *map(_cells, numbers)]
        remarks = [f"  {number.what}: {number.remark}" for number in numbers if number.remark]
        blocks.append("\n".join([f"{publication.name}: {publication.about}", f"  {publication.source}",
                                 columns(lines, left=(0, 1)), *remarks]))
    return "\n\n".join([*blocks, "\n".join(verdict(reruns))])


def page(reruns: Reruns) -> str:
    """A page of Markdown with sources, settings, numbers, tolerances and remarks."""
    lines = ["# Published comparisons, run again", "", *[f"- {sentence}" for sentence in verdict(reruns)]]
    for publication, numbers in reruns.values():
        lines += ["", f"## {publication.name}", "", f"{publication.source}.", "",
                  f"What is compared: {publication.about}.", "", f"How it is run here: {publication.setting}.", "",
                  "| what | label | published | here | tolerance | unit | remark |",
                  "|---|---|---|---|---|---|---|"]
        lines += [f"| {' | '.join((*_cells(number), number.remark))} |" for number in numbers]
    return "\n".join([*lines, ""])


def write_page(reruns: Reruns, path: Path) -> None:
    """Write that page."""
    path.write_text(page(reruns), encoding="utf-8")


def _cells(number: Replication) -> tuple[str, ...]:
    within = (number.tolerance or "") if number.within is None else f"{number.within:.3g}"
    chosen = " (chosen here)" if number.tolerance is not None else ""
    return (number.what, number.label, number.printed, result_text(number), f"{within}{chosen}", number.unit)


def result_text(number: Replication) -> str:
    """The result here, with one digit more than is printed or within the tolerance; a dash where nothing was run."""
    if number.result is None:
        return "-"
    if isinstance(number.result, str):
        return number.result
    digits = 0 if not number.within or number.within >= 1.0 else min(-floor(log10(number.within)), 6)
    return f"{number.result:.{max(len(number.printed.partition('.')[2]) + 1, digits)}f}"
