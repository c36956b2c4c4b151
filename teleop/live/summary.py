"""Summary of a live end in its folder, beside its record: trace.npz and summary.json, as of every run."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

from teleop.errors import Refused, enumerated, number_of, plural
from teleop.live.process.realtime import is_refused
from teleop.live.records.end_result import NAMES, WAYS, end_result
from teleop.live.records.reader import FILE, read_noted
from teleop.live.records.record import read_events
from teleop.live.shell import Shell
from teleop.protocol.endpoint import SLEW
from teleop.protocol.estimates import LinkEstimates, Times
from teleop.scene.playout import integrates
from teleop.scene.scene import Scene
from teleop.simulation.ending import Ending, age_note
from teleop.simulation.notes import in_gaps
from teleop.simulation.plan import Packets
from teleop.simulation.result import Result

INSECURE = "the link was neither authenticated nor encrypted, beyond loopback, as --insecure asked"
UNWATCHED = ("the device has neither a deadline nor a watchdog: if this process is killed, stopped or hangs, its force "
             "stays on; see teleop/live/devices/README.md")
MISSED = 0.01  # share of the ticks, from which on a note says that they were left out
FEWEST_NS = 3_000_000_000  # of two clocks beside each other, before their rates are judged


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
            f"{shell.outcome.sentence}, but its summary could not be written ({error.strerror or error}); what was "
            f"recorded is in {folder / FILE}: free some space, and `teleop report {folder}` makes the rest of it"
        ) from error
    return result


def _result(shell: Shell, folder: Path, seed: int) -> Result:
    scene, endpoint, session = shell.scene, shell.endpoint, shell.endpoint.session
    _, record, late, cut = read_noted(folder)
    inbox: Any = endpoint.inbox
    earlier = endpoint.counted
    scheduling = None if shell.realtime is None else shell.realtime.report
    sends, hears = WAYS[endpoint.e]
    heard = Packets(
        received=earlier["received"] + getattr(inbox, "received", endpoint.received), rejected=dict(endpoint.rejected),
        **{name: earlier[name] + getattr(inbox, name, 0) for name in ("late", "overtaken", "duplicates")},
    )
    facts = {
        "skipped": shell.counts.skipped, **_estimates(endpoint.link, session.peer_every),
        "sessions": session.met, "safe_entries": endpoint.guard.entries, "events": read_events(folder),
        "clock": {"start_ns": session.start_ns, "offset_ns": session.offset_ns,
                  "uncertainty_ns": None if session.rtt_ns is None else session.rtt_ns // 2},
        "stamp_margin": endpoint.stamp_margin, "cpu": shell.counts.cpu, "run_time": shell.counts.run_time,
        "unsent": shell.wire.unsent, "dropped_by_system": shell.counts.dropped,
        "refused": earlier["refused"] + getattr(inbox, "refused", 0),
        **_security(shell), **({} if scheduling is None else {"realtime": scheduling}),
    }
    guard = endpoint.guard
    old = [age_note(NAMES[endpoint.e], guard.old, guard.oldest, guard.age)] if guard.old and guard.age else []
    total = shell.counts.skipped + shell.counts.ticks
    notes = [*old, *getattr(shell.device.device, "notes", ()), *cut, *[INSECURE] * shell.insecure,
             *[UNWATCHED] * holds_on(shell), shell.recorder.trouble, shell.recorder.inputs.trouble,
             clock_note(endpoint.link),
             sums_note(endpoint.rejected["integrals"], NAMES["s" if endpoint.e == "m" else "m"]),
             reading_note(shell.counts.in_read, shell.counts.longest_read, total),
             missed_note(shell.counts.skipped, total, endpoint.end_scene, scheduling)]
    return end_result(
        scene, endpoint.e, record, late,
        Ending(shell.outcome.status, shell.outcome.sentence, notes=tuple(filter(None, notes))), seed=seed,
        mode="lockstep" if endpoint.stepped else "live", facts=facts,
        packets={sends: Packets(sent=shell.counts.data_sent, saved=endpoint.saved), hears: heard},
        first=shell.counts.first, every=endpoint.every,
    )


def _estimates(link: LinkEstimates, every: int) -> dict[str, Any]:
    """Estimates of the link and of the peer's clock from the packets; s, and the drift as a fraction."""
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


def sums_note(count: int, peer: str) -> str | None:
    """A sentence if `count` messages of the `other` end were not taken for their T, U and E; None of none."""
    if not count:
        return None
    were = f"{number_of(count, 'message')} of it {plural(count, 'was', 'were')}"
    return (f"the {peer}'s waves do not add up: {were} not taken, for what its waves have come to did "
            "not fit its number and the messages before; somebody changes them on the way, or the software "
            "of that end is at fault: have the link sealed (see teleop/protocol/README.md), and the same version at "
            "both ends")


def reading_note(in_read: int, longest_ns: int, due: int) -> str | None:
    """A sentence if more than `MISSED` of the `due` ticks of an end went by while its device was read; None if not."""
    if in_read <= MISSED * due:
        return None
    return (f"{in_read} of {due} ticks went by while the device was read, for up to {longest_ns / 1e6:.3g} ms at a "
            "time; have its read give what came last, without waiting for more: see teleop/live/devices/README.md")


def missed_note(skipped: int, due: int, scene: Scene, realtime: dict[str, str] | None = None) -> str | None:
    """A sentence if more than `MISSED` of the `due` ticks of an end were left out; None if not.

    `scene`: with the end's own tick. `realtime`: what the system gave of real-time scheduling, None where it was not
    asked for.
    """
    if skipped <= MISSED * due:
        return None
    choices = ["--spin", *_allow(realtime)]
    if not scene.has_waves or integrates(scene.played_as):  # others are refused at another rate
        choices.append(f"--rate {0.5 / scene.dt:g}")
    return (f"{skipped} of {due} ticks ({100.0 * skipped / due:.3g} %) were left out, as this end was not ready in "
            f"time for one every {scene.dt:g} s: the machine is busy, or its device or law is slow; the other end has "
            f"no message of these ticks: {in_gaps(scene)}; close what else runs here, or try "
            f"{enumerated(choices, 'or')}")


def _allow(realtime: dict[str, str] | None) -> list[str]:
    """Advice to allow real-time scheduling, where there was none."""
    if realtime is None:
        return ["real-time scheduling (without --no-realtime)"]
    return ["real-time scheduling (`teleop doctor` says how to allow it)"] * is_refused(realtime["scheduler"])


def holds_on(shell: Shell) -> bool:
    """True if the device holds its force when this process dies. Simulated devices of stepped ends do not count."""
    return not shell.endpoint.stepped and getattr(shell.device.device, "deadline", None) is None


def _security(shell: Shell) -> dict[str, Any]:
    """Facts on the security of the link: sealed, with counts of what was dropped; or open."""
    secure_link = shell.wire.secure_link
    if secure_link is None:
        return {"sealed": False}
    return {"sealed": True, "associations": secure_link.associations,
            "dropped": {str(cause): count for cause, count in secure_link.dropped.items()}}


def _seconds(times: Times) -> dict[str, float] | None:
    if not times.count:
        return None
    return {"mean": times.total / times.count / 1e9, "least": times.least / 1e9, "most": times.most / 1e9}
