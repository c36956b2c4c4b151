"""Each law at what `teleop tune` finds for it: one search of the same number of rows for each law over each link.

A search is run in one environment, that of the file's key `tune`, and what it finds is taken in all of them: a law that
met free space with other parameters than the wall would not be one law. A law without a number to turn stays as it is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from teleop.errors import Refused
from teleop.scene.knobs import law_with_its_numbers
from teleop.scene.library import scene_function
from teleop.studies.compare.file import Comparison
from teleop.studies.parallel import in_parallel

NOTHING = "has nothing to tune"  # in the refusal of a law without a number to turn


class Found(NamedTuple):
    """What a search found: the law's parameters as knobs, and a sentence where it kept no constraint."""

    knobs: Mapping[str, object]
    broken: str = ""


class Search(NamedTuple):
    """One search: the key that it is kept by, and what `teleop.studies.tune.search.tune_law` is given."""

    key: tuple[str, str]  # law and link
    scene: str
    law: str
    budget: int
    seed: int
    fixed: Mapping[str, object]


def tune_all(asked: Comparison, budget: int, *, workers: int, show: Callable[[int, int], None]
             ) -> dict[tuple[str, str], Found]:
    """What each search finds, by the names of law and link. Raises `Refused` for a budget that takes no search."""
    place = next(each for each in asked.environments if each.name == asked.tune)
    of_place = scene_function(place.text)
    jobs = [Search((law.name, link.name), place.text, law_with_its_numbers(law.text, of_place), budget, asked.seeds[0],
                   {**asked.knobs, **place.knobs, **link.knobs, **law.knobs, "link": link.text})
            for law in asked.laws for link in asked.links]
    show(0, len(jobs))
    found: dict[tuple[str, str], Found] = {}
    for key, one in in_parallel(search, jobs, workers):
        found[key] = one
        show(len(found), len(jobs))
    return found


def search(job: Search) -> tuple[tuple[str, str], Found]:
    """Run one search."""
    from teleop.studies.tune.search import tune_law

    try:
        tuned = tune_law(job.scene, job.law, job.budget, job.seed, fixed=dict(job.fixed), workers=1, engine="plain")
    except Refused as refused:
        if NOTHING not in str(refused):
            raise Refused(f"{refused} (law {job.key[0]!r}, link {job.key[1]!r})") from None
        return job.key, Found({})
    best: dict[str, Any] = dict(tuned.best)
    return job.key, Found(best, "" if tuned.feasible else tuned.score.broken)
