"""Slave, channel and master of a session: turned from trial to trial, steered, let go, and started anew when lost.

Their command lines have the scene and the knobs that all trials share, without a law. What a trial has besides reaches
them by orders on their standard inputs, so nobody who looks at a list of processes sees a condition.
"""

from __future__ import annotations

import asyncio
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from teleop.errors import Refused
from teleop.live.page.controls import PROCESSES
from teleop.live.page.rows import HandReference, RecordTail, positions_of
from teleop.live.page.session import Children, Start
from teleop.live.process.interrupt import Interrupt
from teleop.live.records.end_result import NAMES
from teleop.live.records.reader import IDLE, Row
from teleop.storage.strict_json import Misshapen

ENDS = ("slave", "master")
MEETING = 15.0  # s for the two ends to meet, when they have started
FULL = 0.999  # of the force, from which on an end holds all of it


class Rig:
    """The three processes. `folder`: for their records, of this user alone, since they name laws.

    `report` is called with a sentence when one of the three is lost or does not obey; the sentence may name a law.
    """

    def __init__(self, start: Start, knobs: Mapping[str, str], folder: Path, report: Callable[[str], None]) -> None:
        self._knobs, self._folder, self._report = knobs, folder, report
        self._steered = start.device is None  # a simulated hand, which orders move
        self._children = Children(start, self._hear, lambda name, why: self._fail(f"the {name} is lost: {why}"))
        self._count = 0  # folders
        self._ends: dict[str, Path] = {}  # the folders of m and s, of the newest turn
        self._tails: dict[str, RecordTail] = {}
        self._hand: HandReference | None = None
        self._waiting: set[str] = set()  # processes that have not answered the turn
        self._met: set[str] = set()  # ends that have met the other one
        self._released: set[str] = set()  # ends whose law holds the force again
        self._home: Sequence[float] = ()  # where the hand begins, m per axis
        self._starting: asyncio.Task[None] | None = None
        self.lost = True  # the three do not run together
        self.live: dict[str, dict[str, Any]] = {}  # newest figures of m and s

    # start and end

    def begin(self) -> None:
        """Start all three, or start them anew."""
        if self._starting is None:
            self._starting = asyncio.create_task(self._start())

    async def _start(self) -> None:
        try:
            await self._children.stop()
            self._follow(self._next_folders())
            self._waiting, self._released, self._met = set(), set(), set()
            await self._children.start(self._knobs, self._ends)
            async with asyncio.timeout(MEETING):
                while not self._met >= {*ENDS}:  # a turn before the two have met would take longer than another
                    await asyncio.sleep(0.02)
            self.lost = False
        except TimeoutError:
            self._report(f"slave and master did not meet in {MEETING:g} s")
        except (Refused, OSError) as error:
            self._report(f"slave, channel and master cannot be started: {error}")
            await asyncio.sleep(1.0)
        finally:
            self._starting = None

    async def leave(self, interrupt: Interrupt) -> None:
        """End the three in order; a second signal meanwhile sets the forces to zero at once."""
        if self._starting is not None:
            self._starting.cancel()
            await asyncio.wait([self._starting])
        self.lost = True
        await self._children.leave(interrupt)
        self._close()

    # from trial to trial

    def turn(self, knobs: Mapping[str, str], home: Sequence[float]) -> None:
        """Begin the turn to a trial: the force falls, the bodies go back to the scene's start, the law begins anew."""
        folders = self._next_folders()
        self._waiting, self._released, self._home = set(PROCESSES), set(), home
        self._children.turn(knobs, folders, again=True)
        self._children.order({"order": "clutch", "open": False}, *ENDS)
        self._follow(folders)

    @property
    def is_ready(self) -> bool:
        """True if the turn is made, and both ends hold the whole of their force again."""
        return not self.lost and not self._waiting and self._released >= {*ENDS} and all(
            self._gain(e) >= FULL for e in NAMES)

    def let_go(self) -> None:
        """Bring both forces to zero, and end the records."""
        self._children.order({"order": "clutch", "open": True}, *ENDS)
        self._children.order({"order": "idle"}, *ENDS)

    @property
    def is_recorded(self) -> bool:
        """True if the records of the newest turn are whole: nothing is written to them any more."""
        return all((folder / IDLE).exists() for folder in self._ends.values())

    def end_record(self) -> None:
        """Ask the ends again to end their records: an end that has just switched does not take the order."""
        self._children.order({"order": "idle"}, *ENDS)

    def steer(self, to: Sequence[float] | None) -> None:
        """Move the simulated hand towards `to`, m per axis; None: it lets go of the handle."""
        if self._steered:
            self._children.order({"order": "hand", "to": None if to is None else list(to)}, "master")

    @property
    def folders(self) -> dict[str, Path]:
        """The folders of the two ends, m and s, of the newest turn."""
        return dict(self._ends)

    def drop(self, folders: Sequence[Path]) -> None:
        """Remove records that are kept elsewhere, or were of a turn that was done again."""
        for folder in folders:
            shutil.rmtree(folder.parent, ignore_errors=True)

    # what is seen

    def read(self) -> None:
        """Read the new rows of both ends."""
        for e, tail in self._tails.items():
            try:
                tail.read()
            except (OSError, Misshapen) as error:
                self._fail(f"the record of the {NAMES[e]} cannot be read: {error}")

    @property
    def tick(self) -> int | None:
        """The newest tick that both ends have written; None before the first."""
        newest = [tail.newest[-1][0] if tail.newest else None for tail in self._tails.values()]
        ticks = [int(k) for k in newest if k is not None]
        return min(ticks) if len(ticks) == len(NAMES) else None

    def places(self) -> dict[str, Row | None]:
        """Places of hand, master and slave, m per axis."""
        at = positions_of(self._tails) if self.tick is not None else {}
        return {"hand": self._hand.newest() if self._hand is not None and self._steered else None,
                "master": at.get("m"), "slave": at.get("s")}

    def path(self, e: str, count: int) -> list[Row]:
        """The newest positions of an end, m per axis, oldest first."""
        tail = self._tails[e]
        at = tail.slices.get(f"x_{e}", slice(0, 0))
        return [row[at] for row in list(tail.newest)[-count:]]

    # within

    def _gain(self, e: str) -> float:
        """The share of its force that an end holds."""
        tail = self._tails.get(e)
        if tail is not None and tail.newest and f"g_{e}" in tail.slices:
            return float(tail.newest[-1][tail.slices[f"g_{e}"].start])
        return float(self.live.get(e, {}).get("gain") or 0.0)

    def _next_folders(self) -> dict[str, Path]:
        self._count += 1
        part = self._folder / f"{self._count:04d}"
        part.mkdir(mode=0o700)
        return {e: part / name for e, name in NAMES.items()}

    def _follow(self, folders: Mapping[str, Path]) -> None:
        self._close()
        self._ends = dict(folders)
        self._tails = {e: RecordTail(folder) for e, folder in folders.items()}
        self._hand = HandReference(folders["m"])

    def _close(self) -> None:
        for tail in self._tails.values():
            tail.close()
        if self._hand is not None:
            self._hand.close()

    def _hear(self, name: str, event: dict[str, Any]) -> None:
        """Take an event of one of the three."""
        kind = event["event"]
        if kind == "live":
            self.live[event["end"]] = event
        elif kind == "turned":
            self._waiting.discard(name)
            self._released.discard(name)
            if name == "master":  # its own motion has begun anew, and may lead into the wall
                self.steer(self._home)
        elif kind == "refused":
            self._fail(f"the {name} does not obey: {event['sentence']}")
        elif kind == "event" and event["what"] == "met":
            self._met.add(name)
        elif kind == "event" and event["what"] == "released":
            self._released.add(name)
        elif kind == "event" and event["what"] == "safe":
            self._released.discard(name)

    def _fail(self, why: str) -> None:
        if not self.lost:
            self.lost = True
            self._report(why)


def private_folder(path: Path) -> Path:
    """Make an empty folder that no other user can look into; what an earlier run left there is gone."""
    shutil.rmtree(path, ignore_errors=True)
    path.mkdir(mode=0o700)
    os.chmod(path, 0o700)
    return path
