"""The search for a law's parameters: a Latin hypercube, then evolution strategies, with a stated number of rows.

1. The first points are the law's parameters in the scene, as fitted to link and bodies where the law offers it, and
   its defaults. Points of a Latin hypercube (McKay, Beckman & Conover 1979) follow, until the part `LATIN` of the rows
   is spent. A point that breaks a condition of the law is moved to where the law fits itself (`fitted`), as far as
   that changes knobs of the search. Of two points the one that keeps the conditions is better.
2. An evolution strategy (`teleop.studies.tune.strategy`) goes on from the best point of each playout. It works on the
   parts of each range, by equal ratios where the range goes by those, reflected at its ends. Once at rest it begins
   again at the best point that is far from all its beginnings and ends, until no rows are left. The loops of the best
   few of a generation are tried as in 3, so that it turns from unstable ones.
3. The linear loop of a result (`teleop.studies.margin`) has to be stable with its gain times the margin, where it can
   be worked out. A law that claims to keep energy is tried with its gain alone: waves that resonate have no gain to
   spare, and need none. If the loop is not stable, the next best point is tried that is more than `APART` of a range
   away from all that were tried; that distance doubles after every quarter of `LOOKS`, the most that are tried.
4. Where the link draws random numbers the search runs each point with up to `SEEDS` seeds. The best few points then
   run with as many as `FRESH` that it has not seen. The one with the best mean over these is the result, if each of its
   rows keeps the constraints. In a large search four times as many are first run with a third as many, unseen too.
5. A parameter of the result that changes no bit of its rows has the law's own value again.

All rows go through the sweep engine, and none depends on other rows, on the engine or on the number of threads:
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
from teleop.simulation.notes import facts_of, fitted
from teleop.studies.baseline import Baseline, rigid_baseline
from teleop.studies.margin import Margin, margin, stable_with
from teleop.studies.tune.objective import (
    FREE,
    SCENE,
    STIFF,
    Score,
    find_objective,
    measures_of,
    score_by_seed,
)
from teleop.studies.tune.strategy import (
    Ranges,
    Strategy,
    fold,
    part,
    ranges_of,
    round_beyond,
    value_at,
)
from teleop.sweeps.engine import PLAINER, choose
from teleop.sweeps.grid import Grid, Range, grid, sampled
from teleop.sweeps.runner import LARGEST, carry_out, cores, plan_sweep

LATIN = 0.3  # of the points that are searched
SEEDS, POINTS = 4, 250  # of the link in a search at most, and points that it has for each
FEW, FRESH = 8, 24  # points that are run with other seeds, and how many, at most
LEAST_FRESH = 4
SIDE_BY_SIDE = 4000  # rows from which compiling for eight at once, twice as long as for one, is made up for
LOOKS, LOOKS_EACH, APART = 64, 3, 0.05  # points with their loop tried, in all and a generation; part of a range between
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
    """Result of a search."""

    law: str  # as it is typed
    scene: str
    fixed: Mapping[str, object]  # the knobs that were set, law left out
    objective: str
    names: tuple[str, ...]  # of the knobs that were searched
    ranges: Ranges
    best: Mapping[str, Any]  # knob -> value, of `names`; of an infeasible search the point that comes nearest
    score: Score  # of the best, over all seeds it was run with
    default: Score | None = None  # of the law as it is in the scene, untuned
    tried: tuple[tuple[Mapping[str, Any], Score], ...] = ()  # every point, in the order in which they were run
    baseline: Baseline
    margin: float
    budget: int
    rows: int  # that were run
    seed: int
    engine: str
    measures: tuple[str, ...]  # the metrics of each row
    linear: Margin | None = None  # of the best point; None: nothing is feasible
    seeds: range  # of the link, in the search
    fresh: range  # seeds of `score`, which the search has not seen where the link draws random numbers
    tasks: Mapping[str, Mapping[str, Any]]  # the rows of a point, with the knobs that each sets
    baselines: Mapping[str, Baseline]

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
        """Values for --set that run the best point, law and playout among them."""
        return {"law": self.law, **{name: _option_text(value) for knobs in (self.fixed, self.best)
                                    for name, value in knobs.items() if name != "link"}}

    def command(self, verb: str = "run") -> list[str]:
        """The command that runs the best point."""
        link = ["--link", _option_text(self.fixed["link"])] if "link" in self.fixed else []
        return ["teleop", verb, self.scene, *self._sets(), *link]

    def live(self, address: str) -> tuple[list[str], list[str]]:
        """The commands that start the best point live, master and slave; the slave is at this address: HOST:PORT."""
        return tuple([["python", "-m", end, self.scene, *self._sets(), option, address]  # type: ignore[return-value]
                      for end, option in (("master", "--peer"), ("slave", "--listen"))])

    def _sets(self) -> list[str]:
        return [word for name, value in self.settings.items() for word in ("--set", f"{name}={value}")]

    def front(self) -> list[tuple[Mapping[str, Any], Score]]:
        """The feasible points on the front of tracking error against drag, by the tracking error."""
        points = [each for each in self.tried if not each[1].broken]
        points.sort(key=lambda each: (each[1].terms.get("tracking", inf), each[1].terms.get("drag", inf)))
        front, least = [], inf
        for point in points:
            drag = point[1].terms.get("drag", inf)
            if drag < least:
                front.append(point)
                least = drag
        return front


class SearchJob(NamedTuple):
    """The law that is searched, in what scene, to what end, and in how many rows."""

    scene: str
    law: str  # as --set law= takes it
    budget: int  # rows of a sweep, at most
    seed: int = 0  # keys all draws of the search, and is the first seed of the link; those after are for the check
    fixed: Mapping[str, object] = {}  # knobs that are set, the link among them; one of the law is not searched
    objective: str = "balanced"
    margin: float = 1.0  # factor by which k_e may be greater with all constraints still kept; 1: none
    playouts: Sequence[str] = ()  # texts that the playout may be, a further parameter; none: the scene's
    engine: str | None = None


class LawSearch:
    """Search of one law: the knobs that are searched, the points run so far, and the rows that are left.

    `tell` is called with the rows done. `keep` is handed points as they are run; a search of the same job that is
    handed them as `known`, in that order, does not run them again. Raises `Refused`, and `NothingToTune` for a law
    without a number to change.
    """

    def __init__(self, job: SearchJob, *, tell: Tell | None = None, workers: int | None = None,
                 keep: Keep | None = None, known: Sequence[Scored] = ()) -> None:
        scene, law, budget, seed, _, objective, wanted, playouts, engine = job
        fixed = dict(job.fixed)
        if "law" in fixed:
            raise Refused(f"law={fixed['law']} is set beside the law that is tuned, {law}; leave one of them out")
        self.name, self.law, self.budget, self.seed = scene, law, budget, seed
        self.tell, self.keep, self.known, self.workers = tell, keep, known, workers
        self.goal, self.objective = find_objective(objective), objective
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
        self.baseline = rigid_baseline(self.scene)
        self.ranges = ranges_of(self.scene.law, [name for name in fixed if name.startswith("law.")])
        self._fit_followers()
        self.spans: dict[str, Range | tuple[str, ...]] = dict(self.ranges.searched)
        self.playouts = tuple(playouts) if len(playouts) > 1 else ()
        if self.playouts:
            self.spans["playout"] = self.playouts
        self.names = tuple(self.spans)
        self.soft = {knob: value for knob, value in SOFT.items() if knob in scene_knobs
                     } if "k_e" in scene_knobs and self.baseline.pressed != 0.0 else {}
        self.margin = number("margin", wanted, low=1.0)
        if wanted > 1.0 and not self.soft:
            raise Refused(f"a margin of {wanted:g} is that of the environment's stiffness, and scene {scene} has no "
                          "knob k_e that sets one it touches; leave --margin out")
        contact: dict[str, Any] = {knob: self.scene.knobs[knob] for knob in self.soft}
        self.tasks: dict[str, dict[str, Any]] = {SCENE: contact}  # with the knobs that they set
        self.baselines = {SCENE: self.baseline}
        if self.soft:
            self.tasks[FREE] = self.soft
            self.baselines[FREE] = rigid_baseline(load_scene(scene, **{**fixed, "law": law, **self.soft}))
        if wanted > 1.0:
            self.tasks[STIFF] = {knob: wanted * value for knob, value in contact.items()}
            self.baselines[STIFF] = self.baseline
        self.measures = measures_of(self.scene.law)
        if budget < len(self.tasks):
            raise Refused(f"a budget of {budget} is less than the {len(self.tasks)} rows that one point of the search "
                          f"takes ({', '.join(self.tasks)}); write for example --budget 200")
        self.engine = engine or choose(None, self.scene, max(budget, 16), self.measures)[0]
        if self.engine == "vector" and engine is None and budget < SIDE_BY_SIDE:
            self.engine = PLAINER["vector"]
        self.rows = self.requested = 0
        self.scores: dict[Point, Score] = {}
        self.stable: dict[Point, bool] = {}  # points with their linear loop tried
        self.varies = (self.scene.link is not None and varies(self.scene.link)) or any(
            self.scene.leaves_out(e) is not None for e in ("m", "s"))
        draws = min(max(budget // (len(self.tasks) * POINTS), 1), SEEDS) if self.varies else 1
        self.seeds = range(seed, seed + draws)

    def _fit_followers(self) -> None:
        """Set the knobs that follow from link and bodies, and are not searched, to the values that the law fits."""
        fitting = fitted(self.scene, self.seed).law
        knobs = knobs_of_fields(type(self.scene.law))
        for name in self.ranges.held:
            if knobs[name].knob.stays and f"law.{name}" not in self.fixed:
                self.fixed[f"law.{name}"] = getattr(fitting, name)
        self.scene = load_scene(self.name, **{**self.fixed, "law": self.law})

    def run(self) -> Tuned:
        """Search, and return the result."""
        each, third = len(self.tasks), self.budget // 3
        fresh = min(max(third // (LEAST_FRESH * each), LEAST_FRESH), FRESH)
        few = min(third // (fresh * each), FEW) if self.varies else 0
        screens = 4 * few if few == FEW else 0
        checks = (few * fresh + screens * (fresh // 3)) * each
        resets = ((len(self.ranges.searched) + 1) * len(self.seeds) + (fresh if few else 1)) * each
        resets = resets if 20 * resets <= self.budget else 0
        self.left = (self.budget - checks - resets) // (each * len(self.seeds))  # points
        untuned, *fitting = dict.fromkeys(map(self._point_of, self._laws()))
        first = max(1, int(LATIN * self.left))
        self._try([untuned, *fitting, *map(self._repair, self._draw(first - 1 - len(fitting)))])
        self._evolve()
        ranked = sorted(self.scores, key=lambda point: self.scores[point].order)
        enough = self._select_stable([point for point in ranked if not self.scores[point].broken], screens or few or 1)
        best = enough[0] if enough else min(self.scores, key=lambda point: self.scores[point].order)
        best_score, seeds = self.scores[best], self.seeds
        if few and enough:
            if screens:
                seeds = range(seeds.stop, seeds.stop + fresh // 3)
                screened = self._score_points(enough, seeds)
                enough = [enough[i] for i in sorted(range(len(enough)), key=lambda i: screened[i].order)]
            seeds = range(seeds.stop, seeds.stop + fresh)
            checked = dict(zip(enough[:few], self._score_points(enough[:few], seeds), strict=True))
            best = min(checked, key=lambda point: checked[point].order)
            best_score = checked[best]
        if resets and not best_score.broken:
            best, best_score = self._reset(best, untuned, best_score, seeds)
        return Tuned(law=self.law, scene=self.name, fixed=self.fixed, objective=self.objective, names=self.names,
                     ranges=self.ranges, best=self._values(best), score=best_score,
                     default=self.scores[untuned], baseline=self.baseline,
                     tried=tuple([(self._values(point), each) for point, each in self.scores.items()]),
                     margin=self.margin, budget=self.budget, rows=self.rows, seed=self.seed, engine=self.engine,
                     measures=self.measures, tasks=self.tasks, baselines=self.baselines, seeds=self.seeds, fresh=seeds,
                     linear=None if best_score.broken else margin(self._scene(best), seed=self.seed))

    def _laws(self) -> list[Any]:
        """The law as it is in the scene, as it fits itself to link and bodies, and with its defaults."""
        text = law_with_its_numbers(self.law, scene_function(self.name))
        by_itself = load_scene(self.name, **{**self.fixed, "law": text}).law
        return [self.scene.law, fitted(self.scene, self.seed).law, by_itself]

    def _point_of(self, law: Any) -> Point:
        """The point of a law's numbers, with the first playout if any is tried."""
        values = {name: getattr(law, name.removeprefix("law.")) for name in self.ranges.searched}
        return tuple([values[name] if name in values else span[0]  # type: ignore[index]  # a list of texts
                      for name, span in self.spans.items()])

    def _values(self, point: Point) -> dict[str, Any]:
        return dict(zip(self.names, point, strict=True))

    def _draw(self, count: int) -> list[Point]:
        """Draw so many points of the hypercube, rounded as they are typed."""
        if count < 1:
            return []
        drawn = sampled({name: Range(0.0, 1.0) if isinstance(span, Range) else span
                         for name, span in self.spans.items()}, count, key=self.seed)
        return [tuple([value_at(span, values[name]) if isinstance(span, Range) else values[name]
                       for name, span in self.spans.items()]) for _, values, _ in drawn.rows(range(count))]

    def _repair(self, point: Point) -> Point:
        """Move a point that breaks a condition of the law to where the law fits itself, if it does."""
        law, facts = self._law_of(point), self._facts(self._values(point).get("playout"))
        if law is None or facts is None or not hasattr(law, "fitted") or not broken(law, facts):
            return point
        fitting = law.fitted(facts)
        return tuple([round_beyond(float(value), float(getattr(fitting, name.removeprefix("law."))))
                      if isinstance(self.spans[name], Range) else value for name, value in self._values(point).items()])

    def _law_of(self, point: Point) -> Any:
        """The law with the numbers of a point; None where it refuses them."""
        try:
            return replace(self.scene.law, **{name.removeprefix("law."): value for name, value in zip(
                self.names, point, strict=True) if name in self.ranges.searched})
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

    def _count_unmet(self, point: Point) -> int:
        """Number of conditions of the law that a point breaks."""
        law, facts = self._law_of(point), self._facts(self._values(point).get("playout"))
        return 0 if law is None or facts is None else len(broken(law, facts))

    def _try(self, points: Sequence[Point]) -> int:
        """Run the points that were not run yet, as far as rows are left; returns their number."""
        new = [point for point in dict.fromkeys(points) if point not in self.scores][:max(0, self.left)]
        if self.playouts:  # points of one kernel side by side
            new.sort(key=lambda point: self.playouts.index(point[-1]))
        self.left -= len(new)
        for point, each in zip(new, self._score_points(new, self.seeds) if new else (), strict=True):
            self.scores[point] = each
        return len(new)

    def _score_points(self, points: Sequence[Point], seeds: range) -> list[Score]:
        """The scores of points, each over all tasks and seeds, in one sweep."""
        known = self.known[self.requested:self.requested + len(points)]
        self.requested += len(points)
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
        return [score_by_seed(self.goal, self.baselines, self.scene, [
            (tasks[i // len(seeds)], row) for i, row in enumerate(table[n * per:(n + 1) * per])])._replace(
                unmet=self._count_unmet(point)) for n, point in enumerate(points)]

    def _chunk(self, rows: int) -> int | None:
        """Rows of a job: what they have in common is worked out once for each. None without compilation."""
        return None if self.engine == "plain" else max(1, min(-(-rows // (self.workers or cores())), LARGEST))

    def _evolve(self) -> None:
        """Strategies one after the other until no rows are left."""
        spans = [span for span in self.spans.values() if isinstance(span, Range)]
        ends: list[Point] = []
        run = idle = 0
        while self.left > 0 and idle < 4:  # a law may have fewer points than there are rows for
            ranked = sorted(self.scores, key=lambda point: self.scores[point].order)
            far = [point for point in ranked if not any(self._is_near(point, end, FAR) for end in ends)]
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
                points = [self._repair((*[value_at(span, u) for span, u in zip(spans, fold(x), strict=True)],
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

    def _select_stable(self, ranked: Sequence[Point], most: int) -> list[Point]:
        """The best of these points, `most` at most, with a loop that stands the margin; all are marked if none does."""
        stable: list[Point] = []
        looked: list[Point] = []
        for point in ranked:
            if any(self._is_near(point, tried, APART * 2 ** (4 * len(looked) // LOOKS)) for tried in looked) or any(
                    self._is_near(point, sound, 0.2 * APART) for sound in stable):
                continue
            if self._is_stable(point):
                stable.append(point)
                if len(stable) == most:
                    break
                continue
            looked.append(point)
            if len(looked) == LOOKS:
                break
        for point in ranked if not stable else ():  # none of them is known to stand it
            if point not in looked:
                why = "the linear loop of the points near it does not stand the margin"
                self.scores[point] = self.scores[point]._replace(broken=why, amount=0.6)
        return stable

    def _check_loops(self, points: Sequence[Point]) -> None:
        """Try the loops of the best points of a generation, until one is stable, so that strategies turn from others.
        """
        for point in sorted(points, key=lambda point: self.scores[point].order)[:LOOKS_EACH]:
            if self.scores[point].broken or self._is_stable(point):
                return

    def _is_stable(self, point: Point) -> bool:
        """True if the linear loop of a point stands the margin, or has none; the point is marked if it does not."""
        if point not in self.stable:
            verdict = stable_with(self._scene(point), 1.0 if claims_of(self.scene.law) else self.margin, seed=self.seed)
            self.stable[point] = verdict is None or verdict[0]
            if verdict is not None and not verdict[0]:
                self.scores[point] = self.scores[point]._replace(broken=verdict[1], amount=0.5)
        return self.stable[point]

    def _is_near(self, p: Point, q: Point, apart: float) -> bool:
        """True if no parameter of two points differs by more than `apart` of its range."""
        return all(abs(part(span, a) - part(span, b)) <= apart for span, a, b in zip(
            self.spans.values(), p, q, strict=True) if isinstance(span, Range))

    def _scene(self, point: Point) -> Scene:
        return load_scene(self.name, **{**self.fixed, "law": self.law, **self._values(point)})

    def _reset(self, best: Point, untuned: Point, best_score: Score, seeds: range) -> tuple[Point, Score]:
        """The best point with the untuned value of each parameter that changes no figure of it; and its score."""
        changed = [i for i, name in enumerate(self.names) if name in self.ranges.searched and best[i] != untuned[i]]
        tries = [(*best[:i], untuned[i], *best[i + 1:]) for i in changed]
        (same, *scores) = self._score_points([best, *tries], self.seeds)
        reset = {i for i, each in zip(changed, scores, strict=True) if each == same}
        if not reset:
            return best, best_score
        point = tuple([untuned[i] if i in reset else value for i, value in enumerate(best)])
        again, = self._score_points([point], seeds)
        return (point, again) if again == best_score else (best, best_score)


def _option_text(value: object) -> str:
    """A value as --set takes it."""
    if isinstance(value, float):
        return f"{value:.12g}"
    if isinstance(value, bool):
        return str(value).lower()
    return str(value)
