"""What a comparison of precision leaves: a table for a person, summary.json, and the errors along the run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from teleop.analysis.precision.measure import EULER, FASTER
from teleop.analysis.precision.reference.deviation import SERIES
from teleop.errors import number_of
from teleop.terminal.answer import finite, scene_head
from teleop.terminal.run_table import heading
from teleop.terminal.table import columns, facts
from teleop.terminal.units import si

if TYPE_CHECKING:
    from teleop.analysis.precision.measure import Entry, Precision

HEAD = ("method/sub-steps", "per tick", "x_s max", "x_s rms", "x_s end", "f_env max", "f_env rms", "peak", "")
NO_TIME = "no time; a shorter duration or --rounds 1 has them"
TRACKING = (
    ("tracking error", "x_err", "m", "slave against the delayed master, whatever the method"),
    ("force error", "f_err", "N", "force felt against the force touched one delay ago"),
)


def table(got: Precision) -> str:
    """The comparison as lines of text, the stack's own steps first, then method by method from coarse to fine."""
    rows = [HEAD, *(_row(e) for e in sorted(got.entries, key=_order(got.entries)))]
    if (estimated := got.truth.estimated) is not None:
        rows[1] = (*rows[1][:-1], ", ".join([f"estimated {si(estimated, 'm')}", *filter(None, rows[1][-1:])]))
    return f"{columns(rows, left=(0, len(HEAD) - 1))}\n\n{facts(_facts(got))}"


def _order(entries: Sequence[Entry]) -> Any:
    """Methods as they came, each from coarse to fine."""
    methods = list(dict.fromkeys(e.contender.method for e in entries))
    return lambda e: (methods.index(e.contender.method), e.contender.substeps or 0, -(e.contender.rtol or 0.0))


def _row(e: Entry) -> tuple[str, ...]:
    x, f = e.errors["x_s"], e.errors["f_env"]
    sizes = [si(x.max, "m"), si(x.rms, "m"), si(x.end, "m"), si(f.max, "N"), si(f.rms, "N")]
    peak = "-" if e.peak_ratio is None else f"{e.peak_ratio:.4g}"
    return e.key, si(e.ns_per_tick * 1e-9, "s"), *("-" if "nan" in size else size for size in sizes), peak, _said(e)


def _said(e: Entry) -> str:
    """What must not be overlooked, then who beats it."""
    words = ["diverged"] * (e.status == "diverged")
    words += [f"missed {number_of(e.missed, 'contact')}"] * (e.missed > 0)
    words += [f"beaten by {e.beaten_by}"] if e.beaten_by else []
    return ", ".join(words)


def _facts(got: Precision) -> list[tuple[str, str]]:
    first, others = got.entries[0], got.entries[1:]
    beaten = sum(e.beaten_by == first.key for e in others)
    told = [
        ("run", f"{heading(got.result)}, {number_of(got.result.ticks, 'tick')}, {number_of(got.contacts, 'contact')}, "
                f"seed {got.seed}"),
        ("status", f"{got.result.status}: {got.result.sentence}"),
        ("verdict", verdict(got)),
        ("beaten means", f"another is at least as accurate in x_s and f_env and more than {FASTER:g} times faster; "
                         f"{first.key} beats {beaten} of {len(others)}"),
        *(_worth(got) if first.key == "exact" else _estimated(got)),
    ]
    if EULER in got.step_ns:
        own, euler = got.step_ns[first.key], got.step_ns[EULER]
        told.append((f"{first.key}, its cost", f"{own / euler:.2f} semi-implicit Euler steps: {own:.0f} and "
                                                f"{euler:.0f} ns to move all bodies by a tick, without the loop"))
    for label, name, unit, what in TRACKING:
        if f"{name}_rms" in got.result.metrics:
            rms, most = (si(got.result.metrics[f"{name}_{kind}"], unit) for kind in ("rms", "max"))
            told.append((label, f"{rms} rms, {most} max: {what}"))
    runs = sorted({e.runs for e in got.entries if e.contender.rtol is None})
    timing = f"whole loop, medians of {' to '.join(map(str, runs))} interleaved runs"
    scipys = any(e.contender.rtol is not None for e in got.entries)
    told.append(("timing", timing + "; scipy's one run, for the slave only" * scipys))
    return told + [("left out", f"{', '.join(keys)}: {why}") for why, keys in _left_out(got).items()]


