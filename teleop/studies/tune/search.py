"""The search for a law's parameters: a Latin hypercube, then evolution strategies, with a stated number of rows.

1. The first points are the parameters that the law has in the scene, those that it fits to link and bodies where it
   offers that, its defaults, and those of a Latin hypercube (McKay, Beckman & Conover 1979), until the part `LATIN` of
   the rows is spent. A point that breaks a condition of the law is moved to where the law fits itself (`fitted`), as
   far as that turns knobs of the search; of two points the one that keeps the conditions is better.
2. From the best point of each playout an evolution strategy (`teleop.studies.tune.strategy`) over the parts of each
   parameter's range, by equal ratios where the range goes by those, folded at its ends. Where it has come to rest it
   begins again at the best point that is far from all that it began and ended at, until no rows are left. The loops of
   the best few of a generation are looked at as in 3, so that it turns from those that do not stand.
3. The linear loop of a result (`teleop.studies.margin`) has to be stable with as many times its gain as the margin that
   is asked for, where it can be worked out; of a law that claims to keep energy with its own gain: waves that resonate
   have no gain to spare, and need none. If it is not, the next best point is looked at that is more than `APART` of a
   range away from all that were, twice that after every quarter of `LOOKS`, the most that are.
4. Where the link draws random numbers the search runs each point with up to `SEEDS` seeds, and the best few points run
   with as many as `FRESH` that it has not seen: the one with the best mean over these is the result, if each of its
   rows keeps the constraints. In a large search four times as many are first run with a third as many, unseen too.
5. A parameter of the result that changes no bit of its rows has the law's own value again.

All rows go through the sweep engine, and none depends on what else is run, on the engine or on the number of threads:
the same arguments give the same result to the bit. Points of a search that was stopped are taken as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import repeat
from math import inf
from typing import Any, NamedTuple

from teleop.errors import Refused, number
from teleop.knob import knobs_of_fields
from teleop.law.offers import Facts, broken, claims_of
from teleop.scene.knobs import knobs_of, law_with_its_numbers
from teleop.scene.library import scene_function
from teleop.scene.loading import load_scene
from teleop.scene.parts import varies
from teleop.scene.scene import Scene
from teleop.simulation.facts import facts_of, fitted
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
from teleop.studies.tune.ranges import Ranges, at, beyond, part, ranges_of
from teleop.studies.tune.rod import Rod, rod
from teleop.studies.tune.strategy import Strategy, folded
from teleop.sweeps.engine import choose
from teleop.sweeps.grid import Grid, Range, grid, sampled
from teleop.sweeps.runner import LARGEST, carry_out, cores, plan_sweep

LATIN = 0.3  # of the points that are searched
SEEDS, POINTS = 4, 250  # of the link in a search at most, and points that it has for each
FEW, FRESH = 8, 24  # points that are run with other seeds, and how many, at most
LEAST_FRESH = 4
SIDE_BY_SIDE = 4000  # rows from which compiling for eight at once, twice as long as for one, is made up for
LOOKS, LOOKS_EACH, APART = 64, 3, 0.05  # points whose loop is looked at, of a generation too; part of a range between
STEP, LEAST = 0.15, 0.004  # of a range: the first standard deviation of a strategy and the least
FAR = 0.1  # of a range, between the beginnings of strategies
STALE = 12  # generations without a better point after which a strategy ends
SOFT = {"k_e": 0.0, "d_e": 0.0}  # knobs of a scene that leave free space of its environment

Point = tuple[Any, ...]  # a value for each name of the search
Tell = Callable[[int, str], None]  # rows done so far, and what is done


class Scored(NamedTuple):
    """A point that was run with some seeds, `first` to before `stop`, and its score."""

    point: Point
    first: int
    stop: int
    score: Score


Keep = Callable[[Sequence[Scored]], None]


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
    seeds: range  # of the link, in the search
    fresh: range  # those of `score`, which the search has not seen where the link draws random numbers
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
        link = ["--link", _typed(self.fixed["link"])] if "link" in self.fixed else []
        return ["teleop", verb, self.scene, *self._sets(), *link]

    def live(self, address: str) -> tuple[list[str], list[str]]:
        """The commands that start the best point live, master and slave, which is at this address: HOST:PORT."""
        return tuple([["python", "-m", end, self.scene, *self._sets(), option, address]  # type: ignore[return-value]
                      for end, option in (("master", "--peer"), ("slave", "--listen"))])

    def _sets(self) -> list[str]:
        return [word for name, value in self.settings.items() for word in ("--set", f"{name}={value}")]

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
    workers: int | None = None, engine: str | None = None, keep: Keep | None = None, known: Sequence[Scored] = (),
) -> Tuned:
    """Search the parameters of `law` (as `--set law=` takes it) in `scene`, in at most `budget` rows of a sweep.

    `fixed`: knobs of the scene that are set, the link among them; a knob of the law that is set is not turned.
    `margin`: by which factor the environment may be stiffer (knob k_e) with all constraints still kept; 1: none is
    asked for. `playouts`: texts that the playout may be, tried as a further parameter; left out, the scene's. `seed`:
    keys all draws of the search, and is the first seed of the link; seeds that follow those of the search are for the
    check. `tell` is told of rows done. `keep` is handed points as they are run; a search with the same arguments that
    is given them as `known`, in that order, does not run them again. Raises `Refused`.
    """
    return _Search(scene, law, budget, seed, dict(fixed or {}), objective, margin, tuple(playouts), tell, workers,
                   engine, keep, known).run()


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
                 wanted: float, playouts: tuple[str, ...], tell: Tell | None, workers: int | None, engine: str | None,
                 keep: Keep | None, known: Sequence[Scored]) -> None:
        if "law" in fixed:
            raise Refused(f"law={fixed['law']} is set beside the law that is tuned, {law}; leave one of them out")
        self.name, self.law, self.budget, self.seed, self.tell = scene, law, budget, seed, tell
        self.goal = objective_named(objective)
        self.objective = objective
        scene_knobs = knobs_of(scene_function(scene))
        if "energy" in scene_knobs and "energy" not in fixed:
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
        self._follow()
        self.spans: dict[str, Range | tuple[str, ...]] = dict(self.ranges.turned)
        self.playouts = playouts if len(playouts) > 1 else ()
        if self.playouts:
            self.spans["playout"] = self.playouts
        self.names = tuple(self.spans)
        self.soft = {knob: value for knob, value in SOFT.items() if knob in scene_knobs} if "k_e" in scene_knobs else {}
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
        self.engine = "scalar" if self.engine == "vector" and engine is None and budget < SIDE_BY_SIDE else self.engine
        self.workers = workers
        self.keep, self.known, self.rows, self.asked = keep, known, 0, 0
        self.scores: dict[Point, Score] = {}
        self.stood: dict[Point, bool] = {}  # points whose linear loop was looked at
        self.varies = (self.scene.link is not None and varies(self.scene.link)) or any(
            self.scene.leaves_out(e) is not None for e in ("m", "s"))
        draws = min(max(budget // (len(self.tasks) * POINTS), 1), SEEDS) if self.varies else 1
        self.seeds = range(seed, seed + draws)

    def _follow(self) -> None:
        """Set what follows from link and bodies and is not turned to what the law fits itself to."""
        fitting = fitted(self.scene, self.seed).law
        knobs = knobs_of_fields(type(self.scene.law))
        for name in self.ranges.stay:
            if knobs[name].knob.stays and f"law.{name}" not in self.fixed:
                self.fixed[f"law.{name}"] = getattr(fitting, name)
        self.scene = load_scene(self.name, **{**self.fixed, "law": self.law})

    def run(self) -> Tuned:
        """Search."""
        each, third = len(self.tasks), self.budget // 3
        fresh = min(max(third // (LEAST_FRESH * each), LEAST_FRESH), FRESH)
        few = min(third // (fresh * each), FEW) if self.varies else 0
        screens = 4 * few if few == FEW else 0
        checks = (few * fresh + screens * (fresh // 3)) * each
        resets = ((len(self.ranges.turned) + 1) * len(self.seeds) + (fresh if few else 1)) * each
        resets = resets if 20 * resets <= self.budget else 0
        self.left = (self.budget - checks - resets) // (each * len(self.seeds))  # points
        own, *others = dict.fromkeys(map(self._of_law, self._laws()))
        first = max(1, int(LATIN * self.left))
        self._try([own, *others, *map(self._repair, self._draw(first - 1 - len(others)))])
        self._evolve()
        ranked = sorted(self.scores, key=lambda point: self.scores[point].order)
        enough = self._with_margin([point for point in ranked if not self.scores[point].broken], screens or few or 1)
        best = enough[0] if enough else min(self.scores, key=lambda point: self.scores[point].order)
        found, seeds = self.scores[best], self.seeds
        if few and enough:
            if screens:
                seeds = range(seeds.stop, seeds.stop + fresh // 3)
                screened = self._scored(enough, seeds)
                enough = [enough[i] for i in sorted(range(len(enough)), key=lambda i: screened[i].order)]
            seeds = range(seeds.stop, seeds.stop + fresh)
            checked = dict(zip(enough[:few], self._scored(enough[:few], seeds), strict=True))
            best = min(checked, key=lambda point: checked[point].order)
            found = checked[best]
        if resets and not found.broken:
            best, found = self._reset(best, own, found, seeds)
        return Tuned(law=self.law, scene=self.name, fixed=self.fixed, objective=self.objective, names=self.names,
                     ranges=self.ranges, best=self._values(best), score=found,
                     default=self.scores[own],
                     tried=tuple([(self._values(point), each) for point, each in self.scores.items()]), rod=self.rod,
                     margin=self.margin, budget=self.budget, rows=self.rows, seed=self.seed, engine=self.engine,
                     measures=self.measures, tasks=self.tasks, rods=self.rods, seeds=self.seeds, fresh=seeds,
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

    def _draw(self, count: int) -> list[Point]:
        """So many points of the hypercube, rounded as they are typed."""
        if count < 1:
            return []
        drawn = sampled({name: Range(0.0, 1.0) if isinstance(span, Range) else span
                         for name, span in self.spans.items()}, count, key=self.seed)
        return [tuple([at(span, values[name]) if isinstance(span, Range) else values[name]
                       for name, span in self.spans.items()]) for _, values, _ in drawn.rows(range(count))]

    def _repair(self, point: Point) -> Point:
        """Move a point that breaks a condition of the law to where the law fits itself, if it does."""
        law, facts = self._law_of(point), self._facts(self._values(point).get("playout"))
        if law is None or facts is None or not hasattr(law, "fitted") or not broken(law, facts):
            return point
        fitting = law.fitted(facts)
        return tuple([beyond(float(value), float(getattr(fitting, name.removeprefix("law."))))
                      if isinstance(self.spans[name], Range) else value for name, value in self._values(point).items()])

    def _law_of(self, point: Point) -> Any:
        """The law with the numbers of a point; None where it refuses them."""
        try:
            return replace(self.scene.law, **{name.removeprefix("law."): value for name, value in zip(
                self.names, point, strict=True) if name in self.ranges.turned})
        except Refused:
            return None

    @cache  # noqa: B019 - a search lives no longer than its facts
    def _facts(self, playout: str | None) -> Facts | None:
        """The facts of link and bodies with this playout; None where the scene does not take it."""
        try:
            knobs = {} if playout is None else {"playout": playout}
            return facts_of(load_scene(self.name, **{**self.fixed, "law": self.law, **knobs}), self.seed)
        except Refused:
            return None

    def _unmet(self, point: Point) -> int:
        """Number of conditions of the law that a point breaks."""
        law, facts = self._law_of(point), self._facts(self._values(point).get("playout"))
        return 0 if law is None or facts is None else len(broken(law, facts))

    def _try(self, points: Sequence[Point]) -> int:
        """Run those points that were not run yet, as far as rows are left; how many these were."""
        new = [point for point in dict.fromkeys(points) if point not in self.scores][:max(0, self.left)]
        if self.playouts:  # those of one kernel side by side
            new.sort(key=lambda point: self.playouts.index(point[-1]))
        self.left -= len(new)
        for point, each in zip(new, self._scored(new, self.seeds) if new else (), strict=True):
            self.scores[point] = each
        return len(new)

    def _scored(self, points: Sequence[Point], seeds: range) -> list[Score]:
        """The scores of points, each over all tasks and seeds, in one sweep."""
        known = self.known[self.asked:self.asked + len(points)]
        self.asked += len(points)
        if [each[:3] for each in known] == [(point, seeds.start, seeds.stop) for point in points]:
            scores = [each.score for each in known]
            self.rows += len(points) * len(self.tasks) * len(seeds)
        else:
            scores = self._run(points, seeds)
            if self.keep is not None:
                self.keep([Scored(*each) for each in zip(
                    points, repeat(seeds.start), repeat(seeds.stop), scores, strict=False)])
        if self.tell is not None:
            self.tell(self.rows, self.law)
        return scores

    def _run(self, points: Sequence[Point], seeds: range) -> list[Score]:
        names = (*self.names, *self.soft)
        rows = [(*point, *knobs.values()) for point in points for knobs in self.tasks.values()]
        axes: Grid = grid({names: rows}, seeds)
        fixed = {**{key: value for key, value in self.fixed.items() if key not in self.soft}, "law": self.law}
        plan = plan_sweep(self.name, axes, metrics=list(self.measures), fixed=fixed, engine=self.engine)
        before, tell = self.rows, self.tell
        show = None if tell is None else lambda done, _: tell(before + done, self.law)
        table = [*carry_out(plan, workers=self.workers, show=show, chunk=self._chunk(len(axes)))]
        self.rows += len(table)
        tasks, per = [*self.tasks], len(self.tasks) * len(seeds)
        return [over_seeds(self.goal, self.rods, self.scene, [
            (tasks[i // len(seeds)], row) for i, row in enumerate(table[n * per:(n + 1) * per])])._replace(
                unmet=self._unmet(point)) for n, point in enumerate(points)]

    def _chunk(self, rows: int) -> int | None:
        """Rows of a job: what they have in common is worked out once for each. None of what is not compiled."""
        return None if self.engine == "plain" else max(1, min(-(-rows // (self.workers or cores())), LARGEST))

    def _evolve(self) -> None:
        """Strategies one after the other until no rows are left."""
        spans = [span for span in self.spans.values() if isinstance(span, Range)]
        ends: list[Point] = []
        run = idle = 0
        while self.left > 0 and idle < 4:  # a law may have fewer points than there are rows for
            ranked = sorted(self.scores, key=lambda point: self.scores[point].order)
            far = [point for point in ranked if not any(self._near(point, end, FAR) for end in ends)]
            until = 0  # points that are left where this strategy ends
            if run < len(self.playouts):  # each has its turn first, and a share of the points
                until = self.left - self.left // (len(self.playouts) - run + 1)
                far = [point for point in far or ranked if point[-1] == self.playouts[run]] or far
            start = far[0] if far else self._repair(self._draw(run + 1)[-1])
            strategy = Strategy([part(span, value) for span, value in zip(spans, start, strict=False)], STEP,
                                key=(self.seed, run))
            best, since, left = self.scores.get(start), 0, self.left
            while self.left > until and since < STALE and strategy.spread > LEAST:
                drawn = strategy.ask()
                points = [self._repair((*[at(span, u) for span, u in zip(spans, folded(x), strict=True)],
                                      *start[len(spans):])) for x in drawn]
                self._try(points)
                if any(point not in self.scores for point in points):  # the rows have run out
                    break
                self._check_loops(points)
                strategy.tell(drawn, [self.scores[point].order for point in points])
                here = min([self.scores[point] for point in points], key=lambda each: each.order)
                since = 0 if best is None or here.order < best.order else since + 1
                best = here if since == 0 else best
            ends += [start, min(self.scores, key=lambda point: self.scores[point].order)]
            idle = 0 if self.left < left else idle + 1
            run += 1

    def _with_margin(self, ranked: Sequence[Point], most: int) -> list[Point]:
        """The best of these points, `most` at most, whose loop stands the margin; all are marked if none is found."""
        stood: list[Point] = []
        looked: list[Point] = []
        for point in ranked:
            if any(self._near(point, other, APART * 2 ** (4 * len(looked) // LOOKS)) for other in looked) or any(
                    self._near(point, other, 0.2 * APART) for other in stood):
                continue
            if self._stands(point):
                stood.append(point)
                if len(stood) == most:
                    break
                continue
            looked.append(point)
            if len(looked) == LOOKS:
                break
        for point in ranked if not stood else ():  # none of them is known to stand it
            if point not in looked:
                why = "the linear loop of the points near it does not stand the margin"
                self.scores[point] = self.scores[point]._replace(broken=why, amount=0.6)
        return stood

    def _check_loops(self, points: Sequence[Point]) -> None:
        """Look at the loops of the best points of a generation, until one stands, so that strategies turn from others.
        """
        for point in sorted(points, key=lambda point: self.scores[point].order)[:LOOKS_EACH]:
            if self.scores[point].broken or self._stands(point):
                return

    def _stands(self, point: Point) -> bool:
        """True if the linear loop of a point stands the margin, or has none; the point is marked if it does not."""
        if point not in self.stood:
            verdict = stands(self._scene(point), 1.0 if claims_of(self.scene.law) else self.margin, seed=self.seed)
            self.stood[point] = verdict is None or verdict[0]
            if verdict is not None and not verdict[0]:
                self.scores[point] = self.scores[point]._replace(broken=verdict[1], amount=0.5)
        return self.stood[point]

    def _near(self, point: Point, other: Point, apart: float) -> bool:
        """True if no parameter of two points differs by more than `apart` of its range."""
        return all(abs(part(span, a) - part(span, b)) <= apart for span, a, b in zip(
            self.spans.values(), point, other, strict=True) if isinstance(span, Range))

    def _scene(self, point: Point) -> Scene:
        return load_scene(self.name, **{**self.fixed, "law": self.law, **self._values(point)})

    def _reset(self, best: Point, own: Point, found: Score, seeds: range) -> tuple[Point, Score]:
        """The point with the law's own value of each parameter that changes no figure of it; and its score."""
        turned = [i for i, name in enumerate(self.names) if name in self.ranges.turned and best[i] != own[i]]
        tries = [(*best[:i], own[i], *best[i + 1:]) for i in turned]
        (same, *scores) = self._scored([best, *tries], self.seeds)
        reset = {i for i, each in zip(turned, scores, strict=True) if each == same}
        if not reset:
            return best, found
        point = tuple([own[i] if i in reset else value for i, value in enumerate(best)])
        again, = self._scored([point], seeds)
        return (point, again) if again == found else (best, found)


def _typed(value: object) -> str:
    """A value as --set takes it."""
    if isinstance(value, float):
        return f"{value:.12g}"
    if isinstance(value, bool):
        return str(value).lower()
    return str(value)
