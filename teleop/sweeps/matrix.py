"""The delay-scenario test matrix run, a sweep for each block, and told: what ended as expected, and what did not."""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from itertools import product
from math import inf
from pathlib import Path
from re import fullmatch
from typing import Any, NamedTuple

from teleop.errors import Refused, number, number_of, whole_number
from teleop.scene.library import ROOT
from teleop.scene.loading import load_scene
from teleop.simulation.result import versions
from teleop.storage.toml_tables import check_keys, is_tables, knobs_in, read_toml, repeated, text_of
from teleop.sweeps.runner import plan_sweep, sweep
from teleop.terminal.answer import Answer
from teleop.terminal.progress import shown_on
from teleop.terminal.table import columns

BUILT_IN = ROOT / "scenarios" / "matrix.toml"
EXPECTED = ("ok", "limit cycle", "unstable", "diverged")
METRICS = ("x_err_max", "f_m_max", "E_link_min")  # what a row tells beside its status
LISTS = ("laws", "delays", "losses", "seeds")
KEYS = ("name", "scene", *LISTS, "set", "expect", "why", "except")


class Exempt(NamedTuple):
    """Values of a block, and what is expected where all of them meet."""

    laws: tuple[Any, ...]
    delays: tuple[Any, ...]
    losses: tuple[Any, ...]
    seeds: tuple[Any, ...]
    expect: str
    why: str


class Row(NamedTuple):
    """A run of the matrix, and what is expected of it."""

    id: str
    law: str
    delay: float | None  # s; None: the scene's own
    loss: float | None  # None: the scene's own
    seed: int
    expect: str
    why: str


@dataclass(frozen=True, kw_only=True, slots=True)
class MatrixBlock:
    """Rows of one scene. `read_matrix` makes and checks them."""

    name: str
    scene: str
    laws: tuple[str, ...]
    delays: tuple[float | None, ...] = (None,)
    losses: tuple[float | None, ...] = (None,)
    seeds: tuple[int, ...] | None = None
    fixed: Mapping[str, object] = field(default_factory=dict)
    expect: str
    why: str
    exceptions: tuple[Exempt, ...] = ()

    def rows(self) -> list[Row]:
        """Its rows, in the order of the sweep that runs them."""
        return [self._row(*point) for point in product(self.laws, self.delays, self.losses, self.seeds or (0,))]

    def _row(self, law: str, delay: float | None, loss: float | None, seed: int) -> Row:
        expect, why = self.expect, self.why
        for one in self.exceptions:
            if law in one.laws and delay in one.delays and loss in one.losses and seed in one.seeds:
                expect, why = one.expect, one.why
        parts = [self.name, law]
        parts += [] if delay is None else [f"{1e3 * delay:g}ms"]
        parts += [] if loss is None else [f"{100.0 * loss:g}%"]
        parts += [] if self.seeds is None else [f"seed{seed}"]
        return Row("-".join(parts), law, delay, loss, seed, expect, why)

    def axes(self) -> dict[str, list[Any]]:
        """The axes of its sweep, as `teleop.sweep` takes them."""
        axes: dict[str, list[Any]] = {"law": list(self.laws)}
        if self.losses != (None,):
            axes["link"] = [f"delay({delay})" + (f" | bernoulli({loss})" if loss else "")
                            for delay, loss in product(self.delays, self.losses)]
        elif self.delays != (None,):
            axes["delay"] = list(self.delays)
        return axes


def read_matrix(path: Path | str = BUILT_IN) -> tuple[MatrixBlock, ...]:
    """The blocks of a matrix's file, every row checked to make a scene. Raises `Refused`."""
    path = Path(path)
    held = read_toml(path, f"the matrix {path}",
                     "a file of TOML with [[block]] tables, or none for the built-in matrix")
    extra = next((key for key in held if key != "block"), None)
    if extra is not None or not is_tables(held.get("block")) or not held["block"]:
        what = f"has {extra!r} at its top" if extra is not None else "has no blocks"
        raise Refused(f"the matrix {path} {what}; it is a list of tables, each begun with [[block]]")
    blocks = tuple(_block(table, f"block {i} of {path.name}") for i, table in enumerate(held["block"], 1))
    twice = repeated([block.name for block in blocks])
    if twice is not None:
        raise Refused(f"two blocks of {path.name} are called {twice!r}; write name = \"{twice}_2\" into one of them")
    for block in blocks:
        _try(block, f"block {block.name!r} of {path.name}")
    return blocks


