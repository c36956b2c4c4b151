"""Command `teleop demo --page`: serve the page until Ctrl-C, and merge the records of its parts."""

from __future__ import annotations

import asyncio
import re
import subprocess
import sys
import time
from argparse import Namespace
from functools import partial
from pathlib import Path
from secrets import token_urlsafe
from socket import gethostname
from tempfile import mkstemp

from teleop.errors import Refused, number_of
from teleop.live.options import ticks_of
from teleop.live.page.controls import Controls
from teleop.live.page.server import HOST, Requests
from teleop.live.page.session import PageParts, Start
from teleop.live.process import output
from teleop.live.process.interrupt import Interrupt
from teleop.live.records.record import fresh_folder
from teleop.terminal.answer import Answer, scene_head
from teleop.terminal.options import knobs_from
from teleop.terminal.run import stem

FOLDER = Path(__file__).parent
NEEDS = ("teleop demo --page needs websockets, which is not installed; type pip install 'bilateral-teleop[page]', or "
         "pip install websockets")
LAST_PORT = 65535


def command(args: Namespace) -> Answer:
    """Show the scene until Ctrl-C, and leave its folder. Raises `Refused`."""
    _check(args)
    try:
        from teleop.live.page.page import Page
    except ImportError as error:
        if (error.name or "").partition(".")[0] != "websockets":
            raise
        raise Refused(NEEDS) from error
    controls = Controls(args.scene, knobs_from(args))
    _ = controls.laws  # worked out now: where a scene reads files, it takes as long as many pictures
    ticks_of(controls.first, args.rate, lockstep=False, spin=args.spin)
    ticking = ["--spin"] * args.spin + ([] if args.rate is None else ["--rate", repr(args.rate)])
    start = Start(args.scene, args.seed, args.realtime, ticking)
    requests = Requests(page_bytes(), token := token_urlsafe(16))
    with output.live(), Interrupt() as interrupt, fresh_folder(args.out, f"{stem(args.scene)}-page") as claimed:
        folder = claimed.path
        parts = PageParts(folder, {"scene": args.scene, "seed": args.seed, "command": args.typed})
        page = Page(controls, parts, start, interrupt, time.monotonic)
        way = Path(mkstemp(suffix=".html")[1]) if args.open else None
        try:
            asyncio.run(page.run(requests, args.port or 0, partial(_listening, token, way)))
        except OSError as error:
            if not parts.recorded:
                raise
            _say(f"the page has ended, for the system refused something ({error.strerror or error}); see to that and "
                 "start it again")
        finally:
            if way is not None:
                way.unlink(missing_ok=True)
            if parts.recorded:
                claimed.keep()
        if not parts.recorded:
            raise KeyboardInterrupt
        passed = interrupt.count
        results = parts.merge_all(args.scene, args.typed, _say, lambda: interrupt.count > passed)
    lines = [f"{result.path.name}: {result.status}: {result.sentence}" for result in results if result.path is not None]
    sentence = f"{number_of(len(parts), 'part')}, {len(results)} put together"
    head = scene_head(controls.first, "page", sentence=sentence, seed=args.seed, command=args.typed)
    text = "\n".join([*lines, f"`teleop report {folder}` shows {'it' if len(lines) == 1 else 'them'}"])
    return Answer(text, {**head, "parts": len(parts)}).kept_in(folder)


def page_bytes() -> bytes:
    """Read `page.html` with its style and its scripts, each in the place of the name that stands for it there."""
    page = (FOLDER / "page.html").read_text()
    return re.sub(r"\{\{([a-z]+\.(?:css|js))\}\}", lambda name: (FOLDER / name[1]).read_text(), page).encode()


def _check(args: Namespace) -> None:
    """Refuse the options that do not go with a page."""
    if args.lockstep:
        raise Refused("a page goes by the clock; leave --lockstep out")
    if args.plot or args.format:
        raise Refused("--page draws in the browser; leave --plot and --format out, and draw a part afterwards with "
                      "`teleop report FOLDER/01 --plot`")
    if args.port is not None and args.port > LAST_PORT:
        raise Refused(f"--port must be at most {LAST_PORT}, not {args.port}; leave it out for one that is free")


def _listening(token: str, way: Path | None, port: int) -> None:
    """Print the address of the page, and open it if there is a file `way` for that.

    No other user can read that file, which leads the browser there. All users see the command lines of processes, on
    which the token would stand.
    """
    address = f"http://{HOST}:{port}/?token={token}"
    _say(f"page: {address}\non another machine type  ssh -L {port}:{HOST}:{port} {gethostname()}  there, and open the "
         "same address; Ctrl-C here ends it")
    if way is not None:  # a process of its own: a browser in the terminal would wait for its keys, and be waited for
        way.write_text(f'<!doctype html><meta http-equiv="refresh" content="0; url={address}"><title>teleop</title>\n')
        subprocess.Popen([sys.executable, "-m", "webbrowser", way.as_uri()], stdin=subprocess.DEVNULL,
                         stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
