"""The virtual-time loop: one scene, one process, no clock. The same seed gives the same bits."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from teleop.bodies import master_plant, reference_samples, slave_plants
from teleop.errors import Refused
from teleop.result import Packets, Result
from teleop.scene import Scene
from teleop.tick import compiled, features, loop_text
from teleop.trace import EndRecord, assemble

if TYPE_CHECKING:
    from teleop.playout import Plan


def run(scene: Scene, *, seed: int = 0, clock: Callable[[], int] | None = None) -> Result:
    """Run `scene` in virtual time.

    `seed` (0 .. 2^64-1) keys every random draw of the link. `clock` returns nanoseconds and times the loop
    alone; without it the result has no run time. A run that diverges ends early and says so in its status.
    """
    check_seed(seed)
    has = features(scene)
    plants = [(plant.move, plant.force, plant.c) for plant in slave_plants(scene)]
    forth, back = link_plans(scene, seed)
    lag = max((plan.lag for plan in (forth, back) if plan is not None), default=0)
    rows: dict[str, list[float]] = {"m": [], "s": []}
    loop = compiled(scene, loop_text(scene), "loop")
    arguments = (
        scene, scene.law, scene.dt_ns / 1e9, scene.ticks, scene.x_limit,
        scene.vector("start_m", scene.start_m), scene.vector("start_s", scene.start_s),
        back and back.play, forth and forth.play, lag + 1,
        reference_samples(scene), master_plant(scene), plants, rows["m"].extend, rows["s"].extend,
    )
    began = clock() if clock else 0
    ran, capped, end = loop(*arguments)
    took = clock() - began if clock else None
    records = {
        e: EndRecord(range(ran), rows[e], None if plan is None else plan.play[:ran])
        for e, plan in (("m", back), ("s", forth))
    }
    trace = assemble(scene, records)
    status, sentence = verdict(scene, trace, ran, end)
    packets = {
        "forth": Packets.of_plan(forth) if forth else Packets.without_link(ran),
        "back": Packets.of_plan(back) if back else Packets.without_link(ran),
    }
    notes = [f"{capped} ticks had more contact events than are followed in one tick"] if capped else []
    if "waves" in has and "repeats" in has:
        notes.append("playout holds waves in the gaps, which is active: E_link may fall below zero")
    return Result.make(scene, seed=seed, mode="virtual", status=status, sentence=sentence, ticks=ran,
                       run_time=None if took is None else took / 1e9, trace=trace, packets=packets, notes=notes)


def check_seed(seed: int) -> None:
    """Refuse what does not key the dice."""
    if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed < 1 << 64:
        raise Refused(f"seed must be a whole number from 0 to 2^64-1, not {seed!r}; write --seed 1")


def link_plans(scene: Scene, seed: int) -> tuple[Plan | None, Plan | None]:
    """What the link and the playout make of each direction: the packet played at every tick."""
    if scene.link is None:
        return None, None
    from teleop.playout import plan

    plans = []
    for direction in (0, 1):
        arrivals = scene.link.arrivals(direction, scene.ticks, scene.dt_ns, seed, scene.wire_size)
        plans.append(plan(scene.playout, arrivals.packet, arrivals.time_ns, scene.ticks, scene.dt_ns))
    return plans[0], plans[1]


def verdict(scene: Scene, trace: dict[str, Any], ran: int, end: Any) -> tuple[str, str]:
    """The run's status and its sentence. `end` is None, or the positions that left the bounds."""
    if end is None:
        return "ok", f"ran to its end, {ran} ticks of {scene.dt:g} s"
    from math import isfinite

    for name in ("f_m", "f_s"):
        if not all(map(isfinite, trace[name][-1:].ravel())):
            return "diverged", divergence(scene, ran - 1, f"{name} is not finite")
    far = [name for name, xs in zip(("x_m", "x_s"), end, strict=True) if not all(abs(x) < scene.x_limit for x in xs)]
    return "diverged", divergence(scene, ran - 1, f"{far[0]} passed {scene.x_limit:g} m")


def divergence(scene: Scene, k: int, what: str) -> str:
    """The sentence of a run that diverged at tick k."""
    when = f"diverged at t = {k * scene.dt_ns / 1e9:g} s (tick {k})"
    return f"{when}: {what}; a smaller dt, gain or delay may hold it"
