"""The page's own process: parent of slave, channel and master, which it shows, switches and starts anew."""

from __future__ import annotations

import asyncio
import json
import shutil
from collections.abc import Callable, Hashable
from contextlib import suppress
from typing import Any

from teleop.errors import Refused
from teleop.live.page.controls import Choice, Clutch, Controls, Drag, HandSwing, SwitchQueue, SwitchRequest, most_forces
from teleop.live.page.rows import HandReference, RecordTail, RowMessages, Shaking
from teleop.live.page.server import Clients, Requests, hand_position, sentence_message
from teleop.live.page.session import Children, PageParts, Start, lost_share, size_text
from teleop.live.page.side_view import SideView
from teleop.live.process.interrupt import Interrupt
from teleop.live.records.end_result import NAMES
from teleop.live.records.reader import IDLE as IDLE_FILE
from teleop.live.records.reader import Row
from teleop.protocol.states import Cause
from teleop.storage.strict_json import Misshapen, json_text

PERIOD = 1.0 / 60.0  # s between two pictures, and two orders to the hand, at least
STATUS = 0.25  # s between two messages on the link's state
SILENT = 1.0  # s without a row, and an end is reported as lost, though its process lives
SOON = 5.0  # s after a process was started anew: if it is lost again by then, a person has to start it
IDLE = 60.0  # s without anybody who steers, and the ends write no more
SHARE = 0.25  # of the bytes that are kept: a part that has more is ended, and the next one begun
SCARCE = 1 << 30  # bytes that are left of the disk, from which on the page warns
ENDS = ("slave", "master")
EXPECTED = (Cause.ORDERED.name, Cause.NEW_SESSION.name, Cause.ASKED_AGAIN.name)
"""Causes of a safe state that are no news here, whether the end had the order itself or its peer reports it."""


