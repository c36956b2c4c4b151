"""Some rows of a sweep, run in one thread: what an executor is given.

A row's result depends on its own knobs and seed alone, whatever stands beside it. What rows have in common, the kernel
of their structure, their schedules and the path of their hand, is made once (`teleop.sweeps.rows`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from numbers import Real
from threading import Lock
from time import perf_counter
from traceback import format_exception, walk_tb
from typing import Any, NamedTuple

from teleop.errors import Refused
from teleop.law.contract import file_line
from teleop.scene.library import OwnFile
from teleop.scene.scene import Scene
from teleop.simulation.metrics import of_plan
from teleop.simulation.result import Result
from teleop.simulation.virtual import run
from teleop.sweeps.engine import OF_PLAN, WHOLE, Measure
from teleop.sweeps.kernels.kernel import TICKS, Kernel, NotCompiled, RowInputs, Schedules, figures, has_packets
from teleop.sweeps.rows import Edited, Ready, RowGroup, RowMaker

LONGEST = 80  # characters of a value that a sentence shows


class MetricMistake(Refused):
    """A metric that raised, which is the cause, or that returned no number. It ends its sweep."""


class SentMistake:
    """A mistake that may go to another process, where its cause is a `Raised` with the traceback as text.

    It is no exception itself: dask has those pickled with their causes, which may be of a class that cannot be made
    again.
    """

    def __init__(self, error: MetricMistake) -> None:
        self.error = error

    def __reduce__(self) -> tuple[Any, ...]:
        """Parts from which another process makes it again."""
        cause = self.error.__cause__
        return _again, (str(self.error), None if cause is None else "".join(format_exception(cause)))


class Raised(Exception):
    """Exception of a metric in another process; the text is its traceback there."""


def evaluate_metric(metric: Callable[[Result], float], result: Result, row: Mapping[str, Any]) -> float:
    """The metric's value for the run of `row` (`row`, `seed` and the knobs). Raises `MetricMistake`."""
    try:
        value: Any = metric(result)
    except (Exception, SystemExit) as error:
        message = " ".join(_text(str, error).split())
        raise MetricMistake(_sentence(metric, _innermost(metric, error), row,
                                      f"raised {type(error).__name__}{': ' * bool(message)}{message}")) from error
    if getattr(value, "shape", None) == () and hasattr(value, "item"):  # of numpy
        value = value.item()
    if not isinstance(value, Real):
        what = f"returned {_value_text(value)}, which is no number (write a float, nan where there is none)"
        raise MetricMistake(_sentence(metric, _first_line(metric), row, what))
    return float(value)


def _sentence(metric: Callable[..., Any], place: str, row: Mapping[str, Any], what: str) -> str:
    knobs = {**{name: value for name, value in row.items() if name not in ("row", "seed")}, "seed": row["seed"]}
    at = ", ".join(f"{name}={_value_text(value)}" for name, value in knobs.items())
    name = metric.__name__
    return (f"metric {name}{place} {what}, in row {row['row']} ({at}); mend it and sweep again: with out=FOLDER the "
            f"rows before it are kept there, and mended=[{name!r}] goes on behind them")


def _innermost(metric: Callable[..., Any], error: BaseException) -> str:
    """The innermost line in the metric's own file, where that is known, " (path:line)"."""
    file = getattr(getattr(metric, "__code__", None), "co_filename", None)
    lines = [line for frame, line in walk_tb(error.__traceback__) if frame.f_code.co_filename == file]
    return file_line(file, lines[-1]) if file is not None and lines else ""


def _first_line(metric: Callable[..., Any]) -> str:
    code = getattr(metric, "__code__", None)
    return "" if code is None else file_line(code.co_filename, code.co_firstlineno)


def _value_text(value: object) -> str:
    text = value if isinstance(value, str) and value.isidentifier() else " ".join(_text(repr, value).split())
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."


