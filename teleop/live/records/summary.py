"""What a live end leaves in its folder beside its record: trace.npz and summary.json, as every run does."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from teleop.errors import Refused
from teleop.live.process.realtime import sentence
from teleop.live.records.record import FILE, read_events, read_noted
from teleop.protocol.endpoint import SLEW
from teleop.protocol.estimates import LinkEstimates, Times
from teleop.simulation.outcome import age_note
from teleop.simulation.packets import Packets
from teleop.simulation.prepared import prepare
from teleop.simulation.result import Result
from teleop.simulation.trace import far_apart

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from teleop.live.shell import Shell
    from teleop.scene.scene import Scene
    from teleop.simulation.trace import EndRecord

INSECURE = "the link was neither authenticated nor encrypted, beyond loopback, as --insecure asked"
UNWATCHED = ("the device has neither a deadline nor a watchdog: if this process is killed, stopped or hangs, its force "
             "stays on; see teleop/live/devices/README.md")
FEWEST_NS = 3_000_000_000  # of two clocks beside each other, before their rates are judged
NAMES = {"m": "master", "s": "slave"}
WAYS = {"m": ("fwd", "bwd"), "s": ("bwd", "fwd")}  # the direction an end sends in, and the other


def write_end(shell: Shell, folder: Path, seed: int, command: list[str]) -> Result:
    """Write trace.npz, from the record in `folder`, and summary.json; returns the end's own result.

    Raises `Refused` if the disk takes no more; the record as far as it came is left there.
    """
    try:
        result = _result(shell, folder, seed)
        result.write(folder, command)
    except OSError as error:
        for name in ("trace.npz", "summary.json"):
            with suppress(OSError):
                (folder / name).unlink(missing_ok=True)
        raise Refused(
            f"{shell.sentence}, but its summary could not be written ({error.strerror or error}); what was recorded "
            f"is in {folder / FILE}: free some space, and `teleop report {folder}` makes the rest of it"
        ) from error
    return result


def _result(shell: Shell, folder: Path, seed: int) -> Result:
    scene, endpoint, session = shell.scene, shell.endpoint, shell.endpoint.session
    _, record, late, cut = read_noted(folder)
    inbox: Any = endpoint.inbox
    earlier = endpoint.counted
    sends, hears = WAYS[endpoint.e]
    heard = Packets(
        received=earlier["received"] + getattr(inbox, "received", endpoint.received), rejected=dict(endpoint.rejected),
        **{name: earlier[name] + getattr(inbox, name, 0) for name in ("late", "overtaken", "duplicates")},
    )
    told = {
        "skipped": shell.skipped, **_estimates(endpoint.link, session.peer_every),
        "sessions": session.met, "safe_entries": endpoint.guard.entries, "events": read_events(folder),
        "clock": {"start_ns": session.start_ns, "offset_ns": session.offset_ns,
                  "uncertainty_ns": None if session.rtt_ns is None else session.rtt_ns // 2},
        "stamp_margin": endpoint.stamp_margin, "cpu": shell.cpu, "run_time": shell.run_time,
        "unsent": shell.wire.unsent, "dropped_by_system": shell.dropped,
        "refused": earlier["refused"] + getattr(inbox, "refused", 0),
        **_security(shell), **({} if shell.realtime is None else {"realtime": shell.realtime}),
    }
    guard = endpoint.guard
    old = [age_note(NAMES[endpoint.e], guard.old, guard.oldest, guard.age)] if guard.old and guard.age else []
    return end_result(
        scene, endpoint.e, record, late, seed=seed, mode="lockstep" if endpoint.stepped else "live",
        status=shell.status, sentence=shell.sentence, told=told,
        packets={sends: Packets(sent=shell.data_sent), hears: heard}, first=shell.first, every=endpoint.every,
        notes=[*old, *cut, *[INSECURE] * shell.insecure, *[UNWATCHED] * holds_on(shell),
               *filter(None, [shell.recorder.trouble, clock_note(endpoint.link)]),
               *([sentence(shell.realtime)] if shell.realtime else [])],
    )


def end_result(
    scene: Scene, e: str, record: EndRecord, late: Any, *, seed: int, mode: str, status: str, sentence: str,
    told: dict[str, Any], packets: dict[str, Packets], notes: Sequence[str], first: int = 0, every: int = 1,
) -> Result:
    """One end's part of a run as a result of its own: its columns, and the figures that they are enough for.

    `first`: the first tick that was due; `every`: and then every so many.
    """
    from teleop.simulation.trace import Columns, end_columns, seconds

    trace = Columns({"t": lambda: seconds(record.ticks, scene.dt_ns), **end_columns(prepare(scene), e, record).makers,
                     f"late_{e}": lambda: _scaled(late, 1e9)})
    own = {
        "status": status, "sentence": sentence, "ticks": len(record.ticks), **told,
        "late_us": spread_us(lateness(record.ticks, late, scene.dt_ns, first, every)),
    }
    return Result.make(scene, seed=seed, mode=mode, status=status, sentence=sentence, ticks=len(record.ticks),
                       run_time=None, trace=trace, packets=packets, notes=notes, extra={"end": NAMES[e], NAMES[e]: own})


def lateness(ticks: Any, late: Any, dt_ns: int, first: int = 0, every: int = 1) -> NDArray[np.float64]:
    """How late (ns) each tick was that was due, those that were skipped for a late one included.

    `late` is that of the ticks that ran, each against its own instant; the skipped ones before it were due
    that much and one tick more, two ticks more, ... before. Nothing is told where too many were (`far_apart`).

    >>> lateness([0, 3], [5.0, 7.0], 100).tolist()
    [5.0, 7.0, 107.0, 207.0]
    """
    import numpy as np

    own = np.asarray(late, dtype=float)
    if far_apart(ticks, first):
        return own[:0]
    due = np.asarray(np.diff(np.asarray(ticks, dtype=np.int64), prepend=first - every), dtype=np.int64)
    due //= every
    if (due == 1).all():
        return own
    ends = np.add.accumulate(np.maximum(due, 0, out=due))
    out = np.repeat(own, due)
    for i in np.flatnonzero(due > 1):
        out[ends[i] - due[i] : ends[i]] += np.arange(due[i]) * (every * dt_ns)
    return out


def spread_us(late: Any) -> dict[str, float]:
    """Median, 99th percentile and most (us) of latenesses in ns; nothing of none."""
    import numpy as np

    late_us = _scaled(late, 1e3)
    return {f"p{q}": float(np.percentile(late_us, q, overwrite_input=True)) for q in (50, 99, 100)} \
        if len(late_us) else {}


def _scaled(column: Any, divisor: float) -> NDArray[np.float64]:
    import numpy as np

    out: NDArray[np.float64] = np.array(column, dtype=float)
    out /= divisor
    return out


def _estimates(link: LinkEstimates, every: int) -> dict[str, Any]:
    """What the packets told of the link and of the peer's clock; s, and the drift as a fraction."""
    offset = link.clock.offset_ns
    return {"delay": _seconds(link.way), "rtt": _seconds(link.rtt), "jitter": link.jitter_ns / 1e9,
            "lost": link.lost(every), "reordered": link.reordered,
            "peer_clock": None if offset is None else {
                "offset": offset / 1e9, "drift": link.clock.drift, "moved": link.clock.shift_ns / 1e9}}