class Page:
    """Session of the page. `parts`: folder for its parts; `start`: options of the processes; `now`: the clock, s.

    `view`: side view of the robot, if that is a MuJoCo model.
    """

    def __init__(self, controls: Controls, parts: PageParts, start: Start, interrupt: Interrupt,
                 now: Callable[[], float], view: SideView | None = None) -> None:
        self._controls, self._parts, self._interrupt, self._now = controls, parts, interrupt, now
        self._scene = controls.first
        self._switches, self._drag, self._clutch = SwitchQueue(Choice()), Drag(), Clutch(self._scene)
        self._rows, self._shaking = RowMessages(self._scene.dt, view), self._shaking_of()
        self._children = Children(start, self._hear, self._lose)
        self._tails: dict[str, RecordTail] = {}
        self._next_tails: dict[str, RecordTail] = {}  # of the part that begins
        self._hand: HandReference | None = None
        self._aligns = False  # the master is being brought to the slave
        self._unreadable: set[str] = set()  # ends whose record is damaged
        self._live: dict[str, dict[str, Any]] = {}
        self._safe: set[str] = set()  # ends whose force was reported to go to zero
        self._hand_order: HandSwing | tuple[float, ...] | None = None  # last motion of the hand that was ordered
        self._ordered = False  # the master has that order, and nothing since that undoes it
        self._swings = True  # nobody has moved the hand since the start, so it swings by itself
        self._policy: dict[str, Any] = {"on": False, "who": ""}  # the switch, and who has authority as a sentence
        self._steered_at = now()  # time at which somebody steered last
        self._idle_at: float | None = None  # time at which the ends were ordered to write no more; None: they write
        self._written, self._free = 0, 0  # bytes in the folder, and left of its disk
        self._measured_at = float("-inf")  # time of that
        self._scarce = False  # reported, until there is more again
        self._lost: dict[str, str] = {}  # processes that have ended, and why
        self._silent: str | None = None  # an end whose process lives and sends nothing
        self._heard_at: dict[str, float] = {}  # time of the last row of each end
        self._restarted_at = float("-inf")  # time at which a process was started anew
        self._restarting: asyncio.Task[None] | None = None
        self._began: float | None = None  # the time of tick 0, on the page's own clock
        self._since = now()
        self._status_at = float("-inf")  # time of the last status
        self._refused_at: dict[str, float] = {}  # time of the system's last refusal, by its reason
        self.clients: Clients | None = None

    async def run(self, requests: Requests, port: int, listening: Callable[[int], None]) -> None:
        """Serve until a signal comes; `listening` is called with the port. Raises `Refused`."""
        asyncio.get_running_loop().set_exception_handler(self._take_exception)
        self.clients = Clients(requests, self, self._now)
        listening(await self.clients.serve(port))
        try:
            begin = self._restarting = asyncio.create_task(self._start("start"))
            due = self._now()
            while self._interrupt.name is None:
                if begin.done():
                    begin.result()
                try:
                    self._step(self._now())
                except OSError as error:
                    self._report_refusal(error)
                due = max(due + PERIOD, self._now())
                await asyncio.sleep(due - self._now())
        finally:
            await self._leave()

    def _report_refusal(self, error: OSError) -> None:
        """Report once that the system refuses something, as a file; the next step tries again."""
        what, now = error.strerror or str(error), self._now()
        last, self._refused_at[what] = self._refused_at.get(what, float("-inf")), now
        if now - last > SOON:
            self._tell("warn", f"the system refused something to the page ({what}); it goes on, and tries again")

    def _take_exception(self, loop: asyncio.AbstractEventLoop, about: dict[str, Any]) -> None:
        """Take an exception for which nobody waits, as of a connection that cannot be accepted."""
        if isinstance(error := about.get("exception"), OSError):
            self._report_refusal(error)
        else:
            loop.default_exception_handler(about)

    async def _leave(self) -> None:
        """End in order: tell the pages, and have the three processes leave."""
        self._tell("info", "the page has ended: it was stopped where it was started")
        if self._restarting is not None:
            self._restarting.cancel()
            await asyncio.wait([self._restarting])
        await self._children.leave(self._interrupt)
        assert self.clients is not None
        await self.clients.close("the page was stopped where it was started")
        for tail in [*self._tails.values(), *self._next_tails.values()]:
            tail.close()
        if self._hand is not None:
            self._hand.close()

    # messages of the pages

    def greeting(self) -> list[str]:
        """Write the messages for a page that has just been opened."""
        return [self._hello(), self._status(), self._rows.past_message()]

    def hear(self, page: Hashable, message: dict[str, Any]) -> None:
        """Take a message of a page. Raises `Garbage` or `Refused`."""
        kind = message["type"]
        if kind == "hand":
            self._swings = False
        else:
            self._steered_at = self._now()
        if kind == "hand" and message["to"] is None:
            self._drag.let_go(page)
        elif kind == "hand":
            self._drag.move(page, hand_position(message["to"], self._scene.axes), self._now())
        elif kind == "clutch":
            self._clutch.hold(page, held=message["open"])
        elif kind == "scale":
            self._order_scale(self._controls.set_scale(message["to"]))
        elif kind == "policy":
            self._switch_policy(on=message["takes"])
        elif kind == "turn":
            self._switches.ask(self._controls.chosen(self._switches.wanted, message))
        else:
            self._switches.ask(self._switches.wanted, again=True)
        if kind in ("turn", "again") and self._lost and self._restarting is None:
            self._restart()

    def _order_scale(self, scale: float) -> None:
        """Have the master change the scale of the slave's motion, in the session that runs."""
        self._shaking.note_motion()
        self._children.order({"order": "scale", "to": scale}, "master")

    def _switch_policy(self, *, on: bool) -> None:
        """Switch the scene's policy on or off."""
        if self._scene.handover is None:
            raise Refused("this scene has no policy; take one with handover=Handover(), for example handover")
        self._policy["on"] = on
        self._children.order({"order": "policy", "takes": on}, "master")

    def forget(self, page: Hashable) -> None:
        """Forget a page that was closed; its pointer lets go by its silence, see `Drag`."""
        self._clutch.hold(page, held=False)

    # sixty times a second

    def _step(self, now: float) -> None:
        self._show(now)
        self._steer(now)
        if self._children.complete and self._restarting is None:
            self._update_ends(now)
        if now - self._status_at >= STATUS:
            self._status_at = now
            self._watch(now)
            if now - self._measured_at >= 1.0:
                self._measured_at = now
                self._look_at_disk()
            if self.clients is not None:
                self.clients.show(self._status())

    def _show(self, now: float) -> None:
        """Show the new rows of the records."""
        new: dict[str, list[Row]] = {}
        for e in NAMES:
            new[e] = self._read(e)
            if new[e]:
                self._heard_at[e] = now
        if not any(new.values()):
            return
        if self._began is None:
            if not new["m"]:
                return
            self._began = now - self._since - new["m"][-1][0] * self._scene.dt
        t = self._began + max(each.newest[-1][0] for each in self._tails.values() if each.newest) * self._scene.dt
        self._rows.gain.update({e: numbers["gain"] for e, numbers in self._live.items() if "gain" in numbers})
        hand = None if self._hand is None or (self._idle_at is not None and self._swings) else self._hand.newest()
        shown = self._rows.message(t, self._tails, new, hand)
        if shown is None or self.clients is None:
            return
        self.clients.show(shown.text)
        self._clutch.measure(self._tails)
        self._align()
        if (sentence := self._shaking.sentence(now, shown.forces)) is not None:
            self._tell("warn" if self._shaking.shakes else "info", sentence)

    def _read(self, e: str) -> list[Row]:
        """Read the new rows of an end; those of the part that begins, as soon as it has some."""
        if e in self._unreadable:
            return []
        try:
            if e in self._next_tails and (rows := self._next_tails[e].read()):
                self._tails[e].close()
                self._tails[e] = self._next_tails.pop(e)
                if e == "m" and self._idle_at is None:
                    self._follow_hand()
                return rows
            return self._tails[e].read() if e in self._tails else []
        except OSError as error:
            self._report_refusal(error)
        except Misshapen as error:
            self._unreadable.add(e)
            self._tell("error", f"the record of the {NAMES[e]} cannot be shown: {error}")
        return []

    def _follow_hand(self) -> None:
        if self._hand is not None:
            self._hand.close()
        self._hand = HandReference(self._tails["m"].folder)

    def _steer(self, now: float) -> None:
        """Order the master to move the hand, if its target has changed."""
        to = self._controls.swing if self._swings else self._drag.target(now)
        if (self._ordered and to == self._hand_order) or (self._swings and to is None):  # or the scene's own goes on
            return
        self._shaking.note_motion()
        self._hand_order, self._ordered = to, True
        if isinstance(to, HandSwing):
            self._children.order({"order": "hand", "to": list(to.about), "swing": list(to.by)}, "master")
        else:
            self._steered_at = now
            self._children.order({"order": "hand", "to": None if to is None else list(to)}, "master")

    def _update_ends(self, now: float) -> None:
        """Open or close the clutch; begin the next switch, unless the clutch is open."""
        if self._switches.under_way is None and self._clutch.update():
            self._children.order({"order": "clutch", "open": self._clutch.is_open}, *ENDS)
            self._shaking.note_motion()
        if self._switches.late(now):
            self._fail("the three did not all switch in time")
        elif not self._clutch.is_open and (switch := self._switches.next(now)) is not None:
            self._begin_switch(switch)
        elif not self._clutch.is_open and self._switches.under_way is None:
            self._rest(now)

    def _rest(self, now: float) -> None:
        """Have the ends write no more while nobody steers, and begin a part when somebody does again."""
        if now - self._steered_at < IDLE:
            if self._idle_at is not None:
                self._switches.ask(self._switches.wanted, align=True)
            return
        if self._idle_at is None:
            self._tell("info", f"Nobody has steered for {IDLE:g} s: the run goes on, and nothing more is written until "
                               "somebody does")
        elif not self._next_tails or now - self._idle_at < SILENT:
            return
        self._idle_at = now  # an end that has just switched does not take the order, and has it again
        for e, folder in self._parts.newest.items():
            self._next_tails.setdefault(e, RecordTail(folder, IDLE_FILE))
        self._children.order({"order": "idle"}, *ENDS)

    def _look_at_disk(self) -> None:
        """Measure what has been written, and keep it within bounds: the oldest parts go first."""
        try:
            sizes = self._parts.sizes()
            self._written, self._free = sum(sizes), shutil.disk_usage(self._parts.folder).free
            if self._written > self._parts.keep and len(sizes) > 1 and self._switches.under_way is None:
                self._tell("info", f"Part {self._parts.drop_oldest()} is removed: the parts had "
                                   f"{size_text(self._written)}, and --keep is {size_text(self._parts.keep)}")
            elif sizes and sizes[-1] > SHARE * self._parts.keep and self._idle_at is None:
                self._switches.ask(self._switches.wanted, align=True)
        except OSError as error:
            self._report_refusal(error)
        if self._free < SCARCE and not self._scarce and self._written:
            self._tell("warn", f"{size_text(self._free)} are left on the disk of {self._parts.folder}; free some "
                               "space, or start again with --keep")
        self._scarce = self._free < SCARCE

    def _begin_switch(self, switch: SwitchRequest) -> None:
        try:  # a choice without a scene is refused before any end has an order
            knobs, scene = self._controls.knobs(switch.choice), self._controls.scene(switch.choice)
        except (Refused, OSError) as refused:
            self._switches.give_up()
            self._tell("error", str(refused))
            return
        newest = self._tails["m"].newest if "m" in self._tails else None
        try:
            why = "again" if switch.again else "turn" if self._idle_at is None else "idle"
            folders = self._parts.begin(knobs, int(newest[-1][0]) if newest else 0, why)
        except OSError as error:
            self._switches.give_up()
            self._tell("error", f"not switched, since nothing more can be written ({error.strerror or error}); free "
                                "some space, and switch again")
            if self.clients is not None:
                self.clients.tell(self._hello())  # a slider that was moved goes back
            return
        self._tell("info", "Switching...")
        self._scene, self._idle_at = scene, None
        align = None if switch.again else self._clutch.aligned_position(self._tails)
        self._aligns = align is not None
        self._clutch.expect_switch(again=switch.again)
        self._children.turn(knobs, folders, again=switch.again, align=align)
        for tail in self._next_tails.values():
            tail.close()
        self._next_tails = {e: RecordTail(folders[e]) for e in NAMES}
        self._shaking.note_motion()

    def _align(self) -> None:
        """Send a master that is being brought to the slave its new position: without force the slave moves on."""
        if self._aligns and (to := self._clutch.aligned_position(self._tails)) is not None:
            self._children.order({"order": "align", "to": to}, "master")

    # events of the three processes

    def _hear(self, name: str, event: dict[str, Any]) -> None:
        """Take an event of one of the three."""
        kind = event["event"]
        if kind == "live":
            self._live[event["end"]] = event
        elif kind == "turned":
            if name == "master":
                with suppress(OSError):  # the index then has the tick of the request
                    self._parts.correct_start(int(event["k"]))
            self._take_answer(name)
        elif kind == "refused":
            if self._switches.under_way is None:
                self._tell("error", f"the {name}: {event['sentence']}")
            else:
                self._fail(f"the {name} does not switch: {event['sentence']}")
        elif kind == "event":
            self._happened(name, event)

    def _take_answer(self, name: str) -> None:
        """Note that a process has switched; report it when all have."""
        if (switch := self._switches.take_answer(name, self._now())) is not None:
            self._policy = {"on": False, "who": ""}
            self._shaking = self._shaking_of()  # for the new part: another law that shakes is reported again
            self._tell("info", self._describe_switch(switch))
            self._ordered = False  # a hand that is back at the start needs its target again
            self._swings = self._swings or switch.again
            if self.clients is not None:
                self.clients.tell(self._hello())

    def _happened(self, name: str, event: dict[str, Any]) -> None:
        """Take an event that the end's own record has too."""
        what = event["what"]
        if what == "policy":
            self._policy["who"] = event["why"]
        if what == "met" and name == "master":
            self._aligns = False
            self._clutch.begin_session(event["k"])
        if what == "safe" and event["cause"] not in EXPECTED and not self._lost:
            self._safe.add(name)
            self._tell("warn", f"{name.capitalize()}: the force falls to zero, {event['why']}")
        elif what == "released" and name in self._safe:
            self._safe.discard(name)
            self._tell("info", f"{name.capitalize()}: the force is back, {event['why']}")

    def _describe_switch(self, switch: SwitchRequest) -> str:
        words = self._controls.words(switch.choice, self._scene)
        return f"Started again: {words}" if switch.again else f"Switched to {words}"

    # lost, and back

    def _lose(self, name: str, sentence: str) -> None:
        """Note that a process has ended by itself, and start it anew."""
        self._lost[name] = sentence
        self._clutch.expect_switch(again=False)  # a switch follows the next session, which is not the clutch's
        only_just = self._now() - self._restarted_at < SOON
        self._tell("error", f"the {name} is lost: {sentence}{'; press start again' * only_just}")
        if not only_just and self._restarting is None:
            self._restart()

    def _fail(self, why: str) -> None:
        """Give up a switch: the three no longer agree, and are started anew as they were."""
        self._switches.give_up()
        self._tell("error", f"{why}; the three are started anew as they were")
        self._lost["master"] = why
        self._restart()

    def _restart(self) -> None:
        self._restarting = asyncio.create_task(self._start_lost())

    async def _start_lost(self) -> None:
        """Start the lost processes: the channel alone at its port, or all three as a new part."""
        try:
            if set(self._lost) == {"channel"}:
                await self._children.start_channel(self._controls.knobs(self._switches.choice))
                self._restarted_at = self._now()
                self._lost.pop("channel")
                self._take_answer("channel")  # to a switch that it did not live to see
                # Without a force the hand has slid on, and a wall that was pressed would no longer be felt.
                self._switches.ask(self._switches.wanted, align=True)
                self._tell("info", "the channel is back")
            else:
                await self._children.stop()
                await self._start("lost")
                self._tell("info", "slave, channel and master are back, from the scene's start")
        except (Refused, OSError) as error:
            self._tell("error", f"it cannot be started: {error}; press start again")
        finally:
            self._restarting = None
        if self._lost and self._now() - self._restarted_at < SOON:
            return
        if self._lost:
            self._restart()

    async def _start(self, why: str) -> None:
        """Start all three processes, as a new part."""
        self._switches.restart(self._now())
        self._scene = self._controls.scene(self._switches.choice)
        knobs = self._controls.knobs(self._switches.choice)
        folders = self._parts.begin(knobs, 0, why)
        for tail in [*self._tails.values(), *self._next_tails.values()]:
            tail.close()
        self._tails, self._next_tails = {e: RecordTail(folders[e]) for e in NAMES}, {}
        self._follow_hand()
        self._live, self._heard_at, self._safe, self._unreadable = {}, {}, set(), set()
        self._began = None
        self._aligns, self._swings, self._idle_at, self._steered_at = False, True, None, self._now()
        self._clutch, self._shaking, self._policy = Clutch(self._scene), self._shaking_of(), {"on": False, "who": ""}
        try:
            await self._children.start(knobs, folders)
            if self._controls.scale != 1.0:
                self._order_scale(self._controls.scale)
        finally:
            if why != "start":  # a process that is lost just after the first start is started anew like any other
                self._restarted_at = self._now()
            self._restarting = None
            self._ordered = False  # orders meanwhile have reached nobody
        self._lost = {}
        if self.clients is not None:
            self.clients.tell(self._hello())

    def _watch(self, now: float) -> None:
        """Report it when an end stands still though its process lives, and when it goes on."""
        silent = next((NAMES[e] for e, at in self._heard_at.items() if now - at > SILENT), None)
        if self._lost or self._restarting is not None:
            silent = None
        if silent != self._silent:
            self._tell(*(("info", f"the {self._silent} goes on") if silent is None
                         else ("warn", f"the {silent} stands still: nothing has come of it for {SILENT:g} s")))
        self._silent = silent

    # messages to the pages

    def _shaking_of(self) -> Shaking:
        return Shaking(most_forces(self._scene))

    def _tell(self, level: str, sentence: str) -> None:
        if self.clients is not None:
            self.clients.tell(sentence_message(level, sentence))

    def _hello(self) -> str:
        return json_text({**self._controls.hello(self._switches.choice, self._scene), "state": self._state(),
                          "arm": None if self._rows.view is None else self._rows.view.shapes})

    def _state(self) -> str:
        if self._lost:
            return "lost"
        return "running" if any(each.newest for each in self._tails.values()) else "starting"

    def _status(self) -> str:
        ends = {e: {key: value for key, value in self._live.get(e, {}).items() if key != "event"} for e in NAMES}
        worst = {key: max((numbers[key] for numbers in ends.values() if numbers.get(key) is not None), default=None)
                 for key in ("delay", "jitter", "skipped")}
        lost = next(iter(self._lost), self._silent)
        return json.dumps({
            "type": "status", **ends, **worst, "loss": lost_share(self._live),
            "switching": self._switches.under_way is not None, "idle": self._idle_at is not None, "free": self._free,
            "policy": None if self._scene.handover is None else self._policy,
            "written": self._written, "lost": None if lost is None else f"the {lost}", "scale": self._controls.scale,
            "clutch": self._clutch.is_open, "parts": len(self._parts), "shakes": self._shaking.shakes})