def _text(of: Callable[[Any], str], value: object) -> str:
    try:
        return of(value)
    except Exception:  # of a class of the user's own, whose text may be what is broken
        return f"a {type(value).__name__}"


def _again(text: str, traceback: str | None) -> SentMistake:
    mistake = MetricMistake(text)
    if traceback is not None:
        mistake.__cause__ = Raised(f"\n{traceback}")
    return SentMistake(mistake)


Row = dict[str, Any]
_PREPARING = Lock()


class Job(NamedTuple):
    """A scene, the knobs that all rows share, and the rows: number, knobs and seed of each."""

    scene: str
    fixed: dict[str, object]
    rows: Sequence[tuple[int, dict[str, object], int]]
    measures: tuple[Measure, ...]
    engine: str
    files: tuple[OwnFile, ...] = ()  # of the user's own, as they were when the sweep began


class ChunkResult(NamedTuple):
    """Result of a job: its rows, the number of rows that each engine ran, and the time taken."""

    rows: list[Row]  # with a mistake those until then
    ran: Counter[tuple[str, str]]  # by engine, and why it was not the one that was asked for
    seconds: float
    mistake: SentMistake | None = None  # of a metric of the user's own, which ends the sweep


class Stopped(Exception):
    """A job was given up, and its rows with it."""


def work(job: Job, stopped: Callable[[], bool] | None = None) -> ChunkResult:
    """Run every row of a job. Raises `Stopped` soon after `stopped` says so."""
    began = perf_counter()
    rows: dict[int, Row] = {number: {"row": number, "seed": seed, **knobs} for number, knobs, seed in job.rows}
    ran: Counter[tuple[str, str]] = Counter()
    with _PREPARING:  # under the GIL, one thread at a time; meanwhile the others run the kernels of what they prepared
        groups, mistake = _prepared(job, rows, ran, stopped)
    for group in groups:
        for batch in _batches(group):
            if stopped is not None and stopped():
                raise Stopped
            try:
                kernel = _run(group, batch, job.measures)
                ran[kernel.engine, kernel.why] += len(batch)
            except NotCompiled as why:
                again = frozenset(ready.row["row"] for ready in batch)
                plainly = [one for one in job.rows if one[0] in again]
                rows |= {row["row"]: row for row in work(job._replace(rows=plainly, engine="plain"), stopped).rows}
                ran["plain", str(why)] += len(batch)
    done = list(rows.values()) if mistake is None else [row for row in rows.values() if "status" in row]
    return ChunkResult(done, ran, perf_counter() - began, mistake)


def _prepared(job: Job, rows: dict[int, Row], ran: Counter[tuple[str, str]], stopped: Callable[[], bool] | None
              ) -> tuple[list[RowGroup], SentMistake | None]:
    """The rows of a job, those of one kernel together; what is refused or needs a record has its result already.

    With them the mistake of a metric of the user's own, after which no row is made ready.
    """
    maker = RowMaker(job.scene, job.fixed, job.measures, job.engine, job.files)
    for number, knobs, seed in job.rows:
        row = rows[number]
        if stopped is not None and stopped():
            raise Stopped
        try:
            scene = maker.add(row, knobs, seed)
            if scene is not None:
                _tell(row, *_recorded(scene, seed, job.measures, row))
                ran["plain", WHOLE if job.engine != "plain" else ""] += 1
        except MetricMistake as mistake:
            return maker.groups, SentMistake(mistake)
        except Edited:
            raise
        except Refused as refused:  # bodies and paths have refusals of their own
            _refuse(row, refused)
    return maker.groups, None


def _tell(row: Row, status: str, ticks: int, figures_of_row: dict[str, float]) -> None:
    row.update(status=status, ticks=ticks, **figures_of_row)


def _refuse(row: Row, refused: Refused) -> None:
    row.update(status="refused", ticks=0, sentence=str(refused))


