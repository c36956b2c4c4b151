"""The table of a run, as a person reads it in a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any

from teleop.errors import number_of
from teleop.simulation.metrics import resolved
from teleop.simulation.plan import Packets
from teleop.simulation.result import Result, law_with_gains
from teleop.terminal.table import facts, si

_DIRECTIONS = ("fwd", "bwd")
_LATE = (("half under", "p50"), ("99 % under", "p99"), ("at most", "p100"))
_MODE = {"virtual": "virtual time", "lockstep": "live in lockstep", "live": "live"}
_COUNTS = (("lost", "lost"), ("late", "late"), ("overtaken", "overtaken"), ("duplicates", "doubled"),
           ("in_flight", "under way at the end"))


def table(result: Result) -> str:
    """The run in a few lines: what it was, how it ended, and the metrics that its scene has."""
    return facts([("run", what(result)), ("status", verdict(result)), *rows(result)])


def rows(result: Result) -> Iterator[tuple[str, str]]:
    """The figures of a run and its notes, each with its label."""
    shown = replace(result, metrics=resolved(result.metrics))
    yield from ((label, text) for label, tell in _ROWS for text in tell(shown))
    yield from (("note", note) for note in result.notes)


def what(result: Result) -> str:
    """Scene and law, how it ran, and its seed."""
    return f"{heading(result)}, {_MODE.get(result.mode, result.mode)}, seed {result.seed}"


def heading(result: Result) -> str:
    """Scene and law with its gains."""
    return f"{result.scene}, law {law_with_gains(result.parameters.get('law'))}"


def verdict(result: Result) -> str:
    """The status and its sentence, which may begin with the status itself."""
    return result.sentence if result.sentence.startswith(result.status) else f"{result.status}: {result.sentence}"


MIXED = "over axes in m and in rad"  # what a figure without a unit is


def _error(key: str, unit: str) -> Callable[[Result], Iterator[str]]:
    def tell(result: Result) -> Iterator[str]:
        got = result.metrics
        if {f"{key}_rms", f"{key}_max"} <= got.keys():
            unit_of_axes = result.labels.unit(unit)
            over = "" if unit_of_axes else f", {MIXED}"
            yield f"{si(got[f'{key}_rms'], unit_of_axes)} rms, {si(got[f'{key}_max'], unit_of_axes)} max{over}"

    return tell


def _force(result: Result) -> Iterator[str]:
    unit = result.labels.unit("N")
    words = [f"{si(result.metrics[name], unit)} {word}"
            for name, word in (("f_m_end", "felt"), ("f_env_end", "touched")) if name in result.metrics]
    if words:
        yield ", ".join(words) + ", mean over the last 0.1 s" + ("" if unit else f", {MIXED}")


def _perceived(result: Result) -> Iterator[str]:
    """Perceived inertia and drag of a free slave, beside the master itself, and perceived stiffness of a contact."""
    got, unit = result.metrics, result.labels.unit
    if "felt_fit" in got and result.ticks * result.dt >= _LEAST_MOTION:
        # A force k x against a motion at w is, in a fit of mass and drag, a mass of -k/w^2; the hold of a drag B is one
        # of -B dt/2, and no spring. Nor is there one where the motion grows, or where the fit leaves half unexplained.
        springs = (got["felt_mass"] < -abs(got["felt_drag"]) * result.dt and got["felt_fit"] > 0.5
                   and result.status != "diverged")
        yield (f"in free space it adds {got['felt_drag']:.3g} {unit('N s/m')} of drag and {got['felt_mass']:.3g} "
               f"{unit('kg')} of apparent mass to the master (fit {100.0 * got['felt_fit']:.0f} %)"
               + ("" if unit("kg") else f", {MIXED}")
               + (f"; less than 0 {unit('kg')}: it pulls back as a spring does" if springs and unit("kg") else ""))
    if "felt_share" in got:
        over = "" if unit("N/m") else f", {MIXED}"
        yield (f"a stiffness of {si(got['felt_stiffness'], unit('N/m'))}, {100.0 * got['felt_share']:.3g} % of what is "
               f"touched{over}")


def _energy(key: str) -> Callable[[Result], Iterator[str]]:
    def tell(result: Result) -> Iterator[str]:
        # A run that diverges may end with a sum that is not finite, and then has no metric of its end.
        words = [f"{si(result.metrics[name], 'J')} {word}"
                for name, word in ((f"{key}_min", "smallest"), (f"{key}_end", "at the end")) if name in result.metrics]
        if words:
            yield ", ".join(words)

    return tell


def _delay(result: Result) -> Iterator[str]:
    got = result.metrics
    heard = [way for way in _DIRECTIONS if f"fresh_{way}" in got]  # of one end alone, one way
    if heard:
        yield ", ".join(f"{_seen(got, way)} {way}" for way in heard)


def _seen(got: Mapping[str, float], way: str) -> str:
    if not {f"T_{way}_mean", f"T_{way}_max"} <= got.keys():
        return "nothing came"
    mean, most = got[f"T_{way}_mean"], got[f"T_{way}_max"]
    return si(mean, "s") if most - mean < 1e-9 else f"{si(mean, 's')} (up to {si(most, 's')})"


def _queue(result: Result) -> Iterator[str]:
    got = result.metrics
    ways = [way for way in _DIRECTIONS if {f"queue_{way}_max", f"queue_{way}_end"} <= got.keys()]
    if not any(got[f"queue_{way}_max"] >= _LEAST_QUEUE for way in ways):
        return  # nothing of the link came at another time, and a wave takes the delay
    yield ", ".join(f"{si(got[f'queue_{way}_end'], 's')} (up to {si(got[f'queue_{way}_max'], 's')}) {way}"
                    for way in ways) + " at the end"
    yield "so a wave takes " + ", ".join(
        f"{si(got[f'T_{way}_mean'] + got[f'queue_{way}_end'], 's')} {way}" for way in ways) + ", delay and queue"


def _packets(result: Result) -> Iterator[str]:
    for way in _DIRECTIONS:
        if f"fresh_{way}" in result.metrics and way in result.packets:
            yield f"{way}: {_counts(result.packets[way])}"


def _counts(packets: Packets) -> str:
    words = [f"{packets.sent} sent"] * (packets.sent > 0) + [f"{packets.received} received"]
    if packets.saved:
        words.insert(1, f"{packets.saved} saved")
    for key, word in _COUNTS:
        count = getattr(packets, key)
        words += [f"{count} {word}"] * (count > 0 or key in ("lost", "late"))
    words += [f"{count} rejected ({cause})" for cause, count in packets.rejected.items() if count]
    return ", ".join(words)


def _watchdog(result: Result) -> Iterator[str]:
    fell = [(end, result.metrics[f"g_{e}_min"]) for end, e in (("master", "m"), ("slave", "s"))
            if f"g_{e}_min" in result.metrics]
    if any(gain < 1.0 for _, gain in fell):
        yield "let go: smallest gain " + ", ".join(f"{gain:.0%} at the {end}" for end, gain in fell)


def _link(result: Result) -> Iterator[str]:
    # An end does not know what the other end's deadband did not send, but that there is one.
    missing = "missing or not sent" if any(each.saved for each in result.packets.values()) else "missing"
    for end, report in _live_ends(result):
        rtt, clock = report.get("rtt"), report.get("peer_clock") or {}
        if not rtt:
            continue
        text = f"{end}: round trip {si(rtt['mean'], 's')}, jitter {si(report['jitter'], 's')}, "
        text += f"{report['lost']} {missing}, {report['reordered']} out of order"
        drift = clock.get("drift")
        yield text + ("" if drift is None else f"; the peer's clock goes {drift * 1e6:+.0f} ppm")


def _safe(result: Result) -> Iterator[str]:
    for end, report in _live_ends(result):
        events = [event for event in report.get("events") or () if event.get("what") in ("safe", "joined")]
        for event in events[:_MOST_EVENTS]:
            yield f"{end}: {event['what']} at t = {event['k'] * result.dt:.3f} s, {event['why']}"
        if (hidden := len(events) - _MOST_EVENTS) > 0:
            yield f"{end}: and {number_of(hidden, 'time')} more, see its events.jsonl"


def _late_ticks(result: Result) -> Iterator[str]:
    for end, report in _live_ends(result):
        late = report.get("late_us") or {}
        text = f"{end}: {report.get('skipped', 0)} skipped"
        yield text + "".join(f", {word} {si(late[q] * 1e-6, 's')} late" for word, q in _LATE if q in late)


def _scheduling(result: Result) -> Iterator[str]:
    """Real-time scheduling that the system gave each live end; once, where both have the same.

    Of an end that left no summary it is not known.
    """
    scheduling = {end: ", ".join(f"{name} {what}" for name, what in report["realtime"].items())
            if report.get("realtime") else "ordinary scheduling, real-time scheduling was not asked for"
            for end, report in _live_ends(result)
            if "sealed" in report}
    if len({*scheduling.values()}) == 1 and len(scheduling) > 1:
        yield f"both ends: {next(iter(scheduling.values()))}"
    else:
        yield from (f"{end}: {text}" for end, text in scheduling.items())


def _integration(result: Result) -> Iterator[str]:
    unit = result.labels.unit("m") or "m or rad"
    for end, report in dict(result.extra.get("integration") or {}).items():  # type: ignore[call-overload]  # a mapping
        text = f"{end}: error estimated at {si(float(report['error_estimate_max']), unit)} a tick"
        text += f" ({si(float(report['error_estimate_sum']), unit)} added up), "
        text += f"up to {number_of(report['substeps_max'], 'sub-step')}"
        over = report["ticks_over_tolerance"]
        yield text + (f"; {number_of(over, 'tick')} above {si(report['tolerance'], unit)}" if over else "")


def _per_tick(result: Result) -> Iterator[str]:
    ends = [f"{si(report['cpu'] * result.dt, 's')} {end}" for end, report in _live_ends(result) if report.get("cpu")]
    if ends:
        yield ", ".join(ends) + " of processor time"
    elif result.run_time and result.ticks and (each := result.run_time / result.ticks) > 0.0:
        yield f"{si(each, 's')}, {result.dt / each:.3g} times real time"


def _live_ends(result: Result) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Reports of the ends of a live run on their own ticks; in lockstep there is nothing to be late for."""
    for end in ("master", "slave"):
        report = result.extra.get(end)
        if result.mode == "live" and isinstance(report, Mapping):
            yield end, report


_LEAST_MOTION = 1.0  # s: of a shorter run mass and drag are those of its first transients
_LEAST_QUEUE = 1e-9  # s: what is less is rounding
_MOST_EVENTS = 5  # shown of each end

_ROWS: tuple[tuple[str, Callable[[Result], Iterator[str]]], ...] = (
    ("tracking error", _error("x_err", "m")),
    ("angle error", _error("angle_err", "rad")),
    ("force error", _error("f_err", "N")),
    ("force at the end", _force),
    ("felt", _perceived),
    ("delay seen", _delay),
    ("queue", _queue),
    ("packets", _packets),
    ("link seen", _link),
    ("safe state", _safe),
    ("watchdog", _watchdog),
    ("late ticks", _late_ticks),
    ("real time", _scheduling),
    ("link energy", _energy("E_link")),
    ("port energy", _energy("E_port")),
    ("law energy", _energy("E_law")),
    ("integration", _integration),
    ("time per tick", _per_tick),
)
