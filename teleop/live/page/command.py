"""Command `teleop demo --page`: serve the page until Ctrl-C, and merge the records of its parts."""

from __future__ import annotations

import asyncio
import json
import os
import re
import subprocess
import sys
import time
from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from math import inf
from pathlib import Path
from secrets import token_urlsafe
from socket import SO_REUSEADDR, SOL_SOCKET, gethostname, socket
from tempfile import mkstemp

from teleop.errors import Refused, number_of
from teleop.live.devices.device_watchdog import lock_folder
from teleop.live.options import ticks_of
from teleop.live.page.controls import Controls
from teleop.live.page.server import HOST, Requests
from teleop.live.page.session import PageParts, Start, size_of
from teleop.live.page.side_view import SideView
from teleop.live.process import output
from teleop.live.process.interrupt import Interrupt
from teleop.live.records.record import fresh_folder
from teleop.storage.files import read_bytes, replacing
from teleop.storage.strict_json import Misshapen, parse, record, text, whole
from teleop.terminal.answer import Answer, scene_head
from teleop.terminal.options import knobs_from
from teleop.terminal.run import stem

FOLDER = Path(__file__).parent
NEEDS = ("teleop demo --page needs websockets, which is not installed; type pip install 'bilateral-teleop[page]', or "
         "pip install websockets")
LAST_PORT = 65535
HIGHER = 10  # steps of niceness
LAST = "page.json"  # port and token of the last page, in the user's own folder ...
LASTS = 86400.0  # s, for which they are taken again
LONGEST = 1 << 10  # bytes of that file
_LAST = record({"port": whole(low=1, high=LAST_PORT), "token": text})


def command(args: Namespace) -> Answer:
    """Show the scene until Ctrl-C, and leave its folder. Raises `Refused`."""
    _check(args)
    try:
        from teleop.live.page.page import Page
    except ImportError as error:
        if (error.name or "").partition(".")[0] != "websockets":
            raise
        raise Refused(NEEDS) from error
    keep = inf if args.keep is None else size_of(args.keep)
    controls = Controls(args.scene, knobs_from(args), args.robot)
    view = None if args.robot is None else SideView(controls.first, args.robot)
    _ = controls.laws  # worked out now: where a scene reads files, it takes as long as many pictures
    ticks_of(controls.first, args.rate, lockstep=False, spin=args.spin)
    ticking = ["--spin"] * args.spin + ([] if args.rate is None else ["--rate", repr(args.rate)])
    start = Start(args.scene, args.seed, args.realtime, ticking, args.robot)
    port, token = page_address(args.port)
    requests = Requests(page_bytes(), token)
    with output.live(), Interrupt() as interrupt, fresh_folder(args.out, f"{stem(args.scene)}-page") as claimed:
        folder = claimed.path
        parts = PageParts(folder, {"scene": args.scene, "seed": args.seed, "command": args.typed}, keep)
        page = Page(controls, parts, start, interrupt, time.monotonic, view)
        way = Path(mkstemp(suffix=".html")[1]) if args.open else None
        try:
            with before_others(wanted=args.realtime):
                asyncio.run(page.run(requests, port, partial(begin_page, token, way)))
        except OSError as error:
            if not parts.recorded:
                raise
            say(f"the page has ended, for the system refused something ({error.strerror or error}); see to that and "
                 "start it again")
        finally:
            if way is not None:
                way.unlink(missing_ok=True)
            if parts.recorded:
                claimed.keep()
        if not parts.recorded:
            raise KeyboardInterrupt
        passed = interrupt.count
        results = parts.merge_all(args.scene, args.typed, say, lambda: interrupt.count > passed)
    lines = [f"{result.path.name}: {result.status}: {result.sentence}" for result in results if result.path is not None]
    sentence = f"{number_of(len(parts), 'part')}, {len(results)} put together"
    head = scene_head(controls.first, "page", sentence=sentence, seed=args.seed, command=args.typed)
    shown = "\n".join([*lines, f"`teleop report {folder}` shows {'it' if len(lines) == 1 else 'them'}"])
    return Answer(shown, {**head, "parts": len(parts)}).kept_in(folder)


