"""The advice: every law with two ends tuned for one link and one wall, ranked, and its margins measured.

Each law gets the same number of rows (`teleop.studies.tune`). Of the laws that keep the constraints, and whose own
conditions link and bodies keep (`teleop.law.offers`), the one with the least value of the objective is advised; those
whose value is within the spread over the seeds are said to be as good. A law that does better while a condition of it
is broken is shown beside it: what it does here it promises for no other hand.
Its margins are measured: the stiffest wall and the longest further delay, of the factors that are tried, up to which
the same gains keep all constraints. Gains are not tuned again for them, as nobody does while a robot moves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import sqrt
from typing import Any, NamedTuple

from teleop.errors import Refused
from teleop.knob import Declared, knobs_of_fields
from teleop.law import find_law, known_laws
from teleop.law.offers import claims_of, seed_energy
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene
from teleop.simulation.facts import unmet
from teleop.studies.advise.links import OneWay, one_way, playouts_for
from teleop.studies.tune.objective import SCENE, Score, objective_named
from teleop.studies.tune.rod import rod
from teleop.studies.tune.search import Tuned, judged, tune_law

MARGIN = 2.0  # by which the wall may be stiffer in the search
WALLS = (2.0, 5.0, 10.0, 20.0)  # times k_e
DELAYS = (0.25, 0.5, 1.0, 2.0)  # further delay each way, of the median
OTHERS = ("zero", "hold")  # playouts of waves that are shown beside the best
MEASURED = 3  # laws whose margins are measured
EARLY = 0.02  # of the rows: before, the time left would be that of compiling
CLOSE = 2.0  # standard deviations of the difference between two laws that are equally good

Tell = Callable[[float, str], None]  # rows done so far, and what is done


class Margins(NamedTuple):
    """The most of what was tried that the gains stand, in a row; what comes next breaks a constraint, or is none."""

    wall: float  # N/m
    delay: float  # s, further, each way
    wall_end: str  # what the next stiffer wall breaks; empty: none stiffer was tried
    delay_end: str


@dataclass(frozen=True, kw_only=True)
class LawAdvice:
    """What was found for one law."""

    law: str
    tuned: Tuned | None
    refused: str = ""  # why it was not tuned
    knobs: Mapping[str, Declared]  # of the law
    claims: Mapping[str, str]
    seed_energy: float = 0.0
    broken: tuple[str, ...] = ()  # conditions of the law that link and bodies break, with the best gains
    margins: Margins | None = None

    @property
    def value(self) -> float:
        """Of the objective; inf of a law that keeps the constraints nowhere."""
        return self.tuned.score.value if self.tuned is not None and self.tuned.feasible else float("inf")

    @property
    def deviation(self) -> float:
        """Standard error of the value over the seeds; 0.0 where the link draws nothing."""
        values = () if self.tuned is None else self.tuned.score.values
        if len(values) < 2:
            return 0.0
        mean = sum(values) / len(values)
        return sqrt(sum([(each - mean) ** 2 for each in values]) / (len(values) - 1) / len(values))

    def keeps_energy(self) -> bool:
        """True if it claims a ledger, and no condition of it is broken."""
        return bool(self.claims) and not self.broken


@dataclass(frozen=True, kw_only=True)
class Advice:
    """All of it."""

    scene: Scene
    fixed: Mapping[str, object]
    ways: tuple[OneWay, OneWay]
    objective: str
    laws: tuple[LawAdvice, ...]  # the best first
    budget: int  # rows of each law
    rows: int  # that were run
    playouts: tuple[tuple[str, Score, tuple[str, ...]], ...] = ()  # others, with the best gains, and what they break

    @property
    def best(self) -> LawAdvice | None:
        """The law that is advised; None if no law keeps the constraints."""
        able = [one for one in self.laws if one.value < float("inf")]
        return next((one for one in able if not one.broken), able[0] if able else None)

    @property
    def bolder(self) -> LawAdvice | None:
        """The law that does better, while a condition of it is broken."""
        best = self.best
        return None if best is None or best is self.laws[0] else self.laws[0]

    def alike(self) -> list[LawAdvice]:
        """The laws whose value cannot be told from the best one's by the seeds that were run."""
        best = self.best
        if best is None:
            return []
        return [other for other in self.laws if other is not best and not other.broken and other.value - best.value
                <= CLOSE * sqrt(best.deviation**2 + other.deviation**2)]


def two_port_laws() -> list[str]:
    """The names of all laws with two ends, built in and of installed packages."""
    return [name for name in sorted(known_laws()) if hasattr(find_law(name), "slave")]


