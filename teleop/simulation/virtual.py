"""A run in virtual time: one scene, one process, no clock. The same seed gives the same bits."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from teleop.errors import NamedValues, Refused, number_of
from teleop.law.contract import attempt
from teleop.scene.scene import Scene
from teleop.simulation.bodies import Bodies
from teleop.simulation.ending import (
    Ending,
    handed_over,
    integration,
    over_tolerance,
    position_unit,
    too_old,
    verdict,
)
from teleop.simulation.notes import faded, law_notes, of_plans, unplayed, untuned
from teleop.simulation.plan import LinkPlans, check_seed, counts_of, link_plans, packet_counts, round_trip
from teleop.simulation.prepared import Prepared, prepare
from teleop.simulation.result import Result
from teleop.simulation.structure import columns
from teleop.simulation.trace import EndRecord, ForceSource, assemble

Judge = Callable[[Prepared, Mapping[str, Any], int, Any, int], Ending]
MOST_BYTES = 4_000_000_000  # of rows that a run keeps in memory
LONG = 100_000  # ticks from which on the rows are kept in a quarter of the memory, for 0.3 us a row


def run(
    scene: Scene, *, seed: int = 0, clock: Callable[[], int] | None = None, bodies: Bodies | str | None = None
) -> Result:
    """Run `scene` in virtual time.

    `seed` (0 .. 2^64-1) keys every random draw of the link. `clock` returns nanoseconds and times the loop
    alone; without it the result has no run time. `bodies` are others than the exact ones, for comparison, or their
    integrator by name: "semi_implicit_euler:40" has 40 sub-steps a tick. A run that diverges ends early and says so in
    its status. Raises `Refused`.
    """
    if not isinstance(scene, Scene):
        raise Refused(f"give run a Scene, not {scene!r}; write for example run(load_scene('canonical'))")
    if isinstance(bodies, str):
        from teleop.simulation.integrators.stepped import bodies_of

        bodies = bodies_of(scene, bodies)
    return run_prepared(prepare(scene, bodies), seed=seed, clock=clock)


def _check_memory(scene: Scene) -> None:
    """Refuse a run whose rows no memory would hold, such as a day of a live scene."""
    names = [name for e in ("m", "s")[: 1 if scene.slave is None else 2] for name in columns(scene, e)]
    per_tick = 8 * sum(scene.axes if "@" in name else 1 for name in names)
    needed = scene.ticks * per_tick
    if needed > MOST_BYTES:
        raise Refused(f"a run in virtual time keeps its record in memory, and {scene.ticks} ticks of {scene.dt:g} s "
                      f"are {needed / 1e9:.3g} GB; type for example --set duration={1e4 * scene.dt:g}, or run it live, "
                      "where the record goes to a file")


def run_prepared(prepared: Prepared, *, seed: int = 0, clock: Callable[[], int] | None = None) -> Result:
    """Run a scene that was worked out already, as `run` does."""
    scene, seed = prepared.scene, check_seed(seed)
    bodies = prepared.bodies
    _check_memory(scene)
    fwd, bwd = plans = link_plans(scene, seed)
    orders = [plan and plan.orders.tolist() for plan in (bwd, fwd)]
    if scene.slave is None:  # what its ticks are ordered says which of them are left out, and no more
        plans = LinkPlans(None, None)
    size = 1 + max((plan.reach for plan in plans if plan is not None), default=0)
    rows: dict[str, Any] = {e: array("d") if scene.ticks > LONG else [] for e in ("m", "s")}
    reference, loop, starts = prepared.reference, prepared.loop, prepared.starts
    arguments = (
        prepared.numbers, scene.law, scene.dt_ns / 1e9, scene.ticks, scene.x_limit, starts["m"], starts["s"],
        *orders, size, reference, bodies.numbers(),
        (rows["m"].extend, rows["s"].extend),
    )
    began = clock() if clock else 0
    ran, capped, end, inner = attempt(scene.laws[0], loop, *arguments)
    took = clock() - began if clock else None
    sent = None if scene.deadband is None else [sent_ticks(scene, e, rows[e], ran) for e in ("m", "s")]
    notes = [f"{number_of(capped, 'tick')} had more contact events than are followed in one tick"] * (capped > 0)
    reports = integration(scene, bodies, inner)
    if bodies.method:
        from teleop.simulation.integrators.stepped import method_note

        notes = method_note(bodies) + notes
        reports["bodies"] = bodies.method
    return result_of(prepared, plans, rows, ran, end, seed=seed, sent=sent, took=took, notes=notes, reports=reports)


def result_of(
    prepared: Prepared, plans: LinkPlans, rows: Mapping[str, Any], ran: int, end: Any, *, seed: int, took: int | None,
    sent: Sequence[Any] | None = None, forces: Mapping[str, ForceSource | None] | None = None,
    notes: Sequence[str] = (), reports: Mapping[str, Any] | None = None, judge: Judge = verdict,
) -> Result:
    """The result of a run in virtual time of which `rows` has each end's record, flat.

    `end`: the positions that left the bounds after `ran` ticks, None of a run that came to its end. `took`: ns. `sent`:
    see `sent_ticks`. `forces`: the source of each end's external force; left out, the scene's own bodies. `notes`
    are told with those that follow from the run, `reports` beside its figures. `judge` says how it ended.
    """
    scene, reports = prepared.scene, dict(reports or {})
    if sent is not None:
        plans = link_plans(scene, seed, ran, sent)
    fwd, bwd = plans
    records = {
        e: EndRecord(range(ran), rows[e], None if plan is None else plan.packets_until(ran), (forces or {}).get(e))
        for e, plan in (("m", bwd), ("s", fwd))[: 1 if scene.slave is None else 2]
    }
    trace = NamedValues("column of this run", assemble(prepared, records))
    trip = round_trip(None if plan is None else plan.played_at for plan in plans) if prepared.still else 0
    ending = judge(prepared, trace, ran, end, trip)
    # Of a run that ended early, only what was sent until then counts.
    known = sent is None and ran == scene.ticks
    packets = counts_of(plans, ran) if known else packet_counts(scene, seed, ran, sent)
    sentences = [*untuned(scene), *law_notes(scene, *of_plans(scene, plans, ran)), *notes]
    sentences += too_old(scene, "master", bwd, ran)
    sentences += too_old(scene, "slave", fwd, ran)
    sentences += over_tolerance(reports, position_unit(scene))
    sentences += unplayed(scene, trace, packets, seed=seed) + faded(scene, trace) + handed_over(scene, trace)
    return Result.make(
        scene, ending._replace(notes=(*sentences, *ending.notes)), seed=seed, mode="virtual", ticks=ran,
        run_time=None if took is None else took / 1e9, trace=trace, packets={} if scene.slave is None else packets,
        extra=reports)


def sent_ticks(scene: Scene, e: str, rows: Any, ran: int) -> Any:
    """The ticks at which an end sent its message, as its record has them: (ran,) truths."""
    places = [each for name in columns(scene, e) for each in [name] * (scene.axes if name.endswith("@") else 1)]
    table = np.array(rows, dtype=float).reshape(ran, -1)
    return table[:, places.index(f"sent_{e}")] > 0.0
