"""The delay-scenario test matrix run, a sweep for each block, and told: what ended as expected, and what did not."""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, NamedTuple

from teleop.errors import number_of
from teleop.simulation.result import versions
from teleop.sweeps.matrix_file import BUILT_IN, METRICS, MatrixBlock, Row, read_matrix
from teleop.sweeps.runner import sweep
from teleop.terminal.answer import Answer
from teleop.terminal.progress import shown_on
from teleop.terminal.table import columns

Show = Callable[[int, int], None]


class RowOutcome(NamedTuple):
    """A row and what came."""

    row: Row
    status: str
    ticks: int
    figures: Mapping[str, float]  # those of `METRICS` that the run has
    x_limit: str  # m, beyond which it has diverged

    @property
    def as_expected(self) -> bool:
        """Did the run end with the status that was expected."""
        return self.status == self.row.expect

    def line(self) -> str:
        """What was expected, what came, and why, in one line."""
        ended = "was not finite or passed" if self.status == "diverged" else "stayed within"
        told = "".join(f", {name} {value:.3g}" for name, value in self.figures.items())
        return (f"{self.row.id}: expected {self.row.expect} ({self.row.why}), came {self.status}: {ended} "
                f"{self.x_limit} in {number_of(self.ticks, 'tick')}{told}")


def run_block(block: MatrixBlock, *, executor: Executor | None = None, out: Path | None = None, show: Show | None = None
              ) -> list[RowOutcome]:
    """Run a block as one sweep in plain Python, in the order of its rows. `out`: the folder of that sweep."""
    rows = block.rows()
    ran = sweep(block.scene, block.axes(), seeds=block.seeds or 1, metrics=METRICS, fixed=block.fixed,
                engine="plain", executor=executor, out=out, show=show)
    limit = f"x_limit = {block.fixed['x_limit']} m" if "x_limit" in block.fixed else "its x_limit"
    return [RowOutcome(rows[came["row"]], came["status"], came["ticks"],
                    {name: came[name] for name in METRICS if name in came}, limit) for came in ran]


def run_matrix(blocks: tuple[MatrixBlock, ...], *, executor: Executor | None = None, out: Path | None = None,
               show: Show | None = None) -> dict[str, list[RowOutcome]]:
    """Run every block; what came, by the block's name. `out`: a folder that takes the folder of each block's sweep."""
    total, done = sum(len(block.rows()) for block in blocks), 0
    came: dict[str, list[RowOutcome]] = {}
    for block in blocks:
        def told(here: int, _: int, before: int = done) -> None:
            if show is not None:
                show(before + here, total)

        came[block.name] = run_block(block, executor=executor, out=out and out / block.name, show=told)
        done += len(came[block.name])
    return came


def table(blocks: tuple[MatrixBlock, ...], came: Mapping[str, list[RowOutcome]]) -> str:
    """What came, a line a block, and a line for each row that is not as expected."""
    lines = [("block", "scene", "rows", "as expected")]
    for block in blocks:
        lines.append((block.name, block.scene, str(len(came[block.name])), str(_good(came[block.name]))))
    every = [outcome for outcomes in came.values() for outcome in outcomes]
    lines.append(("in all", "", str(len(every)), str(_good(every))))
    wrong = [outcome.line() for outcome in every if not outcome.as_expected]
    last = _verdict(len(every), len(wrong)) + ":" * bool(wrong)
    return "\n".join([columns(lines, left=(0, 1)), last, *wrong])


def _verdict(rows: int, wrong: int) -> str:
    every = number_of(rows, "row")
    return f"{wrong} of {every} not as expected" if wrong else f"all {every} as expected"


def summary(blocks: tuple[MatrixBlock, ...], came: Mapping[str, list[RowOutcome]]) -> dict[str, Any]:
    """The same as JSON can hold it, with every row."""
    every = [outcome for outcomes in came.values() for outcome in outcomes]
    return {
        "rows": len(every), "as_expected": _good(every),
        "blocks": [{"name": block.name, "scene": block.scene, "rows": len(came[block.name]),
                    "as_expected": _good(came[block.name])} for block in blocks],
        "unexpected": [outcome.line() for outcome in every if not outcome.as_expected],
        "outcomes": [{**one.row._asdict(), "status": one.status, "ticks": one.ticks, **one.figures} for one in every],
    }


def command(args: Namespace) -> Answer:
    """What `teleop matrix` does: run the matrix and say what did not end as expected. Raises `Refused`."""
    path = args.file or BUILT_IN
    blocks = read_matrix(path)
    rows = sum(len(block.rows()) for block in blocks)
    began = args.seconds()
    with shown_on(None if args.json else sys.stderr, args.seconds, float(rows)) as show:
        came = run_matrix(blocks, out=None if args.out is None else Path(args.out),
                          show=lambda done, of: show(float(done), f"{done} of {number_of(of, 'row')}"))
    told = summary(blocks, came)
    document = {
        "status": "done", "sentence": _verdict(told["rows"], len(told["unexpected"])), "matrix": str(path),
        "mode": "matrix", "versions": versions(), "command": list(args.typed),
        "seconds": args.seconds() - began, "path": None, **told,
    }
    answer = Answer(table(blocks, came), document)
    return answer if args.out is None else answer.kept_in(args.out)


def _good(outcomes: list[RowOutcome]) -> int:
    return sum(outcome.as_expected for outcome in outcomes)
