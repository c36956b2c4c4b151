"""The two ends of a live run put together, and what a killed process left made whole."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from teleop.errors import Refused
from teleop.live.record import FILE, read_events, read_noted
from teleop.live.summary import NAMES, WAYS, end_result
from teleop.lockstep import packet_counts, standing_notes
from teleop.result import Packets, Result
from teleop.scene import Scene, load_scene
from teleop.trace import assemble


def scene_of(folder: Path) -> Scene:
    """The scene that the live end in `folder` ran. Raises `Refused`."""
    return _scene(read_noted(folder)[0])


def merge(scene: Scene, master: Path, slave: Path, *, channel: dict[str, Any] | None = None) -> Result:
    """One result from the folders of the two ends of a run of `scene`, at the ticks that both ran. Raises `Refused`.

    `channel` is what the relay counted, if it is known. What an end did not write down itself, having been
    killed, is worked out from its record.
    """
    folders = {"m": master, "s": slave}
    headers, records, ends = {}, {}, {}
    for e, folder in folders.items():
        headers[e], records[e], *_ = read_noted(folder)
        if headers[e]["end"] != e:
            other = NAMES[headers[e]["end"]]
            raise Refused(f"{folder} is of a {other}; give the master's folder first, then the slave's")
        ends[e] = _summary(folder)
    ours, theirs = headers["m"], headers["s"]
    stepped = ours["mode"] == "lockstep"  # by the clock, the seed is the channel's alone
    if any(ours[key] != theirs[key] for key in ("scene", "knobs", "mode", *["seed"] * stepped)):
        raise Refused(f"{master} and {slave} are not the two ends of one run; give two that ran together")
    met = [{event["why"] for event in read_events(folder) if event.get("what") == "met"} for folder in folders.values()]
    if all(met) and not met[0] & met[1]:
        raise Refused(f"{master} and {slave} never met; give two that ran together")
    if scene.link is None:
        records = {e: record._replace(played=None) for e, record in records.items()}
    trace = assemble(scene, records)
    again = any(event.get("what") == "session" for folder in folders.values() for event in read_events(folder))
    if again:
        trace.pop("E_link", None)  # each end's sums begin anew with a session, at a tick of its own
    status, sentence = _verdict(ends)
    packets = packet_counts(scene, ours["seed"], len(trace["t"])) if stepped else _counted(ends, channel or {})
    took = [end[NAMES[e]].get("run_time") for e, end in ends.items()]
    run_time = max((time for time in took if time is not None), default=None)
    extra = {**{NAMES[e]: end[NAMES[e]] for e, end in ends.items()}, "channel": channel}
    notes = standing_notes(scene)
    if again:
        notes.append("the two met more than once: their ledgers begin anew each time, so there is no E_link of it all")
    notes += [f"{NAMES[e]}: {note}" for e, end in ends.items() for note in end["notes"]]
    return Result.make(scene, seed=ours["seed"], mode=ours["mode"], status=status, sentence=sentence,
                       ticks=len(trace["t"]), run_time=run_time, trace=trace, packets=packets, notes=notes, extra=extra)


def recover(folder: Path) -> None:
    """Make the summary.json and trace.npz of a live folder whose process did not come to it. Raises `Refused`."""
    ends = [folder / name for name in NAMES.values()]
    if all((end / FILE).is_file() for end in ends):
        result = merge(scene_of(ends[0]), *ends)
        command: list[str] = []
    else:
        header, record, late, notes = read_noted(folder)
        if not record.ticks:
            raise Refused(f"{folder} holds the record of a run that never came to its first tick")
        e, scene = header["end"], _scene(header)
        sentence = f"the process ended without a word after tick {record.ticks[-1]}; this is made from its record"
        every = header.get("every", 1)
        events = read_events(folder)
        first = next((event["k"] for event in events if event.get("what") == "joined"), 0)
        skipped = (record.ticks[-1] - first) // every + 1 - len(record.ticks)
        sends, hears = WAYS[e]
        came = sum(1 for packet in record.played or () if packet >= 0)
        result = end_result(
            scene, e, record, late, seed=header["seed"], mode=header["mode"], status="stopped", sentence=sentence,
            told={"skipped": skipped, "events": events}, notes=notes, first=first, every=every,
            packets={sends: Packets(sent=len(record.ticks)), hears: Packets(received=came)},
        )
        command = header["command"]
    result.write(folder, command)


def _scene(header: dict[str, Any]) -> Scene:
    return load_scene(header["scene"], **header["knobs"])


def _summary(folder: Path) -> dict[str, Any]:
    if not (folder / "summary.json").is_file():
        recover(folder)
    summary: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    return summary


def _counted(ends: dict[str, dict[str, Any]], channel: dict[str, Any]) -> dict[str, Packets]:
    """What the two ends and the channel counted of each direction."""
    packets = {}
    for e, peer in (("m", "s"), ("s", "m")):
        way = WAYS[e][0]
        sent = ends[e]["packets"][way]["sent"]
        heard = Packets(**ends[peer]["packets"][way])
        lost = channel.get("counts", {}).get(way, {}).get("lost", 0)
        packets[way] = replace(heard, sent=sent, lost=lost, in_flight=max(0, sent - heard.received - lost))
    return packets


def _verdict(ends: dict[str, dict[str, Any]]) -> tuple[str, str]:
    """The status of the whole: what one end found out, the other was told."""
    silent = [end for end in ends.values() if "without a word" in end["sentence"]]
    for status in ("diverged", "stopped"):
        for end in (*silent, *ends.values()):  # that one was killed comes before what the others say of it
            if end["status"] == status:
                return status, str(end["sentence"])
    return "ok", str(ends["m"]["sentence"])
