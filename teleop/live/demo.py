"""`teleop demo`: slave, channel and master as three processes on loopback, watched, and their ends merged."""

from __future__ import annotations

import asyncio
import sys
import time
from argparse import Namespace
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from teleop.errors import Refused
from teleop.live.child import Child, arguments_of
from teleop.live.live_line import live_text
from teleop.live.options import ticks_of
from teleop.live.process import output
from teleop.live.process.interrupt import Interrupt
from teleop.live.process.realtime import sentence
from teleop.live.records.end_result import NAMES
from teleop.live.records.merge import merge
from teleop.live.records.reader import read_noted
from teleop.live.records.record import fresh_folder
from teleop.live.shell import TRACEBACK
from teleop.scene.loading import live_knobs, load_scene
from teleop.scene.scene import Scene, both_ends
from teleop.simulation.result import Result
from teleop.terminal.answer import Answer
from teleop.terminal.options import INTERRUPTED, knobs_from
from teleop.terminal.plotting import asked_formats

FAREWELL = 2.0  # s for the others, when one has failed, to hear of it


@dataclass(frozen=True)
class EndOptions:
    """Options of the two ends of a demo. `rate` (Hz): None, the scene's own; `device`, `robot`: None, the simulated.

    `lockstep`: the ends step by packets, without a channel: each applies the schedule of the link itself.
    """

    lockstep: bool = False
    rate: float | None = None
    spin: bool = False
    device: str | None = None
    robot: str | None = None

    def arguments(self, e: str) -> list[str]:
        """Arguments of the process of the end `e`."""
        option, name = ("--device", self.device) if e == "m" else ("--robot", self.robot)
        return [*["--lockstep"] * self.lockstep, *["--spin"] * self.spin,
                *([] if self.rate is None else ["--rate", repr(self.rate)]), *([] if name is None else [option, name])]


def command(args: Namespace) -> Answer:
    """Run the scene live, as three processes, leave its folder, and draw it if asked to; or show it as a page.

    Raises `Refused`.
    """
    if args.page and args.device is not None:
        raise Refused("--page has a simulated device in the browser's hand; leave --device out, or --page")
    if args.page:
        from teleop.live.page.command import command as show_page

        return show_page(args)
    if args.port is not None or args.open or args.keep is not None:
        raise Refused("--port, --open and --keep are of the page; add --page")
    from teleop.terminal.run import answer_of, stem, with_plot

    formats = asked_formats(args)
    ends = EndOptions(args.lockstep, args.rate, args.spin, args.device, args.robot)
    result = demo(args.scene, knobs_from(args), ends, seed=args.seed, out=args.out, stem=stem(args.scene),
                  json=args.json, command=args.typed, realtime=args.realtime)
    answer = answer_of(result, args.typed)
    if result.status == "stopped":  # by a signal: a script that goes on with what the run came to must not
        answer = answer._replace(code=INTERRUPTED)
    return answer if result.path is None else with_plot(answer, result, result.path, formats)


def demo(
    scene_name: str, knobs: dict[str, str], ends: EndOptions, *, seed: int, out: str | None, stem: str, json: bool,
    command: list[str], realtime: bool = True,
) -> Result:
    """Run a scene live on loopback and write its folder, `out` or runs/STEM-N. Raises `Refused`.

    `realtime`: all three processes ask for real-time scheduling.
    """
    scene = both_ends(load_scene(scene_name, **(knobs if ends.lockstep else live_knobs(scene_name, knobs))))
    ticks_of(scene, ends.rate, lockstep=ends.lockstep, spin=ends.spin)  # refused here, before a process is started
    options = arguments_of(scene_name, seed, knobs, realtime=realtime)
    with output.live(), Interrupt() as interrupt, fresh_folder(out, stem) as claimed:
        folder = claimed.path
        try:
            channel = asyncio.run(_conduct(scene, options, folder, interrupt, ends, show=not json))
        except Refused as refused:
            raise Refused(f"{refused}; what was recorded is in {folder}" if _ran(folder) else str(refused)) from refused
        finally:
            if _ran(folder):
                claimed.keep()
        if interrupt.name is not None and not _ran(folder):
            raise KeyboardInterrupt
        result = merge(scene, folder / "master", folder / "slave", channel=channel)
        result.write(folder, command)
    return replace(result, path=folder)


