"""Commands `teleop export` and `teleop stream`."""

from __future__ import annotations

import os
import sys
from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from teleop.errors import Refused, number_of, plural
from teleop.export.stored import Part, read_parts
from teleop.simulation.result import head
from teleop.storage.files import creating
from teleop.terminal.answer import Answer
from teleop.terminal.options import DONE, complain
from teleop.terminal.table import facts, grouped
from teleop.version import __version__

EXAMPLE = "teleop export runs/hard_wall-1 --mcap hard_wall.mcap"


def export(args: Namespace) -> Answer:
    """Write a run that is over as an MCAP file, a CSV file, or both. Raises `Refused`; then neither is there."""
    from teleop.export.files import metadata_of, need_mcap, write_csv, write_mcap, write_metadata

    if args.mcap is None and args.csv is None:
        raise Refused(f"export needs a file to write, --mcap FILE or --csv FILE; type for example {EXAMPLE}")
    if args.mcap is not None:
        need_mcap()
    if args.mcap is not None and args.csv is not None and Path(args.mcap) in (Path(args.csv),
                                                                              metadata_of(Path(args.csv))):
        raise Refused(f"--mcap and --csv would both write {args.mcap}; give two names")
    left_out: list[str] = []
    parts = read_parts(Path(args.run), trust=args.trust, left_out=left_out)
    rows: list[tuple[str, str]] = [("export", _what(args.run, parts))]
    document: dict[str, Any] = {}
    with ExitStack() as files:
        if args.csv is not None:
            path = Path(args.csv)
            file, beside = (files.enter_context(_new(each)) for each in (path, metadata_of(path)))
            count = write_csv(file, parts)
            write_metadata(beside, path, parts)
            rows.append(("csv", f"{path}, {grouped(count)} {plural(count, 'row')}"))
            rows.append(("", f"{metadata_of(path)} says what its columns are, and their units"))
            document["csv"] = {"file": str(path), "metadata": str(metadata_of(path)), "rows": count}
        if args.mcap is not None:
            path = Path(args.mcap)
            topics = write_mcap(files.enter_context(_new(path)), parts, f"bilateral-teleop {__version__}")
            rows.append(("mcap", f"{path}, times from tick 0"))
            rows += [("", f"{topic}: {grouped(count)} {plural(count, 'message')}") for topic, count in topics.items()]
            document["mcap"] = {"file": str(path), "topics": topics}
    rows += [("note", note) for note in left_out]
    return Answer(facts(rows), {**_head(args, parts), **document, "notes": left_out})


def stream(args: Namespace) -> Answer:
    """Send the rows of a live run to PlotJuggler as they come, until it is over or a signal. Raises `Refused`."""
    from teleop.export.stream import GrowingRun
    from teleop.export.stream import stream as send
    from teleop.live.net.wire import address, host_port
    from teleop.live.process.interrupt import Interrupt

    to = address(args.plotjuggler, "--plotjuggler")
    if to[1] == 0:
        raise Refused("--plotjuggler needs the port of PlotJuggler's UDP Server, not 0; for example --plotjuggler "
                      "127.0.0.1:9870")
    run = GrowingRun(Path(args.run))
    if not args.json:
        print(f"{args.run} to {host_port(to)}: positions, forces and all else that is recorded, as they are, in plain "
              "UDP; Ctrl-C ends it", file=sys.stderr, flush=True)
    try:
        with Interrupt() as interrupt:
            sent = send(run, to, rows=args.rows, stopped=lambda: interrupt.name is not None,
                        warn=_warn)
    finally:
        run.close()
    why = "the run is over" if run.over else f"ended by {interrupt.name}"
    missed = f", {grouped(sent.unheard)} of them while nobody listened" if sent.unheard else ""
    sentence = (f"{why}; {grouped(sent.rows)} {plural(sent.rows, 'row')} in {grouped(sent.datagrams)} "
                f"{plural(sent.datagrams, 'datagram')}{missed}")
    return Answer(facts([("stream", f"{args.run} to {host_port(to)}"), ("", sentence)]), {
        "status": "done", "sentence": sentence, "mode": "stream", "run": args.run, "to": host_port(to),
        "rows": sent.rows, "datagrams": sent.datagrams, "unheard": sent.unheard, "over": run.over})


def _warn(sentence: str) -> None:
    complain(sentence, DONE)


@contextmanager
def _new(path: Path) -> Iterator[BinaryIO]:
    """A new file at `path`, whole in the end or not there. Raises `Refused`."""
    try:
        with creating(path) as file:
            yield file
    except FileExistsError as error:
        raise Refused(f"{path} is there already; give another name, or remove it") from error
    except OSError as error:
        where = "" if path.parent.is_dir() else f"there is no folder {path.parent}: "
        raise Refused(f"could not write {path} ({where}{error.strerror or error}), so nothing was left there; make "
                      "room, or give a file where you may write") from error


def _what(run: str, parts: Sequence[Part]) -> str:
    summary = parts[0].summary
    several = f", {number_of(len(parts), 'part')}" if parts[0].number else ""
    return f"{run} ({summary['scene']}, {summary['mode']}{several})"


def _head(args: Namespace, parts: Sequence[Part]) -> Mapping[str, Any]:
    """The keys that every document begins with; of several parts `parameters` are what all have in common."""
    summaries = [part.summary for part in parts]
    first = summaries[0]
    common = {key: value for key, value in first["parameters"].items()
              if all(one["parameters"].get(key) == value for one in summaries)}
    seed, dt = ((first[key] if all(one[key] == first[key] for one in summaries) else None) for key in ("seed", "dt"))
    return {**head(status="done", sentence=f"exported {number_of(sum(part.ticks for part in parts), 'row')}",
                   scene=first["scene"], mode="export", parameters=common, seed=seed, command=args.typed, dt=dt),
            "run": os.fspath(args.run)}
