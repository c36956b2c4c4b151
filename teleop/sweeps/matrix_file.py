"""The delay-scenario test matrix: blocks of rows with the status that each is expected to end with.

A file of TOML holds blocks. A block is one scene with lists of laws, delays (s, each way), losses (share of packets)
and seeds, all crossed; `set` holds knobs that its rows share, `expect` the status and `why` its reason. Exceptions,
the last that fits counts, say otherwise of some of the rows:

    [[block]]
    name = "soft_tissue"        # left out: the scene's name
    scene = "soft_tissue"
    laws = ["wave", "direct"]
    delays = [0.0, 0.01, 0.05]  # left out: the scene's own link
    losses = [0.0, 0.1]         # left out: only the scene's knob `delay` is turned
    seeds = [1, 2]              # left out: 0 alone, which the rows' names do not show
    set = {duration = 2.0, x_limit = 0.3}
    expect = "ok"
    why = "..."
    [[block.except]]
    laws = ["direct"]
    delays = {from = 0.05}      # or a list of the block's own
    expect = "diverged"
    why = "..."

With `losses` the link is `delay(D) | bernoulli(P)` both ways, in place of the scene's.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from math import inf
from pathlib import Path
from re import fullmatch
from typing import Any, NamedTuple

from teleop.errors import Refused, number, whole_number
from teleop.scene.library import ROOT
from teleop.scene.loading import load_scene
from teleop.storage.toml_tables import check_keys, is_tables, knobs_in, read_toml, repeated, text_of
from teleop.sweeps.runner import plan_sweep

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
    lists = {key: _listed(key, held[key], where) for key in LISTS if key in held}
    block = MatrixBlock(
        name=name, scene=held["scene"], laws=lists["laws"], delays=lists.get("delays", (None,)),
        losses=lists.get("losses", (None,)), seeds=lists.get("seeds"), fixed=fixed,
        expect=_expect(held["expect"], where), why=text_of(held["why"], "why", where),
    )
    given = held.get("except", [])
    if not is_tables(given):
        raise Refused(f"{where}: exceptions are tables, each begun with [[block.except]]")
    exceptions = [_exempt(each, block, f"exception {i} of {where}") for i, each in enumerate(given, 1)]
    return replace(block, exceptions=tuple(exceptions))


def _exempt(held: Mapping[str, Any], block: MatrixBlock, where: str) -> Exempt:
    check_keys(held, (*LISTS, "expect", "why"), where)
    for key in ("expect", "why"):
        if key not in held:
            raise Refused(f'{where} has no {key}; write {key} = "{"diverged" if key == "expect" else "..."}"')
    picked = {key: _picked(key, held[key], getattr(block, key), where) if key in held else getattr(block, key) or (0,)
              for key in LISTS}
    return Exempt(**picked, expect=_expect(held["expect"], where), why=text_of(held["why"], "why", where))


def _picked(key: str, value: object, own: tuple[Any, ...] | None, where: str) -> tuple[Any, ...]:
    """The block's own values that an exception names, one by one or from .. to."""
    own = () if own in (None, (None,)) else own
    if isinstance(value, dict) and key != "laws":
        check_keys(value, ("from", "to"), f"{key} of {where}")
        low, high = (number(f"{where}: {end} of {key}", value[end]) if end in value else past
                     for end, past in (("from", -inf), ("to", inf)))
        found = tuple(each for each in own if low <= each <= high)
    else:
        found = _listed(key, value, where)
    lost = next((each for each in found if each not in own), None)
    if lost is not None or not found:
        what = "none of" if lost is None else f"{lost!r}, which is not among"
        raise Refused(f"{where} picks {what} the block's {key}; there are: {', '.join(map(str, own)) or 'none'}")
    return found


def _listed(key: str, value: object, where: str) -> tuple[Any, ...]:
    """The values of a list, checked; one alone is a list of one."""
    given = value if isinstance(value, list) else [value]
    if not given:
        raise Refused(f"{where}: {key} is empty; leave it out, or write at least one value")
    found: tuple[Any, ...]
    if key == "laws":
        found = tuple(text_of(each, key, where) for each in given)
    elif key == "seeds":
        found = tuple(whole_number(f"{where}: {key}", each, low=0) for each in given)
    else:
        found = tuple(number(f"{where}: {key}", each, low=0.0, high=None if key == "delays" else 1.0) for each in given)
    twice = repeated(found)
    if twice is not None:
        raise Refused(f"{where}: {key} names {twice} twice; write each value once")
    return found


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
