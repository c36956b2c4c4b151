"""The virtual-time loop: one scene, one process, no clock. The same seed gives the same bits."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from numbers import Integral
from typing import TYPE_CHECKING, Any

from teleop.errors import Refused
from teleop.protocol.inbox import repeats
from teleop.scene.scene import Scene
from teleop.simulation.bodies import Bodies, exact_bodies, reference_samples
from teleop.simulation.result import Packets, Result
from teleop.simulation.source import beginnings, compiled, loop_text
from teleop.simulation.trace import EndRecord, assemble

if TYPE_CHECKING:
    from teleop.protocol.inbox import Plan

LONG = 100_000  # ticks from which on the rows are kept in a quarter of the memory, for 0.3 us a row


def run(
    scene: Scene, *, seed: int = 0, clock: Callable[[], int] | None = None, bodies: Bodies | None = None
) -> Result:
    """Run `scene` in virtual time.

    `seed` (0 .. 2^64-1) keys every random draw of the link. `clock` returns nanoseconds and times the loop
    alone; without it the result has no run time. `bodies` are others than the exact ones, for comparison. A run
    that diverges ends early and says so in its status.
    """
    if not isinstance(scene, Scene):
        raise Refused(f"give run a Scene, not {scene!r}; write for example run(load_scene('canonical'))")
    seed = check_seed(seed)
    bodies = bodies or exact_bodies(scene)
    forth, back = link_plans(scene, seed)
    lag = max((plan.lag for plan in (forth, back) if plan is not None), default=0)
    rows: dict[str, Any] = {e: array("d") if scene.ticks > LONG else [] for e in ("m", "s")}
    reference = reference_samples(scene)
    loop = compiled(scene, loop_text(scene), "loop", bodies.functions())
    starts = {e: scene.vector(f"start_{e}", getattr(scene, f"start_{e}")) for e in ("m", "s")}
    arguments = (
        beginnings(scene, starts), scene.law, scene.dt_ns / 1e9, scene.ticks, scene.x_limit, starts["m"], starts["s"],
        back and back.play, forth and forth.play, lag + 1,
        reference, bodies.held(), rows["m"].extend, rows["s"].extend,
    )
    began = clock() if clock else 0
    ran, capped, end, inner = loop(*arguments)
    took = clock() - began if clock else None
    records = {
        e: EndRecord(range(ran), rows[e], None if plan is None else plan.play[:ran])
        for e, plan in (("m", back), ("s", forth))[: 1 if scene.slave is None else 2]
    }
    trace = dict(assemble(scene, records, reference))
    status, sentence = verdict(scene, trace, ran, end)
    # Of a run that ended early, only what was sent until then counts.
    packets = ways(forth, back, ran) if ran == scene.ticks else packet_counts(scene, seed, ran)
    packets = {} if scene.slave is None else packets
    notes = standing_notes(scene)
    notes += [f"{capped} ticks had more contact events than are followed in one tick"] * (capped > 0)
    for end, plan in (("master", back), ("slave", forth)):
        notes += too_old(scene, end, plan, ran)
    told = integration(scene, bodies, inner)
    notes += [f"{own['ticks_over_tolerance']} ticks of the {end} are not within {own['tolerance']:g} m: the figures "
              "may be off by the estimate; a smaller dt may help" for end, own in told.get("integration", {}).items()
              if own.get("ticks_over_tolerance")]
    return Result.make(scene, seed=seed, mode="virtual", status=status, sentence=sentence, ticks=ran,
                       run_time=None if took is None else took / 1e9, trace=trace, packets=packets, notes=notes,
                       extra=told)


def integration(scene: Scene, bodies: Bodies, inner: tuple[tuple[Any, ...], tuple[Any, ...]]) -> dict[str, Any]:
    """What the bodies that have no closed form say of their integration, by end; the worst of the axes."""
    reports = {"master": [bodies.report_m] * scene.axes, "slave": [plant.report for plant in bodies.slaves]}
    found = {}
    for (end, report), states in zip(reports.items(), inner, strict=True):
        said = [tell(z) for tell, z in zip(report, states, strict=False) if tell is not None]
        names = {name for one in said for name in one}
        if names:
            found[end] = {name: max(one[name] for one in said if name in one) for name in sorted(names)}
    return {"integration": found} if found else {}


def standing_notes(scene: Scene) -> list[str]:
    """What a reader of the figures has to know of the scene itself, however it was run."""
    if scene.has_waves and repeats(scene.playout):
        return ["playout holds waves in the gaps, which is active: E_link may fall below zero"]
    return []


def too_old(scene: Scene, end: str, plan: Plan | None, ran: int) -> list[str]:
    """What a reader has to know if messages were too old for the watchdog: how many, how old, and what to write."""
    age = getattr(scene.watchdog, "age", None)
    if plan is None or age is None:
        return []
    import numpy as np

    ages = (np.arange(ran) - plan.played_at[:ran])[plan.played_at[:ran] >= 0] * scene.dt
    old = ages[ages > age + 0.5 * scene.dt]
    return [age_note(end, len(old), float(old.max()), age)] if len(old) else []


def age_note(end: str, count: int, most: float, age: float) -> str:
    """The sentence for messages that were too old for the watchdog of an end."""
    enough = f"{2.0 * most:.2g}"
    return (f"{count} messages were more than the watchdog's age of {age:g} s old when the {end} played them, up to "
            f"{most:g} s, so it let go; for a link as long as that type --set age={enough}, or in a scene of your own "
            f"watchdog=Watchdog(age={enough}); with none in place of a number a message may be of any age")


def check_seed(seed: int) -> int:
    """The seed as an int, also that of numpy; refuse what does not key the dice."""
    if isinstance(seed, bool) or not isinstance(seed, Integral) or not 0 <= seed < 1 << 64:
        raise Refused(f"seed must be a whole number from 0 to 2^64-1, not {seed!r}; write --seed 1")
    return int(seed)


def link_plans(scene: Scene, seed: int, ticks: int | None = None) -> tuple[Plan | None, Plan | None]:
    """What the link and the playout make of each direction: the packet played at every tick.

    `ticks`: of a run that ended early; what was sent and received until then.
    """
    count = scene.ticks if ticks is None else ticks
    if scene.link is None:
        return None, None
    from teleop.protocol.inbox import plan

    plans = []
    for direction in (0, 1):
        arrivals = scene.link.arrivals(direction, count, scene.dt_ns, seed, scene.wire_size)
        plans.append(plan(scene.playout, arrivals.packet, arrivals.time_ns, count, scene.dt_ns))
    return plans[0], plans[1]


def packet_counts(scene: Scene, seed: int, ran: int) -> dict[str, Packets]:
    """The packets of each direction until tick `ran`, as the schedule has them."""
    return ways(*link_plans(scene, seed, ran), ran)


def ways(forth: Plan | None, back: Plan | None, ran: int) -> dict[str, Packets]:
    """The counts of two plans by direction; None is no link, which loses nothing."""
    plans = {"fwd": forth, "bwd": back}
    return {way: Packets.of_plan(plan) if plan else Packets.without_link(ran) for way, plan in plans.items()}


def verdict(scene: Scene, trace: dict[str, Any], ran: int, end: Any) -> tuple[str, str]:
    """The run's status and its sentence. `end` is None, or the positions that left the bounds.

    What is not finite anywhere in the trace is a divergence, even of a run that came to its end.
    """
    import numpy as np

    lost = {
        name: int(np.argmin(sound.reshape(ran, -1).all(axis=1)))
        for name in ("f_m", "f_s", *trace) if name in trace and not (sound := np.isfinite(trace[name])).all()
    }
    if lost:
        name = min(lost, key=lost.__getitem__)  # the first of several at the same tick
        return "diverged", divergence(scene, lost[name], f"{name} is not finite")
    if end is None:
        return "ok", f"ran to its end, {ran} ticks of {scene.dt:g} s"
    far = [name for name, xs in zip(("x_m", "x_s"), end, strict=False) if not all(abs(x) < scene.x_limit for x in xs)]
    return "diverged", divergence(scene, ran - 1, f"{far[0]} passed {scene.x_limit:g} m")


def divergence(scene: Scene, k: int, what: str) -> str:
    """The sentence of a run that diverged at tick k."""
    when = f"diverged at t = {k * scene.dt_ns / 1e9:g} s (tick {k})"
    return f"{when}: {what}; a smaller dt, gain or delay may hold it"