def _block(held: Mapping[str, Any], where: str) -> MatrixBlock:
    where = f"{where} ({held.get('name', held.get('scene', 'without a scene'))})"
    check_keys(held, KEYS, where)
    for key, example in (("scene", "soft_tissue"), ("laws", None), ("expect", "ok"), ("why", "...")):
        if key not in held:
            raise Refused(f"{where} has no {key}; write " + (f'{key} = "{example}"' if example else 'laws = ["wave"]'))
    name = text_of(held.get("name", Path(text_of(held["scene"], "scene", where)).stem), "name", where)
    if not fullmatch(r"\w[\w.]*", name):
        raise Refused(f"{where}: a name has letters, digits, _ and dots, not {name!r}; write name = \"soft_tissue\"")
    fixed = knobs_in(held.get("set", {}), where)
    if "losses" in held and "delays" not in held:
        raise Refused(f"{where} has losses and no delays, and its link has both; write delays = [0.0]")
    lists = {key: _check_list(key, held[key], where) for key in LISTS if key in held}
    block = MatrixBlock(
        name=name, scene=held["scene"], laws=lists["laws"], delays=lists.get("delays", (None,)),
        losses=lists.get("losses", (None,)), seeds=lists.get("seeds"), fixed=fixed,
        expect=_expect(held["expect"], where), why=text_of(held["why"], "why", where),
    )
    exceptions_held = held.get("except", [])
    if not is_tables(exceptions_held):
        raise Refused(f"{where}: exceptions are tables, each begun with [[block.except]]")
    exceptions = [_exempt(each, block, f"exception {i} of {where}") for i, each in enumerate(exceptions_held, 1)]
    return replace(block, exceptions=tuple(exceptions))


def _exempt(held: Mapping[str, Any], block: MatrixBlock, where: str) -> Exempt:
    check_keys(held, (*LISTS, "expect", "why"), where)
    for key in ("expect", "why"):
        if key not in held:
            raise Refused(f'{where} has no {key}; write {key} = "{"diverged" if key == "expect" else "..."}"')
    picked = {key: _picked(key, held[key], getattr(block, key), where) if key in held else getattr(block, key) or (0,)
              for key in LISTS}
    return Exempt(**picked, expect=_expect(held["expect"], where), why=text_of(held["why"], "why", where))


def _picked(key: str, value: object, values: tuple[Any, ...] | None, where: str) -> tuple[Any, ...]:
    """The block's own values that an exception names, one by one or from .. to."""
    values = () if values in (None, (None,)) else values
    if isinstance(value, dict) and key != "laws":
        check_keys(value, ("from", "to"), f"{key} of {where}")
        low, high = (number(f"{where}: {end} of {key}", value[end], example=f"{end} = 1") if end in value else past
                     for end, past in (("from", -inf), ("to", inf)))
        picked = tuple(each for each in values if low <= each <= high)
    else:
        picked = _check_list(key, value, where)
    lost = next((each for each in picked if each not in values), None)
    if lost is not None or not picked:
        what = "none of" if lost is None else f"{lost!r}, which is not among"
        raise Refused(f"{where} picks {what} the block's {key}; there are: {', '.join(map(str, values)) or 'none'}")
    return picked


def _check_list(key: str, value: object, where: str) -> tuple[Any, ...]:
    """The values of a list, checked; one alone is a list of one."""
    entries = value if isinstance(value, list) else [value]
    if not entries:
        raise Refused(f"{where}: {key} is empty; leave it out, or write at least one value")
    checked: tuple[Any, ...]
    if key == "laws":
        checked = tuple(text_of(each, key, where) for each in entries)
    elif key == "seeds":
        checked = tuple(whole_number(f"{where}: {key}", each, low=0) for each in entries)
    else:
        high = None if key == "delays" else 1.0
        checked = tuple(number(f"{where}: {key}", each, low=0.0, high=high) for each in entries)
    twice = repeated(checked)
    if twice is not None:
        raise Refused(f"{where}: {key} names {twice} twice; write each value once")
    return checked


def _expect(value: object, where: str) -> str:
    if value not in EXPECTED:
        known = " or ".join([f'"{each}"' for each in EXPECTED])
        raise Refused(f'{where}: expect is {known}, not {value!r}; write expect = "ok"')
    return str(value)


def _try(block: MatrixBlock, where: str) -> None:
    """Refuse a block of which a row would make no scene: nothing runs until all can."""
    try:
        plan_sweep(block.scene, block.axes(), seeds=block.seeds or 1, metrics=METRICS, fixed=block.fixed,
                   engine="plain")
        for knobs in _points(block.axes()):
            load_scene(block.scene, **{**block.fixed, **knobs})
    except Refused as refused:
        raise Refused(f"{where}: {refused}") from None


def _points(axes: Mapping[str, list[Any]]) -> Iterator[dict[str, Any]]:
    return (dict(zip(axes, values, strict=True)) for values in product(*axes.values()))


Show = Callable[[int, int], None]


