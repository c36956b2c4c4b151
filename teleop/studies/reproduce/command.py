"""What `teleop reproduce` does: rerun published numbers, and tell them beside what came."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Mapping, Sequence
from math import floor, log10
from typing import Any

from teleop.errors import number_of
from teleop.simulation.result import head
from teleop.storage.folder import new_folder
from teleop.storage.strict_json import write_document
from teleop.studies.reproduce import PUBLICATIONS, find_publication
from teleop.studies.reproduce.publication import (
    DIFFERS,
    FITTED,
    PUBLISHED,
    REPRODUCED,
    Finding,
    NumberSource,
    Publication,
)
from teleop.terminal.answer import Answer
from teleop.terminal.table import columns

Came = Mapping[str, tuple[Publication, Sequence[Finding]]]
WORDS = {REPRODUCED: "reproduced", DIFFERS: "different", FITTED: "fitted, which is no reproduction",
         PUBLISHED: "quoted and not run"}
PAGE = "page.md"


def command(args: Namespace) -> Answer:
    """Rerun one publication, or all; with --out leave summary.json and the page. Raises `Refused`."""
    names = PUBLICATIONS if args.name is None else (args.name,)
    publications = [find_publication(name) for name in names]  # all, before any is run
    if args.out is None:
        return _answer(_rerun(publications), args.typed)
    with new_folder(args.out, "reproduce") as new:
        came = _rerun(publications)
        answer = _answer(came, args.typed)
        write_document(new.inside / "summary.json", answer.document)
        (new.inside / PAGE).write_text(page(came), encoding="utf-8")
    return answer.kept_in(new.path)


def _rerun(publications: Sequence[Publication]) -> Came:
    return {one.name: (one, one.rerun()) for one in publications}


def _answer(came: Came, typed: Sequence[str]) -> Answer:
    document = {
        **head(status="done", sentence="; ".join(verdict(came)), scene=", ".join(came), mode="reproduce",
               parameters={}, seed=None, command=typed, dt=None),
        "publications": [{"name": one.name, "kind": one.kind.value, "source": one.source, "about": one.about,
                          "setting": one.setting, "findings": [_told(finding) for finding in of_one]}
                         for one, of_one in came.values()],
    }
    return Answer(table(came), document)


def verdict(reruns: Came) -> list[str]:
    """A sentence for each source of numbers, with how many came out as printed: the sources weigh unlike."""
    sentences = []
    for source in NumberSource:
        labels = [finding.label for one, findings in reruns.values() if one.kind is source for finding in findings]
        counts = [f"{labels.count(label)} {words}" for label, words in WORDS.items() if label in labels]
        if labels:
            sentences.append(f"{number_of(len(labels), 'number')} {source.value}: {', '.join(counts)}")
    return sentences


def _told(finding: Finding) -> dict[str, Any]:
    return {"what": finding.what, "label": finding.label, "printed": finding.printed, "published": finding.value,
            "found": finding.found, "unit": finding.unit,
            "tolerance": finding.tolerance if finding.within is None else finding.within,
            "tolerance_chosen_here": finding.tolerance is not None, "remark": finding.remark}


def table(came: Came) -> str:
    """The numbers of each publication under its source, for a terminal."""
    blocks = []
    for one, findings in came.values():
        lines = [("what", "label", "published", "here", "tolerance", "unit"), *map(_cells, findings)]
        remarks = [f"  {finding.what}: {finding.remark}" for finding in findings if finding.remark]
        blocks.append("\n".join([f"{one.name}: {one.about}", f"  {one.source}", columns(lines, left=(0, 1)), *remarks]))
    return "\n\n".join([*blocks, "\n".join(verdict(came))])


def page(came: Came) -> str:
    """All of it as one page of Markdown: sources, settings, numbers, tolerances and remarks."""
    lines = ["# Published comparisons, run again", "", *[f"- {sentence}" for sentence in verdict(came)]]
    for one, findings in came.values():
        lines += ["", f"## {one.name}", "", f"{one.source}.", "", f"What is compared: {one.about}.", "",
                  f"How it is run here: {one.setting}.", "",
                  "| what | label | published | here | tolerance | unit | remark |",
                  "|---|---|---|---|---|---|---|"]
        lines += [f"| {' | '.join((*_cells(finding), finding.remark))} |" for finding in findings]
    return "\n".join([*lines, ""])


def _cells(finding: Finding) -> tuple[str, ...]:
    within = (finding.tolerance or "") if finding.within is None else f"{finding.within:.3g}"
    chosen = " (chosen here)" if finding.tolerance is not None else ""
    return (finding.what, finding.label, finding.printed, shown(finding), f"{within}{chosen}", finding.unit)


def shown(finding: Finding) -> str:
    """What came, with one digit more than is printed or asked for; a dash where nothing was run."""
    if finding.found is None:
        return "-"
    if isinstance(finding.found, str):
        return finding.found
    asked = 0 if not finding.within or finding.within >= 1.0 else min(-floor(log10(finding.within)), 6)
    return f"{finding.found:.{max(len(finding.printed.partition('.')[2]) + 1, asked)}f}"