def _worth(got: Precision) -> list[tuple[str, str]]:
    """What exact steps are worth."""
    own = got.entries[0].errors
    return [
        ("exact, one tick", got.agreement.sentence + "".join(_differences(got))),
        ("exact, the run", f"steps put off by {si(got.agreement.x, 'm')} each come to "
                           f"{si(own['x_s'].max, 'm')}, {si(own['f_env'].max, 'N')}"),
    ]


def _estimated(got: Precision) -> list[tuple[str, str]]:
    """What the stack's own integration says of its error, beside what it is."""
    own, estimates = got.entries[0].errors, got.truth.estimates

    def said(name: str) -> str:
        return ", ".join(f"{si(one[name], 'm')} ({end})" for end, one in estimates.items() if name in one)

    effort = [f"{end}: at most {one['substeps_max']:.0f} sub-steps in a tick, {one['ticks_over_tolerance']:.0f} ticks "
              "over the tolerance" for end, one in estimates.items() if "substeps_max" in one]
    return [
        ("reference", got.truth.sentence),
        ("default, one tick", f"estimated: at most {said('error_estimate_max')}; true: {got.agreement.sentence}"
                              + "".join(_differences(got))),
        ("default, the run", f"estimates sum to {said('error_estimate_sum')}; true: at most {si(own['x_s'].max, 'm')} "
                             f"in x_s, {si(own['x_m'].max, 'm')} in x_m, {si(own['f_env'].max, 'N')} in f_env"),
        *((("default, its effort", "; ".join(effort)),) if effort else ()),
    ]


def _differences(got: Precision) -> list[str]:
    return [f"; {solver} differs by at most {si(x, 'm')}, {si(v, 'm/s')}"
            for solver, (x, v) in got.agreement.differences.items()]


def _left_out(got: Precision) -> dict[str, list[str]]:
    """Who is left out, by why; what there was no time for is said once."""
    found: dict[str, list[str]] = {}
    for key, why in got.left_out.items():
        found.setdefault(NO_TIME if why.startswith("a run would take") else why, []).append(key)
    return found


def verdict(got: Precision) -> str:
    """Who is not beaten, in one sentence."""
    best = [e.key for e in got.entries if e.beaten_by is None]
    return f"not beaten: {', '.join(best)}"


def summary(got: Precision, command: Sequence[str] = ()) -> dict[str, Any]:
    """The JSON document; a number that does not exist, or has no bound, is null."""
    result = got.result
    return {
        **scene_head(got.scene, "precision", status=result.status, sentence=verdict(got), seed=got.seed,
                     command=command, also=["scipy"] if got.agreement.differences else []),
        "ticks": result.ticks, "rounds": got.rounds, "contacts": got.contacts,
        "units": {**SERIES, "ns_per_tick": "ns", "peak_ratio": "1"},
        "reference": {
            "method": got.truth.method, "sentence": got.truth.sentence,
            "off_by": {name: finite(size) for name, size in got.truth.off.items()},
            "compared": got.agreement.sentence, "ticks": got.agreement.ticks, "changes": got.agreement.changes,
            "per_tick": {s: {"x": finite(x), "v": finite(v)} for s, (x, v) in got.agreement.differences.items()},
            "put_off_by": {"x": got.agreement.x, "v": got.agreement.v}, "step_ns": dict(got.step_ns),
        },
        "estimates": {end: dict(one) for end, one in got.truth.estimates.items()},
        "tracking": {name: value for name, value in result.metrics.items() if name[:5] in ("x_err", "f_err")},
        "methods": [_entry(e) for e in got.entries],
        "left_out": dict(got.left_out), "notes": list(result.notes),
    }


def _entry(e: Entry) -> dict[str, Any]:
    c = e.contender
    return {
        "name": e.key, "method": c.method, "label": c.label, "substeps": c.substeps, "rtol": c.rtol,
        "ns_per_tick": e.ns_per_tick, "runs": e.runs, "status": e.status, "sentence": e.sentence,
        "errors": {name: {k: finite(v) for k, v in error._asdict().items()} for name, error in e.errors.items()},
        "peak_ratio": e.peak_ratio, "missed_contacts": e.missed, "beaten_by": e.beaten_by,
    }


