"""The command `teleop sweep`: run a grid of rows, show its progress, and leave a folder that can go on."""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any, NamedTuple, TextIO

from teleop.errors import Refused, number_of, plural
from teleop.scene.scene import Scene
from teleop.simulation.notes import untuned
from teleop.simulation.result import head, law_with_gains, parameters
from teleop.sweeps.grid import grid, parse_axes, parse_ranges, sampled
from teleop.sweeps.pictures import report
from teleop.sweeps.pictures.picture import check
from teleop.sweeps.runner import Sweep, plan_sweep
from teleop.sweeps.runner import carry_out as run_rows
from teleop.sweeps.store import Store
from teleop.sweeps.table import Table
from teleop.terminal.answer import Answer
from teleop.terminal.options import DONE, INTERRUPTED, complain, knobs_from
from teleop.terminal.plotting import asked_formats
from teleop.terminal.progress import RowsProgress
from teleop.terminal.table import facts, grouped

MANY = 1_000_000_000  # rows: more are a slip of the keyboard unless somebody says --yes


class SweepOutcome(NamedTuple):
    """A sweep as far as it came."""

    plan: Sweep
    table: Table
    folder: Path
    interrupted: bool
    seconds: float
    ran: int  # rows that were run now
    limits: Mapping[str, float]  # what rows run for and may not pass, where that is the same for all
    cluster: tuple[str, int] | None = None  # its scheduler, and how many workers sent rows; none: this machine

    def summary(self, command: Sequence[str]) -> dict[str, Any]:
        """The sweep as JSON can hold it, without its rows: the content of summary.json."""
        plan = self.plan
        seeds, knobs = plan.grid.seeds, plan.grid.knobs
        return {
            **head(status="interrupted" if self.interrupted else "done", scene=plan.scene, mode="sweep",
                   sentence=report.sentence_of(self.table, len(plan.grid)), parameters=in_common(plan.first, knobs),
                   seed=seeds[0] if len(seeds) == 1 else None, command=command,
                   dt=None if "dt" in knobs else plan.first.dt_ns / 1e9),
            **plan.definition(), "rows": len(plan.grid), "done": len(self.table), "ran": self.ran,
            "counts": self.table.counts(), "engine": plan.engine, "why": plan.why, "workers": plan.workers,
            "engines": [{"engine": engine, "rows": rows, "why": why} for (engine, why), rows in plan.ran.items()],
            "seconds": self.seconds, "interrupted": self.interrupted, "path": str(self.folder),
            "limits": dict(self.limits),
            "cluster": self.cluster and {"address": self.cluster[0], "workers": self.cluster[1]},
        }

    def write(self, command: Sequence[str]) -> dict[str, Any]:
        """Write summary.json, which says how far the sweep has come and how, into its folder; what it holds now."""
        document = report.joined(self.summary(command), report.summary_of(self.folder))
        report.write(document, self.folder)
        return document

    def text(self) -> str:
        """The sweep in a few lines."""
        rate = f", {self.ran / self.seconds:.3g} rows a second" if self.seconds > 0.0 and self.ran else ""
        threads = f", in {number_of(self.plan.workers, 'thread')}" if self.ran else ""
        count = len(self.plan.grid)
        turned = ", ".join(self.plan.grid.knobs) or "seeds"
        rows = [("sweep", f"{self.plan.scene}, {grouped(count)} {plural(count, 'row')} of {turned}"),
                *[("law", law) for law in self._laws()], *report.status_rows(self.table)]
        nothing_left = not self.ran and len(self.table) == len(self.plan.grid)
        rows.append(("engine", "none, for no row was left to run: summary.json says which ran them" if nothing_left else
                     f"{self.plan.engine}: {self.plan.why}{threads}{rate}"))
        rows += [("", f"{number_of(ran, 'row')} by {engine}: {why}")
                 for (engine, why), ran in self.plan.ran.items() if why]
        if self.cluster is not None:
            rows.append(("cluster", f"{self.cluster[0]}, rows by {self.cluster[1]} of its workers"))
        rows += [("note", note) for scene in (self.plan.first, *self.plan.others) for note in untuned(scene)]
        return f"{facts(rows)}\n{self.table.text(all_by=report.report_of(self.folder, len(self.table)))}"

    def _laws(self) -> list[str]:
        """Each law of the rows with its gains; those that the sweep turns have their values in the table."""
        turned = self.plan.grid.knobs
        return [law_with_gains(in_common(scene, {*turned} - {"law"})["law"])
                for scene in (self.plan.first, *self.plan.others)]