def advise(scene: str, budget: int, *, fixed: Mapping[str, object], laws: Sequence[str] | None = None,
           objective: str = "balanced", seed: int = 0, tell: Tell | None = None, workers: int | None = None,
           engine: str | None = None) -> Advice:
    """Tune each law in `budget` rows, and measure the margins of the best. Raises `Refused`.

    `scene` with the knobs `fixed`, the link among them. `laws`: which; left out, all that have two ends.
    """
    objective_named(objective)
    names = two_port_laws() if laws is None else [*laws]
    first = load_scene(scene, **fixed)
    rod(first)  # a scene in which no law can be tuned is refused at once, and not law by law
    ways = one_way(first, 0, seed), one_way(first, 1, seed)
    found: list[LawAdvice] = []
    rows = 0
    for number, law in enumerate(names):
        def show(done: int, text: str, before: int = number * budget) -> None:
            if tell is not None and (done == 0 or before + done >= EARLY * budget * len(names)):
                tell(before + done, text)
        show(0, law)
        each = _of_law(scene, law, budget, fixed, ways, objective, seed, show, workers, engine)
        rows += 0 if each.tuned is None else each.tuned.rows
        found.append(each)
    found.sort(key=lambda one: one.tuned.score.order if one.tuned is not None else (float("inf"), 0.0, 0.0))
    able = [one for one in found if one.value < float("inf")]
    top = [one for one in able if not one.broken] or able
    for one in [*top[:MEASURED], *[each for each in able[:1] if each not in top[:MEASURED]]]:
        margins, more = _margins(one, first, ways, workers)
        rows += more
        found[found.index(one)] = replace(one, margins=margins)
    others, more = _other_playouts(top[0], workers) if top and "playout" not in fixed else ((), 0)
    return Advice(scene=first, fixed=fixed, ways=ways, objective=objective, laws=tuple(found), budget=budget,
                  rows=rows + more, playouts=others)


def _of_law(scene: str, law: str, budget: int, fixed: Mapping[str, object], ways: tuple[OneWay, OneWay],
            objective: str, seed: int, tell: Callable[[int, str], None], workers: int | None, engine: str | None
            ) -> LawAdvice:
    """One law tuned, with the conditions that its best gains break."""
    try:
        own = load_scene(scene, **{**fixed, "law": law})
        playouts = () if "playout" in fixed else playouts_for(own, ways)
        margin = MARGIN if "k_e" in own.knobs else 1.0
        tuned = tune_law(scene, law, budget, seed, fixed=fixed, objective=objective, margin=margin, playouts=playouts,
                         tell=tell, workers=workers, engine=engine)
        best = load_scene(scene, **tuned.knobs)
        told = tuple(unmet(best, seed))
    except Refused as refused:
        return LawAdvice(law=law, tuned=None, refused=str(refused), knobs={}, claims={})
    return LawAdvice(law=law, tuned=tuned, knobs=knobs_of_fields(type(best.law)), claims=claims_of(best.law),
                     seed_energy=seed_energy(best.law, best.dt), broken=told)


def _margins(one: LawAdvice, scene: Scene, ways: tuple[OneWay, OneWay], workers: int | None) -> tuple[Margins, int]:
    """Stiffer walls and longer delays with the best gains, each once; and how many rows that took."""
    tuned = one.tuned
    assert tuned is not None
    rows = 0
    told = {"wall": (0.0, ""), "delay": (0.0, "")}
    k_e, link, lag = scene.knobs.get("k_e"), tuned.fixed.get("link"), max(way.median for way in ways)
    tries: dict[str, list[tuple[float, dict[str, Any]]]] = {}
    if isinstance(k_e, float):
        told["wall"] = (k_e, "")
        own = tuned.tasks[SCENE]  # k_e, and d_e where the scene has one
        tries["wall"] = [(factor * k_e, {knob: factor * value for knob, value in own.items()}) for factor in WALLS]
    if isinstance(link, str):
        tries["delay"] = [(share * lag, {"link": _later(link, share * lag)}) for share in DELAYS]
    for what, points in tries.items():
        scores, ran = judged(tuned, [knobs for _, knobs in points], tasks=[SCENE], workers=workers)
        rows += ran
        for (amount, _), found in zip(points, scores, strict=True):
            if found.broken:
                told[what] = (told[what][0], found.broken)
                break
            told[what] = (amount, "")
    return Margins(told["wall"][0], told["delay"][0], told["wall"][1], told["delay"][1]), rows


def _other_playouts(one: LawAdvice, workers: int | None
                    ) -> tuple[tuple[tuple[str, Score, tuple[str, ...]], ...], int]:
    """What becomes of the best gains of a law of waves where gaps are filled otherwise; and how many rows that took."""
    tuned = one.tuned
    assert tuned is not None
    if not load_scene(tuned.scene, **tuned.knobs).has_waves or "playout" not in tuned.names:
        return (), 0
    scores, rows = judged(tuned, [{"playout": playout} for playout in OTHERS], workers=workers)
    told = []
    for playout, found in zip(OTHERS, scores, strict=True):
        scene = load_scene(tuned.scene, **{**tuned.knobs, "playout": playout})
        told.append((playout, found, tuple(unmet(scene, tuned.seed))))
    return tuple(told), rows


def _later(link: str, more: float) -> str:
    """The text of a link with a further constant delay in both directions."""
    return " ; ".join(f"{way.strip()} | delay({more:.9g})" for way in link.split(";"))