class RowOutcome(NamedTuple):
    """A row and its outcome."""

    row: Row
    status: str
    ticks: int
    figures: Mapping[str, float]  # those of `METRICS` that the run has
    x_limit: str  # m, beyond which it has diverged

    @property
    def as_expected(self) -> bool:
        """True if the run ended with the expected status."""
        return self.status == self.row.expect

    def line(self) -> str:
        """Expected status, status, and the reason, in one line."""
        ended = "was not finite or passed" if self.status == "diverged" else "stayed within"
        figures = "".join(f", {name} {value:.3g}" for name, value in self.figures.items())
        return (f"{self.row.id}: expected {self.row.expect} ({self.row.why}), came {self.status}: {ended} "
                f"{self.x_limit} in {number_of(self.ticks, 'tick')}{figures}")


def run_block(block: MatrixBlock, *, executor: Executor | None = None, out: Path | None = None, show: Show | None = None
              ) -> list[RowOutcome]:
    """Run a block as one sweep in plain Python, in the order of its rows. `out`: the folder of that sweep."""
    rows = block.rows()
    ran = sweep(block.scene, block.axes(), seeds=block.seeds or 1, metrics=METRICS, fixed=block.fixed,
                engine="plain", executor=executor, out=out, show=show)
    limit = f"x_limit = {block.fixed['x_limit']} m" if "x_limit" in block.fixed else "its x_limit"
    return [RowOutcome(rows[result["row"]], result["status"], result["ticks"],
                    {name: result[name] for name in METRICS if name in result}, limit) for result in ran]


def run_matrix(blocks: tuple[MatrixBlock, ...], *, executor: Executor | None = None, out: Path | None = None,
               show: Show | None = None) -> dict[str, list[RowOutcome]]:
    """Run every block; outcomes by the block's name. `out`: a folder that takes the folder of each block's sweep."""
    total, done = sum(len(block.rows()) for block in blocks), 0
    outcomes: dict[str, list[RowOutcome]] = {}
    for block in blocks:
        def show_rows(here: int, _: int, before: int = done) -> None:
            if show is not None:
                show(before + here, total)

        outcomes[block.name] = run_block(block, executor=executor, out=out and out / block.name, show=show_rows)
        done += len(outcomes[block.name])
    return outcomes


def table(blocks: tuple[MatrixBlock, ...], outcomes_of: Mapping[str, list[RowOutcome]]) -> str:
    """Table of the outcomes: a line a block, and a line for each row that is not as expected."""
    lines = [("block", "scene", "rows", "as expected")]
    for block in blocks:
        lines.append((block.name, block.scene, str(len(outcomes_of[block.name])), str(_good(outcomes_of[block.name]))))
    every = [outcome for outcomes in outcomes_of.values() for outcome in outcomes]
    lines.append(("in all", "", str(len(every)), str(_good(every))))
    wrong = [outcome.line() for outcome in every if not outcome.as_expected]
    last = _verdict(len(every), len(wrong)) + ":" * bool(wrong)
    return "\n".join([columns(lines, left=(0, 1)), last, *wrong])


def _verdict(rows: int, wrong: int) -> str:
    every = number_of(rows, "row")
    return f"{wrong} of {every} not as expected" if wrong else f"all {every} as expected"


def summary(blocks: tuple[MatrixBlock, ...], outcomes_of: Mapping[str, list[RowOutcome]]) -> dict[str, Any]:
    """The same as JSON can hold it, with every row."""
    every = [outcome for outcomes in outcomes_of.values() for outcome in outcomes]
    return {
        "rows": len(every), "as_expected": _good(every),
        "blocks": [{"name": block.name, "scene": block.scene, "rows": len(outcomes_of[block.name]),
                    "as_expected": _good(outcomes_of[block.name])} for block in blocks],
        "unexpected": [outcome.line() for outcome in every if not outcome.as_expected],
        "outcomes": [{**one.row._asdict(), "status": one.status, "ticks": one.ticks, **one.figures} for one in every],
    }


def command(args: Namespace) -> Answer:
    """Carry out `teleop matrix`: run the matrix and name the rows that did not end as expected. Raises `Refused`."""
    path = args.file or BUILT_IN
    blocks = read_matrix(path)
    rows = sum(len(block.rows()) for block in blocks)
    began = args.seconds()
    with shown_on(None if args.json else sys.stderr, args.seconds, float(rows)) as show:
        outcomes = run_matrix(blocks, out=None if args.out is None else Path(args.out),
                          show=lambda done, of: show(float(done), f"{done} of {number_of(of, 'row')}"))
    content = summary(blocks, outcomes)
    document = {
        "status": "done", "sentence": _verdict(content["rows"], len(content["unexpected"])), "matrix": str(path),
        "mode": "matrix", "versions": versions(), "command": list(args.typed),
        "seconds": args.seconds() - began, "path": None, **content,
    }
    answer = Answer(table(blocks, outcomes), document)
    return answer if args.out is None else answer.kept_in(args.out)


def _good(outcomes: list[RowOutcome]) -> int:
    return sum(outcome.as_expected for outcome in outcomes)
