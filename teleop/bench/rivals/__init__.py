"""The cost of a scenario-step of a sweep (one scene, one tick of 1 ms) beside the usual ways to work it out.

The canonical scene on one thread: wave law over 50 ms each way, the slave against a wall. Each rival is as cheap as we
could get it with an error of at most 1e-6 m in either handle's position, and that error is measured and printed:

- numpy, a whole batch of rows at a time: against the exact sampled scene, twice. Once with the instants of contact
  located and closed-form steps between them, which takes the mathematics of `teleop.physics.contact` and is far the
  cheapest; once as it is mostly written, in sub-steps of a fixed length, as few as the accuracy allows.
- python-control: against the exact sampled scene.
- jitcdde: against itself at a far tighter tolerance, because it solves another problem. See its module.

All are measured in turn in the same rounds, each the best of three; a ratio is the median over rounds. Set-up and
compiling are never counted. Ours works out the energy ledgers besides, the rivals do not.
"""

from __future__ import annotations

from statistics import median

from teleop.bench.rivals import control, jitcdde, numpy_batch
from teleop.bench.rivals.rival import Absent, Rival, best_seconds, ours
from teleop.sweeps.engine import need_compiler

Row = tuple[str, str, str]
RIVALS = (numpy_batch.located_batch, numpy_batch.stepped_batch, jitcdde.rival, control.rival)


def rivals(rounds: int) -> list[Row]:
    """Rows of (what, measured, asked or error)."""
    need_compiler("vector")
    engine, steps, run = ours()
    present: list[Rival] = []
    absent: list[Row] = []
    for make in RIVALS:
        try:
            present.append(make())
        except Absent as missing:
            absent.append((str(missing), "not measured", ""))
    ours_ns: list[float] = []
    theirs: list[list[float]] = [[] for _ in present]
    for _ in range(rounds):
        ours_ns.append(best_seconds(lambda: run) / steps * 1e9)
        for times, one in zip(theirs, present, strict=True):
            times.append(best_seconds(one.ready) / one.steps * 1e9)
    rows = [(f"ours, {engine} engine, a scenario-step", f"{median(ours_ns):.1f} ns", "exact")]
    for times, one in zip(theirs, present, strict=True):
        ratio = median(b / a for a, b in zip(ours_ns, times, strict=True))
        rows.append((one.what, f"{median(times):.1f} ns", f"error {one.error:.1e} m"))
        rows.append(("  over ours", f"{ratio:.1f} times", f"asked: at least {one.bound}"))
        rows += [(f"  {what}", value, "") for what, value in one.notes]
    return rows + absent
