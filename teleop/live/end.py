"""`python -m master` and `python -m slave`: one live end as a process of its own."""

from __future__ import annotations

import asyncio
import json
import shutil
import sys
import time
from argparse import ArgumentParser
from collections.abc import Callable, Sequence
from pathlib import Path
from secrets import randbits
from typing import Any

from teleop.endpoint import Endpoint, Stepped
from teleop.errors import Refused
from teleop.folder import numbered
from teleop.live.address import address, bound, shown
from teleop.live.record import Recorder, read_record
from teleop.live.shell import Device, Shell, Wire
from teleop.options import guarded, knobs_from, scene_options
from teleop.scene import Scene, load_scene
from teleop.session import Session

NAMES = {"m": "master", "s": "slave"}


def end_main(e: str, device: Callable[[Scene], Device], argv: Sequence[str] | None = None) -> int:
    """The command line of one end; `device` makes what stands at that end from the scene."""
    return guarded(lambda: _run(e, device, sys.argv[1:] if argv is None else list(argv)))


def _run(e: str, device: Callable[[Scene], Device], argv: list[str]) -> int:
    args = _parser(e).parse_args(argv)
    knobs = knobs_from(args)
    scene = load_scene(args.scene, **knobs)
    mode = "lockstep" if args.lockstep else "live"
    manifest = {**scene.manifest(), "mode": mode}
    if args.lockstep:
        manifest |= {"seed": str(args.seed), "link": str(scene.link)}
    session = Session(master=e == "m", manifest=manifest, number=randbits(64) if e == "m" else 0)
    inbox = None
    if args.lockstep:
        from teleop.lockstep import link_plans

        inbox = Stepped(link_plans(scene, args.seed)[0 if e == "s" else 1])
    endpoint = Endpoint(scene, e, session, inbox)
    stand = device(scene)
    wire = _wire(e, args)
    folder = Path(args.out) if args.out else numbered(Path("runs"), f"{scene.name}-{NAMES[e]}")
    _make(folder)
    say = _said if args.json else _quiet if args.quiet or not sys.stderr.isatty() else _Line(scene).show
    _greet(e, args, wire)
    try:
        recorder = Recorder(scene, e, folder)
        shell = Shell(endpoint, stand, wire, recorder, say, patience=args.wait)
        asyncio.run(shell.run())
        if shell.status == "refused":
            raise Refused(shell.sentence)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)  # nothing ran: nothing half-written stays
        raise
    finally:
        wire.sock.close()
    summary = _write(scene, e, mode, args.seed, shell, folder, ["python", "-m", NAMES[e], *argv])
    if args.json:
        print(json.dumps({"event": "done", "path": str(folder), "summary": summary}, default=str), flush=True)
    else:
        print(f"{NAMES[e]}: {shell.status}: {shell.sentence}\n{NAMES[e]}: wrote {folder}")
    return 0


def _parser(e: str) -> ArgumentParser:
    from teleop.options import Parser

    name = NAMES[e]
    parser = Parser(prog=f"python -m {name}", description=f"The {name}'s end of a scene, live over UDP.")
    scene_options(parser)
    if e == "m":
        parser.add_argument("--peer", metavar="HOST:PORT", required=True, help="where the slave, or the channel, listens")
    else:
        parser.add_argument("--listen", metavar="HOST:PORT", required=True, help="where to wait for the master")
    parser.add_argument("--out", metavar="DIR", help=f"folder for the record; default runs/SCENE-{name}-N")
    parser.add_argument("--wait", metavar="SECONDS", type=float, default=10.0 if e == "m" else None,
                        help="give up if the other end does not answer in this time"
                        + ("; default 10" if e == "m" else "; default: wait on"))
    parser.add_argument("--lockstep", action="store_true",
                        help="tick by packets instead of by the clock: both ends step together, and the run equals the "
                        "one in virtual time bit for bit (both ends need it, and the same --seed)")
    parser.add_argument("--json", action="store_true", help="write events as lines of JSON for a machine")
    parser.add_argument("--quiet", action="store_true", help="no live line")
    return parser