async def _conduct(
    scene: Scene, options: list[str], out: Path, interrupt: Interrupt, ends: EndOptions, *, show: bool
) -> dict[str, Any]:
    """Start the processes, watch them to their end; returns the counts of the channel."""
    live: dict[str, dict[str, Any]] = {}
    children: list[Child] = []
    watches: list[asyncio.Task[tuple[int, str]]] = []

    def note(event: dict[str, Any]) -> None:
        if event["event"] == "live":
            live[event["end"]] = event

    async def start(name: str, *arguments: str) -> Child:
        if interrupt.name is not None:
            raise Refused("interrupted")
        child = await Child.start(name, [*options, *arguments])
        children.append(child)
        watches.append(asyncio.create_task(child.watch(note)))
        return child

    async def pass_on() -> None:
        passed = 0
        while True:
            await asyncio.sleep(0.05)
            if interrupt.name is not None and interrupt.count > passed:
                passed = interrupt.count
                for child in children:
                    if child.name != "channel":
                        child.interrupt(interrupt.name)

    beside = [asyncio.create_task(pass_on()), *([asyncio.create_task(_line(scene, live))] if show else [])]
    try:
        slave = await start("slave", "--listen", "127.0.0.1:0", "--out", str(out / "slave"), *ends.arguments("s"))
        port = await slave.port()
        if show and slave.realtime is not None:  # all three ask for the same, and may have the same
            print(sentence(slave.realtime), flush=True)
        if not ends.lockstep:
            channel = await start("channel", "--listen", "127.0.0.1:0", "--peer", f"127.0.0.1:{port}")
            port = await channel.port()
        await start("master", "--peer", f"127.0.0.1:{port}", "--out", str(out / "master"), *ends.arguments("m"))
        await _until_over(children, watches)
    except Refused:
        if interrupt.name is None or _ran(out):
            raise  # otherwise what they say of each other's leaving is our doing
    finally:
        for task in beside:
            task.cancel()
        await asyncio.wait(beside)
        for child in children:
            child.interrupt()
        if watches:
            await asyncio.wait(watches, timeout=5.0)
        for child, watch in zip(children, watches, strict=True):
            if child.process.returncode is None:
                child.process.kill()
                await asyncio.wait([watch])
    return next((child.done or {} for child in children if child.name == "channel"), {})


async def _until_over(children: list[Child], watches: list[asyncio.Task[tuple[int, str]]]) -> None:
    """Until both ends have run. One that dies ends it, as nothing restarts it: `Refused` with its name.

    An end that stops by itself tells the other, which may know more; one that was killed cannot.
    """
    both = list(zip(children, watches, strict=True))
    ends = [watch for child, watch in both if child.name != "channel"]
    while not all(watch.done() for watch in ends):
        await asyncio.wait([watch for watch in watches if not watch.done()], return_when=asyncio.FIRST_COMPLETED)
        over = [(child, *watch.result()) for child, watch in both if watch.done()]
        for child, code, errors in over:
            if code < 0 or child.name == "channel":
                raise child.failed(code, errors)
        if any(code for _, code, _ in over):
            await asyncio.wait(ends, timeout=FAREWELL)
            break
    for child, watch in both:
        if watch.done() and watch.result()[0]:
            raise child.failed(*watch.result())


async def _line(scene: Scene, live: dict[str, dict[str, Any]]) -> None:
    """The one line that shows how far the run is. Between two events of the ends it goes on with the clock."""
    from teleop.terminal.progress import Progress

    progress = Progress(sys.stderr, scene.ticks)
    seen, since = -1, 0.0
    try:
        while True:
            now = time.monotonic()
            done = min((numbers["k"] + 1 for numbers in live.values()), default=0)
            if done != seen:
                seen, since = done, now
            if done:  # the start-up is no part of the rate
                text = live_text(*[live[e] for e in "ms" if e in live])
                progress.show(min(done + (now - since) / scene.dt, scene.ticks), now, *text)
            await asyncio.sleep(0.1)
    finally:
        progress.end()


def _ran(out: Path) -> bool:
    """True if there is anything to keep: an end came to its first tick, or raised something before."""
    for name in NAMES.values():
        if (out / name / TRACEBACK).is_file():
            return True
        with suppress(Refused):
            if len(read_noted(out / name)[1].ticks):
                return True
    return False
