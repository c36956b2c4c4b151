"""The Z-width of a scene: passive and stable region, impedance curves, what comes to rest, and what widens it.

    assess(load_scene("virtual_wall")).rows[0].curves.width

Quick first: theory takes a second, the runs in virtual time come last. Ctrl-C keeps what is done.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

from teleop.analysis.models.gains import check, left_out, scales
from teleop.analysis.zwidth.impedance import Curves, curves
from teleop.analysis.zwidth.levers import Lever, levers
from teleop.analysis.zwidth.measured import let_go, stiffest_at_rest
from teleop.analysis.zwidth.passive import Region, passive_region
from teleop.analysis.zwidth.plane import ALL, Boundary, LoopFamily, Span, boundary, loop, rows
from teleop.errors import Refused
from teleop.law.analysis_offers import instead
from teleop.terminal.options import typed_range

if TYPE_CHECKING:
    from teleop.scene.scene import Scene

Show = Callable[[float, str], None]
THEORY = 0.15  # of the work
LEVERS = 10  # of which there are about so many
RUNS = 17  # a search of the stiffest at rest has about so many


class LeverRow(NamedTuple):
    """One lever: what it comes to, at the scene's own B where a single one is meant. None: not claimed, not looked at.

    Stiffnesses in N/m; inf is beyond the range looked at, 0 below all of it.
    """

    name: str
    what: str
    region: Region
    curves: Curves
    stable: float | None  # with the scene's hand
    stable_free: float | None
    stable_any: float | None  # with the hand if there is one, at the B where it is greatest
    rest: float | None = None  # measured in virtual time


@dataclass(frozen=True, kw_only=True)
class ZWidth:
    """All that was found. `rows` begin with the scene as it is; `measured` is (B, greatest K at rest or None)."""

    scene: Scene
    seed: int
    span_K: Span
    span_B: Span
    stable: Boundary | None = None  # with the scene's hand; None: it has none, or the loop is not linear
    stable_free: Boundary | None = None
    rows: list[LeverRow] = field(default_factory=list)
    measured: list[tuple[float, float | None]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    interrupted: bool = False

    @property
    def base(self) -> LeverRow:
        """The scene as it is."""
        return self.rows[0]


def span(name: str, typed: str | None) -> Span:
    """LOW:HIGH as it was typed; `Refused` if it is no range of numbers from 0 up."""
    if typed is None:
        return Span()
    return Span(*typed_range(name, typed, example="0:2000", low=0.0))


def assess(scene: Scene, *, span_K: Span = ALL, span_B: Span = ALL, seed: int = 0, show: Show | None = None) -> ZWidth:
    """Find a scene's Z-width. `show` is told how much is done, 0 to 1.

    The spans are where the stable region and what rests are looked for; the passive region is always whole. Raises
    `Refused` for a scene with a slave and for a law without K and B, and KeyboardInterrupt if nothing is done yet.
    """
    scene = check(scene)
    found = ZWidth(scene=scene, seed=seed, span_K=span_K, span_B=span_B)
    show = show or _quiet
    try:
        for further in _steps(found, show):
            found = further
    except KeyboardInterrupt:
        if not found.rows:
            raise
        return replace(found, interrupted=True)
    show(1.0, "done")
    return found


def _quiet(part: float, text: str) -> None:
    """No progress is shown."""


def _steps(found: ZWidth, show: Show) -> Iterator[ZWidth]:
    """What is found so far, again and again."""
    scene, span_K, span_B = found.scene, found.span_K, found.span_B
    show(0.0, "the scene as it is")
    every = levers(scene)
    tried = [next(every)]
    found = replace(found, rows=[_row(scene, tried[0], scene.law.B, span_K, span_B)], notes=_notes(scene))
    yield found
    show(0.02, "stable region")
    with_hand, why = _loop(scene, hand=True) if scene.hand is not None else (None, "")
    free, why = _loop(scene, hand=False) if not why else (None, why)
    if why:
        found = replace(found, notes=[*found.notes, f"no stable region: {why}"])
    elif free is not None:
        some = rows(with_hand or free, span_B, span_K)
        found = replace(found, stable_free=boundary(free, rows(free, span_B, span_K), span_K),
                        stable=None if with_hand is None else boundary(with_hand, some, span_K))
    yield found
    for i, lever in enumerate(every, 1):
        tried.append(lever)
        show(0.04 + (THEORY - 0.04) * min(i / LEVERS, 1.0), lever.name)
        if lever.scene is None:
            found = replace(found, notes=[*found.notes, f"{lever.name} {lever.what}"])
        else:
            found = replace(found, rows=[*found.rows, _row(lever.scene, lever, scene.law.B, span_K, span_B)])
        yield found
    yield from _runs(found, {lever.name: lever for lever in tried}, with_hand, show)


def _runs(found: ZWidth, tried: dict[str, Lever], linear: LoopFamily | None, show: Show) -> Iterator[ZWidth]:
    """The same with what comes to rest in virtual time, one search after another."""
    own, high = found.scene.law.B, found.span_B.high
    try:
        let_go(found.scene)
    except Refused as refused:
        yield replace(found, notes=[*found.notes, str(refused)])
        return
    b = found.scene.master.damping or 4.0 * scales(found.scene)[1]
    some = sorted({B for B in (0.0, 0.5 * b, b, 2.0 * b, 5.0 * b) if found.span_B.low <= B <= (high or B)} | {own})
    some.sort(key=lambda B: own != B)  # the scene's own first
    total = len(some) + len(found.rows) - 1
    done = 0.0

    def find(scene: Scene, B: float, near: float | None, text: str) -> float | None:
        nonlocal done
        begun = done

        def tell() -> None:
            nonlocal done
            done = min(done + 1.0 / RUNS, begun + 0.95)
            show(THEORY + (1.0 - THEORY) * done / total, text)

        near = near if near is not None and 0.0 < near < float("inf") else scales(scene)[0]
        edge = stiffest_at_rest(let_go(scene), B, near=near, low=found.span_K.low, high=found.span_K.high,
                                seed=found.seed, tell=tell)
        done = begun + 1.0
        return edge

    for B in some:
        near = None if linear is None else boundary(linear, [B], found.span_K).K[0]
        edge = find(found.scene, B, near, f"at rest, B = {B:.3g} N s/m")
        found = replace(found, measured=sorted([*found.measured, (B, edge)], key=lambda one: one[0]))
        if own == B:
            found = replace(found, rows=[found.base._replace(rest=edge), *found.rows[1:]])
        yield found
    for i, row in enumerate(found.rows[1:], 1):
        scene = tried[row.name].scene
        if scene is not None:
            edge = find(scene, own, row.stable or found.base.stable or found.base.stable_free, f"at rest, {row.name}")
            found = replace(found, rows=[*found.rows[:i], row._replace(rest=edge), *found.rows[i + 1:]])
            yield found


def _row(scene: Scene, lever: Lever, B: float, span_K: Span, span_B: Span) -> LeverRow:
    region = passive_region(scene)
    stable, free, most = None, None, None
    if scene.passivity is None:  # whose damping no eigenvalue knows
        with suppress(Refused):
            alone = loop(scene, hand=False)
            held = alone if scene.hand is None else loop(scene, hand=True)
            if scene.hand is None or not alone.coarse:  # which would take seconds for each lever
                free = boundary(alone, [B], span_K).K[0]
            stable = None if scene.hand is None else boundary(held, [B], span_K).K[0]
            if not held.coarse:
                most = boundary(held, rows(held, span_B, span_K), span_K).stiffest
    return LeverRow(lever.name, lever.what, region, curves(scene, region), stable, free, most)


def _loop(scene: Scene, *, hand: bool) -> tuple[LoopFamily | None, str]:
    try:
        return loop(scene, hand=hand), ""
    except Refused as refused:
        return None, str(refused)


def _notes(scene: Scene) -> list[str]:
    gone = left_out(scene)
    notes = [f"the stable region is that of the scene without {', '.join(gone)}"] if gone else []
    if words := instead(scene.law):
        notes.append(f"{words}, but in what was measured")
    if scene.cap is not None:
        notes.append("the force cap is in what was measured and in nothing else")
    return notes