def command(args: Namespace) -> Answer:
    """Carry out `teleop sweep`: run the rows, write summary.json and draw what is asked for. Raises `Refused`."""
    picture = report.PictureRequest(args.picture, args.metric)
    formats = asked_formats(args, wanted=any(picture))
    plan = _plan(args)
    if formats:
        _check_picture(plan, picture)
    folder = Path(args.out) if args.out is not None else Path("runs") / f"{Path(args.scene).stem}-sweep"
    swept = carry_out(plan, folder, cluster=args.cluster, workers=args.workers, clock=args.seconds,
                      stream=None if args.json else sys.stderr)
    summary = swept.write(args.typed)
    answer = Answer(swept.text(), {**swept.summary(args.typed), "runs": summary["runs"]}).kept_in(swept.folder)
    if swept.interrupted:
        answer = answer._replace(text=f"{answer.text}\ninterrupted: the same command goes on from here")
    if formats:
        answer = report.with_picture(answer, swept.table, swept.folder, summary, picture, formats)
    return answer._replace(code=INTERRUPTED if swept.interrupted else DONE)


def _plan(args: Namespace) -> Sweep:
    """Plan the sweep that was typed, with its points from `--latin` or `--random`, or from a grid. Raises `Refused`."""
    text, count = args.metrics, args.latin or args.random
    metrics = None if text is None else [one.strip() for one in text.split(",") if one.strip()]
    if metrics == []:
        raise Refused(f"--metrics {text} names none; write for example --metrics x_err_rms,f_m_max, or leave it out")
    if args.latin is not None and args.random is not None:
        raise Refused("--latin and --random are two ways to draw points; leave one of them out")
    points = grid(parse_axes(args.grid), args.seeds) if count is None else sampled(
        parse_ranges(args.grid), count, latin=args.latin is not None, seeds=args.seeds)
    plan = plan_sweep(args.scene, points, metrics=metrics, fixed=knobs_from(args), engine=args.engine)
    if len(points) > MANY and not args.yes:
        raise Refused(f"this is {grouped(len(points))} rows; write fewer values, or --yes if you mean it")
    return plan


def carry_out(plan: Sweep, folder: Path, *, cluster: str | None, workers: int | None, clock: Callable[[], float],
              stream: TextIO | None) -> SweepOutcome:
    """Run what is not done yet of a sweep, into `folder`, with its progress on `stream`. Raises `Refused`.

    `cluster`: the address of a dask scheduler whose workers run the rows. `workers`: threads; None: one for each core.
    `clock` (s) times it.
    """
    from teleop.sweeps.cluster import connected

    line = None if stream is None else RowsProgress(stream)

    def show(done: int, of: int) -> None:
        if line is not None:
            line.show(done, of, clock())

    def tell(sentence: str) -> None:
        if line is not None and stream is not None:
            line.end()
            complain(sentence, DONE)

    interrupted = False
    with nullcontext() if cluster is None else connected(cluster, tell) as pool:
        began = clock()
        before = len(Store.look(folder).done) if (folder / "sweep.json").is_file() else 0
        try:
            table = run_rows(plan, executor=pool, workers=workers, out=folder, show=show)
        except KeyboardInterrupt:
            if not (folder / "sweep.json").is_file():
                raise  # nothing was begun
            interrupted = True
            table = Store.look(folder).table()
        finally:
            if line is not None:
                line.end()
        seconds = clock() - began
    where = None if pool is None else (pool.address, len(pool.workers))
    limits = report.limits_of(plan.first, plan.grid.knobs)
    return SweepOutcome(plan, table, folder, interrupted, seconds, len(table) - before, limits, where)


def in_common(first: Scene, turned: Collection[str]) -> dict[str, object]:
    """The parameters that all rows of a sweep have: those of the first row without the knobs that are `turned`."""
    shared = {name: value for name, value in parameters(first).items() if name not in turned}
    law = shared.get("law")
    if isinstance(law, dict):
        shared["law"] = {name: value for name, value in law.items() if f"law.{name}" not in turned}
    return shared


def _check_picture(plan: Sweep, request: report.PictureRequest) -> None:
    """Refuse the picture of a sweep whose grid cannot give one, before anything is run."""
    several = {name: [point[i] for point in points] for names, points in plan.grid.axes for i, name in enumerate(names)
               if any(point[i] != points[0][i] for point in points)}
    numeric = [name for name, values in several.items()
               if all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)]
    metrics = [one if isinstance(one, str) else one.__name__ for one in plan.measures]
    check([*several], numeric, request.kind, request.metric, metrics)