def _batches(group: RowGroup) -> Iterator[Sequence[Ready]]:
    """Rows to be handed to their kernel at one call, those with the same schedules together.

    Where a kernel runs rows side by side, those that fill its lanes go first. No more rows at a call than have
    schedules of `TICKS` ticks in all.
    """
    width = group.kernel.width
    if group.kernel.engine == "plain":  # row by row, to be stopped in between
        yield from ([ready] for ready in group.rows)
        return
    alike: dict[int, list[Ready]] = {}
    for ready in group.rows:
        alike.setdefault(id(ready.schedules), []).append(ready)
    left: list[Ready] = []
    batch: list[Ready] = []
    drawn, most = 0, max(width, TICKS // group.ticks)
    for several in alike.values():
        whole = len(several) - len(several) % width
        left += several[whole:]
        batch += several[:whole]
        drawn += 1
        if drawn >= most:
            yield batch
            batch, drawn = [], 0
    if batch:
        yield batch
    yield from (left[first:first + most] for first in range(0, len(left), most))


def _run(group: RowGroup, batch: Sequence[Ready], measures: Sequence[Measure]) -> Kernel:
    """Run rows of a group at once and write its outcome into each. Returns the kernel that ran them."""
    kernel = group.kernel
    rows, inputs = [], []
    for ready in batch:
        try:
            schedule = ready.schedules.schedule()
        except Refused as refused:  # a link may have refusals of its own
            _refuse(ready.row, refused)
            continue
        rows.append(ready)
        inputs.append(RowInputs(ready.tree, ready.flat, group.ticks, schedule, ready.path, ready.still, ready.frame))
    if not rows:
        return kernel
    try:
        results = _figures(kernel, inputs)
    except NotCompiled as why:
        kernel = kernel if kernel.fallback is None else kernel.fallback(str(why))
        if kernel.engine in ("plain", group.kernel.engine):
            raise
        results = _figures(kernel, inputs)
    except Refused as refused:  # the law's doing; plain Python runs one row at a time
        _refuse(rows[0].row, refused)
        return kernel
    of_plan_too = [name for name in measures if name in OF_PLAN]
    for ready, (status, ran, values) in zip(rows, results, strict=True):
        if of_plan_too:
            drawn = _of_schedules(ready.schedules, ran)
            values |= {str(name): drawn[str(name)] for name in of_plan_too if name in drawn}
        if "swing_end" not in measures:  # it is worked out for the status
            values.pop("swing_end", None)
        _tell(ready.row, status, ran, values)
    return kernel


def _figures(kernel: Kernel, inputs: Sequence[RowInputs]) -> list[tuple[str, int, dict[str, float]]]:
    """Run rows by a kernel. Raises `NotCompiled` where compiled code did, so that plain Python names the line."""
    try:
        return figures(kernel, inputs)
    except (NotCompiled, Refused, MemoryError):
        raise
    except Exception as error:  # of a law, or of another part that was compiled with it
        if kernel.engine == "plain":
            raise
        raise NotCompiled(f"a line of the compiled loop raised {type(error).__name__}") from error


def _of_schedules(schedules: Schedules, ran: int) -> dict[str, float]:
    values: dict[str, float] = {}
    schedule = schedules.schedule()
    for way, plan, play in zip(("fwd", "bwd"), schedule.plans, schedule.plays, strict=True):
        if has_packets(plan):
            values |= of_plan(way, play[:ran], schedules.dt)
    return values


def _recorded(scene: Scene, seed: int, measures: Sequence[Measure], row: Row) -> tuple[str, int, dict[str, float]]:
    """A whole run, for figures that need its record. Raises `MetricMistake`."""
    result = run(scene, seed=seed)
    values = {}
    for one in measures:
        if not isinstance(one, str):
            values[one.__name__] = evaluate_metric(one, result, row)
        elif one in result.metrics:
            values[one] = result.metrics[one]
    return result.status, result.ticks, values
