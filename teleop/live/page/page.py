"""The page's own process: parent of slave, channel and master, which it shows, turns and starts anew."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Hashable
from contextlib import suppress
from typing import Any

from teleop.errors import Refused
from teleop.live.page.controls import Choice, Clutch, Controls, Drag, Turn, Turns, most_forces
from teleop.live.page.rows import Follower, Hand, Rows, Shaking
from teleop.live.page.server import Clients, Requests, place, said
from teleop.live.page.session import Children, Parts, Start
from teleop.live.process.interrupt import Interrupt
from teleop.live.records.end_result import NAMES
from teleop.live.records.reader import Row
from teleop.protocol.session import OVER
from teleop.storage.strict_json import Misshapen, json_text

PERIOD = 1.0 / 60.0  # s between two pictures, and two orders to the hand, at least
STATUS = 0.25  # s between two words on how the link is
SILENT = 1.0  # s without a row, and an end is said to be lost, though its process lives
SOON = 5.0  # s after it was started anew: what is lost again then waits for a person
ENDS = ("slave", "master")
OURS = ("a turn", "a new session", "the clutch is open", "the master asks for another")
"""Why an end is safe that is no news here, whether it was told itself or heard it of the other end."""


class Page:
    """`controls`: the scene; `parts`: where its parts go; `start`: how the three are started; `now`: the clock, s."""

    def __init__(self, controls: Controls, parts: Parts, start: Start, interrupt: Interrupt,
                 now: Callable[[], float]) -> None:
        self._controls, self._parts, self._interrupt, self._now = controls, parts, interrupt, now
        self._scene = controls.first
        self._turns, self._drag, self._clutch = Turns(Choice()), Drag(), Clutch(self._scene)
        self._rows, self._shaking = Rows(self._scene.dt), self._shaking_of()
        self._children = Children(start, self._hear, self._ended)
        self._followers: dict[str, Follower] = {}
        self._next: dict[str, Follower] = {}  # of the part that begins
        self._hand: Hand | None = None  # where its reference is
        self._aligns = False  # is the master being brought to the slave
        self._unreadable: set[str] = set()  # ends whose record is damaged
        self._live: dict[str, dict[str, Any]] = {}
        self._safe: set[str] = set()  # ends of which it was said that their force goes to zero
        self._sent: tuple[float, ...] | None = None  # where the hand was told to go
        self._lost: dict[str, str] = {}  # processes that have ended, and why
        self._silent: str | None = None  # an end whose process lives and says nothing
        self._heard: dict[str, float] = {}  # when the last row of each end came
        self._mended = float("-inf")  # when something was started anew
        self._mending: asyncio.Task[None] | None = None
        self._began: float | None = None  # the time of tick 0, on the page's own clock
        self._since = now()
        self._told = float("-inf")  # when the status was told
        self._refused: dict[str, float] = {}  # when the system refused something last, by its reason
        self.clients: Clients | None = None

    async def run(self, requests: Requests, port: int, listening: Callable[[int], None]) -> None:
        """Serve until a signal comes; `listening` is told the port. Raises `Refused`."""
        asyncio.get_running_loop().set_exception_handler(self._raised)
        self.clients = Clients(requests, self, self._now)
        listening(await self.clients.serve(port))
        try:
            begin = self._mending = asyncio.create_task(self._start("start"))
            due = self._now()
            while self._interrupt.name is None:
                if begin.done():
                    begin.result()
                try:
                    self._step(self._now())
                except OSError as error:
                    self._short(error)
                due = max(due + PERIOD, self._now())
                await asyncio.sleep(due - self._now())
        finally:
            await self._leave()

    def _short(self, error: OSError) -> None:
        """Say once what the system does not give now, as files; the next step asks again."""
        what, now = error.strerror or str(error), self._now()
        last, self._refused[what] = self._refused.get(what, float("-inf")), now
        if now - last > SOON:
            self._tell("warn", f"the system refused something to the page ({what}); it goes on, and tries again")

    def _raised(self, loop: asyncio.AbstractEventLoop, about: dict[str, Any]) -> None:
        """Take what was raised where nobody waits for it, as by a connection that cannot be accepted."""
        if isinstance(error := about.get("exception"), OSError):
            self._short(error)
        else:
            loop.default_exception_handler(about)

    async def _leave(self) -> None:
        """Everything in order: the pages are told, the three leave."""
        self._tell("info", "the page has ended: it was stopped where it was started")
        if self._mending is not None:
            self._mending.cancel()
            await asyncio.wait([self._mending])
        leaving = asyncio.create_task(self._children.stop())
        passed = 1
        while not leaving.done():
            await asyncio.wait([leaving], timeout=0.05)
            if self._interrupt.count > passed:  # a second one sets the forces to zero at once
                passed = self._interrupt.count
                self._children.interrupt(str(self._interrupt.name))
        assert self.clients is not None
        await self.clients.close("the page was stopped where it was started")
        for follower in [*self._followers.values(), *self._next.values()]:
            follower.close()
        if self._hand is not None:
            self._hand.close()

    # what the pages say

    def greeting(self) -> list[str]:
        """The messages for a page that has just been opened."""
        return [self._hello(), self._status(), self._rows.past_message()]

    def hear(self, page: Hashable, message: dict[str, Any]) -> None:
        """Take a message of a page. Raises `Garbage` or `Refused`."""
        kind = message["type"]
        if kind == "hand" and message["to"] is None:
            self._drag.let_go(page)
        elif kind == "hand":
            self._drag.move(page, place(message["to"], self._scene.axes), self._now())
        elif kind == "clutch":
            self._clutch.hold(page, held=message["open"])
        elif kind == "turn":
            self._turns.ask(self._controls.chosen(self._turns.wanted, message))
        else:
            self._turns.ask(self._turns.wanted, again=True)
        if kind in ("turn", "again") and self._lost and self._mending is None:
            self._mend()

    def gone(self, page: Hashable) -> None:
        """A page has been closed; of its pointer the rest is silence, see `teleop.live.page.controls`."""
        self._clutch.hold(page, held=False)

    # sixty times a second

    def _step(self, now: float) -> None:
        self._show(now)
        self._steer(now)
        if self._children.complete and self._mending is None:
            self._turn(now)
        if now - self._told >= STATUS:
            self._told = now
            self._watch(now)
            if self.clients is not None:
                self.clients.show(self._status())

    def _show(self, now: float) -> None:
        """Show what has come of the records."""
        new: dict[str, list[Row]] = {}
        for e in NAMES:
            new[e] = self._read(e)
            if new[e]:
                self._heard[e] = now
        if not any(new.values()):
            return
        if self._began is None:
            if not new["m"]:
                return
            self._began = now - self._since - new["m"][-1][0] * self._scene.dt
        t = self._began + max(each.newest[-1][0] for each in self._followers.values()
                                       if each.newest) * self._scene.dt
        self._rows.gain.update({e: numbers["gain"] for e, numbers in self._live.items() if "gain" in numbers})
        shown = self._rows.message(t, self._followers, new, None if self._hand is None else self._hand.newest())
        if shown is None or self.clients is None:
            return
        self.clients.show(shown.text)
        self._clutch.measure(self._followers)
        self._align()
        if (sentence := self._shaking.sentence(now, shown.forces)) is not None:
            self._tell("warn" if self._shaking.shakes else "info", sentence)

    def _read(self, e: str) -> list[Row]:
        """The new rows of an end; of the part that begins, as soon as it has some."""
        if e in self._unreadable:
            return []
        try:
            if e in self._next and (rows := self._next[e].read()):
                self._followers[e].close()
                self._followers[e] = self._next.pop(e)
                if e == "m":
                    self._follow_hand()
                return rows
            return self._followers[e].read() if e in self._followers else []
        except OSError as error:
            self._short(error)
        except Misshapen as error:
            self._unreadable.add(e)
            self._tell("error", f"the record of the {NAMES[e]} cannot be shown: {error}")
        return []

    def _follow_hand(self) -> None:
        if self._hand is not None:
            self._hand.close()
        self._hand = Hand(self._followers["m"].folder)

    def _steer(self, now: float) -> None:
        """Tell the master where the hand is to go, if that has changed."""
        to = self._drag.target(now)
        if to == self._sent:
            return
        self._shaking.moved()
        self._sent = to
        self._children.order({"order": "hand", "to": None if to is None else list(to)}, "master")

    def _turn(self, now: float) -> None:
        """Open or close the clutch; begin the turn that is next, unless the clutch is open."""
        if self._turns.under_way is None and self._clutch.changes():
            self._children.order({"order": "clutch", "open": self._clutch.is_open}, *ENDS)
            self._shaking.moved()
        if self._turns.late(now):
            self._fail("the three did not all turn in time")
        elif not self._clutch.is_open and (turn := self._turns.next(now)) is not None:
            self._begin_turn(turn)

    def _begin_turn(self, turn: Turn) -> None:
        try:  # what cannot be made is refused before any end is told
            knobs, scene = self._controls.knobs(turn.choice), self._controls.scene(turn.choice)
        except (Refused, OSError) as refused:
            self._turns.give_up()
            self._tell("error", str(refused))
            return
        newest = self._followers["m"].newest if "m" in self._followers else None
        try:
            folders = self._parts.begin(knobs, int(newest[-1][0]) if newest else 0, "again" if turn.again else "turn")
        except OSError as error:
            self._turns.give_up()
            self._tell("error", f"not turned, since nothing more can be written ({error.strerror or error}); free some "
                                "space, and turn again")
            if self.clients is not None:
                self.clients.tell(self._hello())  # a slider that was moved goes back
            return
        self._scene = scene
        align = None if turn.again else self._clutch.aligned(self._followers)
        self._aligns = align is not None
        self._clutch.turned(again=turn.again)
        self._children.order({"order": "turn", "knobs": knobs}, "channel")
        for e, name in NAMES.items():
            self._next[e] = Follower(folders[e])
            self._children.order({"order": "turn", "knobs": knobs, "out": str(folders[e]), "again": turn.again,
                                  "align": align if e == "m" else None}, name)
        self._shaking.moved()

    def _align(self) -> None:
        """Tell a master that is being brought to the slave where that is by now: without force it moves on."""
        if self._aligns and (to := self._clutch.aligned(self._followers)) is not None:
            self._children.order({"order": "align", "to": to}, "master")

    # what the three say

    def _hear(self, name: str, event: dict[str, Any]) -> None:
        """Take an event of one of the three."""
        kind = event["event"]
        if kind == "live":
            self._live[event["end"]] = event
        elif kind == "turned":
            if name == "master":
                with suppress(OSError):  # the index then has the tick at which the turn was asked for
                    self._parts.began(int(event["k"]))
            self._answered(name)
        elif kind == "refused":
            if self._turns.under_way is None:
                self._tell("error", f"the {name}: {event['sentence']}")
            else:
                self._fail(f"the {name} does not turn: {event['sentence']}")
        elif kind == "event":
            self._happened(name, event)

    def _answered(self, name: str) -> None:
        """One of the three has turned; when all have, say so."""
        if (turn := self._turns.answered(name, self._now())) is not None:
            self._shaking = self._shaking_of()  # of what begins: another law that shakes is told of again
            self._tell("info", self._turned(turn))
            self._sent = None  # a hand that is back at the start is told again where to go
            if self.clients is not None:
                self.clients.tell(self._hello())

    def _happened(self, name: str, event: dict[str, Any]) -> None:
        """Something that an end's own record tells too."""
        what = event["what"]
        if what == "met" and name == "master":
            self._aligns = False
            self._clutch.met(event["k"])
        if what == "safe" and event["why"].removeprefix(f"{OVER}: ") not in OURS and not self._lost:
            self._safe.add(name)
            self._tell("warn", f"the {name}: the force is on its way to zero, {event['why']}")
        elif what == "released" and name in self._safe:
            self._safe.discard(name)
            self._tell("info", f"the {name}: the force is back, {event['why']}")

    def _turned(self, turn: Turn) -> str:
        hello = self._controls.hello(turn.choice, self._scene)
        begins = "started again" if turn.again else "turned"
        return f"{begins}: law {hello['law']}, {hello['link']}"

    # lost, and back

    def _ended(self, name: str, sentence: str) -> None:
        """One of the three has ended."""
        self._lost[name] = sentence
        self._clutch.turned(again=False)  # the session that heals the run is no clutch's: a turn follows it
        only_just = self._now() - self._mended < SOON
        self._tell("error", f"the {name} is lost: {sentence}{'; press start again' * only_just}")
        if not only_just and self._mending is None:
            self._mend()

    def _fail(self, why: str) -> None:
        """A turn that failed: the three no longer agree, and are started anew as they were."""
        self._turns.give_up()
        self._tell("error", f"{why}; the three are started anew as they were")
        self._lost["master"] = why
        self._mend()

    def _mend(self) -> None:
        self._mending = asyncio.create_task(self._start_anew())

    async def _start_anew(self) -> None:
        """Start what was lost, the channel alone at its port, or all three as a part of its own."""
        try:
            if set(self._lost) == {"channel"}:
                await self._children.start_channel(self._controls.knobs(self._turns.choice))
                self._mended = self._now()
                self._lost.pop("channel")
                self._answered("channel")  # to a turn that it did not live to see
                # Without a force the hand has slid on, and a wall that was pressed would no longer be felt.
                self._turns.ask(self._turns.wanted, align=True)
                self._tell("info", "the channel is back")
            else:
                await self._children.stop()
                await self._start("lost")
                self._tell("info", "slave, channel and master are back, from the scene's start")
        except (Refused, OSError) as error:
            self._tell("error", f"it cannot be started: {error}; press start again")
        finally:
            self._mending = None
        if self._lost and self._now() - self._mended < SOON:
            return
        if self._lost:
            self._mend()

    async def _start(self, why: str) -> None:
        """Start all three, as a part of its own."""
        self._turns.begin(self._now())
        self._scene = self._controls.scene(self._turns.choice)
        knobs = self._controls.knobs(self._turns.choice)
        folders = self._parts.begin(knobs, 0, why)
        for follower in [*self._followers.values(), *self._next.values()]:
            follower.close()
        self._followers, self._next = {e: Follower(folders[e]) for e in NAMES}, {}
        self._follow_hand()
        self._live, self._heard, self._safe, self._unreadable = {}, {}, set(), set()
        self._began = None
        self._aligns = False
        self._clutch, self._shaking = Clutch(self._scene), self._shaking_of()
        try:
            await self._children.start(knobs, folders)
        finally:
            if why != "start":  # what is lost just after the first start is mended like any other
                self._mended = self._now()
            self._mending = None
            self._sent = None  # what was told meanwhile has reached nobody
        self._lost = {}
        if self.clients is not None:
            self.clients.tell(self._hello())

    def _watch(self, now: float) -> None:
        """Say it when an end stands still though its process lives, and when it goes on."""
        silent = next((NAMES[e] for e, at in self._heard.items() if now - at > SILENT), None)
        if self._lost or self._mending is not None:
            silent = None
        if silent != self._silent:
            self._tell(*(("info", f"the {self._silent} goes on") if silent is None
                         else ("warn", f"the {silent} stands still: nothing has come of it for {SILENT:g} s")))
        self._silent = silent

    # in words

    def _shaking_of(self) -> Shaking:
        return Shaking(most_forces(self._scene))

    def _tell(self, level: str, sentence: str) -> None:
        if self.clients is not None:
            self.clients.tell(said(level, sentence))

    def _hello(self) -> str:
        return json_text({**self._controls.hello(self._turns.choice, self._scene), "state": self._state()})

    def _state(self) -> str:
        if self._lost:
            return "lost"
        return "running" if any(each.newest for each in self._followers.values()) else "starting"

    def _status(self) -> str:
        ends = {e: {key: value for key, value in self._live.get(e, {}).items() if key != "event"} for e in NAMES}
        worst = {key: max((numbers[key] for numbers in ends.values() if numbers.get(key) is not None), default=None)
                 for key in ("delay", "jitter", "loss")}
        lost = next(iter(self._lost), self._silent)
        return json.dumps({
            "type": "status", **ends, **worst, "lost": None if lost is None else f"the {lost}",
            "clutch": self._clutch.is_open, "parts": len(self._parts), "shakes": self._shaking.shakes})