def _wire(e: str, args: Any) -> Wire:
    if e == "m":
        peer = address(args.peer, "--peer")
        return Wire(bound(("0.0.0.0" if not peer[0].startswith("127.") else "127.0.0.1", 0), "--peer"), peer)
    return Wire(bound(address(args.listen, "--listen"), "--listen"), None)


def _make(folder: Path) -> None:
    if folder.exists():
        raise Refused(f"{folder} is there already; give another folder with --out, or remove it")
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise Refused(f"cannot write to {folder} ({error.strerror or error}); give another folder with --out") from error


def _greet(e: str, args: Any, wire: Wire) -> None:
    at = wire.sock.getsockname()[:2]
    if args.json:
        print(json.dumps({"event": "listening", "address": shown(at), "port": at[1]}), flush=True)
    elif e == "s":
        print(f"slave: listening on {shown(at)}; start the master with: python -m master {args.scene} --peer {shown(at)}",
              flush=True)


def _said(numbers: dict[str, Any]) -> None:
    print(json.dumps({"event": "live", **numbers}), flush=True)


def _quiet(numbers: dict[str, Any]) -> None:
    pass


class _Line:
    """The live line of an end that was started by hand."""

    def __init__(self, scene: Scene) -> None:
        from teleop.console import Progress

        self._scene = scene
        self._progress = Progress(sys.stderr, scene.ticks)

    def show(self, numbers: dict[str, Any]) -> None:
        """One set of live numbers."""
        self._progress.show(numbers["k"] + 1, time.monotonic(), live_text(numbers))


def live_text(numbers: dict[str, Any]) -> str:
    """The live numbers as a person reads them."""
    e, gain, delay = numbers["end"], numbers["gain"], numbers["delay"]
    parts = [f"x_{e} {numbers['x'] * 1e3:7.2f} mm", f"f_{e} {numbers['f']:6.2f} N"]
    parts += [f"delay {delay * 1e3:5.1f} ms"] if delay is not None else ["nothing heard"]
    parts += [f"watchdog holds {NAMES[e]} at {gain * 100:.0f} %"] if gain is not None and gain < 1.0 else []
    return "  ".join(parts)


def _write(
    scene: Scene, e: str, mode: str, seed: int, shell: Shell, folder: Path, command: list[str]
) -> dict[str, Any]:
    """summary.json and trace.npz of one end, from its record."""
    import numpy as np

    from teleop import __version__
    from teleop.result import parameters
    from teleop.trace import end_arrays

    _, record, late = read_record(folder)
    arrays = {"t": np.array(record.ticks, dtype=np.int64) * scene.dt_ns / 1e9, **end_arrays(scene, e, record)}
    arrays |= {f"late_{e}": np.array(late) / 1e9}
    np.savez(folder / "trace.npz", allow_pickle=False, **arrays)
    endpoint, session, way = shell.endpoint, shell.endpoint.session, shell.endpoint.way
    inbox: Any = endpoint.inbox
    lateness = np.array(late) / 1e3
    summary: dict[str, Any] = {
        "status": shell.status, "sentence": shell.sentence, "end": NAMES[e], "scene": scene.name, "mode": mode,
        "parameters": parameters(scene), "seed": seed, "dt": scene.dt_ns / 1e9, "ticks": shell.ticks,
        "skipped": shell.skipped, "versions": {"bilateral-teleop": __version__, "python": sys.version.split()[0]},
        "command": command,
        "packets": {
            "sent": shell.data_sent, "received": getattr(inbox, "received", endpoint.received),
            **{name: getattr(inbox, name, 0) for name in ("late", "overtaken", "duplicates", "refused")},
            "rejected": dict(endpoint.rejected),
        },
        "late_us": {f"p{q}": float(np.percentile(lateness, q)) for q in (50, 99, 100)} if len(lateness) else {},
        "delay": {"mean": way.total / way.count / 1e9, "least": way.least / 1e9, "most": way.most / 1e9}
        if way.count else None,
        "clock": {"start_ns": session.start_ns, "offset_ns": session.offset_ns,
                  "uncertainty_ns": None if session.rtt_ns is None else session.rtt_ns // 2},
        "stamp_margin": endpoint.stamp_margin, "cpu": shell.cpu, "record": shell.recorder.trouble,
    }
    (folder / "summary.json").write_text(json.dumps(summary, indent=2, default=str) + "\n")
    return summary
