"""The two ends of a live run put together, and what a killed process left made whole."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from teleop.errors import Refused
from teleop.live.records.end_result import NAMES, UNRELEASED, WAYS, end_result, lateness, spread_us
from teleop.live.records.reader import FILE, check_fits, read_noted
from teleop.live.records.record import check_one_run, read_events
from teleop.scene.loading import stored_scene
from teleop.scene.scene import Scene
from teleop.simulation.ending import Ending, ending, handed_over
from teleop.simulation.notes import delay, faded, law_notes, longest, unplayed, untuned
from teleop.simulation.plan import Packets, packet_counts, round_trip
from teleop.simulation.prepared import Prepared, prepare
from teleop.simulation.result import (
    RUNNING,
    Result,
    has_record,
    incomplete,
    read_result,
    records_in,
    stored_summary,
)
from teleop.simulation.summary_shape import of_end
from teleop.simulation.trace import UNKNOWN, Columns, EndRecord, assemble, far_apart
from teleop.storage.folder import BEGUN, is_being_written
from teleop.storage.strict_json import Misshapen

LEDGERS = ("E_link", "E_port", "E_law")  # of both ends together
_MADE = "this is made from its record"  # the end of a sentence on an end that left no summary
ALONE = 1.0  # s that one end may be there before or after the other, and what both counted still belongs together


def load_result(folder: Path | str, *, trust: bool = False) -> Result:
    """The run that lies in `folder`, its trace as arrays. Raises `Refused` if there is none.

    Of a live run whose process was killed the summary is made from its record and written, see `recover`; of one that
    goes on, with the status `RUNNING`, nothing is written.

    The folder may be of unknown origin: nothing in it is run, no link is followed, and memory goes with the size of its
    files. `trust`: a scene's own file and other files that it names may be opened, see `teleop.scene.loading`.
    """
    at = Path(folder)
    return settle(at, trust=trust) or read_result(at)


def settle(at: Path, *, trust: bool = False) -> Result | None:
    """Make whole what a killed process left in the folder `at`, as `load_result` does; None if all is there now.

    Of a live run that goes on the result so far, with the status `RUNNING`.
    """
    try:
        if not has_record(at):
            if is_being_written(at):
                raise Refused(f"{at} {BEGUN}")
        elif needs_recovery(at):  # a live run whose process was killed, or goes on
            result = recover(at, trust=trust)
            if result.status == RUNNING:
                return result
    except Refused:
        raise
    except Exception as error:  # files of another kind, or cut short
        raise incomplete(at, error) from error
    return None


def scene_of(folder: Path, *, trust: bool = False) -> Scene:
    """The scene that the live end in `folder` ran, see `teleop.scene.loading`. Raises `Refused`."""
    return _scene(_noted(folder)[0], trust)


def merge(scene: Scene, master: Path, slave: Path, *, channel: dict[str, Any] | None = None) -> Result:
    """Merge the folders of the two ends of a run of `scene`, at the ticks that both ran. Raises `Refused`.

    `channel` is what the relay counted, if it is known. What an end did not write down itself, having been
    killed, is worked out from its record. Where one end ran without the other, what each counted over all of its own
    ticks is left out: only what the records show of the ticks that both ran is told, and a note says so.
    """
    folders = {"m": master, "s": slave}
    running = {e: is_being_written(folder) for e, folder in folders.items()}  # first: what is read then may grow
    headers, records, ends, late = {}, {}, {}, {}
    for e, folder in folders.items():
        headers[e], records[e], late[e], _ = _noted(folder)
    ours = headers["m"]
    stepped = ours["mode"] == "lockstep"  # by the clock, the seed is the channel's alone
    check_one_run(folders, headers, ("scene", "knobs", "mode", *["seed"] * stepped))
    for e, folder in folders.items():
        check_fits(scene, headers[e], records[e].ticks, folder)
        if running[e] or (any(running.values()) and needs_recovery(folder)):
            ends[e] = _of_one(folder, scene, False, running[e])[0].summary()
        else:
            ends[e] = _summary(folder, scene, e)
    events = {e: read_events(folder) for e, folder in folders.items()}
    met = [{event["why"] for event in noted if event.get("what") == "met"} for noted in events.values()]
    firsts, lasts = [_first(noted) for noted in events.values()], [_last(record) for record in records.values()]
    span = range(max(firsts), min(lasts) + 1)
    alone = max(max(firsts) - min(firsts), max(lasts) - min(lasts)) * scene.dt > ALONE
    apart = not stepped and (alone or met[0] != met[1] or any(_killed(end) for end in ends.values()))
    delays = {e: None if record.played is None else delay(record.ticks, record.played, scene.dt_ns / 1e9)
              for e, record in records.items()}
    if scene.link is None:
        records = {e: record._replace(played=None) for e, record in records.items()}
    trace = assemble(prepared := prepare(scene), records)
    again = _in_last_session(trace, events, span, scene.dt)
    verdict = _verdict(ends, prepared, trace, records, stepped)
    of_ends = {NAMES[e]: end[NAMES[e]] for e, end in ends.items()}
    notes = [*[UNKNOWN] * any(far_apart(record.ticks) for record in records.values())]
    if apart or any(running.values()):
        packets = {}
        of_ends = {NAMES[e]: _within(span, of_ends[NAMES[e]], headers[e], records[e], late[e]) for e in ends}
    if apart:
        notes.append("one end ran without the other for a while: the packets and round trips that each counted in all "
                     "of its own run are left out, and stand in its own folder")
    elif not any(running.values()):
        packets = packet_counts(scene, ours["seed"], len(trace["t"])) if stepped else _packets_of(ends, channel or {})
    lossy, held = any(each.lost > 0 for each in packets.values()), max(longest(each.ticks) for each in records.values())
    notes = [*untuned(scene), *law_notes(scene, delays["s"], delays["m"], lossy, held * scene.dt_ns / 1e9), *notes]
    run_time = max((end["run_time"] for end in of_ends.values() if end.get("run_time") is not None), default=None)
    if again and _met_anew(events, span):
        notes.append("the two met anew in between, and their ledgers of energy began anew: they are those of the last "
                     f"session, from t = {again * scene.dt:.3f} s on")
    notes += [*unplayed(scene, trace, packets, seed=ours["seed"], live=not stepped), *faded(scene, trace),
              *handed_over(scene, trace),
              *verdict.notes,
              *[f"{NAMES[e]}: {note}" for e, end in ends.items() for note in end["notes"]]]
    return Result.make(
        scene, verdict._replace(notes=tuple(notes)), seed=ours["seed"], mode=ours["mode"], ticks=len(trace["t"]),
        run_time=run_time, trace=trace, packets=packets, extra={**of_ends, "channel": channel})


def _in_last_session(trace: Columns, events: dict[str, list[dict[str, Any]]], span: range, dt: float) -> int:
    """Keep the ledgers of the last session alone; the tick at which that began in `span`, 0 if there was one only.

    Each end's sums begin anew with a session, at a tick of its own: in between, a difference of both is no energy.
    """
    within = span[1:]  # at its first tick there is nothing yet that another session has summed up
    again = max((one["k"] for noted in events.values() for one in noted
                 if one["what"] == "session" and one["k"] in within), default=0)
    for ledger in LEDGERS if again else ():
        if ledger in trace:
            began = (again - 0.5) * dt
            trace.makers[ledger] = partial(_from_time, trace.makers[ledger], trace.makers["t"], began)
    return again


def _met_anew(events: dict[str, list[dict[str, Any]]], span: range) -> bool:
    """True if an end met the other more than once in `span`, and not only at the begin of a part that was turned to."""
    return any(sum(one["what"] == "met" and one["k"] in span for one in noted) > 1 for noted in events.values())


def _from_time(column: Callable[[], Any], times: Callable[[], Any], t: float) -> Any:
    """`column` from the time `t` (s) on, NaN before."""
    out = column()
    out[times() < t] = float("nan")
    return out


def needs_recovery(folder: Path) -> bool:
    """True if no summary is in the live folder, or one that was made from a record that has grown since."""
    if not (folder / "summary.json").is_file():
        return True
    try:
        made_from = stored_summary(folder).get("recovered")
    except (OSError, Misshapen):  # the reader of it names what is wrong with it
        return False
    sizes = _sizes(folder)
    return made_from is not None and None not in sizes.values() and made_from != sizes


def recover(folder: Path, scene: Scene | None = None, *, trust: bool = False) -> Result:
    """Make the result of a live folder whose process wrote no summary, from its record. Raises `Refused`.

    It is written there as summary.json and trace.npz if that process has ended. If it still runs nothing is written,
    and the status is `RUNNING`. `scene`: the one that was run; left out: the folder's own, see `teleop.scene.loading`.
    """
    running, sizes = is_being_written(folder), _sizes(folder)  # both before the record is read, which may grow
    if FILE not in sizes:
        ends = [folder / name for name in NAMES.values()]
        result = merge(scene or scene_of(ends[0], trust=trust), *ends)
        command: list[str] = []
        if running and result.status != RUNNING:
            result = replace(result, status=RUNNING, sentence=f"still running: both ends are over, {result.sentence}")
    else:
        result, command = _of_one(folder, scene, trust, running)
    result = replace(result, path=folder, extra={**result.extra, "recovered": sizes})
    if result.status != RUNNING:
        result.write(folder, command)
    return result


def _sizes(folder: Path) -> dict[str, int | None]:
    """The bytes of each record in a live folder, of one end or of two; None of one that cannot be looked at."""
    names = [f"{name}/{FILE}" for name in NAMES.values()]
    sizes: dict[str, int | None] = {}
    for name in names if all((folder / name).is_file() for name in names) else [FILE]:
        sizes[name] = None
        with suppress(OSError):
            sizes[name] = (folder / name).stat().st_size
    return sizes


def _of_one(folder: Path, scene: Scene | None, trust: bool, running: bool) -> tuple[Result, list[str]]:
    """The result of one end from its record alone, and the command that it was started with."""
    import numpy as np

    if running and not (folder / FILE).is_file():
        raise Refused(f"{folder} {BEGUN}")
    header, record, late, notes = _noted(folder)
    if not len(record.ticks):
        raise Refused(f"{folder} is of a run that has not come to its first tick yet; ask again in a moment" if running
                      else f"{folder} holds the record of a run that never came to its first tick")
    e, scene = header["end"], scene or _scene(header, trust)
    check_fits(scene, header, record.ticks, folder)
    last = _last(record)
    events = read_events(folder)
    reasons = {event["what"]: event["why"] for event in events}
    how = f"after tick {last}: {reasons['stopped']}" if "stopped" in reasons else f"without a word after tick {last}"
    status, sentence = "stopped", f"the process ended {how}; {_MADE}"
    if "turned" in reasons:
        status, sentence = "ok", f"ran to t = {(last + 1) * scene.dt:.3f} s, and was turned to {reasons['turned']}"
    if running:
        status, sentence, notes = RUNNING, f"still running: this is its record up to tick {last}", []
    every = header.get("every", 1)
    first = _first(events)
    skipped = (last - first) // every + 1 - len(record.ticks)
    notes += [UNKNOWN] * far_apart(record.ticks)
    sends, hears = WAYS[e]
    received = int((np.asarray(record.played) >= 0).sum())
    result = end_result(
        scene, e, record, late, Ending(status, sentence, notes=tuple(notes)), seed=header["seed"], mode=header["mode"],
        facts={"skipped": skipped, "events": events}, first=first, every=every,
        packets={sends: Packets(sent=len(record.ticks)), hears: Packets(received=received)},
    )
    return result, header.get("command", [])


def _scene(header: dict[str, Any], trust: bool) -> Scene:
    return stored_scene(header["scene"], header["knobs"], trust=trust)


def _summary(folder: Path, scene: Scene, e: str) -> dict[str, Any]:
    """Summary of the end `e` of a run of `scene`."""
    if needs_recovery(folder):
        return recover(folder, scene).summary()
    try:
        summary = stored_summary(folder)
        of_end(NAMES[e], *WAYS[e])(summary, "summary.json")
    except (OSError, Misshapen) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise Refused(f"{folder} holds no summary of an end ({why}); remove its summary.json, and `teleop report "
                      f"{folder}` makes another from the record") from error
    return summary


def _noted(folder: Path) -> tuple[dict[str, Any], EndRecord, Any, list[str]]:
    """Read what an end wrote into `folder`; `Refused`, naming a folder that an end did write into, if none did."""
    if folder.is_symlink() and folder.name in NAMES.values():
        raise Refused(f"{folder} is a link, and what a folder links to is not opened; give the folder itself")
    if not (folder / FILE).is_file():
        inside = [path.parent for path in records_in(folder)]
        whole = {at.parent if at.name in NAMES.values() and at.parent != folder else at for at in inside}
        cure = f"one of its folders, for example {max(whole)}" if whole else "the folder that a live end wrote"
        raise Refused(f"{folder} holds no record; give {cure}")
    return read_noted(folder)


def _first(events: Sequence[dict[str, Any]]) -> int:
    """First tick that was due at an end with these events."""
    return next((int(event["k"]) for event in events if event.get("what") == "joined"), 0)


def _last(record: EndRecord) -> int:
    """The last tick that it ran; -1 of one that ran none."""
    return int(record.ticks[-1]) if len(record.ticks) else -1


def _killed(end: dict[str, Any]) -> bool:
    """True if the process of an end left no summary, so that its own was made from its record."""
    return "recovered" in end and end["status"] == "stopped"


def _within(span: range, whole: dict[str, Any], header: dict[str, Any], record: EndRecord, late: Any) -> dict[str, Any]:
    """Facts of an end in the ticks of `span`, from its record alone, without the sums of its whole run."""
    import numpy as np

    every = header.get("every", 1)
    here = (record.ticks >= span.start) & (record.ticks < span.stop)
    ticks = record.ticks[here]
    first = -(-span.start // every) * every
    facts: dict[str, Any] = {key: whole[key] for key in ("status", "sentence", "sealed", "realtime") if key in whole}
    return {
        **facts, "ticks": len(ticks), "skipped": len(range(first, span.stop, every)) - len(ticks),
        "events": [event for event in whole.get("events") or () if event.get("k") in span],
        "late_us": spread_us(lateness(ticks, np.asarray(late)[here], header["dt_ns"], first, every)),
    }


def _packets_of(ends: dict[str, dict[str, Any]], channel: dict[str, Any]) -> dict[str, Packets]:
    """Packets of each direction, as the two ends and the channel counted them.

    Where no channel has told what it lost, that is what the hearing end missed, less what was never sent: the ticks
    that the sender left out, and what its deadband saved.
    """
    packets, counts = {}, channel.get("counts")
    for e, peer in (("m", "s"), ("s", "m")):
        way = WAYS[e][0]
        sent, saved = (ends[e]["packets"][way].get(name, 0) for name in ("sent", "saved"))
        heard = Packets(**ends[peer]["packets"][way])
        if counts is None:
            missed = ends[peer][NAMES[peer]].get("lost", 0) - ends[e][NAMES[e]].get("skipped", 0) - saved
            lost = max(0, min(missed, sent - heard.received))
        else:
            lost = counts.get(way, {}).get("lost", 0)
        packets[way] = replace(heard, sent=sent, saved=saved, lost=lost, in_flight=max(0, sent - heard.received - lost))
    return packets


def _verdict(ends: dict[str, dict[str, Any]], prepared: Prepared, trace: Columns, records: dict[str, EndRecord],
             stepped: bool) -> Ending:
    """Judge how the whole run ended, from the statuses of both ends."""
    running = [NAMES[e] for e, end in ends.items() if end["status"] == RUNNING]
    if running:
        over = [f"; {NAMES[e]}: {end['sentence']}" for e, end in ends.items() if end["status"] != RUNNING]
        return Ending(RUNNING, f"still running: {' and '.join(running)}; these are the ticks that both have run"
                               f"{''.join(over)}")
    silent = [end for end in ends.values() if _killed(end)]
    for status in (UNRELEASED, "diverged", "stopped"):
        for end in (*silent, *ends.values()):  # that one was killed comes before what the others say of it
            if end["status"] == status:
                return Ending(status, str(end["sentence"]))
    sentence = str(ends["m"]["sentence"])
    if not stepped or len(trace["t"]) < prepared.scene.ticks:
        return Ending("ok", sentence)  # by the clock a person may hold the device, of whom no record tells
    return ending(prepared, trace, round_trip(record.played for record in records.values()), sentence)