def clock_note(link: LinkEstimates) -> str | None:
    """A sentence if the peer's clock goes at another rate than a slave's grid can follow; None if it does not.

    Judged by what of the change of the offset the ways cannot explain, so a link whose delays change is not taken for a
    clock; before `FEWEST_NS` have been seen nothing is said. Of several sessions the one that moved most.
    """
    clock = link.parted
    seen = clock.seen_ns - clock.since_ns
    apart = abs(clock.shift_ns) - seen // SLEW
    if seen < FEWEST_NS or apart <= clock.band_ns:
        return None
    rate = clock.drift if clock.drift is not None else clock.shift_ns / seen
    pace = "faster" if rate > 0.0 else "slower"
    return (f"the other end's clock goes {abs(rate) * 1e6:,.0f} ppm {pace} than this one's, and a slave's grid of "
            f"ticks follows {1e6 / SLEW:.0f} ppm: in {seen / 1e9:.0f} s the two grids came apart by {apart / 1e6:.1f} "
            "ms, by which delays and ages as told, a fixed playout and the tracking error are wrong, until the two "
            "begin a new session for it; have a time service (NTP, PTP) keep both clocks, or mend the one that is off")


def holds_on(shell: Shell) -> bool:
    """Does nothing let go of its device if this process cannot? Simulated devices of stepped ends need nothing."""
    return not shell.endpoint.stepped and getattr(shell.stand.device, "deadline", None) is None


def live_numbers(shell: Shell) -> dict[str, Any]:
    """What the live line shows; the lateness is the most since this was asked last."""
    assert shell.shown is not None
    reading, force = shell.shown
    late, shell.late_most = shell.late_most, 0
    link, guard = shell.endpoint.link, shell.endpoint.guard
    return {
        "end": shell.endpoint.e, "k": shell.ran, "x": reading.x[0], "f": force[0], "late_us": late / 1e3,
        "delay": link.way.recent / 1e9 if link.way.count else None, "gain": guard.gain, "cause": guard.cause,
        "rtt": link.rtt.recent / 1e9 if link.rtt.count else None, "jitter": link.jitter_ns / 1e9,
        "loss": link.loss(shell.endpoint.session.peer_every),
    }


def _security(shell: Shell) -> dict[str, Any]:
    """How the link was kept: sealed, and what of it was dropped; or open, on loopback or because it was asked for."""
    line = shell.wire.line
    if line is None:
        return {"sealed": False}
    return {"sealed": True, "associations": line.associations,
            "dropped": {str(cause): count for cause, count in line.dropped.items()}}


def _seconds(times: Times) -> dict[str, float] | None:
    if not times.count:
        return None
    return {"mean": times.total / times.count / 1e9, "least": times.least / 1e9, "most": times.most / 1e9}
