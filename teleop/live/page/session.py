"""Processes of a session, and the folder of the parts that it leaves."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any, NamedTuple

from teleop.errors import Refused
from teleop.live.child import Child, arguments_of
from teleop.live.process.interrupt import Interrupt
from teleop.live.records.end_result import NAMES
from teleop.live.records.merge import merge
from teleop.live.records.reader import FILE
from teleop.scene.loading import load_scene
from teleop.scene.scene import both_ends
from teleop.simulation.result import Result
from teleop.storage.strict_json import write_document

FLUSH = 16  # rows of a record that are handed over at once
LEAST_KEPT = 1e7  # bytes: ten seconds of a session
LEAVE = 5.0  # s for a process to leave in order, before it is killed


class Start(NamedTuple):
    """Options for starting the three processes.

    `ticking`: of the ends alone; `robot`: a MuJoCo model in place of the simulated slave; `program`: see `Child.start`;
    `device`: a device by its name in place of the simulated master.
    """

    scene: str
    seed: int
    realtime: bool = True
    ticking: Sequence[str] = ()
    robot: str | None = None
    program: Sequence[str] = ()
    device: str | None = None


class Children:
    """Slave, channel and master: their start, orders and end.

    `hear(name, event)` is called with each event, `lose(name, sentence)` when a process has ended by itself.
    """

    def __init__(self, start: Start, hear: Callable[[str, dict[str, Any]], None],
                 lose: Callable[[str, str], None]) -> None:
        self._options, self._hear, self._lose = start, hear, lose
        self._alive: dict[str, Child] = {}
        self._watches: set[asyncio.Task[None]] = set()
        self._ports: dict[str, int] = {}

    @property
    def complete(self) -> bool:
        """True if all three run."""
        return len(self._alive) == 3

    async def start(self, knobs: Mapping[str, str], folders: Mapping[str, Path]) -> None:
        """Start all three, the ends m and s to write into `folders`. Raises `Refused`, and stops what has started."""
        try:
            options = ["--flush", str(FLUSH), *self._options.ticking]
            robot = [] if self._options.robot is None else ["--robot", self._options.robot]
            slave = await self._start("slave", knobs, "--listen", "127.0.0.1:0", "--out", str(folders["s"]), *options,
                                      *robot)
            self._ports["slave"] = await slave.port()
            await self.start_channel(knobs, port=0)
            to = f"127.0.0.1:{self._ports['channel']}"
            device = [] if self._options.device is None else ["--device", self._options.device]
            await self._start("master", knobs, "--peer", to, "--out", str(folders["m"]), *options, *device)
        except BaseException:
            await self.stop()
            raise

    async def start_channel(self, knobs: Mapping[str, str], port: int | None = None) -> None:
        """Start the channel between the two; without `port` at the same one as before. Raises `Refused`."""
        at = self._ports["channel"] if port is None else port
        channel = await self._start("channel", knobs, "--listen", f"127.0.0.1:{at}",
                                  "--peer", f"127.0.0.1:{self._ports['slave']}")
        self._ports["channel"] = await channel.port()

    def order(self, order: Mapping[str, Any], *names: str) -> None:
        """Give an order to these processes, as far as they run."""
        for name in names:
            if name in self._alive:
                self._alive[name].order(order)

    def turn(self, knobs: Mapping[str, str], folders: Mapping[str, Path], *, again: bool,
             align: Sequence[float] | None = None) -> None:
        """Order all three to go on with these knobs, and the ends m and s to write into `folders`.

        `again`: from the scene's start; `align`: place to which the hand first brings the master, m per axis.
        """
        self.order({"order": "turn", "knobs": knobs}, "channel")
        for e, name in NAMES.items():
            self.order({"order": "turn", "knobs": knobs, "out": str(folders[e]), "again": again,
                        "align": align if e == "m" else None}, name)

    async def leave(self, interrupt: Interrupt) -> None:
        """Stop all in order; a second signal meanwhile is passed on to the two ends, which set their forces to zero."""
        ends = [self._alive[name] for name in ("master", "slave") if name in self._alive]
        leaving = asyncio.create_task(self.stop())
        passed = 1
        while not leaving.done():
            await asyncio.wait([leaving], timeout=0.05)
            if interrupt.count > passed:
                passed = interrupt.count
                for end in ends:
                    end.interrupt(str(interrupt.name))

    async def stop(self) -> None:
        """Stop all in order: the two ends, then the channel between them. A process that does not leave is killed."""
        alive, self._alive = self._alive, {}
        for several in (("master", "slave"), ("channel",)):
            leaving = [alive[name] for name in several if name in alive]
            for child in leaving:
                child.interrupt()
            waits = [asyncio.create_task(child.process.wait()) for child in leaving]
            if waits:
                await asyncio.wait(waits, timeout=LEAVE)
            for child in leaving:
                if child.process.returncode is None:
                    with suppress(ProcessLookupError):
                        child.process.kill()
        if self._watches:
            await asyncio.wait(self._watches, timeout=LEAVE)

    async def _start(self, name: str, knobs: Mapping[str, str], *extra: str) -> Child:
        options = arguments_of(self._options.scene, self._options.seed, knobs, realtime=self._options.realtime)
        child = await Child.start(name, [*options, *extra, "--orders"], orders=True, program=self._options.program)
        self._alive[name] = child
        watch = asyncio.create_task(self._watch(child))
        self._watches.add(watch)
        watch.add_done_callback(self._watches.discard)
        return child

    async def _watch(self, child: Child) -> None:
        def hear(event: dict[str, Any]) -> None:
            if self._alive.get(child.name) is child:
                self._hear(child.name, event)

        code, errors = await child.watch(hear)
        if self._alive.get(child.name) is not child:
            return  # it was stopped
        del self._alive[child.name]
        if child.listening.exception() is None:  # or else who waits for its port says so
            sentence = (child.done or {}).get("sentence")
            self._lose(child.name, str(sentence or child.failed(code, errors)))


def lost_share(live: Mapping[str, Mapping[str, Any]]) -> float | None:
    """The greater share of packets that were lost on a way, by the newest event `live` of each end; None: not known.

    >>> lost_share({"m": {"loss": 0.25, "skipped": 0.0}, "s": {"loss": 0.5, "skipped": 0.125}}), lost_share({})
    (0.5, None)
    """
    return max((max(0.0, live[e]["loss"] - (live.get(peer, {}).get("skipped") or 0.0))  # what it skipped was not sent
                for e, peer in ("ms", "sm") if live.get(e, {}).get("loss") is not None), default=None)


UNITS = {"kB": 1e3, "MB": 1e6, "GB": 1e9, "TB": 1e12}


def size_of(text: str) -> float:
    """Read a size as it is typed, in bytes. Raises `Refused`.

    >>> size_of("2GB"), size_of("15.5 MB")
    (2000000000.0, 15500000.0)
    """
    number, unit = text.strip()[:-2], text.strip()[-2:]
    try:
        size = float(number) * UNITS[unit]
    except (KeyError, ValueError):
        size = 0.0
    if not LEAST_KEPT <= size < inf:
        raise Refused(f"--keep takes a size of at least {size_text(LEAST_KEPT)}, as 2GB or 500MB, not {text[:40]!r}")
    return size


def size_text(size: float) -> str:
    """Write a number of bytes for people.

    >>> size_text(820e6), size_text(2e9), size_text(0)
    ('820 MB', '2 GB', '0 kB')
    """
    unit = next((name for name in reversed(UNITS) if size >= UNITS[name]), "kB")
    return f"{size / UNITS[unit]:.3g} {unit}"


INDEX = "page.json"
VERSION = 1


class PagePart(NamedTuple):
    """Part of a session, with its own records. `k`: its first tick.

    `why`: start, turn, again, lost (a process ended), or idle (nobody had steered, and nothing was written).
    """

    folder: str
    knobs: dict[str, str]
    k: int
    why: str


class PageParts:
    """Parts of a session, a folder for each switch, and their index. `about`: its scene, seed and command.

    `keep`: bytes that all parts may have; see `drop_oldest`.

        runs/SCENE-page-N/page.json      list of the parts, with the knobs of each
        runs/SCENE-page-N/01/master      record of the master in the first part
        runs/SCENE-page-N/01/slave
        runs/SCENE-page-N/02/...
    """

    def __init__(self, folder: Path, about: Mapping[str, Any], keep: float = inf) -> None:
        self.folder, self.keep = folder, keep
        self._begun = 0  # parts, those that were removed too
        self._about = {"version": VERSION, **about}
        self._parts: list[PagePart] = []
        self._settled: dict[str, int] = {}  # bytes of the parts in which nothing is written any more

    def __len__(self) -> int:
        return len(self._parts)

    @property
    def recorded(self) -> bool:
        """True if there is anything to keep: an end has begun a record."""
        return any((end / FILE).is_file() for part in self._parts for end in self._ends(part).values())

    @property
    def newest(self) -> dict[str, Path]:
        """The folders of the two ends, m and s, of the newest part."""
        return self._ends(self._parts[-1])

    def sizes(self) -> list[int]:
        """Bytes that each part has on the disk, oldest first; of all but the newest two as they were measured once."""
        for part in self._parts[:-2]:
            if part.folder not in self._settled:
                self._settled[part.folder] = self._size(part)
        return [*(self._settled[part.folder] for part in self._parts[:-2]), *map(self._size, self._parts[-2:])]

    def drop_oldest(self) -> str:
        """Remove the oldest part, which must not be the newest; return its name. Raises `OSError`, and keeps it."""
        oldest = self._parts[0]
        with suppress(FileNotFoundError):  # a person has removed it
            shutil.rmtree(self.folder / oldest.folder)
        del self._parts[0]
        self._write()
        return oldest.folder

    def begin(self, knobs: Mapping[str, str], k: int, why: str) -> dict[str, Path]:
        """Begin a part at tick k; return the folders that its ends are to make. Raises `OSError`, and begins none."""
        self._parts.append(PagePart(f"{self._begun + 1:02d}", dict(knobs), k, why))
        try:
            self._write()
        except OSError:
            self._parts.pop()
            raise
        self._begun += 1
        return self.newest

    def correct_start(self, k: int) -> None:
        """Correct the first tick of the newest part to k."""
        self._parts[-1] = self._parts[-1]._replace(k=k)
        self._write()

    def merge_all(self, name: str, command: Sequence[str], say: Callable[[str], None],
                  stop: Callable[[], bool]) -> list[Result]:
        """Merge the two ends of each part of scene `name` and write the results, until `stop`.

        `say` reports a part that cannot be merged, and the others go on.
        """
        done = []
        for part in self._parts:
            ends, folder = self._ends(part), self.folder / part.folder
            if stop():
                say(f"interrupted: `teleop report {folder}` puts the two ends of the rest together")
                break
            recorded = [end for end in ends.values() if (end / FILE).is_file()]
            if len(recorded) < len(ends):
                if recorded:
                    say(f"part {part.folder}: only the {recorded[0].name} came to it, so there is nothing to put "
                        "together")
                continue
            try:
                scene = both_ends(load_scene(name, **part.knobs))
                result = merge(scene, ends["m"], ends["s"])
                result.write(folder, command)
            except (Refused, OSError) as error:
                say(f"part {part.folder}: {error}")
            else:
                done.append(replace(result, path=folder))
        return done

    def _ends(self, part: PagePart) -> dict[str, Path]:
        return {e: self.folder / part.folder / name for e, name in NAMES.items()}

    def _size(self, part: PagePart) -> int:
        return sum(file.stat().st_size for file in (self.folder / part.folder).rglob("*") if file.is_file())

    def _write(self) -> None:
        write_document(self.folder / INDEX, {**self._about, "parts": [part._asdict() for part in self._parts]})
