"""The rows of a comparison, worked out and checked before any is run: knobs, seed, fitted parameters, the command.

A case is a law over a link in an environment; it has a row for each seed, and a single one where the link has no dice:
there every seed gives the same run.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from shlex import quote
from typing import Any

from teleop.errors import Refused
from teleop.law import is_built_in
from teleop.scene.knobs import law_with_its_numbers
from teleop.scene.library import ROOT, own_file, scene_function
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene
from teleop.simulation.facts import facts, law_notes, of_plans
from teleop.simulation.plan import LinkPlans, link_plans
from teleop.studies.compare.file import Comparison, Part

Tuned = Mapping[tuple[str, str], Mapping[str, object]]  # by the names of law and link, the law's parameters as knobs


@dataclass(frozen=True, kw_only=True, slots=True)
class Case:
    """A law over a link in an environment, ready to be run by its texts alone."""

    law: str
    link: str
    environment: str
    scene: str  # its name or FILE.py
    knobs: Mapping[str, object]  # as `load_scene` takes them
    seeds: tuple[int, ...]
    conditions: tuple[str, ...]  # of the law, those that this link and these bodies break, one sentence each
    units: tuple[str, ...]  # of its axes, m or rad
    source: str  # a digest of the law's file, of one that is not built in; else empty

    def command(self, seed: int) -> str:
        """What to type to run one of its rows by itself."""
        words = ["teleop", "run", self.scene]
        for name, value in self.knobs.items():
            words += ["--link", str(value)] if name == "link" else ["--set", f"{name}={_typed(value)}"]
        return " ".join(map(quote, [*words, "--seed", str(seed)]))


def cases_of(asked: Comparison, where: str, tuned: Tuned | None = None) -> list[Case]:
    """Every case of a comparison, in the order law, environment, link.

    `tuned`: parameters that were found; None: each law has those of the file, fitted. `where` names the file in
    sentences. Raises `Refused`, naming the tables, for a case that
    makes no scene.
    """
    drawn: dict[tuple[str, str], tuple[LinkPlans, bool]] = {}
    return [_case(asked, where, law, environment, link, drawn, tuned)
            for law in asked.laws for environment in asked.environments for link in asked.links]


def _case(asked: Comparison, where: str, law: Part, environment: Part, link: Part,
          drawn: dict[tuple[str, str], tuple[LinkPlans, bool]], tuned: Tuned | None) -> Case:
    knobs = {**asked.knobs, **environment.knobs, **link.knobs, "law": law.text, **law.knobs, "link": link.text}
    try:  # one law has the same numbers in all environments, also in that whose own law it is
        knobs["law"] = law_with_its_numbers(law.text, scene_function(environment.text))
        scene = load_scene(environment.text, **knobs)
    except Refused as refused:
        raise Refused(f"{where}: {refused} (law {law.name!r}, link {link.name!r}, environment "
                      f"{environment.name!r})") from None
    if scene.slave is None:
        raise Refused(f"{where}: environment {environment.name!r} has no slave, so no law with two ends; take another "
                      "scene, for example scene = \"hard_wall\"")
    key = environment.name, link.name
    plans, dice = drawn.get(key) or drawn.setdefault(key, _drawn(scene, asked.seeds))
    played = of_plans(scene, plans, scene.ticks)
    if tuned is not None:
        knobs |= tuned[law.name, link.name]
        scene = load_scene(environment.text, **knobs)
    elif asked.fitted and hasattr(scene.laws[0], "fitted"):
        laws = tuple([each.fitted(facts(scene, i, *played)) for i, each in enumerate(scene.laws)])
        knobs |= _changed(scene.laws, laws)
        scene = replace(scene, law=laws if isinstance(scene.law, tuple) else laws[0])
    found: Any = scene.laws[0]
    own = None if is_built_in(found) else own_file(type(found))
    return Case(law=law.name, link=link.name, environment=environment.name, scene=environment.text, knobs=knobs,
                seeds=asked.seeds if dice else asked.seeds[:1], conditions=tuple(law_notes(scene, *played)),
                units=scene.axis_units, source="" if own is None else own.digest)


def _drawn(scene: Scene, seeds: tuple[int, ...]) -> tuple[LinkPlans, bool]:
    """What the first seed's link plays, and whether another seed plays anything else."""
    plans = link_plans(scene, seeds[0])
    return plans, any(_played(link_plans(scene, seed)) != _played(plans) for seed in seeds[1:])


def _played(plans: LinkPlans) -> list[bytes]:
    return [b"" if plan is None else plan.played_at.tobytes() for plan in plans]


def _changed(laws: tuple[Any, ...], fitted: tuple[Any, ...]) -> dict[str, object]:
    """The parameters in which fitted laws of the axes differ, as knobs: a number, or where axes differ one for each."""
    if not is_dataclass(laws[0]):
        return {}
    found: dict[str, object] = {}
    for name in [field.name for field in fields(laws[0]) if field.init]:
        was, now = [[float(getattr(law, name)) for law in each] for each in (laws, fitted)]
        if was != now:
            found[f"law.{name}"] = now[0] if len(set(now)) == 1 else tuple(now)
    return found


def _typed(value: object) -> str:
    """A knob's value as --set reads it back to the same bits."""
    if isinstance(value, tuple):
        return ",".join(map(_typed, value))
    return "none" if value is None else str(value).lower() if isinstance(value, bool) else str(value)


def shown_path(path: Path | str) -> str:
    """A path as it is told: that of a file of this package by its name."""
    return Path(path).name if ROOT in Path(path).resolve().parents else str(path)