@contextmanager
def before_others(*, wanted: bool) -> Iterator[None]:
    """Run at a higher priority than what else uses the machine, where the system allows it; children inherit it."""
    if not wanted or not hasattr(os, "setpriority"):
        yield
        return
    before = os.getpriority(os.PRIO_PROCESS, 0)
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, before - HIGHER)
    try:
        yield
    finally:
        os.setpriority(os.PRIO_PROCESS, 0, before)


def page_bytes(document: Path = FOLDER / "page.html") -> bytes:
    """Read a document with its head, style and scripts, each in the place of the name that stands for it there.

    They lie beside it, or here.
    """
    def part(name: re.Match[str]) -> str:
        beside = document.with_name(name[1])
        return (beside if beside.is_file() else FOLDER / name[1]).read_text()

    return re.sub(r"\{\{([a-z]+\.(?:css|html|js))\}\}", part, document.read_text()).encode()


def _check(args: Namespace) -> None:
    """Refuse the options that do not go with a page."""
    if args.lockstep:
        raise Refused("a page goes by the clock; leave --lockstep out")
    if args.plot or args.format:
        raise Refused("--page draws in the browser; leave --plot and --format out, and draw a part afterwards with "
                      "`teleop report FOLDER/01 --plot`")
    if args.robot is not None and args.robot.partition(":")[0] != "mujoco":
        raise Refused(f"--page shows a simulated robot or a MuJoCo model, not --robot {args.robot[:40]}; type --robot "
                      "mujoco:FILE.xml, or leave it out")
    check_port(args.port)


def check_port(port: int | None) -> None:
    """Refuse a port that there is not."""
    if port is not None and port > LAST_PORT:
        raise Refused(f"--port must be at most {LAST_PORT}, not {port}; leave it out for one that is free")


def page_address(port: int | None, last_page: str = LAST) -> tuple[int, str]:
    """Port (0: any) and token of the page: those of the last page if it is less than a day ago and the port is free.

    So a browser that shows a page comes back by itself when the page is started again. `last_page`: the file of that.
    """
    with suppress(OSError, Refused, Misshapen):
        path = lock_folder() / last_page
        if time.time() - path.stat().st_mtime < LASTS:
            last = parse(read_bytes(path, most=LONGEST, links=False))
            _LAST(last, last_page)
            if port in (None, 0, last["port"]) and _is_free(last["port"]):
                return last["port"], last["token"]
    return port or 0, token_urlsafe(16)


def _is_free(port: int) -> bool:
    with socket() as probe:
        probe.setsockopt(SOL_SOCKET, SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError:
            return False
    return True


def begin_page(token: str, way: Path | None, port: int, last_page: str = LAST) -> None:
    """Note the address for the page that is started next, and show it."""
    with suppress(OSError, Refused), replacing(lock_folder() / last_page) as file:
        os.fchmod(file.fileno(), 0o600)
        file.write(json.dumps({"port": port, "token": token}).encode())
    _listening(token, way, port)


def _listening(token: str, way: Path | None, port: int) -> None:
    """Print the address of the page, and open it if there is a file `way` for that.

    No other user can read that file, which leads the browser there. All users see the command lines of processes, on
    which the token would stand.
    """
    address = f"http://{HOST}:{port}/?token={token}"
    say(f"page: {address}\non another machine type  ssh -L {port}:{HOST}:{port} {gethostname()}  there, and open the "
         "same address; Ctrl-C here ends it")
    if way is not None:  # a process of its own: a browser in the terminal would wait for its keys, and be waited for
        way.write_text(f'<!doctype html><meta http-equiv="refresh" content="0; url={address}"><title>teleop</title>\n')
        subprocess.Popen([sys.executable, "-m", "webbrowser", way.as_uri()], stdin=subprocess.DEVNULL,
                         stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)


def say(text: str) -> None:
    """Print a line for who started the page."""
    print(text, file=sys.stderr, flush=True)
