"""The search for a law's parameters: a Latin hypercube, then a coordinate search, with a stated number of rows.

1. The first points are the parameters that the law has in the scene, those that it fits to link and bodies where it
   offers that, its defaults, and those of a Latin hypercube (McKay, Beckman & Conover 1979), until half of the rows
   are spent.
2. From the best point a coordinate search (compass search: Kolda, Lewis & Torczon, SIAM Review 45, 2003): all points
   one step up and down in each parameter, at once; the best of them is the next place if it is better, and one more
   step is tried along the way that led there; if none is, the step is halved. Steps are parts of each parameter's
   range, by equal ratios where the range goes by those. Below the least step it begins again at the next best point.
3. The linear loop of the best point (`teleop.studies.margin`) has to be stable with as many times its gain as the
   margin that is asked for, where it can be worked out; of a law that claims to keep energy with its own gain: waves
   that resonate have no gain to spare, and need none. If it is not, the next best point is looked at that is more than
   `APART` of a range away from all that were, twice that after every fourth, `LOOKS` at most.
4. Where the link draws random numbers, the best few points are run with other seeds, and the one with the best mean is
   the result, if each of its rows keeps the constraints.

All rows go through the sweep engine, and none depends on what else is run, on the engine or on the number of threads:
the same arguments give the same result to the bit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

from teleop.errors import Refused, number
from teleop.law.offers import claims_of
from teleop.scene.knobs import knobs_of, law_with_its_numbers
from teleop.scene.library import scene_function
from teleop.scene.loading import load_scene
from teleop.scene.parts import varies
from teleop.scene.scene import Scene
from teleop.simulation.facts import fitted
from teleop.studies.margin import Margin, margin, stands
from teleop.studies.tune.objective import (
    FREE,
    OBJECTIVES,
    SCENE,
    STIFF,
    Score,
    measures_of,
    objective_named,
    over_seeds,
    score,
)
from teleop.studies.tune.ranges import Ranges, at, part, ranges_of
from teleop.studies.tune.rod import Rod, rod
from teleop.sweeps.engine import choose
from teleop.sweeps.grid import Grid, Range, grid, sampled
from teleop.sweeps.runner import carry_out, plan_sweep

LATIN = 0.5  # of the rows that points are searched with
LOOKS, APART = 16, 0.05  # points whose loop is looked at, and the part of a range between them
STEP, LEAST = 0.15, 0.01  # of a range: the first step and the least
CHECKED, SEEDS = 4, 4  # points that are run again, and with how many other seeds
SOFT = {"k_e": 0.0, "d_e": 0.0}  # knobs of a scene that leave free space of its environment

Point = tuple[Any, ...]  # a value for each name of the search
Tell = Callable[[int, str], None]  # rows done so far, and what is done


@dataclass(frozen=True, kw_only=True)
class Tuned:
    """What a search came to."""

    law: str  # as it is typed
    scene: str
    fixed: Mapping[str, object]  # the knobs that were set, law left out
    objective: str
    names: tuple[str, ...]  # of the knobs that were turned
    ranges: Ranges
    best: Mapping[str, Any]  # knob -> value, of `names`; of an infeasible search the point that comes nearest
    score: Score  # of the best, over all seeds it was run with
    default: Score | None = None  # of the law as it is in the scene, untuned
    tried: tuple[tuple[Mapping[str, Any], Score], ...] = ()  # every point, in the order in which they were run
    rod: Rod
    margin: float
    budget: int
    rows: int  # that were run
    seed: int
    engine: str
    measures: tuple[str, ...]  # the metrics of each row
    linear: Margin | None = None  # of the best point; None: nothing is feasible
    tasks: Mapping[str, Mapping[str, Any]]  # the rows of a point, with the knobs that each sets
    rods: Mapping[str, Rod]

    @property
    def knobs(self) -> dict[str, Any]:
        """The knobs of the best point, as `load_scene` takes them: law, link and playout among them."""
        return {**self.fixed, "law": self.law, **self.best}

    @property
    def feasible(self) -> bool:
        """True if the best point keeps all constraints."""
        return not self.score.broken

    @property
    def settings(self) -> dict[str, str]:
        """What --set takes to run the best point, law and playout among it."""
        own = {name: _typed(value) for name, value in self.best.items()}
        return {"law": self.law, **{key: _typed(value) for key, value in self.fixed.items() if key != "link"}, **own}

    def command(self, verb: str = "run") -> list[str]:
        """The command that runs the best point."""
        sets = [word for name, value in self.settings.items() for word in ("--set", f"{name}={value}")]
        link = ["--link", _typed(self.fixed["link"])] if "link" in self.fixed else []
        return ["teleop", verb, self.scene, *sets, *link]

    def front(self) -> list[tuple[Mapping[str, Any], Score]]:
        """The feasible points of which no other has both less tracking error and less drag, by the tracking error."""
        points = [(values, found) for values, found in self.tried if not found.broken]
        points.sort(key=lambda one: (one[1].terms.get("tracking", inf), one[1].terms.get("drag", inf)))
        told, least = [], inf
        for values, found in points:
            drag = found.terms.get("drag", inf)
            if drag < least:
                told.append((values, found))
                least = drag
        return told


def tune_law(
    scene: str, law: str, budget: int, seed: int = 0, *, fixed: Mapping[str, object] | None = None,
    objective: str = "balanced", margin: float = 1.0, playouts: Sequence[str] = (), tell: Tell | None = None,
    workers: int | None = None, engine: str | None = None,
) -> Tuned:
    """Search the parameters of `law` (as `--set law=` takes it) in `scene`, in at most `budget` rows of a sweep.

    `fixed`: knobs of the scene that are set, the link among them; a knob of the law that is set is not turned.
    `margin`: by which factor the environment may be stiffer (knob k_e) with all constraints still kept; 1: none is
    asked for. `playouts`: texts that the playout may be, tried as a further parameter; left out, the scene's. `seed`:
    keys the hypercube, and is the first seed of the link. `tell` is told of rows done. The search is by seed; the check
    runs seed + 1, seed + 2, ... Raises `Refused`.
    """
    return _Search(scene, law, budget, seed, dict(fixed or {}), objective, margin, tuple(playouts), tell, workers,
                   engine).run()


def judged(tuned: Tuned, changes: Sequence[Mapping[str, Any]], *, tasks: Sequence[str] = (SCENE, FREE),
           workers: int | None = None) -> tuple[list[Score], int]:
    """The scores of the best point with knobs changed besides, the same ones in each; and how many rows that took.

    With the first seed of the search. Few rows, so they run by `plain`.
    """
    turned = tuple(changes[0])
    run = [task for task in tasks if task in tuned.tasks]
    of_task = tuple(name for name in tuned.tasks[SCENE] if name not in turned)
    rows = [(*change.values(), *(tuned.tasks[task][name] for name in of_task)) for change in changes for task in run]
    fixed = {key: value for key, value in tuned.knobs.items() if key not in (*turned, *of_task)}
    plan = plan_sweep(tuned.scene, grid({(*turned, *of_task): rows}, [tuned.seed]), metrics=list(tuned.measures),
                      fixed=fixed, engine="plain")
    table = [*carry_out(plan, workers=workers)]
    scene = load_scene(tuned.scene, **tuned.knobs)
    return [score(OBJECTIVES[tuned.objective], tuned.rods, scene, [*zip(run, table[i:i + len(run)], strict=True)])
            for i in range(0, len(table), len(run))], len(table)


class _Search:
    """One search: what is turned, how points become rows, and the rows that are left."""

    def __init__(self, scene: str, law: str, budget: int, seed: int, fixed: dict[str, object], objective: str,
                 wanted: float, playouts: tuple[str, ...], tell: Tell | None, workers: int | None, engine: str | None
                 ) -> None:
        if "law" in fixed:
            raise Refused(f"law={fixed['law']} is set beside the law that is tuned, {law}; leave one of them out")
        self.name, self.law, self.budget, self.seed, self.tell = scene, law, budget, seed, tell
        self.goal = objective_named(objective)
        self.objective = objective
        known = knobs_of(scene_function(scene))
        if "energy" in known and "energy" not in fixed:
            fixed["energy"] = True
        if playouts and "playout" in fixed:
            raise Refused(f"playout={fixed['playout']} is set beside the playouts to choose from, "
                          f"{', '.join(playouts)}; leave one of them out")
        for playout in playouts:  # refused here, and not by a row
            load_scene(scene, **{**fixed, "law": law, "playout": playout})
        if len(playouts) == 1:
            fixed["playout"] = playouts[0]
        self.scene: Scene = load_scene(scene, **{**fixed, "law": law})
        self.fixed = fixed
        self.rod = rod(self.scene)
        self.ranges = ranges_of(self.scene.law, [name for name in fixed if name.startswith("law.")])
        self.spans: dict[str, Range | tuple[str, ...]] = dict(self.ranges.turned)
        if len(playouts) > 1:
            self.spans["playout"] = playouts
        self.names = tuple(self.spans)
        self.soft = {knob: value for knob, value in SOFT.items() if knob in known} if "k_e" in known else {}
        if self.rod.pressed == 0.0:
            self.soft = {}
        self.margin = number("margin", wanted, low=1.0)
        if wanted > 1.0 and not self.soft:
            raise Refused(f"a margin of {wanted:g} is that of the environment's stiffness, and scene {scene} has no "
                          "knob k_e that sets one it touches; leave --margin out")
        own: dict[str, Any] = {knob: self.scene.knobs[knob] for knob in self.soft}
        self.tasks: dict[str, dict[str, Any]] = {SCENE: own}  # with the knobs that they set
        self.rods = {SCENE: self.rod}
        if self.soft:
            self.tasks[FREE] = self.soft
            self.rods[FREE] = rod(load_scene(scene, **{**fixed, "law": law, **self.soft}))
        if wanted > 1.0:
            self.tasks[STIFF] = {knob: wanted * value for knob, value in own.items()}
            self.rods[STIFF] = self.rod
        self.measures = measures_of(self.scene.law)
        if budget < len(self.tasks):
            raise Refused(f"a budget of {budget} is less than the {len(self.tasks)} rows that one point of the search "
                          f"takes ({', '.join(self.tasks)}); write for example --budget 200")
        self.engine = engine or choose(None, self.scene, max(budget, 16), self.measures)[0]
        self.engine = "scalar" if self.engine == "vector" and engine is None else self.engine
        self.workers = workers
        self.rows = 0
        self.scores: dict[Point, Score] = {}

    def run(self) -> Tuned:
        each = len(self.tasks)
        random = (self.scene.link is not None and varies(self.scene.link)) or any(
            self.scene.leaves_out(e) is not None for e in ("m", "s"))
        checks = min(CHECKED * SEEDS * each, self.budget // 3 // each * each) if random else 0
        self.left = (self.budget - checks) // each  # points
        own, *others = dict.fromkeys(map(self._of_law, self._laws()))
        self._try([own, *others, *self._drawn(max(1, int(LATIN * self.left)) - 1 - len(others))])
        self._refine()
        ranked = sorted(self.scores, key=lambda point: self.scores[point].order)
        enough = self._with_margin([point for point in ranked if not self.scores[point].broken])
        best = enough[0] if enough else min(self.scores, key=lambda point: self.scores[point].order)
        found = self.scores[best]
        if checks >= each * SEEDS and enough:
            best, found = self._checked(enough, checks)
        return Tuned(law=self.law, scene=self.name, fixed=self.fixed, objective=self.objective, names=self.names,
                     ranges=self.ranges, best=self._values(best), score=found,
                     default=self.scores[own],
                     tried=tuple([(self._values(point), each) for point, each in self.scores.items()]), rod=self.rod,
                     margin=self.margin, budget=self.budget, rows=self.rows, seed=self.seed, engine=self.engine,
                     measures=self.measures, tasks=self.tasks, rods=self.rods,
                     linear=None if found.broken else margin(self._scene(best), seed=self.seed))

    def _laws(self) -> list[Any]:
        """The law as it is in the scene, as it fits itself to link and bodies, and with its defaults."""
        text = law_with_its_numbers(self.law, scene_function(self.name))
        by_itself = load_scene(self.name, **{**self.fixed, "law": text}).law
        return [self.scene.law, fitted(self.scene, self.seed).law, by_itself]

    def _of_law(self, law: Any) -> Point:
        return self._place({name: getattr(law, name.removeprefix("law.")) for name in self.ranges.turned})

    def _values(self, point: Point) -> dict[str, Any]:
        return dict(zip(self.names, point, strict=True))

    def _place(self, values: Mapping[str, Any]) -> Point:
        """A point of these values; of a playout that is not among them the first."""
        return tuple([values[name] if name in values else span[0]  # type: ignore[index]  # a list of texts
                      for name, span in self.spans.items()])

    def _drawn(self, count: int) -> list[Point]:
        """So many points of the hypercube, rounded as they are typed."""
        if count < 1:
            return []
        drawn = sampled({name: Range(0.0, 1.0) if isinstance(span, Range) else span
                         for name, span in self.spans.items()}, count, key=self.seed)
        return [tuple([at(span, values[name]) if isinstance(span, Range) else values[name]
                       for name, span in self.spans.items()]) for _, values, _ in drawn.rows(range(count))]

    def _try(self, points: Sequence[Point]) -> list[Point]:
        """Run those points that were not run yet, as far as rows are left; those of `points` that have a score."""
        new = [point for point in dict.fromkeys(points) if point not in self.scores][:max(0, self.left)]
        self.left -= len(new)
        for point, found in zip(new, self._scored(new, [self.seed]), strict=True):
            self.scores[point] = found
        return [point for point in points if point in self.scores]

    def _scored(self, points: Sequence[Point], seeds: Sequence[int]) -> list[Score]:
        """The scores of points, each over all tasks and seeds, in one sweep."""
        if not points:
            return []
        names = (*self.names, *self.soft)
        rows = [(*point, *knobs.values()) for point in points for knobs in self.tasks.values()]
        axes: Grid = grid({names: rows}, seeds)
        fixed = {**{key: value for key, value in self.fixed.items() if key not in self.soft}, "law": self.law}
        plan = plan_sweep(self.name, axes, metrics=list(self.measures), fixed=fixed, engine=self.engine)
        before = self.rows
        tell = self.tell
        show = None if tell is None else lambda done, _: tell(before + done, self.law)
        found = [*carry_out(plan, workers=self.workers, show=show)]
        self.rows += len(found)
        tasks, per = [*self.tasks], len(self.tasks) * len(seeds)
        return [over_seeds(self.goal, self.rods, self.scene, [
            (tasks[i // len(seeds)], row) for i, row in enumerate(found[n * per:(n + 1) * per])])
            for n in range(len(points))]

    def _refine(self) -> None:
        """Coordinate searches, each from the best point that none began at, until no rows are left."""
        begun: set[Point] = set()
        while self.left > 0:
            starts = [point for point in sorted(self.scores, key=lambda p: self.scores[p].order) if point not in begun]
            if not starts:
                return
            here, step, before = starts[0], STEP, None
            while self.left > 0 and step >= LEAST:
                begun.add(here)
                tried = self._try(self._around(here, step))
                best = min(tried, key=lambda point: self.scores[point].order, default=here)
                if self.scores[best].order < self.scores[here].order:
                    before, here = here, best
                    on = self._on(before, here)
                    if self._try([on]) and self.scores[on].order < self.scores[here].order:
                        here = on
                else:
                    step /= 2.0

    def _around(self, point: Point, step: float) -> list[Point]:
        """The points one step up and down in each parameter, and with each other playout."""
        told = []
        for i, span in enumerate(self.spans.values()):
            others: list[Any] = [text for text in span if text != point[i]] if not isinstance(span, Range) else [
                at(span, min(max(part(span, point[i]) + way * step, 0.0), 1.0)) for way in (1, -1)]
            told += [(*point[:i], other, *point[i + 1:]) for other in others if other != point[i]]
        return told

    def _on(self, before: Point, here: Point) -> Point:
        """The point as far again."""
        values: list[Any] = []
        for span, old, new in zip(self.spans.values(), before, here, strict=True):
            if isinstance(span, Range) and old != new:
                values.append(at(span, min(max(2.0 * part(span, new) - part(span, old), 0.0), 1.0)))
            else:
                values.append(new)
        return tuple(values)

    def _with_margin(self, ranked: Sequence[Point]) -> list[Point]:
        """The first of these points whose loop stands the margin, and those near it; the others are marked."""
        gain = 1.0 if claims_of(self.scene.law) else self.margin
        looked: list[Point] = []
        for i, point in enumerate(ranked):
            if any(self._near(point, other, APART * 2 ** (len(looked) // 4)) for other in looked):
                continue
            told = stands(self._scene(point), gain, seed=self.seed)
            if told is None or told[0]:
                return [point, *[other for other in ranked[i + 1:] if self._near(point, other, APART) and self._stands(
                    other, gain)][:CHECKED - 1]]
            self.scores[point] = self.scores[point]._replace(broken=told[1], amount=0.5)
            looked.append(point)
            if len(looked) == LOOKS:
                break
        for point in ranked:  # none of them is known to stand it
            if point not in looked:
                why = "the linear loop of the points near it does not stand the margin"
                self.scores[point] = self.scores[point]._replace(broken=why, amount=0.6)
        return []

    def _stands(self, point: Point, gain: float) -> bool:
        told = stands(self._scene(point), gain, seed=self.seed)
        return told is None or told[0]

    def _near(self, point: Point, other: Point, apart: float) -> bool:
        """True if no parameter of two points differs by more than `apart` of its range."""
        return all(abs(part(span, a) - part(span, b)) <= apart for span, a, b in zip(
            self.spans.values(), point, other, strict=True) if isinstance(span, Range))

    def _scene(self, point: Point) -> Scene:
        return load_scene(self.name, **{**self.fixed, "law": self.law, **self._values(point)})

    def _checked(self, points: Sequence[Point], rows: int) -> tuple[Point, Score]:
        """The best of these points over seeds that the search has not seen; and its score."""
        points = points[:max(1, rows // (len(self.tasks) * SEEDS))]
        seeds = range(self.seed + 1, self.seed + 1 + SEEDS)
        found = dict(zip(points, self._scored(points, seeds), strict=True))
        best = min(points, key=lambda point: found[point].order)
        return best, found[best]


def _typed(value: object) -> str:
    """A value as --set takes it."""
    if isinstance(value, float):
        return f"{value:.12g}"
    if isinstance(value, bool):
        return str(value).lower()
    return str(value)
