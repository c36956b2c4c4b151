"""`teleop demo`: slave, channel and master as three processes on loopback, watched, and their ends merged."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import signal
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from teleop.errors import Refused
from teleop.library import ROOT
from teleop.live.end import live_text
from teleop.live.record import read_record
from teleop.result import Packets, Result
from teleop.scene import Scene, load_scene
from teleop.trace import assemble

PATIENCE = 15.0  # s for a process to come up


class Child:
    """One process of the demo; its events are lines of JSON on its standard output."""

    def __init__(self, name: str, process: asyncio.subprocess.Process) -> None:
        self.name, self.process = name, process
        self.listening: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        self.done: dict[str, Any] | None = None

    @classmethod
    async def start(cls, name: str, arguments: list[str]) -> Child:
        """Start `python -m name arguments`, found beside this package whatever the current folder holds."""
        path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-P", "-m", name, *arguments, "--json", stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE, env={**os.environ, "PYTHONPATH": path},
            start_new_session=True,  # Ctrl-C reaches them through us, once
        )
        return cls(name, process)

    async def watch(self, live: dict[str, dict[str, Any]]) -> tuple[int, str]:
        """Read its events until it ends; its exit code and what it said on stderr."""
        assert self.process.stdout is not None
        assert self.process.stderr is not None
        trouble = asyncio.create_task(self.process.stderr.read())
        async for line in self.process.stdout:
            event = json.loads(line)
            if event["event"] == "listening" and not self.listening.done():
                self.listening.set_result(event["port"])
            elif event["event"] == "live":
                live[event["end"]] = event
            elif event["event"] == "done":
                self.done = event["summary"]
        said = (await trouble).decode(errors="replace").strip()
        code = await self.process.wait()
        if not self.listening.done():
            self.listening.set_exception(Refused(said.removeprefix("teleop: ") or f"the {self.name} ended with {code}"))
        return code, said

    def interrupt(self) -> None:
        """Ask it to stop cleanly."""
        if self.process.returncode is None:
            self.process.send_signal(signal.SIGTERM)


def demo(
    scene_name: str, knobs: dict[str, str], *, seed: int, out: Path, json: bool, lockstep: bool, command: list[str]
) -> Result:
    """Run a scene live on loopback and write its folder. Raises `Refused`.

    `lockstep`: the ends step by packets, without a channel: each applies the schedule of the link itself.
    """
    scene = load_scene(scene_name, **knobs)
    if out.exists():
        raise Refused(f"{out} is there already; give another folder with --out, or remove it")
    try:
        out.mkdir(parents=True)
    except OSError as error:
        raise Refused(f"cannot write to {out} ({error.strerror or error}); give another folder with --out") from error
    options = [scene_name, "--seed", str(seed)]
    options += [part for key, value in knobs.items() for part in
                (("--link", value) if key == "link" else ("--set", f"{key}={value}"))]
    try:
        began = time.monotonic()
        channel = asyncio.run(_conduct(scene, options, out, show=not json, lockstep=lockstep))
        result = merge(scene, out, seed=seed, channel=channel, run_time=time.monotonic() - began)
        result.write(out, command)
    except BaseException:
        if not _ran(out):
            shutil.rmtree(out, ignore_errors=True)
        raise
    return replace(result, path=out)


async def _conduct(scene: Scene, options: list[str], out: Path, *, show: bool, lockstep: bool) -> dict[str, Any]:
    """Start the processes, watch them to their end; what the channel counted."""
    live: dict[str, dict[str, Any]] = {}
    children: list[Child] = []
    watches: list[asyncio.Task[tuple[int, str]]] = []
    loop = asyncio.get_running_loop()

    async def start(name: str, *arguments: str) -> Child:
        child = await Child.start(name, [*options, *arguments])
        children.append(child)
        watches.append(asyncio.create_task(child.watch(live)))
        return child

    def interrupt() -> None:
        for child in children:
            if child.name != "channel":
                child.interrupt()

    for name in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(name, interrupt)
    stepping = ["--lockstep"] * lockstep
    line = asyncio.create_task(_line(scene, live)) if show else None
    try:
        slave = await start("slave", "--listen", "127.0.0.1:0", "--out", str(out / "slave"), *stepping)
        port = await asyncio.wait_for(asyncio.shield(slave.listening), PATIENCE)
        if not lockstep:
            channel = await start("channel", "--listen", "127.0.0.1:0", "--peer", f"127.0.0.1:{port}")
            port = await asyncio.wait_for(asyncio.shield(channel.listening), PATIENCE)
        await start("master", "--peer", f"127.0.0.1:{port}", "--out", str(out / "master"), *stepping)
        ends = [watch for child, watch in zip(children, watches, strict=True) if child.name != "channel"]
        for code, said in await asyncio.gather(*ends):
            if code:
                raise Refused(said.removeprefix("teleop: ") or f"an end stopped with exit code {code}")
    finally:
        if line is not None:
            line.cancel()
            await asyncio.wait([line])
        for child in children:
            child.interrupt()
        await asyncio.wait(watches, timeout=5.0)
        for child in children:
            if child.process.returncode is None:
                child.process.kill()
    return next((child.done or {} for child in children if child.name == "channel"), {})


async def _line(scene: Scene, live: dict[str, dict[str, Any]]) -> None:
    """The one line that shows how far the run is."""
    from teleop.console import Progress

    progress = Progress(sys.stderr, scene.ticks)
    try:
        while True:
            done = min((numbers["k"] + 1 for numbers in live.values()), default=0)
            text = "  ".join(live_text(live[e]) for e in ("m", "s") if e in live) or "waiting for the first exchange"
            progress.show(done, time.monotonic(), text)
            await asyncio.sleep(0.1)
    finally:
        progress.end()


def _ran(out: Path) -> bool:
    return any((out / name / "summary.json").is_file() for name in ("master", "slave"))


def merge(scene: Scene, out: Path, *, seed: int, channel: dict[str, Any], run_time: float) -> Result:
    """One result from the folders of the two ends, at the ticks that both ran."""
    names = {"m": "master", "s": "slave"}
    ends: dict[str, dict[str, Any]] = {e: _summary(out / name) for e, name in names.items()}
    records = {e: read_record(out / name)[1] for e, name in names.items()}
    link = scene.link is not None
    trace = assemble(scene, {e: r if link else r._replace(played=None) for e, r in records.items()})
    status, sentence = _verdict(ends)
    mode = str(ends["m"]["mode"])
    packets = _planned(scene, seed) if mode == "lockstep" else _counted(ends, channel)
    skipped = sum(int(end["skipped"]) for end in ends.values())
    notes = [f"{names[e]}: {end['record']}" for e, end in ends.items() if end["record"]]
    extra: dict[str, object] = {"channel": channel}
    shown = ("status", "sentence", "ticks", "skipped", "late_us", "delay", "clock", "stamp_margin", "cpu")
    for e, end in ends.items():
        extra[names[e]] = {key: end[key] for key in shown}
    extra["skipped"] = skipped
    return Result.make(scene, seed=seed, mode=mode, status=status, sentence=sentence, ticks=len(trace["t"]),
                       run_time=run_time, trace=trace, packets=packets, notes=notes, extra=extra)


def _planned(scene: Scene, seed: int) -> dict[str, Packets]:
    """What the schedule says of each direction: a stepped run's packets come when it says."""
    from teleop.lockstep import link_plans

    return {
        way: Packets.without_link(scene.ticks) if plan is None else Packets.of_plan(plan)
        for way, plan in zip(("forth", "back"), link_plans(scene, seed), strict=True)
    }


def _counted(ends: dict[str, dict[str, Any]], channel: dict[str, Any]) -> dict[str, Packets]:
    """What the two ends and the channel counted of each direction."""
    packets = {}
    for way, sender, receiver in (("forth", "m", "s"), ("back", "s", "m")):
        sent, got = ends[sender]["packets"]["sent"], ends[receiver]["packets"]
        lost = channel.get("counts", {}).get(way, {}).get("lost", 0)
        packets[way] = Packets(
            sent=sent, received=got["received"], lost=lost, late=got["late"], overtaken=got["overtaken"],
            duplicates=got["duplicates"], in_flight=max(0, sent - got["received"] - lost), rejected=got["rejected"],
        )
    return packets


def _verdict(ends: dict[str, dict[str, Any]]) -> tuple[str, str]:
    """The status of the whole: what one end found out, the other was told."""
    for status in ("diverged", "stopped"):
        for end in ends.values():
            if end["status"] == status:
                return status, str(end["sentence"])
    return "ok", str(ends["m"]["sentence"])


def _summary(folder: Path) -> dict[str, Any]:
    try:
        found: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    except (OSError, ValueError) as error:
        raise Refused(f"the {folder.name} left no summary ({error}); look at what it wrote in {folder}") from error
    return found
